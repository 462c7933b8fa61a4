"""Neighbours along the axes of a stack: ends of steps, means over a box, noise averaged out.

Noise is averaged out along the slope: phasors of neighbours, each turned by the local slope.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, unchecked, vectorized
from napari_phase4d.phasors import parts_of, phase_of, phasors
from napari_phase4d.task import on_all_cores

__all__ = [
    "HALO",
    "LEAST_WEIGHT",
    "along_slope",
    "both_ends",
    "box_mean",
    "change_on_both_sides",
    "ends_along",
    "known_mean",
]

Part = tuple[slice, ...]


def ends_along(axis: int, ndim: int) -> tuple[Part, Part]:
    """Return the parts of a stack that hold the first and the second ends of all steps.

    Parameters
    ----------
    axis : int
        Along which the steps go.
    ndim : int
        Number of dimensions of the stack.

    Examples
    --------
    >>> stack = np.array([[1, 2, 4], [7, 11, 16]])
    >>> head, tail = ends_along(1, stack.ndim)
    >>> stack[tail] - stack[head]
    array([[1, 2],
           [4, 5]])
    """
    head = tuple(slice(None, -1) if i == axis % ndim else slice(None) for i in range(ndim))
    tail = tuple(slice(1, None) if i == axis % ndim else slice(None) for i in range(ndim))
    return head, tail


def both_ends(mask: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Mark the steps along an axis whose two ends both lie in a mask.

    Parameters
    ----------
    mask : ndarray of bool
        A mask of any number of dimensions.
    axis : int
        Along which the steps go; negative numbers count from the last.

    Returns
    -------
    ndarray of bool
        As ``mask``, but one shorter along the axis: a step is there for each pixel but the last.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_phase4d.unwrapping import both_ends
    >>> both_ends(np.array([True, True, False, True]), 0)
    array([ True, False, False])
    """
    head, tail = ends_along(axis, mask.ndim)
    both: NDArray[np.bool_] = mask[head] & mask[tail]
    return both


# ---- means and changes ----------------------------------------------------------------------


#: Share of the weight of a box below which a mean counts as nothing.
LEAST_WEIGHT = 1e-3
#: So many numbers of a line are worked on at a time, so that they stay near the core.
AT_A_TIME = 1024

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]
Values = TypeVar("Values", NDArray[np.float32], NDArray[np.complex64])


def box_mean(values: Values, axes: Sequence[int] = (0, 1, 2, 3)) -> Values:
    """Return the mean over a box of three along the axes, those that are at least as long.

    At the ends of an axis the last value counts twice, as for ``mode="reflect"`` of
    `scipy.ndimage.uniform_filter`, which gives the same, three times as slowly.

    Parameters
    ----------
    values : ndarray of float32 or complex64, shape (time, angle, y, x)
        Contiguous; is overwritten and returned.
    axes : sequence of int, optional
        Along which to average; default all.
    """
    for axis in axes:
        n = values.shape[axis]
        if n < 3:
            continue
        # Real and imaginary parts are numbers of their own, which take turns along x.
        parts = 2 if values.dtype == np.complex64 else 1
        if axis == values.ndim - 1:
            mean_along(values.reshape(-1, n).view(np.float32), parts)
        else:
            inner = math.prod(values.shape[axis + 1 :])
            lines = values.reshape(math.prod(values.shape[:axis]), n, inner)
            mean_across(lines.view(np.float32))
    return values


def known_mean(values: Values, known: Mask, axes: Sequence[int] = (0, 1, 2, 3)) -> Values:
    """Return `box_mean` over those values that are known; overwrites the values.

    Parameters
    ----------
    values : ndarray of float32 or complex64, shape (time, angle, y, x)
        0 where they are not known.
    known : ndarray of bool, same shape
        Which are known.
    axes : sequence of int, optional
        See `box_mean`.
    """
    mean = box_mean(values, axes)
    if not known.all():
        weights = box_mean(known.astype(np.float32), axes)
        mean /= np.maximum(weights, np.float32(LEAST_WEIGHT), out=weights)
    return mean


