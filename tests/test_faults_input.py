"""Recordings and settings that are odd, or that nothing can be made of."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from faulty import LONGEST
from helpers import wrap
from napari_phase4d.io import write_phase

SIDE = 64
LOBE = p4d.Lobe((0.2, 0.22), 0.09)


def fringes(shape: tuple[int, int, int] = (3, SIDE, SIDE)) -> np.ndarray:
    """Return fringes of two carriers with a small object, as an ideal camera would see them."""
    time, y, x = np.indices(shape).astype(float)
    off = ((y - shape[1] / 2) / 12) ** 2 + ((x - shape[2] / 2) / 12) ** 2
    object_ = 2 * np.exp(-off) + 0 * time
    light = 100.0
    for ky, kx in ((0.2, 0.22), (-0.21, 0.2)):
        light = light + 30 * np.cos(2 * np.pi * (ky * y + kx * x) + object_)
    return light


def one_sentence(error: BaseException) -> str:
    said = str(error)
    assert "\n" not in said
    assert 10 < len(said) < LONGEST
    return said


#: Kind of numbers -> the fringes as such numbers, the same up to a factor and rounding.
KINDS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "uint8": lambda f: f.round().astype("u1"),
    "uint16, big-endian": lambda f: (256 * f).round().astype(">u2"),
    "int16": lambda f: (100 * (f - f.mean())).round().astype("<i2"),
    "int8": lambda f: (f - f.mean()).round().astype("i1"),
    "int32, big-endian": lambda f: (10**6 * f).round().astype(">i4"),
    "uint64": lambda f: (10**9 * f).round().astype("u8"),
    "float16": lambda f: f.astype("f2"),
    "float64, big-endian": lambda f: f.astype(">f8"),
    "long double": lambda f: f.astype(np.longdouble),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", ["array", "npy", "tif"])
def test_any_real_numbers_give_the_same_phase(tmp_path: Path, kind: str, way: str) -> None:
    exact = p4d.reconstruct(p4d.open_recording(fringes()), [LOBE])["phase"]
    frames: Any = KINDS[kind](fringes())
    if way == "npy":
        np.save(tmp_path / "video.npy", frames)
        frames = tmp_path / "video.npy"
    elif way == "tif":
        if kind == "long double":
            pytest.skip("TIFF has no such numbers")
        tifffile.imwrite(tmp_path / "video.tif", frames, photometric="minisblack")
        frames = tmp_path / "video.tif"
    recording = p4d.open_recording(frames)
    assert recording.frame(0).dtype == np.float32
    found = p4d.reconstruct(recording, [LOBE])["phase"]
    # Numbers of 8 bits are rounded to a hundredth of the fringes' contrast.
    assert np.abs(wrap(found.values - exact.values)).max() < 0.05
    assert len(p4d.find_lobes(recording, 2)) == 2


@pytest.mark.parametrize("kind", ["bool", "1-bit TIFF"])
def test_black_and_white_is_poor_but_works(tmp_path: Path, kind: str) -> None:
    """One bit a pixel keeps the fringes' place, and so most of the phase."""
    exact = p4d.reconstruct(p4d.open_recording(fringes()), [LOBE])["phase"]
    frames: Any = fringes() > 100
    if kind == "1-bit TIFF":
        tifffile.imwrite(tmp_path / "video.tif", frames, photometric="minisblack")
        with tifffile.TiffFile(tmp_path / "video.tif") as tif:
            assert tif.pages.first.bitspersample == 1
        frames = tmp_path / "video.tif"
    with pytest.warns(UserWarning, match="if it is a hologram of one bit, its phase is poor"):
        recording = p4d.open_recording(frames)
    found = p4d.reconstruct(recording, [LOBE])["phase"]
    assert np.sqrt((wrap(found.values - exact.values) ** 2).mean()) < 0.15


def saturated(frames: np.ndarray) -> np.ndarray:
    return np.clip(frames, 60, 120)


@pytest.mark.parametrize("shape", [(1, 64, 64), (3, 63, 65), (2, 33, 97), (2, 8, 8), (1, 9, 40)])
def test_any_size_of_frame(shape: tuple[int, int, int]) -> None:
    recording = p4d.open_recording(fringes(shape)[0] if shape[0] == 1 else fringes(shape))
    found = p4d.reconstruct(recording, [LOBE])
    assert found["phase"].sizes["time"] == shape[0]
    assert np.isfinite(found["phase"]).all()
    unwrapped = p4d.unwrap(found["phase"])
    assert np.isfinite(unwrapped).all()


