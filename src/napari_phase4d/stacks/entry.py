"""Phase as it comes in, and masks, labels, regions and further stacks brought onto its axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.stacks.coordinates import (
    AXES,
    PLAIN_AXES,
    check_rising,
    factor_to,
    on_the_clock_of,
    plain,
    same_places,
    some,
    with_coordinates,
)
from napari_phase4d.stacks.notes import (
    check_light,
    check_unwrapped,
    check_wrapped,
    refuse_counts,
    refuse_nothing,
    same_light,
    views_in_order,
    with_light,
)
from napari_phase4d.stacks.numbers import Doubt, countable, row_length, sample_of, what_is_wrong
from napari_phase4d.stacks.order import doubts_of_axes, doubts_of_order
from napari_phase4d.warned import warn
from napari_phase4d.words import shown

__all__ = [
    "as_stack",
    "beside",
    "checked_labels",
    "doubts_of",
    "in_all_axes",
    "mask_on",
    "on_grid_of",
    "unwrapped_stack",
    "without_masked",
    "wrapped_stack",
]

#: What phase is given in.
PHASE_UNITS = "rad"
#: What programs note of numbers without a unit, as those of an angle are. Amplitudes have "a.u."
#: or, as a share, "1".
NO_UNITS = ("dimensionless",)


def wrapped_stack(
    phase: xr.DataArray | Any, name: str = "phase", *, mask: Any = None
) -> xr.DataArray:
    """Return wrapped phase in radians, its times and angles rising, or say what is wrong with it.

    Parameters
    ----------
    phase : DataArray or array_like
        Dims among (time, angle, y, x); plain arrays are (y, x), (time, y, x) or
        (time, angle, y, x). Masked pixels become NaN.
    name : str, optional
        What to call it.
    mask : array_like of bool, "auto" or None, optional
        What is given for its mask; where an array is, no other pixels are looked at.

    Raises
    ------
    TypeError, ValueError
        If it is surely no such stack.

    Warns
    -----
    UserWarning
        If it is probably none: in other units, camera frames, unwrapped already, filtered, cut
        out, or its frames or axes in another order.
    """
    stack = as_stack(phase, name)
    check_rising(stack, name)
    refuse_counts(stack, name)
    given = mask is not None and not isinstance(mask, str)
    check_wrapped(stack, name, np.asarray(mask_on(mask, stack, "the mask")) if given else None)
    plain_axes = not isinstance(phase, xr.DataArray)
    for doubt in (*doubts_of_order(stack), *(doubts_of_axes(stack) if plain_axes else ())):
        warn(f"{name} {doubt.warning}")
    return stack


def doubts_of(wrapped: xr.DataArray, kept: NDArray[np.bool_] | None = None) -> list[Doubt]:
    """Return what is probably wrong with wrapped phase for which results can't be right.

    Parameters
    ----------
    wrapped : DataArray
        Wrapped phase in radians; of many frames, or large ones, some are looked at.
    kept : ndarray of bool, optional
        A mask with the axes (time, angle, y, x), each as long as the phase's or 1.
    """
    known = countable(sample_of(wrapped, kept))
    doubts = [*what_is_wrong(known, row_length(wrapped)), *doubts_of_order(wrapped)]
    return [doubt for doubt in doubts if doubt.verdict]


def unwrapped_stack(phase: xr.DataArray | Any, name: str = "phase") -> xr.DataArray:
    """Return unwrapped phase in radians, or say what is wrong with it.

    See `wrapped_stack`; its numbers may lie on disk.
    """
    stack = as_stack(phase, name)
    refuse_counts(stack, name)
    refuse_nothing(stack, name)
    check_unwrapped(stack, name)
    return stack


def as_stack(phase: xr.DataArray | Any, name: str = "phase") -> xr.DataArray:
    """Return a stack of radians with known dims and coordinates, or say what is wrong with it."""
    stack = phase if isinstance(phase, xr.DataArray) else with_names(phase, name)
    unknown = set(stack.dims) - set(AXES)
    if unknown or not {"y", "x"} <= set(stack.dims):
        found = tuple(stack.dims)
        msg = f"{name} has dims {found}; they must be among time, angle, y, x, with y and x"
        raise ValueError(msg)
    check_numbers(stack, name)
    if any(np.isnan(length) for length in stack.shape):
        msg = f"{name} is a dask array whose lengths are not known; call its compute_chunk_sizes()"
        raise ValueError(msg)
    if stack.size == 0:
        msg = f"{name} is empty: its shape is {stack.shape}"
        raise ValueError(msg)
    return with_coordinates(with_light(in_radians(stack, name), name), name)


def in_all_axes(phase: xr.DataArray, name: str = "phase") -> xr.DataArray:
    """Return what `as_stack` does with the dims (time, angle, y, x), some of them 1 long."""
    stack = as_stack(phase, name)
    return stack.expand_dims([d for d in AXES if d not in stack.dims]).transpose(*AXES)


def with_names(phase: Any, name: str) -> xr.DataArray:
    """Return a plain array with the names of its axes; what is masked becomes NaN."""
    if isinstance(phase, xr.Dataset):
        msg = f"{name} is a Dataset of {', '.join(map(str, phase)) or 'nothing'}; give one of them"
        raise TypeError(msg)
    if isinstance(phase, np.ma.MaskedArray) and phase.dtype.kind == "f":
        phase = phase.filled(np.nan)
    values = plain(phase, name)
    if values.ndim not in PLAIN_AXES:
        msg = (
            f"{name} has {values.ndim} dimensions {values.shape}; it must have two (y, x), "
            "three (time, y, x) or four (time, angle, y, x)"
        )
        raise ValueError(msg)
    return xr.DataArray(values, dims=PLAIN_AXES[values.ndim])


def check_numbers(stack: xr.DataArray, name: str) -> None:
    """Refuse numbers that are no phase, and say what they seem to be."""
    kind = stack.dtype.kind
    if kind in "fiu":
        return
    if kind == "c":
        msg = f"{name} is complex; give its angle, numpy.angle(field)"
    elif kind == "b":
        msg = f"{name} is bool, as masks are; it must be real numbers in radians"
    else:
        msg = f"{name} must be real numbers in radians, but is {stack.dtype}"
    raise TypeError(msg)


def in_radians(stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return phase in radians, by the units that it notes."""
    noted = stack.attrs.get("units")
    if noted is not None and not isinstance(noted, str):
        msg = f'attrs["units"] of {name} must be a word such as "rad", but is {shown(noted)}'
        raise TypeError(msg)
    units = noted or PHASE_UNITS
    if units in NO_UNITS:
        return stack
    factor = factor_to(units, PHASE_UNITS)
    if factor is None:
        length = factor_to(units, "um") is not None
        advice = "2 * numpy.pi / wavelength times an optical path" if length else "give radians"
        msg = (
            f"{name} is in {units!r}, which is no phase; {advice}"
            f'{" is phase in radians" if length else ""}, with attrs["units"] = "rad"'
        )
        raise ValueError(msg)
    if factor == 1:
        return stack
    turned = stack.copy(data=stack.data * np.result_type(stack.dtype, np.float32).type(factor))
    turned.attrs = {**stack.attrs, "units": PHASE_UNITS}
    return turned


