"""What this program writes and reads again: results as OME-TIFF or OME-Zarr, and tables."""

from __future__ import annotations

import json
import uuid
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from napari_phase4d.io.atomic import written_whole
from napari_phase4d.io.describing import (
    PROGRAM,
    checked,
    described,
    is_even,
    name_of,
    restored,
    slabs,
    stack_of,
    step_of,
    view_names,
)
from napari_phase4d.io.lazy import in_one_line
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.tiff import TIFF_SUFFIXES, check_described
from napari_phase4d.io.video import (
    check_fits,
    quiet,
)
from napari_phase4d.io.zarr_results import (
    check_own_or_none,
    read_zarr_result,
    write_zarr_result,
    zarr_description,
)
from napari_phase4d.later import pd, tifffile, xr
from napari_phase4d.stacks import (
    AXES,
    in_units,
    with_coordinates,
    with_light,
)
from napari_phase4d.task import UNWATCHED, CancelledCall, ProgressCall, Task
from napari_phase4d.words import (
    checked_call,
    local_path,
)

__all__ = [
    "is_result",
    "read_results",
    "read_tiff_result",
    "result_attrs",
    "tiff_description",
    "write_phase",
    "write_table",
    "write_tiff_result",
]

#: Pixels up to this size leave room for the directory in a file whose places are 32 bits wide.
CLASSIC_BYTES = 2**32 - 2**27
#: Numbers that an OME-TIFF can hold.
OME_TYPES = tuple(
    np.dtype(name)
    for name in (
        "bool", "int8", "int16", "int32", "uint8", "uint16", "uint32", "float32", "float64",
        "complex64", "complex128",
    )
)  # fmt: skip
#: Ids of files are made from what is noted in them, so that the same run gives the same bytes.
NAMESPACE = uuid.uuid5(uuid.NAMESPACE_OID, PROGRAM)


def write_tiff_result(
    path: Path,
    stack: xr.DataArray,
    task: Task = UNWATCHED,
) -> None:
    """Write a stack (time, angle, y, x) as OME-TIFF, some frames at a time."""
    metadata = ome_metadata(stack)
    with (
        written_whole(path) as temporary,
        closing(slabs(stack, task)) as parts,
    ):
        tifffile.imwrite(
            temporary,
            (frame for _, values in parts for frame in values.reshape(-1, *values.shape[2:])),
            shape=stack.shape,
            dtype=stack.dtype,
            ome=True,
            bigtiff=stack.nbytes > CLASSIC_BYTES,
            photometric="minisblack",
            metadata=metadata,
        )


def ome_metadata(stack: xr.DataArray) -> dict[str, Any]:
    """Return what OME can say of a stack, and in its description what it can't."""
    times = np.asarray(stack["time"].values, dtype=np.float64)
    n_angles = stack.sizes["angle"]
    description = json.dumps(described(stack))
    metadata: dict[str, Any] = {
        "axes": "TCYX",
        "UUID": str(uuid.uuid5(NAMESPACE, f"{stack.shape} {stack.dtype} {description}")),
        # The description has the whole name; tifffile before 2026.2.24 doesn't escape quotes here.
        "Name": name_of(stack).replace('"', "'"),
        "Channel": {"Name": view_names(stack)},
        "PhysicalSizeX": step_of(stack["x"].values),
        "PhysicalSizeXUnit": "µm",
        "PhysicalSizeY": step_of(stack["y"].values),
        "PhysicalSizeYUnit": "µm",
        "TimeIncrement": step_of(times),
        "TimeIncrementUnit": "s",
        "Description": description,
    }
    if not is_even(times):
        metadata["Plane"] = {
            "DeltaT": [float(t) for t in np.repeat(times, n_angles)],
            "DeltaTUnit": ["s"] * (len(times) * n_angles),
        }
    return metadata


def read_tiff_result(path: Path) -> xr.DataArray:
    """Read a stack that `write_tiff_result` wrote.

    Raises
    ------
    OSError
        If the file is missing, damaged, or was not written by this program.
    """
    try:
        with quiet(), tifffile.TiffFile(path) as tif:
            description = description_of(tif)
            if description is None:
                msg = f"{path.name} holds no phase written by napari-phase4d"
                raise OSError(msg)
            check_described(tif, path)
            check_size(tif, description, path)
            return stack_of(description, tif.asarray())
    except OSError:
        raise
    except Exception as error:  # tifffile raises what it likes for damaged files
        msg = f"{path.name} can't be read; it may be cut short or damaged ({in_one_line(error)})"
        raise OSError(msg) from error


def check_size(tif: tifffile.TiffFile, description: dict[str, Any], path: Path) -> None:
    """Raise OSError if the pixels are not those described; nothing of them is read."""
    wanted = tuple(len(places) for places in description["coords"].values())
    series = tif.series[0]
    if int(np.prod(series.shape, dtype=object)) != int(np.prod(wanted, dtype=object)):
        msg = f"{path.name} is damaged: it has {series.shape} pixels, but notes {wanted}"
        raise OSError(msg)
    size = path.stat().st_size
    needed = 0 if series.dataoffset is None else series.dataoffset + series.nbytes
    if needed > size:
        msg = f"{path.name} is cut short: its frames need {needed} bytes, the file has {size}"
        raise OSError(msg)
    check_fits(series.nbytes, path.name)


