"""What is taken off the empty field, against exact truth: right, or refused in words."""

from __future__ import annotations

import re
import sys
import warnings

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from helpers import ROOT, wrap
from napari_phase4d.holography import Lobe, reconstruction_advice
from napari_phase4d.holography.background import Surface
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.emptyfield import FrameTilt
from napari_phase4d.simulation import multiplexed_video

sys.path.append(str(ROOT / "benchmarks"))
from levelling import OTHER_SHAPES, SHAPES, Shape, bent, seen, truth

SIDE = 256
CARRIER = (0.21, 0.19)
LOBE = Lobe(CARRIER, 0.089)


def from_middle(place: tuple[float, float], shape: tuple[int, int] = (SIDE, SIDE)) -> np.ndarray:
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    return np.hypot(y - place[0], x - place[1])


def ellipsoid(cover: float, place: tuple[float, float], peak_rad: float) -> np.ndarray:
    """A thick body that covers a share of the field."""
    away = from_middle(place)
    return peak_rad * np.sqrt(np.maximum(1 - (away / np.quantile(away, cover)) ** 2, 0))


def stack(maps: list[np.ndarray]) -> xr.DataArray:
    coords = {"time": np.arange(len(maps), dtype=float), "angle": [0.0]}
    phase = np.asarray(maps, dtype=np.float32)[:, None]
    return xr.DataArray(phase, dims=("time", "angle", "y", "x"), coords=coords)


def recorded(maps: list[np.ndarray], **camera: float) -> p4d.Recording:
    return multiplexed_video(stack(maps), carriers=[CARRIER], **camera)


def curvature_on(shape: tuple[int, ...], rad: float) -> np.ndarray:
    """The exact curvature on the coarser grid of the fields."""
    # Each pixel of a field stands in the middle of those of the camera that it covers.
    y, x = (-1 + 2 * ((np.arange(n) + 0.5) * SIDE / n - 0.5) / (SIDE - 1) for n in shape)
    return rad * (y[:, None] ** 2 + x[None, :] ** 2) / 2


def off_by(video: p4d.Recording, rad: float) -> tuple[float, str]:
    """Return by how much the fitted curvature is off over the whole view, and what is doubted."""
    field = Demodulator(video.frame_shape, [LOBE])(video.raw_frame(0))[0]
    fit = Surface("powers", 2, field.shape).fit(field)
    return float(np.std(fit.surface - curvature_on(field.shape, rad))), fit.doubt


@pytest.mark.thorough
@pytest.mark.parametrize("rad", [4.0, 12.0])
@pytest.mark.parametrize("peak", [3.0, 6.0, 12.0])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.3, 0.4)])
def test_curvature_round_an_object_is_right_or_doubted(
    place: tuple[float, float], peak: float, rad: float
) -> None:
    """The object covers 10 to 75 % of the view; up to 25 % there is no doubt."""
    for cover in (0.1, 0.25, 0.5, 0.65, 0.75):
        off, doubt = off_by(recorded([ellipsoid(cover, place, peak)], curvature_rad=rad), rad)
        assert doubt or off < 0.4, cover
        if cover <= 0.25:
            assert not doubt
            assert off < 0.1


def test_curvature_is_found_where_the_object_covers_more_than_the_empty_field() -> None:
    """Up to 65 %, where the middle of the cell used to be fitted: 1.1 and 3.1 rad off."""
    for cover, peak, rad in ((0.65, 6.0, 4.0), (0.65, 12.0, 12.0), (0.5, 12.0, 4.0)):
        off, doubt = off_by(recorded([ellipsoid(cover, (0, 0), peak)], curvature_rad=rad), rad)
        assert not doubt
        assert off < 0.1


def test_doubtful_curvature_is_refused_in_words_but_tilt_is_not() -> None:
    video = recorded([ellipsoid(0.85, (0, 0), 6.0)], curvature_rad=4.0)
    with pytest.raises(
        ValueError, match=r"view 1 of .*; use a reference .* or background=\"tilt\""
    ):
        p4d.reconstruct(video, [LOBE], background="curvature")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        p4d.reconstruct(video, [LOBE])


