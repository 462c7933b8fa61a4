"""Noise averaged out along the slope: phasors of neighbours, each turned by the local slope."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import on_all_cores
from napari_phase4d.unwrapping.compiling import compiled
from napari_phase4d.unwrapping.directional.boxes import known_mean
from napari_phase4d.unwrapping.ends import ends_along

__all__ = ["along_slope"]

#: A neighbour counts s^2 / (s^2 + STEADY v), s^2 the noise and v the variance of the slope.
#: Anything from 3 to 25 does as well; below 1 fast motion is smeared.
STEADY = 6.0
#: Means are no shorter than this, so that their logarithm is finite.
SHORTEST = 1e-6

Stack = NDArray[np.float32]
Fields = NDArray[np.complex64]
Mask = NDArray[np.bool_]


def along_slope(phase: Stack, valid: Mask, seams: NDArray[np.int8], noise: float) -> Stack:
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
    """
    z = phasors(phase)
    axes = [axis for axis in range(4) if phase.shape[axis] > 1]
    slopes: dict[int, Fields] = {}

    def measure(axis: int) -> None:
        slopes[axis] = slope_along(z, axis, valid, seams, noise)

    on_all_cores(measure, axes)
    for axis in axes:
        n = z.shape[axis]
        lines = (math.prod(z.shape[:axis]), n, math.prod(z.shape[axis + 1 :]))
        average(z.reshape(lines), slopes.pop(axis).reshape(lines[0], n - 1, lines[2]))
    return np.where(valid, np.angle(z), phase)


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
    weighted(slope.ravel(), known.ravel(), noise**2)
    return slope


@compiled
def weighted(slope: NDArray[Any], known: Mask, variance: float) -> None:
    """Give each mean phasor, in place, the length that its steadiness is worth."""
    for i in range(len(slope)):
        m = slope[i]
        length = max(math.sqrt(m.real * m.real + m.imag * m.imag), SHORTEST)
        if not known[i]:
            slope[i] = 0
            continue
        varies = max(0.0, -2 * math.log(length) - 2 * variance)
        slope[i] = m * np.float32(variance / (variance + STEADY * varies) / length)


@compiled
def average(z: NDArray[Any], slope: NDArray[Any]) -> None:
    """Average phasors (outer, place, inner) with both neighbours turned by the slope, in place."""
    outer, n, inner = z.shape
    before = np.empty(inner, dtype=z.dtype)
    for o in range(outer):
        for j in range(inner):
            before[j] = 0
        for i in range(n):
            for j in range(inner):
                here = z[o, i, j]
                total, weight = here, np.float32(1)
                if i > 0:
                    s = slope[o, i - 1, j]
                    total += before[j] * s
                    weight += abs(s)
                if i + 1 < n:
                    s = slope[o, i, j]
                    total += z[o, i + 1, j] * np.conj(s)
                    weight += abs(s)
                z[o, i, j] = total / weight
                before[j] = here
