"""The paper's building block: unwrapping along one more dimension from a thin frame.

Section 2, steps 1 to 4: the maps are arranged from the optically thin one, which is unwrapped by
the initial method, to the thick ones; each next map is unwrapped pixel by pixel relative to the
one before; the maximum of this and the initial method is taken; the mask is applied.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import nothing
from napari_phase4d.unwrapping.pieces import (
    Piece,
    pieces_between,
    thickness_profile,
    with_thin_turning_points,
)

__all__ = ["unwrap_line"]

TURN = np.float32(2 * np.pi)
Check = Callable[[], None]


def unwrap_line(
    wrapped: NDArray[np.float32],
    initial: NDArray[np.float32],
    mask: NDArray[np.bool_],
    starts: Sequence[int],
    *,
    split: bool = True,
    check: Check = nothing,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Unwrap a sequence of maps outwards from its optically thin ones.

    Parameters
    ----------
    wrapped : ndarray of shape (n, y, x)
        Wrapped phase over time or over angle, radians.
    initial : ndarray, same shape
        The same maps unwrapped by the initial method.
    mask : ndarray of bool, same shape
        Pixels of the object; the result is 0 elsewhere.
    starts : sequence of int
        Indices of the thin maps.
    split : bool, optional
        Whether a sequence that gets thick and thin again is broken into monotonic pieces (last
        paragraph of section 2). Default True.
    check : callable, optional
        Called before every map; may raise to stop the work.
    out : ndarray, same shape, optional
        Where the result goes; may be ``initial`` itself.

    Returns
    -------
    ndarray of shape (n, y, x)
        Unwrapped phase in radians, congruent with ``wrapped`` inside the mask.
    """
    result = np.empty_like(wrapped) if out is None else out
    if np.may_share_memory(result, initial):
        initial = initial.copy()
    pieces = pieces_between(starts, len(wrapped), profile=None)
    follow(pieces, wrapped, initial, mask, result, check)
    if not split or len(wrapped) < 3:
        return result
    profile = thickness_profile(result, mask)
    all_starts = with_thin_turning_points(profile, starts)
    better = pieces_between(all_starts, len(wrapped), profile)
    if better != pieces:
        follow(better, wrapped, initial, mask, result, check)
    return result


def follow(
    pieces: Sequence[Piece],
    wrapped: NDArray[np.float32],
    initial: NDArray[np.float32],
    mask: NDArray[np.bool_],
    result: NDArray[np.float32],
    check: Check,
) -> None:
    """Unwrap each piece from its start outwards (steps 1 to 4), into ``result``."""
    for piece in pieces:
        start = piece.start
        result[start] = np.where(mask[start], initial[start], np.float32(0))
        for k in range(start + 1, piece.stop):
            check()
            next_map(result[k - 1], wrapped[k], initial[k], mask[k], result[k])
        for k in range(start - 1, piece.first - 1, -1):
            check()
            next_map(result[k + 1], wrapped[k], initial[k], mask[k], result[k])


def next_map(
    before: NDArray[np.float32],
    wrapped: NDArray[np.float32],
    initial: NDArray[np.float32],
    mask: NDArray[np.bool_],
    out: NDArray[np.float32],
) -> None:
    """Write the next map of a sequence (steps 2 to 4)."""
    np.subtract(before, wrapped, out=out)
    out /= TURN
    np.round(out, out=out)
    out *= TURN
    out += wrapped
    np.maximum(out, initial, out=out)
    out *= mask
