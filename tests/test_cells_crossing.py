"""Cells that swim over one another keep their numbers, and so do those that only touch."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import summary_of_cells
from napari_phase4d.analysis.cell_table import shared
from napari_phase4d.analysis.cells import keep_apart

N_TIMES, SIDE, RADIUS, SPEED = 41, 96, 9.0, 1.6
MIDDLE = N_TIMES // 2


def cap(y: float, x: float, radius: float, side: int = SIDE) -> np.ndarray:
    """Return the phase of a ball."""
    rows, columns = np.mgrid[:side, :side]
    inside = 1 - ((rows - y) ** 2 + (columns - x) ** 2) / radius**2
    return 5.0 * np.sqrt(np.maximum(inside, 0))


def recording(
    ways: list[np.ndarray], radii: tuple[float, ...], noise: float, side: int = SIDE
) -> xr.DataArray:
    """Return the phase of balls on their ways (time, 2), about the middle of the field."""
    phase = np.zeros((len(ways[0]), 1, side, side))
    for way, radius in zip(ways, radii, strict=True):
        for t, (y, x) in enumerate(way + side / 2):
            phase[t, 0] += cap(y, x, radius, side)
    phase += np.random.default_rng(0).normal(0, noise, phase.shape)
    return xr.DataArray(
        phase.astype(np.float32),
        dims=("time", "angle", "y", "x"),
        coords={"time": np.arange(len(phase)) / 6, "angle": [0.0]}
        | {axis: np.arange(side) / 2 for axis in "yx"},
    )


def straight(heading_deg: float, aside: float = 0.0) -> np.ndarray:
    """Return a way through the middle of the field, or past it, pixels."""
    return through(heading_deg, aside, np.arange(N_TIMES) - MIDDLE)


def through(heading_deg: float, aside: float, frames: np.ndarray) -> np.ndarray:
    """Return a way that is at the middle of the field, or nearest to it, in frame 0."""
    along = np.array([np.sin(np.deg2rad(heading_deg)), np.cos(np.deg2rad(heading_deg))])
    steps = SPEED * frames
    return steps[:, None] * along + aside * np.array([along[1], -along[0]])


def numbers_on(cells: xr.DataArray, way: np.ndarray, frame: int) -> int:
    y, x = np.rint(way[frame] + cells.sizes["y"] / 2).astype(int)
    return int(cells.values[frame, 0, y, x])


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.4])
@pytest.mark.parametrize("turned", [60, 100, 150, 180])
@pytest.mark.parametrize(("aside", "radii"), [(0, (9.0, 9.0)), (4, (9.0, 8.0)), (2, (10.0, 7.0))])
def test_cells_that_cross_keep_their_numbers(
    noise: float, turned: float, aside: float, radii: tuple[float, float]
) -> None:
    ways = [straight(20), straight(20 + turned, aside)]
    cells = p4d.find_cells(recording(ways, radii, noise))
    first, last = ([numbers_on(cells, way, frame) for way in ways] for frame in (4, -5))
    assert sorted(first) == [1, 2]
    assert last == first
    assert cells.attrs["parents"] == []


@pytest.mark.thorough
@pytest.mark.parametrize("aside", [0, 3])
@pytest.mark.parametrize("turned", [180, 120, 90])
def test_a_cell_that_crosses_two_others_keeps_its_number(turned: float, aside: float) -> None:
    frames, first, second = np.arange(61), 18, 44
    own = through(0, 0, frames - 30)
    met = [
        through(turned, aside, frames - first) + own[first],
        through(-turned, aside, frames - second) + own[second],
    ]
    cells = p4d.find_cells(recording([own, *met], (RADIUS,) * 3, 0.2, side=150))
    of_own = [numbers_on(cells, own, frame) for frame in (8, 31, 54)]
    assert of_own == of_own[:1] * 3
    for way, at in zip(met, (first, second), strict=True):
        during = {
            cell
            for cell, _, begin, _ in cells.attrs["overlaps"]
            if abs(6 * begin - at) < (second - first) / 2
        }
        before, after = (numbers_on(cells, way, frame) for frame in (at - 13, at + 13))
        assert before == after
        assert during == {of_own[0], before}


@pytest.mark.slow
@pytest.mark.parametrize("aside", [0, 1.5])
def test_cells_that_cross_twice_keep_their_numbers(aside: float) -> None:
    """They turn round and come back; before that, one of them crosses a third."""
    frames, third_at = np.arange(101), 36
    own, other = (through(heading, aside, 34 - abs(frames - 50)) for heading in (0, 180))
    third = through(90, 0, frames - third_at) + own[third_at]
    cells = p4d.find_cells(recording([own, other, third], (RADIUS,) * 3, 0.2, side=150))
    of_way = [
        {numbers_on(cells, way, frame) for frame in (*seen, third_at - 12, third_at + 12)}
        for way, seen in ((own, (3, 70, 97)), (other, (3, 70, 97)), (third, ()))
    ]
    assert [len(numbers) for numbers in of_way] == [1, 1, 1]
    assert len(set.union(*of_way)) == 3


@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_cells_that_touch_and_turn_round_keep_their_numbers(noise: float) -> None:
    away = RADIUS * 0.97 + SPEED * np.abs(np.arange(N_TIMES) - MIDDLE)
    ways = [np.stack([0 * away, sign * away], axis=1) for sign in (-1, 1)]
    cells = p4d.find_cells(recording(ways, (RADIUS, RADIUS), noise))
    first, last = ([numbers_on(cells, way, frame) for way in ways] for frame in (8, -9))
    assert sorted(first) == [1, 2]
    assert last == first


def test_a_cell_that_has_crossed_another_divides() -> None:
    ways = [straight(0), straight(180)]
    parts = [way.copy() for way in (ways[0], ways[0])]
    for side, part in zip((-1, 1), parts, strict=True):
        part[:, 0] += side * np.maximum(1.2 * (np.arange(N_TIMES) - 34), 0)
    phase = recording([ways[1]], (RADIUS,), 0.1)
    for t in range(N_TIMES):
        if t < 36:
            phase.values[t, 0] += cap(*(ways[0][t] + SIDE / 2), RADIUS)
        else:
            for part in parts:
                phase.values[t, 0] += cap(*(part[t] + SIDE / 2), 0.72 * RADIUS)
    cells = p4d.find_cells(phase)
    mother = numbers_on(cells, ways[0], 4)
    assert numbers_on(cells, ways[0], 34) == mother
    assert [parent for _, parent in cells.attrs["parents"]] == [mother, mother]


def test_a_cell_that_comes_in_beside_another_is_no_daughter() -> None:
    """It appears at the border, where the other one has just come in itself."""
    labels = np.zeros((8, 1, SIDE, SIDE), dtype=np.int32)
    for t in range(8):
        comes = cap(56, 3, 11) > 0
        labels[t, 0][comes & (t >= 4)] = 2
        labels[t, 0][cap(40, 10 + t, 12) > 0] = 1
    cells = p4d.follow_cells(labels)
    assert [len(np.unique(frame)) - 1 for frame in cells.values] == [1] * 4 + [2] * 4
    assert {int(cells.values[t, 0, 40, 10 + t]) for t in range(8)} == {1}
    assert cells.attrs["parents"] == []


def drawn(cells_at: Callable[[int], list[np.ndarray]]) -> xr.DataArray:
    """Return labels of the cells of 14 frames, each numbered anew in each frame."""
    labels = np.zeros((14, 1, SIDE, SIDE), dtype=np.int32)
    for t, frame in enumerate(labels[:, 0]):
        for number, cell in enumerate(cells_at(t), 1):
            frame[cell] = number
    times = {"time": np.arange(14) / 6, "angle": [0.0]}
    return xr.DataArray(labels, dims=("time", "angle", "y", "x"), coords=times)


@pytest.mark.parametrize(("x", "speed", "frames"), [(90, 5, 9), (58, 1, 3), (58, 1, 1)])
def test_a_daughter_that_is_soon_gone_is_one(x: int, speed: int, frames: int) -> None:
    """It leaves in the third frame, or is not found any more."""
    parts_at = 5

    def cells_at(t: int) -> list[np.ndarray]:
        if t < parts_at:
            return [cap(48, x - 10, 12) > 0]
        since = t - parts_at
        other = [cap(48, x + speed * since, 9) > 0] if since < frames else []
        return [cap(48, x - 19 - since, 9) > 0, *(cell for cell in other if cell.any())]

    cells = p4d.follow_cells(drawn(cells_at))
    seen = [np.unique(frame[frame > 0]).tolist() for frame in cells.values]
    assert seen[parts_at - 1 : parts_at + 1] == [[1], [2, 3]]
    assert seen[parts_at + 3 :] == [[2]] * 6
    assert cells.attrs["parents"] == [[2, 1], [3, 1]]


@pytest.mark.parametrize("cut_at", [0, 7])
@pytest.mark.parametrize(("start", "speed"), [(40, 1), (75, 2)])
def test_a_cell_that_is_cut_for_two_frames_is_one(cut_at: int, start: int, speed: int) -> None:
    """Through its middle or at its side, in the field or while it leaves."""

    def cells_at(t: int) -> list[np.ndarray]:
        cell = cap(48, start + speed * t, 12) > 0
        rows = np.arange(SIDE)[:, None]
        parts = [cell & (rows < 47 - cut_at), cell & (rows > 48 - cut_at)]
        return parts if t in (7, 8) else [cell]

    cells = p4d.follow_cells(drawn(cells_at))
    assert [np.unique(frame[frame > 0]).tolist() for frame in cells.values[:9]] == (
        [[1]] * 7 + [[1, 2]] * 2
    )
    assert set(np.unique(cells.values[9:])) <= {0, 1}
    assert cells.attrs["parents"] == []
    assert all(6 * end < 9 for _, _, _, end in cells.attrs["overlaps"])


def test_a_cell_that_is_cut_for_a_moment_may_divide_soon_after() -> None:
    def cells_at(t: int) -> list[np.ndarray]:
        if t >= 8:
            return [cap(48 + side * (9 + t - 8), 48, 8.5) > 0 for side in (-1, 1)]
        cell, rows = cap(48, 48, 12) > 0, np.arange(SIDE)[:, None]
        return [cell & (rows < 47), cell & (rows > 48)] if t == 3 else [cell]

    cells = p4d.follow_cells(drawn(cells_at))
    seen = [np.unique(frame[frame > 0]).tolist() for frame in cells.values]
    assert seen == [[1]] * 3 + [[1, 2]] + [[1]] * 4 + [[3, 4]] * 6
    assert cells.attrs["parents"] == [[3, 1], [4, 1]]


@pytest.mark.slow
def test_errors_grow_while_cells_lie_over_one_another() -> None:
    ways, optics = [straight(20), straight(150, 3)], p4d.Optics()
    phase = recording(ways, (RADIUS, RADIUS), 0.1)
    table = p4d.measure(phase, p4d.find_cells(phase), optics)
    true = optics.dry_mass_pg(5.0 * 2 / 3 * np.pi * RADIUS**2, 0.25)
    off = (table["dry mass (pg)"] - true).abs()
    assert off.max() > true / 4  # so that there is something to be unsure about
    assert 0.55 < (off <= table["dry mass error (pg)"]).mean() < 0.85
    assert (off <= 2 * table["dry mass error (pg)"]).mean() > 0.9
    assert (off > 10 * table["dry mass error (pg)"]).sum() == 0


@pytest.mark.slow
def test_a_cell_that_is_never_seen_alone_has_no_error() -> None:
    """Only the frames are measured in which one of two cells lies over the other."""
    phase = recording([straight(20), straight(150, 3)], (RADIUS, RADIUS), 0.1)
    cells = p4d.find_cells(phase)
    overlaps = np.array(cells.attrs["overlaps"])
    begin, end = np.rint(6 * overlaps[overlaps[:, 0] == 1, 2:]).astype(int).T
    frames = slice(begin[0], end[0] + 1)
    table = p4d.measure(phase[frames], cells[frames], p4d.Optics())
    own = table[table["cell"] == 1]
    assert len(own) > 3
    assert own["dry mass (pg)"].notna().all()
    for name in ("dry mass", "mass density", "mean optical path difference"):
        assert own.filter(regex=f"^{name} error").isna().all(axis=None)
    summary = summary_of_cells(table)
    assert summary["dry mass error (pg)"].isna().tolist()[0]


def test_the_memory_for_overlaps_grows_with_the_table_alone() -> None:
    """A thousand overlaps in twelve thousand rows would be 12 MB for each way to note them."""
    rows = [(cell, time, 0.0, True) for time in range(400) for cell in range(1, 31)]
    table = pd.DataFrame(rows, columns=["cell", "time (s)", "angle (deg)", "whole"])
    mixed = (table["cell"] < 26) & (table["time (s)"] % 10).between(6, 8)
    masses = np.where(mixed, 40.0, 50.0)
    overlaps = [
        (cell, 0.0, begin, begin + 2.0) for cell in range(1, 26) for begin in range(6, 400, 10)
    ]
    tracemalloc.start()
    try:
        off = shared(table, masses, overlaps)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 4e6
    np.testing.assert_allclose(off, np.where(mixed, 10.0, 0.0))


def test_overlaps_that_are_none_are_refused() -> None:
    phase = recording([straight(20)], (RADIUS,), 0.1)
    cells = p4d.find_cells(phase).assign_attrs(overlaps="all")
    with pytest.raises(ValueError, match="the cells note overlaps as"):
        p4d.measure(phase, cells, p4d.Optics())


@pytest.mark.parametrize(("width", "kept"), [(7, 1), (20, 2)])
def test_splinters_of_a_covered_cell_are_not_kept_apart(width: int, kept: int) -> None:
    labels = np.zeros((2, 48, 64), dtype=np.int32)
    labels[0, 12:36, 10:34], labels[0, 12:36, 34 : 34 + width] = 1, 2
    labels[1] = labels[0] > 0
    keep_apart(labels, np.arange(len(labels)))
    assert labels[1].max() == kept
