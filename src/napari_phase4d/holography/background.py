"""What the empty field round the object tells: tilt, curvature, aberrations and drift."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.holography.aberrations import surface_of, terms_at
from napari_phase4d.progress import nothing

__all__ = [
    "ENOUGH_BACKGROUND",
    "Surface",
    "aligned_to",
    "background_offset",
    "fit_background",
    "fitted_surface",
    "flat_share",
    "mode_phase",
]

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
#: Slopes are fitted to about so many pixels, so many times over.
SLOPE_PIXELS, SLOPE_ROUNDS = 40_000, 12
#: A surface with more terms than a tilt has is fitted to about so many pixels at least.
SURFACE_PIXELS = 100_000


def fit_background(
    fields: NDArray[np.complex64], order: int, kind: str = "powers"
) -> NDArray[np.float32]:
    """Fit a surface to the phase of the background.

    The background is what most frames have in common: the fields are averaged after their
    constant phases have been aligned, a first surface is guessed from the wrapped differences of
    neighbours, and the surface is fitted to the pixels near the most frequent phase, again and
    again with a tighter limit.

    Parameters
    ----------
    fields : ndarray of shape (frame, y, x)
        Complex fields of one view.
    order : int
        Degree of the surface: 1 for tilt, 2 for tilt and curvature, up to 8; 0 for nothing.
    kind : str, optional
        "powers" (default, up to order 2), "polynomial" or "zernike"; see `fitted_surface`.

    Returns
    -------
    ndarray of shape (y, x)
        Phase in radians with mean 0, to be subtracted.
    """
    return fitted_surface(fields, order, kind)[0]


def fitted_surface(
    fields: NDArray[np.complex64], order: int, kind: str
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return what `fit_background` does, and the coefficients of the terms in radians.

    A plain tilt begins with the median difference of neighbours. All else begins with a robust
    fit of the slopes, since strong curvature or coma leaves no one tilt to begin with.
    """
    mean = aligned_mean(fields)
    return Surface(kind, order, mean.shape).fitted_to(mean)


