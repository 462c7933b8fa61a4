"""What the steps of a grid cost: the lower, the earlier are they joined.

Most methods take the reliability of both pixels: wrapped second differences, in any number of
dimensions.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.growing.rows import (
    BORDER,
    Floats,
    Phase,
    Shape,
    Workspace,
    full_shape,
)

__all__ = ["Costs", "coherence", "half_stencil", "second_differences"]

TURN = 2 * np.pi

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


NO_MASK: Mask = np.empty((0, 0), dtype=bool)
#: Width of the window in which steps are compared, in pixels.
WINDOW = 13


@dataclass(frozen=True)
class Costs:
    """Costs of the steps of a grid.

    Parameters
    ----------
    shape : tuple of int
        The grid, see `full_shape`.
    point : ndarray of float64, shape (rows, nx), or empty
        Unreliability of every pixel: a step costs what its two pixels have together; infinite
        for pixels that are left out.
    steps : ndarray of float64, shape (2, rows, nx), or empty
        Cost of the step from every pixel to the next along y and along x, instead.
    """

    shape: Shape
    point: Floats = field(default_factory=lambda: np.empty((0, 0)))
    steps: Floats = field(default_factory=lambda: np.empty((0, 0, 0)))

    @property
    def arguments(self) -> tuple[Floats, Floats, Shape]:
        """What kernels are given."""
        return self.point, self.steps, self.shape


def second_differences(
    wrapped: Phase,
    mask: Mask | None,
    work: Workspace,
    bounded: tuple[int, ...] = (2,),
) -> Costs:
    """Let a pixel cost the sum of its squared wrapped second differences (Herraez et al. 2002).

    D^2 = sum over opposite neighbours of (W(v- - v) - W(v - v+))^2, rad^2; in two dimensions in
    the very order of scikit-image's sum.

    Parameters
    ----------
    wrapped : ndarray of float32
        Wrapped phase in radians; one to four dimensions, the last two y and x.
    mask : ndarray of bool, same shape, or None
        Pixels that count.
    work : Workspace
        Memory to work in.
    bounded : tuple of int, optional
        Axes of the full shape (0, 1, 2 for time, angle, y) at whose ends pixels are the least
        reliable; along x they always are. At the ends of other axes, the sum over the pairs that
        exist is scaled to all pairs. Default: only y.

    Notes
    -----
    Next to pixels that the mask leaves out, single frames are as unreliable as at their border,
    as in scikit-image; in more dimensions the sum over the pairs that exist stands for all.
    """
    shape = full_shape(wrapped.shape)
    rows = wrapped.reshape(-1, shape[3])
    pairs = np.array(half_stencil(shape), dtype=np.int64).reshape(-1, 4)
    ends = np.array([axis in bounded for axis in range(3)])
    scaled = sum(n > 1 for n in shape) > 2
    point = work.array("point", rows.shape, np.float64)
    inside = NO_MASK if mask is None else mask.reshape(rows.shape)
    unreliability_of_rows(rows, inside, shape, pairs, ends, scaled, point)
    return Costs(shape, point)


def coherence(wrapped: Phase, mask: Mask | None, work: Workspace) -> Costs:
    """Let a step cost how unlike its surroundings and how large it is.

    1 - |mean of exp(i g)| + |g| / (2 pi), with g the wrapped steps along the same axis and their
    mean over a window of 13 x 13 steps. A steep slope costs little as long as it is even, which
    second differences over three pixels can't tell from noise.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (y, x)
        Wrapped phase of one frame in radians.
    mask : ndarray of bool, same shape, or None
        Pixels that count.
    work : Workspace
        Memory to work in.
    """
    shape = full_shape(wrapped.shape)
    steps = work.array("steps", (2, *wrapped.shape), np.float64)
    steps[:] = np.inf
    for axis in range(2):
        steps[axis][inner(axis)] = incoherence(wrapped, mask, axis)
    return Costs(shape, steps=steps)


def inner(axis: int) -> tuple[slice, slice]:
    """Return all of a frame but the last row or column."""
    return (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))


def incoherence(wrapped: Phase, mask: Mask | None, axis: int) -> NDArray[np.float32]:
    """Return the cost of every step along an axis of a frame, infinite outside the mask."""
    step = np.diff(wrapped, axis=axis)
    if step.size == 0:
        return step
    step -= np.float32(TURN) * np.round(step / np.float32(TURN))
    real, imaginary = np.cos(step), np.sin(step)
    counted: NDArray[np.float32] = np.ones(1, dtype=np.float32)
    both = None
    if mask is not None:
        both = mask[inner(axis)] & np.roll(mask, -1, axis)[inner(axis)]
        real *= both
        imaginary *= both
        counted = np.maximum(mean_over_window(both.astype(np.float32)), np.float32(1e-6))
    alike = np.hypot(mean_over_window(real), mean_over_window(imaginary)) / counted
    cost = (1 - alike + np.abs(step) / np.float32(TURN)).astype(np.float32)
    if both is not None:
        cost[~both] = np.inf
    return cost


def mean_over_window(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean over a window round every place."""
    mean: NDArray[np.float32] = scipy.ndimage.uniform_filter(values, WINDOW, mode="nearest")
    return mean
