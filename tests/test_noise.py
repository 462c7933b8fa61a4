"""Noise figures against the noise that was put in, and against the camera's shot noise."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.analysis import noise_figures, noise_sentence
from napari_phase4d.analysis.noise import variance_in_space
from napari_phase4d.holography import WINDOWS, Demodulator, Lobe, fringe_visibility
from napari_phase4d.holography.quality import fringe_advice
from napari_phase4d.io import read_results, write_phase
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

#: Its fringes fit into 192 pixels, so that nothing rings at the edges.
LOBE = Lobe((38 / 192, 40 / 192), 0.1)


def stack(
    phase: np.ndarray, amplitude: np.ndarray | None = None, wavelength_um: float = 0.6328
) -> xr.Dataset:
    """Return a reconstruction of given phase and amplitude, (time, angle, y, x)."""
    dims = ("time", "angle", "y", "x")
    coords = {"angle": np.arange(phase.shape[1], dtype=float)}
    data = {"phase": (dims, phase.astype(np.float32))}
    if amplitude is not None:
        data["amplitude"] = (dims, amplitude.astype(np.float32))
    return xr.Dataset(data, coords, {"wavelength_um": wavelength_um})


def wrapped_noise(sigma: float, shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, sigma, shape)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.3])
def test_white_noise_of_known_size_is_found(sigma: float) -> None:
    """Round a thick cell, with drift, tilt and wrapping; two views with different noise.

    24 pairs of frames with 8000 empty pixels each: the figure itself is sure to 0.3 %.
    """
    shape = (30, 2, 128, 120)
    y, x = np.meshgrid(np.linspace(-1, 1, 128), np.linspace(-1, 1, 120), indexing="ij")
    cell = 9 * np.sqrt(np.maximum(1 - (y / 0.4) ** 2 - (x / 0.3) ** 2, 0))
    drift = np.cumsum(wrapped_noise(0.8, (30, 1, 1, 1), seed=1), axis=0)
    noise = wrapped_noise(sigma, shape) * np.array([1, 0.5])[:, None, None]
    phase = np.angle(np.exp(1j * (cell + drift + 0.1 * y - 0.05 * x + noise)))
    amplitude = 7 * (1 + wrapped_noise(0.02, shape, seed=2))
    table = noise_figures(stack(phase, amplitude))
    assert list(table.index) == [1, 2]
    for view, share in ((1, 1.0), (2, 0.5)):
        row = table.loc[view]
        for name in ("temporal", "spatial"):
            assert row[f"{name}_phase_mrad"] == pytest.approx(1000 * sigma * share, rel=0.02)
            # 2 pi of phase is a wavelength.
            expected = 1000 * sigma * share / (2 * math.pi) * 0.6328
            assert row[f"{name}_path_nm"] == pytest.approx(expected, rel=0.02)
            assert row[f"{name}_amplitude_percent"] == pytest.approx(2, rel=0.02)
    # The cell covers 0.4 * 0.3 * pi / 4 = 9 % of the frame, the margin 23 %.
    assert 60 < table["empty_percent"].iloc[0] < 69


def test_figures_are_what_they_are_defined_to_be() -> None:
    """By hand: fixed structure counts in space only, what flickers in time only half squared."""
    y, x = np.indices((64, 64))
    fixed = 0.05 * (-1.0) ** (y + x)  # of standard deviation 0.05
    flicker = 0.02 * (-1.0) ** y
    phase = np.stack([fixed + flicker * (-1) ** t for t in range(9)])[:, None]
    row = noise_figures(stack(phase)).loc[1]
    # From frame to frame each pixel moves by 0.04, all rows alternating: 0.04 / sqrt(2).
    assert row["temporal_phase_mrad"] == pytest.approx(1000 * 0.04 / math.sqrt(2), rel=1e-3)
    assert row["spatial_phase_mrad"] == pytest.approx(1000 * math.hypot(0.05, 0.02), rel=1e-3)
    assert math.isnan(row["temporal_amplitude_percent"])
    assert row["empty_percent"] == pytest.approx(100 * (56 / 64) ** 2)


@pytest.mark.parametrize(
    ("bits", "full_well", "read_noise"), [(12, 10_000, 8.0), (8, 2_000, 15.0)]
)
def test_camera_noise_is_that_of_its_electrons(
    bits: int, full_well: int, read_noise: float
) -> None:
    """White grey-value noise of variance v leaves v * f / 2 in each quadrature of the field.

    f is the mean squared window over all frequencies, v the shot noise of the mean grey value,
    read noise and rounding (1/12), and the phase noise sqrt(v f / 2) over the field's amplitude.
    """
    phase = swimming_euglena((192, 192), 12, pixel_um=0.17)["phase"][:, :1] * 0
    video = multiplexed_video(
        phase, carriers=[LOBE.carrier], bits=bits, full_well_electrons=full_well,
        read_noise_electrons=read_noise, unevenness=0, drift_rad=0.3,
    )  # fmt: skip
    data = p4d.reconstruct(video, [LOBE], background="none")
    mean, step = float(video.holograms.mean()), (2**bits - 1) / full_well
    variance = (mean / step + read_noise**2) * step**2 + 1 / 12
    ky, kx = np.fft.fftfreq(192)[:, None], np.fft.fftfreq(192)[None, :]
    f = np.mean(WINDOWS["smooth-disk"](np.hypot(ky, kx) / LOBE.radius) ** 2)
    amplitude = float(data["amplitude"].median())
    table = noise_figures(data)
    expected = math.sqrt(variance * f / 2) / amplitude
    assert table["temporal_phase_mrad"].iloc[0] == pytest.approx(1000 * expected, rel=0.03)
    assert table["temporal_amplitude_percent"].iloc[0] == pytest.approx(100 * expected, rel=0.03)
    # Beams of amplitude 1 and 1.5 interfere with 2 * 1.5 / (1 + 1.5^2).
    assert table["fringe_visibility"].iloc[0] == pytest.approx(3 / 3.25, rel=0.01)


def test_visibility_of_each_view_and_of_none() -> None:
    y, x = np.indices((128, 128))
    frame = 100.0 + sum(
        amplitude * np.cos(2 * np.pi * (ky * y + kx * x))
        for amplitude, (ky, kx) in ((30, (0.25, 0.125)), (12, (-0.25, 0.1875)))
    )
    lobes = [Lobe((0.25, 0.125), 0.05), Lobe((-0.25, 0.1875), 0.05)]
    demodulate = Demodulator((128, 128), lobes)
    found = fringe_visibility(frame, demodulate)
    assert found == pytest.approx([0.3, 0.12], rel=1e-4)
    assert fringe_visibility(0 * frame, demodulate) == [0, 0]
    # Without a true zero the mean is no light.
    for dark in (frame.mean(), 0.97 * frame.mean(), 2 * frame.mean()):
        assert np.isnan(fringe_visibility(frame - dark, demodulate)).all()


@pytest.mark.parametrize("kept", [0.0, 0.02, -0.5])
def test_visibility_is_unknown_where_light_was_taken_off(kept: float, tmp_path: Path) -> None:
    """What reads it copes: warnings, figures and files."""
    exact = p4d.simulation.swimming_euglena((96, 96), 2, pixel_um=0.5)
    rec = p4d.simulation.multiplexed_video(exact["phase"])
    lobes = p4d.find_lobes(rec, n_views=2)
    grey = rec.holograms.values.astype(np.float32)
    known = p4d.reconstruct(rec, lobes)
    ds = p4d.reconstruct(p4d.open_recording(grey - (1 - kept) * grey.mean()), lobes)
    assert np.isnan(ds.attrs["fringe_visibility"]).all()
    assert fringe_advice(ds.attrs) == ""
    assert noise_figures(ds)["fringe_visibility"].isna().all()
    assert np.abs(wrap(ds["phase"].values - known["phase"].values)).max() < 0.01
    for ending in (".ome.tif", ".ome.zarr"):
        write_phase(tmp_path / f"phase{ending}", ds["phase"])
        again = read_results(tmp_path / f"phase{ending}")
        assert np.isnan(again.attrs["fringe_visibility"]).all()


def test_visibility_stays_with_its_view() -> None:
    """Also where views were left out or are in another order since."""
    lobes = [{"angle_deg": float(a)} for a in (0, 30, 60)]
    values = wrapped_noise(0.02, (2, 3, 64, 64))
    ds = stack(values).assign_coords(angle=[0.0, 30.0, 60.0])
    ds.attrs |= {"lobes": lobes, "fringe_visibility": [0.1, 0.2, 0.3]}
    for chosen in ([0, 1, 2], [2, 1, 0], [1, 2]):
        found = noise_figures(ds.isel(angle=chosen))["fringe_visibility"]
        assert list(found) == [[0.1, 0.2, 0.3][i] for i in chosen]


def test_variance_in_space_is_that_of_a_full_fit() -> None:
    rng = np.random.default_rng(4)
    empty = rng.uniform(size=(90, 120)) < 0.4
    y, x = np.indices(empty.shape)
    image = rng.normal(size=empty.shape) * 0.02 + 0.01 * y - 0.02 * x + 3
    terms = np.stack([np.ones(empty.sum()), y[empty], x[empty]], axis=1)
    _, left, *_ = np.linalg.lstsq(terms, image[empty], rcond=None)
    assert variance_in_space(image, empty) == pytest.approx(left[0] / empty.sum(), rel=1e-9)


def test_where_there_is_nothing_to_measure_it_says_so() -> None:
    rng = np.random.default_rng(0)
    nothing = rng.uniform(-np.pi, np.pi, (3, 1, 64, 64))
    table = noise_figures(stack(nothing))
    assert np.isnan(table["temporal_phase_mrad"].iloc[0])
    assert "no empty field" in noise_sentence(table)
    one = noise_figures(stack(wrapped_noise(0.02, (1, 1, 64, 64)), np.ones((1, 1, 64, 64))))
    assert np.isnan(one["temporal_phase_mrad"].iloc[0])
    assert noise_sentence(one).startswith("Noise: 2")
    assert "in time" not in noise_sentence(one)
    with pytest.raises(ValueError, match="noise is measured on phase"):
        noise_figures(xr.Dataset())
    with pytest.raises(p4d.Cancelled):
        noise_figures(stack(nothing), cancelled=lambda: True)


def test_sentence_names_time_space_and_amplitude() -> None:
    shape = (8, 1, 96, 96)
    table = noise_figures(stack(wrapped_noise(0.012, shape), 1 + wrapped_noise(0.015, shape, 3)))
    row = table.iloc[0]
    assert noise_sentence(table) == (
        f"Noise: {row['temporal_phase_mrad']:.3g} mrad ({row['temporal_path_nm']:.2g} nm) in "
        f"time, {row['spatial_phase_mrad']:.3g} mrad ({row['spatial_path_nm']:.2g} nm) in space; "
        f"amplitude {row['temporal_amplitude_percent']:.2g} %."
    )


@pytest.mark.slow
@pytest.mark.parametrize("method", ["directional-l1", "directional-growing"])
def test_phase_that_is_nothing_but_noise_is_said(method: str) -> None:
    rng = np.random.default_rng(0)
    noise = rng.uniform(-np.pi, np.pi, (3, 2, 40, 40)).astype(np.float32)
    with pytest.warns(UserWarning, match="nothing but noise"):
        p4d.unwrap(noise, method)
    y, x = np.mgrid[:40, :40]
    cell = 6 * np.exp(-((y - 20) ** 2 + (x - 20) ** 2) / 100)
    noisy = np.angle(np.exp(1j * (cell + rng.normal(0, 0.9, noise.shape)))).astype(np.float32)
    p4d.unwrap(noisy, method)  # a warning is an error here


def test_noise_is_that_of_each_view_whatever_the_order_of_the_axes() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(0, 1, (3, 2, 48, 48)) * np.array([0.02, 0.3])[:, None, None]
    phase = xr.DataArray(
        values, dims=("time", "angle", "y", "x"), coords={"angle": [-7.0, 21.0]}
    ).assign_coords(time=np.arange(3.0))
    expected = noise_figures(xr.Dataset({"phase": phase}))
    turned = noise_figures(xr.Dataset({"phase": phase.transpose("angle", "time", "x", "y")}))
    np.testing.assert_allclose(
        turned["temporal_phase_mrad"], expected["temporal_phase_mrad"], rtol=0.05
    )
    assert expected["temporal_phase_mrad"][1] < 100 < expected["temporal_phase_mrad"][2]
