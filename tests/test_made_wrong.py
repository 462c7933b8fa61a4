"""Stacks made wrong in one way at a time, given to everything that takes one: never in silence.

Each call is refused in one sentence, or warns, or gives what the right stack gives.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import itoh_margin, residues, traces
from stacks import without_attrs as bare
from test_wrong_input import (
    EXACT,
    FRAMES,
    LOBE,
    OF_UNWRAPPED,
    OF_WRAPPED,
    WRAPPED,
    scaled,
    with_places,
)

N_Y, N_X = WRAPPED.sizes["y"], WRAPPED.sizes["x"]
BY_UNIT = {"radian": 1.0, "degree": 180 / np.pi, "turn": 0.5 / np.pi}


def other_kind(stack: xr.DataArray) -> xr.DataArray:
    return WRAPPED if stack is EXACT else EXACT


def with_pixel(stack: xr.DataArray, value: float) -> xr.DataArray:
    values = stack.values.copy()
    values[1, 0, 9, 9] = value
    return stack.copy(data=values)


#: Ways to make a stack wrong, or to write the same in another way.
WAYS: dict[str, Callable[[xr.DataArray], Any]] = {
    "angles unsorted": lambda s: s.isel(angle=[1, 0]),
    "times shuffled": lambda s: s.isel(time=[2, 0, 3, 1]),
    "times falling": lambda s: s.isel(time=slice(None, None, -1)),
    "a time is NaN": lambda s: with_places(s, "time", [0, 1, np.nan, 3]),
    "times are text": lambda s: with_places(s, "time", list("abcd")),
    "angles are text": lambda s: with_places(s, "angle", ["a", "b"]),
    "angles twice": lambda s: with_places(s, "angle", [7, 7]),
    "times twice": lambda s: with_places(s, "time", [0, 1, 1, 2]),
    "an angle is infinite": lambda s: with_places(s, "angle", [0, np.inf]),
    "uneven y": lambda s: with_places(s, "y", np.arange(N_Y * 1.0) ** 2),
    "shuffled x": lambda s: with_places(s, "x", np.roll(np.arange(N_X * 1.0), 3)),
    "y in seconds": lambda s: scaled(s, "y", 1, "s"),
    "x in pixels": lambda s: scaled(s, "x", 1, "px"),
    "times in micrometres": lambda s: scaled(s, "time", 1, "um"),
    "angles in percent": lambda s: scaled(s, "angle", 1, "percent"),
    "a path in nm": lambda s: bare(s).assign_attrs(units="nm"),
    "amplitude": lambda s: bare(s).assign_attrs(units="a.u."),
    "a share": lambda s: bare(s).assign_attrs(units="1"),
    "camera frames": lambda s: (bare(s) * 5 + 20).astype("u1"),
    "deep camera frames": lambda s: (bare(s) * 3000 + 12000).astype("u2"),
    "bool": lambda s: s > 1,
    "complex": lambda s: np.exp(1j * s),
    "text": lambda s: np.full(s.shape, "a"),
    "objects": lambda s: np.full(s.shape, None),
    "the other kind": other_kind,
    "a Dataset": lambda s: xr.Dataset({"a": s, "b": s}),
    "rows of other lengths": lambda s: [[1.0, 2.0], [1.0]],
    "None": lambda s: None,
    "a name": lambda s: "phase.tif",
    "a number": lambda s: 3.0,
    "one axis": lambda s: s.values.ravel(),
    "five axes": lambda s: s.values[None],
    "no times": lambda s: s[:0],
    "no pixels": lambda s: s[..., :0],
    "all NaN": lambda s: s.copy(data=np.full(s.shape, np.nan, np.float32)),
    "names of other axes": lambda s: s.rename(y="z"),
    "another pixel": lambda s: scaled(s, "x", 2, "um"),
    "other angles": lambda s: s.assign_coords(angle=[100.0, 105.0]),
    "fewer times": lambda s: s[:3],
    "fewer rows": lambda s: s[:, :, 2:],
    "one view": lambda s: s.isel(angle=0),
    "degrees, as it says": lambda s: (bare(s) * BY_UNIT["degree"]).assign_attrs(units="degree"),
    "turns, as it says": lambda s: (bare(s) * BY_UNIT["turn"]).assign_attrs(units="turn"),
    "nanometres, as they say": lambda s: scaled(scaled(s, "y", 1e3, "nm"), "x", 1e3, "nm"),
    "milliseconds, as they say": lambda s: scaled(s, "time", 1000, "ms"),
    "radians of angle, as they say": lambda s: scaled(s, "angle", np.pi / 180, "rad"),
    "axes in another order": lambda s: s.transpose("x", "angle", "y", "time"),
    "double precision": lambda s: s.astype(np.float64),
    "on disk": lambda s: s.chunk({"time": 2}),
    "a view that steps": lambda s: s.copy(data=np.repeat(s.values, 2, axis=-1)[..., ::2]),
    "big-endian": lambda s: s.copy(data=s.values.astype(">f4")),
    "read-only": lambda s: s.copy(data=np.broadcast_to(s.values, s.shape)),
}
WORKS: dict[str, Callable[[Any], Any]] = {
    **OF_WRAPPED,
    **OF_UNWRAPPED,
    "itoh_margin": itoh_margin,
    "find_cells": p4d.find_cells,
    "residues": residues,
    "traces": lambda phase: traces({"a": phase}, (1, 0), (9, 9)),
}
#: What takes wrapped phase.
FROM_WRAPPED = {*OF_WRAPPED, "residues"}
#: Ways that are wrong only where there is another stack to fit.
OF_TWO = ("another pixel", "other angles", "fewer times", "fewer rows", "one view")
#: What takes a single stack.
ALONE = (
    "unwrap", "compare", "score_boundaries", "measure", "itoh_margin", "traces", "find_cells",
    "residues",
)  # fmt: skip


def numbers(result: Any) -> list[np.ndarray]:
    """Return all numbers of a result, in the order of angles."""
    if isinstance(result, p4d.Comparison):
        return [a for stack in result.results.values() for a in numbers(stack)]
    if isinstance(result, xr.Dataset):
        return [a for _, stack in sorted(result.items()) for a in numbers(stack)]
    if isinstance(result, xr.DataArray):
        known = [d for d in ("time", "angle") if d in result.coords and result[d].ndim]
        named = [d for d in ("time", "angle", "y", "x") if d in result.dims]
        ordered = result.sortby(known).transpose(*named, ...) if known else result
        return [np.asarray(ordered.values, np.float64)]
    if isinstance(result, pd.DataFrame):
        named = [c for c in ("time (s)", "angle (deg)") if c in result]
        return [result.sort_values(named).select_dtypes("number").to_numpy(np.float64)]
    if isinstance(result, (float, int, np.floating)):
        return [np.asarray(float(result))]
    found = [vars(result)[name] for name in ("over_time", "over_angle")]
    return [np.asarray(v, np.float64) for part in found for v in part.values()]


def outcome_of(work: Callable[[Any], Any], given: Any) -> tuple[str, Any]:
    """Return what happens: "refused", "warned" or "done", with what was said or found."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            result = work(given)
        except (TypeError, ValueError, OSError) as error:
            return "refused", str(error)
    ours = [w for w in said if w.category is UserWarning]
    return ("warned", str(ours[0].message)) if ours else ("done", result)


