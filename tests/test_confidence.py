"""Maps of confidence, warnings, and scores of boundary frames."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import median_filter

import napari_phase4d as p4d
from helpers import area_under_curve
from napari_phase4d.analysis import Verdict, residues, slip_warning, slipped_frames
from napari_phase4d.analysis.confidence import median_of_nine, odds_in_line
from napari_phase4d.simulation import hard_shape, moving_shape, with_fault, with_noise
from napari_phase4d.stack import Block, InMemory, blocks_of
from napari_phase4d.unwrapping import (
    Judged,
    Problem,
    astray,
    level_residues,
    supports_by_steps,
)

TURN = 2 * np.pi


@pytest.fixture(scope="module")
def noisy() -> xr.Dataset:
    thick = moving_shape("swelling")
    return with_noise(thick.assign(phase=1.4 * thick["phase"]), 0.6, seed=8)


@pytest.fixture(scope="module")
def compared(noisy: xr.Dataset) -> p4d.Comparison:
    return p4d.compare(noisy["wrapped"], ["spatial-2d", "temporal-angular", "directional-l1"])


def support(problem: Problem, result: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how rough the way to each pixel of a result gets, and how firmly it is held."""
    found = supports_by_steps(problem, {"result": Judged(InMemory(result))})["result"]
    every = Block(0, len(result))
    return found.roughest.read(every), found.held.read(every)


def noise_astray(wrapped: xr.DataArray) -> np.ndarray:
    return astray(Problem(wrapped)).read(Block(0, len(wrapped)))


@pytest.mark.slow
def test_wrong_pixels_are_the_doubted_ones(noisy: xr.Dataset, compared: p4d.Comparison) -> None:
    inside = noisy["phase"].values > 1
    for method, result in compared.results.items():
        trust = compared.confidence(method)
        assert trust.dims == result.dims
        assert trust.dtype == np.float32
        assert 0 <= trust.values.min() <= trust.values.max() <= 1
        wrong = np.round((result.values - noisy["phase"].values) / TURN) != 0
        assert wrong[inside].sum() > 20
        assert area_under_curve(-trust.values[inside], wrong[inside]) >= 0.97, method


@pytest.mark.slow
def test_trusted_pixels_are_right(noisy: xr.Dataset, compared: p4d.Comparison) -> None:
    for method, result in compared.results.items():
        wrong = np.round((result.values - noisy["phase"].values) / TURN) != 0
        trusted = compared.confidence(method).values > 0.99
        assert trusted.mean() > 0.5
        assert wrong[trusted].mean() < 0.01, method


@pytest.mark.thorough
def test_the_reference_is_computed_when_it_is_missing(noisy: xr.Dataset) -> None:
    alone = p4d.compare(noisy["wrapped"], ["spatial-2d"])
    both = p4d.compare(noisy["wrapped"], ["spatial-2d", "directional-l1"])
    found, expected = (c.confidence("spatial-2d").values for c in (alone, both))
    np.testing.assert_array_equal(found, expected)
    assert list(alone.results) == ["spatial-2d"]


@pytest.mark.thorough
def test_one_call_gives_what_a_comparison_gives(
    noisy: xr.Dataset, compared: p4d.Comparison
) -> None:
    for method in ("spatial-2d", "directional-l1"):
        alone = p4d.confidence(compared.results[method], noisy["wrapped"])
        xr.testing.assert_equal(alone, compared.confidence(method))
    plain = p4d.confidence(compared.results["spatial-2d"].values, noisy["wrapped"].values)
    np.testing.assert_array_equal(plain, compared.confidence("spatial-2d"))
    with pytest.raises(ValueError, match="the unwrapped phase is"):
        p4d.confidence(np.zeros((3, 4)), noisy["wrapped"])


@pytest.mark.thorough
def test_faint_pixels_are_doubted(noisy: xr.Dataset) -> None:
    result = p4d.unwrap(noisy["wrapped"], "directional-l1")
    amplitude = xr.ones_like(noisy["phase"])
    amplitude[:, :, 20:30] = 0.2
    plain = p4d.confidence(result, noisy["wrapped"], xr.ones_like(amplitude)).values
    faded = p4d.confidence(result, noisy["wrapped"], amplitude).values
    # Nothing hangs on how the empty field is reached.
    inside = noisy["phase"].values[:, :, 20:30] > 2
    assert inside.sum() > 1000
    assert (faded[:, :, 20:30] < plain[:, :, 20:30] - 0.1)[inside].mean() > 0.9


