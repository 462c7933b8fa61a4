"""Means over a box of three along every axis, and changes along one: the kernels of the steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = ["LEAST_WEIGHT", "box_mean", "change_on_both_sides", "known_mean"]

#: Share of the weight of a box below which a mean counts as nothing.
LEAST_WEIGHT = 1e-3

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
        if axis == values.ndim - 1:
            mean_along(values.reshape(-1, n))
        else:
            lines = (math.prod(values.shape[:axis]), n, math.prod(values.shape[axis + 1 :]))
            mean_across(values.reshape(lines))
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
def mean_along(lines: NDArray[Any]) -> None:
    """Average lines (line, place) over three places, in place."""
    third = np.float32(1 / 3)
    n = lines.shape[1]
    for line in range(len(lines)):
        row = lines[line]
        before, here = row[0], row[0]
        for i in range(n - 1):
            after = row[i + 1]
            row[i] = (before + here + after) * third
            before, here = here, after
        row[n - 1] = (before + here + here) * third


@compiled
def mean_across(lines: NDArray[Any]) -> None:
    """Average lines (outer, place, inner) over three places, in place."""
    third = np.float32(1 / 3)
    outer, n, inner = lines.shape
    before = np.empty(inner, dtype=lines.dtype)
    for o in range(outer):
        for j in range(inner):
            before[j] = lines[o, 0, j]
        for i in range(n):
            row = lines[o, i]
            after = lines[o, min(i + 1, n - 1)]
            for j in range(inner):
                here = row[j]
                row[j] = (before[j] + here + after[j]) * third
                before[j] = here


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
    lines = (math.prod(step.shape[:axis]), n, math.prod(step.shape[axis + 1 :]))
    found = np.empty(lines, dtype=np.float32)
    known = np.ascontiguousarray(valid).reshape(lines)
    change_in_lines(np.ascontiguousarray(step).reshape(lines), known, found)
    return found.reshape(step.shape)


@compiled
def change_in_lines(step: Stack, known: Mask, found: Stack) -> None:
    """Do `change_on_both_sides` for lines (outer, place, inner)."""
    outer, n, inner = step.shape
    for o in range(outer):
        for i in range(n):
            for j in range(inner):
                g = step[o, i, j]
                total, count = np.float32(0), 0
                if not known[o, i, j]:
                    found[o, i, j] = 0
                    continue
                if i > 0 and known[o, i - 1, j]:
                    total += abs(g - step[o, i - 1, j])
                    count += 1
                if i + 1 < n and known[o, i + 1, j]:
                    total += abs(step[o, i + 1, j] - g)
                    count += 1
                if count == 0:
                    total = 2 * abs(g)
                elif count == 1:
                    total *= 2
                found[o, i, j] = total * total
