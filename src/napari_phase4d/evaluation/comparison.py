"""Results of several methods on one problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import pandas as pd
import xarray as xr

from napari_phase4d.evaluation.confidence import (
    REFERENCE,
    chance_of_right,
    reference_of,
    slip_warning,
)
from napari_phase4d.evaluation.table import (
    OF_TRUTH,
    as_truth,
    doubtful_percent,
    errors,
    in_order,
)
from napari_phase4d.evaluation.verdict import Verdict, verdict_on
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping import Problem

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
            return reference_of(problem, progress, cancelled)
        finally:
            problem.forget_field()

    def confidence(
        self,
        method: str,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> xr.DataArray:
        """Return the chance, from 0 to 1, that each pixel of a method's result is right.

        See `napari_phase4d.confidence`. The first call may unwrap by directional L1, which the
        others are held against.
        """
        return self.confidences([method], progress, cancelled)[method]

    def confidences(
        self,
        methods: Sequence[str] | None = None,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> dict[str, xr.DataArray]:
        """Return `confidence` of several methods, by default all; each is computed once."""
        problem = self.needed_problem()
        reference = self.reference(progress, cancelled)
        found = {}
        try:
            for method in self.results if methods is None else methods:
                found[method] = problem.once(
                    f"confidence of {method}",
                    partial(
                        chance_of_right,
                        problem,
                        self.results[method],
                        reference,
                        progress,
                        cancelled,
                    ),
                )
        finally:
            problem.forget_field()
        return found

    def warnings(self) -> dict[str, str]:
        """Say of which methods whole objects may be a cycle off, and in how many frames.

        Nothing is said of results of a recording larger than memory.
        """
        if self.problem is None:
            return {}
        said = {m: slip_warning(self.problem, trust) for m, trust in self.confidences().items()}
        return {method: sentence for method, sentence in said.items() if sentence}

    @property
    def verdict(self) -> Verdict:
        """One sentence: which result to use, how much is in doubt, where methods disagree most.

        It also holds what it says as numbers, see `Verdict`. When first asked for, `confidences`
        are computed.

        Raises
        ------
        ValueError
            If there is no result, or the phase was not held in memory.
        """
        if not self.results:
            msg = "there is no result yet to give a verdict on; run at least one method"
            raise ValueError(msg)
        labels = {str(m): str(self.table["method"][m]) for m in self.results}
        trust, problem = self.confidences(), self.needed_problem()
        if REFERENCE not in trust:
            reference = self.reference()
            trust[REFERENCE] = problem.once(
                f"confidence of {REFERENCE}",
                lambda: chance_of_right(problem, reference, reference),
            )
            problem.forget_field()
        return verdict_on(problem, self.results, trust, self.object_mask(), labels)

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
        """Return what of the usable field is not empty, in the form of the phase.

        Frames that say nothing hold no object.
        """
        problem = self.needed_problem()
        usable = problem.usable & ~problem.lost()[..., None, None]
        inside = usable & ~problem.background().mask
        return problem.result(inside if inside.any() else usable, "object", {"units": "1"})
