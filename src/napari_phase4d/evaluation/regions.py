"""Regions to measure: masks from labels and from polygons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from skimage.draw import polygon2mask

from napari_phase4d.checks import as_numbers, shown

__all__ = ["Mask", "polygon_mask", "region_masks"]

Mask = NDArray[np.bool_]


def region_masks(labels: ArrayLike) -> dict[str, Mask]:
    """Return a mask of every label.

    Parameters
    ----------
    labels : array_like of int, dims (y, x), (time, y, x) or (time, angle, y, x)
        0 is no region; every other number is one.

    Returns
    -------
    dict
        "label 3" and so on, by rising number, to a mask of the shape of the labels.

    Raises
    ------
    TypeError
        If the labels are no whole numbers.
    ValueError
        If they have other dims, or if all are 0.

    Examples
    --------
    >>> list(region_masks([[0, 2, 2], [0, 0, 7]]))
    ['label 2', 'label 7']
    """
    image: NDArray[Any] = np.asarray(labels)
    if image.dtype.kind not in "iub":
        msg = f"labels must be whole numbers, but are {image.dtype}"
        raise TypeError(msg)
    if image.ndim not in (2, 3, 4):
        msg = (
            f"the labels have {image.ndim} dimensions {image.shape}; they must have two (y, x), "
            "three (time, y, x) or four (time, angle, y, x)"
        )
        raise ValueError(msg)
    # Unlike numpy.unique this does not sort all pixels.
    numbers = sorted(int(n) for n in pd.unique(image.ravel()) if n != 0)
    if not numbers:
        msg = "there are no labels; paint at least one region"
        raise ValueError(msg)
    return {f"label {n}": image == n for n in numbers}


def polygon_mask(vertices_yx: ArrayLike, shape: tuple[int, int]) -> Mask:
    """Return the pixels of a frame whose centre lies in a polygon.

    Parameters
    ----------
    vertices_yx : array_like of shape (n, 2)
        Corners (y, x) in pixels, three or more; the centres of pixels are at whole numbers. What
        lies outside of the frame is cut off.
    shape : tuple of int
        Height and width of the frame in pixels.

    Returns
    -------
    ndarray of bool, shape (y, x)

    Raises
    ------
    ValueError
        If the corners make no polygon, or if it holds no pixel of the frame.

    Examples
    --------
    >>> polygon_mask([(0, 0), (0, 2), (2, 2), (2, 0)], (4, 5)).astype(int)
    array([[1, 1, 1, 0, 0],
           [1, 1, 1, 0, 0],
           [1, 1, 1, 0, 0],
           [0, 0, 0, 0, 0]])
    """
    if np.shape(shape) != (2,) or np.asarray(shape).dtype.kind not in "iu":
        msg = f"shape must be the height and width of a frame, but is {shown(shape)}"
        raise ValueError(msg)
    corners = as_numbers("vertices_yx", vertices_yx).astype(np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        msg = f"a polygon needs three or more corners (y, x), but has shape {corners.shape}"
        raise ValueError(msg)
    if not np.isfinite(corners).all():
        msg = "the corners of the polygon must be finite numbers"
        raise ValueError(msg)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (high < -0.5).any() or (low > np.array(shape) - 0.5).any():
        msg = (
            f"the polygon (y {low[0]:.4g} to {high[0]:.4g}, x {low[1]:.4g} to {high[1]:.4g} "
            f"pixels) lies outside of the frame of {shape[0]} x {shape[1]} pixels"
        )
        raise ValueError(msg)
    mask: Mask = polygon2mask(shape, corners)
    if not mask.any():
        msg = "there is no pixel of the frame in the polygon; draw a larger one"
        raise ValueError(msg)
    return mask
