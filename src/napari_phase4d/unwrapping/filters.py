"""Filters, medians and patches of single frames: what SciPy gives, a few times as fast.

Filters take the same steps in double precision in the same order as SciPy and NumPy, so that every
bit is the same; what lies beyond the edges is the frame mirrored there ("reflect").

Pixels touch each other up, down and to the sides. A patch is found by its runs along x: those that
touch from row to row are joined (union-find), which takes one look at every pixel.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, inlined

__all__ = [
    "average",
    "correlate_nine",
    "extent",
    "fill_holes",
    "half_gaussian",
    "keep_touching",
    "median_of",
    "middle_of",
    "quantile_of",
    "remove_specks",
    "shrunk",
    "widened",
]

Frame = NDArray[np.float32]
Doubles = NDArray[np.float64]

Bits = NDArray[np.int32] | NDArray[np.int64]

#: Every so-manieth number is looked at to find about where a rank lies, and so many of these to
#: either side of it are looked at closely.
SAMPLE, MARGIN = 64, 24
#: So many numbers are looked at together for whether any lies near.
SOME = 64


@functools.cache
def half_gaussian() -> Doubles:
    """Return the weights of a Gaussian of one pixel from its middle on, cut off after four."""
    weights = np.exp(-0.5 * np.arange(-4, 5) ** 2)
    half: Doubles = (weights / weights.sum())[4:].copy()
    return half


@compiled
def quantile_of(numbers: Frame, share: float) -> np.float32:
    """Return the number below which a share of numbers lies, as `numpy.quantile` does.

    Parameters
    ----------
    numbers : ndarray of float32, shape (n,)
        None of them is NaN.
    share : float
        Between 0 and 1.
    """
    place = (len(numbers) - 1) * share
    rank = int(place)
    low, high = ranked(numbers, rank)
    part = place - rank
    between = np.float32(high - low)
    if part >= 0.5:
        return np.float32(high - np.float32(between * np.float32(1 - part)))
    return np.float32(low + np.float32(between * np.float32(part)))


@compiled
def middle_of(numbers: Frame) -> np.float32:
    """Return the median of numbers of shape (n,), none of them NaN, as `numpy.median` does."""
    low, high = ranked(numbers, (len(numbers) - 1) // 2)
    return low if len(numbers) % 2 else np.float32(np.float32(low + high) / np.float32(2))


@compiled
def ranked(numbers: Frame, rank: int) -> tuple[np.float32, np.float32]:
    """Return the number of a rank, counted from the smallest one, 0, and the one after it.

    Parameters
    ----------
    numbers : ndarray of float32, shape (n,)
        None of them is NaN.
    rank : int
        From 0 to n - 1; after the last one comes itself.
    """
    last = len(numbers) - 1
    pair = np.empty(2, np.float32)
    if len(numbers) > 4 * MARGIN * SAMPLE:
        some = turn_negative(numbers[::SAMPLE].copy().view(np.int32))
        about = rank // SAMPLE
        low, high = np.float32(-np.inf), np.float32(np.inf)
        if about >= MARGIN:
            low = at_rank(some, about - MARGIN, pair)
        if about + MARGIN < len(some):
            high = at_rank(some, about + MARGIN, pair)
        near = np.empty(len(numbers), np.float32)
        below, count = listed_between(numbers, low, high, near)
        if below <= rank and min(rank + 1, last) < below + count:
            at_rank(turn_negative(near[:count].view(np.int32)), rank - below, pair)
            return pair[0], pair[1]
    at_rank(turn_negative(numbers.copy().view(np.int32)), rank, pair)
    return pair[0], pair[1]


@compiled
def at_rank(bits: Bits, rank: int, pair: Frame) -> np.float32:
    """Return the number of a rank by its bits; write it and the one after it."""
    whole = pair.view(np.int32)
    select(bits, rank, whole)
    turn_negative(whole)
    return np.float32(pair[0])


def native(numbers: NDArray[Any]) -> NDArray[Any]:
    """Return numbers in the byte order of this machine, in which their bits can be looked at."""
    return numbers.astype(numbers.dtype.newbyteorder("="), copy=False)


def ordered_bits(numbers: NDArray[np.floating[Any]]) -> Bits:
    """Return the bits of numbers (n,), none of them NaN, as whole numbers in the same order."""
    return turn_negative(numbers.copy().view(f"i{numbers.itemsize}"))


def numbers_at(bits: Bits, rank: int, dtype: Any) -> tuple[Any, Any]:
    """Return the number of a rank and the one after it, by what `ordered_bits` gave."""
    pair = np.empty(2, bits.dtype)
    select(bits, rank, pair)
    low, high = turn_negative(pair).view(dtype)
    return low, high


@compiled
def turn_negative(bits: Bits) -> Bits:
    """Turn the order of negative floating-point numbers round, or back, where they lie."""
    most = np.iinfo(bits.dtype).max
    for k in range(len(bits)):
        bits[k] = bits[k] ^ most if bits[k] < 0 else bits[k]
    return bits


@compiled
def select(numbers: Bits, rank: int, pair: Bits) -> None:
    """Write the number of a rank and the one after it; after the last one comes itself.

    The range that it lies in is halved again and again: counting how many are no larger does many
    numbers at a time, where sorting waits at every second comparison for what comes out of it.
    """
    low, high = numbers[0], numbers[0]
    for k in range(1, len(numbers)):
        low, high = min(low, numbers[k]), max(high, numbers[k])
    largest = high
    while low < high:
        half = (low & high) + ((low ^ high) >> 1)
        if count_to(numbers, numbers.dtype.type(half)) > rank:
            high = half
        else:
            low = half + 1
    pair[0] = pair[1] = low
    if count_to(numbers, pair[0]) == rank + 1 and rank + 1 < len(numbers):
        pair[1] = largest
        for k in range(len(numbers)):
            pair[1] = numbers[k] if pair[0] < numbers[k] < pair[1] else pair[1]


@compiled
def count_to(numbers: Bits, largest: Any) -> int:
    """Return how many numbers are no larger than this."""
    count = np.int32(0)
    for k in range(len(numbers)):
        count += np.int32(numbers[k] <= largest)
    return int(count)


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

    With `half_gaussian` that is `scipy.ndimage.gaussian_filter` with a sigma of one pixel. What is
    added when is SciPy's order: the middle, then pairs from the outermost inwards.

    Parameters
    ----------
    frame : ndarray of float32, shape (y, x)
        What to weigh.
    level : float
        What is taken off it before, in single precision.
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
    """Write the mean over so many pixels along y, then along x: `scipy.ndimage.uniform_filter`."""
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


@inlined
def go_on(entering: Frame, leaving: Frame, total: Doubles) -> None:
    """Move running sums by one row."""
    for x in range(len(total)):
        total[x] += np.float64(entering[x]) - np.float64(leaving[x])


@inlined
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


# ---- patches of a mask ----------------------------------------------------------------------


Mask = NDArray[np.bool_]
#: Row, first and one after the last pixel of every run; its parent among them; the pixels of the
#: patch, and whether it touches the edge, both by its first run.
Runs = NDArray[np.int32]
ROW, START, STOP, PARENT, SIZE, EDGE = 0, 1, 2, 3, 4, 5
#: numba takes a plain number for a type of its own, and compiles what it is handed to once for
#: each; made of one by ``int`` or ``bool``, it is as any other.
NONE, BESIDE, INSIDE = 0, False, True


@compiled
def extent(mask: Mask, room: int) -> tuple[int, int, int, int]:
    """Return the first and one after the last row and column of a mask, with some room.

    The first row and column alone where there is nothing.
    """
    height, width = mask.shape
    top, bottom = height, -1
    columns = np.zeros(width, np.bool_)
    for y in range(height):
        if add_row(mask[y], columns):
            top, bottom = min(top, y), y
    if bottom < 0:
        return 0, 1, 0, 1
    left, right = 0, width - 1
    while not columns[left]:
        left += 1
    while not columns[right]:
        right -= 1
    return (
        max(top - room, 0),
        min(bottom + room + 1, height),
        max(left - room, 0),
        min(right + room + 1, width),
    )


@inlined
def fill_holes(mask: Mask) -> None:
    """Fill what the edge can't be reached from."""
    runs, count = patches_of(mask, bool(BESIDE))
    for k in range(count):
        if not runs[EDGE, root_of(runs, k)]:
            mask[runs[ROW, k], runs[START, k] : runs[STOP, k]] = True


