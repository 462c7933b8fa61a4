"""What both directional methods start from: the empty field, the object in place, its steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, watched
from napari_phase4d.unwrapping.background import turned
from napari_phase4d.unwrapping.directional.filtering import along_slope
from napari_phase4d.unwrapping.directional.following import follow_object, seams
from napari_phase4d.unwrapping.directional.steps import Steps, all_steps
from napari_phase4d.unwrapping.masks import object_masks
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registration import moved
from napari_phase4d.unwrapping.spatial import border_medians
from napari_phase4d.unwrapping.volumes import all_of, with_levels

__all__ = ["NOISY", "Field", "finished_phase", "prepare"]

TURN = np.float32(2 * np.pi)
#: Pixels of the empty field that are kept round the object.
MARGIN = 3
#: An island of the empty field that takes at least this share of the frame holds its level.
FIELD_SHARE = 0.05
#: How firmly: its weight is that of a step of this roughness, which is that of 100 smooth ones.
FIRM = -0.268
#: From this noise in radians on it is averaged out.
NOISY = 0.1

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]
Scalar = TypeVar("Scalar", bound=np.generic)
Box = tuple[slice, slice, slice, slice]


@dataclass(frozen=True)
class Frames:
    """What of a recording is unwrapped: frames that say nothing are left out or stood in for.

    Times at which all views are lost are left out, and the rest solved as if they were adjacent.
    A view that is lost by itself is stood in for by what lies half way between its neighbours.

    Parameters
    ----------
    kept : ndarray of int
        Times that are not left out.
    lost : ndarray of bool, shape (time, angle)
        Frames that say nothing.
    phase : ndarray of shape (kept, angle, y, x)
        Wrapped phase in radians less the frames' empty fields.
    empty, usable : ndarray of bool, same shape
        Empty field; pixels that count.
    amplitude : ndarray of float, same shape, or None
        Amplitude as a share of its view's median.
    noise : float
        Standard deviation of the phase's noise in radians.
    start : tuple of int
        The kept frame (time, angle) that lies next to the boundary frame.
    """

    kept: NDArray[np.intp]
    lost: Mask
    phase: Stack
    empty: Mask
    usable: Mask
    amplitude: Stack | None
    noise: float
    start: tuple[int, int]


def frames_of(problem: Problem) -> Frames:
    """Return the frames of a problem, levelled, without those that say nothing."""
    background, lost = problem.background(), problem.lost()
    if lost.all():
        lost = np.zeros_like(lost)
    kept = np.flatnonzero(~lost.all(axis=1))
    phase = turned(problem.wrapped - background.ground(background.level))
    empty, usable, amplitude = background.mask, problem.usable, problem.amplitude
    if len(kept) < len(lost):
        phase, empty, usable = phase[kept], empty[kept], usable[kept]
        amplitude = None if amplitude is None else amplitude[kept]
    if lost[kept].any():
        phase, empty, usable = phase.copy(), empty.copy(), usable.copy()
        for angle in range(lost.shape[1]):
            stand_in(phase[:, angle], empty[:, angle], usable[:, angle], lost[kept, angle])
    nearest = int(np.argmin(np.abs(kept - problem.first[0])))
    start = nearest, problem.first[1]
    return Frames(kept, lost, phase, empty, usable, amplitude, background.noise, start)


def stand_in(phase: Stack, empty: Mask, usable: Mask, lost: Mask) -> None:
    """Fill the lost frames of a view (time, y, x) in place from the frames round them."""
    good = np.flatnonzero(~lost)
    for t in np.flatnonzero(lost):
        if not len(good):
            usable[t] = False
            continue
        before, after = good[good < t], good[good > t]
        one = before[-1] if len(before) else after[0]
        other = after[0] if len(after) else before[-1]
        share = np.float32((t - one) / (other - one)) if other != one else np.float32(0)
        phase[t] = turned(phase[one] + share * turned(phase[other] - phase[one]))
        empty[t] = empty[one] & empty[other]
        usable[t] = usable[one] & usable[other]


@dataclass(frozen=True)
class Field:
    """Wrapped phase, level with zero where it is empty, the object in place, as a graph.

    Parameters
    ----------
    frames : Frames
        What is unwrapped.
    phase : ndarray of shape (kept time, angle, y, x)
        Wrapped phase in radians, noise averaged out, after frames were moved.
    shifts : ndarray of int, shape (kept time, angle, 2)
        How frames were moved.
    nodes : ndarray of int, shape of the phase
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

    frames: Frames
    phase: Stack
    shifts: NDArray[np.intp]
    nodes: NDArray[np.int32]
    n_islands: int
    steps: Steps
    values: Stack
    amplitude: Stack | None

    def lifted(self, turns: NDArray[np.int32]) -> Stack:
        """Return the phase of all times with the turns of every node added, frames in place."""
        unwrapped = self.phase + TURN * turns[self.nodes].astype(np.float32)
        return self.at_all_times(moved(unwrapped, -self.shifts))

    def everywhere(self, values: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return a value of every node on all pixels of all times, frames back in place."""
        return self.at_all_times(moved(values[self.nodes], -self.shifts))

    def at_all_times(self, stack: NDArray[Scalar]) -> NDArray[Scalar]:
        """Return a stack of the kept times with the times left out, taken from the one before."""
        kept, n = self.frames.kept, len(self.frames.lost)
        if len(kept) == n:
            return stack
        return stack[np.maximum(np.searchsorted(kept, np.arange(n), side="right") - 1, 0)]


def prepare(problem: Problem, watch: Watch) -> Field:
    """Find the empty field, put the object in place, and list the steps (takes three steps)."""
    frames = watched(lambda: frames_of(problem), watch)
    watch.step()
    shifts = watched(lambda: follow_object(frames.phase, ~frames.empty & frames.usable), watch)
    watch.step()
    field = watched(lambda: graph(frames, shifts), watch)
    watch.step()
    return field


def graph(frames: Frames, shifts: NDArray[np.intp]) -> Field:
    """Make a node of every pixel of the object and every island of the empty field."""
    islands, n_islands, fields = islands_of(frames.empty, frames.start)
    islands = moved(islands, shifts)
    usable = moved(np.ascontiguousarray(frames.usable), shifts)
    empty = islands >= 0
    free = ~empty & usable
    nodes = np.maximum(islands, 0)
    n_free = int(np.count_nonzero(free))
    nodes[free] = np.arange(n_islands, n_islands + n_free, dtype=np.int32)
    inside = moved(frames.phase, shifts)
    amplitude = None if frames.amplitude is None else moved(frames.amplitude, shifts)
    box = box_of(free)
    around = seams(shifts, inside.shape[2:])[box]
    left = None
    if frames.noise >= NOISY:
        inside = inside.copy()
        inside[box], left = along_slope(inside[box], usable[box], around, frames.noise)
    steps = all_steps(
        inside[box],
        nodes[box],
        empty[box],
        usable[box],
        around,
        None if amplitude is None else amplitude[box],
        frames.noise,
        left,
        frames.start[0],
    )
    steps = with_ties(steps, fields)

    def of_nodes(stack: Stack, on_islands: float) -> Stack:
        return np.concatenate([np.full(n_islands, on_islands, dtype=np.float32), stack[free]])

    return Field(
        frames,
        inside,
        shifts,
        nodes,
        n_islands,
        steps,
        of_nodes(inside, 0.0),
        None if amplitude is None else of_nodes(amplitude, 1.0),
    )


def islands_of(
    empty: Mask, first: tuple[int, int]
) -> tuple[NDArray[np.int32], int, NDArray[np.int32]]:
    """Give the islands of the empty field numbers, frame by frame; -1 elsewhere.

    The largest one of the boundary frame is 0; else, or if that frame has none, the largest of
    all. There is always one number at least, even where no pixel has it.

    Returns
    -------
    found : ndarray of int, shape of the mask
        The number of each pixel's island.
    count : int
        How many there are.
    fields : ndarray of int
        The largest island of every frame, where it takes enough of it to be the field.
    """
    found = np.full(empty.shape, -1, dtype=np.int32)
    count, fields = 0, []
    for frame in np.ndindex(*empty.shape[:2]):
        labels, n = ndimage.label(empty[frame])
        found[frame] = np.where(labels > 0, labels - 1 + count, -1)
        sizes = np.bincount(labels.ravel(), minlength=n + 1)[1:]
        if n and sizes.max() >= FIELD_SHARE * labels.size:
            fields.append(count + int(np.argmax(sizes)))
        count += n
    if count == 0:
        return found, 1, np.zeros(0, dtype=np.int32)
    in_first = found[first]
    asked = in_first if (in_first >= 0).any() else found
    largest = int(np.argmax(np.bincount(asked[asked >= 0])))
    swap = np.arange(count + 1, dtype=np.int32)
    swap[-1] = -1  # where nothing is empty
    swap[[0, largest]] = swap[[largest, 0]]
    return swap[found], count, swap[np.array(fields, dtype=np.intp)]


def with_ties(steps: Steps, fields: NDArray[np.int32]) -> Steps:
    """Add steps that hold the empty field of every frame at the level of the first one.

    The level of a frame hangs on its own empty field then, not on its neighbours; but not
    beyond doubt, since a plateau inside a cell may be taken for the field.
    """
    others = fields[fields != 0]
    none = np.zeros(len(others), dtype=np.int32)
    return Steps(
        np.concatenate([steps.first, none]),
        np.concatenate([steps.second, others]),
        np.concatenate([steps.turns, none]),
        np.concatenate([steps.size, none.astype(np.float32)]),
        np.concatenate([steps.roughness, np.full(len(others), FIRM, dtype=np.float32)]),
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
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
) -> Stack:
    """Return the unwrapped phase, congruent with the wrapped phase; 0 where it is not wanted.

    Parts that no step joins to the empty field take their level from the two-dimensional
    unwrapping of the boundary frame. A mask that was to be found is found in this result.
    """
    watch = Watch(problem.n_frames, "finding the object", progress, cancelled)
    background = problem.background()
    level = background.ground(border_medians(background.level, problem.first))
    unwrapped = watched(lambda: congruent(field.lifted(turns) + level, problem.wrapped), watch)
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
        about_zero = np.where(problem.usable, unwrapped - level, np.float32(0))
        wanted = wanted & object_masks(about_zero, watch)
    return np.where(wanted, unwrapped, np.float32(0))


def congruent(estimate: Stack, wrapped: Stack) -> Stack:
    """Return the wrapped phase plus the whole turns that bring it nearest to an estimate."""
    turns = np.round((estimate - wrapped) / TURN).astype(np.float32)
    result: Stack = wrapped + TURN * turns
    return result
