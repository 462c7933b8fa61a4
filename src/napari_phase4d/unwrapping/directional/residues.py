"""Residues of wrapped maps: how many there are, and which changes between frames they tear.

Round a residue the steps of a wrapped map do not add up, so that its phase depends on the way
(Goldstein et al. 1988). A map without residues has one phase only.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled

__all__ = ["residues_of_objects", "sudden_changes"]

#: More are not counted: they fit into a byte. What is not known counts as so many.
MOST = 255
#: An object wider than this, in pixels, may have more of them: what counts is how much of its rim
#: they take. Narrower ones are those that confidence was fitted to.
WIDE = 35.0
#: Residues that noise makes go when phasors are averaged over so many pixels along y and x, while
#: those of steep rims mostly stay.
AVERAGED = 3
#: A change between two frames is sudden if it has this many residues, and so many times those of
#: the changes round it, up to so many frames before and after; of these there must be some.
MORE, TIMES, ROUND, SOME = 10, 3, 2, 2

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Counts = NDArray[np.uint8]


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


# ---- sudden changes --------------------------------------------------------------------------


def sudden_changes(change: Image, known: Mask) -> Mask:
    """Say which changes between frames are torn as none of those round them are.

    After a pause in the recording, or where something happens at once, the map of what changes
    has residues: its steps pass half a turn at the rims, and what lies inside may come out a turn
    off as a whole. Where all changes are like that, frames are still known best by each other; if
    it is one alone, the frames on either side of it know better.

    Parameters
    ----------
    change : ndarray of float32, shape (time, angle, y, x)
        Differences of wrapped phase from each frame to the next, in radians.
    known : ndarray of bool, same shape
        Where both are known.

    Returns
    -------
    ndarray of bool, shape (time,)
        For all views together: what happens, happens in all of them.
    """
    counts = np.zeros(len(change))
    for time, angle in np.ndindex(*change.shape[:2]):
        counts[time] += residues_of(change[time, angle], known[time, angle]) / change.shape[1]
    found = np.zeros(len(change), dtype=bool)
    for time, own in enumerate(counts):
        near = np.concatenate(
            [counts[max(time - ROUND, 0) : time], counts[time + 1 : time + 1 + ROUND]]
        )
        found[time] = len(near) >= SOME and own > MORE + TIMES * np.median(near)
    return found


@compiled
def residues_of(wrapped: Image, known: Mask) -> int:
    """Count the residues of a map, which need not be wrapped itself."""
    total = 0
    for y in range(wrapped.shape[0] - 1):
        for x in range(wrapped.shape[1] - 1):
            if known[y, x] and known[y, x + 1] and known[y + 1, x] and known[y + 1, x + 1]:
                total += residue_at(wrapped, y, x)
    return total


@compiled
def residue_at(wrapped: Image, y: int, x: int) -> int:
    """Return 1 if there is a residue between four pixels, the first of which is given, else 0."""
    turn = np.float32(2 * np.pi)
    a, b = wrapped[y, x], wrapped[y, x + 1]
    c, d = wrapped[y + 1, x + 1], wrapped[y + 1, x]
    turns = np.rint((b - a) / turn) + np.rint((c - b) / turn)
    turns += np.rint((d - c) / turn) + np.rint((a - d) / turn)
    return abs(int(turns))
