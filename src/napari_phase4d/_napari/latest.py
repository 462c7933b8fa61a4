"""Small questions that are answered in a thread, of which only the newest counts."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

from napari.qt.threading import create_worker
from qtpy.QtCore import QObject

from napari_phase4d._napari.jobs import GATES, Ended, Gate
from napari_phase4d.task import Task

__all__ = ["Latest"]


@dataclass(frozen=True)
class Question:
    """What is to be found out, and who is told."""

    work: Callable[[Task], Any]
    then: Callable[[Any], None]
    failed: Callable[[Exception], None]
    about: Hashable


class Latest(QObject):  # type: ignore[misc]
    """Answers one question at a time; of those that have come meanwhile, the newest is next.

    What was asked before is stopped, and its answer dropped, unless it is about the same.
    """

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._gate = Gate()
        GATES.add(self._gate)
        self.destroyed.connect(self._gate.shut)
        self._next: Question | None = None
        self._asked: Question | None = None
        self._worker: Any = None

    def ask(
        self,
        work: Callable[[Task], Any],
        then: Callable[[Any], None],
        failed: Callable[[Exception], None],
        about: Hashable,
    ) -> None:
        """Ask a question.

        Parameters
        ----------
        work : callable
            ``work(task)`` returns the answer; done in a thread.
        then, failed : callable
            Told the answer, or the error, in the window's thread.
        about : hashable
            What it is about: a question about the same is not stopped by this one.
        """
        self._next = Question(work, then, failed, about)
        if self._asked is None:
            self._start()
        elif self._asked.about != about:
            self._gate.stop.set()

    def drop(self) -> None:
        """Want no answer any more."""
        self._next = None
        self._gate.stop.set()

    def _start(self) -> None:
        """Begin with the newest question."""
        question, self._next = self._next, None
        if question is None or self._gate.closed:
            return
        self._asked = question
        gate, ended = self._gate, Ended()
        stop = gate.stop = threading.Event()

        def guarded() -> None:
            try:
                ended.result = question.work(Task(None, stop.is_set))
            except Exception as error:
                ended.error = error

        self._worker = create_worker(guarded, _start_thread=False, _ignore_errors=True)
        self._worker.returned.connect(
            lambda _: None if gate.closed else self._ended(question, stop, ended)
        )
        self._worker.start()

    def _ended(self, question: Question, stop: threading.Event, ended: Ended) -> None:
        """Tell the answer if it is still wanted, and go on."""
        self._asked = None
        try:
            if stop.is_set():
                return
            if ended.error is not None:
                question.failed(ended.error)
            else:
                question.then(ended.result)
        finally:
            if self._asked is None:
                self._start()
