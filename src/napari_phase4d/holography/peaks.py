"""The peaks of a hologram's spectrum that may be carriers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.holography.lobes import Lobe, canonical, pair_distance, wrapped_distance

__all__ = [
    "MAIN_LOBE",
    "PLAIN",
    "Half",
    "Peak",
    "Spectrum",
    "brightest_near",
    "brightest_places",
    "find_peaks",
    "half_plane",
    "is_ghost",
    "lobes_round",
    "refined",
]

#: How far a carrier stands above the median of its ring, as a ratio of powers (100 = 20 dB).
STANDS_OUT = 100.0
#: The same where no peak reaches it: a faint carrier is better than none.
STANDS_OUT_FAINT = 20.0
#: Peaks weaker than the strongest by more than this (30 dB) are no views: a weak view of a fifth
#: of the amplitude lies 28 dB below the beat of two strong ones.
DYNAMIC_RANGE = 1e-3
#: Those within 20 dB are plain to see.
PLAIN = 1e-2
#: Circles are drawn round so many of them, as far as this share of the distance to zero.
MOST_ROUND, OF_CARRIER = 2, 0.42
#: A peak that is nearer to a stronger one may be light of the same view, from an object's rim.
OWN_LIGHT = 0.1
#: One that is stronger than so much of it is not, but other light.
COMPARABLE = 0.1
#: Circles hold more than so many pixels of the spectrum from the middle on, or nothing is seen.
LEAST_ROOM = 1.5
#: A frame shows a peak if it has this share of its power in another one, at least.
SHOWN = 0.05
#: Peaks that are looked at; six views and all their beats are 21.
MOST_PEAKS = 24
#: A carrier is looked for so near to a peak, in cycles per pixel: not so far as the next one.
NEAR = 0.03
#: Half the width of a Blackman window's main lobe, in pixels of the spectrum.
MAIN_LOBE = 3
#: Ghosts are at least this much weaker than what they copy: shifted copies 3 dB, harmonics 10 dB.
SHIFTED_COPY, HARMONIC = 0.5, 0.1
#: A copy lies within so many pixels of the spectrum of where it is due (measured: 0.33 in JPEG,
#: 0.15 in interlaced video), a harmonic farther off: it is a multiple, and its lobe another.
GHOST_PIXELS, HARMONIC_PIXELS = 0.5, 0.8
#: The brightest pixel of a harmonic that an object spreads may lie this many times as far off: a
#: view there is doubted.
SPREAD = 3.0
ZERO = (0.0, 0.0)
#: Places on pixels of the spectrum that are less apart than this, in cycles per pixel, are one.
HERE = 1e-9
#: A place in the spectrum (ky, kx), cycles per pixel.
Place = tuple[float, float]
#: Pixels of the spectrum on either side of a peak from which a carrier is refined.
PATCH = 16

Half = NDArray[np.float64]
Spectrum = NDArray[np.complex64]


@dataclass(frozen=True)
class Peak:
    """A local maximum of the spectrum.

    Parameters
    ----------
    carrier : tuple of float
        (ky, kx) in cycles per pixel, to a pixel of the spectrum.
    power : float
        Mean power there.
    relative : float
        That power over the strongest peak's.
    ghost : bool
        Whether it lies where a camera, a video or JPEG copies a stronger peak to.
    near_harmonic : bool
        Whether it lies near to where a saturated camera copies a stronger peak to.
    """

    carrier: tuple[float, float]
    power: float
    relative: float = 1.0
    ghost: bool = False
    near_harmonic: bool = False

    @property
    def is_plain(self) -> bool:
        """Whether it is strong and no ghost."""
        return not self.ghost and self.relative > PLAIN


def find_peaks(half: Half, shape: tuple[int, int]) -> list[Peak]:
    """Return the maxima that stand out of their ring, strongest first.

    The zero order fills its rings evenly, so this masks it by its own measured width, and a
    carrier may lie on an axis.

    Parameters
    ----------
    half : ndarray of shape (y, x // 2 + 1)
        Mean power on the half plane kx >= 0, as `rfft2` orders it.
    shape : tuple of int
        Height and width of the frames.
    """
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
        Peak((float(ky[rows[i], 0]), float(kx[0, columns[i]])), float(half[rows[i], columns[i]]))
        for i in order
    ]
    peaks = [peak for peak in peaks if peak.power > DYNAMIC_RANGE * peaks[0].power]
    return with_ghosts(apart(peaks, shape)[:MOST_PEAKS], half, shape)


def lobes_round(
    peaks: Sequence[Peak], spectra: Sequence[Spectrum], shape: tuple[int, int]
) -> list[Lobe]:
    """Return circles round the strongest peaks, before it is known which of them are views.

    They reach as far as the zero order and each other allow. A peak that far fewer frames show
    than another is no fringes that all of them have.

    Parameters
    ----------
    peaks : sequence of Peak
        Strongest first.
    spectra : sequence of ndarray of shape (y, x // 2 + 1)
        Transforms of the frames that they were found in.
    shape : tuple of int
        Height and width of the frames.
    """
    plain = [peak for peak in peaks if peak.is_plain]
    seen = [frames_with(peak.carrier, spectra, shape) for peak in plain]
    found: list[Lobe] = []
    for peak, n in zip(plain, seen, strict=True):
        apart = all(pair_distance(peak.carrier, lobe.carrier) > OWN_LIGHT for lobe in found)
        reach = room_round(peak, plain)
        if apart and 2 * n > max(seen) and reach * min(shape) > LEAST_ROOM:
            found.append(Lobe(peak.carrier, reach))
    return found[:MOST_ROUND]


def room_round(peak: Peak, peaks: Sequence[Peak]) -> float:
    """Return how far a circle may reach round a peak, among others, in cycles per pixel."""
    ky, kx = peak.carrier
    distances = [
        pair_distance(peak.carrier, other.carrier)
        for other in peaks
        if other is not peak and other.power > COMPARABLE * peak.power
    ]
    distances.append(wrapped_distance(peak.carrier, (-ky, -kx)))
    return min(OF_CARRIER * float(np.hypot(ky, kx)), min(distances) / 2)


def frames_with(
    carrier: tuple[float, float], spectra: Sequence[Spectrum], shape: tuple[int, int]
) -> int:
    """Return how many frames show a peak, next to the one that shows it best."""
    row, column = (round(k * n) for k, n in zip(carrier, shape, strict=True))
    powers = [float(abs(spectrum[row, column])) ** 2 for spectrum in spectra]
    return sum(power > SHOWN * max(powers) for power in powers)


def half_plane(shape: tuple[int, int]) -> tuple[Half, Half]:
    """Return the frequencies of an `rfft2` as a column ky and a row kx, in cycles per pixel."""
    return scipy.fft.fftfreq(shape[0])[:, None], scipy.fft.rfftfreq(shape[1])[None, :]


def ring_median(half: Half, shape: tuple[int, int]) -> Half:
    """Return for each frequency the median power of the ring it lies on."""
    ky, kx = half_plane(shape)
    width = max(1.5 / min(shape), 0.004)
    position = np.hypot(ky, kx) / width
    ring = position.astype(int)
    # A few hundred of a ring's pixels give its median well enough; large frames have thousands.
    thin = (slice(None, None, max(1, shape[0] // 256)), slice(None, None, max(1, shape[1] // 256)))
    median = np.asarray(scipy.ndimage.median(half[thin], ring[thin], np.arange(ring.max() + 1)))
    known = np.flatnonzero(np.isfinite(median))
    levels: Half = np.interp(position - 0.5, known, median[known])
    return np.maximum(levels, np.finfo(float).tiny)


def local_maxima(half: Half, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Mark the pixels that no neighbour within the window's main lobe exceeds."""
    # One column more than the main lobe on the left shows maxima at kx = 0 whole.
    mirrored = half[(-np.arange(shape[0])) % shape[0]][:, MAIN_LOBE:0:-1]
    padded = np.concatenate([mirrored, half], axis=1)
    highest = scipy.ndimage.maximum_filter(
        padded, size=2 * MAIN_LOBE + 1, mode=("wrap", "nearest")
    )
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


def with_ghosts(peaks: list[Peak], half: Half, shape: tuple[int, int]) -> list[Peak]:
    """Mark what a camera, a video or JPEG makes of a stronger peak.

    A view may lie there by chance, so ghosts stay; they are taken if nothing else will do. A ghost
    lies where its source puts it, to half a pixel of the spectrum; a harmonic to 0.8 pixels, or up
    to two where that is multiplied. A view does only by rare chance.
    """
    marked: list[Peak] = []
    sources = [(ZERO, Peak(ZERO, np.inf))]
    for peak in peaks:
        place = between_pixels(peak.carrier, half, shape)
        ghost = any(is_ghost(peak, place, *source, shape) for source in sources)
        near = any(is_harmonic(peak, place, *source, shape, SPREAD) for source in sources)
        relative = peak.power / peaks[0].power
        marked.append(
            replace(peak, ghost=ghost, near_harmonic=near and not ghost, relative=relative)
        )
        if not ghost:
            sources.append((place, peak))
    return marked


def between_pixels(
    carrier: tuple[float, float], half: Half, shape: tuple[int, int]
) -> tuple[float, float]:
    """Return where a maximum lies between the pixels of the spectrum.

    The logarithm of a Blackman window's main lobe is nearly a parabola.
    """
    height, width = shape
    row, column = round(carrier[0] * height), round(carrier[1] * width)
    near = np.arange(-1, 2)
    logs = np.log(np.abs(patch(half, row + near, column + near, shape)) + 1e-30)
    return ((row + vertex(logs[:, 1])) / height, (column + vertex(logs[1])) / width)


def vertex(values: Half) -> float:
    """Return where the parabola through the middle of three values and its neighbours peaks."""
    bend = float(values[0] - 2 * values[1] + values[2])
    if bend >= 0:
        return 0.0
    return float(np.clip((values[0] - values[2]) / (2 * bend), -0.5, 0.5))


def is_ghost(peak: Peak, place: Place, at: Place, source: Peak, shape: tuple[int, int]) -> bool:
    """Say whether a peak is a harmonic or a shifted copy of a stronger one.

    Interlaced video and JPEG's colour shift by half the sampling frequency, JPEG's blocks by
    multiples of an eighth of it. Places, of the peak and of its source, are those between the
    pixels of the spectrum.
    """
    ky, kx = at
    relative = peak.power / source.power
    if relative < SHIFTED_COPY and any(
        pair_distance(place, (ky + dy, kx + dx), shape) < GHOST_PIXELS
        for dy, dx in ((0.5, 0), (0, 0.5), (0.5, 0.5))
    ):
        return True
    if relative >= HARMONIC or source.carrier == ZERO:
        return False
    if is_harmonic(peak, place, at, source, shape):
        return True
    blocks = ((ky + i / 8, kx + j / 8) for i in range(8) for j in range(8) if i or j)
    return any(pair_distance(place, k, shape) < GHOST_PIXELS for k in blocks)


def is_harmonic(
    peak: Peak,
    place: Place,
    at: Place,
    source: Peak,
    shape: tuple[int, int],
    farther: float = 1.0,
) -> bool:
    """Say whether a peak lies at a multiple, or half, of a stronger one; or so much farther."""
    if source.carrier == ZERO or peak.power >= HARMONIC * source.power:
        return False
    ky, kx = at
    return any(
        pair_distance(place, (n * ky, n * kx), shape)
        < (1 + max(n, 1)) / 2 * HARMONIC_PIXELS * farther
        for n in (0.5, 2, 3, 4)
    )


def refined(
    carrier: tuple[float, float], spectra: Sequence[Spectrum], shape: tuple[int, int]
) -> tuple[float, float]:
    """Return the carrier to about a hundredth of a spectral pixel.

    The Fourier transform of the windowed frames is evaluated on ever finer grids round the peak,
    and the largest mean power wins. Between the pixels of the spectrum it is the sum of the
    pixels round it, each times the transform of the frame's own extent (Dirichlet's kernel); the
    window makes those farther than some pixels count for nothing, so that the frames themselves
    are not needed.

    Parameters
    ----------
    carrier : tuple of float
        (ky, kx) in cycles per pixel, to a pixel of the spectrum.
    spectra : sequence of ndarray of shape (y, x // 2 + 1)
        Complex transforms of windowed frames, as `rfft2` orders them.
    shape : tuple of int
        Height and width of the frames.
    """
    height, width = shape
    centre = (round(carrier[0] * height), round(carrier[1] * width))
    reach = (min(PATCH, (height - 1) // 2), min(PATCH, (width - 1) // 2))
    rows, columns = (c + np.arange(-r, r + 1) for c, r in zip(centre, reach, strict=True))
    patches = [patch(spectrum, rows, columns, shape) for spectrum in spectra]
    ky, kx = carrier
    for span in (1.5, 0.3, 0.06):
        fine_y = ky + np.linspace(-span, span, 21) / height
        fine_x = kx + np.linspace(-span, span, 21) / width
        to_y = dirichlet(fine_y[:, None] * height - rows, height)
        to_x = dirichlet(fine_x[:, None] * width - columns, width).T
        power = np.zeros((21, 21))
        for samples in patches:
            power += np.abs(to_y @ samples @ to_x) ** 2
        i, j = np.unravel_index(int(power.argmax()), power.shape)
        ky, kx = float(fine_y[i]), float(fine_x[j])
    return canonical((ky, kx), tolerance=0.5 / width)


def brightest_places(carriers: Sequence[Place], half: Half, shape: tuple[int, int]) -> list[Place]:
    """Return where the spectrum is brightest near each carrier, to a pixel of it.

    Parameters
    ----------
    carriers : sequence of tuple of float
        (ky, kx) in cycles per pixel, of the strongest peak first: a place is that of one peak.
    half : ndarray of shape (y, x // 2 + 1)
        Mean power on the half plane kx >= 0.
    shape : tuple of int
        Height and width of the frames.

    Returns
    -------
    list of tuple of float
        The carrier itself where another peak outshines what is round it.
    """
    found: list[Place] = []
    for number, carrier in enumerate(carriers):
        place = brightest_near(number, carriers, half, shape)
        taken = any(pair_distance(place, other) < HERE for other in found)
        found.append(carrier if taken else place)
    return found


def brightest_near(
    number: int, carriers: Sequence[Place], half: Half, shape: tuple[int, int]
) -> Place:
    """Return where the spectrum is brightest near one of some carriers, or that carrier itself.

    An object that fills the middle of the frames with steep phase has its own peak farther from
    the light that passes round it than can be looked at in one step, so that the light is followed
    over the rim once. That may lead up the slope of another peak, or of the zero order.
    """
    carrier = carriers[number]
    place, inside = brightest_within(carrier, half, shape)
    if not inside:
        place, inside = brightest_within(place, half, shape)
        others = [ZERO, *(k for i, k in enumerate(carriers) if i != number)]
        off = pair_distance(place, carrier)
        inside &= all(off < pair_distance(place, other) for other in others)
    return canonical(place, tolerance=0.5 / shape[1]) if inside else carrier


def brightest_within(place: Place, half: Half, shape: tuple[int, int]) -> tuple[Place, bool]:
    """Return the brightest pixel near a place, and whether it lies well within what is near.

    At the rim of what is near lies the slope of another peak.
    """
    height, width = shape
    reach = [max(1, round(NEAR * n)) for n in shape]
    rows, columns = (
        round(k * n) + np.arange(-r, r + 1) for k, n, r in zip(place, shape, reach, strict=True)
    )
    dy, dx = (np.arange(-r, r + 1) for r in reach)
    within = np.hypot(dy[:, None] / reach[0], dx[None, :] / reach[1]) <= 1
    power = np.where(within, np.abs(patch(half, rows, columns, shape)), 0)
    i, j = np.unravel_index(int(power.argmax()), power.shape)
    inside = within[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].all()
    return (rows[i] / height, columns[j] / width), bool(inside)


def patch(
    spectrum: Spectrum | Half,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    shape: tuple[int, int],
) -> Spectrum:
    """Return pixels of the whole spectrum from its half, F(-k) = F(k)*."""
    height, width = shape
    columns = columns % width
    mirrored = columns > width // 2
    across = np.where(mirrored, width - columns, columns)
    down = np.where(mirrored[None, :], -rows[:, None], rows[:, None]) % height
    samples = spectrum[down, np.broadcast_to(across, down.shape)]
    found: Spectrum = np.where(mirrored, samples.conj(), samples)
    return found


def dirichlet(offset: NDArray[np.float64], n: int) -> NDArray[np.complex128]:
    """Return the transform of n equal samples, over n, at so many pixels of the spectrum off."""
    with np.errstate(invalid="ignore", divide="ignore"):
        size = np.sin(np.pi * offset) / (n * np.sin(np.pi * offset / n))
    size = np.where(np.abs(np.sin(np.pi * offset / n)) < 1e-12, 1.0, size)
    found: NDArray[np.complex128] = size * np.exp(-1j * np.pi * offset * (n - 1) / n)
    return found
