"""A recording that does not fit into memory, in the window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from qtpy.QtWidgets import QApplication

import napari_phase4d as p4d
from napari_phase4d._napari.viewing.layers import OnDemand
from napari_phase4d.analysis import itoh_margin
from napari_phase4d.io.lazy import lazy_frames
from napari_phase4d.recording import Recording
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


def test_an_earlier_run_stays_as_it_was(viewer, on_disk) -> None:
    on_disk.session.unwrap(["temporal-angular"])
    first = on_disk.session.results["temporal-angular"]
    layer = viewer.layers["T/A"]
    before = first.values
    on_disk.session.unwrap(["temporal-angular"], mask=None)
    assert not np.array_equal(on_disk.session.results["temporal-angular"].values, before)
    np.testing.assert_array_equal(first.values, before)
    np.testing.assert_array_equal(layer.data[7, 1], before[7, 1])


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


def test_what_needs_all_frames_says_so(on_disk, monkeypatch: pytest.MonkeyPatch) -> None:
    class Little:
        available = 1000

    on_disk.session.unwrap(["spatial-2d", "temporal-angular"])
    monkeypatch.setattr("psutil.virtual_memory", lambda: Little)
    with pytest.raises(ValueError, match="how far to trust a result is judged on all frames"):
        on_disk.session.weigh()


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
