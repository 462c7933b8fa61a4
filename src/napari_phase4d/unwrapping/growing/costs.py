"""What the steps of a grid cost: the lower, the earlier are they joined."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.compiling import can_compile
from napari_phase4d.unwrapping.growing import plain
from napari_phase4d.unwrapping.growing.reliability import half_stencil, unreliability_of_rows
from napari_phase4d.unwrapping.growing.rows import Floats, Phase, Shape, full_shape
from napari_phase4d.unwrapping.growing.workspace import Workspace

__all__ = ["Costs", "coherence", "second_differences"]

Mask = NDArray[np.bool_]
TURN = 2 * np.pi
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
    if can_compile():
        inside = NO_MASK if mask is None else mask.reshape(rows.shape)
        unreliability_of_rows(rows, inside, shape, pairs, ends, scaled, point)
    else:
        inside = np.ones(shape, dtype=bool) if mask is None else mask.reshape(shape)
        of_grid = plain.unreliability(rows.reshape(shape), inside, pairs, ends, scaled=scaled)
        point[:] = of_grid.reshape(rows.shape)
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
    mean: NDArray[np.float32] = ndimage.uniform_filter(values, WINDOW, mode="nearest")
    return mean
