"""Who works on the blocks: the threads of this machine, or a cluster."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import Any, Protocol, TypeVar

from napari_phase4d.progress import LOOK_UP_S, Watch, in_threads

__all__ = ["Cluster", "Threads", "Workers"]

T = TypeVar("T")
R = TypeVar("R")

#: Blocks that wait for each thread of a cluster, so that none has nothing to do.
AHEAD = 2
#: How often a block is tried anew after its worker has died.
RETRIES = 5
#: Seconds to wait for the scheduler to answer.
ANSWER_S = 20


class Workers(Protocol):
    """Works on many items."""

    def map(self, work: Callable[[T], R], items: Iterable[T], watch: Watch) -> Iterator[R]:
        """Yield ``work(item)`` in order; the wish to stop is looked up all the while."""


class Threads:
    """As many threads as this machine has cores."""

    def map(self, work: Callable[[T], R], items: Iterable[T], watch: Watch) -> Iterator[R]:
        """Yield ``work(item)`` in order."""
        return in_threads(work, items, watch)


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
            self._client: Any = Client(None if how else address, timeout=ANSWER_S, **how)
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
                room = AHEAD * max(sum(self._client.nthreads().values()), 1) - len(waiting)
                for item in islice(left, max(room, 1)):
                    waiting.append(self._client.submit(work, item, pure=False, retries=RETRIES))
                if not waiting:
                    return
                yield self._result(waiting.popleft(), watch)
                watch.step()
        finally:
            self._client.cancel(list(waiting))

    def close(self) -> None:
        """Leave the cluster; its workers go on for others."""
        self._client.close()

    def _result(self, future: Any, watch: Watch) -> Any:
        """Wait for what one item gives."""
        from distributed import KilledWorker, wait

        while not future.done():
            try:
                wait([future], timeout=LOOK_UP_S)
            except TimeoutError:
                watch.check()
        try:
            return future.result()
        except KilledWorker as error:
            msg = f"{watch.message}: the workers that did it died {RETRIES} times; see their logs"
            raise OSError(msg) from error
