"""Which frame is safe to start from: never a lost one, nearly always one of the least wrong."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.pipeline import phase_needs
from napari_phase4d.simulation import SHAPES, moving_shape, with_noise
from napari_phase4d.stacks import wrapped_stack
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import Problem, boundaries, scores_of_some, scores_sentence
from napari_phase4d.unwrapping.growing import Workspace

TURN = 2 * np.pi
RNG = np.random.default_rng


def wrong_pixels(data: xr.Dataset, exact: xr.Dataset) -> np.ndarray:
    """Pixels of the object that two-dimensional unwrapping gets wrong in every frame."""
    flat = p4d.unwrap(data["wrapped"], "spatial-2d")
    off = np.round((flat.values - data["phase"].values) / TURN) != 0
    return (off & (exact["phase"].values > 0.05)).sum((2, 3))


@pytest.mark.thorough
def test_best_frame_is_nearly_always_among_the_least_wrong() -> None:
    """Also where no frame is right: half as thick again, or without the thin half of the times."""
    right = []
    for name in SHAPES:
        exact = moving_shape(name)
        thick = exact.assign(phase=1.5 * exact["phase"])
        for case in (exact, thick, exact.isel(time=slice(10, None))):
            data = with_noise(case, 0.2, seed=4)
            wrong = wrong_pixels(data, case)
            best = tuple(p4d.score_boundaries(data["wrapped"]).attrs["best"])
            right.append(wrong[best] == wrong.min())
    assert sum(right) >= 0.95 * len(right)


def lost_in(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """A frame as a camera that has lost the light gives it."""
    if name == "NaN":
        return np.full(shape, np.nan)
    return np.full(shape, 0.7) if name == "blank" else RNG(1).uniform(-np.pi, np.pi, shape)


@pytest.mark.thorough
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("kind", ["NaN", "blank", "noise"])
def test_lost_frames_score_nothing_and_change_no_other(kind: str, masked: bool) -> None:
    data = with_noise(moving_shape("returning"), 0.2, seed=2)
    wrapped = data["wrapped"]
    mask = np.ones(wrapped.shape, bool)
    mask[..., :3] = not masked
    whole = p4d.score_boundaries(wrapped, mask=mask)
    damaged = wrapped.copy()
    lost = [tuple(whole.attrs["best"]), (7, 2)]  # the very frame that would be taken
    for frame in lost:
        damaged.values[frame] = lost_in(kind, wrapped.shape[2:])
    scores = p4d.score_boundaries(damaged, mask=mask)
    assert [float(scores.values[frame]) for frame in lost] == [0, 0]
    assert tuple(scores.attrs["best"]) not in lost
    assert scores.attrs["lost"] == 2
    assert "Left out as lost: 2 of 80 frames." in scores_sentence(scores)
    wrong = wrong_pixels(data, moving_shape("returning"))
    assert wrong[tuple(scores.attrs["best"])] == 0
    others = np.ones(whole.shape, bool)
    others[tuple(np.transpose(lost))] = False
    assert np.abs(scores.values - whole.values)[others].max() < 0.02


@pytest.mark.slow
def test_frames_that_a_mask_leaves_nothing_of_are_lost() -> None:
    wrapped = with_noise(moving_shape("returning"), 0.2, seed=2)["wrapped"]
    mask = np.ones(wrapped.shape, bool)
    mask[0, 0] = False
    scores = p4d.score_boundaries(wrapped, mask=mask)
    assert scores.values[0, 0] == 0
    assert scores.attrs["lost"] == 1


@pytest.mark.slow
def test_an_honest_frame_without_an_object_is_safe() -> None:
    exact = moving_shape("swelling").copy(deep=True)
    exact["phase"].values[0, 1] = 0
    data = with_noise(exact, 0.2, seed=5)
    scores = p4d.score_boundaries(data["wrapped"])
    assert scores.attrs["best"] == [0, 1]
    assert scores.values[0, 1] > 0.999
    found = p4d.unwrap(data["wrapped"], boundary=(0, 1))
    assert (np.round((found.values[0, 1] - data["phase"].values[0, 1]) / TURN) == 0).all()


def test_a_small_piece_that_is_mostly_wrong_is_not_safe() -> None:
    """A few wrong pixels of few are worse than a few of many."""
    from napari_phase4d.unwrapping.boundaries import Look, score_of

    assert score_of(Look(10, 12), 500.0) < 0.2
    assert score_of(Look(10, 100), 500.0) == pytest.approx(0.98)
    assert score_of(Look(10, 1000), 500.0) == pytest.approx(0.99)
    assert score_of(Look(), 500.0) == 1


@pytest.mark.slow
def test_scores_say_what_they_rest_on() -> None:
    wrapped = with_noise(moving_shape("swelling", (32, 32), 6), 0.2, seed=3)["wrapped"]
    together = p4d.score_boundaries(wrapped)
    assert together.attrs["basis"] == "the frame alone and all frames together (WL1)"
    own = p4d.unwrap(wrapped, "directional-l1")
    given = p4d.score_boundaries(wrapped, own)
    assert given.attrs["basis"] == "the frame alone and the result of WL1"
    np.testing.assert_allclose(given, together, atol=1e-6)
    assert "the reference" in p4d.score_boundaries(wrapped, own.values).attrs["basis"]
    single = p4d.score_boundaries(wrapped[0, 0])
    assert single.attrs["basis"] == "two unwrappers of the frame alone"


@pytest.mark.slow
def test_large_recordings_are_looked_at_here_and_there(monkeypatch: pytest.MonkeyPatch) -> None:
    wrapped = with_noise(moving_shape("returning", (32, 32), 12), 0.1, seed=3)["wrapped"]
    lazy = wrapped.chunk(time=1)
    xr.testing.assert_identical(scores_of_some(lazy), p4d.score_boundaries(wrapped))
    pixels = 4 * wrapped[0].size
    monkeypatch.setattr("napari_phase4d.unwrapping.boundaries.SCORED_PIXELS", pixels)
    some = scores_of_some(lazy)
    assert some.attrs["basis"] == "two unwrappers of the frame alone"
    assert np.isfinite(some.values[::3]).all()
    assert np.isnan(some.values[1::3]).all()
    time, angle = some.attrs["best"]
    assert time % 3 == 0
    assert float(some[time, angle]) == float(some.max())
    alone = p4d.score_boundaries(wrapped)
    assert alone.attrs["basis"] == "two unwrappers of the frame alone"
    np.testing.assert_allclose(some.values[0], alone.values[0], atol=0.02)


def test_finding_the_start_is_counted_in_what_a_run_needs() -> None:
    small, large = (200, 2, 100, 100), (10**6, 2, 100, 100)
    methods = ("temporal-angular",)
    needed = p4d.METHODS["directional-l1"].working_stacks * 4 * np.prod(small)
    plain, found = (phase_needs(methods, small, finds_start=f) for f in (False, True))
    assert found.on_disk > needed > plain.on_disk
    assert found.in_memory > needed > plain.in_memory
    assert (plain.start_is_most, found.start_is_most) == (False, True)
    # It does not grow with the recording.
    assert phase_needs(methods, large, finds_start=True).on_disk < 2e9
    both = phase_needs(("directional-l1",), small, finds_start=True)
    assert both.start_is_most  # the method itself goes through the frames in blocks


def test_too_little_memory_for_finding_the_start_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    class Little:
        available = 10**8

    needs = phase_needs(("spatial-2d",), (200, 2, 100, 100), finds_start=True)
    monkeypatch.setattr("psutil.virtual_memory", lambda: Little)
    with pytest.raises(OSError, match=r"finding the safest frame .* name a frame"):
        needs.check(tmp_path, on_disk=True)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_frames_without_residues_score_as_growing_them_says(
    noise: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a frame without residues nothing is grown, since it has only one unwrapping."""
    sample = p4d.simulation.swimming_euglena((96, 120), 8, peak_rad=20)["wrapped"].values
    noisy = sample + np.random.default_rng(2).normal(0, noise, sample.shape)
    given = Problem(wrapped_stack(np.angle(np.exp(1j * noisy))), mask="auto")
    quick = boundaries.scored(given, None, UNWATCHED, together=False)
    residues = [boundaries.smooth_turns(f, Workspace()) is None for f in given.wrapped[:, 0]]
    assert any(residues) == (noise > 0)
    assert not all(residues)
    monkeypatch.setattr(boundaries, "smooth_turns", lambda *_: None)
    grown = boundaries.scored(given, None, UNWATCHED, together=False)
    np.testing.assert_array_equal(quick, grown)


@pytest.mark.parametrize("turns", [-2, -1, 1])
def test_the_level_of_a_reference_does_not_count(turns: int) -> None:
    """Exact phase may have any level; a frame is right if it is relative to its empty field."""
    sample = p4d.simulation.budding_yeast((40, 40), 6)
    exact = sample["phase"].isel(angle=[0, 4, 5])
    wrapped = sample["wrapped"].isel(angle=[0, 4, 5])
    off = exact.transpose(*wrapped.dims) + np.float32(2 * np.pi * turns)
    scores = p4d.score_boundaries(wrapped, off)
    wrong = np.round((p4d.unwrap(wrapped, "spatial-2d") - exact) / (2 * np.pi)) != 0
    right = 1 - wrong.transpose(*wrapped.dims).mean(("y", "x")).values
    assert wrong.any()
    assert right[scores.attrs["best"][0], scores.attrs["best"][1]] == right.max()
    assert scores.values[right == right.min()].max() < 0.5 < scores.values[right == 1].min()
