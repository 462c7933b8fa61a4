"""Itoh's condition, Eq. (1) of the paper, and residues: where unwrapping has to fail."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.analysis.loading import in_memory
from napari_phase4d.unwrapping import both_ends, loop_sums

__all__ = ["itoh_margin", "order_shares", "residues"]

TURN = 2 * np.pi


def itoh_margin(phase: xr.DataArray, where: xr.DataArray | None = None) -> xr.Dataset:
    """Return how near each step comes to the largest that can be unwrapped, |step| / pi.

    Eq. (1) of the paper asks for |dv| |d psi / dv| <= pi along time or angle; the same holds along
    y and x. A dimension in which few steps exceed 1 is one along which to unwrap.

    Parameters
    ----------
    phase : xarray.DataArray
        Unwrapped phase in radians (true, or as good as it is known), dims among time, angle, y, x.
    where : xarray.DataArray of bool, optional
        Pixels that count for ``share_beyond``, such as those of the object; default all.

    Returns
    -------
    xarray.Dataset
        For each dimension of length 2 or more a map like ``phase``, named ``along_time`` and so
        on: the larger of the steps to the two neighbours, as a share of pi. Its
        ``attrs["share_beyond"]`` is the share of steps beyond pi (of those with both ends in
        ``where``).

    Examples
    --------
    >>> ramp = xr.DataArray(np.array([[0.0, 1.0, 5.0]]), dims=("y", "x"))
    >>> itoh_margin(ramp)["along_x"].attrs["share_beyond"]
    0.5
    """
    phase = in_memory(phase)
    inside = np.ones(phase.shape, bool) if where is None else where.transpose(*phase.dims).values
    maps = {}
    for dim in phase.dims:
        if phase.sizes[dim] < 2:
            continue
        axis = phase.get_axis_num(dim)
        steps = np.abs(np.diff(phase.values, axis=axis)) / np.float32(np.pi)
        before = np.pad(steps, [(int(i == axis), 0) for i in range(phase.ndim)])
        after = np.pad(steps, [(0, int(i == axis)) for i in range(phase.ndim)])
        margin = phase.copy(data=np.maximum(before, after))
        counted = both_ends(inside, axis)
        beyond = float((steps > 1)[counted].mean()) if counted.any() else 0.0
        margin.attrs = {"units": "pi rad", "share_beyond": beyond}
        maps[f"along_{dim}"] = margin
    return xr.Dataset(maps)


def order_shares(
    phase: xr.DataArray, boundary: tuple[int, int] = (0, 0), where: xr.DataArray | None = None
) -> dict[str, float]:
    """Return how many of the steps that T/A and A/T go along break Itoh's condition.

    T/A reaches a frame along time at the boundary angle and then along the angle; A/T along the
    angle at the boundary time and then along time (the paper's Fig. 1). The order with the smaller
    share suits the object better.

    Parameters
    ----------
    phase : xarray.DataArray
        Unwrapped phase in radians, dims (time, angle, y, x).
    boundary : tuple of int, optional
        The optically thin frame (time, angle).
    where : xarray.DataArray of bool, optional
        Pixels that count; default all.

    Returns
    -------
    dict
        Method id "temporal-angular" and "angular-temporal" to a share from 0 to 1.
    """
    stack = in_memory(phase.transpose("time", "angle", "y", "x")).values
    inside = (
        np.ones(stack.shape, dtype=bool)
        if where is None
        else where.transpose("time", "angle", "y", "x").values
    )
    t, a = (index % n for index, n in zip(boundary, stack.shape[:2], strict=True))

    def broken(axis: int, part: tuple[slice, slice]) -> NDArray[np.bool_]:
        """Return for each step of a part of the frames whether it is too large."""
        steps = np.abs(np.diff(stack[part], axis=axis)) > np.pi
        return steps[both_ends(inside[part], axis)]

    everywhere = (slice(None), slice(None))
    ways = {
        "temporal-angular": (
            broken(0, (slice(None), slice(a, a + 1))),
            broken(1, everywhere),
        ),
        "angular-temporal": (
            broken(1, (slice(t, t + 1), slice(None))),
            broken(0, everywhere),
        ),
    }
    shares = {}
    for method, way in ways.items():
        steps = np.concatenate(way)
        shares[method] = float(steps.mean()) if steps.size else 0.0
    return shares


def residues(wrapped: xr.DataArray) -> xr.DataArray:
    """Return the residues of every frame: where the wrapped steps round four pixels don't cancel.

    Parameters
    ----------
    wrapped : xarray.DataArray
        Wrapped phase in radians, the last two dims y and x.

    Returns
    -------
    xarray.DataArray
        int8: +1, -1 or 0, with one row and one column less than ``wrapped``.

    Examples
    --------
    Phase that turns once round a point can't be unwrapped without a cut:

    >>> y, x = np.mgrid[-1.5:2, -1.5:2]
    >>> found = residues(xr.DataArray(np.arctan2(y, x), dims=("y", "x")))
    >>> int(abs(found).sum())
    1
    """
    values = in_memory(wrapped).values.astype(np.float64)

    def turns(axis: int) -> np.ndarray:
        return np.round(np.diff(values, axis=axis) / TURN)

    loop = loop_sums(turns(-2), turns(-1))
    found = wrapped.isel({wrapped.dims[-2]: slice(None, -1), wrapped.dims[-1]: slice(None, -1)})
    return found.copy(data=-loop.astype(np.int8))
