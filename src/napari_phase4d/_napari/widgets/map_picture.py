"""What the map of frames shows, and how it is painted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, Qt
from qtpy.QtGui import QBrush, QColor, QFontMetricsF, QImage, QPainter, QPalette, QPen, QPolygonF

from napari_phase4d._napari.widgets.paths import (
    Arrow,
    Frame,
    Grid,
    best_per_pixel,
    path_arrows,
    time_ticks,
    time_unit,
)
from napari_phase4d.plotting import safety_colours
from napari_phase4d.words import view_in_words

__all__ = ["GAP", "MapPicture"]

#: Space between the parts, in pixels.
GAP = 4
#: Frames get a gap between them from this width on, in pixels.
ROOMY = 5
#: What is outlined is drawn at least this large, in pixels.
LEAST_OUTLINE = 7
#: Arrows next to each other keep this far apart, in pixels.
ARROW_GAP = 14
#: Width that a time below the frames takes with its space, in characters.
LABEL_CHARACTERS = 9
#: Space between the entries of the legend, in pixels.
LEGEND_GAP, LEAST_LEGEND_GAP = 10, 2
#: Width of a mark in the legend, in pixels.
MARK = 12
STAR, SQUARE = 14.0, 11.0


@dataclass
class MapPicture:
    """Frames, their scores and marks.

    Parameters
    ----------
    times_s, angles_deg : ndarray, 1-D
        Of each frame.
    """

    times_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    angles_deg: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    scores: NDArray[np.float32] | None = None
    best: Frame | None = None
    current: Frame | None = None
    pointed: Frame | None = None
    boundaries: list[Frame] = field(default_factory=list)
    path: str | None = None
    #: Whether times are written below the frames.
    with_times: bool = True
    #: What the ends of the colours mean.
    ends: tuple[str, str] = ("unsafe", "safe")
    #: Scores as a picture and the width in pixels that it was made for.
    coloured: tuple[int, QImage] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """Number of times and of angles."""
        return self.times_s.size, self.angles_deg.size

    def known(self, frame: Frame) -> Frame:
        """Return the frame if there is such a one; raise ValueError otherwise."""
        t, a = (int(number) for number in frame)
        n_times, n_angles = self.shape
        if not (0 <= t < n_times and 0 <= a < n_angles):
            msg = f"frame is ({t}, {a}), but there are {n_times} times and {n_angles} angles"
            raise ValueError(msg)
        return t, a

    def view(self, number: int) -> str:
        """Say which view a row is."""
        return view_in_words(self.angles_deg.tolist(), number, "viewing angle ")

    @property
    def labels(self) -> list[str]:
        """What is written at the rows."""
        angles = self.angles_deg.tolist()
        return [view_in_words(angles, number) for number in range(len(angles))]

    def words_on(self, frame: Frame) -> str:
        """Say in words what is shown of a frame."""
        t, a = frame
        factor, unit = time_unit(self.times_s)
        time = f"Time {self.times_s[t] / factor:.4g} {unit} (frame {t})"
        lines = [f"{time}, {self.view(a)}."]
        if self.scores is not None:
            score = self.scores[t, a]
            known = f"{score:.2f} (0 unsafe, 1 safe)" if np.isfinite(score) else "not known"
            lines.append(f"Safety as a start: {known}.")
        if frame == self.best:
            lines.append("Safest frame.")
        if frame in self.boundaries:
            lines.append("Unwrapping starts here.")
        lines.append("Click to start here, Shift+click to start here as well.")
        return "\n".join(lines)

    def paint(self, painter: QPainter, grid: Grid, palette: QPalette, *, focus: bool) -> None:
        """Draw everything."""
        ink = palette.color(QPalette.ColorRole.WindowText)
        box = QRectF(grid.left, grid.top, grid.width, grid.height)
        self._paint_frames(painter, grid, box)
        edge = palette.color(QPalette.ColorRole.Highlight) if focus else ink
        painter.setPen(QPen(edge, 2 if focus else 1))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.drawRect(box)
        painter.setPen(ink)
        self._paint_angles(painter, grid)
        if self.with_times:
            self._paint_times(painter, grid)
        self._paint_legend(painter, grid)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self._paint_path(painter, grid)
        self._paint_marks(painter, grid)

    def _paint_frames(self, painter: QPainter, grid: Grid, box: QRectF) -> None:
        """Draw the scores as one picture, with gaps where there is room."""
        painter.fillRect(box, QColor(UNKNOWN))
        if self.scores is not None:
            # Stripes tell a frame without score from the greyish middle of the colours.
            painter.fillRect(box, QBrush(QColor(255, 255, 255, 90), Qt.BrushStyle.BDiagPattern))
            ratio = painter.device().devicePixelRatioF()
            pixels = max(int(grid.width * ratio), 1)
            if self.coloured is None or self.coloured[0] != pixels:
                self.coloured = pixels, score_image(best_per_pixel(self.scores, pixels))
            painter.drawImage(box, self.coloured[1])
        painter.setPen(QPen(QColor(0, 0, 0, 110), 1))
        width, height = grid.cell
        if width >= ROOMY:
            for t in range(1, grid.n_times):
                x = grid.left + t * width
                painter.drawLine(QPointF(x, box.top()), QPointF(x, box.bottom()))
        if height >= ROOMY:
            for a in range(1, grid.n_angles):
                y = grid.top + a * height
                painter.drawLine(QPointF(box.left(), y), QPointF(box.right(), y))

    def _paint_angles(self, painter: QPainter, grid: Grid) -> None:
        """Write the angles at the left, as many as do not touch."""
        line = QFontMetricsF(painter.font()).height()
        every = max(1, int(np.ceil(0.85 * line / grid.cell[1])))
        align = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        labels = self.labels
        for a in range(0, grid.n_angles, every):
            _, y = grid.centre(0, a)
            place = QRectF(0, y - line / 2, grid.left - GAP, line)
            painter.drawText(place, align, labels[a])

    def _paint_times(self, painter: QPainter, grid: Grid) -> None:
        """Write round times below the frames."""
        metrics = QFontMetricsF(painter.font())
        room = int(grid.width / (LABEL_CHARACTERS * metrics.averageCharWidth()))
        bottom = grid.top + grid.height
        right = grid.left + grid.width + GAP
        taken = -np.inf
        for position, words in time_ticks(self.times_s, room):
            x, _ = grid.centre(position, 0)
            width = metrics.horizontalAdvance(words)
            start = min(x - width / 2, right - width)
            if start < taken:
                continue
            painter.drawLine(QPointF(x, bottom), QPointF(x, bottom + GAP - 1))
            place = QRectF(start, bottom + GAP - 1, width + 1, metrics.height())
            painter.drawText(place, Qt.AlignmentFlag.AlignLeft, words)
            taken = start + width + GAP

    def _paint_legend(self, painter: QPainter, grid: Grid) -> None:
        """Explain colours and marks above the frames, as many as there is room for."""
        metrics = QFontMetricsF(painter.font())
        line = metrics.height()
        x, end, middle = grid.left, grid.left + grid.width, 1 + line / 2
        base = 1 + metrics.ascent()
        ink = painter.pen()
        marks = self._legend()
        widths = [MARK + GAP + metrics.horizontalAdvance(words) for _, words in marks]
        bad, good = self.ends
        bar = 0.12 * grid.width
        scale_width = metrics.horizontalAdvance(bad + good) + 2 * GAP + bar
        if self.scores is not None:
            widths.insert(0, scale_width)
        # Closer together rather than without the last.
        room = (end - x - sum(widths)) / max(len(widths) - 1, 1)
        gap = min(max(room, LEAST_LEGEND_GAP), LEGEND_GAP)
        if self.scores is not None and x + scale_width <= end:
            start = x + metrics.horizontalAdvance(bad) + GAP
            draw_scale(painter, QRectF(start, middle - 4, bar, 8))
            painter.setPen(ink)
            painter.drawText(QPointF(x, base), bad)
            painter.drawText(QPointF(start + bar + GAP, base), good)
            x += scale_width + gap
        for (mark, words), width in zip(marks, widths[-len(marks) :], strict=False):
            if x + width > end + GAP:
                break
            self._paint_sign(painter, mark, QPointF(x + 6, middle))
            painter.setPen(ink)
            painter.drawText(QPointF(x + MARK + GAP, base), words)
            x += width + gap

    def _legend(self) -> list[tuple[str, str]]:
        """Return which marks there are, with their words."""
        entries = []
        if self.best is not None:
            entries.append(("star", "safest"))
        if self.boundaries:
            entries.append(("square", "start"))
            passes = {arrow.pass_number for arrow in self.arrows(1, 1)}
            names = {1: "first", 2: "then"} if len(passes) > 1 else dict.fromkeys(passes, "way")
            entries += [(f"pass {n}", names[n]) for n in sorted(passes)]
        return entries

    def _paint_sign(self, painter: QPainter, mark: str, centre: QPointF) -> None:
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if mark == "star":
            draw_star(painter, centre, 12)
        elif mark == "square":
            draw_square(painter, centre, 9)
        else:
            half = QPointF(7, 0)
            draw_arrow(painter, centre - half, centre + half, int(mark[-1]))
        painter.restore()

    def arrows(self, most_times: int, most_angles: int) -> list[Arrow]:
        """Return the way of the chosen method from the frames to start from."""
        if not self.boundaries:
            return []
        return path_arrows(
            self.path,
            *self.shape,
            self.boundaries,
            most_times=most_times,
            most_angles=most_angles,
        )

    def _paint_path(self, painter: QPainter, grid: Grid) -> None:
        """Draw as many arrows as stay readable, the first pass on top."""
        most = (max(int(length / ARROW_GAP), 1) for length in (grid.width, grid.height))
        for arrow in reversed(self.arrows(*most)):
            start, end = (QPointF(*grid.centre(*frame)) for frame in (arrow.start, arrow.end))
            draw_arrow(painter, start, end, arrow.pass_number)

    def _paint_marks(self, painter: QPainter, grid: Grid) -> None:
        for frame in self.boundaries:
            # Room for the star on it.
            size = STAR + 3 if frame == self.best else SQUARE
            draw_square(painter, QPointF(*grid.centre(*frame)), size)
        if self.best is not None:
            draw_star(painter, QPointF(*grid.centre(*self.best)), STAR)
        if self.current is not None:
            draw_outline(painter, outline(grid, self.current))
        if self.pointed is not None:
            draw_outline(painter, outline(grid, self.pointed), dashed=True)


def outline(grid: Grid, frame: Frame) -> QRectF:
    """Return the box round a frame, large enough to be seen."""
    x, y = grid.centre(*frame)
    width, height = (max(length - 2, LEAST_OUTLINE) for length in grid.cell)
    return QRectF(x - width / 2, y - height / 2, width, height)


#: First and second pass, as in the paper's Fig. 1; told apart by colour-blind people too.
PASS_COLOURS = {1: "#0b5fff", 2: "#d7191c"}
#: A frame whose score is not known.
UNKNOWN = "#8a8a8a"
#: Light edge of what is drawn over the scores, so that it is seen on each of their colours.
EDGE = "#ffffff"
INK = "#000000"
#: Length and half width of an arrow head in pixels.
HEAD = (6.0, 3.5)
#: Radius of the inner corners of a star, as a share of the outer.
STAR_INNER = 0.42


def colours_of(scores: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Return RGBA colours, shape (..., 4), of scores 0 to 1; NaN is transparent."""
    known = np.isfinite(scores)
    colours = np.round(255 * safety_colours(np.where(known, scores, 0))).astype(np.uint8)
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
    painter.drawImage(box, score_image(np.linspace(0, 1, 64)[:, None]))


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
