"""What the mouse takes hold of on the spectrum, and what becomes of it when it is dragged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from napari_phase4d.holography import Lobe

__all__ = ["Hold", "dragged", "grown", "hold_at", "nudged"]

#: Circles can't get smaller or larger than this, in cycles per pixel.
RADII = (0.005, 0.5)


@dataclass(frozen=True)
class Hold:
    """What the mouse holds of which view, and where it took it.

    Parameters
    ----------
    index : int
        The view, counted from 0.
    action : str
        "move" or "resize".
    beside : tuple of float
        (ky, kx) from the mouse to the carrier, so that a circle does not jump when it is taken.
    short : float
        How much farther than the mouse the line is from the carrier, for the same reason.
    """

    index: int
    action: str
    beside: tuple[float, float]
    short: float


def hold_at(
    lobes: Sequence[Lobe], frequency: tuple[float, float], grip: float, chosen: int = -1
) -> Hold | None:
    """Return what a drag from a frequency would hold.

    Parameters
    ----------
    lobes : sequence of Lobe
        The views.
    frequency : tuple of float
        (ky, kx) under the mouse, in cycles per pixel.
    grip : float
        How near to its line the mouse takes the line of a circle, in cycles per pixel.
    chosen : int, optional
        The view that comes first where circles overlap; else the nearest does.

    Returns
    -------
    Hold or None
        None beside all circles.
    """
    found: list[tuple[bool, float, Hold]] = []
    for index, lobe in enumerate(lobes):
        beside = (lobe.carrier[0] - frequency[0], lobe.carrier[1] - frequency[1])
        distance = float(np.hypot(*beside))
        on_line = abs(distance - lobe.radius) < min(grip, lobe.radius / 2)
        if on_line or distance < lobe.radius:
            action = "resize" if on_line else "move"
            hold = Hold(index, action, beside, lobe.radius - distance)
            found.append((index != chosen, distance, hold))
    return min(found, key=lambda each: each[:2])[2] if found else None


def dragged(lobe: Lobe, hold: Hold, frequency: tuple[float, float]) -> Lobe:
    """Return the view that is held, with the mouse at a frequency (ky, kx)."""
    ky, kx = frequency
    if hold.action == "move":
        return replace(lobe, carrier=within(ky + hold.beside[0], kx + hold.beside[1]))
    out = float(np.hypot(ky - lobe.carrier[0], kx - lobe.carrier[1]))
    return replace(lobe, radius=float(np.clip(out + hold.short, *RADII)))


def nudged(lobe: Lobe, ky: float, kx: float) -> Lobe:
    """Return a view moved by (ky, kx)."""
    return replace(lobe, carrier=within(lobe.carrier[0] + ky, lobe.carrier[1] + kx))


def grown(lobe: Lobe, factor: float) -> Lobe:
    """Return a view with a larger or smaller circle."""
    return replace(lobe, radius=float(np.clip(lobe.radius * factor, *RADII)))


def within(ky: float, kx: float) -> tuple[float, float]:
    """Return the nearest carrier within the spectrum."""
    return float(np.clip(ky, -0.5, 0.5)), float(np.clip(kx, -0.5, 0.5))
