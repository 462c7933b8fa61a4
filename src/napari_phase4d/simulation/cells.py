"""The paper's two cells: a yeast that buds, and a euglena that spins and bends as it swims."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.simulation.ellipsoids import (
    Ellipsoid,
    check_asked,
    phase_stack,
    projected_phase,
    rotation,
)
from napari_phase4d.words import check_finite

__all__ = [
    "EUGLENA_ANGLES_DEG",
    "FRAME_RATE_HZ",
    "Budding",
    "budding_yeast",
    "swimming_euglena",
]

YEAST_ANGLES_DEG = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)
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
    angles_deg: Sequence[float] = YEAST_ANGLES_DEG,
    field_um: float = 9.6,
    first_um: float | tuple[float, float] = 0.0,
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
    first_um : float or tuple of float, optional
        Where the first pixel lies in micrometres, or its (y, x). Default 0; for the pixels of a
        reconstruction its ``(y[0], x[0])``.
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
    >>> from napari_phase4d.simulation import budding_yeast
    >>> exact = budding_yeast()
    >>> dict(exact.sizes), exact.attrs["boundary"]
    ({'time': 19, 'angle': 6, 'y': 48, 'x': 48}, (0, 0))
    >>> round(float(exact["phase"].max()))
    21
    """
    check_asked(shape, n_times, angles_deg, optics, field_um=field_um)
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
        first_um=first_um,
    )


FRAME_RATE_HZ = 6.0
EUGLENA_ANGLES_DEG = (-7.0, 21.0)
#: The flat cell lies edge-on after a quarter turn; it does not quite get there.
SPIN_DEG_PER_S = 12.0
SWIM_UM_PER_S = 0.35
#: Body contrast before it is scaled to the wanted peak phase.
UNIT_DELTA_N = 0.01


def swimming_euglena(
    shape: tuple[int, int] = (512, 512),
    n_times: int = 40,
    *,
    peak_rad: float = 17.0,
    angles_deg: Sequence[float] = EUGLENA_ANGLES_DEG,
    frame_rate_hz: float = FRAME_RATE_HZ,
    optics: Optics | None = None,
    pixel_um: float | tuple[float, float] | None = None,
    first_um: float | tuple[float, float] = 0.0,
) -> xr.Dataset:
    """Simulate the phase of a swimming euglena gracilis at exact truth.

    A flattened, spindle-shaped cell with a nucleus and starch grains turns about its long axis,
    bends and swims. It is optically thin at the first time, seen from the first angle, and
    thickest near the end. Light travels in straight lines; every phase is a sum of closed-form
    projections of ellipsoids.

    Parameters
    ----------
    shape : tuple of int, optional
        Height and width in pixels, default (512, 512): the field of a camera.
    n_times : int, optional
        Number of frames, default 40.
    peak_rad : float, optional
        Largest phase of the first 40 frames at 6 frames a second, in radians, default 17.
    angles_deg : sequence of float, optional
        Viewing angles in degrees, default -7 and +21 as in section 3 of the paper.
    frame_rate_hz : float, optional
        Frames per second, default 6 as in the paper.
    optics : Optics, optional
        The microscope, by default that of the paper.
    pixel_um : float or tuple of float, optional
        Width of a pixel in micrometres. Default: the camera pixel in the sample.
    first_um : float or tuple of float, optional
        Where the first pixel lies in micrometres, or its (y, x). Default 0; for the pixels of a
        reconstruction its ``(y[0], x[0])``.

    Returns
    -------
    xarray.Dataset
        ``phase`` (exact) and ``wrapped``, dims (time, angle, y, x), radians; ``attrs["boundary"]``
        is the optically thin (time, angle) index pair.

    See Also
    --------
    multiplexed_video : Holograms of it.
    budding_yeast : The other object of the paper.

    Examples
    --------
    >>> from napari_phase4d.simulation import swimming_euglena
    >>> exact = swimming_euglena(n_times=2)
    >>> dict(exact.sizes), exact.attrs["boundary"]
    ({'time': 2, 'angle': 2, 'y': 512, 'x': 512}, (0, 0))
    """
    check_asked(shape, n_times, angles_deg, optics, frame_rate_hz=frame_rate_hz, pixel_um=pixel_um)
    optics = optics or Optics()
    scale = check_finite("peak_rad", peak_rad) / unit_peak_rad(optics.wavelength_um)
    return phase_stack(
        lambda time: euglena_bodies(time, UNIT_DELTA_N * scale),
        times_s=[t / frame_rate_hz for t in range(n_times)],
        angles_deg=list(angles_deg),
        shape=shape,
        pixel_um=optics.pixel_um if pixel_um is None else pixel_um,
        optics=optics,
        attrs={"object": "swimming euglena", "boundary": (0, 0), "peak_rad": peak_rad},
        first_um=first_um,
    )


def euglena_bodies(time_s: float, delta_n: float) -> list[Ellipsoid]:
    """Return the parts of the cell at a time; sizes in micrometres after Euglena gracilis."""
    # The thin axis looks along the light at the first angle when the movie starts.
    spin = rotation("x", SPIN_DEG_PER_S * time_s)
    heading = rotation("z", 18 + 1.5 * time_s) @ rotation("y", -EUGLENA_ANGLES_DEG[0])
    bend = 9 * np.sin(2 * np.pi * time_s / 9)
    swim = np.array([SWIM_UM_PER_S * (time_s - 3.3), 0.3 * np.sin(time_s), 0.0])
    # offset along the body and across it, semi-axes, contrast, bend about z
    parts = (
        ((0.0, 0.0, 0.0), (14.5, 4.4, 2.2), 1.0, 0.0),
        ((8.0, 0.0, 0.0), (8.0, 2.9, 1.6), 0.45, bend),
        ((-9.0, 0.0, 0.0), (7.0, 2.5, 1.5), 0.45, -bend),
        ((-1.5, 0.2, 0.1), (2.9, 2.3, 1.4), 0.9, 0.0),
        ((5.0, 1.3, 0.3), (1.4, 1.0, 0.8), 1.1, 0.0),
        ((-7.0, -0.9, -0.2), (1.5, 1.0, 0.8), 1.1, 0.0),
    )
    bodies = []
    for offset, semi_axes, contrast, bent in parts:
        curl = rotation("z", bent)
        centre = heading @ (spin @ (curl @ np.asarray(offset))) + swim
        bodies.append(
            Ellipsoid(
                (float(centre[0]), float(centre[1]), float(centre[2])),
                semi_axes,
                delta_n * contrast,
                heading @ spin @ curl,
            )
        )
    return bodies


@lru_cache(maxsize=4)
def unit_peak_rad(wavelength_um: float) -> float:
    """Return the largest phase at unit contrast, on a fixed grid so that it never varies."""
    grid = np.linspace(-20, 20, 161)
    return max(
        float(
            projected_phase(
                euglena_bodies(t / FRAME_RATE_HZ, UNIT_DELTA_N), angle, grid, grid, wavelength_um
            ).max()
        )
        for t in range(0, 40, 3)
        for angle in EUGLENA_ANGLES_DEG
    )
