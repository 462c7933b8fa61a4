"""A yeast cell that buds, seen from six angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from napari_phase4d.optics import Optics
from napari_phase4d.simulation.ellipsoids import Ellipsoid, rotation
from napari_phase4d.simulation.stacks import phase_stack

__all__ = ["Budding", "budding_yeast"]

ANGLES_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)
N_TIMES = 19
INTERVAL_S = 60.0


@dataclass(frozen=True)
class Budding:
    """Shape and growth of a budding cell; lengths in micrometres.

    The defaults were chosen for difficulty: with them the paper's own five methods leave about the
    errors that the paper reports. The contrast is far above that of a living cell, as the paper
    says of its simulation: "abnormally high gradients intentionally created".

    Parameters
    ----------
    mother_um : tuple of float
        Semi-axes of the mother cell at the start, along x, y and the line of sight at 0 degrees.
    thickening : float
        How many times as thick as at the start the mother is at the end.
    bud_um : float
        Radius of the bud at the end.
    bud_growth : float
        Exponent of the bud's radius over time, which starts at 0.
    bud_azimuth_deg, bud_elevation_deg : float
        Where on the mother the bud sits: round the line of sight from x, and towards the viewer.
    lean_deg : tuple of float
        How far the mother leans about y at the start and at the end, seen from 0 degrees; larger
        viewing angles see it lean more, and so thicker.
    vacuole : float
        Contrast of the vacuole as a share of the cell's, added to it.
    delta_n : float
        Contrast of the cell.
    """

    mother_um: tuple[float, float, float] = (2.18, 1.90, 0.57)
    thickening: float = 1.32
    bud_um: float = 1.84
    bud_growth: float = 0.61
    bud_azimuth_deg: float = 270.0
    bud_elevation_deg: float = 19.0
    lean_deg: tuple[float, float] = (40.0, 25.0)
    vacuole: float = -0.11
    delta_n: float = 0.512

    def bodies(self, progress: float) -> list[Ellipsoid]:
        """Return the parts of the cell; ``progress`` runs from 0 at the start to 1 at the end."""
        a, b, c = self.mother_um
        c *= 1 + (self.thickening - 1) * progress
        lean = rotation("y", float(np.interp(progress, (0, 1), self.lean_deg)))
        mother = Ellipsoid((0.0, 0.0, 0.0), (a, b, c), self.delta_n, lean)
        vacuole = Ellipsoid(
            tuple(lean @ np.array([-0.35 * a, 0.2 * b, 0.0])),
            (0.3 * a, 0.3 * b, 0.35 * c),
            self.delta_n * self.vacuole,
            lean,
        )
        if progress == 0:
            return [mother, vacuole]
        azimuth, elevation = np.deg2rad([self.bud_azimuth_deg, self.bud_elevation_deg])
        towards = np.array(
            [
                np.cos(azimuth) * np.cos(elevation),
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation),
            ]
        )
        radius = self.bud_um * progress**self.bud_growth
        surface = 1 / np.linalg.norm(towards / np.array([a, b, c]))
        centre = lean @ (towards * (surface + 0.6 * radius))
        bud = Ellipsoid(tuple(centre), (radius, radius, 0.9 * radius), self.delta_n, lean)
        return [mother, vacuole, bud]


def budding_yeast(
    shape: tuple[int, int] = (48, 48),
    n_times: int = N_TIMES,
    *,
    angles_deg: Sequence[float] = ANGLES_DEG,
    field_um: float = 9.6,
    budding: Budding | None = None,
    optics: Optics | None = None,
) -> xr.Dataset:
    """Simulate a yeast cell during reproduction by budding, as in section 3 of the paper.

    The cell is optically thin only at the first time, seen from the first angle: with the default
    shape, that is the one frame in which no step between neighbouring pixels exceeds half a
    cycle. Light travels in straight lines; every phase is a sum of closed-form projections.

    Parameters
    ----------
    shape : tuple of int, optional
        Height and width in pixels, default (48, 48). Smaller pixels make it easier to unwrap.
    n_times : int, optional
        Number of time steps of 1 minute from t = 1 minute on, default 19 as in the paper.
    angles_deg : sequence of float, optional
        Viewing angles in degrees, default 0 to 25 by 5 as in the paper.
    field_um : float, optional
        Width of the field in micrometres, default 9.6.
    budding : Budding, optional
        Shape and growth.
    optics : Optics, optional
        Gives the wavelength.

    Returns
    -------
    xarray.Dataset
        ``phase`` (exact) and ``wrapped``, dims (time, angle, y, x), radians; ``attrs["boundary"]``
        is the optically thin (time, angle) index pair.

    See Also
    --------
    swimming_euglena : The other object of the paper.

    Examples
    --------
    >>> exact = budding_yeast()
    >>> dict(exact.sizes), exact.attrs["boundary"]
    ({'time': 19, 'angle': 6, 'y': 48, 'x': 48}, (0, 0))
    >>> round(float(exact["phase"].max()))
    21
    """
    cell = budding or Budding()
    last = INTERVAL_S * max(n_times - 1, 1)
    return phase_stack(
        lambda time: cell.bodies((time - INTERVAL_S) / last),
        times_s=[INTERVAL_S * t for t in range(1, n_times + 1)],
        angles_deg=list(angles_deg),
        shape=shape,
        pixel_um=(field_um / shape[0], field_um / shape[1]),
        optics=optics or Optics(),
        attrs={"object": "budding yeast", "boundary": (0, 0)},
    )
