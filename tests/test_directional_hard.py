"""The project's own methods where unwrapping is hard, and the parts that are for it.

Bounds are near what is measured: ``python3 dev.py accuracy regimes`` prints more of it.
"""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import napari_phase4d as p4d
from napari_phase4d.phasors import turned
from napari_phase4d.simulation import hard_shape, moving_shape, with_fault, with_noise
from napari_phase4d.stack import Block
from napari_phase4d.unwrapping import neighbours
from napari_phase4d.unwrapping.background import find_background, plane
from napari_phase4d.unwrapping.border import tilt_of
from napari_phase4d.unwrapping.directional import changes, steps
from napari_phase4d.unwrapping.directional.changes import Denied, turns_of_maps
from napari_phase4d.unwrapping.directional.following import follow
from napari_phase4d.unwrapping.directional.registration import Seen
from napari_phase4d.unwrapping.directional.residues import (
    residues_of_maps,
    torn_changes,
    torn_objects,
    torn_of_few,
    torn_views,
)
from napari_phase4d.unwrapping.directional.steps import Along, Floors, courses_of
from napari_phase4d.unwrapping.neighbours import (
    along_slope,
    box_mean,
    change_on_both_sides,
    known_mean,
)

TURN = 2 * np.pi
WL1 = "directional-l1"
RNG_SEED = 5


@lru_cache(maxsize=16)
def object_(name: str) -> xr.Dataset:
    """Return an object seen from two sides; that is enough, and quick."""
    shape = hard_shape if name in ("growing wall", "lamella", "ring") else moving_shape
    return shape(name, angles_deg=(0.0, 6.0))


def error(found: xr.DataArray, truth: xr.DataArray, empty: np.ndarray) -> float:
    """Return the squared error of wrong turns, each frame relative to its empty field.

    Frames in which the truth is NaN are left out.
    """
    off = np.round((found.values - truth.values) / TURN)
    for frame in np.ndindex(*off.shape[:2]):
        if np.isfinite(off[frame]).any():
            off[frame] -= np.nanmedian(off[frame][empty[frame]])
    return float(TURN**2 * np.nanmean(off**2))


def error_of(data: xr.Dataset, empty: np.ndarray, method: str = WL1) -> float:
    return error(p4d.unwrap(data["wrapped"], method), data["phase"], empty)


def empty_of(exact: xr.Dataset) -> np.ndarray:
    return np.abs(exact["phase"].values) < 0.05


def stack_of(phase: np.ndarray, noise: float = 0.0, seed: int = RNG_SEED) -> xr.Dataset:
    """Return exact phase, with noise, and what is seen of it."""
    noisy = phase + noise * np.random.default_rng(seed).normal(size=phase.shape)
    exact = xr.DataArray(noisy.astype(np.float32), dims=("time", "angle", "y", "x"))
    return xr.Dataset({"phase": exact, "wrapped": exact.copy(data=turned(exact.values))})


# ---- recordings -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("name", ["vacuole", "touching", "dividing"])
def test_a_pause(name: str, noise: float) -> None:
    """What changes meanwhile is torn at the rims; held to it, a cell slips: 1.6 to 3.8 rad²."""
    data = with_fault(object_(name), "pause", noise, seed=RNG_SEED)
    empty = empty_of(with_fault(object_(name), "pause"))
    assert error_of(data, empty) <= 0.06


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_two_views_that_differ_much(noise: float) -> None:
    """From 28 degrees off the change of view is torn by a wall, while each view changes little."""
    exact = hard_shape("growing wall", n_times=30, angles_deg=(-7.0, 21.0))
    data = with_noise(exact, noise, seed=RNG_SEED)
    assert error_of(data, empty_of(exact)) <= 0.002


