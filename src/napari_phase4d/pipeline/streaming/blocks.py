"""A recording cut into blocks of frames that are worked on one by one."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["BLOCK_FRAMES", "Block", "blocks_of"]

#: Frames in a block: one file on disk holds so many.
BLOCK_FRAMES = 16


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


def blocks_of(n_frames: int) -> list[Block]:
    """Cut so many frames into blocks; only the last may be shorter."""
    starts = range(0, n_frames, BLOCK_FRAMES)
    return [Block(start, min(start + BLOCK_FRAMES, n_frames)) for start in starts]
