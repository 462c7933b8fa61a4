"""How far each pixel of an unwrapped phase is to be trusted, without knowing the truth."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.unwrapping import ends_along

__all__ = ["REFERENCE", "confidence_of", "firmness", "slip_warning", "turns_off", "unsteadiness"]

TURN = 2 * np.pi
#: The method that all others are held against.
REFERENCE = "directional-l1"
#: Chance that a pixel of the reference is wrong, as a logistic function of its unsteadiness in
#: turns: where that is a half, and how fast it rises; by whether there are several times and
#: several angles. Fitted once to the cells of `simulation.SHAPES`, noise up to 0.7 rad;
#: ``benchmarks/accuracy.py`` prints how well it holds. A frame by itself hardly tells.
CHANCES = {
    (True, True): (4.7, 2.3),
    (True, False): (4.0, 1.9),
    (False, True): (3.4, 0.45),
    (False, False): (1.9, 0.87),
}
#: Smallest share of the median amplitude that counts.
FAINTEST = 0.05
#: Below this firmness a whole object is held to its level by too few steps. Of 2,500 simulated
#: frames that the reference had right, none was below.
LOOSE = 0.7
#: An object has slipped if this share of it differs from the reference by the same turns.
MOST = 0.5

Stack = NDArray[np.float32]


def unsteadiness(unwrapped: xr.DataArray) -> xr.DataArray:
    """Return the sum of the steps to all neighbours over time, angle, y and x, in turns.

    Where a neighbour is missing the step to the other side counts twice, so that pixels at the
    border compare with the others.

    Parameters
    ----------
    unwrapped : xarray.DataArray
        Unwrapped phase in radians; dims among (time, angle, y, x).
    """
    values = unwrapped.values
    total = np.zeros(values.shape, dtype=np.float32)
    for axis in range(values.ndim):
        if values.shape[axis] < 2:
            continue
        step = np.abs(np.diff(values, axis=axis)) / np.float32(TURN)
        ends = [(int(i == axis), int(i == axis)) for i in range(values.ndim)]
        padded = np.pad(step, ends, mode="edge")
        n = values.shape[axis]
        total += padded.take(range(n), axis) + padded.take(range(1, n + 1), axis)
    return unwrapped.copy(data=total)


def confidence_of(
    result: xr.DataArray,
    reference: xr.DataArray,
    amplitude: xr.DataArray | None = None,
    level: xr.DataArray | float = 0.0,
) -> xr.DataArray:
    """Return the chance, from 0 to 1, that each pixel has the right number of turns.

    For the reference itself, a result of directional L1, it falls with `unsteadiness`; an unknown
    amplitude counts as full. Any other method is as likely right as the reference where both
    agree, and as likely wrong where they do not.

    Parameters
    ----------
    result : xarray.DataArray
        Unwrapped phase of any method, radians.
    reference : xarray.DataArray
        Unwrapped phase of directional L1 on the same grid; may be ``result`` itself.
    amplitude : xarray.DataArray, optional
        Amplitude on the same grid as a share of its median; half of it counts as one turn.
    level : xarray.DataArray or float, optional
        Phase of the empty field of every frame, whose drift is no step of the object.

    Returns
    -------
    xarray.DataArray
        float32 on the grid of the result.
    """
    score = unsteadiness(without_level(reference, level)).values
    several = [reference.sizes.get(dim, 1) > 1 for dim in ("time", "angle")]
    even, slope = CHANCES[several[0], several[1]]
    if amplitude is not None:
        share = np.clip(amplitude.values, FAINTEST, 1)
        score = score + (1 / share - 1).astype(np.float32)
    wrong = 1 / (1 + np.exp(-slope * (score - even)))
    differs = turns_off(result, reference) != 0
    confidence = np.where(differs, wrong, 1 - wrong).astype(np.float32)
    found = result.copy(data=confidence)
    found.attrs = {"of": result.attrs.get("method", ""), "units": "1"}
    return found.rename("confidence")


def without_level(unwrapped: xr.DataArray, level: xr.DataArray | float) -> xr.DataArray:
    """Return phase less the level of each frame; what a mask set to 0 stays 0."""
    if isinstance(level, float):
        return unwrapped
    steady = unwrapped.values - level.transpose(*unwrapped.dims, missing_dims="ignore").values
    masked = (unwrapped.values == 0) & (unwrapped.attrs.get("mask", "none") != "none")
    return unwrapped.copy(data=np.where(masked, 0, steady).astype(np.float32))


def turns_off(result: xr.DataArray, reference: xr.DataArray) -> NDArray[np.float32]:
    """Return by how many whole turns two results differ; 0 where one of them was masked."""
    off: Stack = np.round((result.values - reference.values) / np.float32(TURN))
    for stack in (result, reference):
        if stack.attrs.get("mask", "none") != "none":
            off = np.where(stack.values == 0, np.float32(0), off)
    return off


def slip_warning(
    result: xr.DataArray,
    reference: xr.DataArray,
    empty: xr.DataArray,
    level: xr.DataArray | float = 0.0,
) -> str:
    """Say in one sentence in which frames the whole object may be off by a turn; "" if in none.

    Parameters
    ----------
    result, reference : xarray.DataArray
        See `confidence_of`.
    empty : xarray.DataArray of bool
        The empty field.
    level : xarray.DataArray or float, optional
        See `confidence_of`.
    """
    turns = turns_off(result, reference)
    objects = xr.DataArray(np.where(empty.values, np.nan, turns), dims=result.dims)
    with np.errstate(invalid="ignore"):
        off = [(objects == n).sum(("y", "x")) for n in np.unique(turns) if n != 0]
        count = objects.notnull().sum(("y", "x"))
        slipped = np.any([(o > MOST * count).values for o in off], axis=0) if off else False
    n_slipped, n_frames = int(np.sum(slipped)), int(count.size)
    if n_slipped:
        return (
            f"in {n_slipped} of {n_frames} frames most of the object lies a turn off "
            "the result of WL1"
        )
    loose = int(np.sum(firmness(without_level(result, level), empty).values < LOOSE))
    if loose:
        return (
            f"in {loose} of {n_frames} frames few steps tie the object to its level; "
            "all of it may be a turn off there"
        )
    return ""


def firmness(unwrapped: xr.DataArray, empty: xr.DataArray) -> xr.DataArray:
    """Return how firmly the object of each frame is tied to its level, from -1 to 1.

    Of all steps from the object to the empty field round it, and to the same pixels at the
    neighbouring times and angles, the share that is less than half a turn, minus the share that
    is not.

    Parameters
    ----------
    unwrapped : xarray.DataArray
        Unwrapped phase in radians; dims among (time, angle, y, x).
    empty : xarray.DataArray of bool
        The empty field, same dims.

    Returns
    -------
    xarray.DataArray
        The dims without y and x; NaN where nothing is tied.
    """
    phase, background = unwrapped.values, empty.values
    held, total = np.zeros(phase.shape), np.zeros(phase.shape)
    for axis, dim in enumerate(unwrapped.dims):
        if phase.shape[axis] < 2:
            continue
        head, tail = ends_along(axis, phase.ndim)
        small = np.abs(phase[tail] - phase[head]) < np.pi
        tie = ~background[head] & ~background[tail]
        if dim in ("y", "x"):
            tie = background[head] != background[tail]
        for side in (head, tail):
            held[side] += tie & small
            total[side] += tie
    sums = [xr.DataArray(v, dims=unwrapped.dims).sum(("y", "x")) for v in (held, total)]
    found = 2 * sums[0] / sums[1].where(sums[1] > 0) - 1
    return found.assign_coords(
        {d: unwrapped.coords[d] for d in found.dims if d in unwrapped.coords}
    )
