"""Which steps no residue can put in doubt.

Joining along the cheapest steps first can only depend on the order where a loop of steps does not
close. Let the limit be the smallest, over all loops of four steps that don't close (residues), of
the dearest step in the loop. Below it, the steps of no such loop are complete.
"""

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

__all__ = ["residue_limit"]


@compiled
def residue_limit(
    wrapped: Phase, half: float, point: Floats, steps: Floats, shape: Shape, most: int
) -> float:
    """Return the smallest, over all residues, of the dearest step round it; infinite for none.

    Minus infinity where there are too many residues for a limit to be of use.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (rows, nx)
        Wrapped phase in radians.
    half : float
        Half a turn: the largest step in radians.
    point, steps : ndarray of float64
        What steps cost, see `costs_along`.
    shape : tuple of int
        The grid, see `full_shape`.
    most : int
        Largest number of residues.
    """
    limit, count = np.inf, 0
    nx = shape[3]
    loops = np.empty(nx, dtype=np.int32)
    costs = np.empty((4, nx))
    for row in range(len(wrapped)):
        here = wrapped[row]
        for axis in range(3):
            before = row_before(row, axis, shape)
            if before < 0:
                continue
            above = wrapped[before]
            found = open_loops(above[:-1], above[1:], here[:-1], here[1:], half, loops[:-1])
            if found:
                count += found
                costs_along(point, steps, before, costs[0, :-1])
                costs_along(point, steps, row, costs[1, :-1])
                costs_across(point, steps, axis, before, row, costs[2])
                costs[3, :-1] = costs[2, 1:]
                limit = min(limit, least_of_dearest(loops[:-1], costs))
            for other in range(axis + 1, 3):
                side = row_before(row, other, shape)
                if side < 0:
                    continue
                corner = row_before(before, other, shape)
                found = open_loops(wrapped[corner], above, wrapped[side], here, half, loops)
                if found:
                    count += found
                    costs_across(point, steps, axis, before, row, costs[0])
                    costs_across(point, steps, axis, corner, side, costs[1])
                    costs_across(point, steps, other, side, row, costs[2])
                    costs_across(point, steps, other, corner, before, costs[3])
                    limit = min(limit, least_of_dearest(loops, costs))
        if count > most:
            return -np.inf
    return limit


@compiled
def open_loops(
    corner: Phase, first: Phase, second: Phase, here: Phase, half: float, loops: Whole
) -> int:
    """Write the sums of the loops between four rows; return how many are not zero."""
    seen = np.int32(0)
    for x in range(len(loops)):
        loops[x] = (
            jump(corner[x], first[x], half)
            + jump(first[x], here[x], half)
            - jump(second[x], here[x], half)
            - jump(corner[x], second[x], half)
        )
        seen += np.int32(loops[x] != 0)
    return int(seen)


@compiled
def least_of_dearest(loops: Whole, costs: Floats) -> float:
    """Return the smallest of the dearest costs of the loops that don't close."""
    least = np.inf
    for x in range(len(loops)):
        if loops[x] != 0:
            dearest = max(max(costs[0, x], costs[1, x]), max(costs[2, x], costs[3, x]))
            least = min(least, dearest)
    return least
