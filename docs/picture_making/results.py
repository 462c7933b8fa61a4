"""Figures of results: the paper's, the own method's, and refocusing."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

import napari_phase4d as p4d
from napari_phase4d.holography import Demodulator, Focus, Lobe, autofocus, propagate
from napari_phase4d.plotting import comparison_figure
from napari_phase4d.reproduction import reproduce, write_reproduction
from napari_phase4d.simulation import budding_yeast, moving_shape, with_fault, with_noise
from picture_making.saving import PICTURES, save_figure, save_image

#: A measured hologram, which is not part of the repository.
MEASURED = Path(os.environ.get("PHASE4D_MEASURED", PICTURES.parents[2] / "shared" / "data"))
PARAMECIUM = MEASURED / "offaxis/paramecium_oa_oof.npz"
#: The last frame before the pause of a paused recording, and the first after it.
BOTH_SIDES = (3, 4)


def figures_of_the_paper(wanted: set[str]) -> None:
    """Draw the paper's figures of results from this program's."""
    with TemporaryDirectory() as folder:
        write_reproduction(reproduce(), folder, movies=False)
        for name in sorted(wanted):
            with Image.open(Path(folder) / f"{name}.png") as figure:
                save_image(figure, name)


def figure_of_the_own_method(wanted: set[str]) -> None:
    """Show what the own method finds where T/A and A/T fail: a noisy budding yeast."""
    data = with_noise(budding_yeast(), noise_rad=0.5, seed=1)
    chosen = ["spatial-2d", "temporal-angular", "angular-temporal", "directional-l1"]
    results = p4d.compare(data["wrapped"], chosen).results
    columns = {p4d.METHODS[m].label: results[m] for m in chosen}
    frames = [(0, 0), (6, 0), (11, 5), (18, 5)]
    # Pixels as they are: shades between the colours of noise would make a large file.
    with rc_context({"image.interpolation": "nearest"}):
        figure = comparison_figure({"exact": data["phase"], **columns}, frames)
    save_figure(figure, *wanted)


def figure_of_a_pause(wanted: set[str]) -> None:
    """Show the frames on both sides of a pause, and who is off by how many turns after it."""
    data = with_fault(moving_shape("vacuole"), "pause")
    exact, wrapped = data["phase"][:, 0], data["wrapped"][:, 0]
    figure = Figure(figsize=(9.5, 6.2), layout="constrained")
    axes = figure.subplots(2, 3)
    for axis, time, words in zip(
        axes[0], BOTH_SIDES, ("before the pause", "after it"), strict=False
    ):
        drawn = axis.imshow(wrapped[time], cmap="twilight", vmin=-np.pi, vmax=np.pi)
        axis.set_title(f"wrapped phase {words}", fontsize=10)
    figure.colorbar(drawn, ax=axes[0, 1], label="rad", shrink=0.8)
    before, after = BOTH_SIDES
    drawn = axes[0, 2].imshow(exact[after] - exact[before], cmap="viridis")
    axes[0, 2].set_title("exact change in between", fontsize=10)
    figure.colorbar(drawn, ax=axes[0, 2], label="rad", shrink=0.8)
    for axis, method in zip(
        axes[1], ("spatial-2d", "temporal-angular", "directional-l1"), strict=True
    ):
        found = p4d.unwrap(data["wrapped"], method)[:, 0]
        off = np.round((found - exact)[after] / (2 * np.pi))
        drawn = axis.imshow(off, cmap="RdBu_r", vmin=-3, vmax=3)
        axis.set_title(f"{p4d.METHODS[method].label}, after it", fontsize=10)
    figure.colorbar(drawn, ax=axes[1, 2], ticks=range(-3, 4), label="turns off", shrink=0.8)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    save_figure(figure, *wanted)


def figure_of_refocusing(wanted: set[str]) -> None:
    """Show a measured paramecium before and after refocusing, and the curve that found it.

    The hologram is paramecium_oa_oof of PyHoloscope (M. Hughes, MIT licence), with the wavelength
    and pixel of its example.
    """
    if not PARAMECIUM.exists():
        print(f"{PARAMECIUM.name} is not here: the figure of refocusing is left as it was")
        return
    with np.load(PARAMECIUM) as file:
        hologram, empty = file["data"], file["bg_data"]
    (found,) = p4d.find_lobes(p4d.open_recording(hologram), 1)
    demodulate = Demodulator(hologram.shape, [Lobe(found.carrier, 0.06)])
    field = demodulate(hologram)[0] * np.exp(-1j * np.angle(demodulate(empty)[0]))
    light = {"wavelength_um": 0.63, "pixel_um": demodulate.pixel_ratio, "medium_index": 1.0}
    focus = autofocus(field, **light, objects="phase", span_um=2000.0)
    figure = Figure(figsize=(9.5, 5.6), layout="constrained")
    names = [["a0", "a1", "curve"], ["p0", "p1", "curve"]]
    axes = figure.subplot_mosaic(names, width_ratios=(1, 1, 1.5))  # type: ignore[arg-type]
    planes = {
        "as recorded": field,
        f"refocused by {focus.distance_um / 1000:.2f} mm": propagate(
            field, focus.distance_um, **light
        ),
    }
    for column, (title, shown) in enumerate(planes.items()):
        show_field(axes[f"a{column}"], axes[f"p{column}"], paramecium_in(shown))
        axes[f"a{column}"].set_title(title, fontsize=10)
    axes["a0"].set_ylabel("amplitude")
    axes["p0"].set_ylabel("wrapped phase")
    show_curve(axes["curve"], focus)
    save_figure(figure, *wanted)


def paramecium_in(field: NDArray[Any]) -> NDArray[Any]:
    """Return the part of the field in which the animal is."""
    rows, columns = (
        slice(int(a * n), int(b * n))
        for n, a, b in zip(field.shape, (0.33, 0.24), (0.92, 0.62), strict=True)
    )
    return field[rows, columns]


def show_field(amplitude: Any, phase: Any, field: NDArray[Any]) -> None:
    """Draw amplitude and wrapped phase of a field."""
    bright = np.quantile(np.abs(field), 0.995)
    amplitude.imshow(np.abs(field), cmap="gray", vmin=0, vmax=bright)
    steady = np.angle(field * np.exp(-1j * np.angle(field.mean())))
    phase.imshow(steady, cmap="twilight", vmin=-np.pi, vmax=np.pi)
    for axis in (amplitude, phase):
        axis.set_xticks([])
        axis.set_yticks([])


def show_curve(axis: Any, focus: Focus) -> None:
    """Draw how sharp the field is at each distance, and which was taken."""
    axis.plot(focus.scores["distance"] / 1000, focus.scores, color="C0")
    axis.axvline(focus.distance_um / 1000, color="C3", lw=1)
    axis.set_xlabel("distance (mm)")
    axis.set_title("integrated amplitude (Dubois 2006)", fontsize=10)
