"""Steps between neighbours, what turns they ask for, and how far each is to be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import on_all_cores
from napari_phase4d.unwrapping.directional.links import link_map
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
#: Followed steps count where they are steadier than this, in radians.
FOLLOWED = 1.0
#: A spatial step beyond this many radians makes a start of following as doubtful as roughness.
STEEP = 1.5

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
        The step in radians, without its sign; infinite where two opinions on it differ.
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
    start: int,
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
    start : int
        Time from which spatial steps are followed.
    """
    parts: dict[int, list[tuple[Any, ...]]] = {}

    def work(axis: int) -> None:
        head, tail = ends_along(axis, 4)
        difference = phase[tail] - phase[head]
        valid = usable[head] & usable[tail] & (seams[head] == seams[tail])
        bare = empty[head] & empty[tail]
        step = difference - TURN * np.round(difference / TURN)
        plain = step
        if axis < 2:
            step = link_map(step, valid, bare)
        rough = roughness(step, axis, bare, valid, noise)
        if amplitude is not None:
            rough += fading(np.minimum(amplitude[head], amplitude[tail]))
        kept = valid & (nodes[head] != nodes[tail])
        sizes = np.abs(step)
        parts[axis] = []
        if axis >= 2 and phase.shape[0] > 1:
            followed, doubt = follow_steps(step, valid, bare, rough, noise, start)
            if amplitude is not None:
                doubt += fading(np.minimum(amplitude[head], amplitude[tail]))
            other = kept & (np.abs(followed - step) > 1.0) & (doubt < FOLLOWED)
            sizes = np.where(other, np.float32(np.inf), sizes)
            parts[axis].append(listed(nodes, difference, followed, sizes, doubt, other, axis))
        parts[axis].insert(0, listed(nodes, difference, step, sizes, rough, kept, axis))

    on_all_cores(work, [axis for axis in range(4) if phase.shape[axis] > 1])
    if not parts:
        none = np.zeros(0, dtype=np.int32)
        return Steps(none, none, none, none.astype(np.float32), none.astype(np.float32))
    in_order = [columns for axis in sorted(parts) for columns in parts[axis]]
    return Steps(*(np.concatenate(columns) for columns in zip(*in_order, strict=True)))


def listed(
    nodes: NDArray[np.int32],
    difference: Stack,
    step: Stack,
    size: Stack,
    rough: Stack,
    kept: Mask,
    axis: int,
) -> tuple[Any, ...]:
    """Return the columns of `Steps` for those steps of one axis that are kept."""
    head, tail = ends_along(axis, 4)
    turns = np.round((step[kept] - difference[kept]) / TURN).astype(np.int32)
    return nodes[head][kept], nodes[tail][kept], turns, size[kept], rough[kept]


def follow_steps(
    step: Stack, valid: Mask, bare: Mask, rough: Stack, noise: float, start: int
) -> tuple[Stack, Stack]:
    """Follow spatial steps along time from a frame where they are small.

    Returns
    -------
    followed : ndarray
        The step at ``start`` plus all its changes since, radians.
    doubt : ndarray
        The largest roughness met on the way, radians.
    """
    change = np.diff(step, axis=0)
    change -= TURN * np.round(change / TURN)
    both = valid[1:] & valid[:-1]
    squared = np.where(both, change * change, np.float32(0))
    known = (bare[1:] & bare[:-1]) & both
    floor = float(squared[known].mean()) if np.count_nonzero(known) >= ENOUGH else 4 * noise**2
    width = [1, 1, BOX, BOX]
    weight = ndimage.uniform_filter(both.astype(np.float32), width, mode="reflect")
    mean = ndimage.uniform_filter(squared, width, mode="reflect")
    mean /= np.maximum(weight, np.float32(LEAST_WEIGHT))
    unsteady = 2 * np.sqrt(np.maximum(mean - np.float32(floor), np.float32(0)))
    unsteady = np.where(both, unsteady, np.float32(np.inf))
    followed, doubt = np.empty_like(step), np.empty_like(rough)
    followed[start] = step[start]
    doubt[start] = rough[start] + np.maximum(np.abs(step[start]) - np.float32(STEEP), 0)
    for t in range(start + 1, len(step)):
        followed[t] = followed[t - 1] + change[t - 1]
        doubt[t] = np.maximum(doubt[t - 1], unsteady[t - 1])
    for t in range(start - 1, -1, -1):
        followed[t] = followed[t + 1] - change[t]
        doubt[t] = np.maximum(doubt[t + 1], unsteady[t])
    return followed, doubt


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
