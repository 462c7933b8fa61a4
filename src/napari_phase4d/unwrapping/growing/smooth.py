"""Phase without residues: one pass that integrates and checks every step.

If every loop of steps closes, any way from pixel to pixel leads to the same turns, whatever the
reliabilities are. So each row is integrated from the row before it, and all other steps are
checked; the first row with one that does not fit ends the attempt.
"""

from __future__ import annotations

import numpy as np

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.growing.rows import Phase, Shape, Whole, jump, row_before

__all__ = ["integrated"]


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
