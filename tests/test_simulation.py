from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from napari_phase4d import Optics
from napari_phase4d.simulation import (
    Ellipsoid,
    at_wavelengths,
    budding_yeast,
    hard_shape,
    multiplexed_video,
    pixels_of,
    projected_phase,
    step_phantom,
    swimming_cells,
    swimming_euglena,
    with_fault,
)
from napari_phase4d.simulation.ellipsoids import path_length_um, rotation


def test_chord_through_a_sphere() -> None:
    sphere = Ellipsoid((0, 0, 0), (2, 2, 2), 0.1)
    grid = np.array([-1.5, 0.0, 1.0])
    path = path_length_um(sphere, 33.0, grid, grid)
    expected = 2 * np.sqrt(np.maximum(4 - grid[:, None] ** 2 - grid[None, :] ** 2, 0))
    np.testing.assert_allclose(path, expected, atol=1e-12)


def test_turned_ellipsoid_against_numerical_integration() -> None:
    body = Ellipsoid((0.3, -0.2, 0.5), (3, 2, 1), 0.02, rotation("z", 20) @ rotation("x", 35))
    angle = 25.0
    y, x = np.array([-0.7, 0.1, 0.9]), np.array([-1.1, 0.2, 1.3])
    z = np.linspace(-6, 6, 120_001)
    view = rotation("y", angle)
    quadric = view @ body.axes @ np.diag(1 / np.square(body.semi_axes_um)) @ body.axes.T @ view.T
    centre = view @ np.array(body.centre_um)
    expected = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            point = np.stack([np.full_like(z, x[j]), np.full_like(z, y[i]), z]) - centre[:, None]
            inside = np.einsum("iz,ij,jz->z", point, quadric, point) <= 1
            expected[i, j] = inside.sum() * (z[1] - z[0])
    phase = projected_phase([body], angle, y, x, wavelength_um=0.5)
    np.testing.assert_allclose(phase, 2 * np.pi / 0.5 * 0.02 * expected, atol=1e-3)


def test_euglena_is_the_same_object_on_every_grid() -> None:
    fine = swimming_euglena((128, 128), 3, pixel_um=0.4)["phase"]
    coarse = swimming_euglena((64, 32), 3, pixel_um=(0.8, 1.6))["phase"]
    np.testing.assert_allclose(fine.values[:, :, ::2, ::4], coarse.values, atol=1e-5)


def test_places_of_a_stack_may_begin_elsewhere() -> None:
    """As those of a reconstruction, whose first pixel stands for the middle of several."""
    fine = swimming_euglena((128, 128), 2, pixel_um=0.4)["phase"]
    lies = {"pixel_um": (0.8, 1.6), "first_um": (0.4, 0.8)}
    coarse = swimming_euglena((64, 32), 2, **lies)["phase"]
    np.testing.assert_allclose(fine.values[:, :, 1::2, 2::4], coarse.values, atol=1e-5)
    for axis, places in (("y", fine["y"][1::2]), ("x", fine["x"][2::4])):
        np.testing.assert_allclose(coarse[axis], places)
    with pytest.raises(ValueError, match="first_um must be a finite number, but is nan"):
        swimming_euglena((8, 8), 1, first_um=float("nan"))


def test_pixels_of_a_stack_are_those_it_was_simulated_with() -> None:
    lies = {"pixel_um": (0.8, 1.6), "first_um": (0.4, 0.8)}
    phase = swimming_euglena((64, 32), 1, **lies)["phase"]
    for name, lengths in pixels_of(phase).items():
        np.testing.assert_allclose(lengths, lies[name])
    for stack in (phase.isel(x=slice(1)), phase.drop_vars("y"), phase.isel(y=0)):
        with pytest.raises(ValueError, match="the stack has no places of two pixels or more"):
            pixels_of(stack)
    with pytest.raises(TypeError, match="pixel_um must be a"):
        swimming_cells((64, 64), 1, 1, **pixels_of(phase))


def test_cells_lie_where_their_pixels_do() -> None:
    fine = swimming_cells((128, 192), 3, 2, pixel_um=0.5, divisions=0, leaving=0)
    coarse = swimming_cells((64, 96), 3, 2, pixel_um=1.0, first_um=0.5, divisions=0, leaving=0)
    for name in ("phase", "cells"):
        np.testing.assert_allclose(
            fine[name].values[:, :, 1::2, 1::2], coarse[name].values, atol=1e-5
        )


def test_euglena_is_thin_at_its_boundary_frame_and_wraps_exactly() -> None:
    data = swimming_euglena((64, 64), 40, pixel_um=0.7, peak_rad=17)
    peaks = data["phase"].max(("y", "x")).values
    assert data.attrs["boundary"] == (0, 0)
    assert peaks.argmin() == 0
    assert peaks.max() == pytest.approx(17, rel=0.03)
    turns = (data["phase"] - data["wrapped"]).values / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)
    assert np.abs(data["wrapped"].values).max() <= np.float32(np.pi)


def test_video_has_all_three_cross_correlation_pairs() -> None:
    phase = swimming_euglena((128, 128), 2, pixel_um=0.35, peak_rad=1)["phase"]
    video = multiplexed_video(phase, carriers=((0.25, 0.125), (-0.125, 0.25)), bits=16)
    spectrum = np.abs(np.fft.fft2(video.holograms.values[0].astype(float)))
    peaks = {(32, 16), (-16, 32), (48, -16)}  # views, and their beat at the difference
    strongest = np.argsort(spectrum.ravel())[::-1][:7]
    found = {tuple(int(v) for v in np.unravel_index(i, spectrum.shape)) for i in strongest}
    for ky, kx in peaks:
        assert (ky % 128, kx % 128) in found
        assert (-ky % 128, -kx % 128) in found


