"""What is unwrapped: frames level with their empty field, the object held in place.

Every step is local in time, or goes along time once, so that a recording of any length is worked
on a block of frames at a time, with the same numbers whatever the blocks are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block, Stack, Store
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.directional.outliers import outlying_frames
from napari_phase4d.unwrapping.directional.registration import (
    Frames,
    Recorded,
    Seen,
    Shifts,
    follow_object,
)
from napari_phase4d.unwrapping.frames import moved
from napari_phase4d.unwrapping.given import blocks_within, working_blocks
from napari_phase4d.unwrapping.neighbours import HALO, along_slope

__all__ = ["NOISY", "Box", "Scene", "find_scene", "seams"]

#: Pixels of the empty field that are kept round the object.
MARGIN = 3
#: No more than this share of the field is added before or behind it, as it all takes memory. What
#: goes further comes in at the opposite edge.
WIDEST = 0.25
#: From this noise in radians on it is averaged out.
NOISY = 0.1

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Box = tuple[slice, slice]
Scalar = TypeVar("Scalar", bound=np.generic)


class Margins(NamedTuple):
    """How many pixels are added round the field: before and after its rows, and its columns.

    Where a shift takes part of an object over an edge of the view, there is room for it.
    """

    rows: tuple[int, int] = (0, 0)
    columns: tuple[int, int] = (0, 0)

    def around(self, stack: NDArray[Scalar], outside: float) -> NDArray[Scalar]:
        """Return a stack (time, angle, y, x) with a value in the pixels that are added."""
        if not any(self.rows + self.columns):
            return stack
        return np.pad(stack, ((0, 0), (0, 0), *self), constant_values=outside)

    def off(self, stack: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return a stack (time, angle, y, x) without the pixels that were added."""
        rows, columns = (
            slice(before, n - after)
            for (before, after), n in zip(self, stack.shape[2:], strict=True)
        )
        return stack[:, :, rows, columns]


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
    lifts : mapping of int to Stack, optional
        Turns in that part that maps of changes along time (0) and angle (1) are lifted by; none
        along an axis that is left out.
    margins : Margins, optional
        What is added round the field, so that no shift takes the object over an edge of it.
    """

    frames: Frames
    shifts: Shifts
    box: Box
    averaged: Stack | None = None
    left: Stack | None = None
    lifts: Mapping[int, Stack] = field(default_factory=dict)
    margins: Margins = field(default_factory=Margins)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the kept frames (time, angle, y, x), with what is added round them."""
        rows, columns = (sum(added) for added in self.margins)
        n, angles, height, width = self.frames.shape
        return n, angles, height + rows, width + columns

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
        phase = self.placed(seen.phase, block, 0)
        if self.averaged is not None:
            phase = phase.copy() if phase is seen.phase else phase
            phase[:, :, *self.box] = self.averaged.read(block)
        return Seen(
            phase,
            self.placed(seen.empty, block, False),
            self.placed(seen.usable, block, False),
            None if seen.amplitude is None else self.placed(seen.amplitude, block, 1),
        )

    def placed(self, stack: NDArray[Scalar], block: Block, outside: float) -> NDArray[Scalar]:
        """Return stacks of some kept frames, moved into place; a value where there is no view."""
        shifts = self.shifts[block.start : block.stop]
        return moved(self.margins.around(stack, outside), shifts)

    def taken_back(self, stack: NDArray[Scalar], block: Block) -> NDArray[Scalar]:
        """Return stacks of some kept frames, moved back to where each frame was seen."""
        return self.margins.off(moved(stack, -self.shifts[block.start : block.stop]))

    def read_box(self, block: Block, *, amplitude: bool = False) -> Seen:
        """Return the box of some frames; see `read`.

        A few frames at a time, as the field may be much larger than the box.
        """
        parts = [self._box_of(some, amplitude) for some in blocks_within(block, self.shape)]
        if len(parts) == 1:
            return parts[0]
        phase, empty, usable = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("phase", "empty", "usable")
        )
        bright = [part.amplitude for part in parts if part.amplitude is not None]
        return Seen(phase, empty, usable, np.concatenate(bright) if bright else None)

    def _box_of(self, block: Block, amplitude: bool) -> Seen:
        """Do `read_box`, all frames at once."""
        seen = self.read(block, amplitude=amplitude)
        inside = (slice(None), slice(None), *self.box)
        return Seen(
            np.ascontiguousarray(seen.phase[inside]),
            seen.empty[inside].copy(),
            seen.usable[inside].copy(),
            None if seen.amplitude is None else seen.amplitude[inside].copy(),
        )

    def boxed(
        self, block: Block, *, amplitude: bool = False
    ) -> tuple[Seen, NDArray[np.int8], Image | None]:
        """Return the box of some frames, its seams, and the share of noise that is left there."""
        left = None if self.left is None else self.left.read(block)
        return self.read_box(block, amplitude=amplitude), self.seams(block), left

    def lifts_of(self, axis: int, block: Block) -> NDArray[np.int8] | None:
        """Return the turns that changes between some frames, or their views, are lifted by."""
        if axis not in self.lifts:
            return None
        return self.lifts[axis].read(Block(block.start, block.stop - (axis == 0)))

    def islands(self, block: Block) -> NDArray[np.int32]:
        """Return the number of each island of the empty field in its frame; -1 elsewhere."""
        return self.placed(self.islands_as_seen(block), block, -1)

    def islands_as_seen(self, block: Block) -> NDArray[np.int32]:
        """Return the same of frames that are not moved into place."""
        empty = self.frames.read_empty(block)
        found = np.empty(empty.shape, dtype=np.int32)
        for frame in np.ndindex(*empty.shape[:2]):
            labels, _ = scipy.ndimage.label(empty[frame])
            found[frame] = labels - 1
        return found

    def free(self, block: Block) -> Mask:
        """Return the object's pixels in the box of some kept frames, moved into place."""
        free = self.placed(self.frames.read_free(block), block, False)
        return free[:, :, *self.box]

    def noisy_phase(self, block: Block) -> Image:
        """Return the wrapped phase of some kept frames, moved into place, as it was seen."""
        return self.placed(self.frames.read(block).phase, block, 0)

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
        own = which - kept.start
        found = (self.taken_back(stack, kept) for stack in read(kept))
        return tuple(s if len(own) == len(s) else s[own] for s in found)

    def seams(self, block: Block) -> NDArray[np.int8]:
        """Return how often each pixel of some frames has gone round the field, see `seams`."""
        shape = self.shape[2], self.shape[3]
        return seams(self.shifts[block.start : block.stop], shape)[:, :, *self.box]


