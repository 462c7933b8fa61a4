"""How the session can judge results."""

from __future__ import annotations

from dataclasses import replace

import xarray as xr

from napari_phase4d._napari.session.plan import Plan
from napari_phase4d._napari.session.state import Changed, State
from napari_phase4d.analysis import Comparison, best_known, in_memory, itoh_margin
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch

Judged = tuple[dict[str, xr.DataArray], dict[str, str], str, Comparison]

__all__ = ["plan_confidence", "plan_margin", "plan_truth"]


def plan_truth(state: State, truth: xr.DataArray | None) -> Plan:
    """Plan to read exact phase and count errors against it, None to count none."""
    outcome, data, on_disk = state.outcome, state.reconstruction, state.place is not None
    before = None if outcome is None else outcome.comparison

    def work(
        progress: ProgressCall | None, cancelled: CancelledCall | None
    ) -> tuple[xr.DataArray | None, Comparison | None]:
        # What fits into memory is read here, once, and not at every look at it in the window.
        exact = truth if truth is None or on_disk else in_memory(truth)
        return exact, None if before is None else before.against(exact)

    def receive(found: tuple[xr.DataArray | None, Comparison | None]) -> None:
        now = None if state.outcome is None else state.outcome.comparison
        if now is not before:
            raise Changed
        state.check_phase(data)
        state.take_truth(*found)

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

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> xr.Dataset:
        return itoh_margin(known)

    def receive(margin: xr.Dataset) -> None:
        if state.outcome is not outcome:
            raise Changed
        state.check_phase(data)
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

    def work(progress: ProgressCall | None, cancelled: CancelledCall | None) -> Judged:
        comparison = outcome.comparison
        watch = Watch(3, "weighing", progress, cancelled)
        maps = comparison.confidences(None, None, cancelled)
        watch.step()
        warnings = comparison.warnings()
        watch.step()
        verdict = comparison.verdict
        watch.step()
        return maps, warnings, verdict, comparison.with_doubt(maps)

    def receive(found: Judged) -> None:
        now = state.outcome
        if now is None or now.comparison.results is not outcome.comparison.results:
            raise Changed
        state.confidence, state.warnings, state.verdict, judged = found
        if now.comparison is not outcome.comparison:  # another truth was chosen meanwhile
            judged = now.comparison.with_doubt(state.confidence)
        state.outcome = replace(now, comparison=judged)
        state.confidence_changed.emit()

    return Plan("Weighing the results", work, receive, gives_way=unasked)
