"""What is said stands where the eye is: below what was pressed, on the canvas, at the heading."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import xarray as xr
from driving import frame_on_canvas, let_settle
from qtpy.QtCore import Qt
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QWidget

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d._napari.session import Plan
from napari_phase4d.task import Task
from test_left_out import plume

pytestmark = pytest.mark.gui


def gap_below(dock: Any, name: str) -> int:
    """Pixels from the foot of a widget to the sentence below it."""
    pressed = dock.findChild(QWidget, name)
    bottom = pressed.mapTo(dock, pressed.rect().bottomLeft()).y()
    return int(dock.beside.mapTo(dock, dock.beside.rect().topLeft()).y() - bottom)


@pytest.mark.thorough
def test_an_error_stands_below_what_was_pressed(dock: Any, click: Callable[[str], None]) -> None:
    for name in ("find_lobes", "reconstruct", "run", "side_by_side"):
        click(name)
        assert dock.beside.isVisible()
        assert dock.beside.text() == dock.status.text()
        assert dock.beside.text().startswith("⚠ ")
        assert 0 < gap_below(dock, name) < 60
        section = next(s for s in dock.sections if s.isAncestorOf(dock.beside))
        assert section.isAncestorOf(dock.findChild(QWidget, name))
    click("try_sample")  # which succeeds
    assert not dock.beside.isVisible()
    assert not dock.status.property("wrong")


@pytest.mark.thorough
def test_the_error_of_a_job_stands_there_too(
    dock: Any, click: Callable[[str], None], small_video: Any, tmp_path: Path
) -> None:
    """The frames are gone when they are to be read, as work finds out."""
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in range(6):
        tifffile.imwrite(frames / f"{number}.tif", small_video.frame(number))
    dock.session.open(frames)
    away = frames.rename(tmp_path / "away")
    click("find_lobes")
    assert dock.status.property("wrong")
    assert "can't be read" in dock.beside.text()
    assert 0 < gap_below(dock, "find_lobes") < 60
    away.rename(frames)
    click("find_lobes")
    assert not dock.beside.isVisible()


@pytest.mark.thorough
def test_what_is_pressed_while_a_job_runs_moves_no_words(ready: Any, qtbot: Any) -> None:
    """A refusal stays while work goes on; the job's own error stands at what it was asked by."""
    stop = threading.Event()

    def work(task: Task) -> None:
        for done in range(1000):
            task.progress(done, 1000, "working")
            if stop.wait(0.01):
                break
        msg = "the work came to nothing"
        raise ValueError(msg)

    run, find = (ready.findChild(QWidget, name) for name in ("run", "find_lobes"))
    ready.jobs.asked_by = run
    ready.jobs.start(Plan("Trying", work, lambda _: None))
    ready.jobs.asked_by = None
    ready.show_step(1)
    qtbot.mouseClick(find, Qt.MouseButton.LeftButton)
    assert "another job is still running" in ready.beside.text()
    qtbot.waitUntil(lambda: "working" in ready.status.text(), timeout=60_000)
    qtbot.wait(300)  # progress is told three times meanwhile
    assert ready.beside.isVisible()
    assert 0 < gap_below(ready, "find_lobes") < 60
    ready.show_step(3)
    stop.set()
    qtbot.waitUntil(lambda: not ready.jobs.busy, timeout=60_000)
    assert ready.beside.text() == "⚠ the work came to nothing"
    assert 0 < gap_below(ready, "run") < 60


@pytest.mark.thorough
def test_much_that_object_only_leaves_out_is_said(
    dock: Any, click: Callable[[str], None], qtbot: Any
) -> None:
    frames = np.stack([wrap(plume(12))] * 2)[:, None].astype(np.float32)
    sides = {"y": 0.1 * np.arange(160), "x": 0.1 * np.arange(200)}
    axes = {"time": [0.0, 1.0], "angle": [0.0], **sides}
    dock.session.set_phase(xr.DataArray(frames, coords=axes, dims=("time", "angle", "y", "x")))
    let_settle(qtbot, dock)
    dock.session.update(methods=("spatial-2d",))
    if not dock.unwrap.mask.native.isChecked():
        click("mask")
    assert dock.session.recipe.mask == "auto"
    click("run")
    said = dock.status.text()
    assert '"object only" leaves out' in said
    assert "by unticking it" in said
    badge = dock.sections[3].badge
    assert badge.text() == "⚠ look"
    assert "leaves out" in badge.toolTip()
    click("mask")  # as it says
    click("run")
    assert "leaves out" not in dock.status.text()
    assert badge.text() == "✓ done"


@pytest.fixture
def numbered(dock: Any, click: Callable[[str], None], qtbot: Any) -> Any:
    """Return the dock with results of two views whose angles nobody has given."""
    phase = p4d.simulation.swimming_euglena((90, 110), 6, peak_rad=30)["wrapped"]
    dock.session.set_phase(phase.assign_coords(angle=[0.0, 1.0]))
    let_settle(qtbot, dock)
    dock.session.update(methods=("spatial-2d", "directional-l1"))
    click("run")
    qtbot.waitUntil(lambda: bool(dock.session.verdict), timeout=60_000)
    let_settle(qtbot, dock)
    return dock


@pytest.mark.thorough
def test_views_without_angles_are_numbered_everywhere(
    numbered: Any, viewer: Any, click: Callable[[str], None], qtbot: Any
) -> None:
    dock = numbered
    viewer.dims.set_current_step(1, 1)
    let_settle(qtbot, dock)
    assert frame_on_canvas(viewer).endswith(" s, view 2")
    for picture in (dock.compare.agreement, dock.unwrap.boundary.map):
        assert picture._picture.labels == ["view 1", "view 2"]
        assert "view 2." in picture._picture.words_on((0, 1))
    assert "angle" not in dock.session.verdict
    dock.unwrap.boundary.map.frame_hovered.emit(2, 1)
    assert ", view 2</b>" in dock.unwrap.boundary.thumbnail.words.text()
    click("measure")
    axes = dock.compare.measuring.plot.figure.axes
    assert axes[0].get_xlabel() == "time (s), at view 2"
    assert set(dock.compare.measuring.measured["angle (deg)"]) == {0.0, 1.0}  # as noted
    if frame := getattr(dock.session.verdict, "frame", None):
        heading = dock.sections[4].heading
        if not dock.sections[4].is_open:
            QTest.mouseClick(heading, Qt.MouseButton.LeftButton)
        click("show_worst")
        assert f"view {frame[1] + 1}: here methods disagree most" in dock.status.text()
