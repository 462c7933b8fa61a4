"""The Fourier spectrum with the views as circles that mouse and keys move and resize."""

from __future__ import annotations

from qtpy.QtCore import QEvent, QPointF, QRectF, Qt, Signal
from qtpy.QtGui import QFocusEvent, QKeyEvent, QMouseEvent, QPainter, QPen
from qtpy.QtWidgets import QApplication, QWidget

from napari_phase4d._napari.widgets.holds import Hold, dragged, grown, hold_at, nudged
from napari_phase4d._napari.widgets.plane_view import PlaneView
from napari_phase4d._napari.widgets.spectrum_marks import VIEW_COLORS, paint_marks
from napari_phase4d.holography import Lobe

__all__ = ["VIEW_COLORS", "SpectrumCanvas"]

#: A click this near to a circle's line takes the line, in screen pixels.
GRIP = 7
#: One press of an arrow key moves by this, in cycles per pixel, without and with Shift.
NUDGE, BIG_NUDGE = 0.001, 0.01
#: One press of + or - changes the radius by this factor.
GROWTH = 1.02
ARROWS = {
    Qt.Key.Key_Left: (0, -1),
    Qt.Key.Key_Right: (0, 1),
    Qt.Key.Key_Up: (-1, 0),
    Qt.Key.Key_Down: (1, 0),
}
GROWTHS = {Qt.Key.Key_Plus: GROWTH, Qt.Key.Key_Equal: GROWTH, Qt.Key.Key_Minus: 1 / GROWTH}
REMOVALS = (Qt.Key.Key_Delete, Qt.Key.Key_Backspace)
#: With one of these, a key is a short cut of the window.
COMMANDS = (
    Qt.KeyboardModifier.ControlModifier
    | Qt.KeyboardModifier.AltModifier
    | Qt.KeyboardModifier.MetaModifier
)
CURSORS = {"move": Qt.CursorShape.SizeAllCursor, "resize": Qt.CursorShape.SizeFDiagCursor}


