"""Space-time network flow in two stages."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, in_threads
from napari_phase4d.unwrapping.ends import both_ends
from napari_phase4d.unwrapping.flow import closing_turns, loop_sums
from napari_phase4d.unwrapping.problem import Boundary, Problem
from napari_phase4d.unwrapping.spatial import border_medians, border_of

__all__ = ["network_flow"]

TURN = 2 * np.pi
#: Cost of a turn: outside the mask; inside it, where the first stage had to mend a step's course
#: over time and angle; where that course closed by itself. Ten of one kind weigh as much as one of
#: the next.
OUTSIDE, MENDED, STEADY = 1, 10, 100
#: Values that are worked on at a time in the first stage.
BLOCK = 1 << 17

Whole = NDArray[np.int64]
Stack = NDArray[np.float32]


def network_flow(
    problem: Problem, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> Stack:
    """Unwrap steps over time and angle first, then each frame, both by minimum-cost flow.

    Costantini et al. 2002 [10] ask for the cheapest whole turns that close all loops of the
    space-time grid at once. There every step borders four loops, not two, so that the problem is
    no network flow and has no fast exact solution. This is the two-stage form of Pepe & Lanari
    2006 (IEEE Trans. Geosci. Remote Sens. 44, 2374), with a grid instead of triangles:

    1. for each pair of neighbouring pixels, its step as a function of time and angle is unwrapped
       by a minimum-cost flow on the time-angle grid. In the boundary frame it stays as it is:
       there the object is thin. This is what allows steps of more than half a turn elsewhere;
    2. in each frame, a minimum-cost flow closes the loops that the steps of the first stage leave
       open. Turns are dear where the first stage closed by itself.

    The level of each frame follows from its border, as for `spatial-2d`. The flows are solved by
    OR-tools where it is installed, else by SciPy's HiGHS: the same cost, more slowly.

    Parameters
    ----------
    problem : Problem
        Pixels outside the mask take part at the lowest cost, so that parts which don't touch
        each other keep a common level; they are 0 in the result.
    progress, cancelled : callable or None
        See `unwrap`.
    """
    wrapped = problem.wrapped
    n_times, n_angles, height, width = wrapped.shape
    down, down_cost = steps_over_frames(problem, 2, progress, cancelled)
    right, right_cost = steps_over_frames(problem, 3, progress, cancelled)
    watch = Watch(problem.n_frames, "network flow in each frame", progress, cancelled)
    frames = list(product(range(n_times), range(n_angles)))
    border = np.empty((n_times, n_angles))
    edge = border_of((height, width))
    result = np.empty_like(wrapped)

    def work(frame: Boundary) -> Whole:
        more_down, more_right = closing_turns(
            down[frame][None], right[frame][None], down_cost[frame][None], right_cost[frame][None]
        )
        return integrated(down[frame] + more_down[0], right[frame] + more_right[0])

    for frame, turns in zip(frames, in_threads(work, frames, watch), strict=True):
        result[frame] = wrapped[frame] + np.float32(TURN) * turns.astype(np.float32)
        border[frame] = float(np.median(result[frame][edge]))
    level = np.round((border_medians(border, problem.first) - border) / TURN).astype(np.float32)
    result += np.float32(TURN) * level[..., None, None]
    return np.where(problem.mask, result, np.float32(0))


def integrated(down: Whole, right: Whole) -> Whole:
    """Return the turns of each pixel of a frame from steps that close."""
    turns = np.zeros((right.shape[0], down.shape[1]), dtype=np.int64)
    turns[1:, 0] = np.cumsum(down[:, 0])
    turns[:, 1:] = turns[:, :1] + np.cumsum(right, axis=1)
    return turns


def steps_over_frames(
    problem: Problem, axis: int, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> tuple[Whole, Whole]:
    """Do the first stage for the steps along y (axis 2) or x (axis 3).

    Returns
    -------
    turns, cost : ndarray of int, shape of the steps
        Turns to add to the plain difference of each two neighbours, and the cost of one more.
    """
    # What lies outside a mask that was found is empty field, as good as any.
    mask = np.ones_like(problem.mask) if problem.finds_mask else problem.mask
    valid = both_ends(mask, axis)
    difference = np.diff(problem.wrapped, axis=axis)
    turns = np.zeros(difference.shape, dtype=np.int64)
    cost = np.ones(difference.shape, dtype=np.int64)
    if difference.size == 0:
        return turns, cost
    name = {2: "y", 3: "x"}[axis]
    blocks = list(row_blocks(difference.shape))
    watch = Watch(
        len(blocks), f"network flow over time and angle, along {name}", progress, cancelled
    )

    def work(rows: slice) -> tuple[Whole, Whole]:
        course = np.moveaxis(difference[:, :, rows], (0, 1), (-2, -1))
        used = np.moveaxis(valid[:, :, rows], (0, 1), (-2, -1))
        found, mended = course_turns(
            course.reshape(-1, *course.shape[-2:]),
            used.reshape(-1, *used.shape[-2:]),
            problem.first,
        )
        dear = np.where(mended, MENDED, STEADY).reshape(course.shape[:-2])
        return (
            np.moveaxis(found.reshape(course.shape), (-2, -1), (0, 1)),
            np.where(valid[:, :, rows], dear, OUTSIDE),
        )

    for rows, done in zip(blocks, in_threads(work, blocks, watch), strict=True):
        turns[:, :, rows], cost[:, :, rows] = done
    return turns, cost


def row_blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    """Yield the rows of the frames in blocks of bounded size."""
    frames = shape[0] * shape[1]
    rows = max(1, BLOCK // max(frames * shape[3], 1))
    for start in range(0, shape[2], rows):
        yield slice(start, min(start + rows, shape[2]))


def course_turns(
    course: Stack, used: NDArray[np.bool_], first: Boundary
) -> tuple[Whole, NDArray[np.bool_]]:
    """Unwrap steps between two pixels over time and angle.

    Parameters
    ----------
    course : ndarray of shape (n, times, angles)
        Difference of two neighbours' phase in every frame, radians.
    used : ndarray of bool, same shape
        Frames in which both pixels lie in the mask. A turn on the way to any other frame is cheap.
    first : tuple of int
        Frame in which the step is less than half a turn.

    Returns
    -------
    turns : ndarray of int, same shape
        Turns to add to the difference.
    mended : ndarray of bool, shape (n,)
        Whether loops over time and angle had to be closed.
    """
    over_time = -whole_turns(np.diff(course, axis=1))
    over_angle = -whole_turns(np.diff(course, axis=2))
    open_loops = loop_sums(over_time, over_angle).reshape(len(course), -1)
    mended = np.asarray(open_loops.any(axis=1))
    if mended.any():
        in_time = used[mended, 1:] & used[mended, :-1]
        in_angle = used[mended, :, 1:] & used[mended, :, :-1]
        more_time, more_angle = closing_turns(
            over_time[mended],
            over_angle[mended],
            np.where(in_time, MENDED, OUTSIDE),
            np.where(in_angle, MENDED, OUTSIDE),
        )
        over_time[mended] += more_time
        over_angle[mended] += more_angle
    turns = np.zeros(course.shape, dtype=np.int64)
    turns[:, 1:, 0] = np.cumsum(over_time[:, :, 0], axis=1)
    turns[:, :, 1:] = turns[:, :, :1] + np.cumsum(over_angle, axis=2)
    t, a = first
    at_first = course[:, t, a] + TURN * turns[:, t, a]
    turns -= whole_turns(at_first)[:, None, None]
    return turns, mended


def whole_turns(phase: NDArray[np.floating]) -> Whole:
    """Return the nearest number of turns."""
    return np.round(phase / TURN).astype(np.int64)
