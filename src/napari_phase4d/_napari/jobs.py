"""Long work in a thread: progress, cancel, and one place where errors arrive."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from napari.qt.threading import FunctionWorker, create_worker
from qtpy.QtCore import QObject, Signal

from napari_phase4d.progress import Cancelled

__all__ = ["Jobs"]

Work = Callable[..., Any]


class Bridge(QObject):  # type: ignore[misc]
    """Carries progress from the worker's thread to the window's."""

    progressed = Signal(int, int, str)


class Jobs(QObject):  # type: ignore[misc]
    """Runs one piece of work at a time, outside the window's thread.

    Signals
    -------
    started(str), progressed(int, int, str), finished(str), cancelled(str), failed(str)
        What the job is called, how far it is, how it ended. After `finished`, the result has
        already been given to its receiver.
    """

    started = Signal(str)
    progressed = Signal(int, int, str)
    finished = Signal(str)
    cancelled = Signal(str)
    failed = Signal(str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._worker: FunctionWorker | None = None
        self._stop = threading.Event()
        self._bridge: Bridge | None = None

    @property
    def running(self) -> bool:
        """Whether a job is under way."""
        return self._worker is not None

    def start(self, title: str, work: Work, receive: Callable[[Any], None]) -> None:
        """Start work in a thread.

        Parameters
        ----------
        title : str
            What the user sees.
        work : callable
            ``work(progress=..., cancelled=...)``; it must touch no widget and no layer.
        receive : callable
            Gets the result in the window's thread.

        Raises
        ------
        ValueError
            If another job is still running.
        """
        if self.running:
            msg = "another job is still running; wait for it or press Cancel"
            raise ValueError(msg)
        stop = self._stop = threading.Event()
        bridge = self._bridge = Bridge()
        bridge.progressed.connect(self.progressed)

        def report(done: int, total: int, message: str) -> None:
            bridge.progressed.emit(done, total, message)

        def guarded() -> Any:
            try:
                return work(progress=report, cancelled=stop.is_set)
            except Cancelled:
                return Cancelled

        worker = create_worker(guarded, _start_thread=False, _ignore_errors=True)
        worker.returned.connect(lambda result: self._returned(worker, title, result, receive))
        worker.errored.connect(lambda error: self._errored(worker, error))
        self._worker = worker
        self.started.emit(title)
        worker.start()

    def cancel(self) -> None:
        """Ask the job to stop; it does so at its next step."""
        self._stop.set()

    def _returned(
        self, worker: FunctionWorker, title: str, result: Any, receive: Callable[[Any], None]
    ) -> None:
        if worker is not self._worker:
            return
        self._worker = None
        # A result that arrives after Cancel is not wanted any more.
        if result is Cancelled or self._stop.is_set():
            self.cancelled.emit(title)
            return
        try:
            receive(result)
        except (OSError, TypeError, ValueError) as error:
            self.failed.emit(str(error))
            return
        self.finished.emit(title)

    def _errored(self, worker: FunctionWorker, error: Exception) -> None:
        if worker is self._worker:
            self._worker = None
            self.failed.emit(str(error) or type(error).__name__)
