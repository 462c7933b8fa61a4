"""Wrapped phase that another program, or this one, has already reconstructed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d.axes import AXES, PLAIN_AXES, coordinate
from napari_phase4d.io.hdf5 import HDF5_SUFFIXES, read_hdf5
from napari_phase4d.io.koala import is_koala_phase, read_koala_phase
from napari_phase4d.io.numpy_files import holds_holograms, read_npy, read_npz
from napari_phase4d.io.reading import check_there
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.results import is_result, read_results, result_attrs
from napari_phase4d.io.tiff import TIFF_SUFFIXES, read_tiff
from napari_phase4d.io.video import Video, check_fits
from napari_phase4d.io.zarr_files import is_zarr, read_zarr
from napari_phase4d.stacks import looks_wrapped
from napari_phase4d.words import as_numbers, as_path, check_positive, shown

__all__ = ["holds_phase", "open_phase"]

#: What to do with phase that is no file.
ARRAYS = "phase that is an array already goes to unwrap() as it is"
#: No pixel in a sample is wider.
LARGE_PIXEL_UM = 1e4
#: Names looked for first in an .npz file with several arrays.
PHASE_NAMES = ("wrapped", "phase", "unwrapped")


def open_phase(
    path: str | Path,
    dataset: str | None = None,
    *,
    pixel_um: float | None = None,
    frame_rate_hz: float | None = None,
    angles_deg: Sequence[float] | None = None,
) -> xr.DataArray:
    """Read a stack of phase in radians.

    Parameters
    ----------
    path : str or Path
        An OME-TIFF or OME-Zarr that this program wrote, with its times, angles and pixels; a
        .npy, .npz or TIFF file with (y, x), (time, y, x) or (time, angle, y, x); an HDF5, Zarr or
        OME-Zarr of any program with (y, x) or (time, y, x); or phase of Koala, a .bin file or a
        folder of them.
    dataset : str, optional
        Which array of an .npz, HDF5 or Zarr file, or which place on further axes of a TIFF or
        OME-Zarr, as "C=0". Default, for .npz: ``wrapped``, ``phase`` or ``unwrapped``, else the
        first with two to four dimensions; for HDF5 and Zarr: as for holograms.
    pixel_um, frame_rate_hz, angles_deg : float, float, sequence of float, optional
        Pixel in the sample, frames per second and viewing angles of a file that does not say
        them; default 1 um, 1 a second, and numbers from 0. ``attrs["notes"]`` says what had to be
        assumed.

    Returns
    -------
    xarray.DataArray
        float32, dims (time, angle, y, x).

    Raises
    ------
    OSError
        If the file is missing, damaged, or of a kind that can't be read.
    ValueError
        If it holds no such stack.
    """
    path = as_path(path, ARRAYS)
    if pixel_um is not None:
        check_positive("pixel_um", pixel_um, LARGE_PIXEL_UM)
    if frame_rate_hz is not None:
        check_positive("frame_rate_hz", frame_rate_hz)
    if angles_deg is not None:
        check_angles(angles_deg)
    check_there(path)
    if is_result(path):
        found = read_results(path)
        return found.assign_attrs(source=str(path), object=found.attrs.get("object", path.stem))
    video = plain_phase(path, dataset)
    values = video.frames
    if values.ndim not in PLAIN_AXES or values.dtype.kind != "f" or 0 in values.shape:
        msg = (
            f"{path.name} holds {values.dtype} numbers of shape {values.shape}; phase is a stack "
            "of floating-point radians (y, x), (time, y, x) or (time, angle, y, x)"
        )
        raise ValueError(msg)
    check_fits(values.size * np.dtype(np.float32).itemsize, path.name)
    dims = PLAIN_AXES[values.ndim]
    stack = xr.DataArray(np.asarray(values, dtype=np.float32), dims=dims, name=path.stem)
    full = stack.expand_dims([d for d in AXES if d not in dims]).transpose(*AXES)
    if angles_deg is not None and len(angles_deg) != full.sizes["angle"]:
        msg = (
            f"{path.name} has {full.sizes['angle']} views, but {len(angles_deg)} angles are given"
        )
        raise ValueError(msg)
    pixel_um = video.pixel_um if pixel_um is None else pixel_um
    times_s = video.times_s if frame_rate_hz is None else None
    steps = {"time": 1 / (frame_rate_hz or 1), "y": pixel_um or 1, "x": pixel_um or 1}
    places = {d: np.arange(full.sizes[d]) * float(steps.get(d, 1)) for d in AXES}
    if times_s is not None:
        places["time"] = times_s
    if angles_deg is not None:
        places["angle"] = np.asarray(angles_deg, dtype=np.float64)
    coords = {d: coordinate(d, places[d]) for d in AXES}
    rate = frame_rate_hz if times_s is None else times_s
    given = {"pixel": pixel_um, "frame rate": rate, "viewing angles": angles_deg}
    missing = [name for name, value in given.items() if value is None]
    attrs: dict[str, Any] = {
        "units": "rad",
        "object": path.stem,
        "source": address_of(path) or str(path),
    }
    if missing:
        attrs["notes"] = [f"Not in the file, so counted in ones: {', '.join(missing)}."]
    return full.assign_coords(coords).assign_attrs(attrs)


def check_angles(angles_deg: Any) -> None:
    """Refuse what is no list of different angles in degrees."""
    angles = as_numbers("angles_deg", angles_deg)
    if angles.ndim != 1 or angles.dtype.kind == "b":
        msg = (
            f"angles_deg must be a list of degrees, one for each view, but is {shown(angles_deg)}"
        )
        raise TypeError(msg)
    if not np.isfinite(angles).all() or np.unique(angles).size < angles.size:
        msg = (
            f"angles_deg must be finite and different from each other, but is {shown(angles_deg)}"
        )
        raise ValueError(msg)


def holds_phase(path: str | Path, dataset: str | None = None) -> bool:
    """Say whether a file holds wrapped phase rather than holograms.

    Holograms are counts of light; wrapped phase lies within half a cycle of zero, on both sides,
    and spans more than half a cycle. Stacks of four dimensions are phase. Of files that this
    program wrote, those that no method has unwrapped are.
    """
    path = Path(path)
    if not path.exists() and address_of(path) is None:
        return False
    noted = result_attrs(path)
    if noted is not None:
        return noted.get("units") == "rad" and "method" not in noted
    if is_koala_phase(path):
        return True
    try:
        if path.suffix.lower() == ".npz" and dataset is None and holds_holograms(path):
            return False
        values = plain_phase(path, dataset).frames
    except (OSError, ValueError):
        return False
    return values.ndim in PLAIN_AXES and (is_stack_of_views(values) or looks_wrapped(values))


def is_stack_of_views(values: Any) -> bool:
    """Say whether numbers have four axes, as holograms never do."""
    return bool(values.dtype.kind == "f" and values.ndim == 4 and 0 not in values.shape)


def plain_phase(path: Path, dataset: str | None) -> Video:
    """Return the numbers of a file that says nothing about them, lazily where it allows that."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return read_npy(path)
    if suffix == ".npz":
        return read_npz(path, dataset, PHASE_NAMES, (2, 3, 4))
    if suffix in TIFF_SUFFIXES:
        return read_tiff(path, dataset)
    if suffix in HDF5_SUFFIXES:
        return read_hdf5(path, dataset)
    if is_zarr(path):
        return read_zarr(path, dataset)
    if is_koala_phase(path):
        return read_koala_phase(path)
    msg = (
        f"{path.name} is of a kind that can't be read as phase; use OME-TIFF, OME-Zarr, HDF5, "
        ".npy, .npz or .bin of Koala"
    )
    raise OSError(msg)
