"""Directional growing and directional L1: this project's own unwrappers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, watched
from napari_phase4d.unwrapping.directional.field import Field, finished_phase, prepare
from napari_phase4d.unwrapping.directional.least_turns import (
    Limit,
    growing,
    least_turns,
    weight_of,
)
from napari_phase4d.unwrapping.directional.steps import fading
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["directional_growing", "directional_l1"]

TURN = np.float32(2 * np.pi)
Stack = NDArray[np.float32]
Whole = NDArray[np.int32]

#: A pixel lies below the empty field if its phase is under it by this many radians and twice the
#: noise; each turn below costs as much as a step of so much roughness, in radians, disagreed with.
BELOW, AS_ROUGH_AS = 0.5, 2.0
#: An object is denser than what is round it if this share of what differs by half a turn is.
NEARLY_ALL = 0.9


def directional_growing(
    problem: Problem, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> Stack:
    """Join pixels over time, angle, y and x, first where steps change least along themselves."""
    watch = Watch(5, "directional growing", progress, cancelled)
    field = problem.once("field", lambda: prepare(problem, watch))
    parts, turns = watched(lambda: grown(field), watch)
    watch.step()
    result = finished_phase(field, turns, parts, problem, watch)
    watch.step()
    return result


def directional_l1(
    problem: Problem,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    one_sided: bool = True,
) -> Stack:
    """Find the turns that disagree least with all steps, each weighted by its smoothness."""
    watch = Watch(6, "directional L1", progress, cancelled)
    field = problem.once("field", lambda: prepare(problem, watch))
    parts, start = watched(lambda: grown(field), watch)
    watch.step()
    turns = watched(lambda: least_turns(field.steps, start, watch.check, None, field.n_islands), watch)
    watch.step()
    if one_sided:
        turns = watched(lambda: sided(field, turns, parts, watch), watch)
    result = finished_phase(field, turns, parts, problem, watch)
    watch.step()
    return result


def grown(field: Field) -> tuple[Whole, Whole]:
    """Return the part that each node belongs to, and its turns; none at the empty field."""
    parts, turns = growing(field.steps, len(field.values))
    return parts, turns - np.where(parts == parts[0], turns[0], 0).astype(np.int32)


def sided(field: Field, turns: Whole, parts: Whole, watch: Watch) -> Whole:
    """Solve again with a price on lying on the other side of the empty field than the rest.

    Nearly all cells are denser than what they lie in, everywhere. At a rim that is steeper than
    half a turn a pixel, the steps alone can't tell a phase of 5 rad from one of 5 - 2 pi.
    """
    unwrapped = field.values + TURN * turns.astype(np.float32)
    clear = np.abs(unwrapped) > 2 * np.pi
    clear &= parts == parts[0]
    if not clear.any():
        return turns
    positive = float((unwrapped[clear] > 0).mean())
    if 1 - NEARLY_ALL < positive < NEARLY_ALL:
        return turns
    if positive <= 1 - NEARLY_ALL:
        mirrored = replace(field.steps, turns=-field.steps.turns)
        limit = not_below(-field.values, field, parts)
        return -least_turns(mirrored, -turns, watch.check, limit, field.n_islands)
    limit = not_below(field.values, field, parts)
    return least_turns(field.steps, turns, watch.check, limit, field.n_islands)


def not_below(values: Stack, field: Field, parts: Whole) -> Limit:
    """Return the price on phase below the empty field, where a part is joined to it."""
    allowed = BELOW + 2 * field.background.noise
    lowest = np.ceil((-allowed - values) / TURN).astype(np.int32)
    rough = np.full(len(values), AS_ROUGH_AS, dtype=np.float32)
    if field.amplitude is not None:
        rough += fading(field.amplitude)
    weight = np.where(parts == parts[0], weight_of(rough), 0.0)
    weight[: field.n_islands] = 0.0
    return Limit(lowest, weight)