@pytest.mark.slow
@pytest.mark.parametrize("kind", [0.5, 1.0])
def test_what_may_be_the_object_is_never_taken_off_in_silence(kind: float) -> None:
    """An ellipsoid or a bowl in a corner that covers 85 % of the view bends like a field."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, SIDE),) * 2, indexing="ij")
    away = np.hypot(y - 0.9, x - 0.9)
    r2 = (away / np.quantile(away, 0.85)) ** 2
    wrong = 0
    for peak in (3.0, 6.0, 12.0):
        exact = peak * np.maximum(1 - r2, 0) ** kind
        video = recorded([exact], curvature_rad=4.0)
        off, doubt = off_by(video, 4.0)
        if doubt:
            continue  # refused
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            data = p4d.reconstruct(video, [LOBE], background="curvature")
        wrong += off > 0.5
        assert off < 0.5 or said
        told = "".join(str(each.message) for each in said)
        assert ("may be the object's" in told) == ("curvature_unsure" in data.attrs)
    assert wrong  # it is not a test of what is right


@pytest.mark.thorough
@pytest.mark.parametrize("shapes", [SHAPES, OTHER_SHAPES], ids=["fitted", "others"])
def test_curvature_of_random_objects_is_right_or_told(shapes: dict[str, Shape]) -> None:
    """Half of them near the middle, the others anywhere.

    Words about small ones are needless: 2 of 20 and 4 of 19 get them, a quarter may.
    """
    small, needless, silent = 0, 0, 0
    for case in (bent(seed, shapes) for seed in range(50000, 50070)):
        refused, off, doubted = case.outcome()
        if case.cover <= 0.85:
            silent += off and not (refused or doubted)
        if case.cover <= 0.25 and not (refused or off):
            small += 1
            needless += doubted
    assert silent == 0
    assert needless <= 0.25 * small


@pytest.mark.slow
@pytest.mark.parametrize("rad", [0.0, 6.0])
def test_empty_field_and_small_objects_are_no_cause_for_words(rad: float) -> None:
    for cover, place in ((0.1, (0.0, 0.0)), (0.25, (0.0, 0.0)), (0.1, (0.3, 0.4))):
        for peak in (0.0, 2.0, 8.0):
            video = recorded([ellipsoid(cover, place, peak)], curvature_rad=rad)
            data = p4d.reconstruct(video, [LOBE], background="curvature")  # warnings are errors
            assert "curvature_unsure" not in data.attrs


def noisy(phase: np.ndarray, noise: float) -> np.ndarray:
    """Return the field of a phase with so much noise in each of its parts."""
    rng = np.random.default_rng(0)
    added = rng.normal(0, noise, phase.shape) + 1j * rng.normal(0, noise, phase.shape)
    return (np.exp(1j * phase) + added).astype(np.complex64)


@pytest.mark.parametrize("noise", [0.02, 0.05, 0.08])
def test_what_bends_against_the_field_is_told_where_it_is_noisy(noise: float) -> None:
    """Their sum is nearly plane, and 1.2 rad rms of curvature would stay in silence."""
    field = curvature_on((SIDE, SIDE), 4.0)
    away = from_middle((0.3, 0.4))
    paraboloid = 3 * np.maximum(1 - (away / np.quantile(away, 0.85)) ** 2, 0)
    fit = Surface("powers", 2, field.shape).fit(noisy(paraboloid + field, noise))
    assert np.std(fit.surface - field) > 1
    assert fit.doubt or fit.unsure


@pytest.mark.parametrize(("cover", "peak"), [(0.65, 3.0), (0.75, 3.0), (0.65, 6.0)])
def test_noise_does_not_silence_what_is_said_of_a_hill_in_a_corner(
    cover: float, peak: float
) -> None:
    """Of its bend 0.8 to 1.8 rad rms were taken off in silence."""
    field = seen("hill", cover, "corner", peak, 4.0)
    noise = np.random.default_rng(1).normal(0, 0.25, field.shape)
    fit = Surface("powers", 2, field.shape).fit(field * np.exp(1j * noise).astype(np.complex64))
    assert fit.doubt or fit.unsure


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.03, 0.05, 0.08, 0.2])
@pytest.mark.parametrize("rad", [0.0, 4.0, 8.0])
def test_a_field_that_is_wholly_empty_is_not_doubted(rad: float, noise: float) -> None:
    """Without a pixel that is not explained it was, more than one with a small object on it."""
    field = curvature_on((SIDE, SIDE), rad)
    fit = Surface("powers", 2, field.shape).fit(noisy(field, noise))
    assert np.std(fit.surface - field) < 0.05
    assert not fit.doubt
    assert not fit.unsure


@pytest.mark.parametrize("cover", [0.5, 0.75])
def test_a_hill_that_bends_like_a_field_is_told(cover: float) -> None:
    """It was taken off in silence, 0.8 rad rms of it; so its foot is not fitted either."""
    field = seen("hill", cover, "corner", 3.0, 4.0)
    fit = Surface("powers", 2, field.shape).fit(field)
    assert fit.doubt or fit.unsure or np.std(fit.surface - truth(field.shape, 4.0)) < 0.3


def test_the_soft_foot_of_an_object_does_not_bend_the_surface() -> None:
    """It was 0.26 rad off, and is 0.11."""
    field = seen("hill", 0.5, "off", 3.0, 12.0)
    surface = Surface("powers", 2, field.shape).fit(field).surface
    assert np.std(surface - truth(field.shape, 12.0)) < 0.15


@pytest.mark.thorough
def test_curvature_that_is_left_is_measured_and_told() -> None:
    """12 rad at the corner; a tilt leaves 2.6 rad rms of them, less the middle behind the cell."""
    video = recorded([ellipsoid(0.1, (0.2, 0.1), 5.0)], curvature_rad=12.0)
    with pytest.warns(UserWarning, match=r"curvature is left in view 1 \(2\.\d rad rms\)"):
        data = p4d.reconstruct(video, [LOBE])
    truth = curvature_on(data["phase"].shape[2:], 12.0).std()
    assert data.attrs["background_left_rad"] == [pytest.approx(truth, rel=0.1)]
    data = p4d.reconstruct(video, [LOBE], background="curvature")  # warnings are errors here
    assert data.attrs["background_left_rad"][0] < 0.15
    assert reconstruction_advice(data.attrs) == []
    with pytest.warns(UserWarning, match="little empty field is in view"):
        data = p4d.reconstruct(video, [LOBE], background="none")
    assert "background_left_rad" not in data.attrs


def test_higher_orders_that_are_left_are_told() -> None:
    y, x = np.meshgrid(*(np.linspace(-1, 1, SIDE),) * 2, indexing="ij")
    coma = 5 * (y**2 + x**2) * x
    video = recorded([coma + ellipsoid(0.1, (0.2, 0.1), 5.0)])
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        p4d.reconstruct(video, [LOBE], background="curvature")
    (words,) = [str(each.message) for each in said]  # one sentence, first what to try first
    told = re.search("aberrations are left .* try background='polynomial', .* reference", words)
    assert told
    assert "may be the object's" in words  # what bends otherwise than the surface may be a cell


def test_each_view_is_advised_once() -> None:
    """Where a higher order helps, its sentence holds the doubt."""
    attrs = {
        "background": "curvature",
        "background_left_rad": [0.1, 0.5, 0.6],
        "curvature_unsure": [0, 1],
    }
    first, second = reconstruction_advice(attrs)
    assert "left in view 2 (0.5 rad rms) and view 3 (0.6 rad rms)" in first
    assert "taken off view 2 may be the object's" in first
    assert "taken off view 1 may be the object's" in second
    assert "compare with background='tilt'" in second
    attrs["curvature_unsure"] = []
    (only,) = reconstruction_advice(attrs)
    assert only.endswith("try background='polynomial'")


@pytest.mark.parametrize("cover", [0.1, 0.25])
def test_a_flat_field_is_no_cause_for_advice(cover: float) -> None:
    video = recorded([ellipsoid(cover, (0.3, -0.2), 6.0)])
    for background in ("tilt", "curvature"):
        left = p4d.reconstruct(video, [LOBE], background=background).attrs["background_left_rad"]
        assert max(left) < 0.3


def tilted(n_times: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """A cell that swims, and the same with a tilt of each frame, sd 2 rad from edge to edge."""
    rng = np.random.default_rng(4)
    y, x = np.meshgrid(*(np.linspace(-1, 1, SIDE),) * 2, indexing="ij")
    cells = [ellipsoid(0.2, (-0.3 + 0.6 * t / n_times, 0.1), 6.0) for t in range(n_times)]
    tilts = rng.normal(0, 1, (n_times, 2))
    return cells, [
        cell + a * y + b * x for cell, (a, b) in zip(cells, tilts - tilts.mean(0), strict=True)
    ]


@pytest.mark.slow
def test_tilt_of_single_frames_is_taken_off_on_request() -> None:
    """About 0.8 rad rms are left without, below 0.05 with."""
    cells, moved = tilted(8)
    exact = p4d.reconstruct(recorded(cells, bits=12), [LOBE], background="none")["phase"].values
    left = {}
    for tilt_per_frame in (False, True):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            data = p4d.reconstruct(recorded(moved), [LOBE], tilt_per_frame=tilt_per_frame)
        assert len(said) == (not tilt_per_frame)
        assert data.attrs["tilt_per_frame"] is tilt_per_frame
        error = wrap(data["phase"].values - exact)[..., 3:-3, 3:-3]
        error -= np.median(error, axis=(2, 3), keepdims=True)
        left[tilt_per_frame] = float(np.sqrt(np.mean(wrap(error) ** 2)))
    assert left[False] > 0.5
    assert left[True] < 0.05


def tilting(phase: np.ndarray, n_times: int, sd: float, seed: int) -> list[np.ndarray]:
    """The same in each frame but for its tilt."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in phase.shape), indexing="ij")
    tilts = np.random.default_rng(seed).normal(0, sd, (n_times, 2))
    return [phase + a * y + b * x for a, b in tilts]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("background", ["curvature", "polynomial"])
