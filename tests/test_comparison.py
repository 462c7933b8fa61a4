"""Methods one after another: what is kept, what is said, and the columns of the table."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import difference, mean_squared_error, wrong_cycle_share
from napari_phase4d.machine import measured
from napari_phase4d.simulation import moving_shape, with_noise

TURN = 2 * np.pi
METHODS = ["spatial-2d", "temporal-angular", "directional-l1"]
COSTS = ["method", "seconds", "peak_mb"]
ERRORS = ["mse_rad2", "wrong_cycles_percent"]


@pytest.fixture(scope="module")
def noisy() -> xr.Dataset:
    return with_noise(moving_shape("swelling"), 0.6, seed=8)


@pytest.fixture(scope="module")
def compared(noisy: xr.Dataset) -> p4d.Comparison:
    return p4d.compare(noisy["wrapped"], METHODS)


@pytest.mark.slow
def test_finished_results_are_not_lost(noisy: xr.Dataset, compared: p4d.Comparison) -> None:
    kept: list[p4d.Comparison] = []
    names: list[str] = []

    def finished(method: str, so_far: p4d.Comparison) -> None:
        names.append(method)
        kept.append(so_far)

    with pytest.raises(p4d.Cancelled):
        p4d.compare(
            noisy["wrapped"],
            METHODS,
            truth=noisy["phase"],
            cancelled=lambda: len(kept) == 2,
            finished=finished,
        )
    assert names == METHODS[:2]
    assert [list(so_far.results) for so_far in kept] == [METHODS[:1], METHODS[:2]]
    assert [list(so_far.table.index) for so_far in kept] == [METHODS[:1], METHODS[:2]]
    assert list(kept[1].table.columns) == [*COSTS, *ERRORS]
    for method, result in kept[1].results.items():
        # scikit-image orders the frame's outermost pixels by chance.
        inner = (..., slice(1, -1), slice(1, -1))
        np.testing.assert_array_equal(result[inner], compared.results[method][inner])
        error = mean_squared_error(result, noisy["phase"])
        assert kept[1].table.loc[method, "mse_rad2"] == pytest.approx(error)
    # What was kept still tells how far it is to be trusted.
    assert kept[1].confidence("spatial-2d").shape == noisy["phase"].shape


def test_what_comes_last_is_what_is_returned(noisy: xr.Dataset) -> None:
    kept = {}
    options = {"spatial-2d": {"reliability": "coherence"}}
    found = p4d.compare(noisy["wrapped"], METHODS[:2], options=options, finished=kept.__setitem__)
    assert list(kept) == list(found.results) == METHODS[:2]
    pd.testing.assert_frame_equal(kept[METHODS[1]].table, found.table)
    assert all(kept[METHODS[1]].results[m] is found.results[m] for m in METHODS[:2])
    assert found.table.index.name == "id"


@pytest.mark.slow
def test_progress_names_the_method(noisy: xr.Dataset) -> None:
    said: list[tuple[int, int, str]] = []
    options = {"spatial-2d": {"reliability": "coherence"}}
    p4d.compare(
        noisy["wrapped"],
        ["spatial-2d", "temporal-angular"],
        options=options,
        progress=lambda *step: said.append(step),
    )
    alone: list[tuple[int, int, str]] = []
    p4d.unwrap(
        noisy["wrapped"],
        "spatial-2d",
        reliability="coherence",
        progress=lambda *step: alone.append(step),
    )
    first = [step for step in said if step[2].startswith("2-D (coherence) (1 of 2): ")]
    rest = [step for step in said if step[2].startswith("T/A (2 of 2): ")]
    assert said == first + rest
    assert first == [(d, n, f"2-D (coherence) (1 of 2): {words}") for d, n, words in alone]
    assert len({step[2] for step in rest}) > 1  # its own steps are told apart


@pytest.mark.slow
def test_against_is_what_compare_with_truth_says(
    noisy: xr.Dataset, compared: p4d.Comparison
) -> None:
    truth = noisy["phase"].copy(deep=True)
    truth[0, 0, :9] = np.nan  # not known there
    found = compared.against(truth)
    assert list(found.table.columns) == [*COSTS, *ERRORS]
    for method, result in compared.results.items():
        assert found.results[method] is result
        row = found.table.loc[method]
        assert row["mse_rad2"] == pytest.approx(mean_squared_error(result, truth))
        share = wrong_cycle_share(result, truth)
        assert row["wrong_cycles_percent"] == pytest.approx(100 * share)
    assert found.table.loc["spatial-2d", "wrong_cycles_percent"] > 0.1
    other = found.against(compared.results["directional-l1"].values)
    assert other.table.loc["directional-l1", "mse_rad2"] == 0
    pd.testing.assert_frame_equal(found.against(None).table, compared.table)
    assert list(compared.table.columns) == COSTS
    with pytest.raises(ValueError, match="truth is .* but the phase is"):
        compared.against(np.zeros((2, 2)))


@pytest.mark.slow
def test_doubtful_pixels_of_the_object_are_counted(
    noisy: xr.Dataset, compared: p4d.Comparison
) -> None:
    maps = {method: compared.confidence(method) for method in METHODS[:2]}
    found = compared.against(noisy["phase"]).with_doubt(maps)
    assert list(found.table.columns) == [*COSTS, "doubtful_percent", *ERRORS]
    inside = ~compared.problem.background().mask
    assert 0.1 < inside.mean() < 0.9
    for method, trust in maps.items():
        expected = 100 * (trust.values[inside] < 0.5).mean()
        assert found.table.loc[method, "doubtful_percent"] == pytest.approx(expected)
    # Wrong pixels of the simulated object are found again, as far as confidence tells them.
    body = moving_shape("swelling")["phase"].values > 0
    off = np.round((compared.results["spatial-2d"] - noisy["phase"]).values / TURN) != 0
    share = found.table.loc["spatial-2d", "doubtful_percent"]
    assert share == pytest.approx(100 * off[body].mean(), rel=0.5)
    assert np.isnan(found.table.loc["directional-l1", "doubtful_percent"])
    assert "doubtful_percent" not in found.with_doubt({}).table
    with pytest.raises(ValueError, match="no result of 'laplacian'; there are spatial-2d, "):
        compared.with_doubt({"laplacian": maps["spatial-2d"]})


def test_doubt_leaves_out_what_the_mask_leaves_out() -> None:
    wrapped = moving_shape("swelling")["wrapped"].isel(time=slice(6), angle=1)
    mask = np.zeros(wrapped.shape, bool)
    mask[:, 8:] = True
    compared = p4d.compare(wrapped, ["spatial-2d"], mask=mask)
    inside = (mask[:, None] & ~compared.problem.background().mask)[:, 0]
    assert 0.05 < inside.mean() < 0.8
    trust = xr.ones_like(wrapped)
    trust[:, :8] = 0  # not looked at
    trust[2] = 0.2
    trust[3] = 0.5  # not below a half
    expected = 100 * inside[2].sum() / inside.sum()
    for given in (trust, trust.transpose("x", "time", "y")):
        found = compared.with_doubt({"spatial-2d": given}).table
        assert found.loc["spatial-2d", "doubtful_percent"] == pytest.approx(expected)


def test_without_an_object_all_usable_pixels_count() -> None:
    flat = xr.DataArray(np.zeros((3, 1, 20, 20), np.float32), dims=("time", "angle", "y", "x"))
    mask = np.ones(flat.shape, bool)
    mask[..., :5] = False
    compared = p4d.compare(flat, ["spatial-2d"], mask=mask)
    assert compared.problem.background().mask[mask].all()
    trust = xr.ones_like(flat)
    trust[0] = 0.1
    found = compared.with_doubt({"spatial-2d": trust}).table
    assert found.loc["spatial-2d", "doubtful_percent"] == pytest.approx(100 / 3)


@pytest.mark.slow
def test_difference_of_two_results(noisy: xr.Dataset, compared: p4d.Comparison) -> None:
    result, reference = (compared.results[m] for m in ("spatial-2d", "directional-l1"))
    found = difference(result, reference)
    assert found.dtype == np.float32
    told = {"kind": "unwrapped", "units": "rad", "method": "spatial-2d", "less": "WL1"}
    assert found.attrs == told
    np.testing.assert_array_equal(found.values, result.values - reference.values)
    np.testing.assert_array_equal(found["angle"], result["angle"])
    turns = found.values / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-4)
    assert (np.round(turns) != 0).any()
    np.testing.assert_array_equal(
        difference(result, reference.transpose("x", "angle", "y", "time")), found
    )
    exact = moving_shape("swelling")["phase"]
    assert difference(result, exact).attrs["less"] == "exact phase"
    named = reference.copy().assign_attrs(method="mine").rename("another")
    assert difference(result, named).attrs["less"] == "another"
    coherent = p4d.unwrap(noisy["wrapped"][:1], "spatial-2d", reliability="coherence")
    assert difference(result[:1], coherent).attrs["less"] == "2-D (coherence)"
    with pytest.raises(ValueError, match="they must be of the same frames"):
        difference(result, reference[:, :1])


def test_what_a_mask_left_out_differs_by_nothing(noisy: xr.Dataset) -> None:
    wrapped = noisy["wrapped"]
    half = np.zeros(wrapped.shape, bool)
    half[..., :32] = True
    full = p4d.unwrap(wrapped, "spatial-2d")
    left = p4d.unwrap(wrapped, "spatial-2d", mask=half)
    for found, sign in ((difference(full, left), 1), (difference(left, full), -1)):
        assert (found.values[~half] == 0).all()
        expected = sign * (full.values - left.values)
        np.testing.assert_array_equal(found.values[half], expected[half])
    assert (full.values[~half] != 0).all()


def test_memory_is_measured_without_tracing() -> None:
    """Turning tracing off while other threads allocate crashes some versions of Python."""
    tracing: list[bool] = []
    wrapped = np.angle(np.exp(1j * np.linspace(0, 20, 4 * 30 * 30).reshape(2, 2, 30, 30)))
    p4d.compare(
        wrapped, ["spatial-2d"], progress=lambda *_: tracing.append(tracemalloc.is_tracing())
    )
    assert tracing
    assert not any(tracing)


@pytest.mark.slow
def test_peak_memory_is_that_of_the_process() -> None:
    size = 300 * 2**20

    def work() -> int:
        taken = np.ones(size, dtype=np.uint8)
        time.sleep(0.2)  # so that it is looked at while all of it is there
        return int(taken[-1])

    assert 290 <= measured(work).peak_mb <= 400


@pytest.mark.slow
def test_confidence_is_asked_for_by_id_or_label(compared: p4d.Comparison) -> None:
    expected = compared.confidence("temporal-angular")
    found = compared.confidence("T/A")
    assert found.attrs["of"] == "temporal-angular"
    np.testing.assert_array_equal(found.values, expected.values)
    assert list(compared.confidences(["2-D"])) == ["spatial-2d"]


@pytest.mark.parametrize("method", ["Temporal", "region-growing", "WL2", "", None, 3, ["T/A"]])
def test_confidence_of_what_was_not_run_is_refused(
    compared: p4d.Comparison, method: object
) -> None:
    """It gave that of directional L1, under another name."""
    with pytest.raises(ValueError, match="there is no result of|method must be one of"):
        compared.confidence(method)


def test_it_is_shown_in_few_lines() -> None:
    wrapped = np.zeros((2, 2, 16, 16), dtype=np.float32)
    found = p4d.compare(wrapped, methods=("temporal", "angular"))
    first, *rows = repr(found).splitlines()
    assert first == "<Comparison of 2 methods on time 2, angle 2, y 16, x 16>"
    assert len(rows) < 6
    assert "Temporal" in repr(found)