@compiled
def mean_along(lines: Stack, parts: int) -> None:
    """Average lines (line, place) over three places, in place; each has so many parts."""
    n = lines.shape[1]
    padded = np.empty(n + 2 * parts, dtype=np.float32)
    for line in range(len(lines)):
        row = lines[line]
        copy_line(row, padded[parts : parts + n])
        for i in range(parts):
            padded[i], padded[parts + n + i] = row[i], row[n - parts + i]
        mean_of_three(padded[:n], padded[parts : parts + n], padded[2 * parts :], row)


@compiled
def mean_of_three(before: Stack, here: Stack, after: Stack, out: Stack) -> None:
    """Write the means of three lines."""
    third = np.float32(1 / 3)
    for j in range(len(out)):
        out[j] = (before[j] + here[j] + after[j]) * third


@compiled
def mean_across(lines: Stack) -> None:
    """Average lines (outer, place, inner) over three places, in place, some inner at a time."""
    outer, n, inner = lines.shape
    before, here = np.empty(AT_A_TIME, np.float32), np.empty(AT_A_TIME, np.float32)
    for o in range(outer):
        for start in range(0, inner, AT_A_TIME):
            stop = min(start + AT_A_TIME, inner)
            size = stop - start
            copy_line(lines[o, 0, start:stop], before[:size])
            for i in range(n):
                row = lines[o, i, start:stop]
                copy_line(row, here[:size])
                if i + 1 < n:
                    after = lines[o, i + 1, start:stop]
                    mean_of_three(before[:size], here[:size], after, row)
                else:
                    mean_of_three(before[:size], here[:size], here[:size], row)
                before, here = here, before


@compiled
def copy_line(line: Stack, out: Stack) -> None:
    """Write a line."""
    for j in range(len(out)):
        out[j] = line[j]


def change_on_both_sides(step: Stack, axis: int, valid: Mask) -> Stack:
    """Return (|g(j+1) - g(j)| + |g(j) - g(j-1)|)^2, a missing change replaced by the other.

    (2 |g|)^2 where both are missing; 0 for steps that are not valid.

    Parameters
    ----------
    step : ndarray of float32, shape (time, angle, y, x)
        Steps g along the axis, radians.
    axis : int
        Which axis.
    valid : ndarray of bool, same shape
        Steps that count.
    """
    n = step.shape[axis]
    outer, inner = math.prod(step.shape[:axis]), math.prod(step.shape[axis + 1 :])
    given = np.require(step, np.float32, ["C", "W"])
    known = np.require(valid, np.bool_, ["C", "W"])
    found = np.empty(step.shape, dtype=np.float32)
    if inner == 1:
        lines = (outer, n)
        change_along(given.reshape(lines), known.reshape(lines), found.reshape(lines))
    else:
        of = (outer, n, inner)
        change_across(given.reshape(of), known.reshape(of), found.reshape(of))
    return found


@compiled
def change_along(step: Stack, known: Mask, found: Stack) -> None:
    """Do `change_on_both_sides` for lines (line, place)."""
    n = step.shape[1]
    padded, there = np.zeros(n + 2, np.float32), np.zeros(n + 2, np.bool_)
    for line in range(len(step)):
        copy_line(step[line], padded[1 : n + 1])
        mark_line(known[line], there[1 : n + 1])
        before, here, after = padded[:n], padded[1 : n + 1], padded[2:]
        there_before, there_here, there_after = there[:n], there[1 : n + 1], there[2:]
        square_changes(before, here, after, there_before, there_here, there_after, found[line])


@compiled
def change_across(step: Stack, known: Mask, found: Stack) -> None:
    """Do it for lines (outer, place, inner)."""
    outer, n, inner = step.shape
    none, nowhere = np.zeros(inner, np.float32), np.zeros(inner, np.bool_)
    for o in range(outer):
        for i in range(n):
            before, after = none, none
            known_before, known_after = nowhere, nowhere
            if i > 0:
                before, known_before = step[o, i - 1], known[o, i - 1]
            if i + 1 < n:
                after, known_after = step[o, i + 1], known[o, i + 1]
            square_changes(
                before, step[o, i], after, known_before, known[o, i], known_after, found[o, i]
            )


