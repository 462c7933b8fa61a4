"""A recording that does not fit into memory, in the window."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d
from napari_phase4d._napari.jobs import Latest
from napari_phase4d._napari.viewing.layers import OnDemand
from napari_phase4d.analysis import itoh_margin
from napari_phase4d.io.lazy import lazy_frames
from napari_phase4d.recording import Recording
from napari_phase4d.task import Task
from test_streaming import Endless

pytestmark = pytest.mark.gui


@pytest.fixture
def on_disk(dock, small_video):
    """Return the dock with a lazy video of 30 frames whose stacks lie on disk."""
    reader = Endless(small_video.holograms.values, 30)
    frames = lazy_frames(reader)
    frames.kept = reader
    dock.session.set_recording(
        Recording.from_frames(frames, optics=small_video.optics, frame_rate_hz=6)
    )
    dock.session.update(storage="disk")
    dock.session.find_lobes()
    dock.session.reconstruct()
    return dock


@pytest.mark.thorough
def test_the_window_shows_frames_on_demand(viewer, on_disk, small_video) -> None:
    layer = on_disk.presenter.holograms
    assert isinstance(layer.data, OnDemand)
    assert layer.data.shape == (30, 2, 128, 128)
    phase = on_disk.session.reconstruction["phase"]
    wrapped = next(la for la in viewer.layers if la.name.startswith("wrapped"))
    for time, angle in ((0, 0), (17, 1), (29, 0)):
        np.testing.assert_array_equal(layer.data[time, angle], small_video.frame(time % 6))
        np.testing.assert_array_equal(wrapped.data[time, angle], phase[time, angle].values)
        on_disk.presenter.go_to(time, angle)
        QApplication.processEvents()
        shown = np.asarray(wrapped._slice.image.raw)
        np.testing.assert_array_equal(shown, phase[time, angle].values)


@pytest.mark.thorough
@pytest.mark.story
def test_results_are_those_in_memory(viewer, on_disk, click, qtbot, tmp_path: Path) -> None:
    session = on_disk.session
    session.update(methods=("spatial-2d", "temporal-angular"))
    click("run")
    disk = session.results
    assert all(result.chunks is not None for result in disk.values())
    assert isinstance(session.needed_outcome().comparison.table, pd.DataFrame)
    memory = p4d.run(session.needed_outcome().recipe.changed(storage="memory"), session.recording)
    for method, result in memory.comparison.results.items():
        np.testing.assert_array_equal(disk[method].values, result.values)
    click("measure")
    expected = on_disk.compare.measuring.measured["dry mass (pg)"]
    assert len(expected) == 60
    assert (expected > 0).all()
    written = session.save(tmp_path)
    assert {p.name for p in written} >= {"temporal-angular.ome.zarr", "table.csv"}


@pytest.mark.thorough
def test_the_window_says_where_errors_of_cells_leave_out_doubt(on_disk, click) -> None:
    on_disk.session.update(methods=("temporal-angular",))
    click("run")
    said: list[str] = []
    on_disk.compare.cells.said.connect(said.append)
    for name in ("find_cells", "show_confidence", "find_cells"):
        click(name)
    assert "errors leave out pixels in doubt" in said[0]
    assert "press Confidence above" in said[0]
    assert "doubt" not in said[-1]
    assert "Click one" in said[-1]


@pytest.mark.thorough
def test_curves_follow_the_mouse(on_disk, click, qtbot) -> None:
    on_disk.session.update(methods=("spatial-2d", "temporal-angular"))
    click("run")
    click("follow_mouse")
    trace = on_disk.compare.trace
    results = on_disk.session.results

    def shown(pixel: tuple[int, int], frame: tuple[int, int]) -> bool:
        axes = [] if trace.plot.figure is None else trace.plot.figure.axes
        if len(axes) < 2:
            return False
        t, a = frame
        for panel, part in zip(axes, ((slice(None), a), (t, slice(None))), strict=False):
            lines = {line.get_label(): line.get_ydata() for line in panel.get_lines()}
            values = results["temporal-angular"].values[(*part, *pixel)]
            if "T/A" not in lines or not np.allclose(lines["T/A"], values, atol=1e-5):
                return False
        return True

    on_disk.presenter.go_to(17, 1)
    for pixel in ((10, 11), (14, 20)):  # the second one while the first is read
        trace._pixel = pixel
        trace._show()
    qtbot.waitUntil(lambda: shown((14, 20), (17, 1)), timeout=60_000)
    read = trace._read[1].over_time
    on_disk.presenter.go_to(3, 1)
    qtbot.waitUntil(lambda: shown((14, 20), (3, 1)), timeout=60_000)
    assert trace._read[1].over_time is read  # what is the same at all times is not read again


def test_late_answers_are_dropped(qtbot) -> None:
    latest = Latest()
    go_on = threading.Event()
    told: list[object] = []

    def waits(task: Task) -> str:
        go_on.wait(60)
        return f"first, stopped: {task.stopped}"

    def fails(task: Task) -> str:
        msg = "the disk is gone"
        raise OSError(msg)

    latest.ask(waits, told.append, told.append, "here")
    latest.ask(lambda _: "second", told.append, told.append, "there")
    latest.ask(lambda _: "third", told.append, told.append, "elsewhere")
    go_on.set()
    qtbot.waitUntil(lambda: bool(told), timeout=60_000)
    assert told == ["third"]
    go_on.clear()
    latest.ask(waits, told.append, told.append, "here")
    latest.ask(lambda _: "about the same", told.append, told.append, "here")
    go_on.set()
    qtbot.waitUntil(lambda: len(told) == 3, timeout=60_000)
    assert told[1:] == ["first, stopped: False", "about the same"]
    latest.ask(fails, told.append, told.append, "here")
    qtbot.waitUntil(lambda: len(told) == 4, timeout=60_000)
    assert "the disk is gone" in str(told[-1])
    go_on.clear()
    latest.ask(waits, told.append, told.append, "here")
    latest.drop()
    go_on.set()
    latest.ask(lambda _: "last", told.append, told.append, "here")
    qtbot.waitUntil(lambda: told[-1] == "last", timeout=60_000)
    assert len(told) == 5


@pytest.mark.thorough
def test_an_earlier_run_stays_as_it_was(viewer, on_disk) -> None:
    on_disk.session.unwrap(["temporal-angular"])
    first = on_disk.session.results["temporal-angular"]
    layer = viewer.layers["T/A"]
    before = first.values
    on_disk.session.unwrap(["temporal-angular"], mask=None)
    assert not np.array_equal(on_disk.session.results["temporal-angular"].values, before)
    np.testing.assert_array_equal(first.values, before)
    np.testing.assert_array_equal(layer.data[7, 1], before[7, 1])


@pytest.mark.thorough
def test_frames_are_scored_here_and_there(on_disk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("napari_phase4d.unwrapping.boundaries.SCORED_TIMES", 10)
    pixels = on_disk.session.reconstruction["phase"].size - 1
    monkeypatch.setattr("napari_phase4d.unwrapping.boundaries.SCORED_PIXELS", pixels)
    time, angle = on_disk.session.suggest_boundary()
    scores = on_disk.session.scores
    assert scores.shape == (30, 2)
    assert np.isfinite(scores.values[::3]).all()
    assert np.isnan(scores.values[1::3]).all()
    assert float(scores[time, angle]) == float(scores.max())


@pytest.mark.thorough
def test_results_on_disk_are_judged(viewer, on_disk, click) -> None:
    session = on_disk.session
    session.update(methods=("spatial-2d", "temporal-angular"))
    session.unwrap()
    assert not session.verdict, "it takes long on disk, so it waits until it is asked for"
    assert "press Confidence" in on_disk.compare.verdict.text()
    click("show_confidence")
    assert on_disk.compare.verdict.text() == session.verdict
    recipe = session.needed_outcome().recipe
    memory = p4d.run(recipe.changed(storage="memory"), session.recording).comparison
    assert session.verdict == memory.verdict
    for method in recipe.methods:
        trust = session.confidence[method]
        assert trust.chunks is not None, "it lies in memory"
        np.testing.assert_array_equal(trust.values, memory.confidence(method).values)
    doubt = memory.with_doubt(memory.confidences()).table["doubtful_percent"]
    pd.testing.assert_series_equal(
        session.needed_outcome().comparison.table["doubtful_percent"], doubt
    )
    layer = next(la for la in viewer.layers if "onfidence" in la.name)
    assert layer.data.shape == (30, 2, *trust.shape[2:])
    assert tuple(layer.axis_labels) == ("time", "angle", "y", "x")


@pytest.mark.thorough
def test_steps_and_differences_are_computed_where_they_are_looked_at(viewer, on_disk) -> None:
    on_disk.session.unwrap(["spatial-2d", "temporal-angular"])
    results = on_disk.session.results
    on_disk.session.measure_steps()
    margin, held = on_disk.session.margin, itoh_margin(results["temporal-angular"].compute())
    for name, expected in held.items():
        assert margin[name].chunks is not None
        xr.testing.assert_identical(margin[name].compute(), expected)
    on_disk.presenter.show_difference("spatial-2d")
    layer = viewer.layers["T/A − 2-D"]
    expected = results["temporal-angular"].values[7, 1] - results["spatial-2d"].values[7, 1]
    np.testing.assert_array_equal(np.asarray(layer.data[7, 1]), expected)
