"""How the map of frames draws colours, arrows and marks."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, Qt
from qtpy.QtGui import QColor, QImage, QPainter, QPen, QPolygonF

__all__ = [
    "PASS_COLOURS",
    "UNKNOWN",
    "colours_of",
    "draw_arrow",
    "draw_outline",
    "draw_scale",
    "draw_square",
    "draw_star",
    "score_image",
]

#: First and second pass, as in the paper's Fig. 1; told apart by colour-blind people too.
PASS_COLOURS = {1: "#0b5fff", 2: "#d7191c"}
#: A frame whose score is not known.
UNKNOWN = "#8a8a8a"
#: Colours go by the score to this power: most scores are near 1, and a frame of 0.7, wrong on
#: nearly a third of the object, must not look safe.
POWER = 3
#: Light edge of what is drawn over the scores, so that it is seen on each of their colours.
EDGE = "#ffffff"
INK = "#000000"
#: Length and half width of an arrow head in pixels.
HEAD = (6.0, 3.5)
#: Radius of the inner corners of a star, as a share of the outer.
STAR_INNER = 0.42


@cache
def scale() -> NDArray[np.uint8]:
    """Return 256 colours (RGBA) from unsafe to safe; brighter is safer (viridis)."""
    from matplotlib import colormaps

    table: NDArray[np.uint8] = colormaps["viridis"](np.linspace(0, 1, 256), bytes=True)
    return table


def colours_of(scores: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return RGBA colours, shape (..., 4), of scores 0 to 1; NaN is transparent."""
    known = np.isfinite(scores)
    level = np.clip(np.where(known, scores, 0), 0, 1) ** POWER
    index = np.round(255 * level).astype(np.intp)
    colours = scale()[index]
    colours[~known] = 0
    return colours


def score_image(scores: NDArray[np.floating]) -> QImage:
    """Return scores (time, angle) as a picture: time to the right, angle upwards."""
    colours = np.ascontiguousarray(colours_of(scores.T[::-1]))
    height, width = colours.shape[:2]
    form = QImage.Format.Format_RGBA8888
    # The copy owns its pixels.
    return QImage(colours.tobytes(), width, height, 4 * width, form).copy()


def draw_scale(painter: QPainter, box: QRectF) -> None:
    """Draw the colours from unsafe (left) to safe."""
    painter.drawImage(box, score_image(np.linspace(0, 1, 64)[:, None] ** (1 / POWER)))


def draw_arrow(painter: QPainter, start: QPointF, end: QPointF, pass_number: int) -> None:
    """Draw an arrow with a light edge; the first pass is the bolder one."""
    way = end - start
    length = float(np.hypot(way.x(), way.y()))
    if length < 1:
        return
    along = way / length
    across = QPointF(-along.y(), along.x())
    reach, half = (min(1.0, length / 12) * size for size in HEAD)
    neck = end - along * reach
    head = QPolygonF([end, neck + across * half, neck - across * half])
    colour = QColor(PASS_COLOURS[pass_number])
    width = 2.2 if pass_number == 1 else 1.6
    painter.setBrush(colour)
    for pen in (QPen(QColor(EDGE), width + 2), QPen(colour, width)):
        pen.setCapStyle(Qt.PenCapStyle.FlatCap)
        painter.setPen(pen)
        painter.drawLine(start, neck)
        pen.setWidthF(2.0 if pen.color() != colour else 0.5)
        painter.setPen(pen)
        painter.drawPolygon(head)


def draw_star(painter: QPainter, centre: QPointF, size: float) -> None:
    """Draw a light star with a dark edge, ``size`` pixels across."""
    points = []
    for corner in range(10):
        radius = size / 2 * (1.0 if corner % 2 == 0 else STAR_INNER)
        turn = np.pi * (corner / 5 - 0.5)
        points.append(centre + QPointF(radius * np.cos(turn), radius * np.sin(turn)))
    painter.setPen(QPen(QColor(INK), 1.2))
    painter.setBrush(QColor(EDGE))
    painter.drawPolygon(QPolygonF(points))


def draw_square(painter: QPainter, centre: QPointF, size: float) -> None:
    """Draw a dark square with a light edge, as Fig. 1 shows where to start from."""
    painter.setPen(QPen(QColor(EDGE), 1.2))
    painter.setBrush(QColor(INK))
    painter.drawRect(QRectF(centre.x() - size / 2, centre.y() - size / 2, size, size))


def draw_outline(painter: QPainter, box: QRectF, *, dashed: bool = False) -> None:
    """Draw a crisp light outline that is seen on light and dark."""
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing, on=False)
    painter.setBrush(Qt.BrushStyle.NoBrush)
    whole = box.toRect()
    painter.setPen(QPen(QColor(INK), 4))
    painter.drawRect(whole)
    pen = QPen(QColor(EDGE), 2)
    if dashed:
        pen.setStyle(Qt.PenStyle.DotLine)
    painter.setPen(pen)
    painter.drawRect(whole)
    painter.restore()
