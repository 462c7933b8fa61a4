"""Pixel size and times in the metadata of TIFF files."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from napari_phase4d.io.units import MICROMETRES, SECONDS
from napari_phase4d.io.video import Facts

__all__ = ["imagej_facts", "ome_facts", "ome_times", "told_frames"]


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


def number(value: Any) -> float:
    """Return a finite number, else 0."""
    try:
        found = float(value)
    except (TypeError, ValueError):
        return 0.0
    return found if np.isfinite(found) else 0.0
