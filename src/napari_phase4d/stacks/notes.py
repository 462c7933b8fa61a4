"""What a stack notes of itself: whether it is wrapped or unwrapped, the wavelength of each view.

And what its numbers look like, where it notes nothing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.stacks.coordinates import WAVELENGTH, factor_to, some
from napari_phase4d.warned import warn
from napari_phase4d.words import as_numbers, check_number

__all__ = [
    "KIND",
    "UNWRAPPED",
    "WRAPPED",
    "blurred_share",
    "check_light",
    "check_unwrapped",
    "check_wrapped",
    "kind_of",
    "looks_wrapped",
    "refuse_counts",
    "refuse_nothing",
    "same_light",
    "share_of_blurred",
    "views_in_order",
    "wavelength_coordinate",
    "wavelengths_of",
    "with_light",
]

#: The attribute that notes which of the two phase is.
KIND, WRAPPED, UNWRAPPED = "kind", "wrapped", "unwrapped"
#: Wrapped phase lies in [-pi, pi], give or take its rounding.
LARGEST = np.pi + 1e-3
#: So near to both ends come the numbers of wrapped phase that has wrapped.
NEAR = 0.05
#: Share of numbers that may lie outside of a range.
FEW = 0.005
#: Frames that are looked at, of each about so many pixels in whole rows; of fewer pixels than the
#: last in all, nothing can be told.
FRAMES, ENOUGH_PIXELS, LEAST_PIXELS = 12, 2**16, 64
#: Phase beyond this is 50 cycles of light: a path in nanometres, or degrees.
VERY_LARGE = 314.0
#: Larger numbers lose their turn in single precision, and count as unknown.
BEYOND = 1e5


def kind_of(stack: xr.DataArray) -> str:
    """Return "wrapped" or "unwrapped" where a stack notes it, else ""."""
    noted = str(stack.attrs.get(KIND, ""))
    if noted in (WRAPPED, UNWRAPPED):
        return noted
    return UNWRAPPED if "method" in stack.attrs or stack.attrs.get("exact") else ""


def refuse_counts(stack: xr.DataArray, name: str) -> None:
    """Refuse whole numbers without a sign that are no radians of a turn, but counts of light."""
    if stack.dtype.kind != "u":
        return
    largest = int(sample_of(stack).max(initial=0))
    if largest > 2 * np.pi:
        msg = (
            f"{name} is {stack.dtype} up to {largest}, as camera frames are; phase is in radians: "
            "reconstruct() makes it of holograms"
        )
        raise TypeError(msg)


def refuse_nothing(stack: xr.DataArray, name: str) -> None:
    """Refuse a stack of which no number is known."""
    if stack.dtype.kind == "f" and not sample_of(stack).size and not np.isfinite(stack).any():
        msg = f"{name} holds nothing but NaN or infinite numbers"
        raise ValueError(msg)


def check_wrapped(stack: xr.DataArray, name: str) -> None:
    """Refuse what notes to be unwrapped, and is; warn of what looks like no wrapped phase."""
    known = sample_of(stack)
    refuse_labels(stack, name)
    low, high = ends_of(known)
    if max(-low, high) > BEYOND:
        known = known[np.abs(known) <= BEYOND]  # Problem counts the others as unknown
        low, high = ends_of(known)
    if max(-low, high) <= LARGEST or in_most(known, -LARGEST, LARGEST):  # what never wraps is both
        if known.size >= LEAST_PIXELS:
            doubt_turns(name, low, high)
            doubt_blurred(name, known)
        return
    if in_most(known, -1e-3, 2 * LARGEST):  # wrapped to a turn from zero on
        doubt_blurred(name, known - np.pi)
        return
    if kind_of(stack) == UNWRAPPED:
        by = f" by {stack.attrs['method']}" if stack.attrs.get("method") else ""
        msg = (
            f"{name} is unwrapped already{by}, as it notes; give the wrapped phase, or wrap it "
            "with numpy.angle(numpy.exp(1j * phase))"
        )
        raise ValueError(msg)
    if known.size >= LEAST_PIXELS:
        doubt_beyond(name, known)


def doubt_beyond(name: str, known: NDArray[Any]) -> None:
    """Warn of numbers that span more than a turn."""
    low, high = float(known.min()), float(known.max())
    if np.array_equal(known, np.round(known)):
        warn(
            f"{name} holds whole numbers from {low:g} to {high:g}, as camera frames do; give "
            "phase in radians, which reconstruct() makes of holograms"
        )
    elif in_degrees(low, high):
        warn(
            f"{name} runs from {low:.4g} to {high:.4g}, as degrees do; give radians, with "
            "numpy.deg2rad(phase)"
        )
    else:
        warn(
            f"{name} runs from {low:.4g} to {high:.4g} rad, more than a turn, so it seems to be "
            "unwrapped already; wrapped phase lies between -pi and pi"
        )


def doubt_turns(name: str, low: float, high: float) -> None:
    """Warn if numbers fill just one turn, as counted in turns."""
    centred = -0.501 <= low < -0.49 and 0.49 < high <= 0.501
    if centred or (-1e-3 <= low < 0.01 and 0.99 < high <= 1.001):
        warn(
            f"{name} runs from {low:.3g} to {high:.3g}, as turns do; give radians, with "
            "2 * numpy.pi * phase"
        )


#: Phase so near to an end of its turn may jump to the other one. It lies in between below the
#: second number, where noise seldom takes it from an end.
NEAR_END, BETWEEN = np.pi - 0.9, 2.0
#: Pixels that a blurred jump takes at most.
LONGEST_JUMP = 8
#: Beside a jump phase changes less from pixel to pixel, or else it may be a true slope; where
#: fewer steps than this share do, noise or slopes hide what jumps are like.
GENTLE, GENTLE_ENOUGH = 0.5, 0.6
#: Jumps that are enough to tell, and the share that is blurred in wrapped phase that was smoothed,
#: enlarged, turned or averaged: 0.6 to 1. It is 0.04 at most where none was, 0.25 in noise.
ENOUGH_JUMPS, MANY_BLURRED = 20, 0.6
#: Pixels beside a jump that tell where phase runs. It does so against the jump at this share of
#: them at least, and by so much over the width of half of them, in radians.
BESIDE, AGAINST, LEAST_RISE, MOST_RISE = 4, 0.65, 0.2, 1.35
#: Numbers that are looked at.
MOST_NUMBERS = 2**19


def doubt_blurred(name: str, known: NDArray[Any]) -> None:
    """Warn if phase goes from one end of its turn to the other by way of what lies in between."""
    share = share_of_blurred(known)
    if share:
        warn(
            f"{name} takes several pixels from pi to -pi at {100 * share:.0f} % of its jumps, as "
            "wrapped phase does that was smoothed, resized, turned or averaged, and turns are "
            "lost there; do so to numpy.exp(1j * phase), and take the angle of that"
        )


def blurred_share(wrapped: xr.DataArray) -> float:
    """Return the share of jumps that are blurred in wrapped phase, 0 where it was not worked on.

    Parameters
    ----------
    wrapped : DataArray
        Wrapped phase in radians; of many frames, or large ones, some are looked at.
    """
    known = sample_of(wrapped)
    from_zero = not in_most(known, -LARGEST, LARGEST) and in_most(known, -1e-3, 2 * LARGEST)
    return share_of_blurred(known - np.pi if from_zero else known)


def share_of_blurred(known: NDArray[Any]) -> float:
    """Return the share of blurred jumps, 0 where few are or can be seen.

    Parameters
    ----------
    known : ndarray
        Wrapped phase from -pi to pi, pixel by pixel along rows.
    """
    skipped = max(known.size - MOST_NUMBERS, 0) // 2
    known = known[skipped : known.size - skipped]
    at = np.flatnonzero(np.abs(known) > NEAR_END)
    high = known[at] > 0
    jumps = np.flatnonzero(high[1:] != high[:-1])
    first, last = at[jumps], at[jumps + 1]
    several = (last - first > 1) & (last - first <= LONGEST_JUMP)
    # No other can be blurred.
    if np.count_nonzero(are_gentle(known, first[several], last[several])) < ENOUGH_JUMPS:
        return 0.0
    gentle = are_gentle(known, first, last) & (last - first <= LONGEST_JUMP)
    first, last = first[gentle], last[gentle]
    blurred = np.zeros(len(first), dtype=bool)
    for pixel in range(1, LONGEST_JUMP):
        inside = np.minimum(first + pixel, last)
        # What is just zero is phase that somebody has set to that where it was not known.
        blurred |= (np.abs(known[inside]) < BETWEEN) & (known[inside] != 0)
    if np.count_nonzero(blurred) < max(ENOUGH_JUMPS, MANY_BLURRED * len(first)):
        return 0.0
    pixels = np.arange(known.size - 1)
    if np.mean(np.abs(steps(known, pixels, pixels + 1)) < GENTLE) < GENTLE_ENOUGH:
        return 0.0
    return float(blurred.mean()) if run_back(known, first[blurred], last[blurred]) else 0.0


def are_gentle(
    known: NDArray[Any], first: NDArray[np.intp], last: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Say of jumps whether phase changes little just before and after them."""
    inside = (first > BESIDE) & (last < known.size - BESIDE - 1)
    before = steps(known, first - inside, first)
    after = steps(known, last, last + inside)
    gentle: NDArray[np.bool_] = inside & (np.abs(before) < GENTLE) & (np.abs(after) < GENTLE)
    return gentle


