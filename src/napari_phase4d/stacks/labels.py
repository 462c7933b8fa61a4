"""Labels of cells or regions, where they come in."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.axes import PLAIN_AXES
from napari_phase4d.words import warn

__all__ = ["checked_labels"]

#: Larger numbers, or more of them in a frame, are no labels of cells.
HIGHEST, MOST = 2**20, 4000
#: Frames that are looked at, and pixels of a piece that counts as one.
FRAMES, LEAST_PIXELS = 6, 30


def checked_labels(given: Any, name: str = "the labels") -> xr.DataArray:
    """Return labels with names of their axes; what is masked is 0. Lazy ones stay so.

    Parameters
    ----------
    given : DataArray or array_like
        Whole numbers, 0 where there is nothing.
    name : str, optional
        What they are called in sentences.

    Raises
    ------
    TypeError
        If they are no whole numbers.
    ValueError
        If they are negative, too large or too many.

    Warns
    -----
    UserWarning
        If one number stands for several pieces, as in a mask.
    """
    if isinstance(given, np.ma.MaskedArray):
        given = given.filled(0)
    if isinstance(given, xr.DataArray):
        labels: xr.DataArray = given
    else:
        # Lazy ones as well, which are not to come into memory whole.
        values = given if hasattr(given, "dask") else np.asarray(given)
        if values.ndim not in PLAIN_AXES:
            msg = f"{name} must have two to four axes, but are {values.shape}"
            raise ValueError(msg)
        labels = xr.DataArray(values, dims=PLAIN_AXES[values.ndim])
    if labels.dtype.kind == "b":
        msg = f"{name} are bool, as a mask is; number its pieces with scipy.ndimage.label(mask)"
        raise TypeError(msg)
    if labels.dtype.kind not in "iu":
        msg = f"{name} must be whole numbers, as find_cells() gives them, but are {labels.dtype}"
        raise TypeError(msg)
    check_range(labels, name)
    doubt_mask(labels, name)
    return labels


def check_range(labels: xr.DataArray, name: str) -> None:
    """Refuse numbers that are no labels."""
    if not labels.size:
        return
    if labels.dtype.kind == "i" and int(labels.min()) < 0:
        msg = f"{name} must be 0 or more, but some are negative"
        raise ValueError(msg)
    highest = int(labels.max())
    if highest > HIGHEST:
        msg = (
            f"{name} go up to {highest}; give each cell a smaller number, with "
            "skimage.segmentation.relabel_sequential(labels)[0]"
        )
        raise ValueError(msg)
    most = max((np.unique(frame).size for frame in some_frames(labels)), default=0)
    if most > MOST:
        msg = f"{name} have {most} numbers in one frame, as an image has; give labels of cells"
        raise ValueError(msg)


def doubt_mask(labels: xr.DataArray, name: str) -> None:
    """Warn if one number stands for several pieces in all frames, as in a mask."""
    split = []
    for frame in some_frames(labels):
        numbers = np.unique(frame[frame > 0])
        if numbers.size != 1:
            return
        pieces, _ = ndimage.label(frame > 0)
        split.append(int(np.count_nonzero(np.bincount(pieces.ravel())[1:] >= LEAST_PIXELS)) > 1)
    if split and all(split):
        warn(
            f"{name} have one number for several pieces, as a mask has, so they count as one "
            "cell; number the pieces with scipy.ndimage.label"
        )


def some_frames(labels: xr.DataArray) -> list[NDArray[np.integer[Any]]]:
    """Return some frames (y, x)."""
    further = [d for d in labels.dims if d not in ("y", "x")]
    count = int(np.prod([labels.sizes[d] for d in further], dtype=int))
    picked = np.unique(np.linspace(0, max(count - 1, 0), FRAMES).astype(int))
    frames = []
    for number in picked[: count or 1]:
        place = np.unravel_index(int(number), [labels.sizes[d] for d in further] or [1])
        at = {d: int(i) for d, i in zip(further, place, strict=False)}
        frames.append(np.asarray(labels.isel(at).data))
    return frames
