"""Region growing as PhaseTools computes it (its build of 2015, the year of Barnhill et al.).

It differs from Abdul-Rahman et al. 2007 in three ways. The differences to the neighbours are not
wrapped, so that a pixel next to a wrap counts as unreliable. Missing neighbours multiply a
penalty. And what is meant as the edge to the next time joins pixels of one row: its other end is
found ``depth + 2`` pixels further in memory instead of one volume further. So no edge joins times,
unless a frame has fewer pixels than there are angles, and each is joined by itself.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block
from napari_phase4d.unwrapping.growing import Contracted, closed, grow_list

__all__ = ["grown_as_phasetools", "memory_edges", "penalised_differences", "times_touch"]

#: (first pixel, second pixel) of every edge, as flat indices.
Edges = tuple[NDArray[np.int64], NDArray[np.int64]]

TURN = 2 * np.pi
#: Penalty of a pair of opposite neighbours of which one, or both, are missing.
ONE_MISSING, BOTH_MISSING = 2.0, 4.0


def grown_as_phasetools(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    seen: Block,
    block: Block,
    threshold: float,
) -> tuple[Contracted, NDArray[np.int32], NDArray[np.int32]]:
    """Join the pixels of a block, whose edges join no times; returns what `contracted` does.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians of the frames of ``seen``.
    mask : ndarray of bool, same shape
        Pixels to join.
    seen, block : Block
        The frames that are given: those of the block with one more at least at either end, where
        there are any.
    threshold : float
        Step in radians beyond which a turn is added.
    """
    own = block.of(seen)
    unreliability = penalised_differences(wrapped, mask)[own].ravel()
    wrapped, mask = wrapped[own], mask[own]
    phase = np.mod(wrapped, np.float32(TURN))
    first, second = memory_edges(mask)
    change = phase.ravel()[second].astype(np.float64) - phase.ravel()[first]
    steps = (change < -threshold).astype(np.int32) - (change > threshold)
    # Infinite where a pixel has no neighbour; such a step is taken last.
    cost = unreliability[first] + unreliability[second]
    parts, turns, _ = grow_list(first, second, steps, cost, phase.size, overwrite=True)
    lifted = np.round((phase - wrapped) / np.float32(TURN)).astype(np.int32)
    return closed(block, lifted + turns.reshape(mask.shape), parts.reshape(mask.shape), mask)


def times_touch(shape: tuple[int, ...]) -> bool:
    """Say whether some edges may join pixels of different times, in frames of very few pixels."""
    _, depth, height, width = (n + 2 for n in shape)
    return depth > 2 * height * width


def penalised_differences(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the unreliability of every pixel of a stack (time, angle, y, x).

    Over the 40 pairs of opposite neighbours, with differences d1, d2 of the phase in [0, 2 pi):
    the sum of sqrt(d1^2 + d2^2), or of |d| where one neighbour is missing, times the penalties.
    Infinite where all neighbours are missing.
    """
    phase = np.where(mask, np.mod(wrapped.astype(np.float64), TURN), np.nan)
    padded = np.pad(phase, 1, constant_values=np.nan)
    total, penalty = np.zeros(phase.shape), np.ones(phase.shape)
    seen = np.zeros(phase.shape, dtype=bool)
    offsets = [o for o in itertools.product((-1, 0, 1), repeat=4) if o > (0, 0, 0, 0)]
    for offset in offsets:
        ahead = np.abs(padded[window(offset, 1)] - phase)
        behind = np.abs(padded[window(offset, -1)] - phase)
        missing = np.isnan(ahead).astype(int) + np.isnan(behind)
        total += np.hypot(np.nan_to_num(ahead), np.nan_to_num(behind))
        penalty *= np.choose(missing, (1.0, ONE_MISSING, BOTH_MISSING))
        seen |= missing < 2
    found = total * penalty
    found[~seen] = np.inf
    return found


def window(offset: tuple[int, ...], sign: int) -> tuple[slice, ...]:
    """Return where the neighbours in one direction lie in the padded stack."""
    shifts = [1 + sign * o for o in offset]
    return tuple(slice(s, s - 2 or None) for s in shifts)


def memory_edges(mask: NDArray[np.bool_]) -> Edges:
    """Return the edges as they lie in memory: along x, y, angle, and ``depth + 2`` pixels on.

    Indices are those of the stack (time, angle, y, x).
    """
    padded = np.pad(mask, 1).ravel()
    index = np.pad(np.arange(mask.size).reshape(mask.shape), 1).ravel()
    _, depth, height, width = (n + 2 for n in mask.shape)
    first, second = [], []
    for step in (1, width, width * height, depth):
        both = padded[:-step] & padded[step:]
        first.append(index[:-step][both])
        second.append(index[step:][both])
    return np.concatenate(first), np.concatenate(second)
