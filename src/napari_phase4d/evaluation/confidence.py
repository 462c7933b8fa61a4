"""How far each pixel of an unwrapped phase is to be trusted, without knowing the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.stacks import on_grid_of, unwrapped_stack, without_masked, wrapped_stack
from napari_phase4d.unwrapping import Problem, roughest_on_the_way, run_method

__all__ = [
    "REFERENCE",
    "chance_of_right",
    "confidence",
    "reference_of",
    "slip_warning",
    "slipped_frames",
    "support_of",
    "turns_off",
]

TURN = 2 * np.pi
#: The method that all others are held against.
REFERENCE = "directional-l1"
#: Odds (their logarithm) that a wrap count is wrong, as a parabola in log(0.3 + b), b the roughest
#: step in radians on the smoothest way from the empty field. Fitted once to half of the shapes,
#: faults and sparse recordings of ``benchmarks/regimes.py``, thick ones and noisy ones among
#: them; ``benchmarks/accuracy.py confidence`` prints how well it holds on the other half.
ODDS = (-4.53, 2.20, 1.25)
SOFTENING = 0.3
#: An object is one piece of a frame of at least so many pixels ...
SMALLEST_OBJECT = 30
#: ... and may have slipped if at least this share of it is trusted less than so much.
MOST, FIRM = 0.5, 0.5

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]


def confidence(
    unwrapped: xr.DataArray | ArrayLike,
    phase: xr.DataArray | ArrayLike,
    amplitude: xr.DataArray | ArrayLike | None = None,
    *,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Return the chance, from 0 to 1, that each pixel of a result has the right wrap count.

    Each wrap count is judged by the way that leads to it: of all ways from the empty field over
    time, angle, y and x along steps that agree with the result, the one whose roughest step is
    smoothest. Where a result differs from directional L1, both ways compete. So it also falls
    where a whole object has slipped: then no smooth way leads into it, or a smoother one
    contradicts it.

    Parameters
    ----------
    unwrapped : DataArray or array_like
        Unwrapped phase of any method in radians, as `unwrap` returns it.
    phase : DataArray or array_like
        The wrapped phase that it was made of, same shape.
    amplitude : DataArray or array_like, optional
        Amplitude of the field, same shape; where it fades, less is trusted.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        float32 in the form of the phase; 0 in frames that say nothing of the object.

    Raises
    ------
    ValueError
        If the shapes differ, or an argument does not fit.
    Cancelled
        If ``cancelled()`` returned True.

    See Also
    --------
    compare : Several methods; its ``confidence`` and ``verdict`` use the same.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> sample = p4d.simulation.swimming_euglena((48, 64), 4, peak_rad=9)
    >>> unwrapped = p4d.unwrap(sample["wrapped"], "spatial-2d")
    >>> trust = p4d.confidence(unwrapped, sample["wrapped"])
    >>> bool((trust >= 0).all() and (trust <= 1).all())
    True
    """
    mask = without_masked(phase, None)
    problem = Problem(wrapped_stack(phase), mask=mask, amplitude=amplitude)
    name = "the unwrapped phase"
    values = unwrapped_stack(on_grid_of(unwrapped, problem.template, name), name)
    reference = reference_of(problem, progress, cancelled)
    return chance_of_right(problem, values, reference, progress, cancelled)


def reference_of(
    problem: Problem,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Return the result of directional L1 on a problem, computed once."""
    return problem.once(REFERENCE, lambda: run_method(problem, REFERENCE, progress, cancelled, {}))


def chance_of_right(
    problem: Problem,
    result: xr.DataArray,
    reference: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Return `confidence` of a result, where the problem and the reference are at hand.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    result, reference : DataArray
        Unwrapped phase in the form of the problem's; the reference is that of directional L1.
    progress, cancelled : callable, optional
        See `unwrap`.
    """
    own = support_of(problem, result, progress, cancelled)
    other = problem.once("support", lambda: support_of(problem, reference, progress, cancelled))
    differs = in_full(problem, turns_off(result, reference)) != 0
    same = ~differs
    best = np.where(same, np.minimum(own, other), own)
    weight, rival = odds_of_right(best), odds_of_right(other)
    chance = weight / (1 + weight + np.where(differs, rival, 0))
    chance[problem.lost()] = 0
    found = problem.result(
        chance.astype(np.float32), "confidence", {"of": result.attrs.get("method", "")}
    )
    found.attrs["units"] = "1"
    return found


def support_of(
    problem: Problem,
    result: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Stack:
    """Return the roughest step in radians on the smoothest way to each pixel of a result.

    Faint amplitude counts as roughness, as it does in the steps.
    """
    values = in_full(problem, result.values)
    if result.attrs.get("mask", "none") != "none":
        values = np.where(values == 0, np.float32(np.nan), values)  # taken for empty field
    return roughest_on_the_way(problem, values, progress, cancelled)


def odds_of_right(rough: Stack) -> Stack:
    """Return the odds, right to wrong, of a wrap count whose way is so rough in radians."""
    x = np.log(SOFTENING + rough)
    odds: Stack = np.exp(-(ODDS[0] + ODDS[1] * x + ODDS[2] * x * x))
    return odds


def in_full(problem: Problem, values: NDArray[Any]) -> NDArray[Any]:
    """Return values in the form of a problem's phase with all four axes."""
    return values.reshape(problem.wrapped.shape)


def turns_off(result: xr.DataArray, reference: xr.DataArray) -> Stack:
    """Return by how many whole turns two results differ; 0 where one of them was masked."""
    off: Stack = np.nan_to_num(np.round((result.values - reference.values) / np.float32(TURN)))
    for stack in (result, reference):
        if stack.attrs.get("mask", "none") != "none":
            off = np.where(stack.values == 0, np.float32(0), off)
    return off


def slipped_frames(problem: Problem, trust: xr.DataArray) -> Mask:
    """Mark the frames (time, angle) in which most of an object may be off by the same cycles.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    trust : DataArray
        What `confidence` gave.
    """
    wrong = in_full(problem, trust.values) < FIRM
    objects = problem.usable & ~problem.background().mask
    found = np.zeros(wrong.shape[:2], dtype=bool)
    for frame in np.argwhere(~problem.lost()):
        place = tuple(frame)
        labels, count = ndimage.label(objects[place])
        if not count:
            continue
        size = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        bad = np.bincount(labels[wrong[place]], minlength=count + 1)[1:]
        found[place] = bool(((size >= SMALLEST_OBJECT) & (bad >= MOST * size)).any())
    return found


def slip_warning(problem: Problem, trust: xr.DataArray) -> str:
    """Say in one sentence in which frames whole objects may have slipped; "" if in none.

    Parameters
    ----------
    problem, trust
        See `slipped_frames`.
    """
    slipped = slipped_frames(problem, trust)
    count = int(slipped.sum())
    if not count:
        return ""
    time, angle = np.argwhere(slipped)[0]
    return (
        f"in {count} of {slipped.size} frames most of an object may be off by a cycle, "
        f"first at time {time}, view {angle}"
    )
