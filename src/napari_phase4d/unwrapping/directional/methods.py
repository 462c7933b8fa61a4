"""Directional growing and directional L1: this project's own unwrappers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, watched
from napari_phase4d.unwrapping.directional.field import Field, finished_phase, prepare
from napari_phase4d.unwrapping.directional.least_turns import LeastTurns, Limit
from napari_phase4d.unwrapping.directional.regions import grown, regions_of, weight_of
from napari_phase4d.unwrapping.directional.steps import fading
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.sharing import FIELD

__all__ = ["directional_growing", "directional_l1", "prepared"]

TURN = np.float32(2 * np.pi)
Stack = NDArray[np.float32]
Whole = NDArray[np.int32]
Turns = NDArray[np.int64]

#: A pixel lies beyond the empty field if its phase does so by this many radians and twice the
#: noise; each turn beyond costs as much as a step of so much roughness, in radians, that is off.
BEYOND, AS_ROUGH_AS = 0.5, 2.0
#: Only regions of so few pixels pay, as many as a cube of three: the price is for rims, not for
#: what many steps hold.
RIM = 27
#: Largest share of the object's pixels that the price may move.
MOST = 0.5
#: An object lies on one side of the empty field if this share of what is a turn off does.
NEARLY_ALL = 0.9


def directional_growing(
    problem: Problem, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> Stack:
    """Join pixels over time, angle, y and x, first where steps change least along themselves.

    A step is trusted by how little it differs from the steps before and behind it in its own
    direction, so that a slope counts as smooth however steep it is.
    Region growing (Abdul-Rahman et al. 2007) trusts pixels by second differences in all
    directions instead.
    """
    field = prepared(problem, progress, cancelled)
    watch = Watch(1, "directional growing", progress, cancelled)
    n = len(field.values)
    parts, turns = watched(lambda: grown(field.steps, n, field.n_islands), watch)
    watch.step()
    return finished_phase(field, turns, parts, problem, progress, cancelled)


def prepared(
    problem: Problem, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> Field:
    """Return what both methods start from, computed once for a problem."""
    watch = Watch(3, "weighing the steps", progress, cancelled)
    return problem.once(FIELD, lambda: prepare(problem, watch))


def directional_l1(
    problem: Problem,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    one_sided: bool = True,
) -> Stack:
    """Find the turns that disagree least with all steps, each weighted by its smoothness.

    With J the turns of a step that Itoh's condition would give and D its roughness in radians,
    the sum of (0.5 + D)^-6 |k_q - k_p - J| over all steps is made smallest.

    Parameters
    ----------
    problem : Problem
        What to unwrap.
    progress, cancelled : callable or None
        See `unwrap`.
    one_sided : bool, optional
        Whether to prefer, where steps can't tell, that the object lies on one side of the empty
        field: nowhere thinner optically, or nowhere denser. Default True.
    """
    field = prepared(problem, progress, cancelled)
    watch = Watch(3, "directional L1", progress, cancelled)
    regions = watched(lambda: regions_of(field.steps, len(field.values), field.n_islands), watch)
    watch.step()
    solver = watched(lambda: LeastTurns(regions, watch.check), watch)
    parts, start = watched(solver.start, watch)
    plain = watched(lambda: solver.descend(start), watch)
    watch.step()
    of_node = parts[regions.of_node]
    turns = solver.of_nodes(plain)
    if one_sided:
        turns = watched(lambda: on_one_side(field, solver, plain, of_node), watch)
    watch.step()
    return finished_phase(field, turns.astype(np.int32), of_node, problem, progress, cancelled)


def on_one_side(field: Field, solver: LeastTurns, plain: Turns, parts: Whole) -> Turns:
    """Return the turns of every node, after lying on the wrong side has had its price."""
    before = solver.of_nodes(plain)
    sizes = np.bincount(solver.regions.of_node)
    small = sizes[solver.regions.of_node] <= RIM
    limit = side_of_object(field, before, parts, small)
    if limit is None:
        return before
    after = solver.of_nodes(solver.descend(plain, limit))
    object_ = parts == parts[0]
    object_[: field.n_islands] = False
    moved = (after != before)[object_]
    # If most of it moves, the side was mistaken.
    return before if moved.mean() > MOST else after


def side_of_object(
    field: Field, turns: Turns, parts: Whole, small: NDArray[np.bool_]
) -> Limit | None:
    """Return the price of lying on the other side of the empty field than nearly all else.

    Nearly all cells are denser than what they lie in, everywhere. At a rim that is steeper than
    half a turn a pixel, the steps alone can't tell a phase of 5 rad from one of 5 - 2 pi.
    """
    joined = parts == parts[0]
    unwrapped = field.values + TURN * turns.astype(np.float32)
    clear = joined & (np.abs(unwrapped) > TURN)
    positive = float((unwrapped[clear] > 0).mean()) if clear.any() else 0.5
    if 1 - NEARLY_ALL < positive < NEARLY_ALL:
        return None
    side = 1 if positive > 0.5 else -1
    allowed = BEYOND + 2 * field.frames.noise
    free = side * np.ceil((-allowed - side * field.values.astype(np.float64)) / (2 * np.pi))
    rough = np.full(len(field.values), AS_ROUGH_AS, dtype=np.float32)
    if field.amplitude is not None:
        rough += fading(field.amplitude)
    weight = np.where(joined & small, weight_of(rough), 0.0)
    weight[: field.n_islands] = 0.0
    return Limit(free.astype(np.int64), weight, side)
