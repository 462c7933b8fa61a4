"""The axes of a stack and the coordinates along them: names, numbers, units, order, spacing."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.warned import warn

__all__ = [
    "AXES",
    "PLAIN_AXES",
    "SINCE",
    "UNITS",
    "WAVELENGTH",
    "check_pixel",
    "check_rising",
    "coordinate",
    "doubt_numbers",
    "factor_to",
    "in_full",
    "in_units",
    "on_the_clock_of",
    "pixel_um",
    "plain",
    "same_places",
    "scaled_like",
    "some",
    "spacing",
    "times_in_s",
    "with_coordinates",
]

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


# ---- numbers and units along an axis ----------------------------------------------------------


#: Under this name times note the date that they are counted from.
SINCE = "since"
#: The base unit of all angles; pint counts it as a pure number, as percent and counts are.
ANGLE = "radian"
#: Units as pint calls them -> how they are mostly written.
SHORT = MappingProxyType({"micrometer": "um", "degree": "deg", "second": "s", "radian": "rad"})
#: What is said to be a unit of length by pint, but is none that a microscope has.
PIXELS = ("px", "pixel", "pixels")


#: No name of a unit is longer.
LONGEST_UNIT = 24


@cache
def registry() -> Any:
    """Return all units that are known; loaded when first asked for, which takes a second."""
    import pint

    return pint.UnitRegistry()


@cache
def factor_to(units: str, wanted: str) -> float | None:
    """Return what numbers in some units are multiplied by, None if the units are of other things.

    Parameters
    ----------
    units : str
        As somebody wrote them: "nm", "ms", "degree".
    wanted : str
        "um", "s", "deg" or "rad".

    Examples
    --------
    >>> factor_to("nm", "um"), factor_to("s", "um")
    (0.001, None)
    """
    written = units.strip()
    if written == wanted:
        return 1.0
    # A file may say anything, which pint would compute: no powers, no long sums.
    if len(written) > LONGEST_UNIT or "*" in written or "^" in written:
        return None
    if written.casefold() in PIXELS:
        return None
    try:
        one = registry().Quantity(1.0, registry().Unit(written))
        target = registry().Unit(wanted)
        if is_angle(one.units) != is_angle(target):
            return None
        return float(f"{one.to(target).magnitude:.15g}")
    except Exception:  # pint raises its own, AttributeError, TypeError or those of its parser
        return None


def is_angle(unit: Any) -> bool:
    """Say whether a unit is one of angles, and no other pure number."""
    return str(registry().get_root_units(unit)[1]) == ANGLE


#: Share of a pixel by which the spacing may vary, as it does where float32 holds it.
UNEVEN = 0.01
#: Pixels in the sample that no light resolves, or no microscope has: those are in other units.
NO_PIXEL_UM, SMALL_PIXEL_UM, LARGE_PIXEL_UM = 1e-5, 1e-3, 50.0
#: The unit of each axis, in words.
IN_WORDS = {"time": "seconds", "angle": "degrees", "y": "micrometres", "x": "micrometres"}


def with_coordinates(stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return a stack whose coordinates are finite, different numbers in the usual units.

    Places along y and x are even as well. What is not so is refused.
    """
    for axis in UNITS:
        if axis not in stack.coords:
            continue
        if axis not in stack.dims and stack.coords[axis].ndim == 0:
            stack = with_place(stack, axis, name)
        if axis not in stack.dims:
            continue
        given = stack.coords[axis]
        places = in_usual_units(given, axis, name)
        check_places(places, axis, name, twice=axis == "angle" and WAVELENGTH in stack.coords)
        noted = given.attrs.get("units")
        # Where no unit is noted none is added: the numbers may be those of pixels.
        if given.dtype.kind in "mM" or (noted and noted != UNITS[axis]):
            units = {**given.attrs, "units": UNITS[axis]}
            if given.dtype.kind == "M":
                units[SINCE] = str(given.values[0])
            stack = stack.assign_coords({axis: (axis, places, units)})
    return stack


def on_the_clock_of(given: xr.DataArray, wanted: xr.DataArray) -> NDArray[Any]:
    """Return times of one stack as another counts them, where both have noted their dates."""
    own, theirs = (times.attrs.get(SINCE) for times in (given, wanted))
    if own is None or theirs is None or own == theirs:
        return given.values
    apart = np.datetime64(own) - np.datetime64(theirs)
    return given.values + apart / np.timedelta64(1, "s")


