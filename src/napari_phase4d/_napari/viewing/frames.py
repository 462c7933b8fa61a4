"""Between the viewer's sliders and cursor, and the frames and pixels of a stack."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d.io import step_of

__all__ = ["current_frame", "go_to_frame", "pixel_under_cursor"]


def current_frame(viewer: Any, stack: xr.DataArray) -> tuple[int, int]:
    """Return the (time, angle) numbers of the frame that is on screen."""
    labels = list(viewer.dims.axis_labels)
    found = []
    for axis in ("time", "angle"):
        origin, step, n = axis_steps(stack, axis)
        world = viewer.dims.point[labels.index(axis)] if axis in labels else origin
        found.append(int(np.clip(round((world - origin) / step), 0, n - 1)))
    return found[0], found[1]


def go_to_frame(viewer: Any, stack: xr.DataArray, time: int, angle: int) -> None:
    """Move the sliders to a frame of a stack."""
    labels = list(viewer.dims.axis_labels)
    for axis, number in (("time", time), ("angle", angle)):
        if axis in labels:
            origin, step, _ = axis_steps(stack, axis)
            viewer.dims.set_point(labels.index(axis), origin + number * step)


def pixel_under_cursor(viewer: Any, stack: xr.DataArray) -> tuple[int, int] | None:
    """Return the (y, x) numbers of the pixel under the mouse, None outside of the stack."""
    found = []
    for axis, world in zip(("y", "x"), viewer.cursor.position[-2:], strict=True):
        origin, step, n = axis_steps(stack, axis)
        number = round((world - origin) / step)
        if not 0 <= number < n:
            return None
        found.append(int(number))
    return found[0], found[1]


def axis_steps(stack: xr.DataArray, axis: str) -> tuple[float, float, int]:
    """Return where an axis starts, its step as the layers have it, and its length."""
    coordinates = np.asarray(stack[axis].values, dtype=np.float64)
    return float(coordinates[0]), step_of(coordinates), len(coordinates)
