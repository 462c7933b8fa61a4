"""TIFF family: multi-page, BigTIFF, ImageJ and OME-TIFF videos, read lazily."""

from __future__ import annotations

import math
import re
import struct
import threading
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import (
    FrameReader,
    Unsound,
    WrongFrameError,
    beside,
    in_one_line,
    lazy_frames,
    map_frames,
)
from napari_phase4d.io.video import (
    MICROMETRES,
    MOST_DESCRIBED_FRAMES,
    SECONDS,
    Facts,
    Video,
    axes_in_words,
    chosen_places,
    colour_sentence,
    grey,
    quiet,
)
from napari_phase4d.later import tifffile

__all__ = ["TIFF_SUFFIXES", "check_complete", "check_described", "read_tiff", "tiff_parts"]

TIFF_SUFFIXES = (".tif", ".tiff", ".btf", ".tf8")


def read_tiff(path: Path, dataset: str | None = None) -> Video:
    """Open a TIFF video lazily.

    Pixel size and times are taken from ImageJ or OME metadata where they are there. The files of
    an OME-TIFF series are read as one.

    Parameters
    ----------
    path : Path
        A file with one grey value a pixel; axes of length 1 are dropped.
    dataset : str, optional
        A place on axes other than time, such as "Z=0" or "C=1,Z=0".

    Returns
    -------
    Video
        With more than three axes if the file has them and ``dataset`` doesn't choose.

    Raises
    ------
    OSError
        If the file is cut short or is no TIFF.
    ValueError
        If it is in colour, or ``dataset`` names no place on its axes.
    """
    try:
        with quiet(), tifffile.TiffFile(path) as tif:
            check_described(tif, path)
            for name in named_parts(tif):
                beside(path, name)
            axes, shape, single = layout_of(tif)
            added = not single and tif.series[0].shape != shape
            offset = None if single or added else tif.series[0].dataoffset
            described = tif.is_ome or tif.is_imagej or tif.is_shaped
            if offset is None or not described:  # else one look at the size is enough
                check_complete(tif, path)
            facts = ome_facts(tif) if tif.is_ome else imagej_facts(tif)
            times = ome_times(tif) if tif.is_ome else None
            check_number(tif, path, shape)
            kind = kind_of(tif)
            coloured = not tif.is_imagej and has_colours(tif.series[0].keyframe)
            left_out = () if single else pages_left_out(tif)
            dtype = np.dtype(tif.series[0].dtype)
            order = tif.byteorder
    except Unsound:
        raise
    except Exception as error:
        # A damaged directory leads to any error: RuntimeError, ZeroDivisionError, UnicodeError ...
        msg = (
            f"{path.name} can't be read as a TIFF file; it may be cut short or damaged "
            f"({in_one_line(error)})"
        )
        raise OSError(msg) from error
    if axes.rstrip("S")[-2:] != "YX":
        msg = f"{path.name} holds no pictures, but {axes_in_words(axes, shape)}; it may be damaged"
        raise OSError(msg)
    if coloured:
        msg = (
            f"{path.name} holds numbers of colours in a palette, not grey values; save it as grey "
            "values"
        )
        raise ValueError(msg)
    if dtype.kind not in "buif":
        msg = f"{path.name} holds {dtype} values; a hologram video needs real numbers"
        raise ValueError(msg)
    places = chosen_places(path, axes, shape, dataset)
    left = "".join(a for a, place in zip(axes, places, strict=True) if not isinstance(place, int))
    if offset is not None and "S" not in left:
        frames = map_frames(path, dtype.newbyteorder(order), shape, offset)[places]
    else:
        frames = paged_frames(path, shape, places, dtype, colour="S" in axes)
        left = left.replace("S", "")
    in_time = times is not None and left[:1] == "T" and len(times) == len(frames)
    return Video(
        frames, kind=kind, axes=left, dataset=dataset or "",
        times_s=times if in_time and "interval_s" not in facts else None, notes=left_out, **facts,
    )  # fmt: skip


