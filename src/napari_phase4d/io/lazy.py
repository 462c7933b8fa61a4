"""Frames that are read one at a time, when they are asked for, or mapped into memory."""

from __future__ import annotations

import mmap
import uuid
import zlib
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from napari_phase4d.io.video import MOST_LISTED_FRAMES
from napari_phase4d.recording import remember_reader

__all__ = [
    "FrameReader",
    "MappedFrames",
    "Stamp",
    "Unsound",
    "WrongFrameError",
    "beside",
    "in_one_line",
    "lazy_frames",
    "map_frames",
    "stamp_of",
]

#: Size in bytes, time of the last change in nanoseconds, and the number of the file on its disk.
Stamp = tuple[int, int, int]
#: First and last byte of numbers in a file, and a sum of those near either.
Ends = tuple[int, int, int]
#: How many bytes near either end are summed.
SUMMED = 4096


class MappedFrames(np.memmap[Any, Any]):
    """A read-only memory map that looks at its file before it gives a part of it.

    The system ends a program that touches a mapped file behind its end, so a file that became
    shorter must be noticed before. A process that gets it by pickle maps the file itself.
    """

    stamp: Stamp | None
    ends: Ends | None

    def __array_finalize__(self, obj: Any) -> None:
        super().__array_finalize__(obj)
        self.stamp = getattr(obj, "stamp", None)
        self.ends = getattr(obj, "ends", None)

    def __getitem__(self, key: Any) -> Any:
        if self.stamp is not None and self._is_map():
            check_unchanged(Path(str(self.filename)), self.stamp, key, self.ends)
        return super().__getitem__(key)

    def __reduce__(self) -> Any:
        if self.stamp is None or not self._is_map():
            return np.asarray(self).__reduce__()
        return (
            map_frames,
            (Path(str(self.filename)), self.dtype, self.shape, self._place(), self.strides),
        )

    def _is_map(self) -> bool:
        """Say whether the numbers lie in the file, and are no copy or result."""
        return getattr(self, "_mmap", None) is not None

    def _place(self) -> int:
        """Return the place of the first number in the file, in bytes."""
        mapped = np.frombuffer(self._mmap, np.uint8)  # type: ignore[attr-defined]
        start = self.offset - self.offset % mmap.ALLOCATIONGRANULARITY
        return int(start + self.ctypes.data - mapped.ctypes.data)


def map_frames(
    path: Path,
    dtype: DTypeLike,
    shape: tuple[int, ...],
    offset: int = 0,
    strides: tuple[int, ...] | None = None,
) -> NDArray[Any]:
    """Map numbers that lie in a file as they are.

    Parameters
    ----------
    path : Path
        The file.
    dtype : dtype
        What the numbers are, with their byte order.
    shape : tuple of int
        Of the array.
    offset : int, optional
        Bytes before the first number.
    strides : tuple of int, optional
        Bytes from one number to the next along each axis; default: without gaps.

    Raises
    ------
    OSError
        If the file is too short.
    """
    dtype = np.dtype(dtype)
    if strides is None:
        strides = tuple(dtype.itemsize * n for n in np.cumprod((1, *shape[:0:-1]))[::-1].tolist())
    length = sum(s * (n - 1) for s, n in zip(strides, shape, strict=True)) + dtype.itemsize
    stamp = stamp_of(path)
    if stamp[0] < offset + length:
        msg = (
            f"{path.name} is cut short: {announced(shape)} {offset + length} bytes, the file "
            f"has {stamp[0]}"
        )
        raise OSError(msg)
    numbers = MappedFrames(path, np.uint8, "r", offset, (length,))
    frames: NDArray[Any] = np.ndarray.__new__(
        MappedFrames, shape, dtype, buffer=numbers, strides=strides
    )
    for name in ("_mmap", "filename", "offset", "mode"):
        setattr(frames, name, getattr(numbers, name))
    frames.stamp = stamp  # type: ignore[attr-defined]
    frames.ends = ends_of(path, offset, offset + length)  # type: ignore[attr-defined]
    return frames


def announced(shape: tuple[int, ...]) -> str:
    """Say what needs so many bytes."""
    if len(shape) < 3 or shape[0] == 1:
        return "one frame needs"
    return f"{shape[0]} frames need"


def stamp_of(path: Path) -> Stamp:
    """Return the size of a file, when it was changed, and which file it is."""
    found = path.stat()
    return found.st_size, found.st_mtime_ns, found.st_ino


def ends_of(path: Path, start: int, stop: int) -> Ends:
    """Return where numbers lie in a file, and a sum that tells whether they are others by now."""
    near = min(SUMMED, stop - start)
    with path.open("rb") as file:
        file.seek(start)
        found = zlib.crc32(file.read(near))
        file.seek(stop - near)
        return start, stop, zlib.crc32(file.read(near), found)


def check_unchanged(path: Path, stamp: Stamp, key: Any, ends: Ends | None = None) -> None:
    """Raise OSError if a file is gone, shorter, or was written anew since it was opened.

    One that grows, as the camera still writes it, holds what it held: it is the same file, and
    the numbers at the ends of those that were in it, where they are known, are the same.
    """
    try:
        found = stamp_of(path)
        size, same_file = found[0], found[2] == stamp[2]
        grown = size > stamp[0] and same_file
        if found == stamp or (grown and (ends is None or ends_of(path, *ends[:2]) == ends)):
            return
    except OSError:
        what = "is gone"
    else:
        what = "became shorter" if size < stamp[0] else "was written anew"
    first = key[0] if isinstance(key, tuple) and key else key
    where = f"frame {int(first)}" if isinstance(first, (int, np.integer)) else "frames"
    msg = f"{where} of {path.name} can't be read: the file {what} since it was opened"
    raise OSError(msg)


