"""What is needed on the way only: stacks in plain files, read and written in blocks."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.pipeline.streaming.blocks import Block, block_at

__all__ = ["KeptFrames", "ReadBlocks", "Scratch"]

#: Blocks that `KeptFrames` holds.
KEPT_BLOCKS = 8


class ReadBlocks(Protocol):
    """A stack (time, angle, y, x) on disk."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole stack."""

    def read(self, block: Block, angles: slice = slice(None)) -> NDArray[Any]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""


@dataclass(frozen=True)
class Scratch:
    """A stack (time, angle, y, x) in a file of its own, nothing but its numbers.

    Several threads and processes may write different frames at the same time.

    Parameters
    ----------
    path : Path
        The file.
    shape : tuple of int
        Shape of the stack.
    dtype : str
        Type of its numbers.
    """

    path: Path
    shape: tuple[int, ...]
    dtype: str

    def created(self) -> Scratch:
        """Make the file, all zeros, and return the stack."""
        with self.path.open("wb") as file:
            file.truncate(math.prod(self.shape) * np.dtype(self.dtype).itemsize)
        return self

    def read(self, block: Block, angles: slice = slice(None)) -> NDArray[Any]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""
        first, last, _ = angles.indices(self.shape[1])
        frames = (last - first, *self.shape[2:])
        if last - first == self.shape[1]:
            return self._read(self._place(block.start, 0), (len(block), *frames))
        return np.stack([self._read(self._place(t, first), frames) for t in block.times])

    def _read(self, start: int, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return numbers from somewhere in the file."""
        flat = np.fromfile(self.path, self.dtype, math.prod(shape), offset=start)
        return flat.reshape(shape)

    def write(self, block: Block, values: NDArray[Any]) -> None:
        """Write the frames of a block."""
        self._write(self._place(block.start, 0), values)

    def write_frame(self, time: int, angle: int, values: NDArray[Any]) -> None:
        """Write one frame."""
        self._write(self._place(time, angle), values)

    def _write(self, start: int, values: NDArray[Any]) -> None:
        with self.path.open("r+b") as file:
            file.seek(start)
            # Unlike ``tofile`` this says when the disk is full.
            whole: Any = np.ascontiguousarray(values, self.dtype)
            file.write(whole.data)

    def _place(self, time: int, angle: int) -> int:
        """Return where in the file a frame begins."""
        frame = math.prod(self.shape[2:]) * np.dtype(self.dtype).itemsize
        return (time * self.shape[1] + angle) * frame


class KeptFrames:
    """Single frames of a stack on disk, of which a few blocks are held.

    Parameters
    ----------
    stack : ReadBlocks
        What is read.
    """

    def __init__(self, stack: ReadBlocks) -> None:
        self.shape = stack.shape
        self._stack = stack
        self._blocks: OrderedDict[tuple[int, int], NDArray[Any]] = OrderedDict()

    def __getitem__(self, frame: tuple[int, int]) -> NDArray[Any]:
        """Return frame (time, angle), shape (y, x)."""
        time, angle = frame
        block = block_at(self.shape, time)
        name = (block.start, angle)
        if name not in self._blocks:
            self._blocks[name] = self._stack.read(block, slice(angle, angle + 1))
        self._blocks.move_to_end(name)
        if len(self._blocks) > KEPT_BLOCKS:
            self._blocks.popitem(last=False)
        found: NDArray[Any] = self._blocks[name][time - block.start, 0]
        return found
