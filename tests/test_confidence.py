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
    np.testing.assert_array_equal(
        alone.confidence("spatial-2d").values, both.confidence("spatial-2d").values
    )
    assert list(alone.results) == ["spatial-2d"]


def test_faint_pixels_are_doubted(noisy: xr.Dataset) -> None:
    amplitude = xr.ones_like(noisy["phase"])
    amplitude[:, :, 20:30] = 0.2
    found = p4d.compare(noisy["wrapped"], ["directional-l1"], amplitude=amplitude)
    plain = confidence_of(found.results["directional-l1"], found.results["directional-l1"]).values
    faded = found.confidence("directional-l1").values
    assert (faded[:, :, 20:30] < plain[:, :, 20:30]).all()
    rest = [row for row in range(64) if not 20 <= row < 30]
    np.testing.assert_allclose(faded[:, :, rest], plain[:, :, rest])


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


def test_scores_say_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match=r"reference is .* but the phase is"):
        p4d.score_boundaries(np.zeros((2, 2, 4, 4)), np.zeros((2, 2, 4, 5)))
    stopped = [False]
    with pytest.raises(p4d.Cancelled):
        p4d.score_boundaries(np.zeros((9, 2, 8, 8)), cancelled=lambda: not stopped[0])


def test_amplitude_has_to_fit() -> None:
    with pytest.raises(ValueError, match="the amplitude is"):
        p4d.unwrap(np.zeros((2, 2, 4, 4)), "directional-l1", amplitude=np.zeros((4, 5)))
