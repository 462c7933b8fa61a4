"""Merging pixels to groups along the cheapest steps, in compiled loops.

Steps that may be joined at once, in whatever order, are marked. Bit k of a pixel's mark says that
the step from it to the next pixel along axis k is to be joined; axis 3 is x. Pixels are joined to
runs along x first, then runs to those of the neighbouring rows, so that few steps need a look at
the groups. If steps were marked that disagree, that is seen.

Groups are those of union-find whose roots come first: every pixel points to one that comes no
later, so that a single pass in order flattens all.

Steps that are left between groups go through Boruvka's rounds (1926), without sorting. In each
round every group is joined along its cheapest step to another; steps inside a group are dropped.
Equal costs go by their place in the list, so that the result is that of Kruskal's order.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.task import nothing
from napari_phase4d.unwrapping.growing.rows import (
    Floats,
    Phase,
    Shape,
    Whole,
    costs_across,
    costs_along,
    jump,
    row_after,
    row_before,
)

__all__ = [
    "among_all",
    "cheapest_steps",
    "count_between",
    "join_along",
    "join_cheapest",
    "joined",
    "keep_between",
    "leave_out_alone",
    "list_between",
    "mark_cheap",
    "mark_cheapest_of_each",
    "pass_on",
]

Marks = NDArray[np.uint8]
ALONG_X = np.uint8(8)


@compiled
def mark_cheap(point: Floats, steps: Floats, shape: Shape, limit: float, marks: Marks) -> None:
    """Mark all steps that cost less than a limit below which loops of four steps close.

    The last step of such a loop says nothing new and is left out, where it lies between rows.

    Parameters
    ----------
    point, steps : ndarray of float64
        What steps cost, see `costs_along`.
    shape : tuple of int
        The grid, see `full_shape`.
    limit : float
        No larger than `residue_limit` says.
    marks : ndarray of uint8, shape (rows, nx)
        Where marks are added.
    """
    nx = shape[3]
    costs = np.empty((3, nx))
    for row in range(len(marks)):
        costs_along(point, steps, row, costs[0, :-1])
        mark_below(costs[0, :-1], limit, ALONG_X, marks[row, :-1])
        for axis in range(3):
            before = row_before(row, axis, shape)
            if before >= 0:
                costs_along(point, steps, before, costs[1, :-1])
                costs_across(point, steps, axis, before, row, costs[2])
                mark_first_of_squares(costs, limit, np.uint8(1 << axis), marks[before])


@compiled
def mark_below(costs: Floats, limit: float, bit: np.uint8, marks: Marks) -> None:
    """Mark the steps that cost less than a limit."""
    for x in range(len(costs)):
        marks[x] |= bit if costs[x] < limit else np.uint8(0)


@compiled
def mark_first_of_squares(costs: Floats, limit: float, bit: np.uint8, marks: Marks) -> None:
    """Mark the cheap steps between two rows, but for those that close a loop of cheap steps."""
    along_here, along_before, across = costs[0], costs[1], costs[2]
    if across[0] < limit:
        marks[0] |= bit
    next_across, next_marks = across[1:], marks[1:]
    for x in range(len(next_marks)):
        others = max(max(along_here[x], along_before[x]), across[x])
        wanted = (next_across[x] < limit) & (others >= limit)
        next_marks[x] |= bit if wanted else np.uint8(0)


@compiled
def mark_cheapest_of_each(
    point: Floats,
    steps: Floats,
    shape: Shape,
    limit: float,
    marks: Marks,
    start: int,
    stop: int,
) -> None:
    """Mark the cheapest step of every pixel whose steps all cost no less than a limit.

    Of equal ones it is the first in the order of the grid. The tree of cheapest steps holds all
    of them (the first round of Boruvka 1926). Only pixels of the rows from ``start`` to before
    ``stop`` are asked, and steps that lead out of these are not marked. Other parameters as of
    `mark_cheap`.
    """
    nx = shape[3]
    costs, best = np.empty(nx), np.empty(nx)
    which = np.empty(nx, dtype=np.uint8)
    for row in range(start, stop):
        best[:] = np.inf
        which[:] = 255
        for axis in range(3):
            before = row_before(row, axis, shape)
            if before >= 0:
                costs_across(point, steps, axis, before, row, costs)
                keep_cheaper(costs, np.uint8(axis), best, which)
        costs_along(point, steps, row, costs[:-1])
        keep_cheaper(costs[:-1], np.uint8(3), best[1:], which[1:])  # from the left
        keep_cheaper(costs[:-1], np.uint8(4), best[:-1], which[:-1])
        for axis in (2, 1, 0):
            after = row_after(row, axis, shape)
            if after >= 0:
                costs_across(point, steps, axis, row, after, costs)
                keep_cheaper(costs, np.uint8(5 + axis), best, which)
        for x in range(nx):
            which[x] = which[x] if best[x] >= limit else np.uint8(255)
        for axis in range(3):
            before = row_before(row, axis, shape)
            if before >= start:
                mark_where(which, np.uint8(axis), np.uint8(1 << axis), marks[before])
            if row_after(row, axis, shape) < stop:
                mark_where(which, np.uint8(5 + axis), np.uint8(1 << axis), marks[row])
        mark_where(which[1:], np.uint8(3), ALONG_X, marks[row, :-1])
        mark_where(which, np.uint8(4), ALONG_X, marks[row])


@compiled
def keep_cheaper(costs: Floats, number: np.uint8, best: Floats, which: Marks) -> None:
    """Keep the lower costs, and which step has them."""
    for x in range(len(costs)):
        cheaper = costs[x] < best[x]
        best[x] = costs[x] if cheaper else best[x]
        which[x] = number if cheaper else which[x]


@compiled
def mark_where(which: Marks, number: np.uint8, bit: np.uint8, marks: Marks) -> None:
    """Mark the pixels whose cheapest step has a number."""
    for x in range(len(which)):
        marks[x] |= bit if which[x] == number else np.uint8(0)


@compiled
def root_of(parent: Whole, turns: Whole, i: int) -> tuple[np.int64, np.int32]:
    """Return a pixel's root and its turns relative to it, halving the way there."""
    total, at = np.int32(0), np.int64(i)
    up = np.int64(parent[at])
    while up != at:
        top = np.int64(parent[up])
        if top != up:
            turns[at] += turns[up]
            parent[at] = np.int32(top)
        total += turns[at]
        at = top
        up = np.int64(parent[at])
    return at, total


