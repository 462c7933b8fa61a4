"""Complex fields with their angles, as programs for optical diffraction tomography read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.io.atomic import written_whole
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.stacks import AXES, on_grid_of, pixel_um, unwrapped_stack, wavelengths_of
from napari_phase4d.warned import warn
from napari_phase4d.words import (
    advised_call,
    as_numbers,
    check_type,
    counted,
    local_path,
    shown,
)

__all__ = ["sinogram", "write_sinogram"]

#: With fewer views, or over less than this, a tomogram is mostly artefact.
FEW_VIEWS, NARROW_DEG = 20, 120.0
#: Phase of the empty field is less than this, in radians; so many pixels of it tell its amplitude.
EMPTY_RAD, ENOUGH = 0.5, 20
#: A projection of which so large a share is not known was lost.
MOSTLY = 0.5
#: The amplitude of a pixel is at least this share of that of the empty field.
DARKEST = 1e-3


def sinogram(
    unwrapped: xr.DataArray,
    amplitude: xr.DataArray | None = None,
    *,
    time: int | None = None,
    view: int | None = None,
    angles_deg: ArrayLike | None = None,
    optics: Optics | None = None,
) -> xr.Dataset:
    """Return the complex field of each projection over that of the empty field.

    Either the views of one time are the projections, or the times of one view, in which the
    object was turned. Light falls along z; the object turns about the y axis.

    Parameters
    ----------
    unwrapped : xarray.DataArray
        Unwrapped phase in radians, dims (time, angle, y, x); its empty field lies near zero.
    amplitude : xarray.DataArray, optional
        Amplitude of the same frames; that of the empty field counts as 1. Default: 1 everywhere,
        of an object that takes no light away.
    time : int, optional
        The time whose views are taken, counted from 0.
    view : int, optional
        The view whose times are taken, with ``angles_deg``.
    angles_deg : array_like, optional
        Angle of every projection in degrees. Default, with ``time``: those of the views.
    optics : Optics, optional
        Gives the refractive index of the medium, and the wavelength where the phase does not note
        it. Default: the microscope of the paper.

    Returns
    -------
    xarray.Dataset
        ``field``: complex64, a exp(i phase), dims (projection, y, x); ``rytov``: its logarithm,
        ln(a) + i phase, complex64, with the phase as it was unwrapped here, which a program that
        is given the field would have to unwrap again; coordinate ``angle`` in radians. ``attrs``:
        ``resolution``, the vacuum wavelength in pixels, ``medium_index``, ``wavelength_um``,
        ``pixel_um``.

    Raises
    ------
    TypeError, ValueError
        If neither a time nor a view was chosen, angles don't fit, the pixel is not square, or
        views differ in wavelength.

    Warns
    -----
    UserWarning
        If the views are too few or too near to each other for a tomogram; if a frame is left out
        since most of it is not known; other pixels that are not known count as empty field.

    See Also
    --------
    write_sinogram : Writes it.

    Examples
    --------
    >>> from napari_phase4d.io import sinogram
    >>> import warnings
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.budding_yeast((32, 32), n_times=2)["phase"]
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")  # six views make no tomogram
    ...     found = sinogram(exact, time=0)
    >>> found["field"].dims, found["field"].shape
    (('projection', 'y', 'x'), (6, 32, 32))
    """
    optics = Optics() if optics is None else optics
    check_type("optics", optics, Optics, "give Optics(wavelength_um=...)")
    needed = ("y", "x") if angles_deg is not None else ("angle", "y", "x")
    bare = [axis for axis in needed if axis not in getattr(unwrapped, "coords", ())]
    if bare:
        msg = (
            f"the phase has no coordinates along {', '.join(bare)}; "
            "give it degrees and micrometres with assign_coords"
        )
        raise ValueError(msg)
    stack = unwrapped_stack(unwrapped)
    stack = stack.expand_dims([d for d in AXES if d not in stack.dims]).transpose(*AXES)
    phase, angles = projections_of(stack, time, view, angles_deg)
    size = amplitude_of(amplitude, stack, time, view)
    pixels = pixel_um(stack, "phase")
    if not np.isclose(*pixels, rtol=1e-3):
        msg = f"pixels must be square, but are {pixels[0]:g} by {pixels[1]:g} um"
        raise ValueError(msg)
    unknown = ~(np.isfinite(phase) & np.isfinite(size))
    known = unknown.mean(axis=(1, 2)) < MOSTLY
    if not known.any():
        msg = "no projection is known: all of them were lost"
        raise ValueError(msg)
    if not known.all():
        lost = ", ".join(str(i) for i in np.flatnonzero(~known))
        warn(f"projections {lost} are left out: most of them is not known")
    phase, size, angles, unknown = (a[known] for a in (phase, size, angles, unknown))
    if unknown.any():
        warn(f"{counted(int(unknown.sum()), 'pixel')} that are not known count as empty field")
        phase, size = np.where(unknown, 0, phase), np.where(unknown, 1, size)
    warn_of_few(angles)
    log = np.log(np.maximum(size, DARKEST)) + 1j * phase
    dims = ("projection", "y", "x")
    coords = {
        "angle": ("projection", np.deg2rad(angles), {"units": "rad"}),
        "y": stack["y"],
        "x": stack["x"],
    }
    wavelength = wavelength_of(stack, optics)
    return xr.Dataset(
        {
            "field": (dims, np.exp(log).astype(np.complex64)),
            "rytov": (dims, log.astype(np.complex64)),
        },
        coords,
        {
            "resolution": wavelength / pixels[0],
            "medium_index": optics.medium_index,
            "wavelength_um": wavelength,
            "pixel_um": pixels[0],
        },
    )


def projections_of(
    stack: xr.DataArray, time: int | None, view: int | None, angles_deg: ArrayLike | None
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return the phase (projection, y, x) that was chosen, and its angles in degrees."""
    if (time is None) == (view is None):
        msg = "give time=..., whose views are the projections, or view=..., whose times are"
        raise ValueError(msg)
    if view is not None and angles_deg is None:
        msg = "angles_deg must say how far the object was turned at every time of the view"
        raise ValueError(msg)
    chosen = chosen_frames(stack, time, view)
    angles = as_numbers("angles_deg", stack["angle"].values if angles_deg is None else angles_deg)
    if angles.shape != (len(chosen),):
        msg = f"angles_deg must be {len(chosen)} numbers, one a projection, but is {angles.shape}"
        raise ValueError(msg)
    if not np.isfinite(angles).all() or len(np.unique(angles)) < len(angles):
        msg = "angles_deg must be finite and different from each other"
        raise ValueError(msg)
    return chosen, angles.astype(np.float64)


