"""The phase of a synthetic wavelength, unwrapped where it is smooth and nowhere else.

Where optics blur a sheer wall, the phase in it means nothing, and a way through it may lead
anywhere. So the pixels all of whose steps the wavelengths agree on are unwrapped among themselves;
what is cut off from the field round it has no way at all that could be relied on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.unwrapping.growing import grow_list
from napari_phase4d.unwrapping.light.steps import Steps, wrapped_to_turn
from napari_phase4d.unwrapping.spatial import border_of, unwrap_frame

__all__ = ["unwrapped_where_smooth"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Parts = NDArray[np.int32]

TURN = np.float32(2 * np.pi)
#: A step is smooth if noise alone makes it as rough one time in three hundred, as a logarithm of
#: the odds.
SMOOTH = 4.5
#: A way from part to part goes along a row or a column, over so many pixels at most, and each of
#: its steps is less than this.
FAR, SMALL_STEP = 8, np.float32(np.pi / 2)
#: So many ways must lead from one part to the other, and this share of them agree.
WAYS, AGREE = 3, 0.8


def unwrapped_where_smooth(wrapped: Image, steps: Steps, known: Mask) -> Image:
    """Return phase of a frame, unwrapped inside each smooth part.

    Parts that enough small steps lead to lie where these say. The middle of others is taken to be
    within half a turn of zero.

    Parameters
    ----------
    wrapped : ndarray of shape (y, x)
        Wrapped phase in radians, about 0 in the empty field.
    steps : Steps
        From pixel to pixel.
    known : ndarray of bool, shape (y, x)
        Pixels that count.
    """
    smooth = smooth_pixels(steps, known)
    if not smooth.any():
        return wrapped
    labels, count = ndimage.label(smooth)
    labels = labels.astype(np.int32)
    unwrapped, _ = unwrap_frame(wrapped, smooth)
    every = np.arange(1, count + 1)
    at_border = np.bincount(labels[border_of(labels.shape) & smooth], minlength=count + 1)[1:]
    size = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    ground = int(np.argmax(at_border if at_border.any() else size))
    edge = labels == ground + 1
    edge &= border_of(labels.shape) if at_border.any() else smooth
    level = np.rint(np.median(unwrapped[edge]) / TURN)
    lift = -np.rint(np.asarray(ndimage.median(unwrapped, labels, every)) / TURN)
    joined, turns = joined_parts(wrapped, unwrapped, labels, count)
    led_to = joined == joined[ground]
    lift[led_to] = (turns - turns[ground])[led_to] - level
    whole = np.concatenate([[0.0], lift]).astype(np.float32)[labels]
    found = unwrapped + TURN * whole
    # What is not smooth lies nearest to the smooth pixel next to it.
    rows, columns = ndimage.distance_transform_edt(
        ~smooth, return_distances=False, return_indices=True
    )
    beside = wrapped + TURN * np.rint((found[rows, columns] - wrapped) / TURN)
    result: Image = np.where(smooth, found, beside).astype(np.float32)
    return result


def smooth_pixels(steps: Steps, known: Mask) -> Mask:
    """Mark the pixels all of whose steps are smooth."""
    smooth = known.copy()
    for axis, along in enumerate((steps.down, steps.right)):
        rough = along.off > SMOOTH
        before, after = ([(0, 0), (0, 0)] for _ in range(2))
        before[axis], after[axis] = (1, 0), (0, 1)
        smooth &= ~np.pad(rough, before) & ~np.pad(rough, after)
    return smooth


def joined_parts(
    wrapped: Image, unwrapped: Image, labels: Parts, count: int
) -> tuple[Parts, Parts]:
    """Join parts that small steps lead between; return where each belongs, and its turns.

    Parameters
    ----------
    wrapped, unwrapped : ndarray of shape (y, x)
        Phase in radians; the latter inside the parts.
    labels : ndarray of int, shape (y, x)
        Number of the part that each pixel lies in, from 1.
    count : int
        How many there are.
    """
    along = ways(wrapped, unwrapped, labels)
    across = ways(wrapped.T, unwrapped.T, labels.T)
    every = np.concatenate([along, across], axis=1)
    # The same way, seen from the part of the lower number.
    back = every[0] > every[1]
    every[:, back] = np.stack([every[1], every[0], -every[2]])[:, back]
    votes, number = np.unique(every, axis=1, return_counts=True)
    pairs, place = np.unique(votes[:2], axis=1, return_inverse=True)
    place = place.ravel()
    total = np.bincount(place, number, pairs.shape[1])[place]
    firm = (number >= WAYS) & (number >= AGREE * total)
    first, second, asked = votes[:, firm]
    cost = -number[firm].astype(np.float64)
    parts, turns, _ = grow_list(first, second, asked, cost, count, overwrite=True)
    return parts, turns


def ways(wrapped: Image, unwrapped: Image, labels: Parts) -> Parts:
    """Return the ways from part to part along rows: both parts, from 0, and the turns between."""
    step = wrapped_to_turn(np.diff(wrapped, axis=1))
    gone = np.pad(np.cumsum(step, axis=1, dtype=np.float64), [(0, 0), (1, 0)]).ravel()
    large = np.pad(np.cumsum(np.abs(step) > SMALL_STEP, axis=1), [(0, 0), (1, 0)]).ravel()
    label, phase = labels.ravel(), unwrapped.ravel()
    inside = np.flatnonzero(label)
    a, b = inside[:-1], inside[1:]
    width = wrapped.shape[1]
    leads = (label[a] != label[b]) & (b - a <= FAR) & (a // width == b // width)
    leads &= large[a] == large[b]
    a, b = a[leads], b[leads]
    turns = np.rint((gone[b] - gone[a] - (phase[b] - phase[a])) / TURN)
    return np.stack([label[a] - 1, label[b] - 1, turns]).astype(np.int32)
