"""Who works on the blocks: the threads of this machine, or a cluster."""

from __future__ import annotations

import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from threading import Event, Thread
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

from napari_phase4d.task import LOOK_UP_S, Watch, in_threads

__all__ = ["Cluster", "Threads", "Workers"]

T = TypeVar("T")
R = TypeVar("R")

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
    OSError
        If no scheduler answers there, or it has no workers.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            msg = 'a cluster needs one more package; run: pip install "napari-phase4d[cluster]"'
            raise ImportError(msg) from error
        try:
            how = {"scheduler_file": address} if address.endswith(".json") else {}
            if how and not Path(address).is_file():
                raise FileNotFoundError(address)
            if not how and not answers(address):
                raise TimeoutError(address)
            # Not for all of dask: what this process reads by itself is its own work.
            self._client: Any = Client(
                None if how else address, timeout=ANSWER_S, set_as_default=False, **how
            )
        except (OSError, ValueError) as error:
            msg = f"no dask scheduler answers at {address}; start one with 'dask scheduler'"
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


def answers(address: str) -> bool:
    """Say whether a scheduler takes connections at an address; of other protocols that is unknown.

    A scheduler greets first, by a short message whose length comes first. What else may listen
    there says nothing, as a web server does, or something that is no such length; a client would
    wait for it without an end. Looking a name up can take minutes, so that it is done beside.
    """
    place = urlsplit(address if "://" in address else f"tcp://{address}")
    if place.scheme not in ("tcp", "tls"):
        return True
    port = place.port  # ValueError if there can't be such a one
    found = Event()

    def look() -> None:
        with (
            suppress(OSError),
            socket.create_connection((place.hostname, port or SCHEDULER_PORT), ANSWER_S) as open_,
        ):
            # With tls it is the client that begins.
            if place.scheme == "tls" or greets(open_):
                found.set()

    looking = Thread(target=look, daemon=True)
    looking.start()
    looking.join(ANSWER_S)
    return found.is_set()


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
