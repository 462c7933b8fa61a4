"""Two-dimensional unwrapping of each frame by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import Watch, in_threads
from napari_phase4d.unwrapping.growing import (
    CostsOf,
    PerThread,
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
    "unwrap_frame",
    "unwrap_frames",
]

#: Width of the frame's border that is taken for background, in pixels.
BORDER = 2
TURN = 2 * np.pi


def unwrap_frames(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    first: tuple[int, int],
    watch: Watch,
    costs_of: CostsOf = second_differences,
) -> NDArray[np.float32]:
    """Unwrap every frame by reliability sorting (Herraez et al. 2002, [14] in the paper).

    Reliability sorting leaves each frame's multiple of 2 pi open. It is chosen such that the
    border of the boundary frame lies within half a turn of zero, and that the border moves by
    less than half a turn from frame to frame and from view to view.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    mask : ndarray of bool, same shape
        Pixels to unwrap; 0 elsewhere in the result.
    first : tuple of int
        The boundary frame (time, angle).
    watch : Watch
        Counts frames.
    costs_of : callable, optional
        What the steps of a frame cost, see `grow_grid`; default the published reliability.
    """
    n_times, n_angles = wrapped.shape[:2]
    indices = [(t, a) for t in range(n_times) for a in range(n_angles)]
    unwrapped = np.empty_like(wrapped)
    border = np.empty((n_times, n_angles))
    own = PerThread()

    def work(index: tuple[int, int]) -> None:
        _, border[index] = unwrap_frame(
            wrapped[index], mask[index], costs_of, own.workspace, unwrapped[index]
        )

    for _ in in_threads(work, indices, watch):
        pass
    turns = np.round((border_medians(border, first) - border) / TURN).astype(np.int32)
    for index in np.argwhere(turns):
        frame = unwrapped[tuple(index)]
        lift(frame, wrapped[tuple(index)], turns[tuple(index)])
        frame[~mask[tuple(index)]] = 0
    return unwrapped


def unwrap_frame(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    costs_of: CostsOf = second_differences,
    work: Workspace | None = None,
    out: NDArray[np.float32] | None = None,
) -> tuple[NDArray[np.float32], float]:
    """Unwrap one frame, into ``out`` if given, and return it with the level of its border.

    A mask may cut the frame into parts that do not touch each other or the border. Their levels
    come from the frame unwrapped whole.
    """
    out = np.empty_like(wrapped) if out is None else out
    if not mask.any():
        out[:] = 0
        return out, 0.0
    work = Workspace() if work is None else work
    smooth = smooth_turns(wrapped, work)
    turns = smooth
    if turns is None:
        turns, _ = grow_through_residues(wrapped, None, costs_of, work)
    add_turns(wrapped, turns, out)
    level = float(np.median(border_values(out)))
    if mask.all():
        return out, level
    if smooth is None:  # where residues are, the mask may lead another way
        whole = turns.copy()
        turns, parts = grow_through_residues(wrapped, mask, costs_of, work)
        if parts is not None:  # a mask that leaves pixels out leaves several
            add_turns(wrapped, turns + nearest_turns(whole - turns, parts, mask), out)
    out[~mask] = 0
    return out, level


def add_turns(
    wrapped: NDArray[np.float32], turns: NDArray[np.int32], out: NDArray[np.float32]
) -> None:
    """Write wrapped phase plus whole turns."""
    out[:] = turns
    out *= np.float32(TURN)
    out += wrapped


def lift(unwrapped: NDArray[np.float32], wrapped: NDArray[np.float32], turns: np.integer) -> None:
    """Add whole turns to an unwrapped frame, free of rounding on the way."""
    present = np.round((unwrapped - wrapped) / np.float32(TURN)).astype(np.int32)
    add_turns(wrapped, present + np.int32(turns), unwrapped)


def nearest_turns(
    difference: NDArray[np.int32], parts: NDArray[np.int32], mask: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Return for every pixel the median difference in its part; 0 outside the mask."""
    numbers, place = np.unique(parts[mask], return_inverse=True)
    labels = np.zeros(parts.shape, dtype=np.int32)
    labels[mask] = place + 1
    medians = ndimage.median(difference, labels, np.arange(1, len(numbers) + 1))
    return np.append(0, np.round(medians)).astype(np.int32)[labels]


def border_values(frame: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the pixels at the border of a frame."""
    if min(frame.shape) <= 2 * BORDER:
        return frame.ravel()
    rows = frame[BORDER:-BORDER]
    pieces = (frame[:BORDER], frame[-BORDER:], rows[:, :BORDER], rows[:, -BORDER:])
    return np.concatenate([piece.ravel() for piece in pieces])


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
    line[start:] = np.unwrap(line[start:])
    line[: start + 1] = np.unwrap(line[: start + 1][::-1])[::-1]
