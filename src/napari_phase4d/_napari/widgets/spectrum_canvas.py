"""The Fourier spectrum with the views as circles that mouse and keys move, and as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from qtpy.QtCore import QEvent, QPointF, QRectF, Qt, Signal
from qtpy.QtGui import QColor, QFocusEvent, QKeyEvent, QMouseEvent, QPainter, QPen
from qtpy.QtWidgets import (
    QAbstractItemView,
    QApplication,
    QHeaderView,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from napari_phase4d._napari.widgets.spectrum_picture import VIEW_COLORS, PlaneView, paint_marks
from napari_phase4d.holography import Lobe, angles_unknown

__all__ = ["VIEW_COLORS", "LobeTable", "SpectrumCanvas", "changed_lobe"]

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


#: Circles can't get smaller or larger than this, in cycles per pixel.
RADII = (0.005, 0.5)


@dataclass(frozen=True)
class Hold:
    """What the mouse holds of which view, and where it took it.

    Parameters
    ----------
    index : int
        The view, counted from 0.
    action : str
        "move" or "resize".
    beside : tuple of float
        (ky, kx) from the mouse to the carrier, so that a circle does not jump when it is taken.
    short : float
        How much farther than the mouse the line is from the carrier, for the same reason.
    """

    index: int
    action: str
    beside: tuple[float, float]
    short: float


def hold_at(
    lobes: Sequence[Lobe], frequency: tuple[float, float], grip: float, chosen: int = -1
) -> Hold | None:
    """Return what a drag from a frequency would hold.

    Parameters
    ----------
    lobes : sequence of Lobe
        The views.
    frequency : tuple of float
        (ky, kx) under the mouse, in cycles per pixel.
    grip : float
        How near to its line the mouse takes the line of a circle, in cycles per pixel.
    chosen : int, optional
        The view that comes first where circles overlap; else the nearest does.

    Returns
    -------
    Hold or None
        None beside all circles.
    """
    found: list[tuple[bool, float, Hold]] = []
    for index, lobe in enumerate(lobes):
        beside = (lobe.carrier[0] - frequency[0], lobe.carrier[1] - frequency[1])
        distance = float(np.hypot(*beside))
        on_line = abs(distance - lobe.radius) < min(grip, lobe.radius / 2)
        if on_line or distance < lobe.radius:
            action = "resize" if on_line else "move"
            hold = Hold(index, action, beside, lobe.radius - distance)
            found.append((index != chosen, distance, hold))
    return min(found, key=lambda each: each[:2])[2] if found else None


def dragged(lobe: Lobe, hold: Hold, frequency: tuple[float, float]) -> Lobe:
    """Return the view that is held, with the mouse at a frequency (ky, kx)."""
    ky, kx = frequency
    if hold.action == "move":
        return replace(lobe, carrier=within(ky + hold.beside[0], kx + hold.beside[1]))
    out = float(np.hypot(ky - lobe.carrier[0], kx - lobe.carrier[1]))
    return replace(lobe, radius=float(np.clip(out + hold.short, *RADII)))


def nudged(lobe: Lobe, ky: float, kx: float) -> Lobe:
    """Return a view moved by (ky, kx)."""
    return replace(lobe, carrier=within(lobe.carrier[0] + ky, lobe.carrier[1] + kx))


def grown(lobe: Lobe, factor: float) -> Lobe:
    """Return a view with a larger or smaller circle."""
    return replace(lobe, radius=float(np.clip(lobe.radius * factor, *RADII)))


def within(ky: float, kx: float) -> tuple[float, float]:
    """Return the nearest carrier within the spectrum."""
    return float(np.clip(ky, -0.5, 0.5)), float(np.clip(kx, -0.5, 0.5))


COLUMNS = ("ky (1/px)", "kx (1/px)", "radius", "angle (°)", "λ (nm)", "flip")
LIGHT, FLIP = len(COLUMNS) - 2, len(COLUMNS) - 1


class LobeTable(QTableWidget):  # type: ignore[misc]
    """One row a view; a cell that is typed into gives `typed`.

    Signals
    -------
    typed(int, int, object)
        Row, column and the cell.
    """

    typed = Signal(int, int, object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(0, len(COLUMNS), parent)
        self.setTabKeyNavigation(False)  # Tab leaves the table; arrows go through it
        self._filling = False
        self.setObjectName("lobe_table")
        self.setAccessibleName("Carriers, radii, angles and wavelengths of the views")
        self.setHorizontalHeaderLabels(COLUMNS)
        self.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        self.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self.verticalHeader().setDefaultSectionSize(24)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.setToolTip(
            "Carrier and radius in cycles per camera pixel; the viewing angle in degrees, which a "
            "hologram can't tell; the wavelength in nanometres, where views differ in it, else "
            "nothing: that of step 1; flip where a dense object looks dark."
        )
        self.itemChanged.connect(self._changed)

    def fill(self, lobes: list[Lobe]) -> None:
        """Show these views."""
        self._filling = True
        try:
            self.setRowCount(len(lobes))
            unknown = angles_unknown(lobes)
            for row, lobe in enumerate(lobes):
                self._fill_row(row, lobe, "?" if unknown else f"{lobe.angle_deg:g}")
        finally:
            self._filling = False
        rows = max(1, len(lobes)) * self.verticalHeader().defaultSectionSize()
        self.setFixedHeight(self.horizontalHeader().sizeHint().height() + rows + 6)

    def _fill_row(self, row: int, lobe: Lobe, angle: str) -> None:
        header = QTableWidgetItem(str(row + 1))
        header.setForeground(QColor(VIEW_COLORS[row % len(VIEW_COLORS)]))
        self.setVerticalHeaderItem(row, header)
        ky, kx = lobe.carrier
        light = "" if lobe.wavelength_um is None else f"{1000 * lobe.wavelength_um:g}"
        texts = (f"{ky:.4f}", f"{kx:.4f}", f"{lobe.radius:.4f}", angle, light)
        for column, words in enumerate(texts):
            self.setItem(row, column, QTableWidgetItem(words))
        flip = QTableWidgetItem()
        flip.setFlags(Qt.ItemFlag.ItemIsUserCheckable | Qt.ItemFlag.ItemIsEnabled)
        flip.setCheckState(Qt.CheckState.Checked if lobe.flip else Qt.CheckState.Unchecked)
        self.setItem(row, FLIP, flip)

    def _changed(self, item: QTableWidgetItem) -> None:
        if not self._filling:
            self.typed.emit(item.row(), item.column(), item)


def changed_lobe(lobe: Lobe, column: int, item: Any) -> Lobe:
    """Return a lobe with one cell of its table row changed."""
    if column == FLIP:
        return replace(lobe, flip=item.checkState() == Qt.CheckState.Checked)
    if column == LIGHT and not item.text().strip():
        return replace(lobe, wavelength_um=None)
    try:
        value = float(item.text())
    except ValueError as error:
        msg = f"{COLUMNS[column]} takes a number, but got {item.text()!r}"
        raise ValueError(msg) from error
    ky, kx = lobe.carrier
    changes: dict[int, dict[str, Any]] = {
        0: {"carrier": (value, kx)},
        1: {"carrier": (ky, value)},
        2: {"radius": value},
        3: {"angle_deg": value},
        # Rounded, since 632.8 / 1000 is not 0.6328.
        LIGHT: {"wavelength_um": round(value / 1000, 9)},
    }
    return replace(lobe, **changes[column])
