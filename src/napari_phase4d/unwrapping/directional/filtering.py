"""Noise averaged out along the slope: phasors of neighbours, each turned by the local slope."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.unwrapping.ends import ends_along

__all__ = ["along_slope"]

#: Width, along every axis, of the box in which the slope and its steadiness are measured.
BOX = 3
#: A neighbour counts s^2 / (s^2 + STEADY v), s^2 the noise and v the variance of the slope.
#: Anything from 3 to 25 does as well; below 1 fast motion is smeared.
STEADY = 6.0
#: Share of the weight of a box below which a mean counts as nothing.
LEAST_WEIGHT = 1e-3
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
    """
    z = np.exp(1j * phase).astype(np.complex64)
    filtered = z.copy()
    axes = [axis for axis in range(4) if phase.shape[axis] > 1]
    found = [slope_along(z, axis, valid, seams, noise) for axis in axes]
    for axis, (slope, share) in zip(axes, found, strict=True):
        head, tail = ends_along(axis, 4)
        total = filtered.copy()
        weight = np.ones(phase.shape, dtype=np.float32)
        total[head] += share * filtered[tail] * np.conj(slope)
        total[tail] += share * filtered[head] * slope
        weight[head] += share
        weight[tail] += share
        filtered = total / weight
    averaged: Stack = np.angle(filtered).astype(np.float32)
    return np.where(valid, averaged, phase)


def slope_along(
    z: Fields, axis: int, valid: Mask, seams: NDArray[np.int8], noise: float
) -> tuple[Fields, Stack]:
    """Return the slope of every step along an axis as a phasor, and how far it is to be used."""
    head, tail = ends_along(axis, 4)
    known = (valid[head] & valid[tail] & (seams[head] == seams[tail])).astype(np.float32)
    product = z[tail] * np.conj(z[head]) * known
    width = [BOX if n >= BOX else 1 for n in known.shape]

    def mean(part: Stack) -> Stack:
        found: Stack = ndimage.uniform_filter(part, width, mode="reflect")
        return found

    m = mean(product.real.copy()) + 1j * mean(product.imag.copy())
    m /= np.maximum(mean(known), np.float32(LEAST_WEIGHT))
    length = np.maximum(np.abs(m), np.float32(SHORTEST))
    varies = np.maximum(0, -2 * np.log(length) - 2 * noise**2)
    share = known * noise**2 / (noise**2 + STEADY * varies)
    return (m / length).astype(np.complex64), share.astype(np.float32)
