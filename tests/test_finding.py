"""The finder: simulated carriers of all kinds, and every measured file."""

from __future__ import annotations

import warnings

import imageio.v3 as iio
import numpy as np
import pytest
import tifffile

import napari_phase4d as p4d
from helpers import measured
from napari_phase4d.holography.lobes import pair_distance
from napari_phase4d.recording import Recording
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

TWO = ((0.19, 0.21), (-0.21, 0.19))


def video(carriers: tuple, n_times: int = 8, **options: object) -> Recording:
    angles = tuple(np.linspace(-10, 10, len(carriers)))
    exact = swimming_euglena((256, 256), n_times, angles_deg=angles, pixel_um=5.2 / 30)
    return multiplexed_video(exact["phase"], carriers=carriers, **options)


def assert_found(rec: Recording, carriers: tuple, within: float = 0.002) -> None:
    lobes = p4d.find_lobes(rec, len(carriers))
    for carrier in carriers:
        assert min(pair_distance(lobe.carrier, carrier) for lobe in lobes) < within


@pytest.mark.thorough
@pytest.mark.parametrize("drift", [0.0, 0.3])
@pytest.mark.parametrize("reference", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("beams", [(1, 1), (1, 0.6), (0.6, 1)])
def test_views_are_told_from_their_beat(drift: float, reference: float, beams: tuple) -> None:
    """Also where the reference is the weakest beam, so that the beat is the strongest peak."""
    rec = video(TWO, drift_rad=drift, reference_amplitude=reference, beam_amplitudes=beams)
    assert_found(rec, TWO)


def test_one_frame_is_enough_to_tell_the_beat() -> None:
    assert_found(video(TWO, n_times=1, reference_amplitude=0.7), TWO)


@pytest.mark.slow
@pytest.mark.parametrize("carriers", [((0.25, 0.0),), ((0.0, 0.25),), ((0.25, 0), (0, 0.3))])
def test_carriers_may_lie_on_an_axis(carriers: tuple) -> None:
    assert_found(video(carriers), carriers)


@pytest.mark.slow
@pytest.mark.parametrize("n", [3, 4, 5, 6])
def test_up_to_six_views(n: int) -> None:
    six = ((0.42, 0.05), (0.30, 0.20), (0.12, 0.33), (-0.05, 0.42), (-0.2, 0.3), (-0.35, 0.15))
    rec = video(six[:n], pupil_radius=0.03, reference_amplitude=3.0)
    assert_found(rec, six[:n])


def test_object_comes_out_denser_than_the_background_whichever_lobe_it_is() -> None:
    """A carrier with kx < 0 is found as its conjugate, and flipped."""
    rec = video(((0.2, -0.2),))
    (lobe,) = p4d.find_lobes(rec, 1)
    assert lobe.carrier[1] > 0
    assert lobe.flip
    phase = p4d.reconstruct(rec, [lobe])["phase"]
    unwrapped = p4d.unwrap(phase, "spatial-2d")
    assert float(unwrapped.max()) > 4
    (plain,) = p4d.find_lobes(rec, 1, orient=False)
    assert not plain.flip


@pytest.mark.slow
def test_views_are_ordered_and_numbered() -> None:
    rec = video(TWO)
    lobes = p4d.find_lobes(rec, 2)
    assert [lobe.angle_deg for lobe in lobes] == [0, 1]
    turned = [np.arctan2(-lobe.carrier[0], lobe.carrier[1]) for lobe in lobes]
    assert turned == sorted(turned)
    assert [lobe.angle_deg for lobe in p4d.find_lobes(rec, 2, angles_deg=(-7, 21))] == [-7, 21]
    assert len({lobe.radius for lobe in lobes}) == 1
    assert p4d.find_lobes(rec, 2, radius=0.05)[0].radius == 0.05


def test_interlace_ghost_is_no_view() -> None:
    """Odd rows a little brighter than even ones copy each lobe by half the sampling frequency."""
    frames = video(((0.18, 0.05),)).holograms.values.astype(float)
    frames[:, ::2] *= 0.8
    rec = p4d.open_recording(frames)
    assert_found(rec, ((0.18, 0.05),))
    with pytest.raises(ValueError, match=r"shows 1 carrier, but 2 views were asked for"):
        p4d.find_lobes(rec, 2)


@pytest.mark.parametrize(
    ("n_views", "words"),
    [
        (None, "shows 0 carriers; place the lobes by hand"),
        (1, "shows 0 carriers, but 1 view was asked for; place the lobes by hand"),
        (2, "shows 0 carriers, but 2 views were asked for; place the lobes by hand"),
    ],
)
def test_noise_shows_no_views_whatever_was_asked_for(n_views: int | None, words: str) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (4, 128, 128)).astype(np.uint8)
    with pytest.raises(ValueError, match=f"{words}$"):
        p4d.find_lobes(p4d.open_recording(noise), n_views)


