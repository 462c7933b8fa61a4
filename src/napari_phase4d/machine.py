"""What of this machine may be used: its memory and cores, or the part that a container gets.

And what some work takes of them: its time and memory.

Linux keeps a process in a control group, whose limits hold besides those of the machine: see
"Control Group v2" and "Memory Resource Controller" in the documents of its kernel. Each group lies
in another, and the tightest limit of them holds.
"""

from __future__ import annotations

import math
import os
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Generic, TypeVar

import psutil

__all__ = ["Measured", "cores", "free_memory", "measured"]

T = TypeVar("T")

ROOT = Path("/")


@cache
def cores() -> int:
    """Return how many threads can work at a time; looked up once."""
    return cores_of(ROOT)


def cores_of(root: Path) -> int:
    """Return how many cores this process may use, where files of the system lie below a root."""
    count = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        count = min(count, len(os.sched_getaffinity(0)))
    for group in groups("cpu", root):
        quota, period = (
            texts(group / "cpu.max", 2)
            or [*texts(group / "cpu.cfs_quota_us"), *texts(group / "cpu.cfs_period_us")]
            or ("max", "")
        )
        if quota not in ("max", "-1"):
            count = min(count, math.ceil(int(quota) / int(period)))
    return max(count, 1)


def free_memory(root: Path = ROOT) -> int:
    """Return how many bytes of memory can be taken before the system or its container is full.

    Parameters
    ----------
    root : Path, optional
        Where the files of the system lie.
    """
    free = int(psutil.virtual_memory().available)
    for group in groups("memory", root):
        limit = texts(group / "memory.max") or texts(group / "memory.limit_in_bytes")
        used = texts(group / "memory.current") or texts(group / "memory.usage_in_bytes")
        if limit and used and limit[0] != "max":
            free = min(free, max(int(limit[0]) - int(used[0]) + cached(group), 0))
    return free


def cached(group: Path) -> int:
    """Return the bytes of files that a group keeps in memory and gives back when it needs it."""
    try:
        lines = (group / "memory.stat").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    known = dict(line.split() for line in lines)
    return int(known.get("total_inactive_file", known.get("inactive_file", 0)))


def groups(controller: str, root: Path) -> Iterator[Path]:
    """Yield the folders of this process's control groups that a controller has, innermost first.

    A container may see only its own group, mounted in the place of the outermost.
    """
    try:
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and controller not in controllers.split(","):
            continue
        named = (controllers, controller) if controllers else ("", "unified")
        for top in (root / "sys/fs/cgroup" / name for name in named):
            own = top / path.lstrip("/")
            yield from (folder for folder in (own, *own.parents) if folder.is_relative_to(top))


def texts(file: Path, count: int = 1) -> list[str]:
    """Return the words of a small file, if it is there and has so many."""
    try:
        words = file.read_text(encoding="ascii").split()
    except (OSError, ValueError):
        return []
    return words if len(words) == count else []


# ---- what work takes of it ------------------------------------------------------------------


#: Seconds between two looks at the memory of the process.
LOOK_S = 0.004
MB = 2**20


@dataclass(frozen=True)
class Measured(Generic[T]):
    """A result with what it cost.

    Parameters
    ----------
    result : object
        What the computation gave.
    seconds : float
        Wall time.
    peak_mb : float
        Largest memory at one time, in megabytes (2**20 bytes), beyond what was there before.
    """

    result: T
    seconds: float
    peak_mb: float


def measured(work: Callable[[], T]) -> Measured[T]:
    """Do some work and measure it.

    Memory is that of the whole process, looked at every few milliseconds: what other threads take
    meanwhile counts too, and memory that the process had before and uses again does not. While
    ``tracemalloc`` is tracing it is what Python and NumPy ask for, to the byte. It is not turned
    on here: before Python 3.12.9 and 3.13.2, turning it off crashes where other threads allocate.
    """
    with memory_watch() as peak_bytes:
        began = time.perf_counter()
        result = work()
        seconds = time.perf_counter() - began
        peak = peak_bytes()
    return Measured(result, seconds, max(peak, 0) / MB)


@contextmanager
def memory_watch() -> Iterator[Callable[[], int]]:
    """Watch memory; what is given returns the largest rise so far, in bytes."""
    if tracemalloc.is_tracing():
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        yield lambda: tracemalloc.get_traced_memory()[1] - before
        return
    process = psutil.Process()
    at_first = highest = process.memory_info().rss
    ended = threading.Event()

    def look() -> None:
        nonlocal highest
        while not ended.wait(LOOK_S):
            highest = max(highest, process.memory_info().rss)

    def rise() -> int:
        return int(max(highest, process.memory_info().rss) - at_first)

    watcher = threading.Thread(target=look, name="memory watch", daemon=True)
    watcher.start()
    try:
        yield rise
    finally:
        ended.set()
        watcher.join()
