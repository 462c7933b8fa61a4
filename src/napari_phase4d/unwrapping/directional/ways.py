"""Ways that lead through other spans of frames: what of them matters, kept as a few steps.

The smoothest way from the empty field may leave a span of frames and come back. Of all that lies
before a frame, only how rough the best way between any two of its pixels gets matters to what
comes after, and likewise backwards. A spanning tree of these pixels tells that exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Store
from napari_phase4d.unwrapping.directional.graph import PixelGraph
from napari_phase4d.unwrapping.directional.merging import smoothest_first

__all__ = ["NO_TREE", "Tree", "WaysOutside"]

Whole = NDArray[np.int32]
Stack = NDArray[np.float32]

#: Name of the island that is held; pixels of a frame are called by their numbers.
HELD = -1
#: Name of what is no end of a way.
NO_NAME = -2


@dataclass(frozen=True)
class Tree:
    """Steps that stand for the best ways between some ends.

    Parameters
    ----------
    first, second : ndarray of int
        Names of both ends of each.
    rough : ndarray of float
        How rough the best way between them gets, radians.
    """

    first: Whole
    second: Whole
    rough: Stack

    def between(self, nodes: Whole) -> Tree:
        """Return the same ways between nodes; those of all pixels of the frame are given."""
        ends = (self.first, self.second)
        first, second = (np.where(end == HELD, np.int32(0), nodes[end]) for end in ends)
        return Tree(first, second, self.rough)

    def with_others(self, other: Tree) -> Tree:
        """Return these ways and others."""
        return Tree(
            np.concatenate([self.first, other.first]),
            np.concatenate([self.second, other.second]),
            np.concatenate([self.rough, other.rough]),
        )

    def further(self, by: int) -> Tree:
        """Return the same ways where pixels have names so much higher."""
        ends = (self.first, self.second)
        first, second = (np.where(end == HELD, end, end + np.int32(by)) for end in ends)
        return Tree(first, second, self.rough)


NO_TREE = Tree(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))


class KeptTrees:
    """Trees that are kept until they are needed, in memory or on disk.

    Parameters
    ----------
    store : Store
        Where they lie.
    name : str
        What they are called.
    """

    def __init__(self, store: Store, name: str) -> None:
        self._store, self._name = store, name
        self._kept: dict[int, Kept] = {}

    def __setitem__(self, number: int, tree: Tree) -> None:
        """Keep a tree."""
        if not len(tree.rough):
            self._kept.pop(number, None)
            return
        rows = np.stack([tree.first, tree.second, tree.rough.view(np.int32)])
        kept = self._store.temporary(f"{self._name}{number}", (1, 1, *rows.shape), "int32")
        kept.write(Block(0, 1), rows[None, None])
        self._kept[number] = kept

    def __getitem__(self, number: int) -> Tree:
        """Return a tree; an empty one if there is none of this number."""
        if number not in self._kept:
            return NO_TREE
        first, second, rough = self._kept[number].read(Block(0, 1))[0, 0]
        return Tree(first, second, rough.view(np.float32))


class Kept(Protocol):
    """A stack."""

    def read(self, block: Block) -> NDArray[np.int32]:
        """Return some of it."""

    def write(self, block: Block, values: NDArray[np.int32]) -> None:
        """Write some of it."""


class WaysOutside:
    """The ways outside of each span, of trees of its own frames.

    Parameters
    ----------
    store : Store
        Where trees lie.
    name : str
        What the result is called.
    pixels : int
        How many a frame (angle, y, x) has.
    """

    def __init__(self, store: Store, name: str, pixels: int) -> None:
        self._inside = KeptTrees(store, f"{name}_inside")
        self._before = KeptTrees(store, f"{name}_before")
        self._after = KeptTrees(store, f"{name}_after")
        self._pixels = pixels

    def add(self, span: int, graph: PixelGraph, agreeing: Whole) -> None:
        """Take what a span's own frames tell: ways between its first frame and the one after.

        Of its steps those count that a result agrees with, the smoothest first.

        Pixels of the frame after it are called by their numbers and those of a frame more.
        """
        names = np.full(graph.n, NO_NAME, dtype=np.int32)
        for further, time in ((self._pixels, graph.core.stop), (0, graph.core.start)):
            if graph.around.start <= time < graph.around.stop:
                call_by_pixels(names, graph.nodes_at(time), further)
        names[0] = HELD
        self._inside[span] = Tree(*joined(agreeing, graph.first, graph.second, graph.rough, names))

    def follow(self, spans: int) -> None:
        """Follow the ways from span to span, forwards and backwards."""
        for span in range(1, spans):
            self._before[span] = self._through(self._before[span - 1], span - 1, 0, self._pixels)
        for span in range(spans - 2, -1, -1):
            self._after[span] = self._through(self._after[span + 1], span + 1, self._pixels, 0)

    def _through(self, outside: Tree, span: int, at: int, to: int) -> Tree:
        """Take what lies outside of one end of a span through it, to the frame at the other."""
        ways = outside.further(at).with_others(self._inside[span])
        # Nodes are the held island, the pixels of the first frame, and those of the one after.
        names = np.full(2 * self._pixels + 1, NO_NAME, dtype=np.int32)
        names[0] = HELD
        names[1 + to : 1 + to + self._pixels] = np.arange(self._pixels, dtype=np.int32)
        return spanning(ways.first + np.int32(1), ways.second + np.int32(1), ways.rough, names)

    def before(self, span: int) -> Tree:
        """Return the ways between pixels of the span's first frame."""
        return self._before[span]

    def after(self, span: int) -> Tree:
        """Return the ways between pixels of the frame after the span."""
        return self._after[span]


def spanning(first: Whole, second: Whole, rough: Stack, names: Whole) -> Tree:
    """Return a tree of the ends that have names, with how rough the best ways between them get.

    Parameters
    ----------
    first, second, rough
        Steps between nodes, see `PixelGraph`.
    names : ndarray of int
        The name of every node; -2 where it has none.
    """
    return Tree(*joined(smoothest_first(rough), first, second, rough, names))


@compiled
def call_by_pixels(names: Whole, nodes: Whole, more: int) -> None:
    """Call every node of a frame by the first of its pixels, counted from a number on."""
    for pixel in range(len(nodes) - 1, -1, -1):
        names[nodes[pixel]] = pixel + more


@compiled
def joined(
    order: Whole, first: Whole, second: Whole, rough: Stack, names: Whole
) -> tuple[Whole, Whole, Stack]:
    """Join nodes along steps in order, and list the joins of parts that have named ends.

    Of all named ends that a part has, any will do.
    """
    n = len(names)
    parent = np.arange(n).astype(np.int32)
    size = np.ones(n, dtype=np.int32)
    end = names.copy()
    most = np.count_nonzero(names != NO_NAME)
    one, other = np.empty(most, dtype=np.int32), np.empty(most, dtype=np.int32)
    how = np.empty(most, dtype=np.float32)
    count = 0
    for i in order:
        a, b = first[i], second[i]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a == b:
            continue
        if size[a] < size[b]:
            a, b = b, a
        parent[b] = a
        size[a] += size[b]
        if end[a] != NO_NAME and end[b] != NO_NAME:
            one[count], other[count], how[count] = end[a], end[b], rough[i]
            count += 1
        elif end[b] != NO_NAME:
            end[a] = end[b]
    return one[:count], other[:count], how[:count]
