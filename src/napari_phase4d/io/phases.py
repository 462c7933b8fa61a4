"""Wrapped phase that another program, or this one, has already reconstructed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d.io.numpy_files import read_npy, read_npz
from napari_phase4d.io.results import AXES, is_result, read_results
from napari_phase4d.io.tiff import read_tiff

__all__ = ["holds_phase", "open_phase"]

UNITS = {"time": "s", "angle": "deg", "y": "um", "x": "um"}
#: Axes of stacks with two, three and four dimensions.
PLAIN_DIMS = {2: ("y", "x"), 3: ("time", "y", "x"), 4: AXES}
#: Names looked for first in an .npz file with several arrays.
PHASE_NAMES = ("wrapped", "phase", "unwrapped")
#: Wrapped phase lies in [-pi, pi], give or take its rounding.
LARGEST = np.pi + 1e-3


def open_phase(path: str | Path, dataset: str | None = None) -> xr.DataArray:
    """Read a stack of phase in radians.

    Parameters
    ----------
    path : str or Path
        An OME-TIFF that this program wrote, with its times, angles and pixels; or a .npy, .npz or
        TIFF file with (y, x), (time, y, x) or (time, angle, y, x), whose frames, angles and pixels
        are counted from 0.
    dataset : str, optional
        Which array of an .npz file; default ``wrapped``, ``phase`` or ``unwrapped``, else the
        first with two to four dimensions.

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
    path = Path(path)
    if not path.is_file():
        msg = f"there is no file {path}"
        raise OSError(msg)
    if path.suffix.lower() in (".tif", ".tiff") and is_result(path):
        return read_results(path)
    values = plain_values(path, dataset)
    if values.ndim not in PLAIN_DIMS or values.dtype.kind != "f" or 0 in values.shape:
        msg = (
            f"{path.name} holds {values.dtype} numbers of shape {values.shape}; phase is a stack "
            "of floating-point radians (y, x), (time, y, x) or (time, angle, y, x)"
        )
        raise ValueError(msg)
    dims = PLAIN_DIMS[values.ndim]
    stack = xr.DataArray(np.asarray(values, dtype=np.float32), dims=dims, name=path.stem)
    full = stack.expand_dims([d for d in AXES if d not in dims]).transpose(*AXES)
    coords = {
        d: (d, np.arange(full.sizes[d], dtype=np.float64), {"units": UNITS[d]}) for d in AXES
    }
    return full.assign_coords(coords).assign_attrs(units="rad", source=str(path))


def holds_phase(path: str | Path, dataset: str | None = None) -> bool:
    """Say whether a file holds wrapped phase rather than holograms.

    Holograms are counts of light, and so never negative; wrapped phase lies within half a cycle
    of zero, on both sides of it. The first frame tells.
    """
    path = Path(path)
    if not path.is_file() or path.suffix.lower() not in (".tif", ".tiff", ".npy", ".npz"):
        return False
    if is_result(path):
        return bool(read_results(path).attrs.get("units") == "rad")
    try:
        values = plain_values(path, dataset)
    except (OSError, ValueError):
        return False
    if values.dtype.kind != "f" or values.ndim not in PLAIN_DIMS or 0 in values.shape:
        return False
    first = np.asarray(values if values.ndim == 2 else values[0])
    if not np.isfinite(first).any():
        return False
    low, high = float(np.nanmin(first)), float(np.nanmax(first))
    return -LARGEST <= low < 0 < high <= LARGEST


def plain_values(path: Path, dataset: str | None) -> Any:
    """Return the numbers of a file that says nothing about them, lazily where it allows that."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return read_npy(path).frames
    if suffix == ".npz":
        return read_npz(path, dataset, PHASE_NAMES, (2, 3, 4)).frames
    if suffix in (".tif", ".tiff"):
        return read_tiff(path).frames
    msg = f"{path.name} is of a kind that can't be read as phase; use OME-TIFF, .npy or .npz"
    raise OSError(msg)
