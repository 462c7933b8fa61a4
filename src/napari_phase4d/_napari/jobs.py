"""Work in threads: jobs with progress and cancel; questions of which the newest counts."""

from __future__ import annotations

import atexit
import os
import sys
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from napari.qt.threading import FunctionWorker, create_worker
from psygnal import EmitLoopError
from qtpy.QtCore import QObject, Qt, QThreadPool, QTimer, Signal
from qtpy.QtWidgets import QWidget

from napari_phase4d._napari.session import Changed, Plan
from napari_phase4d._napari.turns import Steps, Turns, exhaust
from napari_phase4d.task import Cancelled, Task
from napari_phase4d.warned import hearing

__all__ = ["Ended", "Hooks", "Jobs", "Latest", "TimeLeft", "in_words", "sentence_of"]

TELL_EVERY_MS = 100
#: While results come up on screen.
LOOK_AGAIN_MS = 10
#: Work that was told to stop gets so long at the end of the program, and the look whether it is
#: over a little more.
LONGEST_END_S, LONGEST_END_MS = 2.5, 3000
#: Seconds between two looks at whether anybody still waits for work.
LOOK_WHO_WAITS_S = 0.1
#: Of work in threads; the window's thread has 0.
NICENESS = 7


@dataclass
class Ended:
    """How a piece of work ended: with a result or with an error; what it warned of so far."""

    result: Any = None
    error: Exception | None = None
    heard: list[str] = field(default_factory=list)

    def do(self, work: Callable[[Task], Any], task: Task) -> None:
        """Do the work, and keep what comes of it.

        The worker's own signal for errors fails on PySide6.
        """
        try:
            with hearing(self.heard):
                self.result = work(task)
        except Exception as error:
            self.error = error
        except BaseException as error:  # as SystemExit, of which nobody would hear in a thread
            msg = f"the work gave up with {error!r} before it was done; the log may say why"
            self.error = RuntimeError(msg)


class Gate:
    """Whether results are still wanted; it outlives the Qt object that it belongs to."""

    def __init__(self) -> None:
        self.closed = False
        self.stop = threading.Event()

    def shut(self, *_: object) -> None:
        """Stop the work, and take no result any more."""
        self.closed = True
        self.stop.set()


