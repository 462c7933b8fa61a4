"""What is unwrapped: frames level with their empty field, the object held in place.

Every step is local in time, or goes along time once, so that a recording of any length is worked
on a block of frames at a time, with the same numbers whatever the blocks are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, Stack, Store
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.alone import Framewise
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.frames import centre, moved
from napari_phase4d.unwrapping.given import working_blocks
from napari_phase4d.unwrapping.neighbours import HALO, along_slope

__all__ = ["NOISY", "Frames", "Recorded", "Scene", "Seen", "find_scene", "follow_object", "seams"]

#: Pixels of the empty field that are kept round the object.
MARGIN = 3
#: From this noise in radians on it is averaged out.
NOISY = 0.1
#: A new shift must make neighbours more alike (mean cosine of their difference) by this much ...
ADVANTAGE = 0.02
#: ... and by this much for every pixel that it moves.
COST_OF_A_PIXEL = 0.005

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Shifts = NDArray[np.intp]
Box = tuple[slice, slice]


class Recorded(Framewise, Protocol):
    """What the directional methods ask of a problem."""

    def lost(self) -> Mask:
        """Frames that say nothing."""

    def background(self) -> Background:
        """Return the empty field."""

    def amplitude_of(self, block: Block) -> Image | None:
        """Amplitude of a block as a share of its view's median, or None."""


@dataclass(frozen=True)
class Seen:
    """Some frames, ready to be joined.

    Parameters
    ----------
    phase : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians less the frames' empty fields.
    empty, usable : ndarray of bool, same shape
        Empty field; pixels that count.
    amplitude : ndarray of float, same shape, or None
        Amplitude as a share of its view's median; None too where it was not asked for.
    """

    phase: Image
    empty: Mask
    usable: Mask
    amplitude: Image | None

    @property
    def free(self) -> Mask:
        """Pixels that count and are not empty: those of the object."""
        found: Mask = self.usable & ~self.empty
        return found


