"""Several cells at once: they swim, meet, divide, leave and come in; each one's mass is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.simulation.cells import EUGLENA_ANGLES_DEG, FRAME_RATE_HZ
from napari_phase4d.simulation.ellipsoids import (
    Ellipsoid,
    check_asked,
    is_count,
    path_length_um,
    phase_stack,
    rotation,
)
from napari_phase4d.stacks import AXES
from napari_phase4d.words import check_positive, shown

__all__ = ["swimming_cells"]

#: Semi-axes of a cell in micrometres: along it, across it, and along the light; and how much
#: cells differ from each other.
SEMI_AXES_UM, VARIETY = (5.0, 3.4, 2.8), 0.15
#: How fast cells swim, and how fast they turn, at random.
SPEED_UM_PER_S, TURN_DEG = 2.5, 6.0
#: Cells bounce off each other where their centres come nearer than this share of their lengths.
BOUNCE = 0.8
#: How far from the middle of their parent daughters begin, as a share of their length.
APART = 0.8


@dataclass
class Cell:
    """One cell on its way.

    Parameters
    ----------
    number : int
        From 1.
    place, heading : ndarray of float, float
        Its centre (x, y) in micrometres, and where it swims, in degrees.
    semi_axes : tuple of float
        Micrometres.
    first, last : int
        Times at which it is there; it may lie outside of the field.
    parent : int
        The cell that it came from by division; 0 if by none.
    stays : bool
        Whether it turns round at the edge of the field.
    """

    number: int
    place: NDArray[np.float64]
    heading: float
    semi_axes: tuple[float, float, float]
    first: int = 0
    last: int = 10**9
    parent: int = 0
    stays: bool = True
    places: dict[int, tuple[float, float, float]] = field(default_factory=dict)

    @property
    def length(self) -> float:
        """Mean of its semi-axes across the light, in micrometres."""
        return (self.semi_axes[0] + self.semi_axes[1]) / 2


def swimming_cells(
    shape: tuple[int, int] = (256, 256),
    n_times: int = 40,
    n_cells: int = 6,
    *,
    peak_rad: float = 6.0,
    divisions: int = 1,
    leaving: int = 1,
    entering: int = 1,
    angles_deg: Sequence[float] = EUGLENA_ANGLES_DEG,
    frame_rate_hz: float = FRAME_RATE_HZ,
    optics: Optics | None = None,
    pixel_um: float | None = None,
    first_um: float | tuple[float, float] = 0.0,
    seed: int = 0,
) -> xr.Dataset:
    """Simulate several cells with exact phase, labels and masses.

    Ellipsoids swim at random, bounce off each other when they touch, and turn round at the edge of
    the field. Some divide half way, one after the other, some leave, and some come in.

    Parameters
    ----------
    shape : tuple of int, optional
        Height and width in pixels.
    n_times, n_cells : int, optional
        Number of frames, and of cells at the first of them.
    peak_rad : float, optional
        Phase in the middle of a cell of mean size, radians.
    divisions, leaving, entering : int, optional
        How many cells divide, leave and come in.
    angles_deg : sequence of float, optional
        Viewing angles in degrees.
    frame_rate_hz : float, optional
        Frames per second.
    optics : Optics, optional
        The microscope; default that of the paper.
    pixel_um : float, optional
        Width of a pixel in micrometres. Default: four camera pixels in the sample.
    first_um : float or tuple of float, optional
        Where the first pixel lies in micrometres, or its (y, x). Default 0; for the pixels of a
        reconstruction its ``(y[0], x[0])``.
    seed : int, optional
        Of the random numbers; the same gives the same cells.

    Returns
    -------
    xarray.Dataset
        ``phase`` (exact) and ``wrapped``, dims (time, angle, y, x), radians; ``cells``, the
        number of the cell that takes most of each ray, 0 where there is none; ``dry_mass_pg``,
        dims (time, cell), NaN where a cell is not wholly in the field; ``parent`` (cell), 0
        where a cell came from no other.

    Raises
    ------
    ValueError
        If more cells divide or leave than there are, or they do not fit into the field.

    See Also
    --------
    find_cells : Finds and follows them.

    Examples
    --------
    >>> from napari_phase4d.simulation import swimming_cells
    >>> data = swimming_cells((96, 96), 3, 2, divisions=0, leaving=0, entering=0)
    >>> sorted(set(data["cells"].values.ravel().tolist()))
    [0, 1, 2]
    """
    check_asked(
        shape, n_times, angles_deg, optics,
        frame_rate_hz=frame_rate_hz, pixel_um=pixel_um, peak_rad=peak_rad,
    )  # fmt: skip
    if pixel_um is not None:
        check_positive("pixel_um", pixel_um)
    if not is_count(n_cells):
        msg = f"n_cells must be a number of cells, 1 or more, but is {shown(n_cells)}"
        raise ValueError(msg)
    for name, count in (("divisions", divisions), ("leaving", leaving), ("entering", entering)):
        if count != 0 and not is_count(count):
            msg = f"{name} must be a number of cells, 0 or more, but is {shown(count)}"
            raise ValueError(msg)
    if divisions + leaving > n_cells:
        msg = (
            f"{divisions} cells divide and {leaving} leave, but there are {n_cells} at first; "
            "give more n_cells"
        )
        raise ValueError(msg)
    optics = optics or Optics()
    pixel = 4 * optics.pixel_um if pixel_um is None else pixel_um
    field_um = np.array([shape[1], shape[0]]) * pixel
    rng = np.random.default_rng(seed)
    cells = begun(n_cells, field_um, rng)
    swim(cells, n_times, 1 / frame_rate_hz, field_um, (divisions, leaving, entering), rng)
    delta_n = peak_rad * optics.wavelength_um / (4 * math.pi * SEMI_AXES_UM[2])

    def bodies_at(time: float) -> list[Ellipsoid]:
        t = round(time * frame_rate_hz)
        return [body_of(cell, t, delta_n) for cell in cells if t in cell.places]

    data = phase_stack(
        bodies_at,
        times_s=[t / frame_rate_hz for t in range(n_times)],
        angles_deg=list(angles_deg),
        shape=shape,
        pixel_um=pixel,
        optics=optics,
        attrs={"object": "swimming cells", "boundary": (0, 0), "peak_rad": peak_rad},
        first_um=first_um,
    )
    data["cells"] = xr.DataArray(labels_of(cells, data, delta_n), dims=AXES)
    numbers = [cell.number for cell in cells]
    data = data.assign_coords(cell=numbers)
    data["parent"] = ("cell", [cell.parent for cell in cells])
    data["dry_mass_pg"] = masses_of(cells, data, delta_n, optics, field_um)
    return data


def begun(n_cells: int, field_um: NDArray[np.float64], rng: np.random.Generator) -> list[Cell]:
    """Return cells at random places, none too near to another or to the edge."""
    cells: list[Cell] = []
    margin = 1.3 * SEMI_AXES_UM[0]
    for _ in range(10_000):
        if len(cells) == n_cells:
            return cells
        place = margin + rng.random(2) * (field_um - 2 * margin) - field_um / 2
        size = 1 + VARIETY * rng.uniform(-1, 1)
        near = [math.dist(place, cell.place) for cell in cells]
        if min(near, default=np.inf) > 2.4 * SEMI_AXES_UM[0]:
            axes = tuple(size * axis for axis in SEMI_AXES_UM)
            heading = float(rng.uniform(0, 360))
            cells.append(Cell(len(cells) + 1, place, heading, (axes[0], axes[1], axes[2])))
    msg = f"{n_cells} cells do not fit into a field of {field_um[1]:.0f} x {field_um[0]:.0f} um"
    raise ValueError(msg)


def swim(
    cells: list[Cell],
    n_times: int,
    step_s: float,
    field_um: NDArray[np.float64],
    events: tuple[int, int, int],
    rng: np.random.Generator,
) -> None:
    """Let cells swim; those that divide or come in are added to the list."""
    divisions, leaving, entering = events
    # Of few frames several are due at once.
    dividing = [n_times // 3 + i * n_times // (3 * max(divisions, 1)) for i in range(divisions)]
    for cell in cells[divisions : divisions + leaving]:
        cell.stays = False
        cell.heading = math.degrees(math.atan2(cell.place[1], cell.place[0]))
    coming = [n_times // 4 + i * n_times // (2 * max(entering, 1)) for i in range(entering)]
    for t in range(n_times):
        for _ in range(coming.count(t)):
            cells.append(from_outside(len(cells) + 1, t, field_um, rng))
        for i, due in enumerate(dividing):
            if due == t:
                divide(cells, cells[i], t)
        here = [cell for cell in cells if cell.first <= t <= cell.last]
        for cell in here:
            x, y = cell.place
            cell.places[t] = (float(x), float(y), cell.heading)
            move(cell, step_s, field_um, rng)
        for i, cell in enumerate(here):
            for other in here[i + 1 :]:
                bounce(cell, other, step_s)


def move(
    cell: Cell, step_s: float, field_um: NDArray[np.float64], rng: np.random.Generator
) -> None:
    """Let a cell swim on for a moment."""
    cell.heading += float(rng.normal(0, TURN_DEG)) if cell.stays else 0.0
    way = np.deg2rad(cell.heading)
    cell.place = cell.place + SPEED_UM_PER_S * step_s * np.array([np.cos(way), np.sin(way)])
    beyond = np.abs(cell.place) > field_um / 2 - 1.2 * cell.semi_axes[0]
    outward = beyond & (np.sign(cell.place) == np.sign([np.cos(way), np.sin(way)]))
    if cell.stays and outward.any():
        toward = np.array([np.cos(way), np.sin(way)]) * np.where(outward, -1, 1)
        cell.heading = math.degrees(math.atan2(toward[1], toward[0]))


def bounce(cell: Cell, other: Cell, step_s: float) -> None:
    """Turn two cells away from each other where they touch, but sisters that just divide."""
    if cell.parent and cell.parent == other.parent:
        return
    apart = other.place - cell.place
    distance = float(np.hypot(*apart))
    if distance > BOUNCE * (cell.semi_axes[0] + other.semi_axes[0]):
        return
    direction = math.degrees(math.atan2(apart[1], apart[0]))
    cell.heading, other.heading = direction + 180, direction
    push = apart / max(distance, 1e-6) * SPEED_UM_PER_S * step_s
    cell.place, other.place = cell.place - push, other.place + push


def from_outside(
    number: int, t: int, field_um: NDArray[np.float64], rng: np.random.Generator
) -> Cell:
    """Return a cell that lies just outside of the field and swims in."""
    side = float(rng.choice([-1, 1]))
    place = np.array(
        [side * (field_um[0] / 2 + SEMI_AXES_UM[0]), rng.uniform(-0.3, 0.3) * field_um[1]]
    )
    return Cell(number, place, 180.0 if side > 0 else 0.0, SEMI_AXES_UM, first=t, stays=True)


def divide(cells: list[Cell], parent: Cell, t: int) -> None:
    """Replace a cell by two that swim apart; their volume together is that of the parent."""
    parent.last = t - 1
    size = 0.5 ** (1 / 3)
    axes = (size * parent.semi_axes[0], size * parent.semi_axes[1], size * parent.semi_axes[2])
    for heading in (parent.heading, parent.heading + 180):
        way = np.deg2rad(heading)
        place = parent.place + APART * axes[0] * np.array([np.cos(way), np.sin(way)])
        number = len(cells) + 1
        cells.append(Cell(number, place, heading, axes, first=t, parent=parent.number))


def body_of(cell: Cell, t: int, delta_n: float) -> Ellipsoid:
    """Return a cell's body at a time."""
    x, y, heading = cell.places[t]
    return Ellipsoid((x, y, 0.0), cell.semi_axes, delta_n, rotation("z", heading))


