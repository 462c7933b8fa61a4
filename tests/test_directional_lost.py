"""Frames that say nothing are found, named, and spoil no other."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import napari_phase4d as p4d
from helpers import measured
from napari_phase4d.simulation import hard_shape, moving_shape, with_fault, with_noise
from napari_phase4d.unwrapping.given import lost_frames

TURN = 2 * np.pi
WL1 = "directional-l1"
RNG_SEED = 5


@lru_cache(maxsize=16)
def object_(name: str, views: int = 2) -> xr.Dataset:
    shape = moving_shape if name in ("vacuole", "swelling") else hard_shape
    return shape(name, angles_deg=tuple(6.0 * view for view in range(views)))


def error(found: xr.DataArray, truth: xr.DataArray, empty: np.ndarray) -> float:
    """Return the squared error of wrong turns, each frame relative to its empty field.

    Frames in which the truth is NaN are left out.
    """
    off = np.round((found.values - truth.values) / TURN)
    for frame in np.ndindex(*off.shape[:2]):
        if np.isfinite(off[frame]).any():
            off[frame] -= np.nanmedian(off[frame][empty[frame]])
    return float(TURN**2 * np.nanmean(off**2))


def empty_of(exact: xr.Dataset) -> np.ndarray:
    return np.abs(exact["phase"].values) < 0.05


LOST = {
    "black frame": [[10, 0], [10, 1]],
    "constant frame": [[10, 0], [10, 1]],
    "noise-only frame": [[10, 0], [10, 1]],
    "two black frames": [[10, 0], [10, 1], [11, 0], [11, 1]],
    "black view": [[10, 1]],
    "noise-only view": [[10, 1]],
}


@pytest.mark.parametrize("fault", LOST)
def test_a_lost_frame_is_named_and_spoils_no_other(fault: str) -> None:
    exact = object_("vacuole")
    data = with_fault(exact, fault, 0.3, seed=RNG_SEED)
    found = p4d.unwrap(data["wrapped"], WL1)
    assert found.attrs["lost_frames"] == LOST[fault]
    assert error(found, data["phase"], empty_of(exact)) <= 0.001


def noise_only(exact: xr.Dataset, lost: NDArray[np.bool_]) -> xr.Dataset:
    """Return an object with little noise, some of whose frames (time, angle) are noise alone."""
    data = with_noise(exact, 0.2, seed=RNG_SEED).copy(deep=True)
    size = (int(lost.sum()), *data["wrapped"].shape[2:])
    data["wrapped"].values[lost] = np.random.default_rng(RNG_SEED).uniform(-np.pi, np.pi, size)
    data["phase"].values[lost] = np.nan
    return data


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("swelling", slice(7, 14)),
        ("vacuole", slice(7, 14)),
        ("crossing", slice(0, None, 2)),
        ("shock", slice(10, 11)),
        ("growing wall", slice(10, 11)),
    ],
)
def test_a_view_that_is_lost_spoils_no_other(name: str, times: slice) -> None:
    """What is made up half way between the frames next to it would mislead the others."""
    exact = object_(name)
    lost = np.zeros(exact["phase"].shape[:2], dtype=bool)
    lost[times, 0] = True
    data = noise_only(exact, lost)
    found = p4d.unwrap(data["wrapped"], WL1)
    assert found.attrs["lost_frames"] == np.argwhere(lost).tolist()
    assert error(found, data["phase"], empty_of(exact)) <= 0.005


@pytest.mark.slow
@pytest.mark.parametrize("times", [slice(0, None, 2), slice(7, 14)])
def test_a_view_that_is_dark_spoils_no_other(times: slice) -> None:
    exact = object_("crossing")
    lost = np.zeros(exact["phase"].shape[:2], dtype=bool)
    lost[times, 0] = True
    data = noise_only(exact, lost)
    data["wrapped"].values[lost] = 0
    found = p4d.unwrap(data["wrapped"], WL1)
    assert found.attrs["lost_frames"] == np.argwhere(lost).tolist()
    assert error(found, data["phase"], empty_of(exact)) <= 0.005


def test_most_frames_may_be_lost() -> None:
    exact = object_("vacuole")
    lost = np.ones(exact["phase"].shape[:2], dtype=bool)
    lost[:6] = False
    data = noise_only(exact, lost)
    found = p4d.unwrap(data["wrapped"], WL1)
    assert found.attrs["lost_frames"] == np.argwhere(lost).tolist()
    assert error(found, data["phase"], empty_of(exact)) <= 0.001


def test_a_frame_without_numbers_stays_without() -> None:
    exact = object_("vacuole")
    data = with_noise(exact, 0.3, seed=RNG_SEED)
    data["wrapped"].values[7] = np.nan
    found = p4d.unwrap(data["wrapped"], WL1)
    assert found.attrs["lost_frames"] == [[7, 0], [7, 1]]
    assert np.isnan(found.values[7]).all()
    others = np.arange(20) != 7
    assert np.isfinite(found.values[others]).all()
    kept = data["phase"].isel(time=others)
    assert error(found.isel(time=others), kept, empty_of(exact)[others]) <= 0.001


@pytest.mark.parametrize("name", ["vacuole", "ring"])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.7, 0.92])
def test_no_honest_frame_counts_as_lost(name: str, noise: float) -> None:
    assert not lost_frames(with_noise(object_(name), noise, seed=1)["wrapped"].values).any()


def test_empty_frames_without_noise_before_and_after_a_cell_are_none_of_the_lost() -> None:
    values = object_("vacuole")["wrapped"].values.copy()
    values[:4] = 0
    values[-2:] = 0
    assert not lost_frames(values).any()
    values[8] = 0
    assert lost_frames(values).any(axis=1).nonzero()[0].tolist() == [8]


@pytest.mark.parametrize("clear", [1, 7])
def test_few_clear_frames_make_no_others_lost(clear: int) -> None:
    exact = object_("vacuole")
    values = with_noise(exact, 1.0, seed=1)["wrapped"].values.copy()
    values[:clear] = with_noise(exact, 0.3, seed=2)["wrapped"].values[:clear]
    assert not lost_frames(values).any()


def test_noise_everywhere_loses_no_frame() -> None:
    rng = np.random.default_rng(0)
    assert not lost_frames(rng.uniform(-np.pi, np.pi, (4, 2, 32, 32)).astype(np.float32)).any()


@pytest.mark.slow
@pytest.mark.measured
def test_no_measured_frame_counts_as_lost() -> None:
    rec = p4d.open_recording(measured("multiplexed/mux2_timelapse_t00-29.npz"))
    wrapped = p4d.reconstruct(rec, p4d.find_lobes(rec, 2))["phase"].values
    assert len(wrapped) == 30
    assert not lost_frames(wrapped).any()
