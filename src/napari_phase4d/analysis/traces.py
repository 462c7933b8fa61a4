"""Where methods differ: maps of the difference, and the phase at one place over time and angle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.axes import AXES, in_full
from napari_phase4d.stacks import KIND, UNWRAPPED, check_rising, on_grid_of, unwrapped_stack
from napari_phase4d.task import CancelledCall, Task, Watch
from napari_phase4d.unwrapping import METHODS, label_of
from napari_phase4d.words import check_type, shown

__all__ = ["Traces", "difference", "traces", "traces_of"]

#: Blocks of a stack on disk that are read at a time.
BLOCKS_AT_ONCE = 8
#: Part of a frame, and which of its pixels count.
Place = tuple[slice, slice, NDArray[np.bool_]]


@dataclass(frozen=True)
class Traces:
    """Mean phase at one place.

    Parameters
    ----------
    times_s : ndarray of shape (time,)
        Seconds.
    angles_deg : ndarray of shape (angle,)
        Degrees.
    over_time : mapping of str to ndarray of shape (time,)
        Radians at all times from one angle, for each method.
    over_angle : mapping of str to ndarray of shape (angle,)
        Radians from all angles at one time, for each method.
    frame : tuple of int
        (time, angle) numbers of that time and that angle.
    """

    times_s: NDArray[np.float64]
    angles_deg: NDArray[np.float64]
    over_time: Mapping[str, NDArray[np.float64]]
    over_angle: Mapping[str, NDArray[np.float64]]
    frame: tuple[int, int]


def traces(results: Mapping[str, xr.DataArray], frame: tuple[int, int], where: Any) -> Traces:
    """Return the phase at one place over time and over the angle.

    Of results on disk, only the blocks that hold the place are read, some frames at a time.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase in radians of some methods, on one grid; dims among (time, angle, y, x).
    frame : tuple of int
        (time, angle) numbers, from 0: the angle is that of the trace over time, the time that of
        the trace over the angle.
    where : tuple of int or ndarray of bool, shape (y, x)
        A pixel (y, x), from 0, or a mask, over which phase is averaged. NaN pixels don't count.

    Returns
    -------
    Traces
        Where no pixel counts, its phase is NaN. Without coordinates, times and angles are
        numbers of frames.

    Raises
    ------
    ValueError
        If there are no results, if they are no unwrapped phase or differ in shape, or if the
        frame or the place lies outside of them.

    Examples
    --------
    >>> phase = xr.DataArray(np.arange(24.0).reshape(3, 2, 2, 2), dims=("time", "angle", "y", "x"))
    >>> found = traces({"exact": phase}, frame=(0, 1), where=(1, 1))
    >>> found.over_time["exact"].tolist()
    [7.0, 15.0, 23.0]
    """
    check_type("results", results, Mapping, "give {method: stack}, as Comparison.results is")
    known = {}
    for method, given in results.items():
        known[method] = unwrapped_stack(given, f"the result {method}")
        check_rising(known[method], f"the result {method}")
    return traces_of(known, frame, where)


def traces_of(
    results: Mapping[str, xr.DataArray],
    frame: tuple[int, int],
    where: Any,
    *,
    known: Traces | None = None,
    cancelled: CancelledCall | None = None,
) -> Traces:
    """Return `traces` of results that are known to be sound: fast enough to follow the mouse.

    Parameters
    ----------
    results, frame, where
        See `traces`.
    known : Traces, optional
        Of the same results, place and angle: the traces over time are taken from there.
    cancelled : callable, optional
        ``cancelled()`` stops the work, between parts that are read from disk.
    """
    if np.shape(frame) != (2,) or np.asarray(frame).dtype.kind not in "iu":
        msg = f"the frame must be two whole numbers (time, angle), but is {shown(frame)}"
        raise ValueError(msg)
    if not results:
        msg = "there are no results yet; run a method first"
        raise ValueError(msg)
    shapes = {tuple(r.sizes.get(axis, 1) for axis in AXES) for r in results.values()}
    if len(shapes) > 1:
        each = [str(tuple(r.sizes.get(axis, 1) for axis in AXES)) for r in results.values()]
        msg = f"the results differ in shape: {', '.join(each)}"
        raise ValueError(msg)
    (shape,) = shapes
    if any(not 0 <= i < n for i, n in zip(frame, shape[:2], strict=True)):
        msg = f"the frame {frame} does not exist; there are {shape[:2]} times and angles"
        raise ValueError(msg)
    time, angle = frame
    place = checked_place(where, shape[2:])
    watch = Watch(1, "reading curves", Task(None, cancelled))
    over_time, every = {} if known is None else known.over_time, slice(None)
    over_angle = {m: mean_over(r, time, every, place, watch) for m, r in results.items()}
    if known is None:
        over_time = {m: mean_over(r, every, angle, place, watch) for m, r in results.items()}
    any_result = next(iter(results.values()))
    return Traces(
        places_along(any_result, "time", shape[0]),
        places_along(any_result, "angle", shape[1]),
        over_time,
        over_angle,
        (time, angle),
    )


def mean_over(
    stack: xr.DataArray, time: int | slice, angle: int | slice, place: Place, watch: Watch
) -> NDArray[np.float64]:
    """Return the mean phase at a place, over all times of an angle, or all angles of a time."""
    rows, columns, mask = place
    wanted = {"time": time, "angle": angle, "y": rows, "x": columns}
    wanted = {d: slice(w, w + 1) if isinstance(w, int) else w for d, w in wanted.items()}
    part = stack.isel({dim: one for dim, one in wanted.items() if dim in stack.dims})
    whole = slice(None), slice(None), mask
    if part.chunks is None:
        return mean_at(in_full(part).reshape(-1, *mask.shape), whole)
    n_times = part.sizes.get("time", 1)
    at_once = BLOCKS_AT_ONCE * max(part.chunksizes.get("time", (1,)))
    means = []
    for start in range(0, n_times, at_once):
        watch.check()
        some = part.isel(time=slice(start, start + at_once)) if "time" in part.dims else part
        means.append(mean_at(in_full(some).reshape(-1, *mask.shape), whole))
    return np.concatenate(means)


def places_along(stack: xr.DataArray, dim: str, count: int) -> NDArray[np.float64]:
    """Return the coordinates along time or angle."""
    if dim not in stack.coords:
        return np.arange(count, dtype=np.float64)
    return np.atleast_1d(stack.coords[dim].values).astype(np.float64)


def checked_place(where: Any, shape: tuple[int, ...]) -> Place:
    """Return the smallest part of a frame that holds a place, or say what is wrong with it."""
    place = np.asarray(where)
    if place.dtype == np.bool_ and place.shape == shape and place.any():
        rows, columns = (np.flatnonzero(place.any(axis=axis)) for axis in (1, 0))
        part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        return (*part, place[part])
    if place.dtype == np.bool_:
        msg = f"the mask is {place.shape} with {place.sum()} pixels; it must mark some of {shape}"
        raise ValueError(msg)
    if place.shape != (2,) or place.dtype.kind not in "iu":
        msg = f"the place must be a pixel (y, x) or a mask, not {shown(where)}"
        raise ValueError(msg)
    y, x = place.tolist()
    if not (0 <= y < shape[0] and 0 <= x < shape[1]):
        msg = f"the pixel (y {y}, x {x}) lies outside of the frame of {shape[0]} x {shape[1]}"
        raise ValueError(msg)
    return slice(y, y + 1), slice(x, x + 1), np.ones((1, 1), dtype=bool)


def mean_at(frames: NDArray[Any], place: Place) -> NDArray[np.float64]:
    """Return the mean of the finite pixels at a place in every frame of (n, y, x)."""
    rows, columns, mask = place
    values = frames[:, rows, columns][:, mask].astype(np.float64)
    known = np.isfinite(values)
    counts = known.sum(axis=1)
    mean = np.full(len(frames), np.nan)
    np.divide(np.where(known, values, 0).sum(axis=1), counts, out=mean, where=counts > 0)
    return mean


def difference(result: xr.DataArray, reference: xr.DataArray) -> xr.DataArray:
    """Return a result minus another one.

    Parameters
    ----------
    result, reference : xarray.DataArray
        Unwrapped phase in radians of the same frames, which are found by their coordinates;
        the reference may be exact phase as well.

    Returns
    -------
    xarray.DataArray
        float32 on the grid of the result, radians; 0 where a mask left out one of the two. Of
        results on disk it is computed where it is looked at. ``attrs`` name the method of the
        result and the label of the reference.

    Raises
    ------
    ValueError
        If the two have not the same dims, shape and coordinates, or one is wrapped.

    Examples
    --------
    >>> one = xr.DataArray(np.ones((2, 2), np.float32), dims=("y", "x"))
    >>> float(difference(one + 3, one).max())
    3.0
    """
    result = unwrapped_stack(result, "the result")
    reference = unwrapped_stack(on_grid_of(reference, result, "the reference"), "the reference")
    masked = tuple(stack.attrs.get("mask", "none") != "none" for stack in (result, reference))
    if result.chunks is None and reference.chunks is None:
        values = less(result.values, reference.values, masked)
    else:  # on disk: computed for the frames that are looked at
        on_disk = result if result.chunks is not None else reference
        both = [stack.chunk(dict(on_disk.chunksizes)).data for stack in (result, reference)]
        import dask.array as da  # which takes a tenth of a second

        values = da.map_blocks(less, *both, masked, dtype=np.float32)
    found = result.copy(data=values)
    found.attrs = {
        KIND: UNWRAPPED,
        "units": "rad",
        "method": result.attrs.get("method", ""),
        "less": name_of(reference),
    }
    return found.rename("difference")


def less(
    values: NDArray[Any], others: NDArray[Any], masked: tuple[bool, bool]
) -> NDArray[np.float32]:
    """Return values minus others; 0 where one of the two is masked, and so is 0."""
    found: NDArray[np.float32] = (values - others).astype(np.float32, copy=False)
    for numbers, zero_is_masked in zip((values, others), masked, strict=True):
        if zero_is_masked:
            found[numbers == 0] = 0
    return found


def name_of(stack: xr.DataArray) -> str:
    """Return what to call a stack on screen: the label of its method, where it has one."""
    method = stack.attrs.get("method")
    if method in METHODS:
        return label_of(str(method), stack.attrs.get("options", {}))
    if stack.attrs.get("exact"):
        return "exact phase"
    return "reference" if stack.name is None else str(stack.name)
