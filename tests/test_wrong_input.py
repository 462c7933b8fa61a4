"""What is given in a wrong way: each row is a call, and what must happen."""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import (
    difference,
    mean_squared_error,
    measure,
    polygon_mask,
    traces,
    wrong_cycle_map,
    wrong_cycle_share,
)
from napari_phase4d.simulation import multiplexed_video, with_noise
from napari_phase4d.task import Cluster
from stacks import without_attrs

#: (time, angle, y, x), wrapped and exact, a peak of three turns.
DATA = p4d.simulation.swimming_euglena((32, 40), 4, peak_rad=20)
WRAPPED, EXACT = DATA["wrapped"], DATA["phase"]
BARE = without_attrs(WRAPPED)
PLAIN = WRAPPED.values
CELL = {"cell": np.ones((32, 40), bool)}
OPTICS = p4d.Optics(wavelength_um=float(EXACT.attrs["wavelength_um"]))
FRAMES = 100 + 50 * np.cos(
    2 * np.pi * (0.2 * np.arange(64)[:, None] + 0.25 * np.arange(64)) + np.zeros((3, 1, 1))
)
LOBE = p4d.Lobe((0.2, 0.25), 0.08)
RECORDING = p4d.open_recording(FRAMES)
TWO_VIEWS = multiplexed_video(p4d.simulation.swimming_euglena((96, 96), 2, peak_rad=9)["phase"])


def with_places(stack: xr.DataArray, axis: str, places: Any, units: str = "") -> xr.DataArray:
    """Give a stack other coordinates along an axis."""
    attrs = {"units": units} if units else {}
    return stack.assign_coords({axis: (axis, np.asarray(places), attrs)})


def scaled(stack: xr.DataArray, axis: str, factor: float, units: str = "") -> xr.DataArray:
    """Give a stack coordinates in another unit, with or without saying so."""
    return with_places(stack, axis, stack[axis].values * factor, units)


def video(**coords: Any) -> xr.DataArray:
    """Return a hologram video with such coordinates."""
    return xr.DataArray(FRAMES, dims=("time", "y", "x"), coords=coords)


def along(axis: str, places: Any, units: str) -> tuple[str, Any, dict[str, str]]:
    return axis, np.asarray(places, dtype=float), {"units": units}


def unwrap(phase: Any, **options: Any) -> xr.DataArray:
    return p4d.unwrap(phase, "spatial-2d", **options)


def compare(phase: Any, **options: Any) -> p4d.Comparison:
    return p4d.compare(phase, ["spatial-2d"], **options)


#: What takes wrapped phase.
OF_WRAPPED: dict[str, Callable[[Any], Any]] = {
    "unwrap": unwrap,
    "compare": compare,
    "score_boundaries": p4d.score_boundaries,
    "confidence": lambda phase: p4d.confidence(EXACT, phase),
}
#: What takes unwrapped phase.
OF_UNWRAPPED: dict[str, Callable[[Any], Any]] = {
    "measure": lambda phase: measure(phase, CELL, OPTICS),
    "difference": lambda phase: difference(phase, EXACT),
    "difference, reference": lambda phase: difference(EXACT, phase),
    "mean_squared_error": lambda phase: mean_squared_error(phase, EXACT),
    "wrong_cycle_share": lambda phase: wrong_cycle_share(phase, EXACT),
    "wrong_cycle_map": lambda phase: wrong_cycle_map(phase, EXACT),
    "confidence, unwrapped": lambda phase: p4d.confidence(phase, WRAPPED),
    "compare, truth": lambda phase: compare(WRAPPED, truth=phase),
    "score_boundaries, reference": lambda phase: p4d.score_boundaries(WRAPPED, phase),
}

