"""The Fourier spectrum of a hologram video, and the frames that are left out of it as lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import vectorized
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.holography.lost import LostFrames, all_lost, reason_alone, usual_fringes
from napari_phase4d.holography.peaks import Half, Peak, Spectrum, find_peaks, lobes_round
from napari_phase4d.later import xr
from napari_phase4d.recording import Recording
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.words import advised_call

__all__ = [
    "FirstSpectrum",
    "first_spectrum",
    "lost_frames",
    "mean_power",
    "power_spectrum",
    "wide_window",
    "windowed_spectrum",
]

#: Frames from which it is learnt where the fringes are, before any is called lost.
FIRST_FRAMES = 9


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
    the image leave no cross in the spectrum. A few frames are in memory at a time.

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
    look = first_look(rec, task)
    watch = Watch(len(indices), "spectrum", task)
    half, lost = mean_half_spectrum(look, indices, watch)
    if len(lost) == len(indices):
        raise ValueError(all_lost(rec.name, lost))
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
            "frames": len(indices) - len(lost),
            "lost_frames": sorted(lost),
        },
    )


def mean_half_spectrum(
    look: FirstLook, indices: Sequence[int], watch: Watch
) -> tuple[Half, dict[int, str]]:
    """Return the mean power of windowed frames on the half plane kx >= 0, and what is lost."""
    shape = look.rec.frame_shape
    window = frame_window(shape)

    def work(index: int) -> Spectrum | str:
        return look.reason(index) or windowed_spectrum(look.rec.frame(index), window)

    total, lost = np.zeros((shape[0], shape[1] // 2 + 1)), {}
    for index, found in zip(indices, in_threads(work, indices, watch, large=True), strict=True):
        if isinstance(found, str):
            lost[index] = found
        else:
            add_power(found, total)
    return total / max(len(indices) - len(lost), 1), lost


@vectorized
def add_power(spectrum: NDArray[np.complex64], total: NDArray[np.float64]) -> None:
    """Add the power of a transform to a sum."""
    height, width = total.shape
    for y in range(height):
        for x in range(width):
            # Squares of 64-bit grey values go beyond single precision.
            real, imaginary = np.float64(spectrum[y, x].real), np.float64(spectrum[y, x].imag)
            total[y, x] += real * real + imaginary * imaginary


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


@dataclass(frozen=True)
class FirstSpectrum:
    """What the transforms of some frames show.

    Parameters
    ----------
    spectra : list of ndarray of shape (y, x // 2 + 1)
        complex64, of windowed frames that are not lost, on the half plane kx >= 0.
    half : ndarray of shape (y, x // 2 + 1)
        Their mean power.
    peaks : list of Peak
        Where it stands out, strongest first.
    lost : dict of int to str
        The other frames, and why.
    """

    spectra: list[Spectrum]
    half: Half
    peaks: list[Peak]
    lost: dict[int, str]


def first_spectrum(
    rec: Recording, indices: Sequence[int], task: Task, watch: Watch
) -> FirstSpectrum:
    """Transform some frames of a recording; leave out those that are lost.

    Parameters
    ----------
    rec : Recording
        The video.
    indices : sequence of int
        Frame numbers.
    task : Task
        Who may stop it.
    watch : Watch
        Is told of each.

    Raises
    ------
    ValueError
        If all are lost.
    """
    spectra, lost = windowed_spectra(rec, indices, watch)
    half, peaks = peaks_of(rec, spectra, lost)
    look = FirstLook.by(rec, peaks, spectra, task)
    more = look.lost_among(list(spectra), task.quiet)
    if more:
        lost = dict(sorted((lost | more).items()))
        spectra = {index: each for index, each in spectra.items() if index not in more}
        half, peaks = peaks_of(rec, spectra, lost)
    return FirstSpectrum(list(spectra.values()), half, peaks, lost)


def windowed_spectra(
    rec: Recording, indices: Sequence[int], watch: Watch
) -> tuple[dict[int, Spectrum], dict[int, str]]:
    """Return the transforms of windowed frames, and why others are lost for themselves."""
    window = frame_window(rec.frame_shape)

    def work(index: int) -> Spectrum | str:
        return reason_alone(rec, index) or windowed_spectrum(rec.frame(index), window)

    found = dict(zip(indices, in_threads(work, indices, watch), strict=True))
    lost = {index: each for index, each in found.items() if isinstance(each, str)}
    return {i: each for i, each in found.items() if not isinstance(each, str)}, lost


def peaks_of(
    rec: Recording, spectra: Mapping[int, Spectrum], lost: Mapping[int, str]
) -> tuple[Half, list[Peak]]:
    """Return the mean power of transforms, and its peaks."""
    if not spectra:
        raise ValueError(all_lost(rec.name, lost))
    half = mean_power(list(spectra.values()))
    return half, find_peaks(half, rec.frame_shape)


def mean_power(spectra: Sequence[Spectrum]) -> Half:
    """Return the mean power of transforms."""
    total = np.zeros(spectra[0].shape, dtype=np.float64)
    for spectrum in spectra:
        add_power(spectrum, total)
    return total / len(spectra)


# ---- frames that are lost, before the lobes are known ---------------------------------------


@dataclass(frozen=True)
class FirstLook:
    """Tells lost frames by the fringes that are plain to see, whichever of them are views.

    Parameters
    ----------
    rec : Recording
        The video.
    demodulate : Demodulator, optional
        Gives the fields of these fringes; None if none are seen.
    lost : LostFrames, optional
        Knows what they usually show.
    fine : frozenset of int
        Frames that were looked at already, and are not lost.
    """

    rec: Recording
    demodulate: Demodulator | None = None
    lost: LostFrames | None = None
    fine: frozenset[int] = frozenset()

    @classmethod
    def by(
        cls, rec: Recording, peaks: Sequence[Peak], spectra: Mapping[int, Spectrum], task: Task
    ) -> FirstLook:
        """Return what looks at the fringes of the strongest peaks of some frames' transforms."""
        lobes = lobes_round(peaks, list(spectra.values()), rec.frame_shape)
        if not lobes:
            return cls(rec)
        demodulate = Demodulator(rec.frame_shape, lobes)
        try:
            lost, known = usual_fringes(rec, demodulate, task, list(spectra))
        except ValueError:  # all of them are, whatever is usual
            return cls(rec)
        return cls(rec, demodulate, lost, frozenset(known))

    def reason(self, index: int) -> str:
        """Say why a frame is lost; "" if it is not."""
        if index in self.fine:
            return ""
        reason = reason_alone(self.rec, index)
        if reason or self.demodulate is None or self.lost is None:
            return reason
        frame = self.rec.raw_frame(index)
        return self.lost.reason(frame, self.demodulate(frame))

    def lost_among(self, indices: Sequence[int], task: Task) -> dict[int, str]:
        """Return which of some frames are lost, and why."""
        watch = Watch(len(indices), "looking for lost frames", task)
        reasons = zip(indices, in_threads(self.reason, indices, watch), strict=True)
        return {index: reason for index, reason in reasons if reason}


def first_look(rec: Recording, task: Task) -> FirstLook:
    """Return what tells lost frames of a recording, by some frames from all over it."""
    indices = rec.sample_indices(FIRST_FRAMES)
    # Light that is on in every second frame is in none or all of frames evenly apart.
    for some in (indices, [i + 1 for i in indices if i + 1 < rec.n_frames]):
        watch = Watch(len(some), "looking for fringes", task.quiet)
        spectra, lost = windowed_spectra(rec, some, watch)
        if spectra:
            _, peaks = peaks_of(rec, spectra, lost)
            look = FirstLook.by(rec, peaks, spectra, task)
            if look.lost is not None and look.lost.usual.are_seen:
                return look
    return FirstLook(rec)


def lost_frames(
    rec: Recording,
    at_most: int | None = None,
    *,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> dict[int, str]:
    """Return which frames the camera lost, and why.

    Parameters
    ----------
    rec : Recording
        The hologram video.
    at_most : int, optional
        Look at so many frames at most, evenly over the recording. Default: all.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Returns
    -------
    dict of int to str
        Frame number: "blank", "saturated", "without fringes", "damaged" or "NaN"; or "without
        fringes in some views", as where one of several beams is blocked.

    See Also
    --------
    lost_sentence : Says it in words.

    Examples
    --------
    >>> from napari_phase4d.holography import lost_frames
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena((64, 64), 4, pixel_um=0.7)
    >>> frames = p4d.simulation.multiplexed_video(exact["phase"]).holograms.values.copy()
    >>> frames[2] = 0
    >>> lost_frames(p4d.open_recording(frames))
    {2: 'blank'}
    """
    task = Task(progress, cancelled)
    indices = rec.sample_indices(at_most or rec.n_frames)
    return first_look(rec, task).lost_among(indices, task)


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