def test_the_way_to_a_pixel_is_as_rough_as_its_roughest_step() -> None:
    """A plateau behind a wall: as rough as the wall; the same a turn off: no way leads there."""
    flat = np.zeros((1, 1, 40, 40), dtype=np.float32)
    flat[..., 12:28, 12:28] = 2.0
    problem = Problem(flat)
    right, _ = support(problem, flat)
    assert right[0, 0, 2, 2] == 0
    # At the wall's corners the two walls share a box: D = 4 in one of three places and 2 in two.
    inside = right[0, 0, 14:26, 14:26]
    assert 1 < inside.min() <= inside.max() < 4
    off = flat.copy()
    off[..., 12:28, 12:28] += TURN
    assert support(problem, off)[0][0, 0, 14:26, 14:26].min() == 12


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "noise"), [("daughters", 0.7), ("touching", 0.9)])
def test_noisy_pixels_that_are_wrong_are_found(name: str, noise: float) -> None:
    """Shapes that the confidence was not fitted to; a smooth way leads to most wrong pixels.

    But they stand out: without asking for that, the areas are 0.92 and 0.96. A few dozen pixels
    are wrong, so that one draw of the noise says little. In one of these draws a daughter slips
    as a whole, of which the pixels round it tell nothing: the median counts.
    """
    exact = hard_shape(name) if name == "daughters" else moving_shape(name)
    inside = exact["phase"].values > 0.05
    areas, shares = [], []
    for seed in range(4, 12):
        data = with_noise(exact, noise, seed=seed)
        result = p4d.unwrap(data["wrapped"], "directional-l1")
        trust = p4d.confidence(result, data["wrapped"]).values
        wrong = np.round((result.values - data["phase"].values) / TURN) != 0
        assert wrong[inside].sum() > 20
        areas.append(area_under_curve(-trust[inside], wrong[inside]))
        trusted = inside & (trust > 0.99)
        assert trusted.sum() > 0.3 * inside.sum()
        shares.append(wrong[trusted].mean())
    assert np.median(areas) >= 0.97
    assert np.median(shares) < 0.001
    assert max(shares) < 0.01  # what they are given


@pytest.mark.parametrize("shape", [(17, 20), (1, 6), (2, 2)])
def test_the_median_of_nine_is_scipys(shape: tuple[int, int]) -> None:
    frame = np.random.default_rng(4).normal(0, 3, shape).astype(np.float32)
    expected = median_filter(frame, 3, mode="reflect")
    np.testing.assert_array_equal(median_of_nine(frame), expected)


def test_a_few_pixels_stand_out_slopes_and_edges_do_not() -> None:
    y, x = np.mgrid[:20, :20].astype(np.float32)
    smooth = np.stack([np.float32(2.5) * x + y, np.where(x < 10, 0, np.float32(TURN))])[:, None]
    np.testing.assert_array_equal(odds_in_line(smooth), 1)
    off = np.zeros_like(smooth)
    off[0, 0, 9, 5:7], off[1, 0, 4, 4] = -TURN, TURN
    found = odds_in_line(off)
    np.testing.assert_allclose(found[off != 0], np.exp(-3), rtol=1e-6)
    np.testing.assert_array_equal(found[off == 0], 1)
    # What is thin or small has no step of half a turn, unless it is thick: nobody can know then.
    np.testing.assert_array_equal(odds_in_line(np.clip(off, -3, 3)), 1)
    # Nothing is said beside what was left out, nor of that.
    holes = off + np.float32(9)
    holes[:, 0, 10, 5] = holes[:, 0, 4, 5] = np.nan
    assert (odds_in_line(holes)[:, 0, (9, 10, 4), (5, 5, 4)] == 1).all()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["touching", "daughters", "crossing"])
def test_objects_that_slip_where_much_changes_at_once_are_warned_of(name: str) -> None:
    """What changes has residues: its map has more than one phase. All else has none."""
    exact = moving_shape(name) if name == "touching" else hard_shape(name)
    data = with_fault(exact, "doubling", 0.5, seed=3)
    result = p4d.unwrap(data["wrapped"], "directional-l1")
    trust = p4d.confidence(result, data["wrapped"])
    said = slipped_frames(Problem(data["wrapped"]), trust)
    off = np.round((result.values - data["phase"].values) / TURN)
    inside = data["phase"].values > 2
    slipped = ((off != 0) & inside).sum((2, 3)) > 0.5 * inside.sum((2, 3))
    assert slipped.sum() >= 10
    assert (~slipped).sum() >= 10
    assert said[slipped].mean() >= 0.8
    assert said[~slipped].mean() <= 0.1


