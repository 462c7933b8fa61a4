"""Speed of demodulation and reconstruction as ratios to peers, measured in the same run.

The published speed: Girshovitz & Shaked 2015, 45 frames a second with unwrapping, one view.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import scipy.fft
import tifffile
import xarray as xr
from measuring import Row, median_seconds, paired, touch_memory

import napari_phase4d as p4d
from napari_phase4d.holography import WINDOWS, Demodulator, Lobe
from napari_phase4d.phasors import to_polar
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

SHAPE = (1024, 1280)
LOBES = [Lobe((0.19, 0.21), 0.103, -7.0), Lobe((-0.21, 0.19), 0.103, 21.0)]  # to 256 x 320
WORK = "2 views of 1024 x 1280 uint8 to phase"
N_FRAMES = 600
#: So many frames at most the finder looks at.
FINDER_FRAMES = 16
BATCH = 60
NUMPY = "FFTFilterNumpy"


def camera_frames() -> np.ndarray:
    """Return a few frames of a swimming cell, as an 8-bit camera gives them."""
    exact = swimming_euglena(SHAPE, 4, pixel_um=5.2 / 60, peak_rad=6)
    frames = multiplexed_video(exact["phase"], bits=8).holograms.values
    assert frames.dtype == np.uint8
    return frames


def write_phase(demodulate: Demodulator, frame: np.ndarray, phase: np.ndarray) -> None:
    amplitude = np.empty_like(phase)
    for view in zip(demodulate(frame), amplitude, phase, strict=True):
        to_polar(*view)


def qpretrieve_phases(
    frame: np.ndarray, padding: int, dtype: type, fft: str, *, crop: bool = False
) -> list[np.ndarray]:
    """Return what qpretrieve makes of both lobes, from one transform of the frame.

    With FFTFilterNumpy, which is what it has by itself, or FFTFilterPyFFTW.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the FFT libraries that are not installed
        import qpretrieve
    hologram = qpretrieve.OffAxisHologram(
        frame,
        padding=padding,
        dtype_conversion=dtype,
        fft_interface=getattr(qpretrieve.fourier, fft),
    )
    phases = []
    for lobe in LOBES:
        hologram.run_pipeline(
            filter_name="disk",
            filter_size=lobe.radius / np.hypot(*lobe.carrier),
            sideband_freq=lobe.carrier,
            scale_to_filter=crop,
        )
        phases.append(hologram.phase)
    return phases


