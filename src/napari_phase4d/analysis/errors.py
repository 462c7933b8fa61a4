"""Errors of unwrapped phase against exact truth, and the table of a comparison that lists them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.analysis.loading import parts_over_time
from napari_phase4d.axes import AXES
from napari_phase4d.stacks import KIND, UNWRAPPED, mask_on, on_grid_of, unwrapped_stack

__all__ = [
    "DOUBTFUL",
    "OF_TRUTH",
    "as_truth",
    "errors",
    "in_order",
    "mean_squared_error",
    "table_of",
    "wrong_cycle_map",
    "wrong_cycle_share",
]

TURN = 2 * np.pi


def mean_squared_error(unwrapped: xr.DataArray, truth: xr.DataArray) -> float:
    """Return the mean squared error in rad^2 over all angles, times and pixels (section 3).

    Parameters
    ----------
    unwrapped, truth : xarray.DataArray
        Phase in radians on the same grid. Pixels where the truth is NaN don't count.

    Examples
    --------
    >>> exact = xr.DataArray(np.zeros((1, 1, 2, 2)), dims=("time", "angle", "y", "x"))
    >>> mean_squared_error(exact + 0.5, exact)
    0.25
    """
    unwrapped, truth = both(unwrapped, truth)
    total, count = 0.0, 0
    for part, values in parts_over_time(unwrapped):
        squares = (values.astype(np.float64) - truth.values[part]) ** 2
        total += float(np.nansum(squares))
        count += int(np.count_nonzero(np.isfinite(squares)))
    return total / count if count else float("nan")


def wrong_cycle_map(unwrapped: xr.DataArray, truth: xr.DataArray) -> xr.DataArray:
    """Mark the pixels that are off by at least one turn; none where the truth is NaN."""
    unwrapped, truth = both(unwrapped, truth)
    return unwrapped.copy(data=off_by_turns(unwrapped.values, truth.values))


def both(unwrapped: xr.DataArray, truth: xr.DataArray) -> tuple[xr.DataArray, xr.DataArray]:
    """Return unwrapped phase and exact phase of the same frames, or say what is wrong."""
    stack = unwrapped_stack(unwrapped, "the unwrapped phase")
    return stack, unwrapped_stack(on_grid_of(truth, stack, "truth"), "truth")


def off_by_turns(unwrapped: NDArray[Any], truth: NDArray[Any]) -> NDArray[np.bool_]:
    """Mark the numbers that are off by at least one turn."""
    off: NDArray[np.bool_] = np.nan_to_num(np.round((unwrapped - truth) / TURN)) != 0
    return off


def wrong_cycle_share(
    unwrapped: xr.DataArray, truth: xr.DataArray, where: xr.DataArray | None = None
) -> float:
    """Return the share of pixels, of those whose truth is known, off by at least one turn.

    Parameters
    ----------
    unwrapped, truth : xarray.DataArray
        Phase in radians on the same grid.
    where : xarray.DataArray of bool, optional
        Pixels to count; default all.

    Examples
    --------
    >>> exact = xr.DataArray(np.zeros((1, 1, 2, 2)), dims=("time", "angle", "y", "x"))
    >>> one_off = exact.copy()
    >>> one_off[0, 0, 0, 0] = 2 * np.pi
    >>> wrong_cycle_share(one_off, exact)
    0.25
    """
    unwrapped, truth = both(unwrapped, truth)
    inside = None if where is None else mask_like(unwrapped, where)
    wrong = count = 0
    for part, values in parts_over_time(unwrapped):
        exact = truth.values[part]
        counted = np.isfinite(exact)
        if inside is not None:
            counted &= inside[part]
        wrong += int(np.count_nonzero(off_by_turns(values, exact)[counted]))
        count += int(np.count_nonzero(counted))
    return wrong / count if count else float("nan")


def mask_like(stack: xr.DataArray, where: xr.DataArray) -> NDArray[np.bool_]:
    """Return a mask in the form of a stack."""
    full = xr.DataArray(mask_on(where, stack, "where"), dims=AXES)
    missing = [axis for axis in AXES if axis not in stack.dims]
    squeezed = full.isel(dict.fromkeys(missing, 0)).transpose(*stack.dims)
    return np.broadcast_to(squeezed.values, stack.shape)


#: Columns of the table that need truth.
OF_TRUTH = ("mse_rad2", "wrong_cycles_percent")
#: Columns of the table, in the order in which they are shown.
COLUMNS = ("method", "seconds", "peak_mb", "doubtful_percent", *OF_TRUTH)
#: A pixel is doubtful if it is trusted less than this.
DOUBTFUL = 0.5


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
    fitting = on_grid_of(truth, phase, "truth")
    if fitting.dtype.kind == "b":
        msg = "truth is bool, as masks are; give exact phase, or the mask as mask=..."
        raise TypeError(msg)
    exact = phase.copy(data=unwrapped_stack(fitting, "truth").values)
    exact.attrs = {**phase.attrs, KIND: UNWRAPPED}
    return exact


def errors(result: xr.DataArray, truth: xr.DataArray | None) -> dict[str, float]:
    """Return the columns that need truth."""
    if truth is None:
        return {}
    return {
        "mse_rad2": mean_squared_error(result, truth),
        "wrong_cycles_percent": 100 * wrong_cycle_share(result, truth),
    }