def run_back(known: NDArray[Any], first: NDArray[np.intp], last: NDArray[np.intp]) -> bool:
    """Say whether phase runs back at its jumps against where it runs beside them, as wraps do.

    The rim of an object that lies near one end of the turn and has its top near the other one
    looks the same but for this: it runs on the way that it goes, or nowhere.
    """
    up = np.sign(known[last] - known[first])
    before = steps(known, first - BESIDE, first - 1)
    after = steps(known, last + 1, last + BESIDE)
    against = -up * (before + after) / (2 * (BESIDE - 1))
    over_jump = float(np.median(against * (last - first + 2)))
    return bool(np.mean(against > 0) >= AGAINST and LEAST_RISE <= over_jump <= MOST_RISE)


def steps(
    known: NDArray[Any], start: NDArray[np.intp], end: NDArray[np.intp]
) -> NDArray[np.floating[Any]]:
    """Return the wrapped differences between numbers, given by their places."""
    step = known[end] - known[start]
    wrapped: NDArray[np.floating[Any]] = step - 2 * np.pi * np.round(step / (2 * np.pi))
    return wrapped


def refuse_labels(stack: xr.DataArray, name: str) -> None:
    """Refuse what notes to be labels of cells."""
    if stack.attrs.get(KIND) == "cells":
        msg = f"{name} holds labels of cells, as it notes; give the unwrapped phase"
        raise ValueError(msg)