class Frames:
    """The frames of a recording, levelled; those that say nothing are left out or stood in for.

    Times at which all views are lost are left out, and the rest solved as if they were adjacent.
    A view that is lost by itself is stood in for by what lies half way between its neighbours.

    Parameters
    ----------
    recorded : Recorded
        What was recorded.

    Attributes
    ----------
    lost : ndarray of bool, shape (time, angle)
        Frames that say nothing.
    kept : ndarray of int
        Times that are not left out. Blocks of `read` count these.
    start : tuple of int
        The kept frame (time, angle) that lies next to the boundary frame.
    """

    def __init__(self, recorded: Recorded) -> None:
        self.recorded = recorded
        self.background = recorded.background()
        lost = recorded.lost()
        self.lost = np.zeros_like(lost) if lost.all() else lost
        self.kept = np.flatnonzero(~self.lost.all(axis=1))
        nearest = int(np.argmin(np.abs(self.kept - recorded.first[0])))
        self.start = nearest, recorded.first[1]
        self.shape = (len(self.kept), *recorded.given.shape[1:])

    def read(self, block: Block, *, amplitude: bool = False) -> Seen:
        """Return some of the kept frames; their amplitude only if it is asked for."""
        times = self.kept[block.start : block.stop]
        seen = self._seen(times, amplitude=amplitude)
        if self.lost[times].any():
            seen = Seen(seen.phase, seen.empty.copy(), seen.usable.copy(), seen.amplitude)
            for i, angle in np.argwhere(self.lost[times]):
                self._stand_in(seen, int(i), int(angle), int(times[i]))
        return seen

    def read_free(self, block: Block) -> Mask:
        """Return the object's pixels of some of the kept frames, as `read` does."""
        times = self.kept[block.start : block.stop]
        if self.lost[times].any():
            return self.read(block).free
        around = Block(int(times[0]), int(times[-1]) + 1)
        _, usable = self.recorded.given.read(around)
        found: Mask = usable & ~self.background.empty.read(around)
        return found if len(times) == len(around) else found[times - around.start]

    def read_empty(self, block: Block) -> Mask:
        """Return the empty field of some of the kept frames."""
        times = self.kept[block.start : block.stop]
        if self.lost[times].any():
            return self.read(block).empty
        around = Block(int(times[0]), int(times[-1]) + 1)
        return self.background.empty.read(around)[times - around.start]

    def all_times(self, block: Block) -> NDArray[np.intp]:
        """Return for the times of a block which kept frame stands for each: the one before."""
        found = np.searchsorted(self.kept, np.arange(block.start, block.stop), side="right") - 1
        return np.maximum(found, 0)

    def _seen(self, times: NDArray[np.intp], *, amplitude: bool = False) -> Seen:
        """Return the frames of some rising times as they were seen."""
        around = Block(int(times[0]), int(times[-1]) + 1)
        wrapped, usable = self.recorded.given.read(around)
        empty = self.background.empty.read(around)
        bright = self.recorded.amplitude_of(around) if amplitude else None
        if len(times) < len(around):
            own = times - around.start
            wrapped, usable, empty = wrapped[own], usable[own], empty[own]
            bright = None if bright is None else bright[own]
        level, tilt = self.background.level[times], self.background.tilt[times]
        levelled = turned(wrapped - self.background.ground_of(level, tilt))
        return Seen(levelled, empty, usable, bright)

    def _stand_in(self, seen: Seen, i: int, angle: int, time: int) -> None:
        """Fill the lost frame of a view in place from the frames round it."""
        good = self.kept[~self.lost[self.kept, angle]]
        if not len(good):
            seen.usable[i, angle] = False
            return
        before, after = good[good < time], good[good > time]
        times = [before[-1] if len(before) else after[0], after[0] if len(after) else before[-1]]
        one, other = (self._seen(np.array([t])) for t in times)
        # Numbers of kept frames, as times that are left out don't count.
        now, first, last = np.searchsorted(self.kept, [time, *times])
        share = np.float32((now - first) / (last - first) if first != last else 0)
        change = turned(other.phase[0, angle] - one.phase[0, angle])
        seen.phase[i, angle] = turned(one.phase[0, angle] + share * change)
        seen.empty[i, angle] = one.empty[0, angle] & other.empty[0, angle]
        seen.usable[i, angle] = one.usable[0, angle] & other.usable[0, angle]


