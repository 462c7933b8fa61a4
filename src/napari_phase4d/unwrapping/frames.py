"""Single frames: two-dimensional unwrapping, and registration by the centre of the object's mask.

These are steps 1 and 2 of the paper's algorithms. Wrapped phase must not be interpolated, so
frames are moved by whole pixels, round the edges of the field, which can be undone exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, inlined
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.filters import middle_of
from napari_phase4d.unwrapping.growing import (
    CostsOf,
    Workspace,
    grow_through_residues,
    integrated,
    second_differences,
)

__all__ = [
    "BORDER",
    "NEAR_LEVEL",
    "as_loops_take",
    "border_medians",
    "border_of",
    "border_values",
    "centre",
    "centre_of_mass_shifts",
    "edge_of",
    "lift_of",
    "likeness",
    "median_and_field",
    "moments",
    "moved",
    "next_shift",
    "says_nothing",
    "smooth_turns_and_levels",
    "turns_of_frame",
    "turns_past_residues",
    "unwrap_frame",
]

#: Width of the frame's border that is taken for background, in pixels.
BORDER = 2
#: The median of a border and, if that shows one, the level of its empty field, else NaN; radians.
BorderLevels = tuple[float, float]
#: A border shows an empty field where half of it lies within so many radians of its median, ...
NEAR_LEVEL = 1.0
#: ... or more than this share of it within as many of another level, ...
FIELD_SHARE = 0.3
#: ... so many times more than near the median, ...
FULLER = 1.5
#: ... than at any third level, as crests and troughs of waves are, and than so many pixels.
CLEARER, LEAST_FIELD = 1.1, 64
TURN = 2 * np.pi
Number = TypeVar("Number", bound=np.generic)


def unwrap_frame(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    costs_of: CostsOf = second_differences,
    work: Workspace | None = None,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Unwrap one frame by reliability sorting.

    Sorting (Herraez et al. 2002, [14] in the paper) leaves the frame's multiple of 2 pi open. A
    mask may cut the frame into parts that do not touch each other or the border. Their levels
    come from the frame unwrapped whole.
    """
    out = np.empty_like(wrapped) if out is None else out
    turns = turns_of_frame(wrapped, mask, costs_of, Workspace() if work is None else work)
    add_turns(wrapped, turns, out)
    if not mask.all():
        out[~mask] = 0
    return out


def turns_of_frame(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_], costs_of: CostsOf, work: Workspace
) -> NDArray[np.int32]:
    """Return the turns of one frame, any outside a mask.

    See `unwrap_frame`; the turns may lie in ``work`` until it is used again.
    """
    turns = work.array("turns", wrapped.shape, np.int32)
    wrapped, mask = as_loops_take(wrapped, np.float32), as_loops_take(mask, np.bool_)
    if not smooth_turns_and_levels(wrapped, mask, turns)[0]:
        turns, _ = turns_past_residues(wrapped, mask, costs_of, work)
    return turns


def turns_past_residues(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_], costs_of: CostsOf, work: Workspace
) -> tuple[NDArray[np.int32], BorderLevels]:
    """Do the same with a frame that is known to have residues; return its border's levels too."""
    turns, _ = grow_through_residues(wrapped, None, costs_of, work)
    levels = border_levels(wrapped, turns)
    if not mask.all():  # where residues are, the mask may lead another way
        whole = turns.copy()
        turns, parts = grow_through_residues(wrapped, mask, costs_of, work)
        if parts is None:
            return whole, levels
        # A mask that leaves pixels out leaves several.
        turns = turns + nearest_turns(whole - turns, parts, mask)
    return turns, levels


def as_loops_take(frame: NDArray[Any], dtype: Any = None) -> NDArray[Any]:
    """Return a frame as loops are compiled for; a copy of what is not in order or read-only."""
    if frame.flags.carray and (dtype is None or frame.dtype == dtype):
        return frame  # `numpy.require` takes ten times as long to find that out
    return np.require(frame, dtype, ["C", "W"])


@inlined
def smooth_turns_and_levels(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_], turns: NDArray[np.int32]
) -> tuple[bool, BorderLevels]:
    """Write the turns of a frame that has no residues.

    All in one piece: between pieces, threads wait for each other.

    Returns
    -------
    bool, tuple of float
        Whether it has none, and the levels of its border. Where nothing is in the mask, all turns
        are 0, and so is the median.
    """
    if not mask.any():
        turns[:] = 0
        return True, (0.0, np.nan)
    height, width = wrapped.shape
    if not integrated(wrapped, (1, 1, height, width), np.pi, turns):
        return False, (0.0, 0.0)
    return True, border_levels(wrapped, turns)


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
    medians = scipy.ndimage.median(difference, labels, np.arange(1, len(numbers) + 1))
    return np.append(0, np.round(medians)).astype(np.int32)[labels]


