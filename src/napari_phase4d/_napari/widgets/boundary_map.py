"""Frames as a map: where to start and the way from there; how far methods agree over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from qtpy.QtCore import QEvent, QPointF, QSize, Qt, Signal
from qtpy.QtGui import (
    QFocusEvent,
    QFont,
    QFontMetricsF,
    QHelpEvent,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
)
from qtpy.QtWidgets import QSizePolicy, QToolTip, QWidget

from napari_phase4d._napari.widgets.map_picture import GAP, Frame, Grid, MapPicture, time_unit
from napari_phase4d.later import xr
from napari_phase4d.unwrapping import ORDERS
from napari_phase4d.words import wavelengths_of_views

__all__ = ["AgreementStrip", "BoundaryMap"]

WIDTH = 360
#: From this height on, in pixels, a screen has room for larger maps.
HIGH_SCREEN = 1000
FONT_POINTS = 8.0
#: The font is this large next to napari's, and never smaller than that.
FONT_SHARE = 0.85
#: A click this far outside the frames still takes the nearest, in pixels.
REACH = 4
#: Ctrl with an arrow key jumps this share of the recording.
JUMP = 0.1
#: Steps of the cursor over (time, angle).
ARROW_KEYS = {
    Qt.Key.Key_Left: (-1, 0),
    Qt.Key.Key_Right: (1, 0),
    Qt.Key.Key_Up: (0, 1),
    Qt.Key.Key_Down: (0, -1),
}
CLICK_KEYS = (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Space, Qt.Key.Key_Select)
TAB_REASONS = (Qt.FocusReason.TabFocusReason, Qt.FocusReason.BacktabFocusReason)


class BoundaryMap(QWidget):  # type: ignore[misc]
    """All frames as a grid: time to the right, one row a viewing angle, the first at the bottom.

    Drawn after Fig. 1 of the paper: the frames to start from are dark squares, the first pass
    of the method is blue, the second red. The star is the safest frame, the white outline the
    frame on screen, the dotted one the frame under the mouse or the keyboard's cursor.

    Signals
    -------
    frame_clicked(int, int, bool)
        (time index, angle index) of a clicked frame, and whether Shift was held. Enter and Space
        click the frame under the cursor.
    frame_hovered(int, int)
        The frame under the mouse, or that the arrow keys have moved to.
    left()
        No frame is pointed at any more.
    """

    frame_clicked = Signal(int, int, bool)
    frame_hovered = Signal(int, int)
    left = Signal()

    #: Height of one viewing angle, and least and most height of all of them, in pixels.
    heights = (16, 48, 88)
    #: How many times higher they are on a screen that has room.
    enlarged = 1.6
    #: What it shows.
    picture_class = MapPicture

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("boundary_map")
        self.setAccessibleName("Map of frames over time and viewing angle")
        self.setAccessibleDescription(
            "The arrow keys move over the frames, Enter starts at one, Shift+Enter adds one."
        )
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setMouseTracking(True)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self._picture = self.picture_class()

    def set_frames_of(self, stack: xr.DataArray) -> None:
        """Show the frames of a stack, by its times, angles and wavelengths; see `set_frames`."""
        lights = wavelengths_of_views(stack)
        self.set_frames(stack["time"].values, stack["angle"].values, lights)

    def set_frames(
        self,
        times_s: ArrayLike,
        angles_deg: ArrayLike,
        wavelengths_um: Sequence[float] | None = None,
    ) -> None:
        """Say which frames there are, and forget the scores and marks of others.

        Parameters
        ----------
        times_s, angles_deg : array_like, 1-D
            Time in seconds and viewing angle in degrees, by index; both empty for no frames.
        wavelengths_um : sequence of float, optional
            Of each view in micrometres, where there are several.

        Raises
        ------
        ValueError
            If there are times but no angles, or the other way round.
        """
        times, angles = (np.ravel(np.asarray(v, dtype=np.float64)) for v in (times_s, angles_deg))
        if bool(times.size) != bool(angles.size):
            msg = f"there are {times.size} times and {angles.size} angles; give both or none"
            raise ValueError(msg)
        self._point_at(None)
        self._picture = self.picture_class(times, angles, wavelengths_um, path=self._picture.path)
        self.updateGeometry()
        self.update()

    def set_scores(self, scores: ArrayLike | None) -> None:
        """Colour the frames.

        Parameters
        ----------
        scores : array_like, shape (time, angle), or None
            0 (unsafe) to 1 (safe); NaN, or None for all, where it is not known (grey).

        Raises
        ------
        ValueError
            If there are not as many scores as frames.
        """
        values = None if scores is None else np.asarray(scores, dtype=np.float32)
        if values is not None and values.shape != self._picture.shape:
            shape = self._picture.shape
            msg = f"scores are {values.shape}, but there are {shape} frames (time, angle)"
            raise ValueError(msg)
        self._picture.scores, self._picture.coloured = values, None
        self.update()

    def set_best(self, frame: Frame | None) -> None:
        """Put the star on the safest frame (time index, angle index)."""
        self._picture.best = None if frame is None else self._picture.known(frame)
        self.update()

    def set_current(self, frame: Frame | None) -> None:
        """Outline the frame on screen (time index, angle index)."""
        self._picture.current = None if frame is None else self._picture.known(frame)
        self.update()

    def set_boundaries(self, frames: Sequence[Frame]) -> None:
        """Mark the frames to start from (time index, angle index); the way leaves the first."""
        self._picture.boundaries = [self._picture.known(frame) for frame in frames]
        self.update()

    def set_path(self, path: str | None) -> None:
        """Draw the way of a method: one of `ORDERS`, or None for no way."""
        if path is not None and path not in ORDERS:
            msg = f"path is {path!r}; it must be one of {', '.join(ORDERS)}"
            raise ValueError(msg)
        self._picture.path = path
        self.update()

    @property
    def pointed(self) -> Frame | None:
        """The frame under the mouse or under the keyboard's cursor."""
        return self._picture.pointed

    def cell_position(self, t: int, a: int) -> QPointF:
        """Return the middle of a frame in pixels of this widget."""
        return QPointF(*self._grid().centre(*self._picture.known((t, a))))

    def sizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        """Return the size at which every viewing angle has a readable row."""
        screen = self.screen()
        has_room = screen is not None and screen.availableGeometry().height() >= HIGH_SCREEN
        row, least, most = (h * (self.enlarged if has_room else 1) for h in self.heights)
        rows = int(np.clip(row * self._picture.shape[1], least, most))
        line = QFontMetricsF(self._font()).height()
        lines = 1 + self._picture.with_times
        return QSize(WIDTH, int(rows + lines * line + 3 * GAP))

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the least size at which it can be read."""
        return QSize(WIDTH // 2, self.sizeHint().height())

    def paintEvent(self, event: QPaintEvent | None) -> None:  # noqa: N802
        """Draw the map."""
        painter = QPainter(self)
        painter.setFont(self._font())
        if self._picture.times_s.size:
            focus = self.hasFocus()
            self._picture.paint(painter, self._grid(), self.palette(), focus=focus)
        else:
            painter.setPen(self.palette().color(self.foregroundRole()))
            painter.drawText(self.rect(), Qt.AlignmentFlag.AlignCenter, "No frames yet.")
        painter.end()

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Click the nearest frame."""
        frame = self._under(event.position())
        if frame is None or event.button() != Qt.MouseButton.LeftButton:
            event.ignore()
            return
        self._point_at(frame)
        self._click(event.modifiers())

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Point at the frame under the mouse."""
        self._point_at(self._under(event.position()))

    def leaveEvent(self, event: QEvent | None) -> None:  # noqa: N802
        """Point at nothing."""
        self._point_at(None)

    def focusInEvent(self, event: QFocusEvent) -> None:  # noqa: N802
        """Show the cursor to who came here by the Tab key."""
        super().focusInEvent(event)
        if event.reason() in TAB_REASONS and self._picture.pointed is None:
            self._point_at(self._start())
        self.update()

    def focusOutEvent(self, event: QFocusEvent) -> None:  # noqa: N802
        """Take the keyboard's cursor away."""
        super().focusOutEvent(event)
        if not self.underMouse():
            self._point_at(None)
        self.update()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Move the cursor, or click the frame under it."""
        start = self._start()
        if start is None or not is_ours(event):
            super().keyPressEvent(event)
        elif event.key() in CLICK_KEYS:
            if self._picture.pointed is None:
                self._point_at(start)
            else:
                self._click(event.modifiers())
        else:
            self._move_cursor(start, event)

    def event(self, event: QEvent) -> bool:
        """Show words on the frame under the mouse, and keep our keys from the window's."""
        kind = event.type()
        if kind == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            frame = self._under(QPointF(event.pos()))
            words = "" if frame is None else self._picture.words_on(frame)
            QToolTip.showText(event.globalPos(), words, self)
            return True
        if kind == QEvent.Type.ShortcutOverride and is_ours(event):
            event.accept()
            return True
        return bool(super().event(event))

    def _font(self) -> QFont:
        font = QFont(self.font())
        font.setPointSizeF(max(FONT_POINTS, FONT_SHARE * font.pointSizeF()))
        return font

    def _grid(self) -> Grid:
        """Return where the frames are: labels at the left and below, the legend above."""
        metrics = QFontMetricsF(self._font())
        labels = (metrics.horizontalAdvance(words) for words in self._picture.labels)
        left = int(max(labels, default=0.0)) + 2 * GAP
        top = int(metrics.height()) + GAP
        width = max(self.width() - left - 2 * GAP, 1)
        below = int(metrics.height()) if self._picture.with_times else 0
        height = max(self.height() - top - below - 2 * GAP, 1)
        return Grid(left, top, width, height, *self._picture.shape)

    def _under(self, position: QPointF) -> Frame | None:
        if not self._picture.times_s.size:
            return None
        return self._grid().nearest(position.x(), position.y(), REACH)

    def _start(self) -> Frame | None:
        """Return where the cursor is, or where it comes up."""
        picture = self._picture
        if not picture.times_s.size:
            return None
        return picture.pointed or picture.current or next(iter(picture.boundaries), (0, 0))

    def _move_cursor(self, start: Frame, event: QKeyEvent) -> None:
        last_time, last_angle = (count - 1 for count in self._picture.shape)
        step_t, step_a = ARROW_KEYS.get(event.key(), (0, 0))
        if event.modifiers() & Qt.KeyboardModifier.ControlModifier:
            step_t *= max(1, round(JUMP * last_time))
        t = {Qt.Key.Key_Home: 0, Qt.Key.Key_End: last_time}.get(event.key(), start[0] + step_t)
        a = start[1] + step_a
        self._point_at((min(max(t, 0), last_time), min(max(a, 0), last_angle)))

    def _point_at(self, frame: Frame | None) -> None:
        if frame == self._picture.pointed:
            return
        self._picture.pointed = frame
        self.update()
        if frame is None:
            self.left.emit()
        else:
            self.frame_hovered.emit(*frame)

    def _click(self, modifiers: Qt.KeyboardModifier) -> None:
        if self._picture.pointed is not None:
            shift = bool(modifiers & Qt.KeyboardModifier.ShiftModifier)
            self.frame_clicked.emit(*self._picture.pointed, shift)


