"""Stacks (time, angle, y, x) that are read and written a block of frames at a time.

And those that lie on disk, as they come in: a part at a time, or whole where all frames are needed
at once and memory allows it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.machine import free_memory
from napari_phase4d.stacks import AXES, in_full
from napari_phase4d.words import size_in_words

__all__ = [
    "PART_BYTES",
    "Block",
    "FileStack",
    "InMemory",
    "Limits",
    "Memory",
    "ReadOnly",
    "Stack",
    "Store",
    "Temporary",
    "Unwritten",
    "block_at",
    "block_frames",
    "blocks_of",
    "blocks_outwards",
    "each_frame",
    "frame_of",
    "in_memory",
    "is_same",
    "known_limits",
    "limits_of",
    "parts_over_time",
    "read_all",
    "room_in",
    "stack_of",
    "widest",
    "write_all",
]

ALL = slice(None)
#: A block has so many frames at most: one file on disk holds so many. Of small frames there are
#: more in a block, since a file takes the time of many pixels.
BLOCK_FRAMES, SMALL_FRAMES = 8, 32
#: Pixels, of all views, in a block at most, unless one frame has more; in one of small frames.
BLOCK_PIXELS, SMALL_PIXELS = 4 * 2**20, 2**20


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

    def wider(self, before: int, after: int, n: int) -> Block:
        """Return the block with more frames at both ends, as far as there are any of n."""
        return Block(max(self.start - before, 0), min(self.stop + after, n))

    def with_neighbours(self, n: int) -> Block:
        """Return the block with the frame before and after, and three at least if n are so many.

        What is averaged over three frames leaves an axis alone that has no three.
        """
        found = self.wider(1, 1, n)
        return found if len(found) >= 3 else self.wider(2, 2, n)

    def of(self, wider: Block) -> slice:
        """Return where the block lies in one that contains it."""
        return slice(self.start - wider.start, self.stop - wider.start)


def block_frames(shape: Sequence[int]) -> int:
    """Return how many frames a block of a stack (time, angle, y, x) has."""
    frame = max(math.prod(shape[1:]), 1)
    small = min(SMALL_FRAMES, SMALL_PIXELS // frame)
    return max(1, min(max(small, min(BLOCK_FRAMES, BLOCK_PIXELS // frame)), shape[0]))


def blocks_of(shape: Sequence[int], frames: int = 0) -> list[Block]:
    """Cut a stack (time, angle, y, x) into blocks; only the last may be shorter.

    Parameters
    ----------
    shape : sequence of int
        Of the stack; nothing but the number of times counts if ``frames`` is given.
    frames : int, optional
        Frames of a block; default as `block_frames` says.
    """
    each = frames or block_frames(shape)
    return [Block(t, min(t + each, shape[0])) for t in range(0, shape[0], each)]


def blocks_outwards(n: int, start: int, frames: int) -> tuple[list[Block], list[Block]]:
    """Cut n frames into blocks from one frame outwards: those from it on, and those before it.

    Examples
    --------
    >>> ahead, behind = blocks_outwards(7, 3, 2)
    >>> [list(block.times) for block in ahead]
    [[3, 4], [5, 6]]
    >>> [list(block.times) for block in behind]
    [[1, 2], [0]]
    """
    ahead = [Block(t, min(t + frames, n)) for t in range(start, n, frames)]
    behind = [Block(max(t - frames, 0), t) for t in range(start, 0, -frames)]
    return ahead, behind


def block_at(shape: Sequence[int], time: int) -> Block:
    """Return the block that a frame of a stack lies in."""
    frames = block_frames(shape)
    start = time // frames * frames
    return Block(start, min(start + frames, shape[0]))


#: Smallest and largest number of a stack.
Limits = tuple[float, float]


def known_limits(values: NDArray[Any]) -> Limits:
    """Return the smallest and the largest number that is finite; NaN if there is none."""
    if values.size:
        low, high = float(values.min()), float(values.max())
        if math.isfinite(low) and math.isfinite(high):  # as nearly always: no copy is needed
            return low, high
    known = values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)


def limits_of(values: NDArray[np.float32]) -> Limits:
    """Return the smallest and the largest number that is finite; 0 if there is none."""
    low, high = known_limits(values)
    return (0.0, 0.0) if math.isnan(low) else (low, high)


def widest(limits: Iterable[Limits]) -> Limits:
    """Return the limits of all parts together."""
    lows, highs = zip(*limits, strict=True)
    return min(lows), max(highs)


class Stack(Protocol):
    """Numbers over (time, angle, y, x), wherever they lie."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole stack."""

    def read(self, block: Block, angles: slice = ALL) -> NDArray[Any]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""

    def write(self, block: Block, values: NDArray[Any], angles: slice = ALL) -> None:
        """Write the frames of a block, or some of its views; threads may write side by side."""


