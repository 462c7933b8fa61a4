"""Methods side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from napari_phase4d.evaluation.confidence import REFERENCE, confidence_of, slip_warning
from napari_phase4d.evaluation.errors import mean_squared_error, wrong_cycle_share
from napari_phase4d.evaluation.resources import measured
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping import (
    METHODS,
    Problem,
    border_medians,
    check_method,
    label_of,
    run_method,
)

__all__ = ["Comparison", "compare"]


@dataclass(frozen=True)
class Comparison:
    """Results of several methods on one problem.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase of each method.
    table : pandas.DataFrame
        One row a method: its label, seconds, peak memory in MB, and against truth, where given,
        the mean squared error in rad^2 and the share of pixels wrong by a turn in percent.
    problem : Problem
        What was unwrapped.
    """

    results: Mapping[str, xr.DataArray]
    table: pd.DataFrame
    problem: Problem = field(repr=False)

    def reference(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> xr.DataArray:
        """Return the result of directional L1, computed now if it was not among the methods."""
        if REFERENCE in self.results:
            return self.results[REFERENCE]
        found: xr.DataArray = self.problem.once(
            REFERENCE, lambda: run_method(self.problem, REFERENCE, progress, cancelled, {})
        )
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
        amplitude = self.problem.relative_amplitude
        return confidence_of(self.results[method], reference, amplitude, self._level())

    def warnings(self) -> dict[str, str]:
        """Say of which methods whole objects may be a turn off, and in how many frames."""
        background = self.problem.background()
        empty = self.problem.result(background.mask, "empty", {"units": "1"})
        said = {
            method: slip_warning(result, self.reference(), empty, self._level())
            for method, result in self.results.items()
        }
        return {method: sentence for method, sentence in said.items() if sentence}

    def _level(self) -> xr.DataArray:
        """Return the phase of the empty field of every frame, in the form of the phase."""
        level = border_medians(self.problem.background().level, self.problem.first)
        full = np.broadcast_to(level[..., None, None], self.problem.wrapped.shape)
        return self.problem.result(full, "level", {"units": "rad"})


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
) -> Comparison:
    """Unwrap with several methods and put the figures next to each other.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians, see `unwrap`.
    methods : sequence of str, optional
        Ids among `METHODS`. Default: all.
    boundary, mask, amplitude, progress, cancelled
        See `unwrap`.
    truth : DataArray or array_like, optional
        Exact phase of the same shape.
    options : mapping, optional
        Method id to the options of that method.

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
    exact = as_truth(truth, problem)
    results: dict[str, xr.DataArray] = {}
    rows = []
    for method in chosen:
        chosen_options = options.get(method, {})
        shared = dict(problem.seconds)
        problem.used.clear()
        run = partial(run_method, problem, method, progress, cancelled, chosen_options)
        cost = measured(run)
        shared_seconds = sum(shared.get(step, 0.0) for step in problem.used)
        results[method] = cost.result
        rows.append(
            {
                "method": label_of(method, chosen_options),
                "seconds": cost.seconds + shared_seconds,
                "peak_mb": cost.peak_mb,
                **errors(cost.result, exact),
            }
        )
    problem.forget("field")  # as large as many results, and of no more use
    table = pd.DataFrame(rows, index=pd.Index(chosen, name="id"))
    return Comparison(results, table, problem)


def as_truth(truth: xr.DataArray | Any, problem: Problem) -> xr.DataArray | None:
    """Return truth in the form of the phase, or None."""
    if truth is None:
        return None
    values = (
        truth.transpose(*problem.template.dims).values
        if isinstance(truth, xr.DataArray)
        else np.asarray(truth)
    )
    if values.shape != problem.template.shape:
        msg = f"truth is {values.shape}, but the phase is {problem.template.shape}"
        raise ValueError(msg)
    return problem.template.copy(data=values)


def errors(result: xr.DataArray, truth: xr.DataArray | None) -> dict[str, float]:
    """Return the columns that need truth."""
    if truth is None:
        return {}
    return {
        "mse_rad2": mean_squared_error(result, truth),
        "wrong_cycles_percent": 100 * wrong_cycle_share(result, truth),
    }