@pytest.mark.slow
def test_harmonic_is_no_view() -> None:
    """A camera that saturates adds harmonics."""
    frames = video(((0.12, 0.05),)).holograms.values.astype(float)
    rec = p4d.open_recording(np.minimum(frames, np.quantile(frames, 0.8)))
    assert_found(rec, ((0.12, 0.05),))
    with pytest.raises(ValueError, match="2 views were asked for"):
        p4d.find_lobes(rec, 2)


@pytest.mark.parametrize("amplitude", [0.25, 0.5])
@pytest.mark.parametrize("kind", ["copy", "harmonic"])
def test_a_view_beside_where_a_ghost_would_lie_is_counted(kind: str, amplitude: float) -> None:
    """A ghost lies there exactly, this weak view two pixels of the spectrum off."""
    first = np.array((40.0, 50.0))
    due = first - (128, 0) if kind == "copy" else 2 * first
    carriers = [tuple(k / 256) for k in (first, due + np.array((2, 0)))]
    exact = swimming_euglena((256, 256), 3, pixel_um=5.2 / 30, peak_rad=6)["phase"]
    rec = multiplexed_video(
        exact,
        carriers=carriers,
        pupil_radius=0.05,
        beam_amplitudes=(1, amplitude),
        reference_amplitude=2.5,
    )
    lobes = p4d.find_lobes(rec)
    assert len(lobes) == 2
    for carrier in carriers:
        assert min(pair_distance(carrier, k.carrier) for k in lobes) < 0.004


