"""Whole turns that disagree least with all steps: weighted L1, solved exactly by minimum cuts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.directional.cut import graph_of_pairs, sink_side
from napari_phase4d.unwrapping.directional.forest import joined
from napari_phase4d.unwrapping.directional.steps import Steps

__all__ = ["Limit", "growing", "least_turns", "weight_of"]

#: Weight of a step: (SOFTENING + roughness)^-POWER, roughness in radians.
SOFTENING, POWER = 0.5, 6
#: Steps smoother and smaller than this, in radians, are never doubted: their ends move together.
CERTAIN = 1.0

#: Gains smaller than this share of the cost are rounding.
SMALLEST_GAIN = 1e-9

Whole = NDArray[np.int32]


@dataclass(frozen=True)
class Limit:
    """What nodes pay for fewer turns than some.

    Parameters
    ----------
    lowest : ndarray of int
        Turns of every node that cost nothing, and more of them neither.
    weight : ndarray of float
        What each turn less costs.
    """

    lowest: Whole
    weight: NDArray[np.float64]


@dataclass(frozen=True)
class Regions:
    """Nodes that move together.

    Parameters
    ----------
    of_node : ndarray of int
        Region of every node.
    relative : ndarray of int
        Turns of every node relative to its region.
    first, second, turns, weight : ndarray
        Steps between regions: both ends, turns between them, and what a turn less or more costs.
    """

    of_node: Whole
    relative: Whole
    first: Whole
    second: Whole
    turns: NDArray[np.int64]
    weight: NDArray[np.float64]


def weight_of(roughness: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the weight of steps of some roughness in radians."""
    weight: NDArray[np.float64] = (SOFTENING + roughness.astype(np.float64)) ** -POWER
    return weight


def growing(steps: Steps, n: int) -> tuple[Whole, Whole]:
    """Return group and relative turns of every node: steps are gone along, smoothest first."""
    order = np.argsort(steps.roughness, kind="stable")
    group, relative = joined(steps.first, steps.second, steps.turns, order, n)
    return group, relative


def regions_of(steps: Steps, alone: NDArray[np.bool_], n_islands: int) -> Regions:
    """Put the nodes together that certain steps join.

    Nodes that are to be left ``alone`` are not joined to anything, and islands of the empty field
    not to each other: of the many steps between two of them, one may look certain by accident.
    """
    n = len(alone)
    certain = np.flatnonzero(
        (steps.roughness < CERTAIN)
        & (steps.size < CERTAIN)
        & ~alone[steps.first]
        & ~alone[steps.second]
        & (np.maximum(steps.first, steps.second) >= n_islands)
    )
    order = certain[np.argsort(steps.roughness[certain], kind="stable")]
    root, relative = joined(steps.first, steps.second, steps.turns, order, n)
    _, region = np.unique(root, return_inverse=True)
    a, b = region[steps.first], region[steps.second]
    across = a != b
    a, b = a[across], b[across]
    first, second = steps.first[across], steps.second[across]
    turns = steps.turns[across].astype(np.int64) - relative[second] + relative[first]
    weight = weight_of(steps.roughness[across])
    swapped = a > b
    a, b = np.where(swapped, b, a), np.where(swapped, a, b)
    turns = np.where(swapped, -turns, turns)
    # Steps between the same two regions that ask for the same turns count as one.
    order = np.lexsort((turns, b, a))
    a, b, turns, weight = a[order], b[order], turns[order], weight[order]
    new = np.ones(len(a), dtype=bool)
    new[1:] = (a[1:] != a[:-1]) | (b[1:] != b[:-1]) | (turns[1:] != turns[:-1])
    starts = np.flatnonzero(new)
    summed = np.add.reduceat(weight, starts) if len(starts) else weight
    return Regions(
        region.astype(np.int32),
        relative,
        a[starts].astype(np.int32),
        b[starts].astype(np.int32),
        turns[starts],
        summed,
    )