def find_scene(recorded: Recorded, watch: Watch) -> Scene:
    """Hold the object of a recording in place, and average noise out; three steps."""
    recorded.amplitude_of(Block(0, 0))  # so that its median is taken once, not by every thread
    frames = Frames(recorded, watch.task)
    watch.step()
    shifts = follow_object(frames, watch)
    outliers = frames.kept[outlying_frames(frames, shifts, watch)]
    if len(outliers):
        frames = Frames(recorded, watch.task, outliers)
        shifts = follow_object(frames, watch)
    watch.step()
    box, margins = room_for(frames, shifts, watch)
    scene = Scene(frames, shifts, box, margins=margins)
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
        seen = scene.read_box(around)
        phase, share = along_slope(
            seen.phase,
            np.ascontiguousarray(seen.usable),
            scene.seams(around),
            scene.noise,
            block.of(around),
        )
        averaged.write(block, phase)
        left.write(block, share)

    blocks = working_blocks(part)
    for _ in in_threads(work, blocks, watch.quiet(len(blocks)), wait=True):
        pass
    return replace(scene, averaged=averaged, left=left)


def room_for(frames: Frames, shifts: Shifts, watch: Watch) -> tuple[Box, Margins]:
    """Return the smallest part of the field that holds the moved object, and a margin.

    And what has to be added round the field so that it is part of it.
    """
    blocks = working_blocks(frames.shape)

    def work(block: Block) -> list[tuple[int, int]]:
        free, by = frames.read_free(block), shifts[block.start : block.stop]
        return [ends_of(np.asarray(free.any(axis=5 - axis)), by[..., axis - 2]) for axis in (2, 3)]

    found = np.array(list(in_threads(work, blocks, watch.quiet(len(blocks)))))
    box, margins = [], []
    for ends, n in zip(found.transpose(1, 2, 0), frames.shape[2:], strict=True):
        first, stop = int(ends[0].min()), int(ends[1].max())
        if first >= stop:  # no object
            first, stop = 0, n
        widest = int(WIDEST * n)
        before, after = (min(max(over, 0), widest) for over in (-first, stop - n))
        margins.append((before, after))
        whole = before + n + after
        least, most = first + before - MARGIN, stop + before + MARGIN
        if least < -MARGIN or most > whole + MARGIN:  # some of it goes round
            least, most = 0, whole
        box.append(slice(max(least, 0), min(most, whole)))
    return (box[0], box[1]), Margins(*margins)


def ends_of(lines: Mask, by: NDArray[np.intp]) -> tuple[int, int]:
    """Return the first of the lines (time, angle, n) that are so moved, and the one after them."""
    some, n = lines.any(axis=2), lines.shape[2]
    if not some.any():
        return n, 0
    first, last = lines.argmax(axis=2), n - lines[..., ::-1].argmax(axis=2)
    return int((first + by)[some].min()), int((last + by)[some].max())


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
