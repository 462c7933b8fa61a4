"""What simulations share: bodies of ellipsoids, stacks of their phase, checks of what is asked.

The projections of ellipsoids are known in closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.stacks import AXES, KIND, UNWRAPPED, WRAPPED, coordinate
from napari_phase4d.words import (
    advised_call,
    as_numbers,
    check_finite,
    check_positive,
    check_type,
    checked_call,
    shown,
)

__all__ = [
    "Ellipsoid",
    "check_asked",
    "is_count",
    "path_length_um",
    "phase_stack",
    "pixels_of",
    "projected_phase",
    "rotation",
    "with_exact_phase",
    "wrap",
]

#: No phantom is larger than this: pixels of all frames together.
MOST_PIXELS = 2**36
#: So many places tell how far one lies from the next.
LEAST_PLACES = 2


def check_asked(
    shape: Any, n_times: Any, angles_deg: Any, optics: Any = None, **lengths: Any
) -> None:
    """Raise TypeError or ValueError for a simulation that can't be.

    Parameters
    ----------
    shape : tuple of int
        Height and width in pixels.
    n_times : int
        Number of frames.
    angles_deg : sequence of float
        Viewing angles in degrees.
    optics : Optics or None
        The microscope.
    **lengths
        Numbers that must be above 0, by their names; None is left out, and of a pair both count.
    """
    sides = shape if isinstance(shape, (tuple, list, np.ndarray)) else ()
    if len(sides) != 2 or not all(is_count(side) for side in sides):
        msg = f"shape must be a height and a width in pixels, but is {shown(shape)}"
        raise ValueError(msg)
    if not is_count(n_times):
        msg = f"n_times must be a number of frames, 1 or more, but is {shown(n_times)}"
        raise ValueError(msg)
    angles = as_numbers("angles_deg", angles_deg)
    if angles.ndim != 1 or not angles.size or not np.isfinite(angles).all():
        msg = f"angles_deg must be a list of degrees, but is {shown(angles_deg)}"
        raise ValueError(msg)
    if (np.diff(angles) <= 0).any():
        msg = f"angles_deg must rise, but is {shown(angles_deg)}"
        raise ValueError(msg)
    if int(sides[0]) * int(sides[1]) * int(n_times) * angles.size > MOST_PIXELS:
        msg = f"{n_times} frames of {sides[0]} x {sides[1]} pixels are more than fit into memory"
        raise ValueError(msg)
    check_optics(optics)
    for name, value in lengths.items():
        for length in value if isinstance(value, (tuple, list)) else (value,):
            if length is not None:
                check_positive(name, length)


def check_optics(optics: Any) -> None:
    """Raise TypeError for what is no microscope; None is the usual one."""
    if optics is not None:
        check_type("optics", optics, Optics, "give Optics(wavelength_um=...)")


def is_count(value: Any) -> bool:
    """Say whether something is a whole number, 1 or more."""
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and value >= 1


# ---- bodies, and stacks of their phase ------------------------------------------------------


@dataclass(frozen=True)
class Ellipsoid:
    """A body of one refractive index; where bodies overlap their contrasts add.

    Parameters
    ----------
    centre_um : tuple of float
        ``(x, y, z)`` in micrometres; light travels along z at viewing angle 0.
    semi_axes_um : tuple of float
        Half the lengths of the three axes in micrometres, along the columns of ``axes``.
    delta_n : float
        Refractive index minus that of what surrounds the body.
    axes : ndarray of shape (3, 3), optional
        Rotation matrix whose columns are the directions of the semi-axes. Default: x, y, z.
    """

    centre_um: tuple[float, float, float]
    semi_axes_um: tuple[float, float, float]
    delta_n: float
    axes: NDArray[np.float64] | None = None


def rotation(axis: str, degrees: float) -> NDArray[np.float64]:
    """Return the matrix that turns a body about the x, y or z axis."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    matrices = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    return np.array(matrices[axis], dtype=np.float64)