def tiff_description(path: str | Path) -> dict[str, Any] | None:
    """Return what `write_tiff_result` noted in a file, or None if it did not write it."""
    try:
        with quiet(), tifffile.TiffFile(path) as tif:
            return description_of(tif)
    except Exception:  # of a damaged file, which whoever reads it will tell
        return None


def description_of(tif: tifffile.TiffFile) -> dict[str, Any] | None:
    """Return what `write_tiff_result` noted in an open file."""
    if not tif.is_ome or PROGRAM not in (tif.ome_metadata or ""):
        return None
    try:
        image = tifffile.xml2dict(tif.ome_metadata)["OME"]["Image"]
        return checked(json.loads(str(image.get("Description", ""))))
    except (ValueError, KeyError, TypeError, AttributeError, SyntaxError):
        return None


# ---- results of any form --------------------------------------------------------------------


#: What the name of an OME-Zarr ends with.
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
        ``.ome.zarr``, gives a folder in OME-Zarr 0.5 (Zarr 3, one chunk a frame, compressed); one
        that ends with ``.tif`` or ``.tiff``, by custom ``.ome.tif``, an OME-TIFF (BigTIFF beyond
        4 GB).
    stack : xarray.DataArray
        Dims (time, angle, y, x), backed by NumPy or dask.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Returns
    -------
    Path
        The file or folder, which `read_results` reads.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was. So is a folder
        that holds anything which this function has not written.
    TypeError, ValueError
        If the stack has other dims, no pixels, places that are no numbers, or numbers that such a
        file can't hold.
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
    stack = stack.transpose(*AXES)
    plain = all(stack[axis].dtype.kind in "iuf" for axis in AXES)
    stack = in_units(stack, "the stack") if plain else with_coordinates(stack, "the stack")
    stack = with_light(stack, "the stack")
    task = Task(progress, cancelled)
    if path.suffix.lower() == ZARR_SUFFIX:
        check_own_or_none(path)
        write_zarr_result(path, stack, task)
    elif path.suffix.lower() not in TIFF_SUFFIXES:
        msg = f"{path.name} must end with .ome.tif or .ome.zarr"
        raise ValueError(msg)
    else:
        if stack.dtype.newbyteorder("=") not in OME_TYPES:
            msg = (
                f"an OME-TIFF can't hold numbers of {stack.dtype}; give them as float32, as "
                'stack.astype("float32") does, or write a .ome.zarr'
            )
            raise TypeError(msg)
        write_tiff_result(path, stack, task)
    return path


def read_results(path: str | Path) -> xr.DataArray:
    """Read a stack that `write_phase` wrote: same numbers, coordinates and attributes.

    The numbers of an OME-Zarr stay on disk, as a dask array of one frame a chunk, and are read
    when they are used.

    Parameters
    ----------
    path : str or Path
        A file or folder that `write_phase` wrote.

    Returns
    -------
    xarray.DataArray
        Dims (time, angle, y, x), in seconds, degrees and micrometres.

    Raises
    ------
    OSError
        If the file is missing, damaged, or was not written by this program.

    See Also
    --------
    write_phase : Writes it, with an example.
    """
    path = local_path(path)
    if not path.exists():
        msg = f"there is no file or folder {path}"
        raise FileNotFoundError(msg)
    return read_zarr_result(path) if path.is_dir() else read_tiff_result(path)


def is_result(path: str | Path) -> bool:
    """Say whether a file or folder was written by `write_phase`."""
    return result_attrs(path) is not None


def result_attrs(path: str | Path) -> dict[str, Any] | None:
    """Return the attributes of what `write_phase` wrote to a file here, None for any other."""
    if address_of(path) is not None:
        return None
    path = local_path(path)
    if path.exists() and not (path.is_dir() or path.is_file()):  # a pipe would be waited for
        return None
    description = zarr_description(path) if path.is_dir() else tiff_description(path)
    return None if description is None else dict(restored(description.get("attrs", {})))


def as_table_file(path: str | Path) -> Path:
    """Return the name that a table is written under."""
    path = local_path(path)
    if path.suffix.lower() not in ("", ".csv"):
        msg = f"a table is written as .csv, but the name is {path.name}"
        raise ValueError(msg)
    return path if path.suffix else path.with_suffix(".csv")


@checked_call
def write_table(path: str | Path, table: pd.DataFrame) -> Path:
    """Write a table as CSV and return its path, which gets the ending .csv if it has none.

    Parameters
    ----------
    path : str or Path
        File to write; an older one of that name is replaced.
    table : pandas.DataFrame
        Its index is written too, in front of the columns.

    Returns
    -------
    Path
        The file that was written.

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


# ---- wrapped phase of any program -----------------------------------------------------------
