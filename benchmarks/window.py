"""How quickly the window reacts: while it works, to the sliders, to a drag, at the start."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from qtpy.QtCore import QEvent, QEventLoop, QObject, QPointF, Qt, QTimer
from qtpy.QtGui import QMouseEvent
from qtpy.QtWidgets import QApplication, QWidget

import napari_phase4d as p4d
from napari_phase4d._napari.demo import viewer_with_dock
from napari_phase4d._napari.session import plan_unwrapping
from napari_phase4d.unwrapping.warming import warm_up

#: (time, angle, y, x) of the phase that is worked on, with so much noise in radians.
N_TIMES, ANGLES_DEG, FRAME, NOISE_RAD = 60, (0.0, 6.0), (256, 256), 0.2
METHODS = ("temporal-angular", "region-growing", "directional-growing", "directional-l1")
#: The quickest nine, to fill a grid with.
NINE = (
    "spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal",
    "laplacian", "region-growing", "spatial-3d", "dilate-erode",
)  # fmt: skip
CAMERA = (1024, 1280)
TICK_MS = 5
ROUNDS, STEPS, DRAGS, STARTS = 2, 40, 30, 5
#: A mouse tells of its moves about so often.
MOUSE_EVERY_MS, STEADY_DRAG_S = 8, 2.0
PATIENCE_S = 120.0


def lines() -> Iterator[str]:
    """Return all tables of the window."""
    warm_up()  # compiling is measured under "First use"
    for heading, part in (
        ("Longest stall of the window (ms)", stall_lines),
        ("Moving a slider", slider_lines),
        ("Dragging a circle", drag_lines),
        ("Start", start_lines),
    ):
        yield f"#### {heading}\n"
        yield from part()
        yield ""


class Pulse:
    """A timer of 5 ms in the window's thread; where a beat is late, the window stood still."""

    def __init__(self) -> None:
        self._beats: list[float] = []
        self._timer = QTimer()
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(lambda: self._beats.append(time.perf_counter()))
        self._timer.start(TICK_MS)

    def longest_stall(self, began: float, ended: float) -> float:
        """Return the longest time without a beat between two moments, less a tick, in ms."""
        beats = [began, *(beat for beat in self._beats if began < beat < ended), ended]
        return max(0.0, 1000 * float(np.diff(beats).max()) - TICK_MS)


class Painted(QObject):
    """Counts how often widgets of one class, or one widget, are painted."""

    def __init__(self, wanted: Callable[[Any], bool]) -> None:
        super().__init__()
        self.count = 0
        self._wanted = wanted
        QApplication.instance().installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:  # noqa: N802
        """Count, and let the event pass."""
        if event is not None and event.type() == QEvent.Type.Paint and self._wanted(watched):
            self.count += 1
        return False

    def stop(self) -> None:
        QApplication.instance().removeEventFilter(self)


def is_canvas(widget: Any) -> bool:
    return bool(widget.inherits("QOpenGLWidget"))


def let_work(until: Callable[[], bool]) -> None:
    """Let the event loop run, undisturbed, until something has happened."""
    loop, look = QEventLoop(), QTimer()
    end = time.monotonic() + PATIENCE_S
    look.timeout.connect(lambda: loop.quit() if until() or time.monotonic() > end else None)
    look.start(20)
    loop.exec()
    if not until():
        msg = f"the window took longer than {PATIENCE_S:g} s"
        raise RuntimeError(msg)


def rest(seconds: float) -> None:
    end = time.monotonic() + seconds
    let_work(lambda: time.monotonic() > end)


def wrapped_phase() -> xr.DataArray:
    """Return noisy wrapped phase of a cell that divides, seen from two angles."""
    exact = p4d.simulation.moving_shape("dividing", FRAME, N_TIMES, angles_deg=ANGLES_DEG)
    return p4d.simulation.with_noise(exact, NOISE_RAD)["wrapped"]


def window_with_phase() -> tuple[Any, Any]:
    """Return a viewer and its dock, which holds phase and does nothing."""
    viewer, dock = viewer_with_dock(show=True)
    dock.session.set_phase(wrapped_phase())
    let_work(lambda: dock.session.scores is not None and not dock.jobs.busy)
    rest(1)
    return viewer, dock