@inlined
def remove_specks(mask: Mask, smallest: float) -> None:
    """Leave out patches of fewer pixels."""
    runs, count = patches_of(mask, bool(INSIDE))
    for k in range(count):
        if runs[SIZE, root_of(runs, k)] < smallest:
            mask[runs[ROW, k], runs[START, k] : runs[STOP, k]] = False


@compiled
def keep_touching(mask: Mask, edge: Mask, smallest: int) -> None:
    """Keep patches of so many pixels that share some with an edge; leave the others out."""
    runs, count = patches_of(mask, bool(INSIDE))
    runs[EDGE] = 0
    for k in range(count):
        row = edge[runs[ROW, k]]
        for x in range(runs[START, k], runs[STOP, k]):
            if row[x]:
                runs[EDGE, root_of(runs, k)] = 1
                break
    for k in range(count):
        root = root_of(runs, k)
        if not runs[EDGE, root] or runs[SIZE, root] < smallest:
            mask[runs[ROW, k], runs[START, k] : runs[STOP, k]] = False


def shrunk(mask: Mask, *, beyond: bool, square: bool = False) -> Mask:
    """Return the pixels of a mask whose neighbours are in it too: four, or eight in a square.

    As ``scipy.ndimage.binary_erosion``, which takes ten times as long.

    Parameters
    ----------
    mask : ndarray of bool, shape (y, x)
        What to shrink.
    beyond : bool
        What lies beyond the border.
    square : bool, optional
        Whether diagonal neighbours count.
    """
    found = np.empty(mask.shape, dtype=bool)
    shrink(np.require(mask, bool, ["C", "W"]), beyond, square, found)
    return found


