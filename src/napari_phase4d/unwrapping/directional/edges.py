"""Edges between what certain steps have joined, and the joining itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = [
    "PARTS",
    "SOFTENING",
    "Edges",
    "Index",
    "Whole",
    "join",
    "merged_edges",
    "no_edges",
    "root_of",
    "weight_of",
]

#: Weight of a step: (SOFTENING + roughness)^-POWER, roughness in radians.
SOFTENING, POWER = 0.5, 6
#: Weights are whole multiples, at least 1, of one part in so many, so that their sums do not
#: depend on the order. It tells steps of up to 40 rad apart, more than fading amplitude stands
#: for, and leaves room for the sum of some ten million smooth steps.
PARTS = 2.0**32

Index = NDArray[np.int32]
Whole = NDArray[np.int64]


def weight_of(roughness: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the weight of steps of some roughness in radians."""
    weight: NDArray[np.float64] = (SOFTENING + roughness.astype(np.float64)) ** -POWER
    return weight


@dataclass(frozen=True)
class Edges:
    """What steps between regions ask for; those that ask for the same count as one.

    Parameters
    ----------
    first, second : ndarray of int
        The regions at both ends.
    turns : ndarray of int
        Turns of the second region minus those of the first.
    weight : ndarray of int
        What a turn more or less costs, in parts of 2^-32.
    ground : ndarray of int
        The share of it that steps between islands of the empty field have.
    rough : ndarray of float
        Roughness of the smoothest step, radians.
    """

    first: Index
    second: Index
    turns: Index
    weight: Whole
    ground: Whole
    rough: NDArray[np.float32]

    def __len__(self) -> int:
        """Return the number of edges."""
        return len(self.first)


@compiled
def root_of(parent: Index, offset: Index, i: int) -> tuple[int, int]:
    """Return the root that something is joined to, and its turns relative to the root."""
    total = 0
    while parent[i] != i:
        above = parent[i]
        offset[i] += offset[above]
        parent[i] = parent[above]
        total += offset[i]
        i = parent[i]
    return i, total


@compiled
def join(parent: Index, offset: Index, a: int, b: int, turns: int) -> None:
    """Join b to a so that it has so many turns more, unless they are joined already."""
    root_a, of_a = root_of(parent, offset, a)
    root_b, of_b = root_of(parent, offset, b)
    if root_a == root_b:
        return
    more = turns + of_a - of_b
    # The first of all is the root, so that what the roots are does not depend on the order.
    if root_a < root_b:
        parent[root_b], offset[root_b] = root_a, more
    else:
        parent[root_a], offset[root_a] = root_b, -more


def no_edges() -> Edges:
    """Return none."""
    none = np.zeros(0, dtype=np.int32)
    cost = np.zeros(0, dtype=np.int64)
    return Edges(none, none, none, cost, cost, np.zeros(0, dtype=np.float32))


def merged_edges(
    first: Index,
    second: Index,
    turns: Index,
    weight: Whole,
    ground: Whole,
    rough: NDArray[np.float32],
) -> Edges:
    """Count edges between the same two regions that ask for the same turns as one.

    Edges from a region to itself are left out. For the parameters see `Edges`.
    """
    across = first != second
    a, b, turns = first[across], second[across], turns[across].astype(np.int64)
    swapped = a > b
    a, b = np.where(swapped, b, a).astype(np.int64), np.where(swapped, a, b)
    turns = np.where(swapped, -turns, turns)
    if not len(a):
        return no_edges()
    n = int(b.max()) + 1
    lowest = int(turns.min())
    span = int(turns.max()) - lowest + 1
    key = (a * n + b) * span + (turns - lowest)
    order = np.argsort(key, kind="stable")
    key = key[order]
    begins = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
    pair = key[begins] // span
    return Edges(
        (pair // n).astype(np.int32),
        (pair % n).astype(np.int32),
        (key[begins] % span + lowest).astype(np.int32),
        np.add.reduceat(weight[across][order], begins),
        np.add.reduceat(ground[across][order], begins),
        np.minimum.reduceat(rough[across][order], begins),
    )
