"""A hand on the mouse: real events, filmed while they happen."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from qtpy.QtCore import QEvent, QPoint, QPointF, Qt
from qtpy.QtGui import QMouseEvent
from qtpy.QtWidgets import QApplication, QWidget

from napari_phase4d._napari.demo import wait_until
from picture_making.film import Film

LEFT, NONE = Qt.MouseButton.LeftButton, Qt.MouseButton.NoButton
PLAIN = Qt.KeyboardModifier.NoModifier
#: How long the pictures of a moving pointer are shown, and how many there are of one way.
MOVE_MS, MOVES = 40, 3
PRESS_MS = 100
#: How long the window gets to react before it is filmed.
REACTION_S = 0.15


class Hand:
    """Moves the pointer, clicks and drags.

    Parameters
    ----------
    film : Film
        What films the window.
    """

    def __init__(self, film: Film) -> None:
        self.film = film
        self.window: QWidget = film.viewer.window._qt_window
        self.place = QPointF(self.window.width() * 0.45, self.window.height() * 0.6)

    def click(self, widget: QWidget, point: QPoint | None = None) -> None:
        """Go to a widget and click on it."""
        point = widget.rect().center() if point is None else point
        self.go_to(widget, point)
        self._send(widget, QEvent.Type.MouseButtonPress, point, LEFT)
        self.film.shoot(PRESS_MS, pressed=True)
        self._send(widget, QEvent.Type.MouseButtonRelease, point, NONE)

    def go_to(self, widget: QWidget, point: QPoint, moves: int = MOVES) -> None:
        """Move the pointer to a point of a widget."""
        start = self.place
        end = QPointF(widget.mapTo(self.window, point))
        for n in range(1, moves + 1):
            self._put(start + (end - start) * (n / moves))
            if n < moves:
                self.film.shoot(MOVE_MS)
        self._send(widget, QEvent.Type.MouseMove, point, NONE)
        self.film.shoot(MOVE_MS)

    def drag(
        self,
        widget: QWidget,
        points: list[QPoint],
        each_ms: int,
        settled: Callable[[], bool] = lambda: True,
    ) -> None:
        """Take hold at the first point and drag over the others.

        Parameters
        ----------
        widget : QWidget
            What gets the events.
        points : list of QPoint
            In pixels of the widget.
        each_ms : int
            How long each point is shown.
        settled : callable, optional
            Says whether the window has followed, before it is filmed.
        """
        self.go_to(widget, points[0])
        self._send(widget, QEvent.Type.MouseButtonPress, points[0], LEFT)
        for point in points:
            self._send(widget, QEvent.Type.MouseMove, point, LEFT)
            self._put(QPointF(widget.mapTo(self.window, point)))
            self.wait()
            wait_until(settled)
            self.film.shoot(each_ms, pressed=True)
        self._send(widget, QEvent.Type.MouseButtonRelease, points[-1], NONE)

    def wait(self, seconds: float = REACTION_S) -> None:
        """Let the window react."""
        end = time.monotonic() + seconds
        wait_until(lambda: time.monotonic() > end)

    def _put(self, place: QPointF) -> None:
        self.place = place
        self.film.pointer = round(place.x()), round(place.y())

    def _send(self, widget: QWidget, kind: Any, point: QPoint, pressed: Any) -> None:
        """Send what the mouse would."""
        button = NONE if kind == QEvent.Type.MouseMove else LEFT
        place = QPointF(widget.mapToGlobal(point))
        event = QMouseEvent(kind, QPointF(point), place, button, pressed, PLAIN)
        QApplication.sendEvent(widget, event)
        QApplication.processEvents()
