"""What the user's layers hold: holograms, phase, truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d._napari.viewing.layers import METADATA_KEY
from napari_phase4d._napari.viewing.on_demand import frames_of, lazy_of
from napari_phase4d.axes import AXES, UNITS
from napari_phase4d.io import open_recording
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import Recipe
from napari_phase4d.recording import Recording

__all__ = [
    "is_hologram_layer",
    "is_phase_layer",
    "recipe_of_layer",
    "recording_of_layer",
    "stack_of_layer",
    "truth_among",
]


def is_hologram_layer(layer: Any) -> bool:
    """Say whether a layer could be a hologram video: its own kind, or a grey image in 2 or 3 D."""
    note = layer.metadata.get(METADATA_KEY)
    if note is not None:
        return bool(note.get("kind") == "holograms")
    return not layer.rgb and not layer.multiscale and layer.ndim in (2, 3)


def is_phase_layer(layer: Any) -> bool:
    """Say whether a layer is wrapped phase that this plugin made."""
    return bool(layer.metadata.get(METADATA_KEY, {}).get("kind") == "wrapped")


def stack_of_layer(layer: Any) -> xr.DataArray:
    """Return the stack that one of our 4-D layers shows, with its coordinates."""
    note = dict(layer.metadata[METADATA_KEY])
    note.pop("kind")
    note.pop("recipe", None)
    steps = zip(layer.data.shape, layer.scale, layer.translate, strict=True)
    evenly = [offset + scale * np.arange(n) for n, scale, offset in steps]
    known = (np.asarray(note.pop("times_s")), np.asarray(note.pop("angles_deg")), *evenly[2:])
    coords = {
        axis: (axis, values, {"units": UNITS[axis]})
        for axis, values in zip(AXES, known, strict=True)
    }
    return xr.DataArray(lazy_of(layer.data), dims=AXES, coords=coords, attrs=note)


def truth_among(layers: Any, phase: xr.DataArray) -> xr.DataArray | None:
    """Return the exact phase that belongs to wrapped phase, if a layer shows it."""
    for layer in layers:
        note = layer.metadata.get(METADATA_KEY, {})
        same = note.get("object") == phase.attrs.get("object") is not None
        if note.get("kind") == "exact" and same and layer.data.shape == phase.shape:
            return stack_of_layer(layer)
    return None


def recording_of_layer(layer: Any) -> Recording:
    """Return the recording that a layer shows.

    Parameters
    ----------
    layer : napari.layers.Image
        A layer made by `hologram_layer`, whose optics and times are noted in it, or any grey
        image (y, x) or video (time, y, x), whose scale and units are used where it has them.
    """
    note = layer.metadata.get(METADATA_KEY)
    if note is None:
        return open_recording(layer)
    optics = Optics(
        note["wavelength_um"],
        note["camera_pixel_um"],
        note["magnification"],
        note["medium_index"],
    )
    return Recording.from_frames(
        frames_of(layer.data),
        optics=optics,
        times_s=np.asarray(note["times_s"]),
        name=str(layer.name),
        source=str(note["source"]),
        notes=tuple(note["notes"]),
    )


def recipe_of_layer(layer: Any) -> Recipe | None:
    """Return the settings that came with a layer, None where there are none."""
    noted = layer.metadata.get(METADATA_KEY, {}).get("recipe")
    return None if noted is None else Recipe.model_validate(noted)