def layout_of(tif: tifffile.TiffFile) -> tuple[str, tuple[int, ...], bool]:
    """Return axes and shape of the frames, and whether each is a series of its own."""
    series = tif.series[0]
    single = single_frames(tif)
    if single:
        return f"T{series.axes}", (len(single), *series.shape), True
    added = added_frames(tif)
    n_times = (len(added),) if added else series.shape[:1]
    return series.axes, tuple(int(n) for n in (*n_times, *series.shape[1:])), False


def pages_left_out(tif: tifffile.TiffFile) -> tuple[str, ...]:
    """Say that a file has pages besides those that are read: of another kind, or added later."""
    used, further = len(tif.series[0].pages), sum(len(s.pages) for s in tif.series[1:])
    if not further or added_frames(tif):
        return ()
    return (
        f"Of {used + further} pages the first {used} are read; the others are of another kind, or "
        "were added later. Write them as one stack if they belong to it.",
    )


def single_frames(tif: tifffile.TiffFile) -> list[Any]:
    """Return the pages of a file whose frames were written one by one, else none.

    Such a file describes every frame as a series of its own.
    """
    if tif.is_ome or tif.is_imagej or len(tif.series) < 2:
        return []
    kinds = {(series.shape, series.dtype, len(series.levels)) for series in tif.series}
    if len(kinds) > 1 or any(len(series.pages) != 1 for series in tif.series):
        return []
    return [series.pages[0] for series in tif.series]


def added_frames(tif: tifffile.TiffFile) -> list[Any]:
    """Return the pages of a video to which frames of the same kind were added later, else none.

    Each addition describes itself as a series. OME-TIFF and ImageJ say how many series there are.
    """
    first = tif.series[0]
    if tif.is_ome or tif.is_imagej or len(tif.series) < 2 or len(first.shape) != 3:
        return []
    kinds = {(series.shape[-2:], series.dtype, len(series.levels)) for series in tif.series}
    if len(kinds) > 1 or any(s.axes[-2:] != "YX" or len(s.shape) > 3 for s in tif.series):
        return []
    return [page for series in tif.series for page in series.pages]


def paged_frames(
    path: Path,
    shape: tuple[int, ...],
    places: tuple[int | slice, ...],
    dtype: np.dtype[Any],
    *,
    colour: bool,
) -> Any:
    """Return the chosen pages of a file as a dask array with one page a chunk."""
    n_picture = 3 if colour else 2
    leading = shape[:-n_picture]
    with quiet():
        pages = TiffPages(path, shape[-n_picture:], dtype)
    numbers = np.arange(int(np.prod(leading, dtype=np.int64))).reshape(leading)
    numbers = np.asarray(numbers[places[: len(leading)]])
    reader = pages.taking(numbers.ravel())
    frames = lazy_frames(reader)
    return frames if numbers.ndim == 1 else frames.reshape(*numbers.shape, *reader.shape[1:])


class TiffPages(FrameReader):
    """Reads single pages; the file stays open, so that its directory is parsed once.

    Parameters
    ----------
    path : Path
        The file.
    picture : tuple of int
        Shape of a page, its last axis colour if there are three.
    dtype : dtype
        Of the pixels.
    numbers : ndarray of int, optional
        The page that holds each frame.

    Raises
    ------
    ValueError
        If the first page is in colour.
    """

    arguments = ("path", "picture", "dtype", "numbers")

    def __init__(
        self,
        path: Path,
        picture: tuple[int, ...],
        dtype: np.dtype[Any],
        numbers: NDArray[np.int64] | None = None,
    ) -> None:
        self.picture = picture
        self.numbers = np.arange(1) if numbers is None else numbers
        super().__init__(path, (len(self.numbers), picture[0], picture[1]), dtype)
        self._lock = threading.RLock()
        self._file: tifffile.TiffFile | None = None
        self._series: Any = None

    def taking(self, numbers: NDArray[np.int64]) -> TiffPages:
        """Return a reader of these pages."""
        reader = TiffPages(self.path, self.picture, self.dtype, numbers)
        if len(self.picture) == 3:
            reader.frame(0)
        return reader

    def read(self, index: int) -> NDArray[Any]:
        """Return one page."""
        with quiet():
            with self._lock:
                page = self._pages()[int(self.numbers[index])]
            if page is None:
                msg = "the file does not hold it"
                raise ValueError(msg)
            image = grey(self._decoded(page))
        if image.ndim > 2:
            raise WrongFrameError(colour_sentence(self.path.name))
        return image.reshape(self.shape[1:])

    def _decoded(self, page: Any) -> NDArray[Any]:
        """Return the pixels of a page, of which another file of a series may hold it."""
        handle = page.parent.filehandle
        if page.parent is self._file:
            # The lock guards the file alone, so that several threads can decode.
            return np.asarray(page.asarray(lock=self._lock))
        with self._lock:
            handle.open()
            try:
                return np.asarray(page.asarray())
            finally:
                handle.close()

    def _pages(self) -> Any:
        """Return the pages of the open file."""
        if self._file is None:
            self._file = tifffile.TiffFile(self.path)
            self._series = (
                single_frames(self._file) or added_frames(self._file) or self._file.series[0]
            )
        return self._series

    def __del__(self) -> None:
        if getattr(self, "_file", None) is not None:
            self._file.close()  # type: ignore[union-attr]


