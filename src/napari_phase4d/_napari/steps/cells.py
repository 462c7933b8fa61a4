"""The tab of step 5 in which each cell is found, followed and measured."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from magicgui.widgets import CheckBox, ComboBox, FloatSpinBox
from napari.layers import Labels
from qtpy.QtWidgets import QAbstractItemView, QFileDialog

from napari_phase4d._napari.preferences import own_optics
from napari_phase4d._napari.session import Plan, Session, plan_cell_by_methods, plan_cells
from napari_phase4d._napari.steps.step import Step, in_grid, increment_field, index_field
from napari_phase4d._napari.widgets.curves import CurvePlot, Panel
from napari_phase4d._napari.widgets.result_table import ResultTable, on_screen
from napari_phase4d.analysis import Cells, CellSettings, most_trusted
from napari_phase4d.holography import pair_distance
from napari_phase4d.io import write_table
from napari_phase4d.later import pd, xr
from napari_phase4d.plotting import colour_of
from napari_phase4d.task import Task
from napari_phase4d.unwrapping import METHODS
from napari_phase4d.words import counted, view_of, wavelengths_of_views

__all__ = ["CellsPart"]

FOUND = "find them"
NOTHING = "Press Find cells: each gets a curve, with its error, and a row."
#: What is plotted over time, the most asked for first, and the column of its error.
PLOTTED = {
    "dry mass (pg)": "dry mass error (pg)",
    "area (um^2)": "",
    "mass density (pg/um^2)": "mass density error (pg/um^2)",
    "mean optical path difference (nm)": "mean optical path difference error (nm)",
    "largest optical path difference (nm)": "",
    "mean phase (rad)": "",
    "volume (um^3)": "volume error (um^3)",
    "mean height (um)": "mean height error (um)",
    "speed (um/s)": "",
    "circularity": "",
}
#: Column of the summary to heading, tooltip and format.
HEADINGS = {
    "cell": (
        "cell",
        "Its number in the picture. Click a row, or the cell, to see it alone.",
        ".0f",
    ),
    "parent": ("parent", "The cell that it came from by division.", ".0f"),
    "from (s)": ("from s", "When it is first seen, in seconds."),
    "to (s)": ("to s", "When it is last seen, in seconds."),
    "dry mass (pg)": ("pg", "Dry mass: median over its frames and views.", ".2f"),
    "dry mass error (pg)": ("±", "One standard deviation of the mass in a single frame.", ".2f"),
    "area (um^2)": ("µm²", "Area: median over its frames and views.", ".1f"),
    "mass density (pg/um^2)": ("pg/µm²", "Dry mass of a square micrometre.", ".3f"),
    "volume (um^3)": ("µm³", "Volume, by the index that is given.", ".1f"),
    "speed (um/s)": ("µm/s", "Speed: median over its frames.", ".2f"),
}
#: What is plotted by its name.
Curves: TypeAlias = "dict[str, np.ndarray[Any, np.dtype[np.float64]]]"
#: More curves than this have no bands.
MOST_BANDS = 12
#: What can be saved: the tables, or a picture of the plot.
KINDS, PICTURES = "Table (*.csv);;Plot (*.png *.svg)", (".png", ".svg")


class CellsPart(Step):
    """Cells, followed: a curve for each, and a row."""

    title = "Cells"
    summary = "Find each cell, follow it, and see its dry mass over time."

    def build(self) -> None:
        """Make the widgets."""
        self._by_methods: dict[str, pd.DataFrame] = {}
        #: All cells that were found, and the curves that are shown with what they depend on.
        self._found: list[int] = []
        self._curves: tuple[tuple[Any, ...], Curves, Curves] | None = None
        self._build_choices()
        self.go = self.button(
            "Find cells",
            "find_cells",
            "Find every cell, follow it through time and views, and measure it.",
            self.find,
        )
        self.quantity = self.watched(
            ComboBox(
                name="cell_quantity",
                choices=[(on_screen(name), name) for name in list(PLOTTED)[:1]],
                tooltip="What the plot shows.",
            )
        )
        self.column.addLayout(self.row(self.go, self.quantity.native))
        self.plot = CurvePlot()
        self.plot.setObjectName("cells_plot")
        self.plot.setMinimumHeight(150)
        self.plot.message(NOTHING)
        self.column.addWidget(self.plot, 3)
        self.table = ResultTable("cells_table")
        self.table.setMinimumHeight(116)
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.itemSelectionChanged.connect(self._chosen_changed)
        self.column.addWidget(self.table, 2)
        self.every = self.button(
            "All cells", "all_cells", "Show the curves of all cells again.", self.show_all
        )
        self.methods = self.button(
            "All methods",
            "cell_by_methods",
            "The chosen cell in the result of every method.",
            self.show_by_methods,
        )
        self.save = self.button(
            "Save…",
            "save_cells",
            "A row for each cell, time and view as CSV, beside it a row for each cell; or a "
            "picture of the plot.",
            self._ask_file,
        )
        self.column.addLayout(self.row(self.every, self.methods, self.save))
        self.when_changed(self.quantity, self._draw)
        self.when_changed(self.source, self._name_button)
        self.session.cells_changed.connect(self._show_cells)
        self.presenter.cells.came_up.connect(self._watch_outlines)
        for signal in (
            self.session.outcome_changed,
            self.session.recording_changed,
            self.session.reconstruction_changed,
        ):
            signal.connect(self._show_results)
        self._show_results()
        if self.presenter.cells.outlines is not None:  # since an earlier dock
            self._watch_outlines()

    def _build_choices(self) -> None:
        self.result = self.watched(
            ComboBox(name="cells_result", choices=[], tooltip="Of which method.")
        )
        self.source = self.watched(
            ComboBox(
                name="cells_source",
                choices=lambda _: self._sources(),
                value=FOUND,
                tooltip="Cells are found in the result; or they are those of a labels layer, "
                "corrected by hand or by another program, and only followed.",
            )
        )
        self.smallest = self.watched(
            FloatSpinBox(
                name="smallest_cell",
                value=0,
                min=0,
                max=1e6,
                step=1,
                tooltip="Smaller blobs are no cells. Default: 30 pixels.",
            )
        )
        self.smallest.native.setSuffix(" µm²")
        self.smallest.native.setSpecialValueText("30 px")
        self.increment = self.watched(increment_field("cells_increment"))
        self.index = self.watched(index_field("cells_index"))
        self.border = self.watched(
            CheckBox(
                name="cells_at_border",
                text="cut off",
                value=True,
                tooltip="Whether cells count that the border of the frame cuts off. Their mass "
                "is that of the part in view.",
            )
        )
        self.oblique = self.watched(
            CheckBox(
                name="cells_oblique",
                text="oblique",
                value=False,
                tooltip="Rays that come at an angle go through more of a cell: multiply by the "
                "cosine of the viewing angle. For angles in the medium that were typed in.",
            )
        )
        # Two grids, so that the longer words of one take no room from the other.
        in_grid(self, (("result", self.result), ("cells", self.source)))
        in_grid(self, (("dn/dc", self.increment), ("object index", self.index)))
        least = self.label("smallest")
        least.setToolTip(self.smallest.tooltip)
        least.setBuddy(self.smallest.native)
        self.column.addLayout(
            self.row(least, self.smallest.native, self.border.native, self.oblique.native)
        )

    def _sources(self) -> list[Any]:
        layers = [la for la in self.presenter.viewer.layers if isinstance(la, Labels)]
        return [FOUND, *layers]

    def reset_choices(self) -> None:
        """Look for layers again."""
        self.look_again(self.source)
        self._name_button()

    def _name_button(self) -> None:
        self.go.setText("Find cells" if self.source.value == FOUND else "Follow cells")

    @property
    def settings(self) -> CellSettings:
        """How cells are found and measured, as the fields say."""
        before = self.session.recipe.cells or CellSettings()
        return CellSettings(
            threshold_rad=before.threshold_rad,
            smallest_um2=self.smallest.value or None,
            largest_um2=before.largest_um2,
            at_border=self.border.value,
            split=before.split,
            oblique=self.oblique.value,
            object_index=None if self.index.value <= 1 else self.index.value,
            refraction_increment_ml_per_g=self.increment.value,
        )

    def find(self) -> None:
        """Find and measure the cells, or follow those of a layer, in a thread."""
        self.session.needed_outcome()
        source = self.source.value
        labels = None if source == FOUND else source.data
        plan = plan_cells(
            self.session, self.result.value, self.settings, labels, optics=own_optics()
        )
        self.jobs.start(replace(plan, work=partial(self._found_and_ready, plan)), then=self._tell)

    def _found_and_ready(self, plan: Plan, task: Task) -> Cells:
        """Find cells, and make their layers, which would hold up the window."""
        cells: Cells = plan.work(task)
        self.presenter.cells.prepare(cells)
        return cells

    def _tell(self) -> None:
        cells = self.session.cells
        if cells is None or cells.table.empty:
            self.said.emit("No cells were found. Are they thinner than 0.25 rad, or too small?")
            return
        divided = len({parent for _, parent in cells.labels.attrs.get("parents", ())})
        words = f", {counted(divided, 'division')}" if divided else ""
        told = f"{counted(len(cells.summary), 'cell')}{words}."
        comparison = self.session.needed_outcome().comparison
        if comparison.knows_confidence(str(self.result.value)):
            told += (
                " Click one to see it alone. Wrong outlines: paint in the layer of cells, then "
                "press Follow cells."
            )
        else:  # of results on disk
            told += (
                " Their errors leave out pixels in doubt about their cycle. To have these in, "
                "press Confidence above, then Find cells again."
            )
        self.said.emit(told)

    def show_all(self) -> None:
        """Show the curves of all cells."""
        self._by_methods = {}
        self.table.clearSelection()
        self._draw()

    def show_by_methods(self) -> None:
        """Show the chosen cell in the result of every method; it is measured in a thread."""
        chosen = self.chosen
        if len(chosen) != 1:
            msg = "choose one cell first: click it in the picture, or its row"
            raise ValueError(msg)
        (cell,) = chosen

        def receive(tables: dict[str, pd.DataFrame]) -> None:
            if self.chosen == [cell]:
                self._by_methods, self._curves = tables, None
                self._draw()

        plan = plan_cell_by_methods(self.session, cell, receive, optics=own_optics())
        self.jobs.start(plan)

    @property
    def chosen(self) -> list[int]:
        """Numbers of the cells whose rows are selected."""
        rows = {index.row() for index in self.table.selectedIndexes()}
        items = (self.table.item(row, 0) for row in sorted(rows))
        return [int(item.value) for item in items if item is not None]

    def choose(self, cell: int) -> None:
        """Select the row of a cell."""
        for row in range(self.table.rowCount()):
            item = self.table.item(row, 0)
            if item is not None and int(item.value) == cell:
                self.table.selectRow(row)
                self.table.scrollToItem(item)

    def clicked(self) -> None:
        """Show the cell alone that was clicked in the picture."""
        cells = self.session.cells
        if cells is None or not self.isVisible():
            return
        pixel, frame = self.presenter.current_pixel(), self.presenter.current_frame()
        if pixel is None:
            return
        cell = int(np.asarray(cells.labels.data[(*frame, *pixel)]))
        if cell:
            self.choose(cell)
        else:
            self.show_all()

    def painted(self) -> None:
        """Offer to follow cells again that were corrected by hand."""
        if not self.presenter.listens:  # this dock was closed
            return
        outlines = self.presenter.cells.outlines
        if outlines is not None and self.source.value != outlines:
            self.reset_choices()
            self.source.value = outlines
            self.said.emit("Press Follow cells to measure the outlines as they are now.")

    def _chosen_changed(self) -> None:
        self._by_methods = {}
        self._draw()

    def frame_changed(self) -> None:
        """Show the curves at the angle on screen, and the time."""
        if self.session.cells is not None and self.isVisible():
            self._draw()

    def _show_results(self) -> None:
        """Offer the results that there are, the most reliable one chosen."""
        results = self.session.results
        with self.own_change():
            self.result.choices = [(METHODS[m].label, m) for m in results]
            if results:
                self.result.value = most_trusted(results)
            how = self.session.recipe.cells
            if how is not None:
                self.smallest.value = how.smallest_um2 or 0
                self.border.value, self.oblique.value = how.at_border, how.oblique
                self.index.value = how.object_index or 1
                self.increment.value = how.refraction_increment_ml_per_g
            else:
                self.oblique.value = angles_are_typed(self.session)
        if self.session.cells is None:
            self._show_cells()

    def _show_cells(self) -> None:
        """Show table and curves of the cells that were found."""
        self._by_methods, self._curves = {}, None
        cells = self.session.cells
        if cells is None or cells.table.empty:
            self.table.clear_rows()
            self.plot.message(NOTHING)
            with self.own_change():  # outlines of before are of other phase
                self.source.reset_choices()
                self.source.value = FOUND
            self._name_button()
            return
        summary = cells.summary
        self._found = summary["cell"].tolist()
        summary["parent"] = summary["parent"].where(summary["parent"] > 0)
        # A column in which nothing stands takes the room of one that says something.
        told = summary.dropna(axis="columns", how="all")
        self.table.show_frame(told, HEADINGS, colours=[colour_of(int(n)) for n in summary["cell"]])
        self.reset_choices()
        with self.own_change():
            self.source.value = FOUND
            kept = self.quantity.value
            there = [name for name in PLOTTED if name in cells.table.columns]
            self.quantity.choices = [(on_screen(name), name) for name in there]
            if kept in self.quantity.choices:
                self.quantity.value = kept
        self._name_button()
        self._draw()

    def _watch_outlines(self) -> None:
        """Hear of what is painted in the outlines, which have just come up."""
        self.presenter.cells.outlines.events.paint.connect(lambda _: self.painted())
        self._name_button()

    def _draw(self) -> None:
        """Plot the chosen quantity over time, at the angle on screen."""
        cells = self.session.cells
        name = self.quantity.value
        if cells is None or cells.table.empty or name is None:
            return
        frame = self.presenter.current_frame()
        where = view_of(cells.labels, frame[1])
        now = float(cells.labels["time"].values[frame[0]])
        times = np.asarray(cells.labels["time"].values, dtype=np.float64)
        wanted = [] if self._by_methods else self.chosen or self._found
        colours = {f"cell {n}": colour_of(int(n)) for n in wanted}
        curves, bands = self._curves_of(cells, str(name), wanted, frame[1])
        words = on_screen(str(name))
        self.plot.show_traces(
            [Panel(times, curves, f"time (s), at {where}", words, now, bands, colours)]
        )

    def _curves_of(
        self, cells: Cells, name: str, wanted: list[int], view: int
    ) -> tuple[Curves, Curves]:
        """Return curves and bands at a view, as they were at the last step if they still hold."""
        about = (id(cells.table), name, tuple(wanted), view, *map(id, self._by_methods.values()))
        if self._curves is None or self._curves[0] != about:
            times = np.asarray(cells.labels["time"].values, dtype=np.float64)
            if self._by_methods:
                tables = {METHODS[m].label: t for m, t in self._by_methods.items()}
            else:
                groups = cells.table.groupby("cell")
                there = groups.groups  # a row may still be that of cells before
                tables = {f"cell {n}": groups.get_group(n) for n in wanted if n in there}
            here = {key: of_view_number(t, cells.labels, view) for key, t in tables.items()}
            error = PLOTTED[name] if len(here) <= MOST_BANDS else ""
            curves = {key: over_time(t, name, times) for key, t in here.items()}
            bands = {k: over_time(t, error, times) for k, t in here.items()} if error else {}
            self._curves = (about, curves, bands)
        return self._curves[1:]

    def save_to(self, path: str | Path) -> None:
        """Write both tables as CSV, units in the headings; or the plot as PNG or SVG."""
        cells = self.session.cells
        if cells is None:
            msg = "there are no cells yet; press Find cells"
            raise ValueError(msg)
        if Path(path).suffix.lower() in PICTURES:
            self.plot.save(path)
            self.said.emit(f"The plot is in {path}.")
            return
        path = write_table(path, cells.table.set_index("cell"))
        beside = path.with_name(f"{path.stem}_summary.csv")
        if not beside.exists():
            write_table(beside, cells.summary.set_index("cell"))
            self.said.emit(f"The cells are in {path}, and in {beside.name} a row for each.")
        else:  # nobody asked whether that one may be replaced
            self.said.emit(f"The cells are in {path}; {beside.name} was there and is as it was.")

    def _ask_file(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Cells", "cells.csv", KINDS)
        if path:
            self.save_to(path)


def of_view_number(table: pd.DataFrame, labels: xr.DataArray, number: int) -> pd.DataFrame:
    """Return the rows of a view of labels, by its angle and, of several, its wavelength."""
    here = table["angle (deg)"] == float(labels["angle"].values[number])
    lights = wavelengths_of_views(labels)
    if lights is not None and "wavelength (um)" in table:
        here &= table["wavelength (um)"] == lights[number]
    return table[here]


def over_time(table: pd.DataFrame, name: str, times: np.ndarray[Any, np.dtype[np.float64]]) -> Any:
    """Return a column of one view at all times, NaN where there is none."""
    found = np.full(times.shape, np.nan)
    places = np.searchsorted(times, table["time (s)"].to_numpy(np.float64))
    found[places] = table[name].to_numpy(np.float64)
    return found


#: Lobes whose carriers are nearer than this, in cycles per pixel, are the same, moved a little.
SAME_CARRIER = 0.02


def angles_are_typed(session: Session) -> bool:
    """Say whether views have other angles than they were found with: beams that come at them.

    A sample's are known without: there the object is turned.
    """
    # A circle that was added by hand has a number for an angle.
    return any(
        lobe.angle_deg != found.angle_deg
        for found in session.found or ()
        for lobe in session.lobes
        if pair_distance(lobe.carrier, found.carrier) < SAME_CARRIER
    )
