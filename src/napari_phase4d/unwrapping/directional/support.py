"""How well the steps support a result: the way to each pixel, and what holds it there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping.background import turned
from napari_phase4d.unwrapping.directional.field import NOISY, Field
from napari_phase4d.unwrapping.directional.merging import held_by_steps
from napari_phase4d.unwrapping.directional.methods import prepared
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registration import moved
from napari_phase4d.unwrapping.spatial import border_medians

__all__ = ["Support", "astray", "roughest_on_the_way", "support_by_steps"]

TURN = np.float32(2 * np.pi)
#: What has no way to the empty field is as rough as this, in radians.
NO_WAY = 12.0
#: Variance of what a noisy pixel and the average of its neighbours differ by, as a share of that
#: of the noise. Fitted to one half of the moving cells, at noises of 0.7 and 0.9 rad.
APART = 1.7

Stack = NDArray[np.float32]
Whole = NDArray[np.int32]


@dataclass(frozen=True)
class Support:
    """What the steps say of each pixel of a result.

    Parameters
    ----------
    roughest : ndarray of shape (time, angle, y, x)
        The roughest step, in radians, on the smoothest way from the empty field.
    held : ndarray, same shape
        From -1 to 1: how firmly the steps hold the parts that the pixel belongs to against a turn
        more or less, see `held_by_steps`.
    """

    roughest: Stack
    held: Stack


def support_by_steps(
    problem: Problem,
    unwrapped: Stack,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Support:
    """Return how well the steps support each pixel of a result.

    A way goes along steps over time, angle, y and x, and only along those that a result agrees
    with: whose wrap count is the one that directional L1 would give them. Of all ways from the
    empty field the one whose roughest step is smoothest counts (a bottleneck path). Where the
    phase of a whole object hangs on rough steps alone, or where a result contradicts smooth steps,
    it is rough. A smooth way may lead into a part by accident; then most other steps at its rim
    are against it, or for nothing, and it is not held.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    unwrapped : ndarray of shape (time, angle, y, x)
        A result of any method, radians; NaN counts as empty field.
    progress, cancelled : callable, optional
        See `unwrap`.
    """
    field = prepared(problem, progress, cancelled)
    steps = field.steps
    turns = turns_of_nodes(field, problem, unwrapped)
    off = turns[steps.second] - turns[steps.first] - steps.turns
    worst, held = held_by_steps(
        steps.first, steps.second, off, steps.roughness, len(turns), NO_WAY
    )
    return Support(
        np.clip(of_pixels(field, worst), np.float32(0), np.float32(NO_WAY)),
        of_pixels(field, held),
    )


def roughest_on_the_way(
    problem: Problem,
    unwrapped: Stack,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Stack:
    """Return how rough the best way from the empty field to each pixel gets, in radians.

    Parameters
    ----------
    problem, unwrapped, progress, cancelled
        See `support_by_steps`.
    """
    return support_by_steps(problem, unwrapped, progress, cancelled).roughest


def astray(
    problem: Problem,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Stack:
    """Return the chance that the noise of a pixel alone takes it more than half a turn away.

    Where its neighbours, averaged along the slope, say e radians else than the pixel, the two
    differ by e or by e - 2 pi. For a normal distribution of variance v the odds of the latter are
    exp(-((2 pi - e)^2 - e^2) / (2 v)); v is 1.7 times that of the noise, as the average is noisy
    too. 0 where there is too little noise to be averaged.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    progress, cancelled : callable, optional
        See `unwrap`.
    """
    field = prepared(problem, progress, cancelled)
    noise = field.frames.noise
    if noise < NOISY:
        return np.zeros(problem.wrapped.shape, dtype=np.float32)
    away = np.abs(turned(moved(field.frames.phase, field.shifts) - field.phase))
    odds = np.exp((away - np.float32(np.pi)) * np.float32(2 * np.pi / (APART * noise**2)))
    return field.at_all_times(moved(odds / (1 + odds), -field.shifts))


def of_pixels(field: Field, of_nodes: Stack) -> Stack:
    """Return what nodes have on all pixels of all times."""
    return field.at_all_times(moved(of_nodes[field.nodes], -field.shifts))


def turns_of_nodes(field: Field, problem: Problem, unwrapped: Stack) -> Whole:
    """Return the wrap count of every node in a result, relative to each frame's empty field."""
    background = problem.background()
    level = background.ground(border_medians(background.level, problem.first))
    kept = field.frames.kept
    steady = (unwrapped - level)[kept]
    turns = np.round((moved(steady, field.shifts) - field.phase) / TURN)
    known = np.isfinite(turns)
    turns = np.where(known, turns, 0).astype(np.int32)
    empty = moved(field.frames.empty, field.shifts) & known
    for frame in np.ndindex(*turns.shape[:2]):
        if empty[frame].any():
            off = np.int32(np.median(turns[frame][empty[frame]]))
            turns[frame] -= off * known[frame]
    found = np.zeros(len(field.values), dtype=np.int32)
    found[field.nodes] = turns
    found[: field.n_islands] = 0
    return found
