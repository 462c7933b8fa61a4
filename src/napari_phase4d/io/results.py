"""Results that travel: 4-D phase as OME-TIFF, tables as CSV."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tifffile
import xarray as xr

from napari_phase4d.io.atomic import written_whole

__all__ = ["read_results", "write_phase", "write_table"]

AXES = ("time", "angle", "y", "x")
#: Marks the description of a file that this program wrote.
SIGNATURE = "napari-phase4d"


def write_phase(path: str | Path, stack: xr.DataArray) -> Path:
    """Write a 4-D stack as OME-TIFF with pixel size, times, angles and provenance.

    The viewing angles lie on the channel axis, which OME has no better name for; they are also
    in the file's description together with the times and attributes, from where
    `read_results` restores them exactly.

    Parameters
    ----------
    path : str or Path
        File to write, by custom ``.ome.tif``; replaced if it exists.
    stack : xarray.DataArray
        Dims (time, angle, y, x).

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    TypeError
        If the stack has other dims.
    """
    path = Path(path)
    if not isinstance(stack, xr.DataArray) or set(stack.dims) != set(AXES):
        msg = "only a DataArray with dims time, angle, y and x can be written as OME-TIFF"
        raise TypeError(msg)
    stack = stack.transpose(*AXES)
    description = {
        "program": SIGNATURE,
        "name": "phase" if stack.name is None else str(stack.name),
        "coords": {d: [float(v) for v in stack[d].values] for d in AXES},
        "units": {d: str(stack[d].attrs["units"]) for d in AXES if "units" in stack[d].attrs},
        "attrs": json_able(stack.attrs),
    }
    angles = stack["angle"].values
    times = stack["time"].values
    metadata: dict[str, Any] = {
        "axes": "TCYX",
        "Channel": {"Name": [f"view {a:g} deg" for a in angles]},
        "PhysicalSizeX": step_of(stack["x"].values),
        "PhysicalSizeXUnit": "µm",
        "PhysicalSizeY": step_of(stack["y"].values),
        "PhysicalSizeYUnit": "µm",
        "TimeIncrement": step_of(times),
        "TimeIncrementUnit": "s",
        "Description": json.dumps(description),
    }
    data = np.ascontiguousarray(stack.values)
    with written_whole(path) as temporary:
        tifffile.imwrite(temporary, data, ome=True, photometric="minisblack", metadata=metadata)
    return path


def read_results(path: str | Path) -> xr.DataArray:
    """Read a stack that `write_phase` wrote: same numbers, coordinates and attributes.

    Raises
    ------
    OSError
        If the file is missing, damaged, or was not written by this program.
    """
    path = Path(path)
    try:
        with tifffile.TiffFile(path) as tif:
            description = result_description(tif)
            if description is None:
                msg = f"{path.name} holds no phase written by napari-phase4d"
                raise OSError(msg)
            data = tif.asarray()
    except (tifffile.TiffFileError, struct.error, ValueError, KeyError) as error:
        msg = f"{path.name} can't be read; it may be cut short or damaged ({error})"
        raise OSError(msg) from error
    units = description.get("units", {})
    coords = {
        name: (name, np.asarray(values), {"units": units[name]} if name in units else {})
        for name, values in description["coords"].items()
    }
    shape = tuple(len(values) for values in description["coords"].values())
    return xr.DataArray(
        data.reshape(shape),
        dims=tuple(coords),
        coords=coords,
        name=description["name"],
        attrs=description["attrs"],
    )


def is_result(path: str | Path) -> bool:
    """Say whether a file was written by `write_phase`."""
    return result_attrs(path) is not None


def result_attrs(path: str | Path) -> dict[str, Any] | None:
    """Return the attributes of what `write_phase` wrote to a file, None for any other file."""
    try:
        with tifffile.TiffFile(path) as tif:
            description = result_description(tif)
    except (OSError, struct.error, tifffile.TiffFileError):
        return None
    return None if description is None else dict(description["attrs"])


def result_description(tif: tifffile.TiffFile) -> dict[str, Any] | None:
    """Return what `write_phase` noted in a file, or None if it did not write it."""
    if not tif.is_ome or SIGNATURE not in (tif.ome_metadata or ""):
        return None
    image = tifffile.xml2dict(tif.ome_metadata)["OME"]["Image"]
    try:
        found = json.loads(str(image.get("Description", "")))
    except ValueError:
        return None
    return found if isinstance(found, dict) and found.get("program") == SIGNATURE else None


def write_table(path: str | Path, table: pd.DataFrame) -> Path:
    """Write a table as CSV.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    """
    path = Path(path)
    with written_whole(path) as temporary:
        table.to_csv(temporary)
    return path


def step_of(coordinates: Any) -> float:
    """Return the spacing of evenly spaced coordinates (1 where there is only one)."""
    return float(coordinates[1] - coordinates[0]) if len(coordinates) > 1 else 1.0


def json_able(value: Any) -> Any:
    """Return a copy that JSON can hold."""
    if isinstance(value, dict):
        return {str(k): json_able(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_able(v) for v in value]
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)
