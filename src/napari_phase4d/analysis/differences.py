"""How far results lie from the truth and from each other: errors, maps, the phase at one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import pd, xr
from napari_phase4d.stack import parts_over_time
from napari_phase4d.stacks import (
    AXES,
    KIND,
    UNWRAPPED,
    check_rising,
    in_full,
    mask_on,
    on_grid_of,
    unwrapped_stack,
)
from napari_phase4d.task import CancelledCall, Task, Watch
from napari_phase4d.unwrapping import METHODS, label_of
from napari_phase4d.words import as_numbers, check_type, is_list, shown, wavelengths_of_views

__all__ = [
    "DOUBTFUL",
    "OF_TRUTH",
    "Traces",
    "as_truth",
    "difference",
    "errors",
    "in_order",
    "mean_squared_error",
    "table_of",
    "traces",
    "traces_of",
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

    Returns
    -------
    float
        In rad^2; NaN if no pixel counts.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from napari_phase4d.analysis import mean_squared_error
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
    """Mark the pixels that are off by at least one turn; none where the truth is NaN.

    Parameters
    ----------
    unwrapped, truth : xarray.DataArray
        Phase in radians on the same grid, dims among (time, angle, y, x).

    Returns
    -------
    xarray.DataArray of bool
        In the form of ``unwrapped``: True where the difference, rounded to whole turns, is not 0.
    """
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
    """Return the share of pixels, of those that are known in both, off by at least one turn.

    Parameters
    ----------
    unwrapped, truth : xarray.DataArray
        Phase in radians on the same grid.
    where : xarray.DataArray of bool, optional
        Pixels to count; default all.

    Returns
    -------
    float
        From 0 to 1; NaN if no pixel counts.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray as xr
    >>> from napari_phase4d.analysis import wrong_cycle_share
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
        counted = np.isfinite(exact) & np.isfinite(values)
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


# ---- from each other ------------------------------------------------------------------------


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
    wavelengths_um : list of float or None
        Of each view in micrometres, where they have several.
    """

    times_s: NDArray[np.float64]
    angles_deg: NDArray[np.float64]
    over_time: Mapping[str, NDArray[np.float64]]
    over_angle: Mapping[str, NDArray[np.float64]]
    frame: tuple[int, int]
    wavelengths_um: list[float] | None = None


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
    >>> import numpy as np
    >>> import xarray as xr
    >>> from napari_phase4d.analysis import traces
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
    if not is_list(frame) or np.shape(frame) != (2,) or np.asarray(frame).dtype.kind not in "iu":
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
        wavelengths_of_views(any_result),
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
    place = as_numbers("where", where)
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
    >>> import numpy as np
    >>> import xarray as xr
    >>> from napari_phase4d.analysis import difference
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