@dataclass(frozen=True)
class Scene:
    """The frames with the object held in place.

    Parameters
    ----------
    frames : Frames
        What is unwrapped.
    shifts : ndarray of int, shape (kept time, angle, 2)
        How frames are moved.
    box : tuple of slice
        The part of the moved field (y, x) that holds the object at all times, and a margin.
    averaged : Stack or None
        Wrapped phase in that part with the noise averaged out, and ...
    left : Stack or None
        ... which share of the noise's variance is left; None where there is hardly any noise.
    """

    frames: Frames
    shifts: Shifts
    box: Box
    averaged: Stack | None = None
    left: Stack | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the kept frames (time, angle, y, x)."""
        return self.frames.shape

    @property
    def noise(self) -> float:
        """Standard deviation of the phase's noise in radians."""
        return self.frames.background.noise

    @property
    def part(self) -> tuple[int, ...]:
        """Shape of the box over the kept frames (time, angle, y, x)."""
        return (*self.shape[:2], *(s.stop - s.start for s in self.box))

    def read(self, block: Block, *, amplitude: bool = False) -> Seen:
        """Return some kept frames, moved into place, the noise averaged out; see `Frames.read`."""
        seen = self.frames.read(block, amplitude=amplitude)
        shifts = self.shifts[block.start : block.stop]
        phase = moved(seen.phase, shifts)
        if self.averaged is not None:
            phase = phase.copy() if phase is seen.phase else phase
            phase[:, :, *self.box] = self.averaged.read(block)
        return Seen(
            phase,
            moved(seen.empty, shifts),
            moved(seen.usable, shifts),
            None if seen.amplitude is None else moved(seen.amplitude, shifts),
        )

    def islands(self, block: Block) -> NDArray[np.int32]:
        """Return the number of each island of the empty field in its frame; -1 elsewhere."""
        empty = self.frames.read_empty(block)
        found = np.empty(empty.shape, dtype=np.int32)
        for frame in np.ndindex(*empty.shape[:2]):
            labels, _ = scipy.ndimage.label(empty[frame])
            found[frame] = labels - 1
        return moved(found, self.shifts[block.start : block.stop])

    def noisy_phase(self, block: Block) -> Image:
        """Return the wrapped phase of some kept frames, moved into place, as it was seen."""
        return moved(self.frames.read(block).phase, self.shifts[block.start : block.stop])

    def put_back(
        self, block: Block, read: Callable[[Block], tuple[NDArray[Any], ...]]
    ) -> tuple[NDArray[Any], ...]:
        """Return stacks of a block of all times, moved back to where each frame was seen.

        Parameters
        ----------
        block : Block
            Of all times.
        read : callable
            Returns the stacks of some kept frames, moved into place.
        """
        which = self.frames.all_times(block)
        kept = Block(int(which[0]), int(which[-1]) + 1)
        back = -self.shifts[kept.start : kept.stop]
        own = which - kept.start
        found = (moved(stack, back) for stack in read(kept))
        return tuple(s if len(own) == len(s) else s[own] for s in found)

    def seams(self, block: Block) -> NDArray[np.int8]:
        """Return how often each pixel of some frames has gone round the field, see `seams`."""
        shape = self.shape[2], self.shape[3]
        return seams(self.shifts[block.start : block.stop], shape)[:, :, *self.box]


def find_scene(recorded: Recorded, watch: Watch) -> Scene:
    """Hold the object of a recording in place, and average noise out; three steps."""
    recorded.amplitude_of(Block(0, 0))  # so that its median is taken once, not by every thread
    frames = Frames(recorded)
    watch.step()
    shifts = follow_object(frames, watch)
    watch.step()
    scene = Scene(frames, shifts, box_of(frames, shifts, watch))
    if scene.noise >= NOISY:
        scene = averaged_scene(scene, recorded.store, watch)
    watch.step()
    return scene


def averaged_scene(scene: Scene, store: Store, watch: Watch) -> Scene:
    """Average the noise out along the slope, see `along_slope`."""
    n = scene.shape[0]
    part = scene.part
    averaged = store.temporary("averaged", part, "float32")
    left = store.temporary("left", part, "float32")

    def work(block: Block) -> None:
        around = block.wider(HALO, HALO, n)
        seen = scene.read(around)
        inside = (slice(None), slice(None), *scene.box)
        phase, share = along_slope(
            np.ascontiguousarray(seen.phase[inside]),
            np.ascontiguousarray(seen.usable[inside]),
            scene.seams(around),
            scene.noise,
            block.of(around),
        )
        averaged.write(block, phase)
        left.write(block, share)

    blocks = working_blocks(part)
    for _ in in_threads(work, blocks, watch.quiet(len(blocks)), wait=True):
        pass
    return Scene(scene.frames, scene.shifts, scene.box, averaged, left)


def box_of(frames: Frames, shifts: Shifts, watch: Watch) -> Box:
    """Return the smallest part of the field that holds the moved object, and a margin."""
    height, width = frames.shape[2:]
    blocks = working_blocks(frames.shape)

    def lines(block: Block) -> tuple[Mask, Mask]:
        seen = moved(frames.read_free(block), shifts[block.start : block.stop])
        return np.asarray(seen.any(axis=(0, 1, 3))), np.asarray(seen.any(axis=(0, 1, 2)))

    rows, columns = np.zeros(height, dtype=bool), np.zeros(width, dtype=bool)
    for some_rows, some_columns in in_threads(lines, blocks, watch.quiet(len(blocks))):
        rows |= some_rows
        columns |= some_columns
    if not rows.any():
        return slice(0, height), slice(0, width)
    y, x = np.flatnonzero(rows), np.flatnonzero(columns)
    return (
        slice(max(int(y[0]) - MARGIN, 0), min(int(y[-1]) + 1 + MARGIN, height)),
        slice(max(int(x[0]) - MARGIN, 0), min(int(x[-1]) + 1 + MARGIN, width)),
    )


