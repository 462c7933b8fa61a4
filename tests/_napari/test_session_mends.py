"""Faults of the session that a reading of it found, without a window."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

import napari_phase4d as p4d
from napari_phase4d._napari.session import Changed, Plan, Session, plan_watching
from napari_phase4d.analysis import CellSettings
from napari_phase4d.io import RawLayout
from napari_phase4d.recording import Recording
from napari_phase4d.task import UNWATCHED


def quiet(session: Session, title: str) -> Plan:
    """Return what is computed unasked under a title, past all that comes before it."""
    passed: list[str] = []
    while (plan := session.quiet_plan(passed)) is not None and plan.title != title:
        passed.append(plan.title)
    assert plan is not None
    return plan


@pytest.fixture
def ready(small_video: Recording) -> Session:
    session = Session()
    session.set_recording(small_video)
    session.find_lobes()
    session.reconstruct()
    return session


def hidden(session: Session) -> tuple[Any, ...]:
    recipe = session.recipe
    return recipe.first_frames, recipe.confidence, recipe.storage


def test_what_a_recipe_sets_unseen_ends_with_its_recording(
    small_video: Recording, tmp_path: Path
) -> None:
    cells = CellSettings(threshold_rad=1.5, smallest_um2=7)
    video = tmp_path / "video.npy"
    np.save(video, small_video.holograms.values)
    path = p4d.Recipe(
        recording=str(video), first_frames=2, confidence=True, storage="disk", cells=cells
    ).to_file(tmp_path / "recipe.json")
    session = Session()
    session.open(path)
    session.open(path)  # again: what was there before the first is still known
    assert hidden(session) == (2, True, "disk")
    assert session.recipe.cells == cells
    session.set_recording(small_video)
    assert hidden(session) == (None, False, "auto")
    assert session.recipe.cells == CellSettings(smallest_um2=7)  # which a widget shows
    session.open(path)
    session.update(storage="memory")  # asked for since
    session.set_recording(small_video)
    assert hidden(session) == (None, False, "memory")
    session.set_recording(small_video)
    assert hidden(session) == (None, False, "memory")


def watched(session: Session, video: Recording, folder: Path) -> Plan:
    """Return the plan to watch a folder in which all frames lie by now."""
    camera = folder / "camera"
    camera.mkdir()
    for number, frame in enumerate(np.asarray(video.holograms.data)):
        tifffile.imwrite(camera / f"frame_{number:04}.tif", frame)
    return plan_watching(session, camera, folder / "out", frames=video.n_frames, patience_s=9)


@pytest.mark.slow
def test_what_a_watch_sets_unseen_ends_with_its_recording(
    small_video: Recording, tmp_path: Path
) -> None:
    session = Session()
    session.update(methods=("temporal-angular",))
    watched(session, small_video, tmp_path).run()
    assert session.recipe.first_frames is not None
    assert session.recipe.options["temporal-angular"] == {"split": False}
    session.set_recording(small_video)
    assert session.recipe.first_frames is None
    assert session.recipe.options == {}


@pytest.mark.thorough
def test_a_microscope_typed_in_while_one_watches_is_no_other_recording(
    ready: Session, small_video: Recording, tmp_path: Path
) -> None:
    ready.update(methods=("temporal-angular",))
    plan = watched(ready, small_video, tmp_path)
    found = plan.work(UNWATCHED)
    ready.recalibrate(small_video.calibrated(frame_rate_hz=5))
    for _ in plan.receive(found) or ():
        pass
    assert list(ready.results) == ["temporal-angular"]


def test_the_layout_of_raw_frames_is_none_of_phase(ready: Session, tmp_path: Path) -> None:
    phase = ready.reconstruction["phase"]
    np.zeros((6, 64, 64), np.uint8).tofile(tmp_path / "camera.raw")
    np.save(tmp_path / "phase.npy", phase.values)
    session = Session()
    session.open(tmp_path / "camera.raw", raw=RawLayout(64, 64, "uint8"))
    session.open(tmp_path / "phase.npy", "phase")
    assert session.recipe.raw is None


def test_phase_with_other_axes_and_units_is_taken_as_it_is_meant() -> None:
    """Its object was transposed, and its layer lay 1000 times off."""
    phase = p4d.simulation.swimming_euglena((48, 64), 3)["wrapped"]
    turned = phase.transpose("angle", "x", "time", "y").assign_coords(
        time=("time", 1000 * phase["time"].values, {"units": "ms"}),
        y=("y", 1000 * phase["y"].values, {"units": "nm"}),
        x=("x", 1000 * phase["x"].values, {"units": "nm"}),
    )
    masses = []
    for given in (phase, turned):
        session = Session()
        session.set_phase(given)
        taken = session.needed_reconstruction()["phase"]
        assert taken.dims == phase.dims
        np.testing.assert_allclose(taken["x"], phase["x"])
        np.testing.assert_allclose(taken["time"], phase["time"])
        session.unwrap(["spatial-2d"])
        masses.append(session.measure("spatial-2d")["dry mass (pg)"].to_numpy())
    np.testing.assert_allclose(*masses)


@pytest.mark.slow
def test_the_time_of_a_run_is_that_of_what_is_ticked(ready: Session) -> None:
    ready.update(methods=("spatial-2d",))
    plan = quiet(ready, "Estimating the time")
    seconds = plan.work(UNWATCHED)
    ready.update(methods=("spatial-2d", "temporal-angular"))
    with pytest.raises(Changed):  # so that it is looked at again
        plan.receive(seconds)
    assert ready.estimate is None
    for change in ({"mask": None}, {"options": {"temporal-angular": {"split": False}}}):
        quiet(ready, "Estimating the time").run()
        assert ready.estimate is not None
        ready.update(**change)
        assert ready.estimate is None


def test_a_refused_opening_leaves_what_was_brought_as_it_was(ready: Session) -> None:
    phase = ready.reconstruction["phase"]
    session = Session()
    session.set_phase(phase, recipe=p4d.Recipe(confidence=True, storage="memory"))
    before = session.recipe
    with pytest.raises(ValueError, match="99"):
        session.set_phase(phase, recipe=p4d.Recipe(boundary=((99, 0),), first_frames=2))
    assert session.recipe == before
    session.set_phase(phase)
    assert hidden(session) == (None, False, "auto")
