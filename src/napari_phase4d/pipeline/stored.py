"""Stacks on disk, written in blocks of frames, and the folder where those of a run lie."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import weakref
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io import OME_ZARR, read_results
from napari_phase4d.io.atomic import machine, put_in_place, remove_dead
from napari_phase4d.io.frame_files import FrameFiles, hold_frames
from napari_phase4d.io.zarr_results import (
    ALL_CHUNKS,
    ARRAY,
    create_blocks,
    finish_blocks,
    path_of,
    set_length,
)
from napari_phase4d.later import xr
from napari_phase4d.stack import (
    Block,
    FileStack,
    Limits,
    block_frames,
    blocks_of,
    limits_of,
    widest,
)
from napari_phase4d.task import UNWATCHED, Task, Watch, in_threads

__all__ = ["GrowingStack", "Shelf", "Stored", "new_folder", "stored_at"]


def new_folder(parent: Path, prefix: str) -> Path:
    """Return a new, empty folder whose name says which process it belongs to.

    Such folders of processes that are no more are removed first.

    Parameters
    ----------
    parent : Path
        Where to make it; made too if it is not there.
    prefix : str
        What its name begins with.

    Raises
    ------
    OSError
        If it can't be made.
    """
    try:
        parent.mkdir(parents=True, exist_ok=True)
        remove_dead(parent, prefix)
        name = f"{prefix}-{machine()}-{os.getpid()}-"
        return Path(tempfile.mkdtemp(prefix=name, dir=parent))
    except OSError as error:
        msg = f"the folder {parent} can't be written ({error.strerror}); choose another one"
        raise OSError(error.errno, msg) from error


#: Arrays that each process keeps open.
OPEN_ARRAYS = 32
ALL = slice(None)
PART_OF_PIECE = threading.Lock()
#: Frames that a growing stack has room for; what is not written takes none.
ROOM = 2**31 - 1


@dataclass(frozen=True)
class Stored:
    """A stack (time, angle, y, x) of float32 in a Zarr array.

    Several threads and processes may write different blocks at the same time, as `blocks_of` cuts
    them; threads of one process any.

    Parameters
    ----------
    path : Path
        The folder of the array.
    shape : tuple of int
        Shape of the stack.
    """

    path: Path
    shape: tuple[int, ...]

    def read(self, block: Block, angles: slice = ALL) -> NDArray[np.float32]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""
        return opened(self.path).read(block, angles)

    def write(self, block: Block, values: NDArray[np.float32], angles: slice = ALL) -> None:
        """Write the frames of a block, or some of its views."""
        opened(self.path).write(block, values, angles)


def stored_at(stack: xr.DataArray) -> Stored | None:
    """Return where a stack lies on disk, None if it is in memory."""
    path = path_of(stack)
    return None if path is None else Stored(path / ARRAY, stack.shape)


class Opened:
    """An array on disk, open for reading and for writing blocks.

    Parameters
    ----------
    path : Path
        Its folder.
    """

    def __init__(self, path: Path) -> None:
        import zarr

        self._array: Any = zarr.open_array(path, mode="r+").with_config(ALL_CHUNKS)
        self._files = FrameFiles(self._array) if hold_frames(self._array) else None

    def read(self, block: Block, angles: slice) -> NDArray[np.float32]:
        """Return the frames of a block, or some of its views, shape (time, angle, y, x)."""
        times = slice(block.start, block.stop)
        if self._files is not None:
            return self._files.read(times, angles)
        return np.asarray(self._array[times, angles], dtype=np.float32)

    def write(self, block: Block, values: NDArray[np.float32], angles: slice) -> None:
        """Write the frames of a block, or some of its views."""
        frames, n_times = self._array.chunks[0], self._array.shape[0]
        whole = not block.start % frames and (not block.stop % frames or block.stop == n_times)
        times = slice(block.start, block.stop)
        if whole and self._files is not None:
            self._files.write(times, angles, values)
            return
        # To write a part of a piece is to read, change and write it: what another thread has
        # written meanwhile would be lost.
        with nullcontext() if whole else PART_OF_PIECE:
            self._array[times, angles] = values


def opened(path: Path) -> Opened:
    """Return an array on disk, opened once."""
    status = (path / "zarr.json").stat()
    return opened_once(path, status.st_ino, status.st_mtime_ns)


@lru_cache(OPEN_ARRAYS)
def opened_once(path: Path, *_which: int) -> Opened:
    """Return an array, opened once; another one may come to lie at the same path later."""
    return Opened(path)


class Shelf:
    """The folder where the results of a run lie, each as OME-Zarr under its name.

    What is being written has a hidden name until it is whole.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        # Workers of a cluster may have been started elsewhere.
        self.folder = folder.absolute()
        #: How often it has been cleared.
        self.clearings = 0
        self._open()

    def _open(self) -> None:
        """Make the folder that holds what is needed on the way only."""
        self._scratch = new_folder(self.folder, ".phase4d")
        # The name of the folder alone: nothing of the shelf may be held by what clears it.
        self._clear = weakref.finalize(self, shutil.rmtree, self._scratch, ignore_errors=True)

    @property
    def scratch(self) -> Path:
        """The folder that holds what is needed on the way only, made anew if it was cleared."""
        if not self._clear.alive:
            self._open()
        return self._scratch

    def new(self, name: str, shape: tuple[int, ...], *, packed: bool = True) -> Stored:
        """Return an empty stack that will have this name; packed if that makes it much smaller."""
        group = self.scratch / f"{name}{OME_ZARR}"
        shutil.rmtree(group, ignore_errors=True)
        return Stored(create_blocks(group, shape, block_frames(shape), packed=packed), shape)

    def growing(self, name: str, shape: tuple[int, ...]) -> GrowingStack:
        """Return a stack of frames (angle, y, x) to which some are added as they come."""
        return GrowingStack(self.new(name, (ROOM, *shape)))

    def temporary(self, name: str, shape: tuple[int, ...], dtype: str) -> FileStack:
        """Return a stack of zeros that is needed on the way only."""
        return FileStack(self.scratch / name, shape, dtype).created()

    def put(self, name: str, stack: xr.DataArray, limits: Limits) -> xr.DataArray:
        """Give a stack that is whole now its name, with its axes and notes; return it as it lies.

        Parameters
        ----------
        name : str
            As it was given to `new`.
        stack : xarray.DataArray
            Its axes and attributes; the values do not count.
        limits : Limits
            Smallest and largest number, for programs that show it.
        """
        group = self.scratch / f"{name}{OME_ZARR}"
        finish_blocks(group, stack, limits)
        final = self.folder / group.name
        put_in_place(group, final, self.scratch / f"{name}-old")
        return read_results(final)

    def take(
        self,
        name: str,
        stack: xr.DataArray,
        task: Task = UNWATCHED,
    ) -> xr.DataArray:
        """Write a stack, in memory or lazy, under a name; return it as it lies."""
        stored = self.new(name, stack.shape)
        blocks = blocks_of(stack.shape)
        watch = Watch(len(blocks), "writing", task)

        def write(block: Block) -> Limits:
            part = np.asarray(stack.data[block.start : block.stop], dtype=np.float32)
            stored.write(block, part)
            return limits_of(part)

        return self.put(name, stack, widest(in_threads(write, blocks, watch, wait=True)))

    def clear(self) -> None:
        """Remove what was needed on the way only."""
        if self._clear.alive:
            self.clearings += 1  # first, or somebody would look for what is going
            self._clear()


class GrowingStack:
    """A stack on disk to which frames are added; a block of them is held until it is full.

    Parameters
    ----------
    stored : Stored
        Where it lies, with more room than is needed.
    """

    def __init__(self, stored: Stored) -> None:
        self.stored = stored
        self.n_times = 0
        self.limits: Limits | None = None
        self._block = block_frames(stored.shape)
        self._waiting: list[NDArray[np.float32]] = []

    def add(self, frames: NDArray[np.float32]) -> None:
        """Add frames (time, angle, y, x)."""
        for frame in frames:
            self._waiting.append(frame)
            if len(self._waiting) == self._block:
                self._write()

    def finished(self) -> Stored:
        """Write what is held, and return the stack as long as it is."""
        self._write()
        set_length(self.stored.path, self.n_times)
        return Stored(self.stored.path, (self.n_times, *self.stored.shape[1:]))

    def _write(self) -> None:
        """Write the frames that are held."""
        if not self._waiting:
            return
        values = np.stack(self._waiting)
        self._waiting.clear()
        start, self.n_times = self.n_times, self.n_times + len(values)
        self.stored.write(Block(start, self.n_times), values)
        here = limits_of(values)
        self.limits = here if self.limits is None else widest([self.limits, here])
