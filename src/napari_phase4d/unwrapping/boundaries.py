"""Which frame is safe to start from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.later import xr
from napari_phase4d.stacks import on_grid_of, unwrapped_stack, without_masked, wrapped_stack
from napari_phase4d.task import (
    UNWATCHED,
    CancelledCall,
    ProgressCall,
    Task,
    Watch,
    in_threads,
    watched,
)
from napari_phase4d.unwrapping.frames import border_medians, unwrap_frame
from napari_phase4d.unwrapping.given import Boundary, checked_boundaries
from napari_phase4d.unwrapping.growing import Workspace, smooth_turns
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.registry import METHODS
from napari_phase4d.unwrapping.running import run_method

__all__ = [
    "SCORED_PIXELS",
    "SCORED_TIMES",
    "SCORING_METHOD",
    "best_frame",
    "score_boundaries",
    "scores_of_some",
    "scores_sentence",
]

TURN = np.float32(2 * np.pi)
#: How far the mean step of a frame, in turns, counts between frames that are alike otherwise.
TIE_BREAK = 1e-3
#: A reference has a level of its own if it is known on more than this share of the empty field.
KNOWN_FIELD = 0.5
#: What all frames are unwrapped by, to hold each of them against ...
SCORING_METHOD = "directional-l1"
#: ... in stacks of so many pixels at most: it takes 26 times their memory, about a gigabyte then.
SCORED_PIXELS = 10_000_000
#: Times that are scored of a larger recording.
SCORED_TIMES = 100

Frame = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Look:
    """What holding one frame against another unwrapping shows.

    Parameters
    ----------
    wrong : int
        Pixels of the object on which they differ.
    size : int
        Pixels of the object.
    steep : float
        Mean step from pixel to pixel in turns.
    """

    wrong: int = 0
    size: int = 0
    steep: float = 0.0


def score_boundaries(
    phase: xr.DataArray | ArrayLike,
    reference: xr.DataArray | ArrayLike | None = None,
    *,
    mask: xr.DataArray | ArrayLike | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Score how safe every frame is as the boundary condition.

    A frame is safe if its own two-dimensional unwrapping agrees with an unwrapping of all frames
    together by directional L1, both relative to the empty field. That takes the time and memory
    of ``unwrap(phase, "directional-l1")``, unless a result of it is given. Of a single frame, or
    of more than 10 million pixels, two unwrappers are compared that look at each frame alone,
    reliability sorting and directional growing, which is less sure.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians, see `unwrap`.
    reference : DataArray or array_like, optional
        Unwrapped phase of the same shape to hold the frames against, best by
        ``"directional-l1"``. Default: it is computed.
    mask : array_like of bool, optional
        Pixels that count, see `unwrap`; NaN are left out in any case.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        dims (time, angle); 1 if both agree on every pixel of the object, less by the share on
        which they do not (and by a little for steep frames, so that of equally safe ones the
        flattest is first). Where the object is smaller than in most frames, it is the share of
        its usual size. A frame without an object scores 1; one that the camera lost (all NaN, the
        same everywhere, or noise only) scores 0.

        ``attrs["best"]`` is the best (time, angle) index pair, ``attrs["basis"]`` says what was
        compared, ``attrs["agreement"]`` on which share of the object they agree there, and
        ``attrs["lost"]`` is the number of lost frames.

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
    task = Task(progress, cancelled)
    left = without_masked(phase, mask)
    given = Problem(wrapped_stack(phase, mask=left), mask="auto" if left is None else left)
    known = None
    if reference is not None:
        fitting = on_grid_of(reference, given.template, "reference")
        known = Problem(unwrapped_stack(fitting, "reference"), mask="auto")
    together = known is None and given.n_frames > 1 and given.wrapped.size <= SCORED_PIXELS
    return scored(given, known, task, together=together)


def scores_of_some(
    phase: xr.DataArray,
    task: Task = UNWATCHED,
) -> xr.DataArray:
    """Score the frames, or some of them evenly over time if there are too many.

    Beyond 10 million pixels, 100 times are looked at, or fewer, whose frames are looked at alone.
    It goes by the shape only, so that a recording has the same safest frame wherever it lies.

    Parameters
    ----------
    phase : DataArray
        Wrapped phase, dims (time, angle, y, x), in memory or lazy.
    task : Task, optional
        Who is told of it, and may stop it.

    Returns
    -------
    xarray.DataArray
        As `score_boundaries` returns it, NaN for frames that were not looked at.
    """
    if phase.size <= SCORED_PIXELS:
        return score_boundaries(phase.compute(), **task.calls)
    times = max(2, min(SCORED_TIMES, SCORED_PIXELS // max(phase[0].size, 1)))
    every = max(1, -(-phase.sizes["time"] // times))
    some = Problem(phase.isel(time=slice(None, None, every)).compute(), mask="auto")
    found = scored(some, None, task, together=False)
    whole = np.full(phase.shape[:2], np.nan)
    whole[::every] = found.values
    time, angle = best_frame(found)
    attrs = {**found.attrs, "best": [time * every, angle]}
    return as_scores(whole, phase, attrs)


def best_frame(scores: xr.DataArray) -> Boundary:
    """Return the safest frame (time, angle) by what `score_boundaries` gave."""
    time, angle = scores.attrs["best"]
    return int(time), int(angle)


def scores_sentence(scores: xr.DataArray) -> str:
    """Say how far the best frame of `score_boundaries` is to be relied on."""
    lost = scores.attrs["lost"]
    if lost == scores.size:
        return "No frame shows any phase that could be judged."
    share = 100 * scores.attrs["agreement"]
    said = f"There, {scores.attrs['basis']} agree on {share:.4g} % of the object."
    return f"{said} Left out as lost: {lost} of {scores.size} frames." if lost else said


def scored(
    given: Problem,
    known: Problem | None,
    task: Task,
    *,
    together: bool,
) -> xr.DataArray:
    """Score all frames of a problem, see `score_boundaries`."""
    Watch(1, "scoring the frames", task).check()
    lost = given.lost()
    basis = basis_of(known, together=together)
    attrs = {"best": [0, 0], "basis": basis, "agreement": 0.0, "lost": int(lost.sum())}
    if lost.all():
        return as_scores(np.zeros(lost.shape), given.template, attrs)
    kept = [(int(t), int(a)) for t, a in np.argwhere(~lost)]
    same = given.result(given.wrapped, "phase", {})  # which notes the wavelengths of the views
    problem = Problem(same, kept[0], given.usable & ~lost[..., None, None])
    if together:
        known = unwrapped_together(problem, task)
    looks = look_at(problem, kept, known, task)
    usual = float(np.median([look.size for look in looks if look.size] or [1]))
    scores = np.zeros(lost.shape)
    for frame, look in zip(kept, looks, strict=True):
        scores[frame] = score_of(look, usual)
    best = kept[int(np.argmax([scores[frame] for frame in kept]))]
    look = looks[kept.index(best)]
    attrs |= {"best": list(best), "agreement": 1 - look.wrong / max(look.size, 1)}
    return as_scores(scores, given.template, attrs)


def as_scores(
    values: NDArray[np.floating], phase: xr.DataArray, attrs: dict[str, object]
) -> xr.DataArray:
    """Return scores with the times and angles of the phase."""
    coords = {d: phase.coords[d] for d in ("time", "angle") if d in phase.coords}
    return xr.DataArray(values, dims=("time", "angle"), coords=coords, attrs=attrs, name="score")


def basis_of(known: Problem | None, *, together: bool) -> str:
    """Say what the frames are judged by."""
    label = METHODS[SCORING_METHOD].label
    if together:
        return f"the frame alone and all frames together ({label})"
    if known is None:
        return "two unwrappers of the frame alone"
    if known.template.attrs.get("method") == SCORING_METHOD:
        return f"the frame alone and the result of {label}"
    return "the frame alone and the reference"


def unwrapped_together(problem: Problem, task: Task) -> Problem:
    """Unwrap all frames together, to hold each of them against that."""
    report = task.reworded("looking for the safest frame: {}".format)
    found = run_method(problem, SCORING_METHOD, report, {})
    problem.forget_field()
    return Problem(found, mask="auto")


def look_at(
    problem: Problem,
    frames: list[Boundary],
    known: Problem | None,
    task: Task,
) -> list[Look]:
    """Hold frames against a known unwrapping, or against another one of the frame alone."""
    watch = Watch(len(frames) + 1, "scoring the frames", task)
    background = watched(problem.background, watch)
    watch.step()
    ground = background.ground(border_medians(background.level, first_boundary(known)))

    def look(frame: Boundary) -> Look:
        other = None
        if known is not None:
            there = known.usable[frame] & (known.wrapped[frame] != 0)
            other = np.where(there, known.wrapped[frame] - ground[frame], np.nan)
            other = to_turns(other, background.mask[frame])
        return look_of(
            problem.wrapped[frame],
            problem.usable[frame],
            background.mask[frame],
            ground[frame],
            other,
            task,
        )

    return list(in_threads(look, frames, watch))


def first_boundary(known: Problem | None) -> Boundary:
    """Return the boundary frame that a reference was unwrapped from."""
    noted = None if known is None else known.template.attrs.get("boundary")
    if known is None or not noted:
        return 0, 0
    try:
        return checked_boundaries(noted, known.wrapped.shape[:2])[0]
    except ValueError:  # it was noted by another program
        return 0, 0


def look_of(
    wrapped: Frame,
    usable: Mask,
    empty: Mask,
    ground: Frame,
    reference: NDArray[np.floating] | None,
    task: Task = UNWATCHED,
) -> Look:
    """Return on how much of one frame two unwrappings differ.

    Both are taken relative to the empty field, where there is one, so that an object that has
    slipped as a whole counts as wrong. The ground is the phase of the empty field, from which a
    tilt is known; the reference is less it.
    """
    inside = usable & ~empty
    if not inside.any():
        return Look()
    alone = unwrap_frame(wrapped, usable)
    spatial = relative(alone - ground, empty)
    other = reference
    if other is None and usable.all() and smooth_turns(wrapped, Workspace()) is not None:
        other = spatial  # without residues every unwrapper of the frame says the same
    elif other is None:
        alone_again = Problem(wrapped, mask=usable)
        grown = run_method(alone_again, "directional-growing", task.quiet, {})
        other = relative(grown.values - ground, empty)
    turns = np.round((other - spatial) / TURN)[inside]
    turns = turns[np.isfinite(turns)]
    if not turns.size:
        return Look()
    level = 0.0 if empty.any() else float(np.median(turns))
    steps = [np.abs(np.diff(alone, axis=axis)).mean() for axis in (0, 1) if alone.shape[axis] > 1]
    steep = float(np.mean(steps)) / (2 * np.pi) if steps else 0.0
    return Look(int((turns != level).sum()), turns.size, steep)


def score_of(look: Look, usual: float) -> float:
    """Return the score of a frame, from 0 to 1, where the object usually has so many pixels.

    A few wrong pixels are no worse where the object is small, unless they are most of it.
    """
    if not look.size:
        return 1.0
    mostly_right = look.wrong < look.size / 2
    size = max(look.size, usual) if mostly_right else look.size
    return max(1 - look.wrong / size - TIE_BREAK * min(look.steep, 1.0), 0.0)


def to_turns(reference: Frame, empty: Mask) -> Frame:
    """Return phase relative to the empty field, to whole turns; as it is where that is unknown.

    Exact phase may have any level, and a result is 0 outside its mask, where nothing is known.
    """
    shown = reference[empty & np.isfinite(reference)]
    if len(shown) <= KNOWN_FIELD * empty.sum():
        return reference
    turns = np.round(np.median(shown) / TURN)
    found: Frame = reference - reference.dtype.type(TURN * turns)
    return found


def relative(unwrapped: Frame, empty: Mask) -> Frame:
    """Return phase relative to the empty field, to whole turns and less its phase."""
    return unwrapped - np.median(unwrapped[empty]) if empty.any() else unwrapped
