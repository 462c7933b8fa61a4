"""Region growing on a grid: reliability sorting without sorting.

Herraez et al. 2002 (two dimensions) and Abdul-Rahman et al. 2007 (three): neighbours are joined
in the order of the cost of the step between them; when two groups meet, one is shifted by whole
turns so that this step is no larger than half a turn. That is Kruskal's construction of the tree
of cheapest steps, and the result is what integrating along that tree gives. The same tree is
reached in quicker ways:

1. without residues every way leads to the same result (`smooth`, tried before);
2. below the cost of the cheapest residue the order makes no difference (`residues`, `marks`), and
   the cheapest step of every pixel is always in the tree: these are joined at once (`joining`);
3. of the steps that are left, first the cheaper ones, then all, go through Boruvka's rounds
   (`between`, `boruvka`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from napari_phase4d.progress import nothing
from napari_phase4d.unwrapping.growing.between import count_between, list_between
from napari_phase4d.unwrapping.growing.boruvka import join_cheapest, pass_on
from napari_phase4d.unwrapping.growing.costs import Costs
from napari_phase4d.unwrapping.growing.joining import joined
from napari_phase4d.unwrapping.growing.marks import mark_cheap, mark_cheapest_of_each
from napari_phase4d.unwrapping.growing.residues import residue_limit
from napari_phase4d.unwrapping.growing.rows import Floats, Phase, Whole
from napari_phase4d.unwrapping.growing.workspace import Workspace

__all__ = ["grown_turns"]

#: Half a turn: the largest step between neighbours, in radians.
HALF = np.pi
#: With more residues than this share of the pixels, a limit below them holds too few steps.
MOST_RESIDUES = 0.02
#: So often is the limit halved before it is given up.
MOST_TRIES = 3
#: With more steps left between groups than this share of the pixels, cheaper ones go first.
MANY_LEFT = 0.25
#: Share of steps that go first, by number of dimensions: just enough to hold most of a grid
#: together (bond percolation needs 0.5, 0.249 and 0.160).
CHEAPER_SHARE = {1: 1.0, 2: 0.6, 3: 0.35, 4: 0.25}
#: Every so manieth pixel is looked at to find how much the cheaper steps cost.
SAMPLE = 37


def grown_turns(
    wrapped: Phase, costs: Costs, work: Workspace, check: Callable[[], None] = nothing
) -> tuple[Whole, Whole | None]:
    """Return the turns that joining along the cheapest steps first gives every pixel.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (rows, nx)
        Wrapped phase in radians.
    costs : Costs
        What its steps cost.
    work : Workspace
        Memory to work in; the results lie in it until it is used again.
    check : callable, optional
        Called between stages; may raise to stop.

    Returns
    -------
    turns : ndarray of int32, shape (rows, nx)
        Turns to add; every separate part has its own open number.
    parts : ndarray of int32, shape (rows, nx), or None
        Number of the part that each pixel belongs to; those left out are parts of their own.
        None if all belong together.
    """
    group = work.array("group", wrapped.shape, np.int32)
    turns = work.array("turns", wrapped.shape, np.int32)
    n = joined_at_once(wrapped, costs, group, turns, work, check)
    left = count_between(*costs.arguments, np.inf, group)
    several = left > MANY_LEFT * group.size
    for below in (cheaper_cost(costs), np.inf) if several else (np.inf,):
        check()
        listed = steps_between(wrapped, costs, below, group, turns, work)
        if len(listed[0]):
            of_group, turns_of_group, n = join_cheapest(*listed, n, check)
            pass_on(group.ravel(), turns.ravel(), of_group, turns_of_group)
    return turns, group if n > 1 else None


def joined_at_once(
    wrapped: Phase,
    costs: Costs,
    group: Whole,
    turns: Whole,
    work: Workspace,
    check: Callable[[], None],
) -> int:
    """Join what can be joined in any order, and return how many groups there are."""
    most = int(MOST_RESIDUES * wrapped.size)
    limit = residue_limit(wrapped, HALF, *costs.arguments, most)
    marks = work.array("marks", wrapped.shape, np.uint8)
    for attempt in range(MOST_TRIES + 1):
        check()
        marks[:] = 0
        trusted = limit if attempt < MOST_TRIES and limit > 0 else 0.0
        if trusted:
            mark_cheap(*costs.arguments, trusted, marks)
        mark_cheapest_of_each(*costs.arguments, trusted, marks)
        count = joined(wrapped, costs.shape, HALF, marks, group, turns)
        if count >= 0:
            break
        limit /= 2
    return count


def cheaper_cost(costs: Costs) -> float:
    """Return the cost below which about the wanted share of all steps lies."""
    dims = sum(n > 1 for n in costs.shape)
    every = SAMPLE if costs.shape[3] % SAMPLE else SAMPLE + 2  # not the same columns in all rows
    some = costs.steps.ravel()[::every] if costs.steps.size else 2 * costs.point.ravel()[::every]
    known = some[np.isfinite(some)]
    return float(np.quantile(known, CHEAPER_SHARE[dims])) if known.size else np.inf


def steps_between(
    wrapped: Phase, costs: Costs, below: float, group: Whole, turns: Whole, work: Workspace
) -> tuple[Whole, Whole, Whole, Floats]:
    """List the steps between groups that cost less than ``below``."""
    n = (count_between(*costs.arguments, below, group),)
    first, second = work.array("first", n, np.int32), work.array("second", n, np.int32)
    between, cost = work.array("between", n, np.int32), work.array("cost", n, np.float64)
    if n[0]:
        list_between(
            wrapped, HALF, *costs.arguments, below, group, turns, first, second, between, cost
        )
    return first, second, between, cost
