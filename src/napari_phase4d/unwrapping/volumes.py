"""Reliability sorting over more than two dimensions: region growing and per-angle volumes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, watched
from napari_phase4d.unwrapping.growing import grow_grid
from napari_phase4d.unwrapping.phasetools import grown_as_phasetools
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.spatial import add_turns

__all__ = ["all_of", "region_growing", "spatial_3d", "with_levels"]

TURN = 2 * np.pi
Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]
Parts = NDArray[np.int32] | None


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
    watch = Watch(2, "region growing", progress, cancelled)
    if not 0 < rga_threshold < TURN:
        msg = f"rga_threshold must lie between 0 and 2 pi, but is {rga_threshold:g}"
        raise ValueError(msg)
    if variant == "textbook":
        return grown(problem, slice(None), watch)
    unwrapped, parts = watched(
        lambda: grown_as_phasetools(problem.wrapped, problem.mask, rga_threshold), watch
    )
    watch.step()
    result = levelled(unwrapped, parts, problem, slice(None), watch)
    watch.step()
    return result


def spatial_3d(
    problem: Problem, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> Stack:
    """Join pixels over time, y and x for each angle by itself, most reliable edges first."""
    n_angles = problem.wrapped.shape[1]
    watch = Watch(2 * n_angles, "3-D reliability sorting", progress, cancelled)
    result = np.empty_like(problem.wrapped)
    for angle in range(n_angles):
        one = slice(angle, angle + 1)
        result[:, one] = grown(problem, one, watch)
    return result


def grown(problem: Problem, angles: slice, watch: Watch) -> Stack:
    """Unwrap the frames of some angles by region growing and level every part."""
    wrapped, mask = problem.wrapped[:, angles], problem.mask[:, angles]
    turns, parts = watched(lambda: grow_grid(wrapped, mask, check=watch.check), watch)
    unwrapped = np.empty(wrapped.shape, dtype=np.float32)
    add_turns(wrapped, turns, unwrapped)
    del turns
    watch.step()
    result = levelled(unwrapped, parts, problem, angles, watch)
    watch.step()
    return result


def levelled(
    unwrapped: Stack, parts: Parts, problem: Problem, angles: slice, watch: Watch
) -> Stack:
    """Choose each part's open multiple of 2 pi.

    The border of the frames is brought within half a turn of zero; round an object that was
    found, the rim of its mask. Parts of any other mask take it from the two-dimensional
    unwrapping, which looks at whole frames. The boundary frame decides for the parts in it.
    """
    mask = problem.mask[:, angles]
    first = (problem.first[0], problem.first[1] - (angles.start or 0))
    if problem.finds_mask or mask.all():
        return with_levels(unwrapped, parts, None, mask, rim_of, first, watch)
    reference = problem.spatial()[:, angles]
    return with_levels(unwrapped, parts, reference, mask, all_of, first, watch)


def with_levels(
    unwrapped: Stack,
    parts: Parts,
    reference: Stack | None,
    mask: Mask,
    asked: Callable[[Mask], Mask],
    first: tuple[int, int],
    watch: Watch,
) -> Stack:
    """Add to each part the whole turns that bring it nearest to a reference.

    Parameters
    ----------
    unwrapped : ndarray of shape (time, angle, y, x)
        Phase in radians, whose parts each have an open multiple of 2 pi.
    parts : ndarray of int, same shape, or None
        Number of the part that each pixel belongs to; None if all are one.
    reference : ndarray, same shape, or None
        Phase in radians; None for zero.
    mask : ndarray of bool, same shape
        Pixels that count; the others are 0 in the result.
    asked : callable
        Returns the pixels of some frames' mask that are asked: those of the boundary frame, else
        those of its time, else all of them. A part that has none of them asks all its pixels.
    first : tuple of int
        The boundary frame (time, angle); it may lie outside.
    watch : Watch
        Stops the work.
    """
    labels = None if parts is None else numbered_inside(parts, mask)
    turns = np.full(2 if labels is None else int(labels.max()) + 1, np.nan)
    turns[0] = 0  # outside the mask
    t, a = slice(first[0], first[0] + 1), slice(max(first[1], 0), max(first[1] + 1, 0))
    for frames, places_of in (((t, a), asked), ((t,), asked), ((), asked), ((), all_of)):
        if np.isfinite(turns).all():
            break
        watch.check()
        places = places_of(mask[frames])
        height = -unwrapped[frames][places]
        if reference is not None:
            height += reference[frames][places]
        of_part = np.ones(height.shape, dtype=int) if labels is None else labels[frames][places]
        found = np.flatnonzero(np.isnan(turns) & (np.bincount(of_part, minlength=len(turns)) > 0))
        if len(found):
            turns[found] = np.round(np.asarray(ndimage.median(height, of_part, found)) / TURN)
    lift = (np.float32(TURN) * turns).astype(np.float32)
    result = unwrapped + (lift[1] if labels is None else lift[labels])
    if not mask.all():
        result[~mask] = 0
    return result


def numbered_inside(parts: NDArray[np.int32], mask: Mask) -> NDArray[np.int32]:
    """Give the parts inside a mask numbers from 1, without gaps; 0 outside."""
    present = np.zeros(int(parts.max()) + 1, dtype=bool)
    present[parts[mask]] = True
    number = np.cumsum(present, dtype=np.int32)
    labels: NDArray[np.int32] = number[parts]
    labels[~mask] = 0
    return labels


def all_of(mask: Mask) -> Mask:
    """Return the mask itself."""
    return mask


def rim_of(mask: Mask) -> Mask:
    """Mark the border of the frames, or of the object in them."""
    cross = ndimage.generate_binary_structure(2, 1)[None, None]
    inner = ndimage.binary_erosion(mask, cross, border_value=0)
    rim: Mask = mask & ~inner
    return rim
