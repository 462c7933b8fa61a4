"""4-D phase as OME-TIFF."""

from __future__ import annotations

import json
import uuid
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import xarray as xr

from napari_phase4d.io.atomic import written_whole
from napari_phase4d.io.describing import (
    PROGRAM,
    checked,
    described,
    is_even,
    name_of,
    slabs,
    stack_of,
    step_of,
    view_names,
)
from napari_phase4d.io.lazy import in_one_line
from napari_phase4d.io.tiff import check_described
from napari_phase4d.io.video import check_fits, quiet
from napari_phase4d.task import UNWATCHED, Task

__all__ = ["read_tiff_result", "tiff_description", "write_tiff_result"]

#: Pixels up to this size leave room for the directory in a file whose places are 32 bits wide.
CLASSIC_BYTES = 2**32 - 2**27
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
