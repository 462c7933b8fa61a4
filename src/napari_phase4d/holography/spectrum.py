"""The Fourier spectrum of a hologram video."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache

import numpy as np
import scipy.fft
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.checks import check_type
from napari_phase4d.compiling import vectorized
from napari_phase4d.holography.lost import FrameLook, all_lost, lost_among, safe_look
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, in_threads
from napari_phase4d.recording import Recording

__all__ = ["add_power", "power_spectrum", "windowed_spectra"]


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
        ``attrs["lost_frames"]`` are those that were blank, saturated or broken, and left out.

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
    check_type("rec", rec, Recording, "open_recording() makes one of a file or an array")
    indices = rec.sample_indices(max_frames or rec.n_frames)
    watch = Watch(len(indices), "spectrum", progress, cancelled)
    lost: dict[int, str] = {}
    half = mean_half_spectrum(watched(rec, indices, lost, watch), rec.frame_shape)
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


def watched(
    rec: Recording, indices: list[int], lost: dict[int, str], watch: Watch
) -> Iterator[NDArray[np.float32]]:
    """Yield the chosen frames, telling how far it is, until cancelled.

    Blank, saturated and broken frames are noted and left out; those whose fringes have collapsed
    add next to nothing to the power.
    """
    watch.check()
    for index in indices:
        reason = safe_look(rec, index).reason
        if reason:
            lost[index] = reason
        else:
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