@lru_cache
def expected(name: str) -> list[np.ndarray]:
    """Return what the right stack gives."""
    return numbers(WORKS[name](WRAPPED if name in FROM_WRAPPED else EXACT))


CASES = [(way, name) for way in WAYS for name in WORKS if not (way in OF_TWO and name in ALONE)]


@pytest.mark.thorough
@pytest.mark.parametrize(("way", "name"), CASES)
def test_nothing_wrong_in_silence(way: str, name: str) -> None:
    work, right = WORKS[name], WRAPPED if name in FROM_WRAPPED else EXACT
    what, found = outcome_of(work, WAYS[way](right))
    if what in ("refused", "warned"):
        assert found
        assert "\n" not in found
        assert "napari_phase4d" not in found
        return
    for one, other in zip(numbers(found), expected(name), strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4)


# ---- videos, and what takes numbers ---------------------------------------------------------


VIDEO = xr.DataArray(
    np.concatenate([FRAMES, FRAMES * 0.9]).astype(np.float32),
    dims=("time", "y", "x"),
    coords={
        "time": ("time", np.arange(6) / 6, {"units": "s"}),
        "y": ("y", np.arange(64) * 0.1, {"units": "um"}),
        "x": ("x", np.arange(64) * 0.1, {"units": "um"}),
    },
)


