"""The objects of a frame that is unwrapped: what is not its empty field."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.analysis.cell_frames import Labels, cells_that_touch
from napari_phase4d.stack import Block, Stack
from napari_phase4d.unwrapping import Problem, shrunk

__all__ = [
    "SMALLEST_OBJECT",
    "object_of",
    "read_when_needed",
    "solid_pieces",
    "told_apart",
    "without_rims",
]

#: So many pixels are taken off the rim of objects, by which too much is not found empty.
SPARE = 3
#: An object is one piece of a frame of at least so many pixels without its rim, or with it where
#: nothing as large is left. Two cells that lie side by side are two then.
SMALLEST_OBJECT = 30

Mask = NDArray[np.bool_]


def object_of(problem: Problem, empty: Stack | None, block: Block) -> Mask:
    """Mark what of the usable field of a block is not empty; all of it if nothing is given."""
    lost = problem.frames_left_out()[block.start : block.stop]
    usable = problem.given.read(block)[1] & ~lost[..., None, None]
    return usable if empty is None else usable & ~empty.read(block)


def read_when_needed(
    read: Callable[[Block], NDArray[np.bool_]], blocks: Iterable[Block], shape: tuple[int, ...]
) -> Any:
    """Return a lazy array of marks, which are read a block at a time."""
    import dask  # which takes a tenth of a second
    import dask.array as da

    parts = [(dask.delayed(partial(read, block), pure=False)(), len(block)) for block in blocks]
    return da.concatenate([da.from_delayed(p, (n, *shape[1:]), np.bool_) for p, n in parts])


def core_of(mask: Mask) -> Mask:
    """Return a mask without its rim of `SPARE` pixels; what lies beyond the view has none."""
    for _ in range(SPARE):
        mask = shrunk(mask, beyond=True)
    return mask


def solid_pieces(inside: Mask) -> Labels:
    """Return numbers from 1 for the pieces of a frame (y, x) that are more than a rim, else 0.

    Cells that touch are told apart by their necks.
    """
    labels, count = scipy.ndimage.label(inside)
    solid = np.bincount(labels[core_of(inside)], minlength=count + 1) > 0
    solid[0] = False
    found: Labels = np.where(solid, np.cumsum(solid), 0).astype(np.int32)[labels]
    count = int(solid.sum())
    for number, place in enumerate(scipy.ndimage.find_objects(found), 1):
        cells = cells_that_touch(found[place] == number)
        if cells is not None:
            more = cells > 1
            found[place][more] = count + cells[more] - 1
            count += int(cells.max()) - 1
    return found


def without_rims(inside: Mask, empty: Mask) -> Labels:
    """Return the objects of a frame: what is not empty field, less its rim where it is wide."""
    cores, count = scipy.ndimage.label(core_of(~empty) & inside)
    large = np.bincount(cores.ravel(), minlength=count + 1) >= SMALLEST_OBJECT
    large[0] = False
    pieces, count = scipy.ndimage.label(inside)
    whole = np.bincount(pieces[large[cores]], minlength=count + 1) == 0
    found: Labels = scipy.ndimage.label(inside & (large[cores] | whole[pieces]))[0]
    return found


def told_apart(objects: Labels, empty: Mask, masks: list[Mask], least: float) -> Labels:
    """Return objects of a frame with new numbers: cells that touch have one each.

    Only pieces of it are looked at that have so many pixels at least in one of the masks.
    """
    cells = objects.copy()
    pieces = scipy.ndimage.label(~empty)[0]
    within = np.where(objects > 0, pieces, 0)
    large = np.bincount(within.ravel()) >= 2 * SMALLEST_OBJECT
    counts = [np.bincount(within[mask], minlength=large.size) for mask in masks]
    asked = large & np.any([count >= least for count in counts], axis=0)
    places, count = scipy.ndimage.find_objects(pieces), int(cells.max())
    for number in np.flatnonzero(asked[1:]) + 1:
        place = places[number - 1]
        parts = cells_that_touch(pieces[place] == number)
        if parts is not None:
            here = cells[place]
            inside = (here > 0) & (parts > 0)
            pairs = here[inside].astype(np.int64) * (int(parts.max()) + 1) + parts[inside]
            found, new = np.unique(pairs, return_inverse=True)
            here[inside] = count + 1 + new
            count += found.size
    return cells
