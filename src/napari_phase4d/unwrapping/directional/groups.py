"""Pixels of one frame that certain steps join, and the edges between what is joined."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Stack, room_in
from napari_phase4d.unwrapping.directional.ground import Islands, islands_of
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import Opinion, Weighed

__all__ = [
    "CERTAIN",
    "PARTS",
    "SURE",
    "SUREST",
    "Edges",
    "Frame",
    "Grouped",
    "Index",
    "Runs",
    "Whole",
    "columns_of",
    "grouped",
    "heavier",
    "join",
    "merged_edges",
    "no_edges",
    "number_roots",
    "root_of",
    "runs_between",
    "weight_of",
]

#: Weight of a step: (SOFTENING + roughness)^-POWER, roughness in radians.
SOFTENING, POWER = 0.5, 6
#: Weights are whole multiples, at least 1, of one part in so many, so that their sums do not
#: depend on the order. It tells steps of up to 40 rad apart, more than fading amplitude stands
#: for, and leaves room for the sum of some ten million smooth steps.
PARTS = 2.0**32

#: Edges that are sorted at a time.
AT_ONCE = 500_000

Index = NDArray[np.int32]
Whole = NDArray[np.int64]


def weight_of(roughness: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the weight of steps of some roughness in radians."""
    weight: NDArray[np.float64] = (SOFTENING + roughness.astype(np.float64)) ** -POWER
    return weight


def heavier(roughness: NDArray[np.float32], times: float) -> NDArray[np.float32]:
    """Return the roughness in radians of steps that weigh so many times as much."""
    softened = (SOFTENING + roughness) * np.float32(times ** (-1 / POWER))
    return softened - np.float32(SOFTENING)


@dataclass(frozen=True)
class Edges:
    """What steps between regions ask for; those that ask for the same count as one.

    Parameters
    ----------
    first, second : ndarray of int
        The regions at both ends.
    turns : ndarray of int
        Turns of the second region minus those of the first.
    weight : ndarray of int
        What a turn more or less costs, in parts of 2^-32.
    ground : ndarray of int
        The share of it that steps between islands of the empty field have.
    rough : ndarray of float
        Roughness of the smoothest step, radians.
    """

    first: Index
    second: Index
    turns: Index
    weight: Whole
    ground: Whole
    rough: NDArray[np.float32]

    def __len__(self) -> int:
        """Return the number of edges."""
        return len(self.first)


@compiled
def root_of(parent: Index, offset: Index, i: int) -> tuple[int, int]:
    """Return the root that something is joined to, and its turns relative to the root."""
    total = 0
    while parent[i] != i:
        above = parent[i]
        offset[i] += offset[above]
        parent[i] = parent[above]
        total += offset[i]
        i = parent[i]
    return i, total


@compiled
def join(parent: Index, offset: Index, a: int, b: int, turns: int) -> None:
    """Join b to a so that it has so many turns more, unless they are joined already."""
    root_a, of_a = root_of(parent, offset, a)
    root_b, of_b = root_of(parent, offset, b)
    if root_a == root_b:
        return
    more = turns + of_a - of_b
    # The first of all is the root, so that what the roots are does not depend on the order.
    if root_a < root_b:
        parent[root_b], offset[root_b] = root_a, more
    else:
        parent[root_a], offset[root_a] = root_b, -more


@compiled
def number_roots(parent: Index, offset: Index, number: Index) -> int:
    """Give what is joined one number, in the order of the roots; return how many there are.

    Turns become those relative to the root.
    """
    count = 0
    for i in range(len(parent)):
        root, turns = root_of(parent, offset, i)
        parent[i], offset[i] = root, turns
        if root == i:
            number[i] = count
            count += 1
        else:
            number[i] = number[root]
    return count


def no_edges() -> Edges:
    """Return none."""
    none = np.zeros(0, dtype=np.int32)
    cost = np.zeros(0, dtype=np.int64)
    return Edges(none, none, none, cost, cost, np.zeros(0, dtype=np.float32))


def columns_of(parts: list[Edges]) -> list[NDArray[Any]]:
    """Return the columns of lists of edges, in the order of `Edges`; the lists are used up."""
    columns = [
        list(c) for c in zip(*(vars(p).values() for p in (no_edges(), *parts)), strict=True)
    ]
    parts.clear()
    found = []
    for column in columns:
        found.append(np.concatenate(column))
        column.clear()  # each goes before the next one comes
    return found


