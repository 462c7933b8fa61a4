"""Finding the lobes of a recording without help.

The steps, each a function below:

1. mean power spectrum of windowed frames, on the half plane kx >= 0 (the other is its mirror);
2. peaks that stand out of the *ring* of equal frequency round zero. The zero order fills its
   rings evenly, so this masks it by its own measured width, and a carrier may lie on an axis;
3. no ghosts: harmonics of a stronger peak, its copies shifted by half the sampling frequency
   (interlaced video, JPEG colour) or by multiples of an eighth (JPEG blocks);
4. among what is left, no beats (see `beams`);
5. the carrier to a hundredth of a pixel of the spectrum, and the largest radius that fits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.holography.beams import choose_views, count_views
from napari_phase4d.holography.lobes import (
    MAX_VIEWS,
    Lobe,
    canonical,
    pair_distance,
    wrapped_distance,
)
from napari_phase4d.holography.sign import object_is_dark
from napari_phase4d.holography.spectrum import mean_half_spectrum
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch
from napari_phase4d.recording import Recording
from napari_phase4d.words import counted

__all__ = ["find_lobes"]

#: Frames that the spectrum is averaged over, and the memory that they may take.
MAX_FRAMES, MAX_FRAME_BYTES = 64, 512 * 2**20
#: How far a carrier stands above the median of its ring, as a ratio of powers (100 = 20 dB).
STANDS_OUT = 100.0
#: The same where no peak reaches it: a faint carrier is better than none.
STANDS_OUT_FAINT = 20.0
#: Peaks weaker than the strongest by more than this (20 dB) are no views.
DYNAMIC_RANGE = 1e-2
#: Half the width of a Blackman window's main lobe, in pixels of the spectrum.
MAIN_LOBE = 3
#: Ghosts are at least this much weaker than what they copy: shifted copies 3 dB, harmonics 10 dB.
SHIFTED_COPY, HARMONIC = 0.5, 0.1
ZERO = (0.0, 0.0)
#: A lobe larger than this share of its distance from zero would reach into the zero order.
MAX_RADIUS_SHARE = 0.42
MIN_RADIUS_SHARE = 1 / 3


@dataclass(frozen=True)
class Peak:
    """A local maximum of the spectrum: carrier in cycles/px, power, and its ratio to the ring."""

    carrier: tuple[float, float]
    power: float
    prominence: float


def find_lobes(
    rec: Recording,
    n_views: int | None = 2,
    *,
    angles_deg: Sequence[float] | None = None,
    radius: float | None = None,
    orient: bool = True,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> list[Lobe]:
    """Find the cross-correlation terms of the views in the spectrum of a recording.

    Parameters
    ----------
    rec : Recording
        The hologram video; up to 64 frames of it are looked at.
    n_views : int, optional
        How many views there are, 1 to 6, default 2. None: as many as there seem to be.
    angles_deg : sequence of float, optional
        Viewing angles in degrees, in the order of the lobes. A hologram can't tell them; by
        default the views are numbered 0, 1, 2 ...
    radius : float, optional
        Radius of all lobes in cycles per pixel. Default: as large as the pupil seems to be and
        as the neighbours allow.
    orient : bool, optional
        Whether to flip a lobe in which a clear object would come out with less phase than the
        background. Default True: cells are denser than water.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the search.

    Returns
    -------
    list of Lobe
        Carriers in the half plane kx >= 0, ordered counter-clockwise as seen on the screen (y
        down), starting from straight down.

    Raises
    ------
    ValueError
        If ``n_views`` is out of range or fewer carriers can be seen.

    See Also
    --------
    power_spectrum : What they are found in.
    reconstruct : What they are for.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena(n_times=2)
    >>> rec = p4d.simulation.multiplexed_video(exact["phase"])
    >>> for lobe in p4d.find_lobes(rec, n_views=2, angles_deg=(-7, 21)):
    ...     print(lobe.angle_deg, [round(k, 2) for k in lobe.carrier])
    -7.0 [0.19, 0.21]
    21.0 [-0.21, 0.19]
    """
    known = isinstance(n_views, (int, np.integer))
    if n_views is not None and not (known and 1 <= n_views <= MAX_VIEWS):
        msg = f"n_views must lie between 1 and {MAX_VIEWS}, but is {n_views!r}"
        raise ValueError(msg)
    if n_views is None and angles_deg is not None:
        n_views = len(angles_deg)
    if angles_deg is not None and len(angles_deg) != n_views:
        msg = f"angles_deg has {len(angles_deg)} angles for {n_views} views; give one each"
        raise ValueError(msg)
    at_most = max(4, MAX_FRAME_BYTES // (4 * math.prod(rec.frame_shape)))
    indices = rec.sample_indices(min(MAX_FRAMES, at_most))
    watch = Watch(len(indices) + (n_views or 1) + 1, "finding the lobes", progress, cancelled)
    frames = []
    for index in indices:
        frames.append(rec.frame(index))
        watch.step()
    half = mean_half_spectrum(frames, rec.frame_shape)
    watch.check()
    peaks = without_ghosts(find_peaks(half, rec.frame_shape), rec.frame_shape)
    if not peaks or (n_views is not None and len(peaks) < n_views):
        raise ValueError(too_few(rec.name, len(peaks), n_views or 1))
    if n_views is None:
        n_views = count_views(peaks, rec.frame_shape)
        watch.total = len(indices) + n_views + 1
    views = choose_views(peaks, n_views, frames)
    watch.step()
    carriers = []
    for view in views:
        carriers.append(refined(view.carrier, frames))
        watch.step()
    others = [p.carrier for p in peaks if p not in views]
    # All views pass one pupil, so one radius serves all.
    radius = radius or min(
        proposed_radius(k, [*carriers, *others], half, rec.frame_shape) for k in carriers
    )
    lobes = [Lobe(k, radius) for k in carriers]
    lobes.sort(key=lambda lobe: np.arctan2(-lobe.carrier[0], lobe.carrier[1]))
    angles = range(n_views) if angles_deg is None else angles_deg
    return [
        Lobe(
            lobe.carrier,
            lobe.radius,
            float(angle),
            flip=orient and object_is_dark(frames[len(frames) // 2], lobe),
        )
        for lobe, angle in zip(lobes, angles, strict=True)
    ]


def too_few(name: str, found: int, wanted: int) -> str:
    """Say that fewer carriers can be seen than views were asked for, and what to do."""
    instead = {0: "", 1: "ask for 1 view, or "}.get(found, f"ask for {found} views, or ")
    return (
        f"{name} shows {counted(found, 'carrier')}, but {wanted} views were asked for; {instead}"
        "place the lobes by hand"
    )


def find_peaks(half: NDArray[np.float64], shape: tuple[int, int]) -> list[Peak]:
    """Return the maxima that stand out of their ring, strongest first."""
    ky, kx = half_plane(shape)
    ratio = half / ring_median(half, shape)
    maxima = local_maxima(half, shape)
    # kx = 0 holds each pair twice; keep the one with ky > 0.
    maxima &= (kx > 0) | (ky > 0)
    # Inside the main lobe of the window lies what is left of the mean.
    maxima &= (np.abs(ky) * shape[0] > MAIN_LOBE) | (np.abs(kx) * shape[1] > MAIN_LOBE)
    for threshold in (STANDS_OUT, STANDS_OUT_FAINT):
        rows, columns = np.nonzero(maxima & (ratio > threshold))
        if len(rows):
            break
    order = np.argsort(-half[rows, columns])
    peaks = [
        Peak(
            (float(ky[rows[i], 0]), float(kx[0, columns[i]])),
            float(half[rows[i], columns[i]]),
            float(ratio[rows[i], columns[i]]),
        )
        for i in order
    ]
    return [p for p in apart(peaks, shape) if p.power > DYNAMIC_RANGE * peaks[0].power]


def half_plane(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the frequencies of an `rfft2` as a column ky and a row kx, in cycles per pixel."""
    return scipy.fft.fftfreq(shape[0])[:, None], scipy.fft.rfftfreq(shape[1])[None, :]


