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

from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.stack import Block, Stack, Store
from napari_phase4d.unwrapping.given import Given
from napari_phase4d.unwrapping.growing import CostsOf, Workspace, second_differences
from napari_phase4d.unwrapping.masks import object_mask, smooth_share_left_out
from napari_phase4d.unwrapping.registration import centre
from napari_phase4d.unwrapping.spatial import border_medians, unwrap_frame

__all__ = [
    "Alone",
    "Framewise",
    "Lift",
    "LiftBlock",
    "Mask",
    "Phase",
    "Turns",
    "UnwrapBlock",
    "each_alone",
    "lift_of",
    "lifted_turns",
    "object_in",
    "turns_of",
    "with_turns",
]

TURN = np.float32(2 * np.pi)

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

    def each(
        self,
        work: Callable[[Block], R],
        message: str,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
    ) -> list[R]:
        """Do some work on every block."""


@dataclass(frozen=True)
class Alone:
    """What two-dimensional unwrapping gave for all frames.

    Parameters
    ----------
    turns : Stack
        Whole turns of each pixel.
    mask, object : Stack
        Pixels to unwrap, and the object.
    centres : ndarray of shape (time, angle, 2)
        Centre of the object in pixels, NaN where there is none.
    smooth_left_out : float
        Mean share of the field that is no part of the object though its phase is smooth, not flat.
    """

    turns: Stack
    mask: Stack
    object: Stack
    centres: NDArray[np.float64]
    smooth_left_out: float


def turns_of(unwrapped: Phase, wrapped: Phase) -> Turns:
    """Return the whole turns that were added to wrapped phase."""
    turns: Turns = np.rint((unwrapped - wrapped) / TURN).astype(np.int16)
    return turns


def with_turns(wrapped: Phase, turns: Turns, mask: Mask) -> Phase:
    """Return wrapped phase plus whole turns inside the mask, 0 outside."""
    unwrapped: Phase = turns.astype(np.float32)
    unwrapped *= TURN
    unwrapped += wrapped
    if not mask.all():
        unwrapped[~mask] = 0
    return unwrapped


def each_alone(
    problem: Framewise, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> Alone:
    """Unwrap all frames, lift them by whole turns, and find the object."""
    shape = problem.given.shape
    turns = problem.store.temporary("alone", shape, "int16")
    unwrap = UnwrapBlock(problem.given, turns)
    borders = problem.each(unwrap, "2-D unwrapping", progress, cancelled)
    found = problem.store.temporary("object", shape, "bool")
    mask = found if problem.finds_mask else problem.store.temporary("mask", shape, "bool")
    lifted = problem.store.temporary("lifted", shape, "int16")
    lift = lift_of(borders, problem.first)
    work = LiftBlock(problem.given, turns, lifted, lift, mask, found, problem.finds_mask)
    each = problem.each(work, "finding the object", progress, cancelled)
    centres, shares = (np.concatenate([block[i] for block in each]) for i in (0, 1))
    return Alone(lifted, mask, found, centres, float(shares.mean()))


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
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
) -> Stack:
    """Return the turns of each frame by itself, joined in another order inside a mask."""
    shape = problem.given.shape
    turns = problem.store.temporary("ordered", shape, "int16")
    unwrap = UnwrapBlock(problem.given, turns, mask, costs_of)
    lift = lift_of(problem.each(unwrap, "2-D unwrapping", progress, cancelled), problem.first)
    lifted = problem.store.temporary("ordered_lifted", shape, "int16")

    problem.each(Lift(turns, lifted, lift), "lifting frames", progress, cancelled)
    return lifted


def lift_of(borders: list[NDArray[np.float64]], first: tuple[int, int]) -> Turns:
    """Return the turns that bring the borders of all frames together."""
    border = np.concatenate(borders)
    lift: Turns = np.round((border_medians(border, first) - border) / TURN).astype(np.int16)
    return lift


@dataclass(frozen=True)
class Lift:
    """Adds each frame's whole turns; not in place, since a block may be done twice."""

    turns: Stack
    lifted: Stack
    lift: Turns

    def __call__(self, block: Block) -> None:
        """Do a block."""
        more = self.lift[block.start : block.stop, :, None, None]
        self.lifted.write(block, self.turns.read(block) + more)


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

    def __call__(self, block: Block) -> NDArray[np.float64]:
        """Do a block; return the level of each frame's border, shape (time, angle)."""
        wrapped, mask = self.given.read(block)
        if self.mask is not None:
            mask = self.mask.read(block)
        work, out = Workspace(), np.empty_like(wrapped)
        border = np.empty(wrapped.shape[:2])
        for frame in np.ndindex(*border.shape):
            _, border[frame] = unwrap_frame(
                wrapped[frame], mask[frame], self.costs_of, work, out[frame]
            )
        self.turns.write(block, np.where(mask, turns_of(out, wrapped), np.int16(0)))
        return border


@dataclass(frozen=True)
class LiftBlock:
    """Adds each frame's whole turns, finds the object, and where its centre lies.

    Parameters
    ----------
    given : Given
        Wrapped phase, and the pixels that count.
    turns, lifted : Stack
        Turns of each frame by itself, and where the lifted ones go: were it the same place, a
        block that is done twice, because a worker died, would be lifted twice.
    lift : ndarray of int, shape (time, angle)
        Whole turns to add to each frame.
    mask, found : Stack
        Where the pixels to unwrap go, and the object.
    finds_mask : bool
        Whether the object is what is to be unwrapped, so that both are one.
    """

    given: Given
    turns: Stack
    lifted: Stack
    lift: Turns
    mask: Stack
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
        turns = self.turns.read(block) + self.lift[block.start : block.stop, :, None, None]
        self.lifted.write(block, turns)
        unwrapped = with_turns(wrapped, turns, usable)
        found = np.empty(wrapped.shape, dtype=bool)
        centres = np.empty((*wrapped.shape[:2], 2))
        shares = np.zeros(wrapped.shape[:2])
        for frame in np.ndindex(*wrapped.shape[:2]):
            found[frame] = object_mask(unwrapped[frame])
            if self.finds_mask:
                shares[frame] = smooth_share_left_out(unwrapped[frame], found[frame])
                found[frame] &= usable[frame]
            centres[frame] = centre(found[frame])
        self.found.write(block, found)
        if not self.finds_mask:
            self.mask.write(block, usable)
        return centres, shares
