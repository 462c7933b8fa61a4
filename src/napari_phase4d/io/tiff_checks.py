"""Noticing TIFF files that are cut short, before a frame is missing."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import tifffile

from napari_phase4d.io.lazy import Unsound
from napari_phase4d.io.limits import MOST_DESCRIBED_FRAMES
from napari_phase4d.io.tiff_facts import told_frames

__all__ = ["check_complete", "check_described", "check_number"]


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
