"""How far each pixel of an unwrapped phase is to be trusted, without knowing the truth."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from napari_phase4d.axes import in_full
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.stacks import on_grid_of, unwrapped_stack, without_masked, wrapped_stack
from napari_phase4d.unwrapping import (
    Problem,
    Support,
    astray,
    chance_by_wavelengths,
    run_method,
    support_by_steps,
)
from napari_phase4d.words import warn

__all__ = [
    "REFERENCE",
    "chance_of_right",
    "confidence",
    "reference_of",
    "slip_warning",
    "slipped_frames",
    "turns_off",
]

TURN = 2 * np.pi
#: The method that all others are held against.
REFERENCE = "directional-l1"
#: Logarithm of the odds that a wrap count is wrong: so much, so much for each radian of the
#: roughest step on its way up to ROUGHEST, and so much for each unit by which it is held. Fitted
#: once, to WL1, RGd, T/A and 2-D on one half of the shapes, walls and sparse recordings of
#: ``benchmarks/regimes.py``, thick and noisy ones among them; ``benchmarks/trusting.py`` prints
#: how well it holds on the other.
LEVEL, PER_RADIAN, PER_HOLD = -3.4, 1.0, -9.6
ROUGHEST = 4.0
#: No result is held less than this.
LOOSEST = -0.2
#: A part of a turn that is no rounding, and the share of pixels in which it is no accident.
NOT_WHOLE, MANY_OFF = 0.02, 0.1
#: An object is one piece of a frame of at least so many pixels ...
SMALLEST_OBJECT = 30
#: ... and may have slipped if at least this share of it is trusted less than so much.
MOST, FIRM = 0.5, 0.8

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
    contradicts it. Where every angle has several wavelengths, it is judged by how far these
    agree instead: sheer walls have no smooth way, and need none then.

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
    doubt_other_phase(values, problem)
    reference = reference_of(problem, progress, cancelled)
    return chance_of_right(problem, values, reference, progress, cancelled)


def doubt_other_phase(unwrapped: xr.DataArray, problem: Problem) -> None:
    """Warn if a result is not the phase and whole turns: it may be of another recording."""
    if unwrapped.attrs.get("method") == "laplacian":  # an estimate, as its page says
        return
    off = (in_full(unwrapped) - problem.wrapped) / np.float32(TURN)
    known = problem.usable & np.isfinite(off)
    if unwrapped.attrs.get("mask", "none") != "none":
        known &= in_full(unwrapped) != 0
    share = float((np.abs(off - np.round(off))[known] > NOT_WHOLE).mean()) if known.any() else 0.0
    if share > MANY_OFF:
        warn(
            f"in {100 * share:.0f} % of the pixels the unwrapped phase is not the wrapped phase "
            "and whole turns; are both of the same recording?"
        )


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
    if problem.parts():
        return chance_of_colours(problem, result, reference, progress, cancelled)
    own = support_of(problem, result, progress, cancelled)
    other = problem.once("support", lambda: support_of(problem, reference, progress, cancelled))
    noise = problem.once("astray", lambda: astray(problem, progress, cancelled))
    differs = in_full(turns_off(result, reference)) != 0
    weight, rival = odds_of_right(own), odds_of_right(other)
    weight = np.where(differs, weight, np.maximum(weight, rival))
    chance = (1 - noise) * weight / (1 + weight + np.where(differs, rival, 0))
    chance[problem.lost()] = 0
    found = problem.result(
        chance.astype(np.float32), "confidence", {"of": result.attrs.get("method", "")}
    )
    found.attrs["units"] = "1"
    return found


def chance_of_colours(
    problem: Problem,
    result: xr.DataArray,
    reference: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Return `confidence` where views differ in wavelength.

    Where every angle has several, by how far they agree, which tells sheer walls too; else by the
    steps of each wavelength by itself.
    """
    values = in_full(result)
    if result.attrs.get("mask", "none") != "none":
        values = np.where(values == 0, np.float32(np.nan), values)
    chance = chance_by_wavelengths(problem, values)
    if chance is None:
        chance = np.zeros_like(values)
        for views, part in problem.parts():
            chosen = {"angle": list(views)}
            of_part = chance_of_right(
                part, result.isel(chosen), reference.isel(chosen), progress, cancelled
            )
            chance[:, list(views)] = in_full(of_part)
    else:
        chance[np.isnan(values)] = 1  # masked: taken for empty field
    chance[problem.lost()] = 0
    found = problem.result(chance, "confidence", {"of": result.attrs.get("method", "")})
    found.attrs["units"] = "1"
    return found


def support_of(
    problem: Problem,
    result: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Support:
    """Return how well the steps support a result, in which masked pixels are empty field.

    Faint amplitude counts as roughness, as it does in the steps.
    """
    values = in_full(result)
    if result.attrs.get("mask", "none") != "none":
        values = np.where(values == 0, np.float32(np.nan), values)  # taken for empty field
    return support_by_steps(problem, values, progress, cancelled)


def odds_of_right(support: Support) -> Stack:
    """Return the odds, right to wrong, of wrap counts that are supported so well."""
    rough = np.minimum(support.roughest, np.float32(ROUGHEST))
    held = np.maximum(support.held, np.float32(LOOSEST))
    odds: Stack = np.exp(-(LEVEL + PER_RADIAN * rough + PER_HOLD * held))
    return odds


def turns_off(result: xr.DataArray, reference: xr.DataArray) -> xr.DataArray:
    """Return by how many whole turns two results differ; 0 where one of them was masked."""
    reference = reference.transpose(*result.dims)
    off = np.nan_to_num(np.round((result.values - reference.values) / np.float32(TURN)))
    for stack in (result, reference):
        if stack.attrs.get("mask", "none") != "none":
            off = np.where(stack.values == 0, np.float32(0), off)
    return result.copy(data=off)


def slipped_frames(problem: Problem, trust: xr.DataArray) -> Mask:
    """Mark the frames (time, angle) in which most of an object may be off by the same cycles.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    trust : DataArray
        What `confidence` gave.
    """
    wrong = in_full(trust) < FIRM
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