@checked_call
def projected_phase(
    bodies: Sequence[Ellipsoid],
    angle_deg: float,
    y_um: NDArray[np.float64],
    x_um: NDArray[np.float64],
    wavelength_um: float,
) -> NDArray[np.float64]:
    """Return the phase in radians that straight rays gather, shape (len(y_um), len(x_um)).

    The view at ``angle_deg`` turns the object about the y axis by that angle; the image plane
    stays perpendicular to the light.

    Parameters
    ----------
    bodies : sequence of Ellipsoid
        What the light goes through; their phases add.
    angle_deg : float
        Viewing angle in degrees.
    y_um, x_um : ndarray of float, shapes (y,) and (x,)
        Places of rows and columns in micrometres, from the origin of the bodies' centres.
    wavelength_um : float
        Vacuum wavelength in micrometres.

    Returns
    -------
    ndarray of float64, shape (y, x)
        Exact phase in radians, not wrapped: positive where the refractive index is higher.
    """
    phase = np.zeros((len(y_um), len(x_um)))
    for body in bodies:
        add_path(phase, body, angle_deg, y_um, x_um, 2 * np.pi / wavelength_um * body.delta_n)
    return phase


def path_length_um(
    body: Ellipsoid, angle_deg: float, y_um: NDArray[np.float64], x_um: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the length in micrometres that each ray travels inside one body."""
    length = np.zeros((len(y_um), len(x_um)))
    add_path(length, body, angle_deg, y_um, x_um, 1.0)
    return length


def add_path(
    total: NDArray[np.float64],
    body: Ellipsoid,
    angle_deg: float,
    y_um: NDArray[np.float64],
    x_um: NDArray[np.float64],
    weight: float,
) -> None:
    """Add ``weight`` times the chord of each ray to ``total``, inside the body's shadow only.

    With q(r) = r^T Q r the ellipsoid q <= 1 in the turned frame, the ray (x, y, z) enters and
    leaves where a z^2 + 2 b z + c = 0; the chord is 2 sqrt(b^2 - a c) / a.
    """
    view = rotation("y", angle_deg)
    axes = np.eye(3) if body.axes is None else body.axes
    turned = view @ axes
    quadric = turned @ np.diag(1 / np.square(body.semi_axes_um)) @ turned.T
    centre = view @ np.asarray(body.centre_um)
    extent = np.sqrt(np.diag(np.linalg.inv(quadric)))
    rows = within(y_um, centre[1], extent[1])
    columns = within(x_um, centre[0], extent[0])
    x = x_um[None, columns] - centre[0]
    y = y_um[rows, None] - centre[1]
    a = quadric[2, 2]
    b = quadric[2, 0] * x + quadric[2, 1] * y
    c = quadric[0, 0] * x**2 + 2 * quadric[0, 1] * x * y + quadric[1, 1] * y**2 - 1
    total[rows, columns] += weight * 2 * np.sqrt(np.maximum(b**2 - a * c, 0)) / a


def within(coordinates: NDArray[np.float64], centre: float, extent: float) -> slice:
    """Return the slice of sorted coordinates that lie within ``extent`` of ``centre``."""
    first, last = np.searchsorted(coordinates, (centre - extent, centre + extent))
    return slice(int(first), int(last))


Bodies = Callable[[float], Sequence[Ellipsoid]]


def wrap(phase: xr.DataArray) -> xr.DataArray:
    """Wrap phase into (-pi, pi]."""
    turns = np.ceil((phase - np.pi) / (2 * np.pi))
    return (phase - 2 * np.pi * turns).astype(np.float32)


@checked_call
def phase_stack(
    bodies_at: Bodies,
    *,
    times_s: Sequence[float],
    angles_deg: Sequence[float],
    shape: tuple[int, int],
    pixel_um: float | tuple[float, float],
    optics: Optics,
    attrs: dict[str, object],
    first_um: float | tuple[float, float] = 0.0,
) -> xr.Dataset:
    """Project moving bodies at every time and angle.

    Half the field, ``shape * pixel_um / 2``, is the origin of the bodies' coordinates, so that
    stacks of one field with other pixel sizes show the same object at the same place.

    Parameters
    ----------
    bodies_at : callable
        Gives the bodies at a time in seconds.
    times_s, angles_deg : sequence of float
        When and from where to look.
    shape : tuple of int
        Height and width in pixels.
    pixel_um : float or tuple of float
        Width of a pixel in micrometres, or (height, width).
    optics : Optics
        Gives the wavelength.
    attrs : dict
        Noted in the result.
    first_um : float or tuple of float, optional
        Where the first pixel lies in micrometres, or its (y, x). Default 0; for the pixels of a
        reconstruction its ``(y[0], x[0])``.

    Returns
    -------
    xarray.Dataset
        ``phase`` exact and ``wrapped``, float32, dims (time, angle, y, x), radians.
    """
    step_y, step_x = np.broadcast_to(np.asarray(pixel_um, dtype=np.float64), 2)
    first = np.broadcast_to(as_numbers("first_um", first_um), 2).tolist()
    first_y, first_x = (check_finite("first_um", place) for place in first)
    y, x = first_y + np.arange(shape[0]) * step_y, first_x + np.arange(shape[1]) * step_x
    phase = np.empty((len(times_s), len(angles_deg), *shape), dtype=np.float32)
    for t, time in enumerate(times_s):
        bodies = bodies_at(time)
        for a, angle in enumerate(angles_deg):
            centred = y - shape[0] / 2 * step_y, x - shape[1] / 2 * step_x
            phase[t, a] = projected_phase(bodies, angle, *centred, optics.wavelength_um)
    return with_exact_phase(phase, times_s, angles_deg, (y, x), optics, attrs)


class Pixels(TypedDict):
    """How large the pixels of a stack are, and where the first one lies, along y and x."""

    pixel_um: tuple[float, float]
    first_um: tuple[float, float]


@advised_call(stack="give phase, as reconstruct() or open_phase() makes it")
def pixels_of(stack: xr.DataArray) -> Pixels:
    """Return what pixels a stack has, to see an object on the same ones.

    `swimming_euglena` and `phase_stack` take it as it is: ``**pixels_of(stack)``.

    Parameters
    ----------
    stack : DataArray
        Phase with places along y and x in micrometres, two or more pixels along each.

    Returns
    -------
    dict
        ``pixel_um`` and ``first_um``: height and width of a pixel in micrometres, and where the
        first one lies along y and x.

    Raises
    ------
    ValueError
        If there are no places, or only one.

    Examples
    --------
    >>> seen = phase_stack(
    ...     lambda time: [], times_s=[0], angles_deg=[0], shape=(4, 4), pixel_um=0.5,
    ...     optics=Optics(), attrs={}, first_um=0.25,
    ... )
    >>> pixels_of(seen["phase"])
    {'pixel_um': (0.5, 0.5), 'first_um': (0.25, 0.25)}
    """
    for axis in ("y", "x"):
        if axis not in stack.coords or stack.sizes.get(axis, 0) < LEAST_PLACES:
            msg = f"the stack has no places of two pixels or more along {axis}, in micrometres"
            raise ValueError(msg)
    rows, columns = (np.asarray(stack[axis].values, dtype=np.float64) for axis in ("y", "x"))
    return {
        "pixel_um": (float(rows[1] - rows[0]), float(columns[1] - columns[0])),
        "first_um": (float(rows[0]), float(columns[0])),
    }


def with_exact_phase(
    phase: NDArray[np.floating],
    times_s: ArrayLike,
    angles_deg: ArrayLike,
    places_um: tuple[NDArray[np.floating], NDArray[np.floating]],
    optics: Optics,
    attrs: Mapping[str, object],
) -> xr.Dataset:
    """Return exact phase with its axes and notes, and the same wrapped.

    Parameters
    ----------
    phase : ndarray, shape (time, angle, y, x)
        Exact phase in radians.
    times_s, angles_deg : array_like
        When and from where it was looked at.
    places_um : tuple of ndarray
        Where pixels lie along y and x.
    optics : Optics
        Gives the wavelength.
    attrs : mapping
        Noted in the result.
    """
    coords = {
        "time": coordinate("time", np.asarray(times_s, dtype=np.float64)),
        "angle": coordinate("angle", np.asarray(angles_deg, dtype=np.float64)),
        "y": coordinate("y", places_um[0]),
        "x": coordinate("x", places_um[1]),
    }
    common = {"units": "rad", "wavelength_um": optics.wavelength_um, **attrs}
    exact = xr.DataArray(phase.astype(np.float32), dims=AXES, coords=coords, attrs=common)
    exact.attrs |= {"exact": True, KIND: UNWRAPPED}
    wrapped = wrap(exact)
    wrapped.attrs = {**common, KIND: WRAPPED}
    return xr.Dataset({"phase": exact, "wrapped": wrapped}, attrs=common)
