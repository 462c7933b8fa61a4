"""How long napari takes to start, with and without the dock."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator

STARTS = 5
START = """
import time
import napari
from qtpy.QtWidgets import QApplication
viewer = napari.Viewer()
{dock}
while not any(w.windowHandle() is not None and w.windowHandle().isExposed()
              for w in QApplication.topLevelWidgets()):
    QApplication.processEvents()
QApplication.processEvents()
print("ready", time.process_time(), flush=True)
"""
DOCK = 'viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")'


def start_lines() -> Iterator[str]:
    """Start napari with and without the dock, in turn, each time in a new process."""
    scripts = (START.format(dock=""), START.format(dock=DOCK))
    for script in scripts:
        seconds_to_start(script)
    alone, both = [], []
    for _ in range(STARTS):
        alone.append(seconds_to_start(scripts[0]))
        both.append(seconds_to_start(scripts[1]))
    (wall, cpu), (wall_both, cpu_both) = medians(alone), medians(both)
    yield (
        "| from the start of Python to a painted window | median (s) "
        "| of it computing, in all threads (s) | goal |"
    )
    yield "|---|---|---|---|"
    yield f"| napari alone | {wall:.2f} | {cpu:.2f} | |"
    yield f"| napari with the dock | {wall_both:.2f} | {cpu_both:.2f} | |"
    yield f"| what the dock adds | {wall_both - wall:.2f} | {cpu_both - cpu:.2f} | ≤ 0.6 |"


def medians(starts: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the medians of both columns."""
    wall, cpu = zip(*starts, strict=True)
    return statistics.median(wall), statistics.median(cpu)


def seconds_to_start(script: str) -> tuple[float, float]:
    """Return the seconds until a script says that it is ready, and those that it computed."""
    # As for a user, modules are kept as byte code.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    began = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
        text=True,
    ) as process:
        assert process.stdout is not None
        words = next((line.split() for line in process.stdout if line.startswith("ready")), None)
        seconds = time.perf_counter() - began
        process.kill()
    if words is None:
        msg = "napari did not start"
        raise RuntimeError(msg)
    return seconds, float(words[1])
