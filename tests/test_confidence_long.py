"""Confidence of recordings of any length: the same ways and numbers, in memory and on disk."""

from __future__ import annotations

import copy
import pickle
import time
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.stats import rankdata

import napari_phase4d as p4d
from helpers import command
from napari_phase4d import task
from napari_phase4d.pipeline import read_outcome, write_outcome
from napari_phase4d.simulation import (
    at_wavelengths,
    hard_shape,
    moving_shape,
    with_fault,
    with_noise,
)
from napari_phase4d.stack import Block, InMemory
from napari_phase4d.task import UNWATCHED, Watch
from napari_phase4d.unwrapping import Judged, Problem, given, supports_by_steps
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.directional import graph
from napari_phase4d.unwrapping.directional.following import followed_steps
from napari_phase4d.unwrapping.directional.graph import graphs_of
from napari_phase4d.unwrapping.directional.methods import prepared

TURN = 2 * np.pi
METHODS = ("spatial-2d", "temporal-angular", "directional-l1")


def thick_and_noisy() -> xr.Dataset:
    exact = moving_shape("swelling")
    return with_noise(exact.assign(phase=1.4 * exact["phase"]), 0.6, seed=8)


def with_black_frames() -> xr.Dataset:
    return with_fault(hard_shape("ring", (48, 48), 12), "black frame", 0.2, seed=1)