@compiled
def square_changes(
    before: Stack,
    here: Stack,
    after: Stack,
    known_before: Mask,
    known: Mask,
    known_after: Mask,
    found: Stack,
) -> None:
    """Do it for steps and those before and behind each; without branches, some at a time."""
    total, count = np.empty(AT_A_TIME, np.float32), np.empty(AT_A_TIME, np.int8)
    for start in range(0, len(found), AT_A_TIME):
        stop = min(start + AT_A_TIME, len(found))
        size = stop - start
        total[:size] = 0
        count[:size] = 0
        add_change(here[start:stop], before[start:stop], known_before[start:stop], total, count)
        add_change(here[start:stop], after[start:stop], known_after[start:stop], total, count)
        square_total(here[start:stop], known[start:stop], total, count, found[start:stop])


@compiled
def add_change(
    here: Stack, other: Stack, known: Mask, total: Stack, count: NDArray[np.int8]
) -> None:
    """Add the changes to other steps, where these are known."""
    for j in range(len(here)):
        change = abs(here[j] - other[j])
        total[j] += change if known[j] else np.float32(0)
        count[j] += known[j]


@compiled
def square_total(
    here: Stack, known: Mask, total: Stack, count: NDArray[np.int8], found: Stack
) -> None:
    """Write the squares of changes, a missing one replaced by the other."""
    two = np.float32(2)
    for j in range(len(here)):
        both = total[j] if count[j] == 2 else two * total[j]
        both = both if count[j] > 0 else two * abs(here[j])
        found[j] = both * both if known[j] else np.float32(0)


@compiled
def mark_line(line: Mask, out: Mask) -> None:
    """Write a line of marks."""
    for j in range(len(out)):
        out[j] = line[j]


# ---- noise averaged out along the slope -----------------------------------------------------


#: A neighbour counts s^2 / (s^2 + STEADY v), s^2 the noise and v the variance of the slope.
#: Anything from 3 to 25 does as well; below 1 fast motion is smeared.
STEADY = 6.0
#: The square of a mean is no less than this, so that its logarithm is finite.
SHORTEST = 1e-12
#: Frames before and after a frame that its average depends on: two, and one more so that at an
#: end of the recording there are three steps, over which slopes are averaged.
HALO = 3
#: Rows that are averaged at a time, and so many more around them: what is needed on the way takes
#: several times as much memory as the phase.
ROWS = 32
#: Rows of what `turned_mean` looks at.
HERE, BEFORE, SLOPE_BEFORE, AFTER, SLOPE_AFTER = 0, 1, 2, 3, 4

Fields = NDArray[np.complex64]


def along_slope(
    phase: Stack,
    valid: Mask,
    seams: NDArray[np.int8],
    noise: float,
    own: slice = slice(None),
) -> tuple[Stack, Stack]:
    """Return wrapped phase (time, angle, y, x) averaged with its neighbours along the slope.

    With z = exp(i phase) and, for the steps along one axis, m the mean of z[next] conj(z) over a
    box of three along every axis, d = m / |m| is the slope and v = -2 ln(|m| / exp(-noise^2)) how
    much it varies. z becomes the mean of itself and, for each neighbour along the axis, that
    neighbour turned back by d, which counts noise^2 / (noise^2 + 6 v): fully where the slope is
    steady, hardly where things move fast.

    Parameters
    ----------
    phase : ndarray of float32, shape (time, angle, y, x)
        Wrapped phase in radians.
    valid : ndarray of bool, same shape
        Pixels that count; others stay as they are.
    seams : ndarray of int, same shape
        Neighbours of different numbers are none.
    noise : float
        Standard deviation of the noise in radians.
    own : slice, optional
        The times that are asked for; the others are only what these depend on. Default all.

    Returns
    -------
    phase : ndarray of float32
        Wrapped phase of these times in radians with less noise.
    left : ndarray of float32
        Which share of the noise's variance is left at each pixel.
    """
    shape = phase[own].shape
    averaged, left = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    for rows in in_rows(shape[2]):
        around = slice(max(rows.start - HALO, 0), rows.stop + HALO)
        of_rows = average_rows(
            np.ascontiguousarray(phase[:, :, around]),
            np.ascontiguousarray(valid[:, :, around]),
            seams[:, :, around],
            noise,
        )
        inner = slice(rows.start - around.start, rows.stop - around.start)
        averaged[:, :, rows], left[:, :, rows] = (part[own][:, :, inner] for part in of_rows)
    return averaged, left


