"""Speed of demodulation and reconstruction as ratios to peers, measured in the same run.

Both are timed in turn, so that a busy machine slows both; the table holds the medians.
"""

from __future__ import annotations

import statistics
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import scipy.fft
import tifffile

import napari_phase4d as p4d
from napari_phase4d.holography import Demodulator, Lobe
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

SHAPE = (1024, 1280)
LOBES = [Lobe((0.19, 0.21), 0.103, -7.0), Lobe((-0.21, 0.19), 0.103, 21.0)]  # to 256 x 320
WORK = "2 views of 1024 x 1280 uint8 to phase"
N_FRAMES = 600
BATCH = 60
ROUNDS = 7

Row = tuple[str, float, str, float]


def paired(
    ours: Callable[[], object],
    theirs: Callable[[], object],
    rounds: int = ROUNDS,
    repeats: tuple[int, int] = (1, 1),
) -> tuple[float, float]:
    """Return the median seconds of one call of each.

    In every round each is called once without a clock, since a video keeps memory and cache
    warm, and then so often as ``repeats`` says.
    """
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        for work, seconds, count in zip((ours, theirs), times, repeats, strict=True):
            if count > 1:
                work()
            began = time.perf_counter()
            for _ in range(count):
                work()
            seconds.append((time.perf_counter() - began) / count)
    return statistics.median(times[0]), statistics.median(times[1])


def camera_frames() -> np.ndarray:
    """Return a few frames of a swimming cell, as an 8-bit camera gives them."""
    exact = swimming_euglena(SHAPE, 4, pixel_um=5.2 / 60, peak_rad=6)
    frames = multiplexed_video(exact["phase"], bits=8).holograms.values
    assert frames.dtype == np.uint8
    return frames


def write_phase(demodulate: Demodulator, frame: np.ndarray, phase: np.ndarray) -> None:
    fields = demodulate(frame)
    np.arctan2(fields.imag, fields.real, out=phase)


def qpretrieve_phases(
    frame: np.ndarray, padding: int, dtype: type, crop: bool = False
) -> list[np.ndarray]:
    """Return what qpretrieve makes of both lobes, from one transform of the frame."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the FFT libraries that are not installed
        import qpretrieve
    hologram = qpretrieve.OffAxisHologram(frame, padding=padding, dtype_conversion=dtype)
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


def demodulation_rows(frames: np.ndarray) -> Iterator[Row]:
    """Measure one frame after the other on one thread, then frames on two threads."""
    demodulate = Demodulator(SHAPE, LOBES)
    phase = np.empty((len(frames), len(LOBES), *demodulate.output_shape), np.float32)
    frame, square = frames[0], np.ascontiguousarray(frames[0][:, :1024])
    peers: list[tuple[str, Callable[[], object], int]] = [
        ("qpretrieve, its defaults", lambda: qpretrieve_phases(frame, 2, float), 5),
        ("qpretrieve, padding 1", lambda: qpretrieve_phases(frame, 1, float), ROUNDS),
        (
            "qpretrieve at its best: 1024 x 1024 of it, no padding, float32, spectrum cropped",
            lambda: qpretrieve_phases(square, 0, np.float32, crop=True),
            ROUNDS,
        ),
    ]
    for peer, theirs, rounds in peers:
        theirs()

        def ours() -> None:
            write_phase(demodulate, frame, phase[0])

        yield work_and_peer(WORK, peer, paired(ours, theirs, rounds, (20, 1)))
    grey = frame.astype(np.float32)
    with ThreadPoolExecutor(2) as pool:

        def work(i: int) -> None:
            write_phase(demodulate, frames[i % len(frames)], phase[i % len(frames)])

        def on_two_threads() -> None:
            list(pool.map(work, range(BATCH)))

        def rfft2_of_as_many() -> None:
            for _ in range(BATCH):
                scipy.fft.rfft2(grey)

        seconds = paired(on_two_threads, rfft2_of_as_many, repeats=(2, 2))
    peer = "scipy.fft.rfft2 of a float32 frame, 1 thread"
    yield work_and_peer(f"{WORK}, 2 threads over frames", peer, seconds, BATCH)


def work_and_peer(work: str, peer: str, seconds: tuple[float, float], frames: int = 1) -> Row:
    """Return a row of the table, in seconds a frame."""
    return work, seconds[0] / frames, peer, seconds[1] / frames


def reconstruction_row(frames: np.ndarray, folder: Path) -> Row:
    """Measure the way of a long recording from its file to phase and amplitude, per frame."""
    path = folder / "video.tif"
    tifffile.imwrite(path, frames[np.arange(N_FRAMES) % len(frames)], photometric="minisblack")

    def ours() -> None:
        p4d.reconstruct(p4d.open_recording(path), LOBES)

    def theirs() -> None:
        for frame in tifffile.memmap(path, mode="r"):
            scipy.fft.rfft2(frame.astype(np.float32))

    return work_and_peer(
        f"open and reconstruct() a TIFF of {N_FRAMES} frames, each",
        "tifffile.memmap and rfft2 in float32 of each frame, 1 thread",
        paired(ours, theirs, 5),
        N_FRAMES,
    )


def rows() -> Iterator[Row]:
    """Yield (work, our seconds, peer, its seconds)."""
    frames = camera_frames()
    yield from demodulation_rows(frames)
    with tempfile.TemporaryDirectory() as folder:
        yield reconstruction_row(frames, Path(folder))


def main() -> None:
    print("| work | ours (ms) | peer | peer (ms) | ratio |\n|---|---|---|---|---|")
    for work, ours, peer, theirs in rows():
        print(
            f"| {work} | {1e3 * ours:.2f} ({1 / ours:.0f} a second) | {peer} "
            f"| {1e3 * theirs:.2f} | {theirs / ours:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
