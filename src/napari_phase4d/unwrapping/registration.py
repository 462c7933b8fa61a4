"""Registration by the centre of mass (step 2 of the paper's algorithms), in whole pixels.

Wrapped phase must not be interpolated, so frames are moved by whole pixels, round the edges of
the field, which can be undone exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.task import Watch

__all__ = ["centre", "centre_of_mass_shifts", "likeness", "moved", "next_shift", "rolled"]

Shifts = NDArray[np.intp]
Scalar = TypeVar("Scalar", bound=np.generic)


class Stack(Protocol):
    """Frames (time, angle), in memory or not: an array will do."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of times and of angles, and more."""

    def __getitem__(self, frame: tuple[int, int]) -> NDArray[Any]:
        """Return one frame (y, x)."""


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
            proposed, kept, lambda s: likeness(wrapped, masks, now, s, before, kept)
        )
        watch.step()

    watch.step()  # the boundary frame stays where it is
    for a in (*range(a0 + 1, n_angles), *range(a0 - 1, -1, -1)):
        visit((t0, a), (t0, a - 1 if a > a0 else a + 1))
    for a in range(n_angles):
        for t in (*range(t0 + 1, n_times), *range(t0 - 1, -1, -1)):
            visit((t, a), (t - 1 if t > t0 else t + 1, a))
    return shifts


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
    count, rows, columns = moments(np.require(mask, np.bool_, ["C", "W"]))
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
        np.require(frame, None, ["C", "W"])
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


def rolled(frame: NDArray[Scalar], shift: Shifts) -> NDArray[Scalar]:
    """Return a frame moved by whole pixels, round the edges."""
    return np.roll(frame, (int(shift[0]), int(shift[1])), axis=(0, 1))


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