def test_a_change_is_torn_that_has_far_more_residues_than_those_round_it() -> None:
    steady = np.array([[40, 44], [38, 40], [45, 41], [39, 43], [41, 40]])
    assert not torn_changes(steady).any()
    alone = steady.copy()
    alone[2] = [170, 150]
    assert torn_changes(alone).all(axis=1).tolist() == [False, False, True, False, False]
    # A change that is torn in a single view is none that happened.
    alone[2] = [170, 0]
    assert not torn_changes(alone).any()
    # What is in one frame alone comes with one change and goes with the next.
    twice = np.array([[0], [0], [90], [85], [0], [0]])
    assert not torn_changes(twice).any()
    # On one side of the first change and the last one there would be a single frame.
    first = np.array([[90], [0], [0], [0], [90]])
    assert not torn_changes(first).any()


def test_of_few_frames_a_change_is_torn_that_has_more_residues_than_both() -> None:
    frames = np.array([[40, 42], [38, 40], [44, 40], [40, 40]])
    assert not torn_of_few(np.array([[40, 44], [50, 51], [41, 40]]), frames).any()
    torn = torn_of_few(np.array([[90, 80], [38, 40], [95, 90]]), frames)
    assert torn.tolist() == [[True, True], [False, False], [True, True]]
    # One frame in which the object is torn itself tears both of its changes.
    noisy = np.array([[4, 4], [70, 70], [4, 4]])
    assert not torn_of_few(np.array([[68, 69], [71, 66]]), noisy).any()


