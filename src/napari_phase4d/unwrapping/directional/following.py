"""Following a moving object by whole pixels: one shift for each time and one for each angle."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.registration import centre

__all__ = ["follow_object", "seams"]

#: A new shift must make neighbours more alike (mean cosine of their difference) by this much ...
ADVANTAGE = 0.02
#: ... and by this much for every pixel that it moves.
COST_OF_A_PIXEL = 0.005

Shifts = NDArray[np.intp]
Mask = NDArray[np.bool_]


def follow_object(wrapped: NDArray[np.float32], objects: Mask) -> Shifts:
    """Return shifts (time, angle, 2) in pixels that keep the object in place.

    They are the sum of one shift for each time and one for each angle. The centre of mass of the
    object proposes; of the shifts round it and the one before, that is taken which makes
    neighbouring frames most alike.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    objects : ndarray of bool, same shape
        Pixels of the object.
    """
    cosine, sine = np.cos(wrapped), np.sin(wrapped)
    n_times, n_angles = wrapped.shape[:2]
    shifts = np.zeros((n_times, n_angles, 2), dtype=np.intp)
    for axis in (0, 1):
        fields = [np.swapaxes(part, 0, axis) for part in (cosine, sine)]
        shifts += chain(fields[0], fields[1], np.swapaxes(objects, 0, axis), axis)
        if axis == 0 and n_angles == 1:
            break
    return shifts


def chain(
    cosine: NDArray[np.float32], sine: NDArray[np.float32], objects: Mask, axis: int
) -> Shifts:
    """Return the shifts along the first axis, the same for all of the second."""
    n = len(cosine)
    centres = [mean_centre(mask) for mask in objects]
    found = np.zeros((n, 2), dtype=np.intp)
    for k in range(1, n):
        before = found[k - 1]
        off = centres[0] - centres[k]
        candidates = [before]
        if np.isfinite(off).all():
            rounded = np.floor(off + 0.5).astype(np.intp)
            candidates += [rounded + np.array(d) for d in product((-1, 0, 1), repeat=2)]
        scores = []
        for i, shift in enumerate(candidates):
            like = likeness(cosine, sine, objects, k, shift - before)
            moved = int(np.abs(shift - before).sum())
            scores.append(like + (ADVANTAGE if i == 0 else -COST_OF_A_PIXEL * moved))
        found[k] = candidates[int(np.argmax(scores))]
    return found[:, None] if axis == 0 else found[None]


def mean_centre(masks: Mask) -> NDArray[np.float64]:
    """Return the mean centre of mass of several masks; NaN if none has one."""
    centres = np.array([centre(mask) for mask in masks])
    known = centres[np.isfinite(centres).all(axis=1)]
    return known.mean(axis=0) if len(known) else np.full(2, np.nan)


def likeness(
    cosine: NDArray[np.float32], sine: NDArray[np.float32], objects: Mask, k: int, step: Shifts
) -> float:
    """Return the mean cosine of the difference between frame k, moved, and the one before."""
    both = (cosine[k], sine[k], objects[k], cosine[k - 1], sine[k - 1], objects[k - 1])
    total, count = product_of_moved(*both, int(step[0]), int(step[1]))
    return total / count if count else 1.0


@compiled
def product_of_moved(
    cosine: NDArray[np.float32],
    sine: NDArray[np.float32],
    mask: Mask,
    cosine_before: NDArray[np.float32],
    sine_before: NDArray[np.float32],
    mask_before: Mask,
    down: int,
    right: int,
) -> tuple[float, int]:
    """Return the sum of the cosines of phase differences, where either mask is, and their number.

    The first field and mask (view, y, x) are moved, round the edges of the field.
    """
    n_views, height, width = mask.shape
    total, count = 0.0, 0
    left = right % width
    for view in range(n_views):
        for y in range(height):
            row = (y - down) % height
            for start, stop, shift in ((left, width, -left), (0, left, width - left)):
                c, s = cosine[view, row], sine[view, row]
                m = mask[view, row]
                for x in range(start, stop):
                    if m[x + shift] or mask_before[view, y, x]:
                        total += c[x + shift] * cosine_before[view, y, x]
                        total += s[x + shift] * sine_before[view, y, x]
                        count += 1
    return total, count


def seams(shifts: Shifts, shape: tuple[int, int]) -> NDArray[np.int8]:
    """Return how often each pixel of moved frames has gone round the field, (time, angle, y, x).

    Neighbours of different numbers are no neighbours in truth.
    """
    height, width = shape
    rows = np.arange(height) - shifts[..., 0, None]
    columns = np.arange(width) - shifts[..., 1, None]
    turns_y = np.floor_divide(rows, height).astype(np.int8)
    turns_x = np.floor_divide(columns, width).astype(np.int8)
    numbers: NDArray[np.int8] = turns_y[..., :, None] * np.int8(8) + turns_x[..., None, :]
    return numbers
