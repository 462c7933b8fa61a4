"""Itoh's condition, Eq. (1) of the paper, and residues: where unwrapping has to fail."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.later import xr
from napari_phase4d.stack import in_memory, parts_over_time
from napari_phase4d.stacks import (
    AXES,
    check_rising,
    mask_on,
    unwrapped_stack,
    wavelengths_of,
    wrapped_stack,
)
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.unwrapping import (
    both_ends,
    checked_boundaries,
    frames_among,
    loop_sums,
    views_by_light,
)
from napari_phase4d.words import check_type, checked_call

__all__ = ["itoh_margin", "larger_step", "order_shares", "residues"]

TURN = 2 * np.pi


def itoh_margin(
    phase: xr.DataArray,
    where: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.Dataset:
    """Return how near each step comes to the largest that can be unwrapped, |step| / pi.

    Eq. (1) of the paper asks for |dv| |d psi / dv| <= pi along time or angle; the same holds along
    y and x. A dimension in which few steps exceed 1 is one along which to unwrap.

    Parameters
    ----------
    phase : xarray.DataArray
        Unwrapped phase in radians (true, or as good as it is known), dims among time, angle, y, x.
    where : xarray.DataArray of bool, optional
        Pixels that count for ``share_beyond``, such as those of the object; default all.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Returns
    -------
    xarray.Dataset
        For each dimension of length 2 or more a map like ``phase``, named ``along_time`` and so
        on: the larger of the steps to the two neighbours, as a share of pi. Its
        ``attrs["share_beyond"]`` is the share of steps beyond pi (of those with both ends in
        ``where``). Maps of phase on disk are computed where they are looked at.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from napari_phase4d.analysis import itoh_margin
    >>> ramp = xr.DataArray(np.array([[0.0, 1.0, 5.0]]), dims=("y", "x"))
    >>> itoh_margin(ramp)["along_x"].attrs["share_beyond"]
    0.5
    """
    phase = checked(phase)
    if where is not None:
        missing = [axis for axis in AXES if axis not in phase.dims]
        where = everywhere_on(where, phase).isel(dict.fromkeys(missing, 0)).transpose(*phase.dims)
    inside = where
    maps = {}
    task = Task(progress, cancelled)
    watch = Watch(phase.ndim, "measuring the steps", task)
    for axis, dim in enumerate(phase.dims):
        watch.step()
        if phase.sizes[dim] < 2:
            continue
        if dim == "angle" and (groups := same_wavelength(phase)):
            maps["along_angle"] = margin_of_each(phase, where, groups, watch)
            continue
        margin = phase.copy(data=larger_steps(phase, axis))
        margin.attrs = {
            "units": "pi rad",
            "share_beyond": share(*steps_beyond(phase, inside, axis, watch)),
        }
        maps[f"along_{dim}"] = margin
    return xr.Dataset(maps)


def same_wavelength(phase: xr.DataArray) -> list[list[int]]:
    """Return the views of each wavelength, empty if all have one: others make no step."""
    return [list(views) for views in views_by_light(wavelengths_of(phase))]


def margin_of_each(
    phase: xr.DataArray, where: xr.DataArray | None, groups: list[list[int]], watch: Watch
) -> xr.DataArray:
    """Return the margin along the angle between views of one wavelength, 0 where there are none.

    Views of different wavelengths have different phase, which is no step of the object.
    """
    margin = phase.copy(data=np.zeros(phase.shape, dtype=np.float32))
    beyond = count = 0
    for views in groups:
        if len(views) < 2:
            continue
        part = phase.isel(angle=views)
        inside = None if where is None else where.isel(angle=views)
        axis = part.dims.index("angle")
        margin[{"angle": views}] = np.asarray(larger_steps(part, axis))
        found = steps_beyond(part, inside, axis, watch)
        beyond, count = beyond + found[0], count + found[1]
    margin.attrs = {"units": "pi rad", "share_beyond": share(beyond, count)}
    return margin


def larger_steps(phase: xr.DataArray, axis: int) -> Any:
    """Return `larger_step` of a stack; of phase on disk it is computed where it is looked at."""
    if phase.chunks is None:
        return larger_step(phase.values, axis)
    import dask.array as da  # which takes a tenth of a second

    return da.map_overlap(larger_step, phase.data, axis=axis, depth={axis: 1}, boundary="none")


def checked(phase: xr.DataArray) -> xr.DataArray:
    """Return unwrapped phase, which may lack any axis, or say what is wrong with it."""
    check_type("the phase", phase, xr.DataArray, "give its axes names")
    missing = [axis for axis in ("y", "x") if axis not in phase.dims]
    stack = unwrapped_stack(phase.expand_dims(missing), "the phase")
    check_rising(stack, "the phase")
    return stack.isel(dict.fromkeys(missing, 0))


def steps_along(values: NDArray[np.floating], axis: int) -> NDArray[np.floating]:
    """Return the size of all steps along an axis as a share of pi."""
    steps: NDArray[np.floating] = np.abs(np.diff(values, axis=axis)) / np.float32(np.pi)
    return steps


def larger_step(values: NDArray[np.floating], axis: int) -> NDArray[np.floating]:
    """Return the larger of the steps to both neighbours along an axis, as a share of pi."""
    steps = steps_along(values, axis)
    before = np.pad(steps, [(int(i == axis), 0) for i in range(values.ndim)])
    after = np.pad(steps, [(0, int(i == axis)) for i in range(values.ndim)])
    larger: NDArray[np.floating] = np.maximum(before, after)
    return larger


def steps_beyond(
    phase: xr.DataArray, inside: xr.DataArray | None, axis: int, watch: Watch
) -> tuple[int, int]:
    """Return how many steps along an axis are beyond pi, and how many are known inside."""
    beyond, count = 0, 0
    for part, values in parts_over_time(phase, more=int(axis == 0)):
        watch.check()
        steps = steps_along(values, axis)
        counted = np.isfinite(steps)
        if inside is not None:
            counted &= both_ends(np.asarray(inside.data[part]), axis)
        beyond += int(np.count_nonzero(steps[counted] > 1))
        count += int(np.count_nonzero(counted))
    return beyond, count


def share(some: int, count: int) -> float:
    """Return what share of a count some are, 0 of none."""
    return some / count if count else 0.0


@checked_call
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
        Unwrapped phase in radians, dims among (time, angle, y, x).
    boundary : tuple of int, optional
        The optically thin frame (time, angle).
    where : xarray.DataArray of bool, optional
        Pixels that count; default all.

    Returns
    -------
    dict
        Method id "temporal-angular" and "angular-temporal" to a share from 0 to 1.
    """
    phase = checked(phase)
    missing = [axis for axis in AXES if axis not in phase.dims]
    stack = in_memory(phase.expand_dims(missing).transpose(*AXES)).values
    known = np.isfinite(stack)
    if where is not None:
        where = everywhere_on(where, phase)
        known &= where.data
    t, a = checked_boundaries(boundary, stack.shape)[0]

    def broken(axis: int, part: tuple[slice, slice]) -> NDArray[np.bool_]:
        """Return for each step of a part of the frames whether it is too large."""
        steps = np.abs(np.diff(stack[part], axis=axis)) > np.pi
        return steps[both_ends(known[part], axis)]

    groups = same_wavelength(phase)
    if groups:  # each by itself, as it is unwrapped
        found = [
            order_shares(
                phase.isel(angle=views).drop_vars("wavelength"),
                frames_among([(t, a)], views, phase["angle"].values)[0],
                None if where is None else where.isel(angle=views),
            )
            for views in groups
        ]
        weights = [len(views) for views in groups]
        return {
            way: float(np.average([own[way] for own in found], weights=weights))
            for way in found[0]
        }

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


