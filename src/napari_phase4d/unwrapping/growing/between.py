"""The steps that are left between groups of pixels."""

from __future__ import annotations

import numpy as np

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.growing.rows import (
    Floats,
    Phase,
    Shape,
    Whole,
    costs_across,
    costs_along,
    jump,
    row_before,
)

__all__ = ["count_between", "list_between"]


@compiled
def count_between(point: Floats, steps: Floats, shape: Shape, below: float, group: Whole) -> int:
    """Return how many steps of a grid that cost less than ``below`` lie between two groups."""
    costs = np.empty(shape[3])
    count = 0
    for row in range(len(group)):
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
    first, second, between, cost : ndarray
        Where the groups, the turns between them and the costs go, as many as `count_between`
        says.
    """
    nx = shape[3]
    costs, places = np.empty(nx), np.empty(nx, dtype=np.int32)
    listed = 0
    for row in range(len(wrapped)):
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
