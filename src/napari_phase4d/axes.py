"""The axes of a stack: their names, their units, and which of them plain arrays have."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

__all__ = ["AXES", "PLAIN_AXES", "UNITS", "WAVELENGTH", "coordinate", "in_full"]

V = TypeVar("V")

AXES = ("time", "angle", "y", "x")
SOME = slice(None)
#: Unit of the coordinates of each axis.
UNITS: Mapping[str, str] = MappingProxyType({"time": "s", "angle": "deg", "y": "um", "x": "um"})
#: Coordinate along the angle, in micrometres, of a stack whose views differ in wavelength. Views
#: of one angle then follow each other by rising wavelength.
WAVELENGTH = "wavelength"
#: Axes of plain arrays by their number of dimensions.
PLAIN_AXES: Mapping[int, tuple[str, ...]] = MappingProxyType(
    {2: ("y", "x"), 3: ("time", "y", "x"), 4: AXES}
)


def coordinate(axis: str, places: V) -> tuple[str, V, dict[str, str]]:
    """Return the places along an axis, with their unit, as xarray takes them."""
    return axis, places, {"units": UNITS[axis]}


def in_full(stack: xr.DataArray) -> NDArray[Any]:
    """Return the values with all four axes (time, angle, y, x); a view."""
    # By array operations, which take microseconds.
    dims = stack.dims
    ordered = stack.values.transpose([dims.index(axis) for axis in AXES if axis in dims])
    values: NDArray[Any] = ordered[tuple(SOME if axis in dims else None for axis in AXES)]
    return values
