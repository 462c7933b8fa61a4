"""How far off the surface is that is taken off the empty field, by how much an object covers."""

from __future__ import annotations

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
    video = multiplexed_video(
        xr.DataArray(
            phase[None, None].astype(np.float32),
            dims=("time", "angle", "y", "x"),
            coords={"time": [0.0], "angle": [0.0]},
        ),
        carriers=[LOBE.carrier],
        curvature_rad=rad,
    )
    return Demodulator(video.frame_shape, [LOBE])(video.raw_frame(0))[0]


def truth(shape: tuple[int, ...], rad: float) -> np.ndarray:
    y, x = (-1 + 2 * np.arange(n) * (SIDE / n) / (SIDE - 1) for n in shape)
    return rad * (y[:, None] ** 2 + x[None, :] ** 2) / 2


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
    heading(
        "Curvature over all of them",
        "covered right off-by-more-than-0.3-rad-in-silence off-but-told refused",
    )
    for cover, counts in wrong.items():
        line(f"{100 * cover:.0f}%", *counts)


if __name__ == "__main__":
    levelling()
