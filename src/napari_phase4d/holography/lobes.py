"""Lobes: the cross-correlation terms of a hologram in the Fourier plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.checks import check_bool, check_number, shown

__all__ = ["MAX_VIEWS", "Lobe", "canonical", "pair_distance", "wrapped_distance"]

#: Views that a hologram is taken to hold at most.
MAX_VIEWS = 6

#: (ky, kx) in cycles per pixel.
Frequency = Sequence[float] | NDArray[np.float64]


@dataclass(frozen=True)
class Lobe:
    """One view of the object: a disk round one carrier in the Fourier plane.

    Parameters
    ----------
    carrier : tuple of float
        ``(ky, kx)`` in cycles per camera pixel, each within [-0.5, 0.5].
    radius : float
        Radius of the disk that is cut out, in cycles per camera pixel, above 0 and at most 0.5.
    angle_deg : float
        Viewing angle in degrees. A hologram can't tell it; until it is given, views are numbered.
    flip : bool
        Whether to take the conjugate term instead, which changes the sign of the phase.
    doubt : str
        What `find_lobes` could not know of it, in a sentence; empty if nothing. It does not count
        where lobes are compared.

    Raises
    ------
    ValueError
        If the carrier or the radius lies outside the spectrum.

    See Also
    --------
    find_lobes : Finds them in a recording.
    reconstruct : Takes them.

    Examples
    --------
    >>> Lobe(carrier=(0.19, 0.21), radius=0.09, angle_deg=-7)
    Lobe(carrier=(0.19, 0.21), radius=0.09, angle_deg=-7, flip=False)
    """

    carrier: tuple[float, float]
    radius: float
    angle_deg: float = 0.0
    flip: bool = False
    doubt: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        ky, kx = carrier_of(self.carrier)
        check_number("the lobe radius", self.radius)
        check_number("angle_deg", self.angle_deg)
        check_bool("flip", self.flip)
        if not all(math.isfinite(k) and abs(k) <= 0.5 for k in (ky, kx)):
            msg = (
                f"the carrier ({ky:g}, {kx:g}) lies outside the spectrum, "
                "which ends at +-0.5 cycles/px"
            )
            raise ValueError(msg)
        if not (math.isfinite(self.radius) and 0 < self.radius <= 0.5):
            msg = f"the lobe radius must lie between 0 and 0.5 cycles/px, but is {self.radius:g}"
            raise ValueError(msg)
        if not math.isfinite(self.angle_deg):
            msg = f"the viewing angle must be a number of degrees, but is {self.angle_deg!r}"
            raise ValueError(msg)
        object.__setattr__(self, "carrier", (ky, kx))


def carrier_of(carrier: Any) -> tuple[float, float]:
    """Return a carrier as two numbers, or say that it is none."""
    try:
        ky, kx = (float(k) for k in carrier)
    except (TypeError, ValueError) as error:
        msg = f"carrier must be two numbers (ky, kx) in cycles per pixel, but is {shown(carrier)}"
        raise ValueError(msg) from error
    return ky, kx


def wrapped_distance(a: Frequency, b: Frequency) -> float:
    """Return the distance of two frequencies; a sampled spectrum repeats with period 1."""
    return math.hypot(*(d - round(d) for d in (a[0] - b[0], a[1] - b[1])))


def pair_distance(a: Frequency, b: Frequency) -> float:
    """Return the distance of a to b or to its conjugate -b, whichever is nearer."""
    return min(wrapped_distance(a, b), wrapped_distance(a, [-v for v in b]))


def canonical(carrier: Sequence[float], tolerance: float = 1e-9) -> tuple[float, float]:
    """Return the carrier or its conjugate: the one with kx > 0, or kx = 0 and ky > 0.

    A carrier on the ky axis, measured with some error, may come out on either side of it;
    within ``tolerance`` of the axis the sign of ky decides.
    """
    ky, kx = (float(k) - round(float(k)) for k in carrier)
    if kx < -tolerance or (abs(kx) <= tolerance and ky < 0):
        return -ky, -kx
    return ky, kx
