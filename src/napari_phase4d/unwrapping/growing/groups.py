"""Groups of pixels with whole turns between them: union-find whose roots come first.

Every pixel points to one that comes no later, so that a single pass in order flattens all.
"""

from __future__ import annotations

import numpy as np

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.growing.rows import Whole

__all__ = ["join", "number", "root_of"]


@compiled
def root_of(parent: Whole, turns: Whole, i: int) -> tuple[np.int64, np.int32]:
    """Return a pixel's root and its turns relative to it, halving the way there."""
    total, at = np.int32(0), np.int64(i)
    up = np.int64(parent[at])
    while up != at:
        top = np.int64(parent[up])
        if top != up:
            turns[at] += turns[up]
            parent[at] = np.int32(top)
        total += turns[at]
        at = top
        up = np.int64(parent[at])
    return at, total


@compiled
def join(parent: Whole, turns: Whole, i: int, j: int, step: np.int32) -> bool:
    """Put two pixels into one group, with turns(j) - turns(i) = step.

    Returns
    -------
    bool
        Whether that agrees with what was known before.
    """
    first, of_first = root_of(parent, turns, i)
    second, of_second = root_of(parent, turns, j)
    between = step + of_first - of_second  # turns(second root) - turns(first root)
    if first == second:
        return bool(between == 0)
    if first < second:
        parent[second] = first
        turns[second] = between
    else:
        parent[first] = second
        turns[first] = -between
    return True


@compiled
def number(parent: Whole, turns: Whole) -> int:
    """Replace every pixel's parent by the number of its group; return how many there are.

    Turns become those relative to the group's root.
    """
    count = np.int32(0)
    for i in range(len(parent)):
        up = parent[i]
        is_root = up == i
        known = parent[up]  # the one before has its number already
        turns[i] += turns[up]  # a root has none
        parent[i] = count if is_root else known
        count += np.int32(is_root)
    return int(count)