def refuse_absurd(stack: xr.DataArray, name: str) -> None:
    """Refuse numbers that are no phase in single precision; of lazy ones some frames are read."""
    values = stack.values if stack.chunks is None else sample_of(stack)
    low, high = float(values.min(initial=0)), float(values.max(initial=0))
    if np.isnan(low) or np.isnan(high) or np.isinf([low, high]).any():
        known = values[np.isfinite(values)]
        low, high = float(known.min(initial=0)), float(known.max(initial=0))
    if max(-low, high) > BEYOND:
        msg = (
            f"{name} runs from {low:.4g} to {high:.4g}, but beyond {BEYOND:g} rad its turns are "
            "lost; set what is not known to NaN"
        )
        raise ValueError(msg)


def check_unwrapped(stack: xr.DataArray, name: str) -> None:
    """Refuse what notes to be wrapped, and is; warn of what looks like no unwrapped phase."""
    refuse_labels(stack, name)
    refuse_absurd(stack, name)
    noted = kind_of(stack)
    if noted == UNWRAPPED:
        return
    known = sample_of(stack)
    if known.size < LEAST_PIXELS:
        return
    low, high = float(known.min()), float(known.max())
    inside = low >= -LARGEST and high <= LARGEST
    fills = inside and low < NEAR - np.pi and np.pi - NEAR < high
    if fills and noted == WRAPPED:
        msg = f"{name} is wrapped, as it notes; unwrap it first, with unwrap()"
        raise ValueError(msg)
    if fills:
        warn(
            f"{name} runs from just -pi to just pi, so it seems to be wrapped; unwrap it first, "
            "with unwrap()"
        )
    elif not in_most(known, -VERY_LARGE, VERY_LARGE):
        warn(
            f"{name} runs from {low:.4g} to {high:.4g} rad, more than 50 turns; if that is an "
            "optical path or degrees, give radians"
        )


