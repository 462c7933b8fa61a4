"""Growing regions on grids and on lists of steps, compiled or not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import can_compile
from napari_phase4d.progress import nothing
from napari_phase4d.unwrapping.growing import boruvka, plain
from napari_phase4d.unwrapping.growing.costs import Costs, second_differences
from napari_phase4d.unwrapping.growing.grid import grown_turns
from napari_phase4d.unwrapping.growing.rows import Phase, Whole, full_shape
from napari_phase4d.unwrapping.growing.smooth import integrated
from napari_phase4d.unwrapping.growing.workspace import Workspace

__all__ = ["CostsOf", "grow_grid", "grow_list", "grow_through_residues", "smooth_turns"]

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
    if can_compile():
        turns, parts = grown_turns(rows, costs, work, check)
    else:
        turns, parts = plain.grown_grid(rows, *costs.arguments)
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
    if not can_compile():
        return plain.integrated(wrapped)
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
    if can_compile():
        copy = None if overwrite else True
        a, b, turns = (
            np.array(column, dtype=np.int32, copy=copy) for column in (first, second, steps)
        )
        costs = np.array(cost, dtype=np.float64, copy=copy)
        return boruvka.join_cheapest(a, b, turns, costs, n, check)
    return plain.joined_list(first, second, steps, cost, n)
