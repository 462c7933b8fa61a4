"""The Fourier plane as a picture that zooms and pans, and what is drawn over it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, QSize, Qt
from qtpy.QtGui import (
    QBrush,
    QColor,
    QFont,
    QFontInfo,
    QImage,
    QPainter,
    QPainterPath,
    QPen,
    QPixmap,
    QResizeEvent,
    QTransform,
    QWheelEvent,
)
from qtpy.QtWidgets import QGraphicsScene, QGraphicsView, QSizePolicy, QWidget

from napari_phase4d.holography import Lobe, StrayTerm, stray_terms
from napari_phase4d.later import xr

__all__ = ["VIEW_COLORS", "PlaneView", "paint_marks", "sized", "view_color"]

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


#: One colour a view, told apart by colour-blind people too (Okabe & Ito).
VIEW_COLORS = ("#56b4e9", "#e69f00", "#009e73", "#f0e442", "#cc79a7", "#d55e00")
#: Lines of views and of the one that is chosen, in pixels.
LINE, CHOSEN_LINE = 1.6, 3.2
GHOST = QColor(210, 210, 210, 150)
CONJUGATE_ALPHA = 210
#: Half the length of the cross at zero frequency, in pixels.
CROSS = 7
#: Sizes of numbers and labels, as shares of the widget's font.
NUMBER_SIZE, LABEL_SIZE = 13 / 12, 9 / 12
#: Of more beats than this, only those that disturb the chosen view have a label.
LABELLED_BEATS = 3


@dataclass(frozen=True)
class Plane:
    """Where the Fourier plane lies on the screen.

    Parameters
    ----------
    zero : QPointF
        Zero frequency, in pixels.
    scale : float
        Pixels for one cycle per pixel.
    """

    zero: QPointF
    scale: float

    def point(self, ky: float, kx: float) -> QPointF:
        """Return where a frequency is drawn, in pixels."""
        return QPointF(self.zero.x() + kx * self.scale, self.zero.y() + ky * self.scale)

    def frequency(self, point: QPointF) -> tuple[float, float]:
        """Return the frequency (ky, kx) drawn at a point."""
        ky = (point.y() - self.zero.y()) / self.scale
        kx = (point.x() - self.zero.x()) / self.scale
        return float(ky), float(kx)

    @property
    def square(self) -> QRectF:
        """The whole plane, +-0.5 cycles per pixel."""
        return QRectF(self.point(-0.5, -0.5), self.point(0.5, 0.5))


def view_color(index: int) -> QColor:
    """Return the colour of a view, counted from 0."""
    return QColor(VIEW_COLORS[index % len(VIEW_COLORS)])


def paint_marks(painter: QPainter, plane: Plane, lobes: Sequence[Lobe], chosen: int) -> None:
    """Draw cross, ghosts, conjugates and circles, the chosen circle last.

    Parameters
    ----------
    painter : QPainter
        What draws, in pixels of the screen.
    plane : Plane
        Where to.
    lobes : sequence of Lobe
        The views.
    chosen : int
        The view to draw thicker, counted from 0; -1 for none.
    """
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    painter.setClipRect(plane.square)
    painter.setBrush(Qt.BrushStyle.NoBrush)
    paint_cross(painter, plane)
    paint_ghosts(painter, plane, lobes, chosen)
    for index, lobe in enumerate(lobes):
        ky, kx = lobe.carrier
        color = view_color(index)
        color.setAlpha(CONJUGATE_ALPHA)
        painter.setPen(QPen(color, 1, Qt.PenStyle.DashLine))
        paint_circle(painter, plane, (-ky, -kx), lobe.radius)
    for index in sorted(range(len(lobes)), key=lambda i: i == chosen):
        paint_view(painter, plane, lobes[index], index, index == chosen)
    painter.restore()


def paint_cross(painter: QPainter, plane: Plane) -> None:
    """Draw a thin cross at zero frequency."""
    for color, width in ((QColor(0, 0, 0, 160), 3.0), (QColor("white"), 1.0)):
        painter.setPen(QPen(color, width))
        for step in (QPointF(CROSS, 0), QPointF(0, CROSS)):
            painter.drawLine(plane.zero - step, plane.zero + step)


def paint_ghosts(painter: QPainter, plane: Plane, lobes: Sequence[Lobe], chosen: int) -> None:
    """Draw the zero order and the beats, dotted, and their labels where there is room."""
    terms = stray_terms(lobes)
    number = sized(painter.font(), NUMBER_SIZE).pixelSize()
    taken = [box for lobe in lobes for box in boxes_of(plane, lobe, number)]
    for term in terms:
        few = term.pair is None or len(terms) - 1 <= LABELLED_BEATS
        labelled = few or (chosen >= 0 and term.disturbs(lobes[chosen]))
        ky, kx = term.centre
        for centre in sorted({(ky, kx), (-ky, -kx)}):
            painter.setPen(QPen(GHOST, 1, Qt.PenStyle.DotLine))
            for copy in copies(centre, term.radius):
                paint_circle(painter, plane, copy, term.radius)
            if labelled:
                paint_label(painter, plane, centre, term, taken)


def paint_label(
    painter: QPainter,
    plane: Plane,
    centre: tuple[float, float],
    term: StrayTerm,
    taken: list[QRectF],
) -> None:
    """Write what a ghost is under its top or over its bottom, if nothing else stands there."""
    font = sized(painter.font(), LABEL_SIZE)
    for side in (-1, 1):
        rim = plane.point(centre[0] + side * term.radius, centre[1])
        middle = rim - QPointF(0, side * font.pixelSize())
        path = text_path(font, plane, middle, term.label)
        if not any(path.boundingRect().intersects(box) for box in taken):
            taken.append(path.boundingRect())
            paint_text(painter, path, GHOST)
            return


def boxes_of(plane: Plane, lobe: Lobe, number: int) -> Iterator[QRectF]:
    """Yield the places of the circle of a view, of its conjugate and of its number, so high."""
    ky, kx = lobe.carrier
    reach = lobe.radius * np.sqrt(0.5)
    for y, x in ((ky, kx), (-ky, -kx)):
        yield QRectF(plane.point(y - reach, x - reach), plane.point(y + reach, x + reach))
    half = QPointF(number / 2, number / 2)
    middle = number_place(plane, lobe, number)
    yield QRectF(middle - half, middle + half)


def copies(centre: tuple[float, float], radius: float) -> Iterator[tuple[float, float]]:
    """Yield the places of a disk in a spectrum that repeats, where they reach into it."""
    for dy, dx in itertools.product((-1, 0, 1), repeat=2):
        ky, kx = centre[0] + dy, centre[1] + dx
        if np.hypot(max(abs(ky) - 0.5, 0), max(abs(kx) - 0.5, 0)) < radius:
            yield ky, kx


def paint_view(painter: QPainter, plane: Plane, lobe: Lobe, index: int, is_chosen: bool) -> None:
    """Draw the circle of a view with its number outside, at the upper right."""
    color = view_color(index)
    painter.setPen(QPen(color, CHOSEN_LINE if is_chosen else LINE))
    paint_circle(painter, plane, lobe.carrier, lobe.radius)
    font = sized(painter.font(), NUMBER_SIZE)
    font.setBold(True)
    middle = number_place(plane, lobe, font.pixelSize())
    path = text_path(font, plane, middle, str(index + 1))
    paint_text(painter, path, color)


def number_place(plane: Plane, lobe: Lobe, size: int) -> QPointF:
    """Return the middle of the number of a view, which is so many pixels high."""
    out = (lobe.radius * plane.scale + 0.7 * size) * np.sqrt(0.5)
    return plane.point(*lobe.carrier) + QPointF(out, -out)


def paint_circle(
    painter: QPainter, plane: Plane, centre: tuple[float, float], radius: float
) -> None:
    """Draw a circle given in cycles per pixel."""
    reach = radius * plane.scale
    painter.drawEllipse(plane.point(*centre), reach, reach)


def sized(font: QFont, share: float) -> QFont:
    """Return a font as large as a share of another, in whole pixels, so that it is sharp."""
    other = QFont(font)
    other.setPixelSize(max(round(share * QFontInfo(font).pixelSize()), 1))
    return other


def text_path(font: QFont, plane: Plane, middle: QPointF, words: str) -> QPainterPath:
    """Return the outline of a short text round its middle, but within the plane."""
    path = QPainterPath()
    path.addText(QPointF(0, 0), font, words)
    box, square = path.boundingRect(), plane.square
    half = QPointF(box.width() / 2 + 3, box.height() / 2 + 3)
    x = np.clip(middle.x(), square.left() + half.x(), square.right() - half.x())
    y = np.clip(middle.y(), square.top() + half.y(), square.bottom() - half.y())
    path.translate(QPointF(float(x), float(y)) - box.center())
    return path


def paint_text(painter: QPainter, path: QPainterPath, color: QColor) -> None:
    """Draw a text with a dark edge, so that it is seen on every grey."""
    painter.strokePath(path, QPen(QColor(0, 0, 0, 190), 3))
    painter.fillPath(path, color)


#: Darkest and brightest shown, as quantiles of the log power.
SHOWN = (0.3, 0.9999)


class SpectrumPicture:
    """Log power in the Fourier plane, drawn in cycles per pixel: kx to the right, ky downwards.

    Parameters
    ----------
    spectrum : xarray.DataArray
        Power, dims (ky, kx), zero frequency in the middle.
    """

    def __init__(self, spectrum: xr.DataArray) -> None:
        self._power = np.asarray(spectrum.values, dtype=np.float32)
        self._pixmaps: dict[int, QPixmap] = {}

    def paint(self, painter: QPainter, pixels_per_cycle: float) -> None:
        """Draw it with a painter in cycles per pixel.

        Parameters
        ----------
        painter : QPainter
            What draws.
        pixels_per_cycle : float
            Pixels of the screen for one cycle per pixel, the width of the whole plane.
        """
        step = self._step(pixels_per_cycle)
        if step not in self._pixmaps:
            grey = log_power(pooled(self._power, step))
            self._pixmaps[step] = QPixmap.fromImage(grey_image(grey))
        pixmap = self._pixmaps[step]
        height, width = self._power.shape
        # Pixel n // 2 is frequency zero and is drawn with its middle there.
        place = QRectF(
            -(width // 2 + 0.5) / width,
            -(height // 2 + 0.5) / height,
            pixmap.width() * step / width,
            pixmap.height() * step / height,
        )
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        painter.drawPixmap(place, pixmap, QRectF(pixmap.rect()))

    def _step(self, pixels_per_cycle: float) -> int:
        """Return how many pixels a side to join, so that none is smaller than the screen's."""
        step = 1
        while 2 * step * pixels_per_cycle <= max(self._power.shape):
            step *= 2
        return step


def pooled(power: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Return the mean of blocks of ``step`` by ``step`` pixels; the last ones may be smaller.

    Joined pixels keep narrow peaks, which a smaller picture of the logarithm would lose.
    """
    if step == 1:
        return power
    for axis, n in enumerate(power.shape):
        starts = np.arange(0, n, step)
        counts = np.diff(np.append(starts, n)).astype(np.float32)
        sums: NDArray[np.float32] = np.add.reduceat(power, starts, axis=axis)
        sums /= counts[:, None] if axis == 0 else counts
        power = sums
    return power


def log_power(power: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return the logarithm of a power spectrum as grey values 0 to 255."""
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