@compiled
def shrink(mask: Mask, beyond: bool, square: bool, out: Mask) -> None:
    """Write what `shrunk` returns."""
    height, width = mask.shape
    nothing = np.full(width, beyond)
    column = np.full(width + 2, beyond)
    for y in range(height):
        above = mask[y - 1] if y > 0 else nothing
        below = mask[y + 1] if y < height - 1 else nothing
        shrink_row(above, mask[y], below, column[1 : width + 1], square, out[y])
        and_beside(column[:width], column[2:], out[y])


@compiled
def shrink_row(above: Mask, row: Mask, below: Mask, column: Mask, square: bool, out: Mask) -> None:
    """Write what is marked in three rows."""
    for x in range(len(out)):
        out[x] = above[x] & row[x] & below[x]
    for x in range(len(out)):
        column[x] = out[x] if square else row[x]


@compiled
def and_beside(left: Mask, right: Mask, out: Mask) -> None:
    """Keep what is marked to the left and to the right as well."""
    for x in range(len(out)):
        out[x] &= left[x] & right[x]


@compiled
def patches_of(mask: Mask, value: bool) -> tuple[Runs, int]:
    """Return the runs of pixels that have a value, joined to patches, and how many there are."""
    height, width = mask.shape
    runs = np.empty((6, height * ((width + 1) // 2)), np.int32)
    count = above = int(NONE)
    for y in range(height):
        row = mask[y]
        own, x = count, 0
        while x < width:
            if row[x] != value:
                x += 1
                continue
            start = x
            while x < width and row[x] == value:
                x += 1
            runs[ROW, count], runs[START, count], runs[STOP, count] = y, start, x
            runs[PARENT, count], runs[SIZE, count] = count, x - start
            runs[EDGE, count] = y == 0 or y == height - 1 or start == 0 or x == width
            count += 1
        join_rows(runs, above, own, count)
        above = own
    return runs, count


@inlined
def join_rows(runs: Runs, above: int, own: int, count: int) -> None:
    """Join the runs of a row, from ``own`` on, to those of the row before that they touch."""
    for k in range(own, count):
        while above < own and runs[STOP, above] <= runs[START, k]:
            above += 1
        other = above
        while other < own and runs[START, other] < runs[STOP, k]:
            join(runs, other, k)
            other += 1


@inlined
def join(runs: Runs, one: int, other: int) -> None:
    """Make one patch of those of two runs."""
    first, second = root_of(runs, one), root_of(runs, other)
    if first == second:
        return
    if first > second:
        first, second = second, first
    runs[PARENT, second] = first
    runs[SIZE, first] += runs[SIZE, second]
    runs[EDGE, first] |= runs[EDGE, second]


@compiled
def root_of(runs: Runs, run: int) -> int:
    """Return the first run of a run's patch."""
    while runs[PARENT, run] != run:
        runs[PARENT, run] = runs[PARENT, runs[PARENT, run]]
        run = runs[PARENT, run]
    return run


@compiled
def widened(mask: Mask, by: int) -> Mask:
    """Return a mask widened by some pixels up, down and to the sides."""
    height, width = mask.shape
    now = mask.copy()
    for _ in range(by):
        wider = now.copy()
        for y in range(height):
            row, out = now[y], wider[y]
            if y > 0:
                add_row(now[y - 1], out)
            if y < height - 1:
                add_row(now[y + 1], out)
            add_row(row[: width - 1], out[1:])
            add_row(row[1:], out[: width - 1])
        now = wider
    return now


@compiled
def add_row(row: Mask, out: Mask) -> bool:
    """Mark what is marked in a row; return whether anything is."""
    some = False
    for x in range(len(row)):
        out[x] |= row[x]
        some |= row[x]
    return some


#: Fewer numbers are looked at all at once.
FEW = 4096


def median_of(values: NDArray[np.floating[Any]]) -> float:
    """Return the median of numbers (n,), as ``numpy.median`` gives it.

    It takes a third of the time: of many only what lies near the median of some is sorted out.
    """
    if 0 < values.size < FEW:
        if np.isnan(values).any():
            return float("nan")
        values = native(values)
        low, high = numbers_at(ordered_bits(values), (values.size - 1) // 2, values.dtype)
        return float(low if values.size % 2 else (low + high) / 2)
    some = np.sort(values[:: values.size // (FEW // 4)])
    low, high = some[int(0.45 * some.size)], some[int(0.55 * some.size)]
    above = values >= low
    below = int(np.count_nonzero(values < low))
    near = values[above & (values <= high)]
    first, last = (values.size - 1) // 2 - below, values.size // 2 - below
    some_nan = below + np.count_nonzero(above) < values.size
    if some_nan or not 0 <= first <= last < near.size:
        return float(np.median(values))
    return float(np.mean(np.partition(near, (first, last))[first : last + 1]))
