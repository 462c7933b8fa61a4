"""Layers side by side, and the view as it was before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.utils import Colormap

from napari_phase4d._napari.turns import UNSEEN, Steps
from napari_phase4d._napari.viewing.layers import METADATA_KEY, PHASE_COLOURS

__all__ = [
    "LINKED",
    "ViewState",
    "arrange",
    "common_contrast",
    "hide_labels",
    "link",
    "look_closer",
    "take_down",
]

#: What results side by side share.
LINKED = ("contrast_limits", "colormap", "gamma")
#: More layers than this in the grid get small labels.
CROWD = 6
#: Size of a name in points; width and height of a colour bar in pixels, and of its numbers in
#: points: first the usual ones, then the small ones. Ten numbers beside a bar do not touch.
NAME_FONT = (10.0, 8.0)
#: A name that its cell is too narrow for gets smaller letters, but never smaller than that.
LEAST_FONT = 6.0
#: Pixels beside a name, and width of a letter in pixels for each point of the font.
BESIDE, LETTER = 24.0, 0.95
COLORBAR_SIZE, COLORBAR_FONT = ((9.0, 110.0), (6.0, 72.0)), (8.0, 6.0)
#: An object is where phase exceeds this share of its largest, and is shown with so much room.
OBJECT_SHARE, ROOM = 0.1, 1.25


@dataclass(frozen=True)
class ViewState:
    """What a viewer shows, to come back to it.

    Layers that are removed meanwhile are passed over; those that this plugin has added are hidden.
    """

    layers: list[tuple[Any, dict[str, Any], bool, bool]]
    grid: bool
    point: tuple[float, ...]
    labels: tuple[str, ...]
    camera: tuple[tuple[float, ...], float, tuple[float, ...]]
    overlays: dict[str, bool]

    @classmethod
    def of(cls, viewer: Any) -> ViewState:
        """Note what a viewer shows."""
        layers = []
        for layer in viewer.layers:
            names = [name for name in ("visible", *LINKED) if hasattr(layer, name)]
            looks = {name: getattr(layer, name) for name in names}
            bar = getattr(layer, "colorbar", None)
            named = layer.name_overlay.visible
            layers.append((layer, looks, named, bar is not None and bar.visible))
        camera, overlays = viewer.scene.camera, viewer.canvas.overlays
        return cls(
            layers,
            viewer.canvas.grid.enabled,
            tuple(viewer.dims.point),
            tuple(viewer.dims.axis_labels),
            (tuple(camera.center), camera.zoom, tuple(camera.angles)),
            {name: getattr(overlays, name).visible for name in ("current_slice", "scale_bar")},
        )

    def restore(self, viewer: Any) -> None:
        """Show again what was shown then."""
        known = [noted for noted in self.layers if noted[0] in viewer.layers]
        added = [la for la in viewer.layers if not any(la is noted[0] for noted in known)]
        for layer in added:
            if METADATA_KEY in layer.metadata:
                layer.visible = False
        for layer, looks, named, bar in known:
            for name, value in looks.items():
                setattr(layer, name, value)
            layer.name_overlay.visible = named
            if hasattr(layer, "colorbar"):
                layer.colorbar.visible = bar
        viewer.canvas.grid.enabled = self.grid
        for name, visible in self.overlays.items():
            getattr(viewer.canvas.overlays, name).visible = visible
        camera = viewer.scene.camera
        camera.center, camera.zoom, camera.angles = self.camera
        if tuple(viewer.dims.axis_labels) == self.labels:
            viewer.dims.point = self.point


#: The shape of a grid that follows the number of its layers.
AS_NEEDED = (-1, -1)


def take_down(viewer: Any, layers: Sequence[Any]) -> Steps:
    """Hide some layers, and leave the grid, in steps.

    A layer or a name that moves to another cell has its shader built anew, which takes longer than
    anything else here. So the grid keeps its shape, and the last layer goes first.
    """
    grid, gone = viewer.canvas.grid, [la for la in in_order(viewer, layers) if la.visible]
    shape = tuple(grid.shape)
    if grid.enabled and len(gone) > 1 and shape == AS_NEEDED:
        grid.shape = shape_for(sum(bool(la.visible) for la in viewer.layers))
        yield UNSEEN
    for layer in reversed(gone):
        hide_labels(layer)
        if layer is gone[0]:  # without any, napari would build the grid anew, now and next time
            grid.enabled = False
        layer.visible = False
        yield UNSEEN
    grid.enabled = False
    grid.shape = shape
    yield


def arrange(viewer: Any, layers: Sequence[Any], bar: int = 0) -> Steps:
    """Show some hidden layers in a grid, each with its name, one colour bar for all, in steps.

    The colour bar is that of the first layer, or of the one with that number.
    """
    grid, layers = viewer.canvas.grid, in_order(viewer, layers)
    shape = tuple(grid.shape)
    if len(layers) > 1:
        if shape == AS_NEEDED:  # from the first layer on as it will be in the end
            others = sum(bool(la.visible) for la in viewer.layers if la not in layers)
            grid.shape = shape_for(len(layers) + others)
        layers[0].visible = True  # and then the grid, which has its shape at once
        yield UNSEEN
        grid.enabled = True
        yield
    for layer in layers:
        if layer in viewer.layers and not layer.visible:  # and not removed meanwhile
            layer.visible = True
            yield
    grid.shape = shape
    yield
    size = font_of_names(viewer, layers)
    for number, layer in enumerate(layers):
        if layer in viewer.layers:
            show_name(layer, size)
            yield
            if number == bar:
                # In one row, the lower left corner is that of the words on the canvas.
                low = len(layers) > CROWD or viewer.canvas.grid.actual_shape(viewer.layers)[0] > 1
                place = "bottom_left" if low else "top_right"
                show_bar(layer, small=len(layers) > CROWD, place=place)
                yield


def in_order(viewer: Any, layers: Sequence[Any]) -> list[Any]:
    """Return layers of a viewer in the order of its list, which is that of the grid."""
    return [la for la in viewer.layers if la in layers]


def shape_for(count: int) -> tuple[int, int]:
    """Return the rows and columns that napari gives so many layers."""
    columns = math.ceil(math.sqrt(count))
    return math.ceil(count / columns), columns


def link(
    viewer: Any,
    layers: Sequence[Any],
    limits: tuple[float, float],
    colormap: Colormap | None = None,
) -> Steps:
    """Give layers the same contrast and colours, now and when one is changed, in steps."""
    low, high = limits
    viewer.layers.unlink_layers(layers)
    for layer in layers:
        layer.contrast_limits_range = (
            min(low, layer.contrast_limits_range[0]),
            max(high, layer.contrast_limits_range[1]),
        )
        layer.contrast_limits = (low, high)
        own = layer.colormap.name.startswith(PHASE_COLOURS)
        if colormap is not None and own:  # and not what the user has chosen
            layer.colormap = colormap
        yield
    viewer.layers.link_layers(layers, LINKED)


def common_contrast(layers: Sequence[Any], exact: Any | None) -> tuple[float, float]:
    """Return contrast limits that suit several results: those of the truth, where it is shown.

    Without truth, a single method that fails by many cycles must not darken all others.
    """
    if exact is not None and exact in layers:
        low, high = exact.contrast_limits
        return float(low), float(high)
    limits = np.array([layer.contrast_limits for layer in layers])
    return float(np.median(limits[:, 0])), float(np.median(limits[:, 1]))


def hide_labels(layer: Any) -> None:
    """Take a layer's name and colour bar away."""
    layer.name_overlay.visible = False
    if hasattr(layer, "colorbar"):
        layer.colorbar.visible = False


