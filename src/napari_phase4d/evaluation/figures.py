"""Pictures of results side by side, after the paper's Figs. 2 and 4."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

from napari_phase4d.evaluation.loading import frame_of, in_memory

__all__ = ["comparison_figure", "movie_frames", "phase_limits"]

#: Inches that one picture takes.
CELL = 1.7
COLOURS = "turbo"
#: Pixels of a movie an inch; a power of two, so that sizes in pixels are exact.
MOVIE_DPI = 128
#: Inches that one picture of a movie takes at least and at most, and all of them about.
SMALLEST, LARGEST, ALL = 1.4, 2.4, (10.0, 8.0)
#: Inches of a movie: between pictures, below them, of a line of words, of the angles at the left
#: and of the colour bar at the right.
GAP, FOOT, LINE, ANGLES, BAR = 0.06, 0.12, 0.19, 0.55, 0.95


def comparison_figure(
    columns: Mapping[str, xr.DataArray],
    frames: Sequence[tuple[int, int]],
    *,
    limits: tuple[float, float] | None = None,
) -> Figure:
    """Draw chosen frames of several stacks: one column a stack, one row a frame.

    Parameters
    ----------
    columns : mapping of str to DataArray
        Title to unwrapped phase (time, angle, y, x) in radians, on one grid.
    frames : sequence of (int, int)
        (time, angle) numbers of the frames to show.
    limits : tuple of float, optional
        Phase in radians at the ends of the colour scale; default: all that is shown.

    Returns
    -------
    matplotlib.figure.Figure
        All pictures on one colour scale; `napari_phase4d.io.write_figure` saves it.
    """
    from matplotlib.figure import Figure

    first = next(iter(columns.values()))
    rows, n_columns = len(frames), len(columns)
    figure = Figure(figsize=(CELL * n_columns + 1.2, CELL * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, n_columns, squeeze=False)
    shown = [frame_of(s, t, a) for s in columns.values() for t, a in frames]
    low, high = limits or phase_limits(shown)
    for row, (t, a) in enumerate(frames):
        for column, (title, stack) in enumerate(columns.items()):
            axis = axes[row, column]
            image = axis.imshow(
                frame_of(stack, t, a), vmin=low, vmax=high, cmap=COLOURS, extent=extent_of(first)
            )
            axis.set_xticks([])
            axis.set_yticks([])
            if row == 0:
                axis.set_title(title, fontsize=9)
            if column == 0:
                label = f"{float(first['angle'][a]):g}°\n{time_label(first, t)}"
                axis.set_ylabel(label, fontsize=8)
    figure.colorbar(image, ax=axes, label="phase (rad)", shrink=0.8)
    return figure


@dataclass(frozen=True)
class Grid:
    """Where the pictures of a movie lie; lengths in inches, shares from the lower left corner.

    Parameters
    ----------
    n_columns, n_rows : int
        Number of pictures across and down.
    cell : tuple of float
        Width and height of one picture.
    size : tuple of float
        Width and height of the whole, an even number of pixels, as movies need it.
    """

    n_columns: int
    n_rows: int
    cell: tuple[float, float]
    size: tuple[float, float]

    @classmethod
    def of(cls, n_columns: int, n_rows: int, aspect: float, head: float) -> Grid:
        """Return a grid of pictures ``aspect`` times as high as wide, below ``head`` inches."""
        width = min(ALL[0] / n_columns, ALL[1] / n_rows / aspect)
        width = min(max(width, SMALLEST), LARGEST)
        height = width * aspect
        whole = (
            ANGLES + n_columns * (width + GAP) + BAR,
            head + n_rows * (height + GAP) + FOOT,
        )
        across, down = (2 * math.ceil(side * MOVIE_DPI / 2) / MOVIE_DPI for side in whole)
        return cls(n_columns, n_rows, (width, height), (across, down))

    def place(self, row: int, column: int) -> tuple[float, float, float, float]:
        """Return left, bottom, width and height of a picture, as shares of the whole."""
        width, height = self.cell
        left = ANGLES + column * (width + GAP)
        bottom = FOOT + (self.n_rows - 1 - row) * (height + GAP)
        across, down = self.size
        return left / across, bottom / down, width / across, height / down

    def bar(self) -> tuple[float, float, float, float]:
        """Return where the colour bar lies: right of the pictures, as high as one to three."""
        left, bottom, width, height = self.place(self.n_rows - 1, self.n_columns - 1)
        across, down = self.size
        left += width + 2 * GAP / across
        whole = self.n_rows * height + (self.n_rows - 1) * GAP / down
        tall = min(whole, 3 * height)
        return left, bottom + (whole - tall) / 2, 0.12 / across, tall


def movie_frames(
    columns: Mapping[str, xr.DataArray], limits: tuple[float, float], *, title: str = ""
) -> Iterator[NDArray[np.uint8]]:
    """Draw stacks over time: one column a stack, one row a viewing angle.

    Parameters
    ----------
    columns : mapping of str to DataArray
        Name to phase (time, angle, y, x) in radians, each with the same times and as many angles.
        Pixels that are NaN stay white.
    limits : tuple of float
        Phase in radians at the ends of the colour scale.
    title : str, optional
        What it shows, to stand before the time.

    Yields
    ------
    ndarray of uint8, shape (height, width, 3)
        One picture a time; height and width are even. The angle of a row stands at its left if
        it is that of all columns.

    Raises
    ------
    ValueError
        If there are no stacks, or they differ in their number of times or angles.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stacks = checked_stacks(columns)
    figure, images = movie_figure(list(columns), stacks, limits)
    canvas = FigureCanvasAgg(figure)
    top = 1 - 0.4 * LINE / figure.get_size_inches()[1]
    heading = figure.suptitle("", fontsize=10, y=top, animated=True)
    canvas.draw()
    # What stays the same is drawn once.
    still = canvas.copy_from_bbox(figure.bbox)
    for t in range(stacks[0].sizes["time"]):
        canvas.restore_region(still)
        words = (title, time_label(stacks[0], t))
        heading.set_text(", ".join(word for word in words if word))
        figure.draw_artist(heading)
        for image, frames in images:
            image.set_data(frames[t])
            figure.draw_artist(image)
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def movie_figure(
    names: Sequence[str], stacks: Sequence[xr.DataArray], limits: tuple[float, float]
) -> tuple[Figure, list[tuple[AxesImage, NDArray[np.float32]]]]:
    """Return what a movie shows all the time, and every moving picture with its frames."""
    from matplotlib.figure import Figure

    titles = [textwrap.fill(name, 18) for name in names]
    lines = 1.6 + max(title.count("\n") + 1 for title in titles)
    _, x_end, y_end, _ = extent_of(stacks[0])
    aspect = min(max(y_end / x_end, 0.3), 3.0)
    grid = Grid.of(len(stacks), stacks[0].sizes["angle"], aspect, lines * LINE)
    figure = Figure(figsize=grid.size, dpi=MOVIE_DPI)
    images = []
    for row in range(grid.n_rows):
        for column, stack in enumerate(stacks):
            axis = figure.add_axes(grid.place(row, column))
            axis.set_axis_off()
            axis.set_title(titles[column] if row == 0 else "", fontsize=9, pad=3)
            image = axis.imshow(
                stack.values[0, row],
                vmin=limits[0],
                vmax=limits[1],
                cmap=COLOURS,
                extent=extent_of(stack),
                animated=True,
            )
            images.append((image, stack.values[:, row]))
        left, bottom, _, height = grid.place(row, 0)
        left -= GAP / grid.size[0]
        label = angle_label(stacks, row)
        figure.text(left, bottom + height / 2, label, fontsize=9, ha="right", va="center")
    figure.colorbar(image, cax=figure.add_axes(grid.bar()), label="phase (rad)")
    return figure, images