#: Longest part of another program's message that is passed on.
LONGEST = 160


class WrongFrameError(ValueError):
    """A frame was read well, but doesn't fit the recording; its message is for the user."""


class Unsound(OSError):  # noqa: N818 - it is an OSError to everybody else
    """What a file says of itself can't be true, or may not be followed; its message is whole."""


def beside(path: Path, name: str) -> Path:
    """Return the place of a file that another one names as a part of it.

    Only what lies in the folder of that file, or below, is followed: a file that came from
    elsewhere must not bring in others of the user's.

    Raises
    ------
    Unsound
        If it lies elsewhere, itself or as a link, or is no file.
    """
    other = path.parent / name
    if not other.resolve().is_relative_to(path.parent.resolve()):
        msg = f"{path.name} needs {name}, which is in another folder and not followed; copy it"
        raise Unsound(msg)
    if other.exists() and not other.is_file():
        msg = f"{path.name} needs {name}, which is not a file, but a folder, a pipe or a device"
        raise Unsound(msg)
    return other


class FrameReader(ABC):
    """Reads single frames of one file or folder; several threads may ask at once.

    Another process gets a reader as the arguments it was made with, and opens the file itself.

    Parameters
    ----------
    path : Path
        The file or folder, named in messages.
    shape : tuple of int
        (time, y, x).
    dtype : dtype
        Of every frame.
    """

    #: What ``__init__`` takes; each is an attribute of the same name.
    arguments: ClassVar[tuple[str, ...]] = ("path", "shape", "dtype")

    def __init__(self, path: Path, shape: tuple[int, int, int], dtype: np.dtype[Any]) -> None:
        self.path = path
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self.stamp = stamp_of(path) if path.is_file() else None

    @property
    def ndim(self) -> int:
        """Number of axes, always 3."""
        return 3

    @abstractmethod
    def read(self, index: int) -> NDArray[Any]:
        """Return frame ``index`` from 0, shape (y, x); any error of a library may come out."""

    def frame(self, index: int) -> NDArray[Any]:
        """Return frame ``index`` from 0, shape (y, x).

        Raises
        ------
        OSError
            If it can't be read, or the file is another one than when it was opened; one sentence
            names the file, and the frame unless it is the whole file that is wrong.
        ValueError
            If the frame is readable but of another size or kind than the first one.
        """
        if self.stamp is not None:  # libraries read on, and give zeros behind the end
            check_unchanged(self.path, self.stamp, index)
        try:
            frame = np.asarray(self.read(index))
        except (WrongFrameError, Unsound):
            raise
        except Exception as error:
            # Readers stand on libraries that raise what they like, even KeyError or zlib.error.
            msg = (
                f"frame {index} of {self.path.name} can't be read, as the file is damaged or was "
                f"changed or removed since it was opened ({in_one_line(error)})"
            )
            raise OSError(msg) from error
        if frame.shape != self.shape[1:] or frame.dtype != self.dtype:
            msg = (
                f"frame {index} of {self.path.name} is {frame.dtype} {frame.shape}, but the "
                f"recording is {self.dtype} {self.shape[1:]}; all frames must be of one kind"
            )
            raise WrongFrameError(msg)
        return frame

    def __reduce__(self) -> tuple[type[FrameReader], tuple[Any, ...]]:
        return type(self), tuple(getattr(self, name) for name in self.arguments)

    def __getitem__(self, key: int | slice | tuple[int | slice, ...]) -> NDArray[Any]:
        first, *rest = key if isinstance(key, tuple) else (key,)
        if not isinstance(first, slice):  # dask joins what it is asked for into one key
            return np.asarray(self.frame(range(self.shape[0])[first])[tuple(rest)])
        numbers = range(self.shape[0])[first]
        if len(numbers) == 1:
            return self.frame(numbers[0])[(None, *rest)]
        block = np.empty((len(numbers), *self.shape[1:]), self.dtype)
        for place, number in enumerate(numbers):
            block[place] = self.frame(number)
        return block[(slice(None), *rest)]


def lazy_frames(reader: FrameReader) -> Any:
    """Return a dask array (time, y, x) that reads a frame a chunk.

    Single frames that a `Recording` is asked for in this process don't go through dask's graph.

    Raises
    ------
    OSError
        If there are absurdly many.
    """
    if reader.shape[0] > MOST_LISTED_FRAMES:
        msg = (
            f"{reader.path.name} says that it has {reader.shape[0]} frames, more than can be "
            "listed; it may be damaged"
        )
        raise OSError(msg)
    import dask.array as da

    # A name of its own spares dask the hashing of a reader, which it can't do the same way twice.
    frames = da.from_array(
        reader,
        chunks=(1, *reader.shape[1:]),
        name=f"frames-{uuid.uuid4().hex}",
        fancy=False,
        meta=np.empty((0, 0, 0), reader.dtype),
    )
    remember_reader(frames.name, reader)
    return frames


def in_one_line(error: BaseException) -> str:
    """Return what an error says in one line of bounded length, else what it is."""
    said = " ".join(str(error).split()) or type(error).__name__
    return said if len(said) <= LONGEST else f"{said[:LONGEST]}..."
