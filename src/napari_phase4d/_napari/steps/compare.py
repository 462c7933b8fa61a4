"""Step 5: which result to use, all of them side by side, and the tab that saves and shares."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from magicgui.widgets import ComboBox, FloatSpinBox
from napari.layers import Image
from qtpy.QtCore import Qt
from qtpy.QtGui import QGuiApplication
from qtpy.QtWidgets import QFileDialog, QHBoxLayout, QSizePolicy, QVBoxLayout

from napari_phase4d._napari.session import (
    Plan,
    folder_without_results,
    plan_confidence,
    plan_margin,
    plan_saving,
    plan_truth,
)
from napari_phase4d._napari.steps.cells import CellsPart
from napari_phase4d._napari.steps.measure import FiguresPart, MeasurePart, TracePart
from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.viewing.layers import METADATA_KEY, lazy_of, stack_of_layer
from napari_phase4d._napari.viewing.pointing import table_of_regions
from napari_phase4d._napari.widgets.boundary_map import AgreementStrip
from napari_phase4d._napari.widgets.section import LowTabs
from napari_phase4d.analysis import in_memory, most_trusted
from napari_phase4d.io import write_figure, write_movie
from napari_phase4d.later import xr
from napari_phase4d.plotting import (
    EXACT,
    comparison_figure,
    movie_frames,
    named_results,
    phase_limits,
    telling_frames,
)
from napari_phase4d.task import Task, Watch
from napari_phase4d.words import frame_in_words

__all__ = ["CompareStep"]

NONE, KNOWN = "none", "of the sample"
NO_REFERENCE = "less …"
ON_DISK = (
    "These results lie on disk, where it takes longer than a run to see which to use: press "
    "Confidence to hear it."
)


class CompareStep(Step):
    """Grid, table, traces, measuring, saving."""

    title = "5  Compare and measure"
    purpose = "All results share sliders and contrast. Where they differ, at least one is wrong."
    grows = True

    def build(self) -> None:
        """Make the widgets."""
        self.explanation.hide()
        self.verdict = self.text(self.purpose, "verdict")
        self.worst = self.button(
            "Show where",
            "show_worst",
            "Side by side, at the time and view at which methods disagree most.",
            self.show_worst,
        )
        self.worst.setVisible(False)
        self.leave = self.button(
            "Leave the grid",
            "leave_grid",
            "Show again what was shown before.",
            self.leave_grid,
        )
        beside = QVBoxLayout()
        beside.setSpacing(4)
        for button in (self.worst, self.leave):
            button.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
            beside.addWidget(button, alignment=Qt.AlignmentFlag.AlignRight)
        beside.addStretch()
        told = QHBoxLayout()
        told.addWidget(self.verdict, 1)
        told.addLayout(beside)
        self.column.addLayout(told)
        self.agreement = AgreementStrip()
        self.agreement.setVisible(False)
        self.agreement.frame_clicked.connect(
            lambda t, a, _: self.guarded(lambda: self.presenter.go_to(t, a))
        )
        self.column.addWidget(self.agreement)
        self._build_views()
        self.tabs = LowTabs()
        self.tabs.setObjectName("compare_tabs")
        parts = (self.session, self.jobs, self.presenter)
        self.figures = FiguresPart(*parts)
        self.trace = TracePart(*parts)
        self.measuring = MeasurePart(*parts)
        self.cells = CellsPart(*parts)
        self.share = SharePart(*parts)
        for part in (self.figures, self.trace, self.measuring, self.cells, self.share):
            part.failed.connect(self.failed)
            part.said.connect(self.said)
            self.tabs.addTab(part, part.title)
            self.tabs.setTabToolTip(self.tabs.count() - 1, part.summary)
        self.column.addWidget(self.tabs, 1)
        self.session.outcome_changed.connect(self._show_choices)
        self.session.recording_changed.connect(self._show_choices)
        self.session.reconstruction_changed.connect(self._show_choices)
        self.session.truth_changed.connect(self._show_choices)
        self.session.outcome_changed.connect(self._show_verdict)
        self.session.confidence_changed.connect(self._show_verdict)
        self.session.calibration_changed.connect(self._show_words)

    def _show_verdict(self) -> None:
        """Say which result to use, as soon as it is known, and go to where that matters most."""
        verdict = self.session.verdict
        frame = getattr(verdict, "frame", None)
        self._show_words()
        self.worst.setVisible(frame is not None)
        if verdict:
            self.figures.mark(getattr(verdict, "method", ""))
        if frame is not None and self.presenter.has_stayed:
            self.show_worst()

    def _show_words(self) -> None:
        """Say which result to use, with the times and angles of today, and how far all agree."""
        asked_for = self.session.results and self.session.place is not None
        self.verdict.setText(self.session.verdict or (ON_DISK if asked_for else self.purpose))
        self._show_agreement()

    def _show_agreement(self) -> None:
        """Show over time and views how far the methods agree."""
        shares = getattr(self.session.verdict, "disagreement", None)
        shown = shares is not None and len(self.session.results) > 1
        self.agreement.setVisible(shown)
        if shares is not None:
            self.agreement.set_frames_of(shares)
            agreement = 1 - shares.values
            for frame in getattr(self.session.verdict, "lost_frames", []):
                agreement[frame] = np.nan  # it counts for nothing
            self.agreement.set_scores(agreement)
            self.frame_changed()

    def show_worst(self) -> None:
        """Go to where methods disagree most."""
        frame = getattr(self.session.verdict, "frame", None)
        if frame is None:
            msg = "the methods agree everywhere, or have not been held against each other yet"
            raise ValueError(msg)
        if self.presenter.showing != "results":
            self.presenter.side_by_side()
        self.presenter.go_soon_to(*frame)
        words = frame_in_words(self.session.needed_reconstruction()["phase"], *frame)
        self.said.emit(f"{words[0].upper()}{words[1:]}: here methods disagree most.")

    def _build_views(self) -> None:
        """Make one row of buttons, of which that is down whose pictures are on screen."""
        self.views = {
            "results": self.button(
                "Results",
                "side_by_side",
                "The newest result of every method side by side.",
                self.show_side_by_side,
            ),
            "wrapped": self.button(
                "Wrapped", "show_wrapped", "The wrapped phase alone.", self.show_wrapped
            ),
            "confidence": self.button(
                "Confidence",
                "show_confidence",
                "Maps of each result's chance to be right, from 0 to 1. Yellow is safe, dark is "
                "more likely off by a cycle.",
                self.show_confidence,
            ),
            "margin": self.button(
                "Steps",
                "show_margin",
                "Where steps are too large: maps of the step to the next time, angle, y and x, in "
                "half cycles. Where it is red, unwrapping along that dimension goes wrong.",
                self.show_margin,
            ),
            "difference": self.button(
                "Difference",
                "show_difference",
                "Each result less the one that is chosen below, in radians.",
                self.show_difference,
            ),
        }
        for button in self.views.values():
            button.setCheckable(True)
            button.setSizePolicy(QSizePolicy.Policy.MinimumExpanding, QSizePolicy.Policy.Fixed)
            button.setStyleSheet("padding: 4px 2px;")
            button.clicked.connect(self._mark_view)
        together = self.row(*self.views.values())
        together.setSpacing(2)
        self.column.addLayout(together)
        self.difference = self.watched(
            ComboBox(
                name="difference",
                choices=[NO_REFERENCE],
                tooltip="What Difference takes off every result.",
            )
        )
        #: What was taken off last.
        self._less = NO_REFERENCE
        self.when_chosen(self.difference, self.show_difference, self._show_less)
        self.truth = self.watched(
            ComboBox(
                name="truth",
                choices=lambda _: self._truth_choices(),
                value=NONE,
                tooltip="Layer with the exact phase, on the same grid, to count errors against.",
            )
        )
        #: The layer that was chosen last, and the exact phase that was made of it.
        self._taken: tuple[Any, xr.DataArray | None] = (NONE, None)
        self.when_chosen(self.truth, self._take_truth, self._show_truth)
        self.column.addLayout(
            self.row(self.difference.native, self.label("Truth"), self.truth.native)
        )
        self.presenter.showing_changed.connect(self._mark_view)
        self._mark_view()

    def _mark_view(self) -> None:
        """Let that button be down whose pictures are on screen."""
        for name, button in self.views.items():
            button.setChecked(name == self.presenter.showing)

    def doubts(self) -> Sequence[str]:
        """Return what the verdict says, where it warns, and which may have slipped."""
        verdict = self.session.verdict
        unsafe = not getattr(verdict, "is_safe", True) or getattr(verdict, "views_apart", [])
        best = getattr(verdict, "method", "")
        slipped = self.session.warnings.get(best, "")
        return [words for words in (verdict if unsafe else "", slipped) if words]

    def frame_changed(self) -> None:
        """Follow the sliders."""
        if getattr(self.session.verdict, "frame", None) is not None:
            self.agreement.set_current(self.presenter.current_frame())
        self.trace.frame_changed()
        self.measuring.frame_changed()
        self.presenter.frame_changed()
        self.cells.frame_changed()

    def cursor_moved(self) -> None:
        """Follow the mouse."""
        self.trace.cursor_moved()

    def clicked(self) -> None:
        """Show what was clicked."""
        self.cells.clicked()

    def region_drawn(self, layer: Any, changed: Sequence[int] = ()) -> None:
        """Look at and measure the region that was drawn, or whose corners were changed."""
        self.trace.region_drawn(layer)
        self.measuring.region_drawn(layer, changed)

    def reset_choices(self) -> None:
        """Look for layers again."""
        chosen = self._taken[0] if self._counts_taken() else self.truth.value
        self.look_again(self.truth)
        gone = chosen not in (NONE, KNOWN) and chosen not in self.presenter.viewer.layers
        if gone and self.session.truth is not None:
            self.session.set_truth(None)
        self.measuring.reset_choices()
        self.cells.reset_choices()

    def show_side_by_side(self) -> None:
        """Show the results in a grid."""
        self.presenter.side_by_side()
        self.said.emit(self.follow_words())

    def follow_words(self) -> str:
        """Say how to look at all results together: a single frame has no sliders."""
        phase = self.session.needed_reconstruction()["phase"]
        single = phase.sizes["time"] == phase.sizes["angle"] == 1
        return f"{'Zoom in' if single else 'Move the sliders'}: all results follow."

    def leave_grid(self) -> None:
        """Show what was shown before the grid."""
        self.presenter.leave_grid()
        self.said.emit("As before the grid. Results brings it back.")

    def show_wrapped(self) -> None:
        """Show the wrapped phase alone."""
        self.presenter.show_wrapped()
        self.said.emit("The wrapped phase alone. Results shows them again.")

    def show_confidence(self) -> None:
        """Show how far to trust each result; it may have to be computed first."""
        self.session.needed_outcome()
        if self.session.confidence:
            self._confidence_known()
        else:
            self.jobs.start(plan_confidence(self.session), then=self._confidence_known)

    def _confidence_known(self) -> None:
        self.presenter.show_confidence()
        self.said.emit(self.words_on_confidence())

    def show_margin(self) -> None:
        """Show where steps are too large."""
        self.jobs.start(plan_margin(self.session, in_words=True), then=self._margin_known)

    def _margin_known(self) -> None:
        self.presenter.show_margin()
        self.said.emit(self.session.steps_words)

    def show_difference(self) -> None:
        """Show each result less the chosen one."""
        self.session.needed_outcome()
        chosen = self.difference.value
        words = f"Each result {chosen}, in radians: dark is 0, either end a cycle."
        plan = self.presenter.plan_difference(self._references()[chosen])

        def receive(made: Any) -> None:
            plan.receive(made)
            self._less = chosen

        self.jobs.start(replace(plan, receive=receive), then=lambda: self.said.emit(words))

    def _show_less(self) -> None:
        """Let that be chosen which was taken off last."""
        if self._less in self.difference.choices:
            with self.own_change():
                self.difference.value = self._less

    def _references(self) -> dict[str, str]:
        """Return what differences can be taken to: words on screen -> method id."""
        if self.session.outcome is None:
            return {}
        labels = self.session.outcome.comparison.table["method"]
        results = self.session.results
        best = most_trusted(results)
        found = {f"less {labels[m]}": m for m in (best, *(m for m in results if m != best))}
        if self.session.truth is not None:
            found = {f"less {EXACT}": EXACT, **found}
        return found

    def _truth_choices(self) -> list[Any]:
        """Return what may be the exact phase of what is shown."""
        data = self.session.reconstruction
        choices: list[Any] = [NONE]
        if data is None:
            return choices
        if self.session.known_truth is not None:
            choices.append(KNOWN)
        own = (la for la in self.presenter.viewer.layers if isinstance(la, Image))
        return choices + [
            la for la in own if la.data.shape == data["phase"].shape and may_be_truth(la)
        ]

    def _take_truth(self) -> None:
        """Count errors against the chosen layer."""
        chosen = self.truth.value
        if chosen in (NONE, KNOWN):
            truth = self.session.known_truth if chosen == KNOWN else None
        else:
            phase = self.session.needed_reconstruction()["phase"]
            truth = stack_like(chosen, phase)
        plan = plan_truth(self.session, truth)

        def receive(found: Any) -> None:
            plan.receive(found)
            self._taken = (chosen, self.session.truth)
            self._show_truth()

        if self.session.outcome is None and (truth is None or truth.chunks is None):
            receive((truth, None))  # there is nothing to read and nothing to count
        else:
            self.jobs.start(replace(plan, receive=receive))

    def _counts_taken(self) -> bool:
        """Say whether errors are counted against the exact phase that was taken last."""
        truth, taken = self.session.truth, self._taken[1]
        return truth is not None and taken is not None and taken.data is truth.data

    def _show_truth(self) -> None:
        """Show what errors are counted against."""
        truth, layer = self.session.truth, self._taken[0]
        choices = self.truth.choices
        if truth is None:
            shown: Any = NONE
        elif self.session.known_truth is truth:
            shown = KNOWN
        elif self._counts_taken():
            shown = layer
        else:
            layers = (la for la in choices if la not in (NONE, KNOWN))
            shown = next((la for la in layers if la.data is truth.data), self.truth.value)
        if shown in choices:
            with self.own_change():
                self.truth.value = shown

    def _show_choices(self) -> None:
        with self.own_change():
            before, references = self.difference.value, list(self._references())
            self.difference.choices = references or [NO_REFERENCE]
            if before in references:
                self.difference.value = before
            self._less = self.difference.value
        self.look_again(self.truth)
        self._show_truth()

    def words_on_confidence(self) -> str:
        """Say which results are least to be trusted, and where whole objects may have slipped."""
        maps, warnings = self.session.confidence, self.session.warnings
        if not maps:
            return ""
        said = "Yellow is safe, dark is more likely a cycle off."
        if warnings:
            labels = self.session.needed_outcome().comparison.table["method"]
            many = f"{len(warnings)} results" if len(warnings) > 2 else None
            slipped = many or " and ".join(labels[m] for m in warnings)
            said += f" Whole objects may be off in {slipped}: point at them in the table."
        return said


def may_be_truth(layer: Any) -> bool:
    """Say whether a layer is unwrapped phase, as far as is noted in it."""
    note = layer.metadata.get(METADATA_KEY)
    return note is None or note.get("kind") in ("exact", "unwrapped")


def stack_like(layer: Any, phase: xr.DataArray) -> xr.DataArray:
    """Return what a layer shows on the grid of the phase; lazy layers stay lazy.

    Raises
    ------
    ValueError
        If it has another shape.
    """
    if layer.data.shape != phase.shape:
        msg = f"“{layer.name}” is {layer.data.shape}, but the phase is {phase.shape}"
        raise ValueError(msg)
    if METADATA_KEY in layer.metadata:
        return stack_of_layer(layer)
    return phase.copy(data=lazy_of(layer.data))


MOVIES = "MP4 (*.mp4);;GIF (*.gif)"
FIGURES = "PNG (*.png);;SVG (*.svg)"
RECIPES = "Recipe (*.json)"


class SharePart(Step):
    """Everything to files, a movie, a figure, the recipe, a script."""

    title = "Save"
    summary = "Files are written whole or not at all."

    def build(self) -> None:
        """Make the widgets."""
        self.save = self.button(
            "Save everything…",
            "save_results",
            "Phase, amplitude and every result as OME-TIFF with times, angles and pixel, tables, "
            "measurements and regions as CSV, and the recipe, into a folder.",
            self._ask_folder,
        )
        self.movie = self.button(
            "Movie…",
            "save_movie",
            "All results over time, a row for each viewing angle: MP4 or GIF.",
            lambda: self._ask_file("Movie", movie_name(), MOVIES, self.save_movie),
        )
        self.rate = self.watched(
            FloatSpinBox(
                name="movie_rate",
                value=6,
                min=0.1,
                max=50,
                step=1,
                tooltip="Frames per second of the movie.",
            )
        )
        self.rate.native.setSuffix(" frames/s")
        self.figure = self.button(
            "Figure…",
            "save_figure",
            "All results at the thin frame, the frame on screen and the last one: PNG or SVG.",
            lambda: self._ask_file("Figure", "comparison.png", FIGURES, self.save_figure),
        )
        self.recipe = self.button(
            "Recipe…",
            "save_recipe",
            "All settings, to open again in step 1 or to run in a terminal.",
            lambda: self._ask_file("Recipe", "recipe.json", RECIPES, self.save_recipe),
        )
        self.script = self.button(
            "Copy as Python",
            "copy_script",
            "A script on the clipboard that computes every array again, bit for bit.",
            self.copy_script,
        )
        self.column.addWidget(self.save)
        self.column.addLayout(self.row(self.movie, self.rate.native))
        self.column.addWidget(self.figure)
        self.column.addLayout(self.row(self.recipe, self.script))
        self.column.addStretch()

    def save_to(self, folder: str | Path) -> None:
        """Write all results into a folder, in a thread."""
        regions = table_of_regions(self.presenter.viewer.layers)
        self.jobs.start(
            plan_saving(self.session, folder, regions),
            then=lambda: self.said.emit(f"All results are in {folder}; step 1 opens them again."),
        )

    def save_movie(self, path: str | Path) -> None:
        """Write a movie of all results, in a thread."""
        stacks, rate = self.stacks(), float(self.rate.value)
        n_frames = len(next(iter(stacks.values())))

        def work(task: Task) -> Path:
            shown = [stacks[EXACT]] if EXACT in stacks else list(stacks.values())
            some = [in_memory(s[:: max(1, len(s) // 16), :, ::2, ::2]).values for s in shown]
            limits = phase_limits(some)
            frames = movie_frames(stacks, limits, title=self.session.name)
            return write_movie(path, frames, rate, n_frames=n_frames, **task.calls)

        self._start(Path(path), work, "The movie is")

    def save_figure(self, path: str | Path) -> None:
        """Write a figure of all results at some frames, in a thread."""
        stacks = self.stacks()
        outcome, frame = self.session.needed_outcome(), self.presenter.current_frame()
        phase = outcome.reconstruction["phase"]
        frames = telling_frames(phase, outcome.recipe.start_frames[0], frame)

        def work(task: Task) -> Path:
            drawn = comparison_figure(stacks, frames)
            Watch(1, "drawing the figure", task).check()  # cancelled, it must not be written
            return write_figure(path, drawn)

        self._start(Path(path), work, "The figure is")

    def save_recipe(self, path: str | Path) -> None:
        """Write all settings."""
        self.session.recipe.to_file(path)
        self.said.emit(f"The recipe is in {path}.")

    def copy_script(self) -> None:
        """Put a script on the clipboard that computes the results again."""
        QGuiApplication.clipboard().setText(self.session.script())
        self.said.emit("The script is on the clipboard; paste it into a file and run it.")

    def stacks(self) -> dict[str, xr.DataArray]:
        """Return what is compared: the truth, where it is known, and every result by its name."""
        comparison = self.session.needed_outcome().comparison
        return named_results(comparison, self.session.truth)

    def _start(
        self,
        path: Path,
        write: Callable[[Task], Any],
        words: str,
    ) -> None:
        def say() -> None:
            self.said.emit(f"{words} in {path}.")

        self.jobs.start(Plan(f"Saving to {path}", write, lambda _: None), then=say)

    def _ask_folder(self) -> None:
        self.session.needed_outcome()
        folder = QFileDialog.getExistingDirectory(self, "Folder for the results")
        if folder:
            self.save_to(folder_without_results(Path(folder), self.session.recipe.recording))

    def _ask_file(self, title: str, name: str, filters: str, save: Callable[[str], None]) -> None:
        if name != "recipe.json":
            self.session.needed_outcome()
        path, _ = QFileDialog.getSaveFileName(self, title, name, filters)
        if path:
            save(path)


def movie_name() -> str:
    """Return what a movie is called at first; MP4 only where it can be written."""
    return "comparison.mp4" if importlib.util.find_spec("av") else "comparison.gif"
