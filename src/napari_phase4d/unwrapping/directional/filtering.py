"""Noise averaged out along the slope: phasors of neighbours, each turned by the local slope."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, unchecked, vectorized
from napari_phase4d.phasors import parts_of, phase_of, phasors
from napari_phase4d.task import on_all_cores
from napari_phase4d.unwrapping.boxes import (
    AT_A_TIME,
    LEAST_WEIGHT,
    box_mean,
    copy_line,
    ends_along,
)

__all__ = ["HALO", "along_slope"]

#: A neighbour counts s^2 / (s^2 + STEADY v), s^2 the noise and v the variance of the slope.
#: Anything from 3 to 25 does as well; below 1 fast motion is smeared.
STEADY = 6.0
#: The square of a mean is no less than this, so that its logarithm is finite.
SHORTEST = 1e-12
#: Frames before and after a frame that its average depends on: two, and one more so that at an
#: end of the recording there are three steps, over which slopes are averaged.
HALO = 3
#: Rows of what `turned_mean` looks at.
HERE, BEFORE, SLOPE_BEFORE, AFTER, SLOPE_AFTER = 0, 1, 2, 3, 4

Stack = NDArray[np.float32]
Fields = NDArray[np.complex64]
Mask = NDArray[np.bool_]


def along_slope(
    phase: Stack, valid: Mask, seams: NDArray[np.int8], noise: float
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

    Returns
    -------
    phase : ndarray of float32
        Wrapped phase in radians with less noise.
    left : ndarray of float32
        Which share of the noise's variance is left at each pixel.
    """
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