def labels_of(cells: Sequence[Cell], data: xr.Dataset, delta_n: float) -> NDArray[np.int32]:
    """Return the number of the cell that takes most of each ray."""
    labels = np.zeros(data["phase"].shape, dtype=np.int32)
    y, x = (data[axis].values for axis in ("y", "x"))
    y, x = y - len(y) / 2 * (y[1] - y[0]), x - len(x) / 2 * (x[1] - x[0])
    for t in range(labels.shape[0]):
        for a, angle in enumerate(data["angle"].values):
            longest = np.zeros(labels.shape[2:])
            for cell in cells:
                if t not in cell.places:
                    continue
                path = path_length_um(body_of(cell, t, delta_n), angle, y, x)
                nearer = path > longest
                labels[t, a][nearer] = cell.number
                longest[nearer] = path[nearer]
    return labels


def masses_of(
    cells: Sequence[Cell],
    data: xr.Dataset,
    delta_n: float,
    optics: Optics,
    field_um: NDArray[np.float64],
) -> xr.DataArray:
    """Return the dry mass of every cell at every time at which it is wholly in the field."""
    mass = np.full((data.sizes["time"], len(cells)), np.nan)
    # What is seen begins there, while cells lie about the middle of a field that begins at 0.
    first = np.array([float(data[axis][0]) for axis in ("x", "y")])
    for i, cell in enumerate(cells):
        volume = 4 / 3 * math.pi * math.prod(cell.semi_axes)
        radians = 2 * math.pi / optics.wavelength_um * delta_n * volume
        for t, (x, y, _) in cell.places.items():
            inside = np.abs(np.array([x, y]) - first) < field_um / 2 - 1.1 * cell.semi_axes[0]
            if inside.all() and t < len(mass):
                mass[t, i] = optics.dry_mass_pg(radians, 1.0)
    return xr.DataArray(mass, dims=("time", "cell"), attrs={"units": "pg"})
