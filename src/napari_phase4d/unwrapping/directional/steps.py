"""Steps between neighbours, and how far each is to be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["Steps", "all_steps", "fading"]

TURN = np.float32(2 * np.pi)
#: Width in steps, along every axis, of the box in which roughness is averaged.
BOX = 3
#: Fewest steps of the empty field from which the noise floor is taken.
ENOUGH = 50
#: Amplitude, as a share of its median, below which fading does not grow; and the roughness in
#: radians that half the median stands for. Any value from 0.5 to 4 does about as well.
FAINTEST, FADING = 0.05, 2.0

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Steps:
    """Steps between nodes, from all four axes.

    Parameters
    ----------
    first, second : ndarray of int
        The nodes at both ends.
    turns : ndarray of int
        Turns of the second minus those of the first, if the step is less than half a turn.
    size : ndarray of float
        The wrapped step in radians, without its sign.
    roughness : ndarray of float
        How much steps change along their own direction here, radians.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    turns: NDArray[np.int32]
    size: Stack
    roughness: Stack


def all_steps(
    phase: Stack,
    nodes: NDArray[np.int32],
    empty: Mask,
    usable: Mask,
    seams: NDArray[np.int8],
    amplitude: Stack | None,
) -> Steps:
    """Return the steps along time, angle, y and x whose ends are not the same node.

    Parameters
    ----------
    phase : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    nodes : ndarray of int, same shape
        Number of the node that each pixel belongs to.
    empty : ndarray of bool, same shape
        Pixels of the empty field, from which the noise floor is taken.
    usable : ndarray of bool, same shape
        Pixels that count.
    seams : ndarray of int, same shape
        Neighbours of different numbers are none.
    amplitude : ndarray of float or None
        Amplitude as a share of its median.
    """
    parts = []
    for axis in range(4):
        n = phase.shape[axis]
        if n < 2:
            continue
        head = tuple(slice(None, -1) if i == axis else slice(None) for i in range(4))
        tail = tuple(slice(1, None) if i == axis else slice(None) for i in range(4))
        difference = phase[tail] - phase[head]
        turns = np.round(difference / TURN).astype(np.int32)
        step = difference - TURN * turns.astype(np.float32)
        rough = roughness(step, axis, empty[head] & empty[tail])
        if amplitude is not None:
            rough += fading(np.minimum(amplitude[head], amplitude[tail]))
        kept = (
            (nodes[head] != nodes[tail])
            & usable[head]
            & usable[tail]
            & (seams[head] == seams[tail])
        )
        parts.append(
            (
                nodes[head][kept],
                nodes[tail][kept],
                -turns[kept],
                np.abs(step[kept]),
                rough[kept],
            )
        )
    if not parts:
        none = np.zeros(0, dtype=np.int32)
        return Steps(none, none, none, none.astype(np.float32), none.astype(np.float32))
    return Steps(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def fading(amplitude: Stack) -> Stack:
    """Return the roughness in radians that counts for amplitude below its median."""
    faint = np.clip(amplitude, np.float32(FAINTEST), np.float32(1))
    return (FADING * (1 / faint - 1)).astype(np.float32)


def roughness(step: Stack, axis: int, empty: Mask) -> Stack:
    """Return how much steps change along their own axis, averaged over a box, less the noise.

    D = |g(j+1) - g(j)| + |g(j) - g(j-1)|, where a missing neighbour counts as the other one, and
    2 |g| where there is one step only; the root of the mean of D^2 over the box, less its mean
    over the empty field.
    """
    if step.shape[axis] == 1:
        twice = 2 * np.abs(step)
    else:
        between = np.abs(np.diff(step, axis=axis))
        ends = [(int(i == axis), int(i == axis)) for i in range(4)]
        padded = np.pad(between, ends, mode="edge")
        n = step.shape[axis]
        twice = padded.take(range(n), axis) + padded.take(range(1, n + 1), axis)
    change = (twice * twice).astype(np.float32)
    floor = float(change[empty].mean()) if np.count_nonzero(empty) >= ENOUGH else 0.0
    width = [BOX if n >= BOX else 1 for n in step.shape]
    mean = ndimage.uniform_filter(change, width, mode="reflect")
    rough: Stack = np.sqrt(np.maximum(mean - np.float32(floor), np.float32(0)))
    return rough
