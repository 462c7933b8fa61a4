"""Cells of many shapes that move in many ways, to test unwrappers with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.simulation.ellipsoids import (
    Ellipsoid,
    check_asked,
    phase_stack,
    rotation,
    wrap,
)
from napari_phase4d.words import check_type

__all__ = ["SHAPES", "moving_shape", "with_noise"]

#: Times from 0 to 1 over the recording; positions and sizes in shares of half the field.
Bodies = Callable[[float], list[Ellipsoid]]


def body(
    centre: tuple[float, float, float],
    semi_axes: tuple[float, float, float],
    contrast: float,
    spin: np.ndarray | None = None,
) -> Ellipsoid:
    """Return an ellipsoid; a contrast of 1 gathers one radian along half the field."""
    return Ellipsoid(centre, semi_axes, contrast, spin)


def dividing(s: float) -> list[Ellipsoid]:
    """Return a cell that rounds up and divides."""
    apart, size = 0.38 * s, 0.45 - 0.12 * s
    thick = 0.10 + 0.30 * s
    return [
        body((-apart, 0.1 * apart, 0.0), (size, 0.9 * size, thick), 24.0),
        body((apart, -0.1 * apart, 0.05 * s), (size, 0.9 * size, 0.9 * thick), 24.0 * s),
    ]


def tumbling(s: float) -> list[Ellipsoid]:
    """Return a flat cell, such as a red blood cell, that turns over to edge-on."""
    turn = rotation("x", 75 * s) @ rotation("z", 25 * s)
    return [body((0.0, 0.0, 0.0), (0.55, 0.42, 0.13), 26.0, turn)]


def swelling(s: float) -> list[Ellipsoid]:
    """Return a cell that swells, with a nucleus off its middle."""
    wide, thick = 0.45 + 0.15 * s, 0.08 + 0.42 * s
    return [
        body((0.05, 0.0, 0.0), (wide, 0.9 * wide, thick), 24.0),
        body((0.15, -0.1, 0.05), (0.2, 0.18, 0.4 * thick), 8.0),
    ]


def returning(s: float) -> list[Ellipsoid]:
    """Return a cell that thickens and becomes thin again."""
    thick = 0.10 + 0.34 * float(np.sin(np.pi * s))
    return [
        body((0.0, 0.05, 0.0), (0.5, 0.4, thick), 24.0),
        body((-0.2, 0.1, 0.0), (0.15, 0.13, 0.5 * thick), 10.0),
    ]


def translating(s: float) -> list[Ellipsoid]:
    """Return a cell that crosses the field while it thickens."""
    along = 0.7 * (s - 0.5)
    thick = 0.09 + 0.25 * s
    return [
        body((along, 0.5 * along, 0.0), (0.35, 0.28, thick), 28.0),
        body((along + 0.1, 0.5 * along, 0.0), (0.12, 0.1, 0.5 * thick), 10.0),
    ]


def touching(s: float) -> list[Ellipsoid]:
    """Return two cells that come together, one of them turning."""
    gap = 0.45 - 0.12 * s
    turn = rotation("y", 20 + 40 * s)
    return [
        body((-gap, 0.12, 0.0), (0.34, 0.40, 0.09 + 0.22 * s), 28.0),
        body((gap, -0.12, 0.05), (0.36, 0.32, 0.12), 28.0, turn),
    ]


def vacuole(s: float) -> list[Ellipsoid]:
    """Return a cell whose vacuole, of lower index than the cell, moves and grows."""
    thick = 0.10 + 0.32 * s
    size = 0.12 + 0.10 * s
    return [
        body((0.0, 0.0, 0.0), (0.52, 0.45, thick), 24.0),
        body((0.2 - 0.25 * s, 0.1 * s, 0.0), (size, size, 0.6 * thick), -18.0),
    ]


def bending(s: float) -> list[Ellipsoid]:
    """Return a long cell of three parts that bends and rolls."""
    roll = rotation("x", 60 * s)
    bend = 25 * float(np.sin(2 * np.pi * s))
    parts = []
    for offset, bent, size in ((-0.32, -bend, 0.30), (0.0, 0.0, 0.34), (0.32, bend, 0.28)):
        curl = rotation("z", bent)
        centre = curl @ np.array([offset, 0.0, 0.0])
        semi_axes = (size, 0.20, 0.11)
        parts.append(body((centre[0], centre[1], centre[2]), semi_axes, 18.0, curl @ roll))
    return parts


#: Name -> bodies at a moment from 0 (thin) to 1.
SHAPES: Mapping[str, Bodies] = MappingProxyType(
    {
        "dividing": dividing,
        "tumbling": tumbling,
        "swelling": swelling,
        "returning": returning,
        "translating": translating,
        "touching": touching,
        "vacuole": vacuole,
        "bending": bending,
    }
)


def moving_shape(
    name: str,
    shape: tuple[int, int] = (64, 64),
    n_times: int = 20,
    *,
    angles_deg: Sequence[float] = (0.0, 6.0, 12.0, 18.0),
    optics: Optics | None = None,
) -> xr.Dataset:
    """Simulate one of the cells in `SHAPES`, with exact phase.

    It is thin at the first time, seen from the first angle.

    Parameters
    ----------
    name : str
        One of `SHAPES`.
    shape : tuple of int, optional
        Height and width in pixels; the field is 10 micrometres high.
    n_times : int, optional
        Number of frames, one a second.
    angles_deg : sequence of float, optional
        Viewing angles in degrees.
    optics : Optics, optional
        Gives the wavelength.

    Returns
    -------
    xarray.Dataset
        ``phase`` (exact) and ``wrapped``, dims (time, angle, y, x), radians.

    Raises
    ------
    ValueError
        If there is no such shape.
    """
    if name not in SHAPES:
        msg = f"shape must be one of {', '.join(SHAPES)}, but is {name!r}"
        raise ValueError(msg)
    check_asked(shape, n_times, angles_deg, optics)
    optics = optics or Optics()
    half_um = 5.0
    delta_n = optics.wavelength_um / (2 * np.pi * half_um)

    def bodies_at(time: float) -> list[Ellipsoid]:
        return [
            Ellipsoid(
                tuple(half_um * c for c in e.centre_um),  # type: ignore[arg-type]
                tuple(half_um * c for c in e.semi_axes_um),  # type: ignore[arg-type]
                delta_n * e.delta_n,
                e.axes,
            )
            for e in SHAPES[name](time / max(n_times - 1, 1))
        ]

    return phase_stack(
        bodies_at,
        times_s=[float(t) for t in range(n_times)],
        angles_deg=list(angles_deg),
        shape=shape,
        pixel_um=2 * half_um / shape[0],
        optics=optics,
        attrs={"object": f"{name} cell", "boundary": (0, 0)},
    )


def with_noise(
    data: xr.Dataset, noise_rad: float = 0.0, drift_rad: float = 0.0, seed: int = 0
) -> xr.Dataset:
    """Add noise and drift to exact phase, and wrap it anew.

    Parameters
    ----------
    data : Dataset
        With exact ``phase``.
    noise_rad : float, optional
        Standard deviation in radians of white noise on every pixel.
    drift_rad : float, optional
        Standard deviation in radians of the change of each view's level from frame to frame.
    seed : int, optional
        Of the random numbers.

    Returns
    -------
    xarray.Dataset
        ``phase`` is the exact phase with the same noise and drift, so that an unwrapper that is
        right everywhere leaves no error; ``wrapped`` belongs to it.
    """
    check_type("data", data, xr.Dataset, 'give one with "phase", as budding_yeast() does')
    if "phase" not in data:
        msg = f'data holds {", ".join(map(str, data)) or "nothing"}, but no exact "phase"'
        raise ValueError(msg)
    rng = np.random.default_rng(seed)
    exact = data["phase"]
    values = exact.values + rng.normal(0, 1, exact.shape).astype(np.float32) * np.float32(
        noise_rad
    )
    steps = rng.normal(0, drift_rad, exact.shape[:2])
    steps[0] = 0
    drift = np.cumsum(steps, axis=0).astype(np.float32)
    noisy = exact.copy(data=values + drift[:, :, None, None])
    wrapped = wrap(noisy)
    wrapped.attrs = dict(data["wrapped"].attrs) if "wrapped" in data else {}
    return xr.Dataset({"phase": noisy, "wrapped": wrapped}, attrs=data.attrs)
