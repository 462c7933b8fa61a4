"""Links along time and angle: what changes from frame to frame, unwrapped as a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.growing import Workspace
from napari_phase4d.unwrapping.spatial import unwrap_frame

__all__ = ["link_map"]

TURN = np.float32(2 * np.pi)
#: Changes that stay below this many radians everywhere can't have passed half a turn unseen.
SURE = 2.0

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]


def link_map(step: Stack, inside: Mask, bare: Mask) -> Stack:
    """Return wrapped changes between frames with the turns that make each map smooth.

    A change of more than half a turn between two frames can't be told from a smaller one at any
    single pixel. As a map it can: it is zero on the empty field and rises from there. So where
    changes come near half a turn, the map is unwrapped over y and x like a frame, and its level
    is that of the empty field.

    Parameters
    ----------
    step : ndarray of shape (time, angle, y, x)
        Wrapped changes in radians.
    inside, bare : ndarray of bool, same shape
        Where both ends count; where both are empty field.

    Returns
    -------
    ndarray
        The changes in radians, which may be larger than half a turn.
    """
    found, work = step.copy(), Workspace()
    for frame in np.ndindex(*step.shape[:2]):
        wrapped, known = step[frame], inside[frame]
        largest = np.abs(wrapped).max(initial=0, where=known)
        if largest <= SURE:
            continue
        whole, _ = unwrap_frame(wrapped, known, work=work)
        turns = np.round((whole - wrapped) / TURN)
        ground = bare[frame] & known
        level = np.round(np.median(turns[ground if ground.any() else known]))
        found[frame] = np.where(known, wrapped + TURN * (turns - level), wrapped)
    return found
