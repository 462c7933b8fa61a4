"""Wrapped phase as it is given, read a block of frames at a time."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, InMemory, ReadOnly, Stack, block_at, block_frames
from napari_phase4d.unwrapping.light.views import ViewsOf

__all__ = [
    "LARGEST",
    "Counted",
    "Given",
    "KeptFrames",
    "all_within",
    "as_given",
    "is_known",
    "working_blocks",
    "working_frames",
]

#: Beyond so many radians, single precision no longer tells the parts of a turn.
LARGEST = 1e5
#: Blocks that `KeptFrames` holds.
KEPT_BLOCKS = 8
#: Work that looks at neighbouring frames too takes about so many pixels at a time, of all views,
#: but so many frames if they have no more than four times the pixels, since what it needs of the
#: frames around is done twice. On the way it takes some hundred bytes a pixel.
WORKING_PIXELS, FEW_FRAMES = 2**20, 8
#: It takes no more frames than this.
WORKING_FRAMES = 32


def is_known(phase: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Mark the pixels that are neither NaN nor infinite, nor so large that a turn is lost."""
    known: NDArray[np.bool_] = np.abs(phase) <= LARGEST
    return known


@compiled
def all_within(numbers: NDArray[np.float32], largest: np.float32) -> bool:
    """Say whether no number is NaN or larger than this, whatever its sign."""
    outside = np.int32(0)
    for k in range(len(numbers)):
        outside |= np.int32(not abs(numbers[k]) <= largest)
    return bool(outside == 0)


ALL = slice(None)


@dataclass(frozen=True)
class Given:
    """Wrapped phase, and which pixels count.

    Parameters
    ----------
    phase : Stack
        Wrapped phase in radians.
    usable : Stack, optional
        Pixels that count; their phase is known. Default those whose phase is known.
    """

    phase: Stack
    usable: Stack | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        return self.phase.shape

    def read(
        self, block: Block, angles: slice = ALL
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the phase of a block, 0 where it is not known, and which pixels count."""
        wrapped = self.phase.read(block, angles)
        if self.usable is not None:
            return wrapped, self.usable.read(block, angles)
        # Which is told several times as fast as for each pixel, and holds of nearly all blocks.
        if all_within(np.require(wrapped, np.float32, ["C", "W"]).ravel(), np.float32(LARGEST)):
            return wrapped, np.ones(wrapped.shape, dtype=bool)
        known = is_known(wrapped)
        return np.where(known, wrapped, np.float32(0)), known

    def of_views(self, views: tuple[int, ...]) -> Given:
        """Return some views of it."""
        usable = None if self.usable is None else ViewsOf(self.usable, views)
        return Given(ViewsOf(self.phase, views), usable)

    def without_lost(
        self, unwrapped: NDArray[np.float32], usable: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Make those frames of a result NaN, in place, of which no phase is known at all.

        Where it is said which pixels count, nobody knows here which phase was known.
        """
        if self.usable is None:
            lost = ~usable.any(axis=(2, 3))
            if lost.any():
                unwrapped[lost] = np.nan
        return unwrapped


@dataclass(frozen=True)
class Counted(ReadOnly):
    """The pixels that count, in the form of a stack.

    Parameters
    ----------
    given : Given
        Wrapped phase, and the pixels that count.
    """

    given: Given

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        return self.given.shape

    def read(self, block: Block, angles: slice = ALL) -> NDArray[np.bool_]:
        """Return some of it."""
        return self.given.read(block, angles)[1]


class KeptFrames:
    """Single frames of a stack, of which a few blocks are held.

    Parameters
    ----------
    shape : tuple of int
        Shape of the stack.
    read : callable
        ``read(block, angles)`` returns some of its frames.
    """

    def __init__(
        self, shape: tuple[int, ...], read: Callable[[Block, slice], NDArray[Any]]
    ) -> None:
        self.shape = shape
        self._read = read
        self._blocks: OrderedDict[tuple[int, int], NDArray[Any]] = OrderedDict()

    def __getitem__(self, frame: tuple[int, int]) -> NDArray[Any]:
        """Return frame (time, angle), shape (y, x)."""
        time, angle = frame
        block = block_at(self.shape, time)
        name = (block.start, angle)
        if name not in self._blocks:
            self._blocks[name] = self._read(block, slice(angle, angle + 1))
        self._blocks.move_to_end(name)
        if len(self._blocks) > KEPT_BLOCKS:
            self._blocks.popitem(last=False)
        found: NDArray[Any] = self._blocks[name][time - block.start, 0]
        return found


def as_given(wrapped: NDArray[np.float32], usable: NDArray[np.bool_] | None = None) -> Given:
    """Return arrays (time, angle, y, x) in the form of `Given`; by default all pixels count."""
    if usable is None:
        usable = np.ones(wrapped.shape, dtype=bool)
    return Given(InMemory(wrapped), InMemory(usable))


def working_frames(shape: Sequence[int]) -> int:
    """Return how many frames of (time, angle, y, x) to work on at a time."""
    frame = max(math.prod(shape[1:]), 1)
    frames = max(WORKING_PIXELS // frame, min(FEW_FRAMES, 4 * WORKING_PIXELS // frame), 1)
    frames = min(frames, WORKING_FRAMES)
    # What lies on disk lies in blocks: parts of one are slow to write.
    block = block_frames(shape)
    return min(frames - frames % block if frames > block else frames, shape[0])


def working_blocks(shape: Sequence[int]) -> list[Block]:
    """Cut a stack into blocks to work on; results must not depend on where."""
    each = working_frames(shape)
    return [Block(t, min(t + each, shape[0])) for t in range(0, shape[0], each)]
