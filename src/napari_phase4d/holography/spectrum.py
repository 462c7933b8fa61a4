"""The Fourier spectrum of a hologram video, and its peaks that may be carriers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import vectorized
from napari_phase4d.holography.lobes import canonical, pair_distance
from napari_phase4d.holography.lost import FrameLook, all_lost, lost_among, lost_frames, safe_look
from napari_phase4d.later import xr
from napari_phase4d.recording import Recording
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.words import advised_call

__all__ = [
    "MAIN_LOBE",
    "PLAIN",
    "Half",
    "Peak",
    "Spectrum",
    "add_power",
    "brightest_near",
    "find_peaks",
    "half_plane",
    "is_ghost",
    "power_spectrum",
    "refined",
    "wide_window",
    "windowed_spectra",
    "windowed_spectrum",
]


@advised_call(rec="open_recording() makes one of a file or an array")
def power_spectrum(
    rec: Recording,
    *,
    max_frames: int | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Return the mean power spectrum over the frames of a recording.

    Each frame is reduced by its mean and multiplied by a Blackman window, so that the edges of
    the image leave no cross in the spectrum. One frame is in memory at a time.

    Parameters
    ----------
    rec : Recording
        The hologram video.
    max_frames : int, optional
        Use at most so many frames, spread evenly. Default: all.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Returns
    -------
    xarray.DataArray
        float32, dims ``("ky", "kx")`` in cycles per camera pixel, zero frequency in the middle.
        ``attrs["lost_frames"]`` are those that the camera lost, and left out.

    Raises
    ------
    ValueError
        If all frames are lost.
    Cancelled
        If ``cancelled()`` returned True.

    See Also
    --------
    find_lobes : Where the views lie in it.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena(n_times=2)
    >>> rec = p4d.simulation.multiplexed_video(exact["phase"])
    >>> dict(p4d.power_spectrum(rec).sizes)
    {'ky': 512, 'kx': 512}
    """
    task = Task(progress, cancelled)
    if max_frames is not None and max_frames < 1:
        msg = f"max_frames must be 1 or more, but is {max_frames}"
        raise ValueError(msg)
    indices = rec.sample_indices(max_frames or rec.n_frames)
    lost = lost_frames(rec, len(indices), progress=progress, cancelled=cancelled)
    kept = [index for index in indices if index not in lost]
    if not kept:
        raise ValueError(all_lost(rec.name, lost))
    watch = Watch(len(kept), "spectrum", task)
    half = mean_half_spectrum(watched(rec, kept, watch), rec.frame_shape)
    height, width = rec.frame_shape
    return xr.DataArray(
        full_spectrum(half, width).astype(np.float32),
        dims=("ky", "kx"),
        coords={
            "ky": scipy.fft.fftshift(scipy.fft.fftfreq(height)),
            "kx": scipy.fft.fftshift(scipy.fft.fftfreq(width)),
        },
        name="power",
        attrs={
            "units": "grey value^2",
            "frames": len(kept),
            "lost_frames": sorted(lost),
        },
    )


def watched(rec: Recording, indices: Sequence[int], watch: Watch) -> Iterator[NDArray[np.float32]]:
    """Yield the chosen frames, telling how far it is, until cancelled."""
    watch.check()
    for index in indices:
        yield rec.frame(index)
        watch.step()


