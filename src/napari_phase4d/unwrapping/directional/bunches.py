"""Edges between regions, on the way to the problems that they make: a bunch of regions each.

Regions that hang together only through the empty field, which is held, do not depend on each
other: the least turns of all are the least turns of each bunch of them. So the edges of a long
recording go to where its stacks lie, as they come, and are read again a bunch at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Stack, Store
from napari_phase4d.unwrapping.directional.groups import (
    Edges,
    Index,
    Whole,
    columns_of,
    join,
    merged_edges,
    number_roots,
)

__all__ = ["Bunch", "Bunches", "EdgeList", "bunches_of", "numbers_of_bunches"]

#: Regions of a bunch, unless more hang together: enough to be worth a thread, few to hold. Edges
#: are three times as many, but how many are put together differs with the blocks they came in.
BUNCH_REGIONS = 30_000
#: Numbers of 32 bits that an edge takes.
WIDTH = 8


@dataclass(frozen=True)
class Bunch:
    """Some regions and the region that is held, and all edges between them.

    Parameters
    ----------
    regions : ndarray of int
        Their numbers, ascending.
    held : int
        Which of them is held.
    held_turns : int
        Turns of the island that is held, relative to its region.
    edges : Edges
        The regions counted as they stand here.
    """

    regions: Index
    held: int
    held_turns: int
    edges: Edges

    @property
    def n(self) -> int:
        """How many regions there are."""
        return len(self.regions)


class EdgeList:
    """Edges that lie in a store, part after part.

    Parameters
    ----------
    store : Store
        Where they lie.
    name : str
        That of the list.
    """

    def __init__(self, store: Store, name: str) -> None:
        self._store, self._name = store, name
        self._parts: list[Stack] = []

    def append(self, edges: Edges) -> None:
        """Add some, as a part of their own."""
        words = np.empty((len(edges), WIDTH), dtype=np.int32)
        words[:, 0], words[:, 1], words[:, 2] = edges.first, edges.second, edges.turns
        words[:, 3:5] = np.ascontiguousarray(edges.weight, np.int64).view(np.int32).reshape(-1, 2)
        words[:, 5:7] = np.ascontiguousarray(edges.ground, np.int64).view(np.int32).reshape(-1, 2)
        words[:, 7] = np.ascontiguousarray(edges.rough, np.float32).view(np.int32)
        name = f"{self._name}-{len(self._parts)}"
        stack = self._store.temporary(name, (len(edges), 1, 1, WIDTH), "int32")
        stack.write(Block(0, len(edges)), words[:, None, None])
        self._parts.append(stack)

    def __len__(self) -> int:
        """Return the number of parts."""
        return len(self._parts)

    def __iter__(self) -> Iterator[Edges]:
        """Yield the edges of every part."""
        for part in self._parts:
            yield self._of(part, Block(0, part.shape[0]))

    def read(self, part: int, block: Block) -> Edges:
        """Return some edges of a part."""
        return self._of(self._parts[part], block)

    def _of(self, part: Stack, block: Block) -> Edges:
        """Return some edges of a part, as `append` packed them."""
        words = part.read(block).reshape(-1, WIDTH)
        weight, ground = (
            np.ascontiguousarray(words[:, i : i + 2]).view(np.int64)[:, 0] for i in (3, 5)
        )
        rough = np.ascontiguousarray(words[:, 7]).view(np.float32)
        first, second, turns = (np.ascontiguousarray(words[:, i]) for i in range(3))
        return Edges(first, second, turns, weight, ground, rough)


@dataclass(frozen=True)
class Bunches:
    """Regions in bunches, and where their edges lie.

    Parameters
    ----------
    of_region : ndarray of int
        Bunch of every region; -1 of the one that is held.
    members : ndarray of int
        The regions of each bunch after those of the one before, ascending.
    starts : ndarray of int, shape (bunches + 1,)
        Where those of each bunch begin.
    edges : EdgeList
        The edges between regions, each part sorted by the bunch.
    cuts : ndarray of int, shape (parts, bunches + 1)
        Where in each part those of each bunch begin.
    held, held_turns : int
        The region that is held, and its turns, see `Bunch`.
    """

    of_region: Index
    members: Index
    starts: Whole
    edges: EdgeList
    cuts: Whole
    held: int
    held_turns: int

    def __len__(self) -> int:
        """Return the number of bunches."""
        return len(self.starts) - 1

    def read(self, number: int) -> Bunch:
        """Return a bunch."""
        own = self.members[self.starts[number] : self.starts[number + 1]]
        held = int(np.searchsorted(own, self.held))
        regions = np.insert(own, held, self.held)
        parts = [
            self.edges.read(k, Block(int(cuts[number]), int(cuts[number + 1])))
            for k, cuts in enumerate(self.cuts)
        ]
        first, second, *rest = columns_of(parts)
        first, second = (np.searchsorted(regions, e).astype(np.int32) for e in (first, second))
        return Bunch(regions, held, self.held_turns, merged_edges(first, second, *rest))


def bunches_of(
    edges: EdgeList,
    region: Index,
    offset: Index,
    n: int,
    held: tuple[int, int],
    ties: Edges,
    store: Store,
) -> Bunches:
    """Sort the edges between groups into bunches of regions.

    Parameters
    ----------
    edges : EdgeList
        Between groups.
    region, offset : ndarray of int
        Region of every group, and its turns relative to the region.
    n : int
        Number of regions.
    held : tuple of int
        The region that is held, and the turns of its island relative to it.
    ties : Edges
        More edges, from the region that is held to others.
    store : Store
        Where the sorted edges go.
    """

    def between_regions() -> Iterator[Edges]:
        yield ties
        for some in edges:
            turns = some.turns + offset[some.first] - offset[some.second]
            ends = region[some.first], region[some.second]
            yield Edges(*ends, turns, some.weight, some.ground, some.rough)

    of_region = numbers_of_bunches(between_regions(), n, held[0])
    members = np.argsort(of_region, kind="stable").astype(np.int32)[1:]
    starts = np.searchsorted(of_region[members], np.arange(int(of_region.max()) + 2))
    by_bunch, cuts = EdgeList(store, "edges-of-bunches"), []
    for some in between_regions():
        own = of_region[np.where(some.first == held[0], some.second, some.first)]
        order = np.argsort(own, kind="stable")
        order = order[(some.first != some.second)[order]]
        by_bunch.append(Edges(*(column[order] for column in vars(some).values())))
        cuts.append(np.searchsorted(own[order], np.arange(len(starts))))
    return Bunches(of_region, members, starts, by_bunch, np.array(cuts), *held)


def numbers_of_bunches(parts: Iterator[Edges], n: int, held: int) -> Index:
    """Return the bunch of every region: all that hangs together is in one; -1 if it is held."""
    parent, offset = np.arange(n).astype(np.int32), np.zeros(n, dtype=np.int32)
    for edges in parts:
        unite(parent, offset, edges.first, edges.second, held)
    component = np.empty(n, dtype=np.int32)
    number_roots(parent, offset, component)
    # That which is held, if no other comes with it, may leave a bunch empty otherwise.
    size = np.bincount(component)
    size[component[held]] -= 1
    _, bunch = np.unique((np.cumsum(size) - 1).clip(0) // BUNCH_REGIONS, return_inverse=True)
    found: Index = bunch.astype(np.int32)[component]
    found[held] = -1
    return found


@compiled
def unite(parent: Index, offset: Index, first: Index, second: Index, held: int) -> None:
    """Join regions that edges lead between, except through the one that is held.

    They are joined at equal turns: what counts is that they hang together.
    """
    for i in range(len(first)):
        if first[i] != held and second[i] != held:
            join(parent, offset, first[i], second[i], 0)
