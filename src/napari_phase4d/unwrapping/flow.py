"""Minimum-cost flow: the cheapest whole turns that make the steps of a grid close.

Costantini 1998 (IEEE Trans. Geosci. Remote Sens. 36, 813): between four neighbouring pixels the
wrapped steps should add up to zero. Where they don't, whole turns are added to some steps. On a
two-dimensional grid every step borders two such cells (or one and the outside), so that the turns
are a flow from cells of positive to cells of negative sum, and the cheapest is found exactly.
"""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

__all__ = ["closing_turns", "loop_sums"]

Whole = NDArray[np.int64]


def loop_sums(down: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Return the sum of steps round every cell of a batch of grids.

    Parameters
    ----------
    down : ndarray, shape (..., ny - 1, nx)
        Step from each pixel to the one below.
    right : ndarray, shape (..., ny, nx - 1)
        Step from each pixel to the one at its right.

    Returns
    -------
    ndarray, shape (..., ny - 1, nx - 1)
    """
    sums: NDArray[Any] = right[..., :-1, :] + down[..., 1:] - right[..., 1:, :] - down[..., :-1]
    return sums


def closing_turns(
    down: Whole, right: Whole, cost_down: Whole, cost_right: Whole
) -> tuple[Whole, Whole]:
    """Return the cheapest turns to add to the steps of grids so that all loops close.

    Parameters
    ----------
    down, right : ndarray of int, shapes (n, ny - 1, nx) and (n, ny, nx - 1)
        Steps in turns, of n grids.
    cost_down, cost_right : ndarray of int, same shapes
        Cost of one turn at each step, 0 or more.

    Returns
    -------
    ndarray, ndarray
        Turns to add, in the shapes of ``down`` and ``right``.
    """
    sums = loop_sums(down, right)
    if not sums.any():  # also where a grid is too narrow for loops
        return np.zeros_like(down), np.zeros_like(right)
    n, ny, nx = sums.shape
    outside = n * ny * nx
    cells = np.full((n, ny + 2, nx + 2), outside)
    cells[:, 1:-1, 1:-1] = np.arange(outside).reshape(sums.shape)
    # A turn added to a step takes one from the sum of the cell on one side and brings it to the
    # other.
    raised = np.concatenate([cells[:, 1:-1, :-1].ravel(), cells[:, 1:, 1:-1].ravel()])
    lowered = np.concatenate([cells[:, 1:-1, 1:].ravel(), cells[:, :-1, 1:-1].ravel()])
    cost = np.concatenate([cost_down.ravel(), cost_right.ravel()])
    needed = np.append(sums.ravel(), -sums.sum())
    solve = by_ortools if importlib.util.find_spec("ortools") else by_linear_program
    turns = solve(lowered, raised, cost, needed)
    return turns[: down.size].reshape(down.shape), turns[down.size :].reshape(right.shape)


def by_ortools(tail: Whole, head: Whole, cost: Whole, supply: Whole) -> Whole:
    """Return the cheapest flow from tails to heads, negative where it runs back (OR-tools)."""
    from ortools.graph.python import min_cost_flow

    problem: Any = min_cost_flow.SimpleMinCostFlow()
    capacity = np.full(2 * len(tail), int(np.abs(supply).sum()))
    arcs = problem.add_arcs_with_capacity_and_unit_cost(
        np.concatenate([tail, head]), np.concatenate([head, tail]), capacity, np.tile(cost, 2)
    )
    problem.set_nodes_supplies(np.arange(len(supply)), supply)
    status = problem.solve()
    if status != problem.OPTIMAL:
        msg = f"the network-flow solver stopped with status {status}"
        raise RuntimeError(msg)
    forth, back = problem.flows(arcs).reshape(2, -1)
    return np.asarray(forth - back, dtype=np.int64)


def by_linear_program(tail: Whole, head: Whole, cost: Whole, supply: Whole) -> Whole:
    """Return the cheapest flow from tails to heads, negative where it runs back (HiGHS).

    The constraints of a flow are totally unimodular, so that the vertex which the simplex method
    finds is whole-numbered.
    """
    from scipy.optimize import linprog

    n = len(tail)
    ones, arcs = np.ones(n), np.arange(n)
    out = sparse.coo_array((ones, (tail, arcs)), shape=(len(supply), n))
    into = sparse.coo_array((ones, (head, arcs)), shape=(len(supply), n))
    balance = (out - into).tocsc()
    found = linprog(
        np.tile(cost, 2),
        A_eq=sparse.hstack([balance, -balance]).tocsc(),
        b_eq=supply,
        bounds=(0, None),
        method="highs-ds",
    )
    if found.x is None:
        msg = f"the network-flow solver stopped: {found.message}"
        raise RuntimeError(msg)
    forth, back = np.round(found.x).astype(np.int64).reshape(2, -1)
    return np.asarray(forth - back)
