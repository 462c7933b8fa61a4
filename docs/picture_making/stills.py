"""The window at every step, and what its buttons show."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tifffile
from numpy.typing import NDArray

from napari_phase4d._napari.demo import let_it_draw, viewer_with_dock, wait_until
from napari_phase4d.sample import CELLS_SOURCE, EUGLENA_SOURCE, YEAST_SOURCE, open_sample
from picture_making.saving import save_image, window_image

#: Enough for a window.
COLOURS = 255
#: Frames a second that the camera of the picture of a live recording writes.
RATE_HZ = 3.0


class Stills:
    """A window, and the pictures of it that are wanted.

    Parameters
    ----------
    wanted : set of str
        Names of the pictures to save; the others are passed over.
    """

    def __init__(self, wanted: set[str]) -> None:
        self.wanted = wanted
        self.viewer, self.dock = viewer_with_dock(show=True)

    def picture(self, name: str) -> None:
        """Save the window as it is now, if that is wanted."""
        if name in self.wanted:
            let_it_draw()
            save_image(window_image(self.viewer), name, COLOURS)

    def press(self, action: Callable[[], None]) -> None:
        """Do what a button does, and wait for it."""
        action()
        wait_until(lambda: not self.dock.jobs.running)
        if self.dock.status.property("wrong"):
            msg = f"the window says: {self.dock.status.text()}"
            raise RuntimeError(msg)


def stills_of_the_euglena(wanted: set[str]) -> None:
    """Go through all steps with the sample recording."""
    stills = Stills(wanted)
    dock, picture, press = stills.dock, stills.picture, stills.press
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
        picture("5_table")
        dock.presenter.go_to(39, 0)
        stills_of_the_tabs(stills)
    finally:
        stills.viewer.close()


def stills_of_the_tabs(stills: Stills) -> None:
    """Show the mass of the whole cell, traces, a measured region, and what can be saved."""
    dock: Any = stills.dock
    dock.compare.tabs.setCurrentIndex(2)
    stills.press(dock.compare.measuring.measure)
    stills.picture("tutorial_6_dry_mass")
    if "tutorial_6_dry_mass" in stills.wanted:
        tell_masses(dock.compare.measuring)
    phase = dock.session.reconstruction["phase"]
    low, high = ([float(phase[axis][n]) for axis in ("y", "x")] for n in (35, 55))
    dock.compare.tabs.setCurrentIndex(1)
    regions = dock.presenter.add_regions()
    corners = [low, [low[0], high[1]], high, [high[0], low[1]]]
    regions.add_rectangles([regions.world_to_data(corner) for corner in corners])
    regions.mode = "pan_zoom"
    stills.picture("5_trace")
    dock.compare.tabs.setCurrentIndex(2)
    stills.press(dock.compare.measuring.measure)
    stills.picture("5_measure")
    dock.compare.tabs.setCurrentWidget(dock.compare.share)
    stills.picture("5_save")


def tell_masses(measuring: Any) -> None:
    """Print the figures that the tutorial gives, for whoever renews it."""
    table = measuring.measured
    for angle, rows in table.groupby("angle (deg)"):
        mass = rows["dry mass (pg)"]
        print(f"  dry mass at {angle:g}°: {mass.min():.1f} to {mass.max():.1f} pg")


def stills_of_the_cells(wanted: set[str]) -> None:
    """Show each cell by itself."""
    stills = Stills(wanted)
    dock = stills.dock
    try:
        stills.press(lambda: dock.recording.open_path(CELLS_SOURCE))
        stills.press(dock.lobes.find_lobes)
        stills.press(dock.phase.reconstruct)
        dock.session.update(methods=("temporal-angular", "directional-l1"))
        stills.press(dock.unwrap.run)
        dock.show_step(4)
        dock.compare.tabs.setCurrentWidget(dock.compare.cells)
        stills.press(dock.compare.cells.find)
        dock.presenter.go_to(20, 0)
        dock.compare.cells.choose(2)
        dock.scroll.ensureWidgetVisible(dock.compare.cells.save)
        wait_until(lambda: bool(dock.session.confidence))
        stills.picture("5_cells")
        print(dock.session.cells.summary.to_string())
    finally:
        stills.viewer.close()


def still_of_a_live_recording(wanted: set[str]) -> None:
    """Show the newest frame while a camera writes, and where that is stopped."""
    stills, over = Stills(wanted), threading.Event()
    dock: Any = stills.dock
    frames = open_sample(EUGLENA_SOURCE).holograms.values
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "cell_01"
        camera = threading.Thread(target=play_the_camera, args=(frames, folder, over))
        try:
            dock.session.update(angles_deg=(-7, 21), n_views=2, methods=("temporal-angular",))
            dock.recording.live.watch(folder, Path(place) / "cell_01_phase")
            camera.start()
            newest: list[int] = [-1]
            dock.session.live_changed.connect(lambda view: newest.append(view.index))
            wait_until(lambda: newest[-1] >= len(frames) - 6)
            stills.picture("live")
            dock.recording.live.finish()
            wait_until(lambda: not dock.jobs.running)
        finally:
            over.set()
            stills.viewer.close()
            camera.join()


def play_the_camera(frames: NDArray[Any], folder: Path, over: threading.Event) -> None:
    """Write frames into a folder as a camera does."""
    folder.mkdir()
    for number, frame in enumerate(frames):
        tifffile.imwrite(folder / f"frame_{number:04}.tif", frame)
        if over.wait(1 / RATE_HZ):
            return


def stills_of_the_yeast(wanted: set[str]) -> None:
    """Show what step 5 has for methods that differ, with the sample phase."""
    stills = Stills(wanted)
    dock, picture, press = stills.dock, stills.picture, stills.press
    try:
        press(lambda: dock.recording.open_path(YEAST_SOURCE))
        for method in ("laplacian", "region-growing", "dilate-erode"):
            dock.unwrap.methods[method].tick.setChecked(True)
        press(dock.unwrap.run)
        wait_until(lambda: bool(dock.session.confidence))
        picture("6_yeast")
        press(dock.compare.show_margin)
        picture("7_steps")
        press(dock.compare.show_confidence)
        picture("8_trust")
        press(dock.compare.show_difference)
        picture("9_difference")
        stills.viewer.theme = "light"
        dock.presenter.side_by_side()
        picture("light")
    finally:
        stills.viewer.close()