def test_views_are_torn_where_time_tells_more() -> None:
    over_time = np.array([[0, 2, 60], [1, 0, 70], [0, 1, 80]])
    between = np.array([[50, 50], [5, 200], [50, 210], [50, 300]])
    found = torn_views(over_time, between)
    assert found.tolist() == [[True, False], [False, True], [True, True], [True, True]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "noise"), [("daughters", 0), ("daughters", 0.4), ("returning", 0.2), ("dividing", 0)]
)
def test_four_frames_far_apart_in_time(name: str, noise: float) -> None:
    """They are thick from the start on, and changes are torn more than they are."""
    exact = hard_shape(name) if name == "daughters" else moving_shape(name)
    exact = exact.isel(time=slice(exact.sizes["time"] // 2, None, 3))
    assert error_of(with_noise(exact, noise, seed=RNG_SEED), empty_of(exact)) <= 0.05


@pytest.mark.xfail(strict=True, reason="most rims of its frames are off by a turn: see limits.md")
def test_four_thick_frames_most_of_which_are_wrong_by_themselves() -> None:
    exact = moving_shape("swelling")
    exact = exact.isel(time=slice(exact.sizes["time"] // 2, None, 3))
    assert error_of(with_noise(exact, 0, seed=RNG_SEED), empty_of(exact)) <= 0.05


@pytest.mark.slow
def test_thick_frames_in_a_row_know_each_other() -> None:
    """The changes have more residues than the frames, one after the other: so they stay."""
    thick = moving_shape("returning")
    thick = thick.assign(phase=np.float32(1.25) * thick["phase"])
    assert error_of(with_noise(thick, 0, seed=RNG_SEED), empty_of(thick)) <= 0.2


def test_residues_of_a_map_are_those_of_its_loops() -> None:
    rng = np.random.default_rng(RNG_SEED)
    maps = rng.normal(0, 2, (3, 2, 15, 18)).astype(np.float32)
    known = rng.random(maps.shape) > 0.1
    loops = [maps[..., :-1, :-1], maps[..., :-1, 1:], maps[..., 1:, 1:], maps[..., 1:, :-1]]
    turns = sum(turned(b - a) for a, b in pairwise([*loops, loops[0]])) / TURN
    all_known = (
        known[..., :-1, :-1] & known[..., :-1, 1:] & known[..., 1:, 1:] & known[..., 1:, :-1]
    )
    expected = (np.abs(np.round(turns)) * all_known).sum(axis=(2, 3))
    assert expected.min() > 10
    bare = np.zeros_like(known)
    np.testing.assert_array_equal(residues_of_maps(maps, known, bare, 0), expected)
    # Whole turns more or less change nothing.
    more = maps + np.float32(TURN) * rng.integers(-3, 4, maps.shape).astype(np.float32)
    np.testing.assert_array_equal(residues_of_maps(more, known, bare, 0), expected)
    # Residues all over the empty field are noise.
    assert not residues_of_maps(maps, known, known, 0).any()


def test_over_time_residues_at_rims_count_and_only_objects_that_have_some() -> None:
    """A cell with a vortex in its middle, one with two at its rim; a third one has none."""
    y, x = np.mgrid[:40, :120].astype(float)
    map_ = np.zeros((40, 120), np.float32)
    inside = np.zeros(map_.shape, dtype=bool)
    for centre, vortices in ((20, [(20, 20)]), (60, [(9, 60), (31, 60)]), (100, [])):
        cell = np.hypot(y - 20, x - centre) < 13
        inside |= cell
        for row, column in vortices:
            angle = np.arctan2(y - row + 0.5, x - column + 0.5)
            map_[cell] += (np.sign(row - 25) * angle if len(vortices) > 1 else angle)[cell]
    known = np.ones(map_.shape, dtype=bool)
    at_rims, everywhere = (
        residues_of_maps(map_[None, None], known[None, None], ~inside[None, None], axis)[0, 0]
        for axis in (0, 1)
    )
    assert 0 < at_rims < everywhere
    noisy = map_.copy()
    noisy[8:32, 48:72] += np.random.default_rng(RNG_SEED).normal(0, 3, (24, 24))
    torn = torn_objects(noisy, known, ~inside)
    assert torn[20, 60]
    assert not torn[20, 100]
    assert not torn[20, 20]


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.2, 0.5])
def test_what_comes_into_view_leaves_other_cells_alone(noise: float) -> None:
    """A cell with a wall that grows, and another one that is there at once, far away."""
    y, x = np.mgrid[:64, :120].astype(float)
    own = np.maximum(1 - ((y - 32) ** 2 + (x - 30) ** 2) / 22**2, 0) ** 0.5
    disc = np.hypot(y - 30, x - 32) < 8
    other = 8 * np.maximum(1 - ((y - 32) ** 2 + (x - 92) ** 2) / 18**2, 0) ** 0.5
    moments = np.linspace(0, 1, 20)
    frames = [(4 + 8 * s) * own + 8 * s * disc + other * (s > 0.6) for s in moments]
    phase = np.stack([np.stack(frames)] * 2, axis=1)
    off = [error_of(stack_of(phase, noise, seed), phase < 0.01) for seed in range(3)]
    assert max(off) <= 0.02, off


@pytest.mark.slow
def test_one_noisy_frame_is_no_pause() -> None:
    exact = hard_shape("growing wall", angles_deg=(0.0, 6.0))
    data = with_noise(exact, 0.2, seed=RNG_SEED)
    more = np.random.default_rng(RNG_SEED).normal(0, 0.77, exact["phase"].shape[1:])
    phase = data["phase"].values.copy()
    phase[15] += more
    data = data.assign(
        phase=data["phase"].copy(data=phase), wrapped=data["wrapped"].copy(data=turned(phase))
    )
    assert error_of(data, empty_of(exact)) <= 0.05


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_wall_that_grows_through_a_turn(noise: float) -> None:
    """A disc rises to 8 rad inside a cell, within one pixel."""
    y, x = np.mgrid[-24:24, -24:24]
    cell = 3 * np.sqrt(np.maximum(1 - (y**2 + x**2) / 17**2, 0))
    disc = np.hypot(y + 2, x - 2) < 6
    frames = [cell + 8 * s * disc for s in np.linspace(0, 1, 20)]
    phase = np.stack([np.stack(frames)] * 2, axis=1)
    data, empty = stack_of(phase, noise), phase < 0.01
    best = min(error_of(data, empty, m) for m in ("spatial-2d", "temporal", "temporal-angular"))
    assert error_of(data, empty) <= 0.001
    assert error_of(data, empty) <= best


@pytest.mark.slow
def test_a_wall_that_noise_blurs() -> None:
    """Some steps across it pass half a turn unseen, and look smooth at a whole one."""
    y, x = np.mgrid[-32:32, -32:32]
    cell = 3 * np.sqrt(np.maximum(1 - (y**2 + x**2) / 22**2, 0))
    disc = np.hypot(y + 2, x - 2) < 8
    frames = [cell + 8 * s * disc for s in np.linspace(0, 1, 20)]
    phase = np.stack([np.stack(frames)] * 2, axis=1)
    errors = [error_of(stack_of(phase, 0.7, seed), phase < 0.01) for seed in range(4)]
    assert max(errors) <= 0.1, errors


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["tilt per frame", "level per frame", "jump of level"])
def test_every_frame_has_its_own_level_and_tilt(fault: str) -> None:
    exact = object_("vacuole")
    data = with_fault(exact, fault, 0.3, seed=RNG_SEED)
    assert error_of(data, empty_of(exact)) <= 0.001
    assert "lost_frames" not in p4d.unwrap(data["wrapped"], WL1).attrs


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_sparse_time_lapse(noise: float) -> None:
    """Two cells change by up to 7 rad and move by some pixels from frame to frame."""
    y, x = np.mgrid[:48, :48]
    peaks = np.array([[3.0, 8], [9, 2], [4, 9], [11, 3]])
    places = np.array([[(14, 14), (32, 34)], [(17, 13), (30, 37)], [(13, 16), (35, 33)],
                       [(16, 18), (32, 30)]])  # fmt: skip
    phase = np.zeros((4, 1, 48, 48))
    for t, cell in np.ndindex(4, 2):
        cy, cx = places[t, cell]
        phase[t, 0] += peaks[t, cell] * np.exp(-((y - cy) ** 2 + (x - cx) ** 2) / 40)
    data, empty = stack_of(phase, noise), phase < 0.05
    assert error_of(data, empty) <= 0.001
    assert error_of(data, empty, "temporal") > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["dead pixels", "hot pixels"])
