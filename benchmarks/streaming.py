"""A recording larger than memory: peak memory, frames a second, and growth with its length.

Frames are made as they are read: a short simulated video, over and over. Each run is a process of
its own, so that its peak memory, the program and its libraries included, is the run's alone.
"""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import napari_phase4d as p4d
from napari_phase4d.io.lazy import FrameReader, lazy_frames
from napari_phase4d.recording import Recording

FRAME = (1024, 1280)
SHORT = 24
#: Frames that a run in memory has.
IN_MEMORY = 600
#: Gigabytes of frames that are streamed: once, twice and four times as long.
STREAMED_GB = (5, 10, 20)
GB = 2**30


class Repeated(FrameReader):
    """A short video, to and fro, as long as one likes."""

    def __init__(self, short: np.ndarray, n_frames: int) -> None:
        super().__init__(Path("repeated"), (n_frames, *short.shape[1:]), short.dtype)
        self.short = short

    def read(self, index: int) -> np.ndarray:
        place = index % (2 * len(self.short) - 2)
        return self.short[min(place, 2 * len(self.short) - 2 - place)].copy()


def save_short(path: Path) -> None:
    """Simulate the short video."""
    exact = p4d.simulation.swimming_euglena(FRAME, SHORT, pixel_um=5.2 / 60, peak_rad=8)
    np.save(path, p4d.simulation.multiplexed_video(exact["phase"]).holograms.values)


def one_run(n_frames: int, storage: str, folder: Path) -> dict[str, float]:
    """Run T/A on so many frames, after a first run that loads and compiles."""
    reader = Repeated(np.load(folder / "short.npy"), n_frames)
    rec = Recording.from_frames(lazy_frames(reader))
    lobes = tuple(p4d.find_lobes(rec, 2))
    recipe = p4d.Recipe(lobes=lobes, methods=("temporal-angular",), storage=storage)
    p4d.run(recipe, rec.first(SHORT), folder=folder / "first")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.perf_counter()
    p4d.run(recipe, rec, folder=folder / "all")
    seconds = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    disk = sum(f.stat().st_size for f in (folder / "all").rglob("*") if f.is_file())
    return {"seconds": seconds, "peak": 1024 * peak, "before": 1024 * before, "disk": disk}


def in_a_process(n_frames: int, storage: str) -> dict[str, float]:
    folder = tempfile.mkdtemp(prefix="phase4d-bench-")
    try:
        save_short(Path(folder) / "short.npy")
        line = [sys.executable, __file__, str(n_frames), storage, folder]
        done = subprocess.run(line, check=True, capture_output=True, text=True)
        return dict(json.loads(done.stdout.splitlines()[-1]))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def lines() -> Iterator[str]:
    """Rows: what ran where, frames a second, peak memory, disk."""
    yield "| frames | of video | stacks lie | frames/s | to in memory | peak memory | on disk |"
    yield "|---|---|---|---|---|---|---|"
    base = 0.0
    plan = [(IN_MEMORY, "memory"), (IN_MEMORY, "disk")]
    plan += [(int(gb * GB / np.prod(FRAME)), "disk") for gb in STREAMED_GB]
    for n_frames, storage in plan:
        found = in_a_process(n_frames, storage)
        rate = n_frames / found["seconds"]
        base = base or rate
        size = n_frames * np.prod(FRAME) / GB
        yield (
            f"| {n_frames} | {size:.1f} GB | {'in memory' if storage == 'memory' else 'on disk'} "
            f"| {rate:.0f} | {rate / base:.2f} | {found['peak'] / GB:.2f} GB "
            f"| {found['disk'] / GB:.1f} GB |"
        )


if __name__ == "__main__":
    frames, where, place = sys.argv[1:]
    print(json.dumps(one_run(int(frames), where, Path(place))))
