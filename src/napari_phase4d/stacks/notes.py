"""What a stack notes of itself: whether it is wrapped or unwrapped, the wavelength of each view.

Where it notes nothing, its numbers tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.stacks.coordinates import WAVELENGTH, factor_to, some
from napari_phase4d.stacks.numbers import (
    BEYOND,
    LARGEST,
    LEAST_PIXELS,
    NEAR,
    VERY_LARGE,
    countable,
    in_a_turn,
    in_most,
    row_length,
    sample_of,
    what_is_wrong,
)
from napari_phase4d.warned import warn
from napari_phase4d.words import as_numbers, check_number

__all__ = [
    "KIND",
    "UNWRAPPED",
    "WRAPPED",
    "check_light",
    "check_unwrapped",
    "check_wrapped",
    "kind_of",
    "refuse_counts",
    "refuse_nothing",
    "same_light",
    "views_in_order",
    "wavelength_coordinate",
    "wavelengths_of",
    "with_light",
]

#: The attribute that notes which of the two phase is.
KIND, WRAPPED, UNWRAPPED = "kind", "wrapped", "unwrapped"


def kind_of(stack: xr.DataArray) -> str:
    """Return "wrapped" or "unwrapped" where a stack notes it, else ""."""
    noted = str(stack.attrs.get(KIND, ""))
    if noted in (WRAPPED, UNWRAPPED):
        return noted
    return UNWRAPPED if "method" in stack.attrs or stack.attrs.get("exact") else ""


def refuse_counts(stack: xr.DataArray, name: str) -> None:
    """Refuse whole numbers without a sign that are no radians of a turn, but counts of light."""
    if stack.dtype.kind != "u":
        return
    largest = int(sample_of(stack).max(initial=0))
    if largest > 2 * np.pi:
        msg = (
            f"{name} is {stack.dtype} up to {largest}, as camera frames are; phase is in radians: "
            "reconstruct() makes it of holograms"
        )
        raise TypeError(msg)


def refuse_nothing(stack: xr.DataArray, name: str) -> None:
    """Refuse a stack of which no number is known."""
    if stack.dtype.kind == "f" and not sample_of(stack).size and not np.isfinite(stack).any():
        msg = f"{name} holds nothing but NaN or infinite numbers"
        raise ValueError(msg)


def check_wrapped(stack: xr.DataArray, name: str, kept: NDArray[np.bool_] | None = None) -> None:
    """Refuse what notes to be unwrapped, and is; warn of what looks like no wrapped phase."""
    known = countable(sample_of(stack, kept))
    refuse_labels(stack, name)
    if kind_of(stack) == UNWRAPPED and not in_a_turn(known):
        by = f" by {stack.attrs['method']}" if stack.attrs.get("method") else ""
        msg = (
            f"{name} is unwrapped already{by}, as it notes; give the wrapped phase, or wrap it "
            "with numpy.angle(numpy.exp(1j * phase))"
        )
        raise ValueError(msg)
    doubt_light(stack, name)
    for doubt in what_is_wrong(known, row_length(stack)):
        if doubt.warning:
            warn(f"{name} {doubt.warning}")


def refuse_labels(stack: xr.DataArray, name: str) -> None:
    """Refuse what notes to be labels of cells."""
    if stack.attrs.get(KIND) == "cells":
        msg = f"{name} holds labels of cells, as it notes; give the unwrapped phase"
        raise ValueError(msg)


def refuse_absurd(stack: xr.DataArray, name: str) -> None:
    """Refuse numbers that are no phase in single precision; of lazy ones some frames are read."""
    values = stack.values if stack.chunks is None else sample_of(stack)
    low, high = float(values.min(initial=0)), float(values.max(initial=0))
    if np.isnan(low) or np.isnan(high) or np.isinf([low, high]).any():
        known = values[np.isfinite(values)]
        low, high = float(known.min(initial=0)), float(known.max(initial=0))
    if max(-low, high) > BEYOND:
        msg = (
            f"{name} runs from {low:.4g} to {high:.4g}, but beyond {BEYOND:g} rad its turns are "
            "lost; set what is not known to NaN"
        )
        raise ValueError(msg)


def check_unwrapped(stack: xr.DataArray, name: str) -> None:
    """Refuse what notes to be wrapped, and is; warn of what looks like no unwrapped phase."""
    refuse_labels(stack, name)
    refuse_absurd(stack, name)
    noted = kind_of(stack)
    if noted == UNWRAPPED:
        return
    known = sample_of(stack)
    if known.size < LEAST_PIXELS:
        return
    low, high = float(known.min()), float(known.max())
    inside = low >= -LARGEST and high <= LARGEST
    fills = inside and low < NEAR - np.pi and np.pi - NEAR < high
    if fills and noted == WRAPPED:
        msg = f"{name} is wrapped, as it notes; unwrap it first, with unwrap()"
        raise ValueError(msg)
    if fills:
        warn(
            f"{name} runs from just -pi to just pi, so it seems to be wrapped; unwrap it first, "
            "with unwrap()"
        )
    elif not in_most(known, -VERY_LARGE, VERY_LARGE):
        warn(
            f"{name} runs from {low:.4g} to {high:.4g} rad, more than 50 turns; if that is an "
            "optical path or degrees, give radians"
        )


# ---- the wavelength of each view ------------------------------------------------------------


#: Longer ones, in micrometres, are probably in nanometres.
LONGEST_UM = 100.0
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


def doubt_light(stack: xr.DataArray, name: str) -> None:
    """Warn of wavelengths that are probably in nanometres."""
    light = wavelengths_of(stack)
    if light is not None and light.max(initial=0.0) > LONGEST_UM:
        warn(
            f"{name} notes wavelengths of {some(np.unique(light))} um; if they are in nanometres, "
            "divide them by 1000"
        )


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
