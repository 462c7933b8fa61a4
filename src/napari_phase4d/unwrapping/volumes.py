"""Reliability sorting over more than two dimensions: region growing and per-angle volumes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, watched
from napari_phase4d.unwrapping.phasetools import memory_edges, penalised_differences
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.reliability import Edges, grid_edges, grow, second_differences

__all__ = ["region_growing", "spatial_3d", "with_levels"]

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
    watch = Watch(3, "region growing", progress, cancelled)
    if variant == "textbook":
        return grown(problem, slice(None), watch)
    if not 0 < rga_threshold < TURN:
        msg = f"rga_threshold must lie between 0 and 2 pi, but is {rga_threshold:g}"
        raise ValueError(msg)
    return grown(
        problem,
        slice(None),
        watch,
        phase=np.mod(problem.wrapped, np.float32(TURN)),
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
        result[:, one] = grown(problem, one, watch)
    return result


def grown(
    problem: Problem,
    angles: slice,
    watch: Watch,
    *,
    phase: Stack | None = None,
    unreliability_of: Callable[[Stack, Mask], NDArray[np.floating]] = second_differences,
    edges_of: Callable[[Mask], Edges] = grid_edges,
    largest_step: float = np.pi,
) -> Stack:
    """Unwrap the frames of some angles by region growing and level every part."""
    wrapped = (problem.wrapped if phase is None else phase)[:, angles]
    mask = problem.mask[:, angles]
    unreliability = watched(lambda: unreliability_of(wrapped, mask).ravel(), watch)
    watch.step()
    edges = watched(lambda: edges_of(mask), watch)
    cost = unreliability[edges[0]].astype(np.float64) + unreliability[edges[1]]
    watch.step()
    unwrapped, parts = watched(lambda: grow(wrapped, edges, cost, largest_step), watch)
    result = levelled(unwrapped, parts, problem, angles, watch)
    watch.step()
    return result


def levelled(
    unwrapped: Stack, parts: NDArray[np.intp], problem: Problem, angles: slice, watch: Watch
) -> Stack:
    """Choose each part's open multiple of 2 pi.

    The border of the frames is brought within half a turn of zero; round an object that was
    found, the rim of its mask. Parts of any other mask take it from the two-dimensional
    unwrapping, which looks at whole frames. The boundary frame decides for the parts in it.
    """
    mask = problem.mask[:, angles]
    whole = problem.finds_mask or mask.all()
    height = -unwrapped if whole else problem.spatial()[:, angles] - unwrapped
    place = rim_of(mask) if whole else mask
    first = (problem.first[0], problem.first[1] - (angles.start or 0))
    return with_levels(unwrapped, parts, height, mask, place, first, watch)


def with_levels(
    unwrapped: Stack,
    parts: NDArray[np.integer],
    height: Stack,
    mask: Mask,
    place: Mask,
    first: tuple[int, int],
    watch: Watch,
) -> Stack:
    """Add to each part the whole turns that are nearest to its median height.

    Parameters
    ----------
    unwrapped : ndarray of shape (time, angle, y, x)
        Phase in radians, whose parts each have an open multiple of 2 pi.
    parts : ndarray of int, same shape
        Number of the part that each pixel belongs to.
    height : ndarray, same shape
        What is to be added, in radians, as far as each pixel knows.
    mask : ndarray of bool, same shape
        Pixels that count; the others are 0 in the result.
    place : ndarray of bool, same shape
        Pixels that are asked: those of the boundary frame, else those of its time, else all of
        them. A part that has none of them asks all its pixels.
    first : tuple of int
        The boundary frame (time, angle); it may lie outside.
    watch : Watch
        Stops the work.
    """
    numbers, compact = np.unique(parts, return_inverse=True)
    labels = np.where(mask, compact.reshape(parts.shape) + 1, 0)
    t, a = first
    in_time = np.zeros(unwrapped.shape, dtype=bool)
    in_time[t] = True
    in_first = np.zeros_like(in_time)
    if 0 <= a < unwrapped.shape[1]:
        in_first[t, a] = True
    chosen = np.full(len(numbers), np.nan)
    for places in (in_first & place, in_time & place, place, mask):
        watch.check()
        there = np.where(places, labels, 0)
        found = np.setdiff1d(np.unique(there)[1:], np.flatnonzero(np.isfinite(chosen)) + 1)
        if len(found):
            chosen[found - 1] = ndimage.median(height, there, found)
    turns = np.concatenate([[0.0], np.round(np.nan_to_num(chosen) / TURN)]).astype(np.float32)
    return np.where(mask, unwrapped + np.float32(TURN) * turns[labels], np.float32(0))


def rim_of(mask: Mask) -> Mask:
    """Mark the border of the frames, or of the object in them."""
    cross = ndimage.generate_binary_structure(2, 1)[None, None]
    inner = ndimage.binary_erosion(mask, cross, border_value=0)
    rim: Mask = mask & ~inner
    return rim
