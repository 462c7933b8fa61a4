"""How long work tells its progress and is stopped, without knowing who is watching."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from itertools import islice
from typing import TypeVar

__all__ = [
    "Cancelled",
    "CancelledCall",
    "ProgressCall",
    "Watch",
    "in_threads",
    "on_all_cores",
    "watched",
]

#: ``progress(done, total, message)``
ProgressCall = Callable[[int, int, str], None]
#: ``cancelled() -> bool``
CancelledCall = Callable[[], bool]

#: Seconds between two looks at ``cancelled()`` while an item is computed.
LOOK_UP_S = 0.1

#: Quick items are handed to threads several at a time, of about so many seconds together ...
BATCH_S = 0.005
#: ... and no more than this, since their results wait in memory.
LARGEST_BATCH = 16
#: What the names of the threads begin with.
THREADS = "phase4d"

T = TypeVar("T")
R = TypeVar("R")


class Cancelled(Exception):  # noqa: N818 - it reports a wish, not an error
    """The work was stopped because ``cancelled()`` said so."""


class Watch:
    """Counts finished steps, reports them, and stops the work when asked to.

    Parameters
    ----------
    total : int
        Number of steps.
    message : str
        What is being done.
    progress, cancelled : callable, optional
        Called after each step with (done, total, message); asked before and after each step.
    """

    def __init__(
        self,
        total: int,
        message: str,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> None:
        self.total = total
        self.message = message
        self._progress = progress
        self._cancelled = cancelled
        self._done = 0

    def check(self) -> None:
        """Raise `Cancelled` if the work is to stop."""
        if self._cancelled is not None and self._cancelled():
            msg = f"{self.message}: cancelled after {self._done} of {self.total}"
            raise Cancelled(msg)

    def step(self) -> None:
        """Note one finished step."""
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, self.total, self.message)
        self.check()


def in_threads(work: Callable[[T], R], items: Iterable[T], watch: Watch) -> Iterator[R]:
    """Yield ``work(item)`` in order, computed on as many threads as there are cores.

    Only a few results wait in memory at a time. When cancelled, it stops at once; items already
    under way end by themselves and their results are dropped.
    """
    workers = os.cpu_count() or 1
    waiting: deque[Future[tuple[list[R], float]]] = deque()
    source, size = iter(items), 1
    watch.check()
    pool = ThreadPoolExecutor(workers, THREADS)
    try:
        while batch := list(islice(source, size)):
            waiting.append(pool.submit(timed, work, batch))
            if len(waiting) >= 2 * workers:
                results, seconds = finished(waiting.popleft(), watch)
                size = max(1, min(int(len(results) * BATCH_S / max(seconds, 1e-9)), LARGEST_BATCH))
                yield from counted(results, watch)
        while waiting:
            yield from counted(finished(waiting.popleft(), watch)[0], watch)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def timed(work: Callable[[T], R], batch: list[T]) -> tuple[list[R], float]:
    """Return what some items give, and the seconds that it took."""
    began = time.perf_counter()
    return [work(item) for item in batch], time.perf_counter() - began


def counted(results: list[R], watch: Watch) -> Iterator[R]:
    """Yield results, noting a step for each."""
    for result in results:
        watch.step()
        yield result


def on_all_cores(work: Callable[[T], object], items: Iterable[T]) -> None:
    """Do some work on every item, on as many threads as there are cores, and wait for all."""
    with ThreadPoolExecutor(os.cpu_count() or 1, THREADS) as pool:
        for _ in pool.map(work, items):
            pass


def watched(work: Callable[[], R], watch: Watch) -> R:
    """Return ``work()``, computed in a thread; the wish to stop is looked up while it runs.

    When cancelled, the work ends by itself and its result is dropped.
    """
    watch.check()
    pool = ThreadPoolExecutor(1, THREADS)
    try:
        return finished(pool.submit(work), watch)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def finished(future: Future[R], watch: Watch) -> R:
    """Return a result when it is there, looking up meanwhile whether to stop."""
    while not future.done():
        wait([future], timeout=LOOK_UP_S)
        watch.check()
    return future.result()
