"""Refocusing against nrefocus and against what must hold; autofocus against known distances."""

from __future__ import annotations

import io
import warnings
import zipfile

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from helpers import measured, wrap
from napari_phase4d.holography import (
    FOCUS_METRICS,
    Demodulator,
    Lobe,
    Preview,
    autofocus,
    depth_of_focus_um,
    propagate,
    refocused,
)
from napari_phase4d.holography.refocusing import EDGES

LIGHT = {"wavelength_um": 0.6328, "pixel_um": 0.3, "medium_index": 1.333}


def smooth_field(shape: tuple[int, int], seed: int = 0, detail: float = 0.25) -> np.ndarray:
    """A random field without frequencies above ``detail`` cycles per pixel."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    ky, kx = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :]
    low = np.fft.ifft2(np.fft.fft2(noise) * (np.hypot(ky, kx) < detail))
    return (1 + low / np.abs(low).std()).astype(np.complex64)


def nrefocus_field(field: np.ndarray, distance_um: float, light: dict) -> np.ndarray:
    """Refocus with the other program, which counts in pixels."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it tells which of its optional parts are missing
        import nrefocus
    pixel = light["pixel_um"]
    return nrefocus.refocus(
        field, distance_um / pixel, light["medium_index"], light["wavelength_um"] / pixel,
        padding=False,
    )  # fmt: skip


def mirrored(field: np.ndarray) -> np.ndarray:
    return np.pad(field, [(0, n) for n in field.shape], mode="symmetric")


def relative(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.abs(found - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("distance", [-40.0, -3.0, 0.7, 12.0, 150.0])
@pytest.mark.parametrize("shape", [(64, 64), (65, 90)])
def test_random_fields_agree_with_nrefocus(distance: float, shape: tuple[int, int]) -> None:
    field = smooth_field(shape)
    expected = nrefocus_field(field, distance, LIGHT)
    assert relative(propagate(field, distance, **LIGHT, edges="periodic"), expected) < 1e-6
    expected = nrefocus_field(mirrored(field), distance, LIGHT)[: shape[0], : shape[1]]
    assert relative(propagate(field, distance, **LIGHT), expected) < 1e-6


@pytest.mark.measured
@pytest.mark.parametrize("distance", [-20.0, -2.5, 5.0, 60.0])
def test_measured_cell_agrees_with_nrefocus(distance: float) -> None:
    with zipfile.ZipFile(measured("unwrap/HL60_field.zip")) as archive:
        real, imag = (
            np.loadtxt(io.BytesIO(archive.read(f"HL60_{part}.txt"))) for part in ("real", "imag")
        )
    light = LIGHT | {"pixel_um": 0.107}
    field = real + 1j * imag
    expected = nrefocus_field(field, distance, light)
    assert relative(propagate(field, distance, **light, edges="periodic"), expected) < 1e-6
    expected = nrefocus_field(mirrored(field), distance, light)[:112, :112]
    assert relative(propagate(field, distance, **light), expected) < 1e-6


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("distance", [3.0, -80.0])
def test_there_and_back_energy_and_sums(edges: str, distance: float) -> None:
    """Without evanescent waves nothing is lost: 0.4 um pixels hold 1.77 of 2.11 cycles/um."""
    light = LIGHT | {"pixel_um": 0.4}
    one, two = smooth_field((80, 96), 1, detail=0.7), smooth_field((80, 96), 2, detail=0.7)

    def carried(field: np.ndarray, d: float = distance) -> np.ndarray:
        return propagate(field, d, **light, edges=edges)

    there = carried(one)
    assert there.dtype == np.complex64
    assert relative(there, one) > 0.1
    assert relative(carried(there, -distance), one) < 3e-6
    assert np.sum(np.abs(there) ** 2) == pytest.approx(np.sum(np.abs(one) ** 2), rel=1e-5)
    assert relative(carried(2 * one - 3j * two), 2 * there - 3j * carried(two)) < 3e-6
    assert relative(carried(carried(one, 1.25), distance), carried(one, distance + 1.25)) < 3e-6


def test_evanescent_waves_are_cut_off_and_plane_waves_stay() -> None:
    light = LIGHT | {"pixel_um": 0.1}  # up to 5 cycles/um, of which 2.1 travel
    y, x = np.indices((64, 64))
    evanescent = np.exp(2j * np.pi * (20 * x / 64))  # 3.1 cycles/um
    assert np.abs(propagate(evanescent, 1.0, **light, edges="periodic")).max() < 1e-5
    flat = np.full((64, 64), 0.5 + 0.5j)
    for edges in EDGES:
        assert relative(propagate(flat, 30.0, **light, edges=edges), flat) < 1e-5
    # A slanting wave gains d (sqrt(K^2 - k^2) - K).
    slanting, k, whole = np.exp(2j * np.pi * 5 * y / 64), 2 * np.pi * 5 / 6.4, 2 * np.pi * 1.333
    gained = 30 * (np.sqrt((whole / 0.6328) ** 2 - k**2) - whole / 0.6328)
    found = propagate(slanting, 30.0, **light, edges="periodic")
    assert relative(found, slanting * np.exp(1j * gained)) < 1e-5


def test_pixels_need_not_be_square() -> None:
    field = smooth_field((64, 64), detail=0.1)
    twice = LIGHT | {"pixel_um": (0.6, 0.3)}
    expected = propagate(field, 9.0, **LIGHT, edges="periodic")[::2]
    found = propagate(field[::2], 9.0, **twice, edges="periodic")
    assert relative(found, expected) < 1e-6


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"wavelength_um": 0.0}, "wavelength_um must be a number above 0"),
        ({"pixel_um": -1.0}, "pixel_um must be a size above 0"),
        ({"medium_index": 0.5}, "medium_index must be at least 1"),
        ({"distance_um": np.nan}, "distance_um must be a number"),
        ({"edges": "open"}, "edges must be one of mirrored, periodic"),
        ({"field": np.ones(5)}, "a field has at least the axes"),
    ],
)
def test_bad_numbers_give_one_sentence(change: dict, sentence: str) -> None:
    settings = {"field": np.ones((8, 8)), "distance_um": 1.0, **LIGHT} | change
    with pytest.raises(ValueError, match=sentence):
        propagate(settings.pop("field"), **settings)


