"""How far off the surface is that is taken off the empty field, by how much an object covers.

On a grid of objects, and on random ones. The clues of `napari_phase4d.holography.surfaces` were
fitted to other objects of `SHAPES`, and to none of `OTHER_SHAPES`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from tables import heading, line

from napari_phase4d.holography import Lobe
from napari_phase4d.holography.background import Surface
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.simulation import multiplexed_video

SIDE = 256
LOBE = Lobe((0.21, 0.19), 0.089)
COVERS = (0.1, 0.25, 0.5, 0.65, 0.75, 0.85, 0.92)
#: Phase of an object by the distance from its middle, 1 at its edge.
OBJECTS = {
    "ellipsoid": lambda r: np.sqrt(np.maximum(1 - r**2, 0)),
    "paraboloid": lambda r: np.maximum(1 - r**2, 0),
    "plate": lambda r: 1 / (1 + np.exp((np.minimum(r, 2) - 1) / 0.02)),
    "hill": lambda r: np.cos(np.pi / 2 * np.minimum(r, 1)) ** 2,
}
PLACES = {"middle": (0.0, 0.0), "off": (0.3, 0.4), "corner": (0.9, 0.9)}
#: What is fitted, and the curvature of the field in radians at the corner.
FITTED = (("tilt", 1, 0.0), ("curvature", 2, 4.0), ("curvature", 2, 12.0))


def seen(kind: str, cover: float, place: str, peak_rad: float, rad: float) -> np.ndarray:
    """Return the field of an object that covers a share of the view."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, SIDE),) * 2, indexing="ij")
    away = np.hypot(y - PLACES[place][0], x - PLACES[place][1])
    phase = peak_rad * OBJECTS[kind](away / np.quantile(away, cover))
    return field_of(phase, curvature_rad=rad)


def field_of(phase: np.ndarray, **camera: float) -> np.ndarray:
    """Return the field that a camera sees of a phase."""
    video = multiplexed_video(
        xr.DataArray(
            phase[None, None].astype(np.float32),
            dims=("time", "angle", "y", "x"),
            coords={"time": [0.0], "angle": [0.0]},
        ),
        carriers=[LOBE.carrier],
        **camera,
    )
    return Demodulator(video.frame_shape, [LOBE])(video.raw_frame(0))[0]


def truth(shape: tuple[int, ...], rad: float) -> np.ndarray:
    y, x = places(shape)
    return rad * (y**2 + x**2) / 2


