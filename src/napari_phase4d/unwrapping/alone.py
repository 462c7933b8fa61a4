"""Each frame by itself: two-dimensional unwrapping, the object, its centre.

Step 1 of the paper's algorithms, a block of frames at a time. What is found are whole turns; the
phase is the wrapped phase plus these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Limits, ReadOnly, Stack, Store, limits_of, room_in
from napari_phase4d.task import Task, on_all_cores
from napari_phase4d.unwrapping.frames import (
    as_loops_take,
    border_medians,
    centre,
    turns_of_frame,
    unwrap_frame,
)
from napari_phase4d.unwrapping.given import Counted, Given
from napari_phase4d.unwrapping.growing import CostsOf, Workspace, second_differences
from napari_phase4d.unwrapping.objects import object_mask, smooth_share_left_out

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
    "lift_of",
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
    """Write a block of a result, lost frames as NaN; return its limits without these."""
    if given.usable is None and not usable.all():
        limits = limits_of(given.without_lost(unwrapped, usable))
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
    return Lifted(turns, lift_of(borders, problem.first))


def written_alone(problem: Framewise, result: Stack, task: Task) -> None:
    """Unwrap all frames one by one straight into a result in memory.

    That is for where nobody needs their turns afterwards. What frames are to be lifted by is known
    only when all are unwrapped. So each is written as if its border lay in the turn round 0, as
    that of most recordings does, and those that have drifted further are lifted where they are.
    Lifting reads what it writes, so it is not for workers, which may do a block twice.
    """
    borders = problem.each(PhaseBlock(problem.given, result), "2-D unwrapping", task)
    further = lift_of(borders, problem.first) - turns_round_0(np.concatenate(borders))
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
    unwrapped, _ = unwrap_frame(np.where(known, wrapped, np.float32(0)), known)
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
    return Lifted(turns, lift_of(borders, problem.first))


def lift_of(borders: Sequence[NDArray[np.float64]], first: tuple[int, int]) -> Turns:
    """Return the turns that bring the borders of all frames together."""
    border = np.concatenate(borders)
    lift: Turns = np.round((border_medians(border, first) - border) / TURN).astype(np.int16)
    return lift


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
        ndarray of shape (time, angle), bool
            The level of each frame's border; whether all pixels count.
        """
        wrapped, mask = self.given.read(block)
        if self.mask is not None:
            mask = self.mask.read(block)
        turns, border = room_in(self.turns, block, np.int16), np.empty(wrapped.shape[:2])
        for frame, own, level in each_of_block(wrapped, mask, self.costs_of):
            turns[frame], border[frame] = own, level
        whole = bool(mask.all())
        if not whole:
            turns[~mask] = 0
        self.turns.write(block, turns)
        return border, whole


def each_of_block(
    wrapped: Phase, mask: Mask, costs_of: CostsOf
) -> Iterator[tuple[tuple[int, ...], NDArray[np.int32], float]]:
    """Yield the place of each frame, its turns until the next one, and its border's level."""
    work = Workspace()
    for frame in np.ndindex(*wrapped.shape[:2]):
        yield frame, *turns_of_frame(wrapped[frame], mask[frame], costs_of, work)


def turns_round_0(border: NDArray[np.float64]) -> Turns:
    """Return the turns that bring levels of borders, in radians, into the turn round 0."""
    turns: Turns = -np.round(border / TURN).astype(np.int16)
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
        """Do a block; return the level of each frame's border, shape (time, angle)."""
        wrapped, usable = self.given.read(block)
        unwrapped, border = room_in(self.result, block, np.float32), np.empty(wrapped.shape[:2])
        for frame, turns, level in each_of_block(wrapped, usable, second_differences):
            border[frame] = level
            if lift := int(turns_round_0(border[frame])):  # most often none
                turns += lift
            write_phase(wrapped[frame], turns, usable[frame], unwrapped[frame])
        self.result.write(block, unwrapped)
        return border


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
        turns, unwrapped = self.turns.read(block), np.empty(wrapped.shape[2:], np.float32)
        found = room_in(self.found, block, np.bool_)
        centres = np.empty((*wrapped.shape[:2], 2))
        shares = np.zeros(wrapped.shape[:2])
        for frame in np.ndindex(*wrapped.shape[:2]):
            write_phase(wrapped[frame], turns[frame], usable[frame], unwrapped)
            found[frame] = object_mask(unwrapped)
            if self.finds_mask:
                shares[frame] = smooth_share_left_out(unwrapped, found[frame])
                found[frame] &= usable[frame]
            centres[frame] = centre(found[frame])
        self.found.write(block, found)
        return centres, shares
