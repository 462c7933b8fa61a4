"""TIFF family: multi-page, BigTIFF, ImageJ and OME-TIFF videos, read lazily."""

from __future__ import annotations

import math
import re
import struct
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import (
    Unsound,
    beside,
    in_one_line,
    map_frames,
)
from napari_phase4d.io.tiff_frames import (
    frames_among_others,
    layout_of,
    lost_among,
    main_series,
    paged_frames,
    pages_left_out,
)
from napari_phase4d.io.video import (
    MICROMETRES,
    MOST_DESCRIBED_FRAMES,
    SECONDS,
    TIME,
    Facts,
    Video,
    axes_in_words,
    chosen_places,
    quiet,
)
from napari_phase4d.later import tifffile
from napari_phase4d.words import printable

__all__ = ["TIFF_SUFFIXES", "check_complete", "check_described", "read_tiff", "tiff_parts"]

TIFF_SUFFIXES = (".tif", ".tiff", ".btf", ".tf8")
#: Share of a step by which measured times may be off an even grid.
EVEN = 0.05


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
            mixed = frames_among_others(tif)
            axes, shape, single = layout_of(tif, mixed)
            first = main_series(tif, mixed)
            added = not single and first.shape != shape
            offset = None if single or added else first.dataoffset
            described = tif.is_ome or tif.is_imagej or tif.is_shaped
            if offset is None or not described:  # else one look at the size is enough
                check_complete(tif, path)
            facts, notes = (ome_facts(tif), ()) if tif.is_ome else imagej_facts(tif)
            planes = ome_planes(tif) if tif.is_ome else []
            check_number(tif, path, shape)
            kind, in_stacks = kind_of(tif), bool(tif.is_imagej)
            coloured = not tif.is_imagej and has_colours(first.keyframe)
            left_out = pages_left_out(tif, mixed)
            dtype = np.dtype(first.dtype)
            order = tif.byteorder
    except Unsound:
        raise
    except Exception as error:
        # A damaged directory leads to any error: RuntimeError, ZeroDivisionError, UnicodeError ...
        if "incompatible keyframe" in str(error):  # of tifffile: the page others are held against
            msg = (
                f"{path.name} has a page among its frames that is of another size or kind; write "
                "the file without it"
            )
            raise OSError(msg) from error
        msg = (
            f"{path.name} can't be read as a TIFF file; it may be cut short or damaged "
            f"({in_one_line(error)})"
        )
        raise OSError(msg) from error
    check_pictures(path, axes, shape, dtype, coloured=coloured)
    places = chosen_places(path, axes, shape, dataset)
    left = "".join(a for a, place in zip(axes, places, strict=True) if not isinstance(place, int))
    if offset is not None and "S" not in left:
        frames = map_frames(path, dtype.newbyteorder(order), shape, offset)[places]
    else:
        frames = paged_frames(path, shape, places, dtype, colour="S" in axes, mixed=bool(mixed))
        left = left.replace("S", "")
    chosen = {a: place for a, place in zip(axes, places, strict=True) if isinstance(place, int)}
    times = times_of(planes, chosen)
    if not has_interval(left, in_stacks=in_stacks):
        facts.pop("interval_s", None)
    in_time = times is not None and left[:1] == "T" and len(times) == len(frames)
    times, told = measured(times if in_time else None, facts.get("interval_s"))
    if times is not None:
        facts.pop("interval_s", None)
    return Video(
        frames, kind=kind, axes=left, dataset=dataset or "", times_s=times,
        notes=(*left_out, *notes, *told), lost=lost_among(mixed, places[0]),
        loose_axes=in_stacks, **facts,
    )  # fmt: skip


def has_interval(axes: str, *, in_stacks: bool) -> bool:
    """Say whether any of some axes is time, so that an interval between frames means something.

    In stacks of ImageJ a single other one may be, see `Video.loose_axes`.
    """
    further = axes.removesuffix("YX")
    return not further or any(a in TIME for a in further) or (in_stacks and further in ("Z", "C"))


def check_pictures(
    path: Path, axes: str, shape: tuple[int, ...], dtype: np.dtype[Any], *, coloured: bool
) -> None:
    """Refuse what is no picture of real grey values."""
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