def stall_lines() -> Iterator[str]:
    """Run methods through the dock and look how long the window stands still."""
    viewer, dock = window_with_phase()
    pulse = Pulse()
    began = time.perf_counter()
    rest(3)
    yield (
        "| work on (60, 2, 256, 256) | takes (s) | while it works (goal <= 100) "
        "| layers added and shown, first time | and again | while results are weighed unasked |"
    )
    yield "|---|---|---|---|---|---|"
    yield f"| nothing | 3.0 | {pulse.longest_stall(began, time.perf_counter()):.0f} | | | |"
    for method in METHODS:
        runs = [stalls_of(dock, pulse, method) for _ in range(ROUNDS)]
        seconds, working, shown, weighing = zip(*runs, strict=True)
        first, again = shown[0], max(shown[1:])
        yield (
            f"| {p4d.METHODS[method].label} | {statistics.median(seconds):.1f} "
            f"| {max(working):.0f} | {first:.0f} | {again:.0f} | {max(weighing):.0f} |"
        )
    yield f"\nThe longest of {ROUNDS} runs each; the first table row is the first result shown."
    viewer.close()


def stalls_of(dock: Any, pulse: Pulse, method: str) -> tuple[float, float, float, float]:
    """Return seconds of work, and the stalls in ms: working, showing, weighing the results."""
    dock.session.update(methods=(method,))
    plan = plan_unwrapping(dock.session)
    moments = []

    def receive(outcome: Any) -> None:
        moments.append(time.perf_counter())
        plan.receive(outcome)

    began = time.perf_counter()
    dock.jobs.start(replace(plan, receive=receive))
    let_work(lambda: not dock.jobs.running)
    if dock.status.property("wrong"):
        raise RuntimeError(dock.status.text())
    rest(0.1)
    (received,), shown = moments, time.perf_counter()
    let_work(lambda: bool(dock.session.confidence) and not dock.jobs.busy)
    rest(0.3)
    spans = ((began, received), (received, shown), (shown, time.perf_counter()))
    working, showing, weighing = (pulse.longest_stall(*span) for span in spans)
    return received - began, working, showing, weighing


def slider_lines() -> Iterator[str]:
    """Step through time with nine layers in the dock's grid, and in a bare one."""
    viewer, dock = window_with_phase()
    dock.session.unwrap(NINE)
    let_work(lambda: bool(dock.session.confidence) and not dock.jobs.busy)
    ours = slider_steps(viewer)
    size, width = canvas_size(), dock.width()
    results = list(dock.session.results.values())
    viewer.close()
    bare = bare_grid(results, width)
    theirs = slider_steps(bare)
    yield "| nine layers (60, 2, 256, 256) side by side | canvas | median (ms) | worst (ms) |"
    yield "|---|---|---|---|"
    for what, canvas, steps in (
        ("the dock's: names, colour bars, what follows the slider", size, ours),
        ("a bare grid of napari's", canvas_size(), theirs),
    ):
        yield f"| {what} | {canvas} | {statistics.median(steps):.0f} | {max(steps):.0f} |"
    yield f"\n{STEPS} steps of the time slider each, until painted."
    bare.close()


def bare_grid(results: list[xr.DataArray], width: int) -> Any:
    """Return a viewer with a grid of results, and an empty dock as wide as ours."""
    import napari

    viewer = napari.Viewer(show=True)
    viewer.window.resize(1280, 720)
    empty = QWidget()
    empty.setMinimumWidth(width)
    viewer.window.add_dock_widget(empty, area="right")
    for result in results:
        limits = (float(result.min()), float(result.max()))
        viewer.add_image(result.values, contrast_limits=limits, colormap="turbo")
    viewer.canvas.grid.enabled = True
    rest(1)
    return viewer


def canvas_size() -> str:
    """Return width and height of the canvas on screen."""
    (canvas,) = (w for w in QApplication.allWidgets() if is_canvas(w) and w.isVisible())
    return f"{canvas.width()} x {canvas.height()}"


def slider_steps(viewer: Any) -> list[float]:
    """Return ms from each step of the time slider to the canvas painted."""
    rest(1)
    painted = Painted(is_canvas)
    steps = []
    for time_index in range(1, STEPS + 1):
        before, began = painted.count, time.perf_counter()
        viewer.dims.set_current_step(0, time_index)
        while painted.count == before:
            QApplication.processEvents()
        steps.append(1000 * (time.perf_counter() - began))
    painted.stop()
    return steps