def with_value(video: xr.DataArray, value: float, where: Any) -> xr.DataArray:
    values = video.values.copy()
    values[where] = value
    return video.copy(data=values)


#: Ways to make a video wrong, or to write the same in another way.
VIDEO_WAYS: dict[str, Callable[[xr.DataArray], Any]] = {
    "times shuffled": lambda v: v.isel(time=[2, 0, 3, 1, 5, 4]),
    "times falling": lambda v: v.isel(time=slice(None, None, -1)),
    "a time is NaN": lambda v: with_places(v, "time", [0, 1, np.nan, 3, 4, 5]),
    "a time is infinite": lambda v: with_places(v, "time", [0, 1, 2, 3, 4, np.inf]),
    "times are text": lambda v: with_places(v, "time", list("abcdef")),
    "times are complex": lambda v: with_places(v, "time", np.arange(6) * 1j),
    "times twice": lambda v: with_places(v, "time", [0, 1, 1, 2, 3, 4]),
    "times in micrometres": lambda v: scaled(v, "time", 1, "um"),
    "uneven x": lambda v: with_places(v, "x", np.arange(64.0) ** 2),
    "uneven y": lambda v: with_places(v, "y", np.arange(64.0) ** 2),
    "shuffled x": lambda v: with_places(v, "x", np.roll(np.arange(64.0), 3)),
    "a NaN in y": lambda v: with_places(v, "y", [np.nan, *range(1, 64)]),
    "x all the same": lambda v: with_places(v, "x", np.zeros(64)),
    "x in seconds": lambda v: scaled(v, "x", 1, "s"),
    "y in pixels": lambda v: scaled(v, "y", 1, "px"),
    "flat pixels": lambda v: scaled(v, "y", 2, "um"),
    "nanometres without saying so": lambda v: scaled(scaled(v, "y", 1e3), "x", 1e3),
    "metres without saying so": lambda v: scaled(scaled(v, "y", 1e-6), "x", 1e-6),
    "numbers of pixels": lambda v: with_places(with_places(v, "y", range(64)), "x", range(64)),
    "no coordinates": lambda v: v.drop_vars(("time", "y", "x")),
    "no times of frames": lambda v: v.drop_vars("time"),
    "no pixel": lambda v: v.drop_vars(("y", "x")),
    "radians": lambda v: v.assign_attrs(units="rad"),
    "wrapped phase": lambda v: np.angle(np.exp(1j * v.values)),
    "bool": lambda v: v > 100,
    "complex": lambda v: v + 0j,
    "text": lambda v: np.full(v.shape, "a"),
    "objects": lambda v: np.full(v.shape, None),
    "dates": lambda v: np.full(v.shape, np.datetime64("2026-01-01")),
    "a Dataset": lambda v: xr.Dataset({"a": v}),
    "a table": lambda v: pd.DataFrame(v.values[0]),
    "rows of other lengths": lambda v: [[1.0, 2.0], [1.0]],
    "None": lambda v: None,
    "a number": lambda v: 3.0,
    "a name": lambda v: "no such video.tif",
    "nothing": lambda v: "",
    "one axis": lambda v: v.values.ravel(),
    "five axes": lambda v: v.values[None, None],
    "colours": lambda v: np.stack([v.values] * 3, axis=-1),
    "no frames": lambda v: v[:0],
    "no pixels": lambda v: v[..., :0],
    "few pixels": lambda v: v[:, :4, :4],
    "names of other axes": lambda v: v.rename(y="z"),
    "all NaN": lambda v: v * np.nan,
    "all the same": lambda v: v * 0 + 7,
    "a frame without light": lambda v: with_value(v, 0, 1),
    "a pixel is NaN": lambda v: with_value(v, np.nan, (1, 9, 9)),
    "a pixel is infinite": lambda v: with_value(v, np.inf, (1, 9, 9)),
    "absurd numbers": lambda v: v * 1e30,
    "nanometres, as they say": lambda v: scaled(scaled(v, "y", 1e3, "nm"), "x", 1e3, "nm"),
    "milliseconds, as they say": lambda v: scaled(v, "time", 1e3, "ms"),
    "axes in another order": lambda v: v.transpose("x", "time", "y"),
    "double precision": lambda v: v.astype(np.float64),
    "on disk": lambda v: v.chunk({"time": 1}),
    "big-endian": lambda v: v.copy(data=v.values.astype(">f4")),
    "read-only": lambda v: v.copy(data=np.broadcast_to(v.values, v.shape)),
    "masked": lambda v: np.ma.masked_array(v.values, v.values > 140),
}