class Jobs(QObject):  # type: ignore[misc]
    """Runs one piece of work at a time, outside the window's thread.

    Parameters
    ----------
    parent : QObject, optional
        What it goes with.
    turns : Turns, optional
        In which results come up on screen; a job has ended only after that.

    Signals
    -------
    started(str), progressed(int, int, str), finished(str), cancelled(str, bool), failed(str)
        What the job is called, how far it is, how it ended. At `finished` the result has already
        been received; `cancelled` says whether parts of it have.
    idle(str)
        Nothing runs any more; the title of the work that gives way which failed, or "".
    warned(Plan, list, bool)
        What work has warned of so far; whether it has ended, and that is all.
    """

    started = Signal(str)
    progressed = Signal(int, int, str)
    finished = Signal(str)
    cancelled = Signal(str, bool)
    failed = Signal(str)
    idle = Signal(str)
    warned = Signal(object, list, bool)

    def __init__(self, parent: QObject | None = None, turns: Turns | None = None) -> None:
        super().__init__(parent)
        self._turns = Turns() if turns is None else turns
        #: What the user has pressed, while that is heeded, and what was pressed for the job; what
        #: is wrong is said beside it.
        self.asked_by: QWidget | None = None
        self.job_asked_by: QWidget | None = None
        #: What is left of taking a result into the session.
        self._steps: Steps | None = None
        #: Of the work that is under way.
        self._ended: Ended | None = None
        self._then: Callable[[], None] | None = None
        self._latest: tuple[int, int, str] | None = None
        self._told = 0
        # The window is told now and then: painting at every step would hold up the work.
        self._look = QTimer(self)
        self._look.setInterval(TELL_EVERY_MS)
        self._look.timeout.connect(self._tell)
        self._gate = Gate()
        GATES.add(self._gate)
        self.destroyed.connect(self._gate.shut)
        self._plan: Plan | None = None

    @property
    def _gives_way(self) -> bool:
        return self._plan is not None and self._plan.gives_way

    @property
    def running(self) -> bool:
        """Whether a job is under way that the user waits for."""
        return self._ended is not None and not self._gives_way

    @property
    def closed(self) -> bool:
        """Whether the window has closed, so that nothing is taken any more."""
        return self._gate.closed

    @property
    def busy(self) -> bool:
        """Whether anything is under way, seen or unseen."""
        return self._ended is not None

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
        self._gate.stop.set()  # what gives way ends now; its result is dropped
        stop = self._gate.stop = threading.Event()

        def report(done: int, total: int, message: str) -> None:
            if plan.gives_way:
                return
            self._latest = (done, total, message)

        ended = Ended()

        work = partial(ended.do, plan.work, Task(report, stop.is_set))
        gate = self._gate
        self._ended, self._plan, self._then = ended, plan, then
        self._latest, self._told = None, 0
        if not plan.gives_way:
            self.job_asked_by = self.asked_by
            self.started.emit(plan.title)
            self._look.start()
        start_worker(work, gate, lambda: self._returned(ended, plan))

    def cancel(self) -> None:
        """Ask the job to stop; it does so at its next step."""
        self._gate.stop.set()
        if self._plan is not None and not self._plan.cancellable and self._ended is not None:
            self._ended = None
            self.cancelled.emit(self._plan.title, False)
            self.idle.emit("")

    def close(self) -> None:
        """Stop what is running and take no result any more: the window closes.

        A result of which a part is taken is taken whole.
        """
        steps, self._steps = self._steps, None
        if steps is not None:
            with suppress(Exception):  # the viewer may be gone already
                exhaust(steps)
        self._gate.shut()
        self._ended = None

    def _tell(self) -> None:
        """Tell how far the work is, if it has gone on."""
        if not self.running:
            self._look.stop()
        latest, self._latest = self._latest, None
        if latest is not None and self.running:
            self.progressed.emit(*latest)
        heard = [] if self._ended is None else self._ended.heard[:]
        if self._plan is not None and self._told < len(heard):
            self._told = len(heard)
            self.warned.emit(self._plan, heard, False)
        # One that is still coming up is not held up by the next.
        if self.running and self._plan is not None and not self._turns.pending:
            self._take_part(self._plan)

    def _returned(self, ended: Ended, plan: Plan) -> None:
        if ended is not self._ended:
            return
        # One part a turn, so that the window goes on.
        if self._turns.pending or (ended.error is None and self._take_part(plan)):
            self._after_a_turn(partial(self._returned, ended, plan))
            return
        stopped = isinstance(ended.error, Cancelled) or self._gate.stop.is_set()
        # A result that arrives after Cancel is not wanted any more, but finished parts are.
        has_parts = plan.keeps_parts and ended.error is None
        if not stopped or has_parts:
            then = None if stopped else self._then
            self._receive(ended, plan, receiving(plan, ended, then), stopped, has_parts)
        else:
            self._shown(ended, plan, stopped=stopped, has_parts=has_parts)

    def _receive(
        self, ended: Ended, plan: Plan, steps: Steps, stopped: bool, has_parts: bool
    ) -> None:
        """Take a result into the session, a step a turn, each once the last one is on screen."""
        if ended is not self._ended:  # something has begun meanwhile
            return
        self._steps = steps
        try:
            with self._turns.unhurried():
                if not self._turns.pending:
                    next(steps)
        except StopIteration:
            self._steps = None
            self._shown(ended, plan, stopped=stopped, has_parts=has_parts)
        except Exception as error:
            self._steps = None
            self._failed(ended, plan, error)
        else:
            again = partial(self._receive, ended, plan, steps, stopped, has_parts)
            self._after_a_turn(again)

    def _shown(self, ended: Ended, plan: Plan, *, stopped: bool, has_parts: bool) -> None:
        """End a job once all that came of it is on screen."""
        if ended is not self._ended:  # something has begun meanwhile
            return
        if self._turns.pending:
            again = partial(self._shown, ended, plan, stopped=stopped, has_parts=has_parts)
            self._after_a_turn(again)
            return
        self._ended = self._plan = self._then = None
        if not stopped or has_parts:
            self.warned.emit(plan, ended.heard, True)
        if not plan.gives_way:
            if stopped:
                self.cancelled.emit(plan.title, has_parts)
            else:
                self.finished.emit(plan.title)
        self.idle.emit("")

    def _after_a_turn(self, go_on: Callable[[], None]) -> None:
        """Go on in a later turn of the event loop, unless the window closes."""
        gate = self._gate
        wait_ms = LOOK_AGAIN_MS if self._turns.pending else 0
        QTimer.singleShot(wait_ms, lambda: None if gate.closed else go_on())

    def _take_part(self, plan: Plan) -> bool:
        """Take one finished part of a plan into the session; return whether there was one.

        One that can't be shown on the way must not hold up the whole, which says what is wrong.
        """
        try:
            with self._turns.unhurried():
                return plan.next_part()
        except Exception:
            return True

    def _failed(self, ended: Ended, plan: Plan, error: Exception) -> None:
        if ended is self._ended:
            self._ended = self._plan = self._then = None
            if not plan.gives_way:
                self.failed.emit(sentence_of(error))
            # What has changed meanwhile can be tried again; a real error can't.
            again = isinstance(error, Changed) or not plan.gives_way
            self.idle.emit("" if again else plan.title)


