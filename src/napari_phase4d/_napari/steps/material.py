"""Fields that tabs of step 5 share: what a cell is made of; and fields side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from magicgui.widgets import FloatSpinBox
from qtpy.QtWidgets import QAbstractSpinBox, QGridLayout

from napari_phase4d._napari.preferences import own_refraction_increment
from napari_phase4d._napari.steps.step import Step

__all__ = ["in_grid", "increment_field", "index_field"]

#: Pixels that a field gets at least.
NARROW = 90


def increment_field(name: str) -> FloatSpinBox:
    """Return a field for the refraction increment."""
    field = FloatSpinBox(
        name=name,
        value=own_refraction_increment(),
        min=0.01,
        max=1,
        step=0.01,
        tooltip="Refraction increment: how much a gram of dry matter in a millilitre "
        "raises the refractive index. 0.18 mL/g is usual for cells (Barer, Nature 169, "
        "366, 1952); proteins have 0.185 (Barer & Joseph 1954) to 0.190 (Zhao et al. 2011).",
    )
    field.native.setSuffix(" mL/g")
    field.native.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)
    return field


def index_field(name: str) -> FloatSpinBox:
    """Return a field for the refractive index of the object."""
    field = FloatSpinBox(
        name=name,
        value=1,
        min=1,
        max=4,
        step=0.01,
        tooltip="Refractive index of the object, no unit; without it there is no height "
        "and no volume.",
    )
    field.native.setDecimals(4)
    field.native.setSpecialValueText("none")
    field.native.setButtonSymbols(QAbstractSpinBox.ButtonSymbols.NoButtons)
    return field


def in_grid(step: Step, fields: Sequence[tuple[str, Any]]) -> None:
    """Add fields with their names to a step, two in a row; those without a name need none."""
    grid = QGridLayout()
    grid.setSpacing(4)
    for number, (words, field) in enumerate(fields):
        row, side = divmod(number, 2)
        if words:
            label = step.label(words)
            label.setToolTip(field.tooltip)
            label.setBuddy(field.native)
            field.native.setMinimumWidth(NARROW)
            grid.addWidget(label, row, 2 * side)
        grid.addWidget(field.native, row, 2 * side + 1)
    grid.setColumnStretch(1, 1)
    grid.setColumnStretch(3, 1)
    step.column.addLayout(grid)
