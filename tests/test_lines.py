"""From which frames each line of frames is unwrapped (the paper's Fig. 1)."""

from __future__ import annotations

import numpy as np
import pytest

import napari_phase4d as p4d
from napari_phase4d.unwrapping.chain import starts_on
from napari_phase4d.unwrapping.problem import Problem

BOUNDARIES = [(3, 1), (5, 0), (0, 1)]


@pytest.mark.parametrize(
    ("dim", "line", "starts"),
    [
        ("time", 0, [5]),  # a line with thin frames starts at its own
        ("time", 1, [0, 3]),
        ("time", 2, [0, 3, 5]),  # one without starts where the others do
        ("angle", 3, [1]),
        ("angle", 5, [0]),
        ("angle", 4, [0, 1]),
    ],
)
def test_lines_start_at_their_thin_frames(dim: str, line: int, starts: list[int]) -> None:
    assert starts_on(dim, line, BOUNDARIES) == starts


def test_boundaries_may_be_counted_from_the_end() -> None:
    problem = Problem(np.zeros((5, 4, 6, 6), np.float32), boundary=[(-2, -1), (1, -4), (3, 3)])
    assert problem.boundaries == [(3, 3), (1, 0)]


@pytest.mark.parametrize("method", ["temporal", "temporal-angular", "angular-temporal"])
@pytest.mark.parametrize("split", [True, False])
@pytest.mark.parametrize(("moves", "mask"), [(0, None), (3, "auto")])
def test_an_unknown_frame_is_passed_over(
    method: str, moves: int, mask: str | None, *, split: bool
) -> None:
    """What is found is what is found without the frame: nothing starts at it, or follows it.

    A ball with a steep rim grows to 11 rad, as 2-D unwrapping can't follow, and shrinks again.
    """
    y, x = np.mgrid[:40, :70]
    shape = 1 / (1 + np.exp(np.clip(np.hypot(y - 20, x - 20) - 13, -50, 50) / 0.45))
    peaks = [0.5, 2, 3.5, 5, 6.5, 8, 9.5, 11, 9, 6, 3, 0.5, 3, 6]
    exact = np.array([np.roll(p * shape, moves * t, axis=1) for t, p in enumerate(peaks)])
    noise = np.random.default_rng(2).normal(0, 0.3, (len(peaks), 2, 40, 70))
    wrapped = np.angle(np.exp(1j * (exact[:, None] + noise))).astype(np.float32)
    wrapped[[4, 9]] = np.nan
    with_it = p4d.unwrap(wrapped, method, boundary=(0, 0), mask=mask, split=split).values
    without = np.delete(wrapped, [4, 9], axis=0)
    expected = p4d.unwrap(without, method, boundary=(0, 0), mask=mask, split=split).values
    assert np.isnan(with_it[[4, 9]]).all()
    np.testing.assert_array_equal(np.delete(with_it, [4, 9], axis=0), expected)
    two_d = p4d.unwrap(without, "spatial-2d", boundary=(0, 0), mask=mask).values
    assert not np.array_equal(two_d, expected)


def test_an_unknown_frame_costs_nothing_where_phase_changes_slowly() -> None:
    y, x = np.mgrid[:40, :70]
    shape = 1 / (1 + np.exp(np.clip(np.hypot(y - 20, x - 20) - 13, -50, 50) / 0.45))
    exact = (np.arange(0.5, 12, 1.5)[:, None, None, None] * shape).repeat(2, axis=1)
    wrapped = np.angle(np.exp(1j * exact)).astype(np.float32)
    wrapped[5] = wrapped[2, 1] = np.nan
    found = p4d.unwrap(wrapped, "temporal-angular", boundary=(0, 0)).values
    known = np.isfinite(wrapped)
    np.testing.assert_allclose(found[known], exact[known], atol=1e-4)
