"""Frames unwrapped as they come: the numbers are those of the finished recording."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import napari_phase4d as p4d
from napari_phase4d.unwrapping import CAUSAL, Causal, causal_methods, for_what_comes
from napari_phase4d.unwrapping.frames import border_values, median_and_field

OPTIONS = [
    {},
    {"spatial-2d": {"reliability": "coherence"}, "temporal": {"registration": False}},
]


@pytest.fixture(scope="module")
def wrapped() -> NDArray[np.float32]:
    """Noisy wrapped phase of a swimmer that gets thick and thin again; a frame is lost.

    The level of the empty field drifts by more than a turn.
    """
    sample = p4d.simulation.swimming_euglena((56, 72), 15, peak_rad=14)
    noise = np.random.default_rng(3).normal(0, 0.4, sample["wrapped"].shape)
    drift = np.linspace(0, 8, 15)[:, None, None, None]
    noisy = np.angle(np.exp(1j * (sample["wrapped"].values + noise + drift))).astype(np.float32)
    noisy[5] = np.nan
    return noisy


def as_they_come(
    wrapped: NDArray[np.float32],
    options: dict[str, dict[str, object]],
    cuts: list[int],
    *,
    mask: bool,
) -> dict[str, NDArray[np.float32]]:
    """Unwrap frames that come so many at a time."""
    causal = Causal(causal_methods(CAUSAL, options), [(0, 1)], finds_mask=mask)
    ends = np.cumsum(cuts)
    parts = [causal.more(part) for part in np.split(wrapped, ends)]
    return {m: np.concatenate([part[m] for part in parts]) for m in causal.methods}


@pytest.mark.slow
@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("mask", [True, False])
def test_all_at_once_gives_the_same(
    wrapped: NDArray[np.float32], options: dict[str, dict[str, object]], *, mask: bool
) -> None:
    settings = for_what_comes(options)
    found = as_they_come(wrapped, settings, [1, 1, 3, 2, 5], mask=mask)
    known = "auto" if mask else np.isfinite(wrapped)
    at_once = p4d.compare(wrapped, list(CAUSAL), (0, 1), mask=known, options=settings)
    assert list(found) == list(CAUSAL)
    for method, result in at_once.results.items():
        np.testing.assert_array_equal(found[method], result.values)
        assert np.ptp(result.values[0]) > 1


@pytest.mark.slow
@pytest.mark.parametrize("cuts", [[1, 1, 3, 2, 5], [7], list(np.ones(13, int))])
def test_a_slope_that_comes_and_goes_over_the_border_gives_the_same(cuts: list[int]) -> None:
    """Some frames show no empty field at their border; what comes later must not count there."""
    where = np.array([60, 50, 40, 30, 20, 10, 4, 1, 2, 12, 24, 36, 48, 60])
    slope = 0.8 * np.maximum(np.arange(56) - where[:, None], 0)
    exact = np.broadcast_to(slope[:, None, None], (14, 2, 48, 56))
    noise = np.random.default_rng(1).normal(0, 0.2, exact.shape)
    wrapped = np.angle(np.exp(1j * (exact + noise))).astype(np.float32)
    wrapped[6, 0] = np.nan
    levels = [median_and_field(border_values(f)) for f in (exact + noise)[:, 1].astype(np.float32)]
    shown = np.isfinite([field for _, field in levels])
    assert shown[0]
    assert shown.any()
    assert not shown.all()
    found = as_they_come(wrapped, for_what_comes({}), cuts, mask=True)
    at_once = p4d.compare(wrapped, list(CAUSAL), (0, 1), mask="auto", options=for_what_comes({}))
    for method, result in at_once.results.items():
        np.testing.assert_array_equal(found[method], result.values)


@pytest.mark.slow
def test_the_future_does_not_count(wrapped: NDArray[np.float32]) -> None:
    settings = for_what_comes({})
    changed = wrapped.copy()
    changed[9:] = changed[9:, :, ::-1, ::-1]
    first, second = (as_they_come(w, settings, [4, 4], mask=True) for w in (wrapped, changed))
    for method in CAUSAL:
        np.testing.assert_array_equal(first[method][:9], second[method][:9])
        assert not np.array_equal(first[method][9:], second[method][9:])


def test_lines_that_start_anew_are_left_to_the_end() -> None:
    assert set(causal_methods(CAUSAL, {})) == {"spatial-2d", "angular"}
    assert set(causal_methods(["directional-l1", "temporal"], for_what_comes({}))) == {"temporal"}


def test_frames_are_unwrapped_from_the_first_one_on() -> None:
    with pytest.raises(ValueError, match="give time 0"):
        Causal({}, [(3, 0)], finds_mask=True)
