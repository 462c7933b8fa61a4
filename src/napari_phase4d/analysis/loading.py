"""Stacks that lie on disk, brought into memory where all frames are needed at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.axes import AXES, in_full
from napari_phase4d.machine import free_memory
from napari_phase4d.stack import Block, InMemory, ReadOnly, Stack
from napari_phase4d.words import size_in_words

__all__ = ["PART_BYTES", "each_frame", "frame_of", "in_memory", "parts_over_time", "stack_of"]

#: Copies that work on a whole stack makes of it, about.
COPIES = 4
#: Bytes that are read at a time.
PART_BYTES = 64 * 2**20


def in_memory(stack: xr.DataArray) -> xr.DataArray:
    """Return a stack whose numbers are in memory.

    Raises
    ------
    OSError
        If they lie on disk and are too many to work on all at once.
    """
    if stack.chunks is None:
        return stack
    needed, free = COPIES * stack.nbytes, free_memory()
    if needed > free:
        msg = (
            f"this looks at all frames at once and needs about {size_in_words(needed)} of memory, "
            f"but {size_in_words(free)} are free; take some frames only, such as "
            "stack.isel(time=slice(200))"
        )
        raise OSError(msg)
    return stack.copy(data=np.asarray(stack.data))


def frame_of(stack: xr.DataArray, time: int, angle: int) -> NDArray[Any]:
    """Return one frame (y, x) of a stack (time, angle, y, x), wherever it lies."""
    return np.asarray(stack.data[time, angle])


def parts_over_time(stack: xr.DataArray, more: int = 0) -> Iterator[tuple[slice, NDArray[Any]]]:
    """Yield the times of a part of a stack (time, ...) and its values, part after part.

    Each part may hold so many times more, of the next one.
    """
    n_times = stack.shape[0]
    if stack.chunks is None:
        yield slice(0, n_times), stack.values
        return
    chunk = max(int(stack.data.chunksize[0]), 1)
    at_once = max(1, PART_BYTES // max(chunk * stack[0].nbytes, 1)) * chunk
    for start in range(0, n_times, at_once):
        part = slice(start, min(start + at_once + more, n_times))
        yield part, np.asarray(stack.data[part])


def each_frame(stack: xr.DataArray) -> Iterator[NDArray[Any]]:
    """Yield the frames (y, x) of a stack (time, angle, y, x), of which few are in memory."""
    for _, values in parts_over_time(stack):
        yield from values.reshape(-1, *values.shape[2:])


class LazyStack(ReadOnly):
    """A stack that is read from where it lies, to be read only.

    Parameters
    ----------
    stack : DataArray
        Any of the dims (time, angle, y, x).
    """

    def __init__(self, stack: xr.DataArray) -> None:
        self._stack = stack
        self.shape = tuple(stack.sizes.get(axis, 1) for axis in AXES)

    def read(self, block: Block, angles: slice = slice(None)) -> NDArray[Any]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""
        chosen = {"time": slice(block.start, block.stop), "angle": angles}
        part = self._stack.isel({d: c for d, c in chosen.items() if d in self._stack.dims})
        return in_full(part)


def stack_of(stack: xr.DataArray) -> Stack:
    """Return a stack to be read a block of frames at a time, wherever it lies."""
    return InMemory(in_full(stack)) if stack.chunks is None else LazyStack(stack)
