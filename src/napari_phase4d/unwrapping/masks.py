"""Binary masks of the object (step 2 of the paper's algorithms)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import Watch, in_threads
from napari_phase4d.unwrapping.spatial import border_of

__all__ = ["object_mask", "object_masks"]

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
