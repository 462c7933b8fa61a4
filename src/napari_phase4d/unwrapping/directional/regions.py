"""Pixels joined along their steps: all of them greedily, or only where no step is in doubt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.directional.forest import joined
from napari_phase4d.unwrapping.directional.steps import Steps

__all__ = ["Regions", "grown", "regions_of", "weight_of"]

#: Weight of a step: (SOFTENING + roughness)^-POWER, roughness in radians.
SOFTENING, POWER = 0.5, 6
#: Steps smoother and smaller than this, in radians, are never doubted: their ends move together.
CERTAIN = 1.0
#: Roughness is sorted in so many levels for each radian, up to the largest 16-bit number.
LEVELS = 2000

Whole = NDArray[np.int32]


@dataclass(frozen=True)
class Regions:
    """Nodes that move together, and the steps between them.

    Parameters
    ----------
    of_node : ndarray of int
        Region of every node.
    relative : ndarray of int
        Turns of every node relative to its region.
    n : int
        Number of regions.
    first, second, turns, weight : ndarray
        Steps between regions: both ends, turns between them, and what a turn less or more costs.
    """

    of_node: Whole
    relative: Whole
    n: int
    first: Whole
    second: Whole
    turns: NDArray[np.int64]
    weight: NDArray[np.float64]


def weight_of(roughness: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the weight of steps of some roughness in radians."""
    weight: NDArray[np.float64] = (SOFTENING + roughness.astype(np.float64)) ** -POWER
    return weight


def smoothest_first(roughness: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the order of steps by their roughness, to a two-thousandth of a radian.

    Whole numbers of 16 bits are sorted several times as fast as floats.
    """
    levels = np.minimum(roughness * LEVELS, np.iinfo(np.uint16).max).astype(np.uint16)
    order: NDArray[np.int64] = np.argsort(levels, kind="stable")
    return order


def grown(steps: Steps, n: int, n_islands: int) -> tuple[Whole, Whole]:
    """Go along the steps, smoothest first, as Kruskal does.

    Before all others come the steps between islands of the empty field, those first whose
    majority is largest: one step that looks smooth by accident is not to tie an island to a cell.

    Parameters
    ----------
    steps : Steps
        Steps between nodes.
    n : int
        Number of nodes.
    n_islands : int
        How many of the first nodes are islands of the empty field.

    Returns
    -------
    parts : ndarray of int
        Part that each node belongs to, as one of its nodes.
    turns : ndarray of int
        Turns of every node; 0 for node 0.
    """
    between = np.flatnonzero(np.maximum(steps.first, steps.second) < n_islands)
    a, b = steps.first[between], steps.second[between]
    turns = steps.turns[between].astype(np.int64)
    nodes = np.arange(n, dtype=np.int32)
    votes = merged(nodes, nodes * 0, n, (a, b, turns, weight_of(steps.roughness[between])))
    heaviest_first = np.argsort(-votes.weight, kind="stable")
    order = smoothest_first(steps.roughness)
    parts, turns_of = joined(
        np.concatenate([votes.first[heaviest_first], steps.first[order]]),
        np.concatenate([votes.second[heaviest_first], steps.second[order]]),
        np.concatenate([votes.turns[heaviest_first].astype(np.int32), steps.turns[order]]),
        np.arange(len(votes.first) + len(order)),
        n,
    )
    return parts, turns_of - np.where(parts == parts[0], turns_of[0], 0).astype(np.int32)


def regions_of(steps: Steps, n: int, n_islands: int) -> Regions:
    """Put the nodes together that certain steps join.

    Islands of the empty field, the first nodes, are not joined to each other: of the many steps
    between two of them, one may look certain by accident.
    """
    certain = np.flatnonzero(
        (steps.roughness < CERTAIN)
        & (steps.size < CERTAIN)
        & (np.maximum(steps.first, steps.second) >= n_islands)
    )
    order = certain[smoothest_first(steps.roughness[certain])]
    root, relative = joined(steps.first, steps.second, steps.turns, order, n)
    is_root = root == np.arange(n, dtype=np.int32)
    number = np.cumsum(is_root, dtype=np.int32) - np.int32(1)
    region = number[root]
    a, b = region[steps.first], region[steps.second]
    across = np.flatnonzero(a != b)
    first, second = steps.first[across], steps.second[across]
    turns = steps.turns[across].astype(np.int64) - relative[second] + relative[first]
    return merged(
        region,
        relative,
        int(is_root.sum()),
        (a[across], b[across], turns, weight_of(steps.roughness[across])),
    )


def merged(
    region: Whole,
    relative: Whole,
    n: int,
    between: tuple[Whole, Whole, NDArray[np.int64], NDArray[np.float64]],
) -> Regions:
    """Count steps between the same two regions that ask for the same turns as one."""
    a, b, turns, weight = between
    swapped = a > b
    a, b = np.where(swapped, b, a), np.where(swapped, a, b)
    turns = np.where(swapped, -turns, turns)
    lowest = int(turns.min(initial=0))
    span = int(turns.max(initial=0)) - lowest + 1
    key = (a.astype(np.int64) * n + b) * span + (turns - lowest)
    keys, place = np.unique(key, return_inverse=True)
    pair = keys // span
    return Regions(
        region,
        relative,
        n,
        (pair // n).astype(np.int32),
        (pair % n).astype(np.int32),
        keys % span + lowest,
        np.bincount(place, weight, len(keys)).astype(np.float64),
    )
