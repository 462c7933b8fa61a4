"""What a multiplexed hologram holds: fringes, a spectrum with names, and two wrapped phases."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe, stray_terms
from napari_phase4d.sample import euglena_sample
from picture_making.saving import save_figure

#: The frame that is shown, and the corner and size of a part of it in which fringes are seen.
FRAME, CORNER, DETAIL = 20, (215, 215), 72
VIEW_COLOURS = ("#56b4e9", "#e69f00")
GHOST = "#e8e8e8"
#: Of the spectrum, this share of the weakest frequencies is black.
DARKEST = 0.6


def figure_of_off_axis(wanted: set[str]) -> None:
    """Draw hologram, detail, spectrum and both views of one frame of the sample."""
    sample = euglena_sample()
    recording = sample.recording
    lobes = p4d.find_lobes(recording, 2, angles_deg=sample.angles_deg)
    data = p4d.reconstruct(recording, lobes)
    figure = Figure(figsize=(10.5, 5.4), layout="constrained")
    names = [
        ["whole", "spectrum", "spectrum", "view 1"],
        ["detail", "spectrum", "spectrum", "view 2"],
    ]
    axes = figure.subplot_mosaic(names)
    show_hologram(axes["whole"], axes["detail"], np.asarray(recording.raw_frame(FRAME)))
    show_spectrum(axes["spectrum"], p4d.power_spectrum(recording), lobes)
    for number, lobe in enumerate(lobes):
        image = show_view(axes[f"view {number + 1}"], data["phase"][FRAME, number], number, lobe)
    bar = figure.colorbar(image, ax=[axes["view 1"], axes["view 2"]], shrink=0.6)
    bar.set_ticks([-np.pi, 0, np.pi], labels=["−π", "0", "π"])
    save_figure(figure, *wanted)


def show_hologram(whole: Any, detail: Any, hologram: np.ndarray) -> None:
    """Draw what the camera saw, and a part of it at its own resolution."""
    low, high = np.quantile(hologram, (0.001, 0.999))
    scale = {"cmap": "gray", "vmin": low, "vmax": high}
    whole.imshow(hologram, **scale)
    whole.set_title("what the camera sees", fontsize=10)
    top, left = CORNER
    part = hologram[top : top + DETAIL, left : left + DETAIL]
    extent = (left, left + DETAIL, top + DETAIL, top)
    detail.imshow(part, extent=extent, interpolation="nearest", **scale)
    detail.set_title("its fringes, magnified", fontsize=10)
    whole.indicate_inset([left, top, DETAIL, DETAIL], edgecolor="#ff5a4d", alpha=1, lw=1.5)
    detail.spines[:].set_color("#ff5a4d")
    detail.spines[:].set_linewidth(1.5)
    for axis in (whole, detail):
        axis.set_xticks([])
        axis.set_yticks([])


def show_spectrum(axis: Any, spectrum: xr.DataArray, lobes: list[Lobe]) -> None:
    """Draw the power spectrum with the name of every term."""
    power = 10 * np.log10(np.maximum(spectrum.values, np.finfo(np.float32).tiny))
    ky, kx = spectrum["ky"].values, spectrum["kx"].values
    low, high = np.quantile(power, (DARKEST, 0.9999))
    extent = (kx[0], kx[-1], ky[-1], ky[0])
    axis.imshow(power, cmap="gray", vmin=low, vmax=high, extent=extent)
    for term in stray_terms(lobes):
        centres = {term.centre, (-term.centre[0], -term.centre[1])}
        for centre in centres:
            circle(axis, centre, term.radius, GHOST, ":")
            name(axis, centre, term.label, GHOST)
    for number, lobe in enumerate(lobes):
        colour, (y, x) = VIEW_COLOURS[number], lobe.carrier
        circle(axis, (y, x), lobe.radius, colour, "-")
        circle(axis, (-y, -x), lobe.radius, colour, "--")
        name(axis, (y, x), f"lobe of\nview {number + 1}", colour, lobe.radius)
        name(axis, (-y, -x), f"conjugate\nof view {number + 1}", colour, lobe.radius)
    axis.set_xlim(-0.5, 0.5)
    axis.set_ylim(0.5, -0.5)
    axis.set_xlabel("kx (cycles per camera pixel)")
    axis.set_ylabel("ky")
    axis.set_title("its spectrum (logarithmic)", fontsize=10)


def circle(axis: Any, centre: tuple[float, float], radius: float, colour: str, line: str) -> None:
    """Draw a circle round a frequency (ky, kx)."""
    y, x = centre
    axis.add_patch(Circle((x, y), radius, fill=False, ec=colour, ls=line, lw=1.6))


def name(
    axis: Any, centre: tuple[float, float], words: str, colour: str, radius: float = 0.0
) -> None:
    """Write a name on a frequency (ky, kx), or outside of a circle round it."""
    y, x = centre
    edge = [withStroke(linewidth=2.5, foreground="black")]
    side = "center" if not radius else "left" if x > 0 else "right"
    place = x + (radius + 0.015 if x > 0 else -radius - 0.015) * bool(radius)
    look = {"ha": side, "va": "center", "fontsize": 9, "path_effects": edge}
    axis.text(place, y, words, color=colour, **look)


def show_view(axis: Any, phase: xr.DataArray, number: int, lobe: Lobe) -> Any:
    """Draw the wrapped phase of a view in the colour of its circle."""
    image = axis.imshow(phase, cmap="twilight_shifted", vmin=-np.pi, vmax=np.pi)
    axis.set_title(f"view {number + 1} ({lobe.angle_deg:g}°): wrapped phase", fontsize=10)
    axis.set_xticks([])
    axis.set_yticks([])
    axis.spines[:].set_color(VIEW_COLOURS[number])
    axis.spines[:].set_linewidth(2.5)
    return image
