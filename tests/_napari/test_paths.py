"""The map of frames in numbers: ways through the frames, round times, cells, by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from napari_phase4d._napari.widgets.map_picture import (
    Arrow,
    Grid,
    best_per_pixel,
    path_arrows,
    spread,
    time_ticks,
)


def ways(path: str, boundary: tuple[int, int], **limits: int) -> set[tuple[Any, Any, int]]:
    """Arrows over 4 times and 3 angles."""
    arrows = path_arrows(path, 4, 3, [boundary], **limits)
    assert len(set(arrows)) == len(arrows)
    return {(arrow.start, arrow.end, arrow.pass_number) for arrow in arrows}


def test_temporal_angular_is_fig_1a() -> None:
    assert ways("temporal-angular", (0, 0)) == {
        ((0, 0), (3, 0), 1),
        *(((t, 0), (t, 2), 2) for t in range(4)),
    }


def test_angular_temporal_is_fig_1b() -> None:
    assert ways("angular-temporal", (0, 0)) == {
        ((0, 0), (0, 2), 1),
        *(((0, a), (3, a), 2) for a in range(3)),
    }


def test_a_boundary_in_the_middle_is_left_both_ways() -> None:
    assert ways("temporal-angular", (1, 1)) == {
        ((1, 1), (3, 1), 1),
        ((1, 1), (0, 1), 1),
        *(((t, 1), (t, 2), 2) for t in range(4)),
        *(((t, 1), (t, 0), 2) for t in range(4)),
    }
    assert ways("angular-temporal", (2, 1)) == {
        ((2, 1), (2, 2), 1),
        ((2, 1), (2, 0), 1),
        *(((2, a), (3, a), 2) for a in range(3)),
        *(((2, a), (0, a), 2) for a in range(3)),
    }


def test_each_start_is_left_until_half_way_to_the_next() -> None:
    arrows = path_arrows("temporal", 10, 2, [(2, 0), (7, 0)])
    found = {(arrow.start, arrow.end) for arrow in arrows if arrow.start[1] == 0}
    assert found == {
        ((2, 0), (0, 0)),
        ((2, 0), (4, 0)),
        ((7, 0), (5, 0)),
        ((7, 0), (9, 0)),
    }
    # Two starts on lines of their own: each line of the first pass is left from its own.
    firsts = [
        a for a in path_arrows("temporal-angular", 4, 3, [(0, 0), (3, 2)]) if a.start[1] == 2
    ]
    assert Arrow((3, 2), (0, 2), 1) in firsts


def test_one_pass_goes_along_every_line() -> None:
    assert ways("temporal", (1, 2)) == {
        *(((1, a), (3, a), 1) for a in range(3)),
        *(((1, a), (0, a), 1) for a in range(3)),
    }
    assert ways("angular", (1, 2)) == {((t, 2), (t, 0), 1) for t in range(4)}


def test_the_first_pass_comes_first() -> None:
    numbers = [a.pass_number for a in path_arrows("angular-temporal", 4, 3, [(1, 1)])]
    assert numbers == sorted(numbers)


def test_fewer_arrows_where_they_would_crowd() -> None:
    arrows = path_arrows("temporal-angular", 600, 2, [(301, 0)], most_times=20)
    columns = [arrow.start[0] for arrow in arrows if arrow.pass_number == 2]
    assert columns == list(range(1, 600, 30))
    assert Arrow((301, 0), (599, 0), 1) in arrows
    assert ways("temporal", (0, 1), most_angles=1) == {((0, 1), (3, 1), 1)}


@pytest.mark.parametrize("count", [1, 5, 19, 20, 21, 39, 40, 5000])
def test_spread_is_even_and_never_too_many(count: int) -> None:
    for keep in {0, count // 3, count - 1}:
        chosen = spread(count, 20, keep)
        assert keep in chosen
        assert len(chosen) <= 20
        assert chosen[0] >= 0
        assert chosen[-1] < count
        assert len(set(np.diff(chosen))) <= 1


def test_no_path_and_a_single_frame_have_no_arrows() -> None:
    assert path_arrows(None, 4, 3, [(0, 0)]) == []
    assert path_arrows("temporal-angular", 1, 1, [(0, 0)]) == []


def test_wrong_paths_are_refused() -> None:
    with pytest.raises(ValueError, match="path is 'sideways'; it must be one of temporal-angular"):
        path_arrows("sideways", 4, 3, [(0, 0)])
    with pytest.raises(ValueError, match=r"boundary is \(4, 0\), but there are 4 times"):
        path_arrows("temporal", 4, 3, [(4, 0)])


def test_times_are_round() -> None:
    assert time_ticks(np.arange(40) / 6, 5) == [
        (0, "0 s"),
        (pytest.approx(12), "2 s"),
        (pytest.approx(24), "4 s"),
        (pytest.approx(36), "6 s"),
    ]
    assert time_ticks(np.arange(19) * 60.0, 4) == [(0, "0 min"), (10, "10 min")]
    assert time_ticks(np.arange(3) * 0.01, 3) == [(0, "0.00 s"), (1, "0.01 s"), (2, "0.02 s")]
    assert time_ticks(np.array([7.25]), 5) == [(0, "7.25 s")]
    assert [text for _, text in time_ticks(np.arange(0, 36_001, 600.0), 4)] == [
        "0 h",
        "5 h",
        "10 h",
    ]


def test_times_of_uneven_frames_stand_where_they_are() -> None:
    assert time_ticks(np.array([0, 1, 10.0]), 3) == [
        (0, "0 s"),
        (pytest.approx(1 + 4 / 9), "5 s"),
        (2, "10 s"),
    ]
    assert time_ticks(np.array([3.0, 1, 1]), 3) == [(0, "3 s"), (2, "1 s")]


def test_crowded_columns_hold_the_safest_frame() -> None:
    rng = np.random.default_rng(3)
    scores = rng.random((1003, 3)).astype(np.float32)
    scores[rng.random(scores.shape) < 0.3] = np.nan
    scores[:60] = np.nan
    found = best_per_pixel(scores, 100)
    pixel = ((np.arange(1003) + 0.5) * 100 / 1003).astype(int)
    for p in range(100):
        part = scores[pixel == p]
        for a in range(3):
            known = part[:, a][~np.isnan(part[:, a])]
            assert np.isnan(found[p, a]) if not known.size else found[p, a] == known.max()
    assert best_per_pixel(scores, 2000).shape == (1003, 3)


def test_the_grid_has_the_first_angle_at_the_bottom() -> None:
    grid = Grid(left=30, top=10, width=100, height=40, n_times=5, n_angles=2)
    assert grid.centre(0, 0) == (40, 40)
    assert grid.centre(4, 1) == (120, 20)
    for t in range(5):
        for a in range(2):
            assert grid.nearest(*grid.centre(t, a), reach=0) == (t, a)
    assert grid.nearest(27, 53, reach=4) == (0, 0)
    assert grid.nearest(25, 40, reach=4) is None
