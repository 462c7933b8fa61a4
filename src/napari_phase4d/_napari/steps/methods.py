"""The methods of step 4: ticked or not, with what each may be set to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Any

from magicgui.widgets import CheckBox, ComboBox, FloatSpinBox, LineEdit, SpinBox
from qtpy.QtCore import Qt, Signal
from qtpy.QtWidgets import (
    QCheckBox,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from napari_phase4d._napari.widgets.section import WheelGuard
from napari_phase4d.pipeline import PAPER_METHODS
from napari_phase4d.unwrapping import METHODS, ONE_OF, Option, label_of

__all__ = ["MethodList"]

#: Width of the short names, in letters, so that the full ones stand below each other.
LETTERS = 13
RECOMMENDED = ("directional-l1",)


class MethodList(QWidget):  # type: ignore[misc]
    """The recommended method, those of the paper, and others, which open and close.

    Parameters
    ----------
    chosen : sequence of str
        Ids of the methods that are ticked at first.

    Signals
    -------
    ticked(str)
        The user, or the program, has ticked a method, or no longer.
    ticked_on(str)
        The user has ticked a method.
    option_changed(str)
        An option of a method was changed.
    """

    ticked = Signal(str)
    ticked_on = Signal(str)
    option_changed = Signal(str)

    def __init__(self, chosen: Sequence[str]) -> None:
        super().__init__()
        self.rows = {method: MethodRow(method, ticked=method in chosen) for method in METHODS}
        known = (*RECOMMENDED, *PAPER_METHODS)
        self.others = [method for method in METHODS if method not in known]
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        self.lacking = QLabel()
        self.lacking.setObjectName("lacking")
        self.lacking.setWordWrap(True)
        column.addWidget(self.lacking)
        for method in RECOMMENDED:
            self._add_row(column, method)
            self.rows[method].name.setText(f"{METHODS[method].name}: <b>recommended</b>")
        column.addWidget(QLabel("<b>From the paper</b>"))
        for method in PAPER_METHODS:
            self._add_row(column, method)
        self.more = QToolButton()
        self.more.setObjectName("more_methods")
        self.more.setToolTip("Show or hide the other methods.")
        self.more.setCheckable(True)
        self.more.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.more.toggled.connect(self._show_others)
        column.addWidget(self.more)
        self.rest = QWidget()
        below = QVBoxLayout(self.rest)
        below.setContentsMargins(0, 0, 0, 0)
        below.setSpacing(0)
        for method in self.others:
            self._add_row(below, method)
        column.addWidget(self.rest)
        for row in self.rows.values():
            row.tick.toggled.connect(lambda _, m=row.method: self._count(m))
            row.ticked_on.connect(self.ticked_on)
            row.option_changed.connect(lambda m=row.method: self.option_changed.emit(m))
        self._show_others(False)
        self._say_others()

    def show_choice(self, chosen: Sequence[str], options: Mapping[str, Any]) -> None:
        """Show which methods are to be run, and with which options."""
        for method, row in self.rows.items():
            row.show_choice(ticked=method in chosen, options=options.get(method, {}))

    def show_suiting(self, why_not: Mapping[str, str]) -> None:
        """Let only methods be ticked that make sense; those for which a reason is given say it."""
        for method, row in self.rows.items():
            row.show_suiting(why_not[method])

    def say_what_lacks(self, shape: Sequence[int]) -> None:
        """Say why methods can't be ticked: there is one time, or one view, or both."""
        ones = [dim for dim, count in zip(ONE_OF, shape, strict=False) if count == 1]
        self.lacking.setText(
            f"Only {' and '.join(ONE_OF[dim] for dim in ones)}: methods along "
            f"{' or '.join(ones)} can't be ticked, and are not run."
        )
        self.lacking.setVisible(bool(ones))

    def _add_row(self, column: QVBoxLayout, method: str) -> None:
        row = self.rows[method]
        column.addWidget(row)
        if row.panel is not None:
            column.addWidget(row.panel)
            row.more.toggled.connect(lambda shown, row=row: self._show_options(row, shown))

    def _show_options(self, shown_row: MethodRow, shown: bool) -> None:
        """Show the options of one method at a time."""
        for row in self.rows.values():
            if row.panel is not None and row is not shown_row and shown:
                row.more.setChecked(False)
        assert shown_row.panel is not None
        shown_row.panel.setVisible(shown)

    def _show_others(self, shown: bool) -> None:
        arrow = Qt.ArrowType.DownArrow if shown else Qt.ArrowType.RightArrow
        self.more.setArrowType(arrow)
        self.rest.setVisible(shown)

    def _count(self, method: str) -> None:
        self._say_others()
        self.ticked.emit(method)

    def _say_others(self) -> None:
        """Say how many of the methods that may be hidden are ticked."""
        count = sum(self.rows[method].tick.isChecked() for method in self.others)
        self.more.setText(f"Others ({count} of {len(self.others)} ticked)")


LARGEST = 1_000_000
DECIMALS = 6
#: More than this, and digits behind the point, the boxes of Qt don't hold.
LARGEST_IN_BOX, LARGEST_FLOAT, MOST_DECIMALS = 2**31 - 1, 1e15, 30


