"""Wrapped phase and its most frequent value, and sums of terms fitted to it."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = [
    "FINE_RAD",
    "N_FINE",
    "fitted",
    "joined_to_the_border",
    "mode_phase",
    "peak_of",
    "solved",
    "wrapped",
]

Real = TypeVar("Real", np.float32, np.float64)

#: Bins of the phase histogram whose peak is the background.
BINS = 72
#: Finer bins in each of them, in which the median near the peak is found.
FINE_BINS = 64
#: So many of them in all, each so wide.
N_FINE = BINS * FINE_BINS
FINE_RAD = 2 * np.pi / N_FINE
#: How many of them on either side of the peak the median is taken from: 0.5 rad.
PEAK_REACH = round(0.5 / (2 * np.pi) * BINS * FINE_BINS)
#: What smooths the histogram.
KERNEL = np.exp(-0.5 * (np.arange(-4, 5) / 2.0) ** 2)


def mode_phase(phase: NDArray[np.float32] | NDArray[np.float64]) -> float:
    """Return the most frequent phase: the peak of a smoothed circular histogram."""
    places = ((phase + np.pi) * (1 / FINE_RAD)).astype(np.intp)
    return peak_of(np.bincount(places.ravel(), minlength=N_FINE + 1))


def peak_of(counts: NDArray[np.integer]) -> float:
    """Return the most frequent phase of a histogram from -pi to pi.

    The peak is made exact by the median of the phases near it, which is read off the histogram,
    since its bins are narrow: partitioning the pixels would take several times as long.

    Parameters
    ----------
    counts : ndarray of shape (N_FINE + 1,)
        How many phases lie in each bin; the last is for the phase pi itself.
    """
    fine = counts[:-1].copy()
    fine[-1] += counts[-1]
    coarse = fine.reshape(BINS, FINE_BINS).sum(axis=1)
    smooth = np.convolve(np.concatenate([coarse[-4:], coarse, coarse[:4]]), KERNEL, "valid")
    start = int(smooth.argmax()) * FINE_BINS + FINE_BINS // 2 - PEAK_REACH
    near = fine.take(np.arange(start, start + 2 * PEAK_REACH), mode="wrap")
    return (start + middle(near)) * FINE_RAD - np.pi


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
