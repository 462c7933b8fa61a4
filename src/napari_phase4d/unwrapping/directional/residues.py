"""Residues of wrapped maps: how many there are, and which changes between frames they tear.

Round a residue the steps of a wrapped map do not add up, so that its phase depends on the way
(Goldstein et al. 1988). A map without residues has one phase only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = [
    "FEW",
    "residues_of_maps",
    "residues_of_objects",
    "torn_changes",
    "torn_objects",
    "torn_of_few",
    "torn_views",
]

#: More are not counted: they fit into a byte. What is not known counts as so many.
MOST = 255
#: An object wider than this, in pixels, may have more of them: what counts is how much of its rim
#: they take. Narrower ones are those that confidence was fitted to.
WIDE = 35.0
#: Residues that noise makes go when phasors are averaged over so many pixels along y and x, while
#: those of steep rims mostly stay.
AVERAGED = 3
#: A change between two frames is torn if it has this many residues more than so many times those
#: of the changes round it (their median): over time those up to so many frames before and after.
MORE, TIMES, ROUND = 10, 3, 2
#: Those right beside it must have less by this factor: one frame tears both of its changes alike.
ALONE = 1.5
#: In recordings of no more frames than this it is torn if it has so many more than both frames.
FEW = 4
#: A residue lies at the rim of an object if there is empty field within so many pixels.
RIM = 3
#: Noise makes the residues of a map if there is more than one in so many pixels of empty field.
NOISE_EACH = 400

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Counts = NDArray[np.uint8]
Totals = NDArray[np.int64]


def residues_of_objects(
    wrapped: Image, known: Mask, thing: Mask, seams: NDArray[np.int16], noisy: bool
) -> Counts:
    """Return for every pixel of an object how many residues the object has; 0 elsewhere.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (y, x)
        Wrapped phase, or its change, in radians.
    known, thing : ndarray of bool, same shape
        Where it is known; where it is not empty field.
    seams : ndarray of int, same shape
        Pixels of different numbers are no neighbours.
    noisy : bool
        Whether noise by itself makes residues.
    """
    # Residues lie between four pixels, and those at a rim belong to what is inside.
    labels, count = scipy.ndimage.label(scipy.ndimage.binary_dilation(thing & known))
    sums = np.zeros(count + 1, dtype=np.int64)
    if count:
        phase = averaged(wrapped, known) if noisy else wrapped
        count_residues(phase, known, seams, labels, sums)
        width = np.sqrt(np.bincount(labels.ravel(), minlength=count + 1))
        sums = np.ceil(sums / np.maximum(width / WIDE, 1)).astype(np.int64)
    each = np.minimum(sums, MOST).astype(np.uint8)
    found: Counts = np.where(thing, np.where(known, each[labels], np.uint8(MOST)), np.uint8(0))
    return found


def averaged(wrapped: Image, known: Mask) -> Image:
    """Return the phase of the mean phasor of the pixels round each one."""
    unit = np.where(known, np.exp(1j * wrapped), 0)
    parts = (scipy.ndimage.uniform_filter(part, AVERAGED) for part in (unit.real, unit.imag))
    real, imaginary = parts
    found: Image = np.arctan2(imaginary, real).astype(np.float32)
    return found


@compiled
def count_residues(
    wrapped: Image,
    known: Mask,
    seams: NDArray[np.int16],
    labels: NDArray[np.int32],
    sums: NDArray[np.int64],
) -> None:
    """Add the residues of a map to those of the part that the pixel at their upper left is of."""
    for y in range(wrapped.shape[0] - 1):
        for x in range(wrapped.shape[1] - 1):
            part = labels[y, x]
            if part == 0 or not (
                known[y, x] and known[y, x + 1] and known[y + 1, x] and known[y + 1, x + 1]
            ):
                continue
            side = seams[y, x]
            if seams[y, x + 1] != side or seams[y + 1, x] != side or seams[y + 1, x + 1] != side:
                continue
            sums[part] += residue_at(wrapped, y, x)


# ---- changes that are torn -------------------------------------------------------------------


def residues_of_maps(maps: Image, known: Mask, bare: Mask, axis: int) -> Totals:
    """Count the residues of objects in each map: of what changes, or of frames themselves.

    Over time those at their rims: there a whole cell slips. Those of a wall inside it say that
    something has moved there, not that the cell's level is another. From one view to the next
    all count, as each is known by what it was before.

    Parameters
    ----------
    maps : ndarray of float32, shape (time, angle, y, x)
        What changes, or the phase of frames, in radians; it need not be wrapped.
    known, bare : ndarray of bool, same shape
        Where it is known; where there is empty field, of changes before and after. A map
        without any of it counts as all rim, one with residues in it has none: it is noise that
        makes them there.
    axis : int
        0 for frames and what changes over time, 1 for what does from view to view.
    """
    found = np.zeros(maps.shape[:2], dtype=np.int64)
    for frame in np.ndindex(*found.shape):
        found[frame] = residues_of(maps[frame], known[frame], bare[frame], axis == 0)
    return found


def torn_changes(counts: Totals) -> Mask:
    """Say which changes over time are torn as none of those round them are.

    Where the map of what changes has residues, what lies inside may come out a turn off as a
    whole. If all changes are like that, frames are still known best by each other. If it is this
    one alone, they are known better without it: after a pause in the recording, or where
    something happens at once, the frames on either side of it by themselves.

    Parameters
    ----------
    counts : ndarray of int, shape (time - 1, angle)
        Residues of each change.

    Returns
    -------
    ndarray of bool, shape (time - 1, angle)
        Torn in all views or in none: what happens is seen from everywhere. The first change and
        the last one never are, as frames on one side of them alone would be all that there is.
    """
    found = np.zeros(counts.shape, dtype=bool)
    means = counts.mean(axis=1)
    # What is seen in one frame alone, as noise, comes with one change and goes with the next.
    for time in range(1, len(means) - 1):
        before, after = means[max(time - ROUND, 0) : time], means[time + 1 :][:ROUND]
        alone = means[time] > ALONE * max(before[-1], after[0])
        found[time] = alone and is_torn(means[time], np.concatenate([before, after]))
    return found


def torn_of_few(counts: Totals, frames: Totals) -> Mask:
    """Say which changes over time are torn in a recording of a few frames.

    There are no others then to hold a change against, but the frames themselves, which may have
    residues as well: it is torn if it has more than both.

    Parameters
    ----------
    counts : ndarray of int, shape (time - 1, angle)
        Residues of each change.
    frames : ndarray of int, shape (time, angle)
        Residues of each frame.

    Returns
    -------
    ndarray of bool, shape (time - 1, angle)
        Torn in all views or in none.
    """
    own = frames.mean(axis=1)
    torn = counts.mean(axis=1) > MORE + np.maximum(own[1:], own[:-1])
    found: Mask = np.repeat(torn[:, None], counts.shape[1], axis=1)
    return found


def is_torn(own: float, near: NDArray[Any]) -> bool:
    """Say whether a change has far more residues than those round it."""
    return bool(own > MORE + TIMES * np.median(near))


def torn_views(over_time: Totals, counts: Totals) -> Mask:
    """Say which changes between views are torn, as neither view is by time.

    Where two views differ much, each is known better by what it was before.

    Parameters
    ----------
    over_time : ndarray of int, shape (time - 1, angle)
        Residues of each change over time.
    counts : ndarray of int, shape (time, angle - 1)
        Residues of each change from view to view.

    Returns
    -------
    ndarray of bool, shape (time, angle - 1)
    """
    found = np.zeros(counts.shape, dtype=bool)
    for time, angle in np.ndindex(*counts.shape):
        near = over_time[max(time - 1, 0) : time + 1, angle : angle + 2]
        found[time, angle] = near.size > 1 and is_torn(float(counts[time, angle]), near)
    return found


def torn_objects(change: Image, known: Mask, bare: Mask) -> Mask:
    """Return the pixels of those objects that tear a map of what changes: no others slip."""
    labels, count = scipy.ndimage.label(scipy.ndimage.binary_dilation(known & ~bare))
    sums = np.zeros(count + 1, dtype=np.int64)
    count_residues(change, known, np.zeros(change.shape, np.int16), labels, sums)
    found: Mask = (sums > MORE)[labels]
    return found


@compiled
def residues_of(wrapped: Image, known: Mask, bare: Mask, rims: bool) -> int:
    """Do a map of `residues_of_maps`."""
    total, counted, empty, in_empty = 0, 0, 0, 0
    for y in range(wrapped.shape[0] - 1):
        for x in range(wrapped.shape[1] - 1):
            if not (known[y, x] and known[y, x + 1] and known[y + 1, x] and known[y + 1, x + 1]):
                continue
            ground = bare[y, x] and bare[y, x + 1] and bare[y + 1, x] and bare[y + 1, x + 1]
            empty += ground
            here = residue_at(wrapped, y, x)
            if here == 0:
                continue
            total += here
            if ground:
                in_empty += here
            elif (
                not rims
                or bare[max(y - RIM, 0) : y + 2 + RIM, max(x - RIM, 0) : x + 2 + RIM].any()
            ):
                counted += here
    if empty == 0:
        return total
    return counted if NOISE_EACH * in_empty <= empty else 0


@compiled
def residue_at(wrapped: Image, y: int, x: int) -> int:
    """Return 1 if there is a residue between four pixels, the first of which is given, else 0."""
    turn = np.float32(2 * np.pi)
    a, b = wrapped[y, x], wrapped[y, x + 1]
    c, d = wrapped[y + 1, x + 1], wrapped[y + 1, x]
    turns = np.rint((b - a) / turn) + np.rint((c - b) / turn)
    turns += np.rint((d - c) / turn) + np.rint((a - d) / turn)
    return abs(int(turns))
