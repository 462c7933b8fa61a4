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
    "ends_of",
    "in_a_turn",
    "in_most",
    "looks_wrapped",
    "row_length",
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
        What they look like and what to do, to go on after the name of the phase; "" if nothing
        goes wrong with them.
    verdict : str
        The same, to go on after "the wrapped phase"; "" if results may be right all the same.
    blurred : float
        Share of its jumps that are blurred.
    """

    warning: str
    verdict: str = ""
    blurred: float = 0.0


def row_length(stack: xr.DataArray) -> int:
    """Return how many pixels follow each other in a row of a frame, as it lies in the stack."""
    return int(stack.sizes[planes_of(stack)[-1]])


def planes_of(stack: xr.DataArray) -> list[str]:
    """Return "y" and "x" in the order in which they lie in the stack."""
    return [str(axis) for axis in stack.dims if axis in ("y", "x")]


def what_is_wrong(known: NDArray[Any], width: int = 0) -> Iterator[Doubt]:
    """Yield what numbers, pixel by pixel along rows, look like that are no wrapped phase.

    Parameters
    ----------
    known : ndarray
        Numbers that are known.
    width : int, optional
        Of a row, if each has all of its pixels.
    """
    if known.size < LEAST_PIXELS:
        return
    low, high = ends_of(known)
    if low == high:
        yield Doubt("", f"is {low:.4g} everywhere, and shows nothing")
        return
    unit = of_beyond_one(known) or of_other_unit(known, low, high)
    if unit is not None:
        yield unit
    elif in_a_turn(known):
        around_zero = max(-low, high) <= LARGEST or in_most(known, -LARGEST, LARGEST)
        radians = known if around_zero else known - np.pi
        rows = radians.reshape(-1, width if width and known.size % width == 0 else known.size)
        found = (look(rows) for look in (look_blurred, look_median, look_filled))
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
#: Each other part holds at least this share of what half of them do.
LEAST_BETWEEN = 0.1
#: Share of the numbers that may be hot at either end, which makes their range so much larger.
HOT, MUCH_MORE = 5e-4, 1.05
#: The jumps of radians are about a turn high, as a share of it; filters make them lower.
LOW_TURN, HIGH_TURN = 0.85, 1.05
#: Those of half a turn are, to this share.
NEAR_HALF = 0.05


def of_beyond_one(known: NDArray[Any]) -> Doubt | None:
    """Return the doubt that one number which is no phase stands for what is not known."""
    beyond = known[np.abs(known) > 2 * LARGEST]
    if in_a_turn(known) or not beyond.size or (beyond != beyond[0]).any():
        return None
    share = f"{100 * beyond.size / known.size:.2g} % of its pixels"
    return Doubt(
        f"is just {beyond[0]:.4g} on {share}, which is no phase; set what is not known to NaN",
        f"is just {beyond[0]:.4g} on {share}, which is no phase",
    )


def of_other_unit(known: NDArray[Any], low: float, high: float) -> Doubt | None:
    """Return the doubt that numbers are in radians, by the heights of their jumps."""
    beyond = not in_a_turn(known)
    if beyond and in_degrees(low, high):
        return Doubt(
            f"runs from {low:.4g} to {high:.4g}, as degrees do; give radians, with "
            "numpy.deg2rad(phase)",
            "seems to be in degrees, and not in radians",
        )
    if beyond and np.array_equal(known, np.round(known)):
        return Doubt(
            f"holds whole numbers from {low:g} to {high:g}, as camera frames do; give phase in "
            "radians, which reconstruct() makes of holograms (pictures of phase: times 2 * "
            "numpy.pi over their number of greys)",
            "holds whole numbers, as camera frames do, and not radians",
        )
    jumps, turns = jumps_over_its_range(known), in_turns(low, high)
    if turns:  # a thin object may end there too, but jumps nowhere
        return Doubt(
            f"runs from {low:.3g} to {high:.3g}, as turns do; give radians, with "
            "2 * numpy.pi * phase",
            "seems to be in turns, and not in radians" if jumps else "",
        )
    if not jumps:
        return None
    height = jumps
    if abs(height / np.pi - 1) < NEAR_HALF:
        return Doubt(
            f"jumps by {height:.3g} where it wraps, half a turn, as what arctan gives does, or "
            "half of a phase; make it with numpy.angle or numpy.arctan2",
            "jumps by half a turn where it wraps, and is no phase of a whole turn",
        )
    return Doubt(
        f"jumps by {height:.4g} where it wraps, and not by 2 pi, so it is not in radians (unless "
        f"it shows steps of that height); multiply it by {2 * np.pi / height:.4g}",
        f"jumps by {height:.4g} where it wraps, and not by 2 pi as radians do",
    )


def jumps_over_its_range(known: NDArray[Any]) -> float:
    """Return the height of the range at whose ends numbers wrap, if that is no turn, else 0."""
    low, high = ends_of(known)
    if high <= low or LOW_TURN < (high - low) / (2 * np.pi) < HIGH_TURN:
        return 0.0
    some = known[:MOST_NUMBERS].astype(np.float64)
    inner = [float(end) for end in np.quantile(some, (HOT, 1 - HOT))]
    if high - low > MUCH_MORE * (inner[1] - inner[0]):  # by hot pixels
        low, high = inner
    height = high - low
    if height <= 0 or LOW_TURN < height / (2 * np.pi) < HIGH_TURN:
        return 0.0
    step = np.abs(np.diff(some))
    jumps = np.count_nonzero((step > OVER_RANGE * height) & (step < height / OVER_RANGE))
    if jumps < ENOUGH_JUMPS:
        return 0.0
    held, _ = np.histogram(some, PARTS, (low, high))
    ends = np.array([held[0], held[-1]])
    beside = np.array([held[1:4].mean(), held[-4:-1].mean()])
    sharp = (ends > LEAST_AT_END * beside) & (ends < MOST_AT_END * beside)
    # Between two levels, as of a grating, there is nothing.
    filled = held.min() >= max(1.0, LEAST_BETWEEN * float(np.median(held)))
    return height if bool(sharp.all()) and filled else 0.0


def in_degrees(low: float, high: float) -> bool:
    """Say whether numbers fill a circle of 360 degrees."""
    return (-181 <= low < -170 and 170 < high <= 181) or (-1 <= low < 10 and 350 < high <= 361)


def in_turns(low: float, high: float) -> bool:
    """Say whether numbers fill just one turn, as counted in turns."""
    centred = -0.501 <= low < -0.49 and 0.49 < high <= 0.501
    return centred or (-1e-3 <= low < 0.01 and 0.99 < high <= 1.001)


# ---- one number in place of many ------------------------------------------------------------


#: Numbers that are just the same fill at least this share, so many times as much as the next most
#: frequent one; at so many of the steps at their edge phase jumps by more than so many radians.
FILLED, STANDS_OUT, MANY_FAR, FAR = 0.002, 5, 0.06, 2.0
#: So much noise has phase that was measured, in radians; simulations without may have sheer walls.
#: For each edge there must be so many places where it can be seen.
LEAST_NOISE, SEEN_AN_EDGE = 0.015, 2
#: Neighbours that are just the same where each pixel has the median of those around it: 0.19 to
#: 0.21 of them. Where pixels were copied, or a border added, whole columns are the same instead.
LEAST_SAME, MOST_SAME, WHOLE_COLUMN = 0.15, 0.4, 0.6
#: Numbers that differ, as a share of all: 0.3 to 0.5 there, next to none where there are only some
#: steps of grey; and what such a filter leaves of the noise, in radians.
LEAST_DISTINCT, LEAST_LEFT = 0.25, 0.004


def look_filled(rows: NDArray[Any]) -> Doubt | None:
    """Return the doubt that phase was cut out, or written over, with one number.

    Where that hides a rim, turns are lost; if nothing is known there they are counted round it.
    """
    known = rows.ravel()
    same = known[1:] == known[:-1]
    if np.count_nonzero(same) < ENOUGH_JUMPS:
        return None
    filling = most_frequent(known[1:][same])
    inside = known == filling
    edge = np.flatnonzero(inside[1:] != inside[:-1])
    edge = edge[(edge + 1) % rows.shape[1] != 0]  # not of a row and the next one
    if inside.mean() < FILLED or len(edge) < ENOUGH_JUMPS:
        return None
    far = float(np.mean(np.abs(steps(known, edge, edge + 1)) > FAR))
    if far < MANY_FAR or is_grey(known, inside):
        return None
    if noise_of(known, ~inside, SEEN_AN_EDGE * len(edge)) < LEAST_NOISE:
        return None
    share = f"{100 * inside.mean():.2g} % of its pixels"
    return Doubt(
        f"is just {filling:.4g} on {share}, and jumps at their edge, as where something was cut "
        "out or written over; set what is not known to NaN, and leave a rim of empty field round "
        "what is cut out",
        f"is just {filling:.4g} on {share}, and jumps at their edge, so that turns may be lost "
        "there",
    )


def is_grey(known: NDArray[Any], inside: NDArray[np.bool_]) -> bool:
    """Say whether numbers are one of some steps of grey, of which others are as frequent.

    Their rounding, or pixels that were copied, would look like noise.
    """
    others = known[~inside]
    values, counts = np.unique(others, return_counts=True)
    if STANDS_OUT * counts.max(initial=0) > np.count_nonzero(inside):
        return True
    few = len(values) < LEAST_DISTINCT * others.size
    return few and bool(np.mean(others[1:] == others[:-1]) > LEAST_SAME)


def look_median(rows: NDArray[Any]) -> Doubt | None:
    """Return the doubt that each pixel has been given the median of those around it."""
    if min(rows.shape) < 2:  # columns can't be told
        return None
    same = rows[:, 1:] == rows[:, :-1]
    if not same.mean() > LEAST_SAME / 4:
        return None
    known = rows.ravel()
    filling = most_frequent(rows[:, 1:][same])
    elsewhere = (rows[:, 1:] != filling) & (rows[:, :-1] != filling)
    there = elsewhere.sum(axis=0)
    by_column = (same & elsewhere).sum(axis=0)
    usual = (by_column <= WHOLE_COLUMN * there) & (there > 0)
    alike = by_column[usual].sum() / max(int(there[usual].sum()), 1)
    distinct = len(np.unique(known)) / max(int(np.count_nonzero(known != filling)), 1)
    if not LEAST_SAME < alike < MOST_SAME or distinct < LEAST_DISTINCT:
        return None
    if (
        usual.sum() < 0.5 * len(usual)
        or noise_of(known, known != filling, ENOUGH_JUMPS) < LEAST_LEFT
    ):
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


def look_blurred(rows: NDArray[Any]) -> Doubt | None:
    """Return the doubt of phase that goes from one end of its turn to the other by steps."""
    share = share_of_blurred(rows.ravel())
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
    if known.dtype.kind != "f":  # small whole numbers have no room for differences
        known = known.astype(np.float64)
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


def sample_of(stack: xr.DataArray, kept: NDArray[np.bool_] | None = None) -> NDArray[Any]:
    """Return the finite numbers of some frames, spread over the stack; of large ones some rows.

    Parameters
    ----------
    stack : DataArray
        Dims among (time, angle, y, x).
    kept : ndarray of bool, optional
        A mask with all four axes, each as long as the stack's or 1; the others are left out.
    """
    frames = [axis for axis in ("time", "angle") if axis in stack.dims]
    shape = [stack.sizes[axis] for axis in frames]
    count = math.prod(shape)
    chosen = sorted({round(place) for place in np.linspace(0, count - 1, min(FRAMES, count))})
    parts = []
    for number in chosen:
        place = dict(zip(frames, np.unravel_index(number, shape), strict=True))
        at = tuple(place.get(str(axis), slice(None)) for axis in stack.dims)
        frame = np.asarray(stack.data[at])
        every = 1 if count == 1 else max(frame.size // ENOUGH_PIXELS, 1)
        rows = frame[::every]
        if kept is not None:
            time, angle = (
                min(int(place.get(axis, 0)), n - 1)
                for axis, n in zip(("time", "angle"), kept.shape, strict=False)
            )
            inside = kept[time, angle] if planes_of(stack) == ["y", "x"] else kept[time, angle].T
            rows = rows[inside[::every]]
        parts.append(rows.ravel())
    return finite_of(np.concatenate(parts) if len(parts) > 1 else parts[0])


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
