"""The preview's wrapped phase against the reconstruction's and against plain transforms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.holography import WINDOWS, Lobe, Preview
from napari_phase4d.holography.demodulation import half_spectrum

PAIR = [Lobe((0.19, 0.21), 0.09), Lobe((-0.21, 0.19), 0.07, 1.0)]
CHOICES = {
    "pair": PAIR,
    "one beside its carrier": [Lobe((0.183, 0.2147), 0.1)],
    "conjugates and flipped": [
        Lobe((-0.19, -0.21), 0.08, 0.0, flip=True), Lobe((0.21, -0.19), 0.08, 1.0),
    ],
    "over the edge and over zero": [Lobe((0.49, 0.3), 0.1), Lobe((0.03, -0.01), 0.06, 1.0)],
    "six": [Lobe((0.06 * i - 0.15, 0.2 + 0.01 * i), 0.05, float(i)) for i in range(6)],
}  # fmt: skip


def speckle(shape: tuple[int, int], dtype: str, seed: int = 0) -> np.ndarray:
    """Noise with fringes in it: every lobe holds something bright."""
    y, x = np.indices(shape)
    grey = np.random.default_rng(seed).normal(120, 25, shape)
    for lobe in PAIR:
        turns = lobe.carrier[0] * y + lobe.carrier[1] * x
        grey += 30 * np.cos(2 * np.pi * turns + np.hypot(y - 40, x - 50) / 9)
    return np.clip(grey * (200 if dtype == "uint16" else 1), 0, np.inf).astype(dtype)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:lobe", "ignore:.*shows? no fringes")
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("shape", [(128, 128), (129, 160), (150, 131), (97, 101)])
@pytest.mark.parametrize("choice", CHOICES)
def test_phase_is_that_of_the_reconstruction(
    choice: str, shape: tuple[int, int], dtype: str
) -> None:
    frame = speckle(shape, dtype)
    lobes = CHOICES[choice]
    rec = p4d.open_recording(frame[None])
    preview = Preview(frame)
    for window in WINDOWS:
        whole = p4d.reconstruct(rec, lobes, window=window, background="none", drift=False)
        found = preview.phases(lobes, window)
        assert len(found) == len(lobes)
        for view, phase in enumerate(found):
            assert phase.dtype == np.float32
            amplitude, expected = (
                whole[name].values[0, view].astype(np.float64) for name in ("amplitude", "phase")
            )
            expected = expected - np.angle((amplitude * np.exp(1j * expected)).mean())
            assert phase.shape == expected.shape
            assert np.abs(phase).max() <= np.float32(np.pi)
            bright = amplitude > 0.05 * amplitude.max()
            assert bright.mean() > 0.1
            assert np.abs(wrap(phase - expected))[bright].max() < 1e-5


@pytest.mark.parametrize("shape", [(64, 80), (65, 81), (300, 131)])
def test_half_spectrum_is_that_of_rfft2(shape: tuple[int, int]) -> None:
    frame = speckle(shape, "uint8")
    expected = np.fft.rfft2(frame.astype(np.float64))
    found = half_spectrum(frame)
    expected[0, 0] = found[0, 0]  # the level that was taken off
    assert found.dtype == np.complex64
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())


def test_only_the_lobe_that_moved_is_cut_out_anew() -> None:
    preview = Preview(speckle((129, 160), "uint8"))
    first, second = preview.phases(PAIR)
    moved, still = preview.phases([replace(PAIR[0], carrier=(0.2, 0.21)), PAIR[1]])
    assert still is second
    assert np.abs(wrap(moved - first)).max() > 0.1


def test_one_preview_serves_many_choices_of_lobes() -> None:
    """What was asked before leaves no trace."""
    frame = speckle((128, 140), "uint8")
    kept = Preview(frame)
    for lobes in (*CHOICES.values(), PAIR):
        for phase, fresh in zip(kept.phases(lobes), Preview(frame).phases(lobes), strict=True):
            np.testing.assert_array_equal(phase, fresh)


@pytest.mark.parametrize("drift", [0.4, 2.9, -3.0])
def test_drift_of_the_fringes_does_not_show(drift: float) -> None:
    """A constant phase between the arms moves the fringes, not the picture."""
    y, x = np.indices((128, 128))
    ring = 5 * np.exp(-((y - 60) ** 2 + (x - 70) ** 2) / 300)
    turns = 2 * np.pi * (0.1875 * y + 0.25 * x)
    still, moved = (
        Preview((100 + 50 * np.cos(turns + ring + d)).astype(np.float32)).phases(
            [Lobe((0.1875, 0.25), 0.1)]
        )[0]
        for d in (0.0, drift)
    )
    assert np.abs(wrap(moved - still)).max() < 0.02
    assert np.ptp(still) > 5  # the object's rings are there
    assert abs(np.angle(np.exp(1j * still.astype(np.float64)).mean())) < 0.1


def test_no_lobes_give_no_phase() -> None:
    assert Preview(speckle((64, 64), "uint8")).phases([]) == []


def test_dark_frames_have_no_phase_and_no_trouble() -> None:
    (phase,) = Preview(np.zeros((64, 64), np.uint8)).phases([PAIR[0]])
    assert not phase.any()


def test_wrong_input_is_said_so() -> None:
    with pytest.raises(ValueError, match=r"takes one frame \(y, x\), but got .* \(2, 64, 64\)"):
        Preview(np.zeros((2, 64, 64)))
    with pytest.raises(ValueError, match="window must be one of disk"):
        Preview(np.zeros((64, 64))).phases(PAIR, "square")
