"""Where legend, panels and ticks of curves are put, and the colours of all but the curves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.plotting import EXACT

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from matplotlib.lines import Line2D

__all__ = [
    "USUAL_POINTS",
    "arrange_panels",
    "finite_range",
    "paint_figure",
    "paint_truth",
    "place_legend",
    "set_positions",
]

#: Points of the font for which spaces are given.
USUAL_POINTS = 9.0
#: Space for ticks and words round the panels, and between two of them, in 1/96 inch with the
#: usual font.
LEFT, RIGHT, BOTTOM, TOP = 54, 12, 38, 8
BESIDE = 40
#: Room that a tick takes with its number, in 1/96 inch.
WIDTH_OF_TICK, HEIGHT_OF_TICK = 40, 32
#: So few positions (viewing angles) each get their number.
EACH_WRITTEN = 3
#: Free space at the sides, as a share of the range.
SIDE = 0.03
#: A panel is at least so large, in 1/96 inch.
LEAST_PANEL = 20
#: The legend may take this share of the height.
MOST_LEGEND = 0.4


def finite_range(arrays: Iterable[NDArray[np.float64]]) -> tuple[float, float] | None:
    """Return the lowest and highest finite value; None if there is none."""
    every = [a[np.isfinite(a)] for a in arrays]
    values = np.concatenate(every) if every else np.zeros(0)
    return (float(values.min()), float(values.max())) if values.size else None


def place_legend(figure: Figure, lines: Sequence[Line2D], points: float) -> Legend | None:
    """Put a legend at the top in as many columns as fit; None if it would take too much room.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Its other legends are removed.
    lines : sequence of Line2D
        One a name.
    points : float
        Size of its letters.
    """
    for legend in list(figure.legends):
        legend.remove()
    columns = len(lines)
    while columns > 0:
        legend = figure.legend(
            handles=list(lines),
            loc="upper center",
            ncols=columns,
            fontsize=points,
            frameon=False,
            handlelength=1.6,
            handletextpad=0.5,
            columnspacing=1.0,
            labelspacing=0.2,
            borderaxespad=0.2,
            borderpad=0.2,
        )
        box = legend.get_window_extent()
        if box.height > MOST_LEGEND * figure.bbox.height:
            legend.remove()
            return None
        if box.width <= figure.bbox.width:
            return legend
        legend.remove()
        # Fewer columns are no narrower each, so that numbers between need not be tried, which
        # takes seconds for the legend of many cells.
        columns = min(columns - 1, int(columns * figure.bbox.width / box.width) + 1)
    return None


def arrange_panels(figure: Figure, points: float) -> None:
    """Spread the panels, side by side, over the room that the legend and a font leave."""
    unit = figure.dpi / 96 * points / USUAL_POINTS
    total_width, total_height = figure.bbox.width / unit, figure.bbox.height / unit
    top = TOP + sum(legend.get_window_extent().height / unit for legend in figure.legends)
    words_between = any(axes.get_ylabel() for axes in figure.axes[1:])
    beside = LEFT if words_between else BESIDE
    columns = len(figure.axes)
    width = (total_width - LEFT - RIGHT - (columns - 1) * beside) / columns
    width = max(width, LEAST_PANEL)
    height = max(total_height - top - BOTTOM, LEAST_PANEL)
    left, bottom = LEFT / total_width, BOTTOM / total_height
    figure.subplots_adjust(
        left=left,
        bottom=bottom,
        right=max(1 - RIGHT / total_width, left + 0.05),
        top=max(1 - top / total_height, bottom + 0.05),
        wspace=beside / width,
    )
    for axes in figure.axes:
        # Fixed places are quicker to draw, and no long number pushes words out of the picture.
        axes.xaxis.set_label_coords(0.5, -(BOTTOM - 16) / height)
        axes.yaxis.set_label_coords(-(LEFT - 16) / width, 0.5)
        set_ticks(axes.xaxis, width / WIDTH_OF_TICK + 1)
        set_ticks(axes.yaxis, height / HEIGHT_OF_TICK + 1)


def set_ticks(axis: Axis, most: float) -> None:
    """Let an axis have about ``most`` intervals between round numbers."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(nbins=int(np.clip(most, 3, 7)), steps=[1, 2, 5, 10]))


def set_positions(axes: Axes, x: NDArray[np.float64]) -> None:
    """Fit the horizontal axis to the positions, and write each of them where they are few."""
    low, high = finite_range([x]) or (0.0, 1.0)
    # A single point gets some room.
    room = SIDE * (high - low) or 0.5
    axes.set_xlim(low - room, high + room)
    if 0 < x.size <= EACH_WRITTEN:
        axes.set_xticks(x)


def paint_figure(figure: Figure, foreground: str, background: str) -> None:
    """Give everything but the curves these two colours."""
    figure.set_facecolor(background)
    for axes in figure.axes:
        paint_axes(axes, foreground)
    for legend in figure.legends:
        for text in legend.get_texts():
            text.set_color(foreground)


def paint_truth(figure: Figure, foreground: str) -> None:
    """Give the truth's line in the legend a colour."""
    for legend in figure.legends:
        for line, text in zip(legend.get_lines(), legend.get_texts(), strict=True):
            if text.get_text() == EXACT:
                line.set_color(foreground)


def paint_axes(axes: Axes, foreground: str) -> None:
    """Give frame, ticks and words of one panel a colour."""
    axes.set_facecolor("none")
    for spine in axes.spines.values():
        spine.set_edgecolor(foreground)
    axes.tick_params(colors=foreground)
    axes.xaxis.label.set_color(foreground)
    axes.yaxis.label.set_color(foreground)
