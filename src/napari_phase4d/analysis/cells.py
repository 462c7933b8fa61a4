"""Cells: found in every frame, told apart where they touch, and followed over time and views."""

from __future__ import annotations

import math
import mmap
import os
import shutil
import tempfile
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
import skimage
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.analysis.cell_crossings import LEAST_PART
from napari_phase4d.analysis.cell_frames import SMALLEST_PIXELS, Labels, Rule
from napari_phase4d.analysis.cell_tracks import GAP, spots_of, tracks_of
from napari_phase4d.analysis.cell_views import joined_views
from napari_phase4d.later import pd, xr
from napari_phase4d.stack import parts_over_time
from napari_phase4d.stacks import (
    AXES,
    check_rising,
    checked_labels,
    unwrapped_stack,
    with_coordinates,
)
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.words import check_bool, check_positive, shown, size_in_words

__all__ = ["copied_labels", "find_cells", "follow_cells", "follow_cells_of"]

#: A cell of the frame before takes part in a blob where this share of it lies in the blob.
OVERLAP = 0.35
#: So many frames may be asked for in which a cell is not found.
MOST_GAP = 1000

Mask = NDArray[np.bool_]


def find_cells(
    unwrapped: xr.DataArray | ArrayLike,
    *,
    threshold_rad: float | None = None,
    smallest_um2: float | None = None,
    largest_um2: float | None = None,
    at_border: bool = True,
    split: bool = True,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Find the cells of every frame, and give each one the same number everywhere.

    What rises out of the empty field is a cell; blobs with a neck are cut at it, and where several
    cells of the frame before have come together they are kept apart. Cells are then followed as by
    `follow_cells`. Frames of which nothing is known are passed over by cells that move too little,
    by their usual steps, to be taken for others after it: by less than half a diameter in all.

    Parameters
    ----------
    unwrapped : DataArray or array_like
        Unwrapped phase in radians, dims among (time, angle, y, x), denser cells positive.
    threshold_rad : float, optional
        Phase above the empty field that some pixel of a cell must have. Default 0.25 rad, more
        with much noise.
    smallest_um2, largest_um2 : float, optional
        Areas between which a cell lies, in square micrometres (in pixels where the phase has no
        places along y and x). Default 30 pixels, and no upper limit.
    at_border : bool, optional
        Whether cells count that the border of the frame cuts off. Default True.
    split : bool, optional
        Whether blobs are cut where they have a neck. Default True.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        int32 in the form of the phase: 0 where there is no cell, else its number, from 1 in the
        order in which cells appear. ``attrs["parents"]`` lists (daughter, parent) of every
        division, ``attrs["overlaps"]`` when a cell can't be told from another that it swims over:
        (cell, angle, from, to), in degrees and seconds.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    ImportError
        If the package that follows cells is not installed.
    Cancelled
        If ``cancelled()`` returned True.

    See Also
    --------
    measure : What each cell weighs.
    follow_cells : For labels of another program.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> sample = p4d.simulation.swimming_cells((96, 96), 3, 2, divisions=0, leaving=0, entering=0)
    >>> cells = p4d.find_cells(sample["phase"])
    >>> sorted(set(cells.values.ravel().tolist()))
    [0, 1, 2]
    """
    task = Task(progress, cancelled)
    phase = unwrapped_stack(unwrapped)
    check_rising(phase, "phase")
    check_bool("at_border", at_border)
    check_bool("split", split)
    stack = with_all_dims(phase)
    area = math.prod(pixel_sides(stack))
    rule = Rule(
        None if threshold_rad is None else check_positive("threshold_rad", threshold_rad),
        SMALLEST_PIXELS
        if smallest_um2 is None
        else check_positive("smallest_um2", smallest_um2) / area,
        math.inf if largest_um2 is None else check_positive("largest_um2", largest_um2) / area,
        at_border,
        split,
    )
    if rule.smallest > rule.largest:
        msg = (
            f"smallest_um2 ({smallest_um2 or 'by default 30 pixels'}) is larger than largest_um2 "
            f"({largest_um2:g}), so that no cell fits"
        )
        raise ValueError(msg)
    labels, known = no_labels(stack), np.zeros(stack.shape[:2], dtype=bool)
    watch = Watch(math.prod(stack.shape[:2]), "finding cells", task)
    for part, values in parts_over_time(stack):
        frames = [values[place] for place in np.ndindex(*values.shape[:2])]
        known[part] = anything_known(values)
        found = labels[part].reshape(-1, *stack.shape[2:])
        for target, of_frame in zip(found, in_threads(rule.found_in, frames, watch), strict=True):
            target[:] = of_frame
    for angle in range(labels.shape[1]):
        keep_apart(labels[:, angle], np.flatnonzero(known[:, angle]))
    full = xr.DataArray(labels, dims=AXES, coords=stack.coords)
    named: xr.DataArray = followed(full, known, None, GAP, task).rename("cells")
    return in_dims_of(named, phase)


def anything_known(values: NDArray[np.floating]) -> list[list[bool]]:
    """Say of frames (time, angle, y, x) whether any of their pixels is known."""
    return [[bool(np.isfinite(view).any()) for view in views] for views in values]


def no_labels(like: xr.DataArray) -> Labels:
    """Return zeros in the form of a stack: in memory, or in a file that nobody sees.

    They lie in a file where the stack does, whose place is taken now: a disk that is full later
    would end the program.

    Raises
    ------
    OSError
        If there is no room for them.
    """
    if not lies_in_file(like.data):
        return np.zeros(like.shape, dtype=np.int32)
    needed = 4 * math.prod(like.shape)
    with tempfile.TemporaryFile() as file:
        free = shutil.disk_usage(tempfile.gettempdir()).free
        if needed > free:
            msg = (
                f"the labels of all cells need {size_in_words(needed)} in "
                f"{tempfile.gettempdir()}, but {size_in_words(free)} are free there; make room, "
                "or set TMPDIR to another folder"
            )
            raise OSError(msg)
        file.truncate(needed)
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file.fileno(), 0, needed)
        return np.memmap(file, dtype=np.int32, mode="r+", shape=like.shape)


def copied_labels(labels: xr.DataArray) -> Labels:
    """Return a copy of labels to paint in, which lies where they lie: in memory, or in a file.

    Parameters
    ----------
    labels : xarray.DataArray
        What `find_cells` gives, dims (time, angle, y, x).

    Returns
    -------
    ndarray of int32, shape (time, angle, y, x)
        The same numbers, 0 where there is no cell; what is painted in it leaves ``labels`` alone.

    Raises
    ------
    OSError
        If there is no room for it.
    """
    copy = no_labels(labels)
    for part, values in parts_over_time(labels):
        if values.size and not 0 <= values.min() <= values.max() <= np.iinfo(np.int32).max:
            msg = "the labels must be from 0 to 2147483647"
            raise ValueError(msg)
        copy[part] = values
    return copy


def lies_in_file(data: Any) -> bool:
    """Say whether numbers are not in memory: lazy ones, and views of mapped files."""
    if not isinstance(data, np.ndarray):
        return True
    while isinstance(data, np.ndarray) and not isinstance(data, np.memmap):
        data = data.base
    return isinstance(data, np.memmap | mmap.mmap)


def pixel_sides(stack: xr.DataArray) -> tuple[float, float]:
    """Return height and width of a pixel in micrometres; 1 where there are no places."""
    sides = []
    for axis in ("y", "x"):
        places = stack.coords[axis].values if axis in stack.coords else np.arange(2)
        sides.append(abs(float(places[1] - places[0])) if len(places) > 1 else 1.0)
    return sides[0], sides[1]


# ---- from frame to frame ---------------------------------------------------------------------


def keep_apart(labels: Labels, known: NDArray[np.intp]) -> None:
    """Cut blobs of a view (time, y, x) that several cells of the time before make up, in place.

    Times that are not known are passed over, if they are few.
    """
    for earlier, later in pairwise(known.tolist()):
        if later - earlier > GAP + 1:
            continue
        before, now = labels[earlier], labels[later]
        both = (before > 0) & (now > 0)
        if not both.any():
            continue
        sizes = np.bincount(before.ravel())
        joint = np.bincount(now[both] * np.int64(sizes.size) + before[both])
        found = np.flatnonzero(joint)
        pairs, overlap = np.stack(np.divmod(found, sizes.size)), joint[found]
        shared = overlap >= OVERLAP * sizes[pairs[1]]
        blobs, members = np.unique(pairs[0][shared], return_counts=True)
        for blob in blobs[members > 1]:
            cells = pairs[1][shared & (pairs[0] == blob)]
            split_as_before(now, int(blob), before, cells)


def split_as_before(now: Labels, blob: int, before: Labels, cells: NDArray[Any]) -> None:
    """Cut one blob of a frame, in place, into the cells that it is made of."""
    inside = now == blob
    markers = np.zeros_like(now)
    for number, cell in enumerate(cells, 1):
        core = scipy.ndimage.binary_erosion((before == cell) & inside, iterations=2)
        markers[core] = number
    if len(np.unique(markers)) <= 2:
        return
    depth = scipy.ndimage.distance_transform_edt(inside)
    parts = skimage.segmentation.watershed(-depth, markers, mask=inside)
    sizes = np.bincount(parts.ravel())[1:]
    splinters = sizes < LEAST_PART * sizes.max()
    if splinters.any():
        markers[np.isin(markers, np.flatnonzero(splinters) + 1)] = 0
        parts = skimage.segmentation.watershed(-depth, markers, mask=inside)
    top = int(now.max())
    for extra in range(2, int(parts.max()) + 1):
        top += 1
        now[parts == extra] = top


def follow_cells(
    labels: xr.DataArray | ArrayLike,
    *,
    reach_um: float | None = None,
    gap: int = GAP,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Give cells that were found frame by frame the same number at all times and in all views.

    Cells of following frames are linked so that the sum of squared ways is least (LAP tracking,
    Jaqaman et al., Nat. Methods 5, 695, 2008, by the package laptrack); gaps are closed, and a
    cell that is followed by two smaller ones has divided. Tracks of two views are one cell's where
    they run side by side.

    Parameters
    ----------
    labels : DataArray or array_like of int, dims among (time, angle, y, x)
        0 is no cell; in each frame every other number is one. Numbers of different frames need
        not have to do with each other.
    reach_um : float, optional
        How far a cell moves from frame to frame at most. Default one diameter, or one and a half
        where nothing else comes into question.
    gap : int, optional
        For how many frames a cell may not be found and still be the same one. Default 1.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        int32 in the form of the labels, see `find_cells`.

    Raises
    ------
    TypeError, ValueError
        If the labels are none.
    ImportError
        If the package laptrack is not installed.
    """
    task = Task(progress, cancelled)
    given = with_coordinates(checked_labels(labels), "the labels")
    if set(given.dims) - set(AXES) or not {"y", "x"} <= set(given.dims):
        msg = f"labels have dims {tuple(given.dims)}; they must be among {', '.join(AXES)}"
        raise ValueError(msg)
    if reach_um is not None:
        check_positive("reach_um", reach_um)
    if isinstance(gap, bool) or not isinstance(gap, int | np.integer) or not 0 <= gap <= MOST_GAP:
        msg = f"gap must be a number of frames from 0 to {MOST_GAP}, but is {shown(gap)}"
        raise ValueError(msg)
    check_rising(given.drop_vars("angle", errors="ignore"), "the labels")
    stack = with_all_dims(given)
    known = np.ones(stack.shape[:2], dtype=bool)
    return in_dims_of(followed(stack, known, reach_um, gap, task), given)


def follow_cells_of(
    unwrapped: xr.DataArray, labels: xr.DataArray | ArrayLike, task: Task
) -> xr.DataArray:
    """Follow cells that are found already over frames of which nothing is known, as `find_cells`.

    Parameters
    ----------
    unwrapped : DataArray
        The phase in which they lie.
    labels : DataArray or array_like of int
        See `follow_cells`.
    task : Task
        Who is told of it, and may stop it.
    """
    given = with_coordinates(checked_labels(labels), "the labels")
    phase = with_all_dims(unwrapped)
    if set(given.dims) - set(AXES) or with_all_dims(given).shape != phase.shape:
        return follow_cells(given, progress=task.progress, cancelled=task.cancelled)
    known = np.zeros(phase.shape[:2], dtype=bool)
    for part, values in parts_over_time(phase):
        known[part] = anything_known(values)
    return in_dims_of(followed(with_all_dims(given), known, None, GAP, task), given)


def with_all_dims(given: xr.DataArray) -> xr.DataArray:
    """Return a stack of any of the four dims as (time, angle, y, x)."""
    found: xr.DataArray = given.expand_dims([d for d in AXES if d not in given.dims])
    return found.transpose(*AXES)


def in_dims_of(stack: xr.DataArray, given: xr.DataArray) -> xr.DataArray:
    """Return a stack (time, angle, y, x) in the form of what it was made of."""
    missing = [d for d in AXES if d not in given.dims]
    found: xr.DataArray = stack.isel(dict.fromkeys(missing, 0), drop=True)
    return found.transpose(*given.dims)


def followed(
    stack: xr.DataArray, known: Mask, reach_um: float | None, gap: int, task: Task
) -> xr.DataArray:
    """Return labels (time, angle, y, x) as `follow_cells` gives them.

    Parameters
    ----------
    stack : DataArray of int
        The labels of each frame.
    known : ndarray of bool, shape (time, angle)
        The frames of which anything is known; others are passed over, see `sure_links`.
    reach_um, gap
        See `follow_cells`.
    task : Task
        Who is told of it, and may stop it.
    """
    sides = pixel_sides(stack)
    watch = Watch(stack.sizes["angle"], "following cells", task)
    views = []
    for angle in range(stack.sizes["angle"]):
        watch.check()
        spots, touching = spots_of(stack[:, angle], sides, watch)
        views.append(tracks_of(spots, touching, reach_um, gap, known[:, angle]))
        watch.step()
    parents = joined_views(views)
    numbered = no_labels(stack)
    for angle, spots in enumerate(views):
        of_spot = spots[["frame", "label", "cell"]].to_numpy(np.int64)
        for time in np.unique(of_spot[:, 0]):
            watch.check()
            frame = np.asarray(stack.data[time, angle]).astype(np.int64)
            here = of_spot[of_spot[:, 0] == time]
            number = np.zeros(max(int(frame.max()), int(here[:, 1].max())) + 1, dtype=np.int32)
            number[here[:, 1]] = here[:, 2]
            numbered[time, angle] = number[frame]
    result = xr.DataArray(numbered, dims=AXES, coords=stack.coords)
    result.attrs = {"kind": "cells", "parents": [list(pair) for pair in parents]}
    result.attrs |= {"overlaps": overlaps_in(views, stack)}
    return result


def overlaps_in(views: list[pd.DataFrame], stack: xr.DataArray) -> list[list[float]]:
    """Return when cells can't be told from others: (cell, angle, from, to), in deg and s."""
    if not {"time", "angle"} <= set(stack.coords):
        return []
    times, angles = (np.asarray(stack[dim].values, np.float64) for dim in ("time", "angle"))
    found: list[list[float]] = []
    for angle, view in zip(angles.tolist(), views, strict=True):
        mixed = view.loc[view["mixed"], ["cell", "frame"]].to_numpy(np.int64)
        for cell in np.unique(mixed[:, 0]).tolist():
            seen = np.sort(mixed[mixed[:, 0] == cell, 1])
            runs = np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1)
            found += [[cell, angle, float(times[r[0]]), float(times[r[-1]])] for r in runs]
    return found
