"""The wavelength of each view of a stack: where it is noted, and what it must be."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.axes import WAVELENGTH
from napari_phase4d.stacks.coordinates import factor_to, some
from napari_phase4d.words import as_numbers, check_number

__all__ = [
    "check_light",
    "same_light",
    "views_in_order",
    "wavelength_coordinate",
    "wavelengths_of",
    "with_light",
]

#: Wavelengths that differ by less than this share are the same.
SAME = 1e-6


def wavelengths_of(stack: xr.DataArray | xr.Dataset) -> NDArray[np.float64] | None:
    """Return the wavelength of each view in micrometres, None where the stack does not note it.

    It is the coordinate "wavelength" along the angle, where views differ in it; else
    ``attrs["wavelength_um"]``, which holds for all of them.

    Parameters
    ----------
    stack : DataArray or Dataset
        Dims among (time, angle, y, x).

    Examples
    --------
    >>> two = xr.DataArray(np.zeros((2, 4, 4)), dims=("angle", "y", "x"))
    >>> two.attrs["wavelength_um"] = 0.6328
    >>> wavelengths_of(two)
    array([0.6328, 0.6328])
    """
    n_views = stack.sizes.get("angle", 1)
    if WAVELENGTH in stack.coords:
        given = np.asarray(stack.coords[WAVELENGTH].values, dtype=np.float64)
        return np.broadcast_to(given, n_views).copy()
    noted = stack.attrs.get("wavelength_um")
    if noted is None:
        return None
    number = check_number('attrs["wavelength_um"] of the phase', noted)
    return np.full(n_views, float(number))


def wavelength_coordinate(
    wavelengths_um: NDArray[np.float64],
) -> tuple[str, NDArray[np.float64], dict[str, str]]:
    """Return the wavelengths of all views as xarray takes them.

    Parameters
    ----------
    wavelengths_um : ndarray of shape (view,)
        In micrometres.
    """
    return "angle", wavelengths_um, {"units": "um"}


def with_light(stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return a stack whose coordinate "wavelength", if it has one, is in micrometres.

    Parameters
    ----------
    stack : DataArray
        Dims among (time, angle, y, x).
    name : str
        What to call it.

    Raises
    ------
    TypeError, ValueError
        If it lies along another axis, holds no lengths above 0, or two views have the same angle
        and wavelength.
    """
    if WAVELENGTH not in stack.coords:
        return stack
    given = stack.coords[WAVELENGTH]
    if given.dims not in ((), ("angle",)):
        msg = (
            f"the wavelengths of {name} lie along {', '.join(map(str, given.dims))}; give one for "
            'each view, along "angle"'
        )
        raise ValueError(msg)
    units = str(given.attrs.get("units") or "um")
    factor = factor_to(units, "um")
    if factor is None:
        msg = f"the wavelengths of {name} are in {units!r}; give them in micrometres"
        raise ValueError(msg)
    numbers = as_numbers(f"the wavelengths of {name}", given.values).astype(np.float64)
    if not (np.isfinite(numbers).all() and (numbers > 0).all()):
        msg = f"the wavelengths of {name} must be numbers above 0, but are {given.values.tolist()}"
        raise ValueError(msg)
    if factor != 1 or units != "um" or given.dtype != np.float64:
        attrs = {**given.attrs, "units": "um"}
        stack = stack.assign_coords({WAVELENGTH: (given.dims, numbers * factor, attrs)})
    check_views(stack, name)
    return stack


def check_views(stack: xr.DataArray, name: str) -> None:
    """Refuse two views of the same angle and wavelength."""
    if "angle" not in stack.dims or "angle" not in stack.coords:
        return
    order = views_in_order(stack)
    angles = np.asarray(stack["angle"].values, dtype=np.float64)[order]
    light = wavelengths_of(stack)
    twice = np.diff(angles) == 0
    if light is not None and (twice & (np.diff(light[order]) < SAME * light.max())).any():
        msg = (
            f"two views of {name} have the same angle and wavelength; leave one of them out, or "
            "correct them"
        )
        raise ValueError(msg)


def views_in_order(stack: xr.DataArray) -> NDArray[np.intp]:
    """Return the numbers of a stack's views by rising angle, then by rising wavelength."""
    angles = np.asarray(stack["angle"].values)
    if WAVELENGTH not in stack.coords:
        return np.argsort(angles)
    light = np.broadcast_to(stack.coords[WAVELENGTH].values, angles.shape)
    return np.lexsort((light, angles))


def same_light(one: xr.DataArray, other: xr.DataArray) -> bool:
    """Say whether the views of two stacks have the same wavelengths, as far as both note them."""
    if not (WAVELENGTH in one.coords and WAVELENGTH in other.coords):
        return True
    a, b = (np.asarray(s.coords[WAVELENGTH].values, np.float64) for s in (one, other))
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=SAME, atol=0))


def check_light(given: xr.DataArray, wanted: xr.DataArray, name: str) -> None:
    """Refuse a stack whose views, in the same order, have other wavelengths than the phase."""
    if not same_light(given, wanted):
        own, theirs = (np.atleast_1d(s.coords[WAVELENGTH].values) for s in (given, wanted))
        msg = (
            f"{name} has other wavelengths ({some(own)} um) than the phase ({some(theirs)} um); "
            "take the same views of both"
        )
        raise ValueError(msg)
