"""How long work tells its progress and is stopped, without knowing who is watching."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
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
    waiting: deque[Future[R]] = deque()
    watch.check()
    pool = ThreadPoolExecutor(workers, THREADS)
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) >= 2 * workers:
                yield finished(waiting, watch)
        while waiting:
            yield finished(waiting, watch)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


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
        future = pool.submit(work)
        while not future.done():
            wait([future], timeout=LOOK_UP_S)
            watch.check()
        return future.result()
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def finished(waiting: deque[Future[R]], watch: Watch) -> R:
    """Return the oldest result and note the step."""
    future = waiting.popleft()
    while not future.done():
        wait([future], timeout=LOOK_UP_S)
        watch.check()
    result = future.result()
    watch.step()
    return result