def test_surfaces_are_fitted_to_frames_that_are_levelled(background: str, seed: int) -> None:
    """A cell over 17 % of frames that tilt, sd 3 rad; warnings are errors here."""
    cell = ellipsoid(0.17, (0.1, 0.0), 5.0)
    exact = p4d.reconstruct(recorded([cell], bits=12), [LOBE], background="none")["phase"].values
    video = recorded(tilting(cell, 12, 3.0, seed), curvature_rad=4.0)
    data = p4d.reconstruct(video, [LOBE], background=background, tilt_per_frame=True)
    error = wrap(data["phase"].values - exact)[..., 3:-3, 3:-3]
    error = wrap(error - np.median(error, axis=(2, 3), keepdims=True))
    assert np.sqrt(np.mean(error**2, axis=(1, 2, 3))).max() < 0.15


@pytest.mark.slow
@pytest.mark.parametrize(("sd", "seed"), [(1.0, 3), (3.0, 3), (3.0, 4)])
def test_tilt_that_differs_from_frame_to_frame_is_told(sd: float, seed: int) -> None:
    frames = tilting(ellipsoid(0.17, (0.1, 0.0), 5.0), 12, sd, seed)
    tilts = [frame - np.mean(frames, axis=0) for frame in frames]
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        data = p4d.reconstruct(recorded(frames), [LOBE])
    assert any("tick Tilt (tilt_per_frame=True)" in str(each.message) for each in said)
    truth = np.median([tilt.std() for tilt in tilts])
    assert data.attrs["frame_tilt_left_rad"] == [pytest.approx(truth, rel=0.3)]
    data = p4d.reconstruct(recorded(frames), [LOBE], tilt_per_frame=True)  # errors here
    assert "frame_tilt_left_rad" not in data.attrs


