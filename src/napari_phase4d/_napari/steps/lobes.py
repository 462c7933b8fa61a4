"""Step 2: find the views in the Fourier spectrum, and correct them by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import xarray as xr
from magicgui.widgets import SpinBox
from qtpy.QtCore import Qt
from qtpy.QtGui import QColor
from qtpy.QtWidgets import (
    QAbstractItemView,
    QHBoxLayout,
    QHeaderView,
    QTableWidget,
    QTableWidgetItem,
)

from napari_phase4d._napari.spectrum_canvas import VIEW_COLORS, SpectrumCanvas
from napari_phase4d._napari.steps.step import Step
from napari_phase4d.holography import Lobe, lobe_warnings

__all__ = ["LobesStep"]

COLUMNS = ("ky (1/px)", "kx (1/px)", "radius", "angle (°)", "flip")


class LobesStep(Step):
    """Spectrum with circles, a table of the same, and warnings."""

    title = "2  Lobes"
    purpose = "Each view is a bright spot away from the middle. Find them, or drag the circles."

    def build(self) -> None:
        """Make the widgets."""
        self._filling = False
        self._drawn: xr.DataArray | None = None
        self.column.addLayout(self.form)
        self.n_views = self.field(
            "Views",
            SpinBox(name="n_views", value=2, min=1, max=6, tooltip="Multiplexed viewing angles."),
        )
        self.n_views.changed.connect(lambda n: self.session.update(n_views=n))
        row = QHBoxLayout()
        self.find = self.button(
            "Find lobes", "find_lobes", "Find the views by themselves.", self.find_lobes
        )
        self.add = self.button("Add", "add_lobe", "One more circle, to drag.", self.add_lobe)
        self.remove = self.button(
            "Remove", "remove_lobe", "Remove the view chosen in the table.", self.remove_lobe
        )
        for button in (self.find, self.add, self.remove):
            row.addWidget(button)
        self.column.addLayout(row)
        self.canvas = SpectrumCanvas()
        self.canvas.lobes_edited.connect(self._edited_on_canvas)
        self.canvas.frequency_shown.connect(self._show_frequency)
        self.column.addWidget(self.canvas)
        self.frequency = self.text("", "frequency")
        self.column.addWidget(self.frequency)
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setObjectName("lobe_table")
        self.table.setHorizontalHeaderLabels(COLUMNS)
        self.table.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.table.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setToolTip(
            "Carrier and radius in cycles per camera pixel; the viewing angle in degrees, which a "
            "hologram can't tell; flip where a dense object looks dark."
        )
        self.table.itemChanged.connect(lambda item: self.guarded(lambda: self._typed(item)))
        self.column.addWidget(self.table)
        self.warnings = self.text("", "lobe_warnings")
        self.column.addWidget(self.warnings)
        self.session.recording_changed.connect(self._new_recording)
        self.session.spectrum_changed.connect(self._show)
        self.session.lobes_changed.connect(self._show)
        self._show()

    def find_lobes(self) -> None:
        """Find the views, in a thread."""
        self.jobs.start(self.session.plan_lobes())

    def add_lobe(self) -> None:
        """Add a view where there is none yet."""
        self.session.needed_recording()
        lobes = self.session.lobes
        radius = lobes[0].radius if lobes else 0.08
        angle = max((lobe.angle_deg for lobe in lobes), default=-1.0) + 1
        self.session.set_lobes([*lobes, Lobe((0.25, 0.0), radius, angle)])

    def remove_lobe(self) -> None:
        """Remove the chosen view, or the last one."""
        lobes = self.session.lobes
        if not lobes:
            msg = "there is no lobe to remove"
            raise ValueError(msg)
        row = self.table.currentRow()
        lobes.pop(row if 0 <= row < len(lobes) else -1)
        self.session.set_lobes(lobes)

    def _new_recording(self) -> None:
        self.n_views.value = self.session.recipe.n_views
        self._show()

    def _edited_on_canvas(self, lobes: list[Lobe]) -> None:
        self.session.set_lobes(lobes)

    def _typed(self, item: Any) -> None:
        """Take what was typed into the table; a wrong number leaves all as it was."""
        if self._filling:
            return
        lobes = self.session.lobes
        try:
            lobes[item.row()] = changed_lobe(lobes[item.row()], item.column(), item)
            self.session.set_lobes(lobes)
        finally:
            self._show()

    def _show(self) -> None:
        lobes = self.session.lobes
        if self._drawn is not self.session.spectrum:
            self._drawn = self.session.spectrum
            self.canvas.set_spectrum(self._drawn)
        self.canvas.set_lobes(lobes)
        self._filling = True
        try:
            self._fill_table(lobes)
        finally:
            self._filling = False
        self.warnings.setText("<br>".join(f"⚠ {w}" for w in lobe_warnings(lobes)))
        self.warnings.setVisible(bool(self.warnings.text()))

    def _fill_table(self, lobes: list[Lobe]) -> None:
        self.table.setRowCount(len(lobes))
        for row, lobe in enumerate(lobes):
            header = QTableWidgetItem(str(row + 1))
            header.setForeground(QColor(VIEW_COLORS[row % len(VIEW_COLORS)]))
            self.table.setVerticalHeaderItem(row, header)
            ky, kx = lobe.carrier
            texts = (f"{ky:.4f}", f"{kx:.4f}", f"{lobe.radius:.4f}", f"{lobe.angle_deg:g}")
            for column, words in enumerate(texts):
                self.table.setItem(row, column, QTableWidgetItem(words))
            flip = QTableWidgetItem()
            flip.setFlags(Qt.ItemFlag.ItemIsUserCheckable | Qt.ItemFlag.ItemIsEnabled)
            flip.setCheckState(Qt.CheckState.Checked if lobe.flip else Qt.CheckState.Unchecked)
            self.table.setItem(row, len(COLUMNS) - 1, flip)
        rows = max(1, len(lobes))
        height = self.table.horizontalHeader().sizeHint().height()
        self.table.setFixedHeight(
            height + rows * self.table.verticalHeader().defaultSectionSize() + 6
        )

    def _show_frequency(self, ky: float, kx: float) -> None:
        words = f"ky {ky:+.4f}, kx {kx:+.4f} cycles/px"
        recording = self.session.recording
        if recording is not None:
            pixel = recording.optics.pixel_um
            words += f"  =  {ky / pixel:+.3f}, {kx / pixel:+.3f} cycles/µm"
        self.frequency.setText(words)


def changed_lobe(lobe: Lobe, column: int, item: Any) -> Lobe:
    """Return a lobe with one cell of its table row changed."""
    if column == len(COLUMNS) - 1:
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
