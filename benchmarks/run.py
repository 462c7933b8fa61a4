"""Speed as ratios to other programs, measured in the same run (medians of several)."""

from __future__ import annotations

import os
import platform
import statistics
import time
import warnings
from collections.abc import Callable

import numpy as np
import scipy.fft
from skimage.restoration import unwrap_phase

import napari_phase4d as p4d
from napari_phase4d.holography import Demodulator, Lobe
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

ROUNDS = 5


def seconds(work: Callable[[], object]) -> float:
    times = []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def row(what: str, ours: float, peer: str, theirs: float) -> None:
    print(f"| {what} | {1e3 * ours:.1f} | {peer} | {1e3 * theirs:.1f} | {theirs / ours:.1f} |")


def main() -> None:
    print(
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, ",
        end="",
    )
    print(f"numpy {np.__version__}, scipy {scipy.__version__}\n")
    print("| work | ours (ms) | peer | peer (ms) | ratio |\n|---|---|---|---|---|")
    frame = np.random.default_rng(0).integers(0, 255, (1024, 1280)).astype(np.float32)
    lobes = [Lobe((0.19, 0.21), 0.09), Lobe((-0.21, 0.19), 0.09)]
    demodulate = Demodulator(frame.shape, lobes)
    ours = seconds(lambda: np.angle(demodulate(frame)))
    row(
        "2 views of 1024 x 1280",
        ours,
        "rfft2 of the frame alone",
        seconds(lambda: scipy.fft.rfft2(frame)),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import qpretrieve

        def theirs(padding: int) -> None:
            for lobe in lobes:
                hologram = qpretrieve.OffAxisHologram(frame, padding=padding)
                hologram.run_pipeline(
                    filter_name="disk", filter_size=1 / 3, sideband_freq=lobe.carrier
                )
                _ = hologram.phase

        row("2 views of 1024 x 1280", ours, "qpretrieve, padding 1", seconds(lambda: theirs(1)))
    exact = swimming_euglena((256, 256), 20, pixel_um=5.2 / 30)
    data = p4d.reconstruct(rec := multiplexed_video(exact["phase"]), p4d.find_lobes(rec, 2))
    phase = data["phase"].values
    ours = seconds(lambda: p4d.unwrap(phase, "temporal-angular", mask="auto"))
    loop = seconds(lambda: [unwrap_phase(f) for f in phase.reshape(-1, *phase.shape[2:])])
    row(f"T/A of {phase.shape}", ours, "scikit-image 2-D of the same frames", loop)


if __name__ == "__main__":
    main()
