"""Watching a window: how long it stands still, and when a widget is painted."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from qtpy.QtCore import QEvent, QEventLoop, QObject, Qt, QTimer
from qtpy.QtWidgets import QApplication, QWidget

TICK_MS = 5
PATIENCE_S = 120.0


class Pulse:
    """A timer of 5 ms in the window's thread; where a beat is late, the window stood still."""

    def __init__(self) -> None:
        #: When each beat was, and how long the window's thread had computed until then.
        self._beats: list[tuple[float, float]] = []
        self._timer = QTimer()
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(
            lambda: self._beats.append((time.perf_counter(), time.thread_time()))
        )
        self._timer.start(TICK_MS)

    def longest_stall(self, began: float, ended: float) -> float:
        """Return the longest time without a beat between two moments, less a tick, in ms."""
        beats = [began, *(beat for beat, _ in self._beats if began < beat < ended), ended]
        return max(0.0, 1000 * float(np.diff(beats).max()) - TICK_MS)

    def longest_work(self, began: float, ended: float) -> float:
        """Return the most that the window's thread has computed from beat to beat, in ms.

        Unlike the stall, it does not tell of other programs on the machine, nor of what OpenGL
        draws in threads of its own.
        """
        worked = [cpu for beat, cpu in self._beats if began < beat < ended]
        return 1000 * float(np.diff(worked).max()) if len(worked) > 1 else 0.0


class Painted(QObject):
    """Counts how often a widget is painted."""

    def __init__(self, widget: QWidget) -> None:
        super().__init__()
        self.count = 0
        self._widget = widget
        QApplication.instance().installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:  # noqa: N802
        """Count, and let the event pass."""
        if watched is self._widget and event is not None and event.type() == QEvent.Type.Paint:
            self.count += 1
        return False

    def next_after(self, action: Callable[[], object]) -> float:
        """Do something and return the ms until the widget has been painted for the next time."""
        before, began = self.count, time.perf_counter()
        action()
        while self.count == before:
            QApplication.processEvents()
            if time.perf_counter() - began > PATIENCE_S:
                msg = f"nothing was painted within {PATIENCE_S:g} s"
                raise RuntimeError(msg)
        return 1000 * (time.perf_counter() - began)

    def stop(self) -> None:
        QApplication.instance().removeEventFilter(self)


def let_work(until: Callable[[], bool]) -> None:
    """Let the event loop run, undisturbed, until something has happened."""
    loop, look = QEventLoop(), QTimer()
    end = time.monotonic() + PATIENCE_S
    look.timeout.connect(lambda: loop.quit() if until() or time.monotonic() > end else None)
    look.start(20)
    loop.exec()
    look.stop()
    if not until():
        msg = f"the window took longer than {PATIENCE_S:g} s"
        raise RuntimeError(msg)


def rest(seconds: float) -> None:
    """Let the event loop run for a while."""
    end = time.monotonic() + seconds
    let_work(lambda: time.monotonic() > end)