# ---- following a moving object ---------------------------------------------------------------


def follow_object(frames: Frames, watch: Watch) -> Shifts:
    """Return shifts (time, angle, 2) in pixels that keep the object in place.

    They are the sum of one shift for each time and one for each angle. The centre of mass of the
    object proposes; of the shifts round it and the one before, that is taken which makes
    neighbouring frames most alike.

    Parameters
    ----------
    frames : Frames
        Of which those pixels are the object that count and are not empty.
    watch : Watch
        Stops the work.
    """
    n_times, n_angles = frames.shape[:2]
    centres = centres_of(frames, watch)
    shifts = np.zeros((n_times, n_angles, 2), dtype=np.intp)
    shifts += along_time(frames, mean_of(centres, 1), watch)[:, None]
    if n_angles > 1:
        shifts += along_angle(frames, mean_of(centres, 0), watch)[None]
    return shifts


def centres_of(frames: Frames, watch: Watch) -> NDArray[np.float64]:
    """Return the centre of mass of the object in every frame (time, angle, 2)."""
    blocks = working_blocks(frames.shape)

    def work(block: Block) -> NDArray[np.float64]:
        free = frames.read_free(block)
        return np.array([[centre(mask) for mask in views] for views in free])

    return np.concatenate(list(in_threads(work, blocks, watch.quiet(len(blocks)))))


