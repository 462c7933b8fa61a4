"""A recording larger than memory: peak memory, frames a second, and growth with its length.

Frames are made as they are read: a short simulated video, over and over. Each run is a process of
its own, so that its peak memory, the program and its libraries included, is the run's alone.
"""

from __future__ import annotations

import json
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from measuring import touch_memory

import napari_phase4d as p4d
from napari_phase4d.io.lazy import FrameReader, lazy_frames
from napari_phase4d.pipeline import write_outcome
from napari_phase4d.recording import Recording

FRAME = (1024, 1280)
SHORT = 24
#: Frames that a run in memory has.
IN_MEMORY = 600
#: Gigabytes of frames that are streamed: once, twice and four times as long.
STREAMED_GB = (5, 10, 20)
GB = 2**30
#: Side of the smaller frames that every method goes through, and how many of them.
SMALL, LENGTHS = (512, 640), (256, 1024, 4096)
#: What is run on them -> the methods of the recipe, and whether it asks for confidence.
WORK = {
    "T/A": ("temporal-angular", False),
    "DE": ("dilate-erode", False),
    "RGd": ("directional-growing", False),
    "WL1": ("directional-l1", False),
    "WL1 and its confidence": ("directional-l1", True),
}
#: A run is done so often, of which the median counts; once if it takes so many seconds.
RUNS, LONG_S = 3, 20
ROUNDS = f"Medians of {RUNS} runs in one process; of one if it takes {LONG_S} s"
#: What the longest of these in memory takes.
MOST_GB = 8
#: The longest run of the own method.
OWN_GB = 20


class Repeated(FrameReader):
    """A short video, to and fro, as long as one likes."""

    def __init__(self, short: np.ndarray, n_frames: int) -> None:
        super().__init__(Path("repeated"), (n_frames, *short.shape[1:]), short.dtype)
        self.short = short

    def read(self, index: int) -> np.ndarray:
        place = index % (2 * len(self.short) - 2)
        return self.short[min(place, 2 * len(self.short) - 2 - place)].copy()


def save_short(path: Path, shape: tuple[int, int]) -> None:
    """Simulate the short video."""
    pixel_um = 5.2 / 60 * FRAME[0] / shape[0]
    exact = p4d.simulation.swimming_euglena(shape, SHORT, pixel_um=pixel_um, peak_rad=8)
    np.save(path, p4d.simulation.multiplexed_video(exact["phase"]).holograms.values)


def one_run(n_frames: int, storage: str, work: str, folder: Path) -> dict[str, float]:
    """Do some work on so many frames, after a first run that loads and compiles."""
    method, confidence = WORK[work]
    reader = Repeated(np.load(folder / "short.npy"), n_frames)
    rec = Recording.from_frames(lazy_frames(reader))
    lobes = tuple(p4d.find_lobes(rec, 2))
    recipe = p4d.Recipe(lobes=lobes, methods=(method,), storage=storage, confidence=confidence)
    p4d.run(recipe, rec.first(SHORT), folder=folder / "first")
    taken: list[float] = []
    written: list[float] = []
    while len(taken) < RUNS and (not taken or taken[0] < LONG_S):
        shutil.rmtree(folder / "all", ignore_errors=True)
        began = time.perf_counter()
        outcome = p4d.run(recipe, rec, folder=folder / "all")
        if confidence:  # of results in memory it is computed when asked for
            outcome.comparison.confidences()
        taken.append(time.perf_counter() - began)
        # Streamed results lie there already, those in memory have yet to be written.
        write_outcome(outcome, folder / "all", form="zarr")
        written.append(time.perf_counter() - began)
        del outcome
    disk = sum(f.stat().st_size for f in (folder / "all").rglob("*") if f.is_file())
    return {
        "seconds": statistics.median(taken),
        "written": statistics.median(written),
        "peak": most_memory(),
        "disk": disk,
    }


def most_memory() -> int:
    """Return the most bytes that this process has had; of this program alone, where it is told.

    What `getrusage` tells counts, on Linux, the process that started this one as well.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
        return 1024 * int(lines["VmHWM"].split()[0])
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def in_a_process(
    n_frames: int, storage: str, work: str = "T/A", shape: tuple[int, int] = FRAME
) -> dict[str, float]:
    folder = tempfile.mkdtemp(prefix="phase4d-bench-")
    try:
        save_short(Path(folder) / "short.npy", shape)
        line = [sys.executable, __file__, str(n_frames), storage, work, folder]
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
    yield ""
    yield from work_lines()


def work_lines() -> Iterator[str]:
    """Rows: what every method takes of recordings once, four and sixteen times as long."""
    yield f"Frames of {SMALL[0]} x {SMALL[1]} and two views, from holograms to results on disk:"
    yield ""
    yield (
        "| work | frames | stacks lie | s | frames/s | to in memory | s, until written "
        "| to in memory | peak memory |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for work, n_frames in product(WORK, LENGTHS):
        in_memory: dict[str, float] = {}
        for storage in ("memory", "disk"):
            touch_memory(MOST_GB)
            found = in_a_process(n_frames, storage, work, SMALL)
            in_memory = in_memory or found
            yield work_row(work, n_frames, storage, found, in_memory)
    n_frames = int(OWN_GB * GB / np.prod(FRAME))
    found = in_a_process(n_frames, "disk", "WL1")
    yield work_row(f"WL1, {FRAME[0]} x {FRAME[1]}, {OWN_GB} GB", n_frames, "disk", found, {})


def work_row(
    work: str, n_frames: int, storage: str, found: dict[str, float], in_memory: dict[str, float]
) -> str:
    """Return a row of the table of methods."""
    place = "in memory" if storage == "memory" else "on disk"
    shares = {
        what: f"{in_memory[what] / found[what]:.2f}" if in_memory else ""
        for what in ("seconds", "written")
    }
    return (
        f"| {work} | {n_frames} | {place} | {found['seconds']:.1f} "
        f"| {n_frames / found['seconds']:.0f} | {shares['seconds']} | {found['written']:.1f} "
        f"| {shares['written']} | {found['peak'] / GB:.2f} GB |"
    )


if __name__ == "__main__":
    frames, where, what, place = sys.argv[1:]
    print(json.dumps(one_run(int(frames), where, what, Path(place))))
