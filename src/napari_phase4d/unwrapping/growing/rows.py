"""A grid of up to four dimensions seen as rows along x, and what its loops of steps say.

A stack of shape (n0, n1, n2, nx) is an array (n0 * n1 * n2, nx). The neighbours of a row along the
first three axes are whole rows, so that every kernel is a loop over rows and, inside, over x; the
inner loops run over slices, which the compiler turns into vector instructions.

If every loop of steps closes, any way from pixel to pixel leads to the same turns, whatever the
reliabilities are. So `integrated` goes from each row to the next and checks all other steps; the
first row with one that does not fit ends the attempt.

Joining along the cheapest steps first can only depend on the order where a loop of steps does not
close. Let the limit be the smallest, over all loops of four steps that don't close (residues), of
the dearest step in the loop. Below it, the steps of no such loop are complete (`residue_limit`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = [
    "BORDER",
    "Floats",
    "Phase",
    "Shape",
    "Whole",
    "Workspace",
    "costs_across",
    "costs_along",
    "full_shape",
    "integrated",
    "jump",
    "residue_limit",
    "row_after",
    "row_before",
]

Phase = NDArray[np.float32]
Floats = NDArray[np.float64]
Whole = NDArray[np.int32]
#: (n0, n1, n2, nx); missing leading dimensions have length 1.
Shape = tuple[int, int, int, int]
#: Unreliability of a pixel at the border of a frame, where second differences are missing.
BORDER = 9_999_999.0


def full_shape(shape: tuple[int, ...]) -> Shape:
    """Return a shape of one to four dimensions with four."""
    n0, n1, n2, nx = (1,) * (4 - len(shape)) + tuple(int(n) for n in shape)
    return n0, n1, n2, nx


@compiled
def row_before(row: int, axis: int, shape: Shape) -> int:
    """Return the row before this one along axis 0, 1 or 2, or -1."""
    _, n1, n2, _ = shape
    if axis == 2:
        return row - 1 if row % n2 > 0 else -1
    if axis == 1:
        return row - n2 if (row // n2) % n1 > 0 else -1
    return row - n1 * n2 if row >= n1 * n2 else -1


@compiled
def row_after(row: int, axis: int, shape: Shape) -> int:
    """Return the row after this one along axis 0, 1 or 2, or -1."""
    n0, n1, n2, _ = shape
    if axis == 2:
        return row + 1 if row % n2 < n2 - 1 else -1
    if axis == 1:
        return row + n2 if (row // n2) % n1 < n1 - 1 else -1
    return row + n1 * n2 if row < (n0 - 1) * n1 * n2 else -1


@compiled
def jump(before: np.float32, after: np.float32, half: float) -> np.int32:
    """Return the turns to add after a step so that it is no larger than half a turn.

    In double precision, as scikit-image does it.
    """
    step = np.float64(after) - np.float64(before)
    return np.int32(step < -half) - np.int32(step > half)


@compiled
def costs_along(point: Floats, steps: Floats, row: int, out: Floats) -> None:
    """Write the costs of the steps along x in a row; infinite where there is no step.

    A step costs what its two pixels (row, x) in ``point`` cost together, unless ``steps`` (2, row,
    x) holds the cost of the step from each pixel to the next along y and along x.
    """
    if steps.size:
        own = steps[1, row]
        for x in range(len(out)):
            out[x] = own[x]
    else:
        here = point[row]
        behind = here[1:]
        for x in range(len(out)):
            out[x] = here[x] + behind[x]


@compiled
def costs_across(
    point: Floats, steps: Floats, axis: int, before: int, row: int, out: Floats
) -> None:
    """Write the costs of the steps from one row to the next along an axis."""
    if steps.size:
        own = steps[axis - 2, before]
        for x in range(len(out)):
            out[x] = own[x]
    else:
        first, second = point[before], point[row]
        for x in range(len(out)):
            out[x] = first[x] + second[x]


class Workspace:
    """Arrays by name, kept until a larger one is asked for.

    Fresh memory is handed out by the system page by page, which costs more than most kernels
    take, and threads wait for each other at it.
    """

    def __init__(self) -> None:
        self._held: dict[str, NDArray[Any]] = {}

    def array(self, name: str, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        """Return an array of any content; it is overwritten when the name is asked for again."""
        size = math.prod(shape)
        held = self._held.get(name)
        if held is None or held.size < size or held.dtype != dtype:
            held = self._held[name] = np.empty(size, dtype=dtype)
        return held[:size].reshape(shape)

    def clear(self) -> None:
        """Let go of all arrays."""
        self._held.clear()


@compiled
def integrated(wrapped: Phase, shape: Shape, half: float, turns: Whole) -> bool:
    """Write the turns of every pixel; return whether all steps agree.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (rows, nx)
        Wrapped phase in radians.
    shape : tuple of int
        The grid, see `full_shape`.
    half : float
        Half a turn: the largest step in radians.
    turns : ndarray of int32, shape (rows, nx)
        Where the turns go; the first pixel has none.
    """
    along(wrapped[0], half, turns[0])
    for row in range(1, len(wrapped)):
        here, turns_here = wrapped[row], turns[row]
        wrong = np.int32(0)
        follows = False
        for axis in (2, 1, 0):
            before = row_before(row, axis, shape)
            if before < 0:
                continue
            if follows:
                wrong |= misfit(wrapped[before], here, turns[before], turns_here, half)
            else:
                follow(wrapped[before], here, turns[before], turns_here, half)
                follows = True
        wrong |= misfit(here[:-1], here[1:], turns_here[:-1], turns_here[1:], half)
        if wrong != 0:
            return False
    return True


@compiled
def along(here: Phase, half: float, turns: Whole) -> None:
    """Integrate a row from its first pixel."""
    turns[0] = 0
    for x in range(1, len(here)):
        turns[x] = turns[x - 1] + jump(here[x - 1], here[x], half)


@compiled
def follow(before: Phase, here: Phase, known: Whole, turns: Whole, half: float) -> None:
    """Integrate from one row to the next."""
    for x in range(len(here)):
        turns[x] = known[x] + jump(before[x], here[x], half)


@compiled
def misfit(before: Phase, here: Phase, known: Whole, turns: Whole, half: float) -> np.int32:
    """Return 0 if the turns of two rows fit all steps between them."""
    wrong = np.int32(0)
    for x in range(len(here)):
        wrong |= turns[x] - known[x] - jump(before[x], here[x], half)
    return wrong


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
                for x in range(len(here) - 1):  # as a slice it would take seconds to compile
                    costs[3, x] = costs[2, x + 1]
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
