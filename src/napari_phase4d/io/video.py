"""What every reader returns, and what all readers hold to: units, limits, grey values, memory."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.machine import free_memory
from napari_phase4d.words import size_in_words

__all__ = [
    "LARGEST_KOALA_SIDE",
    "LARGEST_PIECE",
    "LARGEST_SIDE",
    "MICROMETRES",
    "MOST_DESCRIBED_FRAMES",
    "MOST_LISTED_FRAMES",
    "SECONDS",
    "Facts",
    "Video",
    "check_fits",
    "colour_sentence",
    "grey",
    "memory_lacks",
    "quiet",
]


class Facts(TypedDict, total=False):
    """What a file says of its scale, see `Video`."""

    pixel_um: float
    interval_s: float


@dataclass(frozen=True)
class Video:
    """Frames as they lie in a file, with what the file says of them.

    Parameters
    ----------
    frames : array_like
        Lazy or in memory; (time, y, x) or (y, x), plus a last axis for colour.
    pixel_um : float, optional
        Width of a pixel in the sample in micrometres, if the file says it.
    interval_s : float, optional
        Time between frames in seconds, if the file says it.
    colour : bool
        Whether the last axis is colour.
    kind : str
        What was read, in words for the user, such as "BigTIFF" or "H.264 in MP4".
    dataset : str
        Which of several arrays was read, empty where there is only one.
    times_s : ndarray of float64, shape (time,), optional
        Time of each frame in seconds, if the file says it and frames are not evenly spaced.
    axes : str
        The letters of the axes where there may be more than three, such as "TZYX".
    notes : tuple of str
        What had to be assumed or chosen, in sentences for the user.
    """

    frames: Any
    pixel_um: float | None = None
    interval_s: float | None = None
    colour: bool = False
    kind: str = ""
    dataset: str = ""
    times_s: NDArray[np.float64] | None = None
    axes: str = ""
    notes: tuple[str, ...] = ()


def grey(image: NDArray[Any]) -> NDArray[Any]:
    """Return the grey values of an image whose colour channels are all equal (else the image)."""
    if image.ndim == 3 and image.shape[-1] in (3, 4):
        first = image[..., 0]
        if (image[..., 1] == first).all() and (image[..., 2] == first).all():
            return np.ascontiguousarray(first)
    return image


def colour_sentence(name: str) -> str:
    """Return the sentence for a recording in colour."""
    return f"{name} is in colour; a hologram has one grey value a pixel, so pick one channel first"


#: Unit -> how many micrometres it is.
MICROMETRES = MappingProxyType(
    {
        **dict.fromkeys(("um", "µm", "μm", "\\u00B5m", "micron", "microns", "micrometer"), 1.0),
        **dict.fromkeys(("micrometre", "micrometers", "micrometres"), 1.0),
        **dict.fromkeys(("nm", "nanometer", "nanometre"), 1e-3),
        **dict.fromkeys(("pm", "picometer", "picometre"), 1e-6),
        **dict.fromkeys(("Å", "\u212b", "A", "angstrom", "ångström"), 1e-4),
        **dict.fromkeys(("cm", "centimeter", "centimetre"), 1e4),
        **dict.fromkeys(("mm", "millimeter", "millimetre"), 1e3),
        **dict.fromkeys(("m", "meter", "metre"), 1e6),
    }
)
#: Unit -> how many seconds it is.
SECONDS = MappingProxyType(
    {
        **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
        **dict.fromkeys(("ms", "millisecond", "milliseconds"), 1e-3),
        **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
        **dict.fromkeys(("us", "µs", "μs", "microsecond", "microseconds"), 1e-6),
        **dict.fromkeys(("min", "minute", "minutes"), 60.0),
        **dict.fromkeys(("h", "hour", "hours"), 3600.0),
        **dict.fromkeys(("d", "day", "days"), 86400.0),
    }
)


#: Pixels along a side of a frame.
LARGEST_SIDE = 2**20
#: The same in the header of a file of Koala, which knows one file from another by it.
LARGEST_KOALA_SIDE = 2**16
#: Bytes of a piece (a chunk of HDF5 or Zarr) unpacked; a camera's holds a few frames.
LARGEST_PIECE = 2**30
#: Frames that the description of a TIFF file may tell of: laying out more would take minutes.
MOST_DESCRIBED_FRAMES = 2_000_000
#: Frames of which a list fits into memory, at some 100 bytes each.
MOST_LISTED_FRAMES = 20_000_000


#: Share of the free memory that what is read whole may take; work on it takes as much again.
SHARE_OF_A_FILE = 0.5


def memory_lacks(needed: float, share: float = SHARE_OF_A_FILE) -> str:
    """Say what so many bytes need and what is free; nothing where a share of that is enough."""
    free = free_memory()
    if needed <= share * free:
        return ""
    return f"{size_in_words(needed)}, but {size_in_words(free)} of memory are free"


def check_fits(needed: float, name: str) -> None:
    """Raise OSError if a file that is read whole does not fit.

    Parameters
    ----------
    needed : float
        Bytes that its numbers take in memory.
    name : str
        Name of the file.
    """
    if lacks := memory_lacks(needed):
        msg = (
            f"{name} is read whole and takes {lacks}; "
            "OME-Zarr written by this program is read in parts"
        )
        raise OSError(msg)


#: Whether this thread is inside `quiet`.
SILENT: ContextVar[bool] = ContextVar("phase4d_silent", default=False)


def is_heard(record: logging.LogRecord) -> bool:
    """Say whether a remark may be shown."""
    return not SILENT.get()


@contextmanager
def quiet(name: str = "tifffile") -> Iterator[None]:
    """Keep back what a library logs meanwhile in this thread; others' use of it is not touched."""
    logger = logging.getLogger(name)
    logger.addFilter(is_heard)  # the same function again changes nothing
    token = SILENT.set(True)
    try:
        yield
    finally:
        SILENT.reset(token)
