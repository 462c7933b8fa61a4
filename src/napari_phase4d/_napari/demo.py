"""The demo: napari with the sample loaded, and a picture of the whole window."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from napari_phase4d._napari.dock import Phase4DDock
from napari_phase4d.io import PROGRAM
from napari_phase4d.sample import EUGLENA_SOURCE

__all__ = ["open_demo", "picture_of_the_window"]

#: Longest that one step of the demo may take, in seconds.
PATIENCE_S = 120.0


def open_demo() -> None:
    """Open napari with the dock and the sample video, and wait for the user."""
    import napari

    _, dock = viewer_with_dock(show=True)
    dock.recording.open_path(EUGLENA_SOURCE)
    napari.run()
    let_work_end()


def picture_of_the_window(path: Path) -> Path:
    """Drive the dock through all five steps on the sample and save a picture of the window.

    Raises
    ------
    RuntimeError
        If a step fails or does not end.
    """
    viewer, dock = viewer_with_dock(show=True)
    try:
        for press in (
            partial(dock.recording.open_path, EUGLENA_SOURCE),
            dock.lobes.find_lobes,
            dock.phase.reconstruct,
            dock.unwrap.run,
        ):
            press()
            wait_until(lambda: not dock.jobs.running)
            if dock.status.property("wrong"):
                msg = f"the demo stopped: {dock.status.text()}"
                raise RuntimeError(msg)
        dock.presenter.go_to(39, 0)
        let_it_draw()
        path.parent.mkdir(parents=True, exist_ok=True)
        viewer.window.screenshot(path=str(path), canvas_only=False, flash=False)
    finally:
        viewer.close()
        let_work_end()
    return path


def viewer_with_dock(*, show: bool) -> tuple[Any, Phase4DDock]:
    """Return a new viewer with the dock at its right side."""
    import napari

    viewer = napari.Viewer(title=PROGRAM, show=show)
    viewer.window.resize(1280, 720)
    _, dock = viewer.window.add_plugin_dock_widget(PROGRAM, "Phase 4D")
    return viewer, dock


def wait_until(ready: Callable[[], bool]) -> None:
    """Let the window work until something has happened."""
    from qtpy.QtWidgets import QApplication

    end = time.monotonic() + PATIENCE_S
    while not ready():
        QApplication.processEvents()
        time.sleep(0.01)
        if time.monotonic() > end:
            msg = f"the demo took longer than {PATIENCE_S:g} s"
            raise RuntimeError(msg)


def let_work_end() -> None:
    """Wait for work that a window stopped when it closed: the program must not end before it."""
    from qtpy.QtCore import QThreadPool

    QThreadPool.globalInstance().waitForDone(int(1000 * PATIENCE_S))


def let_it_draw() -> None:
    """Give the window time to lay itself out and draw."""
    end = time.monotonic() + 0.5
    wait_until(lambda: time.monotonic() > end)
