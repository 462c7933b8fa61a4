"""Formats of microscopes that the package bioio opens, such as .czi, .nd2 and .lif."""

from __future__ import annotations

import threading
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.choosing import axes_in_words, choice, chosen_places
from napari_phase4d.io.lazy import FrameReader, in_one_line, lazy_frames
from napari_phase4d.io.video import Facts, Video, colour_sentence, quiet

__all__ = ["BIO_SUFFIXES", "read_bio"]

#: The best known; others are tried too.
BIO_SUFFIXES = (".czi", ".dv", ".gif", ".lif", ".nd2", ".oib", ".oif", ".sld", ".stk")
#: Axes of which a place is chosen, and those that are read whole.
CHOSEN, NOT_CHOSEN = "CZ", "TYXS"


def read_bio(path: Path, dataset: str | None = None) -> Video:
    """Open a file with bioio (https://bioio-devs.github.io/bioio), lazily.

    Parameters
    ----------
    path : Path
        The file.
    dataset : str, optional
        A channel and slice where there are several, such as "C=1" or "C=0,Z=2".

    Raises
    ------
    OSError
        If bioio, or its reader for the format, is missing, or the file is damaged.
    ValueError
        If several channels or slices are there and none is chosen, or it is in colour.
    """
    image = opened(path)
    try:
        sizes = {axis: int(getattr(image.dims, axis, 1)) for axis in "TCZYXS"}
        dtype = np.dtype(image.dtype)
        facts = facts_of(image)
    except Exception as error:
        raise OSError(unreadable(path, error)) from error
    if sizes["S"] > 1:
        first = np.asarray(image.get_image_dask_data("YXS", T=0, C=0, Z=0)[..., :3])
        if (first != first[..., :1]).any():
            raise ValueError(colour_sentence(path.name))
    place = chosen_place(path, sizes, dataset)
    reader = BioReader(path, place, (sizes["T"], sizes["Y"], sizes["X"]), dtype)
    kind = f"{path.suffix[1:].upper()}, read with bioio"
    return Video(lazy_frames(reader), kind=kind, dataset=dataset or "", **facts)


class BioReader(FrameReader):
    """Reads frames with bioio.

    Parameters
    ----------
    path : Path
        The file; every process opens it for itself.
    place : dict of str to int
        Channel and slice.
    shape, dtype
        Of the recording.
    """

    arguments = ("path", "place", "shape", "dtype")

    def __init__(
        self,
        path: Path,
        place: dict[str, int],
        shape: tuple[int, int, int],
        dtype: np.dtype[Any],
    ) -> None:
        super().__init__(path, shape, dtype)
        self.place = place
        self._lock = threading.Lock()
        self._frames: Any = None

    def read(self, index: int) -> NDArray[Any]:
        """Return one frame; of grey values stored as colour, the first channel."""
        with self._lock:
            if self._frames is None:
                image = opened(self.path)
                axes = "TYXS" if int(getattr(image.dims, "S", 1)) > 1 else "TYX"
                self._frames = image.get_image_dask_data(axes, **self.place)
            frame = np.asarray(self._frames[index])
        return frame[..., 0] if frame.ndim == 3 else frame


def opened(path: Path) -> Any:
    """Return the image that bioio opens, or say what is missing."""
    ending = path.suffix.lower() or "no ending"
    try:
        import bioio
        from bioio_base.exceptions import UnsupportedFileFormatError
    except ImportError as error:
        msg = (
            f"{path.name} is of a kind ({ending}) that can't be read; for formats of microscopes "
            'pip install "napari-phase4d[bio]" and the reader of the format, such as bioio-czi, '
            "bioio-nd2 or bioio-lif"
        )
        raise OSError(msg) from error
    try:
        with quiet("bioio.bio_image"):
            return bioio.BioImage(path)
    except UnsupportedFileFormatError as error:
        msg = (
            f"{path.name} is of a kind that can't be read ({ending}); if it is of a microscope, "
            "install the reader of bioio for it, such as bioio-czi, bioio-nd2 or bioio-lif"
        )
        raise OSError(msg) from error
    except Exception as error:
        raise OSError(unreadable(path, error)) from error


def chosen_place(path: Path, sizes: dict[str, int], dataset: str | None) -> dict[str, int]:
    """Return the channel and slice to read.

    Raises
    ------
    ValueError
        If several are there and none, or one that isn't there, is chosen.
    """
    axes, shape = "".join(sizes), tuple(sizes.values())
    places = dict(zip(axes, chosen_places(path, axes, shape, dataset, NOT_CHOSEN), strict=True))
    place = {axis: number for axis in CHOSEN if isinstance(number := places[axis], int)}
    if len(place) < len(CHOSEN):
        several = (axis for axis in CHOSEN if axis not in place)
        msg = (
            f"{path.name} has {axes_in_words(axes, shape)}; a hologram video has time, y, x, so "
            f"choose one place, as with {choice(several)}"
        )
        raise ValueError(msg)
    return place


def facts_of(image: Any) -> Facts:
    """Return pixel (um) and interval (s) where the file says them."""
    facts: Facts = {}
    pixel = image.physical_pixel_sizes.X
    if pixel and np.isfinite(pixel) and pixel > 0:
        facts["pixel_um"] = float(pixel)
    try:
        interval = image.time_interval
    except Exception:
        interval = None
    seconds = interval.total_seconds() if isinstance(interval, timedelta) else interval
    if isinstance(seconds, int | float) and np.isfinite(seconds) and seconds > 0:
        facts["interval_s"] = float(seconds)
    return facts


def unreadable(path: Path, error: Exception) -> str:
    """Return the sentence for a file that bioio can't read."""
    return f"{path.name} can't be read; it may be cut short or damaged ({in_one_line(error)})"