def opened(video: Any) -> p4d.Recording:
    """Open a video; what it notes of itself, for the window and the command line, is said."""
    recording = p4d.open_recording(video)
    for note in set(recording.notes) - set(p4d.open_recording(VIDEO).notes):
        warnings.warn(note, UserWarning, stacklevel=2)
    return recording


def frames_of(video: Any) -> xr.DataArray:
    recording = opened(video)
    frames = np.stack([recording.frame(i) for i in range(recording.n_frames)])
    return recording.holograms.copy(data=frames)


def spectrum_of(video: Any) -> xr.DataArray:
    return p4d.power_spectrum(opened(video))


def phase_of(video: Any) -> xr.DataArray:
    phase = p4d.reconstruct(opened(video), [LOBE], background="none", drift=False)["phase"]
    if "lost_frames" in phase.attrs:
        warnings.warn(str(phase.attrs["lost_frames"]), UserWarning, stacklevel=2)
    return phase


def divided_by(video: Any) -> xr.DataArray:
    reference = video if isinstance(video, (np.ndarray, list)) else opened(video)
    given = p4d.open_recording(VIDEO)
    return p4d.reconstruct(given, [LOBE], reference, background="none", drift=False)["phase"]


OF_VIDEOS: dict[str, Callable[[Any], xr.DataArray]] = {
    "open_recording": frames_of,
    "power_spectrum": spectrum_of,
    "reconstruct": phase_of,
    "reconstruct, reference": divided_by,
}


@lru_cache
def from_video(name: str) -> xr.DataArray:
    """Return what the right video gives."""
    return OF_VIDEOS[name](VIDEO)


#: Ways that make one frame unknown, which is NaN in phase then, and left out of the spectrum.
FRAME_LOST = ("a frame without light", "a pixel is NaN", "a pixel is infinite")
VIDEO_CASES = [
    (way, name)
    for way in VIDEO_WAYS
    for name in OF_VIDEOS
    # Opened, frames are what they were; what is wrong with them is found with their fringes.
    if not (way in (*FRAME_LOST, "all the same") and name == "open_recording")
]


@pytest.mark.thorough
@pytest.mark.parametrize(("way", "name"), VIDEO_CASES)
def test_no_wrong_video_in_silence(way: str, name: str) -> None:
    what, found = outcome_of(OF_VIDEOS[name], VIDEO_WAYS[way](VIDEO))
    if what in ("refused", "warned"):
        assert found
        assert "\n" not in found
        return
    expected = from_video(name)
    if way in FRAME_LOST and name == "reconstruct":
        assert np.isnan(found.values[1]).all()
        found, expected = (s.isel(time=[0, 2, 3, 4, 5]) for s in (found, expected))
    elif way in FRAME_LOST and name == "power_spectrum":
        expected = spectrum_of(VIDEO.isel(time=[0, 2, 3, 4, 5]))
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-4, atol=1e-4)
    for axis in set(found.dims) & set(found.coords):
        np.testing.assert_allclose(found[axis].values, expected[axis].values, rtol=1e-6)


