"""Bodies made of ellipsoids, whose straight-ray projections are known in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Ellipsoid", "path_length_um", "projected_phase", "rotation"]


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
