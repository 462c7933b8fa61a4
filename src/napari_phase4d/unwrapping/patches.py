"""Connected patches of a mask, compiled: holes filled, specks left out, the rim widened.

Pixels touch each other up, down and to the sides. A patch is found by its runs along x: those that
touch from row to row are joined (union-find), which takes one look at every pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = ["extent", "fill_holes", "keep_touching", "remove_specks", "shrink", "widened"]

Mask = NDArray[np.bool_]
#: Row, first and one after the last pixel of every run; its parent among them; the pixels of the
#: patch, and whether it touches the edge, both by its first run.
Runs = NDArray[np.int32]
ROW, START, STOP, PARENT, SIZE, EDGE = 0, 1, 2, 3, 4, 5


@compiled
def extent(mask: Mask, room: int) -> tuple[int, int, int, int]:
    """Return the first and one after the last row and column of a mask, with some room.

    The first row and column alone where there is nothing.
    """
    height, width = mask.shape
    top, bottom = height, -1
    columns = np.zeros(width, np.bool_)
    for y in range(height):
        if add_row(mask[y], columns):
            top, bottom = min(top, y), y
    if bottom < 0:
        return 0, 1, 0, 1
    left, right = 0, width - 1
    while not columns[left]:
        left += 1
    while not columns[right]:
        right -= 1
    return (
        max(top - room, 0),
        min(bottom + room + 1, height),
        max(left - room, 0),
        min(right + room + 1, width),
    )


@compiled
def fill_holes(mask: Mask) -> None:
    """Fill what the edge can't be reached from."""
    runs, count = patches_of(mask, False)
    for k in range(count):
        if not runs[EDGE, root_of(runs, k)]:
            mask[runs[ROW, k], runs[START, k] : runs[STOP, k]] = True


@compiled
def remove_specks(mask: Mask, smallest: float) -> None:
    """Leave out patches of fewer pixels."""
    runs, count = patches_of(mask, True)
    for k in range(count):
        if runs[SIZE, root_of(runs, k)] < smallest:
            mask[runs[ROW, k], runs[START, k] : runs[STOP, k]] = False


@compiled
def keep_touching(mask: Mask, edge: Mask, smallest: int) -> None:
    """Keep patches of so many pixels that share some with an edge; leave the others out."""
    runs, count = patches_of(mask, True)
    runs[EDGE] = 0
    for k in range(count):
        row = edge[runs[ROW, k]]
        for x in range(runs[START, k], runs[STOP, k]):
            if row[x]:
                runs[EDGE, root_of(runs, k)] = 1
                break
    for k in range(count):
        root = root_of(runs, k)
        if not runs[EDGE, root] or runs[SIZE, root] < smallest:
            mask[runs[ROW, k], runs[START, k] : runs[STOP, k]] = False


@compiled
def shrink(mask: Mask, beyond: bool, square: bool, out: Mask) -> None:
    """Write the pixels whose four neighbours are marked too, or all eight in a square.

    Parameters
    ----------
    mask : ndarray of bool, shape (y, x)
        What to shrink.
    beyond : bool
        What lies beyond the border.
    square : bool
        Whether diagonal neighbours count.
    out : ndarray of bool, shape (y, x)
        Where it goes.
    """
    height, width = mask.shape
    nothing = np.full(width, beyond)
    column = np.full(width + 2, beyond)
    for y in range(height):
        above = mask[y - 1] if y > 0 else nothing
        below = mask[y + 1] if y < height - 1 else nothing
        shrink_row(above, mask[y], below, column[1 : width + 1], square, out[y])
        and_beside(column[:width], column[2:], out[y])


@compiled
def shrink_row(above: Mask, row: Mask, below: Mask, column: Mask, square: bool, out: Mask) -> None:
    """Write what is marked in three rows."""
    for x in range(len(out)):
        out[x] = above[x] & row[x] & below[x]
    for x in range(len(out)):
        column[x] = out[x] if square else row[x]


@compiled
def and_beside(left: Mask, right: Mask, out: Mask) -> None:
    """Keep what is marked to the left and to the right as well."""
    for x in range(len(out)):
        out[x] &= left[x] & right[x]


@compiled
def patches_of(mask: Mask, value: bool) -> tuple[Runs, int]:
    """Return the runs of pixels that have a value, joined to patches, and how many there are."""
    height, width = mask.shape
    runs = np.empty((6, height * ((width + 1) // 2)), np.int32)
    count, above = 0, 0
    for y in range(height):
        row = mask[y]
        own, x = count, 0
        while x < width:
            if row[x] != value:
                x += 1
                continue
            start = x
            while x < width and row[x] == value:
                x += 1
            runs[ROW, count], runs[START, count], runs[STOP, count] = y, start, x
            runs[PARENT, count], runs[SIZE, count] = count, x - start
            runs[EDGE, count] = y == 0 or y == height - 1 or start == 0 or x == width
            count += 1
        join_rows(runs, above, own, count)
        above = own
    return runs, count


@compiled
def join_rows(runs: Runs, above: int, own: int, count: int) -> None:
    """Join the runs of a row, from ``own`` on, to those of the row before that they touch."""
    for k in range(own, count):
        while above < own and runs[STOP, above] <= runs[START, k]:
            above += 1
        other = above
        while other < own and runs[START, other] < runs[STOP, k]:
            join(runs, other, k)
            other += 1


@compiled
def join(runs: Runs, one: int, other: int) -> None:
    """Make one patch of those of two runs."""
    first, second = root_of(runs, one), root_of(runs, other)
    if first == second:
        return
    if first > second:
        first, second = second, first
    runs[PARENT, second] = first
    runs[SIZE, first] += runs[SIZE, second]
    runs[EDGE, first] |= runs[EDGE, second]


@compiled
def root_of(runs: Runs, run: int) -> int:
    """Return the first run of a run's patch."""
    while runs[PARENT, run] != run:
        runs[PARENT, run] = runs[PARENT, runs[PARENT, run]]
        run = runs[PARENT, run]
    return run


@compiled
def widened(mask: Mask, by: int) -> Mask:
    """Return a mask widened by some pixels up, down and to the sides."""
    height, width = mask.shape
    now = mask.copy()
    for _ in range(by):
        wider = now.copy()
        for y in range(height):
            row, out = now[y], wider[y]
            if y > 0:
                add_row(now[y - 1], out)
            if y < height - 1:
                add_row(now[y + 1], out)
            add_row(row[: width - 1], out[1:])
            add_row(row[1:], out[: width - 1])
        now = wider
    return now


@compiled
def add_row(row: Mask, out: Mask) -> bool:
    """Mark what is marked in a row; return whether anything is."""
    some = False
    for x in range(len(row)):
        out[x] |= row[x]
        some |= row[x]
    return some
