"""Results of several methods on one problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from napari_phase4d.evaluation.confidence import REFERENCE, confidence_of, slip_warning
from napari_phase4d.evaluation.table import (
    OF_TRUTH,
    as_truth,
    doubtful_percent,
    errors,
    in_order,
)
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping import Problem, border_medians, run_method

__all__ = ["Comparison"]


@dataclass(frozen=True)
class Comparison:
    """Results of several methods on one problem.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase of each method.
    table : pandas.DataFrame
        One row a method: its label, seconds, peak memory in MB; the share of the object's pixels
        that are doubtful in percent, where asked for with `with_doubt`; and against truth,
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
            problem.forget_field()
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

    def with_doubt(self, maps: Mapping[str, xr.DataArray]) -> Comparison:
        """Return the same results, with the share of doubtful pixels in the table.

        The column ``doubtful_percent`` is the share in percent of the object's pixels whose
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
        table = self.table.drop(columns="doubtful_percent", errors="ignore")
        if maps:
            inside = self.object_mask()
            shares = {method: doubtful_percent(trust, inside) for method, trust in maps.items()}
            column = [shares.get(str(method), float("nan")) for method in table.index]
            table = table.assign(doubtful_percent=column)
        return replace(self, table=in_order(table))

    def object_mask(self) -> xr.DataArray:
        """Return what of the usable field is not empty, in the form of the phase."""
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
