"""Which frame is thin enough to start from."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, in_threads, watched
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.running import unwrap
from napari_phase4d.unwrapping.spatial import border_medians, unwrap_frame

__all__ = ["SCORED_TIMES", "score_boundaries", "scores_of_some", "scores_sentence"]

TURN = np.float32(2 * np.pi)
#: How far the mean step of a frame, in turns, counts between frames that are alike otherwise.
TIE_BREAK = 1e-3
#: Times that are scored of a recording larger than memory, and bytes of phase at most.
SCORED_TIMES, SCORED_BYTES = 100, 256 * 2**20

Frame = NDArray[np.float32]
Mask = NDArray[np.bool_]


def score_boundaries(
    phase: xr.DataArray | ArrayLike,
    reference: xr.DataArray | ArrayLike | None = None,
    *,
    mask: xr.DataArray | ArrayLike | None = None,
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

    See Also
    --------
    unwrap : Takes the best frame as its boundary.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> sample = p4d.simulation.swimming_euglena((48, 64), 4, peak_rad=9)
    >>> scores = p4d.score_boundaries(sample["wrapped"])
    >>> scores.dims
    ('time', 'angle')
    >>> unwrapped = p4d.unwrap(sample["wrapped"], boundary=tuple(scores.attrs["best"]))
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


def scores_of_some(
    phase: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Score some frames of a recording larger than memory, evenly over time.

    Parameters
    ----------
    phase : DataArray
        Wrapped phase, dims (time, angle, y, x), in memory or lazy.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        As `score_boundaries` returns it, NaN for frames that were not looked at.
    """
    times = max(2, min(SCORED_TIMES, SCORED_BYTES // max(phase[0].nbytes, 1)))
    every = max(1, -(-phase.sizes["time"] // times))
    some = phase.isel(time=slice(None, None, every)).compute()
    found = score_boundaries(some, progress=progress, cancelled=cancelled)
    scores = found.reindex(time=phase["time"])
    time, angle = found.attrs["best"]
    return scores.assign_attrs(best=[time * every, angle])


def scores_sentence(scores: xr.DataArray) -> str:
    """Say how far the best frame of `score_boundaries` is to be relied on."""
    share = 100 * scores.attrs["agreement"]
    return f"There, {scores.attrs['basis']} agree on {share:.4g} % of the object."


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
