"""What is asked of a simulation, checked: its field, times, angles and microscope."""

from __future__ import annotations

from typing import Any

import numpy as np

from napari_phase4d.optics import Optics
from napari_phase4d.words import as_numbers, check_positive, check_type, shown

__all__ = ["check_asked", "check_optics", "is_count"]

#: No phantom is larger than this: pixels of all frames together.
MOST_PIXELS = 2**36


def check_asked(
    shape: Any, n_times: Any, angles_deg: Any, optics: Any = None, **lengths: Any
) -> None:
    """Raise TypeError or ValueError for a simulation that can't be.

    Parameters
    ----------
    shape : tuple of int
        Height and width in pixels.
    n_times : int
        Number of frames.
    angles_deg : sequence of float
        Viewing angles in degrees.
    optics : Optics or None
        The microscope.
    **lengths
        Numbers that must be above 0, by their names; None is left out, and of a pair both count.
    """
    sides = shape if isinstance(shape, (tuple, list, np.ndarray)) else ()
    if len(sides) != 2 or not all(is_count(side) for side in sides):
        msg = f"shape must be a height and a width in pixels, but is {shown(shape)}"
        raise ValueError(msg)
    if not is_count(n_times):
        msg = f"n_times must be a number of frames, 1 or more, but is {shown(n_times)}"
        raise ValueError(msg)
    angles = as_numbers("angles_deg", angles_deg)
    if angles.ndim != 1 or not angles.size or not np.isfinite(angles).all():
        msg = f"angles_deg must be a list of degrees, but is {shown(angles_deg)}"
        raise ValueError(msg)
    if (np.diff(angles) <= 0).any():
        msg = f"angles_deg must rise, but is {shown(angles_deg)}"
        raise ValueError(msg)
    if int(sides[0]) * int(sides[1]) * int(n_times) * angles.size > MOST_PIXELS:
        msg = f"{n_times} frames of {sides[0]} x {sides[1]} pixels are more than fit into memory"
        raise ValueError(msg)
    check_optics(optics)
    for name, value in lengths.items():
        for length in value if isinstance(value, (tuple, list)) else (value,):
            if length is not None:
                check_positive(name, length)


def check_optics(optics: Any) -> None:
    """Raise TypeError for what is no microscope; None is the usual one."""
    if optics is not None:
        check_type("optics", optics, Optics, "give Optics(wavelength_um=...)")


def is_count(value: Any) -> bool:
    """Say whether something is a whole number, 1 or more."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and value >= 1
