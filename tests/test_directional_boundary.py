"""What the boundary frame is worth to the project's own methods."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from napari_phase4d.simulation import hard_shape, moving_shape, with_noise
from napari_phase4d.stack import Block
from napari_phase4d.task import UNWATCHED, Watch
from napari_phase4d.unwrapping.directional import following
from napari_phase4d.unwrapping.directional.following import is_thin, starting_thin, steep_steps
from napari_phase4d.unwrapping.directional.groups import heavier, weight_of
from napari_phase4d.unwrapping.directional.methods import prepared
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import Opinion, Weighed
from napari_phase4d.unwrapping.problem import Problem
from test_directional_hard import empty_of, error_of


def second_half(make: Callable[..., xr.Dataset], name: str, step: int = 3) -> xr.Dataset:
    """Return an object that is thick from the start, seen from two sides."""
    exact = make(name, angles_deg=(0.0, 6.0))
    return exact.isel(time=slice(exact.sizes["time"] // 2, None, step))


def scene_of(data: xr.Dataset, boundary: tuple[int, int] = (0, 0)) -> Scene:
    problem = Problem(data["wrapped"], boundary=boundary)
    return prepared(problem, UNWATCHED).scene


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


def test_of_one_time_there_is_nothing_to_be_thinner_than() -> None:
    data = moving_shape("swelling", angles_deg=(0.0, 6.0)).isel(time=slice(10, 11))
    assert not is_thin(scene_of(data), Watch(1, ""))


def test_steep_steps_are_those_of_the_object_beyond_a_radian_and_a_half() -> None:
    """A block of four by four pixels that rises by 1 rad, then 2 rad, above an empty field."""
    phase = np.zeros((2, 1, 40, 40), np.float32)
    for time, height in enumerate((1.0, 2.0)):
        phase[time, 0, 18:22, 17:21] = height
    scene = scene_of(xr.Dataset({"wrapped": (("time", "angle", "y", "x"), phase)}))
    assert [steep_steps(scene, time) for time in (0, 1)] == [0, 16]
    # Their share that another frame may have less.
    assert is_thin(scene, Watch(1, ""))


@pytest.mark.parametrize("times", [1, 20, 1000.0])
def test_heavier_steps_weigh_so_many_times_as_much(times: float) -> None:
    rough = np.linspace(1, 30, 50, dtype=np.float32)
    np.testing.assert_allclose(
        weight_of(heavier(rough, times)), times * weight_of(rough), rtol=1e-4
    )


def test_only_steps_within_the_boundary_frame_that_are_not_smooth_weigh_more() -> None:
    rough = np.linspace(6, 0, 2 * 3 * 4 * 5, dtype=np.float32).reshape(2, 3, 4, 5)
    none = np.zeros(rough.shape, bool)

    def steps_of(start: int) -> Weighed:
        turns = none.astype(np.int16)
        every = {axis: Opinion(turns, rough.copy(), ~none, none) for axis in range(4)}
        return Weighed(Block(start, start + 2), ~none, every)

    first = rough[0].copy()
    first[first > 1] = np.maximum(heavier(first[first > 1], following.AUTHORITY), 1)
    assert (first < rough[0]).any()
    for weighed in starting_thin([steps_of(4), steps_of(2)], 4):
        for axis, own in weighed.by_axis.items():
            expected = rough.copy()
            if weighed.block.start == 4 and axis > 1:
                expected[0] = first
            np.testing.assert_allclose(own.rough, expected, rtol=1e-6)
