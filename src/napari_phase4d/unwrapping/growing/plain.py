"""The same results without a compiler: NumPy for what has no residues, SciPy for the rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from napari_phase4d.unwrapping.ends import ends_along
from napari_phase4d.unwrapping.growing.rows import BORDER, Floats, Phase, Shape, Whole

__all__ = ["grown_grid", "integrated", "joined_list", "jumps", "unreliability"]

HALF, TURN = np.pi, 2 * np.pi
Mask = NDArray[np.bool_]


def unreliability(
    wrapped: Phase, mask: Mask, pairs: NDArray[np.int64], ends: Mask, *, scaled: bool
) -> Floats:
    """Return the unreliability of every pixel of a grid, see `second_differences`.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (n0, n1, n2, nx)
        Wrapped phase in radians.
    mask : ndarray of bool, same shape
        Pixels that count.
    pairs : ndarray of int, shape (pairs, 4)
        One offset of each pair of opposite neighbours.
    ends : ndarray of bool, shape (3,)
        Axes at whose ends pixels are the least reliable.
    scaled : bool
        Whether the sum over some pairs is scaled to all; else such a pixel is the least reliable.
    """
    total, count = np.zeros(wrapped.shape), np.zeros(wrapped.shape)
    for offset in pairs:
        centre = tuple(slice(1, -1) if o else slice(None) for o in offset)
        ahead, behind = (tuple(moved(s * o) for o in offset) for s in (1, -1))
        middle = wrapped[centre].astype(np.float64)
        change = wrap(wrapped[behind] - middle) - wrap(middle - wrapped[ahead])
        seen = mask[behind] & mask[ahead]
        total[centre] += np.where(seen, change * change, 0)
        count[centre] += seen
    bounded = [axis for axis in range(3) if ends[axis] and wrapped.shape[axis] > 1]
    for axis in (*bounded, 3):
        for end in (0, -1):
            count[(slice(None),) * axis + (end,)] = 0
    scale = len(pairs) / np.maximum(count, 1)
    total = np.where(count == len(pairs), total, total * scale)
    total[(count == 0) | (count < (0 if scaled else len(pairs)))] = BORDER
    total[~mask] = np.inf
    return total


def moved(offset: int) -> slice:
    """Return the slice of an axis moved by one step, or not."""
    return {0: slice(None), 1: slice(2, None), -1: slice(None, -2)}[int(offset)]


def wrap(step: Floats) -> Floats:
    """Wrap differences of two wrapped phases into [-pi, pi]."""
    inside: Floats = step - TURN * (step > HALF) + TURN * (step < -HALF)
    return inside


def jumps(before: NDArray[np.floating], after: NDArray[np.floating], half: float = HALF) -> Whole:
    """Return the turns to add after each step so that it is no larger than half a turn."""
    step = after.astype(np.float64) - before
    return (step < -half).astype(np.int32) - (step > half)


def integrated(wrapped: Phase) -> Whole | None:
    """Return the turns of every pixel if all steps agree, else None.

    Parameters
    ----------
    wrapped : ndarray of float32
        Wrapped phase in radians, any number of dimensions.
    """
    turns = np.zeros(wrapped.shape, dtype=np.int32)
    for axis in range(wrapped.ndim):
        # Along this axis from the first hyperplane, for all axes before; the first of the others.
        corner = (slice(None),) * (axis + 1) + (0,) * (wrapped.ndim - axis - 1)
        line = np.moveaxis(wrapped[corner], -1, 0)
        so_far = np.moveaxis(turns[corner], -1, 0)
        so_far[1:] = so_far[0] + np.cumsum(jumps(line[:-1], line[1:]), axis=0)
    for axis in range(wrapped.ndim):
        line, so_far = np.moveaxis(wrapped, axis, 0), np.moveaxis(turns, axis, 0)
        if (np.diff(so_far, axis=0) != jumps(line[:-1], line[1:])).any():
            return None
    return turns


def grown_grid(
    wrapped: Phase, point: Floats, steps: Floats, shape: Shape
) -> tuple[Whole, Whole | None]:
    """Return turns and parts of a grid (rows, nx) from the list of all its steps."""
    first, second, cost = steps_in_order(point, steps, shape)
    flat = wrapped.ravel()
    parts, turns, n = joined_list(first, second, jumps(flat[first], flat[second]), cost, flat.size)
    return turns.reshape(wrapped.shape), parts.reshape(wrapped.shape) if n > 1 else None


def steps_in_order(point: Floats, steps: Floats, shape: Shape) -> tuple[Whole, Whole, Floats]:
    """List the steps of finite cost as the compiled code does: row by row, axis by axis."""
    index = np.arange(np.prod(shape), dtype=np.int32).reshape(shape)
    first, second, cost, place = [], [], [], []
    for axis in range(4):
        head, tail = ends_along(axis, 4)
        if steps.size and axis < 2:
            continue
        of_step = (
            steps[axis - 2].reshape(shape)[head]
            if steps.size
            else point.reshape(shape)[head] + point.reshape(shape)[tail]
        )
        known = np.isfinite(of_step)
        first.append(index[head][known])
        second.append(index[tail][known])
        cost.append(of_step[known])
        # In a row, those from the rows before come first, axis by axis, then those along x.
        row, x = np.divmod(second[-1].astype(np.int64), shape[3])
        place.append((4 * row + axis) * shape[3] + x)
    order = np.argsort(np.concatenate(place))
    return tuple(np.concatenate(column)[order] for column in (first, second, cost))  # type: ignore[return-value]


def joined_list(
    first: NDArray[np.integer],
    second: NDArray[np.integer],
    steps: NDArray[np.integer],
    cost: NDArray[np.floating],
    n: int,
) -> tuple[Whole, Whole, int]:
    """Join nodes along the cheapest steps first, see `join_cheapest`."""
    # The order alone matters; ranks make every cost different and none zero.
    rank = np.empty(len(cost))
    rank[np.argsort(cost, kind="stable")] = np.arange(1, len(cost) + 1)
    # Of several steps between the same two nodes only the cheapest may be in the tree.
    low, high = np.minimum(first, second), np.maximum(first, second)
    by_pair = np.lexsort((rank, high, low))
    new = np.ones(len(by_pair), dtype=bool)
    new[1:] = (np.diff(low[by_pair]) != 0) | (np.diff(high[by_pair]) != 0)
    kept = by_pair[new]
    kept = kept[low[kept] != high[kept]]
    up = np.where(first < second, steps, -steps)[kept]
    tree = csgraph.minimum_spanning_tree(
        sparse.csr_array((rank[kept], (low[kept], high[kept])), shape=(n, n))
    ).tocoo()
    turns_of_rank = np.zeros(len(cost) + 1, dtype=np.int32)
    turns_of_rank[rank[kept].astype(np.intp)] = up
    number, parts = csgraph.connected_components(tree, directed=False)
    return parts.astype(np.int32), integrated_tree(tree, turns_of_rank, parts), int(number)


def integrated_tree(tree: sparse.coo_array, turns_of_rank: Whole, parts: Whole) -> Whole:
    """Return every node's turns relative to the first of its part, along the tree."""
    n = len(parts)
    _, first_of_part = np.unique(parts, return_index=True)
    # One more node holds all parts together, so that one walk reaches every node.
    low = np.concatenate([tree.coords[0], np.full(len(first_of_part), n)])
    high = np.concatenate([tree.coords[1], first_of_part])
    links = sparse.coo_array((np.ones(len(low)), (low, high)), shape=(n + 1, n + 1)).tocsr()
    _, parent = csgraph.breadth_first_order(links, n, directed=False, return_predecessors=True)
    parent[n] = n
    jump = np.zeros(n + 1, dtype=np.int32)
    a, b = tree.coords
    of_edge = turns_of_rank[tree.data.astype(np.intp)]
    downwards = parent[b] == a
    jump[b[downwards]] = of_edge[downwards]
    jump[a[~downwards]] = -of_edge[~downwards]
    while (parent != n).any():  # pointer jumping: each round doubles the way covered
        jump += jump[parent]
        parent = parent[parent]
    return jump[:n]
