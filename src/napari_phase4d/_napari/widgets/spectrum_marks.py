"""What is drawn over the spectrum: circles of the views, and ghosts of what disturbs them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from qtpy.QtCore import QPointF, QRectF, Qt
from qtpy.QtGui import QColor, QFont, QPainter, QPainterPath, QPen

from napari_phase4d.holography import Lobe, StrayTerm, stray_terms

__all__ = ["VIEW_COLORS", "Plane", "paint_marks", "view_color"]

#: One colour a view, told apart by colour-blind people too (Okabe & Ito).
VIEW_COLORS = ("#56b4e9", "#e69f00", "#009e73", "#f0e442", "#cc79a7", "#d55e00")
#: Lines of views and of the one that is chosen, in pixels.
LINE, CHOSEN_LINE = 1.6, 3.2
GHOST = QColor(210, 210, 210, 150)
CONJUGATE_ALPHA = 210
#: Half the length of the cross at zero frequency, in pixels.
CROSS = 7
NUMBER_SIZE, LABEL_SIZE = 13, 9
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
    taken = [box for lobe in lobes for box in boxes_of(plane, lobe)]
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
    for side in (-1, 1):
        rim = plane.point(centre[0] + side * term.radius, centre[1])
        middle = rim - QPointF(0, side * LABEL_SIZE)
        path = text_path(painter.font(), plane, middle, term.label, LABEL_SIZE)
        if not any(path.boundingRect().intersects(box) for box in taken):
            taken.append(path.boundingRect())
            paint_text(painter, path, GHOST)
            return


def boxes_of(plane: Plane, lobe: Lobe) -> Iterator[QRectF]:
    """Yield the places of the circle of a view, of its conjugate and of its number."""
    ky, kx = lobe.carrier
    reach = lobe.radius * np.sqrt(0.5)
    for y, x in ((ky, kx), (-ky, -kx)):
        yield QRectF(plane.point(y - reach, x - reach), plane.point(y + reach, x + reach))
    half = QPointF(NUMBER_SIZE / 2, NUMBER_SIZE / 2)
    middle = number_place(plane, lobe)
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
    words = str(index + 1)
    path = text_path(painter.font(), plane, number_place(plane, lobe), words, NUMBER_SIZE)
    paint_text(painter, path, color)


def number_place(plane: Plane, lobe: Lobe) -> QPointF:
    """Return the middle of the number of a view."""
    out = (lobe.radius * plane.scale + 0.7 * NUMBER_SIZE) * np.sqrt(0.5)
    return plane.point(*lobe.carrier) + QPointF(out, -out)


def paint_circle(
    painter: QPainter, plane: Plane, centre: tuple[float, float], radius: float
) -> None:
    """Draw a circle given in cycles per pixel."""
    reach = radius * plane.scale
    painter.drawEllipse(plane.point(*centre), reach, reach)


def text_path(family: QFont, plane: Plane, middle: QPointF, words: str, size: int) -> QPainterPath:
    """Return the outline of a short text round its middle, but within the plane."""
    font = QFont(family)
    font.setPixelSize(size)
    font.setBold(size == NUMBER_SIZE)
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
