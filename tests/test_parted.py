"""Views that dead lines of a camera cut into parts: the field goes on behind them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.simulation import moving_shape, with_noise
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import Problem
from napari_phase4d.unwrapping.directional.graph import (
    DeadLines,
    behind_dead_lines,
    dead_lines,
)
from napari_phase4d.unwrapping.directional.methods import prepared

TURN = 2 * np.pi
METHODS = ("spatial-2d", "temporal-angular", "directional-l1")


def with_dead_columns(phase: xr.DataArray, *starts: int) -> xr.DataArray:
    """Return phase without some columns, two each."""
    dead = np.isin(np.arange(64), [c for start in starts for c in (start, start + 1)])
    return phase.where(xr.DataArray(~dead, dims="x"))


def compared(exact: xr.Dataset, *starts: int) -> p4d.Comparison:
    wrapped = with_dead_columns(exact["wrapped"], *starts)
    mask = np.isfinite(wrapped.values)
    return p4d.compare(exact["wrapped"], METHODS, mask=mask, truth=exact["phase"])


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.2, 0.4])
@pytest.mark.parametrize("shape", ["tumbling", "dividing", "translating"])
@pytest.mark.parametrize("column", [32, 24])
def test_a_cell_with_dead_columns_is_trusted_where_it_is_right(
    shape: str, noise: float, column: int
) -> None:
    """Half of it was more likely wrong than right, as no step led there from the other half."""
    exact = with_noise(moving_shape(shape, n_times=12), noise, seed=3)
    found = compared(exact, column)
    whole = p4d.compare(exact["wrapped"], METHODS)
    assert found.verdict.method == "directional-l1"
    assert found.verdict.doubtful_percent < whole.verdict.doubtful_percent + 1.5
    object_ = (np.abs(exact["phase"].values) > 0.5) & np.isfinite(found.results[METHODS[0]].values)
    object_ &= ~np.isin(np.arange(64), (column, column + 1))
    for method, result in found.results.items():
        wrong = np.rint((result.values - exact["phase"].values) / TURN) != 0
        sure = (found.confidence(method).values > 0.99) & object_
        assert sure.any(), method
        assert np.count_nonzero(wrong & sure) <= 0.01 * sure.sum(), method


def plateau(height: float, steep: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Return phase (time, angle, y, x) of a flat, round cell, and how far its rim is."""
    y, x = np.mgrid[:64, :64]
    from_rim = np.hypot(y - 32, x - 32) - 19
    rise = 1 / (1 + np.exp(from_rim / (steep / 4)))
    return np.broadcast_to(height * rise, (8, 2, 64, 64)).astype(np.float32), from_rim


def judged(exact: np.ndarray, mask: np.ndarray) -> p4d.Comparison:
    noise = np.random.default_rng(0).normal(0, 0.2, exact.shape)
    wrapped = np.angle(np.exp(1j * (exact + noise))).astype(np.float32)
    return p4d.compare(wrapped, METHODS, mask=np.broadcast_to(mask, exact.shape))


def sure_and_wrong(found: p4d.Comparison, exact: np.ndarray, mask: np.ndarray) -> float:
    """Return which share at most is wrong of the pixels that a result is sure of."""
    shares = []
    for method, result in found.results.items():
        wrong = (np.rint((result.values - exact) / TURN) != 0) & mask
        sure = (found.confidence(method).values > 0.99) & mask
        shares.append(np.count_nonzero(wrong & sure) / max(np.count_nonzero(sure), 1))
    return max(shares)


@pytest.mark.slow
@pytest.mark.parametrize("height", [5.8, TURN, 6.8, 2 * TURN])
def test_what_a_mask_of_another_form_cuts_off_is_not_trusted(height: float) -> None:
    """A flat cell about whole turns high, without its rim, looks like field."""
    exact, from_rim = plateau(height)
    mask = np.abs(from_rim) > 4
    found = judged(exact, mask)
    assert sure_and_wrong(found, exact, mask) <= 0.01
    assert not found.verdict.is_safe


@pytest.mark.slow
@pytest.mark.parametrize("height", [TURN, 6.7])
def test_a_flat_cell_behind_dead_columns_is_no_field(height: float) -> None:
    """It faces the rest of the cell there, and not the field."""
    exact, _ = plateau(height)
    mask = ~np.isin(np.arange(64), (24, 25, 40, 41))
    found = judged(exact, np.broadcast_to(mask, (64, 64)))
    assert sure_and_wrong(found, exact, np.broadcast_to(mask, (64, 64))) <= 0.01


@pytest.mark.slow
def test_parts_are_held_the_same_on_disk(tmp_path: Path) -> None:
    exact = with_noise(moving_shape("tumbling", n_times=9), 0.2, seed=1)
    path = p4d.write_phase(tmp_path / "p.ome.zarr", with_dead_columns(exact["wrapped"], 32))
    recipe = p4d.Recipe(
        recording=str(path), content="phase", boundary=((0, 0),), methods=METHODS, confidence=True
    )
    held, lying = (
        p4d.run(recipe.changed(storage=storage), folder=tmp_path / storage).comparison
        for storage in ("memory", "disk")
    )
    assert held.verdict == lying.verdict
    assert held.verdict.doubtful_percent < 2
    for method in METHODS:
        xr.testing.assert_equal(held.confidence(method).compute(), lying.confidence(method))


def test_dead_lines_are_thin_and_known_in_no_frame() -> None:
    wrapped = moving_shape("tumbling", n_times=4)["wrapped"].values

    def dead(mask: np.ndarray) -> list[list[int]] | None:
        problem = Problem(wrapped, mask=mask)
        lines = dead_lines(prepared(problem, UNWATCHED).scene)
        return lines and [np.flatnonzero(each.columns).tolist() for each in lines]

    mask = np.ones(wrapped.shape, dtype=bool)
    assert dead(mask) is None
    mask[:, 1, :, 30:32] = False
    mask[:, 2, :, 40:46] = False  # too many
    mask[:, 3, :, :2] = False  # the edge of the view
    mask[:, 0, 3:, 50] = False  # not from edge to edge
    assert dead(mask) == [[], [30, 31], [], []]
    mask[2, 1, 5, 30:32] = True  # known once
    assert dead(mask) is None


def test_field_goes_on_behind_dead_lines_where_it_faces_itself() -> None:
    numbers = np.zeros((20, 30), dtype=np.int32)
    numbers[:, 12:] = 1
    numbers[13:, 15:] = 2
    numbers[:5, 21:] = 3
    numbers[5:, 21:] = 4
    rows, columns = np.zeros(20, dtype=bool), np.isin(np.arange(30), (10, 11, 20))
    numbers[:, columns] = -1
    # 4 faces 1 over eight pixels; 3 does over five, and 2 faces 4 over seven.
    assert sorted(behind_dead_lines(numbers, DeadLines(rows, columns), 0)) == [1, 4]
    assert sorted(behind_dead_lines(numbers.T, DeadLines(columns, rows), 0)) == [1, 4]
    assert behind_dead_lines(numbers, DeadLines(rows, columns), 2) == []
    assert behind_dead_lines(numbers, DeadLines(rows, ~columns & False), 0) == []
