"""The views as numbers: carrier, radius, viewing angle, flip."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from qtpy.QtCore import Qt, Signal
from qtpy.QtGui import QColor
from qtpy.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from napari_phase4d._napari.widgets.spectrum_canvas import VIEW_COLORS
from napari_phase4d.holography import Lobe

__all__ = ["LobeTable", "changed_lobe"]

COLUMNS = ("ky (1/px)", "kx (1/px)", "radius", "angle (°)", "flip")
FLIP = len(COLUMNS) - 1


class LobeTable(QTableWidget):  # type: ignore[misc]
    """One row a view; a cell that is typed into gives `typed`.

    Signals
    -------
    typed(int, int, object)
        Row, column and the cell.
    """

    typed = Signal(int, int, object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, len(COLUMNS), parent)
        self._filling = False
        self.setObjectName("lobe_table")
        self.setHorizontalHeaderLabels(COLUMNS)
        self.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self.verticalHeader().setDefaultSectionSize(24)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.setToolTip(
            "Carrier and radius in cycles per camera pixel; the viewing angle in degrees, which a "
            "hologram can't tell; flip where a dense object looks dark."
        )
        self.itemChanged.connect(self._changed)

    def fill(self, lobes: list[Lobe]) -> None:
        """Show these views."""
        self._filling = True
        try:
            self.setRowCount(len(lobes))
            for row, lobe in enumerate(lobes):
                self._fill_row(row, lobe)
        finally:
            self._filling = False
        rows = max(1, len(lobes)) * self.verticalHeader().defaultSectionSize()
        self.setFixedHeight(self.horizontalHeader().sizeHint().height() + rows + 6)

    def _fill_row(self, row: int, lobe: Lobe) -> None:
        header = QTableWidgetItem(str(row + 1))
        header.setForeground(QColor(VIEW_COLORS[row % len(VIEW_COLORS)]))
        self.setVerticalHeaderItem(row, header)
        ky, kx = lobe.carrier
        texts = (f"{ky:.4f}", f"{kx:.4f}", f"{lobe.radius:.4f}", f"{lobe.angle_deg:g}")
        for column, words in enumerate(texts):
            self.setItem(row, column, QTableWidgetItem(words))
        flip = QTableWidgetItem()
        flip.setFlags(Qt.ItemFlag.ItemIsUserCheckable | Qt.ItemFlag.ItemIsEnabled)
        flip.setCheckState(Qt.CheckState.Checked if lobe.flip else Qt.CheckState.Unchecked)
        self.setItem(row, FLIP, flip)

    def _changed(self, item: QTableWidgetItem) -> None:
        if not self._filling:
            self.typed.emit(item.row(), item.column(), item)


def changed_lobe(lobe: Lobe, column: int, item: Any) -> Lobe:
    """Return a lobe with one cell of its table row changed."""
    if column == FLIP:
        return replace(lobe, flip=item.checkState() == Qt.CheckState.Checked)
    try:
        value = float(item.text())
    except ValueError as error:
        msg = f"{COLUMNS[column]} takes a number, but got {item.text()!r}"
        raise ValueError(msg) from error
    ky, kx = lobe.carrier
    changes: dict[int, dict[str, Any]] = {
        0: {"carrier": (value, kx)},
        1: {"carrier": (ky, value)},
        2: {"radius": value},
        3: {"angle_deg": value},
    }
    return replace(lobe, **changes[column])
