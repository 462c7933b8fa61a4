"""Telling the views from the beats.

With n sample beams and one reference, every pair of beams leaves a peak: n sample-reference
terms, which are the views, and n (n - 1) / 2 sample-sample terms, the *beats*, at the differences
of the carriers. Geometry can't tell them apart: of three peaks p, q and p - q each is the
difference of the other two, as if any beam could be the reference. Physics can:

* strength: the reference is usually the strongest beam, so a beat, the product of the two weaker
  ones, is the weakest of the three;
* steadiness: the sample beams share their way through the microscope and the reference does not,
  so what the arms drift against each other moves the views and leaves the beat at rest;
* consistency: the beat is the product of two whole views, S1 R* times (S2 R*)*, divided by |R|^2,
  which is smooth because the reference did not pass the object. Taken the other way round, a view
  is the product of the other view and the beat divided by |S|^2, which is not smooth; and the
  beat, which reaches twice as far as the pupil, has been cut off.

`choose_views` adds the three, in decibels, for every choice of n peaks. They seldom disagree;
where they do, the user sees all peaks on screen and moves the circles.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.lobes import MAX_VIEWS, Lobe, pair_distance, wrapped_distance

__all__ = ["choose_views", "count_views"]

#: Peaks that are considered at all; three views leave six.
MAX_CANDIDATES = 14
#: What one decibel of each clue counts.
STRENGTH_WEIGHT, CONSISTENCY_WEIGHT, STEADINESS_WEIGHT = 1.0, 2.5, 1.0
#: Bonus in dB for each peak that is explained as a beat of the chosen views.
EXPLAINED_BONUS = 3.0
#: No single clue may outvote the others by more than this many dB.
CLUE_LIMIT = 12.0
#: Radius of the disks that are compared, as a share of the smallest gap between them.
LOOK_SHARE = 0.4
#: Noise of the comparison: misfits below this are equal.
LEAST_MISFIT = 1e-3
#: Phase wander from frame to frame (rad) below which steadiness says nothing.
WANDER_FLOOR_RAD = 0.05


#: Views are weaker than the strongest by less than this (10 dB), where they are to be counted.
SIMILAR = 0.1


class HasCarrier(Protocol):
    """What a candidate must tell."""

    @property
    def carrier(self) -> tuple[float, float]:
        """Carrier (ky, kx) in cycles per pixel."""

    @property
    def power(self) -> float:
        """Power at the carrier."""


P = TypeVar("P", bound=HasCarrier)


def choose_views(
    peaks: Sequence[P],
    n_views: int,
    frames: Sequence[NDArray[np.float32]],
) -> list[P]:
    """Return the n peaks that are most likely views.

    Parameters
    ----------
    peaks : sequence
        Candidates, strongest first, at least ``n_views``.
    n_views : int
        How many to choose.
    frames : sequence of ndarray
        The frames, for their drift and for the strength of the beams.
    """
    candidates = list(peaks[:MAX_CANDIDATES])
    if n_views == 1 or len(candidates) == n_views:
        return candidates[:n_views]
    strength = [10 * np.log10(p.power / candidates[0].power) for p in candidates]
    height, width = frames[0].shape
    tolerance = max(3 / min(height, width), 0.006)
    triples = beat_triples([p.carrier for p in candidates], tolerance)
    if not triples:
        return candidates[:n_views]
    unsteady = STEADINESS_WEIGHT * clipped(decibels(phase_wander(candidates, frames)))
    frame = frames[len(frames) // 2]
    evidence = {
        t: CONSISTENCY_WEIGHT * consistency([candidates[i].carrier for i in t], frame)
        for t in triples
    }

    def score(chosen: tuple[int, ...]) -> float:
        total = STRENGTH_WEIGHT * sum(strength[i] for i in chosen)
        found: dict[int, float] = {}
        for a, b, c in triples:
            if a in chosen and b in chosen and c not in chosen:
                clue = evidence[a, b, c] + float(min(unsteady[a], unsteady[b]) - unsteady[c])
                found[c] = max(found.get(c, -np.inf), EXPLAINED_BONUS + clue)
        return float(total + sum(found.values()))

    best = max(itertools.combinations(range(len(candidates)), n_views), key=score)
    return [candidates[i] for i in best]


def count_views(peaks: Sequence[P], shape: tuple[int, int]) -> int:
    """Return how many views there are: the fewest peaks of which all others are beats.

    Peaks that are weaker than the strongest by more than 10 dB don't count. Of the frames alone
    this can't be told for certain: two views whose sum or difference is a third view count as
    two.

    Parameters
    ----------
    peaks : sequence
        Candidates, strongest first; ghosts have been left out.
    shape : tuple of int
        Height and width of the frames.
    """
    strong = [p for p in peaks[:MAX_CANDIDATES] if p.power >= SIMILAR * peaks[0].power]
    triples = beat_triples([p.carrier for p in strong], max(3 / min(shape), 0.006))
    everything = set(range(len(strong)))
    for n_views in range(1, min(len(strong), MAX_VIEWS) + 1):
        for chosen in itertools.combinations(range(len(strong)), n_views):
            beats = {c for a, b, c in triples if a in chosen and b in chosen}
            if everything <= beats | set(chosen):
                return n_views
    return min(len(strong), MAX_VIEWS)


def beat_triples(
    carriers: Sequence[tuple[float, float]], tolerance: float
) -> list[tuple[int, int, int]]:
    """Return all (a, b, c) where carrier c is the difference or sum of a and b, up to its sign."""
    found = []
    for a, b in itertools.combinations(range(len(carriers)), 2):
        for sign in (1, -1):
            beat = np.add(carriers[a], np.multiply(sign, carriers[b]))
            for c, carrier in enumerate(carriers):
                if c not in (a, b) and pair_distance(beat, carrier) < tolerance:
                    found.append((a, b, c))
    return found


def consistency(carriers: Sequence[tuple[float, float]], frame: NDArray[np.float32]) -> float:
    """Return in dB how much better the third of three peaks is the beat than one of the others."""
    gaps = [pair_distance(a, b) for a, b in itertools.combinations([(0.0, 0.0), *carriers], 2)]
    radius = LOOK_SHARE * min(gaps)
    fields = Demodulator(frame.shape, [Lobe(k, radius) for k in carriers], "disk")(frame)
    fields = zero_padded(fields, 2)
    misfit = [1 - product_agreement(fields, carriers, i) for i in range(3)]
    ratio = max(min(misfit[:2]), LEAST_MISFIT) / max(misfit[2], LEAST_MISFIT)
    return float(np.clip(10 * np.log10(ratio), -CLUE_LIMIT, CLUE_LIMIT))


def zero_padded(fields: NDArray[np.complex64], factor: int) -> NDArray[np.complex64]:
    """Return band-limited fields on a grid finer by a factor."""
    _, height, width = fields.shape
    spectrum = scipy.fft.fftshift(scipy.fft.fft2(fields), axes=(1, 2))
    rows, columns = (factor - 1) * height // 2, (factor - 1) * width // 2
    padded = np.pad(spectrum, ((0, 0), (rows, rows), (columns, columns)))
    finer: NDArray[np.complex64] = scipy.fft.ifft2(scipy.fft.ifftshift(padded, axes=(1, 2)))
    return finer


def product_agreement(
    fields: NDArray[np.complex64], carriers: Sequence[tuple[float, float]], beat: int
) -> float:
    """Return how well one of three fields equals the product of the others, cut to its band.

    Returns
    -------
    float
        Largest normalised correlation over small tilts, 0 to 1.
    """
    a, b = (i for i in range(3) if i != beat)
    first, second, target = fields[a], fields[b].conj(), fields[beat]
    expected = np.subtract(carriers[a], carriers[b])
    total = np.add(carriers[a], carriers[b])
    if pair_distance(expected, carriers[beat]) > pair_distance(total, carriers[beat]):
        second, expected = fields[b], total
    if wrapped_distance(expected, carriers[beat]) > wrapped_distance(-expected, carriers[beat]):
        target = target.conj()
    band = np.abs(scipy.fft.fft2(fields)).max(axis=0)
    inside = band > 1e-5 * band.max()
    product = scipy.fft.ifft2(scipy.fft.fft2(first * second) * inside)
    edge = tuple(slice(n // 8, n - n // 8) for n in target.shape)
    product, target = product[edge], target[edge]  # a frame's edges do not fit together
    overlap = scipy.fft.fft2(product * target.conj(), s=[4 * n for n in target.shape])
    norm = np.linalg.norm(product) * np.linalg.norm(target)
    return float(np.abs(overlap).max() / norm) if norm > 0 else 0.0


def phase_wander(
    candidates: Sequence[HasCarrier], frames: Sequence[NDArray[np.float32]]
) -> NDArray[np.float64]:
    """Return how much the phase of each carrier moves from frame to frame, in radians rms."""
    if len(frames) < 4:
        return np.full(len(candidates), WANDER_FLOOR_RAD)
    height, width = frames[0].shape
    y, x = np.arange(height), np.arange(width)
    wander = []
    for candidate in candidates:
        ky, kx = candidate.carrier
        rows = np.exp(-2j * np.pi * ky * y).astype(np.complex64)
        columns = np.exp(-2j * np.pi * kx * x).astype(np.complex64)
        carrier = np.array([rows @ frame @ columns for frame in frames])
        steps = np.angle(carrier[1:] * carrier[:-1].conj())
        wander.append(np.sqrt(np.mean(steps**2) + WANDER_FLOOR_RAD**2))
    return np.array(wander)


def decibels(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return values in dB relative to their median."""
    result: NDArray[np.float64] = 20 * np.log10(values / np.median(values))
    return result


def clipped(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Limit a clue to `CLUE_LIMIT` dB."""
    return np.clip(values, -CLUE_LIMIT, CLUE_LIMIT)