def mean_half_spectrum(
    frames: Iterable[NDArray[np.float32]], shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Return the mean power of windowed frames on the half plane kx >= 0, as `rfft2` orders it."""
    window = frame_window(shape)
    total = np.zeros((shape[0], shape[1] // 2 + 1))
    count = 0
    for frame in frames:
        field = windowed_spectrum(frame, window)
        add_power(field, total)
        count += 1
    return total / max(count, 1)


@vectorized
def add_power(spectrum: NDArray[np.complex64], total: NDArray[np.float64]) -> None:
    """Add the power of a transform to a sum."""
    height, width = total.shape
    for y in range(height):
        for x in range(width):
            value = spectrum[y, x]
            total[y, x] += value.real * value.real + value.imag * value.imag


@lru_cache(maxsize=4)
def frame_window(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the Blackman window of a frame, whose side lobes (-58 dB) hide no weak carrier."""
    height, width = shape
    rows, columns = np.blackman(height + 2)[1:-1], np.blackman(width + 2)[1:-1]
    return np.outer(rows, columns).astype(np.float32)


@lru_cache(maxsize=4)
def wide_window(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return a window that is flat in the middle half and falls off as a cosine to the border.

    It shows objects near the border and more of what is round them, of which the Blackman window
    leaves next to nothing. Its side lobes are higher.
    """
    rows, columns = (
        np.sin(np.pi / 2 * np.minimum(1, (np.minimum(i, n - 1 - i) + 0.5) / (n / 4))) ** 2
        for i, n in ((np.arange(n), n) for n in shape)
    )
    return np.outer(rows, columns).astype(np.float32)


def windowed_spectra(
    rec: Recording, indices: Sequence[int], watch: Watch
) -> tuple[list[NDArray[np.complex64]], dict[int, str]]:
    """Return the transforms of windowed frames on the half plane kx >= 0; lost ones are left out.

    Parameters
    ----------
    rec : Recording
        The video.
    indices : sequence of int
        Frame numbers.
    watch : Watch
        Is told of each.

    Returns
    -------
    list of ndarray of shape (y, x // 2 + 1)
        complex64, of the frames that are not lost.
    dict of int to str
        The frames that are, and why.
    """
    window = frame_window(rec.frame_shape)

    def work(index: int) -> tuple[FrameLook, NDArray[np.complex64] | None]:
        look = safe_look(rec, index)
        return look, None if look.reason else windowed_spectrum(rec.frame(index), window)

    found = dict(zip(indices, in_threads(work, indices, watch), strict=True))
    lost = lost_among({index: look for index, (look, _) in found.items()})
    kept = [spectrum for index, (_, spectrum) in found.items() if index not in lost]
    return [spectrum for spectrum in kept if spectrum is not None], lost


def windowed_spectrum(
    frame: NDArray[np.float32], window: NDArray[np.float32]
) -> NDArray[np.complex64]:
    """Return the transform of a frame, less its mean and windowed, on the half plane kx >= 0."""
    field: NDArray[np.complex64] = scipy.fft.rfft2((frame - frame.mean()) * window)
    return field


def full_spectrum(half: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Complete a half-plane power spectrum by its symmetry P(-k) = P(k), zero in the middle."""
    height = half.shape[0]
    mirrored_rows = (-np.arange(height)) % height
    negative = half[mirrored_rows][:, 1 : width - half.shape[1] + 1][:, ::-1]
    whole: NDArray[np.float64] = scipy.fft.fftshift(np.concatenate([half, negative], axis=1))
    return whole


#: How far a carrier stands above the median of its ring, as a ratio of powers (100 = 20 dB).
STANDS_OUT = 100.0
#: The same where no peak reaches it: a faint carrier is better than none.
STANDS_OUT_FAINT = 20.0
#: Peaks weaker than the strongest by more than this (30 dB) are no views: a weak view of a fifth
#: of the amplitude lies 28 dB below the beat of two strong ones.
DYNAMIC_RANGE = 1e-3
#: Those within 20 dB are plain to see.
PLAIN = 1e-2
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


def brightest_near(
    carrier: tuple[float, float], half: Half, shape: tuple[int, int]
) -> tuple[float, float]:
    """Return where the spectrum is brightest near a carrier, to a pixel of it.

    Parameters
    ----------
    carrier : tuple of float
        (ky, kx) in cycles per pixel.
    half : ndarray of shape (y, x // 2 + 1)
        Mean power on the half plane kx >= 0.
    shape : tuple of int
        Height and width of the frames.

    Returns
    -------
    tuple of float
        The carrier itself where another peak outshines what is round it.
    """
    height, width = shape
    reach = [max(1, round(NEAR * n)) for n in shape]
    rows, columns = (
        round(k * n) + np.arange(-r, r + 1) for k, n, r in zip(carrier, shape, reach, strict=True)
    )
    dy, dx = (np.arange(-r, r + 1) for r in reach)
    within = np.hypot(dy[:, None] / reach[0], dx[None, :] / reach[1]) <= 1
    power = np.where(within, np.abs(patch(half, rows, columns, shape)), 0)
    i, j = np.unravel_index(int(power.argmax()), power.shape)
    # At the rim of what is looked at lies the slope of another peak.
    inside = within[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].all()
    if not inside:
        return carrier
    return canonical((rows[i] / height, columns[j] / width), tolerance=0.5 / width)


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
