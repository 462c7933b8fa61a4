"""Real mouse and key events on the window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from qtpy.QtCore import QEvent, QPoint, QPointF, Qt, QTimer
from qtpy.QtGui import QMouseEvent
from qtpy.QtTest import QTest
from qtpy.QtWidgets import (
    QApplication,
    QDialogButtonBox,
    QFileDialog,
    QInputDialog,
    QLabel,
    QLineEdit,
    QWidget,
)

LEFT = Qt.MouseButton.LeftButton
PLAIN = Qt.KeyboardModifier.NoModifier


def drag(canvas: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag with the left mouse button from one frequency (ky, kx) of the spectrum to another."""
    viewport = canvas.viewport()
    for kind, where, pressed in (
        (QEvent.Type.MouseButtonPress, start, LEFT),
        (QEvent.Type.MouseMove, end, LEFT),
        (QEvent.Type.MouseButtonRelease, end, Qt.MouseButton.NoButton),
    ):
        point = canvas.view_position(*where)
        button = Qt.MouseButton.NoButton if kind == QEvent.Type.MouseMove else LEFT
        place = QPointF(viewport.mapToGlobal(point.toPoint()))
        event = QMouseEvent(kind, point, place, button, pressed, PLAIN)
        QApplication.sendEvent(viewport, event)


def canvas_of(viewer: Any) -> QWidget:
    """Return the widget that napari draws its layers on."""
    return viewer.window._qt_viewer.canvas.native


def frame_on_canvas(viewer: Any) -> str:
    """Return what the canvas says of time and view, "" for nothing."""
    label = frame_label(viewer)
    return "" if label is None else label.text()


def frame_label(viewer: Any) -> QLabel | None:
    """Return the label of time and view that is shown on the canvas, None where none is."""
    labels = canvas_of(viewer).findChildren(QLabel, "frame_on_canvas")
    shown = [label for label in labels if not label.isHidden()]
    assert len(shown) < 2
    return next(iter(shown), None)


def place_of(viewer: Any, y_um: float, x_um: float) -> QPoint:
    """Return where a place of the sample is drawn, when one layer fills the canvas."""
    camera, size = viewer.scene.camera, canvas_of(viewer).size()
    x = size.width() / 2 + (x_um - camera.center[2]) * camera.zoom
    y = size.height() / 2 + (y_um - camera.center[1]) * camera.zoom
    return QPoint(round(x), round(y))


def click_cell(boundary_map: Any, time: int, angle: int, modifier: Any = PLAIN) -> None:
    """Click on a frame of the map."""
    place = boundary_map.cell_position(time, angle).toPoint()
    QTest.mouseClick(boundary_map, LEFT, modifier, place)


def answer_dialog(text: str | Path) -> Callable[[], bool]:
    """Type a text into the dialog that opens next, for a file or a text, and press the button.

    What is returned says whether there was a dialog.
    """
    answered: list[bool] = []
    tries = iter(range(100))

    def answer() -> None:
        dialog = QApplication.activeModalWidget()
        if not isinstance(dialog, QFileDialog | QInputDialog):
            if dialog is None and next(tries, None) is not None:
                QTimer.singleShot(50, answer)
            return
        line = dialog.findChild(QLineEdit)
        line.setText(str(text))  # typed, the list of suggestions would take the click
        answered.append(True)
        buttons = dialog.findChild(QDialogButtonBox)
        QTest.mouseClick(buttons.buttons()[0], LEFT)
        # A dialog that still waits would hold up all other tests.
        guard = QTimer(dialog)
        guard.setSingleShot(True)
        guard.timeout.connect(dialog.reject)
        guard.start(2000)

    QTimer.singleShot(50, answer)
    return lambda: bool(answered)


def let_settle(qtbot: Any, dock: Any) -> None:
    """Wait until all that was asked for is on screen, and the panel has followed the sliders."""
    turns, followers = dock.presenter.turns, dock.followers
    qtbot.waitUntil(
        lambda: not (dock.jobs.running or turns.pending or followers.frame_changed.pending),
        timeout=60_000,
    )


def saved(folder: Path, name: str, holograms: Any) -> Path:
    """Write a video as a plain TIFF, as a camera's program does."""
    path = folder / f"{name}.tif"
    tifffile.imwrite(path, np.asarray(holograms), photometric="minisblack", imagej=False)
    return path


def open_by_click(click: Any, dock: Any, path: Path) -> None:
    """Open a file by the button of the first step and the dialog."""
    answered = answer_dialog(path)
    click("open_file")
    assert answered()
    assert dock.session.recording is not None
    assert dock.session.recording.source == str(path)
