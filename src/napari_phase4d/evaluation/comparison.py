"""Methods side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
import pandas as pd
import xarray as xr

from napari_phase4d.evaluation.confidence import REFERENCE, confidence_of, slip_warning
from napari_phase4d.evaluation.errors import mean_squared_error, wrong_cycle_share
from napari_phase4d.evaluation.resources import Measured, measured
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping import (
    METHODS,
    Problem,
    SharedSteps,
    border_medians,
    check_method,
    label_of,
    run_method,
)

__all__ = ["Comparison", "Runs", "compare", "compare_on"]

#: Columns of the table that need truth.
OF_TRUTH = ("mse_rad2", "wrong_cycles_percent")
#: Columns of the table, in the order in which they are shown.
COLUMNS = ("method", "seconds", "peak_mb", "suspicious_percent", *OF_TRUTH)
#: A pixel is suspicious if it is less likely right than this.
SUSPICIOUS = 0.5


@dataclass(frozen=True)
class Comparison:
    """Results of several methods on one problem.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase of each method.
    table : pandas.DataFrame
        One row a method: its label, seconds, peak memory in MB; the share of the object's pixels
        that are suspicious in percent, where asked for with `with_suspicion`; and against truth,
        where given, the mean squared error in rad^2 and the share of pixels wrong by a turn in
        percent.
    problem : Problem or None
        What was unwrapped; None for a recording larger than memory.
    phase : DataArray
        The wrapped phase.
    """

    results: Mapping[str, xr.DataArray]
    table: pd.DataFrame
    problem: Problem | None = field(repr=False)
    phase: xr.DataArray = field(repr=False)

    def needed_problem(self) -> Problem:
        """Return what was unwrapped.

        Raises
        ------
        ValueError
            If it was not held in memory.
        """
        if self.problem is None:
            msg = (
                "how far to trust a result is judged on all frames at once, but these do not fit "
                "into memory; take some of them, such as phase.isel(time=slice(100)), and compare"
            )
            raise ValueError(msg)
        return self.problem

    def reference(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> xr.DataArray:
        """Return the result of directional L1, computed now if it was not among the methods."""
        if REFERENCE in self.results:
            return self.results[REFERENCE]
        problem = self.needed_problem()
        try:
            found: xr.DataArray = problem.once(
                REFERENCE, lambda: run_method(problem, REFERENCE, progress, cancelled, {})
            )
        finally:
            problem.forget("field")  # as large as many results, and of no more use
        return found

    def confidence(
        self,
        method: str,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> xr.DataArray:
        """Return how far each pixel of a method's result is to be trusted, from 0 to 1.

        See `napari_phase4d.evaluation.confidence_of`. The first call may unwrap by directional
        L1, which the others are held against.
        """
        reference = self.reference(progress, cancelled)
        amplitude = self.needed_problem().relative_amplitude
        return confidence_of(self.results[method], reference, amplitude, self._level())

    def warnings(self) -> dict[str, str]:
        """Say of which methods whole objects may be a turn off, and in how many frames.

        Nothing is said of results of a recording larger than memory.
        """
        if self.problem is None:
            return {}
        problem = self.problem
        empty = problem.result(problem.background().mask, "empty", {"units": "1"})
        said = {
            method: slip_warning(result, self.reference(), empty, self._level())
            for method, result in self.results.items()
        }
        return {method: sentence for method, sentence in said.items() if sentence}

    def against(self, truth: xr.DataArray | Any) -> Comparison:
        """Return the same results, with the columns of the table that need truth for this one.

        Nothing is unwrapped again.

        Parameters
        ----------
        truth : DataArray, array_like or None
            Exact phase in radians, of the shape of the phase; None removes these columns.

        Raises
        ------
        ValueError
            If the truth has another shape.
        """
        exact = as_truth(truth, self.phase)
        table = self.table.drop(columns=list(OF_TRUTH), errors="ignore")
        rows = [errors(self.results[str(method)], exact) for method in table.index]
        return replace(self, table=in_order(table.join(pd.DataFrame(rows, index=table.index))))

    def with_suspicion(self, maps: Mapping[str, xr.DataArray]) -> Comparison:
        """Return the same results, with the share of suspicious pixels in the table.

        The column ``suspicious_percent`` is the share in percent of the object's pixels whose
        confidence is below 0.5. The object is what is neither empty field nor left out by a given
        mask; where no object is found, all usable pixels count.

        Parameters
        ----------
        maps : mapping of str to DataArray
            Method id to what `confidence` gave for it. Methods without a map get NaN; with no map
            at all the column goes.

        Raises
        ------
        ValueError
            If there is a map of a method that was not compared.
        """
        unknown = [method for method in maps if method not in self.results]
        if unknown:
            msg = f"there is no result of {unknown[0]!r}; there are {', '.join(self.results)}"
            raise ValueError(msg)
        table = self.table.drop(columns="suspicious_percent", errors="ignore")
        if maps:
            inside = self.object_mask()
            shares = {method: suspicious_percent(trust, inside) for method, trust in maps.items()}
            column = [shares.get(str(method), float("nan")) for method in table.index]
            table = table.assign(suspicious_percent=column)
        return replace(self, table=in_order(table))

    def object_mask(self) -> xr.DataArray:
        """Return what of the usable field is not empty, in the form of the phase."""
        # Not ``problem.mask``: it depends on which methods have run.
        problem = self.needed_problem()
        usable = problem.usable
        inside = usable & ~problem.background().mask
        return problem.result(inside if inside.any() else usable, "object", {"units": "1"})

    def _level(self) -> xr.DataArray:
        """Return the phase of the empty field of every frame, in the form of the phase."""
        problem = self.needed_problem()
        level = border_medians(problem.background().level, problem.first)
        full = np.broadcast_to(level[..., None, None], problem.wrapped.shape)
        return problem.result(full, "level", {"units": "rad"})


def compare(
    phase: xr.DataArray | Any,
    methods: Sequence[str] | None = None,
    boundary: Any = (0, 0),
    truth: xr.DataArray | Any = None,
    *,
    mask: Any = None,
    amplitude: Any = None,
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
        Exact phase of the same shape.
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
    """
    chosen = list(METHODS) if methods is None else list(methods)
    options = options or {}
    for method in (*chosen, *options):
        check_method(method, options.get(method, {}))
    problem = Problem(phase, boundary, mask, amplitude)
    try:
        return compare_on(InMemory(problem), chosen, truth, options, progress, cancelled, finished)
    finally:
        problem.forget("field")  # as large as many results, and of no more use


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
        report = named(progress, f"{label} ({place} of {len(methods)})")
        cost = cost_of(runs, method, report, cancelled, own_options)
        rows[method] = row_of(label, cost, exact)
        so_far = replace(
            so_far, results={**so_far.results, method: cost.result}, table=table_of(rows)
        )
        if finished is not None:
            finished(method, so_far)
    return so_far