def font_of_names(viewer: Any, layers: Sequence[Any]) -> float:
    """Return the size of letters with which the longest name fits its cell, in points."""
    columns = shape_for(max(1, len(layers)))[1]
    room = viewer.canvas.size[1] / columns - BESIDE
    longest = max((len(layer.name) for layer in layers), default=1)
    fits = room // (LETTER * longest)
    return float(np.clip(fits, LEAST_FONT, NAME_FONT[len(layers) > CROWD]))


def show_name(layer: Any, size: float) -> None:
    """Show a layer's name in letters of that many points."""
    layer.name_overlay.font_size = size
    layer.name_overlay.visible = True


def show_bar(layer: Any, *, small: bool, place: str) -> None:
    """Show a layer's colour bar, which leaves the picture free, also in a small cell."""
    layer.colorbar.size = COLORBAR_SIZE[small]
    layer.colorbar.font_size = COLORBAR_FONT[small]
    layer.colorbar.tick_length = 3.0
    layer.colorbar.box = True
    layer.colorbar.position = place
    layer.colorbar.visible = True


def look_closer(viewer: Any, stack: Any) -> None:
    """Zoom in on where an object is at any time, if that is a small part of the field.

    Parameters
    ----------
    viewer : napari.viewer.ViewerModel
        Shows the whole field.
    stack : ndarray, shape (n, y, x)
        Some frames, thinned out by any factor, in which the object is what is not 0.
    """
    if viewer.dims.ndisplay != 2:
        return
    known = np.nan_to_num(np.abs(stack))
    ever = (known > OBJECT_SHARE * np.quantile(known, 0.999)).any(axis=0)
    if not ever.any():
        return
    spans = [np.flatnonzero(ever.any(axis=1 - axis)) for axis in (0, 1)]
    first, last = (np.array([span[end] for span in spans]) for end in (0, -1))
    extent = viewer.layers.get_extent([la for la in viewer.layers if la.visible]).world
    step = (extent[1] - extent[0])[-2:] / (np.array(ever.shape) - 1).clip(1)
    cell = np.array(viewer.canvas.size) / viewer.canvas.grid.actual_shape(viewer.layers)
    camera, zoom = viewer.scene.camera, float((cell / ((last - first + 1) * step * ROOM)).min())
    if zoom <= camera.zoom:
        return
    centre = np.array(camera.center)
    centre[-2:] += ((first + last) / 2 - (np.array(ever.shape) - 1) / 2) * step
    camera.center, camera.zoom = tuple(centre), zoom
