"""Groups of pixels with whole turns between them: union-find along sorted edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.compiling import compiled

__all__ = ["joined"]

Whole = NDArray[np.int32]


@compiled
def root_of(parent: Whole, relative: Whole, i: int) -> tuple[int, int]:
    """Return a pixel's root and its turns relative to it, halving the way there."""
    total = 0
    while parent[i] != i:
        up = parent[i]
        if parent[up] != up:
            relative[i] += relative[up]
            parent[i] = parent[up]
        total += relative[i]
        i = parent[i]
    return i, total


@compiled
def joined(
    first: Whole, second: Whole, turns: Whole, order: NDArray[np.int64], n: int
) -> tuple[Whole, Whole]:
    """Join pixels along edges in the given order, as Kruskal does.

    Parameters
    ----------
    first, second : ndarray of int
        The two pixels of every edge.
    turns : ndarray of int
        Turns of the second pixel minus those of the first.
    order : ndarray of int
        Numbers of the edges to go along, the most trusted first.
    n : int
        Number of pixels.

    Returns
    -------
    group : ndarray of int, shape (n,)
        One pixel of its group for every pixel, the same for all of the group.
    relative : ndarray of int, shape (n,)
        Turns of each pixel relative to that one.
    """
    parent = np.arange(n).astype(np.int32)
    relative = np.zeros(n, dtype=np.int32)  # to the parent
    size = np.ones(n, dtype=np.int32)
    for e in order:
        a, to_a = root_of(parent, relative, first[e])
        b, to_b = root_of(parent, relative, second[e])
        if a == b:
            continue
        # k(second) - k(first) = turns, with k = root's + way to the root
        step = turns[e] + to_a - to_b  # k(root b) - k(root a)
        if size[a] < size[b]:
            parent[a] = b
            relative[a] = -step
            size[b] += size[a]
        else:
            parent[b] = a
            relative[b] = step
            size[a] += size[b]
    for i in range(n):
        root, total = i, 0
        while parent[root] != root:
            total += relative[root]
            root = parent[root]
        # Point straight at the root; pixels on the way keep their own, which stays right.
        if root != i:
            parent[i] = root
            relative[i] = total
    return parent, relative
