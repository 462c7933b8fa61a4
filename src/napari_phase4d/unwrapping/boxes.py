"""Neighbours along the axes of a stack: ends of steps, means over a box of three, and changes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = [
    "AT_A_TIME",
    "LEAST_WEIGHT",
    "both_ends",
    "box_mean",
    "change_on_both_sides",
    "copy_line",
    "ends_along",
    "known_mean",
]

Part = tuple[slice, ...]


def ends_along(axis: int, ndim: int) -> tuple[Part, Part]:
    """Return the parts of a stack that hold the first and the second ends of all steps.

    Parameters
    ----------
    axis : int
        Along which the steps go.
    ndim : int
        Number of dimensions of the stack.

    Examples
    --------
    >>> stack = np.array([[1, 2, 4], [7, 11, 16]])
    >>> head, tail = ends_along(1, stack.ndim)
    >>> stack[tail] - stack[head]
    array([[1, 2],
           [4, 5]])
    """
    head = tuple(slice(None, -1) if i == axis % ndim else slice(None) for i in range(ndim))
    tail = tuple(slice(1, None) if i == axis % ndim else slice(None) for i in range(ndim))
    return head, tail


def both_ends(mask: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Mark the steps along an axis whose two ends both lie in a mask.

    Examples
    --------
    >>> both_ends(np.array([True, True, False, True]), 0)
    array([ True, False, False])
    """
    head, tail = ends_along(axis, mask.ndim)
    both: NDArray[np.bool_] = mask[head] & mask[tail]
    return both


#: Share of the weight of a box below which a mean counts as nothing.
LEAST_WEIGHT = 1e-3
#: So many numbers of a line are worked on at a time, so that they stay near the core.
AT_A_TIME = 1024

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]
Values = TypeVar("Values", NDArray[np.float32], NDArray[np.complex64])


def box_mean(values: Values, axes: Sequence[int] = (0, 1, 2, 3)) -> Values:
    """Return the mean over a box of three along the axes, those that are at least as long.

    At the ends of an axis the last value counts twice, as for ``mode="reflect"`` of
    `scipy.ndimage.uniform_filter`, which gives the same, three times as slowly.

    Parameters
    ----------
    values : ndarray of float32 or complex64, shape (time, angle, y, x)
        Contiguous; is overwritten and returned.
    axes : sequence of int, optional
        Along which to average; default all.
    """
    for axis in axes:
        n = values.shape[axis]
        if n < 3:
            continue
        # Real and imaginary parts are numbers of their own, which take turns along x.
        parts = 2 if values.dtype == np.complex64 else 1
        if axis == values.ndim - 1:
            mean_along(values.reshape(-1, n).view(np.float32), parts)
        else:
            inner = math.prod(values.shape[axis + 1 :])
            lines = values.reshape(math.prod(values.shape[:axis]), n, inner)
            mean_across(lines.view(np.float32))
    return values


def known_mean(values: Values, known: Mask, axes: Sequence[int] = (0, 1, 2, 3)) -> Values:
    """Return `box_mean` over those values that are known; overwrites the values.

    Parameters
    ----------
    values : ndarray of float32 or complex64, shape (time, angle, y, x)
        0 where they are not known.
    known : ndarray of bool, same shape
        Which are known.
    axes : sequence of int, optional
        See `box_mean`.
    """
    mean = box_mean(values, axes)
    if not known.all():
        mean /= np.maximum(box_mean(known.astype(np.float32), axes), np.float32(LEAST_WEIGHT))
    return mean


@compiled
def mean_along(lines: Stack, parts: int) -> None:
    """Average lines (line, place) over three places, in place; each has so many parts."""
    n = lines.shape[1]
    padded = np.empty(n + 2 * parts, dtype=np.float32)
    for line in range(len(lines)):
        row = lines[line]
        copy_line(row, padded[parts : parts + n])
        for i in range(parts):
            padded[i], padded[parts + n + i] = row[i], row[n - parts + i]
        mean_of_three(padded[:n], padded[parts : parts + n], padded[2 * parts :], row)


@compiled
def mean_of_three(before: Stack, here: Stack, after: Stack, out: Stack) -> None:
    """Write the means of three lines."""
    third = np.float32(1 / 3)
    for j in range(len(out)):
        out[j] = (before[j] + here[j] + after[j]) * third