@pytest.fixture
def short_spans(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph, "SPAN_PIXELS", 1)
    monkeypatch.setattr(graph, "SPAN_FRAMES", 3)


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("start", [(0, 0), (7, 1)])
@pytest.mark.parametrize("data", [thick_and_noisy(), with_black_frames()])
def test_ways_are_the_same_wherever_a_recording_is_cut(
    data: xr.Dataset, start: tuple[int, int], method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The smoothest way may lead through frames far away, and come back."""
    result = p4d.unwrap(data["wrapped"], method, boundary=start).values
    found = []
    for pixels, frames in ((10_000_000, 16), (1, 3), (1, 5)):
        monkeypatch.setattr(graph, "SPAN_PIXELS", pixels)
        monkeypatch.setattr(graph, "SPAN_FRAMES", frames)
        judged = {"result": Judged(InMemory(result))}
        support = supports_by_steps(Problem(data["wrapped"], start), judged)["result"]
        found.append(support.roughest.read(Block(0, len(result))))
    assert np.unique(found[0]).size > 100
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])


def layer_without_empty_field() -> xr.Dataset:
    """A layer of cells that fills the view, and waves."""
    t, y, x = np.mgrid[:14, -24:24, -24:24].astype(float)
    hills = 6 * np.cos(0.22 * y + 0.3 * t) * np.cos(0.19 * x - 0.2 * t)
    phase = 14 + hills + 0.05 * x + 3 * np.exp(-((y - t + 7) ** 2 + x**2) / 60)
    exact = xr.DataArray(phase[:, None].astype(np.float32), dims=("time", "angle", "y", "x"))
    return with_noise(xr.Dataset({"phase": exact, "wrapped": exact}), 0.2, seed=5)


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1000, 3])
def test_without_empty_field_ways_begin_in_the_boundary_frame(
    frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing was trusted there, right or wrong; nothing is sure now, but much is likely."""
    monkeypatch.setattr(graph, "SPAN_PIXELS", 1)
    monkeypatch.setattr(graph, "SPAN_FRAMES", frames)
    data = layer_without_empty_field()
    right = p4d.unwrap(data["wrapped"], "directional-l1", boundary=(4, 0))
    turns = np.round((right - data["phase"]).values / TURN)
    assert (turns == turns[0, 0, 0, 0]).all()
    assert not Problem(data["wrapped"]).background().mask.any()
    trust = p4d.confidence(right, data["wrapped"]).values
    assert trust.max() <= 0.9
    assert np.quantile(trust, 0.01) > 0.8
    # A part of it is a turn lower, from a time on.
    wrong = right.copy(data=right.values.copy())
    wrong[9:, :, 10:30, 10:30] -= TURN
    trust = p4d.confidence(wrong, data["wrapped"]).values
    assert trust[9:, :, 12:28, 12:28].max() < 0.1
    assert np.quantile(trust[:8], 0.01) > 0.8


@pytest.mark.slow
def test_verdict_says_that_no_empty_field_is_in_view() -> None:
    data = layer_without_empty_field()
    methods = ("directional-l1", "spatial-2d")
    for mask in (None, "auto"):  # the latter leaves the valleys out
        verdict = p4d.compare(data["wrapped"], methods, mask=mask).verdict
        assert verdict.doubtful_percent < 0.1
        assert "No empty field is in view" in verdict
    shown = p4d.compare(with_black_frames()["wrapped"], methods=("directional-l1",)).verdict
    assert "No empty field" not in shown


@pytest.mark.slow
def test_a_thin_frame_far_away_vouches_for_a_thick_cell(short_spans: None) -> None:
    """No frame of the last spans is thin, so that each by itself could vouch for nothing."""
    y, x = np.mgrid[-24:24, -24:24]
    plateau = (np.hypot(y, x) < 12).astype(np.float32)
    height = np.minimum(np.arange(30), 14) * np.float32(5 / 14)
    exact = (height[:, None, None] * plateau).astype(np.float32)
    wrapped = xr.DataArray((exact + np.pi) % TURN - np.pi, dims=("time", "y", "x"))
    late, inside = slice(18, None), plateau > 0
    trust = p4d.confidence(exact, wrapped).values[late][:, inside]
    alone = p4d.confidence(exact[late], wrapped[late]).values[:, inside]
    assert trust.min() > 0.9
    assert alone.max() < 0.5


@pytest.mark.thorough
@pytest.mark.parametrize("method", METHODS)
def test_doubt_is_where_it_belongs_in_short_spans_too(short_spans: None, method: str) -> None:
    data = thick_and_noisy()
    result = p4d.unwrap(data["wrapped"], method)
    inside = data["phase"].values > 1
    doubt = 1 - p4d.confidence(result, data["wrapped"]).values[inside]
    wrong = (np.round((result.values - data["phase"].values) / TURN) != 0)[inside]
    n = int(wrong.sum())
    area = (rankdata(doubt)[wrong].sum() - n * (n + 1) / 2) / (n * (len(wrong) - n))
    assert n > 20
    assert area >= 0.96


def outcomes(
    tmp_path: Path, phase: xr.DataArray, **settings: object
) -> tuple[p4d.Comparison, p4d.Comparison]:
    """Return what a recipe gives in memory and on disk, with their files written."""
    path = p4d.io.write_phase(tmp_path / "phase.ome.zarr", phase)
    found = []
    for storage in ("memory", "disk"):
        recipe = p4d.Recipe(
            recording=str(path), content="phase", boundary=((0, 0),), storage=storage, **settings
        )
        out = tmp_path / storage
        outcome = p4d.run(recipe, folder=out)
        write_outcome(outcome, out)
        found.append(outcome.comparison)
    return found[0], found[1]


@pytest.mark.thorough
def test_on_disk_missing_mass_is_said_too(tmp_path: Path) -> None:
    exact = hard_shape("shock")
    data = with_noise(exact.assign(phase=np.float32(1.5) * exact["phase"]), 0.4, seed=4)
    held, lying = outcomes(tmp_path, data["wrapped"], methods=("directional-l1",), confidence=True)
    assert "an object has less mass" in held.warnings()["directional-l1"]
    assert lying.warnings() == held.warnings()


@pytest.mark.thorough
@pytest.mark.parametrize("mask", [None, "auto"])
def test_on_disk_it_is_the_same(tmp_path: Path, short_spans: None, mask: str | None) -> None:
    held, lying = outcomes(
        tmp_path, with_black_frames()["wrapped"], methods=METHODS[:2], mask=mask, confidence=True
    )
    for method in METHODS[:2]:
        expected, found = held.confidence(method), lying.confidence(method)
        assert found.chunks is not None
        assert found.attrs["of"] == expected.attrs["of"] == method
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found.values, expected.values)
        assert (tmp_path / "disk" / f"confidence_{method}.ome.zarr").is_dir()
    assert lying.verdict == held.verdict
    assert lying.warnings() == held.warnings()
    tables = [c.with_doubt(c.confidences()).table["doubtful_percent"] for c in (held, lying)]
    np.testing.assert_array_equal(*tables)
    # What was needed on the way only is gone: the reference too, which nobody asked for.
    assert not list((tmp_path / "disk").glob(".phase4d*"))
    assert not (tmp_path / "disk" / "directional-l1.ome.zarr").exists()


