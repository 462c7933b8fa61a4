"""How the session can judge results."""

from __future__ import annotations

from dataclasses import replace

import xarray as xr

from napari_phase4d._napari.session.plan import Plan
from napari_phase4d._napari.session.state import Changed, State
from napari_phase4d.evaluation import (
    Comparison,
    best_known,
    itoh_margin,
)
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch

__all__ = ["plan_confidence", "plan_margin", "plan_truth"]


def plan_truth(state: State, truth: xr.DataArray | None) -> Plan:
    """Plan to count errors against exact phase, None to count none.

    Raises
    ------
    ValueError
        If there are no results yet that could be wrong.
    """
    comparison = state.needed_outcome().comparison

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> Comparison:
        return comparison.against(truth)

    def receive(judged: Comparison) -> None:
        if state.outcome is None or state.outcome.comparison is not comparison:
            raise Changed
        state.take_truth(truth, judged)

    return Plan("Counting errors", work, receive, cancellable=False)


def plan_margin(state: State) -> Plan:
    """Plan to see where steps are too large, by the truth or else by the best result.

    Raises
    ------
    ValueError
        If there is neither truth nor a result yet.
    """
    outcome, data = state.outcome, state.reconstruction
    if not state.results and state.truth is None:
        state.needed_outcome()
    known, _ = best_known(state.results, state.truth)

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> xr.Dataset:
        return itoh_margin(known)

    def receive(margin: xr.Dataset) -> None:
        if state.outcome is not outcome or state.reconstruction is not data:
            raise Changed
        state.margin = margin
        state.margin_changed.emit()

    return Plan("Measuring the steps", work, receive, cancellable=False)


def plan_confidence(state: State, *, unasked: bool = False) -> Plan:
    """Plan to see how far every result is to be trusted.

    Parameters
    ----------
    state : State
        The session.
    unasked : bool, optional
        Whether to do it unseen, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no result yet.
    """
    outcome = state.needed_outcome()

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> tuple[dict[str, xr.DataArray], dict[str, str], Comparison]:
        comparison = outcome.comparison
        watch = Watch(len(comparison.results) + 1, "weighing", progress, cancelled)
        maps = {}
        for method in comparison.results:
            maps[method] = comparison.confidence(method, None, cancelled)
            watch.step()
        warnings = comparison.warnings()
        watch.step()
        return maps, warnings, comparison.with_suspicion(maps)

    def receive(found: tuple[dict[str, xr.DataArray], dict[str, str], Comparison]) -> None:
        now = state.outcome
        if now is None or now.comparison.results is not outcome.comparison.results:
            raise Changed
        state.confidence, state.warnings, judged = found
        if now.comparison is not outcome.comparison:  # another truth was chosen meanwhile
            judged = now.comparison.with_suspicion(state.confidence)
        state.outcome = replace(now, comparison=judged)
        state.confidence_changed.emit()

    return Plan("Weighing the results", work, receive, gives_way=unasked)
