"""How long work tells its progress and is stopped, without knowing who is watching."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sized
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice
from typing import Generic, TypedDict, TypeVar

from napari_phase4d.machine import cores
from napari_phase4d.words import check_call

__all__ = [
    "LOOK_UP_S",
    "THREADS",
    "UNWATCHED",
    "Cancelled",
    "CancelledCall",
    "ProgressCall",
    "Task",
    "Watch",
    "finished",
    "in_threads",
    "nothing",
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
LARGEST_BATCH = 8
#: What the names of the threads begin with.
THREADS = "phase4d"

T = TypeVar("T")
R = TypeVar("R")


def nothing() -> None:
    """Let work go on: what is called between its parts where nobody wants to stop it."""


class Cancelled(Exception):  # noqa: N818 - it reports a wish, not an error
    """The work was stopped because ``cancelled()`` said so."""


class Calls(TypedDict):
    """How functions for scripts are told of a task."""

    progress: ProgressCall | None
    cancelled: CancelledCall | None


@dataclass(frozen=True)
class Task:
    """Long work as seen from outside: who is told how far it is, and who may stop it.

    Parameters
    ----------
    progress : callable, optional
        ``progress(done, total, message)``, called after each step.
    cancelled : callable, optional
        ``cancelled()``; the work stops if it returns True.

    Raises
    ------
    TypeError
        If one of them can't be called.
    """

    progress: ProgressCall | None = None
    cancelled: CancelledCall | None = None

    def __post_init__(self) -> None:
        check_call("progress", self.progress)
        check_call("cancelled", self.cancelled)

    @property
    def calls(self) -> Calls:
        """What functions for scripts take: ``unwrap(phase, **task.calls)``."""
        return {"progress": self.progress, "cancelled": self.cancelled}

    @property
    def quiet(self) -> Task:
        """The same wish to stop; nobody is told how far it is."""
        return Task(None, self.cancelled)

    @property
    def stopped(self) -> bool:
        """Whether the work is to stop."""
        return self.cancelled is not None and self.cancelled()

    def reworded(self, words: Callable[[str], str]) -> Task:
        """Return a task of which is told in other words.

        Parameters
        ----------
        words : callable
            ``words(message)`` returns what is to be said instead.
        """
        told = self.progress
        if told is None:
            return self
        return Task(lambda done, total, message: told(done, total, words(message)), self.cancelled)

    def counting(self, each: int, total: int) -> Task:
        """Return a task told of in other units, of which every step but the last makes as many.

        Parameters
        ----------
        each, total : int
            Units of a step, and in all.
        """
        told = self.progress
        if told is None:
            return self
        return Task(
            lambda done, _, message: told(min(done * each, total), total, message),
            self.cancelled,
        )


#: Work that nobody waits for.
UNWATCHED = Task()


class Watch:
    """Counts finished steps of a task, reports them, and stops the work when asked to.

    Parameters
    ----------
    total : int
        Number of steps.
    message : str
        What is being done.
    task : Task, optional
        Who is told after each step, and asked before and after it.
    """

    def __init__(self, total: int, message: str, task: Task = UNWATCHED) -> None:
        self.total = total
        self.message = message
        self.task = task
        self._done = 0

    @property
    def can_stop(self) -> bool:
        """Whether anybody may want the work to stop."""
        return self.task.cancelled is not None

    def quiet(self, total: int) -> Watch:
        """Return a watch that heeds the same wish to stop, and tells nothing."""
        return Watch(total, self.message, self.task.quiet)

    def check(self) -> None:
        """Raise `Cancelled` if the work is to stop."""
        if self.task.stopped:
            msg = f"{self.message}: cancelled after {self._done} of {self.total}"
            raise Cancelled(msg)

    def step(self) -> None:
        """Note one finished step."""
        self._done += 1
        if self.task.progress is not None:
            self.task.progress(self._done, self.total, self.message)
        self.check()


def in_threads(
    work: Callable[[T], R],
    items: Iterable[T],
    watch: Watch,
    *,
    wait: bool = False,
    large: bool = False,
) -> Iterator[R]:
    """Yield ``work(item)`` in order, computed on as many threads as there are cores.

    Only a few results wait in memory at a time. When cancelled, it stops at once; items already
    under way end by themselves and their results are dropped. With ``wait``, for work that leaves
    more than its result, it ends only when these have ended. With ``large`` results, one at most
    waits while others are computed. A single item that nobody may stop is worked on right here:
    to start a thread takes longer than many a frame.
    """
    if is_single(items) and not watch.can_stop:
        for item in items:
            result = work(item)
            watch.step()
            yield result
        return
    workers = cores()
    most = workers + 1 if large else 2 * workers
    waiting: deque[Future[Batch[R]]] = deque()
    source, size = iter(items), 1
    stopped = threading.Event()
    watch.check()
    pool = ThreadPoolExecutor(workers, THREADS)
    try:
        while batch := list(islice(source, size)):
            waiting.append(pool.submit(done_batch, work, batch, stopped))
            if len(waiting) >= most:
                done = finished(waiting.popleft(), watch)
                yield from counted(done, watch)
                if not large:
                    size = max(1, min(int(BATCH_S / max(done.seconds_each, 1e-9)), LARGEST_BATCH))
        while waiting:
            yield from counted(finished(waiting.popleft(), watch), watch)
    finally:
        stopped.set()
        pool.shutdown(wait=wait, cancel_futures=True)


def is_single(items: Iterable[object]) -> bool:
    """Say whether there is no more than one item; of those that come one by one nobody knows."""
    return isinstance(items, Sized) and len(items) <= 1


@dataclass
class Batch(Generic[R]):
    """What some items gave, the mean time of one, and the error that ended them, if any."""

    results: list[R]
    seconds_each: float
    error: Exception | None = None


def done_batch(work: Callable[[T], R], items: list[T], stopped: threading.Event) -> Batch[R]:
    """Work on some items one after the other, until told to stop."""
    began = time.perf_counter()
    done = Batch[R]([], 0.0)
    try:
        for item in items:
            if stopped.is_set():
                break
            done.results.append(work(item))
    except Exception as error:  # raised where the results are waited for
        done.error = error
    done.seconds_each = (time.perf_counter() - began) / max(len(done.results), 1)
    return done


def counted(done: Batch[R], watch: Watch) -> Iterator[R]:
    """Yield the results of a batch, noting a step for each; then raise what ended it."""
    for result in done.results:
        watch.step()
        yield result
    if done.error is not None:
        raise done.error


def on_all_cores(work: Callable[[T], object], items: Iterable[T]) -> None:
    """Do some work on every item, on as many threads as there are cores, and wait for all."""
    if is_single(items):
        for item in items:
            work(item)
        return
    with ThreadPoolExecutor(cores(), THREADS) as pool:
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
