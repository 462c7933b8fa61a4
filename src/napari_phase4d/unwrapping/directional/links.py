"""Links along time and angle: what changes from frame to frame, unwrapped as a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.spatial import unwrap_frame

__all__ = ["link_map"]

TURN = np.float32(2 * np.pi)
#: Changes that stay below this many radians everywhere can't have passed half a turn unseen.
SURE = 2.0

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]


def link_map(step: Stack, valid: Mask, bare: Mask) -> Stack:
    """Return wrapped changes between frames with the turns that make each map smooth.

    A change of more than half a turn between two frames can't be told from a smaller one at any
    single pixel. As a map it can: it is zero on the empty field and rises from there. So where
    changes come near half a turn, the map is unwrapped over y and x like a frame, and its level
    is that of the empty field.

    Parameters
    ----------
    step : ndarray of shape (time, angle, y, x)
        Wrapped changes in radians.
    valid, bare : ndarray of bool, same shape
        Where both ends count; where both are empty field.
    """
    found = step.copy()
    for frame in np.ndindex(*step.shape[:2]):
        inside = valid[frame]
        if not inside.any() or np.abs(step[frame][inside]).max() <= SURE:
            continue
        whole, _ = unwrap_frame(step[frame], inside)
        turns = np.round((whole - step[frame]) / TURN)
        ground = bare[frame] & inside
        if not ground.any():
            ground = inside
        level = np.round(np.median(turns[ground]))
        found[frame] = np.where(inside, step[frame] + TURN * (turns - level), step[frame])
    return found