@pytest.mark.slow
@pytest.mark.parametrize("peak", [3.0, 8.0])
@pytest.mark.parametrize("cover", [0.1, 0.3, 0.5])
def test_objects_that_move_are_no_tilts(cover: float, peak: float) -> None:
    places = np.random.default_rng(5).uniform(-0.6, 0.6, (8, 2))
    cells = [ellipsoid(cover, (y, x), peak) for y, x in places]
    data = p4d.reconstruct(recorded(cells, drift_rad=1.0), [LOBE])  # warnings are errors here
    assert max(data.attrs["frame_tilt_left_rad"]) < 0.1


def test_frame_without_empty_field_keeps_the_common_tilt() -> None:
    rng = np.random.default_rng(0)
    fields = np.exp(1j * rng.uniform(-np.pi, np.pi, (1, 60, 70))).astype(np.complex64)
    before = fields.copy()
    FrameTilt((60, 70)).take_off(fields)
    np.testing.assert_array_equal(fields, before)


def test_tilt_of_a_frame_is_exact_round_an_object() -> None:
    shape = (96, 120)
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    away = from_middle((0.1, -0.2), shape)
    for cover in (0.1, 0.5, 0.65):
        cell = 6 * np.sqrt(np.maximum(1 - (away / np.quantile(away, cover)) ** 2, 0))
        field = np.exp(1j * (cell + 1.3 * y - 0.8 * x + 2)).astype(np.complex64)
        assert FrameTilt(shape).of(field) == pytest.approx((1.3, -0.8), abs=0.05)