def named(progress: ProgressCall | None, name: str) -> ProgressCall | None:
    """Let every message begin with a name."""
    if progress is None:
        return None
    return lambda done, total, message: progress(done, total, f"{name}: {message}")


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


def table_of(rows: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Return a table of one row a method."""
    return pd.DataFrame(list(rows.values()), index=pd.Index(list(rows), name="id"))


def in_order(table: pd.DataFrame) -> pd.DataFrame:
    """Put the columns of a table into the order in which they are shown."""
    return table[[name for name in COLUMNS if name in table.columns]]


def as_truth(truth: xr.DataArray | Any, phase: xr.DataArray) -> xr.DataArray | None:
    """Return truth in the form of the phase, or None."""
    if truth is None:
        return None
    values = (
        truth.transpose(*phase.dims).values
        if isinstance(truth, xr.DataArray)
        else np.asarray(truth)
    )
    if values.shape != phase.shape:
        msg = f"truth is {values.shape}, but the phase is {phase.shape}"
        raise ValueError(msg)
    return phase.copy(data=values)


def errors(result: xr.DataArray, truth: xr.DataArray | None) -> dict[str, float]:
    """Return the columns that need truth."""
    if truth is None:
        return {}
    return {
        "mse_rad2": mean_squared_error(result, truth),
        "wrong_cycles_percent": 100 * wrong_cycle_share(result, truth),
    }


def suspicious_percent(confidence: xr.DataArray, inside: xr.DataArray) -> float:
    """Return the share in percent of the pixels inside that are more likely wrong than right."""
    trust = confidence.transpose(*inside.dims).values
    count = np.count_nonzero(inside.values)
    if count == 0:
        return float("nan")
    return 100 * np.count_nonzero((trust < SUSPICIOUS) & inside.values) / count