def checked_stacks(columns: Mapping[str, xr.DataArray]) -> list[xr.DataArray]:
    """Return the stacks of a movie, or say why they can't stand next to each other."""
    if not columns:
        msg = "there are no stacks to show; give at least one"
        raise ValueError(msg)
    stacks = [in_memory(stack.transpose("time", "angle", "y", "x")) for stack in columns.values()]
    first = next(iter(columns))
    for name, stack in zip(columns, stacks, strict=True):
        if stack.shape[:2] != stacks[0].shape[:2]:
            msg = (
                f"{name} has {stack.shape[0]} times and {stack.shape[1]} angles, but {first} has "
                f"{stacks[0].shape[0]} and {stacks[0].shape[1]}; show them in movies of their own"
            )
            raise ValueError(msg)
    return stacks


def angle_label(stacks: Sequence[xr.DataArray], row: int) -> str:
    """Return the angle of a row, or nothing where the stacks have different ones."""
    angles = {float(stack["angle"][row]) for stack in stacks}
    return f"{angles.pop():g}°" if len(angles) == 1 else ""


def phase_limits(stacks: Sequence[NDArray[np.floating]]) -> tuple[float, float]:
    """Return the range of phase of several pictures, without a few extreme pixels and NaN."""
    shown = np.concatenate([np.ravel(s) for s in stacks])
    shown = shown[np.isfinite(shown)]
    if not shown.size:
        return -np.pi, np.pi
    low, high = (float(v) for v in np.quantile(shown, (0.001, 0.9995)))
    return low, high


def extent_of(stack: xr.DataArray) -> tuple[float, float, float, float]:
    """Return the edges of a frame in micrometres, as matplotlib wants them."""
    return (0.0, float(stack["x"][-1]) or 1.0, float(stack["y"][-1]) or 1.0, 0.0)


def time_label(stack: xr.DataArray, t: int) -> str:
    """Return the time of a frame, in minutes where a recording lasts some."""
    seconds = float(stack["time"][t])
    if float(stack["time"][-1]) >= 600:
        return f"t = {seconds / 60:.3g} min"
    return f"t = {seconds:.3g} s"
