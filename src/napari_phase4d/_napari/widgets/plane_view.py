"""The Fourier plane as a picture that zooms and pans."""

from __future__ import annotations

import numpy as np
import xarray as xr
from qtpy.QtCore import QPointF, QRectF, QSize, Qt
from qtpy.QtGui import QBrush, QColor, QPainter, QResizeEvent, QTransform, QWheelEvent
from qtpy.QtWidgets import QGraphicsScene, QGraphicsView, QSizePolicy, QWidget

from napari_phase4d._napari.widgets.spectrum_marks import Plane
from napari_phase4d._napari.widgets.spectrum_picture import SpectrumPicture

__all__ = ["MOST_ZOOM", "PlaneView"]

#: Least, preferred and largest side in pixels.
LEAST, SIDE, MOST = 200, 230, 300
MOST_ZOOM = 8.0
#: One notch of the wheel, 120 units, zooms by this.
ZOOM_STEP, NOTCH = 1.25, 120


class PlaneView(QGraphicsView):  # type: ignore[misc]
    """Log power in the Fourier plane, zero frequency in the middle, ky downwards.

    The wheel zooms about the mouse, but only with the focus: what is around it may scroll.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self._scene = QGraphicsScene(QRectF(-0.5, -0.5, 1, 1), self)
        self._picture: SpectrumPicture | None = None
        self._zoom = 1.0
        self._middle = (0.0, 0.0)
        self.setScene(self._scene)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setTransformationAnchor(QGraphicsView.ViewportAnchor.NoAnchor)
        self.setResizeAnchor(QGraphicsView.ViewportAnchor.NoAnchor)
        self.setViewportUpdateMode(QGraphicsView.ViewportUpdateMode.FullViewportUpdate)
        # The picture changes seldom, what is drawn over it with every move of the mouse.
        self.setCacheMode(QGraphicsView.CacheModeFlag.CacheBackground)
        self.setBackgroundBrush(QBrush(QColor("black")))
        self.setMinimumSize(LEAST, LEAST)
        policy = QSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Preferred)
        policy.setHeightForWidth(True)
        self.setSizePolicy(policy)

    @property
    def zoom(self) -> float:
        """How many times larger than the whole plane it is shown, 1 to 8."""
        return self._zoom

    @property
    def has_spectrum(self) -> bool:
        """Whether there is a spectrum to look at."""
        return self._picture is not None

    @property
    def plane(self) -> Plane:
        """Where the Fourier plane lies in the viewport."""
        shown = self.viewportTransform()
        return Plane(QPointF(shown.dx(), shown.dy()), float(shown.m11()))

    def view_position(self, ky: float, kx: float) -> QPointF:
        """Return where a frequency is drawn, in pixels of the viewport."""
        return self.plane.point(ky, kx)

    def set_spectrum(self, spectrum: xr.DataArray | None) -> None:
        """Show a power spectrum with dims (ky, kx), as a whole."""
        self._picture = None if spectrum is None else SpectrumPicture(spectrum)
        self.resetCachedContent()
        self.reset_view()
        self.viewport().update()

    def reset_view(self) -> None:
        """Show the whole plane."""
        self._show(1.0, (0.0, 0.0))

    def zoom_about(self, point: QPointF, factor: float) -> None:
        """Zoom by a factor and leave the frequency under a point of the viewport there."""
        zoom = float(np.clip(self._zoom * factor, 1.0, MOST_ZOOM))
        ky, kx = self.plane.frequency(point)
        y, x = self._middle
        shrunk = self._zoom / zoom
        self._show(zoom, (ky + (y - ky) * shrunk, kx + (x - kx) * shrunk))

    def pan_by(self, way: QPointF) -> None:
        """Move the picture by some pixels, as far as the plane goes."""
        y, x = self._middle
        scale = self.plane.scale
        self._show(self._zoom, (y - way.y() / scale, x - way.x() / scale))

    def _show(self, zoom: float, middle: tuple[float, float]) -> None:
        """Show the plane at a zoom, with a frequency (ky, kx) in the middle if it can be."""
        self._zoom = zoom
        size = self.viewport().size()
        scale = max(min(size.width(), size.height()) - 2, 1) * zoom
        limits = (max(0.5 - n / scale / 2, 0) for n in (size.height(), size.width()))
        y, x = (float(np.clip(k, -limit, limit)) for k, limit in zip(middle, limits, strict=True))
        self._middle = (y, x)
        self.setTransform(QTransform.fromScale(scale, scale))
        self.centerOn(x, y)

    def drawBackground(self, painter: QPainter | None, rect: QRectF) -> None:  # noqa: N802
        """Draw the picture."""
        super().drawBackground(painter, rect)
        if self._picture is not None and painter is not None:
            painter.setClipRect(self.sceneRect(), Qt.ClipOperation.IntersectClip)
            self._picture.paint(painter, self.plane.scale * self.devicePixelRatioF())

    def resizeEvent(self, event: QResizeEvent | None) -> None:  # noqa: N802 - Qt's name
        """Keep what is in the middle there."""
        super().resizeEvent(event)
        self._show(self._zoom, self._middle)

    def wheelEvent(self, event: QWheelEvent) -> None:  # noqa: N802
        """Zoom, if it has been clicked or tabbed to."""
        if not self.hasFocus():
            event.ignore()
            return
        self.zoom_about(event.position(), ZOOM_STEP ** (event.angleDelta().y() / NOTCH))
        event.accept()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return a square."""
        return QSize(SIDE, SIDE)

    def heightForWidth(self, width: int) -> int:  # noqa: N802
        """Return a square's height, which leaves room for what is below on a small screen."""
        return min(max(width, LEAST), MOST)