def looks_wrapped(values: Any) -> bool:
    """Say whether numbers lie and spread as wrapped phase does, and light does not."""
    if values.dtype.kind != "f" or values.ndim < 2 or 0 in values.shape:
        return False
    some = [values] if values.ndim == 2 else [values[i] for i in (0, len(values) // 2, -1)]
    shown = np.concatenate([np.ravel(np.asarray(frame)) for frame in some])
    known = shown[np.isfinite(shown)]
    if len(known) == 0:
        return False
    low, high = float(known.min()), float(known.max())
    return -LARGEST <= low < 0 < high <= LARGEST and high - low > np.pi


def sample_of(stack: xr.DataArray) -> NDArray[Any]:
    """Return the finite numbers of some frames, spread over the stack; of large ones some rows."""
    frames = [axis for axis in ("time", "angle") if axis in stack.dims]
    shape = [stack.sizes[axis] for axis in frames]
    count = math.prod(shape)
    if count <= 1:
        return finite_of(np.asarray(stack.data).ravel())
    chosen = sorted({round(place) for place in np.linspace(0, count - 1, min(FRAMES, count))})
    parts = []
    for number in chosen:
        place = dict(zip(frames, np.unravel_index(number, shape), strict=True))
        at = tuple(place.get(str(axis), slice(None)) for axis in stack.dims)
        frame = np.asarray(stack.data[at])
        parts.append(frame[:: max(frame.size // ENOUGH_PIXELS, 1)].ravel())
    return finite_of(np.concatenate(parts))


def finite_of(shown: NDArray[Any]) -> NDArray[Any]:
    """Return the finite numbers of an array in a type that holds sums of them."""
    if shown.dtype == np.float16:
        shown = shown.astype(np.float32)
    if np.isfinite(ends_of(shown)).all():  # which is quicker than to look at each
        return shown
    known: NDArray[Any] = shown[np.isfinite(shown)]
    return known


def in_most(known: NDArray[Any], low: float, high: float) -> bool:
    """Say whether all but a few numbers lie between two."""
    outside = np.count_nonzero((known < low) | (known > high))
    return bool(outside <= FEW * known.size)


def ends_of(numbers: NDArray[Any]) -> tuple[float, float]:
    """Return the smallest and the largest number; NaN if any is, and zeros if there is none."""
    return (float(numbers.min()), float(numbers.max())) if numbers.size else (0.0, 0.0)


def in_degrees(low: float, high: float) -> bool:
    """Say whether numbers fill a circle of 360 degrees."""
    return (-181 <= low < -170 and 170 < high <= 181) or (-1 <= low < 10 and 350 < high <= 361)


# ---- the wavelength of each view ------------------------------------------------------------


#: Wavelengths that differ by less than this share are the same.
SAME = 1e-6


def wavelengths_of(stack: xr.DataArray | xr.Dataset) -> NDArray[np.float64] | None:
    """Return the wavelength of each view in micrometres, None where the stack does not note it.

    It is the coordinate "wavelength" along the angle, where views differ in it; else
    ``attrs["wavelength_um"]``, which holds for all of them.

    Parameters
    ----------
    stack : DataArray or Dataset
        Dims among (time, angle, y, x).

    Examples
    --------
    >>> two = xr.DataArray(np.zeros((2, 4, 4)), dims=("angle", "y", "x"))
    >>> two.attrs["wavelength_um"] = 0.6328
    >>> wavelengths_of(two)
    array([0.6328, 0.6328])
    """
    n_views = stack.sizes.get("angle", 1)
    if WAVELENGTH in stack.coords:
        given = np.asarray(stack.coords[WAVELENGTH].values, dtype=np.float64)
        return np.broadcast_to(given, n_views).copy()
    noted = stack.attrs.get("wavelength_um")
    if noted is None:
        return None
    number = check_number('attrs["wavelength_um"] of the phase', noted)
    return np.full(n_views, float(number))


def wavelength_coordinate(
    wavelengths_um: NDArray[np.float64],
) -> tuple[str, NDArray[np.float64], dict[str, str]]:
    """Return the wavelengths of all views as xarray takes them.

    Parameters
    ----------
    wavelengths_um : ndarray of shape (view,)
        In micrometres.
    """
    return "angle", wavelengths_um, {"units": "um"}


def with_light(stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return a stack whose coordinate "wavelength", if it has one, is in micrometres.

    Parameters
    ----------
    stack : DataArray
        Dims among (time, angle, y, x).
    name : str
        What to call it.

    Raises
    ------
    TypeError, ValueError
        If it lies along another axis, holds no lengths above 0, or two views have the same angle
        and wavelength.
    """
    if WAVELENGTH not in stack.coords:
        return stack
    given = stack.coords[WAVELENGTH]
    if given.dims not in ((), ("angle",)):
        msg = (
            f"the wavelengths of {name} lie along {', '.join(map(str, given.dims))}; give one for "
            'each view, along "angle"'
        )
        raise ValueError(msg)
    units = str(given.attrs.get("units") or "um")
    factor = factor_to(units, "um")
    if factor is None:
        msg = f"the wavelengths of {name} are in {units!r}; give them in micrometres"
        raise ValueError(msg)
    numbers = as_numbers(f"the wavelengths of {name}", given.values).astype(np.float64)
    if not (np.isfinite(numbers).all() and (numbers > 0).all()):
        msg = f"the wavelengths of {name} must be numbers above 0, but are {given.values.tolist()}"
        raise ValueError(msg)
    if factor != 1 or units != "um" or given.dtype != np.float64:
        attrs = {**given.attrs, "units": "um"}
        stack = stack.assign_coords({WAVELENGTH: (given.dims, numbers * factor, attrs)})
    check_views(stack, name)
    return stack


def check_views(stack: xr.DataArray, name: str) -> None:
    """Refuse two views of the same angle and wavelength."""
    if "angle" not in stack.dims or "angle" not in stack.coords:
        return
    order = views_in_order(stack)
    angles = np.asarray(stack["angle"].values, dtype=np.float64)[order]
    light = wavelengths_of(stack)
    twice = np.diff(angles) == 0
    if light is not None and (twice & (np.diff(light[order]) < SAME * light.max())).any():
        msg = (
            f"two views of {name} have the same angle and wavelength; leave one of them out, or "
            "correct them"
        )
        raise ValueError(msg)


def views_in_order(stack: xr.DataArray) -> NDArray[np.intp]:
    """Return the numbers of a stack's views by rising angle, then by rising wavelength."""
    angles = np.asarray(stack["angle"].values)
    if WAVELENGTH not in stack.coords:
        return np.argsort(angles)
    light = np.broadcast_to(stack.coords[WAVELENGTH].values, angles.shape)
    return np.lexsort((light, angles))


def same_light(one: xr.DataArray, other: xr.DataArray) -> bool:
    """Say whether the views of two stacks have the same wavelengths, as far as both note them."""
    if not (WAVELENGTH in one.coords and WAVELENGTH in other.coords):
        return True
    a, b = (np.asarray(s.coords[WAVELENGTH].values, np.float64) for s in (one, other))
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=SAME, atol=0))


def check_light(given: xr.DataArray, wanted: xr.DataArray, name: str) -> None:
    """Refuse a stack whose views, in the same order, have other wavelengths than the phase."""
    if not same_light(given, wanted):
        own, theirs = (np.atleast_1d(s.coords[WAVELENGTH].values) for s in (given, wanted))
        msg = (
            f"{name} has other wavelengths ({some(own)} um) than the phase ({some(theirs)} um); "
            "take the same views of both"
        )
        raise ValueError(msg)