@pytest.mark.thorough
@pytest.mark.parametrize("mask", [None, "auto"])
def test_on_disk_missing_mass_is_the_same(
    tmp_path: Path, mask: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = hard_shape("shock")
    data = with_noise(exact.assign(phase=np.float32(1.5) * exact["phase"]), 0.4, seed=4)
    monkeypatch.setattr(given, "WORKING_FRAMES", 3)
    held, lying = outcomes(
        tmp_path, data["wrapped"], methods=("directional-l1",), mask=mask, confidence=True
    )
    expected = held.confidence("directional-l1").values
    np.testing.assert_array_equal(lying.confidence("directional-l1").values, expected)
    inside = (exact["phase"] > 4).values
    assert np.median(expected[10:][inside[10:]]) < 0.7 < np.median(expected[:10][inside[:10]])
    assert lying.verdict == held.verdict


@pytest.mark.thorough
def test_on_disk_it_can_be_asked_for_later(tmp_path: Path) -> None:
    held, lying = outcomes(tmp_path, with_black_frames()["wrapped"], methods=("spatial-2d",))
    assert lying.known_confidence("spatial-2d") is None
    expected = held.confidence("spatial-2d").values
    np.testing.assert_array_equal(lying.confidence("spatial-2d").values, expected)
    assert lying.known_confidence("spatial-2d") is not None
    reopened = read_outcome(tmp_path / "disk").comparison
    assert not reopened.held
    np.testing.assert_array_equal(reopened.confidence("spatial-2d").values, expected)
    assert reopened.verdict == held.verdict
    assert not list((tmp_path / "disk").glob(".phase4d*"))


@pytest.mark.thorough
def test_threads_that_ask_for_the_empty_field_at_once_wait_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is looked for anew where the shelf was cleared: every block of the tally asks for it."""
    held, lying = outcomes(tmp_path, with_black_frames()["wrapped"], methods=METHODS[:2])
    for comparison in (held, lying):
        comparison.confidences()
    monkeypatch.setattr(given, "WORKING_FRAMES", 1)
    monkeypatch.setattr(task, "cores", lambda: 4)
    looks: list[Problem] = []
    find = Problem._find_background

    def slowly(problem: Problem, who: task.Task) -> Background:
        looks.append(problem)
        time.sleep(0.05)
        return find(problem, who)

    monkeypatch.setattr(Problem, "_find_background", slowly)
    assert lying.verdict == held.verdict
    assert [id(problem) for problem in looks] == [id(lying.problem)]


@pytest.mark.thorough
def test_several_threads_may_ask_for_confidence_on_disk(tmp_path: Path) -> None:
    """Each ends with tidying up, which must not take away what another one reads."""
    held, lying = outcomes(tmp_path, with_black_frames()["wrapped"], methods=METHODS)
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lying.confidence, METHODS))
        verdicts = set(pool.map(lambda _: lying.verdict, METHODS))
    for method, trust in zip(METHODS, found, strict=True):
        np.testing.assert_array_equal(trust.values, held.confidence(method).values)
    assert verdicts == {held.verdict}


@pytest.mark.slow
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))])
def test_a_comparison_can_be_copied_and_sent_to_another_process(
    copied: Callable[[p4d.Comparison], p4d.Comparison],
) -> None:
    comparison = p4d.compare(with_black_frames()["wrapped"], METHODS[:1])
    expected = comparison.verdict
    found = copied(comparison)
    assert found.verdict == expected
    assert found.problem.locks is not comparison.problem.locks
    assert copied(found.problem).once("anything", lambda: 1) == 1


@pytest.mark.parametrize("mask", [None, "auto"])
@pytest.mark.parametrize("storage", ["memory", "disk"])
def test_phase_of_which_nothing_is_known_is_refused_wherever_it_lies(
    tmp_path: Path, storage: str, mask: str | None
) -> None:
    nothing = with_black_frames()["wrapped"][:1] * np.nan
    path = p4d.io.write_phase(tmp_path / "phase.ome.zarr", nothing)
    recipe = p4d.Recipe(
        recording=str(path), content="phase", mask=mask, storage=storage, boundary=((0, 0),)
    )
    with pytest.raises(ValueError, match="NaN everywhere, so there is nothing to unwrap"):
        p4d.run(recipe, folder=tmp_path / "out")


@pytest.mark.thorough
def test_on_disk_it_is_the_same_for_several_wavelengths(tmp_path: Path) -> None:
    data = at_wavelengths(moving_shape("swelling"), (0.532, 0.6328))
    held, lying = outcomes(tmp_path, data["wrapped"], methods=("temporal-angular",))
    assert "wavelength" in lying.phase.coords
    found, expected = (c.confidence("temporal-angular").values for c in (lying, held))
    np.testing.assert_array_equal(found, expected)
    # Which holds it against WL1, that was not run: of each wavelength by itself there, too.
    assert lying.verdict == held.verdict


@pytest.mark.slow
@pytest.mark.parametrize("mask", [None, "auto"])
def test_the_object_of_results_on_disk_is_that_in_memory(tmp_path: Path, mask: str | None) -> None:
    held, lying = outcomes(
        tmp_path, with_black_frames()["wrapped"], methods=METHODS[:1], mask=mask
    )
    xr.testing.assert_equal(lying.object_mask(), held.object_mask())
    assert 0.05 < float(held.object_mask().mean()) < 0.6
    assert not list((tmp_path / "disk").glob(".phase4d*"))


@pytest.mark.slow
def test_graph_of_small_object_in_large_field_takes_memory_of_its_box() -> None:
    exact = p4d.simulation.swimming_euglena((32, 32), 8, pixel_um=44 / 32, peak_rad=9)
    there_and_back = np.abs((np.arange(160) % 14) - 7)
    wrapped = np.zeros((160, 1, 128, 128), dtype=np.float32)
    wrapped[:, :, 48:80, 48:80] = exact["wrapped"].values[there_and_back, :1]
    problem = Problem(wrapped)
    field = prepared(problem, UNWATCHED)
    tracemalloc.start()
    try:
        steps = followed_steps(field.scene, field.floors, Watch(1, "", UNWATCHED))
        (graph,) = graphs_of(field.scene, steps, [Block(0, 160)])
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert graph.nodes.shape == field.scene.part
    assert graph.nodes.size < wrapped.size / 10
    assert most < 6 * wrapped.size  # bytes; one number for each pixel of the field takes four
    assert (graph.nodes_of(Block(0, 160), field.scene)[:, :, 0, 0] < graph.n_islands).all()


def test_box_of_a_large_field_is_read_a_few_frames_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = with_black_frames()
    amplitude = np.linspace(0.5, 1, data["wrapped"].size).reshape(data["wrapped"].shape)
    scene = prepared(Problem(data["wrapped"], amplitude=amplitude), UNWATCHED).scene
    block = Block(1, scene.shape[0] - 1)
    whole = scene.read_box(block, amplitude=True)
    monkeypatch.setattr(given, "WORKING_PIXELS", 1)
    monkeypatch.setattr(given, "FEW_FRAMES", 1)
    assert len(given.blocks_within(block, scene.shape)) == len(block)
    parts = scene.read_box(block, amplitude=True)
    for one, other in zip(vars(whole).values(), vars(parts).values(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_phase_of_a_file_is_judged_where_stacks_lie_on_disk(tmp_path: Path) -> None:
    """And again into the same folder: the phase that lay there was replaced before it was read."""
    phase = moving_shape("tumbling", n_times=3)["wrapped"]
    phase.attrs = {}
    path = p4d.write_phase(tmp_path / "phase.ome.tif", phase)
    line = ["run", str(path), "--storage", "disk", "--method", "T/A", "--confidence"]
    for _ in range(2):
        ended = command(*line, "--out", "out", cwd=tmp_path)
        assert ended.returncode == 0, ended.stderr
        found = read_outcome(tmp_path / "out")
        np.testing.assert_array_equal(found.reconstruction["phase"].values, phase.values)
    assert (tmp_path / "out" / "confidence_temporal-angular.ome.zarr").is_dir()
