"""What differs from a stack by rounding, by a missing axis or by its notes alone is taken."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe, fringe_mask
from napari_phase4d.recording import Recording
from napari_phase4d.simulation.multiplexing import CARRIERS, PUPIL_RADIUS
from napari_phase4d.stacks import on_grid_of, unwrapped_stack, wrapped_stack

#: The lobes of `multiplexed_video`, which the finder would doubt in frames this small.
LOBES = [Lobe(carrier, PUPIL_RADIUS) for carrier in CARRIERS]


@pytest.fixture(scope="module")
def sample() -> xr.Dataset:
    return p4d.simulation.swimming_euglena((24, 32), 3, peak_rad=9)


def test_single_precision_is_no_other_place(sample: xr.Dataset) -> None:
    one = sample["wrapped"].isel(angle=[1]).assign_coords(angle=[21.3])
    other = one.assign_coords(angle=np.array([21.3], np.float32))
    assert on_grid_of(other, one, "u").equals(other)
    with pytest.raises(ValueError, match="other angle coordinates"):
        on_grid_of(one.assign_coords(angle=[21.4]), one, "u")


def test_plain_arrays_of_the_same_shape_have_the_same_axes(sample: xr.Dataset) -> None:
    phase = sample["wrapped"].isel(time=0)  # (angle, y, x), as long as a video
    amplitude = np.ones(phase.shape, np.float32)
    found = p4d.unwrap(phase, "directional-l1", amplitude=amplitude)
    assert p4d.confidence(found.values, phase).dims == phase.dims


def test_notes_that_were_carried_along_do_not_speak_against_the_numbers(
    sample: xr.Dataset,
) -> None:
    wrapped = sample["wrapped"].assign_attrs(kind="wrapped")
    flat = wrapped.copy(data=np.linspace(-2, 2.5, wrapped.size).reshape(wrapped.shape))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        unwrapped_stack(flat)
        exact = sample["phase"].assign_attrs(kind="unwrapped")
        wrapped_stack(exact.copy(data=exact.values % (2 * np.pi)))
        wrapped_stack(wrapped.assign_attrs(units="dimensionless"))
        wrapped_stack(wrapped.astype(np.float16))


def test_equal_stamps_are_spread_and_earlier_ones_refused() -> None:
    frames = np.random.default_rng(0).integers(1, 200, (5, 16, 16)).astype(np.uint8)
    rec = Recording.from_frames(frames, times_s=[0, 0, 1, 1, 2])
    np.testing.assert_allclose(rec.times_s, [0, 0.5, 1, 1.5, 2])
    assert any("same time stamp" in note for note in rec.notes)
    np.testing.assert_allclose(Recording.from_frames(frames, times_s=[3] * 5).times_s, range(3, 8))
    with pytest.raises(ValueError, match="frame 2 of .* is earlier than the one before"):
        Recording.from_frames(frames, times_s=[0, 2, 1, 3, 4])


def test_a_bad_pixel_of_the_camera_costs_no_frame(sample: xr.Dataset) -> None:
    frames = p4d.simulation.multiplexed_video(sample["phase"]).holograms.values
    bad = np.zeros(frames.shape, bool)
    bad[:, 10, 20] = True
    rec = p4d.open_recording(np.ma.masked_array(frames, bad))
    data = p4d.reconstruct(rec, LOBES)
    assert data.attrs["lost_times"] == []
    assert np.isfinite(data["phase"]).all()


def test_frames_that_contradict_each_other_are_refused_in_a_sentence() -> None:
    y, x = np.indices((128, 128))
    fringes = np.cos(2 * np.pi * (0.2 * y + 0.2 * x))
    halves = [np.where((x < 64) == left, fringes, 0) for left in (True, False)]
    noise = np.random.default_rng(0).normal(0, 2, (2, 128, 128))
    rec = p4d.open_recording(np.clip(100 + 60 * np.stack(halves) + noise, 0, 255).astype(np.uint8))
    with pytest.raises(ValueError, match="no frame of .* shows fringes"):
        p4d.reconstruct(rec, [Lobe((0.2, 0.2), 0.1)])


def test_fringes_of_one_view_and_of_none(sample: xr.Dataset) -> None:
    rec = p4d.simulation.multiplexed_video(sample["phase"])
    data = p4d.reconstruct(rec, LOBES)
    seen = fringe_mask(data.isel(angle=0))
    assert seen.dims == ("time", "y", "x")
    dark = data.isel(angle=0).copy()
    dark["amplitude"] = dark["amplitude"] * 0
    assert not fringe_mask(dark).any()