@compiled
def join(parent: Whole, turns: Whole, i: int, j: int, step: np.int32) -> bool:
    """Put two pixels into one group, with turns(j) - turns(i) = step.

    Returns
    -------
    bool
        Whether that agrees with what was known before.
    """
    first, of_first = root_of(parent, turns, i)
    second, of_second = root_of(parent, turns, j)
    between = step + of_first - of_second  # turns(second root) - turns(first root)
    if first == second:
        return bool(between == 0)
    if first < second:
        parent[second] = first
        turns[second] = between
    else:
        parent[first] = second
        turns[first] = -between
    return True


@compiled
def number(parent: Whole, turns: Whole) -> int:
    """Replace every pixel's parent by the number of its group; return how many there are.

    Turns become those relative to the group's root.
    """
    count = np.int32(0)
    for i in range(len(parent)):
        up = parent[i]
        is_root = up == i
        known = parent[up]  # the one before has its number already
        turns[i] += turns[up]  # a root has none
        parent[i] = count if is_root else known
        count += np.int32(is_root)
    return int(count)


@compiled
def joined(
    wrapped: Phase, shape: Shape, half: float, marks: Marks, group: Whole, turns: Whole
) -> int:
    """Join all pixels along marked steps.

    Parameters
    ----------
    wrapped, shape, half
        See `residue_limit`.
    marks : ndarray of uint8, shape (rows, nx)
        Steps to join.
    group, turns : ndarray of int32, shape (rows, nx)
        Where the number of each pixel's group, and its turns in it, go.

    Returns
    -------
    int
        Number of groups; -1 if marked steps disagree.
    """
    parent, relative = group.ravel(), turns.ravel()
    places = np.empty(shape[3], dtype=np.int32)
    for row in range(len(wrapped)):
        runs(wrapped[row], half, marks[row], row * shape[3], group[row], turns[row])
        for axis in range(3):
            before = row_before(row, axis, shape)
            if before < 0:
                continue
            n = places_of(marks[before], np.uint8(1 << axis), places)
            if not join_rows(wrapped, before, row, half, places[:n], parent, relative):
                return -1
    return number(parent, relative)


