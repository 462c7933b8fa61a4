"""Views of several wavelengths: from the hologram to the path, against exact truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import ndimage

import napari_phase4d as p4d
from helpers import command, wrap
from napari_phase4d.analysis import itoh_margin, noise_figures, order_shares
from napari_phase4d.holography import lobe_warnings, recalibrated, refocused, stray_terms
from napari_phase4d.io import read_results, write_phase
from napari_phase4d.plotting.results import angle_label
from napari_phase4d.simulation import (
    at_wavelengths,
    multiplexed_video,
    step_phantom,
    swimming_euglena,
    with_noise,
)
from napari_phase4d.unwrapping import methods_for
from napari_phase4d.unwrapping.light import ladder_of, noise_between, settled_turns
from napari_phase4d.unwrapping.light.steps import steps_between

TURN = 2 * np.pi
METHOD = "synthetic-wavelength"
TWO, THREE, LONG = (0.532, 0.6328), (0.532, 0.561, 0.6328), (0.532, 0.6238, 0.6328)
#: Carriers of two angles at two wavelengths, all of which have room, and the pupil.
CARRIERS = ((0.30, 0.10), (0.10, 0.30), (-0.10, 0.30), (-0.30, 0.10))
PUPIL = 0.05
ANGLES = (-7.0, 21.0)
PLATES = (0.25, 0.4, 0.6, 0.9, 1.2, 1.5)


def wrong(found: xr.DataArray | np.ndarray, exact: xr.DataArray) -> float:
    """Return the share of pixels that are wrong by a turn or more."""
    return float((np.abs(np.asarray(found) - exact.values) > np.pi).mean())


def lobes_of(angles: tuple[float, float] = ANGLES) -> list[p4d.Lobe]:
    places = [(angle, light) for angle in angles for light in TWO]
    return [
        p4d.Lobe(carrier, PUPIL * 0.6328 / light, angle, wavelength_um=light)
        for carrier, (angle, light) in zip(CARRIERS, places, strict=True)
    ]


@pytest.fixture(scope="module")
def plates() -> xr.Dataset:
    """Plates of more than half a wavelength, from two angles at two wavelengths."""
    return at_wavelengths(step_phantom((512, 512), (0.4, 0.9, 1.4), 2, angles_deg=ANGLES), TWO)


@pytest.fixture(scope="module")
def hologram(plates: xr.Dataset) -> p4d.Recording:
    return multiplexed_video(
        plates["phase"], carriers=CARRIERS, pupil_radius=PUPIL, bits=12, drift_rad=0.3
    )


@pytest.fixture(scope="module")
def reconstruction(hologram: p4d.Recording) -> xr.Dataset:
    return p4d.reconstruct(hologram, lobes_of())


# ---- where the wavelength of a view lives ----------------------------------------------------


@pytest.mark.slow
def test_views_are_grouped_by_angle_and_wavelength(
    hologram: p4d.Recording, reconstruction: xr.Dataset
) -> None:
    assert reconstruction["angle"].values.tolist() == [-7, -7, 21, 21]
    assert reconstruction["wavelength"].values.tolist() == [*TWO, *TWO]
    assert reconstruction["wavelength"].attrs["units"] == "um"
    assert "wavelength_um" not in reconstruction.attrs  # no single one would be right
    mixed = p4d.reconstruct(hologram, lobes_of()[::-1])
    xr.testing.assert_equal(mixed["phase"], reconstruction["phase"])


@pytest.mark.slow
def test_the_recordings_own_wavelength_counts_where_a_lobe_names_none(
    hologram: p4d.Recording, reconstruction: xr.Dataset
) -> None:
    lobes = lobes_of()
    for i in (1, 3):  # those of 632.8 nm, which is that of the recording
        lobes[i] = p4d.Lobe(lobes[i].carrier, lobes[i].radius, lobes[i].angle_deg)
    xr.testing.assert_equal(p4d.reconstruct(hologram, lobes)["phase"], reconstruction["phase"])


@pytest.mark.slow
def test_one_wavelength_leaves_everything_as_it_was(hologram: p4d.Recording) -> None:
    plain = [p4d.Lobe(lobe.carrier, lobe.radius, i) for i, lobe in enumerate(lobes_of())]
    named = [
        p4d.Lobe(lobe.carrier, lobe.radius, lobe.angle_deg, wavelength_um=0.6328) for lobe in plain
    ]
    expected, found = (p4d.reconstruct(hologram, lobes) for lobes in (plain, named))
    assert [note["wavelength_um"] for note in found.attrs["lobes"]] == [0.6328] * 4
    for each in (found, found["phase"], found["amplitude"]):  # that it was named is noted alone
        for note in each.attrs["lobes"]:
            note.pop("wavelength_um", None)
    xr.testing.assert_identical(found, expected)
    assert "wavelength" not in found.coords
    assert found.attrs["wavelength_um"] == 0.6328
    other = [
        p4d.Lobe(lobe.carrier, lobe.radius, lobe.angle_deg, wavelength_um=0.5) for lobe in plain
    ]
    assert p4d.reconstruct(hologram, other).attrs["wavelength_um"] == 0.5


@pytest.mark.slow
@pytest.mark.parametrize("named", [None, 0.6328, 0.5])
def test_a_wavelength_that_lobes_name_is_not_the_microscopes(
    hologram: p4d.Recording, named: float | None
) -> None:
    lobes = [
        p4d.Lobe(x.carrier, x.radius, i, wavelength_um=named) for i, x in enumerate(lobes_of())
    ]
    other = hologram.calibrated(replace(hologram.optics, wavelength_um=0.4))
    again = p4d.reconstruct(other, lobes)
    found = recalibrated(p4d.reconstruct(hologram, lobes), other)
    assert found.attrs["wavelength_um"] == again.attrs["wavelength_um"] == (named or 0.4)
    assert found["phase"].attrs["wavelength_um"] == (named or 0.4)


def test_views_of_the_same_angle_and_wavelength_are_numbered(hologram: p4d.Recording) -> None:
    lobes = [p4d.Lobe(x.carrier, x.radius, 0.0, wavelength_um=x.wavelength_um) for x in lobes_of()]
    found = p4d.reconstruct(hologram, lobes)
    assert found["angle"].values.tolist() == [0, 1, 2, 3]
    assert found["wavelength"].values.tolist() == [*TWO, *TWO]
    said = " ".join(lobe_warnings(lobes))
    assert "Circles 1 and 3 have the same angle" in said
    assert "Circles 2 and 4" in said
    assert "same angle" not in " ".join(lobe_warnings(lobes_of()))


def test_beams_of_different_wavelengths_have_no_beat() -> None:
    beats = [term.pair for term in stray_terms(lobes_of()) if term.pair]
    assert beats == [(0, 2), (1, 3)]


def test_a_lobe_without_a_wavelength_has_that_of_the_recording() -> None:
    carriers = ((0.2, 0.22), (-0.21, 0.2), (0.41, 0.02))  # the last is the beat of the others
    for light in (0.6328, 0.5):
        lobes = [p4d.Lobe(k, 0.05, i) for i, k in enumerate(carriers)]
        lobes[1] = replace(lobes[1], wavelength_um=light)
        same = light == 0.6328
        pairs = [term.pair for term in stray_terms(lobes, 0.6328)[1:]]
        assert pairs == ([(0, 1), (0, 2), (1, 2)] if same else [(0, 2)])
        said = " ".join(lobe_warnings(lobes, 0.6328))
        assert ("Circle 3 lies on the beat of circles 1 and 2" in said) is same
        alike = [replace(lobe, angle_deg=0.0) for lobe in lobes]
        told = " ".join(lobe_warnings(alike, 0.6328))
        assert ("Circles 1, 2 and 3 have the same angle" in told) is same
    with pytest.raises(ValueError, match="wavelength_um"):
        lobe_warnings(lobes, -1)


def test_the_camera_sees_no_beat_between_wavelengths(plates: xr.Dataset) -> None:
    """The spectrum holds the beats of each wavelength, and nothing between the two."""
    flat = plates["phase"].isel(time=[0]) * 0
    rec = multiplexed_video(
        flat, carriers=CARRIERS, pupil_radius=PUPIL, bits=16, unevenness=0, seed=2
    )
    power = np.abs(np.fft.fft2(rec.raw_frame(0).astype(float))) ** 2

    def at(one: int, other: int) -> float:
        ky, kx = np.subtract(CARRIERS[one], CARRIERS[other])
        y, x = (round(k * 512) % 512 for k in (ky, kx))
        near = np.ix_(np.arange(y - 2, y + 3) % 512, np.arange(x - 2, x + 3) % 512)
        return float(power[near].max())

    assert at(0, 2) > 1000 * at(0, 1)
    assert at(1, 3) > 1000 * at(2, 3)


@pytest.mark.parametrize("value", [0, -0.5, np.nan, np.inf])
def test_a_lobe_refuses_what_is_no_wavelength(value: float) -> None:
    with pytest.raises(ValueError, match="wavelength_um of a lobe must be"):
        p4d.Lobe((0.2, 0.2), 0.05, wavelength_um=value)


def test_stacks_with_wavelengths_come_in_checked() -> None:
    good = at_wavelengths(step_phantom(n_times=2), TWO)["wrapped"]
    nm = good.assign_coords(wavelength=("angle", [532, 632.8], {"units": "nm"}))
    xr.testing.assert_allclose(p4d.unwrap(nm, METHOD), p4d.unwrap(good, METHOD))
    with pytest.raises(ValueError, match="two views of phase have the same angle and wavelength"):
        p4d.unwrap(good.assign_coords(wavelength=("angle", [0.5, 0.5])))
    with pytest.raises(ValueError, match="the wavelengths of phase do not rise at the angle"):
        p4d.unwrap(good.isel(angle=[1, 0]))
    with pytest.raises(ValueError, match="must be numbers above 0"):
        p4d.unwrap(good.assign_coords(wavelength=("angle", [0.5, -1])))
    with pytest.raises(ValueError, match="are in 'rad'; give them in micrometres"):
        p4d.unwrap(good.assign_coords(wavelength=("angle", [0.5, 0.6], {"units": "rad"})))
    with pytest.raises(ValueError, match="lie along time; give one for each view"):
        p4d.unwrap(good.assign_coords(wavelength=("time", [0.5, 0.6])))


def test_masks_and_truth_find_their_views_by_wavelength() -> None:
    data = at_wavelengths(step_phantom(n_times=1), TWO)
    exact = data["phase"]
    found = p4d.compare(data["wrapped"], [METHOD], truth=exact.isel(angle=[1, 0]))
    assert found.table.loc[METHOD, "wrong_cycles_percent"] == pytest.approx(
        p4d.compare(data["wrapped"], [METHOD], truth=exact).table.loc[
            METHOD, "wrong_cycles_percent"
        ]
    )
    with pytest.raises(ValueError, match="has other wavelengths .* than the phase"):
        p4d.compare(
            data["wrapped"],
            [METHOD],
            truth=exact.assign_coords(wavelength=("angle", [0.4, 0.5])),
        )


@pytest.mark.parametrize("ending", [".ome.tif", ".ome.zarr"])
def test_files_keep_the_wavelengths(
    reconstruction: xr.Dataset, tmp_path: Path, ending: str
) -> None:
    path = tmp_path / f"phase{ending}"
    write_phase(path, reconstruction["phase"])
    found = read_results(path).compute()
    xr.testing.assert_equal(found, reconstruction["phase"])
    assert found["wavelength"].attrs["units"] == "um"


def test_recipes_keep_lobes_of_today_and_of_before(tmp_path: Path) -> None:
    recipe = p4d.Recipe(lobes=tuple(lobes_of()), wavelengths_um=(*TWO, *TWO))
    assert p4d.Recipe.from_file(recipe.to_file(tmp_path / "new.json")) == recipe
    old = p4d.Recipe(lobes=(p4d.Lobe((0.2, 0.1), 0.05),)).to_file(tmp_path / "old.json")
    assert '"wavelength_um": null' not in old.read_text(encoding="utf-8")
    assert p4d.Recipe.from_file(old).lobes[0].wavelength_um is None


def test_lobes_are_found_with_their_wavelengths(hologram: p4d.Recording) -> None:
    found = p4d.find_lobes(
        hologram, None, angles_deg=(*[-7] * 2, *[21] * 2), wavelengths_um=TWO * 2
    )
    for lobe, expected in zip(found, lobes_of(), strict=True):
        assert lobe.carrier == pytest.approx(expected.carrier, abs=1e-3)
        assert (lobe.angle_deg, lobe.wavelength_um) == (
            expected.angle_deg,
            expected.wavelength_um,
        )
    with pytest.raises(ValueError, match="wavelengths_um has 2 for 4 views; give one each"):
        p4d.find_lobes(hologram, 4, wavelengths_um=TWO)
    with pytest.raises(ValueError, match="wavelengths_um must be lengths above 0"):
        p4d.find_lobes(hologram, 2, wavelengths_um=(0.5, 0))


def test_each_view_is_refocused_by_its_own_wavelength(reconstruction: xr.Dataset) -> None:
    """As if the views of one wavelength had been a recording of their own."""
    moved = refocused(reconstruction, 5.0)
    for view in range(4):
        one = reconstruction.isel(angle=[view]).drop_vars("wavelength")
        light = float(reconstruction["wavelength"][view])
        alone = refocused(one.assign_attrs(wavelength_um=light), 5.0)
        np.testing.assert_array_equal(moved["phase"][:, [view]], alone["phase"])
    other = refocused(reconstruction.drop_vars("wavelength").assign_attrs(wavelength_um=0.6328), 5)
    assert not np.array_equal(moved["phase"][:, 0], other["phase"][:, 0])


def test_reconstruct_refocuses_each_view_by_its_own_wavelength(
    hologram: p4d.Recording,
) -> None:
    every = p4d.reconstruct(hologram, lobes_of(), refocus_um=4.0, drift=False, background="none")
    after = refocused(p4d.reconstruct(hologram, lobes_of(), drift=False, background="none"), 4.0)
    step = wrap(every["phase"].values - after["phase"].values)
    assert np.abs(step).max() < 1e-3


# ---- the method ------------------------------------------------------------------------------


def test_the_synthetic_wavelength_and_its_noise_are_those_of_the_formula() -> None:
    coarse, fine = ladder_of(TWO)
    assert coarse.wavelength_um == pytest.approx(0.532 * 0.6328 / (0.6328 - 0.532))
    assert fine.wavelength_um == 0.532
    # Var of (W/w1)(n1 - n2) - n1, which is (w1 n1 - w2 n2) / (w2 - w1).
    expected = np.hypot(*TWO) / (TWO[1] - TWO[0]) / TURN
    assert noise_between(coarse, fine) == pytest.approx(expected)
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 1, (2, 1, 200_000))
    off = coarse.wavelength_um / fine.wavelength_um * coarse.phase(noise) - fine.phase(noise)
    assert np.std(off) / TURN == pytest.approx(expected, rel=0.01)
    direct = noise_between(ladder_of(LONG)[0], ladder_of(LONG)[-1])
    ladder = ladder_of(LONG)
    assert len(ladder) == 3
    assert max(noise_between(ladder[0], ladder[1]), noise_between(*ladder[1:])) < direct / 5


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("wavelengths", "paths"),
    [(TWO, PLATES), (THREE, (*PLATES, 4.5)), (LONG, (0.25, 0.6, 1.5, 4.0, 9.0, 20.0))],
)
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3])
def test_steps_above_half_a_wavelength_are_solved(
    wavelengths: tuple[float, ...], paths: tuple[float, ...], noise: float
) -> None:
    """Up to 20 um of path; no method of one wavelength can, whatever it looks at beside."""
    exact = at_wavelengths(step_phantom(paths_um=paths, n_times=2), wavelengths)
    data = with_noise(exact, noise, 0.2, seed=1)
    found = p4d.unwrap(data["wrapped"], METHOD)
    others = p4d.unwrap(data["wrapped"], "directional-l1")
    allowed = {0.0: 0.0, 0.1: 0.001, 0.2: 0.012, 0.3: 0.035}[noise]
    assert wrong(found, data["phase"]) <= allowed
    assert wrong(others, data["phase"]) > 0.08
    # Its noise is that of each view, and no more: it differs by whole turns alone.
    np.testing.assert_allclose(wrap(found.values - data["wrapped"].values), 0, atol=2e-4)


@pytest.mark.parametrize(("wavelengths", "least"), [(TWO, 5), (LONG, 30)])
def test_neighbours_settle_what_noise_leaves_in_doubt(
    wavelengths: tuple[float, ...], least: float
) -> None:
    """Where each pixel by itself, as published, has many wrong, few are left."""
    data = with_noise(at_wavelengths(step_phantom(paths_um=PLATES), wavelengths), 0.2, seed=3)
    each = wrong(p4d.unwrap(data["wrapped"], METHOD, settle=False), data["phase"])
    settled = wrong(p4d.unwrap(data["wrapped"], METHOD), data["phase"])
    assert each > 0.04
    assert settled < each / least


@pytest.mark.slow
def test_no_plate_is_joined_to_the_field_by_one_step_that_looks_smooth() -> None:
    """Noise makes a step over a wall look smooth now and then; a plate was then 3.3 um too low."""
    for seed in (1, 2):
        exact = at_wavelengths(step_phantom(paths_um=PLATES, n_times=3, angles_deg=ANGLES), TWO)
        data = with_noise(exact, 0.3, 0.2, seed)
        off = np.abs(p4d.unwrap(data["wrapped"], METHOD).values - data["phase"].values) > np.pi
        for frame in off.reshape(-1, *off.shape[2:]):
            labels, _ = ndimage.label(frame)
            assert np.bincount(labels.ravel())[1:].max(initial=0) < 40  # a plate has 380 pixels


def test_pixels_by_themselves_are_as_often_wrong_as_noise_has_it() -> None:
    """With two wavelengths, the share of a normal distribution beyond half a turn."""
    from scipy.stats import norm

    flat = at_wavelengths(step_phantom((150, 200), (0.1,)), TWO)
    for noise in (0.15, 0.2):
        data = with_noise(flat, noise, seed=4)
        found = p4d.unwrap(data["wrapped"], METHOD, settle=False, beat="wrapped")
        expected = 2 * norm.sf(0.5 / (noise * noise_between(*ladder_of(TWO))))
        assert wrong(found, data["phase"]) == pytest.approx(expected, rel=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("beat", ["spatial", "temporal-angular", "directional-l1"])
def test_a_moving_cell_thicker_than_half_the_synthetic_wavelength(beat: str) -> None:
    """Its beat wraps by itself, smoothly, and is unwrapped first."""
    exact = swimming_euglena((96, 128), 5, peak_rad=40, pixel_um=0.35)
    data = with_noise(at_wavelengths(exact, TWO), 0.2, 0.2, seed=1)
    thickest = float((data["phase"] * data["wavelength"]).max()) / TURN
    assert thickest > 0.6 * ladder_of(TWO)[0].wavelength_um  # half of it is told without a wrap
    assert wrong(p4d.unwrap(data["wrapped"], METHOD, beat=beat), data["phase"]) < 0.004
    assert wrong(p4d.unwrap(data["wrapped"], METHOD, beat="wrapped"), data["phase"]) > 0.01


def test_through_the_optics(plates: xr.Dataset, reconstruction: xr.Dataset) -> None:
    """From the hologram to the path of plates that every other method gets wrong."""
    _, _, height, width = reconstruction["phase"].shape
    rows, columns = (
        np.round((np.arange(n) + 0.5) * 512 / n - 0.5).astype(int) for n in (height, width)
    )
    exact = plates["phase"].values[:, :, rows][..., columns]
    flat = np.ones(exact.shape, dtype=bool)  # no wall within three pixels, nor the frame's edge
    for axis in (2, 3):
        high = ndimage.maximum_filter1d(exact, 7, axis) - ndimage.minimum_filter1d(exact, 7, axis)
        flat &= ndimage.minimum_filter1d(high < 1, 7, 5 - axis)
    flat[..., :3, :] = flat[..., -3:, :] = flat[..., :3] = flat[..., -3:] = False
    raised = flat & (exact > 1)
    assert raised.sum() > 1500
    found = {
        method: p4d.unwrap(reconstruction["phase"], method).values - exact
        for method in (METHOD, "temporal-angular", "directional-l1")
    }
    off = found.pop(METHOD)
    assert np.abs(off[flat]).max() < np.pi
    assert np.sqrt((off[flat] ** 2).mean()) < 0.05
    for method, others in found.items():
        assert (np.abs(others[raised]) > np.pi).mean() > 0.6, method


def through_optics(peak_rad: float) -> tuple[xr.Dataset, np.ndarray]:
    """Return a swimming cell, seen in holograms of two angles and wavelengths, and its truth."""
    cell = swimming_euglena((512, 512), 5, peak_rad=peak_rad, pixel_um=0.09, angles_deg=ANGLES)
    exact = at_wavelengths(cell, TWO)
    rec = multiplexed_video(
        exact["phase"], carriers=CARRIERS, pupil_radius=PUPIL, bits=12, drift_rad=0.3
    )
    data = p4d.reconstruct(rec, lobes_of())
    rows, columns = (
        np.round((np.arange(n) + 0.5) * 512 / n - 0.5).astype(int) for n in data["phase"].shape[2:]
    )
    return data, exact["phase"].values[:, :, rows][..., columns]


@pytest.mark.slow
def test_through_the_optics_the_edges_of_views_are_right_too() -> None:
    """A transform mixes opposite edges: whole columns were a turn off, and taken for an object."""
    data, truth = through_optics(14)
    found = p4d.unwrap(data["phase"], METHOD)
    assert not (np.abs(found.values - truth) > np.pi).any()
    by_itself = p4d.unwrap(data["phase"], METHOD, settle=False).values
    off = np.abs(by_itself - truth) > np.pi  # at edges alone there is what to mend
    assert off[..., -1].mean() > 0.02
    assert not off[..., 1:-1, 1:-1].any()


def test_dispersion_is_taken_off() -> None:
    """Where the index depends on the wavelength, the wavelengths are effectively others."""
    cauchy = 0.06
    exact = swimming_euglena((96, 128), 3, peak_rad=40, pixel_um=0.35)
    data = at_wavelengths(exact, TWO, cauchy_um2=cauchy)
    bent = data["phase"].values[:, ::2].max() / data["phase"].values[:, 1::2].max()
    index = (1 + cauchy / TWO[0] ** 2) / (1 + cauchy / TWO[1] ** 2)
    assert bent == pytest.approx(TWO[1] / TWO[0] * index, rel=1e-6)
    known = p4d.unwrap(data["wrapped"], METHOD, cauchy_um2=cauchy)
    assert wrong(known, data["phase"]) == 0
    assert wrong(p4d.unwrap(data["wrapped"], METHOD), data["phase"]) > 0.01


def test_one_wavelength_is_refused_in_a_sentence() -> None:
    one = step_phantom(n_times=1)["wrapped"]
    with pytest.raises(ValueError, match=r"every angle, but there is one only, 0\.6328 um; give"):
        p4d.unwrap(one, METHOD)
    bare = xr.DataArray(one.values, dims=one.dims)
    with pytest.raises(ValueError, match="at every angle, but none is noted; give each lobe"):
        p4d.unwrap(bare, METHOD)
    two = at_wavelengths(step_phantom(n_times=1, angles_deg=ANGLES), TWO)["wrapped"]
    with pytest.raises(ValueError, match="but the angle 21 has 0.532 um only"):
        p4d.unwrap(two.isel(angle=[0, 1, 2]), METHOD)
    with pytest.raises(ValueError, match="beat must be one of"):
        p4d.unwrap(two, METHOD, beat="median")


def test_a_run_refuses_it_before_the_long_work() -> None:
    exact = swimming_euglena((96, 112), 3, pixel_um=0.35)
    rec = multiplexed_video(exact["phase"])
    asked: list[str] = []

    def progress(done: int, total: int, message: str) -> None:
        asked.append(message)

    recipe = p4d.Recipe(methods=(METHOD,), lobes=tuple(p4d.find_lobes(rec, 2)))
    with pytest.raises(ValueError, match="there is one only"):
        p4d.run(recipe, rec, progress=progress)
    assert not asked


@pytest.mark.slow
def test_all_methods_are_run_where_they_suit() -> None:
    data = at_wavelengths(step_phantom((48, 64), (0.9,), 2), TWO)
    assert METHOD in p4d.compare(data["wrapped"]).results
    one = step_phantom((48, 64), (0.9,), 2)["wrapped"]
    assert list(p4d.compare(one).results) == methods_for(None)
    assert METHOD not in methods_for(None)


def test_lost_frames_and_pixels_stay_so() -> None:
    data = at_wavelengths(step_phantom((48, 64), (0.9,), 3), TWO)
    wrapped = data["wrapped"].copy(deep=True)
    wrapped[1] = np.nan
    found = p4d.unwrap(wrapped, METHOD, mask="auto")
    assert np.isnan(found.values[1]).all()
    assert np.isfinite(found.values[[0, 2]]).all()
    holes = data["wrapped"].copy(deep=True)
    holes[0, 1, 5:8, 5:8] = np.nan
    compared = p4d.compare(holes, [METHOD], mask=np.isfinite(holes.values))
    found, trust = compared.results[METHOD].values, compared.confidence(METHOD).values
    # At the other wavelength too: it has no beat there, and what is not known is not trusted.
    assert np.isnan(found[0, :, 5:8, 5:8]).all()
    assert not np.nan_to_num(trust[0, :, 5:8, 5:8]).any()
    assert trust[0, :, 20:].min() > 0.5
    left = np.isfinite(holes.values).all(axis=1, keepdims=True)
    left = np.broadcast_to(left, holes.shape)
    assert np.abs(found - data["phase"].values)[left].max() < 1e-3


def test_steps_of_more_than_half_a_turn_are_told_where_wavelengths_agree() -> None:
    """A slope of 0.7 turns a pixel, which one wavelength takes for one of -0.3."""
    path = TURN * 0.7 * TWO[0] * np.arange(12, dtype=np.float32)
    phases = np.stack([wrap(path / light) for light in TWO])[:, None].repeat(5, axis=1)
    steps = steps_between(phases.astype(np.float32), TWO, 0.05)
    np.testing.assert_allclose(steps.right.asked, TURN * 0.7 * TWO[0], rtol=1e-4)
    noisy = steps_between(phases.astype(np.float32), TWO, 1.0)  # nothing can be told of it then
    assert (np.abs(noisy.right.asked) < TURN * TWO[0] / 2 * 1.2).all()


def test_a_wall_is_kept_and_a_pixel_that_is_off_is_not() -> None:
    turns = np.zeros((12, 20), dtype=np.float32)
    turns[:, 10:] = 3
    estimate = turns + np.random.default_rng(0).normal(0, 0.3, turns.shape).astype(np.float32)
    estimate[5, 5] += 1.2
    phases = np.zeros((2, 12, 20), dtype=np.float32)
    steps = steps_between(phases, TWO, 0.05).of(phases[0], TWO[0])
    found = settled_turns(estimate, steps, 0.3, np.ones(turns.shape, bool))
    np.testing.assert_array_equal(found, turns)


# ---- beside the others, in memory and on disk ------------------------------------------------


@pytest.mark.slow
def test_methods_never_hold_wavelengths_against_each_other() -> None:
    """Each wavelength comes out as if it had been unwrapped alone."""
    exact = swimming_euglena((64, 80), 4, peak_rad=12, pixel_um=0.45)
    data = with_noise(at_wavelengths(exact, TWO), 0.3, 0.2, seed=2)
    every = p4d.compare(data["wrapped"], methods_for(None), (0, 0), mask="auto").results
    for light, views in zip(TWO, ([0, 2], [1, 3]), strict=True):
        part = data["wrapped"].isel(angle=views).drop_vars("wavelength")
        alone = p4d.compare(
            part.assign_attrs(wavelength_um=light), methods_for(None), (0, 0), mask="auto"
        ).results
        for method, expected in alone.items():
            np.testing.assert_array_equal(
                every[method].values[:, views], expected.values, err_msg=method
            )


@pytest.mark.slow
def test_on_disk_it_is_the_same(tmp_path: Path, hologram: p4d.Recording) -> None:
    methods = tuple(m for m in p4d.METHODS if p4d.METHODS[m].streams)
    recipe = p4d.Recipe(
        lobes=tuple(lobes_of()),
        methods=methods,
        boundary=((0, 0),),
        options={METHOD: {"beat": "temporal-angular"}},
    )
    memory = p4d.run(recipe.changed(storage="memory"), hologram)
    disk = p4d.run(recipe.changed(storage="disk"), hologram, folder=tmp_path / "out")
    for method, expected in memory.comparison.results.items():
        found = disk.comparison.results[method]
        assert found.chunks is not None, "it lies in memory"
        xr.testing.assert_equal(found.compute(), expected)


def test_boundary_frames_hold_at_every_wavelength() -> None:
    from napari_phase4d.unwrapping import frames_among

    angles = np.array([-7.0, -7.0, 21.0, 21.0])
    assert frames_among([(3, 1), (5, 2)], (0, 2), angles) == [(3, 0), (5, 1)]
    assert frames_among([(3, 0), (3, 1)], (1, 3), angles) == [(3, 0)]


def test_the_safest_frame_is_looked_for_wavelength_by_wavelength() -> None:
    exact = swimming_euglena((64, 80), 3, peak_rad=9, pixel_um=0.45)
    data = at_wavelengths(exact, TWO)["wrapped"]
    scores = p4d.score_boundaries(data)
    for views in ([0, 2], [1, 3]):
        alone = p4d.score_boundaries(data.isel(angle=views).drop_vars("wavelength"))
        assert scores.values[:, views] == pytest.approx(alone.values, abs=0.02)


@pytest.mark.parametrize("shape", [(1, 40), (40, 1), (1, 1), (2, 2)])
def test_frames_of_one_row_are_unwrapped(shape: tuple[int, int]) -> None:
    exact = xr.Dataset({"phase": (("time", "angle", "y", "x"), np.full((2, 1, *shape), 3.0))})
    exact["phase"].attrs["wavelength_um"] = 0.6328
    data = with_noise(at_wavelengths(exact, TWO), 0.02, seed=1)
    found = p4d.unwrap(data["wrapped"], METHOD)
    assert found.shape == data["phase"].shape
    np.testing.assert_allclose(wrap(found.values - data["wrapped"].values), 0, atol=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("beat", ["spatial", "temporal-angular", "directional-l1"])
@pytest.mark.usefixtures("traced_memory")
def test_it_stays_within_the_memory_it_names(beat: str) -> None:
    exact = at_wavelengths(step_phantom((90, 90), (0.3, 0.8, 1.4), 10, angles_deg=ANGLES), TWO)
    data = with_noise(exact, 0.6, seed=1)["wrapped"]
    options = {METHOD: {"beat": beat}}
    p4d.compare(data[:2], [METHOD], options=options)  # so that no import is measured
    table = p4d.compare(data, [METHOD], options=options).table
    stacks = table.loc[METHOD, "peak_mb"] * 2**20 / data.nbytes
    assert stacks <= p4d.METHODS[METHOD].working_stacks + 20 * 2 / 40


# ---- what is measured ------------------------------------------------------------------------


def test_measures_speak_of_the_path_whatever_the_wavelength() -> None:
    optics = p4d.Optics()
    data = at_wavelengths(step_phantom(paths_um=(1.5,), n_times=1), TWO)
    found = p4d.unwrap(data["wrapped"], METHOD)
    plate = data["phase"].values[0, 0] > 1
    table = p4d.measure(found, {"plate": plate}, optics, object_index=1.4)
    assert table["wavelength (um)"].tolist() == list(TWO)
    np.testing.assert_allclose(table["mean optical path difference (nm)"], 1500, rtol=1e-4)
    np.testing.assert_allclose(table["mean height (um)"], 1.5 / (1.4 - 1.333), rtol=1e-4)
    pixel = float(np.diff(found["x"][:2])[0]) ** 2
    np.testing.assert_allclose(table["dry mass (pg)"], 1.5 * plate.sum() * pixel / 0.18, rtol=1e-4)
    assert table["mean phase (rad)"].tolist() == pytest.approx([TURN * 1.5 / w for w in TWO], 1e-4)
    cells = np.broadcast_to(plate, found.shape).astype(np.int32)
    of_cells = p4d.measure(found, cells, optics, object_index=1.4)
    assert of_cells["wavelength (um)"].tolist() == list(TWO)
    for column in ("dry mass (pg)", "mean optical path difference (nm)", "volume (um^3)"):
        assert of_cells[column][0] == pytest.approx(of_cells[column][1], rel=1e-3)
    np.testing.assert_allclose(of_cells["mean optical path difference (nm)"], 1500, rtol=1e-3)


def test_noise_is_said_as_path_of_each_wavelength(reconstruction: xr.Dataset) -> None:
    table = noise_figures(reconstruction)
    expected = table["spatial_phase_mrad"] * np.array([*TWO, *TWO]) / TURN
    np.testing.assert_allclose(table["spatial_path_nm"], expected)
    assert table["fringe_visibility"].notna().all()


def test_itoh_margins_know_no_step_from_wavelength_to_wavelength() -> None:
    exact = at_wavelengths(swimming_euglena((48, 64), 2, peak_rad=30, pixel_um=0.5), TWO)["phase"]
    margin = itoh_margin(exact)["along_angle"]
    alone = [itoh_margin(exact.isel(angle=[i, i + 2]).drop_vars("wavelength")) for i in (0, 1)]
    shares = [own["along_angle"].attrs["share_beyond"] for own in alone]
    assert margin.attrs["share_beyond"] == pytest.approx(np.mean(shares))
    np.testing.assert_array_equal(margin.values[:, [0, 2]], alone[0]["along_angle"].values)
    ways = [
        order_shares(exact.isel(angle=[i, i + 2]).drop_vars("wavelength"))["temporal-angular"]
        for i in (0, 1)
    ]
    assert order_shares(exact)["temporal-angular"] == pytest.approx(np.mean(ways))


def test_a_movie_names_angle_and_wavelength_of_its_rows() -> None:
    exact = at_wavelengths(step_phantom((40, 40), (0.3,), 2, angles_deg=(-21.5,)), TWO)
    labels = [angle_label([exact["phase"]], row) for row in range(2)]
    assert labels == ["-21.5°\n532 nm", "-21.5°\n632.8 nm"]


@pytest.mark.slow
def test_from_the_command_line(tmp_path: Path, hologram: p4d.Recording) -> None:
    import tifffile

    tifffile.imwrite(tmp_path / "two.tif", hologram.holograms.values)
    views = [
        word
        for angle in ANGLES
        for light in TWO
        for word in ("--angle", angle, "--view-wavelength", light)
    ]
    done = command(
        "run", "two.tif", "--out", "out", *views, "--method", METHOD, "--whole-field",
        "--boundary", "0,0", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "wavelength" in done.stdout
    found = read_results(tmp_path / "out" / f"{METHOD}.ome.tif").compute()
    assert found["wavelength"].values.tolist() == [*TWO, *TWO]
    table = pd.read_csv(tmp_path / "out" / "table.csv")
    assert table["id"].tolist() == [METHOD]


# ---- the simulation --------------------------------------------------------------------------


def test_the_phantom_has_the_paths_that_were_asked_for() -> None:
    exact = step_phantom(paths_um=PLATES, n_times=2, angles_deg=(0.0, 60.0))["phase"]
    path = exact.values * 0.6328 / TURN
    assert np.unique(path[:, 0].round(4)).tolist() == pytest.approx([0.0, *PLATES])
    np.testing.assert_allclose(path[:, 1], 2 * path[:, 0], rtol=1e-5)
    with pytest.raises(ValueError, match="have no room"):
        step_phantom((10, 10), PLATES)
    sloped = step_phantom(paths_um=(1.0,), slope_um=0.5)["phase"].values * 0.6328 / TURN
    assert (sloped.max(), sloped[sloped > 0].min()) == pytest.approx((1.25, 0.75), rel=1e-4)


def test_wavelengths_that_can_not_be_are_refused() -> None:
    data = step_phantom()
    for light in ((0.5, 0.5), (0.5, 0), ()):
        with pytest.raises(ValueError, match="wavelengths_um must be different lengths above 0"):
            at_wavelengths(data, light)
    with pytest.raises(ValueError, match="data must note its one wavelength"):
        at_wavelengths(at_wavelengths(data, TWO), TWO)


def test_one_wavelength_of_all_views_may_be_noted_as_a_single_number() -> None:
    wrapped = swimming_euglena((24, 32), 3, peak_rad=9)["wrapped"].drop_vars(
        "wavelength", errors="ignore"
    )
    noted = wrapped.assign_coords(wavelength=0.633)
    for method in ("temporal-angular", "directional-l1"):
        expected = p4d.unwrap(wrapped, method).values
        np.testing.assert_array_equal(p4d.unwrap(noted, method).values, expected)
