"""Make the pictures of the documents from the real program: one of the window at every step."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

import napari_phase4d as p4d
from napari_phase4d._napari.demo import let_it_draw, viewer_with_dock, wait_until
from napari_phase4d._napari.session import EUGLENA_SOURCE, YEAST_SOURCE
from napari_phase4d.evaluation import comparison_figure
from napari_phase4d.reproduction import reproduce, write_reproduction
from napari_phase4d.simulation import budding_yeast, with_noise

PICTURES = Path(__file__).parent / "pictures"


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
