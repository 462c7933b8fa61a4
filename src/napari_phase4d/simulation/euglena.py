"""A euglena that spins and bends while it swims, seen from two angles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import xarray as xr

from napari_phase4d.optics import Optics
from napari_phase4d.simulation.ellipsoids import Ellipsoid, projected_phase, rotation
from napari_phase4d.simulation.stacks import phase_stack

__all__ = ["swimming_euglena"]

FRAME_RATE_HZ = 6.0
ANGLES_DEG = (-7.0, 21.0)
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
    angles_deg: Sequence[float] = ANGLES_DEG,
    frame_rate_hz: float = FRAME_RATE_HZ,
    optics: Optics | None = None,
    pixel_um: float | tuple[float, float] | None = None,
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
    >>> exact = swimming_euglena(n_times=2)
    >>> dict(exact.sizes), exact.attrs["boundary"]
    ({'time': 2, 'angle': 2, 'y': 512, 'x': 512}, (0, 0))
    """
    optics = optics or Optics()
    scale = peak_rad / unit_peak_rad(optics.wavelength_um)
    return phase_stack(
        lambda time: euglena_bodies(time, UNIT_DELTA_N * scale),
        times_s=[t / frame_rate_hz for t in range(n_times)],
        angles_deg=list(angles_deg),
        shape=shape,
        pixel_um=optics.pixel_um if pixel_um is None else pixel_um,
        optics=optics,
        attrs={"object": "swimming euglena", "boundary": (0, 0), "peak_rad": peak_rad},
    )


def euglena_bodies(time_s: float, delta_n: float) -> list[Ellipsoid]:
    """Return the parts of the cell at a time; sizes in micrometres after Euglena gracilis."""
    # The thin axis looks along the light at the first angle when the movie starts.
    spin = rotation("x", SPIN_DEG_PER_S * time_s)
    heading = rotation("z", 18 + 1.5 * time_s) @ rotation("y", -ANGLES_DEG[0])
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
        for angle in ANGLES_DEG
    )
