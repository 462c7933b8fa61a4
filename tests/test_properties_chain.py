"""What holds on the way from holograms to files, on examples that hypothesis makes up."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as made

import napari_phase4d as p4d
from made_up import EXAMPLES, TURN, quick
from napari_phase4d.io import read_results, write_phase
from napari_phase4d.pipeline.batch_folders import result_folders

pytestmark = pytest.mark.slow

DIMS = ("time", "angle", "y", "x")
PAIR = (p4d.Lobe((0.21, 0.2), 0.09, -7.0), p4d.Lobe((-0.19, 0.22), 0.09, 21.0))


def frames_of(seed: int, shape: tuple[int, int, int], dtype: str = "u1") -> np.ndarray:
    """Return noisy fringes of two carriers as a camera would count them."""
    rng = np.random.default_rng(seed)
    time, y, x = np.indices(shape)
    light = 100 + 5 * rng.normal(size=shape)
    for lobe in PAIR:
        ky, kx = lobe.carrier
        light += 30 * np.cos(TURN * (ky * y + kx * x) + 0.3 * time + rng.uniform(0, TURN))
    return np.clip(light, 0, 255).round().astype(dtype)


videos = st.builds(
    frames_of,
    st.integers(0, 2**31),
    st.tuples(st.integers(1, 4), st.integers(24, 41), st.integers(24, 41)),
)


def phase_of(frames: Any, lobes: tuple[p4d.Lobe, ...] = PAIR, **options: Any) -> xr.DataArray:
    found: xr.DataArray = p4d.reconstruct(p4d.open_recording(frames), lobes, **options)["phase"]
    return found


def off_by(first: xr.DataArray, second: xr.DataArray) -> float:
    """Return the largest difference of two wrapped phases in radians."""
    return float(np.abs(np.angle(np.exp(1j * (first.values - second.values)))).max())


@pytest.mark.thorough
@quick
@given(video=videos)
def test_holograms_give_the_same_phase_in_any_form(video: np.ndarray) -> None:
    """To the bit, since none of these forms changes a number."""
    before = video.copy()
    video.flags.writeable = False
    expected = phase_of(video)
    assert expected.dims == DIMS
    assert ((expected > -np.pi - 1e-6) & (expected <= np.pi + 1e-6)).all()
    named = xr.DataArray(video, dims=("time", "y", "x"))
    wide = np.repeat(video, 2, axis=2)
    forms = {
        "uint16, big-endian": video.astype(">u2"),
        "int32": video.astype("i4"),
        "float64": video.astype("f8"),
        "half precision": video.astype("f2"),
        "Fortran": np.asfortranarray(video),
        "every second": wide[:, :, ::2],
        "backwards": np.ascontiguousarray(video[:, ::-1])[:, ::-1],
        "named in another order": named.transpose("x", "time", "y"),
        "lazy": named.chunk({"time": 1}).data,
    }
    for form, frames in forms.items():
        np.testing.assert_array_equal(phase_of(frames).values, expected.values, err_msg=form)
    np.testing.assert_array_equal(video, before)


@quick
@given(video=videos, brighter=st.sampled_from([0.01, 3.0, 257.0]))
def test_phase_does_not_depend_on_brightness(video: np.ndarray, brighter: float) -> None:
    plain = p4d.reconstruct(p4d.open_recording(video), PAIR)
    bright = p4d.reconstruct(p4d.open_recording(video.astype("f4") * brighter), PAIR)
    assert off_by(bright["phase"], plain["phase"]) < 2e-3
    ratio = bright["amplitude"].values / plain["amplitude"].values
    np.testing.assert_allclose(ratio, brighter, rtol=2e-3)


@quick
@given(video=videos)
def test_order_of_lobes_makes_no_difference(video: np.ndarray) -> None:
    """The result is in the order of the angles."""
    xr.testing.assert_identical(phase_of(video)["angle"], phase_of(video, PAIR[::-1])["angle"])
    np.testing.assert_array_equal(phase_of(video).values, phase_of(video, PAIR[::-1]).values)


@quick
@given(video=videos)
def test_conjugate_lobe_has_the_opposite_phase(video: np.ndarray) -> None:
    plain = phase_of(video, background="none", drift=False)
    flipped = tuple(p4d.Lobe(b.carrier, b.radius, b.angle_deg, flip=True) for b in PAIR)
    assert off_by(phase_of(video, flipped, background="none", drift=False), -plain) < 1e-4


@quick
@given(video=videos)
def test_frames_can_be_reconstructed_one_by_one(video: np.ndarray) -> None:
    """Nothing but background and reference looks at other frames."""
    whole = phase_of(video, background="none")
    for number in range(len(video)):
        alone = phase_of(video[number], background="none")
        np.testing.assert_array_equal(alone.values[0], whole.values[number])


@settings(quick, max_examples=6)
@given(scale=st.sampled_from([0.003, 1.0, 250.0]), offset=st.sampled_from([0.0, 40.0]))
def test_lobes_do_not_depend_on_brightness(
    small_video: p4d.Recording, scale: float, offset: float
) -> None:
    expected = p4d.find_lobes(small_video, 2)
    frames = small_video.holograms.values.astype("f4") * scale + offset
    for found, lobe in zip(p4d.find_lobes(p4d.open_recording(frames), 2), expected, strict=True):
        np.testing.assert_allclose(found.carrier, lobe.carrier, atol=1e-4)
        assert found.radius == pytest.approx(lobe.radius, abs=0.01)
        assert found.flip == lobe.flip


@pytest.mark.parametrize("move", ["transpose", "flip y", "flip x"])
def test_lobes_move_with_the_frame(small_video: p4d.Recording, move: str) -> None:
    """A carrier and its conjugate are the same fringes."""
    change = {
        "transpose": lambda f: f.swapaxes(1, 2), "flip y": lambda f: f[:, ::-1],
        "flip x": lambda f: f[:, :, ::-1],
    }[move]  # fmt: skip
    there = {
        "transpose": lambda ky, kx: (kx, ky), "flip y": lambda ky, kx: (-ky, kx),
        "flip x": lambda ky, kx: (ky, -kx),
    }[move]  # fmt: skip
    expected = {half(there(*b.carrier)) for b in p4d.find_lobes(small_video, 2)}
    moved = p4d.open_recording(change(small_video.holograms.values))
    for lobe in p4d.find_lobes(moved, 2):
        nearest = min(expected, key=lambda k: math.dist(k, half(lobe.carrier)))
        np.testing.assert_allclose(half(lobe.carrier), nearest, atol=1e-3)
        expected.remove(nearest)
    assert not expected


def half(carrier: tuple[float, float]) -> tuple[float, float]:
    ky, kx = carrier
    return (ky, kx) if kx > 0 else (-ky, -kx)


words = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12)
facts = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | words
    | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=8,
)  # fmt: skip


@st.composite
def stacks(draw: Any) -> xr.DataArray:
    """Any float32 numbers, NaN and infinity among them, at any finite places."""
    shape = draw(st.tuples(*[st.integers(1, 3)] * 2, *[st.integers(1, 6)] * 2))
    values = draw(made.arrays(np.float32, shape, elements=st.floats(width=32)))
    place = st.floats(-1e9, 1e9, allow_subnormal=False)
    coords: dict[str, Any] = {
        d: (d, np.array(draw(st.lists(place, min_size=n, max_size=n, unique=True))), {"units": u})
        for d, n, u in zip(DIMS, shape, ("s", "deg", "um", "um"), strict=True)
    }
    attrs = draw(st.dictionaries(words, facts, max_size=4))
    name = draw(st.sampled_from(["phase", "temporal-angular"]) | words.filter(bool))
    return xr.DataArray(values, dims=DIMS, coords=coords, attrs=attrs, name=name)


@pytest.mark.thorough
@pytest.mark.parametrize("ending", ["ome.tif", "ome.zarr"])
@settings(quick, max_examples=3 * EXAMPLES)
@given(stack=stacks())
def test_stacks_come_back_from_files(tmp_path: Path, ending: str, stack: xr.DataArray) -> None:
    """Same bits of every number, same places, same words."""
    path = write_phase(tmp_path / f"stack.{ending}", stack)
    again = read_results(path).load()
    assert again.values.tobytes() == stack.values.tobytes()
    xr.testing.assert_identical(again, stack)
    shuffled = write_phase(
        tmp_path / f"again.{ending}", stack.transpose("x", "angle", "y", "time")
    )
    xr.testing.assert_identical(read_results(shuffled).load(), stack)


lobes = st.builds(
    p4d.Lobe,
    st.tuples(*[st.floats(-0.5, 0.5)] * 2),
    st.floats(1e-6, 0.5),
    st.floats(-90, 90),
    st.booleans(),
)
positive = st.floats(1e-6, 1e6)
#: Of light, and of cameras and lenses that there could be; others are doubted or refused.
microscopes = (st.floats(1e-3, 99), st.floats(1e-2, 499), st.floats(1e-2, 1e4), st.floats(1, 3))
recipes = st.builds(
    p4d.Recipe,
    recording=words,
    dataset=st.none() | words,
    content=st.sampled_from(["auto", "holograms", "phase"]),
    optics=st.none() | st.builds(p4d.Optics, *microscopes),
    frame_rate_hz=st.none() | positive,
    n_views=st.integers(1, 6),
    angles_deg=st.none() | st.lists(st.floats(-90, 90), max_size=6).map(tuple),
    lobes=st.lists(lobes, max_size=3).map(tuple),
    reference=st.none() | st.integers(0, 10**6) | words,
    window=st.sampled_from(["disk", "smooth-disk", "gaussian", "tukey"]),
    background=st.sampled_from(["none", "tilt", "curvature"]),
    drift=st.booleans(),
    mask=st.sampled_from(["auto", None]),
    boundary=st.lists(st.tuples(*[st.integers(-99, 99)] * 2), min_size=1, max_size=3).map(
        tuple
    ),
    methods=st.lists(st.sampled_from(list(p4d.METHODS)), max_size=4).map(tuple),
    options=st.fixed_dictionaries({}, optional={
        "dilate-erode": st.fixed_dictionaries({
            "max_window": st.integers(0, 9), "erode_threshold": st.floats(0.1, 9)}),
        "temporal": st.fixed_dictionaries({"split": st.booleans()}),
    }),
    confidence=st.booleans(),
)  # fmt: skip


@settings(quick, max_examples=6 * EXAMPLES)
@given(recipe=recipes)
def test_recipes_come_back_from_files(tmp_path: Path, recipe: p4d.Recipe) -> None:
    path = recipe.to_file(tmp_path / "recipe.json")
    assert p4d.Recipe.from_file(path) == recipe
    assert recipe.changed() == recipe
    json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | words,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(words, inner, max_size=3),
    max_leaves=6,
)


@settings(quick, max_examples=12 * EXAMPLES)
@given(field=st.sampled_from(sorted(p4d.Recipe.model_fields)), value=anything)
def test_any_value_of_a_setting_is_taken_or_refused_in_one_sentence(
    tmp_path: Path, field: str, value: Any
) -> None:
    path = tmp_path / "recipe.json"
    path.write_text(json.dumps({field: value}))
    sentence = ""
    try:
        recipe = p4d.Recipe.from_file(path)
    except ValueError as error:
        sentence = str(error)
    if sentence:
        assert sentence.startswith("recipe.json is no valid recipe: ")
        assert "\n" not in sentence
    else:
        assert p4d.Recipe.from_file(recipe.to_file(tmp_path / "again.json")) == recipe


names = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="/\x00"), min_size=1)


@settings(quick, max_examples=12 * EXAMPLES)
@given(names=st.lists(names | st.sampled_from(["...tif", "..", ".", "a.tif", "A.TIF", "a:b"])))
def test_results_stay_in_their_folder(names: list[str]) -> None:
    """Whatever files are called, each gets a folder of its own, right in that one."""
    out = Path("out")
    folders = result_folders([Path("videos") / name for name in names], out)
    assert len({str(folder).casefold() for folder in folders}) == len(names)
    for folder in folders:
        assert folder.parent == out
        assert folder.name not in ("", ".", "..")
        assert (out / folder.name).resolve().parent == out.resolve()
