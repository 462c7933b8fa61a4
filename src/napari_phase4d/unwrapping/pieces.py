"""A line of maps: broken into pieces that each go from thin to thick, and unwrapped outwards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.task import nothing
from napari_phase4d.unwrapping.alone import Mask, Phase, Turns, as_loops_take
from napari_phase4d.unwrapping.filters import quantile_of

__all__ = [
    "Last",
    "Line",
    "Maps",
    "Piece",
    "first_turns",
    "last_known",
    "next_turns",
    "pieces_between",
    "unwrap_line",
    "with_thin_turning_points",
]

Check = Callable[[], None]

#: A map is as thin as the boundary map if its peak phase is at most this many times as large.
AS_THIN = 1.1
#: The sequence must have been thicker in between by at least this share of the boundary's peak.
CLEARLY_THICKER = 0.25


@dataclass(frozen=True)
class Piece:
    """Maps ``first`` to ``stop - 1``, unwrapped outwards from ``start``."""

    first: int
    start: int
    stop: int


def with_thin_turning_points(profile: NDArray[np.float64], starts: Sequence[int]) -> list[int]:
    """Return the starts and those maps where the object has become as thin again.

    Parameters
    ----------
    profile : ndarray of shape (n,)
        Peak phase of each map as a first pass found it; it is more to be trusted than a
        two-dimensional unwrapping, which finds thick maps too thin. NaN where it is not known,
        which says nothing of the object: those beside such a map count as neighbours.
    starts : sequence of int
        Maps that the user knows to be thin.
    """
    found = set(starts)
    thin = max(profile[s] for s in starts)
    known = np.flatnonzero(~np.isnan(profile))
    for place, k in enumerate(known.tolist()):
        nearest = min(starts, key=lambda s: abs(s - k))
        between = profile[min(k, nearest) : max(k, nearest) + 1]
        left = profile[known[place - 1]] if place > 0 else np.inf
        right = profile[known[place + 1]] if place + 1 < len(known) else np.inf
        turns = profile[k] <= min(left, right) and profile[k] < max(left, right)
        was_thicker = np.nanmax(between) > (1 + CLEARLY_THICKER) * max(thin, profile[k])
        if turns and profile[k] <= AS_THIN * thin and was_thicker:
            found.add(k)
    return sorted(found)


def pieces_between(
    starts: Sequence[int], n: int, profile: NDArray[np.float64] | None
) -> list[Piece]:
    """Cut a sequence of n maps between its starts.

    Parameters
    ----------
    starts : sequence of int
        Where pieces start.
    n : int
        Number of maps.
    profile : ndarray or None
        Peak phase of each map, NaN where it is not known: the cut is where it is largest; without
        it, half way.
    """
    ordered = sorted(set(starts))
    cuts = [0]
    for a, b in pairwise(ordered):
        if profile is None:
            cuts.append((a + b) // 2 + 1)
        else:
            known = np.where(np.isnan(profile), -np.inf, profile)
            thickest = np.argmax(known[a + 1 : b + 1])
            cuts.append(a + 1 + int(thickest) if b > a + 1 else b)
    cuts.append(n)
    return [
        Piece(first, s, stop) for s, (first, stop) in zip(ordered, pairwise(cuts), strict=True)
    ]


# ---- a line, piece by piece -----------------------------------------------------------------


class Maps(NamedTuple):
    """Wrapped phase, turns by the initial method, and the object, each of shape (y, x).

    They are held as they are; by so many pixels (y, x) they are to be moved, round the edges of
    the field, for the object to be in place. A map of which no pixel is known, as that of a lost
    frame, is passed over: the next one follows from the last that is known.
    """

    wrapped: Phase
    turns: Turns
    mask: Mask
    shift: Sequence[int] = (0, 0)
    known: bool = True


#: A map, and its turns in the result.
Last = tuple[Maps, Turns]


class Line:
    """Maps to unwrap one after the other, wherever they lie.

    Parameters
    ----------
    n : int
        How many there are.
    read : callable
        Returns what is known of a map by its number.
    room : callable
        Returns where the turns of a map may be put until it is written, shape (y, x).
    write : callable
        ``write(k, map, turns)`` takes a finished map and its turns.
    """

    def __init__(
        self,
        n: int,
        read: Callable[[int], Maps],
        room: Callable[[int], Turns],
        write: Callable[[int, Maps, Turns], None],
    ) -> None:
        self.n = n
        self.read = read
        self.room = room
        self.write = write
        #: Peak phase of every map of the result, NaN where nothing is known of it.
        self.profile = np.zeros(n)


def unwrap_line(
    line: Line, starts: Sequence[int], *, split: bool = True, check: Check = nothing
) -> None:
    """Unwrap a line outwards from its thin maps, and anew where others turn out as thin.

    Parameters
    ----------
    line : Line
        Maps over time or over angle.
    starts : sequence of int
        Numbers of the thin maps.
    split : bool, optional
        Whether a line that gets thick and thin again is broken into monotonic pieces. Default
        True.
    check : callable, optional
        Called before every map; may raise to stop the work.
    """
    again = split and line.n > 2
    pieces = pieces_between(starts, line.n, profile=None)
    follow(pieces, line, check, peaks=again)
    if not again:
        return
    all_starts = with_thin_turning_points(line.profile, starts)
    better = pieces_between(all_starts, line.n, line.profile)
    if better != pieces:
        follow(better, line, check, peaks=False)


def follow(pieces: Sequence[Piece], line: Line, check: Check, *, peaks: bool) -> None:
    """Unwrap each piece from its start outwards (steps 1 to 4)."""
    for piece in pieces:
        maps = line.read(piece.start)
        first = first_turns(maps)
        if peaks:
            line.profile[piece.start] = peak_of(maps, first)
        line.write(piece.start, maps, first)
        for way in (
            range(piece.start + 1, piece.stop),
            range(piece.start - 1, piece.first - 1, -1),
        ):
            last = maps, first
            for k in way:
                check()
                now, found = line.read(k), line.room(k)
                peak = next_turns(last, now, found, peak=peaks)
                if peaks:
                    line.profile[k] = peak
                line.write(k, now, found)
                last = last_known(last, (now, found))


def first_turns(maps: Maps) -> Turns:
    """Return the turns of a thin map, which are those of the initial method."""
    return np.where(maps.mask, maps.turns, np.int16(0))


def last_known(last: Last, now: Last) -> Last:
    """Return what the map after some map follows from: that map, if anything is known of it."""
    return now if now[0].known or not last[0].known else last


def peak_of(maps: Maps, turns: Turns) -> float:
    """Return the peak phase of a map in radians, NaN if nothing is known of it."""
    if not maps.known:
        return np.nan
    found: float = peak_phase(as_loops_take(maps.wrapped), turns, as_loops_take(maps.mask))
    return found


def next_turns(last: Last, now: Maps, out: Turns, *, peak: bool = False) -> float:
    """Write the turns of the next map (steps 2 to 4).

    Parameters
    ----------
    last : (Maps, ndarray)
        The map before, and its turns in the result; its phase is 0 outside the mask.
    now : Maps
        The next map.
    out : ndarray of int
        Where its turns go.
    peak : bool, optional
        Whether its peak phase is asked for.

    Returns
    -------
    float
        Its peak phase in radians, see `peak_phase`; 0 if nobody asked, NaN if it is not known.
    """
    before, turns = last
    if not (before.known and now.known):  # nothing to follow from, or nothing to find
        out[...] = first_turns(now)
        return peak_of(now, out) if peak else 0.0
    height, width = out.shape
    found: float = next_turns_from(
        as_loops_take(before.wrapped),
        as_loops_take(before.mask),
        as_loops_take(turns),
        as_loops_take(now.wrapped),
        as_loops_take(now.mask),
        as_loops_take(now.turns),
        (now.shift[0] - before.shift[0]) % height,
        (now.shift[1] - before.shift[1]) % width,
        peak,
        out,
    )
    return found


@compiled
def peak_phase(wrapped: Phase, turns: Turns, mask: Mask) -> float:
    """Return the peak phase (99th percentile inside the mask) of one map, in radians; or 0."""
    turn = np.float32(2 * np.pi)
    inside, count = np.empty(wrapped.size, np.float32), 0
    for y in range(len(wrapped)):
        for x in range(wrapped.shape[1]):
            inside[count] = np.float32(turns[y, x]) * turn + wrapped[y, x]
            count += mask[y, x]
    return float(quantile_of(inside[:count], 0.99)) if count else 0.0


@compiled
def next_turns_from(
    wrapped_before: Phase,
    mask_before: Mask,
    turns_before: Turns,
    wrapped: Phase,
    mask: Mask,
    turns: Turns,
    down: int,
    right: int,
    peak: bool,
    out: Turns,
) -> float:
    """Do it for arrays, each pixel from the one so far down and right of it in the map before."""
    height, width = out.shape
    split = width - right
    for y in range(height):
        before = (y + down) % height
        phase, inside, whole = wrapped_before[before], mask_before[before], turns_before[before]
        next_in_row(
            phase[right:],
            inside[right:],
            whole[right:],
            wrapped[y],
            mask[y],
            turns[y],
            out[y, :split],
        )
        next_in_row(
            phase,
            inside,
            whole,
            wrapped[y, split:],
            mask[y, split:],
            turns[y, split:],
            out[y, split:],
        )
    return peak_phase(wrapped, out, mask) if peak else 0.0


@compiled
def next_in_row(
    wrapped_before: Phase,
    mask_before: Mask,
    turns_before: Turns,
    wrapped: Phase,
    mask: Mask,
    turns: Turns,
    out: Turns,
) -> None:
    """Do a part of a row; without branches, so that several pixels are done at a time."""
    turn = np.float32(2 * np.pi)
    for x in range(len(out)):
        phase = wrapped_before[x] if mask_before[x] else np.float32(0)
        whole = np.int32(turns_before[x]) if mask_before[x] else np.int32(0)
        whole += np.int32(np.rint((phase - wrapped[x]) / turn))
        whole = max(whole, np.int32(turns[x]))
        out[x] = whole if mask[x] else np.int32(0)