class Temporary(Stack, Protocol):
    """A stack that is needed on the way; it is read and written across the frames as well."""

    def read_pixels(self, pixels: Block) -> NDArray[Any]:
        """Return some pixels at all times, shape (time, pixel), counted over angle, y and x."""

    def write_pixels(self, pixels: Block, values: NDArray[Any]) -> None:
        """Write some pixels at all times."""


class Store(Protocol):
    """Where stacks lie that are needed on the way."""

    def temporary(self, name: str, shape: tuple[int, ...], dtype: str) -> Temporary:
        """Return a new stack of zeros."""


class ReadOnly:
    """A stack that follows from others, or is somebody else's: nothing is written into it."""

    def write(self, block: Block, values: NDArray[Any], angles: slice = ALL) -> None:
        """Refuse."""
        msg = f"{type(self).__name__} is only read"
        raise TypeError(msg)


class InMemory:
    """A stack in memory.

    Parameters
    ----------
    values : ndarray of shape (time, angle, y, x)
        Its numbers. What is read is a view of them, not to be written into.
    """

    def __init__(self, values: NDArray[Any]) -> None:
        self._values = values

    @property
    def values(self) -> NDArray[Any]:
        """Its numbers."""
        return self._values

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole stack."""
        return self.values.shape

    def read(self, block: Block, angles: slice = ALL) -> NDArray[Any]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""
        return self.values[block.start : block.stop, angles]

    def write(self, block: Block, values: NDArray[Any], angles: slice = ALL) -> None:
        """Write the frames of a block, or some of its views."""
        place = self.values[block.start : block.stop, angles]
        if not is_same(place, values):
            place[...] = values

    def read_pixels(self, pixels: Block) -> NDArray[Any]:
        """Return some pixels at all times, shape (time, pixel)."""
        return self.values.reshape(len(self.values), -1)[:, pixels.start : pixels.stop]

    def write_pixels(self, pixels: Block, values: NDArray[Any]) -> None:
        """Write some pixels at all times; the numbers must lie in order."""
        self.values.reshape(len(self.values), -1)[:, pixels.start : pixels.stop] = values


class Unwritten(InMemory):
    """A stack in memory that takes none before it is first written to; for one process.

    Parameters
    ----------
    shape : tuple of int
        (time, angle, y, x).
    dtype : str
        Type of its numbers, which are anything where they have not been written.
    """

    def __init__(self, shape: tuple[int, ...], dtype: str) -> None:
        self._shape, self._dtype = shape, dtype
        self._made, self._lock = False, threading.Lock()

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole stack."""
        return self._shape

    @property
    def values(self) -> NDArray[Any]:
        """Its numbers."""
        with self._lock:  # threads begin to write side by side
            if not self._made:
                self._values, self._made = np.empty(self._shape, self._dtype), True
        return self._values


def room_in(stack: Stack, block: Block, dtype: Any, angles: slice = ALL) -> NDArray[Any]:
    """Return an array of any content for the frames of a block, to be written to the stack then.

    It is the place itself where the stack lies in memory: that spares a copy.
    """
    if isinstance(stack, InMemory) and stack.values.dtype == dtype:
        return stack.values[block.start : block.stop, angles]
    n_angles = len(range(*angles.indices(stack.shape[1])))
    return np.empty((len(block), n_angles, *stack.shape[2:]), dtype)