def is_ours(event: QKeyEvent) -> bool:
    """Return whether a key moves the cursor or clicks."""
    others = (Qt.Key.Key_Home, Qt.Key.Key_End)
    return event.key() in (*ARROW_KEYS, *others, *CLICK_KEYS)


@dataclass
class AgreementPicture(MapPicture):
    """Frames in the colours of the share of the object on which all methods agree."""

    with_times: bool = False
    ends: tuple[str, str] = ("methods disagree", "agree")

    def words_on(self, frame: Frame) -> str:
        """Say in words what is shown of a frame."""
        t, a = frame
        factor, unit = time_unit(self.times_s)
        where = f"Time {self.times_s[t] / factor:.4g} {unit} (frame {t})"
        words = f"{where}, {self.view(a)}."
        if self.scores is not None:
            agreement = float(self.scores[t, a])
            if np.isnan(agreement):
                return f"{words}\nThis frame says nothing of the object.\nClick to go there."
            words += f"\nMethods disagree on {100 * (1 - agreement):.3g} % of the object."
        return f"{words}\nClick to go there."


class AgreementStrip(BoundaryMap):
    """Time to the right, one row a viewing angle; dark where methods disagree.

    The colours are those of the map of frames to start from.

    Signals
    -------
    frame_clicked(int, int, bool)
        (time index, angle index) to go to.
    """

    heights = (13, 14, 54)
    enlarged = 1.3
    picture_class = AgreementPicture

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("agreement")
        self.setAccessibleName("Agreement of the methods over time and viewing angle")
        self.setAccessibleDescription("The arrow keys move over the frames, Enter goes to one.")
