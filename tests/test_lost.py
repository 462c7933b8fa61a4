"""Frames that the camera lost: found wherever they are, and left out of everything."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray
from typer.testing import CliRunner

import napari_phase4d as p4d
from napari_phase4d.cli.app import app
from napari_phase4d.holography import (
    lost_frames,
    lost_sentence,
    pair_distance,
    reconstruction_advice,
)
from napari_phase4d.holography.lost import Fringes, are_usual
from napari_phase4d.recording import Recording
from napari_phase4d.simulation import multiplexed_video, swimming_euglena
from napari_phase4d.unwrapping import methods_for
from napari_phase4d.words import counted

CARRIERS = ((0.19, 0.21), (-0.21, 0.19))
Frame = NDArray[np.uint8]

pytestmark = pytest.mark.filterwarnings(r"ignore:.*frames? of \d+ left out as lost")


@pytest.fixture(scope="module")
def video() -> Recording:
    exact = swimming_euglena((256, 256), 9, pixel_um=5.2 / 30)
    return multiplexed_video(exact["phase"], carriers=CARRIERS)


def garbage(frame: Frame) -> Frame:
    return np.random.default_rng(1).integers(0, 256, frame.shape).astype(frame.dtype)


def half_grey(frame: Frame) -> Frame:
    return np.where(np.arange(len(frame))[:, None] < len(frame) // 2, frame, 128).astype("u1")


def quarter_garbage(frame: Frame) -> Frame:
    return np.where(np.arange(len(frame))[:, None] < len(frame) // 4, garbage(frame), frame)


def torn_rows(frame: Frame) -> Frame:
    rng = np.random.default_rng(2)
    return np.stack([np.roll(row, rng.integers(len(row))) for row in frame])


def faint(frame: Frame) -> Frame:
    return np.round(frame.mean() + 0.1 * (frame - frame.mean())).astype("u1")


LOSSES: dict[str, Callable[[Frame], Frame]] = {
    "black": np.zeros_like,
    "white": lambda frame: np.full_like(frame, 255),
    "garbage": garbage,
    "half grey": half_grey,
    "quarter garbage": quarter_garbage,
    "torn rows": torn_rows,
    "faint": faint,
}


def test_no_frame_is_passed_as_usual_that_a_close_look_calls_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(0)
    frames = []
    for kind in range(400):
        power, coherence = rng.uniform(0.5, 2, (2, 2, 4, 4)), rng.uniform(0.5, 1, (2, 2, 4, 4))
        some = rng.random((2, 4, 4)) < rng.choice([0.1, 0.2, 0.6])
        power[0][some] *= (1, 1e-3, 100, 1)[kind % 4]
        coherence[0][some] *= (1, 1, 1, 0.2)[kind % 4]
        even = np.full((2, 2, 4, 4), np.pi / 4)
        frame, usual = (Fringes(power[i], coherence[i], even[i], 1.0) for i in (0, 1))
        frames.append((frame, usual))
    quick = [are_usual(a.power, a.coherence, b.power, b.coherence, b.lit) for a, b in frames]
    monkeypatch.setattr("napari_phase4d.holography.lost.are_usual", lambda *_: False)
    lost = [bool(frame.reason(usual)) for frame, usual in frames]
    assert sum(quick) > 100
    assert sum(lost) > 100
    assert not any(a and b for a, b in zip(quick, lost, strict=True))


@pytest.mark.thorough
@pytest.mark.parametrize("place", [0, 4, 8])
@pytest.mark.parametrize("loss", LOSSES)
def test_a_lost_frame_is_left_out_wherever_it_is(video: Recording, loss: str, place: int) -> None:
    frames = video.holograms.values.copy()
    frames[place] = LOSSES[loss](frames[place])
    rec = p4d.open_recording(frames)
    lobes = p4d.find_lobes(rec, 2)
    for carrier in CARRIERS:
        assert min(pair_distance(lobe.carrier, carrier) for lobe in lobes) < 0.002
    data = p4d.reconstruct(rec, lobes, background="none")
    assert data.attrs["lost_times"] == [place]
    kept = np.arange(len(frames)) != place
    without = p4d.reconstruct(p4d.open_recording(frames[kept]), lobes, background="none")
    for name in ("phase", "amplitude"):
        assert np.isnan(data[name].values[place]).all()
        np.testing.assert_array_equal(data[name].values[kept], without[name].values)


SEEN_AS = {
    "black": "blank",
    "white": "saturated",
    "half grey": "damaged",
    "quarter garbage": "damaged",
}


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0, 10])
@pytest.mark.parametrize("loss", LOSSES)
def test_it_is_listed_before_the_lobes_are_known(
    video: Recording, loss: str, noise: float
) -> None:
    frames = noisy(video.holograms.values, noise)
    frames[3] = LOSSES[loss](frames[3])
    rec = p4d.open_recording(frames)
    lost = lost_frames(rec)
    assert lost == {3: SEEN_AS.get(loss, "without fringes")}
    assert lost_sentence(lost, 9).startswith("1 frame of 9 is lost and left out: 3 (")
    spectrum = p4d.power_spectrum(rec)
    assert (spectrum.attrs["lost_frames"], spectrum.attrs["frames"]) == ([3], 8)
    without = p4d.power_spectrum(p4d.open_recording(np.delete(frames, 3, axis=0)))
    np.testing.assert_array_equal(spectrum, without)


def noisy(frames: NDArray[np.floating] | Frame, sigma: float) -> Frame:
    noise = np.random.default_rng(3).normal(0, sigma, frames.shape)
    return np.clip(np.round(frames + noise), 0, 255).astype("u1")


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0, 1])
@pytest.mark.parametrize("times", [0.1, 0.2, 0.5, 1, 5])
def test_moving_cells_and_other_light_are_not_lost(
    video: Recording, times: float, noise: float
) -> None:
    """Fringes that are weaker by as much as the light have the contrast that they had."""
    frames = video.holograms.values * (1.0 if times < 1 else 0.2)
    frames[5] *= times
    rec = p4d.open_recording(noisy(frames, noise))
    assert lost_frames(rec) == {}
    assert lost_sentence({}, 9) == ""
    lobes = p4d.find_lobes(video, 2)
    data, full = (p4d.reconstruct(each, lobes) for each in (rec, video))
    assert data.attrs["lost_times"] == []
    off = np.angle(np.exp(1j * (data["phase"].values[5] - full["phase"].values[5])))
    assert np.sqrt((off**2).mean()) < 0.12


def fringes(
    carrier: tuple[float, float], light: Iterable[float], *, amplitude: float = 40
) -> NDArray[np.floating]:
    """Fringes of contrast 0.4 that drift by a radian a frame, in some light, with noise."""
    y, x = np.mgrid[:256, :256]
    turns = carrier[0] * y + carrier[1] * x
    frames = np.stack(
        [n * amplitude * (2.5 + np.cos(2 * np.pi * turns + time)) for time, n in enumerate(light)]
    )
    return frames + np.random.default_rng(4).normal(0, 2, frames.shape)


def both_looks(frames: NDArray[np.floating], carrier: tuple[float, float]) -> list[list[int]]:
    """Return which frames are lost before and after the lobes are known."""
    rec = p4d.open_recording(frames)
    data = p4d.reconstruct(rec, [p4d.Lobe(carrier, 0.05)], background="none")
    return [list(lost_frames(rec)), data.attrs["lost_times"]]


@pytest.mark.slow
@pytest.mark.parametrize(
    "carrier", [(0.25, 0.0), (0.125, 0.0), (0.0, 0.25), (1 / 3, 1 / 3), (0.3, 0.35), (0.45, 0.0)]
)
def test_fringes_of_any_direction_that_drift_are_not_lost(carrier: tuple[float, float]) -> None:
    """Nor does a frame that is black in half of it make the others look lost."""
    frames = fringes(carrier, np.ones(10))
    assert both_looks(frames, carrier) == [[], []]
    frames[3, 128:] = 0
    assert both_looks(frames, carrier) == [[3], [3]]


@pytest.mark.parametrize(("side", "low"), [(64, 0.1), (128, 0.05), (256, 0.025)])
@pytest.mark.parametrize("loss", ["garbage", "faint"])
def test_few_fringes_across_a_frame_are_enough(side: int, low: float, loss: str) -> None:
    frames = fringes((low * 0.6, low * 0.8), np.ones(9))[:, :side, :side].astype("u1")
    assert lost_frames(p4d.open_recording(frames)) == {}
    frames[6] = LOSSES[loss](frames[6])
    assert list(lost_frames(p4d.open_recording(frames))) == [6]


@pytest.mark.parametrize("level", [-100, -95, 0, 400])
@pytest.mark.parametrize("flicker", [0.05, 0.2])
def test_a_lamp_that_flickers_loses_no_frame(level: float, flicker: float) -> None:
    """Grey values may be less a constant, as a mean or a dark level is, or above a dark level."""
    light = 1 + flicker * np.random.default_rng(5).uniform(-1, 1, 9)
    frames = (fringes((0.19, 0.21), light) + level).astype(np.float32)
    assert both_looks(frames, (0.19, 0.21)) == [[], []]


@pytest.mark.parametrize("other", [-250, 500])
def test_light_without_fringes_loses_no_frame(other: float) -> None:
    """As of a lamp beside that is switched on, or off, for one frame."""
    frames = fringes((0.19, 0.21), np.ones(9)) + 300
    frames[4] += other
    assert both_looks(frames, (0.19, 0.21)) == [[], []]


@pytest.mark.filterwarnings("ignore:.*shows? no fringes")
def test_a_border_that_is_always_dark_loses_no_frame() -> None:
    frames = fringes((0.19, 0.21), np.ones(9))
    frames[:, :40] = frames[:, -40:] = 0
    frames[:, :, :40] = 0
    assert both_looks(frames, (0.19, 0.21)) == [[], []]
    frames[2] = np.random.default_rng(6).normal(100, 30, frames[2].shape)
    assert both_looks(frames, (0.19, 0.21)) == [[2], [2]]


@pytest.mark.slow
@pytest.mark.parametrize("carrier", [(0.0, 0.25), (0.2, 0.0), (0.19, 0.21)])
def test_frames_without_an_object_are_not_lost(carrier: tuple[float, float]) -> None:
    exact = swimming_euglena((256, 256), 9, pixel_um=5.2 / 30, angles_deg=(0,))["phase"]
    exact.values[5:] = 0
    frames = multiplexed_video(exact, carriers=[carrier]).holograms.values
    assert both_looks(frames, carrier) == [[], []]


@pytest.mark.slow
@pytest.mark.parametrize(("lost", "warns"), [([3], False), ([3, 4], True), ([*range(1, 9)], True)])
def test_scripts_are_warned_of_many_lost_frames(
    video: Recording, lost: list[int], warns: bool
) -> None:
    frames = np.tile(video.holograms.values, (2, 1, 1))[:10]
    lobes = p4d.find_lobes(p4d.open_recording(frames), 2)
    frames[lost] = 0
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        data = p4d.reconstruct(p4d.open_recording(frames), lobes)
    assert data.attrs["lost_times"] == lost
    sentence = f"{counted(len(lost), 'frame')} of 10 left out as lost, first at time {lost[0]}"
    words = [str(each.message) for each in said]
    assert [each for each in words if each.endswith(sentence)] == words[: warns * 1]
    assert reconstruction_advice(data.attrs, 10)[-1] == sentence
    assert sentence not in reconstruction_advice(data.attrs)


@pytest.mark.slow
def test_the_command_says_lost_frames(video: Recording, tmp_path: Path) -> None:
    frames = video.holograms.values.copy()
    frames[4] = 0
    np.save(tmp_path / "video.npy", frames)
    call = ["run", str(tmp_path / "video.npy"), "--method", "spatial-2d", "--views", "2"]
    said = CliRunner().invoke(app, [*call, "--out", str(tmp_path / "out")])
    assert said.exit_code == 0, said.output
    assert "1 frame of 9 left out as lost, first at time 4." in " ".join(said.output.split())


@pytest.mark.slow
def test_info_says_lost_frames_once(video: Recording, tmp_path: Path) -> None:
    frames = video.holograms.values.copy()
    frames[3], frames[4] = garbage(frames[3]), 255
    np.save(tmp_path / "video.npy", frames)
    with warnings.catch_warnings(record=True) as more:
        warnings.simplefilter("always")
        said = CliRunner().invoke(app, ["info", str(tmp_path / "video.npy"), "--views", "2"])
    assert said.exit_code == 0, said.output
    words = " ".join(said.output.split())
    assert "2 frames of 9 are lost and left out: 3 (without fringes), 4 (saturated)." in words
    assert not [each for each in more if "lost" in str(each.message)]


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.31, ""),
        (0.2, "is in view; check"),
        (0.1, "and a frame keeps its drift; check"),
    ],
)
def test_little_empty_field_is_said(share: float, words: str) -> None:
    attrs = {"drift_removed": True, "background_share": share, "lost_times": []}
    said = reconstruction_advice(attrs, 9)
    assert [words in each for each in said] == [True] * bool(words)
    assert reconstruction_advice({**attrs, "drift_removed": False}, 9) == []
    assert reconstruction_advice({"drift_removed": True}) == []
    (only,) = reconstruction_advice({**attrs, "without_fringes_percent": [60.0]}, 9)
    assert "shows no fringes" in only  # which is why little is empty


def test_scripts_are_warned_of_little_empty_field() -> None:
    """Phase that goes through all turns in every view has no level that is more frequent."""
    y = np.linspace(-1, 1, 256)
    bent = 20 * (y[:, None] ** 2 + y**2)
    exact = swimming_euglena((256, 256), 2, pixel_um=5.2 / 30)["phase"]
    phase = exact.copy(data=np.broadcast_to(bent, exact.shape).astype(np.float32))
    rec = multiplexed_video(phase, carriers=CARRIERS)
    lobes = [p4d.Lobe(carrier, 0.08) for carrier in CARRIERS]
    with pytest.warns(UserWarning, match="little empty field is in view"):
        data = p4d.reconstruct(rec, lobes, background="none")
    assert data.attrs["background_share"] < 0.3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*left out in view 2, as its fringes")
def test_a_blocked_beam_loses_its_own_view_alone() -> None:
    exact = swimming_euglena((256, 256), 9, pixel_um=5.2 / 30)["phase"]
    frames = multiplexed_video(exact, carriers=CARRIERS).holograms.values.copy()
    blocked = multiplexed_video(exact, carriers=CARRIERS, beam_amplitudes=(1.0, 1e-6))
    frames[3:6] = blocked.holograms.values[3:6]
    lobes = [p4d.Lobe(carrier, 0.08) for carrier in CARRIERS]
    data = p4d.reconstruct(p4d.open_recording(frames), lobes)
    assert data.attrs["lost_times"] == []
    assert data.attrs["lost_views"] == [[3, 1], [4, 1], [5, 1]]
    lost = np.zeros((9, 2), dtype=bool)
    lost[3:6, 1] = True
    assert (np.isnan(data["phase"].values).all(axis=(2, 3)) == lost).all()
    assert np.isfinite(data["phase"].values[~lost]).all()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*as its fringes are gone or weak")
@pytest.mark.parametrize(
    ("size", "radius", "off", "amplitude"),
    [
        (128, 0.04, slice(4, 8), 1e-6),  # where noise in a narrow lobe hangs together
        (128, 0.06, slice(2, 20), 1e-6),
        (128, 0.08, slice(0, 22), 1e-6),
        (256, 0.08, slice(2, 20), 0.05),
        (256, 0.08, slice(4, 8), 0.01),
    ],
)
def test_a_beam_off_for_long_costs_no_other_view(
    size: int, radius: float, off: slice, amplitude: float
) -> None:
    exact = swimming_euglena((size, size), 24, pixel_um=5.2 / 30 * 256 / size)["phase"]
    frames = multiplexed_video(exact, carriers=CARRIERS).holograms.values.copy()
    dim = multiplexed_video(exact, carriers=CARRIERS, beam_amplitudes=(1.0, amplitude))
    frames[off] = dim.holograms.values[off]
    lobes = [p4d.Lobe(carrier, radius) for carrier in CARRIERS]
    data = p4d.reconstruct(p4d.open_recording(frames), lobes)
    assert data.attrs["lost_times"] == []
    assert data.attrs["lost_views"] == [[time, 1] for time in range(24)[off]]


def test_beams_that_are_on_in_turn_are_refused_in_words() -> None:
    exact = swimming_euglena((128, 128), 8, pixel_um=5.2 / 15)["phase"]
    one, other = (
        multiplexed_video(exact, carriers=CARRIERS, beam_amplitudes=beams).holograms.values
        for beams in ((1.0, 1e-6), (1e-6, 1.0))
    )
    frames = one.copy()
    frames[::2] = other[::2]
    lobes = [p4d.Lobe(carrier, 0.08) for carrier in CARRIERS]
    with pytest.raises(ValueError, match="the fringes of all views at once; where beams are on"):
        p4d.reconstruct(p4d.open_recording(frames), lobes)


def test_a_blocked_beam_is_said_before_the_lobes_are_known() -> None:
    lost = {3: "blank", 5: "without fringes in some views"}
    assert lost_sentence(lost, 9) == (
        "1 frame of 9 is lost and left out: 3 (blank). "
        "1 frame of 9 shows no fringes in some views: 5."
    )
    exact = swimming_euglena((256, 256), 9, pixel_um=5.2 / 30)["phase"]
    frames = multiplexed_video(exact, carriers=CARRIERS).holograms.values.copy()
    blocked = multiplexed_video(exact, carriers=CARRIERS, beam_amplitudes=(1.0, 1e-6))
    frames[5] = blocked.holograms.values[5]
    frames[3] = 0
    assert lost_frames(p4d.open_recording(frames)) == lost


@pytest.mark.thorough
@pytest.mark.slow
def test_every_method_goes_on_to_the_end(video: Recording) -> None:
    frames = video.holograms.values.copy()
    frames[4] = 0
    rec = p4d.open_recording(frames)
    outcome = p4d.run(p4d.Recipe(methods=tuple(methods_for(None))), rec)
    lost = np.arange(len(frames)) == 4
    for method, result in outcome.comparison.results.items():
        assert np.isnan(result.values[lost]).all(), method
        assert np.isfinite(result.values[~lost]).all(), method
    trust = outcome.comparison.confidence("temporal-angular")
    assert (trust.values[lost] == 0).all()
    assert "time 4" in outcome.comparison.verdict


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*median over time shows:UserWarning")
def test_references_and_fits_leave_it_out(video: Recording) -> None:
    """The median and the tilt are those of the other frames."""
    frames = video.holograms.values.copy()
    frames[0] = 0
    lobes = p4d.find_lobes(video, 2)
    for settings in ({"reference": "median"}, {"background": "curvature"}):
        there = p4d.reconstruct(p4d.open_recording(frames), lobes, **settings)
        without = p4d.reconstruct(p4d.open_recording(frames[1:]), lobes, **settings)
        np.testing.assert_array_equal(there["phase"].values[1:], without["phase"].values)


def with_lost(rec: Recording, lost: dict[int, Callable[[Frame], Frame]]) -> Recording:
    frames = rec.holograms.values.astype("f4")
    for index, loss in lost.items():
        frames[index] = loss(frames[index])
    return p4d.open_recording(frames)


def unknown(frame: Frame) -> Frame:
    return np.full_like(frame, np.nan, dtype="f4")


@pytest.mark.slow
@pytest.mark.parametrize("ends", [(unknown, unknown), (np.zeros_like, garbage)])
def test_lost_frames_do_not_move_the_focus(
    video: Recording, ends: tuple[Callable[[Frame], Frame], ...]
) -> None:
    lobes = p4d.find_lobes(video, n_views=2)
    lost = with_lost(video, dict(zip((0, 8), ends, strict=True)))
    known = p4d.open_recording(video.holograms.values[[1, 3, 5, 7]])
    lost_um, known_um = (
        p4d.reconstruct(rec, lobes, refocus_um="auto").attrs["refocus_um"] for rec in (lost, known)
    )
    assert lost_um == pytest.approx(known_um, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("loss", [unknown, np.zeros_like, garbage, torn_rows])
def test_a_reference_recording_is_averaged_without_its_lost_frames(
    video: Recording, loss: Callable[[Frame], Frame]
) -> None:
    lobes = p4d.find_lobes(video, n_views=2)
    known = p4d.open_recording(np.delete(video.holograms.values, [0, 5], axis=0))
    lost = with_lost(video, {0: loss, 5: loss})
    of_lost, of_known = (
        p4d.reconstruct(video, lobes, reference)["phase"].values for reference in (lost, known)
    )
    np.testing.assert_array_equal(of_lost, of_known)


@pytest.mark.parametrize("loss", [unknown, np.zeros_like])
def test_a_reference_of_lost_frames_only_is_refused_in_words(
    video: Recording, loss: Callable[[Frame], Frame]
) -> None:
    lobes = p4d.find_lobes(video, n_views=2)
    lost = with_lost(video, dict.fromkeys(range(9), loss))
    with pytest.raises(ValueError, match="no frame of the array shows fringes: frame 0 is"):
        p4d.reconstruct(video, lobes, lost)


DARK = {
    "every second": np.arange(20) % 2 == 0,
    "the first six of ten": np.arange(10) < 6,
    "all but one": np.arange(10) != 4,
}


@pytest.mark.slow
@pytest.mark.parametrize("level", [0, 6])
@pytest.mark.parametrize("pattern", DARK)
def test_dark_frames_are_lost_even_where_most_are(pattern: str, level: int) -> None:
    """Of frames evenly apart, all may be dark."""
    exact = p4d.simulation.swimming_euglena((192, 192), 10, pixel_um=0.2)
    bright = p4d.simulation.multiplexed_video(exact["phase"]).holograms.values
    dark = DARK[pattern]
    frames = bright[np.arange(len(dark)) % len(bright)]
    noise = np.random.default_rng(0).normal(level, 2 * (level > 0), frames.shape)
    frames[dark] = np.clip(noise, 0, 255).astype(frames.dtype)[dark]
    rec = p4d.open_recording(frames)
    assert list(lost_frames(rec)) == np.flatnonzero(dark).tolist()
    lobes = p4d.find_lobes(rec, 2)
    assert np.allclose([lobe.carrier for lobe in lobes], [(0.19, 0.21), (-0.21, 0.19)], atol=1e-3)
    found = p4d.reconstruct(rec, lobes)
    assert found.attrs["lost_times"] == np.flatnonzero(dark).tolist()
    assert np.isfinite(found["phase"].values[~dark]).all()


@pytest.mark.slow
def test_light_between_the_frames_that_are_sampled_is_enough(video: Recording) -> None:
    """Of 63 frames 32 evenly apart are all dark."""
    frames = video.holograms.values[np.arange(63) % 9, :128, :128].copy()
    frames[::2] = 0
    rec = p4d.open_recording(frames)
    lobes = p4d.find_lobes(video, n_views=2)
    data = p4d.reconstruct(rec, lobes, p4d.open_recording(frames), refocus_um="auto")
    assert data.attrs["lost_times"] == list(range(0, 63, 2))


@pytest.mark.slow
@pytest.mark.parametrize("first", [None, 8])
@pytest.mark.parametrize("kind", ["round", "smooth"])
def test_cells_that_arrive_lose_no_frame(kind: str, first: int | None) -> None:
    """Fields that slope are less alike to themselves than empty ones, but as strong and even."""
    y, x = np.mgrid[:256, :256]
    rng = np.random.default_rng(3)
    places: list[NDArray[np.float64]] = []
    while len(places) < 30:
        place = rng.uniform(0, 256, 2)
        if all(np.hypot(*(place - other)) > 25 for other in places):
            places.append(place)
    away = np.array([((y - v) ** 2 + (x - u) ** 2) / 13**2 for v, u in places])
    of_cell = np.sqrt(np.maximum(1 - away, 0)) if kind == "round" else np.exp(-away)
    cells = 3.5 * of_cell.sum(axis=0)
    frames = np.stack([cells * (t >= 12) for t in range(24)])[:, None]
    video = multiplexed_video(
        xr.DataArray(frames, dims=("time", "angle", "y", "x")), carriers=[(0.2, 0.22)]
    )
    assert lost_frames(video) == {}
    lobes = [p4d.Lobe((0.2, 0.22), 0.09)]
    found = p4d.reconstruct(video, lobes, first_frames=first)
    assert found.attrs["lost_times"] == []


@pytest.mark.parametrize("radius", [0.06, 0.1])
def test_noise_as_strong_as_fringes_is_found_in_small_views(radius: float) -> None:
    """Tiles hold few grains there, so that noise looks even in many of them."""
    y, x = np.mgrid[:128, :128]
    rng = np.random.default_rng(1)
    carrier = 2 * np.pi * (0.2 * y + 0.22 * x)
    frames = 120 + 60 * np.cos(carrier) + rng.normal(0, 2, (8, 128, 128))
    strong = 30 / np.sqrt(np.pi * radius**2) * np.sqrt(4 / np.pi)
    frames[5] = 120 + rng.normal(0, strong, (128, 128))
    found = p4d.reconstruct(p4d.open_recording(frames), [p4d.Lobe((0.2, 0.22), radius)])
    assert found.attrs["lost_times"] == [5]
