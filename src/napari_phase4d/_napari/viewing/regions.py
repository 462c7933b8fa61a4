"""Regions that the user drew, as masks on the grid of the phase."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from napari.layers import Labels, Shapes
from numpy.typing import NDArray

from napari_phase4d.analysis import polygon_mask, region_masks
from napari_phase4d.io import step_of

__all__ = ["is_region_layer", "newest_region", "regions_of_layer"]

Mask = NDArray[np.bool_]
#: Corners that stand for an ellipse.
ELLIPSE_CORNERS = 64


def is_region_layer(layer: Any) -> bool:
    """Say whether a layer can hold regions to measure."""
    return isinstance(layer, Labels | Shapes)


def regions_of_layer(layer: Any, phase: xr.DataArray) -> dict[str, Mask]:
    """Return the regions of a Shapes or Labels layer: name -> mask.

    Parameters
    ----------
    layer : napari.layers.Shapes or napari.layers.Labels
        Shapes hold at all times and angles, whichever frame they were drawn on. Labels have the
        axes (y, x), (time, y, x) or (time, angle, y, x) of the phase.
    phase : xarray.DataArray
        The phase, dims (time, angle, y, x).

    Raises
    ------
    ValueError
        If there is no region, or a layer does not fit the phase.
    """
    if isinstance(layer, Labels):
        return dict(region_masks(np.asarray(layer.data)))
    areas = areas_of(layer)
    if not areas:
        msg = f"“{layer.name}” holds no area; draw a polygon, rectangle or ellipse in it"
        raise ValueError(msg)
    return {f"region {index + 1}": mask_of(layer, index, phase) for index in areas}


def newest_region(viewer: Any, phase: xr.DataArray) -> Mask | None:
    """Return the region that was drawn last in the topmost Shapes layer, None if there is none."""
    for layer in reversed(viewer.layers):
        if isinstance(layer, Shapes) and len(layer.data):
            areas = areas_of(layer)
            return mask_of(layer, areas[-1], phase) if areas else None
    return None


def areas_of(layer: Shapes) -> list[int]:
    """Return the numbers of the shapes that have an area, in the order they were drawn."""
    return [n for n, kind in enumerate(layer.shape_type) if kind not in ("line", "path")]


def mask_of(layer: Shapes, index: int, phase: xr.DataArray) -> Mask:
    """Return the pixels of the phase that one shape of a layer covers."""
    corners = np.array([layer.data_to_world(corner) for corner in layer.data[index]])[:, -2:]
    outline = ellipse_outline(corners) if layer.shape_type[index] == "ellipse" else corners
    return polygon_mask(in_pixels(outline, phase), (phase.sizes["y"], phase.sizes["x"]))


def in_pixels(world: NDArray[np.float64], phase: xr.DataArray) -> NDArray[np.float64]:
    """Return (y, x) places in micrometres as pixel numbers of the phase."""
    columns = []
    for column, axis in enumerate(("y", "x")):
        places = np.asarray(phase[axis].values, dtype=np.float64)
        columns.append((world[:, column] - places[0]) / step_of(places))
    return np.stack(columns, axis=1)


def ellipse_outline(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the outline of the ellipse in a rectangle that is given by its four corners."""
    middle = corners.mean(axis=0)
    first, second = (corners[1] - corners[0]) / 2, (corners[3] - corners[0]) / 2
    turns = np.linspace(0, 2 * np.pi, ELLIPSE_CORNERS, endpoint=False)[:, None]
    outline: NDArray[np.float64] = middle + np.cos(turns) * first + np.sin(turns) * second
    return outline
