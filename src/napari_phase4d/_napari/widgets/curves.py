"""Curves in the window: traces of a pixel for every method, dry mass for every region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from qtpy.QtCore import QEvent, QSize, Qt
from qtpy.QtGui import QFontInfo, QPalette, QShowEvent
from qtpy.QtWidgets import QLabel, QStackedLayout, QWidget

from napari_phase4d._napari.widgets.curve_layout import (
    USUAL_POINTS,
    arrange_panels,
    finite_range,
    paint_figure,
    paint_truth,
    place_legend,
    set_positions,
)
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.plotting import CURVE_COLOURS, EXACT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

__all__ = ["CurvePlot", "Panel", "curve_styles", "steady_limits"]

#: Sizes of words and of the legend, as shares of the widget's font.
WORDS, LEGEND = 8 / 9, 7.5 / 9
DASHES = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)))
#: Width of the last curve in points, and how much wider each before it is: where several
#: coincide, each is still seen.
THINNEST, THICKER = 1.2, 0.25
#: Free space above and below the curves, as a share of their range.
MARGIN = 0.12
#: Limits stay as they are while the curves fill at least this share of them.
WELL_FILLED = 0.45


def curve_styles(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return colour, dashes and width of each curve, by the order of the names.

    The truth takes no colour from a method: it has that of the words, see `Picture.paint`.
    """
    n_colours = len(CURVE_COLOURS)
    places = {name: i for i, name in enumerate(name for name in names if name != EXACT)}
    return {
        name: {
            "color": CURVE_COLOURS[places.get(name, 0) % n_colours],
            "linestyle": DASHES[places.get(name, 0) // n_colours % len(DASHES)],
            "linewidth": THINNEST + THICKER * (len(names) - 1 - i),
        }
        for i, name in enumerate(names)
    }


def steady_limits(
    shown: tuple[float, float] | None, before: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the limits of an axis that do not jump with every change of the curves.

    Parameters
    ----------
    shown : (float, float) or None
        Lowest and highest value to be shown; None if there is none.
    before : (float, float) or None
        Limits up to now, kept while the values lie within them and fill them well.
    """
    if shown is None:
        return before or (0.0, 1.0)
    low, high = shown
    if before is not None:
        fills = (high - low) >= WELL_FILLED * (before[1] - before[0])
        if before[0] <= low and high <= before[1] and fills:
            return before
    # A constant gets some room too.
    room = MARGIN * (high - low) or 0.05 * max(abs(low), 1.0)
    return low - room, high + room


NOTHING = "Move the mouse over a result."
SIZE, LEAST_SIZE = (360, 200), (280, 140)
FORMATS = (".png", ".svg")


class CurvePlot(QWidget):  # type: ignore[misc]
    """One or more panels of named curves that can be renewed many times a second.

    Until there are curves it shows a sentence, and matplotlib is not loaded.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        self._live: CurveFigure | None = None
        super().__init__(parent)
        self.setObjectName("curve_plot")
        self._words = QLabel(NOTHING)
        self._words.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._words.setWordWrap(True)
        self._stack = QStackedLayout(self)
        self._stack.addWidget(self._words)

    @property
    def figure(self) -> Figure | None:
        """The matplotlib figure; None before the first curve."""
        return None if self._live is None else self._live.figure

    @property
    def has_curves(self) -> bool:
        """Whether curves are shown, not a sentence."""
        return self._stack.currentWidget() is not self._words

    def message(self, text: str = NOTHING) -> None:
        """Show a sentence instead of curves."""
        self._words.setText(text)
        self._stack.setCurrentWidget(self._words)

    def show_traces(self, panels: Sequence[Panel]) -> None:
        """Show panels of curves; quick if only their values have changed since the last time.

        Parameters
        ----------
        panels : sequence of Panel
            Such as one over time and one over the angle, side by side; a name has the same colour
            in each. Without any curve, a sentence is shown.

        Raises
        ------
        ValueError
            If a curve has not as many points as there are positions.
        """
        for panel in panels:
            values_of(panel)
        if not any(panel.curves for panel in panels):
            self.message()
            return
        if self._live is None:
            self._live = CurveFigure(self.logicalDpiX())
            self._stack.addWidget(self._live.canvas)
            self._letter()
            self._paint()
        self._stack.setCurrentWidget(self._live.canvas)
        self._live.show(panels)

    def show_curves(
        self, x: ArrayLike, curves: Mapping[str, ArrayLike], x_label: str, y_label: str
    ) -> None:
        """Show one panel, such as the dry mass of every region over time.

        Parameters
        ----------
        x, curves, x_label, y_label
            See `Panel`.
        """
        self.show_traces([Panel(x, curves, x_label, y_label)])

    def save(self, path: str | Path) -> None:
        """Write the curves to a file, black on white.

        Parameters
        ----------
        path : str or Path
            Ends with .png or .svg.

        Raises
        ------
        ValueError
            If there are no curves, or the ending is another one.
        OSError
            If the file can't be written.
        """
        target = Path(path)
        if self._live is None or not self.has_curves:
            msg = "there are no curves to save yet"
            raise ValueError(msg)
        if target.suffix.lower() not in FORMATS:
            msg = f"curves are saved as {' or '.join(FORMATS)}, but the file is {target.name!r}"
            raise ValueError(msg)
        with written_whole(target) as temporary:
            self._live.save(temporary)

    def sizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        """Return the size at which two panels can be read."""
        return QSize(*SIZE)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the least size at which it can be read."""
        return QSize(*LEAST_SIZE)

    def showEvent(self, event: QShowEvent | None) -> None:  # noqa: N802
        """Draw what has changed while nobody saw it."""
        super().showEvent(event)
        if self._live is not None:
            self._live.redraw(everything=True)

    def changeEvent(self, event: QEvent | None) -> None:  # noqa: N802
        """Follow the theme and the font."""
        super().changeEvent(event)
        changes = (QEvent.Type.PaletteChange, QEvent.Type.StyleChange, QEvent.Type.FontChange)
        if event is not None and event.type() in changes:
            self._letter()
            self._paint()

    def _letter(self) -> None:
        """Use the size of the window's font."""
        if self._live is not None:
            self._live.letter(QFontInfo(self.font()).pointSizeF())

    def _paint(self) -> None:
        """Use the colours of the theme."""
        if self._live is None:
            return
        palette = self.palette()
        ink, ground = (QPalette.ColorRole.WindowText, QPalette.ColorRole.Window)
        self._live.paint(palette.color(ink).name(), palette.color(ground).name())


#: Curves of at most so many points show each of them.
FEW_POINTS = 12
SAVED_DPI = 200
#: Pixels by which the ends of lines stand out of a legend.
CAPS = 4
#: Width in points of curves that have a colour of their own, and how opaque their bands are.
OWN_WIDTH, BAND = 1.5, 0.25

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Panel:
    """Curves that share their axes.

    Parameters
    ----------
    x : array_like, shape (n,)
        Positions of the points.
    curves : mapping of str to array_like, shape (n,)
        Values by name; NaN are gaps.
    x_label, y_label : str
        What is shown, with its unit.
    at : float, optional
        Position of a vertical line, such as the time on screen.
    errors : mapping of str to array_like, shape (n,), optional
        Curve to half the width of a band round it.
    colours : mapping of str to str, optional
        Curve to its colour; default: told apart by the order of the names.
    """

    x: ArrayLike
    curves: Mapping[str, ArrayLike]
    x_label: str
    y_label: str = ""
    at: float | None = None
    errors: Mapping[str, ArrayLike] = field(default_factory=dict)
    colours: Mapping[str, str] = field(default_factory=dict)


@dataclass
class Drawn:
    """A panel as drawn, to be changed in place."""

    axes: Axes
    x: Values
    lines: dict[str, Line2D]
    mark: Line2D
    bands: list[PolyCollection] = field(default_factory=list)
    #: What curves and bands show: their values by name.
    values: dict[tuple[str, str], Values] = field(default_factory=dict)

    def place_mark(self, at: float | None) -> None:
        """Put the vertical line somewhere, or nowhere."""
        self.mark.set_visible(at is not None)
        self.mark.set_xdata([at or 0.0] * 2)

    def takes(self, curves: Mapping[str, Values], panel: Panel) -> bool:
        """Take the values that are to be shown; return whether any of them are new."""
        before = self.values
        errors = {n: np.ravel(np.asarray(e, np.float64)) for n, e in panel.errors.items()}
        self.values = {("curve", n): y for n, y in curves.items()}
        self.values |= {("band", n): e for n, e in errors.items()}
        return before.keys() != self.values.keys() or not all(
            np.array_equal(before[key], value, equal_nan=True)
            for key, value in self.values.items()
        )


def values_of(panel: Panel) -> tuple[Values, dict[str, Values]]:
    """Return positions and values as arrays; raise ValueError if their lengths differ."""
    x = np.ravel(np.asarray(panel.x, dtype=np.float64))
    curves = {n: np.ravel(np.asarray(y, dtype=np.float64)) for n, y in panel.curves.items()}
    for name, y in curves.items():
        if y.size != x.size:
            msg = f"curve {name!r} has {y.size} points, but there are {x.size} positions"
            raise ValueError(msg)
    return x, curves


class CurveFigure:
    """Figure and canvas.

    Axes and words are kept as a picture, over which the curves are drawn; only when the limits
    of an axis change, the axes are drawn anew.

    Parameters
    ----------
    dots_per_inch : float
        Of the screen.
    """

    def __init__(self, dots_per_inch: float) -> None:
        # Matplotlib takes the Qt binding that is loaded, which is that of qtpy by now.
        from matplotlib.backends.backend_qtagg import FigureCanvasQTAgg
        from matplotlib.figure import Figure

        self.figure = Figure(dpi=dots_per_inch)
        self.canvas: Any = FigureCanvasQTAgg(self.figure)
        # Its own handlers would keep the wheel from scrolling the window.
        self.canvas.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.canvas.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.canvas.mpl_connect("resize_event", self._resized)
        self.canvas.mpl_connect("draw_event", self._keep_pictures)
        self._colours = ("black", "white")
        self._points = USUAL_POINTS
        self._drawn: list[Drawn] = []
        self._made_for: tuple[Any, ...] = ()
        #: Pictures of axes and words, and of the curves over them.
        self._ground: Any = None
        self._curved: Any = None
        self._legend: Any = None

    def show(self, panels: Sequence[Panel]) -> None:
        """Show panels side by side; quick if only values or vertical lines have changed."""
        data = [values_of(panel) for panel in panels]
        parts = tuple(
            (
                tuple(panel.curves),
                tuple(panel.colours.items()),
                panel.x_label,
                panel.y_label,
                x.tobytes(),
            )
            for panel, (x, _) in zip(panels, data, strict=True)
        )
        if parts != self._made_for:
            self._build(panels)
            self._made_for = parts
        # Lists, so that every panel takes its values and is made to fit.
        new = [
            drawn.takes(curves, panel)
            for panel, drawn, (_, curves) in zip(panels, self._drawn, data, strict=True)
        ]
        if not any(new):  # such as at each step of the slider, which moves the line only
            for drawn, panel in zip(self._drawn, panels, strict=True):
                drawn.place_mark(panel.at)
            self._redraw_marks()
            return
        moved = [
            renew(drawn, curves, panel)
            for panel, drawn, (_, curves) in zip(panels, self._drawn, data, strict=True)
        ]
        self.redraw(everything=any(moved))

    def letter(self, points: float) -> None:
        """Give words and numbers the size that goes with a font of so many points."""
        if points == self._points:
            return
        self._points = points
        for drawn in self._drawn:
            self._size_words(drawn.axes)
        if self._drawn:
            self._arrange()

    def _size_words(self, axes: Axes) -> None:
        points = WORDS * self._points
        axes.xaxis.label.set_fontsize(points)
        axes.yaxis.label.set_fontsize(points)
        axes.tick_params(labelsize=points)

    def paint(self, foreground: str, background: str) -> None:
        """Give everything but the curves these colours."""
        self._colours = (foreground, background)
        paint_figure(self.figure, foreground, background)
        for drawn in self._drawn:
            drawn.mark.set_color(foreground)
            if EXACT in drawn.lines:
                drawn.lines[EXACT].set_color(foreground)
        paint_truth(self.figure, foreground)
        self._show_legend()
        self.redraw(everything=True)

    def save(self, path: Path) -> None:
        """Write a picture, black on white; the ending says of which kind."""
        before = self._colours
        self.paint("black", "white")
        try:
            self.figure.savefig(path, dpi=SAVED_DPI)
        finally:
            self.paint(*before)

    def redraw(self, *, everything: bool) -> None:
        """Draw the curves, and axes and words too if they have changed."""
        self._curved = None
        if everything:
            self._ground = None
        if not self.canvas.isVisible():
            return
        if self._ground is None:
            self.canvas.draw_idle()
        else:
            self.canvas.restore_region(self._ground)
            self._draw_curves()
            self.canvas.update()

    def _redraw_marks(self) -> None:
        """Draw the vertical lines over the curves, which are as they were."""
        if self._curved is None or not self.canvas.isVisible():
            self.redraw(everything=False)
            return
        self.canvas.restore_region(self._curved)
        self._draw_marks()
        self.canvas.update()

    def _build(self, panels: Sequence[Panel]) -> None:
        """Make panels whose curves have no values yet."""
        self.figure.clear()
        grid = self.figure.subplots(1, len(panels), squeeze=False)
        names = list(dict.fromkeys(name for panel in panels for name in panel.curves))
        styles = curve_styles(names)
        colours = {name: c for panel in panels for name, c in panel.colours.items()}
        for name in set(names) & colours.keys():
            styles[name] = {"color": colours[name], "linewidth": OWN_WIDTH}
        self._drawn = []
        for panel, axes in zip(panels, grid.flat, strict=True):
            x = values_of(panel)[0]
            marker = "o" if x.size <= FEW_POINTS else ""
            look = {"marker": marker, "markersize": 3.5, "animated": True}
            unknown = np.full(x.size, np.nan)
            lines = {
                name: axes.plot(x, unknown, label=name, **look, **styles[name])[0]
                for name in panel.curves
            }
            mark = axes.axvline(0.0, linewidth=1, linestyle=":", animated=True)
            axes.set_xlabel(panel.x_label)
            axes.set_ylabel(panel.y_label)
            self._size_words(axes)
            axes.ticklabel_format(useOffset=False)
            self._drawn.append(Drawn(axes, x, lines, mark))
        self._arrange()

    def _arrange(self) -> None:
        """Give legend and panels their places."""
        every: dict[str, Line2D] = {}
        for drawn in self._drawn:
            every = drawn.lines | every
        place_legend(self.figure, list(every.values()), LEGEND * self._points)
        arrange_panels(self.figure, self._points)
        for drawn in self._drawn:
            set_positions(drawn.axes, drawn.x)
        self.paint(*self._colours)

    def _resized(self, event: Any) -> None:
        if self._drawn:
            self._arrange()

    def _keep_pictures(self, event: Any) -> None:
        """Keep what has just been drawn, legend and all, and draw the curves over it."""
        if event.canvas is not self.canvas or self.canvas.is_saving():
            return
        # The legend is slow to draw and stays as it is when axes change.
        for legend in self.figure.legends:
            if legend.get_visible():
                box = legend.get_window_extent().padded(CAPS)
                self._legend = self.canvas.copy_from_bbox(box)
                legend.set_visible(False)
            else:
                self.canvas.restore_region(self._legend)
        self._ground = self.canvas.copy_from_bbox(self.figure.bbox)
        self._draw_curves()

    def _show_legend(self) -> None:
        for legend in self.figure.legends:
            legend.set_visible(True)

    def _draw_curves(self) -> None:
        for drawn in self._drawn:
            for artist in (*drawn.bands, *drawn.lines.values()):
                drawn.axes.draw_artist(artist)
        self._curved = self.canvas.copy_from_bbox(self.figure.bbox)
        self._draw_marks()

    def _draw_marks(self) -> None:
        for drawn in self._drawn:
            drawn.axes.draw_artist(drawn.mark)


def renew(drawn: Drawn, curves: Mapping[str, Values], panel: Panel) -> bool:
    """Give curves their values; return whether the limits had to change for them."""
    for band in drawn.bands:
        band.remove()
    drawn.bands = []
    ends = list(curves.values())
    for name, y in curves.items():
        line = drawn.lines[name]
        line.set_ydata(y)
        if name in panel.errors:
            error = np.ravel(np.asarray(panel.errors[name], dtype=np.float64))
            look = {"color": line.get_color(), "alpha": BAND, "linewidth": 0, "animated": True}
            drawn.bands.append(drawn.axes.fill_between(drawn.x, y - error, y + error, **look))
            ends += [y - error, y + error]
    drawn.place_mark(panel.at)
    before = drawn.axes.get_ylim()
    after = steady_limits(finite_range(ends), before)
    drawn.axes.set_ylim(after)
    return after != before
