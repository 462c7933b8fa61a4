"""The paper's building block: unwrapping along one more dimension from a thin frame.

Section 2, steps 1 to 4: the maps are arranged from the optically thin one, which is unwrapped by
the initial method, to the thick ones; each next map is unwrapped pixel by pixel relative to the
one before; the maximum of this and the initial method is taken; the mask is applied.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import nothing
from napari_phase4d.unwrapping.pieces import (
    Piece,
    pieces_between,
    thickness_profile,
    with_thin_turning_points,
)

__all__ = ["Line", "follow_line", "unwrap_line"]

TURN = np.float32(2 * np.pi)
Check = Callable[[], None]
Map = NDArray[np.float32]
Inside = NDArray[np.bool_]


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
    follow_line(LineInMemory(wrapped, initial, mask, result), starts, split=split, check=check)
    return result


class Line(Protocol):
    """A sequence of maps to unwrap one after the other, wherever they lie."""

    def __len__(self) -> int:
        """Return the number of maps."""

    def given(self, k: int) -> tuple[Map, Map, Inside]:
        """Return what is known of map k: wrapped, by the initial method, and the mask."""

    def room(self, k: int) -> Map:
        """Return where the result of map k is to be written; the last one stays as it is."""

    def done(self, k: int, result: Map) -> None:
        """Take the finished map k."""

    def profile(self) -> NDArray[np.float64]:
        """Return the peak phase of every map of the result, see `thickness_profile`."""


class LineInMemory:
    """Maps that are all in memory.

    Parameters
    ----------
    wrapped, initial : ndarray of shape (n, y, x)
        Phase as it is wrapped, and by the initial method, radians.
    mask : ndarray of bool, same shape
        Pixels of the object.
    result : ndarray, same shape
        Where the result goes.
    """

    def __init__(self, wrapped: Map, initial: Map, mask: Inside, result: Map) -> None:
        self._given = wrapped, initial, mask
        self._result = result

    def __len__(self) -> int:
        """Return the number of maps."""
        return len(self._result)

    def given(self, k: int) -> tuple[Map, Map, Inside]:
        """Return what is known of map k."""
        wrapped, initial, mask = self._given
        return wrapped[k], initial[k], mask[k]

    def room(self, k: int) -> Map:
        """Return the place of map k in the result."""
        place: Map = self._result[k]
        return place

    def done(self, k: int, result: Map) -> None:
        """Do nothing: the result is where it belongs."""

    def profile(self) -> NDArray[np.float64]:
        """Return the peak phase of every map of the result."""
        return thickness_profile(self._result, self._given[2])


def follow_line(line: Line, starts: Sequence[int], *, split: bool, check: Check = nothing) -> None:
    """Unwrap a line outwards from its thin maps, and anew where others turn out as thin."""
    pieces = pieces_between(starts, len(line), profile=None)
    follow(pieces, line, check)
    if not split or len(line) < 3:
        return
    profile = line.profile()
    all_starts = with_thin_turning_points(profile, starts)
    better = pieces_between(all_starts, len(line), profile)
    if better != pieces:
        follow(better, line, check)


def follow(pieces: Sequence[Piece], line: Line, check: Check) -> None:
    """Unwrap each piece from its start outwards (steps 1 to 4)."""
    for piece in pieces:
        _, initial, mask = line.given(piece.start)
        first = line.room(piece.start)
        first[:] = np.where(mask, initial, np.float32(0))
        line.done(piece.start, first)
        # What follows may need the room of the first map, where the maps are not in memory.
        kept = first.copy()
        for way in (
            range(piece.start + 1, piece.stop),
            range(piece.start - 1, piece.first - 1, -1),
        ):
            before = kept
            for k in way:
                check()
                now = line.room(k)
                next_map(before, *line.given(k), now)
                line.done(k, now)
                before = now


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
