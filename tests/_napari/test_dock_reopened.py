"""What is known stays when the dock is closed, and the sliders keep to one recording."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pint
import pytest
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication, QWidget

import napari_phase4d as p4d
from napari_phase4d._napari.beginning import Units, get_ready
from napari_phase4d.later import load_ahead

pytestmark = pytest.mark.gui


def close(viewer: Any, dock: Any, qtbot: Any) -> None:
    """Close the dock with the button in its title."""
    around = viewer.window.dock_widgets["Phase 4D (napari-phase4d)"].parent()
    while not hasattr(around, "title"):
        around = around.parent()
    button = around.title.close_button
    QTest.mouseClick(button, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: dock.jobs.closed, timeout=60_000)
    dock.deleteLater()  # the test still knows it, so that it would not go
    qtbot.wait(50)


def opened_again(viewer: Any) -> Any:
    _, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
    return dock


@pytest.mark.thorough
def test_all_is_there_when_the_dock_is_opened_again(viewer, ready, click, qtbot) -> None:
    ready.session.unwrap(["temporal", "spatial-2d"])
    ready.session.measure()
    ready.phase.window.value = "gaussian"
    session, rows = ready.session, ready.compare.figures.table.rowCount()
    layers = [layer.name for layer in viewer.layers]
    states = [section.badge.text() for section in ready.sections]
    frame = viewer.dims.current_step
    close(viewer, ready, qtbot)
    again = opened_again(viewer)
    assert again is not ready
    assert again.session is session
    assert [layer.name for layer in viewer.layers] == layers
    assert viewer.dims.current_step == frame
    assert [section.badge.text() for section in again.sections] == states
    assert again.compare.figures.table.rowCount() == rows == 2
    assert again.compare.measuring.table.rowCount() > 0
    assert again.lobes.table.rowCount() == 2
    assert again.phase.window.value == "gaussian"
    assert again.recording.facts.text() != ""
    assert "as it was" in again.status.text()
    # And it goes on: what is found now is shown once.
    again.session.reconstruct()
    again.session.unwrap(["temporal"])
    assert again.compare.figures.table.rowCount() == 1
    assert len(viewer.layers) == len(layers) + 3  # phase, amplitude, Temporal
    again.jobs.cancel()


@pytest.mark.thorough
@pytest.mark.story
def test_a_run_is_stopped_with_its_dock(viewer, ready, qtbot) -> None:
    exact = p4d.simulation.moving_shape("dividing", (160, 160), 24, angles_deg=(0.0, 6.0))
    ready.session.set_phase(p4d.simulation.with_noise(exact, 0.3)["wrapped"])
    ready.session.update(methods=("directional-l1",))
    run = ready.findChild(QWidget, "run")
    ready.show_step(3)
    qtbot.waitUntil(run.isVisible, timeout=60_000)
    QTest.mouseClick(run, Qt.MouseButton.LeftButton)
    assert ready.jobs.running
    qtbot.waitUntil(lambda: "WL1" in ready.status.text(), timeout=60_000)
    assert ready.jobs.running  # in the midst of it
    close(viewer, ready, qtbot)
    qtbot.waitUntil(lambda: not ready.jobs.running, timeout=60_000)
    again = opened_again(viewer)
    assert again.session.outcome is None
    assert not again.jobs.running
    again.session.unwrap(["temporal"])
    assert again.compare.figures.table.rowCount() == 1
    again.jobs.cancel()


def test_an_empty_dock_opens_as_ever(viewer, dock, qtbot) -> None:
    close(viewer, dock, qtbot)
    again = opened_again(viewer)
    assert "Open a recording" in again.status.text()
    again.jobs.cancel()


@pytest.mark.thorough
def test_sliders_keep_to_the_present_recording(viewer, dock, qtbot) -> None:
    yeast = p4d.simulation.budding_yeast(n_times=5)
    dock.session.set_phase(yeast["wrapped"].assign_attrs(source="", object="a yeast"))
    dock.session.unwrap(["temporal"])
    euglena = p4d.simulation.swimming_euglena((40, 56), 9)
    dock.session.set_phase(euglena["wrapped"])
    dock.session.unwrap(["temporal"])
    QApplication.processEvents()
    assert viewer.dims.nsteps == (9, 2, 40, 56)
    for step in range(9):
        viewer.dims.set_current_step(0, step)
        assert dock.presenter.current_frame()[0] == step
    old = [layer for layer in viewer.layers if not layer.visible and layer.data.shape[0] == 5]
    assert len(old) == 2
    assert all("yeast" in layer.name for layer in old)
    # A layer of before that is shown again can be reached by the sliders.
    old[0].visible = True
    assert viewer.dims.range[1].stop == pytest.approx(float(yeast["angle"].max()), abs=1)
    old[0].visible = False
    assert viewer.dims.nsteps == (9, 2, 40, 56)
    # A layer of the user counts in any case.
    viewer.add_image(np.zeros((3, 2, 50, 70)), name="mine")
    assert viewer.dims.range[3].stop >= 69


SCRIPT = """
import atexit
import napari