class SpectrumCanvas(PlaneView):
    """The spectrum with one circle a view.

    Drag a circle to move it, its line to resize it; double click to ask for one more. Dashed
    circles are the conjugates, dotted ones the zero order and the beats. A circle that has been
    clicked, or chosen by its number, takes the arrow keys (with Shift ten times as far), + and -,
    and Delete. The key 0 and a double click with the middle button show the whole plane.

    Signals
    -------
    lobes_edited(list)
        The lobes while one is being moved or resized.
    edit_started()
        Before each drag and each key that moves or resizes, for one step of undo.
    selected(int)
        The chosen view, counted from 0, or -1 for none.
    removal_wanted(int)
        The view that the user wants removed.
    place_wanted(float, float)
        (ky, kx) where the user wants one more view.
    frequency_shown(float, float)
        (ky, kx) under the mouse, in cycles per pixel.
    """

    lobes_edited = Signal(list)
    edit_started = Signal()
    selected = Signal(int)
    removal_wanted = Signal(int)
    place_wanted = Signal(float, float)
    frequency_shown = Signal(float, float)
    left = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("spectrum_canvas")
        self.setAccessibleName("Fourier spectrum with one circle a view")
        self.setAccessibleDescription(
            "A number chooses a circle, arrow keys move it, + and - resize it, Delete removes it."
        )
        self.setMouseTracking(True)
        self._lobes: list[Lobe] = []
        self._chosen = -1
        self._held: Hold | None = None
        self._editing = False
        self._pressed: QPointF | None = None
        self._panned_to: QPointF | None = None

    @property
    def lobes(self) -> list[Lobe]:
        """The views as drawn."""
        return list(self._lobes)

    @property
    def chosen(self) -> int:
        """The chosen view, counted from 0, or -1 for none."""
        return self._chosen

    def set_lobes(self, lobes: list[Lobe]) -> None:
        """Draw these views."""
        self._lobes = list(lobes)
        if self._held is not None and self._held.index >= len(self._lobes):
            self._held = None
        if self._chosen >= len(self._lobes):
            self.select(-1)
        self.viewport().update()

    def select(self, index: int) -> None:
        """Choose a view, counted from 0; any other number chooses none."""
        index = index if 0 <= index < len(self._lobes) else -1
        if index != self._chosen:
            self._chosen = index
            self.viewport().update()
            self.selected.emit(index)

    def drawForeground(self, painter: QPainter | None, rect: QRectF) -> None:  # noqa: N802
        """Draw the circles and, with the focus, a frame."""
        if painter is None:
            return
        painter.save()
        painter.resetTransform()
        if self.has_spectrum or self._lobes:
            paint_marks(painter, self.plane, self._lobes, self._chosen)
        else:
            painter.setPen(Qt.GlobalColor.gray)
            middle = Qt.AlignmentFlag.AlignCenter
            painter.drawText(self.viewport().rect(), middle, "The spectrum appears here.")
        if self.hasFocus():
            painter.setPen(QPen(self.palette().highlight().color(), 2))
            painter.drawRect(self.viewport().rect().adjusted(1, 1, -1, -1))
        painter.restore()

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802 - Qt's name
        """Take hold of a circle, of its line, or of the picture."""
        if event.button() != Qt.MouseButton.LeftButton:
            event.ignore()
            return
        self._held = self._under(event.position())
        if self._held is None:
            self._pressed = self._panned_to = event.position()
            return
        self.select(self._held.index)
        self._start_edit()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Move or resize what is held, and tell the frequency under the mouse."""
        position = event.position()
        self.frequency_shown.emit(*self.plane.frequency(position))
        if self._held is not None:
            held, lobe = self._held, self._lobes[self._held.index]
            self._change(held.index, dragged(lobe, held, self.plane.frequency(position)))
        elif self._panned_to is not None:
            self.pan_by(position - self._panned_to)
            self._panned_to = position
        else:
            under = self._under(position)
            arrow = Qt.CursorShape.ArrowCursor
            self.viewport().setCursor(arrow if under is None else CURSORS[under.action])

    def leaveEvent(self, event: QEvent | None) -> None:  # noqa: N802
        """Tell that no frequency is under the mouse any more."""
        super().leaveEvent(event)
        self.left.emit()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Let go; a click beside all circles chooses none."""
        if event.button() != Qt.MouseButton.LeftButton:
            event.ignore()
            return
        if self._pressed is not None:
            way = (event.position() - self._pressed).manhattanLength()
            if way < QApplication.startDragDistance():
                self.select(-1)
        self._held = self._pressed = self._panned_to = None
        self._editing = False

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Ask for one more view, or show the whole plane (middle button)."""
        if event.button() == Qt.MouseButton.MiddleButton:
            self.reset_view()
        elif self._under(event.position()) is not None:
            self.mousePressEvent(event)
        elif event.button() == Qt.MouseButton.LeftButton:
            ky, kx = self.plane.frequency(event.position())
            if max(abs(ky), abs(kx)) <= 0.5:
                self.place_wanted.emit(ky, kx)

    def event(self, event: QEvent | None) -> bool:
        """Keep our keys from the short cuts of the window."""
        if (
            isinstance(event, QKeyEvent)
            and event.type() == QEvent.Type.ShortcutOverride
            and self._takes(event)
        ):
            event.accept()
            return True
        return bool(super().event(event))

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Choose, move, resize or remove a view, or show the whole plane."""
        if not self._takes(event):
            event.ignore()
            return
        key = Qt.Key(event.key())
        if key == Qt.Key.Key_0:
            self.reset_view()
        elif key in ARROWS:
            shift = event.modifiers() & Qt.KeyboardModifier.ShiftModifier
            ky, kx = (way * (BIG_NUDGE if shift else NUDGE) for way in ARROWS[key])
            self._edit_once(nudged(self._lobes[self._chosen], ky, kx))
        elif key in GROWTHS:
            self._edit_once(grown(self._lobes[self._chosen], GROWTHS[key]))
        elif key in REMOVALS:
            self.removal_wanted.emit(self._chosen)
        else:
            self.select(number_of(key) - 1)

    def focusInEvent(self, event: QFocusEvent | None) -> None:  # noqa: N802
        """Show the frame of the focus."""
        super().focusInEvent(event)
        self.viewport().update()

    def focusOutEvent(self, event: QFocusEvent | None) -> None:  # noqa: N802
        """Take the frame of the focus away."""
        super().focusOutEvent(event)
        self.viewport().update()

    def _takes(self, event: QKeyEvent) -> bool:
        """Say whether a key does something here and now."""
        if event.modifiers() & COMMANDS:
            return False
        key = event.key()
        if key in ARROWS or key in GROWTHS or key in REMOVALS:
            return self._chosen >= 0
        return key == Qt.Key.Key_0 or 1 <= number_of(key) <= len(self._lobes)

    def _edit_once(self, lobe: Lobe) -> None:
        """Change the chosen view as one step of undo."""
        self._start_edit()
        self._change(self._chosen, lobe)
        self._editing = False

    def _change(self, index: int, lobe: Lobe) -> None:
        self._lobes[index] = lobe
        self.viewport().update()
        self.lobes_edited.emit(self.lobes)

    def _start_edit(self) -> None:
        if not self._editing:
            self._editing = True
            self.edit_started.emit()

    def _under(self, position: QPointF) -> Hold | None:
        """Return what a drag from a point of the viewport would hold."""
        plane = self.plane
        grip = GRIP / plane.scale
        return hold_at(self._lobes, plane.frequency(position), grip, self._chosen)


def number_of(key: int) -> int:
    """Return the number on a key, or a number below 0 or above 9 if there is none."""
    return int(key) - int(Qt.Key.Key_0)
