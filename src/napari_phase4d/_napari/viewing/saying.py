"""Words on the canvas: what its colours mean, and at which time and view the sliders are."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from qtpy.QtCore import QEvent, QObject, QSize, Qt
from qtpy.QtGui import QFontMetricsF
from qtpy.QtWidgets import QLabel, QWidget

from napari_phase4d._napari.turns import Canvas

__all__ = ["CanvasWords"]

#: What is shown together -> what its colours mean.
UNITS_OF_COLOURS = {
    "results": "colours: phase in rad",
    "cells": "colours: phase in rad",
    "confidence": "colours: chance to be right, 0 to 1",
    "margin": "colours: steps in half cycles",
    "difference": "colours: difference in rad",
    "": "",
    "wrapped": "",
}
#: Size of the words in napari's points, and how many of Qt's each of those is.
FONT, POINTS = 9.0, 4 / 3
#: Room that napari leaves round words in their box, next to its distance from the border.
ROOM = 0.4
#: How much of what lies below such a box is hidden.
COVERS = 0.8


class CanvasWords:
    """Says on a viewer's canvas what colours mean, and which frame it is.

    The frame changes with every step of a slider. napari would lay all names in the grid out
    anew for each word that changes; with nine results a step took a fifth longer. So it stands in
    a label before the canvas.

    Parameters
    ----------
    viewer : napari.viewer.ViewerModel
        On whose canvas.
    """

    def __init__(self, viewer: Any) -> None:
        self._viewer = viewer
        #: Whether the frame is said; not before all is shown.
        self.frames = False
        self._label: FrameLabel | None = None

    def say_colours(self, showing: str) -> None:
        """Say what the colours mean, unless the user's own words stand there, and no frame yet.

        Parameters
        ----------
        showing : str
            One of `UNITS_OF_COLOURS`.
        """
        self.frames = False
        self._take_label()
        text, words = self._viewer.canvas.overlays.text, UNITS_OF_COLOURS[showing]
        if self._ours and text.text != words:
            text.text, text.font_size, text.position = words, FONT, "bottom_left"
            text.visible = bool(words)

    def say_frame(self, words: str, canvas: Canvas | None) -> None:
        """Say time and view; napari does, without units, where the user's own words stand.

        Parameters
        ----------
        words : str
            Which frame it is.
        canvas : Canvas or None
            Where to; napari says it, too, where there is none.
        """
        self.frames = True
        if not self._ours:
            self._take_label()
        if self._label is None and canvas is not None and self._ours:
            widget = canvas.widget()
            self._label = None if widget is None else FrameLabel(widget)
        if self._label is not None:
            with suppress(RuntimeError):  # the canvas has gone, and the label with it
                self._label.say(words, self._viewer.canvas)
        self._viewer.canvas.overlays.current_slice.visible = self._label is None

    def leave(self) -> None:
        """Let napari say which frame it is from now on, if it was said."""
        self._take_label()
        if self.frames:
            self._viewer.canvas.overlays.current_slice.visible = True

    @property
    def _ours(self) -> bool:
        """Whether what stands there was said here, or nothing does."""
        return self._viewer.canvas.overlays.text.text in UNITS_OF_COLOURS.values()

    def _take_label(self) -> None:
        label, self._label = self._label, None
        if label is not None:
            with suppress(RuntimeError):
                label.hide()
                label.deleteLater()


class FrameLabel(QLabel):  # type: ignore[misc]
    """A line above napari's words at the lower left of its canvas, which looks like them.

    Parameters
    ----------
    canvas : QWidget
        Before which it stands.
    """

    def __init__(self, canvas: QWidget) -> None:
        super().__init__(canvas)
        self.setObjectName("frame_on_canvas")
        self.setAccessibleName("Time and view on screen")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.setIndent(0)
        self._canvas, self._look = canvas, ""
        #: Distance from the canvas's lower left corner, in pixels.
        self._left = self._below = 0
        canvas.installEventFilter(self)

    def say(self, words: str, canvas: Any) -> None:
        """Show words.

        Parameters
        ----------
        words : str
            What to say.
        canvas : napari.components.Canvas
            Whose colours it has, and above whose words it stands.
        """
        if look := self._look_on(canvas):
            self._look = look
            self.setStyleSheet(look)
            self.ensurePolished()
        if words != self.text() or look:
            self.setText(words)
            self._stand_above(canvas)
            self.show()

    def _look_on(self, canvas: Any) -> str:
        """Return the style that suits a canvas, "" if it is that of now."""
        red, green, blue = (round(255 * float(c)) for c in canvas.background_color[:3])
        letters = "white" if red + green + blue < 3 * 128 else "black"
        room = [round(ROOM * pad) for pad in canvas.overlay_tiling.padding]
        look = (
            f"background: rgba({red}, {green}, {blue}, {round(255 * COVERS)}); color: {letters}; "
            f"font-size: {POINTS * FONT:g}pt; padding: {room[1]}px {room[0]}px 0px {room[0]}px;"
        )
        return "" if look == self._look else look

    def _stand_above(self, canvas: Any) -> None:
        """Stand on the box of napari's words, and be as wide."""
        metrics, text = QFontMetricsF(self.font()), canvas.overlays.text
        across, up = canvas.overlay_tiling.padding
        below = text.visible and text.position == "bottom_left"
        box = metrics.height() + 2 * ROOM * up if below else 0.0
        self._left, self._below = round((1 - ROOM) * across), round((1 - ROOM) * up + box)
        width = metrics.horizontalAdvance(text.text) + 2 * ROOM * across if below else 0.0
        self.resize(self.sizeHint().expandedTo(QSize(round(width), 0)))
        self._place()

    def _place(self) -> None:
        self.move(self._left, self._canvas.height() - self._below - self.height())

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:  # noqa: N802
        """Stay at the lower left corner."""
        if event is not None and event.type() == QEvent.Type.Resize:
            self._place()
        return False
