"""How firmly steps hold the turns of a result: parts that grow along smooth steps, and their rims.

Pixels are joined along the steps that a result agrees with, smoothest first, as Kruskal does. Each
part that exists on the way could be a turn off as a whole; what speaks against that are the steps
at its rim. So every part is held by a number of its own, and every pixel by the least of the
parts that it belonged to before it joined the empty field.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = ["held_by_steps"]

#: Weight of a step that holds a part: (1 + roughness)^-2, roughness in radians.
GENTLE = 2.0

Numbers = NDArray[np.float64]
Whole = NDArray[np.int32]
Stack = NDArray[np.float32]


def held_by_steps(
    first: Whole,
    second: Whole,
    off: Whole,
    rough: Stack,
    n: int,
    no_way: float,
    counted: int | None = None,
) -> tuple[Stack, Stack]:
    """Return how rough the way from node 0 to each node gets, and how firmly each is held.

    Parameters
    ----------
    first, second : ndarray of int
        The nodes at both ends of every step.
    off : ndarray of int
        By how many turns a result differs from what each step asks for.
    rough : ndarray of float
        Roughness of every step in radians.
    n : int
        Number of nodes.
    no_way : float
        Roughness that stands for no way at all.
    counted : int, optional
        How many of the steps, the first ones, hold parts at their rims; the others are but ways.
        Default all.

    Returns
    -------
    worst : ndarray of float
        The roughest step, in radians, on the smoothest way from node 0 along steps that agree.
    held : ndarray of float
        From -1 to 1: of all parts that a node belongs to before node 0 does, the least of what a
        turn up or down would cost, a step at the rim counting (1 + roughness)^-2, divided by the
        number of steps at the rim. 1 for node 0, at most 0 where no way leads.
    """
    agreeing = np.flatnonzero(off == 0)
    order = agreeing[np.argsort(rough[agreeing], kind="stable")]
    parent, when, left, right = parts_of(order, first, second, n)
    weight = (1 + np.maximum(rough, 0).astype(np.float64)) ** -GENTLE
    joined = np.full(len(first), -1, dtype=np.int32)
    when_joined(first, second, parent, when, joined)
    up, down, count = rims(
        first,
        second,
        off,
        weight,
        joined,
        n,
        len(left),
        len(first) if counted is None else counted,
    )
    add_parts(left, right, up, down, count, n)
    firmness = np.minimum(up, down) / np.maximum(count, 1)
    made = np.full(len(up), -np.inf, dtype=np.float32)
    made[n:] = rough[order[merging(order, first, second, joined)]]
    return least_on_the_way(left, right, firmness, made, n, no_way)


def merging(
    order: NDArray[np.intp], first: Whole, second: Whole, joined: Whole
) -> NDArray[np.intp]:
    """Return which of the ordered steps made each merge: the first that it joined."""
    _, places = np.unique(joined[order], return_index=True)
    return places


@compiled
def parts_of(
    order: NDArray[np.intp], first: Whole, second: Whole, n: int
) -> tuple[Whole, Whole, Whole, Whole]:
    """Join nodes along steps in order; return the tree of roots, and the two parts of each merge.

    The parent of every node and the number of the merge that gave it one; then the parts that
    each merge joined, where nodes come first and merge i makes part n + i.
    """
    parent = np.arange(n).astype(np.int32)
    when = np.full(n, 2**31 - 1, dtype=np.int32)
    size = np.ones(n, dtype=np.int32)
    part = np.arange(n).astype(np.int32)
    left = np.empty(max(n - 1, 0), dtype=np.int32)
    right = np.empty(max(n - 1, 0), dtype=np.int32)
    count = 0
    for i in order:
        a, b = first[i], second[i]
        while parent[a] != a:
            a = parent[a]
        while parent[b] != b:
            b = parent[b]
        if a == b:
            continue
        if size[a] < size[b]:
            a, b = b, a
        left[count], right[count] = part[a], part[b]
        parent[b], when[b] = a, count
        size[a] += size[b]
        part[a] = n + count
        count += 1
    return parent, when, left[:count], right[:count]


@compiled
def when_joined(first: Whole, second: Whole, parent: Whole, when: Whole, joined: Whole) -> None:
    """Note the merge that put both ends of each step into one part; nothing where none did."""
    for i in range(len(first)):
        a, b = first[i], second[i]
        merge = -1
        while a != b:
            if when[a] > when[b]:
                a, b = b, a
            if parent[a] == a:
                merge = -1
                break
            merge = when[a]
            a = parent[a]
        joined[i] = merge


@compiled
def rims(
    first: Whole,
    second: Whole,
    off: Whole,
    weight: Numbers,
    joined: Whole,
    n: int,
    merges: int,
    counted: int,
) -> tuple[Numbers, Numbers, Numbers]:
    """Return what a turn up and down costs every node, and how many steps it has.

    For each merge, what its two parts have in common and is to be taken off their sum.
    """
    up, down = np.zeros(n + merges), np.zeros(n + merges)
    count = np.zeros(n + merges)
    for i in range(counted):
        a, b, w = first[i], second[i], weight[i]
        more = w * (abs(off[i] + 1) - abs(off[i]))
        less = w * (abs(off[i] - 1) - abs(off[i]))
        up[b] += more
        down[b] += less
        up[a] += less
        down[a] += more
        count[a] += 1
        count[b] += 1
        if joined[i] >= 0:
            part = n + joined[i]
            up[part] -= more + less
            down[part] -= more + less
            count[part] -= 2
    return up, down, count


@compiled
def add_parts(
    left: Whole, right: Whole, up: Numbers, down: Numbers, count: Numbers, n: int
) -> None:
    """Add what both parts of each merge have to what the merge has."""
    for i in range(len(left)):
        for part in (left[i], right[i]):
            up[n + i] += up[part]
            down[n + i] += down[part]
            count[n + i] += count[part]


@compiled
def least_on_the_way(
    left: Whole, right: Whole, firmness: Numbers, made: Stack, n: int, no_way: float
) -> tuple[Stack, Stack]:
    """Return for every node the roughest merge on its way to node 0, and how firmly it is held.

    Parts that merge on at the same roughness at which they were made exist in one order of equal
    steps and not in another; they don't count.
    """
    total = n + len(left)
    ground = np.zeros(total, dtype=np.bool_)
    ground[0] = True
    alone = np.ones(total, dtype=np.bool_)
    for i in range(len(left)):
        ground[n + i] = ground[left[i]] or ground[right[i]]
        alone[left[i]] = alone[right[i]] = False
    worst = np.full(total, no_way, dtype=np.float32)
    held = np.zeros(total, dtype=np.float32)
    for part in range(total):
        if alone[part]:
            held[part] = min(0.0, firmness[part])
    for i in range(len(left) - 1, -1, -1):
        whole = n + i
        for part in (left[i], right[i]):
            if ground[part]:
                continue
            held[part] = held[whole]
            worst[part] = worst[whole]
            if ground[whole]:
                held[part] = 1.0
                worst[part] = made[whole]
            if made[whole] > made[part]:
                held[part] = min(held[part], firmness[part])
    worst[0], held[0] = 0.0, 1.0
    return worst[:n], held[:n]
