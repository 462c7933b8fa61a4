"""What the session can do from phase to results."""

from __future__ import annotations

import itertools
import tempfile
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import xarray as xr

from napari_phase4d._napari.session.plan import Plan
from napari_phase4d._napari.session.state import State
from napari_phase4d._napari.session.states import phase_is_stale
from napari_phase4d.analysis import REFERENCE, Comparison
from napari_phase4d.pipeline import (
    Outcome,
    estimated_seconds,
    noting_start,
    phase_needs,
    unwrap_by,
    with_start,
)
from napari_phase4d.progress import Cancelled, CancelledCall, ProgressCall
from napari_phase4d.unwrapping import score_boundaries, scores_of_some

__all__ = ["plan_estimate", "plan_scores", "plan_unwrapping"]

#: Numbers the runs whose results lie on disk.
RUNS = itertools.count(1)


def plan_unwrapping(state: State) -> Plan:
    """Plan to unwrap with the chosen methods, one after another.

    Raises
    ------
    ValueError
        If there is no phase for the present settings, or no method is chosen.
    """
    data = state.needed_reconstruction()
    if phase_is_stale(state):
        msg = "the lobes or settings have changed since; press Reconstruct in step 3 again"
        raise ValueError(msg)
    recording, chosen, truth = state.recording, state.recipe, state.truth
    if not chosen.methods:
        msg = "no method is ticked; tick at least one in step 4"
        raise ValueError(msg)
    recipe = state.phase_recipe.changed(
        boundary=state.start_frames or "auto",
        mask=chosen.mask,
        methods=chosen.methods,
        options=chosen.options,
        confidence=chosen.confidence,
    )
    known = state.scores if chosen.boundary == "auto" else None
    finds_start = recipe.boundary == "auto"
    place, number = state.place, next(RUNS)
    folder = Path(tempfile.gettempdir()) if place is None else place.shelf.folder
    needs = phase_needs(recipe.methods, data["phase"].shape, finds_start=finds_start)
    needs.check(folder, on_disk=place is not None)

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> Outcome:
        used, found = with_start(recipe, data["phase"], progress, cancelled)
        scores = known if found is None else found
        so_far: list[Comparison] = []
        # Each run has a folder of its own: what an earlier one showed stays as it is.
        with nullcontext() if place is None else place.nested(f"run_{number}") as own:
            try:
                comparison = unwrap_by(
                    used,
                    data["phase"],
                    truth,
                    progress,
                    cancelled,
                    amplitude=data.get("amplitude"),
                    finished=lambda _, comparison: so_far.append(comparison),
                    place=own,
                )
            except Cancelled:
                if not so_far:
                    raise
                comparison = so_far[-1]
        done = used.changed(methods=tuple(comparison.results))
        return Outcome(recording, done, data, noting_start(comparison, scores), truth, scores)

    def receive(outcome: Outcome) -> None:
        state.check_phase(data)
        if state.truth is not truth:  # chosen while this was computed
            comparison = outcome.comparison.against(state.truth)
            outcome = replace(outcome, comparison=comparison, truth=state.truth)
        state.take_outcome(outcome)
        if state.scores is None and outcome.scores is not None:
            state.scores = outcome.scores
            state.scores_changed.emit()
        state.outcome_changed.emit()

    return Plan("Unwrapping", work, receive, keeps_parts=True)


def plan_scores(state: State, *, unasked: bool = False) -> Plan:
    """Plan to score every frame as the one to start from, by the result of WL1 where there is one.

    Parameters
    ----------
    state : State
        The session.
    unasked : bool, optional
        Whether to do it unseen, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data = state.needed_reconstruction()
    reference = None if state.place is not None else state.results.get(REFERENCE)

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> xr.DataArray:
        if reference is None:
            needs = phase_needs((), data["phase"].shape, finds_start=True)
            needs.check(Path(tempfile.gettempdir()), on_disk=False)
            return scores_of_some(data["phase"], progress=progress, cancelled=cancelled)
        return score_boundaries(data["phase"], reference, progress=progress, cancelled=cancelled)

    def receive(scores: xr.DataArray) -> None:
        state.check_phase(data)
        state.scores, state.scored_by = scores, reference
        state.scores_changed.emit()

    return Plan("Scoring the frames", work, receive, gives_way=unasked)


def plan_estimate(state: State) -> Plan:
    """Plan to see how long the ticked methods will take, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data, recipe = state.needed_reconstruction(), state.recipe
    if state.start_frames:  # found already, which takes no time any more
        recipe = recipe.changed(boundary=state.start_frames)

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> float:
        return estimated_seconds(recipe, data["phase"], cancelled=cancelled)

    def receive(seconds: float) -> None:
        state.check_phase(data)
        state.estimate = (recipe.methods, seconds)
        state.estimate_changed.emit()

    return Plan("Estimating the time", work, receive, gives_way=True)