def kind_of(tif: tifffile.TiffFile) -> str:
    """Return what a file is, in words."""
    base = "BigTIFF" if tif.is_bigtiff else "TIFF"
    program = "OME-" if tif.is_ome else ("ImageJ " if tif.is_imagej else "")
    packing = tif.series[0].keyframe.compression
    packed = "" if packing == 1 else f", {getattr(packing, 'name', packing)}".lower()
    return f"{program}{base}{packed}"


def has_colours(page: Any) -> bool:
    """Say whether numbers of a page stand for colours of a palette, and not for grey values."""
    if page.photometric != tifffile.PHOTOMETRIC.PALETTE:
        return False
    palette = None if page.colormap is None else np.asarray(page.colormap).astype(np.int64)
    if palette is None or palette.ndim != 2:
        return True
    is_grey = bool((palette == palette[0]).all() and (np.diff(palette[0]) >= 0).all())
    return not is_grey


def check_described(tif: tifffile.TiffFile, path: Path) -> None:
    """Raise Unsound if absurdly many frames are described."""
    len(tif.pages)  # tifffile notices pages that lead in a circle only where it counts them first
    told = told_frames(tif)
    if told > MOST_DESCRIBED_FRAMES:
        msg = f"{path.name} describes {told} frames, more than can be; it may be damaged"
        raise Unsound(msg)


