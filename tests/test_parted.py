"""Views that a mask from edge to edge cuts into parts: the level of each is told by its field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.simulation import moving_shape, with_noise
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import Problem
from napari_phase4d.unwrapping.directional.graph import parts_of_views
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


@pytest.mark.slow
def test_a_part_without_field_is_not_trusted() -> None:
    """Nothing tells its level."""
    exact = moving_shape("vacuole", n_times=8, shape=(64, 64))
    middle = np.zeros((64, 64), dtype=bool)
    middle[26:38, 26:38] = True  # inside of the cell
    rim = np.zeros_like(middle)
    rim[24:40, 24:40] = True
    mask = np.broadcast_to(~(rim & ~middle), exact["wrapped"].shape)
    found = p4d.compare(exact["wrapped"], METHODS, mask=mask, truth=exact["phase"])
    thick = (exact["phase"].values > 4) & middle
    assert thick.mean() > 0.01
    assert np.median(found.confidence("directional-l1").values[thick]) < 0.9


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


def test_parts_are_what_is_never_known_between() -> None:
    wrapped = moving_shape("tumbling", n_times=4)["wrapped"].values

    def parts(mask: np.ndarray) -> np.ndarray | None:
        problem = Problem(wrapped, mask=np.broadcast_to(mask, wrapped.shape))
        return parts_of_views(prepared(problem, UNWATCHED).scene)

    mask = np.ones(wrapped.shape, dtype=bool)
    assert parts(mask) is None
    mask[:, 1, :, 30] = False
    found = parts(mask)
    assert found is not None
    assert (found[[0, 2, 3]] == 1).all()
    assert (found[1, :, :30] == 1).all()
    assert (found[1, :, 31:] == 2).all()
    assert (found[1, :, 30] == 0).all()
    mask[2, 1, 5, 30] = True  # known once
    assert parts(mask) is None