def places(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return y and x of the pixels of a field, from -1 to 1, as a column and a row."""
    y, x = (-1 + 2 * ((np.arange(n) + 0.5) * SIDE / n - 0.5) / (SIDE - 1) for n in shape)
    return y[:, None], x[None, :]


def over(values: np.ndarray) -> np.ndarray:
    return np.maximum(values, 0)


def bump(r: np.ndarray) -> np.ndarray:
    return np.cos(np.pi / 2 * np.minimum(r, 1)) ** 2


def dome(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.sqrt(over(1 - u**2 - v**2))


Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]
#: Phase of an object by the place in it, from -1 to 1; its peak is about 1.
SHAPES: dict[str, Shape] = {
    **{name: lambda u, v, f=f: f(np.hypot(u, v)) for name, f in OBJECTS.items()},  # type: ignore[misc]
    "superellipse": lambda u, v: np.sqrt(over(1 - u**4 - v**4)),
    "bell": lambda u, v: over(1 - u**2 - v**2) ** 2,
    "two cells": lambda u, v: dome(u - 0.6, 1.2 * v) + dome(1.1 * (u + 0.6), v),
    "ring": lambda u, v: over(1 - ((np.hypot(u, v) - 0.65) / 0.35) ** 2),
    "tilted hill": lambda u, v: bump(np.hypot(u, v)) * (1 + u / 2),
    "gaussian": lambda u, v: np.exp(-3 * (u**2 + v**2)),
    "cone": lambda u, v: over(1 - np.hypot(u, v)),
    "tilted ellipsoid": lambda u, v: dome(u, v) * (1 + u / 2),
}
OTHER_SHAPES: dict[str, Shape] = {
    "cosine": lambda u, v: np.sqrt(bump(np.hypot(u, v))),
    "cell with nucleus": lambda u, v: dome(u, v) + 0.4 * over(1 - ((u - 0.2) ** 2 + v**2) * 10),
    "soft cell": lambda u, v: 1 / (1 + np.exp((np.minimum(np.hypot(u, v), 2) - 1) / 0.12)),
    "flat gaussian": lambda u, v: np.exp(-3 * (u**4 + v**4)),
    "three hills": lambda u, v: (
        bump(np.hypot(u - 0.6, v) / 0.8)
        + bump(np.hypot(u + 0.3, v - 0.5) / 0.8)
        + bump(np.hypot(u + 0.4, v + 0.6) / 0.8)
    ),
    "sech": lambda u, v: 1 / np.cosh(3 * np.hypot(u, v)) ** 2,
    "kidney": lambda u, v: dome(u, v + 0.4 * u**2),
    "slab": lambda u, v: over(1 - v**2) * np.ones_like(u),
}
#: An object ends where it is lower than this share of its peak.
END = 0.05


@dataclass(frozen=True)
class Bent:
    """The field of a random object on a random surface.

    Parameters
    ----------
    cover : float
        The share of the view that the object covers.
    field : ndarray of shape (y, x)
        What is seen.
    surface : ndarray of the same shape
        The surface without the object, in radians.
    """

    cover: float
    field: np.ndarray
    surface: np.ndarray

    def outcome(self) -> tuple[bool, bool, bool]:
        """Return whether a curvature is refused, is off by more than 0.3 rad, and is doubted."""
        fit = Surface("powers", 2, self.field.shape).fit(self.field)
        off = float(np.std(fit.surface - self.surface))
        return bool(fit.doubt), off > 0.3, fit.unsure


def bent(seed: int, shapes: dict[str, Shape]) -> Bent:
    """Draw an object of 1.5 to 15 rad, a curvature up to 15 rad, astigmatism, tilt and noise.

    One in two objects lies anywhere or in a corner, the others near the middle.
    """
    rng = np.random.default_rng(seed)
    shape, cover = shapes[str(rng.choice(list(shapes)))], COVERS[seed % len(COVERS)]
    y, x = np.meshgrid(*(np.linspace(-1, 1, SIDE),) * 2, indexing="ij")
    reach = (0.0, 0.45, 1.0)[min(int(rng.integers(4)), 2)]
    middle, turn = rng.uniform(-reach, reach, 2), rng.uniform(0, np.pi)
    aspect = float(np.exp(rng.normal(0, 0.2)))
    u = ((y - middle[0]) * np.cos(turn) + (x - middle[1]) * np.sin(turn)) * aspect
    v = ((x - middle[1]) * np.cos(turn) - (y - middle[0]) * np.sin(turn)) / aspect
    least, most = 0.02, 8.0
    for _ in range(25):
        size = float(np.sqrt(least * most))
        phase = shape(u / size, v / size)
        least, most = (size, most) if (phase > END).mean() < cover else (least, size)
    phase *= float(np.exp(rng.uniform(np.log(1.5), np.log(15)))) / max(phase.max(), END)
    rad, skew, tilt = rng.uniform(-5, 15), rng.normal(0, 1, 2), rng.normal(0, 1.5, 2)

    def surface(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        bend = rad * (y**2 + x**2) / 2 + skew[0] * y * x + skew[1] * (y**2 - x**2) / 2
        return bend + tilt[0] * y + tilt[1] * x

    field = field_of(
        phase + surface(y, x),
        bits=int(rng.choice((8, 12))),
        full_well_electrons=float(rng.choice((2500, 10000))),
        seed=seed,
    )
    return Bent(cover, field, surface(*places(field.shape)))


def levelling() -> None:
    """Tilt and curvature round an object, over the whole view, against exact truth."""
    columns = " ".join(f"{100 * cover:.0f}%" for cover in COVERS)
    heading(
        "Levelling: rad rms that the fitted surface is off, where the object covers so much of "
        "the view ('-': refused as doubtful, '?': told that it may be the object's)",
        f"object place peak fitted curvature {columns}",
    )
    wrong = {cover: [0, 0, 0, 0] for cover in COVERS}
    for kind in OBJECTS:
        for place in PLACES:
            for peak in (3.0, 6.0, 12.0):
                for name, order, rad in FITTED:
                    cells = []
                    for cover in COVERS:
                        field = seen(kind, cover, place, peak, rad)
                        fit = Surface("powers", order, field.shape).fit(field)
                        off = float(np.std(fit.surface - truth(field.shape, rad)))
                        unsure = "?" if fit.unsure else ""
                        cells.append("-" if fit.doubt else f"{off:.2f}{unsure}")
                        if order == 2:
                            bad = 2 if fit.unsure else 1
                            sort = 3 if fit.doubt else bad if off > 0.3 else 0
                            wrong[cover][sort] += 1
                    line(kind, place, peak, name, rad, *cells)
    columns = "covered right off-by-more-than-0.3-rad-in-silence off-but-told refused"
    heading("Curvature over all of them", columns)
    for cover, counts in wrong.items():
        line(f"{100 * cover:.0f}%", *counts)
    random_objects("shapes that the clues were fitted to", SHAPES, range(30000, 30350))
    random_objects("other shapes", OTHER_SHAPES, range(40000, 40350))


def random_objects(words: str, shapes: dict[str, Shape], seeds: range) -> None:
    """How often a curvature is wrong in silence, and how often a right one is doubted."""
    columns = "covered refused right right-but-doubted off-but-told off-in-silence"
    heading(f"Curvature round random objects, {words}", columns)
    counts = {cover: [0, 0, 0, 0, 0] for cover in COVERS}
    for case in (bent(seed, shapes) for seed in seeds):
        refused, off, doubted = case.outcome()
        found = counts[case.cover]
        if refused:
            found[0] += 1
        elif off:
            found[3 if doubted else 4] += 1
        else:
            found[1] += 1
            found[2] += doubted
    for cover, found in counts.items():
        line(f"{100 * cover:.0f}%", *found)


if __name__ == "__main__":
    levelling()
