"""Each frame by itself: two-dimensional unwrapping, the object, its centre.

Step 1 of the paper's algorithms, a block of frames at a time. What is found are whole turns; the
phase is the wrapped phase plus these.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Limits, ReadOnly, Stack, Store, limits_of, room_in
from napari_phase4d.task import Task, on_all_cores
from napari_phase4d.unwrapping.filters import half_gaussian
from napari_phase4d.unwrapping.frames import (
    as_loops_take,
    lift_of,
    moments,
    smooth_turns_and_levels,
    turns_past_residues,
    unwrap_frame,
)
from napari_phase4d.unwrapping.given import Counted, Given
from napari_phase4d.unwrapping.growing import CostsOf, Workspace, second_differences
from napari_phase4d.unwrapping.objects import mark_object, object_mask, smooth_share_left_out

__all__ = [
    "ALL_USABLE",
    "FindBlock",
    "FinishBlock",
    "Found",
    "Framewise",
    "Lifted",
    "Mask",
    "Phase",
    "Turns",
    "UnwrapBlock",
    "as_loops_take",
    "each_alone",
    "finished_phase",
    "found_in",
    "lifted_turns",
    "object_in",
    "with_turns",
    "write_block",
    "write_phase",
    "written_alone",
]

TURN = np.float32(2 * np.pi)
ALL = slice(None)
#: Name of whether all pixels count, among what a problem shares.
ALL_USABLE = "all usable"

Phase = NDArray[np.float32]
Mask = NDArray[np.bool_]
Turns = NDArray[np.int16] | NDArray[np.int32]
R = TypeVar("R")


class Framewise(Protocol):
    """What is asked of a problem to unwrap its frames one by one."""

    @property
    def given(self) -> Given:
        """The wrapped phase, and the pixels that count."""

    @property
    def store(self) -> Store:
        """Where stacks lie that are needed on the way."""

    @property
    def first(self) -> tuple[int, int]:
        """The boundary frame."""

    @property
    def finds_mask(self) -> bool:
        """Whether the object is what is to be unwrapped."""

    def once(self, name: str, work: Callable[[], R]) -> R:
        """Return what ``work()`` returned when it was first asked for by this name."""

    def blocks(self) -> list[Block]:
        """Cut the frames into blocks."""

    def each(
        self,
        work: Callable[[Block], R],
        message: str,
        task: Task,
    ) -> list[R]:
        """Do some work on every block."""


@dataclass(frozen=True)
class Found:
    """The object in all frames.

    Parameters
    ----------
    object : Stack
        Its pixels.
    centres : ndarray of shape (time, angle, 2)
        Centre of the object in pixels, NaN where there is none.
    smooth_left_out : ndarray of shape (time, angle)
        Share of the field that is no part of the object though its phase is smooth and not flat.
    """

    object: Stack
    centres: NDArray[np.float64]
    smooth_left_out: NDArray[np.float64]


@dataclass(frozen=True)
class Lifted(ReadOnly):
    """Turns with more whole turns for each frame, which are added as they are read.

    Parameters
    ----------
    turns : Stack
        Turns of each frame by itself.
    lift : ndarray of int, shape (time, angle)
        Whole turns to add to each frame.
    """

    turns: Stack
    lift: Turns

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        return self.turns.shape

    def read(self, block: Block, angles: slice = ALL) -> Turns:
        """Return the turns of a block."""
        turns: Turns = self.turns.read(block, angles)
        more = self.lift[block.start : block.stop, angles]
        return turns + more[..., None, None] if more.any() else turns


@dataclass(frozen=True)
class FinishBlock:
    """Writes unwrapped phase from the turns that a method found.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    turns, mask : Stack
        What was found, and where.
    result : Stack
        Where unwrapped phase goes.
    """

    given: Given
    turns: Stack
    mask: Stack
    result: Stack

    def __call__(self, block: Block) -> Limits:
        """Do a block; return its smallest and largest phase."""
        wrapped, mask, usable = self.given.read_marked(block, self.mask)
        unwrapped = room_in(self.result, block, np.float32)
        limits = finished_phase(wrapped, self.turns.read(block), mask, unwrapped)
        return write_block(self.given, self.result, block, unwrapped, usable, limits)


def write_block(
    given: Given, result: Stack, block: Block, unwrapped: Phase, usable: Mask, limits: Limits
) -> Limits:
    """Write a block of a result, NaN where nothing is known; return its limits without that."""
    if given.usable is None and not usable.all():
        limits = limits_of(given.without_unknown(unwrapped, usable))
    result.write(block, unwrapped)
    return limits


def with_turns(wrapped: Phase, turns: Turns, mask: Mask) -> Phase:
    """Return wrapped phase plus whole turns inside the mask, 0 outside."""
    unwrapped: Phase = np.empty(wrapped.shape, np.float32)
    for frame in np.ndindex(*wrapped.shape[:-2]):
        write_phase(wrapped[frame], turns[frame], mask[frame], unwrapped[frame])
    return unwrapped


def finished_phase(wrapped: Phase, turns: Turns, mask: Mask, out: Phase) -> Limits:
    """Write wrapped phase plus whole turns inside the mask, 0 outside; return its limits.

    All arrays have the same shape; the last two axes are y and x.
    """
    lows, highs = [], []
    for frame in np.ndindex(*wrapped.shape[:-2]):
        write_phase(wrapped[frame], turns[frame], mask[frame], out[frame])
        lows.append(out[frame].min())
        highs.append(out[frame].max())
    return float(min(lows)), float(max(highs))


def write_phase(wrapped: Phase, turns: Turns, mask: Mask, out: Phase) -> None:
    """Write wrapped phase plus whole turns inside the mask of a frame, 0 outside."""
    add_in_mask(
        as_loops_take(wrapped, np.float32),
        as_loops_take(turns),
        as_loops_take(mask, np.bool_),
        out,
    )


@compiled
def add_in_mask(wrapped: Phase, turns: Turns, mask: Mask, out: Phase) -> None:
    """Write wrapped phase plus whole turns inside the mask of a frame, 0 outside."""
    for y in range(len(out)):
        add_in_row(wrapped[y], turns[y], mask[y], out[y])


@compiled
def add_in_row(wrapped: Phase, turns: Turns, mask: Mask, out: Phase) -> None:
    """Do a row of it."""
    turn = np.float32(2 * np.pi)
    for x in range(len(out)):
        phase = np.float32(turns[x]) * turn + wrapped[x]
        out[x] = phase if mask[x] else np.float32(0)


def each_alone(problem: Framewise, task: Task) -> Stack:
    """Unwrap all frames one by one, and return their turns, lifted to each other."""
    turns = problem.store.temporary("alone", problem.given.shape, "int16")
    unwrap = UnwrapBlock(problem.given, turns)
    borders, whole = zip(*problem.each(unwrap, "2-D unwrapping", task), strict=True)
    problem.once(ALL_USABLE, lambda: all(whole))  # on disk another look at all of it would be long
    return Lifted(turns, lift_of(np.concatenate(borders), problem.first))


def written_alone(problem: Framewise, result: Stack, task: Task) -> None:
    """Unwrap all frames one by one straight into a result in memory.

    That is for where nobody needs their turns afterwards. What frames are to be lifted by is known
    only when all are unwrapped. So each is written as if its border lay in the turn round 0, as
    that of most recordings does, and those that have drifted further are lifted where they are.
    Lifting reads what it writes, so it is not for workers, which may do a block twice.
    """
    borders = problem.each(PhaseBlock(problem.given, result), "2-D unwrapping", task)
    levels = np.concatenate(borders)
    further = lift_of(levels, problem.first) - turns_round_0(levels)
    if further.any():
        turns = Lifted(TurnsIn(problem.given, result), further)
        lift = FinishBlock(problem.given, turns, Counted(problem.given), result)
        on_all_cores(lift, [b for b in problem.blocks() if further[b.start : b.stop].any()])


def found_in(
    problem: Framewise,
    turns: Stack,
    task: Task,
) -> Found:
    """Find the object in all frames, by the turns that `each_alone` gave."""
    found = problem.store.temporary("object", problem.given.shape, "bool")
    work = FindBlock(problem.given, turns, found, problem.finds_mask)
    each = problem.each(work, "finding the object", task)
    centres, shares = (np.concatenate([block[i] for block in each]) for i in (0, 1))
    return Found(found, centres, shares)


def object_in(wrapped: Phase) -> Mask:
    """Return what of a frame is taken for the object where only that is to be unwrapped.

    Parameters
    ----------
    wrapped : ndarray of shape (y, x)
        Wrapped phase in radians; pixels that are NaN are not of the object.
    """
    known = np.isfinite(wrapped)
    unwrapped = unwrap_frame(np.where(known, wrapped, np.float32(0)), known)
    return object_mask(unwrapped) & known


def lifted_turns(
    problem: Framewise,
    mask: Stack,
    costs_of: CostsOf,
    task: Task,
) -> Stack:
    """Return the turns of each frame by itself, joined in another order inside a mask."""
    shape = problem.given.shape
    turns = problem.store.temporary("ordered", shape, "int16")
    unwrap = UnwrapBlock(problem.given, turns, mask, costs_of)
    borders = [border for border, _ in problem.each(unwrap, "2-D unwrapping", task)]
    return Lifted(turns, lift_of(np.concatenate(borders), problem.first))


@dataclass(frozen=True)
class UnwrapBlock:
    """Unwraps each frame of a block; whole turns of a frame are left open.

    Parameters
    ----------
    given : Given
        Wrapped phase, and the pixels that count.
    turns : Stack
        Where the turns go.
    mask : Stack, optional
        Pixels to unwrap; default: all that count.
    costs_of : callable, optional
        What is joined first, see `grow_grid`.
    """

    given: Given
    turns: Stack
    mask: Stack | None = None
    costs_of: CostsOf = second_differences

    def __call__(self, block: Block) -> tuple[NDArray[np.float64], bool]:
        """Do a block.

        Returns
        -------
        ndarray of shape (time, angle, 2), bool
            The levels of each frame's border; whether all pixels count.
        """
        wrapped, mask = self.given.read(block)
        if self.mask is not None:
            mask = self.mask.read(block)
        wrapped, mask = as_loops_take(wrapped, np.float32), as_loops_take(mask, np.bool_)
        turns, border = room_in(self.turns, block, np.int16), np.empty((*wrapped.shape[:2], 2))
        smooth = np.empty(wrapped.shape[:2], np.bool_)
        turns_where_smooth(wrapped, mask, turns, border, smooth)
        work = Workspace()
        for frame in zip(*np.nonzero(~smooth), strict=True):
            turns[frame], border[frame] = turns_past_residues(
                wrapped[frame], mask[frame], self.costs_of, work
            )
        whole = bool(mask.all())
        if not whole:
            turns[~mask] = 0
        self.turns.write(block, turns)
        return border, whole


@compiled
def turns_where_smooth(
    wrapped: Phase, mask: Mask, out: Turns, border: NDArray[np.float64], smooth: Mask
) -> None:
    """Write the turns of those frames of a block that have no residues.

    All in one piece: threads would wait for each other between the frames.

    Parameters
    ----------
    wrapped, mask, out : ndarray of shape (time, angle, y, x)
        Wrapped phase, what counts, and where the turns go.
    border : ndarray of shape (time, angle, 2)
        Where the levels of each frame's border go.
    smooth : ndarray of shape (time, angle)
        Where it goes whether a frame has no residues.
    """
    n_times, n_angles, height, width = wrapped.shape
    turns = np.empty((height, width), np.int32)
    for t in range(n_times):
        for a in range(n_angles):
            smooth[t, a], levels = smooth_turns_and_levels(wrapped[t, a], mask[t, a], turns)
            border[t, a, 0], border[t, a, 1] = levels
            if not smooth[t, a]:  # its turns were left where the first residue is
                continue
            for y in range(height):
                for x in range(width):
                    out[t, a, y, x] = turns[y, x]


def turns_round_0(levels: NDArray[np.float64]) -> Turns:
    """Return the turns that bring borders with `BorderLevels` (..., 2) into the turn round 0."""
    level = np.where(np.isnan(levels[..., 1]), levels[..., 0], levels[..., 1])
    turns: Turns = -np.round(level / TURN).astype(np.int16)
    return turns


@dataclass(frozen=True)
class PhaseBlock:
    """Unwraps each frame of a block and writes its phase, its border in the turn round 0.

    Parameters
    ----------
    given : Given
        Wrapped phase, and the pixels that count.
    result : Stack
        Where unwrapped phase goes.
    """

    given: Given
    result: Stack

    def __call__(self, block: Block) -> NDArray[np.float64]:
        """Do a block; return the levels of each frame's border, shape (time, angle, 2)."""
        wrapped, usable = self.given.read(block)
        wrapped, usable = as_loops_take(wrapped, np.float32), as_loops_take(usable, np.bool_)
        unwrapped = room_in(self.result, block, np.float32)
        border = np.empty((*wrapped.shape[:2], 2))
        smooth = np.empty(wrapped.shape[:2], np.bool_)
        phase_where_smooth(wrapped, usable, unwrapped, border, smooth)
        work = Workspace()
        for frame in zip(*np.nonzero(~smooth), strict=True):
            turns, border[frame] = turns_past_residues(
                wrapped[frame], usable[frame], second_differences, work
            )
            turns += int(turns_round_0(border[frame]))
            write_phase(wrapped[frame], turns, usable[frame], unwrapped[frame])
        self.result.write(block, unwrapped)
        return border