def start_worker(work: Callable[[], None], gate: Gate, then: Callable[[], None]) -> None:
    """Start work in a worker of napari, which asks before it closes while one is under way.

    Parameters
    ----------
    work : callable
        What to do in a thread.
    gate : Gate
        Whether anybody waits for it.
    then : callable
        Called in the window's thread when it is done, unless the window has closed.
    """
    hooks, box = Hooks(), [work]

    def do() -> None:
        with hooks.kept():
            giving_way(box.pop(), gate)

    def ended(_: object) -> None:
        # napari keeps its workers for good; they must keep neither work nor results.
        worker.returned.disconnect()
        if not gate.closed:
            then()

    worker = create_worker(do, _start_thread=False, _ignore_errors=True)
    hooks.follow(worker)
    worker.returned.connect(ended)
    worker.start()


class Hooks:
    """Python's hook and filters for warnings, as they are without napari's worker.

    A worker replaces both for all threads while it works, and nobody listens to what it hears;
    then it puts back what it found, although that may be another worker's, or something new may
    have come meanwhile. Here they stay as they are, but for moments.
    """

    def __init__(self) -> None:
        self._note()

    def follow(self, worker: FunctionWorker) -> None:
        """Put back what a worker is about to replace, and what it changes at its end."""
        at_once = Qt.ConnectionType.DirectConnection  # in its own thread
        worker.started.connect(self._note, at_once)
        worker.finished.connect(self._put_back, at_once)

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep them while the worker works."""
        self._put_back()
        try:
            yield
        finally:
            self._note()

    def _note(self) -> None:
        self._hook, self._filters = warnings.showwarning, list(warnings.filters)

    def _put_back(self) -> None:
        if warnings.showwarning is not self._hook:
            warnings.showwarning = self._hook
        if list(warnings.filters) != self._filters:
            warnings.filters[:] = self._filters  # type: ignore[index]


def giving_way(work: Callable[[], None], gate: Gate) -> None:
    """Do work in a thread that waits, as do those that it starts, where the window has to do.

    On two cores, two threads of work make the window's own take twice its time. Only Linux tells
    the threads of a program apart here. Qt's threads are lent to other plugins too, and nobody
    may take the waiting back: so it is a thread of its own, for which Qt's waits. Where there can
    be none, Qt's does the work, and does not give way.

    Nobody waits for ever: work that does not stop soon after its window has closed is left to
    itself, and ends with the program, which would neither end nor do so without a crash else.
    """

    def nicely() -> None:
        if sys.platform == "linux":
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        work()

    thread = threading.Thread(target=nicely, name="Phase 4D", daemon=True)
    try:
        thread.start()
    except RuntimeError:  # the system has no more threads
        work()
        return
    while thread.is_alive() and not gate.closed:
        thread.join(LOOK_WHO_WAITS_S)
    thread.join(LONGEST_END_S)


#: Of all windows, for the end of the program.
GATES: weakref.WeakSet[Gate] = weakref.WeakSet()


@atexit.register
def end_all_work() -> None:
    """Stop what still runs when a script ends without closing its window; Qt would abort else."""
    for gate in GATES:
        gate.shut()
    pool = QThreadPool.globalInstance()
    if pool is not None:
        pool.waitForDone(LONGEST_END_MS)


def sentence_of(error: BaseException) -> str:
    """Return what an error says, without the report that a signal's callback wraps round it."""
    while isinstance(error, EmitLoopError) and error.__cause__ is not None:
        error = error.__cause__
    return str(error) or type(error).__name__


def receiving(plan: Plan, ended: Ended, then: Callable[[], None] | None) -> Steps:
    """Take what came of a plan into the session, and go on from there."""
    if ended.error is not None:
        raise ended.error
    result, ended.result = ended.result, None
    yield from plan.receive(result) or ()
    if then is not None:
        then()


#: Nothing is said before so many seconds, when too little is known.
TOO_EARLY_S = 1.5


class TimeLeft:
    """Guesses the seconds left of one stretch of work; a new message begins a new stretch.

    Parameters
    ----------
    clock : callable, optional
        Gives the time in seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._message = ""
        self._began = 0.0
        self._first = 0

    def seconds(self, done: int, total: int, message: str) -> float | None:
        """Return the seconds left, None while they can't be told."""
        now = self._clock()
        if message != self._message or done < self._first:
            self._message, self._began, self._first = message, now, done
        elapsed, steps = now - self._began, done - self._first
        if elapsed < TOO_EARLY_S or steps < 1 or total <= done:
            return None
        return elapsed / steps * (total - done)


def in_words(seconds: float | None) -> str:
    """Return a time left as it is said on screen; "" where it is not known."""
    if seconds is None:
        return ""
    if seconds < 60:
        return f", about {max(1, round(seconds))} s left"
    return f", about {round(seconds / 60)} min left"


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

        work = partial(ended.do, question.work, Task(None, stop.is_set))
        start_worker(work, gate, lambda: self._ended(question, stop, ended))

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