@pytest.mark.parametrize(
    ("frames", "n", "sentence"),
    [
        (np.full((3, 64, 64), 5.0), 1, r"no frame .* shows fringes: frame 0 is blank"),
        (np.random.default_rng(0).normal(size=(40, 64, 64)), 1, r"shows 0 carriers"),
        (np.zeros((1, 64, 64)), 0, "n_views must lie between 1 and 6"),
        (np.zeros((1, 64, 64)), 7, "n_views must lie between 1 and 6"),
    ],
)
def test_no_carrier_is_said_so(frames: np.ndarray, n: int, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        p4d.find_lobes(p4d.open_recording(frames), n)


def test_angles_must_match_the_views(small_video) -> None:
    with pytest.raises(ValueError, match="angles_deg has 3 angles for 2 views"):
        p4d.find_lobes(small_video, 2, angles_deg=(1, 2, 3))


def npz(name: str, key: str):
    return lambda: np.load(measured(name))[key]


def image(name: str):
    return lambda: p4d.open_recording(measured(name)).holograms.values


def hdf5(name: str, *keys: str):
    def load() -> np.ndarray:
        import h5py

        with h5py.File(measured(name)) as file:
            node = file
            for key in keys:
                node = node[key if key != "*" else next(iter(node))]
            return node[()]

    return load


CELL, MUX = "offaxis/hologram_cell.npz", "multiplexed/mux2_timelapse_t00-29.npz"
QLSI = ((-0.2139, 0.1319), (0.1319, 0.2139))
QLSI_ALL = (*QLSI, (-0.082, 0.3458), (0.3458, 0.082))
ELECTRONS = "offaxis/{}_Vbp_130V_0V_bin2_crop.hdf5"
#: What is measured, where it comes from, and its carriers as published with the data.
FILES = {
    "cell": (npz(CELL, "data"), ((0.2004, 0.1160),)),
    "cell background": (npz(CELL, "bg_data"), ((0.2014, 0.1220),)),
    "single": (image("offaxis/single_holo.tif"), ((0.197, 0.116),)),
    "red blood cells, JPEG ghosts": (image("offaxis/pydhm_RBC.jpg"), ((0.171, 0.160),)),
    "test target": (image("offaxis/holobio_20x_SHPC.bmp"), ((0.2437, 0.25),)),
    "vortex": (image("offaxis/holobio_40x_Vortex.bmp"), ((-0.2094, 0.2250),)),
    "gas, on axis, interlaced": (image("offaxis/gasjet_Interferogram_gas.png"), ((0.1823, 0.0),)),
    "gas reference": (image("offaxis/gasjet_Interferogram_reference.png"), ((0.1823, 0.0),)),
    "paramecium": (npz("offaxis/paramecium_oa_oof.npz", "data"), ((-0.256, 0.333),)),
    "paramecium background": (npz("offaxis/paramecium_oa_oof.npz", "bg_data"), ((-0.256, 0.333),)),
    "electrons": (
        hdf5(ELECTRONS.format("01_holo"), "Experiments", "*", "data"), ((-0.2441, 0.1152),),
    ),
    # The published carrier is that of the hologram above; this one's own lies 0.005 beside it.
    "electrons reference": (
        hdf5(ELECTRONS.format("00_ref"), "Experiments", "*", "data"), ((-0.2389, 0.1141),),
    ),
    "bead, two": (hdf5("multiplexed/qlsi_paa_bead.h5", "0"), QLSI),
    "bead, all four": (hdf5("multiplexed/qlsi_paa_bead.h5", "0"), QLSI_ALL),
    "fringe projection": (
        lambda: tifffile.imread(measured("multiplexed/profilometry_t00-29.tif"))[:, 0],
        ((0.0176, 0.0742),),
    ),
    "two channels, time lapse": (npz(MUX, "mux"), ((0.0176, 0.0742), (-0.0742, 0.0176))),
    "two cells": (
        npz("multiplexed/mux2_cells.npz", "mux"), ((0.200, 0.116), (-0.116, 0.197)),
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.measured
@pytest.mark.parametrize("name", FILES)
def test_carriers_of_measured_holograms(name: str) -> None:
    load, carriers = FILES[name]
    assert_found(p4d.open_recording(load()), carriers, within=0.004)


@pytest.mark.slow
@pytest.mark.measured
def test_cells_come_out_denser_than_water() -> None:
    """Both conjugates are in a hologram; cells must not come out as holes."""
    for name in ("offaxis/single_holo.tif", "offaxis/pydhm_RBC.jpg"):
        rec = p4d.open_recording(measured(name))
        phase = p4d.reconstruct(rec, p4d.find_lobes(rec, 1), background="curvature")["phase"]
        unwrapped = p4d.unwrap(phase, "spatial-2d").values[0, 0, 5:-5, 5:-5]
        deviation = unwrapped - np.median(unwrapped)
        assert np.quantile(deviation, 0.99) > 3 * -np.quantile(deviation, 0.01)


def test_imageio_is_what_reads_images(tmp_path) -> None:
    frames = video(((0.2, 0.2),), n_times=1).holograms.values
    iio.imwrite(tmp_path / "one.png", frames[0])
    assert_found(p4d.open_recording(tmp_path / "one.png"), ((0.2, 0.2),))


@pytest.mark.parametrize(
    ("carrier", "pupil"), [((0.38, 0.25), 0.089), ((0.42, 0.2), 0.05), ((0.36, 0.36), 0.089)]
)
def test_a_lobe_near_the_edge_ends_there_if_its_pupil_does(
    carrier: tuple[float, float], pupil: float
) -> None:
    exact = swimming_euglena((192, 192), 2, pixel_um=0.25, peak_rad=4)["phase"][:, :1]
    rec = multiplexed_video(exact, carriers=[carrier], pupil_radius=pupil)
    (lobe,) = p4d.find_lobes(rec, 1)
    assert pupil <= lobe.radius <= 0.5 - max(map(abs, lobe.carrier)) + 1e-6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.reconstruct(rec, [lobe])


def test_a_pupil_that_reaches_over_the_edge_is_not_cut_there() -> None:
    exact = swimming_euglena((192, 192), 2, pixel_um=0.25, peak_rad=4)["phase"][:, :1]
    (lobe,) = p4d.find_lobes(multiplexed_video(exact, carriers=[(0.45, 0.2)]), 1)
    assert lobe.radius >= 0.089 > 0.5 - max(lobe.carrier)
