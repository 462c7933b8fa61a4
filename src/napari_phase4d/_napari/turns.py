"""What is shown comes up in small steps, so that the window never stands still for long."""

from __future__ import annotations

import gc
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from qtpy.QtCore import QCoreApplication, QObject, QTimer
from qtpy.QtGui import QCursor
from qtpy.QtOpenGLWidgets import QOpenGLWidget
from qtpy.QtWidgets import QApplication, QMainWindow, QWidget

__all__ = [
    "UNSEEN",
    "Afterwards",
    "Canvas",
    "Collecting",
    "Steps",
    "Turns",
    "WhenIdle",
    "exhaust",
]

#: Each step is what is done until the next ``yield``.
Steps = Iterator[Any]
#: Yielded after a step of which nothing need be painted before the next one.
UNSEEN = True
#: So long the window has after each step, to paint and to hear of the mouse.
PAUSE_MS = 1
#: Objects that Python has looked through once at most; the others it leaves for later.
NEW = 1
#: A picture is painted after so long, or as soon as what is asked for has been done.
PAINTED_MS = 10
#: Nobody uses the window who has not touched it for so long.
IDLE_MS = 2000


class Turns:
    """Does pieces of work at once, or, where it is `unhurried`, a step a turn of the event loop.

    A script gets what it asked for before it goes on; in the window, each step is painted before
    the next is done. Pieces are done in the order in which they came.
    """

    def __init__(self) -> None:
        #: Told what fails in a turn; where nobody is, it is raised there.
        self.failed: Callable[[Exception], object] | None = None
        self._waiting: deque[Steps] = deque()
        #: Where what steps do is painted; None: wherever Qt likes to.
        self.canvas: Canvas | None = None
        self._unhurried = self._stepping = False
        #: Whether the last step has changed nothing that is to be painted by itself.
        self._unseen = False
        #: Whether the canvas is being painted.
        self._painting = False
        #: While Python looks for no garbage, until all is done or nobody has the turns any more.
        self._put_off: weakref.finalize[..., Turns] | None = None
        self._timer: QTimer | None = None

    @property
    def pending(self) -> bool:
        """Whether there are steps still to do."""
        return bool(self._waiting)

    @contextmanager
    def unhurried(self) -> Iterator[None]:
        """Let what is asked for meanwhile be done a step a turn."""
        before, self._unhurried = self._unhurried, True
        try:
            yield
        finally:
            self._unhurried = before

    def run(self, steps: Steps) -> None:
        """Do a piece of work: at once, after all that waits, or a step a turn."""
        if self._stepping:  # as part of a step
            exhaust(steps)
        elif self._unhurried and QCoreApplication.instance() is not None:
            self._waiting.append(steps)
            self._wait()
        else:
            self.finish()
            exhaust(steps)

    def finish(self) -> None:
        """Do at once all that waits; what fails of it is no fault of who asks."""
        while self._waiting and not self._stepping:
            try:
                self._step()
            except Exception as error:
                if self.failed is None:
                    raise
                self.failed(error)
        if not self._waiting:
            self._paint()
            self._collect_again()

    def stop(self) -> None:
        """Do nothing of what waits."""
        self._waiting.clear()
        if self._timer is not None:
            self._timer.stop()
        self._paint()
        self._collect_again()

    def _paint(self) -> bool:
        """Let the canvas be painted; return whether it was held back."""
        return self.canvas is not None and self.canvas.release()

    def _wait(self) -> None:
        # A search for garbage in the midst of a step, or of what is painted, doubles its time.
        if self._put_off is None and gc.isenabled():
            self._put_off = weakref.finalize(self, gc.enable)
            gc.disable()
        if self._timer is None:
            self._timer = QTimer()
            self._timer.setSingleShot(True)
            self._timer.setInterval(PAUSE_MS)
            self._timer.timeout.connect(self._turn)
        self._timer.start()

    def _turn(self) -> None:
        if self._painting or (not self._unseen and self._paint()):
            # Painting has a turn of its own, after which the timer may have come due already.
            self._painting = not self._painting
            if self._painting or self._waiting:
                self._wait()
            else:
                self._collect_again()
            return
        try:
            if self._waiting:
                if self.canvas is not None:
                    self.canvas.hold()
                self._step()
        except Exception as error:
            if self.failed is None:
                raise
            self.failed(error)
        finally:
            if self._waiting or (self.canvas is not None and self.canvas.held):
                self._wait()
            else:
                self._collect_again()

    def _collect_again(self) -> None:
        if self._put_off is not None:
            self._put_off()
            self._put_off = None
            gc.collect(NEW)  # here, in a turn of its own, and not in the midst of what comes next

    def _step(self) -> None:
        """Do the next step; of work that fails the rest is left out."""
        steps, self._stepping = self._waiting[0], True
        self._unseen = False
        try:
            self._unseen = bool(next(steps))
        except BaseException as error:
            if self._waiting and self._waiting[0] is steps:  # it may have been stopped
                self._waiting.popleft()
            if not isinstance(error, StopIteration):
                raise
        finally:
            self._stepping = False