def test_video_is_seeded() -> None:
    phase = swimming_euglena((64, 64), 2, pixel_um=0.7)["phase"]
    first, again, other = (
        multiplexed_video(phase, drift_rad=0.1, seed=s).holograms.values for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_shot_noise_has_the_variance_of_its_electrons() -> None:
    phase = swimming_euglena((256, 256), 1, pixel_um=10.0)["phase"] * 0
    video = multiplexed_video(
        phase[:, :1], carriers=[(0.25, 0.0)], bits=16, unevenness=0, read_noise_electrons=0,
        full_well_electrons=1000,
    )  # fmt: skip
    electrons = video.holograms.values[0].astype(float) / (2**16 - 1) * 1000
    rows = electrons.reshape(64, 4, 256)  # the fringe repeats every four rows
    mean, variance = rows.mean((0, 2)), rows.var((0, 2))
    np.testing.assert_allclose(variance[mean > 50], mean[mean > 50], rtol=0.05)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"carriers": [(0.2, 0.2)]}, "1 carriers were given for 2 angles"),
        ({"bits": 17}, "bits must lie between 1 and 16"),
        ({"beam_amplitudes": [1, 1, 1]}, "3 beam_amplitudes were given for 2 angles"),
        ({"unevenness": 1.0}, "unevenness must be"),
    ],
)
def test_impossible_video_is_refused(changes: dict, sentence: str) -> None:
    phase = swimming_euglena((32, 32), 1, pixel_um=1.0)["phase"]
    with pytest.raises(ValueError, match=sentence):
        multiplexed_video(phase, Optics(), **changes)


@pytest.mark.parametrize(
    "make",
    [
        lambda: budding_yeast((24, 24), 3),
        lambda: hard_shape("bent tube", (24, 24), 3),
        lambda: step_phantom(),
        lambda: at_wavelengths(budding_yeast((24, 24), 3), (0.532, 0.6328)),
        lambda: at_wavelengths(step_phantom(), (0.532, 0.6328)),
    ],
    ids=["yeast", "hard shape", "steps", "yeast at two wavelengths", "steps at two wavelengths"],
)
def test_phase_notes_whether_it_is_wrapped(make: Callable[[], xr.Dataset]) -> None:
    data = make()
    assert data["phase"].attrs["kind"] == "unwrapped"
    assert data["phase"].attrs["exact"] is True
    assert data["wrapped"].attrs["kind"] == "wrapped"
    assert "exact" not in data["wrapped"].attrs


def test_a_video_is_that_of_the_phase_whatever_the_order_of_its_axes() -> None:
    phase = swimming_euglena((32, 40), 2, pixel_um=1.0)["phase"]
    video, turned = (
        multiplexed_video(each) for each in (phase, phase.transpose("angle", "time", "x", "y"))
    )
    np.testing.assert_array_equal(turned.holograms, video.holograms)
    assert turned.holograms.attrs["angles_deg"] == video.holograms.attrs["angles_deg"]


def test_phase_of_another_wavelength_than_the_optics_is_refused() -> None:
    phase = swimming_euglena((32, 32), 1, pixel_um=1.0, optics=Optics(wavelength_um=0.5))["phase"]
    with pytest.raises(ValueError, match="of a wavelength of 0.5 um, but the optics say 0.6328"):
        multiplexed_video(phase)


@pytest.mark.parametrize(
    ("n_times", "divisions", "entering"), [(6, 3, 0), (10, 0, 6), (12, 3, 4), (40, 3, 3)]
)
def test_as_many_cells_divide_and_come_in_as_are_asked_for(
    n_times: int, divisions: int, entering: int
) -> None:
    data = swimming_cells(
        (64, 64), n_times, 4, pixel_um=1.0,
        divisions=divisions, leaving=0, entering=entering,
    )  # fmt: skip
    daughters = int((data["parent"] > 0).sum())
    assert daughters == 2 * divisions
    assert data.sizes["cell"] == 4 + daughters + entering


def test_cells_outside_of_what_is_seen_have_no_mass() -> None:
    few = {"divisions": 0, "leaving": 0, "entering": 0}
    data = swimming_cells((96, 96), 2, 1, **few)
    width = 96 * float(data["x"][1])
    assert np.isfinite(data["dry_mass_pg"]).all()
    for first in ((width, 0.0), (0.0, -width)):
        away = swimming_cells((96, 96), 2, 1, **few, first_um=first)
        assert not away["phase"].any()
        assert away["dry_mass_pg"].isnull().all()


def test_a_pause_is_in_the_times_too() -> None:
    data = budding_yeast((16, 16), 10)
    paused = with_fault(data, "pause")
    for name in ("phase", "wrapped"):
        np.testing.assert_array_equal(paused[name]["time"], data["time"][[0, 1, 7, 8, 9]])
    np.testing.assert_array_equal(paused["phase"], data["phase"][[0, 1, 7, 8, 9]])


@pytest.mark.parametrize("fault", ["black frame", "constant frame", "two black frames"])
def test_nothing_is_known_of_a_frame_that_the_camera_lost(fault: str) -> None:
    found = with_fault(budding_yeast((16, 16), 4), fault)["phase"]
    assert not np.isfinite(found[2]).any()
    assert np.isfinite(found[:2]).all()


def test_a_fault_needs_no_wrapped_phase() -> None:
    data = budding_yeast((16, 16), 4)
    found = with_fault(data[["phase"]], "kick")
    np.testing.assert_array_equal(found["wrapped"], with_fault(data, "kick")["wrapped"])
