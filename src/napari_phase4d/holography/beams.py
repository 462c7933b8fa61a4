"""Telling the views from the beats, counting them, and knowing how sure that is.

With n sample beams and one reference, every pair of beams leaves a peak: n sample-reference
terms, which are the views, and n (n - 1) / 2 sample-sample terms, the *beats*, at the differences
of the views' carriers. Geometry alone can't tell them apart: of three peaks p, q and p - q each is
the difference of the other two, as if any beam could be the reference. Physics nearly always can:

* the edge of the pupil: the lobe of a view ends sharply at the pupil's radius, that of a beat, the
  correlation of two pupils, fades out to twice of it;
* shape: views of one object resemble each other, in how much of their power lies at the carrier
  and how far the rest spreads;
* power: the reference is usually the strongest beam, so that beats are weaker than views; and
  what each pair of views and their beat say of the reference's power must agree;
* steadiness: the sample beams share their way through the microscope and the reference does not,
  so what the arms drift against each other moves the views and leaves the beats at rest;
* bookkeeping: views and their beats explain all peaks that are no ghosts.

Each choice of peaks, with the half plane that each view truly lies in, gets a score that is linear
in these clues, and a softmax over all choices makes it a chance. The weights were fitted to random
simulated recordings (`benchmarks/layouts.py`). Where a sample beam is as smooth as the reference,
no clue is left, and the chance says so.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.holography.lobes import MAX_VIEWS, pair_distance
from napari_phase4d.holography.spectrum import PLAIN, Half, Peak, Spectrum, half_plane

__all__ = ["Choice", "Clues", "choices", "clues_of", "most_likely"]

#: Lobes are looked at on a spectrum of about so many pixels across.
COARSE = 256
#: Width of the rings in which a lobe's profile is taken, in cycles per pixel, and their number.
RING, RINGS = 1 / COARSE, 80
#: Radii, in rings, at which the pupil's edge is looked for, and the rings on either side of it.
EDGES = np.arange(5, 60)
INSIDE, NEAR = 5, 4
#: A mean over fewer pixels says nothing.
ENOUGH = 4
#: Peaks with less than this share of a peak's power take no part of its lobe away.
OWN_SHARE = 0.1
#: How far from the difference of two carriers their beat may be seen, in pixels of the spectrum.
BEAT_PIXELS = 4.2
#: Variance of the logarithm of power that is noise: pi^2 / 6.
LOG_VARIANCE = np.pi**2 / 6
#: Power within so many rings of the carrier is not scattered; farther than so many not counted.
CORE, FAR = 3, 31
#: Phase wander from frame to frame (rad) below which steadiness says nothing; frames it takes.
WANDER_FLOOR_RAD, ENOUGH_FRAMES = 0.05, 4
#: No single clue of power or steadiness outvotes the others by more than this (log of a ratio).
MOST_POWER, MOST_WANDER = 3.0, 2.0
#: What a beat that lies on another view counts, next to one that is seen.
HIDDEN = 0.5
#: A peak so much stronger (log of a ratio: 6 dB) has structure of its own round it.
MUCH_STRONGER = np.log(4)
#: Carriers of two views lie farther apart than this, in cycles per pixel.
LEAST_APART = 0.06
#: Sets of n - 1 views that are tried with one more.
KEPT = 600

#: What the clues count, in the order of `Clues.table`. They were fitted, but for the last, which
#: few of the simulated recordings need. Each is fitted next to clues that say much the same, and
#: what two of them count twice goes off one: so the views' power next to the strongest, and how
#: much their widths differ, have the sign that they would not have alone.
WEIGHTS = np.array(
    [
        13.09,
        -3.22,
        5.15,
        3.17,
        -0.99,
        0.86,
        3.34,
        -18.93,
        -6.69,
        -4.72,
        3.33,
        -1.88,
        -3.3,
        -4.03,
        -4.0,
    ]
)
#: The same for the number of views: of those clues, and what `Clues.tally` adds. Fitted to fewer
#: recordings, these were held to the sign that a clue has alone: what would have the other is 0.
COUNT_WEIGHTS = np.array(
    [
        *(5.09, -1.52, 0.61, 0.6, 0.0, 0.57, 0.91, -0.93, -0.81, -9.09, -4.73),
        *(0.0, -2.07, -1.43, 0.0, -0.62, 1.56, -0.73, -2.79, 0.09, 1.61, -0.26),
    ]
)

Values = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Choice:
    """One way to read the peaks: which are views.

    Parameters
    ----------
    views : tuple of int
        Peaks that are views.
    mirrored : tuple of bool
        Which of them lie at the conjugate of their peak, up to all of them together: there the
        beats tell.
    chance : float
        Chance from 0 to 1 that these are the views, if there are so many.
    beats_seen : bool
        Whether a peak that is no ghost was seen at the beat of any two of them.
    tally : ndarray
        What is left over and what is missing, for the number of views.
    """

    views: tuple[int, ...]
    mirrored: tuple[bool, ...]
    chance: float
    beats_seen: bool
    tally: Values


@dataclass(frozen=True)
class Clues:
    """What each peak shows, and where each pair of peaks would have its beat.

    Parameters
    ----------
    power, width, core, wander : ndarray of shape (peak,)
        Logarithms of the power, the width of the lobe, the share of its power at the carrier, and
        the wander of its phase from frame to frame.
    edge, sharp : ndarray of shape (peak, radius)
        How much the power falls at a radius: as a logarithm, and as its significance next to the
        fall on either side.
    distance : ndarray of shape (1 + peak, peak)
        Of zero and of each peak from every peak or its conjugate, in cycles per pixel.
    ghost : ndarray of bool
        Whether a peak is a ghost.
    beat : ndarray of shape (peak, peak, 2)
        The peak at the difference, and at the sum, of two carriers; -1 for none.
    """

    power: Values
    width: Values
    core: Values
    wander: Values
    edge: Values
    sharp: Values
    distance: Values
    ghost: NDArray[np.bool_]
    beat: Indices

    def __len__(self) -> int:
        return len(self.power)

    @cached_property
    def relative(self) -> Values:
        """Power of each peak relative to the strongest."""
        found: Values = np.exp(self.power - self.power.max())
        return found

    def beats_of(self, views: Indices, mirrored: Indices) -> Indices:
        """Return for each set (set, n) the peaks at the beats of its pairs, -1 for none."""
        pairs = list(itertools.combinations(range(views.shape[1]), 2))
        if not pairs:
            return np.zeros((len(views), 0), dtype=np.intp)
        found = [
            self.beat[views[:, a], views[:, b], (mirrored[:, a] != mirrored[:, b]).astype(int)]
            for a, b in pairs
        ]
        return np.stack(found, axis=1)

    def table(self, views: Indices, mirrored: Indices) -> Values:
        """Return the clues of each set (set, n) as a table (set, clue)."""
        beats = self.beats_of(views, mirrored)
        within, explained = members(views, len(self)), members(beats, len(self))
        explained &= ~within
        number = explained.sum(1)
        some = number > 0
        each = np.maximum(number, 1)

        def apart(values: Values) -> Values:
            """Return by how much views lie above beats."""
            difference = values[views].mean(1) - explained @ values / each
            return np.where(some, difference, 0.0)

        def over_beats(values: Values) -> Values:
            """Return at each radius the mean of views less half that of beats."""
            above: Values = (within @ values) / views.shape[1]
            above -= 0.5 * (explained @ values) / each[:, None]
            return above

        edge = over_beats(self.edge)
        radius = RING * EDGES[edge.argmax(1)]
        left_over = ~within & ~explained & ~self.ghost
        left_over &= ~self._structure(views, within, explained, radius)
        weaker, balance = self._powers(views, beats)
        return np.stack(
            [
                (number + HIDDEN * self._hidden(views, beats)) / max(beats.shape[1], 1),
                np.log1p(100 * (left_over @ self.relative)),
                edge.max(1),
                over_beats(self.sharp).max(1),
                self.power[views].mean(1) - self.power.max(),
                weaker,
                np.clip(apart(self.wander), -MOST_WANDER, MOST_WANDER),
                apart(np.exp(self.core)),
                apart(self.width),
                self.core[views].std(1),
                self.width[views].std(1),
                balance,
                self._overshadowed(views),
                (self.relative[views] < PLAIN).sum(1),
                self.ghost[views].sum(1),
            ],
            axis=1,
        )

    def _structure(
        self,
        views: Indices,
        within: NDArray[np.bool_],
        beats: NDArray[np.bool_],
        radius: Values,
    ) -> NDArray[np.bool_]:
        """Return which peaks are structure of a stronger lobe of each set, (set, peak).

        A view reaches as far as the pupil, a beat and the zero order twice as far.
        """
        found: NDArray[np.bool_] = self.distance[0] < 2 * radius[:, None]
        for side in views.T:
            near = self.distance[1:][side] < np.maximum(radius, LEAST_APART)[:, None]
            found |= near & (self.power < self.power[side][:, None])
        for peak in range(len(self)):
            near = self.distance[1 + peak] < 2 * radius[:, None]
            found |= near & beats[:, peak, None] & (self.power < self.power[peak])
        found &= ~within
        return found

    def _hidden(self, views: Indices, beats: Indices) -> Indices:
        """Return how many beats of each set lie on one of its own views."""
        found: Indices = (beats[:, :, None] == views[:, None, :]).any(2).sum(1)
        return found

    def _overshadowed(self, views: Indices) -> Values:
        """Return how many views of each set lie within the lobe of a much stronger peak."""
        count = np.zeros(len(views))
        for side in views.T:
            near = self.distance[1:][side] < LEAST_APART
            stronger = self.power > self.power[side][:, None] + MUCH_STRONGER
            count += (near & stronger).any(1)
        return count

    def _powers(self, views: Indices, beats: Indices) -> tuple[Values, Values]:
        """Return by how much beats are weaker than their views, and how much pairs disagree.

        A beat has the power of its views, multiplied, over that of the reference.
        """
        none = np.zeros(len(views))
        if not beats.shape[1]:
            return none, none
        first, second = zip(*itertools.combinations(range(views.shape[1]), 2), strict=True)
        a, b = self.power[views[:, first]], self.power[views[:, second]]
        seen = beats >= 0
        count = np.maximum(seen.sum(1), 1)
        below = np.clip(np.minimum(a, b) - self.power[beats], -MOST_POWER, MOST_POWER)
        reference = np.where(seen, a + b - self.power[beats], 0)
        mean = reference.sum(1) / count
        spread = np.where(seen, (reference - mean[:, None]) ** 2, 0).sum(1) / count
        return np.where(seen, below, 0).sum(1) / count, np.sqrt(spread)

    def tally(self, views: Indices, mirrored: Indices, clues: Values, chance: float) -> Values:
        """Return what tells whether there are as many views as in one set."""
        beats = self.beats_of(views[None], mirrored[None])
        missing, n = int((beats < 0).sum()), len(views)
        hidden = int(self._hidden(views[None], beats)[0])
        further = (missing, missing > 0, hidden, hidden > 0, np.log(chance + 1e-9), n, n == 1)
        return np.array([*clues, *further], dtype=float)


def members(indices: Indices, count: int) -> NDArray[np.bool_]:
    """Return which of so many peaks each row of indices names; -1 is none."""
    found = np.zeros((len(indices), count + 1), dtype=bool)
    np.put_along_axis(found, indices, True, axis=1)  # -1 is the column that is left out
    return found[:, :count]


def choices(clues: Clues, most: int = MAX_VIEWS) -> list[list[Choice]]:
    """Return for every number of views the likeliest ways to read the peaks, best first.

    Every pair of peaks is looked at; larger sets are made of the best smaller ones with one more
    view.

    Parameters
    ----------
    clues : Clues
        Of all peaks.
    most : int, optional
        Largest number of views.

    Returns
    -------
    list of list of Choice
        For 1, 2 ... views, at most two each, up to as many as there are peaks.
    """
    found: list[list[Choice]] = []
    views = np.arange(len(clues))[:, None]
    mirrored = np.zeros_like(views)
    for n in range(1, min(most, len(clues)) + 1):
        if n > 1:
            views, mirrored = extended(views, mirrored, len(clues))
        table = clues.table(views, mirrored)
        score = table @ WEIGHTS
        found.append(ranked(clues, views, mirrored, table, score))
        if n > 1:
            best = np.argsort(-score)[:KEPT]
            views, mirrored = views[best], mirrored[best]
    return found


def extended(views: Indices, mirrored: Indices, count: int) -> tuple[Indices, Indices]:
    """Return all sets with one more view, on either side, each once and in order."""
    n = views.shape[1] + 1
    more = np.arange(2 * count)
    codes = np.concatenate(
        [
            np.repeat(2 * views + mirrored, len(more), axis=0),
            np.tile(more, len(views))[:, None],
        ],
        axis=1,
    )
    codes.sort(axis=1)
    peaks, sides = codes // 2, codes % 2
    distinct = (np.diff(peaks, axis=1) > 0).all(1)
    peaks, sides = peaks[distinct], sides[distinct]
    sides = sides ^ sides[:, :1]  # all together on the other side is the same
    unique = np.unique(2 * peaks + sides, axis=0)
    assert unique.shape[1] == n
    return unique // 2, unique % 2


def ranked(
    clues: Clues, views: Indices, mirrored: Indices, table: Values, score: Values
) -> list[Choice]:
    """Return the two best choices of peaks; sets on other sides count together."""
    weight = np.exp(score - score.max())
    weight /= weight.sum()
    _, which = np.unique(views, axis=0, return_inverse=True)
    which = which.ravel()
    chances = np.bincount(which, weight)
    found = []
    for peaks in np.argsort(-chances)[:2]:
        rows = np.flatnonzero(which == peaks)
        best = rows[int(np.argmax(score[rows]))]
        chance = float(chances[peaks])
        tally = clues.tally(views[best], mirrored[best], table[best], chance)
        sides = tuple(bool(side) for side in mirrored[best])
        beats = clues.beats_of(views[best][None], mirrored[best][None])[0]
        seen = bool((~clues.ghost[beats[beats >= 0]]).any())
        found.append(Choice(tuple(int(v) for v in views[best]), sides, chance, seen, tally))
    return found


def most_likely(found: Sequence[Sequence[Choice]], possible: Sequence[bool]) -> tuple[int, Values]:
    """Return how many views there are, and the chance of every number from 1 on.

    Parameters
    ----------
    found : sequence of sequence of Choice
        What `choices` gave.
    possible : sequence of bool
        Whether there may be so many; if none may, all count.
    """
    score = np.array([each[0].tally @ COUNT_WEIGHTS for each in found])
    if any(possible):
        score = np.where(possible, score, -np.inf)
    weight = np.exp(score - score.max())
    chance: Values = weight / weight.sum()
    return int(np.argmax(chance)) + 1, chance


def clues_of(
    peaks: Sequence[Peak], half: Half, spectra: Sequence[Spectrum], shape: tuple[int, int]
) -> Clues:
    """Measure the clues of all peaks.

    Parameters
    ----------
    peaks : sequence of Peak
        Candidates, the strongest first.
    half : ndarray of shape (y, x // 2 + 1)
        Mean power on the half plane kx >= 0.
    spectra : sequence of ndarray of the same shape
        Complex transforms of the frames that it is the mean of.
    shape : tuple of int
        Height and width of the frames.
    """
    coarse, (ky, kx), pooled = coarser(half, shape)
    frames = len(spectra) * pooled
    # What is noise is the mean of so many exponentials.
    floor = (
        float(np.quantile(coarse, 0.1)) * frames / float(scipy.special.gammaincinv(frames, 0.1))
    )
    carriers = [peak.carrier for peak in peaks]
    profiles = [profile(coarse, distance, own) for distance, own in owned(peaks, carriers, ky, kx)]
    total, count, logs = (np.array(values) for values in zip(*profiles, strict=True))
    radius = (np.arange(RINGS) + 0.5) * RING
    scattered = np.maximum(total - floor * count, 0) * (np.arange(RINGS) < FAR)
    power = np.maximum(scattered.sum(1), 1e-30)
    return Clues(
        power=np.log([peak.power for peak in peaks]),
        width=np.log(np.sqrt((scattered * radius**2).sum(1) / power) + 1e-6),
        core=np.log(scattered[:, :CORE].sum(1) / power + 1e-6),
        wander=np.log(wander(carriers, spectra, shape)),
        edge=falls(logs, count),
        sharp=sharpness(logs, count, frames),
        distance=np.array(
            [[pair_distance(a, b) for b in carriers] for a in [(0.0, 0.0), *carriers]]
        ),
        ghost=np.array([peak.ghost for peak in peaks]),
        beat=beat_table(carriers, max(BEAT_PIXELS / min(shape), 0.006)),
    )


def coarser(half: Half, shape: tuple[int, int]) -> tuple[Half, tuple[Values, Values], int]:
    """Return a spectrum pooled to about `COARSE` pixels across, its frequencies, and by how much.

    A larger frame shows the same lobes on more pixels.
    """
    _, kx = half_plane(shape)
    pool_y, pool_x = (max(1, n // COARSE) for n in shape)
    rows, columns = np.arange(0, half.shape[0], pool_y), np.arange(0, half.shape[1], pool_x)
    pooled = np.add.reduceat(np.add.reduceat(half, rows, axis=0), columns, axis=1)
    heights = np.diff([*rows, half.shape[0]])[:, None]
    widths = np.diff([*columns, half.shape[1]])[None, :]
    # The rows of `fftfreq` wrap at the middle, their numbers do not.
    middle_y = (np.arange(half.shape[0]) / shape[0])[rows][:, None] + (heights - 1) / 2 / shape[0]
    middle_x = kx[:, columns] + (widths - 1) / 2 / shape[1]
    return pooled / (heights * widths), (middle_y, middle_x), pool_y * pool_x


def owned(
    peaks: Sequence[Peak], carriers: Sequence[tuple[float, float]], ky: Values, kx: Values
) -> list[tuple[Values, NDArray[np.bool_]]]:
    """Return for each peak the distance of every frequency, and which of them it is nearest to.

    Only zero and peaks that are not much weaker compete with it: those are mostly structure of
    its own lobe, and would cut the lobe off before the pupil's edge. Strongest peaks come first.
    """
    distances = [
        np.minimum(*(distance_to(side, ky, kx) for side in (k, (-k[0], -k[1])))) for k in carriers
    ]
    nearest = list(itertools.accumulate([distance_to((0.0, 0.0), ky, kx), *distances], np.minimum))
    rivals = [sum(other.power >= OWN_SHARE * peak.power for other in peaks) for peak in peaks]
    return [
        (distance, distance <= nearest[count])
        for distance, count in zip(distances, rivals, strict=True)
    ]


def distance_to(carrier: tuple[float, float], ky: Values, kx: Values) -> Values:
    """Return the distance of frequencies from a carrier; a sampled spectrum repeats."""
    dy, dx = ky - carrier[0], kx - carrier[1]
    found: Values = np.hypot(dy - np.round(dy), dx - np.round(dx))
    return found


def profile(half: Half, distance: Values, own: NDArray[np.bool_]) -> tuple[Values, Values, Values]:
    """Return the power, the pixels and the logarithms of power in each ring, summed."""
    ring = np.minimum((distance[own] / RING).astype(int), RINGS - 1)
    power = half[own]
    each = (power, np.ones(power.size), np.log(power + 1e-30))
    total, count, logs = (np.bincount(ring, v, RINGS).astype(np.float64) for v in each)
    return total, count, logs


def falls(logs: Values, count: Values) -> Values:
    """Return by how much log power falls at every radius, (peak, radius); 0 where unknown."""
    before, n_before = means(logs, count, EDGES - INSIDE, EDGES)
    after, n_after = means(logs, count, EDGES, EDGES + INSIDE)
    known = (n_before >= ENOUGH) & (n_after >= ENOUGH)
    return np.where(known, before - after, 0.0)


def sharpness(logs: Values, count: Values, frames: int) -> Values:
    """Return how significant a fall is next to those on either side of it, (peak, radius).

    In standard deviations, on a scale that large ones are compressed on (arsinh).
    """
    starts = (EDGES - 2 * NEAR, EDGES - NEAR, EDGES, EDGES + NEAR)
    level, number = zip(
        *(means(logs, count, np.maximum(s, 0), np.maximum(s + NEAR, 0)) for s in starts),
        strict=True,
    )
    enough = [n >= ENOUGH for n in number]
    each = [1 / np.maximum(n, 1) for n in number]
    fall = level[1] - level[2]
    variance = each[1] + each[2]
    for known, drop, spread in (
        (enough[0], level[0] - level[1], each[0]),
        (enough[3], level[2] - level[3], each[3]),
    ):
        fall = fall - 0.5 * np.where(known, np.maximum(drop, 0), 0)
        variance = variance + 0.25 * np.where(known, spread, 0)
    deviations = fall / np.sqrt(LOG_VARIANCE * variance / frames)
    return np.where(enough[1] & enough[2], np.arcsinh(deviations / 2), 0.0)


def means(logs: Values, count: Values, start: Indices, stop: Indices) -> tuple[Values, Values]:
    """Return the mean over rings from start to stop, (peak, radius), and the pixels in them."""
    sums, numbers = (np.pad(np.cumsum(v, axis=1), ((0, 0), (1, 0))) for v in (logs, count))
    number = numbers[:, stop] - numbers[:, start]
    return (sums[:, stop] - sums[:, start]) / np.maximum(number, 1), number


def wander(
    carriers: Sequence[tuple[float, float]], spectra: Sequence[Spectrum], shape: tuple[int, int]
) -> Values:
    """Return how much the phase of each carrier moves from frame to frame, in radians rms."""
    if len(spectra) < ENOUGH_FRAMES:
        return np.full(len(carriers), WANDER_FLOOR_RAD)
    places = [(round(ky * shape[0]) % shape[0], round(kx * shape[1])) for ky, kx in carriers]
    fields = np.array([[spectrum[place] for place in places] for spectrum in spectra])
    steps = np.angle(fields[1:] * fields[:-1].conj())
    found: Values = np.sqrt(np.mean(steps**2, axis=0) + WANDER_FLOOR_RAD**2)
    return found


def beat_table(carriers: Sequence[tuple[float, float]], tolerance: float) -> Indices:
    """Return the peak at the difference (0) and at the sum (1) of two carriers; -1 for none."""
    count = len(carriers)
    found = np.full((count, count, 2), -1, dtype=np.intp)
    for a, b in itertools.combinations(range(count), 2):
        for side, sign in enumerate((-1, 1)):
            place = np.add(carriers[a], np.multiply(sign, carriers[b]))
            distances = [pair_distance(place, carrier) for carrier in carriers]
            nearest_one = int(np.argmin(distances))
            if distances[nearest_one] < tolerance and nearest_one not in (a, b):
                found[a, b, side] = found[b, a, side] = nearest_one
    return found
