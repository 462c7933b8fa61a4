"""Filters of single frames, compiled: the numbers of SciPy and NumPy, a few times as fast.

They take the same steps in double precision in the same order, so that every bit is the same; what
lies beyond the edges is the frame mirrored there ("reflect").
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = ["gaussian", "middle", "ranked", "running_mean", "upper_quantile"]

Frame = NDArray[np.float32]
Doubles = NDArray[np.float64]

#: Every so-manieth number is sorted to find about where a rank lies, and so many of these to
#: either side of it are looked at closely.
SAMPLE, MARGIN = 64, 24
#: So many numbers are looked at together for whether any lies near.
SOME = 64


def gaussian(frame: Frame, level: float = 0.0) -> Frame:
    """Return a frame smoothed as `scipy.ndimage.gaussian_filter` does with a sigma of one pixel.

    Parameters
    ----------
    frame : ndarray of float32, shape (y, x)
        What to smooth.
    level : float, optional
        What is taken off it before, in single precision. Default nothing.
    """
    out = np.empty_like(frame)
    frame = np.require(frame, np.float32, ["C", "W"])
    correlate_nine(frame, np.float32(level), half_gaussian(), out)
    return out


@functools.cache
def half_gaussian() -> Doubles:
    """Return the weights of a Gaussian of one pixel from its middle on, cut off after four."""
    weights = np.exp(-0.5 * np.arange(-4, 5) ** 2)
    half: Doubles = (weights / weights.sum())[4:].copy()
    return half


def running_mean(frame: Frame, size: int) -> Frame:
    """Return the means over squares, as `scipy.ndimage.uniform_filter` does.

    Parameters
    ----------
    frame : ndarray of float32, shape (y, x)
        What to average.
    size : int
        Pixels of a square from side to side.
    """
    out = np.empty_like(frame)
    average(np.require(frame, np.float32, ["C", "W"]), size, out)
    return out


def upper_quantile(frame: Frame, share: float) -> np.float32:
    """Return the number below which a share of a frame lies, as `numpy.quantile` does.

    Parameters
    ----------
    frame : ndarray of float32
        Numbers, none of them NaN.
    share : float
        Between 0 and 1.
    """
    numbers = frame.ravel()
    place = (numbers.size - 1) * share
    rank = int(place)
    low, high = ranked(numbers, rank)
    part = place - rank
    between = high - low
    return high - between * (1 - part) if part >= 0.5 else low + between * part


def middle(numbers: Frame) -> np.float32:
    """Return the median of numbers of shape (n,), none of them NaN, as `numpy.median` does."""
    low, high = ranked(numbers, (numbers.size - 1) // 2)
    return low if numbers.size % 2 else (low + high) / np.float32(2)


def ranked(numbers: Frame, rank: int) -> tuple[np.float32, np.float32]:
    """Return the number of a rank, counted from the smallest one, 0, and the one after it.

    Parameters
    ----------
    numbers : ndarray of float32, shape (n,)
        None of them is NaN.
    rank : int
        From 0 to n - 1; after the last one comes itself.
    """
    last = numbers.size - 1
    if numbers.size > 4 * MARGIN * SAMPLE:
        some = np.sort(numbers[::SAMPLE])
        about = rank // SAMPLE
        low = some[about - MARGIN] if about >= MARGIN else np.float32(-np.inf)
        high = some[about + MARGIN] if about + MARGIN < some.size else np.float32(np.inf)
        near = np.empty(numbers.size, np.float32)
        below, count = listed_between(np.ascontiguousarray(numbers), low, high, near)
        if below <= rank and min(rank + 1, last) < below + count:
            numbers, rank = near[:count], rank - below
            last = count - 1
    found = np.sort(numbers)
    return found[rank], found[min(rank + 1, last)]


@compiled
def listed_between(
    numbers: Frame, low: np.float32, high: np.float32, out: Frame
) -> tuple[int, int]:
    """List the numbers from one to another; return how many are below, and how many listed."""
    below, count = 0, 0
    for start in range(0, len(numbers), SOME):
        few = numbers[start : start + SOME]
        smaller, near = 0, 0
        for k in range(len(few)):
            smaller += few[k] < low
            near += (few[k] >= low) & (few[k] <= high)
        below += smaller
        if near == 0:
            continue
        for k in range(len(few)):
            out[count] = few[k]
            count += (few[k] >= low) & (few[k] <= high)
    return below, count


@compiled
def mirrored(place: int, n: int) -> int:
    """Return where a place beyond the edges of a line of n pixels lies in it, mirrored."""
    place %= 2 * n
    return place if place < n else 2 * n - 1 - place


@compiled
def correlate_nine(frame: Frame, level: np.float32, half: Doubles, out: Frame) -> None:
    """Write a frame weighted along y, then along x, over nine pixels each.

    What is added when is SciPy's order: the middle, then pairs from the outermost inwards.

    Parameters
    ----------
    frame : ndarray of float32, shape (y, x)
        What to weigh.
    level : float
        What is taken off it before.
    half : ndarray of float64, shape (5,)
        Weights from the middle on.
    out : ndarray of float32, shape (y, x)
        Where it goes.
    """
    height, width = frame.shape
    w0, w1, w2, w3, w4 = half[0], half[1], half[2], half[3], half[4]
    # The rows around; row y lies at (y + 4) % 9.
    rows = np.empty((9, width), np.float64)
    for y in range(-4, 4):
        copy_row(frame[mirrored(y, height)], level, rows[y + 4])
    line = np.empty((1, width + 8), np.float64)
    # Slices of rows would cost more than the sums.
    for y in range(height):
        copy_row(frame[mirrored(y + 4, height)], level, rows[(y + 8) % 9])
        r0, r1, r2, r3, r4 = y % 9, (y + 1) % 9, (y + 2) % 9, (y + 3) % 9, (y + 4) % 9
        r5, r6, r7, r8 = (y + 5) % 9, (y + 6) % 9, (y + 7) % 9, (y + 8) % 9
        for x in range(width):
            total = rows[r4, x] * w0
            total += (rows[r0, x] + rows[r8, x]) * w4
            total += (rows[r1, x] + rows[r7, x]) * w3
            total += (rows[r2, x] + rows[r6, x]) * w2
            total += (rows[r3, x] + rows[r5, x]) * w1
            line[0, x + 4] = np.float32(total)
        for k in range(1, 5):
            line[0, 4 - k] = line[0, 4 + mirrored(-k, width)]
            line[0, width + 3 + k] = line[0, 4 + mirrored(width - 1 + k, width)]
        for x in range(width):
            total = line[0, x + 4] * w0
            total += (line[0, x] + line[0, x + 8]) * w4
            total += (line[0, x + 1] + line[0, x + 7]) * w3
            total += (line[0, x + 2] + line[0, x + 6]) * w2
            total += (line[0, x + 3] + line[0, x + 5]) * w1
            out[y, x] = total


@compiled
def copy_row(row: Frame, level: np.float32, out: Doubles) -> None:
    """Write a row above a level, in double precision."""
    for x in range(len(out)):
        out[x] = np.float32(row[x] - level)


@compiled
def average(frame: Frame, size: int, out: Frame) -> None:
    """Write the mean over so many pixels along y, then along x."""
    height, width = frame.shape
    before, after = size // 2, size - size // 2 - 1
    total, line = np.zeros(width, np.float64), np.empty(width + size - 1, np.float64)
    total_along = np.empty(width, np.float64)
    for k in range(-before, after + 1):
        row = frame[mirrored(k, height)]
        for x in range(width):
            total[x] += row[x]
    for y in range(height):
        if y > 0:
            entering, leaving = mirrored(y + after, height), mirrored(y - 1 - before, height)
            go_on(frame[entering], frame[leaving], total)
        for x in range(width):
            line[before + x] = np.float32(total[x] / size)
        for k in range(1, before + 1):
            line[before - k] = line[before + mirrored(-k, width)]
        for k in range(1, after + 1):
            line[before + width - 1 + k] = line[before + mirrored(width - 1 + k, width)]
        mean_along(line, size, total_along, out[y])


@compiled
def go_on(entering: Frame, leaving: Frame, total: Doubles) -> None:
    """Move running sums by one row."""
    for x in range(len(total)):
        total[x] += np.float64(entering[x]) - np.float64(leaving[x])


@compiled
def mean_along(line: Doubles, size: int, total: Doubles, out: Frame) -> None:
    """Write the means along a line that goes on beyond both ends."""
    for x in range(1, len(out)):
        total[x] = line[x + size - 1] - line[x - 1]
    total[0] = 0.0
    for k in range(size):
        total[0] += line[k]
    for x in range(1, len(out)):
        total[x] += total[x - 1]
    for x in range(len(out)):
        out[x] = total[x] / size