def swirl() -> np.ndarray:
    """Return a map (y, x) with two residues, in a disc round which it is empty."""
    y, x = np.mgrid[-16:16, -16:16]
    found = np.arctan2(y + 0.5, x - 4.5) - np.arctan2(y + 0.5, x + 5.5)
    found = np.where(np.hypot(y, x) < 11, found, 0).astype(np.float32)
    assert abs(residues(found)).values.sum() == 2
    return found


@pytest.mark.parametrize("frames", [1, 2, 8])
def test_residues_in_the_way_of_a_level_are_those_of_the_best_way(
    frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What grows step by step has none; what turns up at once has its own, or of its change."""
    monkeypatch.setattr(
        "napari_phase4d.unwrapping.directional.levels.working_blocks",
        lambda shape: blocks_of(shape, frames),
    )
    inside = swirl() != 0
    every = Block(0, 5)
    sudden = np.stack([0 * swirl(), swirl(), swirl(), 0 * swirl(), swirl()])[:, None]
    found = level_residues(Problem(sudden)).read(every)
    assert found[1, 0][inside].max() == 2
    assert found[0].max() == 0
    thin = np.float32(0.3) * inside
    growing = np.stack([thin, swirl() / 2, swirl(), swirl(), swirl()])[:, None]
    for order in (slice(None), slice(None, None, -1)):
        problem = Problem(growing[order].astype(np.float32))
        assert level_residues(problem).read(every).max() == 0


def test_what_is_not_known_vouches_for_no_level() -> None:
    """A hole in the mask of one frame lets no others through."""
    frames = np.stack([swirl()] * 5)[:, None]
    mask = np.ones(frames.shape, dtype=bool)
    mask[2, 0, 14:18, 14:18] = False
    counts = level_residues(Problem(frames, mask=mask)).read(Block(0, 5))
    assert (counts[[0, 1, 3, 4]][:, :, 14:18, 14:18] > 0).all()


@pytest.mark.thorough
@pytest.mark.parametrize(("side", "noise"), [(64, 0.9), (256, 0.9), (400, 0.7)])
def test_noise_is_no_reason_to_doubt_a_level(side: int, noise: float) -> None:
    """The same cell sampled finer has more pixels, and more residues that noise makes."""
    y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j]
    cap = np.sqrt(np.maximum(1 - (y**2 + x**2) / 0.5, 0))
    exact = (np.linspace(3, 14, 5)[:, None, None] * cap).astype(np.float32)[:, None]
    noisy = exact + noise * np.random.default_rng(side).normal(size=exact.shape)
    wrapped = xr.DataArray(
        ((noisy + np.pi) % TURN - np.pi).astype(np.float32), dims=("time", "angle", "y", "x")
    )
    result = p4d.unwrap(wrapped, "directional-l1")
    inside = exact > 0.05
    assert (np.round((result.values - noisy) / TURN) != 0)[inside].mean() < 0.01
    trust = p4d.confidence(result, wrapped).values
    assert trust[inside].mean() > 0.97
    assert slipped_frames(Problem(wrapped), xr.DataArray(trust, dims=wrapped.dims)).sum() <= 1


@pytest.mark.slow
@pytest.mark.parametrize("thicker", [1.5, 2.0])
def test_a_thick_cell_that_grows_fast_is_right_and_trusted(thicker: float) -> None:
    """Its rim is too steep for any frame alone; what changes, by up to 6 rad a frame, is smooth.

    So it is known, if the cell is not moved by what its growth looks like.
    """
    exact = moving_shape("returning")
    data = with_noise(exact.assign(phase=thicker * exact["phase"]), 0.2, seed=1)
    result = p4d.unwrap(data["wrapped"], "directional-l1")
    inside = exact["phase"].values > 0.05
    off = np.round((result.values - data["phase"].values) / TURN)
    assert (off != 0)[inside].mean() < 0.001
    said = slipped_frames(Problem(data["wrapped"]), p4d.confidence(result, data["wrapped"]))
    assert said.mean() <= 0.02


@pytest.fixture(scope="module")
def judged() -> tuple[xr.DataArray, xr.DataArray, xr.DataArray, np.ndarray]:
    """Return a phase, its right result as that of another method, its trust, and its field."""
    exact = moving_shape("swelling")
    phase = with_noise(exact, 0.2, seed=4)["wrapped"]
    right = p4d.unwrap(phase, "directional-l1").assign_attrs(method="other")
    return phase, right, p4d.confidence(right, phase), exact["phase"].values < 0.5


@pytest.mark.slow
def test_an_object_is_judged_above_the_field_of_its_frame(judged) -> None:
    """A frame that slips as a whole is right, an object whose field alone has slipped is not."""
    phase, right, trust, field = judged
    frame = (9, 1)

    whole = right.copy(deep=True)
    whole.values[frame] += TURN
    # A turn more leaves a float32 fewer digits, by which it stands out from its neighbours.
    np.testing.assert_allclose(p4d.confidence(whole, phase), trust, rtol=1e-5, atol=1e-6)

    field_only = right.copy(deep=True)
    field_only.values[frame][field[frame]] += TURN
    doubted = p4d.confidence(field_only, phase)
    assert doubted.values[frame][~field[frame]].mean() < 0.1
    assert doubted.values[frame][field[frame]].mean() > 0.9
    assert np.argwhere(slipped_frames(Problem(phase), doubted)).tolist() == [list(frame)]


@pytest.mark.thorough
@pytest.mark.slow
def test_an_object_above_a_torn_field_is_doubted(judged) -> None:
    """Half of the field is a turn off: above which half is the object to be measured?"""
    phase, right, trust, field = judged
    frame = (9, 1)
    inside = ~field[frame]

    def with_share_off(share: float) -> xr.DataArray:
        found = right.copy(deep=True)
        torn = np.random.default_rng(3).random(inside.shape) < share
        found.values[frame][field[frame] & torn] += TURN
        return p4d.confidence(found, phase)

    tenth = with_share_off(0.1)
    np.testing.assert_allclose(
        tenth.values[frame][inside], trust.values[frame][inside], atol=0.002
    )
    assert not slipped_frames(Problem(phase), tenth).any()
    half = with_share_off(0.5)
    assert half.values[frame][inside].max() < 0.7
    assert np.argwhere(slipped_frames(Problem(phase), half)).tolist() == [list(frame)]


def test_a_pixel_is_held_by_most_of_its_steps() -> None:
    """The inside of a steep cell is held less than that of a flat one; a turn off, not at all."""
    y, x = np.mgrid[-24:24, -24:24]
    held = []
    for peak in (3.0, 12.0):
        exact = (peak * np.exp(-(y**2 + x**2) / 60)).astype(np.float32)[None, None]
        problem = Problem(exact - np.float32(TURN) * np.round(exact / np.float32(TURN)))
        right = support(problem, exact)[1][0, 0, 20:28, 20:28]
        off = exact + np.float32(TURN) * (exact > 0.5 * peak)
        assert support(problem, off)[1][0, 0, 20:28, 20:28].max() <= 0
        held.append(float(right.mean()))
    assert held[0] > 1.5 * held[1] > 0


@pytest.mark.slow
def test_noise_beyond_half_a_turn_is_a_reason_for_doubt() -> None:
    exact = moving_shape("swelling")
    data = with_noise(exact, 0.5, seed=8)
    wrapped = data["wrapped"].copy()
    chance = noise_astray(wrapped)
    assert chance.max() < 0.2
    wrapped[4, 1, 32, 32] += 3.1 - (wrapped[4, 1, 32, 32] - exact["phase"][4, 1, 32, 32])
    wrapped = (wrapped + np.pi) % TURN - np.pi
    far = noise_astray(wrapped)
    assert far[4, 1, 32, 32] > 0.1
    assert not noise_astray(exact["wrapped"]).any()


@pytest.mark.slow
def test_a_slipped_object_is_said() -> None:
    data = moving_shape("tumbling")
    exact, problem = data["phase"], Problem(data["wrapped"])
    trust = p4d.confidence(exact, data["wrapped"])
    assert slip_warning(problem, trust) == ""
    slipped = exact.copy(deep=True)
    slipped[4] = slipped[4] + TURN * ~problem.background().mask[4]
    slipped[2, :, 30, 30] += TURN
    trust = p4d.confidence(slipped, data["wrapped"])
    said = slip_warning(problem, trust)
    assert said.startswith("in 4 of 80 frames most of an object may be off by a cycle")
    assert said.endswith("first in frame (time 4, angle 0), counted from 0")


def two_cells(gap: int) -> xr.Dataset:
    """Return a large cell and a small one beside it, with so many pixels between the two."""
    y, x = np.mgrid[:64, :64]
    frame = np.zeros((64, 64), dtype=np.float32)
    for radius, middle in ((11, 24), (7, 24 + 11 + gap + 7)):
        frame += 5 * np.sqrt(np.maximum(1 - ((y - 32) ** 2 + (x - middle) ** 2) / radius**2, 0))
    phase = xr.DataArray(np.tile(frame, (6, 2, 1, 1)), dims=("time", "angle", "y", "x"))
    wrapped = np.angle(np.exp(1j * phase)).astype(np.float32)
    return xr.Dataset({"phase": phase, "wrapped": phase.copy(data=wrapped)})


@pytest.mark.parametrize("noise", [0.0, 0.5])
@pytest.mark.parametrize("gap", [4, 2])
def test_a_cell_that_slipped_beside_another_is_said(gap: int, noise: float) -> None:
    """The field between the two is narrow, or there is none: one piece of what is not empty."""
    data = with_noise(two_cells(gap), noise, seed=6)
    problem, small = Problem(data["wrapped"]), np.arange(64) > 24 + 11
    inside = two_cells(gap)["phase"].values > 0
    slipped = data["phase"].copy(data=data["phase"].values + TURN * (inside & small))
    slipped[[0, 1, 2, 4, 5]] = data["phase"][[0, 1, 2, 4, 5]]
    trust = p4d.confidence(slipped, data["wrapped"])
    assert np.argwhere(slipped_frames(problem, trust)).tolist() == [[3, 0], [3, 1]]


@pytest.mark.parametrize("size", [(9, 9), (7, 30), (30, 30)])
def test_small_and_thin_pieces_are_objects(size: tuple[int, int]) -> None:
    """Of which nothing is left, or too little, when a rim is taken off."""
    phase = xr.DataArray(np.zeros((2, 1, 64, 64), np.float32), dims=("time", "angle", "y", "x"))
    phase[1, :, 8 : 8 + size[0], 8 : 8 + size[1]] = 3
    problem = Problem(phase)
    piece = ~problem.background().mask[1, 0]
    assert piece.sum() >= 60
    trust = np.ones(phase.shape, dtype=np.float32)
    for doubted, said in ((0.65, True), (0.75, False)):
        trust[1, 0][piece] = doubted
        found = slipped_frames(problem, phase.copy(data=trust))
        assert found.tolist() == [[False], [said]]


@pytest.mark.thorough
def test_verdict_says_what_to_use() -> None:
    data = with_noise(moving_shape("swelling"), 0.5, seed=8)
    found = p4d.compare(data["wrapped"], ["spatial-2d", "temporal-angular", "directional-l1"])
    verdict = found.verdict
    assert isinstance(verdict, Verdict)
    assert verdict.startswith("Use WL1: ")
    assert verdict.method == "directional-l1"
    assert verdict.frame is not None
    time, view = verdict.frame
    seconds, degrees = (data["wrapped"][axis].values for axis in ("time", "angle"))
    where = f"time {seconds[time]:.3g} s, angle {degrees[view]:g}°"
    assert f"disagree most at {where}, on" in verdict
    turns = [np.round((r.values - data["phase"].values) / TURN) for r in found.results.values()]
    differ = (turns[0] != turns[2]) | (turns[1] != turns[2])
    counts = (differ & found.object_mask().values).sum((2, 3))
    share = counts / found.object_mask().values.sum((2, 3))
    assert share[time, view] == share.max()
    assert verdict.disagreement_percent == pytest.approx(100 * share.max())
    alone = p4d.compare(data["wrapped"], ["spatial-2d"]).verdict
    assert alone.startswith("No result") or "is not safe" in alone
    assert "WL1 would leave" in alone


@pytest.mark.slow
def test_verdict_names_lost_frames_and_they_are_not_trusted() -> None:
    data = with_fault(hard_shape("ring", (48, 48), 8), "black frame", 0.2, seed=1)
    found = p4d.compare(data["wrapped"], ["temporal-angular", "directional-l1"])
    assert found.verdict.lost_frames == [(4, angle) for angle in range(4)]
    assert "4 of 32 frames say nothing" in found.verdict
    assert (found.confidence("directional-l1")[4] == 0).all()
    assert found.results["directional-l1"].attrs["lost_frames"] == [[4, a] for a in range(4)]


def test_one_frame_has_a_verdict() -> None:
    found = p4d.compare(moving_shape("swelling")["wrapped"][0, 0], ["spatial-2d"])
    assert found.verdict.startswith("2-D alone was run")
    assert found.verdict.frame is None


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("name", ["swelling", "returning", "touching"])
def test_suggested_frame_is_one_of_the_best(name: str, noise: float) -> None:
    data = with_noise(moving_shape(name), noise, seed=9)
    inside = moving_shape(name)["phase"].values > 0.05
    flat = p4d.unwrap(data["wrapped"], "spatial-2d")
    off = np.round((flat.values - data["phase"].values) / TURN) != 0
    wrong = (off & inside).sum((2, 3))
    own = p4d.unwrap(data["wrapped"], "directional-l1")
    for reference in (None, own):
        scores = p4d.score_boundaries(data["wrapped"], reference)
        assert scores.dims == ("time", "angle")
        np.testing.assert_array_equal(scores["angle"], data["angle"])
        best = tuple(scores.attrs["best"])
        assert scores.values[best] == scores.values.max()
        assert wrong[best] == wrong.min()
    # A frame that 2-D gets wrong scores lower than one that it gets right.
    assert scores.values[wrong == 0].min() > scores.values[wrong > 100].max()


@pytest.mark.thorough
def test_drift_is_no_reason_for_doubt() -> None:
    exact = moving_shape("returning")
    still = p4d.compare(with_noise(exact, 0.1, seed=1)["wrapped"], ["directional-l1"])
    data = with_noise(exact, 0.1, drift_rad=1.0, seed=1)
    for mask in (None, "auto"):
        drifting = p4d.compare(data["wrapped"], ["directional-l1"], mask=mask)
        assert drifting.warnings() == {}
        doubt = [1 - c.confidence("directional-l1").values.mean() for c in (still, drifting)]
        assert doubt[1] < 2 * doubt[0] + 1e-4


@pytest.mark.thorough
@pytest.mark.parametrize("axes", [{"angle": [1]}, {"time": [10]}, {"time": [10], "angle": [1]}])
def test_fewer_axes_are_trusted_less(axes: dict) -> None:
    """Of the pixels given so much chance to be wrong, about so many are."""
    chances, outcomes = [], []
    for name in ("dividing", "swelling", "touching", "vacuole"):
        data = with_noise(moving_shape(name), 0.5, seed=6).isel(axes)
        result = p4d.compare(data["wrapped"], ["directional-l1"])
        inside = moving_shape(name)["phase"].isel(axes).values > 1
        found = result.results["directional-l1"].values - data["phase"].values
        outcomes.append((np.round(found / TURN) != 0)[inside])
        chances.append(1 - result.confidence("directional-l1").values[inside])
    chance, wrong = np.concatenate(chances), np.concatenate(outcomes)
    trusted = chance < 0.1
    assert wrong.mean() < chance.mean() + 0.02  # rather too careful than too sure
    assert not trusted.any() or wrong[trusted].mean() < 0.1


@pytest.mark.slow
def test_drift_and_a_masked_reference_change_no_score() -> None:
    exact = moving_shape("swelling")
    scores = []
    for drift in (0.0, 1.0):
        wrapped = with_noise(exact, 0.2, drift, seed=3)["wrapped"]
        own = p4d.unwrap(wrapped, "directional-l1", mask="auto")
        scores.append(p4d.score_boundaries(wrapped, own))
    assert np.abs(scores[0] - scores[1]).max() < 0.05


@pytest.mark.slow
def test_nan_are_left_out_of_scores() -> None:
    y, x = np.mgrid[:64, :64] - 31.5
    wrapped = with_noise(moving_shape("swelling"), 0.2, seed=3)["wrapped"]
    scores = p4d.score_boundaries(wrapped.where(np.hypot(y, x) < 30))
    assert scores.values[0, 0] > 0.99
    assert scores.values[-1, 0] < 0.98


def test_scores_say_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match=r"reference is .* but the phase is"):
        p4d.score_boundaries(np.zeros((2, 2, 4, 4)), np.zeros((2, 2, 4, 5)))
    stopped = [False]
    with pytest.raises(p4d.Cancelled):
        p4d.score_boundaries(np.zeros((9, 2, 8, 8)), cancelled=lambda: not stopped[0])


def test_amplitude_has_to_fit() -> None:
    with pytest.raises(ValueError, match="the amplitude is"):
        p4d.unwrap(np.zeros((2, 2, 4, 4)), "directional-l1", amplitude=np.zeros((4, 5)))
