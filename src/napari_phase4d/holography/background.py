"""What the empty field round the object tells: tilt, curvature and drift."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["background_offset", "fit_background", "flat_share", "mode_phase"]

Real = TypeVar("Real", np.float32, np.float64)

#: Background pixels deviate from the fit by less than this, in radians; first a generous limit.
LIMITS_RAD = (1.5, 1.2, 1.0, 0.8, 0.8, 0.6, 0.6)
#: The same for the constant phase of one frame.
OFFSET_LIMITS_RAD = (1.0, 0.6, 0.5)
#: Bins of the phase histogram whose peak is the background.
BINS = 72
#: Finer bins in each of them, in which the median near the peak is found.
FINE_BINS = 64
#: How many of them on either side of the peak the median is taken from: 0.5 rad.
PEAK_REACH = round(0.5 / (2 * np.pi) * BINS * FINE_BINS)
#: What smooths the histogram.
KERNEL = np.exp(-0.5 * (np.arange(-4, 5) / 2.0) ** 2)
#: How far from the background's phase a pixel counts as background, in radians.
FLAT_RAD = 0.8
#: Below this share of background pixels nothing is fitted or removed.
ENOUGH_BACKGROUND = 0.15


def fit_background(fields: NDArray[np.complex64], order: int) -> NDArray[np.float32]:
    """Fit a polynomial to the phase of the background.

    The background is what most frames have in common: the fields are averaged after their
    constant phases have been aligned, a tilt is guessed from the median wrapped difference of
    neighbours, and a polynomial is fitted to the pixels near the most frequent phase, again and
    again with a tighter limit.

    Parameters
    ----------
    fields : ndarray of shape (frame, y, x)
        Complex fields of one view.
    order : int
        1 for tilt, 2 for tilt and curvature, 0 for nothing.

    Returns
    -------
    ndarray of shape (y, x)
        Phase in radians with mean 0, to be subtracted.
    """
    mean = aligned_mean(fields)
    surface = np.zeros(mean.shape)
    if order == 0:
        return surface.astype(np.float32)
    y, x = (np.linspace(-1, 1, n) for n in mean.shape)
    grid_y, grid_x = np.broadcast_arrays(y[:, None], x[None, :])
    unit = mean / np.maximum(np.abs(mean), np.finfo(np.float32).tiny)
    phase = np.angle(unit).astype(np.float64)
    surface += grid_y * slope(unit, 0) + grid_x * slope(unit, 1)
    for i, limit in enumerate(LIMITS_RAD):
        residual = wrapped(phase - surface)
        residual = wrapped(residual - mode_phase(residual))
        near = joined_to_the_border(np.abs(residual) < limit)
        if near.mean() < ENOUGH_BACKGROUND:
            break
        surface += fitted(residual, near, grid_y, grid_x, min(order, 1 + (i >= 2)))
    centred: NDArray[np.float32] = (surface - surface.mean()).astype(np.float32)
    return centred


def joined_to_the_border(near: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Keep the pixels that the border can reach.

    Inside a thick object the phase comes back to that of the background at every turn; the
    object's steep rim keeps those places apart from it.
    """
    labels, _ = ndimage.label(near)
    edges = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    joined = np.zeros(labels.max() + 1, dtype=bool)
    joined[edges] = True
    joined[0] = False
    return joined[labels] if joined.any() else near


def aligned_mean(fields: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return the mean over frames after each has been turned to agree with the first."""
    first = fields[0]
    total = first.copy()
    for field in fields[1:]:
        overlap = np.vdot(first, field)
        total += field * np.complex64(np.exp(-1j * np.angle(overlap)))
    mean: NDArray[np.complex64] = total / np.float32(len(fields))
    return mean


def slope(unit: NDArray[np.complexfloating], axis: int) -> float:
    """Return the phase from the middle to the edge of a tilt, by the median wrapped difference."""
    ahead = np.roll(unit, -1, axis)
    steps = np.angle(ahead * unit.conj())
    steps = np.delete(steps, -1, axis)
    half_width: float = (unit.shape[axis] - 1) / 2
    return float(np.median(steps)) * half_width


def mode_phase(phase: NDArray[np.float32] | NDArray[np.float64]) -> float:
    """Return the most frequent phase: the peak of a smoothed circular histogram.

    The peak is made exact by the median of the phases near it, which is read off a finer
    histogram: partitioning the pixels would take several times as long.
    """
    n_fine = BINS * FINE_BINS
    width = 2 * np.pi / n_fine
    places = ((phase + np.pi) * (1 / width)).astype(np.intp)
    fine = np.bincount(places.ravel(), minlength=n_fine + 1)
    fine[-2] += fine[-1]  # the phase pi itself
    counts = fine[:-1].reshape(BINS, FINE_BINS).sum(axis=1)
    smooth = np.convolve(np.concatenate([counts[-4:], counts, counts[:4]]), KERNEL, "valid")
    start = int(smooth.argmax()) * FINE_BINS + FINE_BINS // 2 - PEAK_REACH
    near = fine[:-1].take(np.arange(start, start + 2 * PEAK_REACH), mode="wrap")
    return (start + middle(near)) * width - np.pi


def middle(counts: NDArray[np.integer]) -> float:
    """Return the bin, and how far into it, at which half of the counts are reached."""
    below = np.concatenate([[0], np.cumsum(counts)])
    if not below[-1]:
        return len(counts) / 2
    return float(np.interp(below[-1] / 2, below, np.arange(len(below))))


def wrapped(phase: NDArray[Real]) -> NDArray[Real]:
    """Return phases between -pi and pi."""
    result: NDArray[Real] = phase - 2 * np.pi * np.rint(phase * (0.5 / np.pi))
    return result


def fitted(
    residual: NDArray[np.floating],
    near: NDArray[np.bool_],
    y: NDArray[np.float64],
    x: NDArray[np.float64],
    order: int,
) -> NDArray[np.float64]:
    """Return the least-squares polynomial through the background pixels."""
    terms = [np.ones_like(y), y, x]
    if order >= 2:
        terms += [y**2, y * x, x**2]
    matrix = np.stack([t.ravel() for t in terms])
    weighed = matrix * near.ravel()
    normal, right = weighed @ matrix.T, weighed @ residual.ravel()
    coefficients, *_ = np.linalg.lstsq(normal, right, rcond=None)
    surface: NDArray[np.float64] = (coefficients @ matrix).reshape(near.shape)
    return surface


def background_offset(
    field: NDArray[np.complex64], phase: NDArray[np.float32] | None = None
) -> float:
    """Return the phase of the background: its complex mean round the most frequent phase.

    Parameters
    ----------
    field : ndarray of shape (y, x)
        Complex field, tilt already removed.
    phase : ndarray of shape (y, x), optional
        The field's phase, where it is known already.

    Returns
    -------
    float
        Radians in (-pi, pi].
    """
    if phase is None:
        phase = np.angle(field)
    start = mode_phase(phase)
    away, shift = wrapped(phase - start), 0.0
    for limit in OFFSET_LIMITS_RAD:
        near = np.abs(away - shift) < limit
        if not near.any():
            break
        shift = float(np.angle(field.sum(where=near) * np.exp(-1j * start)))
    return math.remainder(start + shift, 2 * math.pi)


def flat_share(phase: NDArray[np.float32], offset: float) -> float:
    """Return the share of pixels within 0.8 rad of the background's phase."""
    return np.count_nonzero(np.abs(wrapped(phase - offset)) < FLAT_RAD) / phase.size
