"""Windows that cut a lobe out of the Fourier plane."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

__all__ = ["WINDOWS", "window_reach"]

Window = Callable[[NDArray[np.float64]], NDArray[np.float64]]

#: Width of the smooth disk's edge (standard deviation) as a share of the radius.
EDGE = 0.05
#: Share of a Tukey window's radius that is tapered.
TAPER = 0.25


def disk(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 up to the radius, 0 beyond."""
    return (rho <= 1).astype(np.float64)


def smooth_disk(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a disk with a Gaussian-blurred edge, 1/2 at the radius."""
    soft: NDArray[np.float64] = 0.5 * erfc((rho - 1) / (EDGE * np.sqrt(2)))
    return np.where(rho < 1 + 4 * EDGE, soft, 0.0)


def gaussian(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a Gaussian with a standard deviation of half the radius, cut off at the radius."""
    return np.where(rho <= 1, np.exp(-2 * rho**2), 0.0)


def tukey(rho: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1 up to three quarters of the radius, then a cosine down to 0 at the radius."""
    along = np.clip((rho - (1 - TAPER)) / TAPER, 0, 1)
    taper: NDArray[np.float64] = 0.5 * (1 + np.cos(np.pi * along))
    return taper


#: Window name -> function of (distance from the carrier / radius).
WINDOWS: dict[str, Window] = {
    "disk": disk,
    "smooth-disk": smooth_disk,
    "gaussian": gaussian,
    "tukey": tukey,
}


def window_reach(name: str) -> float:
    """Return how far a window reaches, in radii."""
    return 1 + 4 * EDGE if name == "smooth-disk" else 1.0