def ring_median(half: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return for each frequency the median power of the ring it lies on."""
    ky, kx = half_plane(shape)
    width = max(1.5 / min(shape), 0.004)
    ring = (np.hypot(ky, kx) / width).astype(int)
    median = np.asarray(ndimage.median(half, ring, np.arange(ring.max() + 1)))
    position = np.hypot(ky, kx) / width - 0.5
    levels: NDArray[np.float64] = np.interp(position, np.arange(len(median)), median)
    return np.maximum(levels, np.finfo(float).tiny)


def local_maxima(half: NDArray[np.float64], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Mark the pixels that no neighbour within the window's main lobe exceeds."""
    # One column more than the main lobe on the left shows maxima at kx = 0 whole.
    mirrored = half[(-np.arange(shape[0])) % shape[0]][:, MAIN_LOBE:0:-1]
    padded = np.concatenate([mirrored, half], axis=1)
    highest = ndimage.maximum_filter(padded, size=2 * MAIN_LOBE + 1, mode=("wrap", "nearest"))
    maxima: NDArray[np.bool_] = (padded == highest)[:, MAIN_LOBE:]
    return maxima


def apart(peaks: list[Peak], shape: tuple[int, int]) -> list[Peak]:
    """Drop peaks that belong to the lobe of a stronger one: its structure, not a carrier."""
    kept: list[Peak] = []
    reach = max(8 / min(shape), 0.04)
    for peak in peaks:
        near = (
            pair_distance(peak.carrier, k.carrier) < min(reach, 0.6 * np.hypot(*k.carrier))
            for k in kept
        )
        if not any(near):
            kept.append(peak)
    return kept


def without_ghosts(peaks: list[Peak], shape: tuple[int, int]) -> list[Peak]:
    """Drop what a camera, a video or JPEG makes of a stronger peak."""
    kept: list[Peak] = []
    tolerance = max(2.5 / min(shape), 0.004)
    zero_order = Peak(ZERO, np.inf, np.inf)
    for peak in peaks:
        if not any(is_ghost(peak, stronger, tolerance) for stronger in (zero_order, *kept)):
            kept.append(peak)
    return kept


def is_ghost(peak: Peak, source: Peak, tolerance: float) -> bool:
    """Say whether a peak is a harmonic or a shifted copy of a stronger one."""
    ky, kx = source.carrier
    relative = peak.power / source.power
    if relative < SHIFTED_COPY and any(
        pair_distance(peak.carrier, (ky + dy, kx + dx)) < tolerance
        for dy, dx in ((0.5, 0), (0, 0.5), (0.5, 0.5))
    ):
        return True
    if relative >= HARMONIC or source.carrier == ZERO:
        return False
    if any(
        pair_distance(peak.carrier, (n * ky, n * kx)) < max(n, 1) * tolerance / 2
        for n in (0.5, 2, 3, 4)
    ):
        return True
    blocks = ((ky + i / 8, kx + j / 8) for i in range(8) for j in range(8) if i or j)
    return any(pair_distance(peak.carrier, k) < tolerance / 2 for k in blocks)


def refined(
    carrier: tuple[float, float], frames: Sequence[NDArray[np.float32]]
) -> tuple[float, float]:
    """Return the carrier to about a hundredth of a spectral pixel.

    The Fourier transform of the windowed frames is evaluated on ever finer grids round the peak
    (a matrix product, Soummer et al. 2007), and the largest mean power wins.
    """
    height, width = frames[0].shape
    y, x = np.arange(height), np.arange(width)
    wy, wx = np.blackman(height + 2)[1:-1], np.blackman(width + 2)[1:-1]
    ky, kx = carrier
    for span in (1.5, 0.3, 0.06):
        rows = ky + np.linspace(-span, span, 21) / height
        columns = kx + np.linspace(-span, span, 21) / width
        to_rows = (np.exp(-2j * np.pi * np.outer(rows, y)) * wy).astype(np.complex64)
        to_columns = (np.exp(-2j * np.pi * np.outer(x, columns)) * wx[:, None]).astype(
            np.complex64
        )
        power = np.zeros((21, 21))
        for frame in frames:
            power += np.abs(to_rows @ (frame - frame.mean()) @ to_columns) ** 2
        i, j = np.unravel_index(int(power.argmax()), power.shape)
        ky, kx = float(rows[i]), float(columns[j])
    return canonical((ky, kx), tolerance=0.5 / width)


def proposed_radius(
    carrier: tuple[float, float],
    all_carriers: Sequence[tuple[float, float]],
    half: NDArray[np.float64],
    shape: tuple[int, int],
) -> float:
    """Return the radius where the lobe ends, within what neighbours and the zero order allow."""
    distance = float(np.hypot(*carrier))
    neighbours = [pair_distance(carrier, k) for k in all_carriers if k != carrier]
    conjugate = wrapped_distance(carrier, [-v for v in carrier]) / 2
    # A peak nearer than the least radius is structure of this lobe, not a neighbour.
    limits = [n / 2 for n in neighbours if n > MIN_RADIUS_SHARE * distance]
    limit = min([MAX_RADIUS_SHARE * distance, conjugate, *limits])
    floor = min(MIN_RADIUS_SHARE * distance, limit)
    return float(np.clip(lobe_extent(carrier, half, shape, limit), floor, limit))


def lobe_extent(
    carrier: tuple[float, float], half: NDArray[np.float64], shape: tuple[int, int], limit: float
) -> float:
    """Return the distance from the carrier at which the power has sunk to the noise (+3 dB)."""
    ky, kx = half_plane(shape)
    dy, dx = ky - carrier[0], kx - carrier[1]
    distance = np.hypot(dy - np.round(dy), dx)
    noise = 2 * float(np.quantile(half, 0.1)) / 0.105  # the 10 % quantile of exponential noise
    step = max(1.5 / min(shape), 0.004)
    for inner in np.arange(MAIN_LOBE / min(shape), limit, step):
        ring = half[(distance >= inner) & (distance < inner + step)]
        if ring.size and np.median(ring) / np.log(2) < noise:
            return float(inner + step)
    return limit
