"""What a computation costs: seconds and memory."""

from __future__ import annotations

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
        Largest memory at one time, in megabytes (2**20 bytes), beyond what was there before.
    """

    result: T
    seconds: float
    peak_mb: float


def measured(work: Callable[[], T]) -> Measured[T]:
    """Do some work and measure it.

    Memory is what Python and NumPy ask for, in all threads; what compiled libraries allocate for
    themselves is not seen. Watching it costs some time where many small arrays are made.
    """
    was_tracing = tracemalloc.is_tracing()
    if not was_tracing:
        tracemalloc.start()
    try:
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        began = time.perf_counter()
        result = work()
        seconds = time.perf_counter() - began
        _, peak = tracemalloc.get_traced_memory()
    finally:
        if not was_tracing:
            tracemalloc.stop()
    return Measured(result, seconds, max(peak - before, 0) / 2**20)
