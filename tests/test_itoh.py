"""Itoh's condition and residues."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import (
    itoh_margin,
    order_shares,
    order_verdict,
    residues,
    wrong_cycle_share,
)
from napari_phase4d.simulation import moving_shape, with_noise


def test_margin_of_a_ramp_is_its_slope() -> None:
    t, y, x = np.meshgrid(np.arange(5), np.arange(6), np.arange(7), indexing="ij")
    phase = xr.DataArray(0.5 * np.pi * t + 1.2 * np.pi * x + 0.0 * y, dims=("time", "y", "x"))
    margin = itoh_margin(phase)
    np.testing.assert_allclose(margin["along_time"], 0.5, rtol=1e-6)
    np.testing.assert_allclose(margin["along_x"], 1.2, rtol=1e-6)
    np.testing.assert_allclose(margin["along_y"], 0.0, atol=1e-12)
    assert [margin[f"along_{d}"].attrs["share_beyond"] for d in ("time", "y", "x")] == [0, 0, 1]


def test_margin_takes_the_larger_neighbour_and_skips_single_frames() -> None:
    phase = xr.DataArray(np.array([[0.0, 0.0, 4.0, 4.0]]), dims=("time", "x"))
    margin = itoh_margin(phase)
    assert list(margin.data_vars) == ["along_x"]
    np.testing.assert_allclose(margin["along_x"].values[0] * np.pi, [0, 4, 4, 0])
    assert margin["along_x"].attrs["share_beyond"] == pytest.approx(1 / 3)


def test_steps_to_what_is_not_known_do_not_count() -> None:
    phase = xr.DataArray(np.array([[0.0, 0.0, 4.0, np.nan, 0.0, 0.0]]), dims=("y", "x"))
    assert itoh_margin(phase)["along_x"].attrs["share_beyond"] == pytest.approx(1 / 3)
    inside = phase.copy(data=np.array([[False, True, True, True, True, False]]))
    assert itoh_margin(phase, inside)["along_x"].attrs["share_beyond"] == 1


def test_wrong_cycles_are_counted_where_both_are_known() -> None:
    truth = xr.DataArray(np.zeros((1, 1, 1, 4)), dims=("time", "angle", "y", "x"))
    found = truth.copy(data=np.array([0, 2 * np.pi, np.nan, np.nan]).reshape(truth.shape))
    assert wrong_cycle_share(found, truth) == 0.5


def test_residues_of_a_vortex() -> None:
    y, x = np.indices((11, 12))
    vortex = np.arctan2(y - 4.5, x - 6.5)
    found = residues(xr.DataArray(vortex, dims=("y", "x")))
    assert found.shape == (10, 11)
    assert abs(int(found[4, 6])) == 1
    assert int(np.abs(found).sum()) == 1
    mirrored = residues(xr.DataArray(-vortex, dims=("y", "x")))
    assert int(mirrored[4, 6]) == -int(found[4, 6])
    smooth = np.angle(np.exp(1j * 0.3 * (x + y)))
    assert not residues(xr.DataArray(smooth, dims=("y", "x"))).any()


def test_share_counts_steps_inside_only() -> None:
    phase = xr.DataArray(np.array([[0.0, 4.0, 8.0, 8.0, 8.0]]), dims=("y", "x"))
    inside = phase.copy(data=np.array([[False, True, True, True, True]]))
    assert itoh_margin(phase)["along_x"].attrs["share_beyond"] == pytest.approx(2 / 4)
    assert itoh_margin(phase, inside)["along_x"].attrs["share_beyond"] == pytest.approx(1 / 3)


def test_orders_are_judged_by_the_steps_on_their_way() -> None:
    """A ramp over time at the second angle only, then at both."""
    phase = np.zeros((4, 2, 3, 3))
    phase[:, 1] = 5.0 * np.arange(4)[:, None, None]
    stack = xr.DataArray(phase, dims=("time", "angle", "y", "x"))
    shares = order_shares(stack, (0, 0))
    # T/A: three steps along time at angle 0, four along the angle of which those at t = 1, 2, 3
    # are too large. A/T: one along the angle at t = 0, six along time of which three are.
    assert shares["temporal-angular"] == pytest.approx(3 / 7)
    assert shares["angular-temporal"] == pytest.approx(3 / 7)
    smooth_angle = stack.copy(data=np.broadcast_to(phase[:, 1:], phase.shape).copy())
    shares = order_shares(smooth_angle, (0, 0))
    assert shares["temporal-angular"] == pytest.approx(3 / 7)
    assert shares["angular-temporal"] == pytest.approx(6 / 7)


BOTH = ("temporal-angular", "angular-temporal")


@pytest.mark.slow
def test_order_is_judged_by_truth_and_not_by_a_result_of_itself() -> None:
    data = p4d.simulation.budding_yeast()
    results = p4d.compare(data["wrapped"], mask="auto").results
    wrong = [100 * wrong_cycle_share(results[m], data["phase"]) for m in BOTH]
    assert order_verdict(results, truth=data["phase"]) == (
        f"T/A suits better: it is wrong in {wrong[0]:.2g} % of the pixels, "
        f"A/T in {wrong[1]:.2g} %."
    )
    assert order_verdict({}, truth=data["phase"]) == "T/A meets fewer of them, by the exact phase."
    own = results["directional-l1"].values
    differ = [100 * float((abs(results[m].values - own) > np.pi).mean()) for m in BOTH]
    assert order_verdict(results) == (
        f"T/A suits better: it differs from WL1 in {differ[0]:.1f} % of the pixels, "
        f"A/T in {differ[1]:.1f} %."
    )
    own = results.pop("directional-l1")
    # Each result is smooth along the dimension of its own last pass.
    untold = "Which of T/A and A/T suits better can't be told yet: run {} too, since"
    assert order_verdict(results).startswith(untold.format("WL1"))
    assert order_verdict({}).startswith(untold.format("T/A and A/T and WL1"))
    one = {"temporal-angular": results["temporal-angular"], "directional-l1": own}
    assert order_verdict(one).startswith(untold.format("A/T"))
    flat = {m: xr.zeros_like(own) for m in (*BOTH, "directional-l1")}
    assert order_verdict(flat).startswith("T/A or A/T makes no difference")
    assert order_verdict({}, truth=flat[BOTH[0]]).startswith("T/A and A/T meet equally many")
    negative = order_shares(data["phase"], (-1, -1))
    assert negative == order_shares(data["phase"], (18, 5))


@pytest.mark.parametrize(
    ("off", "said"),
    [
        ((0.002, 0.004), "T/A suits better"),
        ((0.004, 0.002), "A/T suits better"),
        ((0.0002, 0.0004), "T/A or A/T makes no difference"),  # too few pixels to matter
        ((0.100, 0.105), "T/A or A/T makes no difference"),  # about as many
        ((0.100, 0.120), "T/A suits better"),
    ],
)
@pytest.mark.parametrize("known", ["truth", "directional-l1"])
def test_an_order_is_advised_only_if_it_matters(
    off: tuple[float, float], said: str, known: str
) -> None:
    exact = xr.DataArray(np.zeros((10, 2, 50, 50)), dims=("time", "angle", "y", "x"))
    results = {}
    for method, share in zip(BOTH, off, strict=True):
        wrong = exact.copy(deep=True)
        wrong.values.flat[: round(share * exact.size)] = 2 * np.pi
        results[method] = wrong
    if known == "truth":
        verdict = order_verdict(results, truth=exact)
    else:
        verdict = order_verdict(results | {known: exact})
    assert verdict.startswith(said)
    assert f"{100 * off[0]:.2g} %" in verdict
    assert f"{100 * off[1]:.2g} %" in verdict


@pytest.mark.thorough
def test_an_order_that_is_advised_is_the_better_one() -> None:
    """By the result of directional L1 alone, against exact phase."""
    advised = 0
    for name in ("tumbling", "touching", "swelling", "translating", "bending"):
        data = with_noise(moving_shape(name), 0.5, seed=4)
        results = p4d.compare(data["wrapped"], [*BOTH, "directional-l1"]).results
        verdict = order_verdict(results)
        if "makes no difference" in verdict:
            continue
        advised += 1
        wrong = {m: wrong_cycle_share(results[m], data["phase"]) for m in BOTH}
        best = min(wrong, key=lambda m: wrong[m])
        assert verdict.startswith(f"{p4d.METHODS[best].label} suits better")
    assert advised >= 3


@pytest.mark.parametrize("dims", [("time", "y", "x"), ("angle", "y", "x"), ("y", "x")])
def test_orders_of_phase_that_lacks_an_axis(dims: tuple[str, ...]) -> None:
    """With one view, or one time, both ways take the same steps."""
    frames = 5.0 * np.arange(3)[:, None, None] * (np.arange(4) > 1)[None, :, None] * np.ones(5)
    stack = xr.DataArray(frames if len(dims) == 3 else frames[0], dims=dims)
    shares = order_shares(stack, (0, 0), xr.ones_like(stack, dtype=bool))
    assert shares["temporal-angular"] == shares["angular-temporal"]
    assert shares["temporal-angular"] == (0.5 if len(dims) == 3 else 0)


def test_shares_count_known_steps_alone() -> None:
    """Every step along time is 4 rad, none along the angle is."""
    rising = 4.0 * np.arange(8)[:, None, None, None] * np.ones((8, 2, 5, 6))
    phase = xr.DataArray(rising, dims=("time", "angle", "y", "x"))
    phase[3:6] = np.nan
    # Of 7 steps along time 3 are known, of 8 times at both angles 5.
    assert order_shares(phase) == pytest.approx(
        {"temporal-angular": 3 / (3 + 5), "angular-temporal": 6 / (6 + 1)}
    )


def test_orders_start_at_frames_that_are_there() -> None:
    phase = xr.DataArray(np.zeros((8, 2, 5, 6)), dims=("time", "angle", "y", "x"))
    with pytest.raises(ValueError, match="does not exist"):
        order_shares(phase, (100, 7))


@pytest.mark.parametrize("wavelengths", [None, [0.5, 0.6]])
def test_a_mask_of_a_frame_holds_for_all(wavelengths: list[float] | None) -> None:
    rng = np.random.default_rng(1)
    phase = xr.DataArray(rng.normal(0, 3, (4, 2, 6, 7)), dims=("time", "angle", "y", "x"))
    if wavelengths:
        phase = phase.assign_coords(wavelength=("angle", wavelengths))
    inside = xr.DataArray(rng.random((6, 7)) > 0.4, dims=("y", "x"))
    everywhere = inside.broadcast_like(phase).transpose(*phase.dims)
    found, expected = (itoh_margin(phase, mask) for mask in (inside, everywhere))
    for name in expected:
        assert found[name].attrs == expected[name].attrs
    assert order_shares(phase, (0, 0), inside) == order_shares(phase, (0, 0), everywhere)


def test_residues_are_none_round_what_is_not_known() -> None:
    y, x = np.mgrid[-3.5:4, -3.5:4]
    vortex = np.arctan2(y, x)
    vortex[0, 0] = vortex[6, 6] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = residues(xr.DataArray(vortex, dims=("y", "x"))).values
    assert np.argwhere(found).tolist() == [[3, 3]]
    vortex[3, 3] = np.nan
    assert not residues(xr.DataArray(vortex, dims=("y", "x"))).any()
