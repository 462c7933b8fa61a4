"""Which frame is thin enough to start from."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, in_threads, watched
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.running import unwrap
from napari_phase4d.unwrapping.spatial import border_medians, unwrap_frame

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
    mask: Any = None,
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
    mask : array_like of bool, optional
        Pixels that count, see `unwrap`; NaN are left out in any case.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        dims (time, angle); 1 if both agree on every pixel of the object, less by the share on
        which they do not (and by a little for steep frames, so that of equally safe ones the
        flattest is first). ``attrs["best"]`` is the best (time, angle) index pair,
        ``attrs["basis"]`` says what was compared, and ``attrs["agreement"]`` on which share of the
        object they agree there. A frame without an object scores 1.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.
    """
    problem = Problem(phase, mask="auto" if mask is None else mask)
    shape = problem.wrapped.shape
    known = None if reference is None else Problem(reference, mask="auto")
    if known is not None and known.wrapped.shape != shape:
        msg = f"reference is {known.wrapped.shape}, but the phase is {shape}"
        raise ValueError(msg)
    frames = list(np.ndindex(*shape[:2]))
    watch = Watch(len(frames) + 1, "scoring the frames", progress, cancelled)
    background = watched(problem.background, watch)
    watch.step()
    level = border_medians(background.level, first_boundary(known))

    def score(frame: tuple[int, ...]) -> tuple[float, float]:
        other = None
        if known is not None:
            kept = known.usable[frame] & (known.wrapped[frame] != 0)
            other = np.where(kept, known.wrapped[frame] - level[frame], np.nan)
        return score_of(
            problem.wrapped[frame], problem.usable[frame], background.mask[frame], other, cancelled
        )

    found = np.array(list(in_threads(score, frames, watch))).reshape(*shape[:2], 2)
    scores, agreement = found[..., 0], found[..., 1]
    best = np.unravel_index(int(np.argmax(scores)), scores.shape)
    coords = {
        d: problem.template.coords[d] for d in ("time", "angle") if d in problem.template.coords
    }
    basis = "two unwrappers of the frame alone"
    if known is not None:
        basis = "the frame alone and the reference"
    attrs = {
        "best": [int(best[0]), int(best[1])],
        "basis": basis,
        "agreement": float(agreement[best]),
    }
    return xr.DataArray(scores, dims=("time", "angle"), coords=coords, attrs=attrs, name="score")


def first_boundary(known: Problem | None) -> tuple[int, int]:
    """Return the boundary frame that a reference was unwrapped from."""
    noted = [] if known is None else known.template.attrs.get("boundary", [])
    return (int(noted[0][0]), int(noted[0][1])) if len(noted) else (0, 0)


def score_of(
    wrapped: Frame,
    usable: Mask,
    empty: Mask,
    reference: NDArray[np.floating] | None,
    cancelled: CancelledCall | None = None,
) -> tuple[float, float]:
    """Return the score of one frame, from 0 to 1, and the share on which both agree.

    Both unwrappings are taken relative to the empty field, where there is one, so that an object
    that has slipped as a whole counts as wrong.
    """
    inside = usable & ~empty
    if not inside.any():
        return 1.0, 1.0
    spatial = relative(unwrap_frame(wrapped, usable)[0], empty)
    other = reference
    if other is None:
        grown = unwrap(wrapped, "directional-growing", mask=usable, cancelled=cancelled)
        other = relative(grown.values, empty)
    turns = np.round((other - spatial) / TURN)[inside]
    turns = turns[np.isfinite(turns)]
    if not turns.size:
        return 1.0, 1.0
    level = 0.0 if empty.any() else float(np.median(turns))
    agreement = float((turns == level).mean())
    steps = [
        np.abs(np.diff(spatial, axis=axis)).mean() for axis in (0, 1) if spatial.shape[axis] > 1
    ]
    steep = float(np.mean(steps)) / (2 * np.pi) if steps else 0.0
    return max(agreement - TIE_BREAK * min(steep, 1.0), 0.0), agreement


def relative(unwrapped: Frame, empty: Mask) -> Frame:
    """Return phase relative to the empty field, to whole turns and less its phase."""
    return unwrapped - np.median(unwrapped[empty]) if empty.any() else unwrapped