def on_grid_of(other: xr.DataArray | Any, stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return a further stack with the dims, order and coordinates of a stack, or refuse it.

    Frames are brought into the order of the stack's times and angles by their coordinates, where
    both have them. Plain arrays of the stack's shape have its dims.
    """
    given = other if isinstance(other, xr.DataArray) else beside(other, stack, name)
    if set(given.dims) != set(stack.dims) or dict(given.sizes) != dict(stack.sizes):
        msg = (
            f"{name} is {in_words(given)}, but the phase is {in_words(stack)}; they must be of "
            "the same frames"
        )
        raise ValueError(msg)
    given = in_order_of(with_coordinates(with_light(given, name), name), stack, name)
    return given.transpose(*stack.dims)


def beside(values: Any, stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return a plain array with the dims of the stack that it belongs to, if it has its shape."""
    given = named(values, name)
    return xr.DataArray(given.data, dims=stack.dims) if given.shape == stack.shape else given


def mask_on(mask: xr.DataArray | Any, stack: xr.DataArray, name: str) -> Any:
    """Return a mask with the four axes (time, angle, y, x), each as long as the stack's or 1.

    Plain masks are (y, x), (time, y, x) or (time, angle, y, x), whatever their lengths; others
    give the names of their dims. Lazy ones stay so.

    Raises
    ------
    TypeError
        If it is no mask.
    ValueError
        If it does not fit.
    """
    if isinstance(mask, np.ma.MaskedArray):
        mask = mask.filled(0)  # what is masked is not in it
    given = mask if isinstance(mask, xr.DataArray) else named(mask, name)
    if set(given.dims) - set(AXES) or not {"y", "x"} <= set(given.dims):
        msg = (
            f"{name} has dims {tuple(given.dims)}; they must be among {', '.join(AXES)}, with y "
            "and x"
        )
        raise ValueError(msg)
    for axis in given.dims:
        length, there = given.sizes[axis], stack.sizes.get(axis, 1)
        if length != there and not (length == 1 and axis in ("time", "angle")):
            msg = (
                f"{name} is {in_words(given)}, which does not fit the phase, {in_words(stack)}; "
                "name its axes with an xarray.DataArray if they are others"
            )
            raise ValueError(msg)
    given = with_coordinates(with_light(as_bool(given, name), name), name)
    given = in_order_of(given, stack, name)
    return given.expand_dims([d for d in AXES if d not in given.dims]).transpose(*AXES).data


def without_masked(phase: Any, mask: Any) -> Any:
    """Return a mask that leaves out what is masked in a masked array too."""
    if not isinstance(phase, np.ma.MaskedArray) or not np.ma.is_masked(phase):
        return mask
    if isinstance(mask, str):
        return mask  # what is NaN is left out then
    kept = named(~np.ma.getmaskarray(phase), "phase")
    if mask is None:
        return kept
    full = kept.expand_dims([d for d in AXES if d not in kept.dims]).transpose(*AXES)
    return full & xr.DataArray(
        np.broadcast_to(mask_on(mask, kept, "the mask"), full.shape), dims=AXES
    )


def named(values: Any, name: str) -> xr.DataArray:
    """Return a plain array with the names of its axes."""
    if isinstance(values, xr.Dataset):
        held = ", ".join(map(str, values)) or "nothing"
        msg = f"{name} is a Dataset of {held}; give one of them"
        raise TypeError(msg)
    if isinstance(values, np.ma.MaskedArray):
        outside: Any = False if values.dtype.kind in "biu" else np.nan
        values = values.filled(outside)
    values = plain(values, name)
    if values.ndim not in PLAIN_AXES:
        msg = (
            f"{name} is {values.shape}, which does not fit the phase: plain arrays are (y, x), "
            "(time, y, x) or (time, angle, y, x)"
        )
        raise ValueError(msg)
    return xr.DataArray(values, dims=PLAIN_AXES[values.ndim])


def as_bool(mask: xr.DataArray, name: str) -> xr.DataArray:
    """Return a mask of bool: of labels what is not 0, of numbers 0 and 1 alone."""
    kind = mask.dtype.kind
    if kind == "b":
        return mask
    if kind not in "iuf":
        msg = f"{name} must be of bool, but is {mask.dtype}"
        raise TypeError(msg)
    # A lazy one is not held in memory for it.
    if kind == "f" and bool(((mask != 0) & (mask != 1)).any()):
        odd = mask.values[((mask != 0) & (mask != 1)).values][0]
        msg = f"{name} must be of bool, but holds {odd:g}; make one, as with mask > 0"
        raise ValueError(msg)
    return mask != 0


def in_order_of(given: xr.DataArray, stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return a stack with its frames in the order of another's coordinates, or refuse it."""
    for axis in given.dims:
        known = axis in given.coords and axis in stack.coords and axis in stack.dims
        if not known or given.sizes[axis] != stack.sizes[axis]:
            continue
        own, wanted = given[axis].values, stack[axis].values
        if axis == "time":
            own = on_the_clock_of(given[axis], stack[axis])
        if same_places(wanted, own) and (axis != "angle" or same_light(given, stack)):
            continue
        order, target = np.argsort(own), np.argsort(wanted)
        if axis == "angle":
            order, target = views_in_order(given), views_in_order(stack)
            check_light(given.isel(angle=order), stack.isel(angle=target), name)
        if not same_places(wanted[target], own[order]):
            same = "pixels" if axis in ("y", "x") else "frames"
            msg = (
                f"{name} has other {axis} coordinates ({some(own)}) than the phase "
                f"({some(wanted)}); take the same {same} of both"
            )
            raise ValueError(msg)
        places = np.empty_like(order)
        places[target] = order
        given = given.isel({axis: places})
    return given


def in_words(stack: xr.DataArray) -> str:
    """Return the axes of a stack with their lengths."""
    return " x ".join(f"{n} {axis}" for axis, n in stack.sizes.items())


# ---- labels ---------------------------------------------------------------------------------


#: Larger numbers, or more of them in a frame, are no labels of cells.
HIGHEST, MOST = 2**20, 4000
#: Frames that are looked at, and pixels of a piece that counts as one.
FRAMES, LEAST_PIXELS = 6, 30


def checked_labels(given: Any, name: str = "the labels") -> xr.DataArray:
    """Return labels with names of their axes; what is masked is 0. Lazy ones stay so.

    Parameters
    ----------
    given : DataArray or array_like
        Whole numbers, 0 where there is nothing.
    name : str, optional
        What they are called in sentences.

    Raises
    ------
    TypeError
        If they are no whole numbers.
    ValueError
        If they are negative, too large or too many.

    Warns
    -----
    UserWarning
        If one number stands for several pieces, as in a mask.
    """
    if isinstance(given, np.ma.MaskedArray):
        given = given.filled(0)
    if isinstance(given, xr.DataArray):
        labels: xr.DataArray = given
    else:
        # Lazy ones as well, which are not to come into memory whole.
        values = plain(given, name)
        if values.ndim not in PLAIN_AXES:
            msg = f"{name} must have two to four axes, but are {values.shape}"
            raise ValueError(msg)
        labels = xr.DataArray(values, dims=PLAIN_AXES[values.ndim])
    if labels.dtype.kind == "b":
        msg = f"{name} are bool, as a mask is; number its pieces with scipy.ndimage.label(mask)"
        raise TypeError(msg)
    if labels.dtype.kind not in "iu":
        msg = f"{name} must be whole numbers, as find_cells() gives them, but are {labels.dtype}"
        raise TypeError(msg)
    check_range(labels, name)
    doubt_mask(labels, name)
    return labels


def check_range(labels: xr.DataArray, name: str) -> None:
    """Refuse numbers that are no labels."""
    if not labels.size:
        return
    if labels.dtype.kind == "i" and int(labels.min()) < 0:
        msg = f"{name} must be 0 or more, but some are negative"
        raise ValueError(msg)
    highest = int(labels.max())
    if highest > HIGHEST:
        msg = (
            f"{name} go up to {highest}; give each cell a smaller number, with "
            "skimage.segmentation.relabel_sequential(labels)[0]"
        )
        raise ValueError(msg)
    most = max((np.unique(frame).size for frame in some_frames(labels)), default=0)
    if most > MOST:
        msg = f"{name} have {most} numbers in one frame, as an image has; give labels of cells"
        raise ValueError(msg)


def doubt_mask(labels: xr.DataArray, name: str) -> None:
    """Warn if one number stands for several pieces in all frames, as in a mask."""
    split = []
    for frame in some_frames(labels):
        numbers = np.unique(frame[frame > 0])
        if numbers.size != 1:
            return
        pieces, _ = scipy.ndimage.label(frame > 0)
        split.append(int(np.count_nonzero(np.bincount(pieces.ravel())[1:] >= LEAST_PIXELS)) > 1)
    if split and all(split):
        warn(
            f"{name} have one number for several pieces, as a mask has, so they count as one "
            "cell; number the pieces with scipy.ndimage.label"
        )


def some_frames(labels: xr.DataArray) -> list[NDArray[np.integer[Any]]]:
    """Return some frames (y, x)."""
    further = [d for d in labels.dims if d not in ("y", "x")]
    count = int(np.prod([labels.sizes[d] for d in further], dtype=int))
    picked = np.unique(np.linspace(0, max(count - 1, 0), FRAMES).astype(int))
    frames = []
    for number in picked[: count or 1]:
        place = np.unravel_index(int(number), [labels.sizes[d] for d in further] or [1])
        at = {d: int(i) for d, i in zip(further, place, strict=False)}
        frames.append(np.asarray(labels.isel(at).data))
    return frames
