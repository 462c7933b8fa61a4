"""Pixels that certain steps join, frame by frame, and what the steps between them ask for.

Pixels of one frame are joined first, then frames to each other from the start outwards. Only the
labels of the last frame are needed on the way, so that a recording may have any length; what is
left, some regions for a hundred pixels, is one problem over the whole recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Stack, Store
from napari_phase4d.task import Watch, in_threads, watched
from napari_phase4d.unwrapping.directional.bunches import Bunches, EdgeList, bunches_of
from napari_phase4d.unwrapping.directional.ground import FIELD_SHARE, Grounds, Islands
from napari_phase4d.unwrapping.directional.groups import (
    PARTS,
    SURE,
    SUREST,
    Edges,
    Frame,
    Grouped,
    Index,
    Runs,
    Whole,
    columns_of,
    grouped,
    join,
    merged_edges,
    number_roots,
    root_of,
    runs_between,
    weight_of,
)
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import Floors, Opinion, Weighed

__all__ = ["FIRM", "Field", "Regions", "find_regions"]
#: How firmly: its weight is that of a step of this roughness, which is that of 100 smooth ones.
FIRM = -0.268
#: Other large islands are held as by so many steps of this roughness, in radians, as their width
#: has pixels: what an object cuts off from the field is field, where its rim tells nothing. The
#: rim of a sheet does.
LOOSE = 2.0
#: As many times more room is made for groups where there is none left.
ROOM = 1.25
#: Edges that are collected before those that ask for the same are put together. Nearly all of
#: these lie within some frames, so that older ones need not be looked at again before the end.
MANY_EDGES = 300_000


@dataclass(frozen=True)
class Regions:
    """Pixels that move together, and the edges between them.

    Parameters
    ----------
    n : int
        How many there are.
    bunches : Bunches
        They and the edges between them.
    held : int
        The region of the island of the empty field that has no turns.
    held_turns : int
        Turns of that island relative to its region.
    size : ndarray of int
        How many pixels of the object each one has.
    of_group : ndarray of int
        Region of each group of pixels that are joined within a frame, and ...
    offset : ndarray of int
        ... the group's turns relative to the region.
    groups : Stack
        Group of every pixel (kept time, angle, y, x) of the moved frames, counted from ``base``;
        -1 where there is none.
    relative : Stack
        Turns of every pixel relative to its group.
    base : ndarray of int, shape (kept time,)
        Number of the first group of every time.
    fields : ndarray of int
        Regions that the islands which hold the level of frames belong to, that which is held
        among them.
    """

    n: int
    bunches: Bunches
    held: int
    held_turns: int
    size: Whole
    of_group: Index
    offset: Index
    groups: Stack
    relative: Stack
    base: Whole
    fields: Index

    def read(self, block: Block) -> tuple[Index, Index]:
        """Return region and relative turns of every pixel of some frames.

        Where there is no group it is the region that is held.
        """
        group, relative = self.groups.read(block), self.relative.read(block)
        region, turns = np.empty(group.shape, np.int32), np.empty(group.shape, np.int32)
        for i, time in enumerate(block.times):
            write_regions(
                np.require(group[i], None, ["C", "W"]).reshape(-1),
                np.require(relative[i], None, ["C", "W"]).reshape(-1),
                int(self.base[time]),
                self.of_group,
                self.offset,
                (self.held, self.held_turns),
                region[i].reshape(-1),
                turns[i].reshape(-1),
            )
        return region, turns


@compiled
def write_regions(
    group: Index,
    relative: NDArray[np.int16],
    base: int,
    of_group: Index,
    offset: Index,
    outside: tuple[int, int],
    region: Index,
    turns: Index,
) -> None:
    """Write the region and turns of every pixel of a time, by its group counted from a base."""
    for i in range(len(group)):
        if group[i] < 0:
            region[i], turns[i] = outside
        else:
            here = group[i] + base
            region[i], turns[i] = of_group[here], offset[here] + relative[i]


@dataclass(frozen=True)
class Field:
    """What both methods start from.

    Parameters
    ----------
    scene : Scene
        The frames, the object held in place.
    floors : Floors
        What noise alone makes of the weights.
    regions : Regions
        Pixels that certain steps join, and the edges between them.
    """

    scene: Scene
    floors: Floors
    regions: Regions


def find_regions(scene: Scene, steps: Iterator[Weighed], store: Store, watch: Watch) -> Regions:
    """Join pixels along certain steps.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    steps : iterator of Weighed
        All its steps, see `weighed_steps`.
    store : Store
        Where the groups of all pixels are kept.
    watch : Watch
        Stops the work.
    """
    groups = store.temporary("groups", scene.shape, "int32")
    relative = store.temporary("relative", scene.shape, "int16")

    def work(weighed: Weighed) -> Grouped:
        return grouped(scene, weighed, groups, relative)

    joining = Joining(scene, store)
    for found in in_threads(work, steps, watch.quiet(0), wait=True, large=True):
        joining.add(found)
    return watched(lambda: joining.regions(groups, relative), watch)


# ---- from frame to frame ---------------------------------------------------------------------


class Joining:
    """Joins groups of one frame after the other, from the start outwards.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    store : Store
        Where the edges lie.
    """

    def __init__(self, scene: Scene, store: Store) -> None:
        self._store = store
        self._start = scene.frames.start
        self._pixels = scene.frames.shape[2] * scene.frames.shape[3]
        self._parent = np.zeros(0, dtype=np.int32)
        self._offset = np.zeros(0, dtype=np.int32)
        self._sizes: list[Whole] = []
        self._n = 0
        self._base = np.zeros(scene.shape[0], dtype=np.int64)
        self._grounds = Grounds(scene)
        #: Edges of the last frames, and those that have been put together.
        self._edges: list[Edges] = []
        self._older = EdgeList(store, "edges")
        #: The start's first time; the last time so far and the steps to the one after.
        self._first: Frame | None = None
        self._last: tuple[Frame, Opinion | None] | None = None

    def add(self, found: Grouped) -> None:
        """Take the next block: those from the start on, then those before it."""
        forward = found.block.start >= self._start[0]
        times = list(found.block.times)
        link = self._to_last(found) if forward else self._to_first(found)
        for t in times if forward else times[::-1]:
            i = t - found.block.start
            self._make_room(t, found.sizes[i])
            for runs in found.within[i]:
                self._join(runs, t, t)
            if link is not None:
                self._join(link, *((t - 1, t) if forward else (t, t + 1)))
            link = None
            if forward and i + 1 < len(times):
                link = found.ahead[i]
            elif not forward and i > 0:
                link = found.ahead[i - 1]
            self._take_islands(t, found.fields[i])
        if self._first is None or not forward:
            self._first = found.first
        if forward:
            self._last = found.last, found.later
        if sum(len(edges) for edges in self._edges) > MANY_EDGES:
            self._put_away()

    def regions(self, groups: Stack, relative: Stack) -> Regions:
        """Return what has been joined."""
        self._put_away()
        region = np.empty(self._n, dtype=np.int32)
        offset = self._offset[: self._n]
        n = number_roots(self._parent[: self._n], offset, region)
        held, others = self._islands()
        if held is None:  # no empty field is in view, so that nothing is held at zero
            at, turns, n = n, 0, n + 1
        else:
            at, turns = int(region[held[0]]), int(offset[held[0]] + held[1])
        loose = np.array(self._grounds.others or np.zeros((0, 3)), dtype=np.int64)
        costs = [tie_cost(FIRM)] * len(others) + [
            tie_cost(LOOSE, math.sqrt(pixels)) for pixels in loose[:, 2].tolist()
        ]
        tied = np.concatenate([others, loose]) if held is not None else others
        ties = ties_between(
            np.full(len(tied), at, dtype=np.int32),
            region[tied[:, 0]],
            (turns - (offset[tied[:, 0]] + tied[:, 1])).astype(np.int64),
            np.array(costs, dtype=np.int64),
        )
        bunches = bunches_of(self._older, region, offset, n, (at, turns), ties, self._store)
        sizes = np.concatenate(self._sizes)
        return Regions(
            n,
            bunches,
            at,
            turns,
            np.bincount(region, sizes, n).astype(np.int64),
            region,
            offset,
            groups,
            relative,
            self._base,
            np.unique(np.append(region[others[:, 0]], at)),
        )

    def _put_away(self) -> None:
        """Put together the last edges that ask for the same, and store them."""
        first, second, turns, *rest = columns_of(self._edges)
        turns += resolved(self._parent, self._offset, first)
        turns -= resolved(self._parent, self._offset, second)
        self._older.append(merged_edges(first, second, turns, *rest))

    def _make_room(self, time: int, sizes: Whole) -> None:
        """Give the groups of one more time numbers."""
        self._base[time] = self._n
        self._n += len(sizes)
        self._sizes.append(sizes.astype(np.int32))  # pixels of a frame
        if self._n > len(self._parent):
            room = max(self._n, int(ROOM * len(self._parent)))
            more = np.arange(len(self._parent), room, dtype=np.int32)
            self._parent = np.concatenate([self._parent, more])
            self._offset = np.concatenate([self._offset, np.zeros(len(more), dtype=np.int32)])

    def _take_islands(self, time: int, of_views: list[Islands | None]) -> None:
        """Keep the islands of a time, their groups counted through."""
        for angle, own in enumerate(of_views):
            if own is not None:
                own.listed[:, 1] += np.int32(self._base[time])
                self._grounds.islands[time, angle] = own

    def _to_last(self, found: Grouped) -> Runs | None:
        """Return the steps to a block from the time before it."""
        if self._last is None or self._last[1] is None:
            return None
        return runs_between(self._last[0], found.first, self._last[1], -1)

    def _to_first(self, found: Grouped) -> Runs | None:
        """Return the steps from a block to the time after it."""
        if self._first is None or found.later is None:
            return None
        return runs_between(found.last, self._first, found.later, -1)

    def _join(self, runs: Runs, time: int, time_2: int) -> None:
        """Join groups along certain steps, and keep the others."""
        if not len(runs.rough):
            return
        first = runs.ends[:, 0] + np.int32(self._base[time])
        second = runs.ends[:, 1] + np.int32(self._base[time_2])
        join_runs(self._parent, self._offset, first, second, runs.ends)
        doubted = runs.ends[:, 3] < SURE
        self._edges.append(
            Edges(
                first[doubted],
                second[doubted],
                runs.ends[doubted, 2],
                runs.costs[doubted, 0],
                runs.costs[doubted, 1],
                runs.rough[doubted],
            )
        )

    def _islands(self) -> tuple[tuple[int, int] | None, Whole]:
        """Return group and turns of the island that is held, and those of the other fields."""
        of_frame = self._grounds.followed()
        fields = of_frame.reshape(-1, 3)
        if not (fields[:, 0] >= 0).any():
            return None, np.zeros((0, 3), dtype=np.int64)
        held = of_frame[self._start]
        if held[0] < 0:
            held = fields[np.argmax(fields[:, 2])]
        others = fields[(fields[:, 0] >= 0) & (fields[:, 2] >= FIELD_SHARE * self._pixels)]
        same = (others[:, 0] == held[0]) & (others[:, 1] == held[1])
        return (int(held[0]), int(held[1])), others[~same]


@compiled
def join_runs(parent: Index, offset: Index, first: Index, second: Index, ends: Index) -> None:
    """Join groups along certain steps, the smoother ones first."""
    for least in (SUREST, SURE):
        for i in range(len(first)):
            if ends[i, 3] >= least:
                join(parent, offset, first[i], second[i], ends[i, 2])


@compiled
def resolved(parent: Index, offset: Index, ids: Index) -> Index:
    """Replace groups by their roots, in place; return their turns relative to these."""
    turns = np.empty(len(ids), dtype=np.int32)
    for i in range(len(ids)):
        ids[i], turns[i] = root_of(parent, offset, ids[i])
    return turns


def tie_cost(rough: float, times: float = 1.0) -> int:
    """Return what some steps of a roughness weigh, in parts of 2^-32, at least 1."""
    return max(int(np.round(PARTS * times * weight_of(np.array([rough]))[0])), 1)


def ties_between(first: Index, second: Index, turns: Whole, costs: Whole) -> Edges:
    """Return edges that hold the empty field of every frame level.

    The level of a frame hangs on its own empty field then, not on its neighbours; but not
    beyond doubt, since a plateau inside a cell may be taken for the field.
    """
    firm = costs >= tie_cost(FIRM)
    rough = np.where(firm, FIRM, LOOSE).astype(np.float32)
    # Directional growing takes what the field says before all else: not what is loose.
    ground = np.where(firm, costs, 0)
    return Edges(first, second, turns.astype(np.int32), costs, ground, rough)
