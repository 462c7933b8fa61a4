"""Results that travel: 4-D phase as OME-TIFF or OME-Zarr, tables as CSV."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from napari_phase4d.axes import AXES
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.io.describing import restored
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.tiff_results import (
    read_tiff_result,
    tiff_description,
    write_tiff_result,
)
from napari_phase4d.io.zarr_results import (
    read_zarr_result,
    write_zarr_result,
    zarr_description,
)
from napari_phase4d.stacks import in_units
from napari_phase4d.task import CancelledCall, ProgressCall, Task
from napari_phase4d.words import local_path

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "is_result",
    "read_results",
    "result_attrs",
    "write_phase",
    "write_table",
]

#: What the name of an OME-Zarr ends with; everything else is written as OME-TIFF.
ZARR_SUFFIX = ".zarr"


def write_phase(
    path: str | Path,
    stack: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Path:
    """Write a 4-D stack as OME-TIFF or OME-Zarr with pixel size, times, angles and provenance.

    Lazy stacks are computed and written some frames at a time, so that they may be larger than
    memory. The same stack gives the same bytes.

    The viewing angles lie on the channel axis, which OME has no better name for, and name the
    channels. Angles, times, places and attributes are also noted as they are, from where
    `read_results` restores them exactly: in the description of an OME-TIFF, and in the attribute
    "napari-phase4d" of an OME-Zarr.

    Parameters
    ----------
    path : str or Path
        File to write, replaced if it exists: a name that ends with ``.zarr``, by custom
        ``.ome.zarr``, gives a folder in OME-Zarr 0.5 (Zarr 3, one chunk a frame, compressed); any
        other, by custom ``.ome.tif``, gives an OME-TIFF (BigTIFF beyond 4 GB).
    stack : xarray.DataArray
        Dims (time, angle, y, x), backed by NumPy or dask.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    TypeError, ValueError
        If the stack has other dims, or no pixels.
    Cancelled
        If ``cancelled()`` returned True; an older file of that name is then left as it was.

    See Also
    --------
    read_results : Reads it back.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> yeast = p4d.simulation.budding_yeast(n_times=3)
    >>> path = p4d.write_phase("yeast.ome.tif", yeast["wrapped"])
    >>> p4d.read_results(path).equals(yeast["wrapped"])
    True
    """
    path = local_path(path)
    if not isinstance(stack, xr.DataArray) or set(stack.dims) != set(AXES):
        msg = "only a DataArray with dims time, angle, y and x can be written as a result"
        raise TypeError(msg)
    if 0 in stack.shape:
        msg = f"the stack for {path.name} is empty: its shape is {stack.shape}"
        raise ValueError(msg)
    stack = in_units(stack.transpose(*AXES), "the stack")
    write = write_zarr_result if path.suffix.lower() == ZARR_SUFFIX else write_tiff_result
    write(path, stack, Task(progress, cancelled))
    return path


def read_results(path: str | Path) -> xr.DataArray:
    """Read a stack that `write_phase` wrote: same numbers, coordinates and attributes.

    The numbers of an OME-Zarr stay on disk, as a dask array of one frame a chunk, and are read
    when they are used.

    Raises
    ------
    OSError
        If the file is missing, damaged, or was not written by this program.

    See Also
    --------
    write_phase : Writes it, with an example.
    """
    path = local_path(path)
    return read_zarr_result(path) if path.is_dir() else read_tiff_result(path)


def is_result(path: str | Path) -> bool:
    """Say whether a file or folder was written by `write_phase`."""
    return result_attrs(path) is not None


def result_attrs(path: str | Path) -> dict[str, Any] | None:
    """Return the attributes of what `write_phase` wrote to a file here, None for any other."""
    if address_of(path) is not None:
        return None
    path = local_path(path)
    description = zarr_description(path) if path.is_dir() else tiff_description(path)
    return None if description is None else dict(restored(description.get("attrs", {})))


def as_table_file(path: str | Path) -> Path:
    """Return the name that a table is written under."""
    path = local_path(path)
    if path.suffix.lower() not in ("", ".csv"):
        msg = f"a table is written as .csv, but the name is {path.name}"
        raise ValueError(msg)
    return path if path.suffix else path.with_suffix(".csv")


def write_table(path: str | Path, table: pd.DataFrame) -> Path:
    """Write a table as CSV and return its path, which gets the ending .csv if it has none.

    Raises
    ------
    ValueError
        If the name has another ending.
    OSError
        If it can't be written; an older file of that name is then left as it was.
    """
    path = as_table_file(path)
    with written_whole(path) as temporary:
        table.to_csv(temporary)
    return path
