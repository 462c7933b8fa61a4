"""Pixels joined along their steps: all of them greedily, or only where no step is in doubt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.directional.steps import Steps
from napari_phase4d.unwrapping.growing import grow_list

__all__ = ["Regions", "grown", "regions_of", "weight_of"]

#: Weight of a step: (SOFTENING + roughness)^-POWER, roughness in radians.
SOFTENING, POWER = 0.5, 6
#: Steps smoother and smaller than this, in radians, are never doubted: their ends move together.
CERTAIN = 1.0

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
        Number of the part that each node belongs to.
    turns : ndarray of int
        Turns of every node; 0 for node 0.
    """
    between = np.flatnonzero(np.maximum(steps.first, steps.second) < n_islands)
    a, b = steps.first[between], steps.second[between]
    turns = steps.turns[between].astype(np.int64)
    nodes = np.arange(n, dtype=np.int32)
    votes = merged(nodes, nodes * 0, n, (a, b, turns, weight_of(steps.roughness[between])))
    parts, turns_of, _ = grow_list(
        np.concatenate([votes.first, steps.first]),
        np.concatenate([votes.second, steps.second]),
        np.concatenate([votes.turns.astype(np.int32), steps.turns]),
        np.concatenate([-votes.weight, steps.roughness]),
        n,
        overwrite=True,
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
    region, relative, n_regions = grow_list(
        steps.first[certain],
        steps.second[certain],
        steps.turns[certain],
        steps.roughness[certain],
        n,
        overwrite=True,
    )
    a, b = region[steps.first], region[steps.second]
    across = np.flatnonzero(a != b)
    first, second = steps.first[across], steps.second[across]
    turns = steps.turns[across].astype(np.int64) - relative[second] + relative[first]
    return merged(
        region,
        relative,
        n_regions,
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
    # As numpy.unique does, which holds Python's lock over its sum of booleans.
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    begins = np.append(True, ordered[1:] != ordered[:-1])[: len(key)]
    keys, place = ordered[begins], np.empty(len(key), dtype=np.intp)
    place[order] = np.cumsum(begins.astype(np.intp)) - 1
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
