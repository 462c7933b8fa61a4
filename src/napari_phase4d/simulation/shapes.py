"""Cells of many shapes that move in many ways, and objects that are hard, to test unwrappers with.

Cells are bodies whose phase is projected. The phase of hard objects is written down directly as a
map over y and x: what counts is that it is known exactly and changes over time and angle as that
of a cell could.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.simulation.ellipsoids import (
    Ellipsoid,
    check_asked,
    phase_stack,
    rotation,
    with_exact_phase,
)
from napari_phase4d.words import shown

__all__ = [
    "HARD_SHAPES",
    "SHAPES",
    "hard_shape",
    "moving_shape",
]

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
    check_named(name, SHAPES)
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


def check_named(name: str, known: Mapping[str, object]) -> None:
    """Raise ValueError if there is no shape of that name."""
    if name not in known:
        msg = f"shape must be one of {', '.join(known)}, but is {shown(name)}"
        raise ValueError(msg)


# ---- hard ones: walls, tubes, parts that part fast, sudden changes --------------------------


Map = NDArray[np.float64]
#: Phase in radians at a moment from 0 to 1, at y and x in shares of half the field, seen from
#: an angle in radians.
PhaseAt = Callable[[float, Map, Map, float], Map]

#: Softness of the edge of a flat top, in shares of half the field.
EDGE = 0.005


def dome(
    y: Map, x: Map, centre: tuple[float, float], size: tuple[float, float], peak: float
) -> Map:
    """Return the phase of half an ellipsoid."""
    square = ((y - centre[0]) / size[0]) ** 2 + ((x - centre[1]) / size[1]) ** 2
    return peak * np.sqrt(np.maximum(1 - square, 0))


def hill(y: Map, x: Map, centre: tuple[float, float], width: float, peak: float) -> Map:
    """Return a Gaussian."""
    return peak * np.exp(-((y - centre[0]) ** 2 + (x - centre[1]) ** 2) / (2 * width**2))


def plate(y: Map, x: Map, centre: tuple[float, float], radius: float, height: float) -> Map:
    """Return a flat top with a wall round it."""
    distance = np.hypot(y - centre[0], x - centre[1])
    return height / (1 + np.exp(np.clip((distance - radius) / EDGE, -50, 50)))


def tube(y: Map, x: Map, points: NDArray[np.float64], radius: float, peak: float) -> Map:
    """Return a tube round a line through points (y, x)."""
    nearest = np.full(y.shape, np.inf)
    for start, end in pairwise(points):
        along = end - start
        share = ((y - start[0]) * along[0] + (x - start[1]) * along[1]) / max(along @ along, 1e-12)
        share = np.clip(share, 0, 1)
        distance = np.hypot(y - start[0] - share * along[0], x - start[1] - share * along[1])
        nearest = np.minimum(nearest, distance)
    phase: Map = peak * np.sqrt(np.maximum(1 - (nearest / radius) ** 2, 0))
    return phase


def seen(x: Map, angle: float, height: float = 0.0) -> Map:
    """Return x as seen from an angle, of what lies at a height."""
    found: Map = (x - height * np.sin(angle)) / np.cos(angle)
    return found


def bent_tube(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a tube that bends and thickens."""
    along = np.linspace(-0.7, 0.7, 9)
    points = np.stack([0.5 * s * np.sin(2.2 * along), along], axis=1)
    return tube(y, seen(x, angle, 0.1), points, 0.12, 3 + 6 * s)