class Canvas:
    """The canvas beside a dock, which is painted in other turns than what changes it.

    Qt paints before it hears of the mouse again, so that a step and its picture would be one wait.

    Parameters
    ----------
    dock : QWidget
        In the same window, or floating before it.
    """

    def __init__(self, dock: QWidget) -> None:
        self._dock = dock
        self._held: list[QWidget] = []

    @property
    def held(self) -> bool:
        """Whether anything is held back."""
        return bool(self._held)

    def hold(self) -> None:
        """Paint nothing new until `release`."""
        if self._held:
            return
        with suppress(RuntimeError):  # the window has gone
            painted = self._window().findChildren(QOpenGLWidget)
            self._held = [widget for widget in painted if widget.updatesEnabled()]
            for widget in self._held:
                widget.setUpdatesEnabled(False)

    def widget(self) -> QWidget | None:
        """Return napari's canvas, None where the dock stands in no window of napari's."""
        with suppress(RuntimeError):
            window = self._window()
            if isinstance(window, QMainWindow) and window.centralWidget() is not None:
                return window.centralWidget().findChild(QOpenGLWidget)
        return None

    def _window(self) -> QWidget:
        window = self._dock
        while window.parentWidget() is not None:
            window = window.parentWidget()
        return window

    def release(self) -> bool:
        """Paint what is new; return whether it was held back."""
        held, self._held = self._held, []
        for widget in held:
            with suppress(RuntimeError):  # it has gone with its window
                widget.setUpdatesEnabled(True)
        return bool(held)


def exhaust(steps: Steps) -> None:
    """Do all steps."""
    for _ in steps:
        pass


class Afterwards:
    """Does something once the window has painted, however often it is asked for until then.

    Parameters
    ----------
    action : callable
        What to do.
    parent : QObject
        What it ends with.
    """

    def __init__(self, action: Callable[[], object], parent: QObject) -> None:
        self._action = action
        self._timer = QTimer(parent)
        self._timer.setSingleShot(True)
        self._timer.setInterval(PAINTED_MS)
        self._timer.timeout.connect(self._due)
        self._ready = False

    @property
    def pending(self) -> bool:
        """Whether it was asked for and has not been done."""
        return bool(self._timer.isActive())

    def __call__(self) -> None:
        """Ask for it."""
        if not self._timer.isActive():
            self._ready = False
            self._timer.start()

    def stop(self) -> None:
        """Do nothing that was asked for."""
        self._timer.stop()

    def _due(self) -> None:
        if self._ready:
            self._action()
        else:  # it may have come due before what was painted meanwhile
            self._ready = True
            self._timer.start()


class WhenIdle:
    """Does something once nobody has touched the window for a while.

    Parameters
    ----------
    action : callable
        What to do.
    touched : callable
        Returns what changes while somebody uses the window: as places of sliders.
    parent : QObject
        What it ends with.
    """

    def __init__(
        self, action: Callable[[], object], touched: Callable[[], object], parent: QObject
    ) -> None:
        self._action, self._touched = action, touched
        self._before: object = None
        self._timer = QTimer(parent)
        self._timer.setSingleShot(True)
        self._timer.setInterval(IDLE_MS)
        self._timer.timeout.connect(self._look)

    def __call__(self) -> None:
        """Ask for it."""
        self._before = self._now()
        self._timer.start()

    def stop(self) -> None:
        """Do nothing that was asked for."""
        self._timer.stop()

    def _now(self) -> object:
        # Not told by an event filter: Python would be called for every event of the program.
        mouse = QCursor.pos()
        held, typed_in = QApplication.mouseButtons(), id(QApplication.focusWidget())
        return mouse.x(), mouse.y(), held, typed_in, self._touched()

    def _look(self) -> None:
        if self._now() == self._before:
            self._action()
        else:
            self()


class Collecting:
    """Lets Python look for garbage among new objects only, so that it takes no third of a second.

    Python looks through all objects whenever there are a quarter more of them, and napari does
    after every layer that is removed. Most are code and tables of libraries, which stay. What
    was there before is looked through again after `end`. Measured with two results shown: 220 ms
    of the window's thread without this, 25 to 50 ms with it.

    New objects are looked through when nobody touches the window, rather than in the midst of
    what the user waits for: after three runs of nine methods that takes a quarter of a second.
    """

    #: So many times longer than Python would it is waited for a quiet moment, and for any other.
    patience, most_patience = 3, 10

    #: How many windows ask for it.
    asked = 0
    #: How often Python looked before.
    thresholds = (0, 0, 0)

    def __init__(self) -> None:
        self._ended = False
        # Where somebody else, as a program that embeds napari, has seen to it, it is theirs.
        self._theirs = Collecting.asked == 0 and gc.get_freeze_count() > 0
        if not self._theirs:
            if Collecting.asked == 0:
                Collecting.thresholds = gc.get_threshold()
                new, young, old = Collecting.thresholds
                gc.set_threshold(new, young, self.most_patience * old)
            Collecting.asked += 1
            gc.freeze()

    def in_quiet(self) -> None:
        """Look for garbage, if there is much that is new."""
        waits = self.patience * Collecting.thresholds[2]
        if not self._theirs and gc.get_count()[2] > waits:
            gc.collect()

    def end(self) -> None:
        """Let everything be looked through again, if no other window asks for this."""
        if self._ended or self._theirs:
            return
        self._ended = True
        Collecting.asked -= 1
        if Collecting.asked == 0:
            gc.unfreeze()
            gc.set_threshold(*Collecting.thresholds)
