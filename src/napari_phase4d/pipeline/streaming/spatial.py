"""Each frame by itself: two-dimensional unwrapping, the object, its centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.pipeline.streaming.stored import Stored
from napari_phase4d.stack import Block, FileStack
from napari_phase4d.unwrapping import is_known
from napari_phase4d.unwrapping.growing import CostsOf, Workspace, second_differences
from napari_phase4d.unwrapping.masks import object_mask, smooth_share_left_out
from napari_phase4d.unwrapping.registration import centre
from napari_phase4d.unwrapping.spatial import unwrap_frame

__all__ = [
    "LiftBlock",
    "Mask",
    "Phase",
    "UnwrapBlock",
    "known_phase",
    "turns_of",
    "with_turns",
    "without_lost",
]

TURN = np.float32(2 * np.pi)

Phase = NDArray[np.float32]
Mask = NDArray[np.bool_]


def known_phase(stack: Stored, block: Block, angles: slice = slice(None)) -> tuple[Phase, Mask]:
    """Return the wrapped phase of a block, 0 where it is not known, and where it is known."""
    wrapped = stack.read(block, angles)
    known = is_known(wrapped)
    return (wrapped if known.all() else np.where(known, wrapped, np.float32(0))), known


def without_lost(unwrapped: Phase, known: Mask) -> Phase:
    """Leave frames unknown of which no pixel was known; in place where there are any."""
    lost = ~known.any(axis=(2, 3))
    if lost.any():
        unwrapped[lost] = np.nan
    return unwrapped


def turns_of(unwrapped: Phase, wrapped: Phase) -> NDArray[np.int16]:
    """Return the whole turns that were added to wrapped phase."""
    turns: NDArray[np.int16] = np.rint((unwrapped - wrapped) / TURN).astype(np.int16)
    return turns


def with_turns(wrapped: Phase, turns: NDArray[np.int16], mask: Mask) -> Phase:
    """Return wrapped phase plus whole turns inside the mask, 0 outside."""
    unwrapped: Phase = turns.astype(np.float32)
    unwrapped *= TURN
    unwrapped += wrapped
    unwrapped[~mask] = 0
    return unwrapped


@dataclass(frozen=True)
class UnwrapBlock:
    """Unwraps each frame of a block; whole turns of a frame are left open.

    Parameters
    ----------
    phase : Stored
        Wrapped phase.
    turns : FileStack
        Where the turns go.
    mask : FileStack, optional
        Pixels to unwrap; default: all that are known.
    costs_of : callable, optional
        What is joined first, see `grow_grid`.
    """

    phase: Stored
    turns: FileStack
    mask: FileStack | None = None
    costs_of: CostsOf = second_differences

    def __call__(self, block: Block) -> NDArray[np.float64]:
        """Do a block; return the level of each frame's border, shape (time, angle)."""
        wrapped, mask = known_phase(self.phase, block)
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
    phase : Stored
        Wrapped phase.
    turns, lifted : FileStack
        Turns of each frame by itself, and where the lifted ones go: were it the same place, a
        block that is done twice, because a worker died, would be lifted twice.
    lift : ndarray of int, shape (time, angle)
        Whole turns to add to each frame.
    mask, found : FileStack
        Where the pixels to unwrap go, and the object.
    finds_mask : bool
        Whether the object is what is to be unwrapped, so that both are one.
    """

    phase: Stored
    turns: FileStack
    lifted: FileStack
    lift: NDArray[np.int16]
    mask: FileStack
    found: FileStack
    finds_mask: bool

    def __call__(self, block: Block) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
        """Do a block.

        Returns
        -------
        ndarray of shape (time, angle, 2), ndarray of shape (time, angle), bool
            The object's centre in each frame; the share of the frame that is left out though its
            phase is smooth and not flat, where the object is to be found; whether the phase is
            known everywhere.
        """
        wrapped, known = known_phase(self.phase, block)
        lift = self.lift[block.start : block.stop, :, None, None]
        turns = self.turns.read(block) + lift
        self.lifted.write(block, turns)
        unwrapped = with_turns(wrapped, turns, known)
        found = np.empty(wrapped.shape, dtype=bool)
        centres = np.empty((*wrapped.shape[:2], 2))
        shares = np.zeros(wrapped.shape[:2])
        for frame in np.ndindex(*wrapped.shape[:2]):
            found[frame] = object_mask(unwrapped[frame])
            if self.finds_mask:
                shares[frame] = smooth_share_left_out(unwrapped[frame], found[frame])
        if self.finds_mask:
            found &= known
        for frame in np.ndindex(*wrapped.shape[:2]):
            centres[frame] = centre(found[frame])
        self.found.write(block, found)
        if not self.finds_mask:
            self.mask.write(block, known)
        return centres, shares, bool(known.all())