@pytest.mark.slow
def test_median_reference_takes_off_a_static_texture() -> None:
    """1 rad rms of it, where the cell is away in most frames; the surface is fitted after it."""
    rng = np.random.default_rng(1)
    waves = rng.normal(0, 4, (12, 2))
    y, x = np.meshgrid(*(np.linspace(-1, 1, SIDE),) * 2, indexing="ij")
    texture = sum(np.sin(np.pi * (a * y + b * x) + i) for i, (a, b) in enumerate(waves))
    texture /= texture.std()
    n_times = 9
    cells = [ellipsoid(0.05, (-0.5 + t / (n_times - 1), 0.2), 5.0) for t in range(n_times)]
    exact = p4d.reconstruct(recorded(cells, bits=12), [LOBE], background="none")["phase"].values
    video = recorded([cell + texture for cell in cells], drift_rad=0.5)
    with pytest.warns(UserWarning, match="something that stays in 29 % of view 1: if that is the"):
        data = p4d.reconstruct(video, [LOBE], "median")
    error = wrap(data["phase"].values - exact)[..., 3:-3, 3:-3]
    error = wrap(error - np.median(error, axis=(2, 3), keepdims=True))
    assert np.sqrt(np.mean(error**2)) < 0.1
    size = error.shape[2:]
    slope_y, slope_x = (np.linspace(-1, 1, n) for n in size)
    mean = error.mean(axis=(0, 1))
    for slope in (slope_y[:, None], slope_x[None, :]):
        assert abs((mean * slope).mean() / (slope**2).mean()) < 0.05


@pytest.mark.parametrize("stays", [True, False])
def test_a_median_that_shows_what_stays_is_said(stays: bool) -> None:
    """A cell that stays is divided away; one that swims off is not in the median."""
    y, x = np.mgrid[:128, :128] + 0.5
    frames = []
    for t in range(7):
        far = ((y - 40) ** 2 + (x - 20 - (0 if stays else 15 * t)) ** 2) / 18**2
        phase = 6 * np.exp(-2 * far)
        frames.append(100 + 60 * np.cos(2 * np.pi * (0.2 * y + 0.15 * x) + phase))
    rec = p4d.open_recording(np.round(frames).astype(np.uint8))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        data = p4d.reconstruct(rec, [p4d.Lobe((0.2, 0.15), 0.1)], reference="median")
    said = any("median over time shows something that stays" in str(w.message) for w in told)
    assert said == stays
    (percent,) = data.attrs["median_shows_percent"]
    assert percent > 5 if stays else percent < 0.5
    peak = float(p4d.unwrap(data.phase, "spatial-2d").max())
    assert peak < 1 if stays else peak > 5