def chosen_frames(stack: xr.DataArray, time: int | None, view: int | None) -> NDArray[np.float32]:
    """Return all views of a time, or all times of a view."""
    axis, number = ("time", time) if time is not None else ("angle", view)
    if isinstance(number, bool) or not isinstance(number, (int, np.integer)):
        msg = f"{axis} must be the number of a {axis}, counted from 0, but is {shown(number)}"
        raise TypeError(msg)
    if not 0 <= number < stack.sizes[axis]:
        msg = f"there is no {axis} {number}; there are {stack.sizes[axis]}, counted from 0"
        raise ValueError(msg)
    return np.asarray(stack.isel({axis: number}).values)


def amplitude_of(
    amplitude: xr.DataArray | None, stack: xr.DataArray, time: int | None, view: int | None
) -> NDArray[np.float64]:
    """Return the amplitude of each projection over that of its empty field, its median."""
    if amplitude is None:
        return np.ones_like(chosen_frames(stack, time, view), dtype=np.float64)
    fitting = on_grid_of(amplitude, stack, "amplitude").transpose(*stack.dims)
    size = chosen_frames(fitting, time, view).astype(np.float64)
    empty = np.abs(chosen_frames(stack, time, view)) < EMPTY_RAD
    for number, (of_frame, field) in enumerate(zip(size, empty, strict=True)):
        level = float(np.nanmedian(of_frame[field])) if field.sum() >= ENOUGH else np.nan
        if np.isfinite(of_frame).any() and not level > 0:
            msg = f"projection {number} shows no empty field, whose amplitude is needed"
            raise ValueError(msg)
        of_frame /= level
    return size


def wavelength_of(stack: xr.DataArray, optics: Optics) -> float:
    """Return the one wavelength of a stack in micrometres."""
    noted = wavelengths_of(stack)
    if noted is None:
        return optics.wavelength_um
    if not np.allclose(noted, noted[0]):
        msg = "views differ in wavelength; choose those of one with isel(angle=[...])"
        raise ValueError(msg)
    return float(noted[0])


def warn_of_few(angles: NDArray[np.float64]) -> None:
    """Warn if a tomogram of these angles would be mostly artefact."""
    spread = float(np.ptp(angles)) if len(angles) else 0.0
    if len(angles) < FEW_VIEWS or spread < NARROW_DEG:
        warn(
            f"{counted(len(angles), 'view')} over {spread:.0f} degrees give no tomogram: what is "
            f"computed of them is mostly artefact. It takes {FEW_VIEWS} or more over half a turn"
        )


@advised_call(data="give what sinogram() returned")
def write_sinogram(path: str | Path, data: xr.Dataset) -> Path:
    """Write a sinogram as HDF5: ``field``, ``rytov``, ``angles``, and the rest as attributes.

    Parameters
    ----------
    path : str or Path
        Name of the file; it gets the ending .h5 if it has none.
    data : xarray.Dataset
        What `sinogram` gave.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    TypeError, ValueError
        If it is no sinogram, or the name has another ending.
    """
    import h5py

    path = local_path(path)
    if path.suffix.lower() not in ("", ".h5", ".hdf5"):
        msg = f"a sinogram is written as .h5, but the name is {path.name}"
        raise ValueError(msg)
    if not {"field", "rytov"} <= set(data.data_vars) or "angle" not in data.coords:
        msg = "data is no sinogram; give what sinogram() returned"
        raise ValueError(msg)
    path = path if path.suffix else path.with_suffix(".h5")
    with written_whole(path) as temporary, h5py.File(temporary, "w") as file:
        for name in ("field", "rytov"):
            file.create_dataset(name, data=data[name].values, compression="gzip", shuffle=True)
        file["angles"] = data["angle"].values
        file["angles"].attrs["units"] = "rad"
        notes: dict[str, Any] = {"axes": "projection, y, x", "turned about": "y", **data.attrs}
        file.attrs.update(notes)
    return path
