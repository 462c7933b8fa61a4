"""Reconstructions with their axes, units and notes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.axes import AXES, coordinate
from napari_phase4d.holography.aberrations import ABERRATION_NAMES
from napari_phase4d.holography.focusing import Focus
from napari_phase4d.holography.lobes import Lobe
from napari_phase4d.recording import Recording
from napari_phase4d.stacks import KIND, WRAPPED

__all__ = ["aberration_note", "as_dataset", "focus_note", "lobe_note", "recalibrated"]

Stack = TypeVar("Stack", xr.Dataset, xr.DataArray)


def lobe_note(lobe: Lobe) -> dict[str, object]:
    """Return a lobe as JSON can hold it."""
    return {
        "carrier": list(lobe.carrier),
        "radius": lobe.radius,
        "angle_deg": lobe.angle_deg,
        "flip": lobe.flip,
    }


def focus_note(focus: Focus) -> dict[str, object]:
    """Return how the focus was found, as JSON can hold it."""
    return {
        "focus_metric": focus.metric,
        "focus_objects": focus.objects,
        "focus_at_the_end": focus.at_the_end,
    }


def aberration_note(coefficients: NDArray[np.float64]) -> dict[str, float]:
    """Return a background's Zernike terms in radians rms, with their names or numbers.

    The constant is left out: it is set by the empty field of each frame.
    """
    return {
        ABERRATION_NAMES.get(j, f"Noll {j}"): round(float(value), 6)
        for j, value in enumerate(coefficients[1:], start=2)
    }


def times_and_places(
    rec: Recording, pixel_ratio: Sequence[float], shape: Sequence[int]
) -> dict[str, tuple[str, NDArray[np.floating], dict[str, str]]]:
    """Return the coordinates of time, y and x of a reconstruction."""
    step_y, step_x = (rec.optics.pixel_um * ratio for ratio in pixel_ratio)
    return {
        "time": coordinate("time", rec.times_s),
        "y": coordinate("y", np.arange(shape[0]) * step_y),
        "x": coordinate("x", np.arange(shape[1]) * step_x),
    }


def recalibrated(stack: Stack, rec: Recording) -> Stack:
    """Return a reconstruction, or what was made of it, with a recording's new optics and times.

    Parameters
    ----------
    stack : Dataset or DataArray
        With ``attrs["pixel_ratio"]``, as `reconstruct` notes it.
    rec : Recording
        The same frames with another microscope or frame rate.
    """
    shape = (stack.sizes["y"], stack.sizes["x"])
    changed = stack.assign_coords(times_and_places(rec, stack.attrs["pixel_ratio"], shape))
    light = {
        "wavelength_um": rec.optics.wavelength_um,
        "medium_index": rec.optics.medium_index,
    }
    changed.attrs = {**stack.attrs, **light}
    if isinstance(changed, xr.Dataset):
        for name, variable in changed.data_vars.items():
            changed[name] = variable.copy(deep=False).assign_attrs(light)
    return changed


def as_dataset(
    rec: Recording,
    angles: list[float],
    pixel_ratio: tuple[float, float],
    phase: NDArray[np.float32],
    amplitude: NDArray[np.float32],
    attrs: dict[str, Any],
) -> xr.Dataset:
    """Give the arrays their names, axes and units."""
    coords = {
        "angle": coordinate("angle", np.asarray(angles)),
        **times_and_places(rec, pixel_ratio, phase.shape[2:]),
    }
    return xr.Dataset(
        {
            "phase": xr.DataArray(
                phase, dims=AXES, attrs={"units": "rad", KIND: WRAPPED, **attrs}
            ),
            "amplitude": xr.DataArray(amplitude, dims=AXES, attrs={"units": "a.u.", **attrs}),
        },
        coords=coords,
        attrs=attrs,
    )