@compiled
def phase_where_smooth(
    wrapped: Phase, usable: Mask, out: Phase, border: NDArray[np.float64], smooth: Mask
) -> None:
    """Write the phase of those frames that have no residues, see `turns_where_smooth`."""
    n_times, n_angles, height, width = wrapped.shape
    turns = np.empty((height, width), np.int32)
    for t in range(n_times):
        for a in range(n_angles):
            smooth[t, a], levels = smooth_turns_and_levels(wrapped[t, a], usable[t, a], turns)
            border[t, a, 0], border[t, a, 1] = levels
            if not smooth[t, a]:
                continue
            level = levels[0] if np.isnan(levels[1]) else levels[1]
            lift = -np.int32(np.rint(level / np.float64(TURN)))
            if lift:  # most often none
                for y in range(height):
                    for x in range(width):
                        turns[y, x] += lift
            add_in_mask(wrapped[t, a], turns, usable[t, a], out[t, a])


@dataclass(frozen=True)
class TurnsIn(ReadOnly):
    """The turns in unwrapped phase.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    unwrapped : Stack
        It and whole turns.
    """

    given: Given
    unwrapped: Stack

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        return self.given.shape

    def read(self, block: Block, angles: slice = ALL) -> Turns:
        """Return the turns of a block."""
        wrapped, _ = self.given.read(block, angles)
        unwrapped = self.unwrapped.read(block, angles)
        turns: Turns = np.empty(wrapped.shape, np.int16)
        for frame in np.ndindex(*wrapped.shape[:2]):
            turns_between(
                as_loops_take(wrapped[frame]),
                as_loops_take(unwrapped[frame]),
                turns[frame],
            )
        return turns


