"""Files that hold frames of one view each, as Zarr lays them, read and written straight."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
from google_crc32c import extend as more_of_sum
from numpy.typing import NDArray

from napari_phase4d.stack import read_all, write_all

__all__ = ["FrameFiles", "hold_frames"]

#: Bytes of a checksum.
SUM_BYTES = 4
#: So many bytes are rather copied than read or written frame by frame.
FEW_BYTES = 2**23


class FrameFiles:
    """The files of an array on disk, read and written straight, packed or not.

    A file holds the numbers of some frames of one view, one after the other, and a checksum.
    Zarr, which does it on a thread of its own, takes three to ten times as long.

    Parameters
    ----------
    array : zarr.Array
        An open one, for which `hold_frames` holds.
    """

    def __init__(self, array: Any) -> None:
        self._folder: Path = Path(array.store.root) / array.path
        self._key: Callable[[tuple[int, ...]], str] = array.metadata.encode_chunk_key
        self._shape, self._frames = array.shape, array.chunks[0]
        self._packer = packer_of(array.compressors[0]) if len(array.compressors) > 1 else None

    def read(self, times: slice, angles: slice) -> NDArray[np.float32]:
        """Return some frames, shape (time, angle, y, x).

        Raises
        ------
        OSError
            If a file is missing, cut short, too long, or damaged; where it is not packed, the last
            can only be told if all of its frames are asked for.
        """
        times = slice(times.start, min(times.stop, self._shape[0]))
        views = range(*angles.indices(self._shape[1]))
        found = np.empty((times.stop - times.start, len(views), *self._shape[2:]), np.float32)
        for frames in self._files(times):
            here = found[frames.start - times.start : frames.stop - times.start]
            for column, view in enumerate(views):
                self._read_file(frames, view, here[:, column])
        return found

    def write(self, times: slice, angles: slice, values: NDArray[np.float32]) -> None:
        """Write frames (time, angle, y, x) that fill their files, as far as there are any."""
        views = range(*angles.indices(self._shape[1]))
        shape = (times.stop - times.start, len(views), *self._shape[2:])
        if values.shape != shape:
            msg = f"frames of shape {values.shape} can't be written where {shape} belong"
            raise ValueError(msg)
        for frames in self._files(times):
            here = values[frames.start - times.start : frames.stop - times.start]
            for column, view in enumerate(views):
                self._write_file(self._path(frames.start, view), here[:, column])

    def _files(self, times: slice) -> Iterator[slice]:
        """Yield which of some times lie in the same file."""
        start = times.start
        while start < times.stop:
            stop = min((start // self._frames + 1) * self._frames, times.stop)
            yield slice(start, stop)
            start = stop

    def _path(self, time: int, view: int) -> Path:
        """Return the file of a frame."""
        return self._folder / self._key((time // self._frames, view, 0, 0))

    def _read_file(self, times: slice, view: int, out: NDArray[np.float32]) -> None:
        """Read some frames of a view from the file in which they lie."""
        path, first = self._path(times.start, view), times.start % self._frames
        if self._packer is not None:
            out[...] = self._unpacked(path, self._packer)[first : first + len(out)]
            return
        size, last = out[0].nbytes, times.stop == self._shape[0]
        with opened_file(path) as file:
            if path.stat().st_size != self._frames * size + SUM_BYTES:
                msg = f"{path} is damaged: it is cut short or too long"
                raise OSError(msg)
            file.seek(first * size)
            total = 0
            for place, part in read_in_parts(out):
                read_all(file, part)
                total = more_of_sum(total, bytes_of(part))
                if place is not part:
                    place[...] = part
            if first == 0 and (last or len(out) == self._frames):
                beyond = (self._frames - len(out)) * size
                total = more_of_sum(total, file.read(beyond)) if beyond else total
                check_sum(path, total, file.read(SUM_BYTES))

    def _unpacked(self, path: Path, packer: Any) -> NDArray[np.float32]:
        """Return all frames of a packed file."""
        with opened_file(path) as file:
            content = file.readall()
        # First of all: Blosc is not made for what is cut short.
        packed, noted = content[:-SUM_BYTES], content[-SUM_BYTES:]
        check_sum(path, more_of_sum(0, packed), noted)
        frames = np.empty((self._frames, *self._shape[2:]), np.float32)
        if said_sizes(packed) != (frames.nbytes, len(packed)):
            msg = f"{path} is damaged: it holds more or less than its frames"
            raise OSError(msg)
        try:
            packer.decode(packed, frames)
        except (RuntimeError, ValueError) as error:
            msg = f"{path} is damaged: it can't be unpacked"
            raise OSError(msg) from error
        return frames

    def _write_file(self, path: Path, frames: NDArray[np.float32]) -> None:
        """Write a file under another name first: what reads it finds the whole of it, or none.

        The last file of a view has as many frames as all others: those beyond the end are 0.
        """
        partial, total = path.with_suffix(f".{uuid.uuid4().hex}.partial"), 0
        beyond = np.zeros((self._frames - len(frames), *self._shape[2:]), np.float32)
        # Numbers as they come may be of another type, or lie in another order.
        whole = frames.nbytes <= FEW_BYTES or self._packer is not None
        several = [frames] if whole else list(frames)
        parts = [np.ascontiguousarray(part, np.float32) for part in (*several, beyond)]
        if self._packer is not None:
            parts = [np.frombuffer(self._packer.encode(np.concatenate(parts)), np.uint8)]
        try:
            with new_file(partial) as file:
                for part in parts:
                    numbers = bytes_of(part)
                    total = more_of_sum(total, numbers)
                    write_all(file, numbers.data)
                write_all(file, bytes_of_sum(total))
            partial.replace(path)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise


def read_in_parts(
    out: NDArray[np.float32],
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield frames that lie one after the other in a file, and where to read them to.

    They are one part if they lie so in memory too, or are few bytes: to copy these takes less than
    to read them frame by frame.
    """
    if out.flags.c_contiguous:
        yield out, out
    elif out.nbytes <= FEW_BYTES:
        yield out, np.empty(out.shape, np.float32)
    else:
        for frame in out:
            yield frame, frame


