"""Whole turns that noise leaves in doubt, settled together with their neighbours'.

A coarse phase says of every pixel by itself how many turns a finer one has, with noise that may
well be a turn. The steps from pixel to pixel say with hardly any noise by how many turns
neighbours differ, but nothing of the level, and wrong at a sheer wall. So pixels are joined along
their smoothest steps first, as in reliability sorting (Herraez et al. 2002), and what the coarse
phase says is averaged over each region that has come about; where two regions meet whose averages
contradict the step between them, beyond what noise explains, they are left apart: there is a wall.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.ends import ends_along
from napari_phase4d.unwrapping.light.steps import AlongAxis

__all__ = ["SHARED", "STAYS", "settled_turns"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Whole = NDArray[np.int32]

#: Pixels that share their noise, since the pupil cuts the spectrum off.
SHARED = 2.0
#: Errors in turns that an average does not make smaller: of the levels, of dispersion.
STAYS = 0.08
#: A wall is believed in if it is so much likelier than noise, as a logarithm of the odds.
LIKELIER = 5.0


def settled_turns(
    estimate: Image, steps: tuple[AlongAxis, AlongAxis], noise: float, mask: Mask
) -> Whole:
    """Return the whole turns of every pixel of a frame; 0 outside the mask.

    Parameters
    ----------
    estimate : ndarray of shape (y, x)
        Turns by the coarser phase, not rounded.
    steps : two AlongAxis
        Turns that the steps down and to the right ask for in the finer phase.
    noise : float
        Standard deviation of the estimate in turns.
    mask : ndarray of bool, shape (y, x)
        Pixels to settle.
    """
    first, second, asked, order = edges_of(steps, mask)
    turns = np.zeros(mask.size, dtype=np.int32)
    join(
        first[order],
        second[order],
        asked[order],
        estimate.ravel().astype(np.float64),
        (SHARED * noise**2, STAYS**2, LIKELIER),
        turns,
    )
    return np.where(mask, turns.reshape(mask.shape), np.int32(0))


def edges_of(
    steps: tuple[AlongAxis, AlongAxis], mask: Mask
) -> tuple[NDArray[np.int32], NDArray[np.int32], Whole, NDArray[np.intp]]:
    """Return both ends of the steps inside a mask, the turns they ask for, and their order."""
    number = np.arange(mask.size, dtype=np.int32).reshape(mask.shape)
    parts = []
    for axis, along in enumerate(steps):
        head, tail = ends_along(axis, 2)
        inside = mask[head] & mask[tail]
        ends = number[head][inside], number[tail][inside]
        parts.append((*ends, along.asked[inside], along.cost[inside]))
    first, second, asked, cost = (np.concatenate(column) for column in zip(*parts, strict=True))
    return first, second, asked.astype(np.int32), np.argsort(cost, kind="stable")


@compiled
def join(
    first: NDArray[np.int32],
    second: NDArray[np.int32],
    asked: Whole,
    estimate: NDArray[np.float64],
    odds: tuple[float, float, float],
    turns: Whole,
) -> None:
    """Join pixels step by step, and write the turns of each; see `settled_turns`.

    Parameters
    ----------
    first, second : ndarray of int
        Ends of the steps, in the order in which they are gone along.
    asked : ndarray of int
        Turns that the second end has more than the first.
    estimate : ndarray of float
        Turns of each pixel by the coarser phase.
    odds : tuple of float
        Variance of the estimate in a pixel, and what averaging leaves of it, in turns squared; and
        how much likelier a wall must be.
    turns : ndarray of int
        Written: whole turns of each pixel.
    """
    n = len(estimate)
    parent = np.arange(n)
    # Turns of each pixel against its parent; of a root, the sum and number over its region.
    relative = np.zeros(n, dtype=np.int64)
    total = estimate.copy()
    count = np.ones(n)
    for step in range(len(first)):
        a, up_a = first[step], 0
        while parent[a] != a:
            up_a += relative[a]
            a = parent[a]
        b, up_b = second[step], 0
        while parent[b] != b:
            up_b += relative[b]
            b = parent[b]
        if a == b:
            continue
        # Turns of root b against root a, if this step is to be believed.
        apart = up_a + asked[step] - up_b
        off = total[b] / count[b] - total[a] / count[a] - apart
        whole = np.rint(off)
        if whole != 0:
            variance = odds[0] * (1 / count[a] + 1 / count[b]) + 2 * odds[1]
            if off**2 - (off - whole) ** 2 > 2 * variance * odds[2]:
                continue
        if count[a] < count[b]:
            a, b, apart = b, a, -apart
        parent[b] = a
        relative[b] = apart
        total[a] += total[b] - apart * count[b]
        count[a] += count[b]
    for pixel in range(n):
        root, up = pixel, 0
        while parent[root] != root:
            up += relative[root]
            root = parent[root]
        turns[pixel] = np.rint(total[root] / count[root]) + up
