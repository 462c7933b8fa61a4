"""How well the steps support a result: the roughest step on the smoothest way to each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping.directional.field import Field
from napari_phase4d.unwrapping.directional.methods import prepared
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registration import moved
from napari_phase4d.unwrapping.spatial import border_medians

__all__ = ["roughest_on_the_way"]

TURN = np.float32(2 * np.pi)
#: What has no way to the empty field is as rough as this, in radians.
NO_WAY = 12.0

Stack = NDArray[np.float32]
Whole = NDArray[np.int32]


def roughest_on_the_way(
    problem: Problem,
    unwrapped: Stack,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Stack:
    """Return how rough the best way from the empty field to each pixel gets, in radians.

    A way goes along steps over time, angle, y and x, and only along those that a result agrees
    with: whose wrap count is the one that directional L1 would give them. Of all ways the one
    whose roughest step is smoothest counts (a bottleneck path). Where the phase of a whole object
    hangs on rough steps alone, or where a result contradicts smooth steps, it is large.

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
    agrees = turns[steps.second] - turns[steps.first] == steps.turns
    first, second, rough = (c[agrees] for c in (steps.first, steps.second, steps.roughness))
    worst = np.full(len(turns), NO_WAY, dtype=np.float32)
    merge_in_order(np.argsort(rough), first, second, rough, worst)
    everywhere = field.at_all_times(moved(worst[field.nodes], -field.shifts))
    return np.clip(everywhere, np.float32(0), np.float32(NO_WAY))


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


@compiled
def merge_in_order(
    order: NDArray[np.intp], first: Whole, second: Whole, rough: Stack, worst: Stack
) -> None:
    """Join nodes, smoothest steps first, and note when each joins that of node 0."""
    n = len(worst)
    parent = np.arange(n)
    following = np.arange(n)  # the members of a component in a ring
    size = np.ones(n, dtype=np.int64)
    worst[0] = 0
    for i in order:
        a, b = first[i], second[i]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a == b:
            continue
        ground = parent[0]
        while parent[ground] != ground:
            ground = parent[ground]
        if ground in (a, b):
            joins = b if a == ground else a
            member = joins
            while True:
                worst[member] = rough[i]
                member = following[member]
                if member == joins:
                    break
        if size[a] < size[b]:
            a, b = b, a
        parent[b] = a
        size[a] += size[b]
        following[a], following[b] = following[b], following[a]
