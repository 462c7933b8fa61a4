"""One method in the list of step 4: a tick, and its options when asked for."""

from __future__ import annotations

from typing import Any

from magicgui.widgets import CheckBox, ComboBox, FloatSpinBox, SpinBox
from qtpy.QtWidgets import QCheckBox, QFormLayout, QHBoxLayout, QToolButton, QVBoxLayout, QWidget

from napari_phase4d._napari.steps.wheel import WheelGuard
from napari_phase4d.unwrapping import METHODS, Option, label_of

__all__ = ["MethodRow"]

INDENT = 24
LARGEST = 1_000_000


class MethodRow(QWidget):  # type: ignore[misc]
    """A method's tick box with its options under it.

    Parameters
    ----------
    method : str
        Id among `METHODS`.
    ticked : bool
        Whether it is to be run at first.
    """

    def __init__(self, method: str, *, ticked: bool) -> None:
        super().__init__()
        self.method = method
        facts = METHODS[method]
        self.tick = QCheckBox(facts.label)
        self.tick.setObjectName(f"method_{method}")
        self.tick.setToolTip(f"{facts.summary}\n{facts.source}")
        self.tick.setChecked(ticked)
        self.fields = {option.name: field_of(option) for option in facts.options}
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(2)
        row = QHBoxLayout()
        row.addWidget(self.tick, 1)
        column.addLayout(row)
        if not self.fields:
            return
        self.panel = QWidget()
        form = QFormLayout(self.panel)
        form.setContentsMargins(INDENT, 0, 0, 4)
        wheel = WheelGuard(self)
        for option in facts.options:
            field = self.fields[option.name]
            field.native.setObjectName(f"option_{method}_{option.name}")
            field.native.setToolTip(option.summary)
            wheel.watch(field.native)
            form.addRow(option.name.replace("_", " "), field.native)
            form.labelForField(field.native).setToolTip(option.summary)
            field.changed.connect(self._show_label)
        self.panel.hide()
        column.addWidget(self.panel)
        self.more = QToolButton()
        self.more.setObjectName(f"options_{method}")
        self.more.setText("options")
        self.more.setToolTip(f"Show or hide the options of {facts.label}.")
        self.more.setCheckable(True)
        self.more.toggled.connect(self.panel.setVisible)
        row.addWidget(self.more)

    def changed(self) -> dict[str, Any]:
        """Return the options that differ from their defaults."""
        defaults = {option.name: option.default for option in METHODS[self.method].options}
        return {
            name: field.value
            for name, field in self.fields.items()
            if field.value != defaults[name]
        }

    def _show_label(self) -> None:
        """Name the variant that is chosen."""
        self.tick.setText(label_of(self.method, self.changed()))


def field_of(option: Option) -> Any:
    """Return a widget for an option's type."""
    if option.choices:
        return ComboBox(name=option.name, choices=list(option.choices), value=option.default)
    if isinstance(option.default, bool):
        return CheckBox(name=option.name, value=option.default, text="")
    if isinstance(option.default, int):
        return SpinBox(name=option.name, value=option.default, min=0, max=LARGEST)
    return FloatSpinBox(name=option.name, value=option.default, min=0, max=LARGEST, step=0.1)
