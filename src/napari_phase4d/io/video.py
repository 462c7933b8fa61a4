"""What every reader returns and holds to: units, limits, memory, what of a file is meant.

A file may hold several arrays, and arrays further axes: which of them, and which place on them, is
the recording.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
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
    "TIME",
    "USUAL_NAMES",
    "Facts",
    "Found",
    "Video",
    "axes_in_words",
    "axes_to_choose",
    "check_fits",
    "choice",
    "chosen_name",
    "chosen_places",
    "colour_sentence",
    "grey",
    "listed",
    "memory_lacks",
    "other_arrays",
    "quiet",
    "sensible",
    "taken_for_time",
]


class Facts(TypedDict, total=False):
    """What a file says of its scale, see `Video`."""

    pixel_um: float
    height_um: float
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
    lost : tuple of int
        Frames of which the file has nothing, and which are read as zeros.
    height_um : float, optional
        Height of a pixel, if the file says it apart from its width.
    loose_axes : bool
        Whether other letters than T may well stand for time, as in ImageJ's files: users have it
        where there are slices, and scripts that write such files where there are channels.
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
    lost: tuple[int, ...] = ()
    height_um: float | None = None
    loose_axes: bool = False


#: Pixels in micrometres and intervals in seconds outside of this are no more than damage.
LEAST_FACT, LARGEST_FACT = 1e-9, 1e9


def sensible(fact: float | None) -> float | None:
    """Return the pixel (um) or interval (s) that a file gives, None if it can't be true."""
    return fact if fact is not None and LEAST_FACT <= fact <= LARGEST_FACT else None


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
        **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), 1e-3),
        **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
        **dict.fromkeys(("us", "usec", "µs", "μs", "microsecond", "microseconds"), 1e-6),
        **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
        **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), 3600.0),
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


# ---- what of a file is meant ----------------------------------------------------------------


#: Names looked for first in a file with several arrays; the last ones say the least.
USUAL_NAMES = ("holograms", "hologram", "mux", "frames", "images", "image", "data")
#: Names of what a recording is compared with, which are taken only where nothing else is there.
ASIDE = ("ref", "background", "bg", "dark", "flat", "empty", "mask", "weight")
#: Frames of fewer pixels a side are tables.
SMALLEST_SIDE = 8
#: Names listed in a message.
LISTED = 8

#: Shape and dtype of an array.
Found = tuple[tuple[int, ...], np.dtype[np.generic]]


def chosen_name(path: Path, arrays: Mapping[str, Found], dataset: str | None) -> str:
    """Return the name of the array to read.

    Parameters
    ----------
    path : Path
        The file, named in messages.
    arrays : mapping of str to (shape, dtype)
        What it holds.
    dataset : str or None
        The name that the user gave; else one with a usual name is taken, else the largest with
        two or three axes (axes of length 1 don't count); of equal ones the first.

    Raises
    ------
    ValueError
        If there is no such array.
    """
    if dataset is not None:
        name = dataset.strip("/")
        if name in arrays:
            return name
        msg = f"{path.name} has no array {dataset!r}; it has {listed(list(arrays))}"
        raise ValueError(msg)
    usable = [name for name, found in arrays.items() if is_video(*found)]
    if not usable:
        msg = (
            f"{path.name} has no array of numbers with two or three axes; "
            f"it has {listed(list(arrays))}"
        )
        raise ValueError(msg)
    return min(usable, key=lambda name: rank(name, arrays[name]))


def is_video(shape: Sequence[int], dtype: np.dtype[np.generic]) -> bool:
    """Say whether an array may be frames."""
    long = [n for n in shape if n != 1]
    return dtype.kind in "buif" and len(long) in (2, 3) and min(shape[-2:]) >= SMALLEST_SIDE


def rank(name: str, found: Found) -> tuple[bool, int, int]:
    """Sort key: what is set aside last, usual names first, large before small."""
    last = name.rsplit("/", 1)[-1].lower()
    named = USUAL_NAMES.index(last) if last in USUAL_NAMES else len(USUAL_NAMES)
    pixels = -int(np.prod([float(n) for n in found[0]]))
    return last.startswith(ASIDE), named, pixels


def other_arrays(name: str, arrays: Mapping[str, Found], dataset: str | None) -> tuple[str, ...]:
    """Return the note that tells what was taken, where the user didn't say it."""
    others = [n for n, found in arrays.items() if n != name and is_video(*found)]
    if dataset is not None or not others:
        return ()
    return (
        f"Of several arrays {name!r} is read; the others are {listed(others)} "
        "(choose one with dataset).",
    )


def listed(names: Sequence[str]) -> str:
    """Return names in words, not too many."""
    if not names:
        return "none"
    more = len(names) - LISTED
    return ", ".join(names[:LISTED]) + (f" and {more} more" if more > 0 else "")


#: Axes of a picture; every other one may be time.
PICTURE = "YXS"


def chosen_places(
    path: Path, axes: str, shape: Sequence[int], dataset: str | None, whole: str = PICTURE
) -> tuple[int | slice, ...]:
    """Return what to take along each axis: a number, or all.

    Parameters
    ----------
    path : Path
        The file, named in messages.
    axes : str
        A letter an axis; those that a file doesn't name may share one.
    shape : sequence of int
        Their lengths.
    dataset : str or None
        The choice of the user, as "C=1,Z=0".
    whole : str, optional
        Axes of which no place can be chosen. Default: those of a picture.

    Raises
    ------
    ValueError
        If there is no such place.
    """
    # An axis of length 1 says nothing, but a picture keeps its own. By number: axes that a file
    # doesn't name are all called Q.
    places: list[int | slice] = [
        slice(None) if n > 1 or a in PICTURE else 0 for a, n in zip(axes, shape, strict=True)
    ]
    for part in () if dataset is None else dataset.split(","):
        name, _, number = part.strip().partition("=")
        named = [i for i, a in enumerate(axes) if a == name.strip().upper()]
        axis = next((i for i in named if isinstance(places[i], slice)), named[0] if named else -1)
        digits = number.strip().isdigit()
        if axis < 0 or axes[axis] in whole or not digits or int(number) >= shape[axis]:
            known = axes_in_words(axes, shape)
            msg = f"{path.name} has {known}; {part.strip()!r} is no place there"
            raise ValueError(msg)
        places[axis] = int(number)
    return tuple(places)


def axes_in_words(axes: Iterable[str], shape: Iterable[int]) -> str:
    """Return axes with their lengths."""
    named = ", ".join(f"{a}={n}" for a, n in zip(axes, shape, strict=True))
    return f"the axes {named}"


#: Time, and axes that a file gives no meaning, which are time as well.
TIME = "TQI"


def taken_for_time(axis: str) -> str:
    """Return the note that an axis which is called otherwise is taken for time."""
    return f"The axis {axis.upper()} is taken for time."


def axes_to_choose(axes: Iterable[str], *, has_time: bool) -> list[str]:
    """Return the axes of which a place must be chosen; without T, the first one is time."""
    others = [a for a in axes if a not in "TYX"]
    return others if has_time else others[1:]


def choice(axes: Iterable[str]) -> str:
    """Return an example of how places on axes are chosen."""
    return 'dataset="' + ",".join(f"{a}=0" for a in axes) + '"'
