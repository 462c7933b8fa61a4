"""What frames are divided by: references of several frames, and damaged ones."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

import napari_phase4d as p4d
from napari_phase4d.holography import Lobe
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

LOBES = [Lobe((0.19, 0.21), 0.1), Lobe((-0.21, 0.19), 0.1, 1.0)]
SHAPE, PIXEL_UM, TIMES = (128, 128), 0.35, 12
CURVATURE_RAD = 5.0


@pytest.fixture(scope="module")
def exact() -> Any:
    return swimming_euglena(SHAPE, TIMES, pixel_um=PIXEL_UM, peak_rad=4)["phase"]


@pytest.fixture(scope="module")
def rec(exact: Any) -> p4d.Recording:
    return multiplexed_video(exact[:2], curvature_rad=CURVATURE_RAD)


def empty(exact: Any, tilts_rad: Any = 0.0, **arguments: Any) -> p4d.Recording:
    """Return a recording without the object, whose frames tilt along x."""
    across = np.linspace(-1, 1, SHAPE[1])
    tilts = np.broadcast_to(tilts_rad, TIMES)[:, None, None, None] * across
    return multiplexed_video(exact * 0 + tilts, curvature_rad=CURVATURE_RAD, seed=9, **arguments)


def errors(data: Any, exact: Any) -> np.ndarray:
    """Return how far the phase is off in radians, without what the border joins."""
    lies = [
        (PIXEL_UM * ratio, PIXEL_UM * (ratio - 1) / 2)
        for ratio in np.divide(SHAPE, data["phase"].shape[2:])
    ]
    pixel, first = zip(*lies, strict=True)
    truth = swimming_euglena(
        data["phase"].shape[2:], TIMES, pixel_um=pixel, first_um=first, peak_rad=4
    )["phase"].values[:2]
    off = np.angle(np.exp(1j * (data["phase"].values - truth)))[..., 4:-4, 4:-4]
    return np.angle(np.exp(1j * (off - np.median(off, axis=(2, 3), keepdims=True))))


# Half a turn to and fro, once round, and steps: grey values would cancel in all of them.
DRIFTS = {
    "steps": {"drift_rad": 2.0},
    "tilts": {"tilts_rad": np.linspace(-6, 6, TIMES)},
    "both": {"drift_rad": 2.0, "tilts_rad": np.linspace(-3, 3, TIMES)},
}


@pytest.mark.parametrize("moves", DRIFTS)
def test_a_reference_whose_fringes_move_does_not_cancel(
    exact: Any, rec: p4d.Recording, moves: str
) -> None:
    reference = empty(exact, **DRIFTS[moves])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = p4d.reconstruct(rec, LOBES, reference)
    assert errors(data, exact).std() < 0.12
    assert float(np.median(data["amplitude"])) == pytest.approx(1, abs=0.02)


def test_a_steady_reference_is_the_mean_of_its_grey_values(exact: Any, rec: p4d.Recording) -> None:
    steady = empty(exact)
    grey = steady.holograms.values.astype(np.float32).mean(axis=0)
    data, mean = (p4d.reconstruct(rec, LOBES, reference) for reference in (steady, grey))
    off = np.angle(np.exp(1j * (data["phase"].values - mean["phase"].values)))
    assert np.abs(off).max() < 2e-3
    np.testing.assert_allclose(data["amplitude"], mean["amplitude"], rtol=2e-3)


def test_a_reference_whose_frames_have_nothing_in_common_is_said(
    exact: Any, rec: p4d.Recording
) -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[0]
    bent = exact * 0
    for time in range(TIMES):  # a wave of its own in each frame, of no tilt
        angle = 2 * np.pi * time / TIMES
        bent[time] = 3 * np.sin(5 * (x * np.cos(angle) + y * np.sin(angle)) + 2 * time)
    with pytest.warns(UserWarning, match="the frames of the reference don't agree in view 1"):
        p4d.reconstruct(rec, LOBES, multiplexed_video(bent))


def torn(frame: np.ndarray, share: float) -> np.ndarray:
    """Return a frame whose lower rows are black."""
    found = frame.copy()
    found[round((1 - share) * len(found)) :] = 0
    return found


@pytest.mark.parametrize("first_frames", [None, 6])
def test_a_lost_frame_is_no_reference(exact: Any, first_frames: int | None) -> None:
    frames = multiplexed_video(exact).holograms.values.copy()
    frames[0] = torn(frames[0], 0.45)
    damaged = p4d.open_recording(frames)
    for number in (0, -TIMES):
        with pytest.raises(ValueError, match=rf"reference frame {number} of the array is lost"):
            p4d.reconstruct(damaged, LOBES, number, first_frames=first_frames)
    kept = p4d.reconstruct(damaged, LOBES, 1, first_frames=first_frames)
    assert kept.attrs["reference"] == "frame 1"
    with pytest.raises(TypeError, match="reference must be a frame number"):
        p4d.reconstruct(damaged, LOBES, True, first_frames=first_frames)


def test_a_reference_without_fringes_in_a_part_is_said(exact: Any, rec: p4d.Recording) -> None:
    frame = empty(exact).holograms.values[0]
    with pytest.warns(UserWarning, match=r"no fringes on 4\d % of view 1 and 4\d % of view 2"):
        p4d.reconstruct(rec, LOBES, torn(frame, 0.45))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.reconstruct(rec, LOBES, frame)