def test_dead_pixels(fault: str) -> None:
    exact = object_("ring")
    data = with_fault(exact, fault, 0.5, seed=RNG_SEED)
    assert error_of(data, empty_of(exact)) <= 0.001


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("lamella", 0.015), ("vacuole", 0.003)])
def test_much_noise(name: str, most: float) -> None:
    data = with_noise(object_(name), 0.7, seed=RNG_SEED)
    assert error_of(data, empty_of(object_(name))) <= most


@pytest.mark.slow
def test_a_recording_turned_round_gives_the_same_turned_round() -> None:
    values = with_noise(object_("ring"), 0.5, seed=RNG_SEED)["wrapped"].values
    plain = p4d.unwrap(values, WL1, boundary=(0, 0)).values
    for turn in (
        lambda v: v[..., ::-1],
        lambda v: v[..., ::-1, :],
        lambda v: np.swapaxes(v, 2, 3),
        np.negative,
    ):
        there = np.ascontiguousarray(turn(values))
        back = turn(p4d.unwrap(there, WL1, boundary=(0, 0)).values)
        assert int((np.abs(back - plain) > np.pi).sum()) <= 3


# ---- lost frames, level and tilt ------------------------------------------------------------


@pytest.mark.parametrize("rises", [(0.0, 0.0), (1.3, -0.7), (-5.1, 3.3)])
def test_the_plane_of_a_border_is_found(rises: tuple[float, float]) -> None:
    """Three quarters of the values lie on it, the rest anywhere."""
    rng = np.random.default_rng(2)
    y, x = (rng.uniform(-30, 30, 400) for _ in range(2))
    values = 0.8 + rises[0] / 60 * y + rises[1] / 60 * x + 0.1 * rng.normal(size=400)
    values[:100] = rng.uniform(-np.pi, np.pi, 100)
    level, tilt, near = tilt_of(turned(values).astype(np.float64), y, x, 0.5)
    assert abs(math.remainder(level - 0.8, TURN)) < 0.03
    np.testing.assert_allclose(tilt * 60, rises, atol=0.1)
    assert 300 <= near <= 340


def test_tilts_are_taken_off_where_they_are_and_nowhere_else() -> None:
    exact = object_("vacuole")
    flat = find_background(with_noise(exact, 0.2, seed=1)["wrapped"].values)
    assert not flat.tilt.any()
    tilt = np.array([[0.05, -0.03]])
    values = turned(exact["phase"].values + plane(tilt, (64, 64)))
    found = find_background(values)
    np.testing.assert_allclose(found.tilt, np.broadcast_to(tilt, found.tilt.shape), rtol=0.005)


