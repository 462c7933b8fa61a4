"""TIFF family: multi-page, ImageJ and OME-TIFF videos, read lazily."""

from __future__ import annotations

import re
import struct
import threading
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from napari_phase4d.io.video import Video

__all__ = ["read_tiff"]

MICROMETRES = {"micron", "microns", "um", "µm", "μm", "\\u00B5m"}
TO_MICROMETRES = {"nm": 1e-3, "µm": 1.0, "μm": 1.0, "um": 1.0, "mm": 1e3, "m": 1e6}
TO_SECONDS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "μs": 1e-6, "min": 60.0, "h": 3600.0}


def read_tiff(path: Path) -> Video:
    """Open a TIFF video lazily.

    Pixel size and frame interval are taken from ImageJ or OME metadata where they are there.

    Parameters
    ----------
    path : Path
        A .tif or .tiff file with one grey value a pixel; axes of length 1 are dropped.

    Raises
    ------
    OSError
        If the file is cut short or is no TIFF.
    """
    try:
        with tifffile.TiffFile(path) as tif:
            series = tif.series[0]
            axes, shape = series.axes, series.shape
            single = single_frames(tif)
            if single:
                axes, shape = f"T{axes}", (len(single), *shape)
            colour = "S" in axes and shape[axes.index("S")] in (3, 4)
            check_complete(tif, path)
            facts = ome_facts(tif) if tif.is_ome else imagej_facts(tif)
            dtype = series.dtype
            contiguous = series.dataoffset is not None and not single
    except (tifffile.TiffFileError, struct.error, IndexError, KeyError, ValueError) as error:
        msg = f"{path.name} can't be read as a TIFF file; it may be cut short or damaged ({error})"
        raise OSError(msg) from error
    frames = mapped_frames(path, shape) if contiguous else paged_frames(path, shape, dtype)
    keep = tuple(
        slice(None) if n > 1 or a in "YX" else 0 for n, a in zip(shape, axes, strict=True)
    )
    return Video(frames[keep], colour=colour, **facts)


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


def check_complete(tif: tifffile.TiffFile, path: Path) -> None:
    """Raise OSError if any page's pixels lie beyond the end of the file."""
    size = path.stat().st_size
    for page in tif.pages:
        ends = [o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
        if ends and max(ends) > size:
            msg = f"{path.name} is cut short: a frame needs {max(ends)} bytes, the file has {size}"
            raise OSError(msg)


def mapped_frames(path: Path, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the pixels of an uncompressed file with no gaps as a memory map."""
    try:
        mapped: NDArray[Any] = tifffile.memmap(path, series=0, mode="r").reshape(shape)
    except ValueError as error:
        msg = f"{path.name} is cut short: it has fewer bytes than its {shape[0]} frames need"
        raise OSError(msg) from error
    return mapped


def paged_frames(path: Path, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
    """Return the pages of any other file as a dask array with one page a chunk."""
    pages = Pages(path)
    page_shape = pages.shape
    n_leading = len(shape) - len(page_shape)
    leading = shape[:n_leading]

    def read_block(block_info: Any = None) -> NDArray[Any]:
        location = block_info[None]["array-location"][:n_leading]
        flat = (
            int(np.ravel_multi_index([start for start, _ in location], leading)) if leading else 0
        )
        return pages.read(flat).reshape((*((1,) * n_leading), *page_shape))

    chunks = (*((1,) * n for n in leading), *((n,) for n in page_shape))
    meta = np.empty((0,) * len(shape), dtype)
    import dask.array as da

    return da.map_blocks(read_block, chunks=chunks, dtype=dtype, meta=meta)


class Pages:
    """Reads single pages; the file stays open, so that its directory is parsed once.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._open()

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of one page."""
        return tuple(int(n) for n in self._file.series[0].keyframe.shape)

    def read(self, index: int) -> NDArray[Any]:
        """Return one page.

        Raises
        ------
        OSError
            If the page can't be decoded.
        """
        try:
            with self._lock:
                page = self._series[index]
            if page is None:
                msg = "the file does not hold it"
                raise ValueError(msg)
            # The lock guards the file alone, so that several threads can decode.
            return np.asarray(page.asarray(lock=self._lock))
        except (OSError, ValueError, RuntimeError, zlib.error, struct.error) as error:
            msg = f"frame {index} of {self.path.name} can't be decoded ({error})"
            raise OSError(msg) from error

    def _open(self) -> None:
        self._lock = threading.RLock()
        self._file = tifffile.TiffFile(self.path)
        self._series = single_frames(self._file) or self._file.series[0]

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.path = state["path"]
        self._open()

    def __del__(self) -> None:
        if hasattr(self, "_file"):
            self._file.close()


def imagej_facts(tif: tifffile.TiffFile) -> dict[str, float]:
    """Return pixel size (um) and frame interval (s) of an ImageJ file, where given."""
    meta = tif.imagej_metadata or {}
    facts: dict[str, float] = {}
    if float(meta.get("finterval", 0) or 0) > 0:
        facts["interval_s"] = float(meta["finterval"])
    elif float(meta.get("fps", 0) or 0) > 0:
        facts["interval_s"] = 1 / float(meta["fps"])
    resolution = tif.pages.first.tags.get("XResolution")
    if resolution is not None and str(meta.get("unit", "")) in MICROMETRES:
        pixels, per = resolution.value
        if pixels > 0:
            facts["pixel_um"] = per / pixels
    return facts


def ome_facts(tif: tifffile.TiffFile) -> dict[str, float]:
    """Return pixel size (um) and frame interval (s) of an OME-TIFF file, where given."""
    facts: dict[str, float] = {}
    try:
        root = ET.fromstring(tif.ome_metadata or "<OME/>")
    except ET.ParseError:
        return facts
    pixels = next((e for e in root.iter() if re.sub(r"\{.*\}", "", e.tag) == "Pixels"), None)
    if pixels is None:
        return facts
    size = float(pixels.get("PhysicalSizeX", 0))
    if size > 0:
        facts["pixel_um"] = size * TO_MICROMETRES.get(pixels.get("PhysicalSizeXUnit", "µm"), 1.0)
    interval = float(pixels.get("TimeIncrement", 0))
    if interval > 0:
        facts["interval_s"] = interval * TO_SECONDS.get(pixels.get("TimeIncrementUnit", "s"), 1.0)
    return facts
