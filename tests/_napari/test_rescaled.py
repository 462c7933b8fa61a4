"""What is counted and measured of results: wherever they lie, whatever their scale has become."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d._napari.session import (
    Session,
    plan_confidence,
    plan_margin,
    plan_measuring,
    plan_truth,
)
from napari_phase4d.task import Cancelled, Task

METHODS = ["spatial-2d", "temporal-angular"]
STORAGES = ["memory", "disk"]


def unwrapped(
    video: p4d.Recording, storage: str, methods: list[str] | None = None, mask: str | None = "auto"
) -> Session:
    """Return a session with results that lie in memory or on disk."""
    session = Session()
    session.set_recording(video, angles_deg=(-7, 21))
    session.update(storage=storage)
    session.find_lobes()
    session.reconstruct()
    session.unwrap(methods or METHODS[:1], mask=mask, boundary=(0, 0))
    return session


def recalibrated(session: Session) -> xr.DataArray:
    """Change optics and frame rate of a session, and return the coordinates that hold now."""
    optics = replace(session.recording.optics, magnification=30.0)
    session.recalibrate(session.recording.calibrated(optics, frame_rate_hz=2))
    grid = session.reconstruction["phase"]
    assert float(grid["time"][1]) == 0.5
    return grid


def assert_on(grid: xr.DataArray, *stacks: xr.DataArray) -> None:
    """Hold the coordinates of stacks against those of the phase."""
    for stack in stacks:
        for axis in {"time", "y", "x"} & set(grid.dims):
            np.testing.assert_array_equal(stack[axis], grid[axis])


@pytest.mark.slow
@pytest.mark.parametrize("mask", ["auto", None])
def test_the_object_is_measured_alike_in_memory_and_on_disk(small_video, mask) -> None:
    held, lying = (unwrapped(small_video, storage, METHODS, mask) for storage in STORAGES)
    for method, result in held.results.items():
        assert lying.results[method].chunks is not None
        np.testing.assert_array_equal(lying.results[method].values, result.values)
    expected = held.measure(METHODS)
    assert len(expected) == 24
    assert (expected["dry mass (pg)"] > 0).all()
    pd.testing.assert_frame_equal(lying.measure(METHODS), expected, check_exact=True)
    left = list(lying.place.shelf.folder.rglob("empty*"))
    assert not left, "what was needed on the way lies there still"


@pytest.mark.slow
def test_the_object_of_results_on_disk_is_read_a_block_at_a_time(
    small_video, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("napari_phase4d.stack.BLOCK_FRAMES", 2)
    monkeypatch.setattr("napari_phase4d.stack.SMALL_FRAMES", 2)
    comparison = unwrapped(small_video, "disk").needed_outcome().comparison
    with comparison.object_by_blocks() as inside:
        assert inside.chunks[0] == (2, 2, 2)
        assert inside.dtype == bool
        third = inside[2].values
    xr.testing.assert_equal(comparison.object_mask(), comparison.object_mask())
    np.testing.assert_array_equal(comparison.object_mask()[2].values, third)
    assert comparison.object_mask().chunks is None


@pytest.mark.slow
@pytest.mark.parametrize("plan_of", [plan_measuring, plan_margin, plan_confidence])
def test_what_is_made_of_results_on_disk_can_be_stopped(
    small_video, monkeypatch: pytest.MonkeyPatch, plan_of
) -> None:
    """It reads them, which takes a while, and is asked for again afterwards."""
    monkeypatch.setattr("napari_phase4d.stack.BLOCK_FRAMES", 2)
    monkeypatch.setattr("napari_phase4d.stack.SMALL_FRAMES", 2)
    session = unwrapped(small_video, "disk")
    for asked in (1, 2, 4):
        times: list[bool] = []

        def stopped(asked: int = asked, times: list[bool] = times) -> bool:
            times.append(True)
            return len(times) >= asked

        with pytest.raises(Cancelled):
            plan_of(session).work(Task(None, stopped))
    plan_of(session).run()


@pytest.mark.slow
@pytest.mark.parametrize("storage", STORAGES)
def test_errors_are_counted_after_the_scale_has_changed(small_video, storage: str) -> None:
    session = unwrapped(small_video, storage)
    before = session.results["spatial-2d"].values
    grid = recalibrated(session)
    result = session.results["spatial-2d"]
    np.testing.assert_array_equal(result.values, before)
    # Exact phase that is chosen as a layer has the times and places of the phase on screen.
    truth = result.copy(data=before + 2 * np.pi * (np.arange(before.shape[-1]) >= 20))
    plan = plan_truth(session, truth)
    plan.receive(plan.work(Task()))
    assert session.truth is not None
    found = session.needed_outcome().comparison
    share = 100 * (before.shape[-1] - 20) / before.shape[-1]
    assert found.table["wrong_cycles_percent"]["spatial-2d"] == pytest.approx(share, abs=0.1)
    assert found.table["mse_rad2"]["spatial-2d"] == pytest.approx(
        (2 * np.pi) ** 2 * share / 100, rel=1e-3
    )
    assert_on(grid, found.phase, found.object_mask())
    assert found.phase.attrs["medium_index"] == session.recording.optics.medium_index


@pytest.mark.slow
@pytest.mark.parametrize("known", [True, False], ids=["known before", "asked for later"])
@pytest.mark.parametrize("storage", STORAGES)
def test_confidence_has_the_scale_that_holds_now(small_video, storage: str, known: bool) -> None:
    session = unwrapped(small_video, storage)
    earlier = session.needed_outcome().comparison
    if known:
        session.weigh()
    grid = recalibrated(session)
    trust = session.weigh()["spatial-2d"]
    assert_on(grid, trust)
    comparison = session.needed_outcome().comparison
    assert comparison.confidence("spatial-2d") is comparison.confidence("spatial-2d")
    assert_on(grid, comparison.reference())
    assert_on(grid.isel(y=0, x=0, drop=True), comparison.verdict.disagreement)
    assert_on(earlier.phase, earlier.confidence("spatial-2d"))  # whoever holds it keeps its scale
    np.testing.assert_array_equal(earlier.confidence("spatial-2d").values, trust.values)
    assert_on(grid, comparison.confidence("spatial-2d"))


@pytest.mark.slow
def test_words_and_notes_are_of_the_scale_that_holds_now(small_video) -> None:
    """The verdict names times: it is not left with those of another frame rate."""
    session = unwrapped(small_video, "memory", METHODS)
    session.update(boundary="auto")
    session.unwrap(METHODS)
    session.weigh()
    before = session.verdict
    recording = session.recording
    optics = replace(recording.optics, wavelength_um=0.5)
    session.recalibrate(recording.calibrated(optics, frame_rate_hz=2))
    outcome = session.needed_outcome()
    grid, verdict = outcome.reconstruction["phase"], session.verdict
    assert str(verdict) == str(outcome.comparison.verdict)
    assert verdict.frame == before.frame
    np.testing.assert_array_equal(verdict.disagreement.values, before.disagreement.values)
    assert_on(grid.isel(y=0, x=0, drop=True), verdict.disagreement, outcome.scores)
    for trust in session.confidence.values():
        assert trust.attrs["wavelength_um"] == 0.5
        assert_on(grid, trust)
    if verdict.frame is not None:
        assert str(verdict) != str(before)
