"""Which frame is thin enough to start from."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, in_threads
from napari_phase4d.unwrapping.background import find_background
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registry import unwrap
from napari_phase4d.unwrapping.spatial import unwrap_frame

__all__ = ["score_boundaries"]

TURN = np.float32(2 * np.pi)
#: How far the mean step of a frame, in turns, counts between frames that are alike otherwise.
TIE_BREAK = 1e-3

Frame = NDArray[np.float32]
Mask = NDArray[np.bool_]


def score_boundaries(
    phase: xr.DataArray | Any,
    reference: xr.DataArray | Any = None,
    *,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Score how safe every frame is as the boundary condition.

    A frame is thin if two different unwrappers agree on it: reliability sorting and directional
    growing, each on this frame alone. Where an unwrapping of all frames by directional L1 is
    known, the frame's own two-dimensional unwrapping is held against that, which is surer.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians, see `unwrap`.
    reference : DataArray or array_like, optional
        Unwrapped phase of the same shape, best by ``"directional-l1"``.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        dims (time, angle); 1 if both agree on every pixel of the object, less by the share on
        which they do not (and by a little for steep frames, so that of equally safe ones the
        flattest is first). ``attrs["best"]`` is the best (time, angle) index pair, and
        ``attrs["basis"]`` says what was compared.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.
    """
    problem = Problem(phase)
    known = None if reference is None else Problem(reference)
    if known is not None and known.wrapped.shape != problem.wrapped.shape:
        msg = f"reference is {known.wrapped.shape}, but the phase is {problem.wrapped.shape}"
        raise ValueError(msg)
    empty = find_background(problem.wrapped).mask
    frames = list(np.ndindex(*problem.wrapped.shape[:2]))
    watch = Watch(len(frames), "scoring the frames", progress, cancelled)

    def score(frame: tuple[int, ...]) -> float:
        other = None if known is None else known.wrapped[frame]
        return score_of(problem.wrapped[frame], empty[frame], other)

    scores = np.array(list(in_threads(score, frames, watch))).reshape(problem.wrapped.shape[:2])
    best = np.unravel_index(int(np.argmax(scores)), scores.shape)
    coords = {
        d: problem.template.coords[d] for d in ("time", "angle") if d in problem.template.coords
    }
    basis = "two unwrappers of the frame alone"
    if known is not None:
        basis = "the frame alone and the reference"
    attrs = {"best": [int(best[0]), int(best[1])], "basis": basis}
    return xr.DataArray(scores, dims=("time", "angle"), coords=coords, attrs=attrs, name="score")


def score_of(wrapped: Frame, empty: Mask, reference: Frame | None) -> float:
    """Return the score of one frame, from 0 to 1."""
    inside = ~empty
    if not inside.any():
        return 1.0
    spatial, _ = unwrap_frame(wrapped, np.ones_like(empty))
    other = reference
    if other is None:
        other = unwrap(wrapped, "directional-growing").values
    turns = np.round((other - spatial) / TURN)
    level = np.median(turns[empty] if empty.any() else turns)
    wrong = float((turns[inside] != level).mean())
    steps = [
        np.abs(np.diff(spatial, axis=axis)).mean() for axis in (0, 1) if wrapped.shape[axis] > 1
    ]
    steep = float(np.mean(steps)) / (2 * np.pi) if steps else 0.0
    return 1 - wrong - TIE_BREAK * min(steep, 1.0)
