"""Two-dimensional unwrapping of each frame by itself."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.unwrapping.growing import (
    CostsOf,
    Workspace,
    grow_through_residues,
    second_differences,
    smooth_turns,
)

__all__ = [
    "BORDER",
    "add_turns",
    "border_medians",
    "border_of",
    "border_values",
    "turns_of_frame",
    "unwrap_frame",
]

#: Width of the frame's border that is taken for background, in pixels.
BORDER = 2
TURN = 2 * np.pi
Number = TypeVar("Number", bound=np.generic)


def unwrap_frame(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    costs_of: CostsOf = second_differences,
    work: Workspace | None = None,
    out: NDArray[np.float32] | None = None,
) -> tuple[NDArray[np.float32], float]:
    """Unwrap one frame by reliability sorting, and return it with the level of its border.

    Sorting (Herraez et al. 2002, [14] in the paper) leaves the frame's multiple of 2 pi open. A
    mask may cut the frame into parts that do not touch each other or the border. Their levels
    come from the frame unwrapped whole.
    """
    out = np.empty_like(wrapped) if out is None else out
    turns, level = turns_of_frame(wrapped, mask, costs_of, Workspace() if work is None else work)
    add_turns(wrapped, turns, out)
    if not mask.all():
        out[~mask] = 0
    return out, level


def turns_of_frame(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_], costs_of: CostsOf, work: Workspace
) -> tuple[NDArray[np.int32], float]:
    """Return the turns of one frame, any outside a mask, and the level of its border.

    See `unwrap_frame`; the turns may lie in ``work`` until it is used again.
    """
    if not mask.any():
        return np.zeros(wrapped.shape, dtype=np.int32), 0.0
    smooth = smooth_turns(wrapped, work)
    turns = smooth
    if turns is None:
        turns, _ = grow_through_residues(wrapped, None, costs_of, work)
    level = median_of(border_phase(wrapped, turns))
    if smooth is None and not mask.all():  # where residues are, the mask may lead another way
        whole = turns.copy()
        turns, parts = grow_through_residues(wrapped, mask, costs_of, work)
        if parts is None:
            return whole, level
        # A mask that leaves pixels out leaves several.
        turns = turns + nearest_turns(whole - turns, parts, mask)
    return turns, level


def add_turns(
    wrapped: NDArray[np.float32],
    turns: NDArray[np.int32] | NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Write wrapped phase plus whole turns."""
    out[:] = turns
    out *= np.float32(TURN)
    out += wrapped


def nearest_turns(
    difference: NDArray[np.int32], parts: NDArray[np.int32], mask: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Return for every pixel the median difference in its part; 0 outside the mask."""
    numbers, place = np.unique(parts[mask], return_inverse=True)
    labels = np.zeros(parts.shape, dtype=np.int32)
    labels[mask] = place + 1
    medians = ndimage.median(difference, labels, np.arange(1, len(numbers) + 1))
    return np.append(0, np.round(medians)).astype(np.int32)[labels]


def border_values(frame: NDArray[Number]) -> NDArray[Number]:
    """Return the pixels at the border of a frame."""
    if min(frame.shape) <= 2 * BORDER:
        return frame.ravel()
    rows = frame[BORDER:-BORDER]
    pieces = (frame[:BORDER], frame[-BORDER:], rows[:, :BORDER], rows[:, -BORDER:])
    return np.concatenate([piece.ravel() for piece in pieces])


def border_phase(wrapped: NDArray[np.float32], turns: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the unwrapped phase of the pixels at the border of a frame."""
    phase = border_values(turns).astype(np.float32)
    add_turns(border_values(wrapped), phase, phase)
    return phase


def median_of(values: NDArray[np.float32]) -> float:
    """Return the median of some known numbers, as `numpy.median` does in several times the time."""
    upper = len(values) // 2
    lower = upper if len(values) % 2 else upper - 1
    ordered = np.partition(values, (lower, upper))
    return float((ordered[lower] + ordered[upper]) / np.float32(2))


def border_of(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Mark the border of a frame."""
    edge = np.ones(shape, dtype=bool)
    if min(shape) > 2 * BORDER:
        edge[BORDER:-BORDER, BORDER:-BORDER] = False
    return edge


def border_medians(border: NDArray[np.float64], first: tuple[int, int]) -> NDArray[np.float64]:
    """Unwrap the border levels (time, angle) outwards from the boundary frame."""
    t0, a0 = first
    levels = border - TURN * np.round(border / TURN)
    unwrap_outwards(levels[t0], a0)
    for a in range(levels.shape[1]):
        unwrap_outwards(levels[:, a], t0)
    return levels


def unwrap_outwards(line: NDArray[np.float64], start: int) -> None:
    """Unwrap a line of phases in place, from one of them to both ends."""
    if len(line) < 2:
        return
    line[start:] = np.unwrap(line[start:])
    line[: start + 1] = np.unwrap(line[: start + 1][::-1])[::-1]