@compiled
def join_rows(
    wrapped: Phase, before: int, row: int, half: float, places: Whole, parent: Whole, turns: Whole
) -> bool:
    """Join two rows in some places; return whether all agree."""
    above, here = wrapped[before], wrapped[row]
    first, second = before * len(here), row * len(here)
    for k in range(len(places)):
        x = int(places[k])
        if not join(parent, turns, first + x, second + x, jump(above[x], here[x], half)):
            return False
    return True


@compiled
def places_of(marks: Marks, bit: np.uint8, places: Whole) -> int:
    """List where a bit is set, without a branch to be guessed; return how often it is."""
    count = 0
    for x in range(len(marks)):
        places[count] = x
        count += int((marks[x] & bit) != 0)
    return count


@compiled
def runs(here: Phase, half: float, marks: Marks, start: int, parent: Whole, turns: Whole) -> None:
    """Join the pixels of a row along its marked steps, each to the first of its run."""
    first, total = np.int32(start), np.int32(0)
    parent[0], turns[0] = first, total
    for x in range(1, len(here)):
        goes_on = (marks[x - 1] & ALONG_X) != 0
        step = total + jump(here[x - 1], here[x], half)
        first = first if goes_on else np.int32(start + x)
        total = step if goes_on else np.int32(0)
        parent[x], turns[x] = first, total


@compiled
def count_between(
    point: Floats, steps: Floats, shape: Shape, below: float, group: Whole, start: int
) -> int:
    """Return how many steps of a grid that cost less than ``below`` lie between two groups.

    Steps to the rows before ``start`` are left out, unless they lead on from there.
    """
    costs = np.empty(shape[3])
    count = 0
    for row in range(start, len(group)):
        here = group[row]
        costs_along(point, steps, row, costs[:-1])
        count += differing(here[:-1], here[1:], costs, below)
        for axis in range(3):
            before = row_before(row, axis, shape)
            if before >= 0:
                costs_across(point, steps, axis, before, row, costs)
                count += differing(group[before], here, costs, below)
    return count


@compiled
def differing(one: Whole, other: Whole, costs: Floats, below: float) -> int:
    """Return in how many places two rows differ and the step between them costs less."""
    count = np.int32(0)
    for x in range(len(one)):
        count += np.int32((one[x] != other[x]) & (costs[x] < below))
    return int(count)


@compiled
def list_between(
    wrapped: Phase,
    half: float,
    point: Floats,
    steps: Floats,
    shape: Shape,
    below: float,
    group: Whole,
    turns: Whole,
    start: int,
    first: Whole,
    second: Whole,
    between: Whole,
    cost: Floats,
) -> None:
    """List the steps that cost less than ``below`` between groups, in the order of the grid.

    Parameters
    ----------
    wrapped, half, point, steps, shape
        See `residue_limit`.
    below : float
        Steps of this cost and more are left out.
    group, turns : ndarray of int32, shape (rows, nx)
        Group of every pixel, and its turns relative to that.
    start : int
        The first row to which steps are listed.
    first, second, between, cost : ndarray
        Where the groups, the turns between them and the costs go, as many as `count_between`
        says.
    """
    nx = shape[3]
    costs, places = np.empty(nx), np.empty(nx, dtype=np.int32)
    listed = 0
    for row in range(start, len(wrapped)):
        for axis in range(4):
            dx = int(axis == 3)  # along x, a row is compared with itself one pixel further
            before = row if dx else row_before(row, axis, shape)
            if before < 0:
                continue
            if dx:
                costs_along(point, steps, row, costs[:-1])
            else:
                costs_across(point, steps, axis, before, row, costs)
            one, other = group[before, : nx - dx], group[row, dx:]
            for k in range(differing_places(one, other, costs, below, places)):
                x = places[k]
                step = jump(wrapped[before, x], wrapped[row, x + dx], half)
                first[listed], second[listed] = one[x], other[x]
                between[listed] = step + turns[before, x] - turns[row, x + dx]
                cost[listed] = costs[x]
                listed += 1


@compiled
def differing_places(one: Whole, other: Whole, costs: Floats, below: float, places: Whole) -> int:
    """List where two rows differ and the step between them costs less; return how often."""
    count = 0
    for x in range(len(one)):
        places[count] = x
        count += int((one[x] != other[x]) & (costs[x] < below))
    return count


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