class MethodRow(QWidget):  # type: ignore[misc]
    """A method's tick box, and a panel with its options.

    Parameters
    ----------
    method : str
        Id among `METHODS`.
    ticked : bool
        Whether it is to be run at first.

    Signals
    -------
    option_changed()
        An option was changed.
    ticked_on(str)
        The user has ticked the method.
    """

    option_changed = Signal()
    ticked_on = Signal(str)

    def __init__(self, method: str, *, ticked: bool) -> None:
        super().__init__()
        self.method = method
        facts = METHODS[method]
        self.tick = QCheckBox(facts.label)
        self.tick.setObjectName(f"method_{method}")
        self.tick.setChecked(ticked)
        self.tick.clicked.connect(self._clicked)
        self.fields = {option.name: field_of(option) for option in facts.options}
        #: Where the options are set; None for a method that has none.
        self.panel: QWidget | None = None
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.tick)
        self.tick.setMinimumWidth(self.fontMetrics().horizontalAdvance("x" * LETTERS))
        self.name = QLabel(facts.name or facts.package)
        # Rather cut off than widening the dock, where the font is large.
        self.name.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        row.addWidget(self.name, 1)
        if self.fields:
            self.panel = self._options_panel()
            self.more = QToolButton()
            self.more.setObjectName(f"options_{method}")
            self.more.setText("⚙")
            self.more.setAccessibleName(f"options of {facts.label}")
            self.more.setToolTip(f"Show or hide the options of {facts.label}.")
            self.more.setCheckable(True)
            row.addWidget(self.more)
        self.show_suiting("")

    def changed(self) -> dict[str, Any]:
        """Return the options that differ from their defaults."""
        defaults = self._defaults()
        values = {name: value_in(field, defaults[name]) for name, field in self.fields.items()}
        return {name: value for name, value in values.items() if value != defaults[name]}

    def show_choice(self, *, ticked: bool, options: Mapping[str, Any]) -> None:
        """Show whether the method is to be run, and with which options."""
        self.tick.setChecked(ticked)
        for name, default in self._defaults().items():
            field, value = self.fields[name], options.get(name, default)
            field.value = str(value) if isinstance(field, LineEdit) else value

    def show_suiting(self, why_not: str) -> None:
        """Let the method be ticked where nothing speaks against it, else say what does."""
        facts = METHODS[self.method]
        self.tick.setEnabled(not why_not or self.tick.isChecked())
        self.name.setEnabled(self.tick.isEnabled())
        lines = [facts.summary, *([why_not] if why_not else []), facts.source]
        for widget in (self.tick, self.name):
            widget.setToolTip("\n".join(lines))
        self.tick.setAccessibleDescription("\n".join(lines))

    def _defaults(self) -> dict[str, Any]:
        return {option.name: option.default for option in METHODS[self.method].options}

    def _options_panel(self) -> QWidget:
        """Return a box with one field for every option."""
        facts = METHODS[self.method]
        panel = QGroupBox(f"Options of {facts.label}")
        form = QFormLayout(panel)
        form.setVerticalSpacing(3)
        self._wheel = WheelGuard(self)
        for option in facts.options:
            field = self.fields[option.name]
            field.native.setObjectName(f"option_{self.method}_{option.name}")
            field.native.setAccessibleName(f"{option.name.replace('_', ' ')} of {self.method}")
            field.native.setToolTip(option.summary)
            self._wheel.watch(field.native)
            form.addRow(option.name.replace("_", " "), field.native)
            form.labelForField(field.native).setToolTip(option.summary)
            field.changed.connect(self._option_changed)
        panel.hide()
        return panel

    def _clicked(self, on: bool) -> None:
        if on:
            self.ticked_on.emit(self.method)

    def _option_changed(self) -> None:
        """Name the variant that is chosen."""
        self.tick.setText(label_of(self.method, self.changed()))
        self.option_changed.emit()


def field_of(option: Option) -> Any:
    """Return a widget for an option's type."""
    if option.choices:
        return ComboBox(name=option.name, choices=list(option.choices), value=option.default)
    if isinstance(option.default, bool):
        return CheckBox(name=option.name, value=option.default, text="")
    if isinstance(option.default, str):
        return LineEdit(name=option.name, value=option.default)
    field = number_field(option.name, option.default)
    if field is None or field.value != option.default:
        return LineEdit(name=option.name, value=str(option.default))
    return field


def number_field(name: str, default: float) -> Any:
    """Return a box for numbers like a default; None for one that is too large for any."""
    most = max(LARGEST, 10 * abs(default)) if math.isfinite(default) else math.inf
    if isinstance(default, int) and most <= LARGEST_IN_BOX:
        return SpinBox(name=name, value=default, min=0 if default >= 0 else -most, max=most)
    if isinstance(default, int) or most > LARGEST_FLOAT:
        return None
    # Set one by one: as it is made, a box rounds its value to fewer digits.
    box = FloatSpinBox(name=name, min=-most, max=most, step=0.1)
    digits = -int(Decimal(repr(float(default))).as_tuple().exponent)
    box.native.setDecimals(max(DECIMALS, min(digits, MOST_DECIMALS)))
    box.value = default
    return box


def value_in(field: Any, default: Any) -> Any:
    """Return what a field holds, of the type of the default; that, if it can't be read."""
    if not isinstance(field, LineEdit) or isinstance(default, str):
        return field.value
    try:
        return type(default)(field.value)
    except ValueError:
        return default
