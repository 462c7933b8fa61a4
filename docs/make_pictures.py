"""Make the pictures of the documents from the real program: one of the window at every step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import napari_phase4d as p4d
from napari_phase4d._napari.demo import let_it_draw, viewer_with_dock, wait_until
from napari_phase4d._napari.session import EUGLENA_SOURCE, YEAST_SOURCE
from napari_phase4d.evaluation import comparison_figure
from napari_phase4d.holography import Demodulator, Lobe, autofocus, propagate
from napari_phase4d.reproduction import reproduce, write_reproduction
from napari_phase4d.simulation import budding_yeast, with_noise

PICTURES = Path(__file__).parent / "pictures"
#: A measured hologram, which is not part of the repository.
PARAMECIUM = Path(__file__).resolve().parents[2] / "shared/data/offaxis/paramecium_oa_oof.npz"


def main() -> None:
    PICTURES.mkdir(exist_ok=True)
    viewer, dock = viewer_with_dock(show=True)

    def picture(name: str) -> None:
        let_it_draw()
        path = PICTURES / f"{name}.png"
        pixels = viewer.window.screenshot(canvas_only=False, flash=False)
        # 256 colours are enough for a window, and a fringe pattern then takes a third.
        Image.fromarray(pixels[..., :3]).quantize(256).save(path, optimize=True)
        print(path.relative_to(PICTURES.parents[1]))

    def press(action: Callable[[], None]) -> None:
        action()
        wait_until(lambda: not dock.jobs.running)

    try:
        picture("0_empty")
        press(lambda: dock.recording.open_path(EUGLENA_SOURCE))
        dock.show_step(0)
        picture("1_recording")
        press(dock.lobes.find_lobes)
        dock.show_step(1)
        picture("2_lobes")
        dock.show_step(2)
        picture("3_phase")
        press(dock.phase.reconstruct)
        wait_until(lambda: dock.session.scores is not None)
        picture("4_unwrap")
        press(dock.unwrap.run)
        wait_until(lambda: bool(dock.session.confidence))
        dock.presenter.go_to(39, 0)
        picture("5_table")
        pictures_of_the_tabs(viewer, dock, picture, press)
        viewer.layers.clear()
        press(lambda: dock.recording.open_path(YEAST_SOURCE))
        for method in ("laplacian", "region-growing", "dilate-erode"):
            dock.unwrap.methods[method].tick.setChecked(True)
        press(dock.unwrap.run)
        dock.presenter.go_to(11, 5)
        picture("6_yeast")
        press(dock.compare.show_margin)
        picture("7_steps")
        press(dock.compare.show_confidence)
        picture("8_trust")
        dock.compare.difference.value = "less exact"
        picture("9_difference")
        viewer.theme = "light"
        dock.presenter.side_by_side()
        picture("light")
    finally:
        viewer.close()
    figures_of_the_paper()
    figure_of_the_own_method()
    figure_of_refocusing()


def pictures_of_the_tabs(viewer: Any, dock: Any, picture: Any, press: Any) -> None:
    """Show traces, a measured region, and what can be saved."""
    phase = dock.session.reconstruction["phase"]
    low, high = ([float(phase[axis][n]) for axis in ("y", "x")] for n in (35, 55))
    dock.compare.tabs.setCurrentIndex(1)
    regions = dock.presenter.add_regions()
    corners = [low, [low[0], high[1]], high, [high[0], low[1]]]
    regions.add_rectangles([regions.world_to_data(corner) for corner in corners])
    regions.mode = "pan_zoom"
    picture("5_trace")
    dock.compare.tabs.setCurrentIndex(2)
    press(dock.compare.measuring.measure)
    picture("5_measure")
    dock.compare.tabs.setCurrentIndex(3)
    picture("5_save")
    dock.compare.tabs.setCurrentIndex(0)


def figure_of_the_own_method() -> None:
    """Show what the own method finds where T/A and A/T fail: a noisy budding yeast."""
    data = with_noise(budding_yeast(), noise_rad=0.5, seed=1)
    chosen = ["spatial-2d", "temporal-angular", "angular-temporal", "directional-l1"]
    results = p4d.compare(data["wrapped"], chosen).results
    columns = {p4d.METHODS[m].label: results[m] for m in chosen}
    frames = [(0, 0), (6, 0), (11, 5), (18, 5)]
    picture = comparison_figure({"exact": data["phase"], **columns}, frames)
    picture.savefig(PICTURES / "figure_own.png", dpi=90)


def figure_of_refocusing() -> None:
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
    planes = {"as recorded": 0.0, f"refocused by {focus.distance_um / 1000:.2f} mm": None}
    part = tuple(
        slice(int(a * n), int(b * n))
        for n, a, b in zip(field.shape, (0.33, 0.24), (0.92, 0.62), strict=True)
    )
    for column, (title, distance) in enumerate(planes.items()):
        shown = propagate(field, focus.distance_um if distance is None else distance, **light)[
            part
        ]
        axes[f"a{column}"].imshow(
            np.abs(shown), cmap="gray", vmin=0, vmax=np.quantile(np.abs(shown), 0.995)
        )
        steady = np.angle(shown * np.exp(-1j * np.angle(shown.mean())))
        axes[f"p{column}"].imshow(steady, cmap="twilight", vmin=-np.pi, vmax=np.pi)
        axes[f"a{column}"].set_title(title, fontsize=10)
    for name in ("a0", "a1", "p0", "p1"):
        axes[name].set_xticks([])
        axes[name].set_yticks([])
    axes["a0"].set_ylabel("amplitude")
    axes["p0"].set_ylabel("wrapped phase")
    curve = axes["curve"]
    curve.plot(focus.scores["distance"] / 1000, focus.scores, color="C0")
    curve.axvline(focus.distance_um / 1000, color="C3", lw=1)
    curve.set_xlabel("distance (mm)")
    curve.set_title("integrated amplitude (Dubois 2006)", fontsize=10)
    path = PICTURES / "refocusing.png"
    figure.savefig(path, dpi=90)
    print(path.relative_to(PICTURES.parents[1]))


def figures_of_the_paper() -> None:
    with TemporaryDirectory() as folder:
        write_reproduction(reproduce(), folder, movies=False)
        for name in ("figure_2", "figure_4"):
            path = PICTURES / f"{name}.png"
            with Image.open(Path(folder) / path.name) as figure:
                figure.convert("RGB").quantize(256).save(path, optimize=True)
            print(path.relative_to(PICTURES.parents[1]))


if __name__ == "__main__":
    main()
