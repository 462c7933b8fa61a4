"""Reliability sorting over more than two dimensions: region growing and per-angle volumes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch
from napari_phase4d.unwrapping.phasetools import memory_edges, penalised_differences
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.reliability import Edges, grid_edges, grow, second_differences
from napari_phase4d.unwrapping.spatial import border_of
from napari_phase4d.unwrapping.variants import check_variant

__all__ = ["region_growing", "spatial_3d"]

TURN = 2 * np.pi
Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]


def region_growing(
    problem: Problem,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    variant: str = "textbook",
    rga_threshold: float = 3.14,
) -> Stack:
    """Join pixels over time, angle, y and x, most reliable edges first (RG).

    The reliability sorting of Herraez et al. 2002 and Abdul-Rahman et al. 2007 in four dimensions,
    as Barnhill et al. 2015 describe it: second differences over the 40 pairs of opposite
    neighbours; edges along the four axes, in the order of the sum of their ends' unreliabilities.

    Parameters
    ----------
    problem : Problem
        Any; the boundary frame's border gives the level.
    progress, cancelled : callable or None
        See `unwrap`.
    variant : str, optional
        "textbook" (default), or "phasetools": as PhaseTools computes it, see
        `napari_phase4d.unwrapping.phasetools`.
    rga_threshold : float, optional
        Only with "phasetools": step in radians beyond which a turn is added; published default
        3.14.
    """
    check_variant(variant)
    watch = Watch(3, "region growing", progress, cancelled)
    if variant == "textbook":
        return grown(problem.wrapped, problem.mask, problem.first, watch)
    if not 0 < rga_threshold < TURN:
        msg = f"rga_threshold must lie between 0 and 2 pi, but is {rga_threshold:g}"
        raise ValueError(msg)
    return grown(
        np.mod(problem.wrapped, np.float32(TURN)),
        problem.mask,
        problem.first,
        watch,
        unreliability_of=penalised_differences,
        edges_of=memory_edges,
        largest_step=rga_threshold,
    )


def spatial_3d(
    problem: Problem, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> Stack:
    """Join pixels over time, y and x for each angle by itself, most reliable edges first."""
    n_angles = problem.wrapped.shape[1]
    watch = Watch(3 * n_angles, "3-D reliability sorting", progress, cancelled)
    result = np.empty_like(problem.wrapped)
    for angle in range(n_angles):
        one = slice(angle, angle + 1)
        result[:, one] = grown(
            problem.wrapped[:, one], problem.mask[:, one], (problem.first[0], 0), watch
        )
    return result


def grown(
    wrapped: Stack,
    mask: Mask,
    first: tuple[int, int],
    watch: Watch,
    *,
    unreliability_of: Callable[[Stack, Mask], NDArray[np.floating]] = second_differences,
    edges_of: Callable[[Mask], Edges] = grid_edges,
    largest_step: float = np.pi,
) -> Stack:
    """Unwrap a stack (time, angle, y, x) by region growing and level every part of it."""
    watch.check()
    unreliability = unreliability_of(wrapped, mask).ravel()
    watch.step()
    edges = edges_of(mask)
    cost = unreliability[edges[0]].astype(np.float64) + unreliability[edges[1]]
    watch.step()
    unwrapped, parts = grow(wrapped, edges, cost, largest_step)
    result = levelled(unwrapped, parts, mask, first)
    watch.step()
    return result


def levelled(
    unwrapped: Stack, parts: NDArray[np.intp], mask: Mask, first: tuple[int, int]
) -> Stack:
    """Choose each part's open multiple of 2 pi.

    The border of the boundary frame, or else of all frames, or else the part's lowest tenth is
    brought within half a turn of zero.
    """
    edge = np.broadcast_to(border_of(unwrapped.shape[2:]), unwrapped.shape)
    result = np.zeros_like(unwrapped)
    for part in np.unique(parts[mask]):
        inside = (parts == part) & mask
        of_first = np.zeros_like(inside)
        of_first[first] = inside[first] & edge[first]
        for places in (of_first, inside & edge):
            if places.any():
                height = float(np.median(unwrapped[places]))
                break
        else:
            height = float(np.quantile(unwrapped[inside], 0.1))
        result[inside] = unwrapped[inside] - np.float32(TURN * np.round(height / TURN))
    return result
