"""Errors of unwrapped phase against exact truth."""

from __future__ import annotations

import numpy as np
import xarray as xr

__all__ = ["mean_squared_error", "wrong_cycle_map", "wrong_cycle_share"]

TURN = 2 * np.pi


def mean_squared_error(unwrapped: xr.DataArray, truth: xr.DataArray) -> float:
    """Return the mean squared error in rad^2 over all angles, times and pixels (section 3).

    Parameters
    ----------
    unwrapped, truth : xarray.DataArray
        Phase in radians on the same grid. Pixels where the truth is NaN don't count.
    """
    difference = unwrapped.values.astype(np.float64) - truth.values
    return float(np.nanmean(difference**2)) if np.isfinite(difference).any() else float("nan")


def wrong_cycle_map(unwrapped: xr.DataArray, truth: xr.DataArray) -> xr.DataArray:
    """Mark the pixels that are off by at least one turn; none where the truth is NaN."""
    turns = np.round((unwrapped.values - truth.values) / TURN)
    return unwrapped.copy(data=np.nan_to_num(turns) != 0)


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
    """
    wrong = wrong_cycle_map(unwrapped, truth).values
    counted = np.isfinite(truth.values)
    if where is not None:
        counted = counted & where.values
    return float(wrong[counted].mean()) if counted.any() else float("nan")
