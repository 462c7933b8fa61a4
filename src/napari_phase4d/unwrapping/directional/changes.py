"""What changes between two frames, as a map: unwrapped, and where that is not to be trusted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, Stack, Store, blocks_outwards
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.directional.registration import Seen
from napari_phase4d.unwrapping.directional.scene import Box, Scene
from napari_phase4d.unwrapping.frames import turns_of_frame
from napari_phase4d.unwrapping.given import working_frames
from napari_phase4d.unwrapping.growing import Workspace, second_differences
from napari_phase4d.unwrapping.neighbours import ends_along

__all__ = ["Denied", "changes_along", "lifts_of_changes", "turns_above_field", "turns_of_maps"]

TURN = np.float32(2 * np.pi)
#: Changes that stay below this many radians everywhere can't have passed half a turn unseen.
SURE = 2.0
#: A part is lowered if its tears are more than its mends by this share of its edge, and may be
#: denied if its mends are more than its tears by as much.
CLEARLY = 0.2
#: A part is put back if this share of it is then within so many radians of the change before.
MOST_LIKE, LIKE_BEFORE = 0.75, np.float32(0.6)
#: ... and if at least this share of the steps at its edge are beyond `SURE`: measured, a fourth to
#: a half round what a steep rim encloses, none of a smooth change, in noise of up to 0.5 rad.
STEEP_RIM = 0.1
#: Turns that are kept; a map that is lifted by more is not known.
MOST_TURNS = 127
#: A part is denied if less than this share of it is lifted between the two frames by themselves.
AFFIRMED = 0.2
#: A change is denied as a whole if more than this share of what it lifts is.
MOST_DENIED = 0.5
#: Frames in which more than this share of the steps at its edge are beyond `SURE` don't know it.
STEEP_EDGE = 0.6

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Whole = NDArray[np.int32]
Lifts = NDArray[np.int8]


def changes_along(axis: int, seen: Seen, seams: NDArray[np.int8]) -> tuple[Image, Mask, Mask]:
    """Return what changes along time or angle; where it is known; where both are empty field."""
    head, tail = ends_along(axis, 4)
    known = seen.usable[head] & seen.usable[tail] & (seams[head] == seams[tail])
    return seen.phase[tail] - seen.phase[head], known, seen.empty[head] & seen.empty[tail]


# ---- maps unwrapped --------------------------------------------------------------------------


def turns_of_maps(step: Image, inside: Mask, bare: Mask) -> Lifts | None:
    """Return the turns that make each map of wrapped changes smooth; None if no map has any.

    A change of more than half a turn between two frames can't be told from a smaller one at any
    single pixel. As a map it can: it is zero on the empty field and rises from there. So where
    changes come near half a turn, the map is unwrapped over y and x like a frame, and its level
    is that of the empty field. Where no empty field is in view the level can't be known: most of
    the map counts as unchanged then, and only what has a smooth edge all round is lifted.

    Parameters
    ----------
    step : ndarray of shape (time, angle, y, x)
        Wrapped changes in radians.
    inside, bare : ndarray of bool, same shape
        Where both ends count; where both are empty field.
    """
    found: Lifts | None = None
    work = Workspace()
    for frame in np.ndindex(*step.shape[:2]):
        wrapped, known = step[frame], inside[frame]
        ground = bare[frame] & known
        if np.abs(wrapped).max(initial=0, where=known) <= SURE:
            continue
        turns = turns_above_field(wrapped, known, ground, work)
        if turns.any() and np.abs(turns).max() <= MOST_TURNS:
            found = np.zeros(step.shape, np.int8) if found is None else found
            found[frame] = without_tears(wrapped, known, turns, smooth=not ground.any())
    return found


def turns_above_field(wrapped: Image, known: Mask, ground: Mask, work: Workspace) -> Whole:
    """Return the turns of a map (y, x) unwrapped by itself, above the median of its field.

    Where it has none, they are those that make the map as a whole smallest.
    """
    turns = turns_of_frame(wrapped, known, second_differences, work)
    if ground.any():
        level = np.int32(np.round(np.median(turns[ground])))
    else:
        level = smallest_level(wrapped[known] / TURN + turns[known])
    found: Whole = np.where(known, turns - level, np.int32(0))
    return found


def smallest_level(in_turns: Image) -> np.int32:
    """Return the whole number of turns by which the sum of the sizes of some numbers is least."""
    near = int(np.round(np.median(in_turns))) + np.arange(-1, 2)
    sizes = [float(np.abs(in_turns - turns).sum(dtype=np.float64)) for turns in near]
    return np.int32(near[int(np.argmin(sizes))])


def without_tears(wrapped: Image, known: Mask, turns: Whole, *, smooth: bool = False) -> Whole:
    """Return turns of a map (y, x) without those parts that tear it more than they mend.

    Where a map is noisy at a rim, its unwrapping may lift all that lies inside by a turn. The
    edge of such a part is mostly made of tears, steps that were small before; that of a part
    whose change has truly passed half a turn is mostly made of steps that are small only now.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (y, x)
        The wrapped map.
    known : ndarray of bool, same shape
        Where it is known.
    turns : ndarray of int, same shape
        What it is lifted by.
    smooth : bool, optional
        Whether parts with a steep rim are put back too, as where nothing tells a level that they
        would be held to.
    """
    box = box_of_turns(turns)
    inside, kept = wrapped[box], turns.copy()
    part = kept[box]
    for side, pieces in lifted_pieces(part, known[box]):
        down = pieces.torn(inside, part, side) > CLEARLY * pieces.steps
        if smooth:
            down |= pieces.have_steep_rims(inside)
        put_back(part, pieces, down, side)
    return kept


def box_of_turns(turns: Whole) -> Box:
    """Return the part of a map (y, x) that has turns, and a pixel round it."""
    rows, columns = (np.flatnonzero(turns.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(rows[0] - 1, 0), rows[-1] + 2),
        slice(max(columns[0] - 1, 0), columns[-1] + 2),
    )


def lifted_pieces(turns: Whole, known: Mask) -> Iterator[tuple[int, Pieces]]:
    """Yield the pieces that are lifted (1) or lowered (-1), the highest first.

    Some may be put back before the next are asked for.
    """
    for side in (1, -1):
        for level in range(int((side * turns).max()), 0, -1):
            yield side, Pieces(side * turns >= level, known)


def put_back(turns: Whole, pieces: Pieces, chosen: Mask, side: int) -> None:
    """Put the chosen ones of some pieces back by a turn, in place."""
    chosen[0] = False
    turns -= np.int32(side) * chosen[pieces.labels]


class Pieces:
    """The pieces of a map, and the steps that lead out of each.

    Parameters
    ----------
    inside : ndarray of bool, shape (y, x)
        Pixels that hang together are one piece.
    known : ndarray of bool, same shape
        Pixels that count; a step to one that does not is none.

    Attributes
    ----------
    labels : ndarray of int, shape (y, x)
        Number of each pixel's piece, from 1; 0 for what belongs to none.
    size, steps : ndarray of int
        Pixels of each piece, and steps that lead out of it; entry 0 is what belongs to none.
    """

    def __init__(self, inside: Mask, known: Mask) -> None:
        self.labels, self._count = scipy.ndimage.label(inside)
        self._out = []
        for axis in (0, 1):
            head, tail = ends_along(axis, 2)
            out = (self.labels[head] != self.labels[tail]) & known[head] & known[tail]
            self._out.append((axis, out, self.labels[head][out], self.labels[tail][out]))
        self.size = self._sums(self.labels.ravel())
        self.steps = sum(self._sums(a) + self._sums(b) for _, _, a, b in self._out)

    def _sums(self, pieces: Whole, each: NDArray[np.generic] | None = None) -> Whole:
        """Add up a number for each time that a piece is named; 1 by itself."""
        found: Whole = np.bincount(pieces, each, self._count + 1).astype(np.int32)
        return found

    def torn(self, wrapped: Image, turns: Whole, side: int) -> Whole:
        """Return by how many steps each edge would cost less if its piece were put back a turn.

        These are its tears less its mends.

        Parameters
        ----------
        wrapped : ndarray of float32, shape (y, x)
            The wrapped map.
        turns : ndarray of int, same shape
            What is added to it.
        side : int
            1 if the pieces are lifted, -1 if they are lowered.
        """
        found = np.zeros(self._count + 1, dtype=np.int32)
        for axis, out, a, b in self._out:
            asked = -np.round(np.diff(wrapped, axis=axis)[out] / TURN)
            jump = side * (np.diff(turns, axis=axis)[out] - asked)
            found += self._sums(a, np.abs(jump) - np.abs(jump + 1))
            found += self._sums(b, np.abs(jump) - np.abs(jump - 1))
        return found

    def steep(self, wrapped: Image) -> Whole:
        """Count the steps of a wrapped map at each edge that are beyond `SURE`."""
        found = np.zeros(self._count + 1, dtype=np.int32)
        for axis, out, a, b in self._out:
            steep = np.abs(turned(np.diff(wrapped, axis=axis)[out])) > SURE
            found += self._sums(a[steep]) + self._sums(b[steep])
        return found

    def have_steep_rims(self, wrapped: Image) -> Mask:
        """Say whether enough steps of a wrapped map at each edge are beyond `SURE`."""
        found: Mask = self.steep(wrapped) >= STEEP_RIM * self.steps
        return found


# ---- changes that go on as before ------------------------------------------------------------


@dataclass
class Maps:
    """What changes along an axis in some frames, in the box of the object.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (time, angle, y, x)
        Wrapped changes in radians.
    inside : ndarray of bool, same shape
        Where both ends count, in maps that have empty field: of others the level is not known.
    turns : ndarray of int8, same shape, or None
        What each map is lifted by: at first by itself, see `turns_of_maps`.
    """

    wrapped: Image
    inside: Mask
    turns: Lifts | None

    def go_on_from(self, k: int, before: tuple[Maps, int] | None) -> None:
        """Put parts of the maps at a time back that then go on as before.

        Parameters
        ----------
        k : int
            Which time of these.
        before : (Maps, int), or None
            Those next to it on the way from the boundary frame, and which time of them.
        """
        if self.turns is None or before is None:
            return
        for angle in np.flatnonzero(self.turns[k].any(axis=(1, 2))):
            own = self.wrapped[k, angle], self.inside[k, angle], self.turns[k, angle]
            self.turns[k, angle] = going_on(*own, before[0].in_radians(before[1], int(angle)))

    def in_radians(self, k: int, angle: int) -> Image:
        """Return a map (y, x) with its turns; NaN where it is not known."""
        found = np.where(self.inside[k, angle], self.wrapped[k, angle], np.float32(np.nan))
        if self.turns is not None:
            found += TURN * self.turns[k, angle].astype(np.float32)
        return found


def going_on(wrapped: Image, known: Mask, lifts: Lifts, before: Image) -> Whole:
    """Return turns of a map (y, x) without those parts that would go on as before, put back.

    A rim that grows by more than half a turn within one pixel lifts all that it encloses by a
    turn. Nothing in the map tells, nor do its two frames, if each is a turn off for the same
    reason. But what is enclosed then seems to leap, by just so much that put back by a turn it
    goes on changing as it did. What truly leaps would have to hit that by chance, all over: what
    beats to and fro by half a turn does. So only parts with a steep rim are asked, which have
    more pixels than edge. From view to view the same goes for how two views differed before.
    """
    turns = lifts.astype(np.int32)
    box = box_of_turns(turns)
    part, known = turns[box], known[box]
    off = wrapped[box] - before[box]
    for side, pieces in lifted_pieces(part, known):
        like = np.abs(off + TURN * (part - np.int32(side)).astype(np.float32)) < LIKE_BEFORE
        count = np.bincount(pieces.labels[like & known], minlength=len(pieces.size))
        goes_on = (count > MOST_LIKE * pieces.size) & (pieces.size > pieces.steps)
        goes_on &= pieces.have_steep_rims(wrapped[box])
        put_back(part, pieces, goes_on, side)
    return turns


def lifts_of_changes(scene: Scene, store: Store, watch: Watch) -> dict[int, Stack]:
    """Return the turns of what changes along time (0) and angle (1), for `Scene.lifts`.

    Each map is unwrapped by itself; then, from the boundary frame on to both sides, parts are put
    back that go on as before, see `going_on`. An axis along which nothing is lifted is left out.
    """
    n, start = scene.shape[0], scene.frames.start[0]
    ahead, behind = blocks_outwards(n, start, working_frames(scene.part))
    blocks = [*ahead, *behind]

    def work(block: Block) -> dict[int, Maps]:
        return maps_of(scene, block)

    found: dict[int, Stack] = {}
    first: dict[int, tuple[Maps, int]] = {}
    last: dict[int, tuple[Maps, int]] = {}
    maps = in_threads(work, blocks, watch.quiet(len(blocks)), large=True)
    for block, by_axis in zip(blocks, maps, strict=True):
        forward = block.start >= start
        near = last if forward else first
        for axis, some in by_axis.items():
            order = range(len(some.wrapped))
            for k in order if forward else reversed(order):
                some.go_on_from(k, near.get(axis))
                near[axis] = some, k
                if axis == 1 and forward:  # views of the boundary frame come before both sides
                    first.setdefault(axis, near[axis])
            if some.turns is not None and some.turns.any():
                if axis not in found:
                    shape = tuple(m - (i == axis) for i, m in enumerate(scene.part))
                    found[axis] = store.temporary(f"lifts_{axis}", shape, "int8")
                of_maps = Block(block.start, block.start + len(some.turns))
                found[axis].write(of_maps, some.turns)
    return found


def maps_of(scene: Scene, block: Block) -> dict[int, Maps]:
    """Return what changes from some frames to the next ones, and in them from view to view."""
    seen = scene.read_box(block.wider(0, 1, scene.shape[0]))
    found = {}
    for axis, frames in ((0, slice(None)), (1, slice(0, len(block)))):
        phase, usable, empty = seen.phase[frames], seen.usable[frames], seen.empty[frames]
        if phase.shape[axis] > 1:
            head, tail = ends_along(axis, 4)
            wrapped, inside = turned(phase[tail] - phase[head]), usable[head] & usable[tail]
            bare = empty[head] & empty[tail]
            turns = turns_of_maps(wrapped, inside, bare)
            ground = (inside & bare).any(axis=(2, 3), keepdims=True)
            found[axis] = Maps(wrapped, inside & ground, turns)
    return found


# ---- changes that the frames deny ------------------------------------------------------------


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
    few : bool, optional
        Whether the recording has few. Then, where most of what a change lifts is denied, nothing
        that it says of objects is known. In more frames other changes lead there as well.
    """

    def __init__(self, seen: Seen, *, few: bool = False) -> None:
        self._seen, self._few, self._work = seen, few, Workspace()
        self._alone: dict[tuple[int, int], Whole] = {}

    def __call__(self, time: int, angle: int, step: Image) -> Mask:
        """Return the pixels (y, x) of a change at which it is denied.

        Parameters
        ----------
        time, angle : int
            Of the first of the two frames, counted among those seen.
        step : ndarray of float32, shape (y, x)
            What changes to the next one, as its map says, in radians; see `turns_of_maps`.
        """
        found = np.zeros(step.shape, dtype=bool)
        frames = self._seen.phase[time : time + 2, angle]
        known = self._seen.usable[time, angle] & self._seen.usable[time + 1, angle]
        difference = frames[1] - frames[0]
        change = turned(difference)
        lifted = whole_turns(step - change)
        for side in (1, -1):
            parts = Pieces(side * lifted >= 1, known)
            heard = parts.torn(change, lifted, side) < -CLEARLY * parts.steps
            heard &= parts.size > parts.steps
            for frame in frames:
                heard &= parts.steep(frame) <= STEEP_EDGE * parts.steps
            heard[0] = False
            if heard.any():
                by_frames = self._turns(time + 1, angle) - self._turns(time, angle)
                by_frames += whole_turns(difference - change)
                unmoved = known & (lifted == 0)
                if not self._show_field(time, angle) and unmoved.any():
                    by_frames -= np.int32(np.round(np.median(by_frames[unmoved])))
                affirmed = np.bincount(parts.labels[side * by_frames >= 1], minlength=len(heard))
                found |= (heard & (affirmed < AFFIRMED * parts.size))[parts.labels]
        if self._few and found.sum() > MOST_DENIED * np.count_nonzero(lifted):
            found |= known & ~(self._seen.empty[time, angle] & self._seen.empty[time + 1, angle])
        return found

    def _ground(self, time: int, angle: int) -> Mask:
        found: Mask = self._seen.empty[time, angle] & self._seen.usable[time, angle]
        return found

    def _show_field(self, time: int, angle: int) -> bool:
        """Say whether a frame and the one after it both show empty field."""
        return all(self._ground(t, angle).any() for t in (time, time + 1))

    def _turns(self, time: int, angle: int) -> Whole:
        """Return the turns of a frame unwrapped by itself, above its empty field."""
        at = (time, angle)
        if at not in self._alone:
            phase, known = self._seen.phase[at], self._seen.usable[at]
            self._alone[at] = turns_above_field(phase, known, self._ground(*at), self._work)
        return self._alone[at]


def whole_turns(phase: Image) -> Whole:
    """Return the number of turns of phase that consists of whole ones."""
    found: Whole = np.round(phase / TURN).astype(np.int32)
    return found
