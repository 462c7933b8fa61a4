"""Links along time and angle: what changes from frame to frame, unwrapped as a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.unwrapping.boxes import ends_along
from napari_phase4d.unwrapping.frames import turns_of_frame
from napari_phase4d.unwrapping.growing import Workspace, second_differences

__all__ = ["link_map"]

TURN = np.float32(2 * np.pi)
#: Changes that stay below this many radians everywhere can't have passed half a turn unseen.
SURE = 2.0
#: A part is lowered if its tears are more than its mends by this share of its edge.
CLEARLY = 0.2

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]
Whole = NDArray[np.int32]


def link_map(step: Stack, inside: Mask, bare: Mask) -> Stack:
    """Return wrapped changes between frames with the turns that make each map smooth.

    A change of more than half a turn between two frames can't be told from a smaller one at any
    single pixel. As a map it can: it is zero on the empty field and rises from there. So where
    changes come near half a turn, the map is unwrapped over y and x like a frame, and its level
    is that of the empty field. Where no empty field is in view the level can't be known, and the
    changes stay wrapped.

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
        ground = bare[frame] & known
        if not ground.any() or np.abs(wrapped).max(initial=0, where=known) <= SURE:
            continue
        turns, _ = turns_of_frame(wrapped, known, second_differences, work)
        level = np.int32(np.round(np.median(turns[ground])))
        turns = np.where(known, turns - level, np.int32(0))
        if turns.any():
            found[frame] = wrapped + TURN * without_tears(wrapped, turns)
    return found


def without_tears(wrapped: Stack, turns: Whole) -> Whole:
    """Return turns of a map (y, x) without those parts that tear it more than they mend.

    Where a map is noisy at a rim, its unwrapping may lift all that lies inside by a turn. The
    edge of such a part is mostly made of tears, steps that were small before; that of a part
    whose change has truly passed half a turn is mostly made of steps that are small only now.
    """
    rows, columns = (np.flatnonzero(turns.any(axis=axis)) for axis in (1, 0))
    box = (
        slice(max(rows[0] - 1, 0), rows[-1] + 2),
        slice(max(columns[0] - 1, 0), columns[-1] + 2),
    )
    inside, kept = wrapped[box], turns.copy()
    asked = [jumps_of(inside, axis) for axis in (0, 1)]
    for side in (1, -1):
        for level in range(int((side * turns).max()), 0, -1):
            part = kept[box]
            labels, count = ndimage.label(side * part >= level)
            torn, edge = np.zeros(count + 1), np.zeros(count + 1)
            for axis in (0, 1):
                head, tail = ends_along(axis, 2)
                a, b = labels[head], labels[tail]
                jump = side * (part[tail] - part[head] - asked[axis])
                # What an edge of the map would cost less if the part at its end were lowered.
                torn += np.bincount(
                    b.ravel(), ((a != b) * (np.abs(jump) - np.abs(jump - 1))).ravel(), count + 1
                )
                torn += np.bincount(
                    a.ravel(), ((a != b) * (np.abs(jump) - np.abs(jump + 1))).ravel(), count + 1
                )
                edge += np.bincount(b.ravel(), (a != b).ravel(), count + 1)
                edge += np.bincount(a.ravel(), (a != b).ravel(), count + 1)
            down = torn > CLEARLY * edge
            down[0] = False
            part -= np.int32(side) * down[labels]
    return kept


def jumps_of(wrapped: Stack, axis: int) -> Whole:
    """Return the turns that the steps of a wrapped map ask for along an axis."""
    return -np.round(np.diff(wrapped, axis=axis) / TURN).astype(np.int32)