def new_file(path: Path) -> FileIO:
    """Return a new file, open for writing, in a folder that is made if it is not there."""
    try:
        return path.open("xb", 0)
    except FileNotFoundError:  # to ask ahead takes longer than to write a small file
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("xb", 0)


def opened_file(path: Path) -> FileIO:
    """Return a file of frames, open for reading."""
    try:
        return path.open("rb", 0)
    except FileNotFoundError:
        msg = f"{path} is missing; were stacks of a run moved or removed?"
        raise OSError(msg) from None


def bytes_of(frames: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the bytes of numbers that lie in order."""
    return frames.reshape(-1).view(np.uint8)


def bytes_of_sum(total: int) -> bytes:
    """Return a checksum as it ends a file."""
    return total.to_bytes(SUM_BYTES, "little")


def said_sizes(packed: bytes) -> tuple[int, int]:
    """Return how many bytes Blosc says that it holds and takes, in bytes 4 to 7 and 12 to 15."""
    return int.from_bytes(packed[4:8], "little"), int.from_bytes(packed[12:16], "little")


def check_sum(path: Path, total: int, noted: bytes) -> None:
    """Raise an error if the checksum of a file is not the one that it holds."""
    if noted != bytes_of_sum(total):
        msg = f"{path} is damaged: its checksum is another"
        raise OSError(msg)


def hold_frames(array: Any) -> bool:
    """Say whether the files of an open array hold float32 frames as `FrameFiles` takes them."""
    from zarr.codecs import BloscCodec, BytesCodec, Crc32cCodec

    *packers, last = array.compressors or (None,)
    summed = isinstance(last, Crc32cCodec) and len(packers) <= 1
    known = all(isinstance(packer, BloscCodec) for packer in packers)
    as_here = BytesCodec() == array.serializer and array.dtype == np.float32 and not array.filters
    whole = not array.shards and array.chunks[1:] == (1, *array.shape[2:])
    return summed and known and as_here and whole


def packer_of(codec: Any) -> Any:
    """Return what packs numbers as Blosc in Zarr does."""
    from numcodecs import Blosc  # which takes a tenth of a second

    shuffles = {"noshuffle": Blosc.NOSHUFFLE, "shuffle": Blosc.SHUFFLE}
    shuffle = shuffles.get(codec.shuffle.value, Blosc.BITSHUFFLE)
    return Blosc(codec.cname.value, codec.clevel, shuffle, codec.blocksize)
