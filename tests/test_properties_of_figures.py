"""What holds for scores and tables of any phase, on examples that hypothesis makes up."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

import napari_phase4d as p4d
from helpers import wrap
from made_up import Case, gentle_cell, noise, quick
from napari_phase4d.analysis import mean_squared_error, wrong_cycle_share

TURN = 2 * np.pi
DIMS = ("time", "angle", "y", "x")


@pytest.mark.slow
@quick
@given(case=gentle_cell())
def test_frames_that_both_unwrappers_get_right_are_safe(case: Case) -> None:
    scores = p4d.score_boundaries(wrap(case.phase))
    assert scores.dims == ("time", "angle")
    assert ((scores > 0.998) & (scores <= 1)).all()
    assert scores.values[tuple(scores.attrs["best"])] == scores.max()
    assert scores.attrs["agreement"] == 1
    reference = p4d.unwrap(wrap(case.phase), "directional-l1")
    assert (p4d.score_boundaries(wrap(case.phase), reference) > 0.998).all()


@pytest.mark.filterwarnings("ignore:phase (is just|jumps by)")  # as some made-up noise does
@pytest.mark.slow
@quick
@given(case=noise())
def test_scores_are_shares(case: Case) -> None:
    before = case.phase.copy()
    scores = p4d.score_boundaries(case.phase)
    assert ((scores >= 0) & (scores <= 1)).all()
    assert scores.values[tuple(scores.attrs["best"])] == scores.max()
    xr.testing.assert_identical(scores, p4d.score_boundaries(case.phase))
    np.testing.assert_array_equal(case.phase, before)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:phase (is just|jumps by)")
@quick
@given(case=noise(), wrong=st.integers(-3, 3))
def test_table_counts_what_was_put_in(case: Case, wrong: int) -> None:
    """Against a truth that is the result plus whole turns on known pixels."""
    method = "spatial-2d"
    result = p4d.unwrap(case.phase, method, case.boundary)
    off = np.random.default_rng(case.seed).random(case.phase.shape) < 0.3
    truth = result.values.astype(np.float64) + TURN * wrong * off
    row = p4d.compare(case.phase, [method], case.boundary, truth).table.loc[method]
    share = off.mean() if wrong else 0.0
    assert row["wrong_cycles_percent"] == pytest.approx(100 * share)
    assert row["mse_rad2"] == pytest.approx((TURN * wrong) ** 2 * share, abs=1e-9)
    exact = xr.DataArray(truth, dims=DIMS)
    assert wrong_cycle_share(result, exact) == pytest.approx(share)
    assert mean_squared_error(result, exact) == pytest.approx(row["mse_rad2"])
