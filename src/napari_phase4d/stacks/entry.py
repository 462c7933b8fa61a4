"""Phase as it comes in, wrapped or unwrapped."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d.axes import AXES, PLAIN_AXES
from napari_phase4d.stacks.coordinates import check_rising, plain, with_coordinates
from napari_phase4d.stacks.kinds import check_unwrapped, check_wrapped, refuse_counts
from napari_phase4d.stacks.units import factor_to

__all__ = ["as_stack", "unwrapped_stack", "wrapped_stack"]

#: What phase is given in.
PHASE_UNITS = "rad"
#: What programs note of numbers without a unit, as those of an angle are. Amplitudes have "a.u."
#: or, as a share, "1".
NO_UNITS = ("dimensionless",)


def wrapped_stack(phase: xr.DataArray | Any, name: str = "phase") -> xr.DataArray:
    """Return wrapped phase in radians, its times and angles rising, or say what is wrong with it.

    Parameters
    ----------
    phase : DataArray or array_like
        Dims among (time, angle, y, x); plain arrays are (y, x), (time, y, x) or
        (time, angle, y, x). Masked pixels become NaN.
    name : str, optional
        What to call it.

    Raises
    ------
    TypeError, ValueError
        If it is surely no such stack.

    Warns
    -----
    UserWarning
        If it is probably none: degrees, turns, camera frames, or unwrapped already.
    """
    stack = as_stack(phase, name)
    check_rising(stack, name)
    refuse_counts(stack, name)
    check_wrapped(stack, name)
    return stack


def unwrapped_stack(phase: xr.DataArray | Any, name: str = "phase") -> xr.DataArray:
    """Return unwrapped phase in radians, or say what is wrong with it.

    See `wrapped_stack`; its numbers may lie on disk.
    """
    stack = as_stack(phase, name)
    refuse_counts(stack, name)
    check_unwrapped(stack, name)
    return stack


def as_stack(phase: xr.DataArray | Any, name: str = "phase") -> xr.DataArray:
    """Return a stack of radians with known dims and coordinates, or say what is wrong with it."""
    stack = phase if isinstance(phase, xr.DataArray) else with_names(phase, name)
    unknown = set(stack.dims) - set(AXES)
    if unknown or not {"y", "x"} <= set(stack.dims):
        found = tuple(stack.dims)
        msg = f"{name} has dims {found}; they must be among time, angle, y, x, with y and x"
        raise ValueError(msg)
    check_numbers(stack, name)
    if stack.size == 0:
        msg = f"{name} is empty: its shape is {stack.shape}"
        raise ValueError(msg)
    return with_coordinates(in_radians(stack, name), name)


def with_names(phase: Any, name: str) -> xr.DataArray:
    """Return a plain array with the names of its axes; what is masked becomes NaN."""
    if isinstance(phase, xr.Dataset):
        msg = f"{name} is a Dataset of {', '.join(map(str, phase)) or 'nothing'}; give one of them"
        raise TypeError(msg)
    if isinstance(phase, np.ma.MaskedArray) and phase.dtype.kind == "f":
        phase = phase.filled(np.nan)
    values = plain(phase, name)
    if values.ndim not in PLAIN_AXES:
        msg = (
            f"{name} has {values.ndim} dimensions {values.shape}; it must have two (y, x), "
            "three (time, y, x) or four (time, angle, y, x)"
        )
        raise ValueError(msg)
    return xr.DataArray(values, dims=PLAIN_AXES[values.ndim])


def check_numbers(stack: xr.DataArray, name: str) -> None:
    """Refuse numbers that are no phase, and say what they seem to be."""
    kind = stack.dtype.kind
    if kind in "fiu":
        return
    if kind == "c":
        msg = f"{name} is complex; give its angle, numpy.angle(field)"
    elif kind == "b":
        msg = f"{name} is bool, as masks are; it must be real numbers in radians"
    else:
        msg = f"{name} must be real numbers in radians, but is {stack.dtype}"
    raise TypeError(msg)


def in_radians(stack: xr.DataArray, name: str) -> xr.DataArray:
    """Return phase in radians, by the units that it notes."""
    units = str(stack.attrs.get("units") or PHASE_UNITS)
    if units in NO_UNITS:
        return stack
    factor = factor_to(units, PHASE_UNITS)
    if factor is None:
        length = factor_to(units, "um") is not None
        advice = "2 * numpy.pi / wavelength times an optical path" if length else "give radians"
        msg = (
            f"{name} is in {units!r}, which is no phase; {advice}"
            f'{" is phase in radians" if length else ""}, with attrs["units"] = "rad"'
        )
        raise ValueError(msg)
    if factor == 1:
        return stack
    turned = stack.copy(data=stack.data * np.result_type(stack.dtype, np.float32).type(factor))
    turned.attrs = {**stack.attrs, "units": PHASE_UNITS}
    return turned
