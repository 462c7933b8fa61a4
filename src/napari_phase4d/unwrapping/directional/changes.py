"""What changes between two frames, as a map: unwrapped, and where that is not to be trusted."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.phasors import turned
from napari_phase4d.unwrapping.directional.scene import Seen
from napari_phase4d.unwrapping.frames import turns_of_frame
from napari_phase4d.unwrapping.growing import Workspace, second_differences
from napari_phase4d.unwrapping.neighbours import ends_along

__all__ = ["Denied", "changes_along", "link_map"]

TURN = np.float32(2 * np.pi)
#: Changes that stay below this many radians everywhere can't have passed half a turn unseen.
SURE = 2.0
#: A part is lowered if its tears are more than its mends by this share of its edge, and may be
#: denied if its mends are more than its tears by as much.
CLEARLY = 0.2
#: A part is denied if less than this share of it is lifted between the two frames by themselves.
AFFIRMED = 0.2
#: Frames in which more than this share of the steps at its edge are beyond `SURE` don't know it.
STEEP_EDGE = 0.6

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
            torn, edge = edges_of(labels, count, side * part, [side * own for own in asked])
            down = torn > CLEARLY * edge
            down[0] = False
            part -= np.int32(side) * down[labels]
    return kept


def edges_of(
    labels: Whole, count: int, turns: Whole, asked: list[Whole]
) -> tuple[NDArray[np.float64], Whole]:
    """Look at the edges of some parts of a map; entry 0 is what belongs to none.

    Parameters
    ----------
    labels : ndarray of int, shape (y, x)
        Which part each pixel belongs to, from 1; 0 for none.
    count : int
        How many there are.
    turns : ndarray of int, same shape
        Turns that are added to the wrapped map.
    asked : list of ndarray of int
        The turns that its steps ask for along y and x, see `jumps_of`.

    Returns
    -------
    torn : ndarray of float
        By how many steps each edge would cost less if the part were lowered by a turn: its tears
        less its mends.
    edge : ndarray of int
        How many steps it has.
    """
    torn, edge = np.zeros(count + 1), np.zeros(count + 1, dtype=np.int32)
    for axis in (0, 1):
        head, tail = ends_along(axis, 2)
        out = labels[head] != labels[tail]
        jump = (turns[tail] - turns[head] - asked[axis])[out]
        for end, lowered in ((tail, jump - 1), (head, jump + 1)):
            own = labels[end][out]
            torn += np.bincount(own, np.abs(jump) - np.abs(lowered), count + 1)
            edge += np.bincount(own, minlength=count + 1).astype(np.int32)
    return torn, edge


def steep_steps(labels: Whole, count: int, frame: Image) -> Whole:
    """Count the steps of a frame beyond `SURE` at the edge of each part, see `edges_of`."""
    found = np.zeros(count + 1, dtype=np.int32)
    for axis in (0, 1):
        head, tail = ends_along(axis, 2)
        out = labels[head] != labels[tail]
        out &= np.abs(turned(np.diff(frame, axis=axis))) > SURE
        for end in (head, tail):
            found += np.bincount(labels[end][out], minlength=count + 1).astype(np.int32)
    return found


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
    more pixels than edge, as rings have nothing inside, and where the edge mends clearly more
    than it tears: what is ragged in the change is in the frames too. Frames in which that edge is
    steep, as that of a wall, are no witnesses either.

    Parameters
    ----------
    seen : Seen
        The frames.
    """

    def __init__(self, seen: Seen) -> None:
        self._seen, self._work = seen, Workspace()
        self._alone: dict[tuple[int, int], Whole] = {}

    def __call__(self, time: int, angle: int, lifted: Whole) -> Mask:
        """Return the pixels (y, x) of a change at which it is denied.

        Parameters
        ----------
        time, angle : int
            Of the first of the two frames, counted among those seen.
        lifted : ndarray of int, shape (y, x)
            Turns that the map adds to the wrapped change.
        """
        difference = self._seen.phase[time + 1, angle] - self._seen.phase[time, angle]
        change = turned(difference)
        passed = np.round((difference - change) / TURN).astype(np.int32)
        found = np.zeros(lifted.shape, dtype=bool)
        asked = [jumps_of(change, axis) for axis in (0, 1)]
        for side in (1, -1):
            labels, count = scipy.ndimage.label(side * lifted >= 1)
            size = np.bincount(labels.ravel(), minlength=count + 1)
            torn, edge = edges_of(labels, count, side * lifted, [side * own for own in asked])
            clear = (torn < -CLEARLY * edge) & (size > edge)
            clear[0] = False
            if clear.any():
                for frame in self._seen.phase[time : time + 2, angle]:
                    clear &= steep_steps(labels, count, frame) <= STEEP_EDGE * edge
            if clear.any():
                said = self._of(time + 1, angle) - self._of(time, angle) + passed
                affirmed = np.bincount(labels[side * said >= 1], minlength=count + 1)
                found |= (clear & (affirmed < AFFIRMED * size))[labels]
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