@compiled
def turns_between(wrapped: Phase, unwrapped: Phase, out: Turns) -> None:
    """Write the turns from wrapped to unwrapped phase."""
    turn = np.float32(2 * np.pi)
    for y in range(len(out)):
        for x in range(out.shape[1]):
            out[y, x] = np.int16(np.rint((unwrapped[y, x] - wrapped[y, x]) / turn))


@dataclass(frozen=True)
class FindBlock:
    """Finds the object, and where its centre lies.

    Parameters
    ----------
    given : Given
        Wrapped phase, and the pixels that count.
    turns : Stack
        Turns of each frame by itself, lifted.
    found : Stack
        Where the object goes.
    finds_mask : bool
        Whether the object is what is to be unwrapped, so that both are one.
    """

    given: Given
    turns: Stack
    found: Stack
    finds_mask: bool

    def __call__(self, block: Block) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Do a block.

        Returns
        -------
        ndarray of shape (time, angle, 2), ndarray of shape (time, angle)
            The object's centre in each frame; the share of the frame that is left out though its
            phase is smooth and not flat, where the object is to be found.
        """
        wrapped, usable = self.given.read(block)
        found = room_in(self.found, block, np.bool_)
        sums, shares = np.empty((*wrapped.shape[:2], 3), np.intp), np.zeros(wrapped.shape[:2])
        find_objects(
            as_loops_take(wrapped, np.float32),
            as_loops_take(self.turns.read(block)),
            as_loops_take(usable, np.bool_),
            half_gaussian(),
            self.finds_mask,
            found,
            sums,
            shares,
        )
        self.found.write(block, found)
        count = sums[..., :1]
        none = (count == 0) | (count == wrapped[0, 0].size)
        return np.where(none, np.nan, sums[..., 1:] / np.maximum(count, 1)), shares


@compiled
def find_objects(
    wrapped: Phase,
    turns: Turns,
    usable: Mask,
    half: NDArray[np.float64],
    finds_mask: bool,
    found: Mask,
    sums: NDArray[np.intp],
    shares: NDArray[np.float64],
) -> None:
    """Mark the object in all frames of a block.

    All in one piece: threads would wait for each other between the frames.

    Parameters
    ----------
    wrapped, turns, usable : ndarray of shape (time, angle, y, x)
        Wrapped phase, turns of each frame by itself, and what counts.
    half : ndarray of float64, shape (5,)
        What `half_gaussian` returns.
    finds_mask : bool
        Whether the object is what is to be unwrapped.
    found : ndarray of bool, shape (time, angle, y, x)
        Where the object goes.
    sums : ndarray of int, shape (time, angle, 3)
        Where the number of its pixels goes, and the sums of their rows and columns.
    shares : ndarray of shape (time, angle)
        Where the shares left out go, if the object is what is to be unwrapped.
    """
    n_times, n_angles, height, width = wrapped.shape
    unwrapped = np.empty((height, width), np.float32)
    for t in range(n_times):
        for a in range(n_angles):
            mask, known = found[t, a], usable[t, a]
            add_in_mask(wrapped[t, a], turns[t, a], known, unwrapped)
            mark_object(unwrapped, half, mask)
            if finds_mask:
                shares[t, a] = smooth_share_left_out(unwrapped, mask)
                for y in range(height):
                    for x in range(width):
                        mask[y, x] &= known[y, x]
            sums[t, a, 0], sums[t, a, 1], sums[t, a, 2] = moments(mask)
