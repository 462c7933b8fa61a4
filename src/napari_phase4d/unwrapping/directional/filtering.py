"""Noise averaged out along the slope: phasors of neighbours, each turned by the local slope."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, vectorized
from napari_phase4d.phasors import parts_of, phase_of, phasors
from napari_phase4d.progress import on_all_cores
from napari_phase4d.unwrapping.boxes import LEAST_WEIGHT, box_mean
from napari_phase4d.unwrapping.ends import ends_along

__all__ = ["HALO", "along_slope"]

#: A neighbour counts s^2 / (s^2 + STEADY v), s^2 the noise and v the variance of the slope.
#: Anything from 3 to 25 does as well; below 1 fast motion is smeared.
STEADY = 6.0
#: The square of a mean is no less than this, so that its logarithm is finite.
SHORTEST = 1e-12
#: Frames before and after a frame that its average depends on: two, and one more so that at an
#: end of the recording there are three steps, over which slopes are averaged.
HALO = 3

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
        product *= known
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


@compiled
def average(z: NDArray[Any], slope: NDArray[Any], left: Stack) -> None:
    """Average phasors (outer, place, inner) with both neighbours turned by the slope, in place."""
    outer, n, inner = z.shape
    before = np.empty(inner, dtype=z.dtype)
    for o in range(outer):
        for j in range(inner):
            before[j] = 0
        for i in range(n):
            for j in range(inner):
                here = z[o, i, j]
                total, weight, squares = here, np.float32(1), np.float32(1)
                if i > 0:
                    s = slope[o, i - 1, j]
                    total += before[j] * s
                    square = s.real * s.real + s.imag * s.imag
                    weight += np.sqrt(square)
                    squares += square
                if i + 1 < n:
                    s = slope[o, i, j]
                    total += z[o, i + 1, j] * s.conjugate()
                    square = s.real * s.real + s.imag * s.imag
                    weight += np.sqrt(square)
                    squares += square
                share = np.float32(1) / weight
                left[o, i, j] *= squares * share * share
                z[o, i, j] = total * share
                before[j] = here
