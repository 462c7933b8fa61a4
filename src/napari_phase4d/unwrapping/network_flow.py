"""Space-time network flow in two stages, each of them a minimum-cost flow on a grid.

Costantini 1998 (IEEE Trans. Geosci. Remote Sens. 36, 813): between four neighbouring pixels the
wrapped steps should add up to zero. Where they don't, whole turns are added to some steps. On a
two-dimensional grid every step borders two such cells (or one and the outside), so that the turns
are a flow from cells of positive to cells of negative sum, and the cheapest is found exactly.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block, Limits, Stack, Temporary
from napari_phase4d.task import Task, Watch
from napari_phase4d.unwrapping.alone import FinishBlock, Lifted
from napari_phase4d.unwrapping.frames import border_of, lift_of, median_and_field
from napari_phase4d.unwrapping.given import Boundary, Given
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["closing_turns", "loop_sums", "network_flow"]

Whole = NDArray[np.int64]


def loop_sums(down: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Return the sum of steps round every cell of a batch of grids.

    Parameters
    ----------
    down : ndarray, shape (..., ny - 1, nx)
        Step from each pixel to the one below.
    right : ndarray, shape (..., ny, nx - 1)
        Step from each pixel to the one at its right.

    Returns
    -------
    ndarray, shape (..., ny - 1, nx - 1)
    """
    sums: NDArray[Any] = right[..., :-1, :] + down[..., 1:] - right[..., 1:, :] - down[..., :-1]
    return sums


def closing_turns(
    down: Whole, right: Whole, cost_down: Whole, cost_right: Whole
) -> tuple[Whole, Whole]:
    """Return the cheapest turns to add to the steps of grids so that all loops close.

    Parameters
    ----------
    down, right : ndarray of int, shapes (n, ny - 1, nx) and (n, ny, nx - 1)
        Steps in turns, of n grids.
    cost_down, cost_right : ndarray of int, same shapes
        Cost of one turn at each step, 0 or more.

    Returns
    -------
    ndarray, ndarray
        Turns to add, in the shapes of ``down`` and ``right``.
    """
    sums = loop_sums(down, right)
    if not sums.any():  # also where a grid is too narrow for loops
        return np.zeros_like(down), np.zeros_like(right)
    n, ny, nx = sums.shape
    outside = n * ny * nx
    cells = np.full((n, ny + 2, nx + 2), outside)
    cells[:, 1:-1, 1:-1] = np.arange(outside).reshape(sums.shape)
    # A turn added to a step takes one from the sum of the cell on one side and brings it to the
    # other.
    raised = np.concatenate([cells[:, 1:-1, :-1].ravel(), cells[:, 1:, 1:-1].ravel()])
    lowered = np.concatenate([cells[:, 1:-1, 1:].ravel(), cells[:, :-1, 1:-1].ravel()])
    cost = np.concatenate([cost_down.ravel(), cost_right.ravel()])
    needed = np.append(sums.ravel(), -sums.sum())
    solve = by_ortools if importlib.util.find_spec("ortools") else by_linear_program
    turns = solve(lowered, raised, cost, needed)
    return turns[: down.size].reshape(down.shape), turns[down.size :].reshape(right.shape)


def by_ortools(tail: Whole, head: Whole, cost: Whole, supply: Whole) -> Whole:
    """Return the cheapest flow from tails to heads, negative where it runs back (OR-tools)."""
    from ortools.graph.python import min_cost_flow

    problem: Any = min_cost_flow.SimpleMinCostFlow()
    capacity = np.full(2 * len(tail), int(np.abs(supply).sum()))
    arcs = problem.add_arcs_with_capacity_and_unit_cost(
        np.concatenate([tail, head]), np.concatenate([head, tail]), capacity, np.tile(cost, 2)
    )
    problem.set_nodes_supplies(np.arange(len(supply)), supply)
    status = problem.solve()
    if status != problem.OPTIMAL:
        msg = f"the network-flow solver stopped with status {status}"
        raise RuntimeError(msg)
    forth, back = problem.flows(arcs).reshape(2, -1)
    return np.asarray(forth - back, dtype=np.int64)


