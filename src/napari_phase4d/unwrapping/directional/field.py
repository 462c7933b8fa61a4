"""What both directional methods start from: the empty field, the object in place, its steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, watched
from napari_phase4d.unwrapping.background import Background, turned
from napari_phase4d.unwrapping.directional.filtering import along_slope
from napari_phase4d.unwrapping.directional.following import follow_object, seams
from napari_phase4d.unwrapping.directional.steps import Steps, all_steps
from napari_phase4d.unwrapping.masks import object_masks
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registration import moved
from napari_phase4d.unwrapping.spatial import border_medians
from napari_phase4d.unwrapping.volumes import all_of, with_levels

__all__ = ["Field", "finished_phase", "prepare"]

TURN = np.float32(2 * np.pi)
#: Pixels of the empty field that are kept round the object.
MARGIN = 3
#: From this noise in radians on it is averaged out.
NOISY = 0.1

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
    nodes : ndarray of int, shape (time, angle, y, x)
        Node of every pixel of the moved frames. The pixels of an island of the empty field in one
        frame share one; 0 is the island that is held.
    n_islands : int
        How many nodes are islands of the empty field; they come first.
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
    nodes: NDArray[np.int32]
    n_islands: int
    steps: Steps
    values: Stack
    amplitude: Stack | None

    def lifted(self, turns: NDArray[np.int32]) -> Stack:
        """Return the phase with the turns of every node added, frames back in place."""
        return self.phase + TURN * self.everywhere(turns).astype(np.float32)

    def everywhere(self, values: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a value of every node on all pixels, frames back in place."""
        return moved(values[self.nodes], -self.shifts)


def prepare(problem: Problem, watch: Watch) -> Field:
    """Find the empty field, put the object in place, and list the steps (takes three steps)."""
    background = watched(problem.background, watch)
    watch.step()
    phase = turned(problem.wrapped - background.level[..., None, None].astype(np.float32))
    shifts = watched(lambda: follow_object(phase, ~background.mask & problem.usable), watch)
    watch.step()
    field = watched(lambda: graph(problem, background, phase, shifts), watch)
    watch.step()
    return field


def graph(
    problem: Problem, background: Background, phase: Stack, shifts: NDArray[np.intp]
) -> Field:
    """Make a node of every pixel of the object and every island of the empty field."""
    islands, n_islands = islands_of(background.mask, problem.first)
    islands = moved(islands, shifts)
    usable = moved(np.ascontiguousarray(problem.usable), shifts)
    empty = islands >= 0
    free = ~empty & usable
    nodes = np.maximum(islands, 0)
    n_free = int(np.count_nonzero(free))
    nodes[free] = np.arange(n_islands, n_islands + n_free, dtype=np.int32)
    inside = moved(phase, shifts)
    amplitude = None if problem.amplitude is None else moved(problem.amplitude, shifts)
    box = box_of(free)
    if background.noise >= NOISY:
        inside = inside.copy()
        inside[box] = along_slope(
            inside[box], usable[box], seams(shifts, phase.shape[2:])[box], background.noise
        )
        phase = moved(inside, -shifts)
    steps = all_steps(
        inside[box],
        nodes[box],
        empty[box],
        usable[box],
        seams(shifts, phase.shape[2:])[box],
        None if amplitude is None else amplitude[box],
        background.noise,
        problem.first[0],
    )

    def of_nodes(stack: Stack, on_islands: float) -> Stack:
        return np.concatenate([np.full(n_islands, on_islands, dtype=np.float32), stack[free]])

    return Field(
        background,
        phase,
        shifts,
        nodes,
        n_islands,
        steps,
        of_nodes(inside, 0.0),
        None if amplitude is None else of_nodes(amplitude, 1.0),
    )


def islands_of(empty: Mask, first: tuple[int, int]) -> tuple[NDArray[np.int32], int]:
    """Give the islands of the empty field numbers, frame by frame; -1 elsewhere.

    The largest one of the boundary frame is 0; else, or if that frame has none, the largest of
    all. There is always one number at least, even where no pixel has it.
    """
    found = np.full(empty.shape, -1, dtype=np.int32)
    count = 0
    for frame in np.ndindex(*empty.shape[:2]):
        labels, n = ndimage.label(empty[frame])
        found[frame] = np.where(labels > 0, labels - 1 + count, -1)
        count += n
    if count == 0:
        return found, 1
    in_first = found[first]
    asked = in_first if (in_first >= 0).any() else found
    largest = int(np.argmax(np.bincount(asked[asked >= 0])))
    swap = np.arange(count + 1, dtype=np.int32)
    swap[-1] = -1  # where nothing is empty
    swap[[0, largest]] = swap[[largest, 0]]
    return swap[found], count


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
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
) -> Stack:
    """Return the unwrapped phase, congruent with the wrapped phase; 0 where it is not wanted.

    Parts that no step joins to the empty field take their level from the two-dimensional
    unwrapping of the boundary frame. A mask that was to be found is found in this result.
    """
    watch = Watch(problem.n_frames, "finding the object", progress, cancelled)
    level = border_medians(field.background.level, problem.first)[..., None, None]
    unwrapped = watched(
        lambda: congruent(field.lifted(turns) + level.astype(np.float32), problem.wrapped), watch
    )
    label = field.everywhere(parts)
    loose = problem.usable & (label != parts[0])
    if loose.any():
        whole = problem.spatial(progress, cancelled)
        placed = watched(
            lambda: with_levels(unwrapped, label, whole, loose, all_of, problem.first, watch),
            watch,
        )
        unwrapped = np.where(loose, placed, unwrapped)
    wanted = problem.usable
    if problem.finds_mask:
        # Each frame about zero, so that an aperture's outside, which is 0, is no step.
        about_zero = np.where(problem.usable, unwrapped - level.astype(np.float32), np.float32(0))
        wanted = wanted & object_masks(about_zero, watch)
    return np.where(wanted, unwrapped, np.float32(0))


def congruent(estimate: Stack, wrapped: Stack) -> Stack:
    """Return the wrapped phase plus the whole turns that bring it nearest to an estimate."""
    turns = np.round((estimate - wrapped) / TURN).astype(np.float32)
    result: Stack = wrapped + TURN * turns
    return result
