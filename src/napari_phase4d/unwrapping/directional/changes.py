"""What changes between two frames, as a map: unwrapped, and where that is not to be trusted."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.unwrapping.directional.scene import Seen
from napari_phase4d.unwrapping.frames import turns_of_frame
from napari_phase4d.unwrapping.growing import Workspace, second_differences
from napari_phase4d.unwrapping.neighbours import ends_along

__all__ = ["Denied", "changes_along", "link_map"]

TURN = np.float32(2 * np.pi)
#: Changes that stay below this many radians everywhere can't have passed half a turn unseen.
SURE = 2.0
#: A part is lowered if its tears are more than its mends by this share of its edge.
CLEARLY = 0.2
#: A part is denied if less than this share of it is lifted between the two frames by themselves.
AFFIRMED = 0.2

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Whole = NDArray[np.int32]


def changes_along(axis: int, seen: Seen, seams: NDArray[np.int8]) -> tuple[Image, Mask, Mask]:
    """Return what changes along time or angle; where it is known; where both are empty field."""
    head, tail = ends_along(axis, 4)
    known = seen.usable[head] & seen.usable[tail] & (seams[head] == seams[tail])
    return seen.phase[tail] - seen.phase[head], known, seen.empty[head] & seen.empty[tail]


def link_map(step: Image, inside: Mask, bare: Mask) -> Image:
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


def without_tears(wrapped: Image, turns: Whole) -> Whole:
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
            labels, count = scipy.ndimage.label(side * part >= level)
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


def jumps_of(wrapped: Image, axis: int) -> Whole:
    """Return the turns that the steps of a wrapped map ask for along an axis."""
    return -np.round(np.diff(wrapped, axis=axis) / TURN).astype(np.int32)


class Denied:
    """Says where two frames deny what the map of their change says.

    A part of a map that is lifted by a turn is an inference from its edge: all inside has passed
    half a turn between the two frames. Where a rim grows by more than half a turn, that of a bud
    for one, the ring of it looks like a small change the other way, and all that it encloses is
    lifted in its stead. The two frames, each unwrapped by itself, are witnesses of their own: if
    what they differ by is lifted nowhere there, the change is not known. That goes for parts with
    more pixels than edge; rings have nothing inside to lift.

    Parameters
    ----------
    seen : Seen
        The frames.
    """

    def __init__(self, seen: Seen) -> None:
        self._seen, self._work = seen, Workspace()
        self._alone: dict[tuple[int, int], Whole] = {}

    def __call__(self, time: int, angle: int, lifted: Whole, passed: Whole) -> Mask:
        """Return the pixels (y, x) of a change at which it is denied.

        Parameters
        ----------
        time, angle : int
            Of the first of the two frames, counted among those seen.
        lifted : ndarray of int, shape (y, x)
            Turns that the map adds to the wrapped change.
        passed : ndarray of int, same shape
            Turns by which the two wrapped phases differ more than their wrapped change.
        """
        found = np.zeros(lifted.shape, dtype=bool)
        for side in (1, -1):
            labels, count = scipy.ndimage.label(side * lifted >= 1)
            size = np.bincount(labels.ravel(), minlength=count + 1)
            solid = size > edge_of(labels, count)
            solid[0] = False
            if solid.any():
                said = self._of(time + 1, angle) - self._of(time, angle) + passed
                affirmed = np.bincount(labels[side * said >= 1], minlength=count + 1)
                found |= (solid & (affirmed < AFFIRMED * size))[labels]
        return found

    def _of(self, time: int, angle: int) -> Whole:
        """Return the turns of a frame unwrapped by itself, above its empty field."""
        at = (time, angle)
        if at not in self._alone:
            known = self._seen.usable[at]
            turns, _ = turns_of_frame(self._seen.phase[at], known, second_differences, self._work)
            level = np.median(turns[self._seen.empty[at] & known])
            self._alone[at] = turns - np.int32(np.round(level))
        return self._alone[at]


def edge_of(labels: Whole, count: int) -> Whole:
    """Return how many steps lead out of each of some parts of a map; first of what is none."""
    edge = np.zeros(count + 1, dtype=np.int32)
    for axis in (0, 1):
        head, tail = ends_along(axis, 2)
        out = labels[head] != labels[tail]
        for end in (head, tail):
            edge += np.bincount(labels[end][out], minlength=count + 1).astype(np.int32)
    return edge
