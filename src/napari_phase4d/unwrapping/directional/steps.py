"""Steps between neighbours, and how far each is to be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import on_all_cores
from napari_phase4d.unwrapping.ends import ends_along

__all__ = ["Steps", "all_steps", "fading"]

TURN = np.float32(2 * np.pi)
#: Width in steps, along every axis, of the box in which roughness is averaged.
BOX = 3
#: Fewest steps of the empty field from which the noise floor is taken.
ENOUGH = 50
#: Mean of D^2 for white noise of one radian: 12 + 2 * 4.7 where there are two changes, which share
#: two thirds of their noise, and 4 * 2 where there is a single step.
OF_TWO_CHANGES, OF_ONE_STEP = 21.4, 8.0
#: Share of the weight of a box below which a mean counts as nothing.
LEAST_WEIGHT = 1e-3
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
    noise: float,
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
    noise : float
        Standard deviation of the phase's noise in radians, for where no empty field is in view.
    """
    parts: dict[int, tuple[Any, ...]] = {}

    def work(axis: int) -> None:
        head, tail = ends_along(axis, 4)
        difference = phase[tail] - phase[head]
        turns = np.round(difference / TURN).astype(np.int32)
        step = difference - TURN * turns.astype(np.float32)
        valid = usable[head] & usable[tail] & (seams[head] == seams[tail])
        rough = roughness(step, axis, empty[head] & empty[tail], valid, noise)
        if amplitude is not None:
            rough += fading(np.minimum(amplitude[head], amplitude[tail]))
        kept = valid & (nodes[head] != nodes[tail])
        ends = nodes[head][kept], nodes[tail][kept]
        parts[axis] = (*ends, -turns[kept], np.abs(step[kept]), rough[kept])

    on_all_cores(work, [axis for axis in range(4) if phase.shape[axis] > 1])
    if not parts:
        none = np.zeros(0, dtype=np.int32)
        return Steps(none, none, none, none.astype(np.float32), none.astype(np.float32))
    in_order = [parts[axis] for axis in sorted(parts)]
    return Steps(*(np.concatenate(columns) for columns in zip(*in_order, strict=True)))


def fading(amplitude: Stack) -> Stack:
    """Return the roughness in radians that counts for amplitude below its median."""
    faint = np.clip(amplitude, np.float32(FAINTEST), np.float32(1))
    return (FADING * (1 / faint - 1)).astype(np.float32)


def roughness(step: Stack, axis: int, empty: Mask, valid: Mask, noise: float) -> Stack:
    """Return how much steps change along their own axis, averaged over a box, less the noise.

    D = |g(j+1) - g(j)| + |g(j) - g(j-1)|, where a missing neighbour counts as the other one, and
    2 |g| where there is none; the root of the mean of D^2 over the valid steps of the box, less
    what noise alone makes of it: its mean over the empty field, else that of white noise.
    """
    if step.shape[axis] == 1:
        twice, of_noise = 2 * np.abs(step), OF_ONE_STEP
    else:
        twice, of_noise = change_on_both_sides(step, axis, valid), OF_TWO_CHANGES
    change = (twice * twice).astype(np.float32)
    known = empty & valid
    floor = of_noise * noise**2
    if np.count_nonzero(known) >= ENOUGH:
        floor = float(change[known].mean())
    width = [BOX if n >= BOX else 1 for n in step.shape]
    if valid.all():
        mean = ndimage.uniform_filter(change, width, mode="reflect")
    else:
        weight = valid.astype(np.float32)
        counted = ndimage.uniform_filter(weight, width, mode="reflect")
        mean = ndimage.uniform_filter(change * weight, width, mode="reflect")
        mean /= np.maximum(counted, np.float32(LEAST_WEIGHT))
    rough: Stack = np.sqrt(np.maximum(mean - np.float32(floor), np.float32(0)))
    return rough


def change_on_both_sides(step: Stack, axis: int, valid: Mask) -> Stack:
    """Return |g(j+1) - g(j)| + |g(j) - g(j-1)|, a missing one replaced by the other.

    2 |g| where both are missing.
    """
    n = step.shape[axis]
    lines = (math.prod(step.shape[:axis]), n, math.prod(step.shape[axis + 1 :]))
    change = np.zeros(lines, dtype=np.float32)
    count = np.zeros(lines, dtype=np.int8)
    along, known = step.reshape(lines), np.ascontiguousarray(valid).reshape(lines)
    between = np.abs(along[:, 1:] - along[:, :-1])
    both = known[:, 1:] & known[:, :-1]
    between *= both
    change[:, 1:] += between
    change[:, :-1] += between
    count[:, 1:] += both
    count[:, :-1] += both
    change[count == 1] *= 2
    alone = count == 0
    change[alone] = 2 * np.abs(along[alone])
    return change.reshape(step.shape)
