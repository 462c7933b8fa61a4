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

The clues are measured in two looks, and the chance is the mean of both: one window hides what lies
near the border of the frames, the other what its side lobes outshine. Where they disagree,
no choice has a high one.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.lobes import MAX_VIEWS, pair_distance
from napari_phase4d.holography.peaks import PLAIN, Half, Peak, Spectrum
from napari_phase4d.holography.profiles import EDGES, RING, profiles_of

__all__ = ["Choice", "Clues", "choices", "clues_of", "most_likely"]

#: How far from the difference of two carriers their beat may be seen, in pixels of the spectrum.
BEAT_PIXELS = 4.2
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
#: Sets of n - 1 views that are tried with one more, and sets of which a second look is taken.
KEPT, LOOKED_AT = 600, 200

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
#: recordings (seeds 800000 to 803600), these were held to the sign that a clue has alone: what
#: would have the other is 0. That also serves recordings with ghosts better.
COUNT_WEIGHTS = np.array(
    [
        *(7.16, -2.59, 1.42, 0.0, 0.0, 0.0, 1.16, -4.26, 0.0, -24.7, -6.37),
        *(0.0, -3.22, -1.89, 0.0, -0.41, 0.52, -0.4, -4.64, 1.14, 2.26, -1.48),
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


def choices(looks: Sequence[Clues], most: int = MAX_VIEWS) -> list[list[Choice]]:
    """Return for every number of views the likeliest ways to read the peaks, best first.

    Every pair of peaks is looked at; larger sets are made of the best smaller ones with one more
    view.

    Parameters
    ----------
    looks : sequence of Clues
        Of all peaks, in each look.
    most : int, optional
        Largest number of views.

    Returns
    -------
    list of list of Choice
        For 1, 2 ... views, at most two each, up to as many as there are peaks.
    """
    clues = looks[0]
    found: list[list[Choice]] = []
    views = np.arange(len(clues))[:, None]
    mirrored = np.zeros_like(views)
    for n in range(1, min(most, len(clues)) + 1):
        if n > 1:
            views, mirrored = extended(views, mirrored, len(clues))
        table = clues.table(views, mirrored)
        score = table @ WEIGHTS
        found.append(ranked(looks, views, mirrored, table))
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
    looks: Sequence[Clues], views: Indices, mirrored: Indices, table: Values
) -> list[Choice]:
    """Return the two best choices of peaks; sets on other sides count together.

    The chance of a set is the mean of those that the looks give it.
    """
    clues, *others = looks
    chance = softmax(table @ WEIGHTS)
    if others:
        best = np.argsort(-chance)[:LOOKED_AT]
        views, mirrored = views[best], mirrored[best]
        each = [softmax(look.table(views, mirrored) @ WEIGHTS) for look in others]
        chance = np.mean([chance[best], *each], axis=0)
    # The number was fitted to the powers of the first look.
    counted = [clues, *(replace(look, power=clues.power) for look in others)]
    _, which = np.unique(views, axis=0, return_inverse=True)
    which = which.ravel()
    chances = np.bincount(which, chance)
    found = []
    for peaks in np.argsort(-chances)[:2]:
        rows = np.flatnonzero(which == peaks)
        row = rows[int(np.argmax(chance[rows]))]
        chosen = views[row : row + 1], mirrored[row : row + 1]
        mean = np.mean([look.table(*chosen)[0] for look in counted], axis=0)
        tally = clues.tally(views[row], mirrored[row], mean, float(chances[peaks]))
        sides = tuple(bool(side) for side in mirrored[row])
        beats = clues.beats_of(*chosen)[0]
        seen = bool((~clues.ghost[beats[beats >= 0]]).any())
        numbers = tuple(int(v) for v in views[row])
        found.append(Choice(numbers, sides, float(chances[peaks]), seen, tally))
    return found


def softmax(score: Values) -> Values:
    """Return chances that add up to 1."""
    weight = np.exp(score - score.max())
    chance: Values = weight / weight.sum()
    return chance


def most_likely(
    found: Sequence[Sequence[Choice]], possible: Sequence[Sequence[bool]]
) -> tuple[int, Values]:
    """Return how many views there are, and the chance of every number from 1 on.

    All choices count, since of so many views the likeliest may not be the one that explains most.

    Parameters
    ----------
    found : sequence of sequence of Choice
        What `choices` gave.
    possible : sequence of sequence of bool
        Whether each may be; if none may, all count.
    """
    number = np.concatenate([[n] * len(each) for n, each in enumerate(found)])
    score = np.array([choice.tally @ COUNT_WEIGHTS for each in found for choice in each])
    can = np.concatenate(possible)
    if can.any():
        score = np.where(can, score, -np.inf)
    chance = np.bincount(number, softmax(score), len(found)).astype(np.float64)
    return int(np.argmax(chance)) + 1, chance


def clues_of(
    peaks: Sequence[Peak],
    places: Sequence[tuple[float, float]],
    looks: Sequence[tuple[Half, int]],
    spectra: Sequence[Spectrum],
    shape: tuple[int, int],
) -> list[Clues]:
    """Measure the clues of all peaks in each of some looks.

    Parameters
    ----------
    peaks : sequence of Peak
        Candidates, the strongest first.
    places : sequence of tuple of float
        Where light that nothing scattered lies near to each; beats lie at the differences.
    looks : sequence of tuple
        Each the mean power on the half plane kx >= 0, and of how many frames it is the mean. The
        first is that in which the peaks were found; in others they are as high as their places.
    spectra : sequence of ndarray of shape (y, x // 2 + 1)
        Complex transforms of the frames of the first look.
    shape : tuple of int
        Height and width of the frames.
    """
    first, *others = (vars(each) for each in profiles_of(peaks, looks, shape))
    clues = Clues(
        power=np.log([peak.power for peak in peaks]),
        wander=np.log(wander([peak.carrier for peak in peaks], spectra, shape)),
        distance=np.array([[pair_distance(a, b) for b in places] for a in [(0.0, 0.0), *places]]),
        ghost=np.array([peak.ghost for peak in peaks]),
        beat=beat_table(places, max(BEAT_PIXELS / min(shape), 0.006)),
        **first,
    )
    # Each look has its own powers: one hides what lies near the border of the frames.
    powers = [[power_at(place, half, shape) for place in places] for half, _ in looks[1:]]
    own = zip(powers, others, strict=True)
    return [clues, *(replace(clues, power=np.log(power), **each) for power, each in own)]


def power_at(carrier: tuple[float, float], half: Half, shape: tuple[int, int]) -> float:
    """Return the power of a spectrum at a carrier on its half plane."""
    row, column = (round(k * n) for k, n in zip(carrier, shape, strict=True))
    return max(float(half[row, column]), np.finfo(float).tiny)


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
