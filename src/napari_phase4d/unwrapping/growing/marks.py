"""Marking steps of a grid that may be joined at once, in whatever order.

Bit k of a pixel's mark says that the step from it to the next pixel along axis k is to be joined;
axis 3 is x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.growing.rows import (
    Floats,
    Shape,
    costs_across,
    costs_along,
    row_after,
    row_before,
)

__all__ = ["ALONG_X", "Marks", "mark_cheap", "mark_cheapest_of_each"]

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
    point: Floats, steps: Floats, shape: Shape, limit: float, marks: Marks
) -> None:
    """Mark the cheapest step of every pixel whose steps all cost no less than a limit.

    Of equal ones it is the first in the order of the grid. The tree of cheapest steps holds all
    of them (the first round of Boruvka 1926). Parameters as of `mark_cheap`.
    """
    nx = shape[3]
    costs, best = np.empty(nx), np.empty(nx)
    which = np.empty(nx, dtype=np.uint8)
    for row in range(len(marks)):
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
            if before >= 0:
                mark_where(which, np.uint8(axis), np.uint8(1 << axis), marks[before])
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