def in_rows(height: int) -> list[slice]:
    """Cut a frame into parts of about `ROWS` rows."""
    each = -(-height // max(height // ROWS, 1))
    return [slice(y, min(y + each, height)) for y in range(0, height, each)]


def average_rows(
    phase: Stack, valid: Mask, seams: NDArray[np.int8], noise: float
) -> tuple[Stack, Stack]:
    """Do `along_slope` for some rows and those around them."""
    z = phasors(phase)
    left = np.ones(phase.shape, dtype=np.float32)
    axes = [axis for axis in range(4) if phase.shape[axis] > 1]
    slopes: dict[int, Fields] = {}

    def measure(axis: int) -> None:
        slopes[axis] = slope_along(z, axis, valid, seams, noise)

    on_all_cores(measure, axes)
    for axis in axes:
        n = z.shape[axis]
        lines = (math.prod(z.shape[:axis]), n, math.prod(z.shape[axis + 1 :]))
        slope = slopes.pop(axis).reshape(lines[0], n - 1, lines[2])
        average(z.reshape(lines), slope, left.reshape(lines))
    averaged: Stack = np.where(valid, phase_of(z), phase)
    return averaged, left


def slope_along(
    z: Fields, axis: int, valid: Mask, seams: NDArray[np.int8], noise: float
) -> Fields:
    """Return the slope of every step along an axis: its length is how far it is to be used."""
    head, tail = ends_along(axis, 4)
    known = valid[head] & valid[tail] & (seams[head] == seams[tail])
    product: Fields = np.conj(z[head])
    product *= z[tail]
    weights = None
    if not known.all():
        keep_known(parts_of(product).reshape(known.size, 2), known.reshape(-1))
        weights = box_mean(known.astype(np.float32))
    slope: Fields = box_mean(product)
    if weights is None:
        weights = np.ones((1, 1), dtype=np.float32)
    lines = slope.reshape(-1, slope.shape[-1])
    use_of_slope(
        parts_of(lines),
        weights.reshape(-1, weights.shape[-1]),
        known.reshape(lines.shape),
        np.float32(noise**2),
    )
    return slope


@compiled
def keep_known(parts: Stack, known: Mask) -> None:
    """Make numbers zero that are not known; each has a real and an imaginary part."""
    for i in range(len(known)):
        parts[i, 0] = parts[i, 0] if known[i] else np.float32(0)
        parts[i, 1] = parts[i, 1] if known[i] else np.float32(0)


@vectorized
def use_of_slope(parts: Stack, weights: Stack, known: Mask, variance: np.float32) -> None:
    """Turn mean products (line, place) into slopes as long as they are to be used, in place.

    Real and imaginary parts take turns.
    """
    one, none = np.float32(1), np.float32(0)
    height, width = known.shape
    whole = weights.size == 1
    for y in range(height):
        for x in range(width):
            weight = one if whole else max(weights[y, x], np.float32(LEAST_WEIGHT))
            real, imag = parts[y, 2 * x] / weight, parts[y, 2 * x + 1] / weight
            square = max(real * real + imag * imag, np.float32(SHORTEST))
            varies = min(np.log(square) + 2 * variance, none)
            share = variance / (np.sqrt(square) * (variance - np.float32(STEADY) * varies))
            share = share if known[y, x] else none
            parts[y, 2 * x], parts[y, 2 * x + 1] = real * share, imag * share


def average(z: Fields, slope: Fields, left: Stack) -> None:
    """Average phasors (outer, place, inner) with both neighbours turned by the slope, in place."""
    outer, n, inner = z.shape
    if inner == 1:
        along = slope.reshape(outer, n - 1).view(np.float32)
        average_along(z.reshape(outer, n).view(np.float32), along, left.reshape(outer, n))
    else:
        average_across(z.view(np.float32), slope.view(np.float32), left)


@compiled
def average_along(z: Stack, slope: Stack, left: Stack) -> None:
    """Do `average` for lines of parts (line, place) that take turns."""
    n = left.shape[1]
    around = np.zeros((5, 2 * n), np.float32)
    mean, factor = np.empty(2 * n, np.float32), np.empty(n, np.float32)
    last = 2 * n - 2
    for line in range(len(z)):
        row, own = z[line], slope[line]
        copy_line(row, around[HERE])
        copy_line(row[:last], around[BEFORE, 2:])
        copy_line(row[2:], around[AFTER, :last])
        copy_line(own, around[SLOPE_BEFORE, 2:])
        copy_line(own, around[SLOPE_AFTER, :last])
        turned_mean(around, n, mean, factor)
        copy_line(mean, row)
        times_line(factor, left[line])


@compiled
def average_across(z: Stack, slope: Stack, left: Stack) -> None:
    """Do `average` for parts (outer, place, inner) that take turns, some inner at a time."""
    outer, n, both = z.shape
    around = np.zeros((5, 2 * AT_A_TIME), np.float32)
    mean, factor = np.empty(2 * AT_A_TIME, np.float32), np.empty(AT_A_TIME, np.float32)
    for o in range(outer):
        for start in range(0, both, 2 * AT_A_TIME):
            stop = min(start + 2 * AT_A_TIME, both)
            size = stop - start
            around[BEFORE] = 0
            around[SLOPE_BEFORE] = 0
            copy_line(z[o, 0, start:stop], around[HERE, :size])
            for i in range(n):
                if i + 1 < n:
                    copy_line(z[o, i + 1, start:stop], around[AFTER, :size])
                    copy_line(slope[o, i, start:stop], around[SLOPE_AFTER, :size])
                else:
                    around[AFTER] = 0
                    around[SLOPE_AFTER] = 0
                turned_mean(around, size // 2, mean, factor)
                copy_line(mean[:size], z[o, i, start:stop])
                times_line(factor[: size // 2], left[o, i, start // 2 : stop // 2])
                copy_line(around[HERE, :size], around[BEFORE, :size])
                copy_line(around[AFTER, :size], around[HERE, :size])
                copy_line(around[SLOPE_AFTER, :size], around[SLOPE_BEFORE, :size])


@unchecked
def turned_mean(around: Stack, n: int, mean: Stack, factor: Stack) -> None:
    """Write means of phasors and their neighbours, and which share of the noise is left.

    Parameters
    ----------
    around : ndarray of float32, shape (5, 2 n)
        The phasors, those before and after, and the slopes to either; 0 where there is none. Real
        and imaginary parts take turns. One array, so that the loop works on several at a time.
    n : int
        How many there are.
    mean, factor : ndarray of float32
        Where it goes.
    """
    one = np.float32(1)
    for j in range(n):
        real, imag = around[HERE, 2 * j], around[HERE, 2 * j + 1]
        z_real, z_imag = around[BEFORE, 2 * j], around[BEFORE, 2 * j + 1]
        s_real, s_imag = around[SLOPE_BEFORE, 2 * j], around[SLOPE_BEFORE, 2 * j + 1]
        real += z_real * s_real - z_imag * s_imag
        imag += z_real * s_imag + z_imag * s_real
        square = s_real * s_real + s_imag * s_imag
        weight, squares = one + np.sqrt(square), one + square
        z_real, z_imag = around[AFTER, 2 * j], around[AFTER, 2 * j + 1]
        s_real, s_imag = around[SLOPE_AFTER, 2 * j], around[SLOPE_AFTER, 2 * j + 1]
        real += z_real * s_real + z_imag * s_imag
        imag += z_imag * s_real - z_real * s_imag
        square = s_real * s_real + s_imag * s_imag
        weight, squares = weight + np.sqrt(square), squares + square
        share = one / weight
        factor[j] = squares * share * share
        mean[2 * j], mean[2 * j + 1] = real * share, imag * share


@compiled
def times_line(line: Stack, out: Stack) -> None:
    """Multiply by a line, in place."""
    for j in range(len(out)):
        out[j] *= line[j]
