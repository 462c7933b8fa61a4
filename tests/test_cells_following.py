"""Cells that are followed: how far they may move, in which unit, and over which views."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import cells_in

Places = list[tuple[float, float, float]]

#: Side of a pixel in micrometres.
PIXEL = 0.2


def labels_of(
    cells_at: Callable[[int, int], Places], n_times: int, n_angles: int = 1, unit: str = "um"
) -> xr.DataArray:
    """Return labels with the discs (y, x, radius), in pixels, of each time and view."""
    y, x = np.mgrid[:40, :80]
    stack = np.zeros((n_times, n_angles, *y.shape), np.int32)
    for time, angle in np.ndindex(n_times, n_angles):
        for number, (cy, cx, radius) in enumerate(cells_at(time, angle), 1):
            stack[time, angle][np.hypot(y - cy, x - cx) <= radius] = number
    side = PIXEL * (1000 if unit == "nm" else 1)
    return xr.DataArray(
        stack,
        dims=("time", "angle", "y", "x"),
        coords={
            "time": np.arange(n_times) * 0.5,
            "angle": np.arange(n_angles) * 10.0,
            "y": ("y", np.arange(y.shape[0]) * side, {"units": unit}),
            "x": ("x", np.arange(y.shape[1]) * side, {"units": unit}),
        },
    )


def numbers(found: xr.DataArray, time: int, angle: int = 0) -> set[int]:
    """Return the cells of a frame."""
    return set(np.unique(found.values[time, angle]).tolist()) - {0}


@pytest.mark.parametrize("unit", ["um", "nm"])
@pytest.mark.parametrize("step", [3, 5, 9])
@pytest.mark.parametrize("reach_um", [0.1, 0.5, 0.7, 0.95, 1.3, 2.0])
def test_no_cell_moves_further_than_its_reach(reach_um: float, step: int, unit: str) -> None:
    found = p4d.follow_cells(
        labels_of(lambda time, _: [(20, 6 + step * time, 3)], 4, unit=unit), reach_um=reach_um
    )
    assert found.max() == (1 if step * PIXEL <= reach_um else 4)


def test_what_appears_beside_where_a_cell_was_is_another_one() -> None:
    """A cell that is gone has no single daughter either."""
    found = p4d.follow_cells(
        labels_of(lambda time, _: [(20, 20 if time < 2 else 25, 4)], 4), reach_um=0.05
    )
    assert [numbers(found, time) for time in range(4)] == [{1}, {1}, {2}, {2}]


@pytest.mark.parametrize(("step", "cells"), [(7, 1), (9, 1), (12, 4)])
def test_alone_a_cell_may_move_one_and_a_half_diameters(step: int, cells: int) -> None:
    found = p4d.follow_cells(labels_of(lambda time, _: [(20, 6 + step * time, 3)], 4))
    assert found.max() == cells


def test_daughters_may_lie_further_than_the_reach() -> None:
    def cells(time: int, _: int) -> Places:
        return [(20, 30, 6)] if time < 3 else [(20, 25, 4), (20, 35, 4)]

    found = p4d.follow_cells(labels_of(cells, 6), reach_um=0.9)
    assert found.attrs["parents"] == [[2, 1], [3, 1]]


def test_a_gap_is_closed_further_than_one_step() -> None:
    def cells(time: int, _: int) -> Places:
        return [] if time == 2 else [(20, 10 + 4 * time, 3)]

    assert p4d.follow_cells(labels_of(cells, 5), reach_um=1.1).max() == 1


def test_a_cell_that_the_first_view_does_not_show_has_one_number_in_the_others() -> None:
    def cells(time: int, angle: int) -> Places:
        return [(10, 10 + time, 4), (28, 35 + time, 4)][: 1 + (angle > 0)]

    found = p4d.follow_cells(labels_of(cells, 5, 4))
    assert [numbers(found, 4, angle) for angle in range(4)] == [{1}, {1, 2}, {1, 2}, {1, 2}]


@pytest.mark.parametrize("lost_in", [0, 1])
def test_a_cell_that_one_view_loses_for_a_while_keeps_its_number(lost_in: int) -> None:
    def cells(time: int, angle: int) -> Places:
        return [] if angle == lost_in and 2 <= time <= 5 else [(20, 15 + time, 5)]

    assert p4d.follow_cells(labels_of(cells, 10, 2)).max() == 1


def test_a_division_that_views_see_at_different_times_is_one() -> None:
    def cells(time: int, angle: int) -> Places:
        if time < 4 + 2 * angle:
            return [(20, 30, 6)]
        return [(20, 25, 4.5), (20, 35, 4.5)]

    found = p4d.follow_cells(labels_of(cells, 10, 2))
    assert found.attrs["parents"] == [[2, 1], [3, 1]]
    assert [numbers(found, 9, angle) for angle in range(2)] == [{2, 3}, {2, 3}]


def test_two_cells_that_follow_each_other_far_apart_stay_two_in_all_views() -> None:
    def cells(time: int, angle: int) -> Places:
        return [(20, 15 if time < 4 else 60, 5)]

    found = p4d.follow_cells(labels_of(cells, 8, 3))
    for angle in range(3):
        assert [numbers(found, time, angle) for time in (0, 7)] == [{1}, {2}]


def test_labels_that_lie_where_nothing_is_known_give_an_empty_table() -> None:
    labels = labels_of(lambda _, __: [(20, 20, 4)], 2)
    unknown = xr.zeros_like(labels, dtype=np.float32).where(labels == 0)
    found = cells_in(unknown, p4d.Optics(), labels=labels)
    assert found.table.empty
    assert found.summary.empty
    with pytest.raises(ValueError, match="there are no cells where the phase is known"):
        p4d.measure(unknown, labels, p4d.Optics())
