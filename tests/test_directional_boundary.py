"""What is known from the boundary frame on: the frame itself, and changes that go on as before."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
import scipy.ndimage
import xarray as xr
from numpy.typing import NDArray

import napari_phase4d as p4d
from napari_phase4d.phasors import turned
from napari_phase4d.simulation import hard_shape, moving_shape, with_noise
from napari_phase4d.stack import Block, Memory
from napari_phase4d.task import UNWATCHED, Watch
from napari_phase4d.unwrapping.directional import changes, following
from napari_phase4d.unwrapping.directional.changes import (
    going_on,
    lifts_of_changes,
    maps_of,
    turns_of_maps,
)
from napari_phase4d.unwrapping.directional.following import followed_steps, is_thin, steep_steps
from napari_phase4d.unwrapping.directional.groups import CERTAIN, heavier, weight_of
from napari_phase4d.unwrapping.directional.methods import prepared
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import Floors
from napari_phase4d.unwrapping.problem import Problem
from test_directional import Still
from test_directional_hard import TURN, empty_of, error_of


def second_half(make: Callable[..., xr.Dataset], name: str, step: int = 3) -> xr.Dataset:
    """Return an object that is thick from the start, seen from two sides."""
    exact = make(name, angles_deg=(0.0, 6.0))
    return exact.isel(time=slice(exact.sizes["time"] // 2, None, step))


def scene_of(data: xr.Dataset, boundary: tuple[int, int] = (0, 0)) -> Scene:
    problem = Problem(data["wrapped"], boundary=boundary)
    return prepared(problem, UNWATCHED).scene


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "name", "step", "noise"),
    [
        (hard_shape, "growing wall", 3, 0.0),
        (hard_shape, "growing wall", 3, 0.15),
        (moving_shape, "translating", 3, 0.0),
        (moving_shape, "translating", 1, 0.3),
    ],
)
def test_the_boundary_frame_outvotes_thicker_ones(
    make: Callable[..., xr.Dataset],
    name: str,
    step: int,
    noise: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Steep from the start, and steeper after: most frames by themselves are a turn too low."""
    exact = second_half(make, name, step)
    data = with_noise(exact, noise, seed=5)
    assert error_of(data, empty_of(exact)) <= 0.1
    monkeypatch.setattr(following, "is_thin", lambda *_: False)
    assert error_of(data, empty_of(exact)) >= 1


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.15])
def test_a_thick_boundary_frame_decides_nothing(
    noise: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cell becomes thin only afterwards."""
    exact = second_half(moving_shape, "returning")
    data = with_noise(exact, noise, seed=5)
    assert not is_thin(scene_of(data), Watch(1, ""))
    assert is_thin(scene_of(data, (-1, 0)), Watch(1, ""))
    assert error_of(data, empty_of(exact)) <= 0.05
    monkeypatch.setattr(following, "is_thin", lambda *_: True)
    assert error_of(data, empty_of(exact)) >= 1


@pytest.mark.parametrize("first_column", [40, 64])
def test_a_cell_that_leaves_has_not_become_thin(first_column: int) -> None:
    """Of the last frame a part is left, or nothing."""
    exact = second_half(hard_shape, "growing wall")
    phase = exact["phase"].values.copy()
    phase[-1] = np.roll(phase[-1], first_column, -1)
    phase[-1, ..., :first_column] = 0
    data = with_noise(exact.assign(phase=exact["phase"].copy(data=phase)), 0.05, seed=5)
    scene = scene_of(data)
    (steep, _), *_, (left, _) = (steep_steps(scene, time) for time in range(scene.shape[0]))
    assert left < steep / 3
    assert is_thin(scene, Watch(1, ""))


def test_of_one_time_there_is_nothing_to_be_thinner_than() -> None:
    data = moving_shape("swelling", angles_deg=(0.0, 6.0)).isel(time=slice(10, 11))
    assert not is_thin(scene_of(data), Watch(1, ""))


def test_thin_is_what_has_few_steps_beyond_a_radian_and_a_half() -> None:
    """A block of four by four pixels that rises by 1 rad, then 2 rad, above an empty field."""
    phase = np.zeros((2, 1, 40, 40), np.float32)
    for time, height in enumerate((1.0, 2.0)):
        phase[time, 0, 18:22, 17:21] = height
    data = xr.Dataset({"wrapped": (("time", "angle", "y", "x"), phase)})
    scene = scene_of(data)
    assert [steep_steps(scene, time)[0] for time in (0, 1)] == [0, 16]
    assert is_thin(scene, Watch(1, ""))
    assert not is_thin(scene_of(data, (1, 0)), Watch(1, ""))


@pytest.mark.parametrize("times", [1, 20, 1000.0])
def test_heavier_steps_weigh_so_many_times_as_much(times: float) -> None:
    rough = np.linspace(1, 30, 50, dtype=np.float32)
    np.testing.assert_allclose(
        weight_of(heavier(rough, times)), times * weight_of(rough), rtol=1e-4
    )


@pytest.mark.parametrize("amplitude", [None, 0.5])
@pytest.mark.parametrize("start", [0, 1])
def test_only_steps_within_the_boundary_frame_weigh_more_and_none_that_fades(
    amplitude: float | None, start: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half the amplitude counts as a roughness of 2 rad, which stays."""
    phase = np.random.default_rng(4).uniform(-3, 3, (3, 2, 9, 9)).astype(np.float32)
    bright = None if amplitude is None else np.full(phase.shape, amplitude, np.float32)
    still = Still(phase, np.zeros(phase.shape, bool), bright)
    still.start = (start, 0)
    scene = Scene(still, np.zeros((3, 2, 2), np.intp), (slice(0, 9), slice(0, 9)))
    floors = Floors(dict.fromkeys(range(4), 0.0), dict.fromkeys((2, 3), (0.0, 1.0)))
    rough = []
    for thin in (False, True):
        monkeypatch.setattr(following, "is_thin", lambda *_, found=thin: found)
        steps = followed_steps(scene, floors, Watch(1, ""), frames=3)
        parts = {part.block.start: part.by_axis for part in steps}
        rough.append({(at, axis): o.rough for at in parts for axis, o in parts[at].items()})
    fade = 0 if amplitude is None else 2
    for (at, axis), plain in rough[0].items():
        expected = plain.copy()
        if at == start and axis > 1:
            first = expected[0] - fade
            assert (first > CERTAIN).all()
            expected[0] = np.maximum(heavier(first, following.AUTHORITY), CERTAIN) + fade
        np.testing.assert_allclose(rough[1][at, axis], expected, rtol=1e-5)


# ---- changes that go on as before ------------------------------------------------------------


def test_what_a_steep_rim_encloses_goes_on_as_before() -> None:
    """A cell that rises by 2.4 rad from frame to frame, and by 5 rad in a ring round it."""
    radius = np.hypot(*np.mgrid[-20:20, -20:20])
    change = np.select([radius < 11, radius < 12], [2.4, 5.0]).astype(np.float32)
    known, bare = np.ones(change.shape, bool), change == 0
    wrapped = turned(change)
    lifts = turns_of_maps(wrapped[None, None], known[None, None], bare[None, None])[0, 0]
    inside = np.isclose(change, np.float32(2.4))
    assert (lifts[inside] == -1).all()  # the ring by itself tells no other
    assert not going_on(wrapped, known, lifts, change)[inside].any()
    # What came before was the leap itself, or something else, or is not alike all over.
    for before in (
        change - np.float32(TURN),
        0 * change,
        np.where(np.indices(change.shape)[0] % 2, change, 0),
    ):
        np.testing.assert_array_equal(going_on(wrapped, known, lifts, before), lifts)


@pytest.mark.parametrize("start", [0, 5, 11])
def test_changes_are_followed_from_the_boundary_frame_to_both_sides(start: int) -> None:
    """The ring begins to grow too fast some frames before and after the boundary frame."""
    radius = np.hypot(*np.mgrid[-20:20, -20:20])
    inside, ring = radius < 11, (radius >= 11) & (radius < 12)
    phase = np.zeros((12, 1, 40, 40), np.float32)
    for time in range(12):
        away = time - start
        phase[time, 0][inside | ring] = 1 + 2.4 * away
        phase[time, 0][ring] += 2.6 * np.sign(away) * max(abs(away) - 3, 0)
    empty = np.broadcast_to(~(inside | ring), phase.shape)
    still = Still(turned(phase), empty)
    still.start = (start, 0)
    scene = Scene(still, np.zeros((12, 1, 2), np.intp), (slice(0, 40), slice(0, 40)))
    by_itself = maps_of(scene, Block(0, 12))[0].turns
    too_fast = np.array([max(abs(t - start), abs(t + 1 - start)) > 3 for t in range(11)])
    assert (by_itself[too_fast][:, 0, inside] == -1).all()
    assert not by_itself[~too_fast].any()
    # Every part goes on as before, so that nothing is lifted and no stack of it made.
    assert lifts_of_changes(scene, Memory(), Watch(1, "")) == {}
    still.start = (11 - start, 0)
    if start != 5:  # on the other side the first changes known are those that leap
        lifts = lifts_of_changes(scene, Memory(), Watch(1, ""))[0].read(Block(0, 11))
        assert (lifts[too_fast][:, 0, inside] == -1).all()


@pytest.mark.slow
def test_lifts_do_not_depend_on_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    exact = moving_shape("swelling", angles_deg=(0.0, 6.0)).isel(time=slice(None, None, 2))
    exact = exact.assign(phase=np.float32(1.25) * exact["phase"])
    data = with_noise(exact, 0.3, seed=5)
    found = []
    for start in (0, 4):
        for frames in (1, 3, 10):
            monkeypatch.setattr(changes, "working_frames", lambda _, n=frames: n)
            lifts = scene_of(data, (start, 0)).lifts
            found.append(lifts[0].read(Block(0, 9)))
            assert found[-1].any()
            np.testing.assert_array_equal(found[-1], found[-1 if frames == 1 else -2])


@pytest.mark.parametrize("start", [0, 4, 9])
def test_a_recording_turned_round_has_the_same_lifts_turned_round(start: int) -> None:
    exact = moving_shape("swelling", angles_deg=(0.0, 6.0)).isel(time=slice(None, None, 2))
    phase = turned(np.float32(1.25) * exact["phase"].values)
    empty = exact["phase"].values < 0.05
    found = []
    for way in (1, -1):
        still = Still(phase[::way], empty[::way])
        still.start = (start if way == 1 else 9 - start, 0)
        scene = Scene(still, np.zeros((10, 2, 2), np.intp), (slice(0, 64), slice(0, 64)))
        lifts = lifts_of_changes(scene, Memory(), Watch(1, ""))
        found.append(lifts[0].read(Block(0, 9))[::way])
    assert found[0].any()
    np.testing.assert_array_equal(found[0], -found[1])


def test_nothing_goes_on_from_what_is_not_known() -> None:
    """No empty field is in view of the first change, so that its level is not known."""
    radius = np.hypot(*np.mgrid[-20:20, -20:20])
    change = np.select([radius < 11, radius < 12], [2.4, 5.0]).astype(np.float32)
    phase = np.stack([0 * change, change, 2 * change])[:, None]
    empty = np.broadcast_to(change == 0, phase.shape).copy()
    for known in (True, False):
        empty[0] &= known
        still = Still(turned(phase), empty)
        scene = Scene(still, np.zeros((3, 1, 2), np.intp), (slice(0, 40), slice(0, 40)))
        maps = maps_of(scene, Block(0, 3))[0]
        if known:  # the first one is what it goes on from
            maps.turns[0] = 0
        maps.go_on_from(0, None)
        maps.go_on_from(1, (maps, 0))
        assert maps.turns[1, 0, 20, 20] == (0 if known else -1)


def test_a_cell_that_leaps_is_lifted() -> None:
    """It did not grow before: nothing goes on there."""
    change = (9 * np.exp(-(np.hypot(*np.mgrid[-20:20, -20:20]) ** 2) / 80)).astype(np.float32)
    known, bare = np.ones(change.shape, bool), change < 0.01
    lifts = turns_of_maps(turned(change)[None, None], known[None, None], bare[None, None])[0, 0]
    assert lifts.max() == 1
    np.testing.assert_array_equal(going_on(turned(change), known, lifts, 0 * change), lifts)
    np.testing.assert_array_equal(going_on(turned(change), known, lifts, change / 20), lifts)


def beating(
    peaks: Sequence[float], noise: float, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return phase (time, angle, y, x) of a cell that stays where it is, with noise, and exact."""
    y, x = np.mgrid[-16:16, -24:24]
    cell = np.clip(1 - (x / 13) ** 2 - (y / 12) ** 2, 0, None) ** 0.7
    cell = scipy.ndimage.gaussian_filter(cell, 0.8)
    exact = np.multiply.outer(peaks, cell[None] / cell.max())
    rng = np.random.default_rng(seed)
    return (exact + rng.normal(0, noise, exact.shape)).astype(np.float32), exact


@pytest.mark.parametrize(
    ("peaks", "noise", "seed"),
    [
        ((19.5, 18.1, 14.6, 18.5), 0.5, 0),
        ((19.5, 18.1, 14.6, 18.5), 0.3, 0),
        ((20, 19, 18, 14.5, 18.5, 15, 19, 15.5, 19), 0.3, 1),
    ],
)
def test_what_beats_to_and_fro_by_half_a_turn_does_not_go_on(peaks, noise, seed) -> None:
    """Put back by a turn, the way up looks like the way down; but no rim of it is steep."""
    phase, exact = beating(peaks, noise, seed)
    result = p4d.unwrap(turned(phase), "directional-l1").values
    turns = np.round((result - phase) / TURN)
    assert not (turns - np.median(turns[exact < 0.05])).any()


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_a_thick_cell_that_grows_steadily_keeps_its_level(
    noise: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    exact = moving_shape("swelling", angles_deg=(0.0, 6.0)).isel(time=slice(None, None, 2))
    exact = exact.assign(phase=np.float32(1.25) * exact["phase"])
    data = with_noise(exact, noise, seed=5)
    assert error_of(data, empty_of(exact)) <= 0.3
    monkeypatch.setattr(changes, "going_on", lambda *own: own[2])
    assert error_of(data, empty_of(exact)) >= 1
