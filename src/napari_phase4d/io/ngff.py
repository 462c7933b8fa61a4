"""The description of an image in OME-Zarr (https://ngff.openmicroscopy.org)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from napari_phase4d.io.units import MICROMETRES, SECONDS
from napari_phase4d.io.video import Facts

__all__ = ["axes_of", "ome_facts", "ome_image"]


def ome_image(attrs: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the description of the first image of an OME-Zarr group."""
    inner = attrs.get("ome", attrs)
    images = inner.get("multiscales") if isinstance(inner, Mapping) else None
    if not isinstance(images, list) or not images or not isinstance(images[0], dict):
        return None
    return images[0] if images[0].get("datasets") else None


def axes_of(image: Mapping[str, Any]) -> str:
    """Return the axes of an OME-Zarr image as letters."""
    return "".join(
        str(axis.get("name", "?") if isinstance(axis, Mapping) else axis)[:1]
        for axis in image.get("axes", ())
    )


def ome_facts(image: Mapping[str, Any]) -> Facts:
    """Return pixel (um) and interval (s) of an OME-Zarr image, where their units are given."""
    axes = [axis for axis in image.get("axes", ()) if isinstance(axis, Mapping)]
    scale = np.ones(len(axes))
    steps = [part.get("coordinateTransformations") for part in (image, image["datasets"][0])]
    for step in [one for many in steps for one in many or () if one.get("type") == "scale"]:
        if len(step.get("scale", ())) == len(axes):
            scale = scale * np.asarray(step["scale"], np.float64)
    facts: Facts = {}
    for axis, size in zip(axes, scale, strict=True):
        unit = str(axis.get("unit", ""))
        if not (math.isfinite(size) and size > 0):
            continue
        if axis.get("name") == "x" and unit in MICROMETRES:
            facts["pixel_um"] = float(size) * MICROMETRES[unit]
        elif axis.get("type") == "time" and unit in SECONDS:
            facts["interval_s"] = float(size) * SECONDS[unit]
    return facts