def border_values(frame: NDArray[Number]) -> NDArray[Number]:
    """Return the pixels at the border of a frame."""
    found: NDArray[Number] = edge_of(as_loops_take(frame))
    return found


@compiled
def edge_of(frame: NDArray[Any]) -> NDArray[Any]:
    """Return what `border_values` does."""
    height, width = frame.shape
    if min(height, width) <= 2 * BORDER:
        return frame.copy().reshape(-1)
    out = np.empty(2 * BORDER * (height + width - 2 * BORDER), frame.dtype)
    list_border(frame, BORDER, out)
    return out


@inlined
def list_border(frame: NDArray[Any], wide: int, out: NDArray[Any]) -> None:
    """Write the border of a frame, so many pixels wide."""
    height, width = frame.shape
    count = 0
    for y in range(height):
        row = frame[y]
        if wide <= y < height - wide:
            for x in range(wide):
                out[count + x] = row[x]
                out[count + wide + x] = row[width - wide + x]
            count += 2 * wide
        else:
            for x in range(width):
                out[count + x] = row[x]
            count += width


@inlined
def border_levels(wrapped: NDArray[np.float32], turns: NDArray[np.int32]) -> BorderLevels:
    """Return `median_and_field` of the unwrapped phase at the border of a frame."""
    phase, own = edge_of(wrapped), edge_of(turns)
    turn = np.float32(TURN)
    for k in range(len(phase)):
        phase[k] = np.float32(own[k]) * turn + phase[k]
        if np.isnan(phase[k]):
            return np.nan, np.nan
    median, field = median_and_field(phase)
    return float(median), float(field)


@compiled
def median_and_field(phase: NDArray[np.float32]) -> tuple[np.float32, np.float32]:
    """Return the median of unwrapped phase at a frame's border, and the level of its empty field.

    Mostly they are the same. Where an object covers about half of the border, though, its median
    lies somewhere on a slope. The field is then what lies close together, if that is much of the
    border, and far more than lies near the median: phase that rises evenly from side to side has
    no such place.

    Parameters
    ----------
    phase : ndarray of float32, shape (n,)
        Unwrapped phase in radians; none of it is NaN.

    Returns
    -------
    float32, float32
        In radians; the second is NaN where the border shows no empty field.
    """
    median, near = middle_of(phase), 0
    for k in range(len(phase)):
        near += abs(phase[k] - median) < NEAR_LEVEL
    if 2 * near >= len(phase):
        return median, median
    ordered = np.sort(phase)
    wide = np.float32(2 * NEAR_LEVEL)
    first, last = fullest(ordered, wide)
    below, above = fullest(ordered[:first], wide), fullest(ordered[last:], wide)
    other = max(below[1] - below[0], above[1] - above[0])
    enough = max(FIELD_SHARE * len(phase), LEAST_FIELD, FULLER * near, CLEARER * other)
    if last - first > enough:
        return median, middle_of(ordered[first:last])
    return median, np.float32(np.nan)


@inlined
def fullest(ordered: NDArray[np.float32], wide: np.float32) -> tuple[int, int]:
    """Return from where to where most numbers lie that differ by no more than this."""
    start, best, end = 0, 0, 0
    for k in range(len(ordered)):
        while ordered[k] - ordered[start] > wide:
            start += 1
        if k + 1 - start > end - best:
            best, end = start, k + 1
    return best, end


