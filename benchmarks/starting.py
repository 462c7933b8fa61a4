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
import napari
from qtpy.QtWidgets import QApplication
viewer = napari.Viewer()
{dock}
while not any(w.windowHandle() is not None and w.windowHandle().isExposed()
              for w in QApplication.topLevelWidgets()):
    QApplication.processEvents()
QApplication.processEvents()
print("ready", flush=True)
"""
DOCK = 'viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")'


def start_lines() -> Iterator[str]:
    """Start napari with and without the dock, in turn, each time in a new process."""
    scripts = (START.format(dock=""), START.format(dock=DOCK))
    for script in scripts:
        seconds_to_start(script)
    times = [[seconds_to_start(script) for script in scripts] for _ in range(STARTS)]
    alone, both = (statistics.median(column) for column in zip(*times, strict=True))
    yield "| from the start of Python to a painted window | median (s) | goal |"
    yield "|---|---|---|"
    yield f"| napari alone | {alone:.1f} | |"
    yield f"| napari with the dock | {both:.1f} | |"
    yield f"| what the dock adds | {both - alone:.1f} | < 1.5 |"


def seconds_to_start(script: str) -> float:
    """Return the seconds until a script says that it is ready."""
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
        ready = any(line.strip() == "ready" for line in process.stdout)
        seconds = time.perf_counter() - began
        process.kill()
    if not ready:
        msg = "napari did not start"
        raise RuntimeError(msg)
    return seconds