def mean_of(centres: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Return the mean of the centres that are known along an axis; NaN if none is."""
    known = np.isfinite(centres).all(axis=2, keepdims=True)
    count = known.sum(axis=axis)
    total = np.where(known, centres, 0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def proposals(off: NDArray[np.float64], before: Shifts) -> list[Shifts]:
    """Return the shifts to try: the one before, and those round what the centres say."""
    if not np.isfinite(off).all():
        return [before]
    rounded = np.floor(off + 0.5).astype(np.intp)
    return [before] + [rounded + np.array(d) for d in product((-1, 0, 1), repeat=2)]


def likeliest(tried: list[Shifts], likeness: list[float], before: Shifts) -> Shifts:
    """Return the shift that makes frames most alike; moving must be worth it."""
    costs = [-ADVANTAGE] + [COST_OF_A_PIXEL * int(np.abs(s - before).sum()) for s in tried[1:]]
    return tried[int(np.argmax(np.array(likeness) - costs))]


class Look(NamedTuple):
    """Some views of the object: cosine and sine of the phase, and its mask (view, y, x).

    And between which columns the mask lies in each row (view, y, 2).
    """

    cosine: Image
    sine: Image
    mask: Mask
    ends: Shifts


def looks_at(seen: Seen, angles: slice = slice(None)) -> list[Look]:
    """Return what some frames show, time by time."""
    phase, free = seen.phase[:, angles], seen.free[:, angles]
    width = free.shape[3]
    some = free.any(axis=3)
    first = np.where(some, free.argmax(axis=3), width)
    last = np.where(some, width - free[..., ::-1].argmax(axis=3), 0)
    ends = np.stack([first, last], axis=3)
    return [
        Look(*of_time) for of_time in zip(np.cos(phase), np.sin(phase), free, ends, strict=True)
    ]


def along_time(frames: Frames, centres: NDArray[np.float64], watch: Watch) -> Shifts:
    """Return the shift of every time, the same for all angles."""
    found = np.zeros((frames.shape[0], 2), dtype=np.intp)
    last: Look | None = None
    for block in working_blocks(frames.shape):
        for k, now in zip(block.times, looks_at(frames.read(block)), strict=True):
            watch.check()
            if last is not None:
                before = found[k - 1]
                tried = proposals(centres[0] - centres[k], before)
                likeness = [mean_cosine([likeness_of(now, last, s - before)]) for s in tried]
                found[k] = likeliest(tried, likeness, before)
            last = now
    return found


def along_angle(frames: Frames, centres: NDArray[np.float64], watch: Watch) -> Shifts:
    """Return the shift of every angle, the same for all times."""
    found = np.zeros((frames.shape[1], 2), dtype=np.intp)
    blocks = working_blocks(frames.shape)
    for k in range(1, len(found)):
        before = found[k - 1]
        tried = proposals(centres[0] - centres[k], before)
        steps = [shift - before for shift in tried]

        def work(block: Block, k: int = k, steps: list[Shifts] = steps) -> list[list[Likeness]]:
            seen = frames.read(block)
            pairs = zip(
                looks_at(seen, slice(k, k + 1)), looks_at(seen, slice(k - 1, k)), strict=True
            )
            return [[likeness_of(*pair, step) for step in steps] for pair in pairs]

        of_frames = [
            frame for some in in_threads(work, blocks, watch.quiet(len(blocks))) for frame in some
        ]
        likeness = [mean_cosine(of_shift) for of_shift in zip(*of_frames, strict=True)]
        found[k] = likeliest(tried, likeness, before)
    return found


#: Sum of the cosines of phase differences, and their number.
Likeness = tuple[float, int]


def likeness_of(now: Look, before: Look, step: Shifts) -> Likeness:
    """Return how alike two looks are if the first is moved."""
    total, count = sums_of_moved(now, before, int(step[0]), int(step[1]))
    return total, count


def mean_cosine(sums: Iterable[Likeness]) -> float:
    """Return the mean cosine, of sums that are added in the order of time."""
    total, count = 0.0, 0
    for more, number in sums:
        total, count = total + more, count + number
    return total / count if count else 1.0


@compiled
def sums_of_moved(now: Look, before: Look, down: int, right: int) -> tuple[float, int]:
    """Return the sum of the cosines of phase differences, where either mask is, and their number.

    The first look is moved, round the edges of the field.
    """
    n_views, height, width = now.mask.shape
    total, count = 0.0, 0
    left = right % width
    for view in range(n_views):
        for y in range(height):
            row = (y - down) % height
            c, s, m = now.cosine[view, row], now.sine[view, row], now.mask[view, row]
            c_before, s_before = before.cosine[view, y], before.sine[view, y]
            m_before = before.mask[view, y]
            first, last = now.ends[view, row, 0], now.ends[view, row, 1]
            first_before, last_before = before.ends[view, y, 0], before.ends[view, y, 1]
            for start, stop, shift in ((left, width, -left), (0, left, width - left)):
                # What lies in neither mask is passed over.
                start_here = max(start, min(first - shift, first_before))
                stop_here = min(stop, max(last - shift, last_before))
                for x in range(start_here, stop_here):
                    if m[x + shift] or m_before[x]:
                        total += c[x + shift] * c_before[x]
                        total += s[x + shift] * s_before[x]
                        count += 1
    return total, count


def seams(shifts: Shifts, shape: tuple[int, int]) -> NDArray[np.int8]:
    """Return how often each pixel of moved frames has gone round the field, (time, angle, y, x).

    Neighbours of different numbers are no neighbours in truth.
    """
    height, width = shape
    rows = np.arange(height) - shifts[..., 0, None]
    columns = np.arange(width) - shifts[..., 1, None]
    turns_y = np.floor_divide(rows, height).astype(np.int8)
    turns_x = np.floor_divide(columns, width).astype(np.int8)
    numbers: NDArray[np.int8] = turns_y[..., :, None] * np.int8(8) + turns_x[..., None, :]
    return numbers