def everywhere_on(where: xr.DataArray, phase: xr.DataArray) -> xr.DataArray:
    """Return the pixels that count with all four axes, each as long as that of the phase."""
    shape = [phase.sizes.get(axis, 1) for axis in AXES]
    return xr.DataArray(np.broadcast_to(mask_on(where, phase, "where"), shape), dims=AXES)


def residues(wrapped: xr.DataArray | ArrayLike) -> xr.DataArray:
    """Return the residues of every frame: where the wrapped steps round four pixels don't cancel.

    Parameters
    ----------
    wrapped : DataArray or array_like
        Wrapped phase in radians, dims among (time, angle, y, x).

    Returns
    -------
    xarray.DataArray
        int8: +1, -1 or 0, with one row and one column less than ``wrapped``; 0 round pixels that
        are not known.

    Raises
    ------
    TypeError, ValueError
        If it is surely no wrapped phase.

    Examples
    --------
    Phase that turns once round a point can't be unwrapped without a cut:

    >>> import numpy as np
    >>> import xarray as xr
    >>> from napari_phase4d.analysis import residues
    >>> y, x = np.mgrid[-1.5:2, -1.5:2]
    >>> found = residues(xr.DataArray(np.arctan2(y, x), dims=("y", "x")))
    >>> int(abs(found).sum())
    1
    """
    stack = in_memory(wrapped_stack(wrapped, "the wrapped phase"))
    values = stack.transpose(..., "y", "x").values.astype(np.float64)

    def turns(axis: int) -> np.ndarray:
        return np.nan_to_num(np.round(np.diff(values, axis=axis) / TURN))

    known = np.isfinite(values)
    loop = loop_sums(turns(-2), turns(-1)) * both_ends(both_ends(known, -2), -1)
    found = stack.transpose(..., "y", "x").isel(y=slice(None, -1), x=slice(None, -1))
    signs = found.copy(data=-loop.astype(np.int8)).transpose(*stack.dims)
    signs.attrs = {}  # a count, and no phase any more
    return signs
