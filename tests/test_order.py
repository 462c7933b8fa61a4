"""Frames in the order of their names, and plain arrays with time as their last axis, are told."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.stacks import doubts_of, wrapped_stack

Stack = NDArray[np.float64]
SHAPES = ("translating", "dividing", "swelling", "touching")


def moving(shape: str, n_times: int, noise: float) -> Stack:
    """Return wrapped phase (time, angle, y, x) of an object that moves or grows."""
    exact = p4d.simulation.moving_shape(shape, (64, 64), n_times, angles_deg=(0.0, 6.0))
    values = exact["phase"].transpose("time", "angle", "y", "x").values.astype(np.float64)
    return wrap(values + noise * np.random.default_rng(1).standard_normal(values.shape))


def by_name(frames: Stack, first: int = 1) -> Stack:
    """Return frames in the order of their numbers as text."""
    names = sorted(range(first, first + len(frames)), key=str)
    return frames[[name - first for name in names]]


def heard_of(phase: object) -> list[str]:
    """Return what is warned of when phase comes in."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        wrapped_stack(phase)
    return [str(each.message) for each in heard]


@pytest.mark.slow
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("n_times", [24, 110])
@pytest.mark.parametrize("shape", SHAPES)
def test_frames_in_the_order_of_their_names_are_told(shape: str, n_times: int, first: int) -> None:
    """They are in noise, and none is that is in order, backwards or thinned out."""
    frames = moving(shape, n_times, 0.2)
    (said,) = heard_of(by_name(frames, first))
    assert "1, 10, 11, 2" in said
    assert "sort the files by their numbers" in said
    for right in (
        frames,
        frames[::-1],
        frames[::2],
        by_name(frames)[np.argsort(by_name_of(n_times))],
    ):
        assert heard_of(right) == []


def by_name_of(n_times: int) -> list[int]:
    """Return the numbers of frames, from 0, in the order of their names from 1."""
    return [name - 1 for name in sorted(range(1, n_times + 1), key=str)]


@pytest.mark.slow
def test_no_result_of_frames_out_of_order_is_safe() -> None:
    """The verdict says why."""
    frames = by_name(moving("translating", 24, 0.1))
    with pytest.warns(UserWarning, match="in the order of their names"):
        found = p4d.compare(frames, ("directional-l1", "spatial-2d"))
    assert not found.verdict.is_safe
    assert "No result is safe: the wrapped phase seems to have its frames in the order 1, 10" in (
        found.verdict
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda w: np.repeat(w[:12], 2, axis=0),  # a camera that gives each frame twice
        lambda w: np.concatenate([w, w[::-1]]),  # to and fro
        lambda w: np.repeat(w[:1], 24, axis=0),  # one that stands still
        lambda w: w[[0, 12] * 12],  # one that flickers
        lambda w: np.where(np.arange(24)[:, None, None, None] % 5 == 3, np.nan, w),
    ],
    ids=["twice", "to and fro", "still", "flickering", "lost"],
)
@pytest.mark.parametrize("shape", SHAPES)
def test_other_recordings_are_in_order(shape: str, change: object) -> None:
    """No odd recording is taken for one whose frames were sorted by name."""
    frames = moving(shape, 24, 0.1)
    assert callable(change)
    assert not [said for said in heard_of(change(frames)) if "order" in said]


@pytest.mark.slow
def test_what_tells_the_order_is_read_from_any_layout_in_part() -> None:
    """Dims in another order give the same, and a lazy stack is not read whole."""
    frames = by_name(moving("translating", 60, 0.1))
    stack = xr.DataArray(frames, dims=("time", "angle", "y", "x"))
    turned = stack.transpose("y", "time", "x", "angle")
    assert [d.verdict for d in doubts_of(turned)] == [d.verdict for d in doubts_of(stack)]
    assert len(doubts_of(stack)) == 1

    read: set[int] = set()

    def block(
        part: Stack, block_info: dict[int, dict[str, tuple[int, ...]]] | None = None
    ) -> Stack:
        if block_info:
            read.add(block_info[0]["chunk-location"][0])
        return part

    lazy = stack.chunk(time=1)
    lazy = lazy.copy(data=lazy.data.map_blocks(block, dtype=lazy.dtype))
    assert len(doubts_of(lazy)) == 1
    assert len(read) < 50


def test_time_as_the_last_axis_is_told() -> None:
    """The axes (y, x, time) are those of Matlab; those of a narrow camera are left alone."""
    frames = moving("swelling", 12, 0.05)[:, 0]
    (said,) = heard_of(np.moveaxis(frames, 0, -1))
    assert "numpy.moveaxis(phase, -1, 0)" in said
    assert "64 frames of 64 x 12 pixels" in said
    assert heard_of(frames) == []
    assert heard_of(np.ascontiguousarray(frames[:, :, 24:40])) == []
    named = xr.DataArray(np.moveaxis(frames, 0, -1), dims=("time", "y", "x"))
    assert heard_of(named) == []  # which its axes' names say
    infinite = np.moveaxis(frames, 0, -1).copy()
    infinite[5:8] = np.inf
    assert len(heard_of(infinite)) == 1


@pytest.mark.parametrize("n_times", [12, 13, 16, 24, 40])
@pytest.mark.parametrize("period", [3, 5, 7, 10])
def test_what_beats_is_in_order(period: int, n_times: int) -> None:
    """Frames of the same phase of a beat are alike, however far from each other."""
    thick = 6 + 2 * np.sin(2 * np.pi * np.arange(n_times) / period)
    y, x = np.mgrid[:64, :64] - 32
    cell = np.sqrt(np.clip(1 - (y**2 + x**2) / 400, 0, None))
    noise = 0.1 * np.random.default_rng(period).standard_normal((n_times, 64, 64))
    assert heard_of(wrap(thick[:, None, None] * cell + noise)) == []