#: Ways to make wrapped phase wrong -> the sentence that refuses it.
REFUSED_WRAPPED: dict[str, tuple[Callable[[], Any], str]] = {
    "angles unsorted": (lambda: WRAPPED.isel(angle=[1, 0]), r"angle coordinates .* do not rise"),
    "times shuffled": (lambda: WRAPPED.isel(time=[2, 0, 3, 1]), "time coordinates .* sortby"),
    "times falling": (lambda: WRAPPED.isel(time=slice(None, None, -1)), "do not rise"),
    "a time is NaN": (
        lambda: with_places(WRAPPED, "time", [0, 1, np.nan, 3]), "1 of 4 time coordinates .* NaN"
    ),
    "times are text": (lambda: with_places(WRAPPED, "time", list("abcd")), "no numbers"),
    "angles are text": (lambda: with_places(WRAPPED, "angle", ["a", "b"]), "no numbers"),
    "angles twice": (lambda: with_places(WRAPPED, "angle", [7, 7]), "two angle .* the same"),
    "times twice": (lambda: with_places(WRAPPED, "time", [0, 1, 1, 2]), "two time .* the same"),
    "an angle is infinite": (lambda: with_places(WRAPPED, "angle", [0, np.inf]), "infinite"),
    "uneven y": (lambda: with_places(WRAPPED, "y", np.arange(32.0) ** 2), "y .* not evenly"),
    "shuffled x": (
        lambda: with_places(WRAPPED, "x", np.roll(np.arange(40.0), 3)), "x .* not evenly"
    ),
    "y in seconds": (lambda: scaled(WRAPPED, "y", 1, "s"), "y coordinates .* in 's'"),
    "x in pixels": (lambda: scaled(WRAPPED, "x", 1, "px"), "x coordinates .* in 'px'"),
    "times in micrometres": (lambda: scaled(WRAPPED, "time", 1, "um"), "give them in seconds"),
    "angles in percent": (lambda: scaled(WRAPPED, "angle", 1, "percent"), "give them in degrees"),
    "a path in nm": (lambda: BARE.assign_attrs(units="nm"), "'nm', which is no phase.*path"),
    "amplitude": (lambda: BARE.assign_attrs(units="a.u."), "'a.u.', which is no phase"),
    "a share": (lambda: BARE.assign_attrs(units="1"), "'1', which is no phase"),
    "camera frames": (lambda: (BARE * 30 + 120).astype("u1"), "uint8 up to .* camera frames"),
    "deep camera frames": (lambda: (PLAIN * 3000 + 12000).astype("u2"), "uint16 up to"),
    "bool": (lambda: WRAPPED > 0, "bool, as masks are"),
    "complex": (lambda: np.exp(1j * WRAPPED), "complex; give its angle"),
    "text": (lambda: np.full((4, 2, 8, 8), "a"), "must be real numbers"),
    "unwrapped, as it notes": (lambda: EXACT, "unwrapped already, as it notes"),
    "a result": (lambda: unwrap(WRAPPED), "unwrapped already by spatial-2d"),
    "all of a Dataset": (lambda: DATA, "Dataset of phase, wrapped; give one of them"),
    "rows of other lengths": (lambda: [[1.0, 2.0], [1.0]], "rows differ in length"),
}  # fmt: skip
#: Ways to make wrapped phase wrong -> the warning.
DOUBTED_WRAPPED: dict[str, tuple[Callable[[], Any], str]] = {
    "degrees": (lambda: np.rad2deg(PLAIN), "as degrees do; give radians"),
    "degrees from 0": (lambda: np.rad2deg(PLAIN) % 360, "as degrees do"),
    "turns": (lambda: PLAIN / (2 * np.pi), "as turns do"),
    "turns from 0": (lambda: (PLAIN / (2 * np.pi)) % 1, "as turns do"),
    "camera frames as floats": (
        lambda: np.round(PLAIN * 30 + 120).astype(np.float32), "whole numbers .* camera frames"
    ),
    "unwrapped": (lambda: EXACT.values, "seems to be unwrapped already"),
}  # fmt: skip
#: Ways to write wrapped phase that are right, and must give the same as the usual one.
RIGHT_WRAPPED: dict[str, Callable[[], Any]] = {
    "degrees, as it says": lambda: np.rad2deg(BARE).assign_attrs(units="degree"),
    "turns, as it says": lambda: (BARE / (2 * np.pi)).assign_attrs(units="turn"),
    "nanometres, as they say": lambda: scaled(WRAPPED, "y", 1000, "nm"),
    "milliseconds, as they say": lambda: scaled(WRAPPED, "time", 1000, "ms"),
    "radians of angle, as they say": lambda: scaled(WRAPPED, "angle", np.pi / 180, "rad"),
    "falling y": lambda: WRAPPED.assign_coords(y=WRAPPED["y"].values[::-1]),
    "dates": lambda: with_places(
        WRAPPED, "time", np.datetime64("2026-01-01", "ns") + np.arange(4) * np.timedelta64(1, "s")
    ),
    "copied over unwrapped phase": lambda: EXACT.copy(data=PLAIN),
    "names swapped": lambda: WRAPPED.transpose("x", "angle", "y", "time"),
}
REFUSED_UNWRAPPED: dict[str, tuple[Callable[[], Any], str]] = {
    "wrapped, as it notes": (lambda: WRAPPED, "is wrapped, as it notes; unwrap it first"),
    "a path in nm": (
        lambda: EXACT.assign_attrs(units="nm"), "in 'nm', which is no phase.* optical path"
    ),
    "bool": (lambda: EXACT > 1, "bool, as masks are"),
    "complex": (lambda: np.exp(1j * EXACT), "is complex"),
    "camera frames": (lambda: (EXACT * 5 + 9).astype("u1"), "camera frames"),
    "uneven y": (lambda: with_places(EXACT, "y", np.arange(32.0) ** 2), "y .* not evenly"),
    "a time is NaN": (lambda: with_places(EXACT, "time", [0, 1, np.nan, 3]), "NaN"),
    "angles twice": (lambda: with_places(EXACT, "angle", [7, 7]), "two angle .* the same"),
    "x in pixels": (lambda: scaled(EXACT, "x", 1, "px"), "'px'; give them in micrometres"),
}  # fmt: skip
OTHER_FRAMES: dict[str, Callable[[], Any]] = {
    "other angles": lambda: EXACT.assign_coords(angle=[0.0, 5.0]),
    "later times": lambda: EXACT.assign_coords(time=EXACT["time"].values + 100),
    "another pixel": lambda: scaled(EXACT, "x", 2, "um"),
    "fewer times": lambda: EXACT[:3],
    "one view": lambda: EXACT.isel(angle=0),
}
#: Single calls -> the sentence that refuses them.
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "pixels in metres": (
        lambda: measure(scaled(scaled(EXACT, "y", 1e-6), "x", 1e-6), CELL, OPTICS),
        "no light resolves; if that is in metres",
    ),
    "regions as a list": (lambda: measure(EXACT, [CELL], OPTICS), "mapping of names to masks"),
    "region of labels": (
        lambda: measure(EXACT, {"a": np.ones((32, 40), int)}, OPTICS), "region_masks"
    ),
    "region of views": (
        lambda: measure(EXACT, {"a": np.ones((2, 32, 40), bool)}, OPTICS),
        "2 time .* does not fit .* name its axes",
    ),
    "region of other views": (
        lambda: measure(
            EXACT, {"a": (EXACT > 1).assign_coords(angle=[1.0, 2.0])}, OPTICS
        ),
        "other angle coordinates",
    ),
    "optics as text": (lambda: measure(EXACT, CELL, "x"), "optics must be an Optics"),
    "mask of views": (
        lambda: unwrap(PLAIN, mask=np.ones((2, 32, 40), bool)), "2 time .* does not fit"
    ),
    "mask of a stack of views": (
        lambda: unwrap(WRAPPED[0], mask=np.ones((2, 32, 40), bool)), "name its axes"
    ),
    "mask with NaN": (lambda: unwrap(PLAIN, mask=np.where(PLAIN > 1, np.nan, 1)), "holds nan"),
    "mask of shares": (lambda: unwrap(PLAIN, mask=np.full((32, 40), 0.5)), "holds 0.5"),
    "mask of text": (lambda: unwrap(PLAIN, mask=np.full((32, 40), "a")), "must be of bool"),
    "mask of other times": (
        lambda: unwrap(WRAPPED, mask=(EXACT > 1).assign_coords(time=[5.0, 6, 7, 8])),
        "other time coordinates",
    ),
    "mask as truth": (
        lambda: p4d.compare(WRAPPED, ["spatial-2d"], (0, 0), PLAIN > 1), "truth is bool"
    ),
    "amplitude of other views": (
        lambda: unwrap(WRAPPED, amplitude=xr.ones_like(WRAPPED).assign_coords(angle=[1.0, 2])),
        "other angle coordinates",
    ),
    "times of a video fall": (
        lambda: p4d.open_recording(video(time=[3.0, 2, 1])), "do not rise"
    ),
    "times of a video twice": (
        lambda: p4d.open_recording(video(time=[1.0, 1, 2])), "two time .* the same"
    ),
    "a time of a video is NaN": (
        lambda: p4d.open_recording(video(time=[1.0, np.nan, 2])), "NaN"
    ),
    "uneven x of a video": (
        lambda: p4d.open_recording(video(x=along("x", np.arange(64) ** 2, "um"))), "not evenly"
    ),
    "flat pixels of a video": (
        lambda: p4d.open_recording(
            video(x=along("x", np.arange(64), "um"), y=along("y", np.arange(64) * 2, "um"))
        ),
        "2 um high and 1 um wide, but must be square",
    ),
    "pixels of a video in metres": (
        lambda: p4d.open_recording(video(x=np.arange(64) * 1e-7)), "no light resolves"
    ),
    "a Dataset as a video": (lambda: p4d.open_recording(DATA), "give one array of it"),
    "phase as a video": (lambda: p4d.open_recording(WRAPPED[:, 0]), "give it to unwrap"),
    "optics of a video": (lambda: p4d.open_recording(FRAMES, optics="x"), "must be an Optics"),
    "lobe at zero": (
        lambda: p4d.reconstruct(RECORDING, [p4d.Lobe((0, 0), 0.1)]), "on the zero order"
    ),
    "lobe twice": (lambda: p4d.reconstruct(RECORDING, [LOBE, LOBE]), "lobes 1 and 2 are the same"),
    "lobe and its conjugate": (
        lambda: p4d.reconstruct(RECORDING, [LOBE, p4d.Lobe((-0.2, -0.25), 0.05)]), "conjugate"
    ),
    "drift in words": (lambda: p4d.reconstruct(RECORDING, [LOBE], drift="no"), "drift must be"),
    "tilt in words": (
        lambda: p4d.reconstruct(RECORDING, [LOBE], tilt_per_frame="no"), "tilt_per_frame must be"
    ),
    "reconstruct of an array": (lambda: p4d.reconstruct(FRAMES, [LOBE]), "takes a Recording"),
    "spectrum of an array": (lambda: p4d.power_spectrum(FRAMES), "rec must be a Recording"),
    "lobes of an array": (lambda: p4d.find_lobes(FRAMES), "rec must be a Recording"),
    "carrier of one number": (lambda: p4d.Lobe((0.1,), 0.1), r"carrier must be two numbers"),
    "carrier of three": (lambda: p4d.Lobe((0.1, 0.1, 0.1), 0.1), "carrier must be two numbers"),
    "carrier of text": (lambda: p4d.Lobe("ab", 0.1), "carrier must be two numbers"),
    "carrier is a number": (lambda: p4d.Lobe(0.1, 0.1), "carrier must be two numbers"),
    "radius as text": (lambda: p4d.Lobe((0.1, 0.1), "x"), "radius must be a number"),
    "angle as text": (lambda: p4d.Lobe((0.1, 0.1), 0.1, "x"), "angle_deg must be a number"),
    "flip in words": (lambda: p4d.Lobe((0.1, 0.1), 0.1, flip="no"), "flip must be True or False"),
    "wavelength as text": (lambda: p4d.Optics(wavelength_um="red"), "wavelength_um must be a"),
    "no wavelength": (lambda: p4d.Optics(wavelength_um=None), "wavelength_um must be a number"),
    "magnification is True": (lambda: p4d.Optics(magnification=True), "magnification must be"),
    "mass without increment": (
        lambda: OPTICS.dry_mass_pg([1.0], 0.01, 0), "refraction_increment_ml_per_g must be"
    ),
    "mass without area": (lambda: OPTICS.dry_mass_pg([1.0], -1), "pixel_area_um2 must be"),
    "noise on an array": (lambda: with_noise(PLAIN), "data must be a Dataset"),
    "noise on amplitude": (lambda: with_noise(xr.Dataset({"a": EXACT})), 'no exact "phase"'),
    "run of a word": (lambda: p4d.run("a.tif"), "recipe must be a Recipe"),
    "run of frames": (lambda: p4d.run(p4d.Recipe(), FRAMES), "recording must be a Recording"),
    "video of an array": (lambda: multiplexed_video(PLAIN), "phase must be a DataArray"),
    "video of a frame": (lambda: multiplexed_video(EXACT[0]), "it must have time, angle, y and x"),
    "video with optics of text": (
        lambda: multiplexed_video(EXACT, "x"), "optics must be an Optics"
    ),
    "threshold is NaN": (
        lambda: p4d.unwrap(WRAPPED, "region-growing", rga_threshold=np.nan), "between 0 and 2 pi"
    ),
    "height of NaN": (lambda: OPTICS.height_um([1.0], np.nan), "must be a finite number"),
    "lobes are nothing": (lambda: p4d.reconstruct(RECORDING, None), "a list of Lobe"),
    "angles are a number": (lambda: p4d.find_lobes(RECORDING, 1, angles_deg=3), "list of degrees"),
    "path of text": (lambda: OPTICS.optical_path_um("x"), "phase must be real numbers"),
    "height of nothing": (lambda: OPTICS.height_um([1.0], None), "object_index must be a number"),
    "traces of a stack": (lambda: traces(EXACT, (0, 0), (1, 1)), "results must be a Mapping"),
    "traces of no frame": (lambda: traces({"a": EXACT}, 3, (1, 1)), "two whole numbers"),
    "polygon in no frame": (lambda: polygon_mask([(0, 0), (0, 2), (2, 2)], 3), "height and width"),
    "polygon of text": (lambda: polygon_mask("x", (4, 4)), "vertices_yx must be real numbers"),
    "recipe with a word": (lambda: p4d.Recipe(boundary="first"), "boundary"),
    "recipe with too much": (lambda: p4d.Recipe(speed=3), "speed"),
    "recipe with optics of text": (lambda: p4d.Recipe(optics="x"), "optics"),
    "recipe with a broken lobe": (
        lambda: p4d.Recipe(lobes=({"carrier": (9, 9), "radius": 0.1},)), "outside the spectrum"
    ),
    "recipe changed to a word": (lambda: p4d.Recipe().changed(n_views="x"), "n_views"),
}  # fmt: skip
#: What can't be simulated -> the sentence that refuses it.
NO_PHANTOM: dict[str, tuple[dict[str, Any], str]] = {
    "one side": ({"shape": (5,)}, "shape must be a height and a width"),
    "no pixels": ({"shape": (0, 0)}, "shape must be a height and a width"),
    "a shape of text": ({"shape": "ab"}, "shape must be a height and a width"),
    "half a pixel": ({"shape": (32.5, 32)}, "shape must be a height and a width"),
    "no frames": ({"n_times": 0}, "n_times must be a number of frames"),
    "frames in words": ({"n_times": "x"}, "n_times must be a number of frames"),
    "more than any memory": ({"n_times": 10**9}, "more than fit into memory"),
    "no angles": ({"angles_deg": []}, "angles_deg must be a list of degrees"),
    "an angle of NaN": ({"angles_deg": [np.nan]}, "angles_deg must be a list of degrees"),
    "an angle twice": ({"angles_deg": [0, 0]}, "angles_deg must rise"),
    "one angle, no list": ({"angles_deg": 5}, "angles_deg must be a list of degrees"),
    "optics of text": ({"optics": "x"}, "optics must be an Optics"),
}
PHANTOMS: dict[str, Callable[..., Any]] = {
    "euglena": p4d.simulation.swimming_euglena,
    "yeast": p4d.simulation.budding_yeast,
    "cells": p4d.simulation.swimming_cells,
    "steps": p4d.simulation.step_phantom,
    "hard shape": partial(p4d.simulation.hard_shape, "wide"),
    "shape": partial(p4d.simulation.moving_shape, next(iter(p4d.simulation.SHAPES))),
}
#: Settings of single phantoms -> the sentence.
NO_SETTING: dict[str, tuple[Callable[[], Any], str]] = {
    "no rate": (lambda: PHANTOMS["euglena"](frame_rate_hz=0), "frame_rate_hz must be a number ab"),
    "no pixel": (lambda: PHANTOMS["euglena"](pixel_um=-1), "pixel_um must be a number above 0"),
    "half a pixel": (lambda: PHANTOMS["euglena"](pixel_um=(1, np.nan)), "pixel_um must be a num"),
    "no peak": (lambda: PHANTOMS["euglena"](peak_rad=np.nan), "peak_rad must be a finite number"),
    "no field": (lambda: PHANTOMS["yeast"](field_um=0), "field_um must be a number above 0"),
    "half a cell": (lambda: PHANTOMS["cells"](n_cells=1.5), "n_cells must be a number of cells"),
    "less than none": (lambda: PHANTOMS["cells"](entering=-1), "entering must be a number of ce"),
}
#: Single calls -> the warning.
DOUBTED: dict[str, tuple[Callable[[], Any], str]] = {
    "wrapped, of another program": (
        lambda: measure(BARE, CELL, OPTICS), "seems to be wrapped"
    ),
    "a path without its unit": (
        lambda: measure(without_attrs(EXACT) * 100, CELL, OPTICS), "more than 50 turns"
    ),
    "pixels in nanometres": (
        lambda: measure(scaled(scaled(EXACT, "y", 1e3), "x", 1e3), CELL, OPTICS),
        "very large; if that is in nanometres",
    ),
    "wavelength in nanometres": (
        lambda: p4d.Optics(wavelength_um=632.8), "nanometres, give wavelength_um=0.6328"
    ),
    "wavelength in metres": (
        lambda: p4d.Optics(wavelength_um=6.328e-7), "metres, give wavelength_um=0.6328"
    ),
    "camera pixel in nanometres": (
        lambda: p4d.Optics(camera_pixel_um=5200), "nanometres, give camera_pixel_um=5.2"
    ),
    "three of two views": (lambda: p4d.find_lobes(TWO_VIEWS, 3), "looks like 2 views"),
    "medium of 1333": (lambda: p4d.Optics(medium_index=1333), "water has 1.33"),
    "pixels by their numbers": (
        lambda: measure(with_places(EXACT, "y", range(32)), CELL, OPTICS),
        "as numbers of pixels are, and count as micrometres",
    ),
    "pixels by their numbers, as floats": (
        lambda: measure(with_places(EXACT, "x", np.arange(40.0)), CELL, OPTICS),
        "x coordinates of the phase are 0, 1, 2, ... without a unit, as numbers of pixels are",
    ),
    "pixels by their numbers, once unwrapped": (
        lambda: measure(unwrap(with_places(WRAPPED, "x", np.arange(40.0))), CELL, OPTICS),
        "as numbers of pixels are",
    ),
    "pixels of a video by their numbers, as floats": (
        lambda: p4d.open_recording(video(x=np.arange(64.0), y=np.arange(64.0))),
        "as numbers of pixels are",
    ),
    "pixels of a video by their numbers": (
        lambda: p4d.open_recording(video(x=np.arange(64), y=np.arange(64))), "numbers of pixels"
    ),
    "pixels of a video in nanometres": (
        lambda: p4d.open_recording(video(x=np.arange(64) * 100.0)), "if that is in nanometres"
    ),
    "wrapped phase as a video": (lambda: p4d.open_recording(PLAIN[:, 0]), "as wrapped phase does"),
    "lobe over the zero order": (
        lambda: p4d.reconstruct(RECORDING, [p4d.Lobe((0.1, 0.1), 0.2)], background="none"),
        "lobe 1 reaches over the zero order",
    ),
    "lobe over the zero order in a run": (
        lambda: p4d.run(
            p4d.Recipe(
                lobes=(p4d.Lobe((0.1, 0.1), 0.2),), methods=("spatial-2d",), background="none"
            ),
            RECORDING,
        ),
        "lobe 1 reaches over the zero order",
    ),
    "lobe on the beat of two others": (
        lambda: p4d.reconstruct(
            TWO_VIEWS,
            [p4d.Lobe((ky, kx), 0.09) for ky, kx in ((0.19, 0.21), (-0.21, 0.19), (0.4, 0.02))],
        ),
        "one of lobes 1, 2 and 3 lies where the other two interfere with each other",
    ),
    "lobe over the edge": (
        lambda: p4d.reconstruct(RECORDING, [p4d.Lobe((0.2, 0.45), 0.1)], background="none"),
        "lobe 1 reaches beyond the edge",
    ),
}  # fmt: skip


