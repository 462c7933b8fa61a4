"""Entries of napari's menus that work on the selected layer, without the dock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from napari.layers import Image
from napari.qt.threading import create_worker
from napari.utils.notifications import show_error, show_info
from napari.viewer import Viewer

from napari_phase4d._napari.jobs import sentence_of
from napari_phase4d._napari.preferences import (
    own_optics,
    own_refraction_increment,
    with_own_optics,
)
from napari_phase4d._napari.viewing.layers import (
    METADATA_KEY,
    LayerTuple,
    is_hologram_layer,
    is_phase_layer,
    recording_of_layer,
    stack_layer,
    stack_of_layer,
)
from napari_phase4d.holography import find_lobes, reconstruct
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.unwrapping import METHODS, unwrap

__all__ = [
    "dry_mass_density",
    "optical_path",
    "reconstruct_selected",
    "unwrap_2d",
    "unwrap_ta",
    "unwrap_wl1",
]

#: Views that are looked for in a hologram.
N_VIEWS = 2


def reconstruct_selected(viewer: Viewer) -> None:
    """Add the wrapped phase of the selected hologram video, two views, default settings."""

    def work(layer: Image) -> LayerTuple:
        recording = with_own_optics(recording_of_layer(layer))
        data = reconstruct(recording, find_lobes(recording, N_VIEWS))
        return stack_layer(data["phase"], f"wrapped phase, {layer.name}", "wrapped")

    on_selected(viewer, is_hologram_layer, "a hologram video", "Reconstructing", work)


def unwrap_2d(viewer: Viewer) -> None:
    """Add the selected wrapped phase, unwrapped frame by frame."""
    unwrap_selected(viewer, "spatial-2d")


def unwrap_ta(viewer: Viewer) -> None:
    """Add the selected wrapped phase, unwrapped along time, then angle."""
    unwrap_selected(viewer, "temporal-angular")


def unwrap_wl1(viewer: Viewer) -> None:
    """Add the selected wrapped phase, unwrapped by directional L1."""
    unwrap_selected(viewer, "directional-l1")


def unwrap_selected(viewer: Viewer, method: str) -> None:
    """Add the selected wrapped phase, unwrapped by a method, from the first frame."""
    label = METHODS[method].label

    def work(layer: Image) -> LayerTuple:
        result = unwrap(stack_of_layer(layer), method)
        return stack_layer(result, f"{label}, {layer.name}", "unwrapped")

    on_selected(viewer, is_phase_layer, "wrapped phase", f"Unwrapping by {label}", work)


def optical_path(viewer: Viewer) -> None:
    """Add the optical path difference of the selected unwrapped phase, in nanometres."""

    def work(layer: Image) -> LayerTuple:
        stack = stack_of_layer(layer)
        path = stack.copy(data=nanometres(stack))
        path.attrs = {**stack.attrs, "units": "nm"}
        return stack_layer(path, f"optical path (nm), {layer.name}", "optical path")

    on_selected(viewer, is_unwrapped_layer, "unwrapped phase", "Computing the path", work)


def dry_mass_density(viewer: Viewer) -> None:
    """Add the dry mass of the selected unwrapped phase, in picograms a square micrometre."""
    increment = own_refraction_increment()

    def work(layer: Image) -> LayerTuple:
        stack = stack_of_layer(layer)
        density = stack.copy(data=nanometres(stack) / np.float32(1000 * increment))
        density.attrs = {**stack.attrs, "units": "pg/um^2", "refraction_increment": increment}
        return stack_layer(density, f"dry mass (pg/µm²), {layer.name}", "dry mass")

    on_selected(viewer, is_unwrapped_layer, "unwrapped phase", "Computing the dry mass", work)


def nanometres(stack: xr.DataArray) -> Any:
    """Return the optical path difference of phase, float32."""
    light = wavelengths_of(stack)
    if light is None:
        light = np.full(stack.sizes["angle"], (own_optics() or Optics()).wavelength_um)
    path_um = stack.values * (light / (2 * np.pi))[:, None, None]
    return (1000 * path_um).astype(np.float32)


def is_unwrapped_layer(layer: Any) -> bool:
    """Say whether a layer is unwrapped phase, exact or computed."""
    return layer.metadata.get(METADATA_KEY, {}).get("kind") in ("unwrapped", "exact")


def on_selected(
    viewer: Viewer,
    fits: Callable[[Any], bool],
    wanted: str,
    title: str,
    work: Callable[[Image], LayerTuple],
) -> Any:
    """Work on the selected layer in a thread and add what comes of it; say what is wrong."""
    layer = viewer.layers.selection.active
    if not isinstance(layer, Image) or not fits(layer):
        show_error(f"Select a layer with {wanted} first; Plugins > Phase 4D makes one.")
        return None

    def guarded() -> LayerTuple | Exception:
        # The worker's own signal for errors fails on PySide6.
        try:
            return work(layer)
        except Exception as error:
            return error

    def receive(found: LayerTuple | Exception) -> None:
        if isinstance(found, Exception):
            show_error(sentence_of(found))
            return
        data, keywords, _ = found
        viewer.add_image(data, **keywords)
        show_info(f"{title}: done.")

    worker = create_worker(guarded, _start_thread=False, _progress={"desc": title})
    worker.returned.connect(receive)
    worker.start()
    return worker
