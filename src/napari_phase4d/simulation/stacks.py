"""From moving bodies to 4-D phase stacks with exact truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from napari_phase4d.axes import AXES, coordinate
from napari_phase4d.optics import Optics
from napari_phase4d.simulation.ellipsoids import Ellipsoid, projected_phase
from napari_phase4d.stacks import KIND, UNWRAPPED, WRAPPED

__all__ = ["phase_stack", "wrap"]

Bodies = Callable[[float], Sequence[Ellipsoid]]


def wrap(phase: xr.DataArray) -> xr.DataArray:
    """Wrap phase into (-pi, pi]."""
    turns = np.ceil((phase - np.pi) / (2 * np.pi))
    return (phase - 2 * np.pi * turns).astype(np.float32)


def phase_stack(
    bodies_at: Bodies,
    *,
    times_s: Sequence[float],
    angles_deg: Sequence[float],
    shape: tuple[int, int],
    pixel_um: float | tuple[float, float],
    optics: Optics,
    attrs: dict[str, object],
) -> xr.Dataset:
    """Project moving bodies at every time and angle.

    The middle of the field, pixel ``shape / 2``, is the origin of the bodies' coordinates, so
    that stacks of one field with other pixel sizes show the same object at the same place.

    Parameters
    ----------
    bodies_at : callable
        Gives the bodies at a time in seconds.
    times_s, angles_deg : sequence of float
        When and from where to look.
    shape : tuple of int
        Height and width in pixels.
    pixel_um : float or tuple of float
        Width of a pixel in micrometres, or (height, width).
    optics : Optics
        Gives the wavelength.
    attrs : dict
        Noted in the result.

    Returns
    -------
    xarray.Dataset
        ``phase`` exact and ``wrapped``, float32, dims (time, angle, y, x), radians.
    """
    step_y, step_x = np.broadcast_to(np.asarray(pixel_um, dtype=np.float64), 2)
    y, x = np.arange(shape[0]) * step_y, np.arange(shape[1]) * step_x
    phase = np.empty((len(times_s), len(angles_deg), *shape), dtype=np.float32)
    for t, time in enumerate(times_s):
        bodies = bodies_at(time)
        for a, angle in enumerate(angles_deg):
            centred = y - shape[0] / 2 * step_y, x - shape[1] / 2 * step_x
            phase[t, a] = projected_phase(bodies, angle, *centred, optics.wavelength_um)
    coords = {
        "time": coordinate("time", np.asarray(times_s, dtype=np.float64)),
        "angle": coordinate("angle", np.asarray(angles_deg, dtype=np.float64)),
        "y": coordinate("y", y),
        "x": coordinate("x", x),
    }
    common = {"units": "rad", "wavelength_um": optics.wavelength_um, **attrs}
    exact = xr.DataArray(phase, dims=AXES, coords=coords, attrs=common)
    exact.attrs |= {"exact": True, KIND: UNWRAPPED}
    wrapped = wrap(exact)
    wrapped.attrs = {**common, KIND: WRAPPED}
    return xr.Dataset({"phase": exact, "wrapped": wrapped}, attrs=common)
