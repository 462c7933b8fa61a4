"""The paper's building block on stacks that lie on disk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.pipeline.streaming.spatial import (
    Mask,
    Phase,
    known_phase,
    turns_of,
    with_turns,
    without_lost,
)
from napari_phase4d.pipeline.streaming.stored import Limits, Stored, limits_of
from napari_phase4d.stack import Block, FileStack, block_at
from napari_phase4d.unwrapping.combined import follow_line, unwrap_line
from napari_phase4d.unwrapping.four_d import starts_on
from napari_phase4d.unwrapping.pieces import thickness
from napari_phase4d.unwrapping.problem import Boundary
from napari_phase4d.unwrapping.registration import moved, rolled

ALL = slice(None)

__all__ = ["AlongAngle", "AlongTime", "Chain", "FinishBlock"]


@dataclass(frozen=True)
class Chain:
    """What all passes of a method need.

    Parameters
    ----------
    phase : Stored
        Wrapped phase.
    mask : FileStack
        Pixels to unwrap.
    shifts : ndarray of int, shape (time, angle, 2)
        How frames are moved, so that the object stays in place.
    boundaries : list of (int, int)
        Thin frames (time, angle).
    split : bool
        See `unwrap_line`.
    """

    phase: Stored
    mask: FileStack
    shifts: NDArray[np.intp]
    boundaries: list[Boundary]
    split: bool

    def read(
        self, block: Block, turns: FileStack, angles: slice = ALL
    ) -> tuple[Phase, Phase, Mask]:
        """Return a block of wrapped and initial phase and mask, moved into place."""
        wrapped, _ = known_phase(self.phase, block, angles)
        mask = self.mask.read(block, angles)
        initial = with_turns(wrapped, turns.read(block, angles), mask)
        shifts = self.shifts[block.start : block.stop, angles]
        return moved(wrapped, shifts), moved(initial, shifts), moved(mask, shifts)

    def turns(self, result: Phase, wrapped: Phase, mask: Mask) -> NDArray[np.int16]:
        """Return the turns of a result, none outside the mask."""
        return np.where(mask, turns_of(result, wrapped), np.int16(0))


@dataclass(frozen=True)
class AlongAngle:
    """One pass along the angle at each time of a block.

    Parameters
    ----------
    chain : Chain
        What all passes need.
    initial : FileStack
        Turns of the initial method.
    result : FileStack or Stored
        Where the turns of the result go; or, of the last pass, unwrapped phase itself.
    """

    chain: Chain
    initial: FileStack
    result: FileStack | Stored

    def __call__(self, block: Block) -> Limits:
        """Do a block; return its smallest and largest phase."""
        chain = self.chain
        wrapped, initial, mask = chain.read(block, self.initial)
        found = np.empty_like(wrapped)
        for i, time in enumerate(block.times):
            starts = starts_on("angle", time, chain.boundaries)
            unwrap_line(wrapped[i], initial[i], mask[i], starts, split=chain.split, out=found[i])
        back = -chain.shifts[block.start : block.stop]
        if not isinstance(self.result, Stored):
            self.result.write(block, moved(chain.turns(found, wrapped, mask), back))
            return limits_of(found)
        _, known = known_phase(chain.phase, block)
        unwrapped = without_lost(moved(found, back), known)
        self.result.write(block, unwrapped)
        return limits_of(unwrapped)


@dataclass(frozen=True)
class AlongTime:
    """One pass along time, for one angle.

    Parameters
    ----------
    chain : Chain
        What all passes need.
    initial, result : FileStack
        Turns of the initial method, and where those of the result go.
    check : callable
        Called before every map; may raise to stop the work.
    """

    chain: Chain
    initial: FileStack
    result: FileStack
    check: Callable[[], None]

    def __call__(self, angle: int) -> None:
        """Do one angle."""
        starts = starts_on("time", angle, self.chain.boundaries)
        follow_line(LineOnDisk(self, angle), starts, split=self.chain.split, check=self.check)


class LineOnDisk:
    """The maps of one angle over time; a block of them is in memory.

    Parameters
    ----------
    along : AlongTime
        The pass.
    angle : int
        Number of the angle.
    """

    def __init__(self, along: AlongTime, angle: int) -> None:
        self._chain = along.chain
        self._initial, self._result = along.initial, along.result
        self._angle = angle
        self._block: Block | None = None
        self._maps: tuple[Phase, Phase, Mask]
        self._peaks = np.zeros(len(self))

    def __len__(self) -> int:
        """Return the number of maps."""
        return int(self._chain.phase.shape[0])

    def given(self, k: int) -> tuple[Phase, Phase, Mask]:
        """Return what is known of map k, moved into place."""
        if self._block is None or k not in self._block.times:
            self._block = block_at(self._chain.phase.shape, k)
            self._maps = self._read(self._block)
        i = k - self._block.start
        wrapped, initial, mask = self._maps
        return wrapped[i], initial[i], mask[i]

    def room(self, k: int) -> Phase:
        """Return one of two maps by turns: the one before stays as it is."""
        room: Phase = self._rooms[k % 2]
        return room

    def done(self, k: int, result: Phase) -> None:
        """Write the turns of the finished map k, and note its peak."""
        wrapped, _, mask = self.given(k)
        self._peaks[k] = thickness(result, mask)
        turns = self._chain.turns(result, wrapped, mask)
        back = rolled(turns, -self._chain.shifts[k, self._angle])
        self._result.write_frame(k, self._angle, back)

    def profile(self) -> NDArray[np.float64]:
        """Return the peak phase of every map of the result."""
        return self._peaks

    @cached_property
    def _rooms(self) -> Phase:
        return np.empty((2, *self._chain.phase.shape[2:]), dtype=np.float32)

    def _read(self, block: Block) -> tuple[Phase, Phase, Mask]:
        """Return one view's maps of a block, moved into place."""
        angle = slice(self._angle, self._angle + 1)
        wrapped, initial, mask = self._chain.read(block, self._initial, angle)
        return wrapped[:, 0], initial[:, 0], mask[:, 0]


@dataclass(frozen=True)
class FinishBlock:
    """Writes unwrapped phase from the turns that a method found.

    Parameters
    ----------
    phase : Stored
        Wrapped phase.
    turns, mask : FileStack
        What was found, and where.
    result : Stored
        Where unwrapped phase goes.
    """

    phase: Stored
    turns: FileStack
    mask: FileStack
    result: Stored

    def __call__(self, block: Block) -> Limits:
        """Do a block; return its smallest and largest phase."""
        wrapped, known = known_phase(self.phase, block)
        unwrapped = with_turns(wrapped, self.turns.read(block), self.mask.read(block))
        unwrapped = without_lost(unwrapped, known)
        self.result.write(block, unwrapped)
        return limits_of(unwrapped)
