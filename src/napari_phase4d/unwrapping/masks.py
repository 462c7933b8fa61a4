"""Binary masks of the object (step 2 of the paper's algorithms)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import Watch, in_threads, on_all_cores
from napari_phase4d.unwrapping.spatial import border_of

__all__ = [
    "left_out_advice",
    "left_out_note",
    "mean_share_left_out",
    "object_mask",
    "object_masks",
    "smooth_share_left_out",
]

#: A pixel belongs to the object where its phase exceeds this share of the largest ...
SHARE_OF_PEAK = 0.1
#: ... and so many standard deviations of the background.
DEVIATIONS = 4.0
#: Blobs smaller than this share of the frame are noise.
SMALLEST_SHARE = 0.002
#: What lies on more of the border than this is no single object; nothing is then left out.
LARGEST_BORDER_SHARE = 0.5
#: Pixels to widen the mask by, so that the object's rim is inside.
WIDEN = 2
#: What is left out is looked at on every so-manieth row and column.
THIN = 2
#: Phase is not flat so far from the level of what is left out, and smooth where it lies so near to
#: its surroundings, both in radians ...
NOT_FLAT_RAD, SMOOTH_RAD = 1.0, 0.5
#: ... in so large a share of them.
MOSTLY = 0.8
#: From so many percent of the field on it is worth a warning.
MUCH_LEFT_OUT_PERCENT = 10.0


def object_masks(unwrapped: NDArray[np.float32], watch: Watch) -> NDArray[np.bool_]:
    """Return the object's mask in every frame of a stack (time, angle, y, x)."""
    frames = unwrapped.reshape(-1, *unwrapped.shape[2:])
    masks = np.empty(frames.shape, dtype=bool)
    for mask, found in zip(masks, in_threads(object_mask, frames, watch), strict=True):
        mask[:] = found
    return masks.reshape(unwrapped.shape)


def object_mask(unwrapped: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the mask of what rises out of the background of one frame.

    Where no single object can be told from a background, nothing is left out.

    Parameters
    ----------
    unwrapped : ndarray of shape (y, x)
        Unwrapped phase in radians.
    """
    edge = unwrapped[border_of(unwrapped.shape)]
    level = float(np.median(edge))
    noise = 1.4826 * float(np.median(np.abs(edge - level)))
    height = np.abs(ndimage.gaussian_filter(unwrapped - level, 1.0))
    threshold = max(SHARE_OF_PEAK * float(np.quantile(height, 0.995)), DEVIATIONS * noise, 1e-3)
    above = height > threshold
    part = part_around(above)
    smallest = SMALLEST_SHARE * above.size
    above[part] = without_specks(without_holes(above[part]), smallest)
    if not above.any() or above[border_of(above.shape)].mean() > LARGEST_BORDER_SHARE:
        return np.ones(above.shape, dtype=bool)
    above[part] = widened(above[part])
    found: NDArray[np.bool_] = above
    return found


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
    out = ~mask[::THIN, ::THIN]
    if not out.any():
        return 0.0
    phase = unwrapped[::THIN, ::THIN]
    soft = ndimage.uniform_filter(phase, 3)
    uneven = out & (np.abs(soft - np.median(soft[out])) > NOT_FLAT_RAD)
    if not uneven.any():
        return 0.0
    near = (np.abs(phase - soft) < SMOOTH_RAD).astype(np.float32)
    uneven &= ndimage.uniform_filter(near, 5) > MOSTLY
    return float(uneven.mean())


def mean_share_left_out(unwrapped: NDArray[np.float32], masks: NDArray[np.bool_]) -> float:
    """Return the mean of `smooth_share_left_out` over the frames of (time, angle, y, x)."""
    n_angles = unwrapped.shape[1]
    shares = np.zeros(unwrapped.shape[:2])

    def share(number: int) -> None:
        frame = divmod(number, n_angles)
        shares[frame] = smooth_share_left_out(unwrapped[frame], masks[frame])

    on_all_cores(share, range(shares.size))
    return float(shares.mean())


def left_out_note(share: float) -> dict[str, Any]:
    """Return what a result notes of the share left out; nothing if there is none."""
    percent = round(100 * share, 1)
    return {"smooth_left_out_percent": percent} if percent else {}


def left_out_advice(attrs: Mapping[str, Any]) -> str:
    """Say that a mask found by itself leaves out much that may be measured; "" if it does not.

    Parameters
    ----------
    attrs : mapping
        The notes of a result.

    Examples
    --------
    >>> left_out_advice({"smooth_left_out_percent": 31.2})[:46]
    '"object only" leaves out 31 % of the field tho'
    """
    percent = attrs.get("smooth_left_out_percent", 0.0)
    if percent <= MUCH_LEFT_OUT_PERCENT:
        return ""
    return (
        f'"object only" leaves out {percent:.0f} % of the field though its phase there is smooth '
        "and not flat: try the whole field"
    )


def part_around(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the part of a frame that holds a mask, with room to widen it."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, 1), slice(0, 1)
    room = WIDEN + 1
    return (
        slice(max(rows[0] - room, 0), rows[-1] + room + 1),
        slice(max(columns[0] - room, 0), columns[-1] + room + 1),
    )


def without_holes(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Fill what the border of the frame can't be reached from."""
    outside, count = ndimage.label(~mask)
    hole = np.ones(count + 1, dtype=bool)
    for line in (outside[0], outside[-1], outside[:, 0], outside[:, -1]):
        hole[line] = False
    hole[0] = True  # the mask itself
    filled: NDArray[np.bool_] = hole[outside]
    return filled


def without_specks(mask: NDArray[np.bool_], smallest: float) -> NDArray[np.bool_]:
    """Leave out blobs of fewer pixels, which are too small to be an object."""
    labels, count = ndimage.label(mask)
    if count == 0:
        return mask
    large = np.bincount(labels.ravel()) >= smallest
    large[0] = False
    return mask if large[1:].all() else large[labels]


def widened(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Widen a mask by some pixels up, down and to the sides."""
    for _ in range(WIDEN):
        wider = mask.copy()
        wider[1:] |= mask[:-1]
        wider[:-1] |= mask[1:]
        wider[:, 1:] |= mask[:, :-1]
        wider[:, :-1] |= mask[:, 1:]
        mask = wider
    return mask
