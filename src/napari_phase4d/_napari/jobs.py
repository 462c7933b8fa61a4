"""Long work in a thread: progress, cancel, and one place where errors arrive."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from napari.qt.threading import FunctionWorker, create_worker
from psygnal import EmitLoopError
from qtpy.QtCore import QObject, Signal

from napari_phase4d._napari.session import Plan
from napari_phase4d.progress import Cancelled

__all__ = ["Jobs", "sentence_of"]


@dataclass
class Ended:
    """How a piece of work ended: with a result or with an error."""

    result: Any = None
    error: Exception | None = None


class Jobs(QObject):  # type: ignore[misc]
    """Runs one piece of work at a time, outside the window's thread.

    Signals
    -------
    started(str), progressed(int, int, str), finished(str), cancelled(str), failed(str)
        What the job is called, how far it is, how it ended. At `finished` the result has already
        been received.
    idle(str)
        Nothing runs any more; the title of the work that gives way which failed, or "".
    """

    started = Signal(str)
    progressed = Signal(int, int, str)
    finished = Signal(str)
    cancelled = Signal(str)
    failed = Signal(str)
    idle = Signal(str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._worker: FunctionWorker | None = None
        self._then: Callable[[], None] | None = None
        self._closed = False
        self._plan: Plan | None = None
        self._stop = threading.Event()

    @property
    def _gives_way(self) -> bool:
        return self._plan is not None and self._plan.gives_way

    @property
    def running(self) -> bool:
        """Whether a job is under way that the user waits for."""
        return self._worker is not None and not self._gives_way

    @property
    def busy(self) -> bool:
        """Whether anything is under way, seen or unseen."""
        return self._worker is not None

    def start(self, plan: Plan, then: Callable[[], None] | None = None) -> None:
        """Start a plan in a thread.

        Parameters
        ----------
        plan : Plan
            The work.
        then : callable, optional
            What to do in the window once the result has been received.

        Raises
        ------
        ValueError
            If another job is still running.
        """
        if self.running:
            msg = "another job is still running; wait for it or press Cancel"
            raise ValueError(msg)
        self._stop.set()  # what gives way ends now; its result is dropped
        stop = self._stop = threading.Event()

        def report(done: int, total: int, message: str) -> None:
            if plan.gives_way:
                return
            # A signal is the one thing of Qt that may be used from another thread. The window
            # may be gone by now.
            with contextlib.suppress(RuntimeError):
                self.progressed.emit(done, total, message)

        ended = Ended()

        def guarded() -> None:
            # What comes of it is kept here: the worker's own signal for errors fails on PySide6.
            try:
                ended.result = plan.work(progress=report, cancelled=stop.is_set)
            except Exception as error:
                ended.error = error

        worker = create_worker(guarded, _start_thread=False, _ignore_errors=True)
        worker.returned.connect(lambda _: self._returned(worker, plan, ended))
        self._worker, self._plan, self._then = worker, plan, then
        if not plan.gives_way:
            self.started.emit(plan.title)
        worker.start()

    def cancel(self) -> None:
        """Ask the job to stop; it does so at its next step."""
        self._stop.set()
        if self._plan is not None and not self._plan.cancellable and self._worker is not None:
            self._worker = None
            self.cancelled.emit(self._plan.title)

    def close(self) -> None:
        """Stop what is running and take no result any more: the window closes."""
        self._closed = True
        self._stop.set()
        self._worker = None

    def _returned(self, worker: FunctionWorker, plan: Plan, ended: Ended) -> None:
        if worker is not self._worker or self._closed:
            return
        stopped = isinstance(ended.error, Cancelled) or self._stop.is_set()
        # A result that arrives after Cancel is not wanted any more, but finished parts are.
        has_parts = plan.keeps_parts and ended.error is None
        try:
            if not stopped or has_parts:
                if ended.error is not None:
                    raise ended.error
                plan.receive(ended.result)
                if self._then is not None and not stopped:
                    self._then()
        except Exception as error:
            self._failed(worker, plan, error)
            return
        if worker is not self._worker:  # something has begun meanwhile
            return
        self._worker = None
        if not plan.gives_way:
            (self.cancelled if stopped else self.finished).emit(plan.title)
        self.idle.emit("")

    def _failed(self, worker: FunctionWorker, plan: Plan, error: Exception) -> None:
        if worker is self._worker:
            self._worker = None
            if not plan.gives_way:
                self.failed.emit(sentence_of(error))
            self.idle.emit(plan.title if plan.gives_way else "")


def sentence_of(error: BaseException) -> str:
    """Return what an error says, without the report that a signal's callback wraps round it."""
    while isinstance(error, EmitLoopError) and error.__cause__ is not None:
        error = error.__cause__
    return str(error) or type(error).__name__
