"""Two-dimensional unwrapping of each frame by itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.restoration import unwrap_phase

from napari_phase4d.progress import Watch, in_threads

__all__ = ["border_medians", "unwrap_frames"]

#: Width of the frame's border that is taken for background, in pixels.
BORDER = 2
TURN = 2 * np.pi


def unwrap_frames(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    first: tuple[int, int],
    watch: Watch,
) -> NDArray[np.float32]:
    """Unwrap every frame by reliability sorting (Herraez et al. 2002, [14] in the paper).

    Reliability sorting leaves each frame's multiple of 2 pi open. It is chosen such that the
    border of the boundary frame lies within half a turn of zero, and that the border moves by
    less than half a turn from frame to frame and from view to view.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    mask : ndarray of bool, same shape
        Pixels to unwrap; 0 elsewhere in the result.
    first : tuple of int
        The boundary frame (time, angle).
    watch : Watch
        Counts frames.
    """
    n_times, n_angles = wrapped.shape[:2]
    indices = [(t, a) for t in range(n_times) for a in range(n_angles)]
    unwrapped = np.empty_like(wrapped)
    border = np.empty((n_times, n_angles))

    def work(index: tuple[int, int]) -> tuple[NDArray[np.float32], float]:
        return unwrap_frame(wrapped[index], mask[index])

    for index, (frame, level) in zip(indices, in_threads(work, indices, watch), strict=True):
        unwrapped[index], border[index] = frame, level
    turns = np.round((border_medians(border, first) - border) / TURN).astype(np.float32)
    unwrapped += np.float32(TURN) * turns[..., None, None]
    return np.where(mask, unwrapped, np.float32(0))


def unwrap_frame(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], float]:
    """Unwrap one frame and return it with the level of its border.

    A mask may cut the frame into parts that do not touch each other or the border. Their levels
    come from the frame unwrapped whole.
    """
    if 1 in wrapped.shape:  # scikit-image wants two lines at least
        twice = [2 if n == 1 else 1 for n in wrapped.shape]
        doubled, level = unwrap_frame(np.tile(wrapped, twice), np.tile(mask, twice))
        return doubled[: wrapped.shape[0], : wrapped.shape[1]], level
    edge = border_of(wrapped.shape)
    if mask.all():
        unwrapped = exact(unwrap_phase(wrapped, rng=0), wrapped)
        return unwrapped, float(np.median(unwrapped[edge]))
    if not mask.any():
        return np.zeros_like(wrapped), 0.0
    masked = np.ma.masked_array(wrapped, ~mask)
    inside = exact(np.ma.getdata(unwrap_phase(masked, rng=0)), wrapped)
    whole = unwrap_phase(wrapped, rng=0)
    parts, count = ndimage.label(mask)
    offsets = ndimage.median(whole - inside, parts, np.arange(1, count + 1))
    turns = np.concatenate([[0.0], np.round(np.asarray(offsets) / TURN)]).astype(np.float32)
    return inside + np.float32(TURN) * turns[parts], float(np.median(whole[edge]))


def exact(unwrapped: NDArray[np.floating], wrapped: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the wrapped phase plus whole turns, free of rounding on the way."""
    turns = np.round((unwrapped - wrapped) / TURN).astype(np.float32)
    result: NDArray[np.float32] = wrapped + np.float32(TURN) * turns
    return result


def border_of(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Mark the border of a frame."""
    edge = np.ones(shape, dtype=bool)
    if min(shape) > 2 * BORDER:
        edge[BORDER:-BORDER, BORDER:-BORDER] = False
    return edge


def border_medians(border: NDArray[np.float64], first: tuple[int, int]) -> NDArray[np.float64]:
    """Unwrap the border levels (time, angle) outwards from the boundary frame."""
    t0, a0 = first
    levels = border - TURN * np.round(border / TURN)
    unwrap_outwards(levels[t0], a0)
    for a in range(levels.shape[1]):
        unwrap_outwards(levels[:, a], t0)
    return levels


def unwrap_outwards(line: NDArray[np.float64], start: int) -> None:
    """Unwrap a line of phases in place, from one of them to both ends."""
    line[start:] = np.unwrap(line[start:])
    line[: start + 1] = np.unwrap(line[: start + 1][::-1])[::-1]