def drag_lines() -> Iterator[str]:
    """Drag a circle of the spectrum and wait for the wrapped phase that it gives."""
    viewer, dock = viewer_with_dock(show=True)
    exact = p4d.simulation.moving_shape("dividing", CAMERA, 2, angles_deg=ANGLES_DEG)
    dock.session.set_recording(p4d.simulation.multiplexed_video(exact["phase"]))
    dock.session.find_lobes()
    dock.show_step(1)
    let_work(lambda: not dock.jobs.busy)
    rest(1)
    painted = Painted(lambda widget: widget is dock.lobes.strip)
    waits, carrier = single_drags(dock, painted), dock.session.lobes[0].carrier
    between = steady_drag(dock, painted)
    if dock.session.lobes[0].carrier == carrier:
        msg = "the circle did not follow the mouse"
        raise RuntimeError(msg)
    painted.stop()
    yield "| preview of 1024 x 1280, two lobes | median (ms) | worst (ms) | goal |"
    yield "|---|---|---|---|"
    for what, times in (
        (f"{DRAGS} single moves of the mouse, each until painted", waits),
        (f"from picture to picture, the mouse moving every {MOUSE_EVERY_MS} ms", between),
    ):
        yield f"| {what} | {statistics.median(times):.0f} | {max(times):.0f} | <= 50 |"
    viewer.close()


def single_drags(dock: Any, painted: Painted) -> list[float]:
    """Return ms from each move of the mouse to the preview painted."""
    canvas, waits = dock.lobes.canvas, []
    start = canvas.view_position(*dock.session.lobes[0].carrier)
    send_mouse(canvas, QEvent.Type.MouseButtonPress, start)
    for number in range(DRAGS):
        before, began = painted.count, time.perf_counter()
        send_mouse(canvas, QEvent.Type.MouseMove, start + QPointF(1 + number % 4, number % 3))
        while painted.count == before:
            QApplication.processEvents()
        waits.append(1000 * (time.perf_counter() - began))
        rest(0.05)
    send_mouse(canvas, QEvent.Type.MouseButtonRelease, start)
    return waits


def steady_drag(dock: Any, painted: Painted) -> list[float]:
    """Return ms between one preview and the next while the mouse moves all the time."""
    canvas, moments = dock.lobes.canvas, []
    start = canvas.view_position(*dock.session.lobes[0].carrier)
    send_mouse(canvas, QEvent.Type.MouseButtonPress, start)
    began, moves, shown = time.perf_counter(), 0, painted.count
    moments.append(began)
    while (now := time.perf_counter()) - began < STEADY_DRAG_S:
        if now - began > moves * MOUSE_EVERY_MS / 1000:
            moves += 1
            place = start + QPointF(moves % 40 / 4, moves % 25 / 5)
            send_mouse(canvas, QEvent.Type.MouseMove, place)
        QApplication.processEvents()
        if painted.count != shown:
            shown = painted.count
            moments.append(time.perf_counter())
    moments.append(time.perf_counter())
    send_mouse(canvas, QEvent.Type.MouseButtonRelease, start)
    return [1000 * float(gap) for gap in np.diff(moments)]


def send_mouse(canvas: Any, kind: QEvent.Type, place: QPointF) -> None:
    """Let the left button press, drag or release at a place of the spectrum."""
    button, none = Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton
    changed = none if kind == QEvent.Type.MouseMove else button
    held = none if kind == QEvent.Type.MouseButtonRelease else button
    there = QPointF(canvas.viewport().mapToGlobal(place.toPoint()))
    event = QMouseEvent(kind, place, there, changed, held, Qt.KeyboardModifier.NoModifier)
    QApplication.sendEvent(canvas.viewport(), event)


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
    scripts = {"napari alone": START.format(dock=""), "with the dock": START.format(dock=DOCK)}
    for script in scripts.values():
        seconds_to_start(script)
    times: dict[str, list[float]] = {name: [] for name in scripts}
    for _ in range(STARTS):
        for name, script in scripts.items():
            times[name].append(seconds_to_start(script))
    alone, dock = (statistics.median(seconds) for seconds in times.values())
    yield "| from the start of Python to a painted window | median (s) | goal |"
    yield "|---|---|---|"
    yield f"| napari alone | {alone:.1f} | |"
    yield f"| napari with the dock | {dock:.1f} | |"
    yield f"| what the dock adds | {dock - alone:.1f} | < 1.5 |"


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