#: What is no such number, and numbers that are in another unit.
NO_NUMBERS: dict[str, Any] = {
    "None": None, "a word": "x", "an empty word": "", "a number as a word": "0.6", "bytes": b"1",
    "True": True, "NaN": np.nan, "infinite": np.inf, "minus infinite": -np.inf, "zero": 0,
    "below zero": -1.0, "complex": 1j, "a list": [1.0], "nothing": [], "two": (1.0, 2.0),
    "a mapping": {"a": 1}, "a set": {1.0}, "a function": abs, "a class": float,
    "an object": object(), "an array": np.ones(3), "a table": pd.DataFrame(),
    "a series": pd.Series([1.0]), "a DataArray": xr.DataArray(1.0), "a Dataset": xr.Dataset(),
    "dates": np.datetime64("2026"), "a time": np.timedelta64(1, "s"), "a path": Path("x"),
    "a range": range(3), "an iterator": iter([1.0]), "of 400 digits": 10**400, "huge": 1e30,
    "tiny": 1e-30, "in nanometres": 632.8, "in metres": 632.8e-9, "text of NumPy": np.str_("1"),
    "a masked number": np.ma.masked, "objects": np.array([None]), "an error": ValueError(),
    "not implemented": NotImplemented, "an ellipsis": ..., "a slice": slice(3),
}  # fmt: skip
#: What takes numbers -> how it is made with one of them, and the number that it has then.
OF_NUMBERS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "Optics, wavelength": (lambda n: p4d.Optics(wavelength_um=n), lambda o: o.wavelength_um),
    "Optics, pixel": (lambda n: p4d.Optics(camera_pixel_um=n), lambda o: o.camera_pixel_um),
    "Optics, magnification": (lambda n: p4d.Optics(magnification=n), lambda o: o.magnification),
    "Optics, medium": (lambda n: p4d.Optics(medium_index=n), lambda o: o.medium_index),
    "Lobe, carrier": (lambda n: p4d.Lobe((n, 0.2), 0.1), lambda k: k.carrier[0]),
    "Lobe, all of its carrier": (lambda n: p4d.Lobe(n, 0.1), lambda k: k.carrier),
    "Lobe, radius": (lambda n: p4d.Lobe((0.2, 0.2), n), lambda k: k.radius),
    "Lobe, angle": (lambda n: p4d.Lobe((0.2, 0.2), 0.1, n), lambda k: k.angle_deg),
    "Recipe, optics": (lambda n: p4d.Recipe(optics=n), lambda r: r.optics),
    "Recipe, views": (lambda n: p4d.Recipe(n_views=n), lambda r: r.n_views),
    "Recipe, rate": (lambda n: p4d.Recipe(frame_rate_hz=n), lambda r: r.frame_rate_hz),
    "Recipe, boundary": (lambda n: p4d.Recipe(boundary=n), lambda r: r.boundary),
    "Recipe, focus": (lambda n: p4d.Recipe(refocus_um=n), lambda r: r.refocus_um),
}


@pytest.mark.parametrize("name", OF_NUMBERS)
@pytest.mark.parametrize("way", NO_NUMBERS)
def test_no_wrong_number_in_silence(way: str, name: str) -> None:
    """Refused, warned of, or kept just as it was given: never turned into another number."""
    make, kept = OF_NUMBERS[name]
    given = NO_NUMBERS[way]
    what, found = outcome_of(make, given)
    if what == "done":  # also where the same number is written in another way
        assert kept(found) is given or kept(found) == float(given)
        assert given is None or np.isfinite(float(given))
        return
    assert found
    assert "\n" not in found


def test_there_are_as_many_ways_and_functions_as_are_said() -> None:
    assert min(len(WAYS), len(VIDEO_WAYS), len(NO_NUMBERS)) >= 40
    fed = {name.split(",")[0] for name in (*WORKS, *OF_VIDEOS, *OF_NUMBERS)}
    assert fed >= {
        "unwrap", "compare", "measure", "confidence", "difference", "mean_squared_error",
        "wrong_cycle_share", "wrong_cycle_map", "score_boundaries", "reconstruct",
        "open_recording", "Recipe", "Optics", "Lobe",
    }  # fmt: skip