@compiled
def mean_across(lines: Stack) -> None:
    """Average lines (outer, place, inner) over three places, in place, some inner at a time."""
    outer, n, inner = lines.shape
    before, here = np.empty(AT_A_TIME, np.float32), np.empty(AT_A_TIME, np.float32)
    for o in range(outer):
        for start in range(0, inner, AT_A_TIME):
            stop = min(start + AT_A_TIME, inner)
            size = stop - start
            copy_line(lines[o, 0, start:stop], before[:size])
            for i in range(n):
                row = lines[o, i, start:stop]
                copy_line(row, here[:size])
                if i + 1 < n:
                    after = lines[o, i + 1, start:stop]
                    mean_of_three(before[:size], here[:size], after, row)
                else:
                    mean_of_three(before[:size], here[:size], here[:size], row)
                before, here = here, before


@compiled
def copy_line(line: Stack, out: Stack) -> None:
    """Write a line."""
    for j in range(len(out)):
        out[j] = line[j]


def change_on_both_sides(step: Stack, axis: int, valid: Mask) -> Stack:
    """Return (|g(j+1) - g(j)| + |g(j) - g(j-1)|)^2, a missing change replaced by the other.

    (2 |g|)^2 where both are missing; 0 for steps that are not valid.

    Parameters
    ----------
    step : ndarray of float32, shape (time, angle, y, x)
        Steps g along the axis, radians.
    axis : int
        Which axis.
    valid : ndarray of bool, same shape
        Steps that count.
    """
    n = step.shape[axis]
    outer, inner = math.prod(step.shape[:axis]), math.prod(step.shape[axis + 1 :])
    given = np.require(step, np.float32, ["C", "W"])
    known = np.require(valid, np.bool_, ["C", "W"])
    found = np.empty(step.shape, dtype=np.float32)
    if inner == 1:
        lines = (outer, n)
        change_along(given.reshape(lines), known.reshape(lines), found.reshape(lines))
    else:
        of = (outer, n, inner)
        change_across(given.reshape(of), known.reshape(of), found.reshape(of))
    return found


@compiled
def change_along(step: Stack, known: Mask, found: Stack) -> None:
    """Do `change_on_both_sides` for lines (line, place)."""
    n = step.shape[1]
    padded, there = np.zeros(n + 2, np.float32), np.zeros(n + 2, np.bool_)
    for line in range(len(step)):
        copy_line(step[line], padded[1 : n + 1])
        mark_line(known[line], there[1 : n + 1])
        before, here, after = padded[:n], padded[1 : n + 1], padded[2:]
        there_before, there_here, there_after = there[:n], there[1 : n + 1], there[2:]
        square_changes(before, here, after, there_before, there_here, there_after, found[line])


@compiled
def change_across(step: Stack, known: Mask, found: Stack) -> None:
    """Do it for lines (outer, place, inner)."""
    outer, n, inner = step.shape
    none, nowhere = np.zeros(inner, np.float32), np.zeros(inner, np.bool_)
    for o in range(outer):
        for i in range(n):
            before, after = none, none
            known_before, known_after = nowhere, nowhere
            if i > 0:
                before, known_before = step[o, i - 1], known[o, i - 1]
            if i + 1 < n:
                after, known_after = step[o, i + 1], known[o, i + 1]
            square_changes(
                before, step[o, i], after, known_before, known[o, i], known_after, found[o, i]
            )


@compiled
def square_changes(
    before: Stack,
    here: Stack,
    after: Stack,
    known_before: Mask,
    known: Mask,
    known_after: Mask,
    found: Stack,
) -> None:
    """Do it for steps and those before and behind each; without branches, some at a time."""
    total, count = np.empty(AT_A_TIME, np.float32), np.empty(AT_A_TIME, np.int8)
    for start in range(0, len(found), AT_A_TIME):
        stop = min(start + AT_A_TIME, len(found))
        size = stop - start
        total[:size] = 0
        count[:size] = 0
        add_change(here[start:stop], before[start:stop], known_before[start:stop], total, count)
        add_change(here[start:stop], after[start:stop], known_after[start:stop], total, count)
        square_total(here[start:stop], known[start:stop], total, count, found[start:stop])


@compiled
def add_change(
    here: Stack, other: Stack, known: Mask, total: Stack, count: NDArray[np.int8]
) -> None:
    """Add the changes to other steps, where these are known."""
    for j in range(len(here)):
        change = abs(here[j] - other[j])
        total[j] += change if known[j] else np.float32(0)
        count[j] += known[j]


@compiled
def square_total(
    here: Stack, known: Mask, total: Stack, count: NDArray[np.int8], found: Stack
) -> None:
    """Write the squares of changes, a missing one replaced by the other."""
    two = np.float32(2)
    for j in range(len(here)):
        both = total[j] if count[j] == 2 else two * total[j]
        both = both if count[j] > 0 else two * abs(here[j])
        found[j] = both * both if known[j] else np.float32(0)


@compiled
def mark_line(line: Mask, out: Mask) -> None:
    """Write a line of marks."""
    for j in range(len(out)):
        out[j] = line[j]
