"""Noise averaged out along the slope: phasors of neighbours, each turned by the local slope."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.progress import on_all_cores
from napari_phase4d.unwrapping.boxes import known_mean
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
    averaged: Stack = np.where(valid, np.arctan2(z.imag, z.real), phase)
    return averaged, left


def phasors(phase: Stack) -> Fields:
    """Return exp(i phase)."""
    z = np.empty(phase.shape, dtype=np.complex64)
    np.cos(phase, out=z.real)
    np.sin(phase, out=z.imag)
    return z


def slope_along(
    z: Fields, axis: int, valid: Mask, seams: NDArray[np.int8], noise: float
) -> Fields:
    """Return the slope of every step along an axis: its length is how far it is to be used."""
    head, tail = ends_along(axis, 4)
    known = valid[head] & valid[tail] & (seams[head] == seams[tail])
    product = np.conj(z[head])
    product *= z[tail]
    if not known.all():
        product *= known
    slope = known_mean(product, known)
    square = slope.real * slope.real
    square += slope.imag * slope.imag
    np.maximum(square, np.float32(SHORTEST), out=square)
    varies = np.log(square)
    varies += np.float32(2 * noise**2)
    np.minimum(varies, 0, out=varies)
    varies *= np.float32(-STEADY)
    varies += np.float32(noise**2)
    np.sqrt(square, out=square)
    square *= varies
    share = np.divide(np.float32(noise**2), square, out=square)
    if not known.all():
        share *= known
    weighted: Fields = slope * share
    return weighted


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
