"""The budding yeast of the paper's section 3."""

from __future__ import annotations

import numpy as np
import pytest

import napari_phase4d as p4d
from napari_phase4d.evaluation import itoh_margin
from napari_phase4d.simulation import budding_yeast


def test_axes_are_the_papers() -> None:
    data = budding_yeast()
    assert data["phase"].shape == (19, 6, 48, 48)
    np.testing.assert_allclose(data["angle"], [0, 5, 10, 15, 20, 25])
    np.testing.assert_allclose(np.diff(data["time"]), 60)
    assert data.attrs["boundary"] == (0, 0)


def test_only_the_first_times_can_be_unwrapped_frame_by_frame() -> None:
    data = budding_yeast()
    phase, first = data["phase"], p4d.unwrap(data["wrapped"], "spatial-2d")
    wrong = (np.abs(first - phase) > np.pi).sum(("y", "x")).values
    assert wrong[0, 0] == 0
    assert (wrong[2:] > 0).all()


def test_same_cell_on_a_finer_grid() -> None:
    coarse = budding_yeast((24, 24), 3)["phase"]
    fine = budding_yeast((48, 48), 3)["phase"]
    np.testing.assert_allclose(fine.values[..., ::2, ::2], coarse.values, atol=1e-5)


def test_errors_come_in_the_papers_order() -> None:
    """2-D > angular > temporal >= T/A and A/T, these near 0.8 rad^2, LBE worse than 2-D."""
    data = budding_yeast()
    mse = p4d.compare(data["wrapped"], truth=data["phase"], mask="auto").table["mse_rad2"]
    assert 2.0 <= mse["spatial-2d"] <= 3.1
    assert mse["spatial-2d"] > mse["angular"] > mse["temporal"]
    for both in ("temporal-angular", "angular-temporal"):
        assert mse["temporal"] >= mse[both]
        assert mse[both] == pytest.approx(0.8, abs=0.2)
    assert mse["laplacian"] > mse["spatial-2d"]


def test_steps_are_too_steep_in_every_dimension_somewhere() -> None:
    margin = itoh_margin(budding_yeast()["phase"])
    shares = {name: margin[name].attrs["share_beyond"] for name in margin.data_vars}
    assert all(share > 0 for share in shares.values()), shares
