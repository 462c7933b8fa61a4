"""What is noted in the file of a stack, so that it can be read back as it was, and its parts."""

from __future__ import annotations

import math
import sys
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.atomic import UnreadableError
from napari_phase4d.later import xr
from napari_phase4d.stacks import AXES, WAVELENGTH, wavelength_coordinate, wavelengths_of
from napari_phase4d.task import THREADS, UNWATCHED, Task, Watch
from napari_phase4d.words import views_are_numbered

__all__ = [
    "OME_TIFF",
    "OME_ZARR",
    "PROGRAM",
    "checked",
    "described",
    "is_even",
    "name_of",
    "restored",
    "slabs",
    "stack_of",
    "step_of",
    "view_names",
]

#: Marks the description of a file that this program wrote.
PROGRAM = "napari-phase4d"
#: What the names of stacks end with, by custom.
OME_TIFF, OME_ZARR = ".ome.tif", ".ome.zarr"
#: Stands for a number that JSON has no sign for.
NOT_FINITE = "not finite"
#: The largest number of float64; JSON knows larger whole ones.
LARGEST = sys.float_info.max


def described(stack: xr.DataArray) -> dict[str, Any]:
    """Return the name, coordinates, units and attributes of a stack, as JSON can hold them."""
    found = {
        "program": PROGRAM,
        "name": name_of(stack),
        "coords": {d: [float(v) for v in stack[d].values] for d in AXES},
        "units": {d: str(stack[d].attrs["units"]) for d in AXES if "units" in stack[d].attrs},
        "attrs": json_able(stack.attrs),
    }
    light = wavelengths_of(stack)
    if light is not None and WAVELENGTH in stack.coords:
        found["wavelengths_um"] = light.tolist()
    return found


def view_names(stack: xr.DataArray) -> list[str]:
    """Return what other programs call the views of a stack: their angles, and wavelengths.

    Where nobody has given angles they are numbered from 1, as on screen.
    """
    angles = stack["angle"].values.tolist()
    numbered = views_are_numbered(angles)
    names = [f"view {n}" if numbered else f"view {a:g} deg" for n, a in enumerate(angles, 1)]
    light = wavelengths_of(stack)
    if light is None or WAVELENGTH not in stack.coords:
        return names
    return [f"{name}, {1000 * own:g} nm" for name, own in zip(names, light, strict=True)]


def name_of(stack: xr.DataArray) -> str:
    """Return the name of a stack, "phase" for one that has none."""
    return "phase" if stack.name is None else str(stack.name)


def checked(found: Any) -> dict[str, Any] | None:
    """Return a description if this program could have written it, else None."""
    if not isinstance(found, dict) or found.get("program") != PROGRAM:
        return None
    coords, attrs, units = (found.get(name, {}) for name in ("coords", "attrs", "units"))
    if not all(isinstance(part, dict) for part in (coords, attrs, units)):
        return None
    if tuple(coords) != AXES or not isinstance(found.get("name"), str):
        return None
    numbers = all(
        isinstance(values, list) and all(is_number(v) for v in values)
        for values in coords.values()
    )
    light = found.get("wavelengths_um", [1.0] * len(coords["angle"]))
    numbers = numbers and isinstance(light, list) and len(light) == len(coords["angle"])
    return found if numbers and all(is_number(v) and v > 0 for v in light) else None


def is_number(value: Any) -> bool:
    """Say whether a value is a number that float64 can hold."""
    return isinstance(value, float) or (isinstance(value, int) and abs(value) <= LARGEST)


def stack_of(description: dict[str, Any], values: Any) -> xr.DataArray:
    """Return the stack that was described, with these values, NumPy or dask.

    Raises
    ------
    ValueError
        If the values have another shape.
    """
    units = description.get("units", {})
    coords: dict[str, Any] = {
        name: (
            name,
            np.asarray(places, np.float64),
            {"units": units[name]} if name in units else {},
        )
        for name, places in description["coords"].items()
    }
    if "wavelengths_um" in description:
        light = np.asarray(description["wavelengths_um"], np.float64)
        coords[WAVELENGTH] = wavelength_coordinate(light)
    shape = tuple(len(places) for places in description["coords"].values())
    return xr.DataArray(
        values.reshape(shape),
        dims=AXES,
        coords=coords,
        name=description["name"],
        attrs=restored(description.get("attrs", {})),
    )


def step_of(coordinates: NDArray[Any]) -> float:
    """Return the mean spacing of coordinates in either direction, 1 where there is none."""
    if len(coordinates) < 2:
        return 1.0
    steps = np.abs(np.diff(np.asarray(coordinates, dtype=np.float64)))
    step = float(steps[0] if is_even(coordinates) else np.mean(steps))
    return step if step > 0 else 1.0


def is_even(coordinates: NDArray[Any]) -> bool:
    """Say whether coordinates are evenly spaced, give or take their rounding."""
    steps = np.diff(np.asarray(coordinates, dtype=np.float64))
    return len(steps) < 2 or bool(np.ptp(steps) <= 1e-6 * np.abs(steps).max())


def json_able(value: Any) -> Any:
    """Return a copy that JSON can hold, in the strict form that all programs read."""
    if isinstance(value, dict):
        return {str(k): json_able(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_able(v) for v in value]
    if isinstance(value, (np.generic, np.ndarray)):
        return json_able(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return {NOT_FINITE: str(value)}
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)


def restored(value: Any) -> Any:
    """Return what `json_able` was given, with lists for tuples and arrays."""
    if isinstance(value, dict):
        if set(value) == {NOT_FINITE} and value[NOT_FINITE] in ("nan", "inf", "-inf"):
            return float(value[NOT_FINITE])
        return {k: restored(v) for k, v in value.items()}
    return [restored(v) for v in value] if isinstance(value, list) else value


#: Bytes that are computed at a time, unless one chunk of the stack is larger.
SLAB_BYTES = 16 * 2**20


def slabs(
    stack: xr.DataArray,
    task: Task = UNWATCHED,
) -> Generator[tuple[slice, NDArray[Any]], None, None]:
    """Yield the times of each part of a stack and its values, in the order of the times.

    While one part is written, the next one is computed. Close it where it may not come to its end.

    Raises
    ------
    UnreadableError
        If what a lazy stack is computed from can't be read.
    Cancelled
        If ``cancelled()`` returned True.
    """
    parts = parts_of(stack)
    watch = Watch(len(parts), "saving", task)
    watch.check()
    pool = ThreadPoolExecutor(1, THREADS)
    try:
        coming = pool.submit(values_of, stack, parts[0])
        for this, following in zip(parts, [*parts[1:], None], strict=True):
            values = coming.result()
            if following is not None:
                coming = pool.submit(values_of, stack, following)
            yield this, values
            watch.step()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def values_of(stack: xr.DataArray, part: slice) -> NDArray[Any]:
    """Return the values at some times, computed if they are not there yet."""
    try:
        return np.ascontiguousarray(stack.data[part])
    except OSError as error:
        raise UnreadableError(*error.args) from error


def parts_of(stack: xr.DataArray) -> list[slice]:
    """Cut a stack's times into parts; the chunks of a lazy one are never cut."""
    n_times = stack.sizes["time"]
    chunks = stack.chunksizes.get("time", (1,) * n_times)
    frame = max(stack.nbytes // n_times, 1)
    ends, start, end = [0], 0, 0
    for length in chunks:
        if end > start and (end + length - start) * frame > SLAB_BYTES:
            ends.append(end)
            start = end
        end += length
    ends.append(end)
    return [slice(a, b) for a, b in pairwise(ends)]
