"""Maps of confidence, warnings, and scores of boundary frames."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.stats import rankdata

import napari_phase4d as p4d
from napari_phase4d.evaluation import confidence_of, firmness, slip_warning, unsteadiness
from napari_phase4d.simulation import moving_shape, with_noise
from napari_phase4d.unwrapping.background import find_background

TURN = 2 * np.pi


@pytest.fixture(scope="module")
def noisy() -> xr.Dataset:
    return with_noise(moving_shape("swelling"), 0.6, seed=8)


@pytest.fixture(scope="module")
def compared(noisy: xr.Dataset) -> p4d.Comparison:
    return p4d.compare(noisy["wrapped"], ["spatial-2d", "temporal-angular", "directional-l1"])


def area_under_curve(score: np.ndarray, wrong: np.ndarray) -> float:
    n = wrong.sum()
    return float((rankdata(score)[wrong].sum() - n * (n + 1) / 2) / (n * (~wrong).sum()))


def test_wrong_pixels_are_the_doubted_ones(noisy: xr.Dataset, compared: p4d.Comparison) -> None:
    inside = noisy["phase"].values > 1
    for method, result in compared.results.items():
        least = 0.95 if method == "directional-l1" else 0.97
        trust = compared.confidence(method)
        assert trust.dims == result.dims
        assert trust.dtype == np.float32
        assert 0 <= trust.values.min() <= trust.values.max() <= 1
        wrong = np.round((result.values - noisy["phase"].values) / TURN) != 0
        assert wrong[inside].sum() > 50
        assert area_under_curve(-trust.values[inside], wrong[inside]) >= least


def test_trusted_pixels_are_right(noisy: xr.Dataset, compared: p4d.Comparison) -> None:
    for method, result in compared.results.items():
        wrong = np.round((result.values - noisy["phase"].values) / TURN) != 0
        trusted = compared.confidence(method).values > 0.9
        assert wrong[trusted].mean() < 0.01, method


def test_the_reference_is_computed_when_it_is_missing(noisy: xr.Dataset) -> None:
    alone = p4d.compare(noisy["wrapped"], ["spatial-2d"])
    both = p4d.compare(noisy["wrapped"], ["spatial-2d", "directional-l1"])
    # scikit-image orders the frame's outermost pixels by chance.
    inner = (..., slice(1, -1), slice(1, -1))
    found, expected = (c.confidence("spatial-2d").values[inner] for c in (alone, both))
    np.testing.assert_array_equal(found, expected)
    assert list(alone.results) == ["spatial-2d"]


def test_faint_pixels_are_doubted(noisy: xr.Dataset) -> None:
    amplitude = xr.ones_like(noisy["phase"])
    amplitude[:, :, 20:30] = 0.2
    found = p4d.compare(noisy["wrapped"], ["directional-l1"], amplitude=amplitude)
    plain = confidence_of(found.results["directional-l1"], found.results["directional-l1"]).values
    faded = found.confidence("directional-l1").values
    assert (faded[:, :, 20:30] < plain[:, :, 20:30] - 0.001).mean() > 0.99
    rest = [row for row in range(64) if not 20 <= row < 30]
    np.testing.assert_allclose(faded[:, :, rest], plain[:, :, rest], atol=0.02)


def test_unsteadiness_by_hand() -> None:
    stack = xr.DataArray(np.zeros((2, 1, 3, 3)), dims=("time", "angle", "y", "x"))
    stack[0, 0, 1, 1] = TURN
    found = unsteadiness(stack).values
    assert found[0, 0, 1, 1] == pytest.approx(6)  # the one step in time counts twice
    assert found[0, 0, 1, 0] == pytest.approx(2)
    assert found[0, 0, 0, 0] == 0
    assert found[1, 0, 1, 1] == pytest.approx(2)


def test_a_slipped_object_is_said() -> None:
    data = moving_shape("tumbling")
    exact = data["phase"]
    empty = exact.copy(data=find_background(data["wrapped"].values).mask)
    assert slip_warning(exact, exact, empty) == ""
    slipped = exact.copy(deep=True)
    slipped[4] = slipped[4] + TURN * (~empty[4])
    slipped[2, :, 30, 30] += TURN
    assert "in 4 of 80 frames most of the object" in slip_warning(slipped, exact, empty)
    tie = firmness(slipped, empty)
    assert tie.dims == ("time", "angle")
    assert (tie[4] < tie[0]).all()
    assert float(firmness(exact, empty).min()) > 0.7


def test_a_loosely_tied_object_is_said() -> None:
    rng = np.random.default_rng(1)
    stack = xr.DataArray(np.zeros((4, 1, 16, 16)), dims=("time", "angle", "y", "x"))
    inside = np.zeros(stack.shape, dtype=bool)
    inside[:, :, 5:11, 5:11] = True
    stack.values[inside] = rng.choice([5.0, 12.0, 20.0], inside.sum())
    assert "few steps tie the object" in slip_warning(stack, stack, stack.copy(data=~inside))


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


def test_drift_is_no_reason_for_doubt() -> None:
    exact = moving_shape("returning")
    still = p4d.compare(with_noise(exact, 0.1, seed=1)["wrapped"], ["directional-l1"])
    data = with_noise(exact, 0.1, drift_rad=1.0, seed=1)
    for mask in (None, "auto"):
        drifting = p4d.compare(data["wrapped"], ["directional-l1"], mask=mask)
        assert drifting.warnings() == {}
        doubt = [1 - c.confidence("directional-l1").values.mean() for c in (still, drifting)]
        assert doubt[1] < 2 * doubt[0] + 1e-4


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


def test_drift_and_a_masked_reference_change_no_score() -> None:
    exact = moving_shape("swelling")
    scores = []
    for drift in (0.0, 1.0):
        wrapped = with_noise(exact, 0.2, drift, seed=3)["wrapped"]
        own = p4d.unwrap(wrapped, "directional-l1", mask="auto")
        scores.append(p4d.score_boundaries(wrapped, own))
    assert np.abs(scores[0] - scores[1]).max() < 0.05


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
