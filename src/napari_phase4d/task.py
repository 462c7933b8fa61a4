"""Long work: how it tells its progress and is stopped, and who does it: threads, or a cluster.

It does not know who is watching.
"""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sized
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Generic, Protocol, TypedDict, TypeVar
from urllib.parse import urlsplit

from napari_phase4d.machine import cores
from napari_phase4d.words import check_call, printable, shown

__all__ = [
    "LOOK_UP_S",
    "THREADS",
    "UNWATCHED",
    "Cancelled",
    "CancelledCall",
    "Cluster",
    "ProgressCall",
    "Task",
    "Threads",
    "Watch",
    "Workers",
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
        ``cancelled()``; the work stops if it returns True. Several threads may ask at once.

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
            waiting.append(pool.submit(copy_context().run, done_batch, work, batch, stopped))
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


def on_all_cores(
    work: Callable[[T], object], items: Iterable[T], task: Task = UNWATCHED, message: str = ""
) -> None:
    """Do some work on every item, on as many threads as there are cores, and wait for all.

    Nobody is told of it; when cancelled, no further item is begun.
    """
    stopped = threading.Event()

    def unless_stopped(item: T) -> None:
        if not stopped.is_set():
            if task.stopped:
                stopped.set()
            else:
                work(item)

    if is_single(items):
        for item in items:
            unless_stopped(item)
    else:
        with ThreadPoolExecutor(cores(), THREADS) as pool:
            for _ in pool.map(unless_stopped, items):
                pass
    if stopped.is_set():
        msg = f"{message}: cancelled"
        raise Cancelled(msg)


def watched(work: Callable[[], R], watch: Watch) -> R:
    """Return ``work()``, computed in a thread; the wish to stop is looked up while it runs.

    When cancelled, the work ends by itself and its result is dropped.
    """
    watch.check()
    pool = ThreadPoolExecutor(1, THREADS)
    try:
        return finished(pool.submit(copy_context().run, work), watch)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def finished(future: Future[R], watch: Watch) -> R:
    """Return a result when it is there, looking up meanwhile whether to stop."""
    while not future.done():
        wait([future], timeout=LOOK_UP_S)
        watch.check()
    return future.result()


# ---- who works on the blocks: threads of this machine, or a cluster -------------------------


#: Blocks that wait for each thread of a cluster, so that none has nothing to do.
AHEAD = 2
#: Seconds between two looks at whether a block is done.
BETWEEN_S = 0.01
#: Seconds to wait for blocks that are under way when the work is stopped.
ENDING_S = 30
#: Seconds between two looks at whether there are workers.
LOOK_AROUND_S = 1
#: Seconds to wait for a new worker where all have died; what looks after them may start others.
NEW_WORKER_S = 8
#: Where dask's scheduler listens unless told otherwise.
SCHEDULER_PORT = 8786
#: Seconds to wait for the scheduler to answer.
ANSWER_S = 6
#: How a scheduler's messages begin: with the number of bytes that follow; and most of a greeting.
LENGTH, LONGEST_GREETING = struct.Struct("<Q"), 100_000


class Workers(Protocol):
    """Works on many items."""

    def map(self, work: Callable[[T], R], items: Iterable[T], watch: Watch) -> Iterator[R]:
        """Yield ``work(item)`` in order; the wish to stop is looked up all the while."""


class Threads:
    """As many threads as this machine has cores."""

    def map(self, work: Callable[[T], R], items: Iterable[T], watch: Watch) -> Iterator[R]:
        """Yield ``work(item)`` in order."""
        # What is written must be written before its folder may go.
        return in_threads(work, items, watch, wait=True)


class Cluster:
    """Workers of a ``dask.distributed`` scheduler that runs already.

    A block whose worker dies is done again by another one. All workers must see the recording
    and the folder of the results under the same paths.

    Parameters
    ----------
    address : str
        Of the scheduler, such as "tcp://10.0.0.5:8786", or a file that it wrote.

    Raises
    ------
    ImportError
        If ``distributed`` is not installed.
    TypeError
        If it is no address.
    OSError
        If no scheduler answers there, or it has no workers.
    """

    def __init__(self, address: str) -> None:
        if not isinstance(address, str) or not address:
            msg = (
                'scheduler must be an address such as "tcp://10.0.0.5:8786", but is '
                f"{shown(address)}"
            )
            raise TypeError(msg)
        try:
            from distributed import Client
        except ImportError as error:
            msg = 'a cluster needs one more package; run: pip install "napari-phase4d[cluster]"'
            raise ImportError(msg) from error
        there = address
        try:
            if address.endswith(".json"):
                there = scheduler_in(Path(address))
            check_answers(there)
            # Not for all of dask: what this process reads by itself is its own work.
            self._client: Any = Client(there, timeout=ANSWER_S, set_as_default=False)
        except (OSError, ValueError) as error:
            msg = (
                f"no dask scheduler answers at {printable(address)}; start one with "
                "'dask scheduler'"
            )
            if there.startswith("tls://"):
                msg += (
                    ", or, if one runs there, give dask its certificates "
                    "(distributed.comm.tls in dask's configuration), which may be missing"
                )
            raise OSError(msg) from error
        if not self._client.nthreads():
            self._client.close()
            msg = f"the dask scheduler at {address} has no workers; start some with 'dask worker'"
            raise OSError(msg)

    def map(self, work: Callable[[T], R], items: Iterable[T], watch: Watch) -> Iterator[R]:
        """Yield ``work(item)`` in order, a few items ahead for each thread of the cluster."""
        waiting: deque[Any] = deque()
        left = iter(items)
        watch.check()
        try:
            while True:
                room = AHEAD * max(self._threads(watch), 1) - len(waiting)
                for item in islice(left, max(room, 1)):
                    waiting.append(self._client.submit(work, item, pure=False))
                if not waiting:
                    return
                yield self._result(waiting.popleft(), watch)
                watch.step()
        finally:
            self._end(list(waiting))

    def close(self) -> None:
        """Leave the cluster; its workers go on for others."""
        self._client.close()

    def _end(self, waiting: list[Any]) -> None:
        """Stop what has not begun, and wait for what is being written."""
        if not waiting:
            return
        names = {future.key for future in waiting}
        self._client.cancel(waiting)
        give_up = time.monotonic() + ENDING_S
        while time.monotonic() < give_up:
            executing = self._client.run(keys_under_way)
            if not names & {key for keys in executing.values() for key in keys}:
                return
            time.sleep(LOOK_UP_S)

    def _threads(self, watch: Watch) -> int:
        """Return how many threads the workers have."""
        try:
            return sum(self._client.nthreads().values())
        except OSError as error:
            msg = f"{watch.message}: the dask scheduler is gone; start one with 'dask scheduler'"
            raise OSError(msg) from error

    def _result(self, future: Any, watch: Watch) -> Any:
        """Wait for what one item gives; a result that dies with its worker is made again."""
        from distributed import KilledWorker

        last_seen = looked = time.monotonic()
        while True:
            watch.check()
            if time.monotonic() - looked > LOOK_AROUND_S:
                looked = time.monotonic()
                if self._threads(watch):
                    last_seen = looked
                elif looked - last_seen > NEW_WORKER_S:
                    msg = (
                        f"{watch.message}: all workers of the cluster are gone; start some with "
                        "'dask worker', then run it again"
                    )
                    raise OSError(msg)
            if not future.done():
                time.sleep(BETWEEN_S)
                continue
            try:
                return future.result(timeout=LOOK_AROUND_S)
            except TimeoutError:
                continue
            except KilledWorker as error:
                times = error.allowed_failures + 1
                msg = f"{watch.message}: {times} workers that did it died; see their logs"
                raise OSError(msg) from error


def scheduler_in(file: Path) -> str:
    """Return the address that a scheduler has written to a file; ValueError if there is none."""
    if not file.is_file():
        raise FileNotFoundError(file)
    noted = json.loads(file.read_text(encoding="utf-8"))
    address = noted.get("address") if isinstance(noted, dict) else None
    if not isinstance(address, str) or not address:
        msg = "it notes no address"
        raise ValueError(msg)
    return address


def check_answers(address: str) -> None:
    """Raise TimeoutError, from what is wrong, unless a scheduler takes connections at an address.

    A scheduler greets first, by a short message whose length comes first. What else may listen
    there says nothing, as a web server does, or something that is no such length; a client would
    wait for it without an end. Looking a name up can take minutes, so that it is done beside.
    """
    place = urlsplit(address if "://" in address else f"tcp://{address}")
    port = place.port  # ValueError if there can't be such a one
    found = threading.Event()
    wrong: list[Exception] = []

    def look() -> None:
        where = (place.hostname or "", port or SCHEDULER_PORT)
        try:
            with socket.create_connection(where, ANSWER_S) as open_:
                if greets(open_):
                    found.set()
        except (OSError, UnicodeError) as error:
            wrong.append(error)

    def connect() -> None:
        try:
            asyncio.run(greeted(address))
            found.set()
        except Exception as error:  # whatever the packages of other protocols raise
            wrong.append(error)

    looking = threading.Thread(target=look if place.scheme == "tcp" else connect, daemon=True)
    looking.start()
    looking.join(ANSWER_S)
    if not found.is_set():
        raise TimeoutError(address) from next(iter(wrong), None)


async def greeted(address: str) -> None:
    """Connect to a scheduler by another protocol than plain tcp, or raise what dask does.

    A client that is refused waits for itself when the program ends.
    """
    from distributed.comm import connect
    from distributed.security import Security

    how = Security().get_connection_args("client")
    connection = await connect(address, timeout=ANSWER_S, **how)
    await connection.close()


def greets(connection: socket.socket) -> bool:
    """Say whether what is at the other end of a connection greets as a scheduler does."""
    begun = b""
    while len(begun) < LENGTH.size:
        more = connection.recv(LENGTH.size - len(begun))
        if not more:
            return False
        begun += more
    (length,) = LENGTH.unpack(begun)
    return bool(0 < length <= LONGEST_GREETING)


def keys_under_way(dask_worker: Any) -> list[str]:
    """Return the names of the blocks that a worker of a cluster is at."""
    return [str(task.key) for task in dask_worker.state.executing]
