"""Joining the marked steps of a grid to groups of pixels.

Pixels are joined to runs along x first, then runs to those of the neighbouring rows, so that few
steps need a look at the groups. If steps were marked that disagree, that is seen.
"""

from __future__ import annotations

import numpy as np

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.growing.groups import join, number
from napari_phase4d.unwrapping.growing.marks import ALONG_X, Marks
from napari_phase4d.unwrapping.growing.rows import Phase, Shape, Whole, jump, row_before

__all__ = ["joined"]


@compiled
def joined(
    wrapped: Phase, shape: Shape, half: float, marks: Marks, group: Whole, turns: Whole
) -> int:
    """Join all pixels along marked steps.

    Parameters
    ----------
    wrapped, shape, half
        See `residue_limit`.
    marks : ndarray of uint8, shape (rows, nx)
        Steps to join.
    group, turns : ndarray of int32, shape (rows, nx)
        Where the number of each pixel's group, and its turns in it, go.

    Returns
    -------
    int
        Number of groups; -1 if marked steps disagree.
    """
    parent, relative = group.ravel(), turns.ravel()
    places = np.empty(shape[3], dtype=np.int32)
    for row in range(len(wrapped)):
        runs(wrapped[row], half, marks[row], row * shape[3], group[row], turns[row])
        for axis in range(3):
            before = row_before(row, axis, shape)
            if before < 0:
                continue
            n = places_of(marks[before], np.uint8(1 << axis), places)
            if not join_rows(wrapped, before, row, half, places[:n], parent, relative):
                return -1
    return number(parent, relative)


@compiled
def join_rows(
    wrapped: Phase, before: int, row: int, half: float, places: Whole, parent: Whole, turns: Whole
) -> bool:
    """Join two rows in some places; return whether all agree."""
    above, here = wrapped[before], wrapped[row]
    first, second = before * len(here), row * len(here)
    for k in range(len(places)):
        x = int(places[k])
        if not join(parent, turns, first + x, second + x, jump(above[x], here[x], half)):
            return False
    return True


@compiled
def places_of(marks: Marks, bit: np.uint8, places: Whole) -> int:
    """List where a bit is set, without a branch to be guessed; return how often it is."""
    count = 0
    for x in range(len(marks)):
        places[count] = x
        count += int((marks[x] & bit) != 0)
    return count


@compiled
def runs(here: Phase, half: float, marks: Marks, start: int, parent: Whole, turns: Whole) -> None:
    """Join the pixels of a row along its marked steps, each to the first of its run."""
    first, total = np.int32(start), np.int32(0)
    parent[0], turns[0] = first, total
    for x in range(1, len(here)):
        goes_on = (marks[x - 1] & ALONG_X) != 0
        step = total + jump(here[x - 1], here[x], half)
        first = first if goes_on else np.int32(start + x)
        total = step if goes_on else np.int32(0)
        parent[x], turns[x] = first, total