def test_saturated_frames_still_have_their_fringes() -> None:
    exact = p4d.find_lobes(p4d.open_recording(fringes()), 2)
    found = p4d.find_lobes(p4d.open_recording(saturated(fringes())), 2)
    for lobe, expected in zip(found, exact, strict=True):
        np.testing.assert_allclose(lobe.carrier, expected.carrier, atol=0.002)


NO_RECORDING: dict[str, tuple[Any, str]] = {
    "complex": (np.ones((2, 16, 16), complex), "holds complex128 values"),
    "objects": (np.full((2, 16, 16), None), "holds object values"),
    "words": (np.full((2, 16, 16), "a"), "holds <U1 values"),
    "dates": (np.zeros((2, 16, 16), "M8[s]"), "values; a hologram video needs real numbers"),
    "records": (np.zeros((2, 16, 16), [("a", "u1")]), "values; a hologram video needs real"),
    "colour": (np.zeros((2, 16, 16, 3), "u1"), "pick one channel"),
    "five axes": (np.zeros((1, 1, 2, 16, 16), "u1"), "dimensions"),
    "one axis": (np.zeros(16), "has 1 dimensions"),
    "a number": (3.5, "has 0 dimensions"),
    "nothing": (None, "holds object values"),
    "no frames": (np.zeros((0, 16, 16)), "is empty"),
    "one pixel": (np.zeros((4, 1, 1)), "at least 8 x 8"),
    "one row": (np.zeros((4, 1, 99)), "at least 8 x 8"),
    "rows of different length": ([[1, 2], [3]], "differ in length"),
    "other axes": (xr.DataArray(np.zeros((3, 16, 16)), dims=("q", "y", "x")), "has dims"),
}


@pytest.mark.parametrize("case", NO_RECORDING)
def test_what_is_no_recording_is_said(case: str) -> None:
    given, sentence = NO_RECORDING[case]
    with pytest.raises((ValueError, TypeError, OSError), match=sentence) as caught:
        p4d.open_recording(given)
    one_sentence(caught.value)


BAD = [np.nan, np.inf, -np.inf, 1e30, -1e300]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*1 frame of 3 left out as lost")
@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("where", [(1, 5, 6), (1,)], ids=["one pixel", "one frame"])
def test_frames_with_holes_are_left_out(bad: float, where: tuple[int, ...]) -> None:
    """Of the others every number stays as it is without that frame."""
    frames = fringes()
    exact = p4d.reconstruct(p4d.open_recording(frames), [LOBE], background="none")
    frames[where] = bad
    recording = p4d.open_recording(frames)
    assert len(p4d.find_lobes(recording, 2)) == 2
    assert p4d.power_spectrum(recording).attrs["lost_frames"] == [1]
    found = p4d.reconstruct(recording, [LOBE], background="none")
    assert found.attrs["lost_times"] == [1]
    for name in ("phase", "amplitude"):
        assert np.isnan(found[name].values[1]).all()
        np.testing.assert_array_equal(found[name].values[2:], exact[name].values[2:])
    ran = p4d.run(p4d.Recipe(lobes=(LOBE,), methods=("spatial-2d", "temporal")), recording)
    for result in ran.comparison.results.values():
        lost = np.isnan(result.values).all(axis=(1, 2, 3))
        assert lost.tolist() == [i == 1 for i in range(len(frames))]
        assert np.isfinite(result.values[~lost]).all()


@pytest.mark.parametrize("bad", BAD)
def test_recordings_of_nothing_but_holes_are_refused(bad: float) -> None:
    recording = p4d.open_recording(np.full_like(fringes(), bad))
    for work in NEED_FRINGES:
        with pytest.raises(ValueError, match="no frame of .* shows fringes: frame 0 is NaN") as e:
            work(recording)
        one_sentence(e.value)


NEED_FRINGES: tuple[Callable[[p4d.Recording], Any], ...] = (
    lambda r: p4d.find_lobes(r, 2),
    lambda r: p4d.power_spectrum(r),
    lambda r: p4d.reconstruct(r, [LOBE]),
    lambda r: p4d.run(p4d.Recipe(lobes=(LOBE,), methods=("spatial-2d",)), r),
)


@pytest.mark.parametrize(
    ("frames", "why"),
    [
        (np.zeros((2, 32, 32)), "blank"),
        (np.full((2, 32, 32), 255, "u1"), "saturated"),
        (np.full((2, 32, 32), 4095, "u2"), "saturated"),
        (np.full((2, 32, 32), -1e9), "blank"),
    ],
    ids=["black", "white", "white, 12 bits", "far below zero"],
)
def test_recordings_without_fringes_are_refused(frames: np.ndarray, why: str) -> None:
    for work in NEED_FRINGES:
        with pytest.raises(
            ValueError, match=f"no frame of .* shows fringes: frame 0 is {why}"
        ) as e:
            work(p4d.open_recording(frames))
        one_sentence(e.value)


