"""Step 5: look at the results side by side, measure and save them."""

from __future__ import annotations

from typing import Any

import xarray as xr
from magicgui.widgets import ComboBox
from napari.layers import Image

from napari_phase4d._napari.session import plan_confidence, plan_margin, plan_truth
from napari_phase4d._napari.steps.measure import FiguresPart, MeasurePart, TracePart
from napari_phase4d._napari.steps.share import SharePart
from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.viewing.layers import METADATA_KEY, lazy_of, stack_of_layer
from napari_phase4d._napari.widgets.section import LowTabs
from napari_phase4d.analysis import best_known, order_verdict, steps_sentence
from napari_phase4d.plotting import EXACT

__all__ = ["CompareStep"]

NONE, KNOWN = "none", "known with the sample"
NO_DIFFERENCE = "difference …"


class CompareStep(Step):
    """Grid, table, traces, measuring, saving."""

    title = "5  Compare and measure"
    purpose = "All results share sliders and contrast. Where they differ, at least one is wrong."

    def build(self) -> None:
        """Make the widgets."""
        self.verdict = self.text("", "verdict")
        self.verdict.setVisible(False)
        self.column.addWidget(self.verdict)
        self._build_views()
        self.tabs = LowTabs()
        self.tabs.setObjectName("compare_tabs")
        parts = (self.session, self.jobs, self.presenter)
        self.figures = FiguresPart(*parts)
        self.trace = TracePart(*parts)
        self.measuring = MeasurePart(*parts)
        self.share = SharePart(*parts)
        for part in (self.figures, self.trace, self.measuring, self.share):
            part.failed.connect(self.failed)
            part.said.connect(self.said)
            self.tabs.addTab(part, part.title)
            self.tabs.setTabToolTip(self.tabs.count() - 1, part.summary)
        self.column.addWidget(self.tabs)
        self.session.outcome_changed.connect(self._show_choices)
        self.session.recording_changed.connect(self._show_choices)
        self.session.reconstruction_changed.connect(self._show_choices)
        self.session.truth_changed.connect(self._show_choices)
        self.session.outcome_changed.connect(self._show_verdict)
        self.session.confidence_changed.connect(self._show_verdict)

    def _show_verdict(self) -> None:
        """Say which result to use, as soon as it is known."""
        self.verdict.setText(self.session.verdict)
        self.verdict.setVisible(bool(self.session.verdict))

    def _build_views(self) -> None:
        self.side_by_side = self.button(
            "Side by side",
            "side_by_side",
            "The newest result of every method in a grid.",
            self.show_side_by_side,
        )
        self.leave = self.button(
            "Leave the grid",
            "leave_grid",
            "Show again what was shown before.",
            self.leave_grid,
        )
        self.wrapped = self.button(
            "Wrapped", "show_wrapped", "The wrapped phase alone.", self.show_wrapped
        )
        self.confidence = self.button(
            "Trust",
            "show_confidence",
            "How far to trust: maps of each result's chance to be right, from 0 to 1. Dark is to "
            "be trusted, yellow is more likely off by a cycle.",
            self.show_confidence,
        )
        self.margin = self.button(
            "Steps",
            "show_margin",
            "Where steps are too large: maps of the step to the next time, angle, y and x, in "
            "half cycles. Where it is red, unwrapping along that dimension goes wrong.",
            self.show_margin,
        )
        self.column.addLayout(self.row(self.side_by_side, self.leave))
        self.difference = self.watched(
            ComboBox(
                name="difference",
                choices=[NO_DIFFERENCE],
                tooltip="Each result less this one, in radians, side by side.",
            )
        )
        self.when_changed(self.difference, self._show_difference)
        self.truth = self.watched(
            ComboBox(
                name="truth",
                choices=lambda _: self._truth_choices(),
                value=NONE,
                tooltip="Layer with the exact phase, on the same grid, to count errors against.",
            )
        )
        self.when_changed(self.truth, self._take_truth)
        self.column.addLayout(
            self.row(self.wrapped, self.confidence, self.margin, self.difference.native)
        )
        self.column.addLayout(self.row(self.label("Truth"), self.truth.native))

    def frame_changed(self) -> None:
        """Follow the sliders."""
        self.trace.frame_changed()
        self.measuring.frame_changed()

    def cursor_moved(self) -> None:
        """Follow the mouse."""
        self.trace.cursor_moved()

    def region_drawn(self, layer: Any) -> None:
        """Look at and measure the region that was drawn."""
        self.trace.region_drawn()
        self.measuring.region_drawn(layer)

    def reset_choices(self) -> None:
        """Look for layers again."""
        chosen = self.truth.value
        with self.own_change():
            self.truth.reset_choices()
        gone = chosen not in (NONE, KNOWN) and chosen not in self.presenter.viewer.layers
        if gone and self.session.truth is not None:
            self.session.set_truth(None)
        self.measuring.reset_choices()

    def show_side_by_side(self) -> None:
        """Show the results in a grid."""
        self.presenter.side_by_side()
        self.said.emit("Move the sliders: all results follow.")

    def leave_grid(self) -> None:
        """Show what was shown before the grid."""
        self.presenter.leave_grid()
        self.said.emit("As before the grid. Side by side brings it back.")

    def show_wrapped(self) -> None:
        """Show the wrapped phase alone."""
        self.presenter.show_wrapped()
        self.said.emit("The wrapped phase alone. Side by side shows the results again.")

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
        self.jobs.start(plan_margin(self.session), then=self._margin_known)

    def _margin_known(self) -> None:
        self.presenter.show_margin()
        self.said.emit(self.words_on_the_steps())

    def _show_difference(self) -> None:
        chosen = self.difference.value
        if chosen != NO_DIFFERENCE:
            with self.own_change():
                self.difference.value = NO_DIFFERENCE
            self.presenter.show_difference(self._references()[chosen])
            self.said.emit(f"Each result {chosen}, in radians: dark is 0, half the scale a cycle.")

    def _references(self) -> dict[str, str]:
        """Return what differences can be taken to: words on screen -> method id."""
        if self.session.outcome is None:
            return {}
        labels = self.session.outcome.comparison.table["method"]
        found = {f"less {labels[m]}": m for m in self.session.results}
        if self.session.truth is not None:
            found[f"less {EXACT}"] = EXACT
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
        if self.session.outcome is None and (truth is None or truth.chunks is None):
            self.session.set_truth(truth)  # there is nothing to read and nothing to count
        else:
            self.jobs.start(plan_truth(self.session, truth))

    def _show_choices(self) -> None:
        with self.own_change():
            self.difference.choices = [NO_DIFFERENCE, *self._references()]
            self.difference.value = NO_DIFFERENCE
            self.truth.reset_choices()
            known = self.session.known_truth
            if self.session.truth is None:
                self.truth.value = NONE
            elif known is not None and self.session.truth is known:
                self.truth.value = KNOWN

    def words_on_the_steps(self) -> str:
        """Say along which dimensions steps are too large, and which order suits the object."""
        if self.session.margin is None:
            return ""
        outcome, truth = self.session.outcome, self.session.truth
        results = self.session.results
        frames = self.session.start_frames if outcome is None else outcome.recipe.start_frames
        _, basis = best_known(results, truth)
        verdict = order_verdict(results, next(iter(frames), (0, 0)), truth)
        return f"{steps_sentence(self.session.margin, basis)} {verdict}"

    def words_on_confidence(self) -> str:
        """Say which results are least to be trusted, and where whole objects may have slipped."""
        maps, warnings = self.session.confidence, self.session.warnings
        if not maps:
            return ""
        said = "Dark is to be trusted, yellow more likely a cycle off."
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