# ---- averages, links and followed steps -----------------------------------------------------


@pytest.mark.parametrize("kind", [np.float32, np.complex64])
@pytest.mark.parametrize("axes", [(0, 1, 2, 3), (2, 3), (0,)])
def test_box_mean_is_that_of_scipy(kind: type, axes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(5, 2, 7, 6)).astype(kind)
    if kind is np.complex64:
        values += 1j * rng.normal(size=values.shape).astype(np.float32)
    sizes = [3 if axis in axes and n >= 3 else 1 for axis, n in enumerate(values.shape)]
    expected = ndimage.uniform_filter(values, sizes, mode="reflect")
    np.testing.assert_allclose(box_mean(values.copy(), axes), expected, atol=2e-6)
    known = rng.random(values.shape) < 0.7
    share = ndimage.uniform_filter(known.astype(np.float32), sizes, mode="reflect")
    expected = ndimage.uniform_filter(values * known, sizes, mode="reflect")
    found = known_mean((values * known).astype(kind), known, axes)
    np.testing.assert_allclose(found, expected / np.maximum(share, 1e-3), atol=1e-4)


def test_changes_on_both_sides_by_their_formula() -> None:
    rng = np.random.default_rng(4)
    step = rng.normal(size=(1, 1, 1, 6)).astype(np.float32)
    g = step.ravel()
    valid = np.array([1, 1, 1, 0, 1, 0], dtype=bool).reshape(step.shape)
    found = change_on_both_sides(step, 3, valid).ravel()
    before, after = abs(g[1] - g[0]), abs(g[2] - g[1])
    expected = [2 * before, before + after, 2 * after, 0, 2 * abs(g[4]), 0]
    np.testing.assert_allclose(found, np.square(expected), rtol=1e-5)


def moving_ramp() -> np.ndarray:
    """Return a plane that rises along x and y and with time, many turns in all."""
    t, a, y, x = np.ogrid[:12, :2, :32, :32]
    return 0.9 * x - 0.6 * y + 1.1 * t + 0.4 * a


def test_noise_is_averaged_out_along_the_slope_without_bias() -> None:
    exact, noise = moving_ramp(), 0.5
    data = stack_of(exact, noise)["wrapped"].values
    yes, none = np.ones(exact.shape, bool), np.zeros(exact.shape, np.int8)
    found, left = along_slope(data, yes, none, noise)
    inside = (slice(1, -1), slice(None), slice(2, -2), slice(2, -2))
    rest = turned(found - exact)[inside]
    before = turned(data - exact)[inside]
    assert rest.std() < 0.35 * before.std()
    assert abs(rest.mean() - before.mean()) < 0.005
    # What it says is left is what is left.
    assert np.sqrt(left[inside].mean()) * noise == pytest.approx(rest.std(), rel=0.35)


def test_no_average_over_what_does_not_count_or_is_no_neighbour() -> None:
    exact, noise = moving_ramp(), 0.3
    data = stack_of(exact, noise)["wrapped"].values
    yes, none = np.ones(exact.shape, bool), np.zeros(exact.shape, np.int8)
    valid = yes.copy()
    valid[..., 16:] = False
    found, left = along_slope(data, valid, none, noise)
    np.testing.assert_array_equal(found[..., 16:], data[..., 16:])
    np.testing.assert_array_equal(left[..., 16:], 1)
    # Beyond a seam lies another level, which does not leak.
    seams = none.copy()
    seams[..., 16:] = 1
    level = np.where(seams > 0, np.float32(2), np.float32(0))
    parted, _ = along_slope(data, yes, seams, noise)
    lifted, _ = along_slope(turned(data + level), yes, seams, noise)
    np.testing.assert_allclose(turned(lifted - parted - level), 0, atol=1e-5)


