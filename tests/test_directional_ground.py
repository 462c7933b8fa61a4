"""The empty field is followed from frame to frame: a sheet whole turns above it is not it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray

import napari_phase4d as p4d
from napari_phase4d.unwrapping.directional.ground import Grounds, islands_of

TURN = 2 * np.pi
SHAPE = (64, 80)


def front(height: float, width: float, speed: float, noise: float, seed: int = 0) -> NDArray:
    """Return the phase of a sheet that grows over the view from one side, noise and all."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    clean = np.empty((26, 2, *SHAPE))
    for t, view in np.ndindex(26, 2):
        edge = 9 + speed * t + 5 * np.sin(y / 9) + 3 * view
        clean[t, view] = height / (1 + np.exp((x - edge) / width))
    return clean + np.random.default_rng(seed).normal(0, noise, clean.shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("height", "width", "noise"),
    [(6.3, 0.8, 0.6), (12.6, 1.3, 0.0), (12.6, 1.3, 0.5), (18.9, 2.5, 0.0), (19.8, 2.5, 0.4)],
)
def test_a_sheet_that_grows_over_the_view_is_not_pulled_down(
    height: float, width: float, noise: float
) -> None:
    """Held at the level of the field, as the largest flat island is, it would be turns low."""
    phase = front(height, width, 2.2, noise)
    wrapped = np.angle(np.exp(1j * phase)).astype(np.float32)
    found = p4d.unwrap(wrapped, "directional-l1").values
    wrong = np.round((found - phase) / TURN) != 0
    assert wrong.mean() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("peak", "rise", "fall", "noise"),
    [(9, 0.12, 3.0, 0.0), (7, 0.3, 2.5, 0.5), (12, 0.5, 4.0, 0.3)],
)
def test_field_behind_a_sheer_wall_is_field(
    peak: float, rise: float, fall: float, noise: float
) -> None:
    """One side of a bar that crosses the view tells nothing: no way leads to what is behind."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    clean = np.empty((24, 1, *SHAPE))
    for t in range(24):
        edge = 8 + 1.6 * t + 1.5 * np.sin(y / 7)
        clean[t, 0] = peak / (1 + np.exp((edge - x) / rise)) / (1 + np.exp((x - edge - 22) / fall))
    phase = clean + np.random.default_rng(1).normal(0, noise, clean.shape)
    found = p4d.unwrap(np.angle(np.exp(1j * phase)).astype(np.float32), "directional-l1").values
    assert (np.round((found - phase) / TURN) != 0).mean() < 0.01


def islands_in(frame: list[str]) -> NDArray[np.int32]:
    """Return the number of each pixel's island, by letters; -1 for dots."""
    rows = np.array([list(row) for row in frame])
    names = sorted(set(rows.ravel().tolist()) - {"."})
    found = np.full(rows.shape, -1, dtype=np.int32)
    for number, name in enumerate(names):
        found[rows == name] = number
    return found


def chosen(frames: list[list[str]], start: int = 0) -> list[str]:
    """Return the letters of the islands that hold the level of each frame; "" for none."""
    numbers = np.stack([islands_in(frame) for frame in frames])[:, None]
    scene = SimpleNamespace(
        shape=numbers.shape,
        frames=SimpleNamespace(shape=numbers.shape, start=(start, 0)),
        islands_as_seen=lambda block: numbers[block.start : block.stop],
    )
    grounds = Grounds(scene)  # type: ignore[arg-type] # all that it asks of a scene
    for t, own in enumerate(numbers[:, 0]):
        count = int(own.max()) + 1
        # Groups are told apart by numbers of their own: a hundred for each frame.
        of_group = np.column_stack([100 * t + np.arange(count), np.zeros(count)]).astype(int)
        listed = islands_of(own, own, of_group)
        if listed is not None:
            grounds.islands[t, 0] = listed
    found = grounds.followed()[:, 0, 0]
    names = [sorted(set("".join(frame)) - {"."}) for frame in frames]
    return [names[t][g - 100 * t] if g >= 0 else "" for t, g in enumerate(found)]


def test_what_was_field_holds_the_level_where_the_sheet_is_larger() -> None:
    frames = [
        ["..aaaaaa", "..aaaaaa"],
        ["s..aaaaa", "s..aaaaa"],
        ["sss..aaa", "sss..aaa"],
        ["sssss..a", "sssss..a"],
        ["ssssssss", "ssssssss"],
    ]
    assert chosen(frames) == ["a", "a", "a", "a", ""]
    assert chosen(frames[::-1], start=4) == ["", "a", "a", "a", "a"]


def test_a_field_that_parts_is_held_by_its_largest_piece() -> None:
    frames = [
        ["aaaaaaaa", "aaaaaaaa"],
        ["aa..bbbb", "aa..bbbb"],
        ["a.cc.bb.", "a.cc.bb."],
        ["aaaaaaaa", "aaaaaaaa"],
    ]
    assert chosen(frames) == ["a", "b", "b", "a"]


def test_it_begins_anew_where_all_lies_elsewhere() -> None:
    """The stage has moved: nothing says that what lies there now was anything else."""
    assert chosen([["aaaa....", "aaaa...."], [".....bbb", ".....bbb"]]) == ["a", "b"]


def test_a_frame_without_field_is_passed_over() -> None:
    frames = [["aaa.", "aaa."], ["....", "...."], ["aaa.", "aaa."]]
    assert chosen(frames) == ["a", "", "a"]


def test_where_the_start_shows_none_it_begins_at_the_largest() -> None:
    frames = [["....", "...."], ["b..a", "b.aa"], ["b.aa", "b.aa"]]
    assert chosen(frames) == ["", "a", "a"]


def test_islands_are_listed_with_their_pixels() -> None:
    numbers = islands_in(["aab.", "aab."])
    found = islands_of(numbers, numbers, np.array([[7, 1], [9, -2]]))
    assert found is not None
    np.testing.assert_array_equal(found.listed, [[0, 7, 1, 4], [1, 9, -2, 2]])
    assert found.largest == 0
    none = np.full((2, 2), -1, np.int32)
    assert islands_of(none, none, np.empty((0, 2), np.int32)) is None