def tell():  # after the dock has been told, and before Qt's own end
    try:
        dock.objectName()
    except RuntimeError:
        print("deleted")


viewer = napari.Viewer()
atexit.register(tell)
_, dock = viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
print(type(dock).__name__)
"""


@pytest.mark.thorough
def test_a_script_that_ends_while_the_dock_is_open_ends_well() -> None:
    # What of the dock is left for PyQt to delete can end the program with a crash.
    command = [sys.executable, "-W", "ignore", "-c", SCRIPT]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert (done.returncode, done.stdout.split()) == (0, ["Phase4DDock", "deleted"]), done.stderr


STARTING = """
import os, sys, threading, time
import napari, numpy, pint
from napari_phase4d._napari.jobs import Gate, giving_way
from qtpy.QtWidgets import QApplication

go, start = threading.Event(), threading.Thread.start
def held(thread):  # what is loaded ahead must not be taken for what the window itself loads
    if thread.name == "loading ahead":
        run, thread.run = thread.run, lambda: (go.wait(), run())
    start(thread)
threading.Thread.start = held

viewer = napari.Viewer()
QApplication.processEvents()
of_napari = set(sys.modules)
viewer.window.add_plugin_dock_widget("napari-phase4d", "Phase 4D")
QApplication.processEvents()
print(*sorted({"h5py", "matplotlib", "pandas", "scipy.fft", "scipy.ndimage", "scipy.special",
               "tifffile", "xarray", "zarr"} & (set(sys.modules) - of_napari)))
go.set()
end = time.monotonic() + 60
registry = pint.get_application_registry()
while type(registry.get()) is pint.registry.LazyRegistry and time.monotonic() < end:
    QApplication.processEvents()
print("xarray" in sys.modules, type(registry.get()).__name__)
layer = viewer.add_image(numpy.zeros((2, 2)), units=("um", "um"))
print(layer.units[0] == registry.micrometer)
loops = lambda: [thread for thread in threading.enumerate() if thread.name == "zarr_io"]
end = time.monotonic() + 20
while not loops() and time.monotonic() < end:
    time.sleep(0.01)
def store():
    import zarr
    zarr.create_group(zarr.storage.MemoryStore())
giving_way(store, Gate())
def niceness(thread):  # only Linux tells threads apart
    return os.getpriority(os.PRIO_PROCESS, thread.native_id) if sys.platform == "linux" else 0
print(*{niceness(thread) - niceness(threading.main_thread()) for thread in loops()})
"""


@pytest.mark.thorough
def test_the_dock_opens_before_what_it_does_not_show_is_loaded() -> None:
    command = [sys.executable, "-W", "ignore", "-c", STARTING]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    heavy, ahead, same_unit, niceness = done.stdout.splitlines()[-4:]
    assert heavy == ""
    assert (ahead, same_unit) == ("True UnitRegistry", "True")  # before it is clicked at
    assert niceness == "0"  # of Zarr's thread, which work that gives way may not start


def test_units_that_are_in_use_are_not_changed(qapp: QApplication) -> None:
    registry, units = pint.get_application_registry(), Units()
    metre, before = registry.metre, registry.get()
    units.read_ahead()
    units.read.emit(pint.UnitRegistry())  # as if they had come into use meanwhile
    assert registry.get() is before
    assert registry.metre == metre


def test_nothing_is_begun_for_a_dock_that_has_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, closed = [], []

    def close_meanwhile() -> None:
        begun.append("units")
        closed.append(True)

    load_ahead((close_meanwhile, lambda: begun.append("compiling")), lambda: bool(closed)).join()
    assert begun == ["units"]
    monkeypatch.setattr(
        "napari_phase4d._napari.beginning.load_ahead", lambda *_: begun.append("all")
    )
    get_ready(lambda: True)
    assert begun == ["units"]
    get_ready(lambda: False)
    assert begun == ["units", "all"]


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_what_cannot_be_got_ready_holds_up_nothing_else() -> None:
    begun = []

    def fail() -> None:
        raise PermissionError

    load_ahead((fail, lambda: begun.append("next")), lambda: False).join()
    assert begun == ["next"]


#: Closes the window while work goes on that does not look whether it is to stop.
ENDLESS = """
import time
from qtpy.QtWidgets import QApplication
from napari_phase4d._napari.demo import viewer_with_dock
from napari_phase4d._napari.session import Plan

viewer, dock = viewer_with_dock(show=True)
dock.jobs.start(Plan("endless", lambda task: time.sleep(120), lambda result: None))
end = time.monotonic() + 0.5
while time.monotonic() < end:
    QApplication.processEvents()
assert dock.jobs.running
viewer.close()
"""


@pytest.mark.thorough
def test_work_that_does_not_stop_holds_up_no_end_of_the_program() -> None:
    done = subprocess.run(
        [sys.executable, "-c", ENDLESS], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "Aborted" not in done.stderr