def furthest_from_double_precision(demodulate: Demodulator, frame: np.ndarray) -> float:
    """Return the largest phase difference to a plain transform in double precision, radians.

    Where the amplitude is above a tenth of its median; elsewhere there is no phase.
    """
    spectrum = scipy.fft.fft2(frame - frame.mean())
    largest = 0.0
    for lobe, field in zip(LOBES, demodulate(frame), strict=True):
        offsets = [
            scipy.fft.fftfreq(n)[:, None] - k if axis == 0 else scipy.fft.fftfreq(n)[None] - k
            for axis, (n, k) in enumerate(zip(SHAPE, lobe.carrier, strict=True))
        ]
        around = [d - np.round(d) for d in offsets]
        rho = np.hypot(*around) / lobe.radius
        whole = scipy.fft.ifft2(spectrum * WINDOWS["smooth-disk"](rho))
        y, x = (np.arange(n) for n in SHAPE)
        ky, kx = lobe.carrier
        whole *= np.exp(-2j * np.pi * (ky * y[:, None] + kx * x[None]))
        ratio = [n // m for n, m in zip(SHAPE, demodulate.output_shape, strict=True)]
        expected = whole[:: ratio[0], :: ratio[1]]
        seen = np.abs(expected) > 0.1 * np.median(np.abs(expected))
        off = np.abs(np.angle(field * expected.conj()))[seen]
        largest = max(largest, float(off.max()))
    return largest


def demodulation_rows(frames: np.ndarray) -> Iterator[Row]:
    """Measure one frame after the other on one thread, then frames on two threads."""
    demodulate = Demodulator(SHAPE, LOBES)
    phase = np.empty((len(frames), len(LOBES), *demodulate.output_shape), np.float32)
    frame, square = frames[0], np.ascontiguousarray(frames[0][:, :1024])
    phases = qpretrieve_phases
    peers: list[tuple[str, Callable[[], object], str]] = [
        ("qpretrieve, its defaults", lambda: phases(frame, 2, float, NUMPY), ">= 500"),
        ("qpretrieve, padding 1", lambda: phases(frame, 1, float, NUMPY), ">= 40"),
        (
            "qpretrieve at its best: 1024 x 1024 of it, no padding, float32, spectrum cropped, "
            "pyfftw",
            lambda: phases(square, 0, np.float32, "FFTFilterPyFFTW", crop=True),
            ">= 4",
        ),
    ]
    furthest = furthest_from_double_precision(demodulate, frame)
    for peer, theirs, goal in peers:
        theirs()

        def ours() -> None:
            write_phase(demodulate, frame, phase[0])

        quick, slow = paired(ours, theirs, repeats=(20, 1))
        yield Row(WORK, quick, peer, slow, goal, f"{furthest:.0e} rad from float64")
    grey = frame.astype(np.float32)
    with ThreadPoolExecutor(2) as pool:

        def work(i: int) -> None:
            write_phase(demodulate, frames[i % len(frames)], phase[i % len(frames)])

        def on_two_threads() -> None:
            list(pool.map(work, range(BATCH)))

        def rfft2_of_as_many() -> None:
            for _ in range(BATCH):
                scipy.fft.rfft2(grey)

        quick, slow = paired(on_two_threads, rfft2_of_as_many, repeats=(2, 2))
    peer = "scipy.fft.rfft2 of a float32 frame, 1 thread"
    note = f"{BATCH / quick:.0f} frames a second, goal >= 350"
    yield Row(f"{WORK}, 2 threads over frames", quick / BATCH, peer, slow / BATCH, ">= 1.5", note)


def finder_rows(frames: np.ndarray, path: Path) -> Iterator[Row]:
    """Measure how long the lobes take to be found, in a short and in a long recording."""
    grey = frames[0].astype(np.float32)

    def transforms() -> None:
        for _ in range(FINDER_FRAMES):
            scipy.fft.rfft2(grey)

    short = p4d.open_recording(frames[np.arange(64) % len(frames)])
    for what, rec, goal in (
        ("64 frames in memory", short, 0.3),
        (f"a TIFF of {N_FRAMES} frames", p4d.open_recording(path), 0.4),
    ):
        for n_views in (2, None):
            find = partial(p4d.find_lobes, rec, n_views=n_views)
            quick, slow = paired(find, transforms, repeats=(3, 3))
            peer = f"scipy.fft.rfft2 of {FINDER_FRAMES} float32 frames, 1 thread"
            counted = "counted" if n_views is None else f"{n_views} views"
            yield Row(f"find_lobes(), {what}, {counted}", quick, peer, slow, f"<= {goal} s", "")


def chain_rows(frames: np.ndarray, path: Path) -> Iterator[Row]:
    """Measure the way of a long recording from its file to wrapped and to unwrapped phase."""

    def reading() -> None:
        for frame in tifffile.memmap(path, mode="r"):
            scipy.fft.rfft2(frame.astype(np.float32))

    def phase() -> xr.DataArray:
        return p4d.reconstruct(p4d.open_recording(path), LOBES)["phase"]

    def unwrapped() -> None:
        p4d.unwrap(phase(), "temporal-angular", mask="auto")

    p4d.unwrap(phase()[:3], "temporal-angular", mask="auto")
    slow = median_seconds(reading) / N_FRAMES
    peer = "tifffile.memmap and rfft2 in float32 of each frame, 1 thread"
    for what, work, goal in (
        ("open, reconstruct()", phase, ""),
        ("open, reconstruct(), unwrap() with T/A and mask", unwrapped, ">= 100 a second"),
    ):
        quick = median_seconds(work, before=lambda: touch_memory(4)) / N_FRAMES
        note = f"{1 / quick:.0f} frames, {2 / quick:.0f} views a second; published: 45 views"
        yield Row(f"TIFF of {N_FRAMES} frames: {what}, each", quick, peer, slow, goal, note)


def rows() -> Iterator[Row]:
    """Yield all comparisons."""
    frames = camera_frames()
    yield from demodulation_rows(frames)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.tif"
        repeated = frames[np.arange(N_FRAMES) % len(frames)]
        tifffile.imwrite(path, repeated, photometric="minisblack")
        yield from finder_rows(frames, path)
        yield from chain_rows(frames, path)
