"""Minimum cut of a graph with two terminals: push-relabel with global relabelling.

Goldberg & Tarjan 1988; first phase only, which is all that a minimum cut needs. Nodes are taken
first in, first out; distances to the sink are computed anew from time to time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = ["graph_of_pairs", "sink_side"]

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
    tail = np.concatenate([first, second])
    order = np.argsort(tail, kind="stable")
    place = np.empty(len(tail), dtype=np.int32)
    place[order] = np.arange(len(tail), dtype=np.int32)
    head = np.concatenate([second, first])[order].astype(np.int32)
    start = np.zeros(n + 1, dtype=np.int32)
    start[1:] = np.cumsum(np.bincount(tail, minlength=n))
    pairs = len(first)
    reverse = np.empty(len(tail), dtype=np.int32)
    reverse[place[:pairs]] = place[pairs:]
    reverse[place[pairs:]] = place[:pairs]
    return start, head, reverse, place


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
            current[:] = start[:-1]
    distances(start, head, reverse, capacity, to_sink, distance)
    return distance <= n