def refused(call: Callable[[], Any], sentence: str) -> None:
    """Check that a call is refused in one sentence of this program."""
    with pytest.raises((TypeError, ValueError)) as caught:
        call()
    said = str(caught.value)
    assert re.search(sentence, said), said
    assert "\n" not in said
    assert type(caught.value) in (TypeError, ValueError)


def doubted(call: Callable[[], Any], sentence: str) -> None:
    """Check that a call warns once, pointing at this file, and goes on."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        call()
    found = [w for w in said if re.search(sentence, str(w.message))]
    assert len(found) == 1, [str(w.message) for w in said]
    assert found[0].filename == __file__
    assert found[0].category is UserWarning


@pytest.mark.slow
@pytest.mark.parametrize("work", OF_WRAPPED)
@pytest.mark.parametrize("way", REFUSED_WRAPPED)
def test_what_is_no_wrapped_phase_is_refused(way: str, work: str) -> None:
    make, sentence = REFUSED_WRAPPED[way]
    stack = make()
    refused(lambda: OF_WRAPPED[work](stack), sentence)


@pytest.mark.slow
@pytest.mark.parametrize("work", OF_WRAPPED)
@pytest.mark.parametrize("way", DOUBTED_WRAPPED)
def test_what_hardly_is_wrapped_phase_is_doubted(way: str, work: str) -> None:
    make, sentence = DOUBTED_WRAPPED[way]
    stack = make()
    doubted(lambda: OF_WRAPPED[work](stack), sentence)


@pytest.mark.parametrize("way", RIGHT_WRAPPED)
def test_other_ways_to_say_the_same_give_the_same(way: str) -> None:
    stack = RIGHT_WRAPPED[way]()
    found = unwrap(stack)
    assert found.dims == stack.dims
    assert found.attrs["units"] == "rad"
    expected = unwrap(WRAPPED)
    np.testing.assert_allclose(found.transpose(*expected.dims).values, expected.values, atol=1e-5)
    for axis in ("time", "angle", "y"):
        assert found[axis].attrs.get("units", "") in ("", *("s", "deg", "um"))
    np.testing.assert_allclose(found["angle"], WRAPPED["angle"])
    assert np.abs(np.diff(found["y"])) == pytest.approx(np.diff(WRAPPED["y"]))


@pytest.mark.slow
@pytest.mark.parametrize("work", OF_UNWRAPPED)
@pytest.mark.parametrize("way", REFUSED_UNWRAPPED)
def test_what_is_no_unwrapped_phase_is_refused(way: str, work: str) -> None:
    make, sentence = REFUSED_UNWRAPPED[way]
    stack = make()
    if (way, work) == ("bool", "compare, truth"):
        sentence = "truth is bool"
    refused(lambda: OF_UNWRAPPED[work](stack), sentence)


@pytest.mark.parametrize("work", sorted(set(OF_UNWRAPPED) - {"measure"}))
@pytest.mark.parametrize("way", OTHER_FRAMES)
def test_phase_of_other_frames_is_refused(way: str, work: str) -> None:
    stack = OTHER_FRAMES[way]()
    refused(lambda: OF_UNWRAPPED[work](stack), "other (angle|time|x) coord|of the same frames")


@pytest.mark.parametrize("work", sorted(set(OF_UNWRAPPED) - {"measure"}))
def test_views_in_another_order_are_found_by_their_angles(work: str) -> None:
    turned = EXACT.isel(angle=[1, 0], time=[3, 0, 2, 1])
    expected, found = OF_UNWRAPPED[work](EXACT), OF_UNWRAPPED[work](turned)
    if isinstance(found, p4d.Comparison):
        assert found.table["mse_rad2"].tolist() == expected.table["mse_rad2"].tolist()
    elif isinstance(found, xr.DataArray):
        xr.testing.assert_allclose(found.reindex_like(expected), expected)
    else:
        assert found == pytest.approx(expected)


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_surely_wrong_is_refused(case: str) -> None:
    refused(*REFUSED[case])


@pytest.mark.parametrize("name", PHANTOMS)
@pytest.mark.parametrize("way", NO_PHANTOM)
def test_what_can_not_be_simulated_is_refused(way: str, name: str) -> None:
    given, sentence = NO_PHANTOM[way]
    refused(lambda: PHANTOMS[name](**given), sentence)


@pytest.mark.parametrize("case", NO_SETTING)
def test_settings_of_phantoms_are_refused(case: str) -> None:
    refused(*NO_SETTING[case])


@pytest.mark.parametrize("case", DOUBTED)
def test_what_is_probably_wrong_is_doubted(case: str) -> None:
    doubted(*DOUBTED[case])


@pytest.mark.parametrize("kind", [int, float])
def test_a_pixel_of_1_um_that_says_so_is_not_doubted(kind: type) -> None:
    places = {axis: np.arange(EXACT.sizes[axis], dtype=kind) for axis in ("y", "x")}
    stack = with_places(with_places(EXACT, "y", places["y"], "um"), "x", places["x"], "um")
    sides = {axis: (axis, np.arange(64, dtype=kind), {"units": "um"}) for axis in ("y", "x")}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        table = measure(stack, CELL, OPTICS)
        recording = p4d.open_recording(video(**sides))
    assert (table["area (um^2)"] == 32 * 40).all()
    assert recording.optics.pixel_um == pytest.approx(1)


def test_masks_follow_their_names() -> None:
    inside = EXACT > 1
    expected = unwrap(WRAPPED, mask=inside)
    xr.testing.assert_identical(
        unwrap(WRAPPED, mask=inside.transpose("x", "time", "y", "angle")), expected
    )
    xr.testing.assert_identical(unwrap(WRAPPED, mask=inside.isel(angle=[1, 0])), expected)
    views = xr.DataArray(np.ones((2, 32, 40), bool), dims=("angle", "y", "x"))
    views[0, :, :9] = False
    found = unwrap(WRAPPED, mask=views)
    assert (found.isel(angle=0, x=slice(9)) == 0).all()
    assert (found.isel(angle=1, x=slice(9)) != 0).any()


def test_plain_masks_of_three_axes_are_of_times() -> None:
    """Also where there are as many views as times, so that either would fit."""
    two = WRAPPED[:2]
    mask = np.ones((2, 32, 40), bool)
    mask[0, :, :9] = False
    found = unwrap(two, mask=mask)
    assert (found[0, :, :, :9] == 0).all()
    assert (found[1, :, :, :9] != 0).any()
    table = measure(EXACT[:2], {"a": mask}, OPTICS).set_index(["time (s)", "angle (deg)"])
    area = table["area (um^2)"].to_numpy().reshape(2, 2)
    np.testing.assert_allclose(area[0], area[1] * 31 / 40)


def test_regions_follow_their_names() -> None:
    inside = EXACT > 1
    expected = measure(EXACT, {"a": inside.values}, OPTICS)
    for region in (inside.transpose("x", "y", "angle", "time"), inside.isel(angle=[1, 0])):
        found = measure(EXACT, {"a": region}, OPTICS)
        assert found.equals(expected)


def test_masked_arrays_are_masks() -> None:
    hidden = EXACT.values < 1
    found = unwrap(np.ma.masked_array(PLAIN, hidden))
    np.testing.assert_array_equal(found, unwrap(PLAIN, mask=~hidden))
    both = unwrap(np.ma.masked_array(PLAIN, hidden), mask=np.arange(40) * np.ones((32, 1)) > 8)
    assert (both.values[..., :9] == 0).all()
    assert (both.values[hidden] == 0).all()
    assert (both.values != 0).any()
    mask = np.ma.masked_array(np.ones(PLAIN.shape, bool), hidden)
    np.testing.assert_array_equal(unwrap(PLAIN, mask=mask), found)
    scored = p4d.score_boundaries(np.ma.masked_array(PLAIN, hidden))
    assert scored.attrs["best"] == p4d.score_boundaries(PLAIN, mask=~hidden).attrs["best"]


def test_measures_take_the_units_that_coordinates_name() -> None:
    expected = measure(EXACT, CELL, OPTICS)
    for units, factor in (("nm", 1e3), ("m", 1e-6), ("mm", 1e-3)):
        found = measure(
            scaled(scaled(EXACT, "y", factor, units), "x", factor, units), CELL, OPTICS
        )
        np.testing.assert_allclose(found["dry mass (pg)"], expected["dry mass (pg)"], rtol=1e-6)


def test_a_frame_of_nothing_is_never_safe() -> None:
    holes = WRAPPED.copy(deep=True)
    holes[1, 0] = np.nan
    assert float(p4d.score_boundaries(holes)[1, 0]) == 0


def test_videos_take_the_units_that_coordinates_name() -> None:
    usual = p4d.open_recording(
        video(time=along("time", [0, 1, 2], "s"), x=along("x", np.arange(64) * 0.1, "um"))
    )
    other = p4d.open_recording(
        video(time=along("time", [0, 1e3, 2e3], "ms"), x=along("x", np.arange(64) * 100, "nm"))
    )
    assert usual.optics.pixel_um == pytest.approx(0.1)
    assert other.optics.pixel_um == pytest.approx(0.1)
    np.testing.assert_allclose(other.times_s, usual.times_s)
    assert any("microscope" in note for note in p4d.open_recording(video()).notes)


def test_masked_pixels_of_a_video_are_unknown() -> None:
    frames = np.ma.masked_array(FRAMES, np.zeros(FRAMES.shape, bool))
    frames.mask[1, 5, 5] = True  # a bad pixel of the camera
    filled = p4d.open_recording(frames).frame(1)
    assert filled[5, 5] == pytest.approx(frames[1].mean(), rel=1e-5)
    frames.mask[1, :, 5:15] = True
    with pytest.raises(ValueError, match=r"frame 1 .* holds \d+ NaN"):
        p4d.open_recording(frames).frame(1)


@pytest.mark.parametrize(
    "address",
    [
        "tcp://127.0.0.1:9", "nowhere.invalid:8786", "junk", "tcp://127.0.0.1:99999",
        "http://127.0.0.1:9", "inproc://1", "tls://127.0.0.1:9", "ucx://x:1",
        "tcp://\ud800:1", "noted.json", "empty.json", "list.json", "nowhere.json",
    ],
)  # fmt: skip
def test_an_address_without_a_scheduler_is_soon_said(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that fails to connect would be waited for when the program ends: none is made."""
    monkeypatch.chdir(tmp_path)
    Path("noted.json").write_text('{"address": "junk://q"}')
    Path("empty.json").write_text("{}")
    Path("list.json").write_text("[1]")
    made: list[Any] = []
    monkeypatch.setattr("distributed.Client", made.append)
    began = time.monotonic()
    with pytest.raises(OSError, match="no dask scheduler answers at"):
        Cluster(address)
    assert time.monotonic() - began < 10
    assert not made


def test_an_address_is_a_text() -> None:
    with pytest.raises(TypeError, match="scheduler must be an address such as"):
        Cluster(8786)  # type: ignore[arg-type]