def field_of(ds: xr.Dataset) -> np.ndarray:
    return (ds["amplitude"] * np.exp(1j * ds["phase"])).values


@pytest.mark.slow
def test_reconstruction_is_refocused_after_its_corrections(small_video) -> None:
    """Reference and tilt are taken off in the camera's plane, the offset in the new one."""
    lobes = p4d.find_lobes(small_video, 2)
    settings = {"reference": 0, "background": "tilt", "drift": False}
    plain = p4d.reconstruct(small_video, lobes, **settings)
    found = p4d.reconstruct(small_video, lobes, **settings, refocus_um=7.5)
    pixel = [float(plain[d][1] - plain[d][0]) for d in ("y", "x")]
    expected = propagate(field_of(plain), 7.5, 0.6328, pixel, 1.333)
    assert relative(field_of(found), expected) < 1e-5
    assert found.attrs["refocus_um"] == 7.5
    assert "refocus_um" not in plain.attrs
    after = refocused(plain, 7.5)
    assert relative(field_of(after), expected) < 1e-5
    # In a denser medium no wave of these pixels is evanescent, and all come back.
    back = refocused(refocused(plain, 7.5, medium_index=1.6), -7.5, medium_index=1.6)
    assert relative(field_of(back), field_of(plain)) < 1e-5
    assert back.attrs["refocus_um"] == back["phase"].attrs["refocus_um"] == 0
    levelled = p4d.reconstruct(small_video, lobes, 0, refocus_um=7.5)
    rest = wrap(levelled["phase"].values - found["phase"].values)
    assert np.abs(wrap(rest - rest[..., :1, :1])).max() < 1e-4  # one constant a frame and view


def test_preview_is_refocused_like_the_reconstruction(small_video) -> None:
    lobes = p4d.find_lobes(small_video, 2)
    whole = p4d.reconstruct(small_video, lobes, background="none", drift=False, refocus_um=-5.0)
    phases = Preview(small_video.raw_frame(0)).phases(
        lobes, refocus_um=-5.0, optics=small_video.optics
    )
    for view, phase in enumerate(phases):
        field = field_of(whole)[0, view]
        expected = np.angle(field * np.exp(-1j * np.angle(field.mean())))
        bright = np.abs(field) > 0.05 * np.abs(field).max()
        assert np.abs(wrap(phase - expected))[bright].max() < 1e-4


# Autofocus


def cell(kind: str, shape: tuple[int, int] = (128, 128)) -> np.ndarray:
    """A field in focus: a cell with a nucleus that delays the light, or absorbs it."""
    y, x = np.indices(shape)
    thick = sum(
        height * np.clip(1 - ((y - cy) / ry) ** 2 - ((x - cx) / rx) ** 2, 0, None) ** 0.5
        for cy, cx, ry, rx, height in ((60, 66, 30, 22, 3.0), (52, 60, 8, 8, 1.2))
    )
    field = np.exp(1j * thick) if kind == "phase" else np.exp(-0.3 * thick)
    ky, kx = (np.fft.fftfreq(n) for n in shape)
    pupil = np.hypot(ky[:, None], kx[None, :]) < 0.4
    return np.fft.ifft2(np.fft.fft2(field) * pupil)


