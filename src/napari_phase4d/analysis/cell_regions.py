"""Regions that go along with the cells that they were drawn on."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.analysis.loading import PART_BYTES, frame_of, parts_over_time
from napari_phase4d.axes import AXES
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch

__all__ = ["region_with_cell"]

#: Where no way of a cell is known, since it is not found there.
NOWHERE = np.iinfo(np.int64).min

Mask = NDArray[np.bool_]
Ways = NDArray[np.int64]


def region_with_cell(
    region: Mask,
    frame: tuple[int, int],
    cells: xr.DataArray,
    *,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Let a region that was drawn in one frame go along with the cell that it lies on.

    It keeps its form, and is moved as the middle of the cell moves, through times and views. What
    leaves the field is cut off; where the cell is not found, the region is empty.

    Parameters
    ----------
    region : ndarray of bool, shape (y, x)
        The region.
    frame : (int, int)
        Numbers of the time and angle at which it was drawn.
    cells : xarray.DataArray
        What `find_cells` gives, dims (time, angle, y, x); in memory or lazy.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        bool, dims (time, angle, y, x). It is lazy: only where the cell is in each frame is kept,
        and a frame of it is made when it is looked at.

    Raises
    ------
    ValueError
        If there is no cell in the region in that frame.
    Cancelled
        If ``cancelled()`` returned True.
    """
    task = Task(progress, cancelled)
    labels = cells.transpose(*AXES)
    if not (0 <= frame[0] < labels.shape[0] and 0 <= frame[1] < labels.shape[1]):
        msg = (
            f"the region was drawn at time {frame[0]} and angle {frame[1]} (counted from 0), but "
            f"there are {labels.shape[0]} times and {labels.shape[1]} angles; draw it again"
        )
        raise ValueError(msg)
    here = frame_of(labels, *frame)
    region = np.asarray(region)
    if region.dtype != bool or region.shape != here.shape:
        msg = (
            f"the region must be True and False on {here.shape} pixels (y, x), but is "
            f"{region.dtype} of shape {region.shape}"
        )
        raise ValueError(msg)
    inside = here[region & (here > 0)]
    if not inside.size:
        msg = (
            f"there is no cell in the region at time {frame[0]} and angle {frame[1]} (counted "
            "from 0), so it can't go along with one; draw it on a cell, or let it stand still"
        )
        raise ValueError(msg)
    cell = int(np.bincount(inside).argmax())
    watch = Watch(labels.shape[0], "following the region", task)
    ways = ways_of(cell, middle_of(here == cell), labels, watch)
    # Blocks that are small beside what is free, and large beside what a block costs.
    times = max(1, PART_BYTES // 4 // max(labels[0].size, 1))
    begins = range(0, labels.shape[0], times)
    lengths = tuple(min(times, labels.shape[0] - begin) for begin in begins)
    import dask.array as da  # which takes a tenth of a second

    moved = da.map_blocks(
        lambda block_id: block_of(region, ways[begins[block_id[0]] :][:times]),
        chunks=(lengths, *((n,) for n in labels.shape[1:])),
        dtype=bool,
        meta=np.empty((0, 0, 0, 0), dtype=bool),
    )
    return xr.DataArray(moved, dims=AXES, coords=labels.coords, name="region")


def ways_of(cell: int, start: NDArray[np.float64], labels: xr.DataArray, watch: Watch) -> Ways:
    """Return by how many pixels (time, angle, 2) a cell has moved, NOWHERE where it is not."""
    ways = np.full((*labels.shape[:2], 2), NOWHERE)
    watch.check()
    for part, values in parts_over_time(labels):
        for time, views in enumerate(values, part.start):
            for angle, frame in enumerate(views):
                of_cell = frame == cell
                if of_cell.any():
                    ways[time, angle] = np.rint(middle_of(of_cell) - start)
            watch.step()
    return ways


def block_of(region: Mask, ways: Ways) -> Mask:
    """Return a region (time, angle, y, x) moved by such ways."""
    moved = np.zeros((*ways.shape[:2], *region.shape), dtype=bool)
    for place in np.ndindex(*ways.shape[:2]):
        if ways[place][0] != NOWHERE:
            shifted(region, ways[place], moved[place])
    return moved


def middle_of(mask: Mask) -> NDArray[np.float64]:
    """Return the middle (y, x) of the pixels of a mask."""
    return np.array([float(part.mean()) for part in np.nonzero(mask)])


def shifted(mask: Mask, way: Ways, target: Mask) -> None:
    """Move a mask by whole pixels into an empty one; what leaves it is lost."""
    source, goal = [], []
    for step, size in zip(way.tolist(), mask.shape, strict=True):
        source.append(slice(max(-step, 0), max(min(size, size - step), 0)))
        goal.append(slice(max(step, 0), max(min(size, size + step), 0)))
    if mask[tuple(source)].size:
        target[tuple(goal)] = mask[tuple(source)]
