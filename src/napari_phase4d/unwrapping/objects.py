"""What of a frame is taken for the object: what rises out of its background.

That is step 2 of the paper's algorithms, whose frames are registered by it, and "object only".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, inlined
from napari_phase4d.unwrapping.filters import (
    average,
    correlate_nine,
    extent,
    fill_holes,
    half_gaussian,
    middle_of,
    quantile_of,
    remove_specks,
    widened,
)
from napari_phase4d.unwrapping.frames import (
    BORDER,
    NEAR_LEVEL,
    as_loops_take,
    edge_of,
    median_and_field,
)

__all__ = [
    "left_out_advice",
    "left_out_note",
    "mark_object",
    "object_mask",
    "smooth_share_left_out",
]

TURN = 2 * np.pi

#: A pixel belongs to the object where its phase exceeds this share of the largest ...
SHARE_OF_PEAK = 0.1
#: ... which is taken where all but this share of the frame lies below it ...
PEAK = 0.995
#: ... so many standard deviations of the background, and this, in radians.
DEVIATIONS, LEAST = 4.0, 1e-3
#: Blobs smaller than this share of the frame are noise.
SMALLEST_SHARE = 0.002
#: What lies on more of the border than this is no single object; nothing is then left out.
LARGEST_BORDER_SHARE = 0.5
#: Pixels to widen the mask by, so that the object's rim is inside.
WIDEN = 2
#: What is left out is looked at on every so-manieth row and column.
THIN = 2
#: It is averaged over so many pixels a side, and its likeness to that over so many.
SOFT, AROUND = 3, 5
#: Phase is not flat so many radians from the level of what is left out. Whole turns do not count:
#: noise lifts patches of an empty field by them.
NOT_FLAT_RAD = 1.0
#: It is smooth where the mean cosine of its difference from its surroundings is larger. Noise of
#: 0.7 rad leaves 0.8 of it, noise of a whole turn next to nothing, and a slope does not count.
SMOOTH_COSINE = 0.7
#: From so many percent of the field of any frame on it is worth a warning.
MUCH_LEFT_OUT_PERCENT = 10.0


def object_mask(unwrapped: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the mask of what rises out of the background of one frame.

    Where no single object can be told from a background, nothing is left out.

    Parameters
    ----------
    unwrapped : ndarray of shape (y, x)
        Unwrapped phase in radians.
    """
    found = np.empty(unwrapped.shape, np.bool_)
    mark_object(as_loops_take(unwrapped, np.float32), half_gaussian(), found)
    return found


@inlined
def mark_object(
    unwrapped: NDArray[np.float32], half: NDArray[np.float64], out: NDArray[np.bool_]
) -> None:
    """Mark what `object_mask` returns.

    All in one piece: between pieces, threads wait for each other.

    Parameters
    ----------
    unwrapped : ndarray of float32, shape (y, x)
        Unwrapped phase in radians.
    half : ndarray of float64, shape (5,)
        What `half_gaussian` returns.
    out : ndarray of bool, same shape
        Where it goes.
    """
    level, noise = level_and_noise(edge_of(unwrapped))
    if np.isnan(level):
        out[:] = True
        return
    height = np.empty(unwrapped.shape, np.float32)
    correlate_nine(unwrapped, level, half, height)
    rows, columns = unwrapped.shape
    for y in range(rows):
        for x in range(columns):
            height[y, x] = abs(height[y, x])
    peak = float(quantile_of(height.reshape(-1), PEAK))
    threshold = np.float32(max(max(SHARE_OF_PEAK * peak, DEVIATIONS * noise), LEAST))
    for y in range(rows):
        for x in range(columns):
            out[y, x] = height[y, x] > threshold
    top, bottom, left, right = extent(out, WIDEN + 1)
    part = out[top:bottom, left:right].copy()
    fill_holes(part)
    remove_specks(part, SMALLEST_SHARE * out.size)
    put(part, out, top, left)
    if not part.any() or share_of_border(out) > LARGEST_BORDER_SHARE:
        out[:] = True
        return
    put(widened(part, WIDEN), out, top, left)


@compiled
def put(part: NDArray[np.bool_], out: NDArray[np.bool_], top: int, left: int) -> None:
    """Put a part of a mask back into it; as a slice it would take seconds to compile."""
    height, width = part.shape
    for y in range(height):
        for x in range(width):
            out[top + y, left + x] = part[y, x]


@inlined
def share_of_border(mask: NDArray[np.bool_]) -> float:
    """Return which share of a frame's border is marked."""
    height, width = mask.shape
    count, marked = 0, 0
    for y in range(height):
        inner = BORDER <= y < height - BORDER
        for x in range(width):
            if inner and BORDER <= x < width - BORDER:
                continue
            count += 1
            marked += mask[y, x]
    return marked / count