def neuron(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a cell body with arms that grow."""
    x = seen(x, angle)
    reach = 0.35 + 0.45 * s
    phase = dome(y, x, (0.0, 0.0), (0.28, 0.28), 4 + 9 * s)
    for turn in (0.3, 2.2, 4.4):
        bend = turn + np.array([0.0, 0.15, 0.35])
        arm = np.array([0.15, 0.5 * reach, reach])
        points = np.stack([arm * np.sin(bend), arm * np.cos(bend)], axis=1)
        phase = np.maximum(phase, tube(y, x, points, 0.09, 4.0))
    return phase


def growing_wall(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a nucleus with a steep wall that grows through a cycle, in a flat cell."""
    cell = dome(y, seen(x, angle), (0.0, 0.0), (0.7, 0.6), 3.0 + 2 * s)
    return cell + plate(y, seen(x, angle, 0.1), (0.05, -0.05), 0.25, 1.0 + 7 * s)


def standing_wall(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a nucleus with a wall of 5 rad that moves but does not grow."""
    cell = dome(y, seen(x, angle), (0.0, 0.0), (0.7, 0.65), 4.0 + 3 * s)
    return cell + plate(y, seen(x, angle), (0.1 - 0.15 * s, 0.1 * s), 0.25, 5.0 * min(1, 4 * s))


def falling_wall(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a hole that a cell opens: its wall falls through a cycle."""
    cell = dome(y, seen(x, angle), (0.0, 0.0), (0.72, 0.72), 5.0 + 8 * s)
    return cell - plate(y, seen(x, angle, -0.1), (-0.1, 0.1), 0.2, 7.0 * s)


def daughters(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a cell that rounds up, divides, and whose daughters part fast."""
    apart = 0.05 + 0.5 * max(0.0, min(1.0, 5 * (s - 0.55)))
    size, peak = 0.42 - 0.15 * min(1.0, 2 * s), 5 + 5 * min(1.0, 2 * s)
    x = seen(x, angle, 0.1)
    return dome(y, x, (0.05, -apart), (size, size), peak) + dome(
        y, x, (-0.05, apart), (0.95 * size, 0.9 * size), 0.9 * peak
    )


def shock(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a cell that shrinks at once to nearly half its width and doubles its phase."""
    x = seen(x, angle)
    if s < 0.5:
        return dome(y, x, (0.0, 0.0), (0.7, 0.65), 5 + 2 * s)
    return dome(y, x, (0.0, 0.0), (0.5, 0.46), 12 + 2 * s)


def jump(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return two cells, one of which doubles its phase from one frame to the next."""
    x = seen(x, angle, 0.1)
    high = 6.0 if s < 0.6 else 12.0
    return dome(y, x, (0.3, -0.35), (0.4, 0.4), high) + dome(
        y, x, (-0.3, 0.4), (0.38, 0.4), 4 + 8 * s
    )


def crossing(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return two cells that swim past each other, one over the other."""
    at = 0.55 - 1.1 * s
    return dome(y, seen(x, angle, 0.2), (0.1, at), (0.3, 0.34), 8.0 + 2 * s) + dome(
        y, seen(x, angle, -0.2), (-0.1, -at), (0.3, 0.34), 6.0 + 4 * s
    )


def ring(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a ring, such as a red blood cell with its dimple, that thickens and drifts."""
    distance = np.hypot(y - 0.15 * s, seen(x, angle) + 0.15 * s)
    phase: Map = (2 + 9 * s) * np.exp(-(((distance - 0.42) / 0.17) ** 2))
    return phase


def lamella(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a crawling cell: a flat sheet with a thick body behind its front."""
    x = seen(x, angle)
    at = -0.25 + 0.5 * s
    return dome(y, x, (0.0, at), (0.6, 0.5), 3.5) + dome(
        y, seen(x, angle, 0.1), (0.05, at - 0.15), (0.26, 0.22), 3 + 9 * s
    )


def cluster(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a heap of small cells that swell one after the other."""
    phase = np.zeros(y.shape)
    centres = ((-0.35, -0.3), (-0.3, 0.3), (0.05, 0.0), (0.4, -0.25), (0.35, 0.38))
    for i, centre in enumerate(centres):
        grown = np.clip(2.2 * s - 0.3 * i, 0, 1)
        phase += dome(y, seen(x, angle, 0.05 * i), centre, (0.28, 0.28), 4 + 6 * grown)
    return phase


def rough(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a cell full of granules that drift."""
    x = seen(x, angle)
    grains = np.sin(11 * (y + 0.1 * s)) * np.sin(9 * (x - 0.12 * s) + 1.0)
    cell = dome(y, x, (0.0, 0.0), (0.68, 0.62), 1.0)
    phase: Map = cell * (5 + 8 * s) + 0.8 * cell * grains * (1 + s)
    return phase


def thin_bubble(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return what is less dense than what surrounds it, and grows."""
    x = seen(x, angle, 0.1)
    return -dome(y, x, (-0.1 * s, 0.1), (0.3 + 0.3 * s, 0.3 + 0.25 * s), 4 + 9 * s)


def leaving(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a cell that swims out of the field while it thickens."""
    return dome(y, seen(x, angle, 0.1), (0.1, -0.4 + 1.2 * s), (0.36, 0.34), 4 + 7 * s)


def coming(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a thick cell that swims into a field that holds another."""
    x = seen(x, angle)
    return dome(y, x, (-0.35, 0.35), (0.32, 0.36), 4 + 6 * s) + dome(
        y, x, (0.4, -1.3 + 1.0 * s), (0.34, 0.34), 8.0
    )


def blebs(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a cell with bulges that come and go."""
    x = seen(x, angle)
    phase = dome(y, x, (0.0, 0.0), (0.45, 0.42), 5 + 7 * s)
    for i, turn in enumerate((0.4, 2.0, 3.9, 5.3)):
        out = max(0.0, float(np.sin(2 * np.pi * (1.5 * s + 0.22 * i))))
        centre = 0.47 * np.sin(turn), 0.45 * np.cos(turn)
        phase += dome(y, x, centre, (0.16, 0.16), 3.5 * out)
    return phase


def steep_hill(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a smooth peak whose flanks become steeper than half a cycle a pixel."""
    return hill(y, seen(x, angle, 0.1), (0.05, -0.05), 0.2 + 0.02 * s, 5 + 22 * s)


def wide(s: float, y: Map, x: Map, angle: float) -> Map:
    """Return a cell that covers most of the field."""
    x = seen(x, angle)
    return dome(y, x, (0.0, 0.0), (0.9, 0.88), 4 + 16 * s) + hill(y, x, (0.1, 0.2), 0.15, 4 * s)


#: Name -> phase at a moment from 0 (thin) to 1.
HARD_SHAPES: Mapping[str, PhaseAt] = MappingProxyType(
    {
        "bent tube": bent_tube,
        "neuron": neuron,
        "growing wall": growing_wall,
        "standing wall": standing_wall,
        "falling wall": falling_wall,
        "daughters": daughters,
        "shock": shock,
        "jump": jump,
        "crossing": crossing,
        "ring": ring,
        "lamella": lamella,
        "cluster": cluster,
        "rough": rough,
        "bubble": thin_bubble,
        "leaving": leaving,
        "coming": coming,
        "blebs": blebs,
        "steep hill": steep_hill,
        "wide": wide,
    }
)


def hard_shape(
    name: str,
    shape: tuple[int, int] = (64, 64),
    n_times: int = 20,
    *,
    angles_deg: Sequence[float] = (0.0, 6.0, 12.0, 18.0),
    moments: Sequence[float] | None = None,
    optics: Optics | None = None,
) -> xr.Dataset:
    """Simulate one of the objects in `HARD_SHAPES`, with exact phase.

    It is thin, or as thin as it comes, at the first time.

    Parameters
    ----------
    name : str
        One of `HARD_SHAPES`.
    shape : tuple of int, optional
        Height and width in pixels; the field is 10 micrometres high.
    n_times : int, optional
        Number of frames, one a second.
    angles_deg : sequence of float, optional
        Viewing angles in degrees.
    moments : sequence of float, optional
        Moments from 0 to 1 at which frames are taken, rising; default ``n_times`` evenly.
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
    check_named(name, HARD_SHAPES)
    check_asked(shape, n_times, angles_deg, optics)
    optics = optics or Optics()
    asked = np.linspace(0, 1, n_times) if moments is None else np.asarray(moments, dtype=float)
    half_pixel = 2 / shape[0]
    y = (np.arange(shape[0]) - shape[0] / 2)[:, None] * half_pixel + np.zeros(shape)
    x = (np.arange(shape[1]) - shape[1] / 2)[None, :] * half_pixel + np.zeros(shape)
    phase = np.stack(
        [np.stack([HARD_SHAPES[name](s, y, x, np.deg2rad(a)) for a in angles_deg]) for s in asked]
    )
    pixel_um = 5.0 * half_pixel
    return with_exact_phase(
        phase,
        np.round(asked * max(n_times - 1, 1), 9),
        angles_deg,
        (np.arange(shape[0]) * pixel_um, np.arange(shape[1]) * pixel_um),
        optics,
        {"object": name, "boundary": (0, 0)},
    )