def by_linear_program(tail: Whole, head: Whole, cost: Whole, supply: Whole) -> Whole:
    """Return the cheapest flow from tails to heads, negative where it runs back (HiGHS).

    The constraints of a flow are totally unimodular, so that the vertex which the simplex method
    finds is whole-numbered.
    """
    n = len(tail)
    ones, arcs = np.ones(n), np.arange(n)
    out = scipy.sparse.coo_array((ones, (tail, arcs)), shape=(len(supply), n))
    into = scipy.sparse.coo_array((ones, (head, arcs)), shape=(len(supply), n))
    balance = (out - into).tocsc()
    found = scipy.optimize.linprog(
        np.tile(cost, 2),
        A_eq=scipy.sparse.hstack([balance, -balance]).tocsc(),
        b_eq=supply,
        bounds=(0, None),
        method="highs-ds",
    )
    if found.x is None:
        msg = f"the network-flow solver stopped: {found.message}"
        raise RuntimeError(msg)
    forth, back = np.round(found.x).astype(np.int64).reshape(2, -1)
    return np.asarray(forth - back)


# ---- the two stages -------------------------------------------------------------------------


TURN = 2 * np.pi
#: Cost of a turn: outside the mask; inside it, where the first stage had to mend a step's course
#: over time and angle; where that course closed by itself. Ten of one kind weigh as much as one of
#: the next.
OUTSIDE, MENDED, STEADY = 1, 10, 100
#: Values that are read at a time in the first stage, and of these in one flow.
AT_ONCE, IN_A_FLOW = 1 << 22, 1 << 17

Phase = NDArray[np.float32]
Mask = NDArray[np.bool_]