def test_averages_are_the_same_however_many_rows_are_taken_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(RNG_SEED)
    data = rng.uniform(-3, 3, (7, 2, 41, 30)).astype(np.float32)
    valid = rng.random(data.shape) > 0.1
    seams = np.zeros(data.shape, np.int8)
    seams[:, :, 19:] = 1
    monkeypatch.setattr(neighbours, "ROWS", 1000)
    whole = along_slope(data, valid, seams, 0.5)
    for rows in (4, 9, 20):
        monkeypatch.setattr(neighbours, "ROWS", rows)
        for found, expected in zip(along_slope(data, valid, seams, 0.5), whole, strict=True):
            np.testing.assert_array_equal(found, expected)
    # And where only some times are asked for.
    some = slice(2, 5)
    for found, expected in zip(along_slope(data, valid, seams, 0.5, some), whole, strict=True):
        np.testing.assert_array_equal(found, expected[some])


def test_changes_beyond_half_a_turn_are_found_as_a_map() -> None:
    y, x = np.mgrid[-20:20, -20:20]
    change = np.stack([h * np.exp(-(y**2 + x**2) / 80) for h in (1.5, 5.0, -9.0)])[:, None]
    inside = np.ones(change.shape, bool)
    bare = np.abs(change) < 0.01
    found = turned(change) + TURN * turns_of_maps(turned(change), inside, bare)
    np.testing.assert_allclose(found, change, atol=1e-5)
    # Small changes stay as they are, and so does what does not count.
    rough = np.random.default_rng(0).uniform(-1.9, 1.9, change.shape).astype(np.float32)
    assert turns_of_maps(rough, inside, bare) is None
    inside[..., 25:] = False
    lifts = turns_of_maps(turned(change), inside, bare)
    assert not lifts[..., 25:].any()
    part = turned(change) + TURN * lifts
    np.testing.assert_allclose(part[..., :25], change[..., :25], atol=1e-5)


def test_without_empty_field_only_what_has_a_smooth_edge_counts_as_changed_by_a_turn() -> None:
    y, x = np.mgrid[-20:20, -20:20]
    radius = np.hypot(y, x)
    bump, wall = 5 * np.exp(-(radius**2) / 80), 2.3 * (radius < 8) + 2.3 * (radius < 9.5)
    change = np.stack([bump, wall, bump + 0.9])[:, None]
    inside = np.ones(change.shape, bool)
    lifts = turns_of_maps(turned(change), inside, np.zeros_like(inside))
    found = turned(change) + TURN * lifts
    np.testing.assert_allclose(found[[0, 2]], change[[0, 2]], atol=1e-5)
    assert not lifts[1].any()
    # With empty field round it, the inside of the wall is what its map says.
    with_field = turns_of_maps(turned(change), inside, np.abs(change) < 0.01)
    np.testing.assert_array_equal(with_field[1, 0] == 1, radius < 8)


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_what_a_growing_rim_encloses_does_not_sink(noise: float) -> None:
    """A bud's rim grows by more than half a turn; all that is inside sank by a turn each time."""
    every = p4d.simulation.budding_yeast((64, 64))
    exact = every.isel(time=slice(None, None, 2))
    empty = np.abs(exact["phase"].values) < 0.1
    data = with_noise(exact, noise, seed=RNG_SEED)
    assert error_of(data, empty) <= 0.5  # 3.1 before, that of T/A 0.8
    # The same whatever the frames are looked at together.
    whole = p4d.unwrap(data["wrapped"], WL1).values
    for frames in (1, 3):
        with pytest.MonkeyPatch.context() as patch:
            for part in (steps, changes):
                patch.setattr(part, "working_frames", lambda _, n=frames: n)
            np.testing.assert_array_equal(p4d.unwrap(data["wrapped"], WL1).values, whole)


