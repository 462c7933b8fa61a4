"""The tree of cheapest steps between groups, without sorting (Boruvka 1926).

In each round every group is joined along its cheapest step to another; steps inside a group are
dropped. Equal costs go by their place in the list, so that the result is that of Kruskal's order.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from napari_phase4d.compiling import compiled
from napari_phase4d.progress import nothing
from napari_phase4d.unwrapping.growing.groups import join, number
from napari_phase4d.unwrapping.growing.rows import Floats, Whole

__all__ = ["join_cheapest", "pass_on"]


@compiled
def leave_out_alone(first: Whole, second: Whole, n: int) -> Whole:
    """Give groups that have steps new numbers, in both lists; return which they are."""
    place = np.full(n, -1, dtype=np.int32)
    for e in range(len(first)):
        place[first[e]] = 0
        place[second[e]] = 0
    count = 0
    for i in range(n):
        if place[i] == 0:
            place[i] = count
            count += 1
    for e in range(len(first)):
        first[e], second[e] = place[first[e]], place[second[e]]
    which = np.empty(count, dtype=np.int32)
    for i in range(n):
        if place[i] >= 0:
            which[place[i]] = i
    return which


@compiled
def among_all(
    which: Whole, of_some: Whole, turns_of_some: Whole, group: Whole, turns: Whole
) -> int:
    """Return how many groups are left when some of all have been joined to each other."""
    for i in range(len(group)):
        group[i] = i
        turns[i] = 0
    first = np.full(len(which), -1, dtype=np.int32)
    for k in range(len(which)):
        part = of_some[k]
        if first[part] < 0:
            first[part] = which[k]
        group[which[k]] = first[part]
        turns[which[k]] = turns_of_some[k]
    return number(group, turns)


@compiled
def cheapest_steps(first: Whole, second: Whole, cost: Floats, n: int) -> Whole:
    """Return the number of each group's cheapest step; -1 where it has none."""
    cheapest = np.full(n, np.inf)
    which = np.full(n, -1, dtype=np.int32)
    for e in range(len(cost)):
        c = cost[e]
        for end in (first[e], second[e]):
            cheaper = (c < cheapest[end]) | (which[end] < 0)  # infinite ones come last
            cheapest[end] = c if cheaper else cheapest[end]
            which[end] = e if cheaper else which[end]
    return which


@compiled
def join_along(
    which: Whole, first: Whole, second: Whole, steps: Whole, parent: Whole, turns: Whole
) -> int:
    """Join each group along a step; return how many are left, numbered in ``parent``."""
    for i in range(len(which)):
        parent[i] = i
        turns[i] = 0
    for i in range(len(which)):
        e = which[i]
        if e >= 0:
            join(parent, turns, first[e], second[e], steps[e])
    return number(parent, turns)


@compiled
def keep_between(
    first: Whole, second: Whole, steps: Whole, cost: Floats, group: Whole, turns: Whole
) -> int:
    """Keep the steps between different new groups at the front; return how many there are."""
    kept = 0
    for e in range(len(cost)):
        a, b = first[e], second[e]
        # Written in any case, and overwritten by the next if it was not to be kept.
        steps[kept] = steps[e] + turns[a] - turns[b]
        first[kept], second[kept], cost[kept] = group[a], group[b], cost[e]
        kept += int(group[a] != group[b])
    return kept


@compiled
def pass_on(group: Whole, turns: Whole, of_group: Whole, turns_of_group: Whole) -> None:
    """Replace groups by the groups that they are in."""
    for i in range(len(group)):
        inner = group[i]
        turns[i] += turns_of_group[inner]
        group[i] = of_group[inner]


def join_cheapest(
    first: Whole,
    second: Whole,
    steps: Whole,
    cost: Floats,
    n: int,
    check: Callable[[], None] = nothing,
) -> tuple[Whole, Whole, int]:
    """Join groups along the cheapest steps until none is left between two of them.

    Parameters
    ----------
    first, second : ndarray of int32, shape (n_steps,)
        The two groups of every step; overwritten.
    steps : ndarray of int32, shape (n_steps,)
        Turns of the second minus those of the first; overwritten.
    cost : ndarray of float64, shape (n_steps,)
        Cost of every step, infinite ones last; overwritten.
    n : int
        Number of groups.
    check : callable, optional
        Called before every round; may raise to stop.

    Returns
    -------
    part, turns : ndarray of int32, shape (n,)
        Number of the part that each group belongs to, and its turns relative to the part's first
        group.
    n_parts : int
        Number of parts.
    """
    with_steps = leave_out_alone(first, second, n)
    rounds = []
    left = len(with_steps)
    while True:
        check()
        which = cheapest_steps(first, second, cost, left)
        group, turns = np.empty(left, dtype=np.int32), np.empty(left, dtype=np.int32)
        left = join_along(which, first, second, steps, group, turns)
        rounds.append((group, turns))
        kept = keep_between(first, second, steps, cost, group, turns)
        first, second, steps, cost = first[:kept], second[:kept], steps[:kept], cost[:kept]
        if kept == 0:
            break
    for outer in reversed(rounds[:-1]):
        pass_on(*outer, *rounds.pop())
        rounds[-1] = outer
    part, relative = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
    n_parts = among_all(with_steps, *rounds[0], part, relative)
    return part, relative, n_parts
