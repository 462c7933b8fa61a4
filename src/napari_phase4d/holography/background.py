"""What the empty field round the object tells: tilt, curvature and drift."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["background_offset", "fit_background", "flat_share", "mode_phase"]

#: Background pixels deviate from the fit by less than this, in radians; first a generous limit.
LIMITS_RAD = (1.5, 1.2, 1.0, 0.8, 0.8, 0.6, 0.6)
#: The same for the constant phase of one frame.
OFFSET_LIMITS_RAD = (1.0, 0.6, 0.5)
#: Bins of the phase histogram whose peak is the background.
BINS = 72
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
    surface += grid_y * slope(unit, 0) + grid_x * slope(unit, 1)
    for i, limit in enumerate(LIMITS_RAD):
        residual = np.angle(unit * np.exp(-1j * surface))
        residual = np.angle(np.exp(1j * (residual - mode_phase(residual))))
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
    reached = np.isin(labels, np.unique(edges[edges > 0]))
    return reached if reached.any() else near


def aligned_mean(fields: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return the mean over frames after each has been turned to agree with the first."""
    first = fields[0]
    total = first.astype(np.complex128)
    for field in fields[1:]:
        overlap = np.vdot(first, field)
        total += field * np.exp(-1j * np.angle(overlap))
    mean: NDArray[np.complex64] = (total / len(fields)).astype(np.complex64)
    return mean


def slope(unit: NDArray[np.complexfloating], axis: int) -> float:
    """Return the phase from the middle to the edge of a tilt, by the median wrapped difference."""
    ahead = np.roll(unit, -1, axis)
    steps = np.angle(ahead * unit.conj())
    steps = np.delete(steps, -1, axis)
    half_width: float = (unit.shape[axis] - 1) / 2
    return float(np.median(steps)) * half_width


def mode_phase(phase: NDArray[np.floating]) -> float:
    """Return the most frequent phase: the peak of a smoothed circular histogram."""
    counts, edges = np.histogram(phase, BINS, range=(-np.pi, np.pi))
    kernel = np.exp(-0.5 * (np.arange(-4, 5) / 2.0) ** 2)
    smooth = np.convolve(np.concatenate([counts[-4:], counts, counts[:4]]), kernel, "valid")
    peak = float(edges[int(smooth.argmax())] + np.pi / BINS)
    near = np.angle(np.exp(1j * (phase - peak)))
    inside = np.abs(near) < 0.5
    return peak + (float(np.median(near[inside])) if inside.any() else 0.0)


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
    matrix = np.stack([t[near] for t in terms], axis=1)
    coefficients, *_ = np.linalg.lstsq(matrix, residual[near], rcond=None)
    surface: NDArray[np.float64] = np.tensordot(coefficients, np.stack(terms), axes=1)
    return surface


def background_offset(field: NDArray[np.complex64]) -> float:
    """Return the phase of the background: its complex mean round the most frequent phase.

    Parameters
    ----------
    field : ndarray of shape (y, x)
        Complex field, tilt already removed.

    Returns
    -------
    float
        Radians in (-pi, pi].
    """
    phase = np.angle(field)
    centre = mode_phase(phase)
    for limit in OFFSET_LIMITS_RAD:
        near = np.abs(np.angle(np.exp(1j * (phase - centre)))) < limit
        if not near.any():
            break
        centre = float(np.angle(field[near].sum(dtype=np.complex128)))
    return centre


def flat_share(field: NDArray[np.complex64], offset: float) -> float:
    """Return the share of pixels within 0.8 rad of the background's phase."""
    return float((np.abs(np.angle(field * np.exp(-1j * offset))) < 0.8).mean())
