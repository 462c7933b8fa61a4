"""The lobes round peaks of the spectrum: how wide they are, and where they end.

Power and its logarithm are averaged in rings round each peak, on the pixels that are nearest to
it. `beams` tells views from beats by them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.holography.peaks import Half, Peak, half_plane

__all__ = ["EDGES", "RING", "Profiles", "profiles_of"]

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
#: Variance of the logarithm of power that is noise: pi^2 / 6.
LOG_VARIANCE = np.pi**2 / 6
#: Power within so many rings of the carrier is not scattered; farther than so many not counted.
CORE, FAR = 3, 31

Values = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Profiles:
    """What the lobes round some peaks look like.

    Parameters
    ----------
    width, core : ndarray of shape (peak,)
        Logarithms of the width of the lobe and of the share of its power at the carrier.
    edge, sharp : ndarray of shape (peak, radius)
        How much the power falls at a radius: as a logarithm, and as its significance next to the
        fall on either side.
    """

    width: Values
    core: Values
    edge: Values
    sharp: Values


def profiles_of(
    peaks: Sequence[Peak], looks: Sequence[tuple[Half, int]], shape: tuple[int, int]
) -> list[Profiles]:
    """Measure the lobes round peaks, the strongest first, in each of some looks.

    Parameters
    ----------
    peaks : sequence of Peak
        The strongest first.
    looks : sequence of tuple
        Each the mean power on the half plane kx >= 0, and of how many frames it is the mean.
    shape : tuple of int
        Height and width of the frames.
    """
    pooled = [coarser(half, shape) for half, _ in looks]
    ky, kx = pooled[0][1]
    own = owned(peaks, [peak.carrier for peak in peaks], ky, kx)
    return [
        measured(coarse, own, frames * together)
        for (coarse, _, together), (_, frames) in zip(pooled, looks, strict=True)
    ]


def measured(
    coarse: Half, own: Sequence[tuple[Values, NDArray[np.bool_]]], frames: int
) -> Profiles:
    """Measure lobes on a pooled spectrum, each pixel of which is the mean of so many."""
    # What is noise is the mean of so many exponentials.
    floor = (
        float(np.quantile(coarse, 0.1)) * frames / float(scipy.special.gammaincinv(frames, 0.1))
    )
    rings = [profile(coarse, distance, nearest) for distance, nearest in own]
    total, count, logs = (np.array(values) for values in zip(*rings, strict=True))
    radius = (np.arange(RINGS) + 0.5) * RING
    scattered = np.maximum(total - floor * count, 0) * (np.arange(RINGS) < FAR)
    power = np.maximum(scattered.sum(1), 1e-30)
    return Profiles(
        width=np.log(np.sqrt((scattered * radius**2).sum(1) / power) + 1e-6),
        core=np.log(scattered[:, :CORE].sum(1) / power + 1e-6),
        edge=falls(logs, count),
        sharp=sharpness(logs, count, frames),
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