def merged_edges(
    first: Index,
    second: Index,
    turns: Index,
    weight: Whole,
    ground: Whole,
    rough: NDArray[np.float32],
) -> Edges:
    """Count edges between the same two regions that ask for the same turns as one.

    Edges from a region to itself are left out; the others are sorted by their regions and turns.
    For the parameters see `Edges`.
    """
    lower = np.minimum(first, second)
    until = np.cumsum(np.bincount(lower))
    # Some at a time: on the way each of them takes several times what it does at the end.
    cuts = [*range(0, int(until[-1]) if len(until) else 0, AT_ONCE), len(first)]
    starts = np.searchsorted(until, cuts, side="right")
    parts = []
    for start, stop in pairwise(starts):
        some = np.flatnonzero((lower >= start) & (lower < stop) & (first != second))
        columns: tuple[Any, ...] = (first, second, turns, weight, ground, rough)
        parts.append(sorted_edges(Edges(*(column[some] for column in columns))))
    return Edges(*columns_of(parts))


def sorted_edges(edges: Edges) -> Edges:
    """Do some of it, none of which leads from a region to itself."""
    if not len(edges):
        return edges
    first, second, turns = edges.first, edges.second, edges.turns
    swapped = first > second
    a, b = np.where(swapped, second, first).astype(np.int64), np.where(swapped, first, second)
    asked = np.where(swapped, -turns, turns).astype(np.int64)
    n = int(b.max()) + 1
    lowest = int(asked.min())
    span = int(asked.max()) - lowest + 1
    key = (a * n + b) * span + (asked - lowest)
    order = np.argsort(key, kind="stable")
    key = key[order]
    begins = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    pair = key[begins] // span
    return Edges(
        (pair // n).astype(np.int32),
        (pair % n).astype(np.int32),
        (key[begins] % span + lowest).astype(np.int32),
        np.add.reduceat(edges.weight[order], begins),
        np.add.reduceat(edges.ground[order], begins),
        np.minimum.reduceat(edges.rough[order], begins),
    )


# ---- what is joined -------------------------------------------------------------------------


#: Steps smoother and smaller than this, in radians, are never doubted: their ends move together.
#: The smoother half of them joins first.
CERTAIN, SMOOTH = 1.0, 0.5
#: How far steps may be used: in doubt, certain, certain and smooth.
DOUBTED, SURE, SUREST = 1, 2, 3
Mask = NDArray[np.bool_]


# ---- within a frame --------------------------------------------------------------------------


@dataclass(frozen=True)
class Frame:
    """The box of the frames of one time, as the steps to the next time need it."""

    groups: Index
    relative: NDArray[np.int16]
    free: Mask


@dataclass(frozen=True)
class Runs:
    """Steps between groups; those that follow each other and ask for the same count as one.

    Parameters
    ----------
    ends : ndarray of int, shape (steps, 4)
        First and second group, turns, and how far they may be used.
    costs : ndarray of int, shape (steps, 2)
        Weight, and that of steps between islands of the empty field, in parts of 2^-32.
    rough : ndarray of float
        Roughness of the smoothest, radians.
    """

    ends: Index
    costs: Whole
    rough: NDArray[np.float32]


@dataclass(frozen=True)
class Grouped:
    """What certain steps join in the frames of a block, and the steps between.

    Parameters
    ----------
    block : Block
        The frames.
    sizes : list of ndarray of int
        Of every time, the pixels of the object that each group has.
    fields : list of list of Islands or None
        The islands of the empty field of each time and angle.
    within : list of Runs
        Steps between groups of one time.
    ahead : list of Runs
        Steps from each time but the last to the next one.
    first, last : Frame
        The first and the last time.
    later : Opinion or None
        Steps from the block's last time to the one after.
    """

    block: Block
    sizes: list[Whole]
    fields: list[list[Islands | None]]
    within: list[list[Runs]]
    ahead: list[Runs]
    first: Frame
    last: Frame
    later: Opinion | None


def grouped(scene: Scene, weighed: Weighed, groups_to: Stack, relative_to: Stack) -> Grouped:
    """Join the pixels of each frame of a block, and list the steps between what is joined."""
    block = weighed.block
    unmoved = scene.islands_as_seen(block)
    islands = scene.placed(unmoved, block, -1)
    groups, relative = room_in(groups_to, block, np.int32), room_in(relative_to, block, np.int16)
    groups[...], relative[...] = -1, 0
    free = np.ascontiguousarray(weighed.free)
    fields: list[list[Islands | None]] = []
    sizes = []
    corner = scene.box[0].start, scene.box[1].start
    none = Opinion(*(np.zeros((len(block), free.shape[1], 0, 0), d) for d in DTYPES))
    down, right = (weighed.by_axis.get(axis, none) for axis in (2, 3))
    for i in range(len(block)):
        of_time: list[Whole] = []
        fields.append([])
        count = 0
        for angle in range(islands.shape[1]):
            frame = i, angle
            n_islands = int(islands[frame].max(initial=-1)) + 1
            of_island, size = group_frame(
                islands[frame],
                n_islands,
                corner,
                free[frame],
                tuple(part[frame] for part in parts_of(down)),
                tuple(part[frame] for part in parts_of(right)),
                groups[frame],
                relative[frame],
                count,
            )
            fields[-1].append(islands_of(islands[frame], unmoved[frame], of_island))
            of_time.append(size)
            count += len(size)
        sizes.append(np.concatenate(of_time))
    groups_to.write(block, groups)
    relative_to.write(block, relative)
    inside = (slice(None), slice(None), *scene.box)
    boxed = (np.ascontiguousarray(stack[inside]) for stack in (groups, relative))
    part = [Frame(*arrays) for arrays in zip(*boxed, free, strict=True)]
    within = [
        [
            runs_along(part[i], axis, opinions[axis], i)
            for axis in (1, 2, 3)
            for opinions in (weighed.by_axis, weighed.followed)
            if axis in opinions
        ]
        for i in range(len(block))
    ]
    link = weighed.by_axis.get(0)
    ahead = [
        runs_between(part[i], part[i + 1], link, i)
        for i in range(len(block) - 1)
        if link is not None
    ]
    later = link if link is not None and len(link.turns) == len(block) else None
    return Grouped(block, sizes, fields, within, ahead, part[0], part[-1], later)


DTYPES = ("int16", "float32", "bool", "bool")


def parts_of(opinion: Opinion) -> tuple[NDArray[Any], ...]:
    """Return the arrays of an opinion."""
    return opinion.turns, opinion.rough, opinion.kept, opinion.small


def runs_along(frame: Frame, axis: int, opinion: Opinion, i: int) -> Runs:
    """List the steps between the groups of one time, along angle, y or x."""
    return runs_of(frame, frame, opinion, i, (axis == 1, axis == 2, axis == 3))


def runs_between(frame: Frame, following: Frame, opinion: Opinion, i: int) -> Runs:
    """List the steps from one time to the next."""
    return runs_of(frame, following, opinion, i, (False, False, False))


def runs_of(
    head: Frame, tail: Frame, opinion: Opinion, i: int, step: tuple[bool, bool, bool]
) -> Runs:
    """List the steps from each pixel (angle, y, x) of a frame to the next one of another."""
    asked = tuple(part[i] for part in parts_of(opinion))
    maps = (*vars(head).values(), *vars(tail).values(), *asked, *(int(s) for s in step))
    count = 0
    for _ in range(2):  # counted first, then listed
        found = Runs(
            np.empty((count, 4), np.int32),
            np.empty((count, 2), np.int64),
            np.empty(count, np.float32),
        )
        count = list_runs(*maps, *vars(found).values())
        if not count:
            break
    return found


@compiled
def grade_of(rough: float, kept: bool, small: bool, free: bool) -> int:
    """Return how far a step may be used; between two islands it is never certain.

    Of the many steps between two islands one may look certain by accident.
    """
    if not kept:
        return 0
    if not (small and free and rough < CERTAIN):
        return DOUBTED
    return SUREST if rough < SMOOTH else SURE


@compiled
def group_frame(  # noqa: C901 - one loop after the other; calls would need all of it again
    islands: Index,
    n_islands: int,
    corner: tuple[int, int],
    free: Mask,
    down: tuple[Any, ...],
    right: tuple[Any, ...],
    groups: Index,
    relative: NDArray[np.int16],
    before: int,
) -> tuple[Index, Whole]:
    """Join the pixels of a frame along certain steps.

    Parameters
    ----------
    islands : ndarray of int, shape (y, x)
        Number of the island of the empty field; -1 elsewhere.
    n_islands : int
        How many there are.
    corner : tuple of int
        Where the box of the object begins.
    free : ndarray of bool
        The object in the box.
    down, right : tuple of ndarray
        Steps along y and x in the box, see `parts_of`.
    groups, relative : ndarray of int, shape (y, x)
        Where the group of every pixel goes, and its turns relative to the group.
    before : int
        Number of the first group.

    Returns
    -------
    of_island : ndarray of int, shape (islands, 2)
        Group of every island, and its turns.
    sizes : ndarray of int
        Pixels of the object in each group.
    """
    height, width = free.shape
    top, left = corner
    node = np.full((height, width), -1, dtype=np.int32)
    n = n_islands
    for y in range(height):
        for x in range(width):
            if free[y, x]:
                node[y, x] = n
                n += 1
            else:
                node[y, x] = islands[top + y, left + x]
    parent, offset = np.arange(n).astype(np.int32), np.zeros(n, dtype=np.int32)
    for least in (SUREST, SURE):
        for axis, asked in enumerate((down, right)):
            turns, rough, kept, small = asked
            for y in range(turns.shape[0]):
                for x in range(turns.shape[1]):
                    y2, x2 = y + 1 - axis, x + axis
                    either = free[y, x] or free[y2, x2]
                    if grade_of(rough[y, x], kept[y, x], small[y, x], either) >= least:
                        join(parent, offset, node[y, x], node[y2, x2], turns[y, x])
    number = np.empty(n, dtype=np.int32)
    count = 0
    for i in range(n):
        root, turn = root_of(parent, offset, i)
        if root == i:
            number[i] = before + count
            count += 1
        else:
            number[i] = number[root]
        offset[i], parent[i] = turn, root
    sizes = np.zeros(count, dtype=np.int64)
    for y in range(islands.shape[0]):
        for x in range(islands.shape[1]):
            if islands[y, x] >= 0:
                groups[y, x], relative[y, x] = number[islands[y, x]], offset[islands[y, x]]
    for y in range(height):
        for x in range(width):
            if free[y, x]:
                i = node[y, x]
                groups[top + y, left + x], relative[top + y, left + x] = number[i], offset[i]
                sizes[number[i] - before] += 1
    of_island = np.empty((n_islands, 2), dtype=np.int32)
    for i in range(n_islands):
        of_island[i, 0], of_island[i, 1] = number[i], offset[i]
    return of_island, sizes


@compiled
def list_runs(
    groups: Index,
    relative: NDArray[np.int16],
    free: Mask,
    groups_2: Index,
    relative_2: NDArray[np.int16],
    free_2: Mask,
    turns: NDArray[np.int16],
    rough: NDArray[np.float32],
    kept: Mask,
    small: Mask,
    dv: int,
    dy: int,
    dx: int,
    ends: Index,
    costs: Whole,
    least: NDArray[np.float32],
) -> int:
    """List the steps between two maps of groups; only count them where there is no room.

    A step leads from each pixel of the first map to that one of the second map which lies so
    many views, rows and columns further.
    """
    count = 0
    fill = len(ends) > 0
    same = dv + dy + dx > 0
    for v in range(turns.shape[0]):
        for y in range(turns.shape[1]):
            a0, b0, j0 = -1, -1, 0
            for x in range(turns.shape[2]):
                if not kept[v, y, x]:
                    continue
                a, b = groups[v, y, x], groups_2[v + dv, y + dy, x + dx]
                if same and a == b:
                    continue
                j = turns[v, y, x] - relative_2[v + dv, y + dy, x + dx] + relative[v, y, x]
                if a != a0 or b != b0 or j != j0:
                    a0, b0, j0 = a, b, j
                    if fill:
                        ends[count, 0], ends[count, 1], ends[count, 2] = a, b, j
                        ends[count, 3] = 0
                        costs[count, 0] = costs[count, 1] = 0
                        least[count] = np.float32(np.inf)
                    count += 1
                if fill:
                    either = free[v, y, x] or free_2[v + dv, y + dy, x + dx]
                    r = rough[v, y, x]
                    grade = grade_of(r, True, small[v, y, x], either)
                    ends[count - 1, 3] = max(ends[count - 1, 3], grade)
                    share = 1 / (SOFTENING + np.float64(r)) ** 2
                    cost = max(np.int64(np.round(PARTS * share * share * share)), 1)
                    costs[count - 1, 0] += cost
                    if not either:
                        costs[count - 1, 1] += cost
                    least[count - 1] = min(least[count - 1], r)
    return count