def network_flow(
    problem: Problem,
    result: Stack,
    task: Task,
) -> list[Limits]:
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
    result : Stack
        Where the unwrapped phase goes, radians.
    task : Task
        Who is told of it, and may stop it.
    """
    given, shape = problem.given, problem.given.shape
    mask = problem.counted(task)
    phase, used = copied(problem, task)
    steps: list[Stack] = []
    for down in (True, False):
        steps += steps_over_frames(problem, phase, used, task, down=down)
    turns = problem.store.temporary("flow turns", shape, "int32")
    close = CloseBlock(given, tuple(steps), turns)
    borders = problem.each(close, "network flow in each frame", task)
    border = np.concatenate(borders)
    finish = FinishBlock(given, Lifted(turns, lift_of(border, problem.first)), mask, result)
    return problem.each(finish, "writing", task)


def copied(problem: Problem, task: Task) -> tuple[Temporary, Temporary | None]:
    """Copy the phase, and which pixels count (None for all), to where pixels can be read."""
    store, shape = problem.store, problem.given.shape
    phase = store.temporary("flow phase", shape, "float32")
    # What lies outside a mask that was found is empty field, as good as any.
    whole = problem.finds_mask or problem.all_usable
    used = None if whole else store.temporary("flow mask", shape, "bool")
    problem.each(CopyBlock(problem.given, phase, used), "network flow", task)
    return phase, used


def steps_over_frames(
    problem: Problem,
    phase: Temporary,
    used: Temporary | None,
    task: Task,
    *,
    down: bool,
) -> tuple[Temporary, Temporary]:
    """Do the first stage for the steps along y, or along x.

    Returns
    -------
    turns, cost : Temporary
        Turns to add to the difference of each pixel to the next, and the cost of one more; 0
        where there is no next one.
    """
    name, shape = "y" if down else "x", problem.given.shape
    turns = problem.store.temporary(f"flow turns {name}", shape, "int32")
    cost = problem.store.temporary(f"flow cost {name}", shape, "uint8")
    work = CourseBlock(phase, used, down, problem.first, turns, cost)
    parts = pixel_blocks(shape)
    message = f"network flow over time and angle, along {name}"
    for _ in problem.on_workers(work, parts, Watch(len(parts), message, task)):
        pass
    return turns, cost


@dataclass(frozen=True)
class CopyBlock:
    """Copies wrapped phase, and which pixels count, to where pixels can be read at all times.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    phase, used : Stack
        Where they go.
    """

    given: Given
    phase: Stack
    used: Stack | None

    def __call__(self, block: Block) -> None:
        """Do a block."""
        wrapped, usable = self.given.read(block)
        self.phase.write(block, wrapped)
        if self.used is not None:
            self.used.write(block, usable)


def pixel_blocks(shape: tuple[int, ...]) -> list[Block]:
    """Cut the pixels of a frame, counted over y and x, into blocks for the first stage."""
    count = shape[2] * shape[3]
    each = max(1, AT_ONCE // (shape[0] * shape[1]))
    return [Block(p, min(p + each, count)) for p in range(0, count, each)]


@dataclass(frozen=True)
class CourseBlock:
    """Does the first stage for the steps from some pixels of the frames.

    Parameters
    ----------
    phase : Temporary
        Wrapped phase in radians.
    used : Temporary or None
        Pixels that count; None for all.
    down : bool
        Whether the other pixel lies below; else at the right.
    first : tuple of int
        The boundary frame.
    turns, cost : Temporary
        Where the turns go that are to be added to the difference of the two, and the cost of one
        more; 0 where there is no other pixel.
    """

    phase: Temporary
    used: Temporary | None
    down: bool
    first: Boundary
    turns: Temporary
    cost: Temporary

    def __call__(self, pixels: Block) -> None:
        """Do some pixels."""
        height, width = self.phase.shape[2:]
        step = width if self.down else 1
        course = self._read(self.phase, pixels, step) - self._read(self.phase, pixels, 0)
        used = np.ones(course.shape, dtype=bool)
        if self.used is not None:
            used = self._read(self.used, pixels, step) & self._read(self.used, pixels, 0)
        turns = np.zeros(course.shape, dtype=np.int32)
        cost = np.zeros(course.shape, dtype=np.uint8)
        number = np.arange(pixels.start, pixels.stop)
        last = number >= (height - 1) * width if self.down else (number + 1) % width == 0
        there = np.flatnonzero(~last)
        each = max(1, IN_A_FLOW // course[0].size)
        for start in range(0, len(there), each):
            some = there[start : start + each]
            turns[some], mended = course_turns(course[some], used[some], self.first)
            dear = np.where(mended, MENDED, STEADY)[:, None, None]
            cost[some] = np.where(used[some], dear, OUTSIDE)
        for angle in range(self.phase.shape[1]):
            place = self._place(pixels, angle)
            self.turns.write_pixels(place, turns[:, :, angle].T)
            self.cost.write_pixels(place, cost[:, :, angle].T)

    def _read(self, stack: Temporary, pixels: Block, further: int) -> NDArray[Any]:
        """Return pixels, or others further on, over time and angle: (pixel, time, angle)."""
        found = []
        end = stack.shape[2] * stack.shape[3]
        start, stop = min(pixels.start + further, end), min(pixels.stop + further, end)
        for angle in range(stack.shape[1]):
            some = stack.read_pixels(self._place(Block(start, stop), angle)).T
            found.append(np.pad(some, ((0, len(pixels) - len(some)), (0, 0))))
        return np.stack(found, axis=2)

    def _place(self, pixels: Block, angle: int) -> Block:
        """Return where pixels of a frame lie among those of all views."""
        before = angle * self.phase.shape[2] * self.phase.shape[3]
        return Block(before + pixels.start, before + pixels.stop)


@dataclass(frozen=True)
class CloseBlock:
    """Does the second stage for the frames of a block.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    steps : tuple of Stack
        What the first stage gave for the steps from each pixel to that below, turns and cost, and
        for those to the right.
    turns : Stack
        Where the turns of each pixel go; the level of a frame is open.
    """

    given: Given
    steps: tuple[Stack, ...]
    turns: Stack

    def __call__(self, block: Block) -> NDArray[np.float64]:
        """Do a block; return the levels of each frame's border, shape (time, angle, 2)."""
        wrapped, _ = self.given.read(block)
        down, down_cost, right, right_cost = (s.read(block).astype(np.int64) for s in self.steps)
        steps = (down[..., :-1, :], right[..., :-1], down_cost[..., :-1, :], right_cost[..., :-1])
        turns = np.empty(wrapped.shape, dtype=np.int32)
        border = np.empty((*wrapped.shape[:2], 2))
        edge = border_of(wrapped.shape[2:])
        for frame in np.ndindex(*wrapped.shape[:2]):
            own = [part[frame][None] for part in steps]
            more_down, more_right = closing_turns(*own)
            turns[frame] = integrated(own[0][0] + more_down[0], own[1][0] + more_right[0])
            level = wrapped[frame] + np.float32(TURN) * turns[frame].astype(np.float32)
            border[frame] = median_and_field(level[edge])
        self.turns.write(block, turns)
        return border


def integrated(down: Whole, right: Whole) -> Whole:
    """Return the turns of each pixel of a frame from steps that close."""
    turns = np.zeros((right.shape[0], down.shape[1]), dtype=np.int64)
    turns[1:, 0] = np.cumsum(down[:, 0])
    turns[:, 1:] = turns[:, :1] + np.cumsum(right, axis=1)
    return turns


def course_turns(course: Phase, used: Mask, first: Boundary) -> tuple[Whole, Mask]:
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