WRONG: dict[str, tuple[Callable[[p4d.Recording], Any], str]] = {
    "no views": (lambda r: p4d.find_lobes(r, 0), "n_views"),
    "fewer than no views": (lambda r: p4d.find_lobes(r, -1), "n_views"),
    "more views than fit": (lambda r: p4d.find_lobes(r, 6), "view|peak|carrier"),
    "many views": (lambda r: p4d.find_lobes(r, 10**9), "n_views"),
    "half a view": (lambda r: p4d.find_lobes(r, 1.5), "n_views"),
    "too many angles": (lambda r: p4d.find_lobes(r, 2, angles_deg=[1, 2, 3]), "angle"),
    "negative radius": (lambda r: p4d.find_lobes(r, 2, radius=-0.1), "radius"),
    "no radius": (lambda _: p4d.Lobe((0.1, 0.1), 0), "radius"),
    "radius is no number": (lambda _: p4d.Lobe((0.1, 0.1), float("nan")), "radius"),
    "outside the spectrum": (lambda _: p4d.Lobe((0.6, 0.1), 0.1), "outside the spectrum"),
    "far outside": (lambda _: p4d.Lobe((1e300, float("inf")), 0.1), "outside the spectrum"),
    "no lobes": (lambda r: p4d.reconstruct(r, []), "lobe"),
    "no lobe": (lambda r: p4d.reconstruct(r, [(0.1, 0.1)]), "list of Lobe"),
    "window": (lambda r: p4d.reconstruct(r, [LOBE], window="round"), "window must be one of"),
    "background": (lambda r: p4d.reconstruct(r, [LOBE], background="x"), "background must be"),
    "reference": (lambda r: p4d.reconstruct(r, [LOBE], 99), "reference frame 99 does not exist"),
    "small reference": (
        lambda r: p4d.reconstruct(r, [LOBE], np.ones((16, 16))), r"reference is \(16, 16\)"
    ),
    "dark reference": (
        lambda r: p4d.reconstruct(r, [LOBE], np.zeros(r.frame_shape)), "shows no fringes"
    ),
    "frame rate": (lambda _: p4d.open_recording(fringes(), frame_rate_hz=0), "frame_rate_hz"),
    "frame rate is tiny": (
        lambda _: p4d.open_recording(fringes(), frame_rate_hz=1e-320), "frame_rate_hz"
    ),
    "pixel is huge": (lambda _: p4d.Optics(camera_pixel_um=1e300, magnification=1e-300), "pixel"),
    "pixel is nothing": (lambda _: p4d.Optics(camera_pixel_um=1e-30), "pixel in the sample"),
    "frame rate is no number": (
        lambda _: p4d.open_recording(fringes(), frame_rate_hz=float("nan")), "frame_rate_hz"
    ),
    "wavelength": (lambda _: p4d.Optics(wavelength_um=-1), "wavelength_um"),
    "magnification": (lambda _: p4d.Optics(magnification=float("inf")), "magnification"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_settings_of_holograms_are_named(case: str) -> None:
    work, sentence = WRONG[case]
    with pytest.raises((ValueError, TypeError), match=sentence) as caught:
        work(p4d.open_recording(fringes()))
    one_sentence(caught.value)


PHASE = wrap(np.random.default_rng(0).normal(size=(3, 2, 12, 12))).astype(np.float32)
ONE_FRAME = np.broadcast_to(np.arange(3)[:, None, None, None] == 1, PHASE.shape)
WRONG_PHASE: dict[str, tuple[Callable[[], Any], str]] = {
    "time out of range": (lambda: p4d.unwrap(PHASE, boundary=(3, 0)), "does not exist"),
    "angle out of range": (lambda: p4d.unwrap(PHASE, boundary=(0, -3)), "does not exist"),
    "huge": (lambda: p4d.unwrap(PHASE, boundary=(10**30, 0)), "boundary"),
    "half a frame": (lambda: p4d.unwrap(PHASE, boundary=(0.5, 0)), "boundary must be"),
    "no boundary": (lambda: p4d.unwrap(PHASE, boundary=()), "boundary must be"),
    "three numbers": (lambda: p4d.unwrap(PHASE, boundary=(0, 0, 0)), "boundary must be"),
    "method": (lambda: p4d.unwrap(PHASE, "magic"), "method must be one of"),
    "option": (lambda: p4d.unwrap(PHASE, split=3), "takes a bool"),
    "option unknown": (lambda: p4d.unwrap(PHASE, fast=True), "has no option"),
    "mask of another size": (lambda: p4d.unwrap(PHASE, mask=np.ones((5, 5))), "does not fit"),
    "empty mask": (lambda: p4d.unwrap(PHASE, mask=np.zeros(PHASE.shape)), "mask is empty"),
    "mask on what is not known": (
        lambda: p4d.unwrap(np.where(ONE_FRAME, np.nan, PHASE), mask=ONE_FRAME),
        "NaN wherever the mask counts",
    ),
    "mask with other axes": (
        lambda: p4d.unwrap(PHASE, mask=xr.DataArray(np.ones(12), dims=["q"])), "mask has dims"
    ),
    "amplitude": (lambda: p4d.unwrap(PHASE, amplitude=np.ones((2, 2))), "amplitude is"),
    "complex": (lambda: p4d.unwrap(PHASE.astype(complex)), "phase is complex"),
    "objects": (lambda: p4d.unwrap(PHASE.astype(object)), "must be real numbers"),
    "five axes": (lambda: p4d.unwrap(PHASE[None]), "dimensions"),
    "one axis": (lambda: p4d.unwrap(PHASE[0, 0, 0]), "dimensions"),
    "empty": (lambda: p4d.unwrap(PHASE[:0]), "is empty"),
    "other axes": (lambda: p4d.unwrap(xr.DataArray(PHASE, dims=list("tzyx"))), "phase has dims"),
    "NaN": (lambda: p4d.unwrap(np.where(PHASE > 2, np.nan, PHASE)), "NaN or infinite"),
    "infinite": (lambda: p4d.unwrap(np.where(PHASE > 2, np.inf, PHASE)), "NaN or infinite"),
    "too large": (lambda: p4d.unwrap(PHASE * np.float32(1e20)), "NaN|large|beyond"),
    "much too large": (lambda: p4d.unwrap(np.full(PHASE.shape, 1e300)), "NaN|large|beyond"),
    "truth": (lambda: p4d.compare(PHASE, ["spatial-2d"], truth=PHASE[0]), "truth is"),
    "no such compared": (lambda: p4d.compare(PHASE, ["x"]), "method must be one of"),
    "scored": (lambda: p4d.score_boundaries(PHASE, PHASE[:2]), "reference is"),
    "written": (lambda: write_phase("x.ome.tif", xr.DataArray(PHASE[0])), "DataArray with dims"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_PHASE)
def test_wrong_settings_of_phase_are_named(case: str) -> None:
    work, sentence = WRONG_PHASE[case]
    with pytest.raises((ValueError, TypeError), match=sentence) as caught:
        work()
    one_sentence(caught.value)


WRONG_FACTS = {
    "pixel is no number": ("PhysicalSizeX", "nan"),
    "pixel below zero": ("PhysicalSizeX", "-3"),
    "pixel in words": ("PhysicalSizeX", "wide"),
    "interval is infinite": ("TimeIncrement", "inf"),
    "interval is tiny": ("TimeIncrement", "1e-320"),
    "pixel is huge": ("PhysicalSizeX", "1e308"),
    "axes are wrong": ("DimensionOrder", "QQQQQ"),
    "sizes are wrong": ("SizeT", "9999"),
    "sizes are no numbers": ("SizeX", "many"),
    "kind is wrong": ("Type", "double"),
}


@pytest.mark.parametrize("case", WRONG_FACTS)
def test_wrong_facts_in_the_description_do_no_harm(tmp_path: Path, case: str) -> None:
    """The frames are right, or a sentence says what is wrong; places and times are finite."""
    path, (name, value) = tmp_path / "video.ome.tif", WRONG_FACTS[case]
    frames = KINDS["uint8"](fringes())
    facts = {"axes": "TYX", "PhysicalSizeX": 0.5, "PhysicalSizeXUnit": "µm", "TimeIncrement": 0.5}
    tifffile.imwrite(path, frames, ome=True, metadata=facts, photometric="minisblack")
    with tifffile.TiffFile(path) as tif:
        xml = str(tif.ome_metadata)
    start = xml.index(f'{name}="') + len(name) + 2
    told = xml[:start] + value + xml[xml.index('"', start) :]
    tifffile.tiffcomment(path, told.encode())
    try:
        recording = p4d.open_recording(path)
        np.testing.assert_array_equal(recording.frame(2), frames[2])
    except (OSError, ValueError) as error:
        assert path.name in one_sentence(error)  # noqa: PT017 - either way is right
        return
    for place in recording.holograms.coords.values():
        assert np.isfinite(place).all()
        assert place.size == 1 or place[1] > place[0]
