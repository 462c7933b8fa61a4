"""Measured holograms against other programs and against themselves."""

from __future__ import annotations

import warnings

import imageio.v3 as iio
import numpy as np
import pytest
import scipy

import napari_phase4d as p4d
from helpers import measured, wrap
from napari_phase4d.holography import Lobe

pytestmark = pytest.mark.measured


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def same_lobes(lobes: list[Lobe], radius: float | None) -> list[Lobe]:
    return [Lobe(lo.carrier, radius or lo.radius, lo.angle_deg, lo.flip) for lo in lobes]


def at_full_size(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Interpolate a band-limited field onto the camera's pixels, exactly."""
    spectrum = np.fft.fftshift(np.fft.fft2(field))
    whole = np.zeros(shape, dtype=complex)
    for axis, (n, m) in enumerate(zip(shape, field.shape, strict=True)):
        # A pixel of the field stands in the middle of n / m of the camera's.
        back = np.exp(-2j * np.pi * (np.arange(m) - m // 2) * (n / m - 1) / 2 / n)
        spectrum = spectrum * np.expand_dims(back, 1 - axis)
    corner = [n // 2 - m // 2 for n, m in zip(shape, field.shape, strict=True)]
    whole[corner[0] : corner[0] + field.shape[0], corner[1] : corner[1] + field.shape[1]] = (
        spectrum
    )
    return np.fft.ifft2(np.fft.ifftshift(whole)) * np.prod(shape) / np.prod(field.shape)


@pytest.mark.slow
def test_cell_agrees_with_qpretrieve() -> None:
    """HL60 cell and background: the same sideband, disk and radius as qpretrieve's.

    qpretrieve takes the conjugate sideband, so its sign is fixed by asking for the other one.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it tells which of its optional parts are missing
        import qpretrieve

    with np.load(measured("offaxis/hologram_cell.npz")) as file:
        data, background = file["data"], file["bg_data"]
    rec = p4d.open_recording(data)
    (found,) = p4d.find_lobes(rec, 1)
    lobe = Lobe(found.carrier, np.hypot(*found.carrier) / 3)
    ours = p4d.reconstruct(rec, [lobe], background, window="disk", background="none", drift=False)
    ours = ours["phase"].values[0, 0]

    options = {"filter_name": "disk", "filter_size": 1 / 3}
    theirs = qpretrieve.OffAxisHologram(data)
    theirs.run_pipeline(sideband_freq=found.carrier, **options)
    empty = qpretrieve.OffAxisHologram(background)
    empty.run_pipeline(**theirs.pipeline_kws)
    ratio = np.squeeze(theirs.field / empty.field)
    # Their pixels are the camera's; ours stand in the middle of those that they cover.
    places = np.meshgrid(
        *((np.arange(m) + 0.5) * n / m - 0.5 for n, m in zip(data.shape, ours.shape, strict=True)),
        indexing="ij",
    )
    parts = (
        scipy.ndimage.map_coordinates(part, places, order=5) for part in (ratio.real, ratio.imag)
    )
    their_phase = np.angle(next(parts) + 1j * next(parts))
    error = wrap(ours - their_phase)[5:-5, 5:-5]
    error = wrap(error - np.angle(np.exp(1j * error).mean()))
    assert rms(error) <= 0.02


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* left in view")  # as it should be, with a tilt
@pytest.mark.parametrize(("background", "coherence"), [("tilt", 0.931), ("curvature", 0.972)])
def test_vortex_agrees_with_its_published_phase(background: str, coherence: float) -> None:
    """40x hologram: circular coherence with the phase that its authors published.

    They took off a curvature as well, so that agrees better than the tilt alone.
    """
    hologram = p4d.open_recording(measured("offaxis/holobio_40x_Vortex.bmp"))
    published = iio.imread(measured("offaxis/holobio_40x_Vortex_published_phase.tif"))
    expected = published.astype(float) / 255 * 2 * np.pi - np.pi
    data = p4d.reconstruct(hologram, p4d.find_lobes(hologram, 1), background=background)
    field = data["amplitude"].values[0, 0] * np.exp(1j * data["phase"].values[0, 0])
    phase = np.angle(at_full_size(field, hologram.frame_shape))[:, 160:1120]
    assert np.abs(np.exp(1j * (phase - expected)).mean()) >= coherence


@pytest.mark.parametrize(
    ("name", "radius", "limits"),
    [
        ("mux2_cells.npz", 0.10, (0.042, 0.020)),
        ("mux2_cells.npz", None, (0.040, 0.020)),
        ("mux2_timelapse_t00-29.npz", 0.045, (0.047, 0.037)),
        ("mux2_timelapse_t00-29.npz", None, (0.036, 0.036)),
    ],
)
def test_crosstalk_between_multiplexed_views(
    name: str, radius: float | None, limits: tuple[float, float]
) -> None:
    """The phase of a view from the multiplex against that from its own channel alone.

    As the data's README has it: rms inside amplitude > 25 % of its median, away from the border.
    """
    with np.load(measured(f"multiplexed/{name}")) as file:
        mux, channels = file["mux"], (file["chA"], file["chB"])
    rec = p4d.open_recording(mux)
    lobes = same_lobes(p4d.find_lobes(rec, 2), radius)
    settings = {"background": "none", "drift": False}
    together = p4d.reconstruct(rec, lobes, **settings)
    inside = (slice(8, -8), slice(8, -8))
    for view, (channel, limit) in enumerate(zip(channels, limits, strict=True)):
        alone = p4d.reconstruct(p4d.open_recording(channel), [lobes[view]], **settings)
        errors = []
        for t in range(rec.n_frames):
            ours, own = (
                at_full_size(
                    d["amplitude"].values[t, v] * np.exp(1j * d["phase"].values[t, v]),
                    rec.frame_shape,
                )[inside]
                for d, v in ((together, view), (alone, 0))
            )
            bright = np.abs(own) > 0.25 * np.median(np.abs(own))
            errors.append(np.angle(ours * own.conj())[bright])
        assert rms(np.concatenate(errors)) <= limit


def test_sum_rule_of_a_multi_carrier_hologram() -> None:
    """Quadri-wave shearing of a bead: phase(f1 + f2) = phase(f1) + phase(f2)."""
    import h5py

    with h5py.File(measured("multiplexed/qlsi_paa_bead.h5")) as file:
        bead, reference = file["0"][()], file["reference"][()]
    rec = p4d.open_recording(bead)
    first, second = (lobe.carrier for lobe in p4d.find_lobes(rec, 2, orient=False))
    lobes = [Lobe(first, 0.04, 0), Lobe(second, 0.04, 1), Lobe(np.add(first, second), 0.04, 2)]
    # One of such a triple may be a beat of the others, which is told; here it is a view.
    with pytest.warns(UserWarning, match="one of lobes 1, 2 and 3 lies where the other two"):
        data = p4d.reconstruct(rec, lobes, reference, background="none", drift=False)
    one, two, both = data["phase"].values[0]
    rest = wrap(one + two - both)
    rest = wrap(rest - np.angle(np.exp(1j * rest).mean()))
    assert rms(rest) <= 0.005


@pytest.mark.slow
def test_red_blood_cells_are_found_and_nothing_else() -> None:
    """Six cells on an uneven background, of which two touch; the halo round them is no cell."""
    rec = p4d.open_recording(measured("offaxis/pydhm_RBC.jpg"))
    lobes = p4d.find_lobes(rec, n_views=1)
    phase = p4d.reconstruct(rec, lobes, background="zernike")["phase"]
    unwrapped = p4d.unwrap(phase, "spatial-2d")
    cells = p4d.find_cells(unwrapped)
    middles = [(80, 102), (36, 41), (121, 33), (196, 58), (80, 191), (80, 218)]  # seen by eye
    numbers = [int(cells[0, 0, y, x]) for y, x in middles]
    assert len(set(numbers)) == 6
    assert 0 not in numbers
    assert set(np.unique(cells)) == {0, *numbers}
    # The line between the two lies in the gap that is seen.
    sizes = np.bincount(cells.values.ravel())[numbers[-2:]]
    assert 0.8 < sizes[0] / sizes[1] < 1.25
    assert int(cells[0, 0, 80, 200]) == numbers[-2]
    assert int(cells[0, 0, 80, 211]) == numbers[-1]
    # Volumes of 83 +- 14 fl have been published (Rappaz et al., Cytometry A 73, 895, 2008); these
    # differ as much. The scale of these cells is not known.
    masses = p4d.measure(unwrapped, cells, p4d.Optics())["dry mass (pg)"]
    assert 0.08 < masses.std() / masses.mean() < 0.25


@pytest.mark.slow
@pytest.mark.parametrize("blocked", [0, 1])
def test_a_blocked_beam_in_a_measured_multiplex(blocked: int) -> None:
    """The view of the other channel goes on as it was, and the one that is gone is left out."""
    with np.load(measured("multiplexed/mux2_timelapse_t00-29.npz")) as file:
        mux, other = file["mux"].copy(), file["chA" if blocked else "chB"]
    whole = p4d.open_recording(mux.copy())
    lobes = p4d.find_lobes(whole, 2)
    mux[10:20] = other[10:20]
    rec = p4d.open_recording(mux)
    for found, lobe in zip(p4d.find_lobes(rec, 2), lobes, strict=True):
        np.testing.assert_allclose(found.carrier, lobe.carrier, atol=0.002)
    with pytest.warns(UserWarning, match=f"10 frames of 30 left out in view {blocked + 1}"):
        phase = p4d.reconstruct(rec, lobes)["phase"].values
    gone = np.isnan(phase).all(axis=(2, 3))
    assert np.argwhere(gone).tolist() == [[time, blocked] for time in range(10, 20)]
    off = np.angle(np.exp(1j * (phase - p4d.reconstruct(whole, lobes)["phase"].values)))
    assert np.median(np.abs(off[~gone])) < 0.002
    assert rms(off[~gone]) < 0.05
