"""Real mouse events on the spectrum canvas, and what it shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from qtpy.QtCore import QEvent, QPoint, QPointF, Qt
from qtpy.QtGui import QMouseEvent, QWheelEvent
from qtpy.QtTest import QTest
from qtpy.QtWidgets import QApplication

from napari_phase4d._napari.widgets.spectrum_canvas import SpectrumCanvas
from napari_phase4d.holography import Lobe

LEFT, NO_KEY = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
LOBES = [Lobe((0.19, 0.21), 0.09, -7.0), Lobe((-0.21, 0.19), 0.08, 21.0)]
EMPTY = (0.05, -0.42)


def scale_of(canvas: SpectrumCanvas) -> float:
    """Pixels for one cycle per pixel: the plane fills the shorter side, less a pixel each way."""
    size = canvas.viewport().size()
    return (min(size.width(), size.height()) - 2) * canvas.zoom


def point_of(canvas: SpectrumCanvas, ky: float, kx: float) -> QPoint:
    """Where a frequency is on the whole plane, worked out from the size of the viewport."""
    assert canvas.zoom == 1
    size, scale = canvas.viewport().size(), scale_of(canvas)
    return QPoint(round(size.width() / 2 + kx * scale), round(size.height() / 2 + ky * scale))


def mouse(canvas: SpectrumCanvas, kind: str, point: QPoint, button: Any = LEFT) -> None:
    """Press, move, release or double click on the viewport."""
    viewport = canvas.viewport()
    if kind == "move":  # QTest moves the pointer of the machine, which some displays do not have
        place = QPointF(point)
        event = QMouseEvent(
            QEvent.Type.MouseMove, place, QPointF(viewport.mapToGlobal(point)),
            Qt.MouseButton.NoButton, button, NO_KEY,
        )  # fmt: skip
        QApplication.sendEvent(viewport, event)
        return
    does = {"press": QTest.mousePress, "release": QTest.mouseRelease, "double": QTest.mouseDClick}
    does[kind](viewport, button, NO_KEY, point)


def drag(canvas: SpectrumCanvas, start: QPoint, *way: tuple[int, int]) -> None:
    """Drag over some points, given in pixels from the start."""
    mouse(canvas, "press", start)
    for dx, dy in way:
        mouse(canvas, "move", start + QPoint(dx, dy))
    mouse(canvas, "release", start + QPoint(*way[-1]))


def turn_wheel(canvas: SpectrumCanvas, point: QPoint, notches: float) -> bool:
    """Turn the wheel over a point; say whether the canvas took it."""
    viewport = canvas.viewport()
    event = QWheelEvent(
        QPointF(point), QPointF(viewport.mapToGlobal(point)), QPoint(),
        QPoint(0, int(120 * notches)), Qt.MouseButton.NoButton, NO_KEY,
        Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(viewport, event)
    return bool(event.isAccepted())


def pixels(canvas: SpectrumCanvas) -> np.ndarray:
    """What the viewport shows, (y, x, RGB)."""
    image = canvas.viewport().grab().toImage()
    image = image.convertToFormat(image.Format.Format_RGB888)
    bits = image.constBits()
    data = bits.asstring(image.sizeInBytes()) if hasattr(bits, "asstring") else bytes(bits)
    rows = np.frombuffer(data, np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)


def spectrum(shape: tuple[int, int], *peaks: tuple[float, float]) -> xr.DataArray:
    """Noise with bright spots, more than single pixels where there are many."""
    power = np.random.default_rng(0).exponential(1, shape)
    half = min(shape) // 128
    for ky, kx in peaks:
        y, x = round(ky * shape[0]) + shape[0] // 2, round(kx * shape[1]) + shape[1] // 2
        power[y - half : y + half + 1, x - half : x + half + 1] = 1e8
    return xr.DataArray(power.astype(np.float32), dims=("ky", "kx"))
