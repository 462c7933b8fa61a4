"""What both directional methods start from: the empty field, the object in place, its steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import Watch, watched
from napari_phase4d.unwrapping.directional.background import (
    Background,
    find_background,
    turned,
)
from napari_phase4d.unwrapping.directional.following import follow_object, seams
from napari_phase4d.unwrapping.directional.steps import Steps, all_steps
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registration import moved
from napari_phase4d.unwrapping.spatial import border_medians
from napari_phase4d.unwrapping.volumes import with_levels

__all__ = ["Field", "finished_phase", "prepare"]

TURN = np.float32(2 * np.pi)
#: Pixels of the empty field that are kept round the object.
MARGIN = 3

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]
Box = tuple[slice, slice, slice, slice]


@dataclass(frozen=True)
class Field:
    """Wrapped phase, level with zero where it is empty, the object in place, as a graph.

    Parameters
    ----------
    background : Background
        The empty field, before frames were moved.
    phase : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians less the frames' levels, before frames were moved.
    shifts : ndarray of int, shape (time, angle, 2)
        How frames were moved.
    box : tuple of slice
        What of the moved frames holds the object.
    nodes : ndarray of int, shape of the box
        Node of every pixel; 0 for those of the empty field.
    steps : Steps
        Steps between nodes.
    values : ndarray of shape (nodes,)
        Wrapped phase of every node in radians.
    amplitude : ndarray of shape (nodes,) or None
        Amplitude of every node as a share of its view's median.
    """

    background: Background
    phase: Stack
    shifts: NDArray[np.intp]
    box: Box
    nodes: NDArray[np.int32]
    steps: Steps
    values: Stack
    amplitude: Stack | None

    def lifted(self, turns: NDArray[np.int32]) -> Stack:
        """Return the phase with the turns of every node added, frames back in place."""
        full = np.zeros(self.phase.shape, dtype=np.int32)
        full[self.box] = turns[self.nodes]
        return self.phase + TURN * moved(full, -self.shifts).astype(np.float32)

    def everywhere(self, values: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a value of every node on all pixels, frames back in place."""
        full = np.full(self.phase.shape, values[0], dtype=np.int32)
        full[self.box] = values[self.nodes]
        return moved(full, -self.shifts)


def prepare(problem: Problem, watch: Watch) -> Field:
    """Find the empty field, put the object in place, and list the steps (takes three steps)."""
    wrapped = problem.wrapped
    background = watched(lambda: find_background(wrapped), watch)
    watch.step()
    phase = turned(wrapped - background.level[..., None, None].astype(np.float32))
    shifts = watched(lambda: follow_object(phase, ~background.mask), watch)
    watch.step()
    field = watched(lambda: graph(problem, background, phase, shifts), watch)
    watch.step()
    return field


def graph(
    problem: Problem, background: Background, phase: Stack, shifts: NDArray[np.intp]
) -> Field:
    """Number the pixels of the object and list their steps."""
    empty = moved(background.mask, shifts)
    usable = moved(np.ascontiguousarray(problem.usable), shifts)
    box = box_of(~empty & usable)
    empty, usable = empty[box], usable[box]
    free = ~empty & usable
    nodes = np.where(free, np.cumsum(free, dtype=np.int32).reshape(free.shape), 0).astype(np.int32)
    inside = moved(phase, shifts)[box]
    amplitude = None
    if problem.amplitude is not None:
        amplitude = moved(problem.amplitude, shifts)[box]
    steps = all_steps(inside, nodes, empty, usable, seams(shifts, phase.shape[2:])[box], amplitude)

    def of_nodes(stack: Stack, empty_value: float) -> Stack:
        return np.concatenate([np.array([empty_value], dtype=np.float32), stack[free]])

    return Field(
        background,
        phase,
        shifts,
        box,
        nodes,
        steps,
        of_nodes(inside, 0.0),
        None if amplitude is None else of_nodes(amplitude, 1.0),
    )


def box_of(objects: Mask) -> Box:
    """Return the smallest part of the field that holds the object at all times, and a margin."""
    whole = (slice(None), slice(None))
    seen = objects.any(axis=(0, 1))
    if not seen.any():
        return (*whole, slice(None), slice(None))
    y, x = ndimage.find_objects(seen.astype(np.int8))[0]
    return (
        *whole,
        slice(max(y.start - MARGIN, 0), y.stop + MARGIN),
        slice(max(x.start - MARGIN, 0), x.stop + MARGIN),
    )


def finished_phase(
    field: Field,
    turns: NDArray[np.int32],
    parts: NDArray[np.int32],
    problem: Problem,
    watch: Watch,
) -> Stack:
    """Return the unwrapped phase, congruent with the wrapped phase; 0 where it is not wanted.

    Parts that no step joins to the empty field take their level from the two-dimensional
    unwrapping of the boundary frame.
    """
    level = border_medians(field.background.level, problem.first)[..., None, None]
    lifted = field.lifted(turns) + level.astype(np.float32)
    unwrapped = congruent(lifted, problem.wrapped)
    wanted = problem.usable & ~field.background.mask if problem.finds_mask else problem.usable
    label = field.everywhere(parts)
    loose = wanted & (label != parts[0])
    if loose.any():
        height = problem.spatial() - unwrapped
        placed = with_levels(
            unwrapped, label, height, loose, loose & problem.mask, problem.first, watch
        )
        unwrapped = np.where(loose, placed, unwrapped)
    return np.where(wanted, unwrapped, np.float32(0))


def congruent(estimate: Stack, wrapped: Stack) -> Stack:
    """Return the wrapped phase plus the whole turns that bring it nearest to an estimate."""
    turns = np.round((estimate - wrapped) / TURN).astype(np.float32)
    result: Stack = wrapped + TURN * turns
    return result
