"""The controller between dock and pipeline: without a window, and without Qt."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d._napari.jobs import TimeLeft, in_words
from napari_phase4d._napari.session import Session, StepState, plan_unwrapping, step_states
from napari_phase4d.analysis import measure, most_trusted, noise_figures
from napari_phase4d.holography import Lobe
from napari_phase4d.io import write_phase
from napari_phase4d.pipeline import open_by
from napari_phase4d.sample import yeast_sample
from napari_phase4d.task import Task

DONE, READY, TO_DO, STALE = StepState.DONE, StepState.READY, StepState.TO_DO, StepState.STALE
METHODS = ["spatial-2d", "temporal-angular"]


@pytest.fixture
def session(small_video) -> Session:
    session = Session()
    session.set_recording(small_video, angles_deg=(-7, 21))
    return session


@pytest.mark.thorough
def test_it_needs_neither_qt_nor_napari() -> None:
    code = (
        "import sys, napari_phase4d._napari.session; "
        "print(sorted({m.split('.')[0] for m in sys.modules} & {'napari', 'qtpy', 'magicgui'}))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


@pytest.mark.slow
def test_states_from_nothing_to_results_and_back(session: Session) -> None:
    assert step_states(Session()) == (READY, TO_DO, TO_DO, TO_DO, TO_DO)
    assert step_states(session) == (DONE, READY, TO_DO, TO_DO, TO_DO)
    lobes = session.find_lobes()
    assert step_states(session) == (DONE, DONE, READY, TO_DO, TO_DO)
    session.reconstruct()
    assert step_states(session) == (DONE, DONE, DONE, READY, TO_DO)
    session.unwrap(METHODS)
    assert step_states(session) == (DONE,) * 5
    session.update(window="disk")  # of step 3: what it made, and all after it, is of before
    assert step_states(session) == (DONE, DONE, STALE, STALE, STALE)
    session.update(window="smooth-disk")
    assert step_states(session) == (DONE,) * 5
    session.set_lobes([lobes[0], Lobe((-0.2, 0.18), 0.07, 21)])
    assert step_states(session) == (DONE, DONE, STALE, STALE, STALE)
    session.undo_lobes()
    session.update(boundary=((2, 1),))
    assert step_states(session) == (DONE, DONE, DONE, STALE, STALE)
    session.update(boundary="auto", methods=METHODS[:1])  # less than there is: nothing stale
    assert step_states(session) == (DONE,) * 5
    session.update(methods=(*METHODS, "temporal"))
    assert step_states(session)[3] == STALE
    session.update(methods=METHODS, options={"spatial-2d": {"reliability": "coherence"}})
    assert step_states(session)[3] == STALE


def test_changed_phase_without_results_is_not_ready_to_unwrap(session: Session) -> None:
    session.find_lobes()
    session.reconstruct()
    session.update(background="none")
    assert step_states(session) == (DONE, DONE, STALE, TO_DO, TO_DO)
    with pytest.raises(ValueError, match="press Reconstruct in step 3 again"):
        session.unwrap(METHODS)


def test_undo_goes_back_through_every_change(session: Session) -> None:
    with pytest.raises(ValueError, match="nothing to undo"):
        session.undo_lobes()
    first = session.find_lobes()
    second = [first[0], Lobe((0.3, 0.0), 0.05, 3)]
    session.set_lobes(second)
    session.remember_lobes()  # a drag of many small moves is one change
    for shift in (0.31, 0.32, 0.33):
        session.set_lobes([first[0], Lobe((shift, 0.0), 0.05, 3)], undoable=False)
    session.remember_lobes()
    session.undo_lobes()
    assert session.lobes == second
    session.undo_lobes()
    assert session.lobes == first
    session.undo_lobes()
    assert session.lobes == []


@pytest.mark.slow
def test_a_script_through_the_session_gives_what_functions_give(session, small_video) -> None:
    session.find_lobes()
    session.reconstruct(drift=False)
    table = session.unwrap(METHODS, boundary=(3, 1), mask=None)
    data = p4d.reconstruct(small_video, session.lobes, drift=False)
    for method in METHODS:
        expected = p4d.unwrap(data["phase"], method, boundary=(3, 1))
        np.testing.assert_array_equal(session.results[method].values, expected.values)
    assert list(table.index) == METHODS
    best = session.suggest_boundary()
    assert best == tuple(p4d.score_boundaries(data["phase"]).attrs["best"])
    assert session.recipe.boundary == "auto"
    session.unwrap(METHODS)
    assert session.outcome.recipe.boundary == (best,)
    for method in METHODS:
        expected = p4d.unwrap(data["phase"], method, boundary=best)
        np.testing.assert_array_equal(session.results[method].values, expected.values)


@pytest.mark.slow
def test_recipe_file_brings_everything_back(session: Session, tmp_path: Path) -> None:
    video = tmp_path / "video.npy"
    np.save(video, session.recording.holograms.values)
    session.open(video)
    session.find_lobes()
    session.reconstruct(window="disk", background="curvature")
    session.unwrap(METHODS, boundary=(2, 1))
    path = session.recipe.to_file(tmp_path / "recipe.json")
    again = Session()
    again.open(path)
    assert again.recipe == session.recipe
    again.reconstruct()
    again.unwrap()
    for method, result in session.results.items():
        np.testing.assert_array_equal(again.results[method].values, result.values)


def test_forced_content_is_kept_in_recipe_and_script(session: Session, tmp_path: Path) -> None:
    """Holograms that look like wrapped phase stay holograms when they are opened again."""
    rng = np.random.default_rng(0)
    path = tmp_path / "odd.npy"
    np.save(path, wrap(rng.normal(0, 3, (3, 32, 32))).astype(np.float32))
    session.open(path, "holograms")
    assert session.recording is not None
    assert session.recipe.content == "holograms"
    session.open(path)
    assert session.recording is None
    assert session.recipe.content == "auto"


@pytest.mark.slow
def test_errors_against_a_chosen_truth() -> None:
    data = yeast_sample()
    session = Session()
    session.set_phase(data["wrapped"])
    assert "mse_rad2" not in session.unwrap(METHODS)
    session.set_truth(data["phase"])
    table = session.outcome.comparison.table
    for method in METHODS:
        error = float(((session.results[method] - data["phase"].values) ** 2).mean())
        assert table["mse_rad2"][method] == pytest.approx(error, rel=1e-5)
    session.set_truth(None)
    assert "mse_rad2" not in session.outcome.comparison.table


@pytest.mark.slow
def test_all_that_is_known_follows_the_microscope(session: Session) -> None:
    session.find_lobes()
    session.reconstruct()
    session.unwrap(["spatial-2d", "directional-l1"])
    session.weigh()
    session.measure_steps()
    session.suggest_boundary()
    finer = session.recording.calibrated(p4d.Optics(magnification=30), frame_rate_hz=2)
    session.recalibrate(finer)
    grid = session.reconstruction["phase"]
    assert float(grid["time"][1]) == 0.5
    stacks = [*session.results.values(), *session.confidence.values()]
    for stack in (*stacks, *session.margin.data_vars.values()):
        for axis in ("time", "y", "x"):
            np.testing.assert_array_equal(stack[axis], grid[axis])
    np.testing.assert_array_equal(session.scores["time"], grid["time"])
    assert session.outcome.recipe.optics.magnification == 30


@pytest.mark.slow
def test_measuring_through_the_session(session: Session) -> None:
    with pytest.raises(ValueError, match="no results yet"):
        session.measure()
    session.find_lobes()
    session.reconstruct()
    pd.testing.assert_frame_equal(session.measure_noise(), noise_figures(session.reconstruction))
    session.unwrap(METHODS)
    optics, best = session.recipe.optics, most_trusted(session.results)
    inside = session.outcome.comparison.object_mask().values.astype(bool)
    expected = measure(session.results[best], {"object": inside}, optics)
    found = session.measure()
    pd.testing.assert_frame_equal(found[list(expected.columns)], expected)
    box = np.zeros(inside.shape[-2:], bool)
    box[3:9, 4:12] = True
    result = session.results["spatial-2d"]
    expected = measure(result, {"box": box}, optics, object_index=1.4)
    found = session.measure("spatial-2d", {"box": box}, object_index=1.4)
    pd.testing.assert_frame_equal(found[list(expected.columns)], expected)
    assert set(found["object index"]) == {1.4}
    assert session.measured is found
    session.recalibrate(session.recording.calibrated(p4d.Optics(magnification=30)))
    assert session.measured is None  # its areas would be of the old scale


def test_measuring_phase_that_does_not_say_its_microscope() -> None:
    session = Session()
    session.set_phase(yeast_sample()["wrapped"])
    session.unwrap(["spatial-2d"])
    own = p4d.Optics(wavelength_um=0.4, magnification=20)
    noted = session.results["spatial-2d"].attrs["wavelength_um"]
    measured = session.measure(optics=own)
    with_noted = session.measure(optics=replace(own, wavelength_um=noted))
    pd.testing.assert_frame_equal(measured, with_noted)  # what the phase says comes first


def test_cancelled_unwrapping_returns_what_is_finished(session: Session) -> None:
    session.find_lobes()
    session.reconstruct()
    session.update(methods=(*METHODS, "angular-temporal"), boundary=((0, 0),))
    said: list[str] = []

    def report(done: int, total: int, message: str) -> None:
        said.append(message)

    plan = plan_unwrapping(session)
    outcome = plan.work(Task(report, lambda: bool(said) and said[-1].startswith("A/T")))
    assert list(outcome.comparison.results) == METHODS
    assert outcome.recipe.methods == tuple(METHODS)
    assert said[0].startswith("2-D (1 of 3): ")


@pytest.mark.slow
def test_what_is_done_unasked_comes_in_order_and_is_not_tried_again(session: Session) -> None:
    titles = []
    while (plan := session.quiet_plan(titles[2:])) is not None and len(titles) < 5:
        assert plan.gives_way
        titles.append(plan.title)
        plan.run()
    assert titles == ["Computing the spectrum"]
    session.find_lobes()
    session.reconstruct()
    assert session.quiet_plan().title == "Scoring the frames"
    assert session.quiet_plan(["Scoring the frames"]).title == "Measuring the noise"
    known = ["Scoring the frames", "Measuring the noise"]
    estimate = session.quiet_plan(known)
    assert estimate.title == "Estimating the time"
    estimate.run()
    assert session.estimate[0] == session.recipe.methods
    assert session.estimate[1] > 0
    assert session.quiet_plan(known) is None
    session.update(methods=("spatial-2d",))
    assert session.quiet_plan(known).title == "Estimating the time"


def test_results_of_a_saved_stack_open_as_phase(tmp_path: Path) -> None:
    data = yeast_sample()
    path = write_phase(tmp_path / "wrapped.ome.tif", data["wrapped"])
    session = Session()
    session.open(str(path))
    np.testing.assert_array_equal(session.reconstruction["phase"].values, data["wrapped"].values)
    assert step_states(session) == (DONE, DONE, DONE, READY, TO_DO)


def test_unknown_sample_is_said() -> None:
    with pytest.raises(ValueError, match="sample:euglena"):
        Session().open("sample:nothing")


def test_time_left_comes_from_the_speed_so_far() -> None:
    clock = iter([0.0, 1.0, 2.0, 4.0, 4.5, 10.0])
    left = TimeLeft(lambda: next(clock))
    assert left.seconds(0, 10, "2-D") is None
    assert left.seconds(2, 10, "2-D") is None  # too early to tell
    assert left.seconds(4, 10, "2-D") == pytest.approx(3.0)  # half a second a step
    assert left.seconds(5, 10, "2-D") == pytest.approx(4.0)
    assert left.seconds(0, 100, "T/A") is None  # another method
    assert left.seconds(10, 100, "T/A") == pytest.approx(5.5 / 10 * 90)
    assert in_words(None) == ""
    assert in_words(0.2) == ", about 1 s left"
    assert in_words(150) == ", about 2 min left"


def test_uneven_times_of_a_file_are_no_frame_rate_of_the_recipe() -> None:
    frames = np.random.default_rng(0).integers(0, 255, (4, 16, 16)).astype(np.uint8)
    uneven = p4d.Recording.from_frames(frames, times_s=np.array([0.0, 1, 2, 60]))
    late = p4d.Recording.from_frames(frames, times_s=np.array([5.0, 6, 7, 8]))
    session = Session()
    for recording, rate in ((uneven, None), (late, None), (uneven.calibrated(None, 3), 3)):
        session.set_recording(recording)
        assert session.recipe.frame_rate_hz == rate
        session.recalibrate(recording.calibrated(p4d.Optics(magnification=20)))
        assert session.recipe.frame_rate_hz == rate
    session.recalibrate(uneven.calibrated(None, 7))
    assert session.recipe.frame_rate_hz == 7


def test_views_that_were_changed_come_before_angles_that_were_known(session: Session) -> None:
    first = Lobe((0.2, 0.2), 0.07, -7)
    for lobes, angles in (
        ([first, Lobe((-0.2, 0.2), 0.07, 21)], (-7, 21)),
        ([], (-7, 21)),
        ([first, Lobe((-0.2, 0.2), 0.07, 30)], None),
    ):
        session.set_lobes(lobes)
        assert session.recipe.angles_deg == angles


def test_the_recipe_names_the_array_that_was_opened(tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 255, (2, 3, 16, 16)).astype(np.uint8)
    np.savez(tmp_path / "m.npz", run1=frames[0], run2=frames[1])
    session = Session()
    session.open(p4d.open_recording(tmp_path / "m.npz", dataset="run2"))
    assert session.recipe.dataset == "run2"
    again = open_by(session.recipe)
    assert (again.frame(1) == frames[1, 1]).all()
    for number in range(3):
        np.save(tmp_path / f"{number}.npy", frames[0])
    session.open([tmp_path / "0.npy", tmp_path / "1.npy"])
    assert (session.recipe.recording, session.recipe.dataset) == ("", None)