@dataclass(frozen=True)
class Surface:
    """Surfaces of one kind, to be fitted to the views of one size; the terms are made once.

    Fitted is what is seen on every so-manieth row and column of a large field, so that memory and
    time don't grow with it; a tilt takes so little that it is fitted to every pixel.

    Parameters
    ----------
    kind : str
        "powers", "polynomial" or "zernike".
    order : int
        The degree; 0 for nothing.
    shape : tuple of int
        Height and width in pixels.
    """

    kind: str
    order: int
    shape: tuple[int, ...]

    @property
    def is_tilt(self) -> bool:
        """Whether it has no more terms than a tilt."""
        return self.kind == "powers" and self.order == 1

    @property
    def thin(self) -> int:
        """Of so many rows and columns one is fitted to."""
        size = math.prod(self.shape)
        return 1 if self.is_tilt else max(1, math.isqrt(size // SURFACE_PIXELS))

    @cached_property
    def terms(self) -> NDArray[np.float64]:
        """The terms on the thinned grid, (term, y, x)."""
        return self._terms_on(*(slice(None, None, self.thin) for _ in self.shape))

    @cached_property
    def slopes(self) -> NDArray[np.float64]:
        """What the terms change by from a pixel to its neighbours, (term, pixel)."""
        steps = []
        for axis in (0, 1):
            ahead, here = neighbours(axis, self.shape)
            step = self._terms_on(*ahead) - self._terms_on(*here)
            steps.append(step.reshape(len(step), -1))
        return np.concatenate(steps, axis=1)

    def _terms_on(self, rows: slice, columns: slice) -> NDArray[np.float64]:
        """Return the terms on some rows and columns."""
        y, x = (np.linspace(-1, 1, n) for n in self.shape)
        return terms_at(self.kind, self.order, y[rows], x[columns], self.shape)

    def fitted_to(
        self, mean: NDArray[np.complex64], check: Callable[[], None] = nothing
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Return the surface that fits the phase of a field's background, and its coefficients.

        Parameters
        ----------
        mean : ndarray of shape (y, x)
            The field.
        check : callable, optional
            Called between rounds; what it raises ends the work.
        """
        if self.order == 0:
            return np.zeros(mean.shape, dtype=np.float32), np.zeros(0)
        unit = mean / np.maximum(np.abs(mean), np.finfo(np.float32).tiny)
        phase = np.angle(unit[:: self.thin, :: self.thin]).astype(np.float64)
        found = first_tilt(unit) if self.is_tilt else fitted_slopes(unit, self.slopes, check)
        for limit in LIMITS_RAD:
            check()
            residual = wrapped(phase - np.tensordot(found, self.terms, 1))
            residual = wrapped(residual - mode_phase(residual))
            near = joined_to_the_border(np.abs(residual) < limit)
            if near.mean() < ENOUGH_BACKGROUND:
                break
            found += fitted(residual, near, self.terms)
        surface = (
            np.tensordot(found, self.terms, 1)
            if self.thin == 1
            else surface_of(found, self.kind, self.order, self.shape)
        )
        centred: NDArray[np.float32] = (surface - surface.mean()).astype(np.float32)
        return centred, found


def neighbours(
    axis: int, shape: tuple[int, ...]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return where pixels are, not too many, and where those before them along an axis."""
    thin = max(1, math.isqrt(math.prod(shape) // SLOPE_PIXELS))
    ahead, here, all_along = slice(1, None, thin), slice(0, -1, thin), slice(0, None, thin)
    if axis == 0:
        return (ahead, all_along), (here, all_along)
    return (all_along, ahead), (all_along, here)


def first_tilt(unit: NDArray[np.complexfloating]) -> NDArray[np.float64]:
    """Return the coefficients of 1, y and x that median differences give."""
    return np.array([0.0, slope(unit, 0), slope(unit, 1)])


def fitted_slopes(
    unit: NDArray[np.complexfloating],
    matrix: NDArray[np.float64],
    check: Callable[[], None] = nothing,
) -> NDArray[np.float64]:
    """Return the coefficients whose slopes fit the wrapped differences of neighbours best.

    Differences need no unwrapping. The object's are left out by Tukey's biweight, with a limit of
    4.685 standard deviations, which are told by the median (Huber & Ronchetti, Robust
    Statistics).
    """
    pairs = (neighbours(axis, unit.shape) for axis in (0, 1))
    steps = [np.angle(unit[ahead] * unit[here].conj()).ravel() for ahead, here in pairs]
    step = np.concatenate(steps).astype(np.float64)
    weights: NDArray[np.float64] = np.ones(step.size)
    found: NDArray[np.float64] = np.zeros(len(matrix))
    for _ in range(SLOPE_ROUNDS):
        check()
        found = solved(matrix, weights, step)
        rest = wrapped(step - found @ matrix)
        limit = 4.685 * 1.4826 * max(float(np.median(np.abs(rest))), 1e-6)
        weights = np.maximum(1 - (rest / limit) ** 2, 0) ** 2
    return found


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
        total += aligned_to(first, field)
    mean: NDArray[np.complex64] = total / np.float32(len(fields))
    return mean


def aligned_to(
    first: NDArray[np.complex64], field: NDArray[np.complex64]
) -> NDArray[np.complex64]:
    """Return a field turned so that its constant phase agrees with that of the first."""
    overlap = np.vdot(first, field)
    turned: NDArray[np.complex64] = field * np.complex64(np.exp(-1j * np.angle(overlap)))
    return turned


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
    residual: NDArray[np.floating], near: NDArray[np.bool_], terms: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the least-squares coefficients of terms (term, y, x) at the background pixels."""
    return solved(terms.reshape(len(terms), -1), near.ravel(), residual.ravel())


def solved(
    matrix: NDArray[np.float64], weights: NDArray[Any], values: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return the coefficients of terms (term, pixel) that fit weighted values (pixel) best."""
    weighed = matrix * weights
    found: NDArray[np.float64] = np.linalg.lstsq(weighed @ matrix.T, weighed @ values, rcond=None)[
        0
    ]
    return found


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
