"""Steps between neighbours, what turns they ask for, and how far each is to be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.progress import on_all_cores
from napari_phase4d.unwrapping.background import turned
from napari_phase4d.unwrapping.directional.boxes import change_on_both_sides, known_mean
from napari_phase4d.unwrapping.directional.links import link_map
from napari_phase4d.unwrapping.ends import ends_along

__all__ = ["Steps", "all_steps", "fading"]

TURN = np.float32(2 * np.pi)
#: Fewest steps of the empty field from which the noise floor is taken.
ENOUGH = 50
#: Mean of D^2 for white noise of one radian: 12 + 2 * 4.7 where there are two changes, which share
#: two thirds of their noise, and 4 * 2 where there is a single step.
OF_TWO_CHANGES, OF_ONE_STEP = 21.4, 8.0
#: Amplitude, as a share of its median, below which fading does not grow; and the roughness in
#: radians that half the median stands for. Any value from 0.5 to 4 does about as well.
FAINTEST, FADING = 0.05, 2.0
HALF_A_TURN = np.float32(np.pi)
#: Followed steps count where they are steadier than this, in radians.
FOLLOWED = 3.0
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
    left: Stack | None,
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
    left : ndarray of float, same shape, or None
        Share of the noise's variance that is left at each pixel; None where it is all.
    start : int
        Time from which spatial steps are followed.
    """
    parts: dict[int, list[tuple[Any, ...]]] = {}

    def work(axis: int) -> None:
        head, tail = ends_along(axis, 4)
        difference = phase[tail] - phase[head]
        inside = usable[head] & usable[tail]
        valid = inside & (seams[head] == seams[tail])
        bare = empty[head] & empty[tail]
        step = turned(difference)
        if axis < 2:
            step = link_map(step, inside, bare)
        faint = 0 if amplitude is None else fading(np.minimum(amplitude[head], amplitude[tail]))
        rough = roughness(step, axis, bare, valid, noise) + faint
        kept = valid & (nodes[head] != nodes[tail])
        size = np.abs(step)
        parts[axis] = [listed(nodes, difference, step, size, rough, kept, axis)]
        if axis >= 2 and len(phase) > 1:
            share = None if left is None else 0.5 * (left[head] + left[tail])
            followed, doubt = follow_steps(step, rough, valid, bare, noise, share, start)
            other = kept & (np.abs(followed - step) > HALF_A_TURN) & (doubt + faint < FOLLOWED)
            if other.any():
                size[other] = np.inf
                parts[axis] = [
                    listed(nodes, difference, step, size, rough, kept, axis),
                    listed(nodes, difference, followed, size, doubt + faint, other, axis),
                ]

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
    step: Stack,
    rough: Stack,
    valid: Mask,
    bare: Mask,
    noise: float,
    left: Stack | None,
    start: int,
) -> tuple[Stack, Stack]:
    """Follow spatial steps along time from a frame where they are small.

    A wall that grows through half a turn looks smooth again near a whole one. Its step a moment
    before was smaller and is known; what it has changed since is small and is known as well.

    Parameters
    ----------
    step : ndarray of shape (time, angle, y, x)
        Wrapped steps along y or x, radians.
    rough : ndarray, same shape
        Their roughness in radians.
    valid, bare : ndarray of bool, same shape
        Steps that count; those of the empty field.
    noise : float
        Standard deviation of the phase's noise in radians.
    start : int
        Time at which the object is thin.

    Returns
    -------
    followed : ndarray
        The step at ``start`` plus all its changes since, radians.
    doubt : ndarray
        The largest roughness met on the way, radians: of the step itself at the start, and
        twice the root mean square change, over 3 x 3 steps, of every change since, less the noise.
    """
    known = valid[1:] & valid[:-1]
    squares = turned(step[1:] - step[:-1])
    squares *= squares * known
    ground = bare[1:] & bare[:-1] & known
    floor = float(squares[ground].mean()) if np.count_nonzero(ground) >= ENOUGH else 4 * noise**2
    mean = known_mean(squares, known, axes=(2, 3))
    if left is not None:
        # Where things move fast less noise was averaged out than on the empty field.
        share = 0.5 * (left[1:] + left[:-1])
        usual = float(share[ground].mean()) if ground.any() else 1.0
        mean -= np.float32(floor / usual) * share
        floor = 0.0
    followed, doubt = np.empty_like(step), np.empty_like(step)
    followed[start] = step[start]
    doubt[start] = rough[start] + np.maximum(np.abs(step[start]) - np.float32(STEEP), 0)

    def lines(part: NDArray[Any]) -> NDArray[Any]:
        return part.reshape(len(part), -1)

    follow_lines(
        lines(step), lines(mean), lines(known), lines(followed), lines(doubt), start, floor
    )
    return followed, doubt


@compiled
def follow_lines(
    step: Stack,
    square: Stack,
    known: Mask,
    followed: Stack,
    doubt: Stack,
    start: int,
    floor: float,
) -> None:
    """Do `follow_steps` for steps (time, place), away from the start in both directions."""
    n = len(step)
    turn = np.float32(2 * np.pi)
    for way in (1, -1):
        t = start
        while 0 <= t + way < n:
            link = min(t, t + way)
            for i in range(step.shape[1]):
                change = step[t + way, i] - step[t, i]
                change -= turn * np.round(change / turn)
                followed[t + way, i] = followed[t, i] + change
                unsteady = np.float32(2 * math.sqrt(max(square[link, i] - floor, 0.0)))
                if not known[link, i]:
                    unsteady = np.float32(np.inf)
                doubt[t + way, i] = max(doubt[t, i], unsteady)
            t += way


def fading(amplitude: Stack) -> Stack:
    """Return the roughness in radians that counts for amplitude below its median."""
    faint = np.clip(amplitude, np.float32(FAINTEST), np.float32(1))
    return (FADING * (1 / faint - 1)).astype(np.float32)


def roughness(step: Stack, axis: int, bare: Mask, valid: Mask, noise: float) -> Stack:
    """Return how much steps change along their own axis, averaged over a box, less the noise.

    D = |g(j+1) - g(j)| + |g(j) - g(j-1)|, where a missing neighbour counts as the other one, and
    2 |g| where there is none; the root of the mean of D^2 over the valid steps of the box, less
    what noise alone makes of it: its mean over the empty field, else that of white noise.
    """
    of_noise = OF_ONE_STEP if step.shape[axis] == 1 else OF_TWO_CHANGES
    squares = change_on_both_sides(step, axis, valid)
    known = bare & valid
    floor = of_noise * noise**2
    if np.count_nonzero(known) >= ENOUGH:
        floor = float(squares[known].mean())
    rough = known_mean(squares, valid)
    rough -= np.float32(floor)
    np.maximum(rough, 0, out=rough)
    np.sqrt(rough, out=rough)
    return rough
