"""One method in the list of step 4: a tick, and its options when asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from magicgui.widgets import CheckBox, ComboBox, FloatSpinBox, SpinBox
from qtpy.QtCore import Signal
from qtpy.QtWidgets import (
    QCheckBox,
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QToolButton,
    QWidget,
)

from napari_phase4d._napari.widgets.wheel import WheelGuard
from napari_phase4d.unwrapping import METHODS, Option, label_of

__all__ = ["MethodRow"]

LARGEST = 1_000_000
DECIMALS = 6


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
        The method was ticked.
    """

    option_changed = Signal()
    ticked_on = Signal(str)

    def __init__(self, method: str, *, ticked: bool) -> None:
        super().__init__()
        self.method = method
        facts = METHODS[method]
        self.tick = QCheckBox(facts.label)
        self.tick.setObjectName(f"method_{method}")
        self.tick.setToolTip(f"{facts.summary}\n{facts.source}")
        self.tick.setChecked(ticked)
        self.tick.toggled.connect(self._toggled)
        self.fields = {option.name: field_of(option) for option in facts.options}
        #: Where the options are set; None for a method that has none.
        self.panel: QWidget | None = None
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.tick, 1)
        if self.fields:
            self.panel = self._options_panel()
            self.more = QToolButton()
            self.more.setObjectName(f"options_{method}")
            self.more.setText("options")
            self.more.setToolTip(f"Show or hide the options of {facts.label}, below the list.")
            self.more.setCheckable(True)
            row.addWidget(self.more)

    def changed(self) -> dict[str, Any]:
        """Return the options that differ from their defaults."""
        defaults = self._defaults()
        return {
            name: field.value
            for name, field in self.fields.items()
            if field.value != defaults[name]
        }

    def show_choice(self, *, ticked: bool, options: Mapping[str, Any]) -> None:
        """Show whether the method is to be run, and with which options."""
        self.tick.setChecked(ticked)
        for name, default in self._defaults().items():
            self.fields[name].value = options.get(name, default)

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
            field.native.setToolTip(option.summary)
            self._wheel.watch(field.native)
            form.addRow(option.name.replace("_", " "), field.native)
            form.labelForField(field.native).setToolTip(option.summary)
            field.changed.connect(self._option_changed)
        panel.hide()
        return panel

    def _toggled(self, on: bool) -> None:
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
    if isinstance(option.default, int):
        return SpinBox(name=option.name, value=option.default, min=0, max=LARGEST)
    box = FloatSpinBox(name=option.name, value=option.default, min=-LARGEST, max=LARGEST, step=0.1)
    box.native.setDecimals(DECIMALS)
    return box
