"""How late a frame is on screen that a camera writes, and how long the window stalls meanwhile.

Run it as ``python benchmarks/live_window.py [frames] [frames a second]`` where there is a display.
A short recording is watched first, which loads and compiles. The times are those of the wall: on a
machine that has other work to do they say as much of that.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import napari
import numpy as np
import tifffile
from qtpy.QtCore import QTimer
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d

FRAME, SHORT, WARM = (512, 512), 24, 40
METHODS = ("temporal-angular",)


def write(short: Path, folder: Path, rate: float, number: int) -> None:
    """Write frames at a rate, each as a file; to and fro, as long as is asked for."""
    frames = np.load(short)
    there_and_back = [*range(SHORT), *range(SHORT - 2, 0, -1)]
    folder.mkdir()
    began = time.monotonic()
    for index in range(number):
        time.sleep(max(0.0, began + index / rate - time.monotonic()))
        frame = frames[there_and_back[index % len(there_and_back)]]
        tifffile.imwrite(folder / f"frame_{index:05}.tif", frame)


def watched(viewer: Any, dock: Any, place: Path, number: int, rate: float) -> None:
    """Watch a recording that is written by another process, and print how that went."""
    folder, app = place / f"camera_{number}", QApplication.instance()
    newest, lost, late, gaps, last = [-1], [0], {}, [], [time.monotonic()]

    def taken(view: Any) -> None:
        newest[0], lost[0] = view.index, view.status.lost

    def painted(_: Any) -> None:
        index = newest[0]
        if index >= 0 and index not in late:
            file = folder / f"frame_{index:05}.tif"
            late[index] = time.time() - file.stat().st_mtime

    def ticked() -> None:
        now = time.monotonic()
        gaps.append(now - last[0])
        last[0] = now

    dock.session.live_changed.connect(taken)
    draw = viewer.window._qt_viewer.canvas._scene_canvas.events.draw
    draw.connect(painted, position="last")
    dock.recording.live.watch(folder, place / f"out_{number}", frames=number)
    told = (str(place / "short.npy"), str(folder), str(rate), str(number))
    writer = subprocess.Popen([sys.executable, __file__, *told])
    timer = QTimer()
    timer.timeout.connect(ticked)
    timer.start(0)
    wait_while(app, lambda: dock.jobs.running)
    timer.stop()
    writer.wait()
    draw.disconnect(painted)
    dock.session.live_changed.disconnect(taken)
    behind_the_first = [late[i] for i in late if i >= number // 8]
    print(
        f"{number} frames at {rate:g} a second: {lost[0]} dropped, {len(late)} pictures, "
        f"late {np.median(behind_the_first):.2f} s (median), "
        f"{np.quantile(behind_the_first, 0.95):.2f} s (95 of 100), {max(behind_the_first):.2f} s "
        f"(at most); longest stalls {', '.join(f'{s:.2f}' for s in sorted(gaps)[:-5:-1])} s"
    )


def wait_while(app: Any, busy: Callable[[], bool]) -> None:
    """Let the window go on."""
    while busy():
        app.processEvents()
        time.sleep(0.0005)


def main(number: int, rate: float) -> None:
    """Watch twice: to warm up, and to measure."""
    with tempfile.TemporaryDirectory(prefix="phase4d-bench-") as folder:
        place = Path(folder)
        exact = p4d.simulation.swimming_euglena(FRAME, SHORT, pixel_um=5.2 / 60, peak_rad=8)
        video = p4d.simulation.multiplexed_video(exact["phase"])
        np.save(place / "short.npy", video.holograms.values)
        viewer = napari.Viewer()
        viewer.window.resize(1280, 720)
        _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
        dock.session.update(n_views=2, methods=METHODS)
        watched(viewer, dock, place, WARM, rate)
        watched(viewer, dock, place, number, rate)
        viewer.close()


if __name__ == "__main__":
    if len(sys.argv) > 3:
        write(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]))
    else:
        numbers = [*sys.argv[1:], *("300", "30")[len(sys.argv) - 1 :]]
        main(int(numbers[0]), float(numbers[1]))
