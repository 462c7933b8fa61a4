"""A recording cut into blocks of frames that are worked on one by one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["Block", "block_at", "block_frames", "blocks_of"]

#: Frames in a block at most: one file on disk holds so many.
BLOCK_FRAMES = 8
#: Pixels, of all views, in a block at most, unless one frame has more.
BLOCK_PIXELS = 4 * 2**20


@dataclass(frozen=True)
class Block:
    """Frames ``start`` to ``stop - 1`` of a recording."""

    start: int
    stop: int

    def __len__(self) -> int:
        """Return the number of frames."""
        return self.stop - self.start

    @property
    def times(self) -> range:
        """Numbers of its frames."""
        return range(self.start, self.stop)


def block_frames(shape: Sequence[int]) -> int:
    """Return how many frames a block of a stack (time, angle, y, x) has."""
    fitting = BLOCK_PIXELS // max(math.prod(shape[1:]), 1)
    return max(1, min(BLOCK_FRAMES, fitting, shape[0]))


def blocks_of(shape: Sequence[int]) -> list[Block]:
    """Cut a stack (time, angle, y, x) into blocks; only the last may be shorter."""
    return [block_at(shape, start) for start in range(0, shape[0], block_frames(shape))]


def block_at(shape: Sequence[int], time: int) -> Block:
    """Return the block that a frame of a stack lies in."""
    frames = block_frames(shape)
    start = time // frames * frames
    return Block(start, min(start + frames, shape[0]))
