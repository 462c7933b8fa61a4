"""Unwrapping by sorted reliability in any number of dimensions.

Herraez et al. 2002 (two dimensions) and Abdul-Rahman et al. 2007 (three): neighbours are joined
in the order of the reliability of the edge between them; when two groups meet, one is shifted by
whole turns so that the step across that edge is less than half a turn. Joining in this order is
Kruskal's construction of a minimum spanning tree, so the result is what integrating along that
tree gives.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

__all__ = ["Edges", "grid_edges", "grow", "second_differences"]

TURN = 2 * np.pi
#: Unreliability of a pixel at the border of a frame, where second differences are missing.
BORDER = np.float32(9_999_999.0)

#: (first pixel, second pixel) of every edge, as flat indices.
Edges = tuple[NDArray[np.int64], NDArray[np.int64]]


def half_stencil(shape: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Return one of each pair of opposite neighbours: 4 in 2-D, 13 in 3-D, 40 in 4-D.

    Dimensions of length 1 and 2 have no second differences along them and are left out.
    """
    steps = [(-1, 0, 1) if n > 2 else (0,) for n in shape]
    offsets = [o for o in itertools.product(*steps) if any(o)]
    return [o for o in offsets if o > tuple(-v for v in o)]


def second_differences(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return the unreliability of every pixel: the sum of its squared wrapped second differences.

    Parameters
    ----------
    wrapped : ndarray
        Wrapped phase in radians, any number of dimensions; the last two are y and x.
    mask : ndarray of bool, same shape
        Pixels that count.

    Returns
    -------
    ndarray, same shape
        D^2 = sum over opposite neighbours of (W(v- - v) - W(v - v+))^2. Pixels at the border of a
        frame are the least reliable, as in scikit-image. At the first and last time or angle, the
        sum over the pairs that exist is scaled to all pairs.
    """
    offsets = half_stencil(wrapped.shape)
    total = np.zeros(wrapped.shape, dtype=np.float32)
    count = np.zeros(wrapped.shape, dtype=np.float32)
    for offset in offsets:
        centre = tuple(slice(1, -1) if o else slice(None) for o in offset)
        ahead = tuple(shifted(o) for o in offset)
        behind = tuple(shifted(-o) for o in offset)
        middle = wrapped[centre]
        second = wrap(wrapped[behind] - middle) - wrap(middle - wrapped[ahead])
        valid = mask[behind] & mask[ahead]
        total[centre] += np.where(valid, second**2, 0)
        count[centre] += valid
    scaled = (total * len(offsets) / np.maximum(count, 1)).astype(np.float32)
    scaled[count == 0] = BORDER
    edge = np.ones(wrapped.shape[-2:], dtype=bool)
    edge[1:-1, 1:-1] = False
    scaled[..., edge] = BORDER
    return scaled


def shifted(offset: int) -> slice:
    """Return the slice of an axis moved by one step, or not."""
    return {0: slice(None), 1: slice(2, None), -1: slice(None, -2)}[offset]


def wrap(difference: NDArray[np.float32]) -> NDArray[np.float32]:
    """Wrap differences into [-pi, pi]."""
    turns = np.round(difference / np.float32(TURN)).astype(np.float32)
    return difference - np.float32(TURN) * turns


def grid_edges(mask: NDArray[np.bool_]) -> Edges:
    """Return all edges between neighbours along the axes, both inside the mask."""
    index = np.arange(mask.size).reshape(mask.shape)
    first, second = [], []
    for axis in range(mask.ndim):
        head = tuple(slice(None, -1) if i == axis else slice(None) for i in range(mask.ndim))
        tail = tuple(slice(1, None) if i == axis else slice(None) for i in range(mask.ndim))
        both = mask[head] & mask[tail]
        first.append(index[head][both])
        second.append(index[tail][both])
    return np.concatenate(first), np.concatenate(second)


def grow(
    wrapped: NDArray[np.float32],
    edges: Edges,
    cost: NDArray[np.floating],
    largest_step: float = np.pi,
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Join pixels along the cheapest edges first and integrate.

    Parameters
    ----------
    wrapped : ndarray
        Wrapped phase in radians.
    edges : tuple of ndarray
        Flat indices of the two ends of every edge.
    cost : ndarray
        Cost of every edge; equal ones are taken in their order.
    largest_step : float, optional
        Step in radians beyond which one side of an edge is shifted by a turn; default pi. Any
        other value takes the wrapped phase to lie within one turn.

    Returns
    -------
    unwrapped : ndarray of float32, shape of wrapped
        In radians; every separate part has its own open multiple of 2 pi.
    parts : ndarray of int, shape of wrapped
        Number of the part that each pixel belongs to.
    """
    flat = wrapped.ravel()
    n = flat.size
    # The order alone matters; ranks make every cost different and none zero.
    rank = np.empty(len(cost))
    rank[np.argsort(cost, kind="stable")] = np.arange(1, len(cost) + 1)
    tree = csgraph.minimum_spanning_tree(sparse.csr_array((rank, edges), shape=(n, n)))
    _, parts = csgraph.connected_components(tree, directed=False)
    _, first_of_part = np.unique(parts, return_index=True)
    # One more node holds all parts together, so that one walk reaches every pixel.
    links = sparse.coo_array(
        (np.ones(len(first_of_part)), (np.full(len(first_of_part), n), first_of_part)),
        shape=(n + 1, n + 1),
    )
    tree.resize(n + 1, n + 1)
    order, parent = csgraph.breadth_first_order(
        (tree + links).tocsr(), n, directed=False, return_predecessors=True
    )
    del order
    parent[n] = n
    from_below = flat - np.append(flat, np.float32(0))[parent[:n]]
    turns_down = np.round(from_below / TURN)
    if largest_step != np.pi:
        turns_down = (from_below > largest_step).astype(np.int32) - (from_below < -largest_step)
    jump = np.append(-turns_down, 0).astype(np.int32)
    jump[first_of_part] = 0
    while (parent != n).any():  # pointer jumping: each round doubles the way covered
        jump += jump[parent]
        parent = parent[parent]
    unwrapped = flat + np.float32(TURN) * jump[:n].astype(np.float32)
    return unwrapped.reshape(wrapped.shape), parts.reshape(wrapped.shape)