def border_of(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Mark the border of a frame."""
    edge = np.ones(shape, dtype=bool)
    if min(shape) > 2 * BORDER:
        edge[BORDER:-BORDER, BORDER:-BORDER] = False
    return edge


def lift_of(levels: NDArray[np.float64], first: tuple[int, int]) -> NDArray[np.int16]:
    """Return the turns that bring the borders of all frames together, shape (time, angle).

    Parameters
    ----------
    levels : ndarray of shape (time, angle, 2)
        The `BorderLevels` of each frame's border.
    first : tuple of int
        The boundary frame; its level comes to lie within half a turn of zero.
    """
    level = field_levels(levels, first[0])
    lift: NDArray[np.int16] = np.round((border_medians(level, first) - level) / TURN)
    return lift.astype(np.int16)


def field_levels(levels: NDArray[np.float64], start: int) -> NDArray[np.float64]:
    """Return the level of each frame's empty field, or what stands for it, shape (time, angle).

    Where a border shows none, its median stays as far above the field as the way of the medians
    from the frame before says, counted from the boundary time outwards. If none is shown there,
    the medians stand for it: they move less than a guess that comes and goes.
    """
    median, field = levels[..., 0], levels[..., 1]
    above = np.where(np.isnan(field[start]), 0.0, median - field)
    for line, way in zip(above.T, median.T.copy(), strict=True):
        unwrap_outwards(way, start)
        for t in (*range(start + 1, len(line)), *range(start - 1, -1, -1)):
            if np.isnan(line[t]):
                before = t - 1 if t > start else t + 1
                line[t] = line[before] + way[t] - way[before]
    return median - above


def border_medians(border: NDArray[np.float64], first: tuple[int, int]) -> NDArray[np.float64]:
    """Unwrap the border levels (time, angle) outwards from the boundary frame.

    Parameters
    ----------
    border : ndarray of float, shape (time, angle)
        Phase at the border of each frame in radians.
    first : tuple of int
        Number (time, angle) of the boundary frame.

    Returns
    -------
    ndarray of float, shape (time, angle)
        Radians, whole turns from ``border``; that of the boundary frame within half a turn of 0.
    """
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


# ---- registration ---------------------------------------------------------------------------


Shifts = NDArray[np.intp]
Scalar = TypeVar("Scalar", bound=np.generic)


class Stack(Protocol):
    """Frames (time, angle), in memory or not: an array will do."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of times and of angles, and more."""

    def __getitem__(self, frame: tuple[int, int]) -> NDArray[Any]:
        """Return one frame (y, x)."""


#: Frames of each view that are followed before it is told how far that is.
FRAMES_AT_A_TIME = 64


def centre_of_mass_shifts(
    wrapped: Stack,
    masks: Stack,
    first: tuple[int, int],
    watch: Watch,
    centres: NDArray[np.float64] | None = None,
) -> Shifts:
    """Return how to move every frame so that the object stays where it is in the boundary frame.

    The masks' centre of mass proposes the shift. It is taken where it makes the frame more like
    its neighbour (mean cosine of the phase difference) than that one's own shift does, so that a
    mask that fails in one frame does not tear that frame away. Frames are visited outwards from
    the boundary frame: along time for each view, after the views of the boundary time.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    masks : ndarray of bool, same shape
        The object.
    first : tuple of int
        Boundary frame (time, angle).
    watch : Watch
        Counts frames.
    centres : ndarray of shape (time, angle, 2), optional
        What `centre` gives for each mask, where it is known.

    Returns
    -------
    ndarray of int, shape (time, angle, 2)
        Shift in y and x, in pixels.
    """
    n_times, n_angles = wrapped.shape[:2]
    shifts = np.zeros((n_times, n_angles, 2), dtype=np.intp)
    if centres is None:
        found = [[centre(masks[t, a]) for a in range(n_angles)] for t in range(n_times)]
        centres = np.array(found)
    t0, a0 = first

    def visit(now: tuple[int, int], before: tuple[int, int]) -> None:
        kept = shifts[before]
        proposed = centres[t0, a0] - centres[now]

        shifts[now] = next_shift(
            proposed,
            kept,
            lambda s: likeness(
                wrapped, masks, now, s, last_known(wrapped, centres, before, t0), kept
            ),
        )

    for a in (*range(a0 + 1, n_angles), *range(a0 - 1, -1, -1)):
        visit((t0, a), (t0, a - 1 if a > a0 else a + 1))
    for _ in range(n_angles):
        watch.step()  # the boundary frame stays where it is
    outwards = [*range(t0 + 1, n_times), *range(t0 - 1, -1, -1)]
    for start in range(0, len(outwards), FRAMES_AT_A_TIME):
        some = outwards[start : start + FRAMES_AT_A_TIME]
        watch.check()

        def follow(a: int, some: list[int] = some) -> None:
            for t in some:
                visit((t, a), (t - 1 if t > t0 else t + 1, a))

        # Each view follows from the boundary time by itself.
        for _ in in_threads(follow, range(n_angles), watch.quiet(n_angles), wait=True):
            for _ in some:
                watch.step()
    return shifts


def last_known(
    wrapped: Stack, centres: NDArray[np.float64], before: tuple[int, int], first: int
) -> tuple[int, int]:
    """Return a frame (time, angle), or that nearer the first time of which something is known."""
    time, angle = before
    while time != first and says_nothing(centres[time, angle], wrapped[time, angle]):
        time += 1 if time < first else -1
    return time, angle


def says_nothing(centre: NDArray[np.float64], wrapped: NDArray[np.float32]) -> bool:
    """Say whether nothing is known of a frame, which holds 0 then: it is like no other."""
    return bool(np.isnan(centre).any()) and not wrapped.any()


def next_shift(
    proposed: NDArray[np.float64], kept: Shifts, likeness_of: Callable[[Shifts], float]
) -> Shifts:
    """Return the shift of a frame that follows another one.

    Parameters
    ----------
    proposed : ndarray of shape (2,)
        From the object's centre to where it is in the boundary frame, in pixels; NaN where there
        is no object.
    kept : ndarray of int, shape (2,)
        Shift of the frame before.
    likeness_of : callable
        Says how like the frame before this one is, if it is shifted so.
    """
    if np.isnan(proposed).any():
        return kept
    candidate: Shifts = np.round(proposed).astype(np.intp)
    if (candidate != kept).any():
        old, new = likeness_of(kept), likeness_of(candidate)
        if new > old:
            return candidate
    return kept


def centre(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the centre of mass of a mask, NaN if it is empty or all of the frame."""
    count, rows, columns = moments(as_loops_take(mask, np.bool_))
    if count in (0, mask.size):
        return (np.nan, np.nan)
    return (rows / count, columns / count)


@compiled
def moments(mask: NDArray[np.bool_]) -> tuple[int, int, int]:
    """Return the number of pixels of a mask, and the sums of their rows and columns."""
    height, width = mask.shape
    in_column = np.zeros(width, np.int64)
    count, rows, columns = 0, 0, 0
    for y in range(height):
        row, own = mask[y], 0
        for x in range(width):
            own += row[x]
        for x in range(width):
            in_column[x] += row[x]
        count += own
        rows += y * own
    for x in range(width):
        columns += x * in_column[x]
    return count, rows, columns


def likeness(
    wrapped: Stack,
    masks: Stack,
    now: tuple[int, int],
    shift: Shifts,
    before: tuple[int, int],
    shift_before: Shifts,
) -> float:
    """Return the mean cosine of the phase difference of two moved frames, on their objects."""
    own, own_mask, other, other_mask = (
        as_loops_take(frame)
        for frame in (wrapped[now], masks[now], wrapped[before], masks[before])
    )
    out = np.empty(own.size, np.float32)
    of_now, of_before = (
        (int(shift[0]), int(shift[1])),
        (int(shift_before[0]), int(shift_before[1])),
    )
    count = list_steps(own, own_mask, other, other_mask, of_now, of_before, out)
    return float(np.cos(out[:count]).mean()) if count else 1.0


@compiled
def list_steps(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    wrapped_before: NDArray[np.float32],
    mask_before: NDArray[np.bool_],
    shift: tuple[int, int],
    shift_before: tuple[int, int],
    out: NDArray[np.float32],
) -> int:
    """List the phase differences of two moved frames on either's object; return how many."""
    height, width = wrapped.shape
    right, right_before = -shift[1] % width, -shift_before[1] % width
    either, other = np.empty(width, np.bool_), np.empty(width, np.bool_)
    step, before = np.empty(width, np.float32), np.empty(width, np.float32)
    count = 0
    for y in range(height):
        now, then = (y - shift[0]) % height, (y - shift_before[0]) % height
        roll_row(mask[now], right, either)
        roll_row(mask_before[then], right_before, other)
        if not add_marks(other, either):
            continue
        roll_row(wrapped[now], right, step)
        roll_row(wrapped_before[then], right_before, before)
        first, last = 0, width - 1
        while not either[first]:
            first += 1
        while not either[last]:
            last -= 1
        for x in range(first, last + 1):
            if either[x]:
                out[count] = step[x] - before[x]
                count += 1
    return count


@compiled
def add_marks(row: NDArray[np.bool_], out: NDArray[np.bool_]) -> bool:
    """Mark what is marked in a row; return whether anything is, in either."""
    some = False
    for x in range(len(row)):
        out[x] |= row[x]
        some |= out[x]
    return some


@compiled
def roll_row(row: NDArray[Any], ahead: int, out: NDArray[Any]) -> None:
    """Write a row that begins so many pixels further, and goes on at its beginning."""
    rest, last = row[ahead:], out[len(row) - ahead :]
    for x in range(len(rest)):
        out[x] = rest[x]
    for x in range(len(last)):
        last[x] = row[x]


def moved(stack: NDArray[Scalar], shifts: Shifts) -> NDArray[Scalar]:
    """Return a stack (time, angle, y, x) with every frame moved; undo with ``-shifts``."""
    if not shifts.any():
        return stack
    result = np.empty_like(stack)
    height, width = stack.shape[2:]
    for index in np.ndindex(*stack.shape[:2]):
        down, right = int(shifts[index][0]) % height, int(shifts[index][1]) % width
        frame, out = stack[index], result[index]
        for rows, of_rows in halves(down, height):
            for columns, of_columns in halves(right, width):
                out[rows, columns] = frame[of_rows, of_columns]
    return result


def halves(by: int, n: int) -> list[tuple[slice, slice]]:
    """Return where the two parts of a line of n pixels that is moved go, and where they lie."""
    parts = [(slice(by, n), slice(0, n - by))]
    return [*parts, (slice(0, by), slice(n - by, n))] if by else parts
