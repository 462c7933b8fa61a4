"""How unreliable each pixel is: wrapped second differences, in any number of dimensions."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.growing.rows import Floats, Phase, Shape

__all__ = ["BORDER", "half_stencil", "unreliability_of_rows"]

TURN = 2 * np.pi
#: Unreliability of a pixel at the border of a frame, where second differences are missing.
BORDER = 9_999_999.0

Mask = NDArray[np.bool_]
Pairs = NDArray[np.int64]


def half_stencil(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Return one of each pair of opposite neighbours: 4 in 2-D, 13 in 3-D, 40 in 4-D.

    Dimensions of length 1 and 2 have no second differences along them and are left out.
    """
    steps = [(0, 1, -1) if n > 2 else (0,) for n in shape]
    offsets = [o for o in itertools.product(*steps) if any(o)]
    return [o for o in offsets if o > tuple(-v for v in o)]


@compiled
def unreliability_of_rows(
    wrapped: Phase,
    mask: Mask,
    shape: Shape,
    pairs: Pairs,
    ends: Mask,
    scaled: bool,
    out: Floats,
) -> None:
    """Write the unreliability of all rows.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (rows, nx)
        Wrapped phase in radians.
    mask : ndarray of bool, same shape, or empty
        Pixels that count.
    shape : tuple of int
        The grid, see `full_shape`.
    pairs : ndarray of int, shape (pairs, 4)
        One offset of each pair of opposite neighbours.
    ends : ndarray of bool, shape (3,)
        Axes at whose ends pixels are the least reliable.
    scaled : bool
        Whether the sum over some pairs is scaled to all; else such a pixel is the least reliable.
    out : ndarray of float64, shape (rows, nx)
        Where the unreliability goes; infinite outside the mask.
    """
    count = np.empty(shape[3])
    for row in range(len(wrapped)):
        for x in range(len(count)):
            out[row, x] = 0
            count[x] = 0
        if shape[3] > 2 and not at_bounded_end(row, shape, ends):
            add_row(wrapped, mask, shape, pairs, row, out[row], count)
        for x in range(len(count)):
            if count[x] == 0 or (count[x] < len(pairs) and not scaled):
                out[row, x] = BORDER
            elif count[x] != len(pairs):
                out[row, x] *= len(pairs) / count[x]
            if mask.size and not mask[row, x]:
                out[row, x] = np.inf


@compiled
def add_row(
    wrapped: Phase, mask: Mask, shape: Shape, pairs: Pairs, row: int, total: Floats, count: Floats
) -> None:
    """Add the squared second differences in a row, and count them."""
    nx = shape[3]
    inner, counted = total[1 : nx - 1], count[1 : nx - 1]
    here = wrapped[row, 1 : nx - 1]
    for k in range(len(pairs)):
        dt, da, dy, dx = pairs[k, 0], pairs[k, 1], pairs[k, 2], pairs[k, 3]
        ahead, behind = row_at(row, dt, da, dy, shape), row_at(row, -dt, -da, -dy, shape)
        if ahead < 0 or behind < 0:
            continue
        before = wrapped[behind, 1 - dx : nx - 1 - dx]
        after = wrapped[ahead, 1 + dx : nx - 1 + dx]
        if mask.size:
            seen_before = mask[behind, 1 - dx : nx - 1 - dx]
            seen_after = mask[ahead, 1 + dx : nx - 1 + dx]
            add_seen(before, here, after, seen_before, seen_after, inner, counted)
        else:
            add_pair(before, here, after, inner)
            for x in range(len(counted)):
                counted[x] += 1


@compiled
def wrapped_step(step: float) -> float:
    """Wrap a difference of two wrapped phases."""
    inside = step
    if step > np.pi:
        inside = step - TURN
    if step < -np.pi:
        inside = step + TURN
    return inside


@compiled
def second_difference(before: np.float32, here: np.float32, after: np.float32) -> float:
    """Return by how much the wrapped step changes at a pixel, in double precision."""
    centre = np.float64(here)
    return wrapped_step(np.float64(before) - centre) - wrapped_step(centre - np.float64(after))


@compiled
def add_pair(before: Phase, here: Phase, after: Phase, total: Floats) -> None:
    """Add the squared second differences between three rows."""
    for x in range(len(here)):
        change = second_difference(before[x], here[x], after[x])
        total[x] += change * change


@compiled
def add_seen(
    before: Phase,
    here: Phase,
    after: Phase,
    seen_before: Mask,
    seen_after: Mask,
    total: Floats,
    count: Floats,
) -> None:
    """Add the squared second differences between three rows, where both ends are seen."""
    for x in range(len(here)):
        change = second_difference(before[x], here[x], after[x])
        if seen_before[x] and seen_after[x]:
            total[x] += change * change
            count[x] += 1


@compiled
def at_bounded_end(row: int, shape: Shape, ends: Mask) -> bool:
    """Say whether a row lies at the end of an axis that has no second differences there."""
    _, n1, n2, _ = shape
    at = (row // (n1 * n2), (row // n2) % n1, row % n2)
    for axis in range(3):
        if ends[axis] and shape[axis] > 1 and at[axis] in (0, shape[axis] - 1):
            return True
    return False


@compiled
def row_at(row: int, dt: int, da: int, dy: int, shape: Shape) -> int:
    """Return the row at an offset along the first three axes, or -1 outside the grid."""
    n0, n1, n2, _ = shape
    t, a, y = row // (n1 * n2) + dt, (row // n2) % n1 + da, row % n2 + dy
    if t < 0 or t >= n0 or a < 0 or a >= n1 or y < 0 or y >= n2:
        return -1
    return (t * n1 + a) * n2 + y