@pytest.mark.parametrize("side", [1, -1])
def test_a_change_is_denied_where_both_frames_by_themselves_differ_by_less(side: int) -> None:
    """A ring rises by 4.6 rad, which looks like -1.7; what it encloses by 1.9, which does not."""
    y, x = np.mgrid[-30:31, -30:31]
    r = np.hypot(y, x)
    inside, ring = r < 10, (r >= 10) & (r < 13)

    def denied(
        first: np.ndarray, change: np.ndarray, lifted: np.ndarray, *, few: bool = False
    ) -> np.ndarray:
        phase = side * np.stack([first, first + change])[:, None]
        empty = np.broadcast_to(r > 20, phase.shape)
        seen = Seen(turned(phase).astype(np.float32), empty, np.ones(phase.shape, bool), None)
        step = turned(seen.phase[1, 0] - seen.phase[0, 0]) + np.float32(side * TURN) * lifted
        return Denied(seen, few=few)(0, 0, step.astype(np.float32))

    first = 2.0 * ring + 0.4 * inside
    np.testing.assert_array_equal(denied(first, 4.6 * ring + 1.9 * inside, -1 * inside), inside)
    # Wherever the frames wrap, and whatever the turns of their fields.
    for level in (2.0, 3.0):
        found = denied(first + level, 4.6 * ring + 1.9 * inside, -1 * inside)
        np.testing.assert_array_equal(found, inside)
    # Of few frames all that is not empty is.
    few = denied(first, 4.6 * ring + 1.9 * inside, -1 * inside, few=True)
    np.testing.assert_array_equal(few, r <= 20)
    # But not where more is lifted than is denied: a ring round it.
    more = (r > 15) & (r <= 19)
    rise = 4.6 * ring + 1.9 * inside + 4.6 * more
    lifted = -1 * inside + 1 * more
    np.testing.assert_array_equal(denied(first, rise, lifted, few=True), inside)
    # Frames that are steep there know nothing.
    steep = 2.0 * ring - 0.3 * inside
    assert not denied(steep, 4.6 * ring + 1.9 * inside, -1 * inside).any()
    # An edge that is torn by it says nothing.
    assert not denied(first, 4.6 * ring + 1.3 * inside, -1 * inside).any()
    # A hill that rises so far is affirmed, one that passes half a turn in a ring is no part.
    hill = np.exp(-(r**2) / 60)
    for level in (0.0, 3.0):
        assert not denied(hill + level, 5 * hill, 5 * hill > np.pi).any()
    assert not denied(first, 4.6 * ring + 1.9 * inside, 1 * (ring & (r < 11))).any()


@pytest.mark.parametrize("start", [0, 5])
def test_a_step_is_followed_from_where_it_is_small(start: int) -> None:
    """It grows away from the start, to more than a turn."""
    times = np.abs(np.arange(12) - start)
    step = np.broadcast_to((1.1 * times)[:, None, None, None], (12, 1, 6, 6)).astype(np.float32)
    yes = np.ones(step.shape, bool)
    followed, doubt = followed_from(start, turned(step), yes)
    np.testing.assert_allclose(followed, step, atol=1e-5)
    # Its changes on the way are its doubt.
    np.testing.assert_allclose(doubt[start], 0)
    np.testing.assert_allclose(doubt[np.arange(12) != start], 2.2, rtol=1e-4)
    # What was not seen in between can't be followed.
    valid = yes.copy()
    valid[start + 2] = False
    doubt = followed_from(start, turned(step), valid)[1]
    assert np.isinf(doubt[start + 2 :]).all()
    assert np.isfinite(doubt[: start + 2]).all()


def followed_from(
    start: int, step: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Follow steps through all times, first from the start on, then back from there."""
    every, none = Block(0, len(step)), np.zeros(step.shape, bool)
    steps = Along(step, step, valid, valid, none)
    floors = Floors({3: 0.0}, {3: (0.0, 1.0)})
    seen = Seen(step, none, valid, None)
    course, rough = courses_of(3, steps, None, floors, seen, every, every), np.zeros_like(step)
    ahead = follow(course, step, rough, Block(start, len(step)), None, forward=True)
    if start == 0:
        return ahead
    first = ahead[0][0], ahead[1][0]
    behind = follow(course, step, rough, Block(0, start), first, forward=False)
    return np.concatenate([behind[0], ahead[0]]), np.concatenate([behind[1], ahead[1]])