@inlined
def level_and_noise(edge: NDArray[np.float32]) -> tuple[np.float32, float]:
    """Return the level of pixels (n,), and their deviation by the median distance from it."""
    for k in range(len(edge)):
        if np.isnan(edge[k]):
            return np.float32(np.nan), np.nan
    median, field = median_and_field(edge)
    level = median if np.isnan(field) else field
    for k in range(len(edge)):
        edge[k] = abs(np.float32(edge[k] - level))
    if level != median:  # the rest of the border is the object's
        edge = edge[edge < NEAR_LEVEL]
    return level, 1.4826 * float(middle_of(edge))


@inlined
def smooth_share_left_out(unwrapped: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """Return the share of a frame that a mask leaves out though its phase is smooth and not flat.

    The phase of an empty field is flat, and that of noise is not smooth; what is neither may well
    be measured.

    Parameters
    ----------
    unwrapped : ndarray of shape (y, x)
        Unwrapped phase in radians.
    mask : ndarray of bool, shape (y, x)
        What is kept.
    """
    phase = unwrapped[::THIN, ::THIN].copy()
    soft, like, uneven = (
        np.empty_like(phase),
        np.empty_like(phase),
        np.empty(phase.shape, np.bool_),
    )
    average(phase, int(SOFT), soft)
    if not mark_uneven(soft, mask, uneven):
        return 0.0
    height, width = phase.shape
    for y in range(height):
        for x in range(width):
            phase[y, x] = np.cos(phase[y, x] - soft[y, x])
    average(phase, int(AROUND), like)
    count = 0
    for y in range(height):
        for x in range(width):
            count += uneven[y, x] & (like[y, x] > SMOOTH_COSINE)
    return count / phase.size


@inlined
def mark_uneven(
    soft: NDArray[np.float32], mask: NDArray[np.bool_], uneven: NDArray[np.bool_]
) -> bool:
    """Mark what a mask leaves out that is not flat; return whether anything is."""
    height, width = soft.shape
    left, count = np.empty(soft.size, np.float32), 0
    for y in range(height):
        for x in range(width):
            uneven[y, x] = not mask[THIN * y, THIN * x]
            left[count] = soft[y, x]
            count += uneven[y, x]
    if not count:
        return False
    level, some = middle_of(left[:count]), False
    for y in range(height):
        for x in range(width):
            above = (soft[y, x] - level) / TURN
            uneven[y, x] &= abs(above - np.rint(above)) * TURN > NOT_FLAT_RAD
            some |= uneven[y, x]
    return some


def left_out_note(shares: NDArray[np.float64]) -> dict[str, Any]:
    """Return what a result notes of the shares left out; nothing if there are none.

    Parameters
    ----------
    shares : ndarray of shape (time, angle)
        Of each frame, see `smooth_share_left_out`; may be empty.
    """
    if not shares.size:
        return {}
    percents = np.round(100 * shares, 1)
    mean, much = round(100 * float(shares.mean()), 1), percents > MUCH_LEFT_OUT_PERCENT
    note: dict[str, Any] = {"smooth_left_out_percent": mean} if mean or much.any() else {}
    if much.any():  # a mean over many frames hides the few in which all is lost
        note["smooth_left_out_most_percent"] = float(percents.max())
        note["smooth_left_out_frames"] = np.argwhere(much).tolist()
    return note


def left_out_advice(attrs: Mapping[str, Any]) -> str:
    """Say that a mask found by itself leaves out much that may be measured; "" if it does not.

    It is said if it does so in any frame.

    Parameters
    ----------
    attrs : mapping
        The notes of a result.

    Examples
    --------
    >>> notes = {"smooth_left_out_most_percent": 66.2, "smooth_left_out_frames": [[3, 0]]}
    >>> left_out_advice(notes)[:57]
    '"object only" leaves out 66 % of the field at time 3 thou'
    """
    frames = attrs.get("smooth_left_out_frames", [])
    if not len(frames):
        return ""
    time, view = frames[0]
    first = f"time {time}, view {view + 1}" if view else f"time {time}"
    percent = f"{attrs['smooth_left_out_most_percent']:.0f} % of the field"
    if len(frames) == 1:
        where = f"{percent} at {first}"
    else:
        where = f"up to {percent} in {len(frames)} frames, the first at {first},"
    return (
        f'"object only" leaves out {where} though its phase there is smooth and not flat: '
        "try the whole field"
    )
