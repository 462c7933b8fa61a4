"""Whole turns that disagree least with all steps: weighted L1, solved exactly by minimum cuts.

A minimum cut of a graph with two terminals is found by push-relabel with global relabelling,
Goldberg & Tarjan 1988; first phase only, which is all that a minimum cut needs. Nodes are taken
first in, first out; distances to the sink are computed anew from time to time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.directional.bunches import Bunch
from napari_phase4d.unwrapping.growing import grow_list

__all__ = ["LeastTurns", "Limit", "graph_of_pairs", "sink_side"]

Index = NDArray[np.int32]
Numbers = NDArray[np.float64]

#: Distances are computed anew after this many units of work for every node and arc.
RELABEL_EVERY = 1.0


def graph_of_pairs(first: Index, second: Index, n: int) -> tuple[Index, Index, Index, Index]:
    """Return pairs of nodes as arcs in both directions, sorted by the node they leave.

    Parameters
    ----------
    first, second : ndarray of int
        The two nodes of every pair.
    n : int
        Number of nodes.

    Returns
    -------
    start : ndarray of int, shape (n + 1,)
        Where the arcs of each node begin.
    head : ndarray of int, shape (2 pairs,)
        Node that each arc leads to.
    reverse : ndarray of int, shape (2 pairs,)
        Number of the arc in the other direction.
    place : ndarray of int, shape (2 pairs,)
        Number of the arc of each pair from first to second, then of those from second to first.
    """
    start = np.zeros(n + 1, dtype=np.int32)
    start[1:] = np.cumsum(np.bincount(first, minlength=n) + np.bincount(second, minlength=n))
    place, head, reverse = (np.empty(2 * len(first), dtype=np.int32) for _ in range(3))
    place_arcs(first, second, start[:-1].copy(), place, head, reverse)
    return start, head, reverse, place


@compiled
def place_arcs(
    first: Index, second: Index, free: Index, place: Index, head: Index, reverse: Index
) -> None:
    """Put arcs in order, of each node in the order that they are given in."""
    pairs = len(first)
    for k in range(2 * pairs):
        tail, other = (first[k], second[k]) if k < pairs else (second[k - pairs], first[k - pairs])
        place[k] = free[tail]
        head[free[tail]] = other
        free[tail] += 1
    for k in range(pairs):
        reverse[place[k]], reverse[place[pairs + k]] = place[pairs + k], place[k]


@compiled
def distances(
    start: Index, head: Index, reverse: Index, capacity: Numbers, to_sink: Numbers, found: Index
) -> None:
    """Count the arcs that still lead from each node to the sink; n + 1 where none do."""
    n = len(start) - 1
    queue = np.empty(n, dtype=np.int32)
    first, last = 0, 0
    for i in range(n):
        if to_sink[i] > 0:
            found[i] = 1
            queue[last] = i
            last += 1
        else:
            found[i] = n + 1
    while first < last:
        i = queue[first]
        first += 1
        for arc in range(start[i], start[i + 1]):
            j = head[arc]
            if found[j] > n and capacity[reverse[arc]] > 0:
                found[j] = found[i] + 1
                queue[last] = j
                last += 1


@compiled
def lowest_above(
    i: int, start: Index, head: Index, capacity: Numbers, to_sink: Numbers, distance: Index
) -> int:
    """Return one more than the least distance that a node can push to."""
    lowest = len(start)
    if to_sink[i] > 0:
        lowest = 1
    for arc in range(start[i], start[i + 1]):
        if capacity[arc] > 0 and distance[head[arc]] + 1 < lowest:
            lowest = distance[head[arc]] + 1
    return lowest


@compiled
def sink_side(  # noqa: C901 - one loop, as published; calls would cost a third of the time
    start: Index,
    head: Index,
    reverse: Index,
    capacity: Numbers,
    excess: Numbers,
    to_sink: Numbers,
) -> NDArray[np.bool_]:
    """Return which nodes lie on the sink's side of a minimum cut.

    Parameters
    ----------
    start, head, reverse : ndarray of int
        The graph, see `graph_of_pairs`.
    capacity : ndarray of float
        Capacity of every arc; what is left of it at the end.
    excess : ndarray of float, shape (n,)
        Capacity from the source to each node.
    to_sink : ndarray of float, shape (n,)
        Capacity from each node to the sink.
    """
    n = len(start) - 1
    distance = np.empty(n, dtype=np.int32)
    distances(start, head, reverse, capacity, to_sink, distance)
    current = start[:-1].copy()
    queue = np.empty(n + 1, dtype=np.int32)
    waiting = np.zeros(n, dtype=np.bool_)
    first, last = 0, 0
    for i in range(n):
        if excess[i] > 0 and distance[i] <= n:
            queue[last] = i
            last += 1
            waiting[i] = True
    work, limit = 0, int(RELABEL_EVERY * (n + len(head))) + 1
    while first != last:
        i = queue[first]
        first = first + 1 if first < n else 0
        waiting[i] = False
        while excess[i] > 0 and distance[i] <= n:
            if distance[i] == 1 and to_sink[i] > 0:
                pushed = min(excess[i], to_sink[i])
                to_sink[i] -= pushed
                excess[i] -= pushed
                continue
            arc = current[i]
            end = start[i + 1]
            while arc < end:
                j = head[arc]
                if capacity[arc] > 0 and distance[j] == distance[i] - 1:
                    pushed = min(excess[i], capacity[arc])
                    capacity[arc] -= pushed
                    capacity[reverse[arc]] += pushed
                    excess[i] -= pushed
                    excess[j] += pushed
                    if not waiting[j]:
                        waiting[j] = True
                        queue[last] = j
                        last = last + 1 if last < n else 0
                    if excess[i] <= 0:
                        break
                arc += 1
            current[i] = arc
            work += arc - start[i] + 1
            if excess[i] > 0 and arc >= end:
                distance[i] = lowest_above(i, start, head, capacity, to_sink, distance)
                current[i] = start[i]
                work += end - start[i]
        if work > limit:
            work = 0
            distances(start, head, reverse, capacity, to_sink, distance)
            for i in range(n):  # as a slice it would take four seconds to compile
                current[i] = start[i]
    distances(start, head, reverse, capacity, to_sink, distance)
    return distance <= n


# ---- the least turns ------------------------------------------------------------------------


Turns = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True)
class Limit:
    """What pixels of some regions pay for fewer turns than some, or for more.

    Parameters
    ----------
    region : ndarray of int
        Region of every pixel that pays.
    turns : ndarray of int
        Turns of its region that cost nothing.
    weight : ndarray of float
        What each turn beyond costs.
    side : int
        1 if fewer turns cost, -1 if more do.
    """

    region: Turns
    turns: Turns
    weight: Numbers
    side: int

    def some(self, which: slice | Turns) -> Limit:
        """Return what some of the pixels pay."""
        return Limit(self.region[which], self.turns[which], self.weight[which], self.side)

    def of(self, bunch: Bunch) -> Limit:
        """Return the same, the regions counted as they stand in a bunch that has all of them."""
        region = np.searchsorted(bunch.regions, self.region)
        return Limit(region, self.turns, self.weight, self.side)

    def paid(self, turns: Turns, n: int) -> Numbers:
        """Return what every region pays for its turns."""
        beyond = self.weight * np.maximum(self.side * (self.turns - turns[self.region]), 0)
        return np.bincount(self.region, beyond, n).astype(np.float64)


class LeastTurns:
    """The turns of a bunch of regions for which sum W |k_q - k_p - J| is smallest.

    The cost is convex in the turns k, so that moving some regions up or down by one as long as
    that helps ends at its minimum (Darbon & Sigelle 2005; Bioucas-Dias & Valadao 2007); which
    regions to move is a minimum cut.

    Parameters
    ----------
    bunch : Bunch
        The regions. The one that is held never moves.
    check : callable
        Called before every cut; may raise to stop.
    """

    def __init__(self, bunch: Bunch, check: Callable[[], None]) -> None:
        self.bunch = bunch
        self.check = check
        self.held = bunch.held
        self.limit: Limit | None = None
        first, second = bunch.edges.first, bunch.edges.second
        # Edges are sorted by their regions.
        begins = np.append(True, (first[1:] != first[:-1]) | (second[1:] != second[:-1]))
        free = begins[: len(first)] & (first != self.held) & (second != self.held)
        self.graph = graph_of_pairs(first[free], second[free], bunch.n)

    def start(self) -> tuple[NDArray[np.int32], Turns]:
        """Return the part of each region, and turns to start with: heaviest edges first."""
        edges = self.bunch.edges
        costs = -edges.weight.astype(np.float64)
        parts, turns, _ = grow_list(edges.first, edges.second, edges.turns, costs, self.bunch.n)
        # The island that is held is to have none.
        level = turns[self.held] + self.bunch.held_turns
        joined = parts == parts[self.held]
        return parts, turns.astype(np.int64) - np.where(joined, level, 0)

    def descend(self, turns: Turns, limit: Limit | None = None) -> Turns:
        """Return the turns of least cost, from any others."""
        self.limit = limit
        cost = self.cost(turns)
        failed, up = 0, 1
        while failed < 2:
            self.check()
            moved = turns + up * self.best_move(turns, up)
            new = self.cost(moved)
            if new < cost:
                turns, cost, failed = moved, new, 0
            else:
                failed += 1
                up = -up
        return turns

    def cost(self, turns: Turns) -> int:
        """Return the cost of some turns, in parts as weights are: a whole number, so exact."""
        edges = self.bunch.edges
        of_edges = cost_of_edges(edges.first, edges.second, edges.turns, edges.weight, turns)
        return int(of_edges) + int(self.beyond(turns).sum())

    def beyond(self, turns: Turns) -> Numbers:
        """Return what each region pays beyond its limit."""
        return (
            np.zeros(self.bunch.n) if self.limit is None else self.limit.paid(turns, self.bunch.n)
        )

    def best_move(self, turns: Turns, up: int) -> NDArray[np.bool_]:
        """Return the regions whose move by ``up`` (1 or -1) makes the cost smallest."""
        n, edges = self.bunch.n, self.bunch.edges
        start, head, reverse, place = self.graph
        of_first, of_second, capacity = np.zeros(n), np.zeros(n), np.zeros(len(place))
        weigh_moves(
            edges.first, edges.second, edges.turns, edges.weight, turns, up, self.held, place,
            of_first, of_second, capacity,
        )  # fmt: skip
        own = self.beyond(turns + up) - self.beyond(turns)
        own = own + of_first + of_second
        moving = sink_side(start, head, reverse, capacity, np.maximum(own, 0), np.maximum(-own, 0))
        moving[self.held] = False
        return moving


@compiled
def cost_of_edges(first: Index, second: Index, asked: Index, weight: Turns, turns: Turns) -> int:
    """Return what all edges cost, by the turns of the regions."""
    total = 0
    for k in range(len(first)):
        total += int(weight[k]) * abs(int(turns[second[k]]) - int(turns[first[k]]) - int(asked[k]))
    return total


@compiled
def weigh_moves(
    first: Index,
    second: Index,
    asked: Index,
    weight: Turns,
    turns: Turns,
    up: int,
    held: int,
    place: Index,
    of_first: Numbers,
    of_second: Numbers,
    capacity: Numbers,
) -> None:
    """Add up what moving each region costs by itself, and write what it costs pairs.

    What moving costs a region by itself are its steps, each of which is shared out so that the
    rest is what only one of its two ends pays. Edges of a pair of regions follow each other.
    """
    k, pair = 0, 0
    while k < len(first):
        a, b = first[k], second[k]
        now, first_moves, second_moves = 0.0, 0.0, 0.0
        while k < len(first) and first[k] == a and second[k] == b:
            off, each = turns[b] - turns[a] - asked[k], np.float64(weight[k])
            now += each * abs(off)
            second_moves += each * abs(off + up)
            first_moves += each * abs(off - up)
            k += 1
        second_moves -= now
        first_moves -= now
        of_first[a] += first_moves
        of_second[b] += second_moves if a == held else -first_moves
        if a != held and b != held:
            capacity[place[pair]] = max(first_moves + second_moves, 0.0)
            pair += 1
