"""The tabs of step 5 that measure: the table of figures, curves of a place, regions over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from magicgui.widgets import CheckBox, ComboBox
from napari.layers import Shapes
from numpy.typing import NDArray
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QFileDialog

from napari_phase4d._napari.jobs import Latest, sentence_of
from napari_phase4d._napari.preferences import own_optics
from napari_phase4d._napari.session import (
    Changed,
    Masks,
    MasksCall,
    plan_measuring,
    with_their_cells,
)
from napari_phase4d._napari.steps.step import Step, in_grid, increment_field, index_field
from napari_phase4d._napari.viewing.pointing import (
    LabelsWatch,
    frames_of_regions,
    is_region_layer,
    newest_region,
    note_frame,
    regions_of_layer,
)
from napari_phase4d._napari.widgets.curves import CurvePlot, Panel
from napari_phase4d._napari.widgets.result_table import ResultTable, on_screen
from napari_phase4d._napari.widgets.section import split
from napari_phase4d.analysis import Traces, most_trusted, traces_of
from napari_phase4d.io import write_table
from napari_phase4d.later import pd
from napari_phase4d.plotting import named_results
from napari_phase4d.task import Task
from napari_phase4d.unwrapping import METHODS
from napari_phase4d.words import view_in_words, views_are_numbered

__all__ = ["FiguresPart", "MeasurePart", "TracePart"]

#: Columns of the table: heading, what it means, and how it is written if not with three digits.
HEADINGS = {
    "method": ("method", "The unwrapping method."),
    "seconds": ("s", "Seconds, the shared two-dimensional step included."),
    "doubtful_percent": (
        "doubt %",
        "Pixels of the object whose confidence is below 0.5, in percent. The maps of confidence "
        "err on the side of doubt.",
    ),
    "mse_rad2": ("MSE rad²", "Mean squared error against the chosen truth, in square radians."),
    "wrong_cycles_percent": (
        "wrong %",
        "Pixels that are off by at least one cycle against the chosen truth, in percent.",
    ),
    "peak_mb": ("MB", "Most memory beyond what was there before, in megabytes.", ".1f"),
}


class FiguresPart(Step):
    """Table of the methods: seconds, doubtful pixels, errors."""

    title = "Table"
    summary = "One line a method; click on a heading to sort."

    def build(self) -> None:
        """Make the widgets."""
        self.table = ResultTable("result_table")
        self.table.setMinimumHeight(120)
        self.column.addWidget(self.table, 1)
        self.copy = self.button(
            "Copy", "copy_table", "Put the table on the clipboard.", self._copy
        )
        self.save = self.button(
            "Save as CSV…", "save_table", "Write the table to a file.", self._ask_file
        )
        self.column.addLayout(self.row(self.copy, self.save))
        for signal in (
            self.session.recording_changed,
            self.session.reconstruction_changed,
            self.session.outcome_changed,
            self.session.confidence_changed,
            self.session.truth_changed,
        ):
            signal.connect(self._show)

    def save_to(self, path: str | Path) -> None:
        """Write the table as CSV."""
        path = write_table(path, self.session.needed_outcome().comparison.table)
        self.said.emit(f"The table is in {path}.")

    def mark(self, method: str) -> None:
        """Mark the row of a method, the one to use."""
        outcome = self.session.outcome
        if outcome is None or method not in outcome.comparison.table.index:
            return
        label = str(outcome.comparison.table["method"][method])
        for row in range(self.table.rowCount()):
            item = self.table.item(row, 0)
            if item is not None:
                font = item.font()
                font.setBold(item.text() == label)
                item.setFont(font)

    def _ask_file(self) -> None:
        self.session.needed_outcome()
        path, _ = QFileDialog.getSaveFileName(self, "Table", "table.csv", "CSV (*.csv)")
        if path:
            self.save_to(path)

    def _copy(self) -> None:
        self.table.copy()
        self.said.emit("The table is on the clipboard.")

    def _show(self) -> None:
        outcome = self.session.outcome
        if outcome is None:
            self.table.clear_rows()
            return
        table = outcome.comparison.table
        said = {
            row: words[:1].upper() + words[1:]
            for row, method in enumerate(table.index)
            if (words := self.session.warnings.get(str(method), ""))
        }
        self.table.show_frame(table.reset_index(drop=True), HEADINGS, said)


#: The curves follow mouse and sliders, but no oftener than this.
EVERY_MS = 40


class TracePart(Step):
    """Curves of the pixel under the mouse, or of the region that was drawn last."""

    title = "Trace"
    summary = "Move the mouse over a result, or draw a region: its phase by every method."

    def build(self) -> None:
        """Make the widgets."""
        self._pixel: tuple[int, int] | None = None
        self.plot = CurvePlot()
        self.plot.setObjectName("trace_plot")
        self.plot.setMinimumHeight(180)
        self.column.addWidget(self.plot, 1)
        self.draw = self.button(
            "Draw a region",
            "draw_region",
            "Adds a layer to draw in. The curves then show the mean where it was drawn; in the "
            "tab Measure, a region that was drawn on a cell goes along with it.",
            self._start_region,
        )
        self.follow = self.button(
            "Follow the mouse", "follow_mouse", "Show the pixel under the mouse.", self.unpin
        )
        self.column.addLayout(self.row(self.draw, self.follow))
        self._mask: NDArray[np.bool_] | None = None
        #: Reads results on disk; what was read last, and of what.
        self._reading = Latest(self)
        self._read: tuple[Any, Traces] | None = None
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(EVERY_MS)
        self._timer.timeout.connect(self._show)
        self.session.outcome_changed.connect(self._forget)
        self.session.recording_changed.connect(self._forget)
        self.session.truth_changed.connect(self._start)
        self.session.calibration_changed.connect(self._read_anew)

    def _start_region(self) -> None:
        self.presenter.start_regions()
        self.said.emit("Click the corners of the region on the canvas, double-click to end it.")

    def cursor_moved(self) -> None:
        """Follow the mouse, unless a region is looked at."""
        if self.isVisible() and self._mask is None and self.session.results:
            pixel = self.presenter.current_pixel()
            if pixel is not None and pixel != self._pixel:
                self._pixel = pixel
                self._start()

    def frame_changed(self) -> None:
        """Follow the sliders."""
        self._start()

    def region_drawn(self, layer: Any) -> None:
        """Look at the region that was drawn last, in this layer if it has any."""
        if self.session.reconstruction is None:
            return
        phase = self.session.needed_reconstruction()["phase"]
        self._mask = newest_region(self.presenter.viewer, phase, layer)
        self._start()

    def unpin(self) -> None:
        """Follow the mouse again."""
        self._mask = None
        self._start()

    def showEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        """Bring the curves up to date when the tab is opened."""
        super().showEvent(event)
        self._start()

    def _forget(self) -> None:
        self._mask = self._pixel = None
        self._read_anew()

    def _read_anew(self) -> None:
        """Show the same place, whose times may be others now."""
        self._read = None
        self._reading.drop()
        self._start()

    def _start(self) -> None:
        if not self._timer.isActive():
            self._timer.start()

    def _show(self) -> None:
        """Draw the curves of the place that is looked at."""
        if not self.isVisible():
            return
        outcome = self.session.outcome
        where = self._mask if self._mask is not None else self._pixel
        if outcome is None or where is None:
            self.plot.message("Move the mouse over a result, or draw a region.")
            return
        stacks = named_results(outcome.comparison, self.session.truth)
        frame = self.presenter.current_frame()
        if all(stack.chunks is None for stack in stacks.values()):
            self._draw(traces_of(stacks, frame, where))
            return
        # Over time it is the same whatever the time on screen is: that is not read again.
        place = where.tobytes() if isinstance(where, np.ndarray) else where
        about = (id(outcome), tuple(stacks), place, frame[1])
        if self._known(about) is None:
            self.plot.message("Reading the results from disk…")

        def work(task: Task) -> Traces:
            known = self._known(about)
            return traces_of(stacks, frame, where, known=known, cancelled=task.cancelled)

        def then(found: Traces) -> None:
            self._read = (about, found)
            self._draw(found)

        self._reading.ask(work, then, self._say, about)

    def _known(self, about: Any) -> Traces | None:
        """Return what was read last, if it was about the same."""
        read = self._read
        return read[1] if read is not None and read[0] == about else None

    def _say(self, error: Exception) -> None:
        """Say what went wrong where the curves would be."""
        self.plot.message(sentence_of(error))

    def _draw(self, found: Traces) -> None:
        """Draw curves."""
        time, angle = found.frame
        angles, lights = found.angles_deg.tolist(), found.wavelengths_um
        # Counted from 1, as everywhere on screen; views of several wavelengths share an angle.
        numbered = lights is not None or views_are_numbered(angles)
        places = np.arange(1.0, len(angles) + 1) if numbered else found.angles_deg
        place = "mean of the region" if self._mask is not None else f"pixel {self._pixel}"
        panels = [
            Panel(
                found.times_s,
                found.over_time,
                f"time (s), at {view_in_words(angles, angle, wavelengths_um=lights)}",
                "phase (rad)",
                float(found.times_s[time]),
            )
        ]
        if len(angles) > 1:
            panels.append(
                Panel(
                    places,
                    found.over_angle,
                    f"{'view' if numbered else 'angle (°)'}, at {found.times_s[time]:.3g} s",
                    "",
                    float(places[angle]),
                )
            )
        self.plot.setToolTip(f"Phase of the {place}, by every method.")
        self.plot.show_traces(panels)


OBJECT = "the object"
#: All results, in one table and one plot.
EVERY = "every"
#: Columns that are plotted over time, the most asked for first.
PLOTTED = (
    "dry mass (pg)",
    "mean optical path difference (nm)",
    "mean height (um)",
    "volume (um^3)",
    "area (um^2)",
    "mean phase (rad)",
)
#: Column of the table to its heading and what it means. The file and the clipboard hold more: what
#: was typed beside "Measure".
MEASURED = {
    "method": ("method", "The unwrapping method."),
    "region": ("region", "What was measured."),
    "time (s)": ("s", "Time in seconds."),
    "angle (deg)": ("°", "Viewing angle in degrees."),
    "wavelength (um)": ("λ µm", "Wavelength in micrometres."),
    "area (um^2)": ("µm²", "Area in square micrometres."),
    "mean phase (rad)": ("rad", "Mean phase in radians."),
    "mean optical path difference (nm)": ("nm", "Mean optical path difference in nanometres."),
    "mean height (um)": ("µm", "Mean height in micrometres, by the index that is given."),
    "volume (um^3)": ("µm³", "Volume in cubic micrometres, by the index that is given."),
    "dry mass (pg)": ("pg", "Dry mass in picograms, by the refraction increment that is given."),
}
#: What can be saved: the table, or a picture of the plot.
KINDS, PICTURES = "Table (*.csv);;Plot (*.png *.svg)", (".png", ".svg")


def of_view(measured: pd.DataFrame, number: int) -> tuple[pd.DataFrame, str]:
    """Return the rows of one view by its number, and the view in words."""
    keys = [key for key in ("angle (deg)", "wavelength (um)") if key in measured]
    views = measured[keys].drop_duplicates()
    number = min(number, len(views) - 1)
    lights = views["wavelength (um)"].tolist() if len(keys) > 1 else None
    words = view_in_words(views["angle (deg)"].tolist(), number, wavelengths_um=lights)
    return measured[(measured[keys] == views.iloc[number]).all(axis=1)], words


def curves_of(measured: pd.DataFrame, name: str) -> dict[str, pd.Series]:
    """Return what is plotted of a table: a curve a region, or a method, or a region of each."""
    by = [c for c in ("method", "region") if c in measured and measured[c].nunique() > 1]
    if not by:
        return {str(measured["region"].iloc[0]): measured[name]}
    groups = measured.groupby(by, sort=False)
    return {", ".join(map(str, key)): rows[name] for key, rows in groups}


class MeasurePart(Step):
    """Dry mass and its relatives, of the object, drawn regions or labels."""

    title = "Measure"
    summary = "Dry mass, height and optical path of regions over time."

    def build(self) -> None:
        """Make the widgets."""
        #: Counts what has changed what would be measured.
        self._changes = 0
        #: What was measured last: a layer or the object, None if another panel did it.
        self._of: Any = None
        self._labels = LabelsWatch(self._labels_changed)
        self._build_choices()
        self.go = self.button(
            "Measure", "measure", "Table and plot of every region over time.", self.measure
        )
        self.quantity = self.watched(
            ComboBox(
                name="quantity",
                choices=[(on_screen(PLOTTED[0]), PLOTTED[0])],
                tooltip="What the plot shows.",
            )
        )
        self.column.addLayout(self.row(self.go, self.quantity.native))
        self.plot = CurvePlot()
        self.plot.setObjectName("measure_plot")
        self.plot.setMinimumHeight(130)
        self.table = ResultTable("measure_table")
        self.table.setMinimumHeight(52)
        self.column.addWidget(split(self.plot, self.table), 1)
        self.copy = self.button(
            "Copy", "copy_measured", "Put the table on the clipboard.", self._copy
        )
        self.save = self.button(
            "Save…", "save_measured", "The table as CSV, or a picture of the plot.", self._ask_file
        )
        self.column.addLayout(self.row(self.copy, self.save))
        self.when_changed(self.quantity, self._draw)
        for widget in (self.result, self.regions, self.follow):
            self.when_changed(widget, self._outdate)
        self.session.measured_changed.connect(self._show_measured)
        self.session.outcome_changed.connect(self._show_results)
        self.session.recording_changed.connect(self._new_recording)
        self.session.reconstruction_changed.connect(self._show_results)
        self.session.calibration_changed.connect(self._show_results)
        self._show_results()

    @property
    def measured(self) -> pd.DataFrame:
        """What was measured last; empty before."""
        measured = self.session.measured
        return pd.DataFrame() if measured is None else measured

    def _build_choices(self) -> None:
        self.result = self.watched(
            ComboBox(
                name="measured_result",
                choices=[],
                tooltip="Of which method, or of all in one table and plot.",
            )
        )
        self.regions = self.watched(
            ComboBox(
                name="regions",
                choices=lambda _: self._region_choices(),
                value=OBJECT,
                tooltip="What to measure: the whole object, or the shapes or labels of a layer.",
            )
        )
        self.increment = self.watched(increment_field("increment"))
        self.index = self.watched(index_field("object_index"))
        # Two grids, so that the longer words of one take no room from the other.
        in_grid(self, (("result", self.result), ("region", self.regions)))
        in_grid(self, (("dn/dc", self.increment), ("object index", self.index)))
        self.follow = self.watched(
            CheckBox(
                name="regions_follow",
                text="drawn regions go along with their cell",
                value=True,
                tooltip="A region that was drawn on a cell moves with it through time and views. "
                "Else it stands still.",
            )
        )
        self.column.addWidget(self.follow.native)

    def reset_choices(self) -> None:
        """Look for layers again."""
        if not self.look_again(self.regions):
            self._outdate("The layer that was to be measured was removed")

    def _new_recording(self) -> None:
        """Measure the whole object again: regions of another recording lie elsewhere."""
        with self.own_change():
            self.regions.value = OBJECT
        self._show_results()

    def region_drawn(self, layer: Any, changed: Sequence[int] = ()) -> None:
        """Choose the layer in which a region was drawn, unless there is a table or a choice."""
        if self.session.reconstruction is not None:
            note_frame(layer, self.presenter.current_frame(), changed)
        self.reset_choices()
        if self._of == layer or (self._of is None and not self._is_of_the_object()):
            self._outdate()
        free = self.regions.value == OBJECT and self.session.measured is None
        if free and layer in self.regions.choices:
            with self.own_change():
                self.regions.value = layer

    def _is_of_the_object(self) -> bool:
        """Say whether a script, or a panel that is closed, has measured the whole object."""
        measured = self.session.measured
        return measured is not None and set(measured["region"]) == {"object"}

    def frame_changed(self) -> None:
        """Show the curve at the angle on screen."""
        if len(self.measured) and self.isVisible():
            self._draw()

    def measure(self) -> None:
        """Measure the chosen regions, in a thread."""
        self.session.needed_outcome()
        self._still = ""
        plan = plan_measuring(
            self.session,
            self._methods(),
            self._chosen_regions(),
            optics=own_optics(),
            object_index=None if self.index.value <= 1 else self.index.value,
            refraction_increment_ml_per_g=self.increment.value,
        )
        changes, regions = self._changes, self.regions.value

        def receive(measured: pd.DataFrame) -> None:
            if self._changes != changes:
                raise Changed
            plan.receive(measured)
            with self.own_change():  # a region may have been drawn meanwhile
                self.regions.value = regions

        self.jobs.start(replace(plan, receive=receive), then=self._tell)
        self._of = regions
        self._labels.note(regions)

    def _labels_changed(self) -> None:
        if self.presenter.listens:
            self._outdate()

    def _outdate(self, why: str = "What is to be measured has changed") -> None:
        """Take away what was measured: region or result have changed, and it is not theirs."""
        self._changes += 1
        self._labels.stop()
        if self.session.measured is not None:
            self.session.measured = None
            self.table.clear_rows()
            self.plot.message(f"{why}; press Measure again.")

    def _tell(self) -> None:
        words = "The curves follow the angle on screen."
        self.said.emit(f"{self._still or words} Save… keeps the table or the plot.")

    def _methods(self) -> str | list[str]:
        """Return of which result or results."""
        chosen = self.result.value
        return list(self.session.results) if chosen == EVERY else str(chosen)

    def _chosen_regions(self) -> Masks | MasksCall | None:
        """Return the regions of the chosen layer, None for the whole object."""
        layer, results = self.regions.value, self.session.results
        method = self.result.value
        # A region that goes along with its cell takes the same way in every result.
        result = results[most_trusted(results) if method == EVERY else method]
        if layer == OBJECT:
            return None
        # Shapes are read here, in the window's thread; labels may take a while.
        if isinstance(layer, Shapes):
            drawn, frames = regions_of_layer(layer, result), frames_of_regions(layer)
            if not self.follow.value:
                return drawn
            cells = self.session.cells
            labels = None if cells is None else cells.labels
            how = self.session.recipe.cells

            def going_along(task: Task) -> Masks:
                moved, self._still = with_their_cells(result, drawn, frames, labels, how, task)
                return moved

            return going_along
        return lambda *_: regions_of_layer(layer, result)

    def save_to(self, path: str | Path) -> None:
        """Write the table as CSV, units in the headings; the plot as PNG or SVG."""
        if Path(path).suffix.lower() in PICTURES:
            self._needed_measurement()
            self.plot.save(path)
            self.said.emit(f"The plot is in {path}.")
            return
        table = self._needed_measurement()
        path = write_table(path, table.set_index(table.columns[0]))
        self.said.emit(f"The measurement is in {path}.")

    def _show_measured(self) -> None:
        """Show what was measured."""
        self.table.show_frame(self.measured, MEASURED)
        with self.own_change():
            there = [name for name in PLOTTED if name in self.measured.columns]
            self.quantity.choices = [(on_screen(name), name) for name in there]
        self._draw()

    def _draw(self) -> None:
        """Plot the chosen quantity over time at the angle on screen."""
        name = self.quantity.value
        if self.measured.empty or name is None:
            self.plot.message("Choose what to measure, then press Measure.")
            return
        shown, where = of_view(self.measured, self.presenter.current_frame()[1])
        times = shown["time (s)"].unique()
        curves, words = curves_of(shown, name), on_screen(str(name))
        self.plot.show_curves(times, curves, f"time (s), at {where}", words)

    def _region_choices(self) -> list[Any]:
        layers = [la for la in self.presenter.viewer.layers if is_region_layer(la)]
        return [OBJECT, *layers]

    def _show_results(self) -> None:
        """Offer the results that there are, the most reliable one chosen."""
        results = self.session.results
        with self.own_change():
            every = [("all", EVERY)] if len(results) > 1 else []
            self.result.choices = [(METHODS[m].label, m) for m in results] + every
            if results:
                self.result.value = most_trusted(results)
        self.table.clear_rows()
        self.plot.message("Choose what to measure, then press Measure.")

    def _copy(self) -> None:
        self.table.copy()
        self.said.emit("The measurement is on the clipboard.")

    def _needed_measurement(self) -> pd.DataFrame:
        """Return what was measured, or raise ValueError if nothing was."""
        if self.measured.empty:
            msg = "nothing has been measured yet; press Measure"
            raise ValueError(msg)
        return self.measured

    def _ask_file(self) -> None:
        self._needed_measurement()
        path, _ = QFileDialog.getSaveFileName(self, "Measurement", "measured.csv", KINDS)
        if path:
            self.save_to(path)
