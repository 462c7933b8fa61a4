"""How far results are trusted where an angle is seen at several wavelengths."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from helpers import area_under_curve
from napari_phase4d.simulation import (
    at_wavelengths,
    moving_shape,
    step_phantom,
    swimming_euglena,
    with_noise,
)
from napari_phase4d.task import Cancelled, Task
from napari_phase4d.unwrapping import Problem, views_apart
from test_wavelengths import ANGLES, METHOD, PLATES, TURN, TWO, through_optics


@pytest.mark.slow
def test_steep_rims_that_optics_blur_are_not_settled_by_wavelengths() -> None:
    """They agree on wrong counts there; Synthetic has many, and it was said to be the safest."""
    data, truth = through_optics(22)
    found = p4d.compare(data["phase"], [METHOD, "directional-l1"], amplitude=data["amplitude"])
    inside = np.abs(truth) > 0.3
    off = {m: (np.abs(r.values - truth) > np.pi)[inside] for m, r in found.results.items()}
    assert off[METHOD].mean() > 5 * off["directional-l1"].mean()
    for method, wrong_pixels in off.items():
        trust = found.confidence(method).values[inside]
        assert wrong_pixels[trust > 0.99].mean() < 0.004, method
        assert (trust[~wrong_pixels] > 0.5).mean() > 0.99, method
    assert found.verdict.startswith("Use WL1")


@pytest.mark.slow
def test_trust_goes_by_how_far_wavelengths_agree() -> None:
    data = with_noise(at_wavelengths(step_phantom(paths_um=PLATES, n_times=2), TWO), 0.1, seed=1)
    found = p4d.compare(data["wrapped"], ["temporal-angular", "directional-l1", METHOD])
    for method, result in found.results.items():
        right = np.abs(result.values - data["phase"].values) < np.pi
        trust = found.confidence(method).values
        assert trust[right].mean() > 0.95, method
        if method != METHOD:
            assert trust[~right].mean() < 0.05, method
    assert found.verdict.startswith("Use Synthetic")
    alone = p4d.confidence(found.results[METHOD], data["wrapped"])
    xr.testing.assert_allclose(alone, found.confidence(METHOD))


@pytest.mark.slow
def test_without_an_empty_field_wavelengths_tell_no_level() -> None:
    """As each drifts by itself: Synthetic was trusted, whose frames are turns off each other."""
    t, y, x = np.mgrid[:8, -40:40, -40:40].astype(float)
    hills = 14 + 6 * np.cos(0.22 * y + 0.3 * t) * np.cos(0.19 * x - 0.2 * t)
    layer = step_phantom((80, 80), (0.1,), 8, angles_deg=(0.0,))
    layer["phase"] = layer["phase"].copy(data=hills[:, None])
    data = with_noise(at_wavelengths(layer, TWO), 0.15, 0.2, seed=2)
    found = p4d.compare(data["wrapped"], [METHOD, "directional-l1"])
    turns = np.round((found.results["directional-l1"] - data["phase"]) / TURN).values
    for view in range(2):
        assert np.unique(turns[:, view]).size == 1
    assert found.confidence("directional-l1").mean() > 0.85
    assert found.confidence(METHOD).mean() < 0.2
    assert found.verdict.startswith("Use WL1")
    assert "No empty field is in view" in found.verdict


@pytest.mark.slow
def test_an_angle_without_empty_field_leaves_the_other_to_the_wavelengths() -> None:
    exact = step_phantom((80, 96), (0.4, 0.9, 1.4), 3, angles_deg=ANGLES)
    y, x = np.mgrid[:80, :96].astype(float)
    phase = exact["phase"].values.copy()
    phase[:, 1] = 14 + 6 * np.cos(0.22 * y) * np.cos(0.19 * x)
    hidden = exact.assign(phase=exact["phase"].copy(data=phase))
    data = with_noise(at_wavelengths(hidden, TWO), 0.1, 0.2, seed=3)
    found = p4d.compare(data["wrapped"], [METHOD, "directional-l1"])
    plates = np.s_[:, :2]
    for method, result in found.results.items():
        right = np.abs(result.values - data["phase"].values)[plates] < np.pi
        trust = found.confidence(method).values[plates]
        assert (trust[right] > 0.5).mean() > 0.95, method
        if method == METHOD:
            assert right.mean() > 0.999
            assert (trust > 0.5).mean() > 0.99
        else:
            assert (trust[~right] < 0.5).mean() > 0.95
    hills = found.confidence(METHOD).values[:, 2:]
    assert np.median(hills) < 0.2  # whose levels differ from frame to frame


def test_tall_plates_of_close_wavelengths_are_not_doubted() -> None:
    """Their rims are steep, and tell nothing; that nothing is told is no reason for doubt."""
    exact = step_phantom((80, 96), (2.0, 4.0, 6.0), 3, angles_deg=(0.0,))
    data = with_noise(at_wavelengths(exact, (0.6328, 0.66)), 0.15, seed=4)
    found = p4d.compare(data["wrapped"], [METHOD])
    right = np.abs(found.results[METHOD].values - data["phase"].values) < np.pi
    assert right.mean() > 0.995
    assert (found.confidence(METHOD).values[right] > 0.5).mean() > 0.98


@pytest.mark.slow
def test_counts_on_which_wavelengths_agree_by_accident_are_doubted() -> None:
    """At steep rims Synthetic makes them agree a turn off; such pixels were trusted to 97 %."""
    cell = moving_shape("vacuole", n_times=9).isel(angle=[0])
    data = with_noise(at_wavelengths(cell, TWO), 0.3, seed=5)
    found = p4d.compare(data["wrapped"], [METHOD, "directional-l1"])
    inside = data["phase"].values > 0.3
    for method, most_trusted in ((METHOD, 0.01), ("directional-l1", 0.001)):
        off = np.abs(found.results[method].values - data["phase"].values) > np.pi
        trust = found.confidence(method).values
        if method == METHOD:
            assert off[inside].mean() > 0.005
            assert area_under_curve(-trust[inside], off[inside]) > 0.95
            assert np.median(trust[inside & off]) < 0.6
        assert off[inside & (trust > 0.99)].mean() < most_trusted
    assert found.verdict.startswith("Use WL1")  # whose wrong pixels are a tenth as many


def shifted_views(exact: xr.Dataset, down: int, right: int, noise: float) -> xr.Dataset:
    """Return noisy views of which every second, the longer wavelength, lies off the others."""
    data = exact.copy()
    moved = exact["phase"].values.copy()
    moved[:, 1::2] = np.roll(moved[:, 1::2], (down, right), (-2, -1))
    data["phase"] = exact["phase"].copy(data=moved)
    return with_noise(data, noise, seed=3)


def cell_at_two() -> xr.Dataset:
    return at_wavelengths(swimming_euglena((96, 128), 5, peak_rad=12, pixel_um=0.35), TWO)


@pytest.mark.slow
@pytest.mark.parametrize(("down", "right"), [(1, 0), (2, -1), (-6, 4)])
def test_views_that_lie_off_each_other_are_said_and_not_trusted(down: int, right: int) -> None:
    """Synthetic was the verdict, and of the pixels it was sure of up to 10 % were wrong."""
    data = shifted_views(cell_at_two(), down, right, 0.15)
    with pytest.warns(UserWarning, match="do not lie on each other") as said:
        found = p4d.compare(data["wrapped"], [METHOD, "directional-l1"])
    own = [str(w.message) for w in said if "do not lie" in str(w.message)]
    assert len(own) == 1
    assert own[0].count(f"0.6328 um lies {down:+d} px down and {right:+d} px right") == 2
    assert found.verdict.startswith("Use WL1: less than")
    place = f"21°, 632.8 nm lies {down:+d} px down and {right:+d} px right of 21°, 532 nm"
    assert place in found.verdict
    assert [pair.shift for pair in found.verdict.views_apart] == [(down, right)] * 2
    for method, result in found.results.items():
        off = np.abs(result.values - data["phase"].values) > np.pi
        trust = found.confidence(method).values
        assert off[trust > 0.99].mean() < 1e-4, method
        assert method != METHOD or off.mean() > 0.005


@pytest.mark.parametrize("noise", [0.05, 0.3, 0.7])
@pytest.mark.parametrize("shape", ["cell", "plates", "empty"])
def test_views_that_lie_on_each_other_are_not_said_to_be_off(shape: str, noise: float) -> None:
    """Warnings are errors here."""
    paths = PLATES if shape == "plates" else (1e-4,)
    exact = at_wavelengths(step_phantom((96, 120), paths, 2, angles_deg=ANGLES), TWO)
    data = with_noise(cell_at_two() if shape == "cell" else exact, noise, seed=5)
    assert p4d.unwrap(data["wrapped"], METHOD).shape == data["phase"].shape


@pytest.mark.parametrize("side", [16, 32, 48])
def test_small_frames_of_noise_are_not_said_to_be_off(side: int) -> None:
    """Warnings are errors here."""
    for seed in range(6):
        plates = step_phantom((side, side), (0.4, 0.9), 1, angles_deg=(0.0,))
        data = with_noise(at_wavelengths(plates, TWO), 0.7, seed=seed)
        p4d.unwrap(data["wrapped"], METHOD)


@pytest.mark.parametrize("tilt", [0.1, 0.5, 1.0])
def test_views_with_tilts_of_their_own_are_not_said_to_be_off(tilt: float) -> None:
    """Slopes were asked with the tilt, which lights a cell from opposite sides."""
    data = with_noise(tilted(cell_at_two(), tilt), 0.1, seed=1)
    p4d.unwrap(data["wrapped"], METHOD)


def test_the_shift_of_views_with_tilts_of_their_own_is_told() -> None:
    data = shifted_views(tilted(cell_at_two(), 0.8), 2, -1, 0.1)
    with pytest.warns(UserWarning, match=r"\+2 px down and -1 px right.*\+2 px down and -1 px"):
        p4d.unwrap(data["wrapped"], METHOD)


def tilted(data: xr.Dataset, rad_per_px: float) -> xr.Dataset:
    """Tilt the views of two wavelengths to opposite sides."""
    x = np.arange(data.sizes["x"], dtype=np.float32)
    sides = np.resize([1, -1], data.sizes["angle"]).astype(np.float32)
    tilt = rad_per_px * sides[:, None, None] * x
    return data.assign(phase=data["phase"].copy(data=data["phase"].values + tilt))


def test_shifts_beyond_what_is_looked_at_are_not_guessed() -> None:
    """It was said to be 12 pixels, where the looking ends. Warnings are errors here."""
    p4d.unwrap(shifted_views(cell_at_two(), 30, 20, 0.1)["wrapped"], METHOD)


def test_views_that_are_never_seen_together_are_not_compared() -> None:
    """They raised an IndexError."""
    phase = cell_at_two()["wrapped"][:4, :2].copy()
    phase[:2, 0] = phase[2:, 1] = np.nan
    found = p4d.compare(phase, ["directional-l1"], mask=np.isfinite(phase.values))
    assert found.confidence("directional-l1").shape == phase.shape


def test_looking_for_shifts_can_be_stopped() -> None:
    """Of large frames it takes seconds."""
    problem = Problem(cell_at_two()["wrapped"])
    problem.lost()
    asked = 0

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return asked > 2

    with pytest.raises(Cancelled):
        views_apart(problem, Task(None, stop))
    assert asked == 3
    assert views_apart(problem) == []