def check_complete(tif: tifffile.TiffFile, path: Path) -> None:
    """Raise Unsound if any page's pixels lie beyond the end of the file."""
    size = path.stat().st_size
    for page in tif.pages:
        ends = [o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if ends and max(ends) > size:
            msg = f"{path.name} is cut short: a frame needs {max(ends)} bytes, the file has {size}"
            raise Unsound(msg)
    following = next_page(tif)
    if following:
        msg = (
            f"{path.name} is cut short or damaged: behind {len(tif.pages)} frames another one "
            f"follows at {following} bytes, the file has {size}"
        )
        raise Unsound(msg)


def next_page(tif: tifffile.TiffFile) -> int:
    """Return where the page behind the last one that could be read lies, 0 if there is none.

    tifffile takes a directory that is not whole, or lies behind the end of the file, for the end
    of all pages.
    """
    form, file = tif.tiff, tif.filehandle
    file.seek(tif.pages[-1].offset)
    (count,) = struct.unpack(form.tagnoformat, file.read(form.tagnosize))
    file.seek(count * form.tagsize, 1)
    (following,) = struct.unpack(form.offsetformat, file.read(form.offsetsize))
    return int(following)


def check_number(tif: tifffile.TiffFile, path: Path, shape: tuple[int, ...]) -> None:
    """Raise Unsound if fewer frames are there than the description of the file says."""
    told, series = told_frames(tif), tif.series[0]
    found = math.prod(shape) // max(1, math.prod(series.keyframe.shape))
    if series.dataoffset is None and not getattr(series, "is_multifile", True):
        found = min(found, len(tif.pages))
    if found < told:
        msg = f"{path.name} is cut short: {told} frames are described, {found} are there"
        raise Unsound(msg)


def imagej_facts(tif: tifffile.TiffFile) -> Facts:
    """Return pixel size (um) and frame interval (s) of an ImageJ file, where given."""
    meta = tif.imagej_metadata or {}
    facts: Facts = {}
    if number(meta.get("finterval")) > 0:
        facts["interval_s"] = number(meta["finterval"])
    elif number(meta.get("fps")) > 0:
        facts["interval_s"] = 1 / number(meta["fps"])
    resolution = tif.pages.first.tags.get("XResolution")
    unit = MICROMETRES.get(str(meta.get("unit", "")))
    if resolution is not None and unit:
        pixels, per = resolution.value
        if pixels > 0:
            facts["pixel_um"] = per / pixels * unit
    return facts


def ome_facts(tif: tifffile.TiffFile) -> Facts:
    """Return pixel size (um) and frame interval (s) of an OME-TIFF file, where given."""
    facts: Facts = {}
    pixels = ome_pixels(tif)
    if pixels is None:
        return facts
    unit = MICROMETRES.get(pixels.get("PhysicalSizeXUnit", "µm"), 0.0)
    if number(pixels.get("PhysicalSizeX")) * unit > 0:
        facts["pixel_um"] = number(pixels.get("PhysicalSizeX")) * unit
    unit = SECONDS.get(pixels.get("TimeIncrementUnit", "s"), 0.0)
    if number(pixels.get("TimeIncrement")) * unit > 0:
        facts["interval_s"] = number(pixels.get("TimeIncrement")) * unit
    return facts


def ome_times(tif: tifffile.TiffFile) -> NDArray[np.float64] | None:
    """Return the time of each frame (s) of an OME-TIFF file that notes it with every plane."""
    pixels = ome_pixels(tif)
    times: dict[int, float] = {}
    for plane in () if pixels is None else [e for e in pixels if e.tag.endswith("Plane")]:
        unit = SECONDS.get(plane.get("DeltaTUnit", "s"))
        given = plane.get("DeltaT")
        if unit and given is not None and plane.get("TheT", "").isdigit():
            times.setdefault(int(plane.get("TheT", "0")), number(given) * unit)
    if len(times) < 2 or sorted(times) != list(range(len(times))):
        return None
    all_times = np.array([times[i] for i in range(len(times))])
    return all_times - all_times[0] if (np.diff(all_times) > 0).all() else None


def told_frames(tif: tifffile.TiffFile) -> int:
    """Return how many frames the description of a file tells of, 0 if it doesn't."""
    if tif.is_imagej:
        return int(number((tif.imagej_metadata or {}).get("images")))
    pixels = ome_pixels(tif) if tif.is_ome else None
    if pixels is None:
        return 0
    return int(np.prod([number(pixels.get(f"Size{axis}", 1)) for axis in "TCZ"]))


def ome_pixels(tif: tifffile.TiffFile) -> ET.Element | None:
    """Return the part of the OME metadata that describes the first image."""
    try:
        root = ET.fromstring(tif.ome_metadata or "<OME/>")
    except ET.ParseError:
        return None
    return next((e for e in root.iter() if re.sub(r"\{.*\}", "", e.tag) == "Pixels"), None)


def named_parts(tif: tifffile.TiffFile) -> list[str]:
    """Return the names of the other files that hold frames of an OME-TIFF series.

    A file that was renamed is still known by its number in the description.
    """
    pixels = ome_pixels(tif) if tif.is_ome else None
    if pixels is None:
        return []
    own = ET.fromstring(tif.ome_metadata or "<OME/>").get("UUID", "")
    others = [e for e in pixels.iter() if e.get("FileName") and (e.text or "").strip() != own]
    return sorted({e.get("FileName", "") for e in others} - {tif.filename})


def tiff_parts(path: Path) -> list[Path]:
    """Return the other files of an OME-TIFF series; none of a file that is damaged."""
    try:
        with quiet(), tifffile.TiffFile(path) as tif:
            return [path.parent / name for name in named_parts(tif)]
    except Exception:  # a damaged file leads to any error; reading it will say what is wrong
        return []


def number(value: Any) -> float:
    """Return a finite number, else 0."""
    try:
        found = float(value)
    except (TypeError, ValueError):
        return 0.0
    return found if np.isfinite(found) else 0.0
