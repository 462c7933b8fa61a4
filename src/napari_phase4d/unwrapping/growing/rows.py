"""A grid of up to four dimensions seen as rows along x: what all grid kernels share.

A stack of shape (n0, n1, n2, nx) is an array (n0 * n1 * n2, nx). The neighbours of a row along the
first three axes are whole rows, so that every kernel is a loop over rows and, inside, over x; the
inner loops run over slices, which the compiler turns into vector instructions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = [
    "Floats",
    "Phase",
    "Shape",
    "Whole",
    "costs_across",
    "costs_along",
    "full_shape",
    "jump",
    "row_after",
    "row_before",
]

Phase = NDArray[np.float32]
Floats = NDArray[np.float64]
Whole = NDArray[np.int32]
#: (n0, n1, n2, nx); missing leading dimensions have length 1.
Shape = tuple[int, int, int, int]


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