def least_turns(
    steps: Steps,
    start: Whole,
    check: Callable[[], None],
    limit: Limit | None = None,
    n_islands: int = 1,
) -> Whole:
    """Return the turns of every node that cost least.

    The cost sum W |k_q - k_p - J| is convex in the turns k, so that moving some nodes up or down
    by one as long as that helps ends at its minimum; which nodes to move is a minimum cut.

    Parameters
    ----------
    steps : Steps
        All steps.
    start : ndarray of int
        Turns of every node to begin with. Node 0 keeps its own.
    check : callable
        Called before every cut; may raise to stop.
    limit : Limit, optional
        What some nodes pay for too few turns.
    n_islands : int, optional
        How many of the first nodes are islands of the empty field.
    """
    alone = np.zeros(len(start), dtype=bool)
    if limit is not None:
        # What certain steps have led below the limit is doubted one by one.
        alone = (start < limit.lowest) & (limit.weight > 0)
    regions = regions_of(steps, alone, n_islands)
    n = int(regions.of_node.max()) + 1
    turns = np.zeros(n, dtype=np.int64)
    turns[regions.of_node] = start - regions.relative
    held = int(regions.of_node[0])
    turns[held] = start[0] - regions.relative[0]
    moves = Moves(regions, n, held, limit)
    cost = moves.cost(turns)
    failed, up = 0, 1
    while failed < 2:
        check()
        moved = turns + up * moves.best(turns, up)
        new = moves.cost(moved)
        if new < cost - SMALLEST_GAIN * max(cost, 1.0):
            turns, cost, failed = moved, new, 0
        else:
            failed += 1
            up = -up
    found: Whole = (turns[regions.of_node] + regions.relative).astype(np.int32)
    return found


class Moves:
    """Which regions to move by one turn, so that the cost falls most.

    Parameters
    ----------
    regions : Regions
        With the steps between them.
    n : int
        Number of regions.
    held : int
        Region that never moves.
    limit : Limit or None
        What some nodes pay for too few turns.
    """

    def __init__(self, regions: Regions, n: int, held: int, limit: Limit | None) -> None:
        self.regions = regions
        self.n = n
        self.held = held
        self.limit = limit
        pair = regions.first.astype(np.int64) * n + regions.second
        pairs, self.pair = np.unique(pair, return_inverse=True)
        self.first = (pairs // n).astype(np.int32)
        self.second = (pairs % n).astype(np.int32)
        self.free = (self.first != held) & (self.second != held)
        self.graph = graph_of_pairs(self.first[self.free], self.second[self.free], n)

    def residual(self, turns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return by how many turns each step is off."""
        r = self.regions
        found: NDArray[np.int64] = turns[r.second] - turns[r.first] - r.turns
        return found

    def cost(self, turns: NDArray[np.int64]) -> float:
        """Return the cost of some turns."""
        steps = (self.regions.weight * np.abs(self.residual(turns))).sum()
        return float(steps + self.below(turns).sum())

    def below(self, turns: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return what the nodes of each region pay for too few turns."""
        if self.limit is None:
            return np.zeros(self.n)
        r = self.regions
        missing = np.maximum(self.limit.lowest - turns[r.of_node] - r.relative, 0)
        paid: NDArray[np.float64] = np.bincount(r.of_node, self.limit.weight * missing, self.n)
        return paid

    def best(self, turns: NDArray[np.int64], up: int) -> NDArray[np.bool_]:
        """Return the regions whose move by ``up`` (1 or -1) makes the cost smallest."""
        weight, off = self.regions.weight, self.residual(turns)
        n_pairs = len(self.first)

        def summed(values: NDArray[np.float64]) -> NDArray[np.float64]:
            total: NDArray[np.float64] = np.bincount(self.pair, values, n_pairs)
            return total

        now = summed(weight * np.abs(off))
        second_moves = summed(weight * np.abs(off + up)) - now
        first_moves = summed(weight * np.abs(off - up)) - now
        # Both fixed ends and pairs give each region a cost of its own for moving.
        own = np.bincount(self.first, first_moves, self.n)
        own += np.bincount(
            self.second, np.where(self.first == self.held, second_moves, -first_moves), self.n
        )
        own = own + self.below(turns + up) - self.below(turns)
        start, head, reverse, place = self.graph
        pairs = int(self.free.sum())
        capacity = np.zeros(2 * pairs)
        capacity[place[:pairs]] = np.maximum(first_moves + second_moves, 0)[self.free]
        moving = sink_side(start, head, reverse, capacity, np.maximum(own, 0), np.maximum(-own, 0))
        moving[self.held] = False
        return moving