def in_units(stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return a stack with coordinates in the usual units, where they note others."""
    for axis in UNITS:
        given = stack.coords.get(axis)
        if given is None or given.attrs.get("units", UNITS[axis]) == UNITS[axis]:
            continue
        places = in_usual_units(given, axis, name)
        units = {**given.attrs, "units": UNITS[axis]}
        stack = stack.assign_coords({axis: (given.dims, places, units)})
    return stack


def with_place(stack: xr.DataArray, axis: str, name: str) -> xr.DataArray:
    """Return a stack of one time, or one angle, whose place is in the usual unit."""
    given = stack.coords[axis]
    if axis == "time" and given.dtype.kind in "mM":
        # A date by itself: there is nothing that it could be counted from.
        return stack.drop_vars(axis).assign_coords({axis: 0.0})
    place = float(in_usual_units(given, axis, name))
    if not np.isfinite(place):
        msg = f"the {axis} of {name} is {place}; give {IN_WORDS[axis]}"
        raise ValueError(msg)
    return stack.assign_coords({axis: ((), place, {**given.attrs, "units": UNITS[axis]})})


def in_usual_units(given: xr.DataArray, axis: str, name: str) -> NDArray[Any]:
    """Return the places along an axis in seconds, degrees or micrometres."""
    places = given.values
    if axis == "time" and places.dtype.kind in "mM":
        return times_in_s(places)
    if places.dtype.kind not in "iuf":
        msg = (
            f"the {axis} coordinates of {name} are {places.dtype}, no numbers; give them in "
            f"{IN_WORDS[axis]}"
        )
        raise TypeError(msg)
    units = given.attrs.get("units") or UNITS[axis]
    factor = factor_to(str(units), UNITS[axis])
    if factor is None:
        msg = (
            f"the {axis} coordinates of {name} are in {str(units)!r}; give them in "
            f'{IN_WORDS[axis]}, with attrs["units"] = "{UNITS[axis]}"'
        )
        raise ValueError(msg)
    return places if factor == 1 else places * factor


def times_in_s(times: NDArray[Any]) -> NDArray[np.float64]:
    """Return times in seconds; dates count from the first one, NaT is NaN."""
    if times.dtype.kind in "mM":
        since = times - times[0] if times.dtype.kind == "M" else times
        return np.asarray(since / np.timedelta64(1, "s"), dtype=np.float64)
    return np.asarray(times, dtype=np.float64)


def check_places(places: NDArray[Any], axis: str, name: str, *, twice: bool = False) -> None:
    """Refuse places that are not finite, there twice where they must not, or uneven in y or x."""
    bad = int(np.count_nonzero(~np.isfinite(places)))
    if bad:
        msg = (
            f"{bad} of {len(places)} {axis} coordinates of {name} are NaN or infinite; give them "
            f"in {IN_WORDS[axis]}, or take them off with drop_vars({axis!r})"
        )
        raise ValueError(msg)
    if not twice and len(np.unique(places)) < len(places):
        msg = (
            f"two {axis} coordinates of {name} are the same; leave one of them out with "
            f"drop_duplicates({axis!r}), or correct them"
        )
        raise ValueError(msg)
    if axis in ("y", "x") and not is_even(places):
        msg = (
            f"the {axis} coordinates of {name} are not evenly spaced; put the stack on an even "
            f"grid, as with interp({axis}=...)"
        )
        raise ValueError(msg)


def plain(values: Any, name: str) -> Any:
    """Return an array of what was given, lazy ones as they are; ValueError if it is none."""
    if hasattr(values, "dask") and hasattr(values, "chunks"):
        return values
    try:
        return np.asarray(values)
    except ValueError as error:
        msg = f"{name} is no array: its rows differ in length"
        raise ValueError(msg) from error
    except Exception as error:  # whatever another package says of its own arrays
        msg = f"{name} can't be read as an array: {error}"
        raise ValueError(msg) from error


def is_even(places: NDArray[Any]) -> bool:
    """Say whether places rise or fall evenly."""
    steps = np.diff(np.asarray(places, dtype=np.float64))
    return len(steps) < 2 or bool(np.ptp(steps) <= UNEVEN * abs(float(np.mean(steps))))


def check_rising(stack: xr.DataArray, name: str) -> None:
    """Refuse times and angles that do not rise, where frames are told by their numbers."""
    for axis in ("time", "angle"):
        if axis not in stack.dims or axis not in stack.coords:
            continue
        places = np.asarray(stack.coords[axis].values, dtype=np.float64)
        steps = np.diff(places)
        keys: str | list[str] = axis
        light = stack.coords.get(WAVELENGTH)
        if axis == "angle" and light is not None and light.ndim:
            # Views of one angle follow each other by their wavelengths.
            check_light_rises(places, np.asarray(light.values, dtype=np.float64), name)
            steps, keys = steps[steps != 0], [axis, WAVELENGTH]
        if (steps <= 0).any():
            msg = (
                f"the {axis} coordinates of {name} do not rise ({some(places)}), so neighbours "
                f"are none; sort it with its data, as with sortby({keys!r})"
            )
            raise ValueError(msg)


def check_light_rises(angles: NDArray[Any], light: NDArray[Any], name: str) -> None:
    """Refuse views that follow a view of the same angle, but of a longer wavelength.

    Parameters
    ----------
    angles, light : ndarray of shape (view,)
        Angle in degrees and wavelength in micrometres.
    name : str
        What to call the stack.
    """
    falls = np.flatnonzero((np.diff(angles) == 0) & (np.diff(light) <= 0))
    if len(falls):
        first = falls[0]
        msg = (
            f"the wavelengths of {name} do not rise at the angle {angles[first]:g} "
            f"({light[first]:g} um, then {light[first + 1]:g} um); sort its views by both, as "
            "with sortby(['angle', 'wavelength'])"
        )
        raise ValueError(msg)


def some(places: NDArray[Any]) -> str:
    """Return the first numbers of an axis as they are said."""
    shown = ", ".join(f"{p:g}" for p in places[:3])
    return f"{shown}, ..." if len(places) > 3 else shown


def same_places(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Say whether two stacks have the same places along an axis, but for rounding."""
    if len(one) != len(other):
        return False
    a, b = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    rounding = 1e-6 * float(np.abs(a).max(initial=0))  # of single precision
    if len(a) > 1:
        steps = np.abs(np.diff(a))
        apart = float(np.min(steps[steps > 0], initial=np.inf))
        if not np.isfinite(apart):
            apart = 0.0
        rounding = max(UNEVEN * apart, min(rounding, 0.4 * apart))
    return bool(np.all(np.abs(a - b) <= max(rounding, 1e-9)))


def pixel_um(stack: xr.DataArray, name: str) -> tuple[float, float]:
    """Return the height and width of a pixel in micrometres, from the coordinates.

    Raises
    ------
    ValueError
        If they have no spacing, or one that light can't resolve.
    """
    height, width = (spacing(stack, axis, name) for axis in ("y", "x"))
    check_pixel(height, width, name)
    doubt_numbers(stack, name)
    return height, width


def check_pixel(height: float, width: float, name: str) -> None:
    """Refuse a pixel that no light resolves; warn of one that is probably in another unit."""
    said = f"a pixel of {name} is {height:.4g} x {width:.4g} um wide"
    advice = 'say the unit along both axes, as in stack["x"].attrs["units"] = '
    if min(height, width) < NO_PIXEL_UM:
        msg = f'{said}, which no light resolves; if that is in metres, {advice}"m"'
        raise ValueError(msg)
    if min(height, width) < SMALL_PIXEL_UM:
        warn(f'{said}, which is very small; if that is in millimetres, {advice}"mm"')
    if max(height, width) > LARGE_PIXEL_UM:
        warn(f'{said}, which is very large; if that is in nanometres, {advice}"nm"')


def doubt_numbers(stack: xr.DataArray, name: str) -> None:
    """Warn of coordinates without a unit that are probably the numbers of pixels."""
    for axis in ("y", "x"):
        if axis not in stack.coords or stack[axis].ndim != 1 or stack[axis].attrs.get("units"):
            continue
        places = stack[axis].values
        if len(places) > 2 and places.dtype.kind in "iuf" and (np.diff(places) == 1).all():
            warn(
                f"the {axis} coordinates of {name} are {some(places)} without a unit, as numbers "
                "of pixels are, and count as micrometres; give them times the pixel, or note that "
                f'they are in micrometres: stack["{axis}"].attrs["units"] = "um"'
            )
            return


def spacing(stack: xr.DataArray, axis: str, name: str) -> float:
    """Return the spacing along y or x in micrometres, or say that there is none."""
    places = np.asarray(stack[axis].values, dtype=np.float64)
    # A single coordinate has no spacing; any guess would be a wrong area.
    step = float(np.abs(np.diff(places[:2])).sum())
    if not (math.isfinite(step) and step > 0):
        msg = (
            f"the pixel size of {name} can't be told: {axis} has no spacing; give it in "
            "micrometres"
        )
        raise ValueError(msg)
    return step


def scaled_like(stack: xr.DataArray, phase: xr.DataArray) -> xr.DataArray:
    """Return a stack with the times, places and light of the phase; itself, if it has them."""
    others = {
        name: place
        for name, place in phase.coords.items()
        if name in stack.coords and not place.equals(stack[name])
    }
    light = {
        name: phase.attrs[name]
        for name in ("wavelength_um", "medium_index")
        if name in phase.attrs and name in stack.attrs and phase.attrs[name] != stack.attrs[name]
    }
    return stack.assign_coords(others).assign_attrs(light) if others or light else stack