def is_same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Say whether two arrays are the same place in memory."""
    return (
        isinstance(other, np.ndarray)
        and one.dtype == other.dtype
        and one.shape == other.shape
        and one.strides == other.strides
        and one.__array_interface__["data"] == other.__array_interface__["data"]
    )


class Memory:
    """Makes stacks in memory."""

    def temporary(self, name: str, shape: tuple[int, ...], dtype: str) -> InMemory:
        """Return a new stack of zeros."""
        return InMemory(np.zeros(shape, dtype))


@dataclass(frozen=True)
class FileStack:
    """A stack in a file of its own, nothing but its numbers.

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

    def created(self) -> FileStack:
        """Make the file, all zeros, and return the stack."""
        with self.path.open("wb") as file:
            file.truncate(math.prod(self.shape) * np.dtype(self.dtype).itemsize)
        return self

    def read(self, block: Block, angles: slice = ALL) -> NDArray[Any]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""
        first, last, _ = angles.indices(self.shape[1])
        frames = (last - first, *self.shape[2:])
        found = np.empty((len(block), *frames), self.dtype)
        with self.path.open("rb", 0) as file:
            if last - first == self.shape[1]:
                file.seek(self._place(block.start, 0))
                read_all(file, found)
            else:
                for time, one in zip(block.times, found, strict=True):
                    file.seek(self._place(time, first))
                    read_all(file, one)
        return found

    def write(self, block: Block, values: NDArray[Any], angles: slice = ALL) -> None:
        """Write the frames of a block, or some of its views."""
        first, last, _ = angles.indices(self.shape[1])
        whole: Any = np.ascontiguousarray(values, self.dtype)
        # Unlike ``tofile`` this says when the disk is full.
        with self.path.open("r+b") as file:
            if last - first == self.shape[1]:
                file.seek(self._place(block.start, 0))
                file.write(whole.data)
                return
            for time, frames in zip(block.times, whole, strict=True):
                file.seek(self._place(time, first))
                file.write(frames.data)

    def read_pixels(self, pixels: Block) -> NDArray[Any]:
        """Return some pixels at all times, shape (time, pixel)."""
        found = np.empty((self.shape[0], len(pixels)), self.dtype)
        with self.path.open("rb") as file:
            for time, row in enumerate(found):
                file.seek(self._place(time, 0) + pixels.start * found.itemsize)
                read_all(file, row)
        return found

    def write_pixels(self, pixels: Block, values: NDArray[Any]) -> None:
        """Write some pixels at all times."""
        whole = np.ascontiguousarray(values, self.dtype)
        with self.path.open("r+b") as file:
            for time, row in enumerate(whole):
                file.seek(self._place(time, 0) + pixels.start * whole.itemsize)
                file.write(row.data)

    def _place(self, time: int, angle: int) -> int:
        """Return where in the file a frame begins."""
        frame = math.prod(self.shape[2:]) * np.dtype(self.dtype).itemsize
        return (time * self.shape[1] + angle) * frame


def read_all(file: FileIO | BufferedReader, out: NDArray[Any]) -> None:
    """Read numbers from where a file stands into an array in order.

    Raises
    ------
    OSError
        If the file ends before.
    """
    rest = out.reshape(-1).view(np.uint8)
    while rest.size:
        count = file.readinto(rest.data)
        if not count:
            msg = f"{file.name} is cut short"
            raise OSError(msg)
        rest = rest[count:]


def write_all(file: FileIO, values: memoryview | bytes) -> None:
    """Write bytes to where a file stands, all of them: a file may take some at a time."""
    rest = memoryview(values)
    while rest:
        rest = rest[file.write(rest) or 0 :]


# ---- stacks that come in --------------------------------------------------------------------


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
