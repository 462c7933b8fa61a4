"""What the numbers of a stack look like, and what is probably wrong with them as wrapped phase."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr

__all__ = [
    "BEYOND",
    "LARGEST",
    "LEAST_PIXELS",
    "NEAR",
    "VERY_LARGE",
    "Doubt",
    "countable",
    "doubts_of",
    "ends_of",
    "in_a_turn",
    "in_most",
    "looks_wrapped",
    "sample_of",
    "share_of_blurred",
    "what_is_wrong",
]

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


@dataclass(frozen=True)
class Doubt:
    """What is probably wrong with numbers that are given as wrapped phase.

    Parameters
    ----------
    warning : str
        What they look like and what to do, to go on after the name of the phase.
    verdict : str
        The same, to go on after "the wrapped phase"; "" if results may be right all the same.
    blurred : float
        Share of its jumps that are blurred.
    """

    warning: str
    verdict: str = ""
    blurred: float = 0.0


def doubts_of(wrapped: xr.DataArray, *, masked: bool = False) -> list[Doubt]:
    """Return what is probably wrong with wrapped phase for which results can't be right.

    Parameters
    ----------
    wrapped : DataArray
        Wrapped phase in radians; of many frames, or large ones, some are looked at.
    masked : bool, optional
        Whether a mask tells what is not known.
    """
    known, width = countable(sample_of(wrapped)), wrapped.sizes["x"]
    return [doubt for doubt in what_is_wrong(known, width, masked=masked) if doubt.verdict]


def what_is_wrong(known: NDArray[Any], width: int = 0, *, masked: bool = False) -> Iterator[Doubt]:
    """Yield what numbers, pixel by pixel along rows, look like that are no wrapped phase.

    Parameters
    ----------
    known : ndarray
        Numbers that are known.
    width : int, optional
        Of a row, if each has all of its pixels.
    masked : bool, optional
        Whether a mask tells what is not known.
    """
    if known.size < LEAST_PIXELS:
        return
    low, high = ends_of(known)
    if low == high:
        yield Doubt(f"is {low:.4g} everywhere, so it shows nothing", "is the same everywhere")
        return
    unit = of_other_unit(known, low, high)
    if unit is not None:
        yield unit
    elif in_a_turn(known):
        around_zero = max(-low, high) <= LARGEST or in_most(known, -LARGEST, LARGEST)
        radians = known if around_zero else known - np.pi
        looks = (look_blurred, look_median) if masked else (look_blurred, look_median, look_filled)
        found = (look(radians, width) for look in looks)
        yield from islice((doubt for doubt in found if doubt is not None), 1)
    else:
        yield Doubt(
            f"runs from {low:.4g} to {high:.4g} rad, more than a turn, so it seems to be "
            "unwrapped already; wrapped phase lies between -pi and pi"
        )


def in_a_turn(known: NDArray[Any]) -> bool:
    """Say whether numbers lie between -pi and pi, or between zero and a turn, but for a few."""
    low, high = ends_of(known)
    return (
        max(-low, high) <= LARGEST  # what never wraps is both
        or in_most(known, -LARGEST, LARGEST)
        or in_most(known, -1e-3, 2 * LARGEST)
    )


# ---- other units ----------------------------------------------------------------------------


#: A jump goes over this share of the range that numbers fill, at so many pixels at least.
OVER_RANGE, ENOUGH_JUMPS = 0.85, 20
#: Where phase wraps, its range ends sharply: of so many parts of it the last ones hold about as
#: many numbers as those beside them. Otherwise as few as none (0.02), or all of them.
PARTS, LEAST_AT_END, MOST_AT_END = 40, 0.3, 5.0
#: The jumps of radians are about a turn high, as a share of it; filters make them lower.
LOW_TURN, HIGH_TURN = 0.85, 1.05
#: Those of half a turn are, to this share.
NEAR_HALF = 0.05


def of_other_unit(known: NDArray[Any], low: float, high: float) -> Doubt | None:
    """Return the doubt that numbers are in radians, by the heights of their jumps."""
    beyond = not in_a_turn(known)
    if beyond and np.array_equal(known, np.round(known)):
        return Doubt(
            f"holds whole numbers from {low:g} to {high:g}, as camera frames do; give phase in "
            "radians, which reconstruct() makes of holograms",
            "holds whole numbers, as camera frames do, and not radians",
        )
    if beyond and in_degrees(low, high):
        return Doubt(
            f"runs from {low:.4g} to {high:.4g}, as degrees do; give radians, with "
            "numpy.deg2rad(phase)",
            "seems to be in degrees, and not in radians",
        )
    if in_turns(low, high):
        return Doubt(
            f"runs from {low:.3g} to {high:.3g}, as turns do; give radians, with "
            "2 * numpy.pi * phase",
            "seems to be in turns, and not in radians",
        )
    height = high - low
    if not jumps_over_its_range(known, low, high):
        return None
    if abs(height / np.pi - 1) < NEAR_HALF:
        return Doubt(
            f"jumps by {height:.3g} where it wraps, half a turn, as what arctan gives does, or "
            "half of a phase; make it with numpy.angle or numpy.arctan2",
            "jumps by half a turn where it wraps, and is no phase of a whole turn",
        )
    return Doubt(
        f"jumps by {height:.4g} where it wraps, and not by 2 pi, so it is not in radians; "
        f"multiply it by {2 * np.pi / height:.4g}",
        f"jumps by {height:.4g} where it wraps, and not by 2 pi as radians do",
    )


def jumps_over_its_range(known: NDArray[Any], low: float, high: float) -> bool:
    """Say whether numbers wrap at the ends of a range that is no turn of radians."""
    height = high - low
    if height <= 0 or LOW_TURN < height / (2 * np.pi) < HIGH_TURN:
        return False
    some = known[:MOST_NUMBERS].astype(np.float64)
    if np.count_nonzero(np.abs(np.diff(some)) > OVER_RANGE * height) < ENOUGH_JUMPS:
        return False
    held, _ = np.histogram(some, PARTS, (low, high))
    ends = np.array([held[0], held[-1]])
    beside = np.array([held[1:4].mean(), held[-4:-1].mean()])
    return bool(((ends > LEAST_AT_END * beside) & (ends < MOST_AT_END * beside)).all())


def in_degrees(low: float, high: float) -> bool:
    """Say whether numbers fill a circle of 360 degrees."""
    return (-181 <= low < -170 and 170 < high <= 181) or (-1 <= low < 10 and 350 < high <= 361)


def in_turns(low: float, high: float) -> bool:
    """Say whether numbers fill just one turn, as counted in turns."""
    centred = -0.501 <= low < -0.49 and 0.49 < high <= 0.501
    return centred or (-1e-3 <= low < 0.01 and 0.99 < high <= 1.001)


# ---- one number in place of many ------------------------------------------------------------


#: Numbers that are just the same fill at least this share; phase jumps by more than a radian and
#: more to those beside them at so many of these, which it does nowhere where nothing is hidden.
FILLED, FAR, MANY_FAR = 0.002, 2.0, 0.06
#: So much noise has phase that was measured, in radians; simulations without may have sheer walls.
#: For each edge there must be so many places where it can be seen.
LEAST_NOISE, SEEN_AN_EDGE = 0.015, 2
#: What a median filter leaves of it.
LEAST_LEFT = 0.004
#: Neighbours that are just the same where each pixel has the median of those around it: 0.19 to
#: 0.21 of them. They are 0.5 where pixels were doubled, which does no harm.
LEAST_SAME, MOST_SAME = 0.12, 0.4
#: Numbers that differ, as a share of all: 0.3 to 0.5 there, next to none where there are only some
#: steps of grey.
LEAST_DISTINCT = 0.25


def look_filled(known: NDArray[Any], width: int) -> Doubt | None:
    """Return the doubt that phase was cut out, or written over, with one number.

    Where that hides a rim, turns are lost; if nothing is known there they are counted round it.
    """
    same = np.flatnonzero(known[1:] == known[:-1])
    if len(same) < ENOUGH_JUMPS:
        return None
    filling = most_frequent(known[same])
    inside = known == filling
    edge = np.flatnonzero(inside[1:] != inside[:-1])
    if width and known.size % width == 0:
        edge = edge[(edge + 1) % width != 0]  # of a row and the next one
    if inside.mean() < FILLED or len(edge) < ENOUGH_JUMPS:
        return None
    far = float(np.mean(np.abs(steps(known, edge, edge + 1)) > FAR))
    if far < MANY_FAR or noise_of(known, ~inside, SEEN_AN_EDGE * len(edge)) < LEAST_NOISE:
        return None
    share = f"{100 * inside.mean():.2g} % of its pixels"
    return Doubt(
        f"is just {filling:.4g} on {share}, and jumps at their edge, as where something was cut "
        "out or written over; set what is not known to NaN, and leave a rim of empty field round "
        "what is cut out",
        f"is just {filling:.4g} on {share}, and jumps at their edge, so that turns may be lost "
        "there",
    )


def look_median(known: NDArray[Any], _: int) -> Doubt | None:
    """Return the doubt that each pixel has been given the median of those around it."""
    same = known[1:] == known[:-1]
    if not LEAST_SAME < same.mean() < MOST_SAME:
        return None
    filling = most_frequent(known[1:][same])
    others = known[known != filling]
    alike = np.mean(others[1:] == others[:-1]) if others.size > LEAST_PIXELS else 0.0
    distinct = len(np.unique(others)) / max(others.size, 1)
    if not LEAST_SAME < alike < MOST_SAME or distinct < LEAST_DISTINCT:
        return None
    if noise_of(known, known != filling, ENOUGH_JUMPS) < LEAST_LEFT:
        return None
    return Doubt(
        f"has the same number at {100 * alike:.0f} % of all neighbours, as after a median filter, "
        "which moves the jumps of wrapped phase; filter numpy.exp(1j * phase), or don't filter",
        "seems to have gone through a median filter, which loses turns where it jumps",
    )


def most_frequent(numbers: NDArray[Any]) -> float:
    """Return the number that there is most often, among some of them."""
    values, counts = np.unique(numbers[:: max(numbers.size // 4096, 1)], return_counts=True)
    return float(values[counts.argmax()])


def noise_of(known: NDArray[Any], there: NDArray[np.bool_], least: int) -> float:
    """Return the noise of phase along rows by differences of the fifth order, in radians.

    Where these can be taken at fewer places than the least it is 0.

    To them smooth objects add next to nothing; where they do, at rims, is left out with the
    quarter that is looked at: of normal noise it lies within 0.3186 of the deviation. A difference
    has the variance of a number times the sum of its squared weights, 252.
    """
    known, there = known[:MOST_NUMBERS], there[:MOST_NUMBERS]
    places = np.arange(known.size - 1)
    fifth = np.diff(steps(known, places, places + 1), 4)
    whole = np.logical_and.reduce([there[i : i + len(fifth)] for i in range(6)])
    if np.count_nonzero(whole) < least:
        return 0.0
    return float(np.quantile(np.abs(fifth[whole]), 0.25) / (0.3186 * math.sqrt(252)))


# ---- worked on as a picture -----------------------------------------------------------------


#: Phase so near to an end of its turn may jump to the other one. It lies in between below the
#: second number, where noise seldom takes it from an end.
NEAR_END, BETWEEN = np.pi - 0.9, 2.0
#: Pixels that a blurred jump takes at most.
LONGEST_JUMP = 8
#: Beside a jump phase changes less from pixel to pixel, or else it may be a true slope; where
#: fewer steps than this share do, noise or slopes hide what jumps are like.
GENTLE, GENTLE_ENOUGH = 0.5, 0.6
#: The share of jumps that is blurred in wrapped phase that was smoothed, enlarged, turned or
#: averaged: 0.6 to 1. It is 0.04 at most where none was, 0.25 in noise.
MANY_BLURRED = 0.6
#: Pixels beside a jump that tell where phase runs. It does so against the jump at this share of
#: them at least, and by so much over the width of half of them, in radians.
BESIDE, AGAINST, LEAST_RISE, MOST_RISE = 4, 0.65, 0.2, 1.35
#: Numbers that are looked at.
MOST_NUMBERS = 2**19


def look_blurred(known: NDArray[Any], _: int) -> Doubt | None:
    """Return the doubt of phase that goes from one end of its turn to the other by steps."""
    share = share_of_blurred(known)
    if not share:
        return None
    return Doubt(
        f"takes several pixels from pi to -pi at {100 * share:.0f} % of its jumps, as wrapped "
        "phase does that was smoothed, resized, turned or averaged, and turns are lost there; do "
        "so to numpy.exp(1j * phase), and take the angle of that",
        "seems to have been smoothed, resized, turned or averaged, and has lost turns where it "
        "jumps",
        share,
    )


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


# ---- numbers ---------------------------------------------------------------------------------


def countable(known: NDArray[Any]) -> NDArray[Any]:
    """Leave out numbers that are too large, which `Problem` counts as unknown."""
    low, high = ends_of(known)
    return known[np.abs(known) <= BEYOND] if max(-low, high) > BEYOND else known


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