def imagej_facts(tif: tifffile.TiffFile) -> tuple[Facts, tuple[str, ...]]:
    """Return pixel size (um) and frame interval (s) of an ImageJ file, where given, with notes."""
    meta = tif.imagej_metadata or {}
    facts, notes = imagej_interval(meta)
    unit = MICROMETRES.get(str(meta.get("unit", "")), 0.0)
    if width := side_by(tif, "XResolution") * unit:
        facts["pixel_um"] = width
    if height := side_by(tif, "YResolution") * unit:
        facts["height_um"] = height
    return facts, notes


def side_by(tif: tifffile.TiffFile, tag: str) -> float:
    """Return how wide a pixel is by a tag that counts pixels, in the unit of the file, else 0."""
    resolution = tif.pages.first.tags.get(tag)
    pixels, per = (0, 0) if resolution is None else resolution.value
    return float(per / pixels) if pixels > 0 else 0.0


def imagej_interval(meta: Mapping[str, Any]) -> tuple[Facts, tuple[str, ...]]:
    """Return the frame interval (s) that ImageJ noted, and what is to be known of it."""
    if (interval := number(meta.get("finterval"))) > 0:
        named = str(meta.get("tunit", "s")).strip().replace(r"\u00B5", "µ") or "s"
        unit = SECONDS.get(named, SECONDS.get(named.lower()))
        if unit is not None:
            return {"interval_s": interval * unit}, ()
        told = f"{interval:g} {printable(named)}".strip()
        return {}, (f"The frame interval of {told} is in no unit of time, and is not used.",)
    if (speed := number(meta.get("fps"))) > 0:
        # ImageJ means how fast it plays the stack, but other programs write how it was recorded.
        return {"interval_s": 1 / speed}, (
            f"The {speed:g} frames a second are those at which ImageJ plays the recording; check "
            "the frame rate.",
        )
    return {}, ()


def ome_facts(tif: tifffile.TiffFile) -> Facts:
    """Return pixel size (um) and frame interval (s) of an OME-TIFF file, where given."""
    facts: Facts = {}
    pixels = ome_pixels(tif)
    if pixels is None:
        return facts
    width, height = (
        number(pixels.get(f"PhysicalSize{axis}"))
        * MICROMETRES.get(pixels.get(f"PhysicalSize{axis}Unit", "µm"), 0.0)
        for axis in "XY"
    )
    if width > 0:
        facts["pixel_um"] = width
    if height > 0:
        facts["height_um"] = height
    unit = SECONDS.get(pixels.get("TimeIncrementUnit", "s"), 0.0)
    if number(pixels.get("TimeIncrement")) * unit > 0:
        facts["interval_s"] = number(pixels.get("TimeIncrement")) * unit
    return facts


def ome_planes(tif: tifffile.TiffFile) -> list[tuple[dict[str, int], float]]:
    """Return place and time (s) of the planes of an OME-TIFF file that note them."""
    pixels = ome_pixels(tif)
    planes: list[tuple[dict[str, int], float]] = []
    for plane in () if pixels is None else [e for e in pixels if e.tag.endswith("Plane")]:
        unit = SECONDS.get(plane.get("DeltaTUnit", "s"))
        given = plane.get("DeltaT")
        place = [plane.get(f"The{axis}", "" if axis == "T" else "0") for axis in "TCZ"]
        if unit and given is not None and all(n.isdecimal() for n in place):
            numbers = dict(zip("TCZ", map(int, place), strict=True))
            planes.append((numbers, number(given) * unit))
    return planes


def times_of(
    planes: Sequence[tuple[Mapping[str, int], float]], chosen: Mapping[str, int]
) -> NDArray[np.float64] | None:
    """Return the time of each frame (s) at a place on further axes, None if planes don't say."""
    times: dict[int, float] = {}
    for place, time in planes:
        if all(place.get(axis, wanted) == wanted for axis, wanted in chosen.items()):
            times.setdefault(place["T"], time)
    if len(times) < 2 or sorted(times) != list(range(len(times))):
        return None
    all_times = np.array([times[i] for i in range(len(times))])
    return all_times - all_times[0] if (np.diff(all_times) > 0).all() else None


def measured(
    times: NDArray[np.float64] | None, interval_s: float | None
) -> tuple[NDArray[np.float64] | None, tuple[str, ...]]:
    """Return the times of the frames, None where the interval says the same, and a note."""
    if times is None or interval_s is None:
        return times, ()
    off = float(np.abs(times - interval_s * np.arange(len(times))).max())
    if off <= EVEN * interval_s:
        return None, ()
    return times, (
        f"The times noted with the frames are up to {off:.3g} s off the file's frame interval of "
        f"{interval_s:g} s; those of the frames are taken.",
    )


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
