"""Several methods run one after the other on one problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import xarray as xr
from numpy.typing import ArrayLike

from napari_phase4d.evaluation.comparison import Comparison
from napari_phase4d.evaluation.resources import Measured, measured
from napari_phase4d.evaluation.table import as_truth, errors, table_of
from napari_phase4d.progress import CancelledCall, ProgressCall, reworded
from napari_phase4d.stacks import without_masked, wrapped_stack
from napari_phase4d.unwrapping import (
    METHODS,
    Problem,
    SharedSteps,
    check_method,
    label_of,
    run_method,
)

__all__ = ["Runs", "compare", "compare_on"]


def compare(
    phase: xr.DataArray | ArrayLike,
    methods: Sequence[str] | None = None,
    boundary: tuple[int, int] | Sequence[tuple[int, int]] = (0, 0),
    truth: xr.DataArray | ArrayLike | None = None,
    *,
    mask: xr.DataArray | ArrayLike | None = None,
    amplitude: xr.DataArray | ArrayLike | None = None,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    finished: Callable[[str, Comparison], None] | None = None,
) -> Comparison:
    """Unwrap with several methods and put the figures next to each other.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians, see `unwrap`.
    methods : sequence of str, optional
        Ids among `METHODS`. Default: all.
    boundary, mask, amplitude, cancelled
        See `unwrap`.
    truth : DataArray or array_like, optional
        Exact phase of the same frames; they are found by their coordinates, where it has any.
    options : mapping, optional
        Method id to the options of that method.
    progress : callable, optional
        ``progress(done, total, message)`` after each step of a method; the message begins with
        the method and how many there are, such as "T/A (4 of 6): ".
    finished : callable, optional
        ``finished(method, comparison)`` after each method, with all results so far, so that they
        are not lost if the rest is cancelled or fails. They may be looked at straight away;
        the methods of that comparison that compute have to wait until `compare` has ended.

    Returns
    -------
    Comparison
        The two-dimensional unwrapping and the registration are computed once; their time is
        counted in every method that uses them, their memory in the first.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.

    See Also
    --------
    unwrap : One method.
    Comparison.confidence : How far to trust each pixel of a result.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> sample = p4d.simulation.swimming_euglena((48, 64), 4, peak_rad=9)
    >>> methods = ["spatial-2d", "temporal-angular"]
    >>> found = p4d.compare(sample["wrapped"], methods, truth=sample["phase"])
    >>> list(found.table["method"])
    ['2-D', 'T/A']
    >>> found.results["temporal-angular"].dims
    ('time', 'angle', 'y', 'x')
    """
    chosen = list(METHODS) if methods is None else list(methods)
    options = options or {}
    for method in (*chosen, *options):
        check_method(method, options.get(method, {}))
    mask = without_masked(phase, mask)
    problem = Problem(wrapped_stack(phase), boundary, mask, amplitude)
    try:
        return compare_on(InMemory(problem), chosen, truth, options, progress, cancelled, finished)
    finally:
        problem.forget_field()


class Runs(Protocol):
    """Unwraps one phase by any method.

    Attributes
    ----------
    steps : SharedSteps
        What several methods start from.
    problem : Problem or None
        The phase, where all of it is in memory.
    phase : DataArray
        Wrapped phase, wherever it lies.
    """

    steps: SharedSteps
    problem: Problem | None
    phase: xr.DataArray

    def run(
        self,
        method: str,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
        options: Mapping[str, Any],
    ) -> xr.DataArray:
        """Return unwrapped phase."""


class InMemory:
    """Unwraps phase that is in memory.

    Parameters
    ----------
    problem : Problem
        The phase.
    """

    def __init__(self, problem: Problem) -> None:
        self.steps: SharedSteps = problem
        self.problem: Problem | None = problem
        self.phase = problem.template
        self.run = partial(run_method, problem)


def compare_on(
    runs: Runs,
    methods: Sequence[str],
    truth: xr.DataArray | Any,
    options: Mapping[str, Mapping[str, Any]],
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    finished: Callable[[str, Comparison], None] | None = None,
) -> Comparison:
    """Run several methods one after the other, wherever their phase lies; see `compare`."""
    exact = as_truth(truth, runs.phase)
    so_far = Comparison({}, table_of({}), runs.problem, runs.phase)
    rows: dict[str, dict[str, Any]] = {}
    for place, method in enumerate(methods, 1):
        own_options = options.get(method, {})
        label = label_of(method, own_options)
        head = f"{label} ({place} of {len(methods)})"
        report = reworded(progress, partial("{}: {}".format, head))
        cost = cost_of(runs, method, report, cancelled, own_options)
        rows[method] = row_of(label, cost, exact)
        so_far = replace(
            so_far, results={**so_far.results, method: cost.result}, table=table_of(rows)
        )
        if finished is not None:
            finished(method, so_far)
    return so_far


def cost_of(
    runs: Runs,
    method: str,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    options: Mapping[str, Any],
) -> Measured[xr.DataArray]:
    """Run one method, and count the time of the shared steps that others have done for it."""
    shared = dict(runs.steps.seconds)
    runs.steps.used.clear()
    cost = measured(partial(runs.run, method, progress, cancelled, options))
    shared_seconds = sum(shared.get(step, 0.0) for step in runs.steps.used)
    return replace(cost, seconds=cost.seconds + shared_seconds)


def row_of(label: str, cost: Measured[xr.DataArray], truth: xr.DataArray | None) -> dict[str, Any]:
    """Return what the table says of one result."""
    own = {"method": label, "seconds": cost.seconds, "peak_mb": cost.peak_mb}
    return own | errors(cost.result, truth)
