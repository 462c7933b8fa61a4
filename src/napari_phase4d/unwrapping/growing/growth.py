"""Growing regions on grids and on lists of steps.

On a grid it is reliability sorting without sorting.

Herraez et al. 2002 (two dimensions) and Abdul-Rahman et al. 2007 (three): neighbours are joined
in the order of the cost of the step between them; when two groups meet, one is shifted by whole
turns so that this step is no larger than half a turn. That is Kruskal's construction of the tree
of cheapest steps, and the result is what integrating along that tree gives. The same tree is
reached in quicker ways:

1. without residues every way leads to the same result (`integrated`, tried before);
2. below the cost of the cheapest residue the order makes no difference (`residue_limit`,
   `mark_cheap`), and the cheapest step of every pixel is always in the tree: these are joined at
   once (`joined`);
3. of the steps that are left, first the cheaper ones, then all, go through Boruvka's rounds
   (`list_between`, `join_cheapest`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.task import nothing
from napari_phase4d.unwrapping.growing.costs import Costs, second_differences
from napari_phase4d.unwrapping.growing.merging import (
    count_between,
    join_cheapest,
    joined,
    list_between,
    mark_cheap,
    mark_cheapest_of_each,
    pass_on,
)
from napari_phase4d.unwrapping.growing.rows import (
    Floats,
    Phase,
    Whole,
    Workspace,
    full_shape,
    integrated,
    residue_limit,
)

__all__ = [
    "HALF",
    "MANY_LEFT",
    "CostsOf",
    "cheaper_cost",
    "check_size",
    "grow_grid",
    "grow_list",
    "grow_through_residues",
    "smooth_turns",
    "steps_between",
]

#: Pixels and steps are numbered with 32 bits.
LARGEST = 2**31 - 1
#: ``costs_of(wrapped, mask, work)`` gives the costs of a grid's steps.
CostsOf = Callable[[Phase, NDArray[np.bool_] | None, Workspace], Costs]


def grow_grid(
    wrapped: Phase,
    mask: NDArray[np.bool_] | None = None,
    costs_of: CostsOf = second_differences,
    work: Workspace | None = None,
    check: Callable[[], None] = nothing,
) -> tuple[Whole, Whole | None]:
    """Return the turns that joining neighbours along the cheapest steps first gives every pixel.

    Parameters
    ----------
    wrapped : ndarray of float32
        Wrapped phase in radians; one to four dimensions, the last two y and x.
    mask : ndarray of bool, same shape, optional
        Pixels to join; default all.
    costs_of : callable, optional
        ``costs_of(wrapped, mask, work)`` gives the costs of the steps; default
        `second_differences`, the reliability of Herraez et al. 2002.
    work : Workspace, optional
        Memory to work in; the results lie in it until it is used again.
    check : callable, optional
        Called between stages; may raise to stop.

    Returns
    -------
    turns : ndarray of int32, same shape
        Turns to add; every separate part has its own open number.
    parts : ndarray of int32, same shape, or None
        Number of the part that each pixel belongs to; those outside the mask are parts of their
        own. None if all belong together.
    """
    own = work is None
    work = Workspace() if work is None else work
    turns = smooth_turns(wrapped, work) if mask is None or mask.all() else None
    if turns is not None:
        return turns, None
    check()
    turns, parts = grow_through_residues(wrapped, mask, costs_of, work, check)
    if own:
        work.clear()
    return turns, parts


def grow_through_residues(
    wrapped: Phase,
    mask: NDArray[np.bool_] | None,
    costs_of: CostsOf,
    work: Workspace,
    check: Callable[[], None] = nothing,
) -> tuple[Whole, Whole | None]:
    """Do the same as `grow_grid`, for a grid that is known to have residues or a mask."""
    check_size(wrapped.size)
    # Kernels are compiled for arrays in order that may be written to; copies only where needed.
    wrapped = np.require(wrapped, np.float32, ["C", "W"])
    if mask is not None:
        mask = None if mask.all() else np.require(mask, bool, ["C", "W"])
    costs = costs_of(wrapped, mask, work)
    check()
    rows = wrapped.reshape(-1, wrapped.shape[-1])
    turns, parts = grown_turns(rows, costs, work, check)
    if parts is not None:
        parts = parts.reshape(wrapped.shape)
    return turns.reshape(wrapped.shape), parts


def check_size(n: int) -> None:
    """Raise ValueError for more pixels or steps than have numbers."""
    if n > LARGEST:
        msg = f"{n} pixels or steps are too many to grow at once; at most {LARGEST} are possible"
        raise ValueError(msg)


def smooth_turns(wrapped: Phase, work: Workspace) -> Whole | None:
    """Return the turns of every pixel of a grid if it has no residues, else None.

    Parameters
    ----------
    wrapped : ndarray of float32
        Wrapped phase in radians; one to four dimensions.
    work : Workspace
        Memory to work in; the result lies in it until it is used again.
    """
    shape = full_shape(wrapped.shape)
    rows = np.require(wrapped, np.float32, ["C", "W"]).reshape(-1, shape[3])
    turns: Whole = work.array("turns", rows.shape, np.int32)
    return turns.reshape(wrapped.shape) if integrated(rows, shape, np.pi, turns) else None


def grow_list(
    first: NDArray[np.integer],
    second: NDArray[np.integer],
    steps: NDArray[np.integer],
    cost: NDArray[np.floating],
    n: int,
    check: Callable[[], None] = nothing,
    *,
    overwrite: bool = False,
) -> tuple[Whole, Whole, int]:
    """Join nodes along the cheapest of a list of steps first.

    Parameters
    ----------
    first, second : ndarray of int, shape (n_steps,)
        The two nodes of every step.
    steps : ndarray of int, shape (n_steps,)
        Turns of the second node minus those of the first.
    cost : ndarray of float, shape (n_steps,)
        Cost of every step; equal ones are taken in their order, infinite ones last.
    n : int
        Number of nodes.
    check : callable, optional
        Called between rounds; may raise to stop.
    overwrite : bool, optional
        Whether the lists may be worked in, which saves their copies. Default False.

    Returns
    -------
    parts : ndarray of int32, shape (n,)
        Number of the part that each node belongs to, in the order of their first nodes.
    turns : ndarray of int32, shape (n,)
        Turns of every node relative to the first of its part.
    n_parts : int
        Number of parts.
    """
    check_size(len(cost))
    copy = None if overwrite else True
    a, b, turns = (
        np.array(column, dtype=np.int32, copy=copy) for column in (first, second, steps)
    )
    costs = np.array(cost, dtype=np.float64, copy=copy)
    return join_cheapest(a, b, turns, costs, n, check)


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
    left = count_between(*costs.arguments, np.inf, group, 0)
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
        mark_cheapest_of_each(*costs.arguments, trusted, marks, 0, len(marks))
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
    wrapped: Phase,
    costs: Costs,
    below: float,
    group: Whole,
    turns: Whole,
    work: Workspace,
    start: int = 0,
) -> tuple[Whole, Whole, Whole, Floats]:
    """List the steps between groups that cost less than ``below``, to the rows from a start on."""
    n = (count_between(*costs.arguments, below, group, start),)
    first, second = work.array("first", n, np.int32), work.array("second", n, np.int32)
    between, cost = work.array("between", n, np.int32), work.array("cost", n, np.float64)
    if n[0]:
        list_between(
            wrapped,
            HALF,
            *costs.arguments,
            below,
            group,
            turns,
            start,
            first,
            second,
            between,
            cost,
        )
    return first, second, between, cost
