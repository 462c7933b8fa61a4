"""What a computation costs: seconds and memory."""

from __future__ import annotations

import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, TypeVar

import psutil

__all__ = ["Measured", "measured"]

T = TypeVar("T")

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