@pytest.mark.thorough
@pytest.mark.parametrize("metric", FOCUS_METRICS)
@pytest.mark.parametrize("kind", ["phase", "amplitude"])
@pytest.mark.parametrize("away", [0.0, 14.3, -22.0])
def test_autofocus_finds_a_known_distance(metric: str, kind: str, away: float) -> None:
    """Defocused by the other program, with noise of 3 % and without: within a depth of focus."""
    depth = depth_of_focus_um(**LIGHT)
    assert depth == pytest.approx(1.333 * 0.6328 / (0.6328 / 0.6) ** 2)
    field = nrefocus_field(cell(kind), away, LIGHT) if away else cell(kind)
    rng = np.random.default_rng(1)
    noise = rng.normal(size=field.shape) + 1j * rng.normal(size=field.shape)
    for noisy in (field, field + 0.03 * noise / np.sqrt(2)):
        for objects in ("auto", kind):
            focus = autofocus(noisy, **LIGHT, metric=metric, objects=objects)
            assert focus.objects == kind
            assert not focus.at_the_end
            assert abs(focus.distance_um + away) < depth
    assert focus.scores.dims == ("distance",)
    assert focus.scores["distance"].attrs["units"] == "um"


@pytest.mark.slow
def test_several_fields_give_one_distance_and_a_region_may_be_chosen() -> None:
    near, far = (nrefocus_field(cell("phase"), d, LIGHT) for d in (5.0, 9.0))
    both = autofocus(np.stack([near, far]), **LIGHT, span_um=25.0)
    assert 5 - 0.8 < -both.distance_um < 9 + 0.8
    side_by_side = np.concatenate([near, nrefocus_field(cell("phase"), 15.0, LIGHT)], axis=1)
    for part, distance in ((slice(0, 128), 5.0), (slice(128, 256), 15.0)):
        focus = autofocus(side_by_side, **LIGHT, region=(slice(None), part), span_um=(-30, 10))
        assert abs(focus.distance_um + distance) < 0.8


def test_autofocus_says_when_the_focus_is_beyond_and_what_is_wrong() -> None:
    field = nrefocus_field(cell("phase"), 15.0, LIGHT)
    assert autofocus(field, **LIGHT, span_um=5.0, objects="phase").at_the_end
    for change, sentence in (
        ({"metric": "sharpness"}, "metric must be one of dubois, tamura, gradient"),
        ({"objects": "cell"}, "objects must be one of auto, phase, amplitude"),
        ({"span_um": (3, -3)}, "span_um must be a distance above 0"),
        ({"region": (slice(0, 0), slice(None))}, "region holds no pixel"),
    ):
        with pytest.raises(ValueError, match=sentence):
            autofocus(field, **LIGHT, **change)


@pytest.mark.slow
def test_a_recording_that_is_in_focus_stays_there(reconstruction, sample, lobes) -> None:
    found = p4d.reconstruct(sample.recording, lobes, refocus_um="auto")
    pixel = [float(found[d][1] - found[d][0]) for d in ("y", "x")]
    assert found.attrs["focus_objects"] == "phase"
    assert abs(found.attrs["refocus_um"]) < depth_of_focus_um(0.6328, pixel, 1.333)
    with pytest.raises(ValueError, match="refocus_um must be a number of micrometres or"):
        p4d.reconstruct(sample.recording, lobes, refocus_um="there")


@pytest.mark.slow
@pytest.mark.measured
@pytest.mark.parametrize("metric", ["dubois", "tamura"])
def test_measured_paramecium_is_found_where_it_was_published(metric: str) -> None:
    """PyHoloscope's example says 1 um pixels, 630 nm, air, and 1.2 mm (later 1.17 mm).

    As there, the phase of the background hologram is taken off, not its amplitude. The lobe is
    as wide as the object needs (0.06 cycles/px), so that less of the speckle comes along. The
    third measure, the gradient, is misled here: the speckle that both holograms share is flat in
    the camera's plane.
    """
    with np.load(measured("offaxis/paramecium_oa_oof.npz")) as file:
        hologram, empty = file["data"], file["bg_data"]
    (found,) = p4d.find_lobes(p4d.open_recording(hologram), 1)
    demodulate = Demodulator(hologram.shape, [Lobe(found.carrier, 0.06)])
    field = demodulate(hologram)[0] * np.exp(-1j * np.angle(demodulate(empty)[0]))
    light = {"wavelength_um": 0.63, "pixel_um": demodulate.pixel_ratio, "medium_index": 1.0}
    focus = autofocus(field, **light, objects="phase", metric=metric, span_um=2000.0)
    assert abs(focus.distance_um + 1200) < depth_of_focus_um(**light)  # 296 um


@pytest.mark.slow
def test_a_run_notes_the_distance_that_it_found(small_video, tmp_path) -> None:
    """Done again with what was noted, on disk instead of in memory, it gives the same phase."""
    recipe = p4d.Recipe(refocus_um="auto", background="zernike", methods=("spatial-2d",))
    first = p4d.run(recipe, small_video)
    distance = first.recipe.refocus_um
    assert isinstance(distance, float)
    assert first.reconstruction.attrs["refocus_um"] == distance
    noted = p4d.Recipe.from_file(first.recipe.to_file(tmp_path / "recipe.json"))
    again = p4d.run(noted.changed(storage="disk"), small_video, folder=tmp_path)
    for name in ("phase", "amplitude"):
        np.testing.assert_array_equal(again.reconstruction[name], first.reconstruction[name])
    assert p4d.run(noted.changed(refocus_um=None), small_video).recipe.refocus_um is None
