"""Cells where little, or nothing, tells the level of the empty field; and what was beside it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.analysis import with_empty_field

OPTICS = p4d.Optics()
PIXEL_UM = 0.1
#: Half axes of two balls in micrometres, and where they lie.
RADIUS_UM, PLACES = 2.0, ((3.0, 3.0), (6.5, 6.5))
#: Phase of one micrometre of a ball, in radians.
RAD_PER_UM = 0.8


def balls(noise: float = 0.0) -> xr.DataArray:
    """Return unwrapped phase (time, angle, y, x) of two balls that swim."""
    y, x = np.mgrid[:96, :96] * PIXEL_UM
    frames = np.zeros((4, 1, 96, 96))
    for time in range(4):
        for down, right in PLACES:
            away = (y - down) ** 2 + (x - right - 0.05 * time) ** 2
            frames[time, 0] += RAD_PER_UM * 2 * np.sqrt(np.clip(RADIUS_UM**2 - away, 0, None))
    frames += noise * np.random.default_rng(0).standard_normal(frames.shape)
    return xr.DataArray(
        frames.astype(np.float32),
        dims=("time", "angle", "y", "x"),
        coords={
            "time": np.arange(4.0),
            "angle": [0.0],
            "y": np.arange(96) * PIXEL_UM,
            "x": np.arange(96) * PIXEL_UM,
        },
        attrs={"units": "rad"},
    )


#: What holograms note whose empty field was put to 0.
LEVELLED = {"drift_removed": True, "background": "tilt"}


def true_mass_pg() -> float:
    """Return the dry mass of a ball, by its volume."""
    volume = 4 / 3 * np.pi * RADIUS_UM**3
    return OPTICS.dry_mass_pg(RAD_PER_UM * volume, 1.0, 0.18)


def masses(phase: xr.DataArray) -> np.ndarray:
    """Return the masses of all cells, found and measured step by step."""
    table = p4d.measure(phase, p4d.find_cells(phase), OPTICS)
    assert sorted(set(table["cell"])) == [1, 2]
    return np.asarray(table["dry mass (pg)"], dtype=np.float64)


@pytest.mark.parametrize("noise", [0.05, 0.4])
@pytest.mark.parametrize("level", [-0.3, 0.3, 2.0])
def test_level_that_a_mask_left_out_is_said_and_comes_back(level: float, noise: float) -> None:
    """It counts as 0, and masses are 8 to 126 % off."""
    exact = balls(noise)
    wrapped = exact.copy(data=wrap(exact.values + level).astype(np.float32))
    found = p4d.unwrap(wrapped, "directional-l1", mask="auto")
    cells = p4d.find_cells(balls())
    with pytest.warns(UserWarning, match="with_empty_field"):
        weighed = p4d.measure(found, cells, OPTICS)["dry mass (pg)"].to_numpy()
    assert (abs(weighed / true_mass_pg() - 1) > 0.07).all()
    np.testing.assert_allclose(
        masses(with_empty_field(found, wrapped)), true_mass_pg(), rtol=0.02 + 0.2 * noise
    )


@pytest.mark.parametrize("noise", [0.05, 0.4])
def test_levelled_holograms_are_not_doubted(noise: float) -> None:
    """Their empty field is at 0, whatever is left of it."""
    exact = balls(noise)
    wrapped = exact.copy(data=wrap(exact.values).astype(np.float32))
    found = p4d.unwrap(wrapped.assign_attrs(LEVELLED), "directional-l1", mask="auto")
    np.testing.assert_allclose(masses(found), true_mass_pg(), rtol=0.02 + 0.2 * noise)


def test_a_mask_that_leaves_nothing_out_hides_no_field() -> None:
    exact = balls(0.05) + 2
    found = p4d.unwrap(exact.copy(data=wrap(exact.values)), "directional-l1")
    np.testing.assert_allclose(masses(found.assign_attrs(mask="auto")), true_mass_pg(), rtol=0.02)


@pytest.mark.parametrize("kept_px", [0, 2, 6])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_cells_are_found_where_all_round_them_is_unknown(noise: float, kept_px: int) -> None:
    """The commonest phase is that of the cells then; none was found, in silence."""
    exact = balls(noise)
    kept = balls().values > 0
    if kept_px:
        kept = ndimage.binary_dilation(kept, ndimage.generate_binary_structure(4, 1), kept_px)
    cells = p4d.find_cells(exact.where(xr.DataArray(kept, dims=exact.dims)))
    assert sorted(set(np.unique(cells))) == [0, 1, 2]


def test_no_field_at_all_is_said() -> None:
    """A view that is full of cells does not tell their level, and their error did not say so."""
    exact = balls()
    everywhere = np.ones(exact.shape, dtype=np.int32)
    with pytest.warns(UserWarning, match="in 4 of 4 frames no empty field is seen"):
        p4d.measure(exact + 2, everywhere, OPTICS)


def test_little_field_makes_errors_large() -> None:
    """Of a level that one pixel tells, the noise of that pixel is part of the error."""
    labels = np.ones((1, 1, 60, 60), dtype=np.int32)
    labels[..., :5, :5] = 0
    base = balls().isel(time=[0])[..., :60, :60]
    flat = base.copy(data=np.where(labels > 0, 2.0, 0.0))
    found, errors = [], []
    for seed in range(40):
        noise = 0.3 * np.random.default_rng(seed).standard_normal(flat.shape)
        table = p4d.measure(flat + noise, labels, OPTICS)
        found.append(float(table["dry mass (pg)"].iloc[0]))
        errors.append(float(table["dry mass error (pg)"].iloc[0]))
    assert 0.5 < np.median(errors) / np.std(found) < 2


# ---- what else was found beside it ------------------------------------------------------------


def test_wavelengths_in_nanometres_are_saved_in_micrometres(tmp_path: object) -> None:
    """They came back as so many micrometres, and masses 1000 times too large."""
    from pathlib import Path

    light = ("angle", [532.0, 633.0], {"units": "nm"})
    two = balls().isel(angle=[0, 0]).assign_coords(angle=[0.0, 0.0], wavelength=light)
    for name in ("two.ome.tif", "two.ome.zarr"):
        back = p4d.read_results(p4d.write_phase(Path(str(tmp_path)) / name, two))
        np.testing.assert_allclose(back["wavelength"], [0.532, 0.633])
        assert back["wavelength"].attrs["units"] == "um"


def shuffled(stack: xr.DataArray) -> xr.DataArray:
    return stack.isel(time=[2, 0, 3, 1])


def backwards(stack: xr.DataArray) -> xr.DataArray:
    return stack.isel(time=slice(None, None, -1))


@pytest.mark.parametrize("change", [shuffled, backwards])
def test_labels_are_followed_by_their_times(
    change: Callable[[xr.DataArray], xr.DataArray],
) -> None:
    """Times that do not rise are refused, as `find_cells` does."""
    cells = p4d.find_cells(balls())
    with pytest.raises(ValueError, match="the time coordinates of the labels do not rise"):
        p4d.follow_cells(change(cells))


def test_steps_of_several_wavelengths_are_counted_one_by_one() -> None:
    """Of one that is left out nothing counts, not even that it is one of two."""
    from napari_phase4d.analysis import itoh_margin

    light = ("angle", [0.5, 0.6, 0.5, 0.6])
    phase = balls().isel(time=[0], angle=[0, 0, 0, 0])
    phase = phase.assign_coords(angle=[0.0, 0.0, 5.0, 5.0], wavelength=light)
    rising = phase + xr.DataArray([0.0, 0.0, 4.0, 0.5], dims="angle")
    where = rising.copy(data=np.ones(rising.shape, dtype=bool))
    where[{"angle": [1, 3]}] = False
    assert itoh_margin(rising, where)["along_angle"].attrs["share_beyond"] == 1.0
    where[{"angle": [1, 3], "y": slice(0, 48)}] = True
    share = itoh_margin(rising, where)["along_angle"].attrs["share_beyond"]
    assert share == pytest.approx(2 / 3)


def test_a_run_of_phase_says_what_needs_holograms(tmp_path: Path) -> None:
    """And does not note it as done."""
    exact = balls()
    path = tmp_path / "phase.ome.tif"
    p4d.write_phase(path, exact.copy(data=wrap(exact.values).astype(np.float32)))
    recipe = p4d.Recipe(
        recording=str(path), methods=("temporal",), reference="nothere.tif", refocus_um=5.0
    )
    with pytest.warns(UserWarning, match="a reference and refocusing need holograms"):
        outcome = p4d.run(recipe)
    assert (outcome.recipe.reference, outcome.recipe.refocus_um) == (None, None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.run(recipe.changed(reference=None, refocus_um=None))


def test_a_background_and_a_window_need_holograms_too(tmp_path: Path) -> None:
    exact = balls()
    path = tmp_path / "phase.ome.tif"
    p4d.write_phase(path, exact.copy(data=wrap(exact.values).astype(np.float32)))
    lobe = p4d.Lobe((0.2, 0.1), 0.05)
    recipe = p4d.Recipe(recording=str(path), methods=("temporal",))
    with pytest.warns(UserWarning, match="taking a background off needs holograms, and is"):
        outcome = p4d.run(recipe.changed(lobes=(lobe,), background="zernike"))
    assert outcome.recipe.background == "tilt"
    with pytest.warns(UserWarning, match="a window round the lobes needs holograms, and is"):
        p4d.run(recipe.changed(window="tukey"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.run(recipe.changed(background="none", lobes=(lobe,)))
