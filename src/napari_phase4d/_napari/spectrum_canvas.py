"""The Fourier spectrum with the views as circles that the mouse moves and resizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, Qt, Signal
from qtpy.QtGui import QBrush, QColor, QFont, QImage, QMouseEvent, QPen, QPixmap, QResizeEvent
from qtpy.QtWidgets import QGraphicsScene, QGraphicsView, QWidget

from napari_phase4d.holography import Lobe

__all__ = ["VIEW_COLORS", "SpectrumCanvas"]

#: One colour a view, told apart by colour-blind people too (Okabe & Ito).
VIEW_COLORS = ("#56b4e9", "#e69f00", "#009e73", "#f0e442", "#cc79a7", "#d55e00")
#: Darkest and brightest shown, as quantiles of the log power.
SHOWN = (0.3, 0.9999)
#: A click this near to a circle's line takes the line, in screen pixels.
GRIP = 7
#: Circles can't get smaller than this, in cycles per pixel.
SMALLEST_RADIUS = 0.005


class SpectrumCanvas(QGraphicsView):  # type: ignore[misc]
    """Log power in the Fourier plane, zero frequency in the middle, ky downwards.

    Drag a circle to move it, its line to resize it. Dashed circles are the conjugates.

    Signals
    -------
    lobes_edited(list)
        The lobes while the mouse moves one.
    frequency_shown(float, float)
        (ky, kx) under the mouse, in cycles per pixel.
    """

    lobes_edited = Signal(list)
    frequency_shown = Signal(float, float)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("spectrum_canvas")
        self._plane = QGraphicsScene(QRectF(-0.5, -0.5, 1, 1), self)
        self.setScene(self._plane)
        self.setMouseTracking(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setMinimumHeight(260)
        self.setMaximumHeight(300)  # leaves room for the table on a small screen
        self.setBackgroundBrush(QBrush(QColor("black")))
        self._lobes: list[Lobe] = []
        self._held: tuple[int, str] | None = None

    @property
    def lobes(self) -> list[Lobe]:
        """The views as drawn."""
        return list(self._lobes)

    def set_spectrum(self, spectrum: xr.DataArray | None) -> None:
        """Show a power spectrum with dims (ky, kx)."""
        self._plane.clear()
        if spectrum is not None:
            picture = self._plane.addPixmap(QPixmap.fromImage(grey_image(log_power(spectrum))))
            height, width = spectrum.shape
            picture.setTransformationMode(Qt.TransformationMode.SmoothTransformation)
            # Pixel n // 2 is frequency zero and is drawn with its middle there.
            picture.setTransform(
                picture.transform()
                .translate(-(width // 2 + 0.5) / width, -(height // 2 + 0.5) / height)
                .scale(1 / width, 1 / height)
            )
            picture.setZValue(-1)
        self._draw_circles()
        self._fit()

    def set_lobes(self, lobes: list[Lobe]) -> None:
        """Draw these views."""
        self._lobes = list(lobes)
        if self._held is not None and self._held[0] >= len(self._lobes):
            self._held = None
        self._draw_circles()

    def view_position(self, ky: float, kx: float) -> QPointF:
        """Return where a frequency is drawn, in pixels of the viewport."""
        return QPointF(self.mapFromScene(QPointF(kx, ky)))

    def _draw_circles(self) -> None:
        for item in self._plane.items():
            if item.zValue() >= 0:
                self._plane.removeItem(item)
        for i, lobe in enumerate(self._lobes):
            color = QColor(VIEW_COLORS[i % len(VIEW_COLORS)])
            ky, kx = lobe.carrier
            self._circle(ky, kx, lobe.radius, QPen(color, 2))
            ghost = QColor(color)
            ghost.setAlpha(130)
            self._circle(-ky, -kx, lobe.radius, QPen(ghost, 1, Qt.PenStyle.DashLine))
            label = self._plane.addSimpleText(str(i + 1), QFont(self.font().family(), 11))
            label.setBrush(QBrush(color))
            label.setFlag(label.GraphicsItemFlag.ItemIgnoresTransformations)
            label.setPos(kx, ky)

    def _circle(self, ky: float, kx: float, radius: float, pen: QPen) -> None:
        pen.setCosmetic(True)
        box = QRectF(kx - radius, ky - radius, 2 * radius, 2 * radius)
        self._plane.addEllipse(box, pen).setZValue(1)

    def _fit(self) -> None:
        self.fitInView(self.sceneRect(), Qt.AspectRatioMode.KeepAspectRatio)

    def resizeEvent(self, event: QResizeEvent | None) -> None:  # noqa: N802 - Qt's name
        """Keep the whole plane in view."""
        super().resizeEvent(event)
        self._fit()

    def mousePressEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Take hold of a circle or of its line."""
        if event.button() == Qt.MouseButton.LeftButton:
            self._held = self._under(event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Move or resize what is held, and tell the frequency under the mouse."""
        point = self.mapToScene(event.position().toPoint())
        self.frequency_shown.emit(point.y(), point.x())
        if self._held is None:
            held = self._under(event)
            shapes = {
                "move": Qt.CursorShape.SizeAllCursor,
                "resize": Qt.CursorShape.SizeFDiagCursor,
            }
            shape = Qt.CursorShape.ArrowCursor if held is None else shapes[held[1]]
            self.viewport().setCursor(shape)
            return
        index, action = self._held
        lobe = self._lobes[index]
        if action == "move":
            ky, kx = (float(np.clip(v, -0.5, 0.5)) for v in (point.y(), point.x()))
            self._lobes[index] = replace(lobe, carrier=(ky, kx))
        else:
            ky, kx = lobe.carrier
            radius = float(np.hypot(point.y() - ky, point.x() - kx))
            self._lobes[index] = replace(lobe, radius=float(np.clip(radius, SMALLEST_RADIUS, 0.5)))
        self._draw_circles()
        self.lobes_edited.emit(self.lobes)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:  # noqa: N802
        """Let go."""
        self._held = None

    def _under(self, event: QMouseEvent) -> tuple[int, str] | None:
        """Return the view under the mouse and what a drag would do to it."""
        point = self.mapToScene(event.position().toPoint())
        grip = GRIP / max(self.transform().m11(), 1e-9)
        for index, lobe in enumerate(self._lobes):
            ky, kx = lobe.carrier
            distance = float(np.hypot(point.y() - ky, point.x() - kx))
            if abs(distance - lobe.radius) < min(grip, lobe.radius / 2):
                return index, "resize"
            if distance < lobe.radius:
                return index, "move"
        return None


def log_power(spectrum: xr.DataArray) -> NDArray[np.uint8]:
    """Return the logarithm of a power spectrum as grey values 0 to 255."""
    power = np.asarray(spectrum.values, dtype=np.float64)
    logs = np.log10(np.maximum(power, np.finfo(np.float32).tiny))
    low, high = np.quantile(logs, SHOWN)
    scaled = (logs - low) / max(high - low, 1e-9)
    grey: NDArray[np.uint8] = (255 * np.clip(scaled, 0, 1)).astype(np.uint8)
    return grey


def grey_image(grey: NDArray[np.uint8]) -> QImage:
    """Return grey values as a picture that owns its pixels."""
    height, width = grey.shape
    data = np.ascontiguousarray(grey)
    return QImage(data.tobytes(), width, height, width, QImage.Format.Format_Grayscale8).copy()
