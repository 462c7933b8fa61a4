"""Whole turns that disagree least with all steps: weighted L1, solved exactly by minimum cuts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.directional.cut import graph_of_pairs, sink_side
from napari_phase4d.unwrapping.directional.regions import Regions
from napari_phase4d.unwrapping.growing import grow_list

__all__ = ["LeastTurns", "Limit"]

#: Gains smaller than this share of the cost are rounding.
SMALLEST_GAIN = 1e-9

Turns = NDArray[np.int64]
Numbers = NDArray[np.float64]


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

    def paid(self, turns: Turns, n: int) -> Numbers:
        """Return what every region pays for its turns."""
        beyond = self.weight * np.maximum(self.side * (self.turns - turns[self.region]), 0)
        return np.bincount(self.region, beyond, n).astype(np.float64)


class LeastTurns:
    """The turns of all regions for which sum W |k_q - k_p - J| is smallest.

    The cost is convex in the turns k, so that moving some regions up or down by one as long as
    that helps ends at its minimum (Darbon & Sigelle 2005; Bioucas-Dias & Valadao 2007); which
    regions to move is a minimum cut.

    Parameters
    ----------
    regions : Regions
        With the edges between them. The region that is held never moves.
    check : callable
        Called before every cut; may raise to stop.
    """

    def __init__(self, regions: Regions, check: Callable[[], None]) -> None:
        self.regions = regions
        self.check = check
        self.held = regions.held
        self.limit: Limit | None = None
        self.weight = regions.edges.weight.astype(np.float64)
        pair = regions.edges.first.astype(np.int64) * regions.n + regions.edges.second
        pairs, self.pair = np.unique(pair, return_inverse=True)
        self.first = (pairs // regions.n).astype(np.int32)
        self.second = (pairs % regions.n).astype(np.int32)
        self.free = (self.first != self.held) & (self.second != self.held)
        self.graph = graph_of_pairs(self.first[self.free], self.second[self.free], regions.n)

    def start(self) -> tuple[NDArray[np.int32], Turns]:
        """Return the part of each region, and turns to start with: heaviest edges first."""
        edges = self.regions.edges
        parts, turns, _ = grow_list(
            edges.first, edges.second, edges.turns, -self.weight, self.regions.n
        )
        # The island that is held is to have none.
        level = turns[self.held] + self.regions.held_turns
        return parts, turns.astype(np.int64) - level

    def descend(self, turns: Turns, limit: Limit | None = None) -> Turns:
        """Return the turns of least cost, from any others."""
        self.limit = limit
        cost = self.cost(turns)
        failed, up = 0, 1
        while failed < 2:
            self.check()
            moved = turns + up * self.best_move(turns, up)
            new = self.cost(moved)
            if new < cost - SMALLEST_GAIN * max(cost, 1.0):
                turns, cost, failed = moved, new, 0
            else:
                failed += 1
                up = -up
        return turns

    def residual(self, turns: Turns) -> Turns:
        """Return by how many turns each edge is off."""
        edges = self.regions.edges
        return (turns[edges.second] - turns[edges.first] - edges.turns).astype(np.int64)

    def cost(self, turns: Turns) -> float:
        """Return the cost of some turns."""
        steps = (self.weight * np.abs(self.residual(turns))).sum()
        return float(steps + self.beyond(turns).sum())

    def beyond(self, turns: Turns) -> Numbers:
        """Return what each region pays beyond its limit."""
        return (
            np.zeros(self.regions.n)
            if self.limit is None
            else self.limit.paid(turns, self.regions.n)
        )

    def best_move(self, turns: Turns, up: int) -> NDArray[np.bool_]:
        """Return the regions whose move by ``up`` (1 or -1) makes the cost smallest."""
        n, weight, off = self.regions.n, self.weight, self.residual(turns)
        now = self.summed(weight * np.abs(off))
        second_moves = self.summed(weight * np.abs(off + up)) - now
        first_moves = self.summed(weight * np.abs(off - up)) - now
        # What moving costs a region by itself: its limit, and its steps, each of which is shared
        # out so that the rest is what only one of its two ends pays.
        alone = np.where(self.first == self.held, second_moves, -first_moves)
        own = self.beyond(turns + up) - self.beyond(turns)
        own = own + np.bincount(self.first, first_moves, n) + np.bincount(self.second, alone, n)
        start, head, reverse, place = self.graph
        pairs = len(place) // 2
        capacity = np.zeros(2 * pairs)
        capacity[place[:pairs]] = np.maximum(first_moves + second_moves, 0)[self.free]
        moving = sink_side(start, head, reverse, capacity, np.maximum(own, 0), np.maximum(-own, 0))
        moving[self.held] = False
        return moving

    def summed(self, of_steps: Numbers) -> Numbers:
        """Return the sum over the steps of each pair of regions."""
        return np.bincount(self.pair, of_steps, len(self.first)).astype(np.float64)
