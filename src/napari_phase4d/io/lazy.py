"""Frames that are read one at a time, when they are asked for."""

from __future__ import annotations

import uuid
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.limits import MOST_LISTED_FRAMES
from napari_phase4d.io.mapped import check_unchanged, stamp_of
from napari_phase4d.recording import remember_reader

__all__ = ["FrameReader", "Unsound", "WrongFrameError", "in_one_line", "lazy_frames"]

#: Longest part of another program's message that is passed on.
LONGEST = 160


class WrongFrameError(ValueError):
    """A frame was read well, but doesn't fit the recording; its message is for the user."""


class Unsound(OSError):  # noqa: N818 - it is an OSError to everybody else
    """What a file says of itself can't be true, or may not be followed; its message is whole."""


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
