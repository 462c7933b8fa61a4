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
        Phase in radians on the same grid.
    """
    difference = unwrapped.values.astype(np.float64) - truth.values
    return float(np.mean(difference**2))


def wrong_cycle_map(unwrapped: xr.DataArray, truth: xr.DataArray) -> xr.DataArray:
    """Mark the pixels that are off by at least one turn."""
    turns = np.round((unwrapped.values - truth.values) / TURN)
    return unwrapped.copy(data=turns != 0)


def wrong_cycle_share(
    unwrapped: xr.DataArray, truth: xr.DataArray, where: xr.DataArray | None = None
) -> float:
    """Return the share of pixels that are off by at least one turn.

    Parameters
    ----------
    unwrapped, truth : xarray.DataArray
        Phase in radians on the same grid.
    where : xarray.DataArray of bool, optional
        Pixels to count; default all.
    """
    wrong = wrong_cycle_map(unwrapped, truth).values
    return float(wrong.mean() if where is None else wrong[where.values].mean())
