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

__all__ = ["held_by_steps", "smoothest_first", "weight_of_hold"]

#: Weight of a step that holds a part: (1 + roughness)^-2, roughness in radians.
GENTLE = 2.0

Numbers = NDArray[np.float64]
Whole = NDArray[np.int32]
Short = NDArray[np.int16]
Stack = NDArray[np.float32]


def smoothest_first(rough: Stack) -> Whole:
    """Return the numbers of steps, the smoothest first; of equal ones the first.

    Both go into one whole number each, which is twice as fast to sort as `numpy.argsort`.
    """
    bits = (rough + np.float32(0)).view(np.int32).astype(np.int64)  # adding 0 takes the sign of -0
    bits ^= (bits >> 63) & 0x7FFFFFFF  # numbers below 0 count downwards
    bits <<= 32
    bits |= np.arange(len(bits))
    bits.sort()
    bits &= 0xFFFFFFFF
    return bits.astype(np.int32)


def weight_of_hold(rough: Stack) -> Numbers:
    """Return what a step of such roughness, in radians, holds."""
    found: Numbers = (1 + np.maximum(rough, 0).astype(np.float64)) ** -GENTLE
    return found


def held_by_steps(
    first: Whole,
    second: Whole,
    off: Short,
    rough: Stack,
    n: int,
    no_way: float,
    order: Whole | None = None,
    shared: tuple[Numbers, Whole] | None = None,
) -> tuple[Stack, Stack]:
    """Return how rough the way from node 0 to each node gets, and how firmly each is held.

    Parameters
    ----------
    first, second : ndarray of int
        The nodes at both ends of every step.
    off : ndarray of int16
        By how many turns a result differs from what each step asks for.
    rough : ndarray of float
        Roughness of every step in radians.
    n : int
        Number of nodes.
    no_way : float
        Roughness that stands for no way at all.
    order : ndarray of int, optional
        The steps that the result agrees with, `smoothest_first`, where these are known.
    shared : tuple of ndarray, optional
        What some of the steps, the last that have an ``off``, hold and how many each stands for.

    Steps that have no ``off``, those after all others, are but ways: they hold nothing.

    Returns
    -------
    worst : ndarray of float
        The roughest step, in radians, on the smoothest way from node 0 along steps that agree.
    held : ndarray of float
        From -1 to 1: of all parts that a node belongs to before node 0 does, the least of what a
        turn up or down would cost, a step at the rim counting (1 + roughness)^-2, divided by the
        number of steps at the rim. 1 for node 0, at most 0 where no way leads.
    """
    if order is None:
        order = smoothest_first(rough)
        order = order[off[order] == 0]
    parent, when, left, right, made = parts_of(order, first, second, rough, n)
    none = np.zeros(0), np.zeros(0, dtype=np.int32)
    up, down, count = rims(
        first, second, off, rough, *(shared or none), parent, when, n, len(left)
    )
    del parent, when
    add_parts(left, right, up, down, count, n)
    np.minimum(up, down, out=up)
    up /= np.maximum(count, 1)
    return least_on_the_way(left, right, up, made, n, no_way)


@compiled
def parts_of(
    order: Whole, first: Whole, second: Whole, rough: Stack, n: int
) -> tuple[Whole, Whole, Whole, Whole, Stack]:
    """Join nodes along steps in order; return the tree of roots, and the two parts of each merge.

    The parent of every node and the number of the merge that gave it one; then the parts that
    each merge joined, where nodes come first and merge i makes part n + i; then the roughness at
    which each part was made, which for a node is less than any.
    """
    parent = np.arange(n).astype(np.int32)
    when = np.full(n, 2**31 - 1, dtype=np.int32)
    size = np.ones(n, dtype=np.int32)
    part = np.arange(n).astype(np.int32)
    left = np.empty(max(n - 1, 0), dtype=np.int32)
    right = np.empty(max(n - 1, 0), dtype=np.int32)
    made = np.full(n + len(left), -np.inf, dtype=np.float32)
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
        made[n + count] = rough[i]
        count += 1
    return parent, when, left[:count], right[:count], made[: n + count]


@compiled
def joined_by(a: int, b: int, parent: Whole, when: Whole) -> int:
    """Return the merge that put two nodes into one part; -1 where none did."""
    merge = -1
    while a != b:
        if when[a] > when[b]:
            a, b = b, a
        if parent[a] == a:
            return -1
        merge = when[a]
        a = parent[a]
    return merge


@compiled
def rims(
    first: Whole,
    second: Whole,
    off: Short,
    rough: Stack,
    weight: Numbers,
    number: Whole,
    parent: Whole,
    when: Whole,
    n: int,
    merges: int,
) -> tuple[Numbers, Numbers, Whole]:
    """Return what a turn up and down costs every node, and how many steps it has.

    For each merge, what its two parts have in common and is to be taken off their sum.
    """
    up, down = np.zeros(n + merges), np.zeros(n + merges)
    count = np.zeros(n + merges, dtype=np.int32)
    plain = len(off) - len(weight)
    for i in range(len(off)):
        a, b = first[i], second[i]
        holds, many = 0.0, 1
        if i < plain:
            holds = (1.0 + max(np.float64(rough[i]), 0.0)) ** -GENTLE
        else:
            holds, many = weight[i - plain], number[i - plain]
        more = holds * (abs(off[i] + 1) - abs(off[i]))
        less = holds * (abs(off[i] - 1) - abs(off[i]))
        up[b] += more
        down[b] += less
        up[a] += less
        down[a] += more
        count[a] += many
        count[b] += many
        merge = joined_by(a, b, parent, when)
        if merge >= 0:
            up[n + merge] -= more + less
            down[n + merge] -= more + less
            count[n + merge] -= 2 * many
    return up, down, count


@compiled
def add_parts(left: Whole, right: Whole, up: Numbers, down: Numbers, count: Whole, n: int) -> None:
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
