"""Timing work against a peer, and writing down what came out."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import statistics
import time
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROUNDS = 5
PACKAGES = ("numpy", "scipy", "scikit-image", "numba", "qpretrieve", "pyfftw")


@dataclass(frozen=True)
class Row:
    """One comparison: seconds of ours and of a peer, and what was seen of the results."""

    work: str
    ours: float
    peer: str
    theirs: float
    goal: str = ""
    note: str = ""

    @property
    def ratio(self) -> float:
        return self.theirs / self.ours

    def __str__(self) -> str:
        cells = (
            self.work,
            in_milliseconds(self.ours),
            self.peer,
            in_milliseconds(self.theirs),
            f"{self.ratio:.0f}" if self.ratio >= 20 else f"{self.ratio:.1f}",
            self.goal,
            self.note,
        )
        return f"| {' | '.join(cells)} |"


HEAD = (
    "| work | ours (ms) | peer | peer (ms) | times as fast | goal | results |\n"
    "|---|---|---|---|---|---|---|"
)


def in_milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.2f}" if seconds < 0.1 else f"{1e3 * seconds:.0f}"


def paired(
    ours: Callable[[], object],
    theirs: Callable[[], object],
    rounds: int = ROUNDS,
    repeats: tuple[int, int] = (1, 1),
) -> tuple[float, float]:
    """Return the median seconds of one call of each, called in turn.

    A call without a clock comes before those that are repeated, since a video keeps memory and
    cache warm.
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


def median_seconds(
    work: Callable[[], object], rounds: int = ROUNDS, before: Callable[[], object] | None = None
) -> float:
    """Return the median seconds of a call; ``before`` is called before each, without a clock."""
    times = []
    for _ in range(rounds):
        if before is not None:
            before()
        began = time.perf_counter()
        work()
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def touch_memory(gigabytes: float) -> None:
    """Use memory and give it back.

    A virtual machine may have to fetch memory that it never used from its host, which takes
    seconds a gigabyte and has nothing to do with the program.
    """
    pieces = [np.empty(2**26, dtype=np.float32) for _ in range(int(4 * gigabytes))]
    for piece in pieces:
        piece[::1024] = 1


def machine(rounds: str = f"Medians of {ROUNDS} or more; all of one row in the same run") -> str:
    """Say what this was measured on."""
    versions = ", ".join(f"{p} {version_of(p)}" for p in PACKAGES)
    return (
        f"{processor()}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}. "
        f"{rounds}."
    )


def taken_by_host() -> tuple[int, int]:
    """Return processor time that the host of a virtual machine kept to itself, and all in use."""
    stat = Path("/proc/stat")
    if not stat.exists():
        return 0, 0
    user, nice, system, _idle, _waiting, irq, soft, steal = (
        int(n) for n in stat.read_text().split()[1:9]
    )
    return steal, user + nice + system + irq + soft + steal


def version_of(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()


def table(rows: Iterator[Row]) -> str:
    """Print rows as they come, and return them as a table."""
    print(HEAD)
    lines = [HEAD]
    for row in rows:
        print(row, flush=True)
        lines.append(str(row))
    return "\n".join(lines)


def peak_bytes(work: Callable[[], object]) -> int:
    """Return the largest memory of some work that leaves no thread behind, to the byte."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
