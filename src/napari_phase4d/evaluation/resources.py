"""What a computation costs: seconds and memory."""

from __future__ import annotations

import threading
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["Measured", "measured"]

T = TypeVar("T")


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
        Largest memory at one time, in megabytes (2**20 bytes), beyond what was there before; NaN
        if something else was being measured meanwhile.
    """

    result: T
    seconds: float
    peak_mb: float


#: Memory can be watched for one computation at a time.
WATCHING = threading.Lock()


def measured(work: Callable[[], T]) -> Measured[T]:
    """Do some work and measure it.

    Memory is what Python and NumPy ask for, in all threads; what compiled libraries allocate for
    themselves is not seen. Watching it costs some time where many small arrays are made.
    """
    began = time.perf_counter()
    if not WATCHING.acquire(blocking=False):
        result = work()
        return Measured(result, time.perf_counter() - began, float("nan"))
    was_tracing = tracemalloc.is_tracing()
    try:
        if not was_tracing:
            tracemalloc.start()
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        began = time.perf_counter()
        result = work()
        seconds = time.perf_counter() - began
        _, peak = tracemalloc.get_traced_memory()
    finally:
        if not was_tracing:
            tracemalloc.stop()
        WATCHING.release()
    return Measured(result, seconds, max(peak - before, 0) / 2**20)
