"""What the map of frames shows: ways through the frames, ticks and cells; how it is painted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, Qt
from qtpy.QtGui import QBrush, QColor, QFontMetricsF, QImage, QPainter, QPalette, QPen, QPolygonF

from napari_phase4d.plotting import safety_colours
from napari_phase4d.unwrapping import ORDERS
from napari_phase4d.unwrapping.chain import starts_on
from napari_phase4d.unwrapping.pieces import pieces_between
from napari_phase4d.words import view_in_words

__all__ = [
    "GAP",
    "Arrow",
    "Frame",
    "Grid",
    "MapPicture",
    "best_per_pixel",
    "path_arrows",
    "spread",
    "time_ticks",
    "time_unit",
]

#: (time index, angle index).
Frame = tuple[int, int]
#: Steps between labelled times are one of these times a power of ten.
NICE_STEPS = (1, 2, 5)
#: Recordings shorter than so many seconds are labelled in units of so many seconds.
TIME_UNITS = ((600.0, 1.0, "s"), (36_000.0, 60.0, "min"), (np.inf, 3600.0, "h"))


@dataclass(frozen=True)
class Arrow:
    """A straight way through frames.

    Parameters
    ----------
    start, end : (int, int)
        First and last frame, (time index, angle index).
    pass_number : int
        1 for the pass that is made first, 2 for the second.
    """

    start: Frame
    end: Frame
    pass_number: int


def path_arrows(
    path: str | None,
    n_times: int,
    n_angles: int,
    boundaries: Sequence[Frame],
    *,
    most_times: int | None = None,
    most_angles: int | None = None,
) -> list[Arrow]:
    """Return the ways that a method goes from its boundary frames, after the paper's Fig. 1.

    The first of two passes goes along the line of each boundary frame; the second leaves that
    line at each of its frames. A single pass goes along every line. Where a line has several
    frames to start from, each is left until half way to the next.

    Parameters
    ----------
    path : str or None
        One of `ORDERS`; None is no way at all.
    n_times, n_angles : int
        How many frames there are, at least 1 each.
    boundaries : sequence of (int, int)
        Where it starts, (time index, angle index); at least one.
    most_times, most_angles : int, optional
        Draw at most so many arrows next to each other, evenly spread over the times or angles
        and one of them from the first boundary frame.

    Returns
    -------
    list of Arrow
        First pass first; within a pass by line, onwards before backwards. Arrows of no length
        are left out.

    Raises
    ------
    ValueError
        If the path is not known or a boundary frame does not exist.
    """
    if path is None:
        return []
    if path not in ORDERS:
        msg = f"path is {path!r}; it must be one of {', '.join(ORDERS)}"
        raise ValueError(msg)
    for t, a in boundaries:
        if not (0 <= t < n_times and 0 <= a < n_angles):
            msg = f"boundary is {(t, a)}, but there are {n_times} times and {n_angles} angles"
            raise ValueError(msg)
    known, counts, most = list(boundaries), (n_times, n_angles), (most_times, most_angles)
    arrows: list[Arrow] = []
    for number, dim in enumerate(ORDERS[path], start=1):
        along, across = (0, 1) if dim == "time" else (1, 0)
        lines = sorted({frame[across] for frame in known})
        if number == len(ORDERS[path]):
            lines = spread(counts[across], most[across], known[0][across])
        for line in lines:
            for piece in pieces_between(starts_on(dim, line, known), counts[along], None):
                start = on_line(dim, piece.start, line)
                ends = (on_line(dim, end, line) for end in (piece.stop - 1, piece.first))
                arrows += [Arrow(start, end, number) for end in ends if start != end]
    return arrows


def on_line(dim: str, place: int, line: int) -> Frame:
    """Return the frame at a place of a line along a dimension."""
    return (place, line) if dim == "time" else (line, place)


def spread(count: int, most: int | None, keep: int) -> list[int]:
    """Return at most ``most`` of the numbers 0 to ``count - 1``, evenly spread.

    ``keep`` is always among them.
    """
    stride = 1 if most is None else -(-count // most)
    return list(range(keep % stride, count, stride))


def time_ticks(times_s: NDArray[np.floating], most: int) -> list[tuple[float, str]]:
    """Choose round times to write under the frames.

    Parameters
    ----------
    times_s : ndarray, shape (n,)
        Time of each frame in seconds.
    most : int
        How many labels there is room for; two are always allowed.

    Returns
    -------
    list of (float, str)
        Position as a (fractional) time index, and the time with its unit (s, min or h).
        Times that do not grow from frame to frame get a label at their ends.
    """
    factor, unit = time_unit(times_s)
    shown = np.asarray(times_s, dtype=np.float64) / factor
    low, high = float(shown[0]), float(shown[-1])
    if len(shown) == 1:
        return [(0.0, f"{low:.4g} {unit}")]
    if np.any(np.diff(shown) <= 0):
        return [(0.0, f"{low:.4g} {unit}"), (len(shown) - 1.0, f"{high:.4g} {unit}")]
    step, decimals = nice_step(high - low, max(most, 2))
    first, last = int(np.ceil(low / step - 1e-6)), int(np.floor(high / step + 1e-6))
    values = np.arange(first, last + 1) * step
    positions = np.interp(values, shown, np.arange(len(shown)))
    texts = [f"{value:.{decimals}f} {unit}" for value in values]
    return list(zip(positions.tolist(), texts, strict=True))


def time_unit(times_s: NDArray[np.floating]) -> tuple[float, str]:
    """Return the unit that suits a recording: its length in seconds, and its sign."""
    longest = float(np.max(np.abs(times_s)))
    return next((seconds, sign) for below, seconds, sign in TIME_UNITS if longest < below)


def nice_step(span: float, most: int) -> tuple[float, int]:
    """Return the smallest round step with at most ``most`` ticks on ``span``, and its decimals."""
    power = int(np.floor(np.log10(span))) - 2
    while True:
        for nice in NICE_STEPS:
            step = nice * 10.0**power
            if span / step + 1 <= most + 1e-6:
                return step, max(0, -power)
        power += 1


def best_per_pixel(scores: NDArray[np.floating], width: int) -> NDArray[np.float32]:
    """Return scores (time, angle) for at most ``width`` columns of pixels.

    Where several times share a column, it holds the highest score, so that a short safe moment
    of a long recording stays visible; NaN only where none is known.
    """
    n_times = len(scores)
    values: NDArray[np.float32] = np.asarray(scores, dtype=np.float32)
    if n_times <= width:
        return values
    # A frame belongs to the pixel that its middle is in.
    starts = -((width - 2 * np.arange(width) * n_times) // (2 * width))
    found = np.maximum.reduceat(np.where(np.isnan(values), -np.inf, values), starts, axis=0)
    return np.where(np.isinf(found), np.float32(np.nan), found).astype(np.float32)


@dataclass(frozen=True)
class Grid:
    """Where the frames are drawn: time to the right, angle upwards, as in Fig. 1.

    Parameters
    ----------
    left, top, width, height : float
        Place of all frames in pixels of the widget.
    n_times, n_angles : int
        How many frames there are.
    """

    left: float
    top: float
    width: float
    height: float
    n_times: int
    n_angles: int

    @property
    def cell(self) -> tuple[float, float]:
        """Width and height of one frame in pixels."""
        return self.width / self.n_times, self.height / self.n_angles

    def centre(self, t: float, a: float) -> tuple[float, float]:
        """Return the middle (x, y) of a frame in pixels."""
        width, height = self.cell
        return self.left + (t + 0.5) * width, self.top + self.height - (a + 0.5) * height

    def nearest(self, x: float, y: float, reach: float) -> Frame | None:
        """Return the frame nearest to a pixel; None further than ``reach`` pixels outside."""
        right, bottom = self.left + self.width, self.top + self.height
        if not (
            self.left - reach <= x <= right + reach and self.top - reach <= y <= bottom + reach
        ):
            return None
        width, height = self.cell
        t = int(np.clip(np.floor((x - self.left) / width), 0, self.n_times - 1))
        a = int(np.clip(np.floor((bottom - y) / height), 0, self.n_angles - 1))
        return t, a


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
    wavelengths_um : sequence of float, optional
        Of each view, where there are several.
    """

    times_s: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    angles_deg: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    wavelengths_um: Sequence[float] | None = None
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
        return self._view(number, "viewing angle ")

    def _view(self, number: int, what: str = "") -> str:
        return view_in_words(self.angles_deg.tolist(), number, what, self.wavelengths_um)

    @property
    def labels(self) -> list[str]:
        """What is written at the rows."""
        return [self._view(number) for number in range(len(self.angles_deg))]

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
