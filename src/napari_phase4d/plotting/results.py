"""Figures and movies of results side by side, and which frames tell most."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.analysis import Comparison, frame_of, in_memory
from napari_phase4d.later import xr
from napari_phase4d.plotting.colours import phase_limits, phase_scale
from napari_phase4d.stacks import AXES, factor_to, in_units
from napari_phase4d.words import checked_call, shown, view_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage


__all__ = [
    "EXACT",
    "angle_label",
    "comparison_figure",
    "movie_frames",
    "named_results",
    "telling_frames",
]

#: A scale bar takes at most this share of a picture's width.
SCALE_BAR = 0.3
#: Inches that one picture takes.
CELL = 1.7
#: Pixels of a movie an inch; a power of two, so that sizes in pixels are exact.
MOVIE_DPI = 128
#: Inches that one picture of a movie takes at least and at most, and all of them about.
SMALLEST, LARGEST, ALL = 1.4, 2.4, (10.0, 8.0)
#: Inches of a movie: between pictures, below them, of a line of words, of the angles at the left
#: and of the colour bar at the right.
GAP, FOOT, LINE, ANGLES, BAR = 0.06, 0.12, 0.19, 0.55, 0.95


@checked_call
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
        Title to phase (time, angle, y, x), or what else is to be drawn so: axes in any order,
        coordinates and phase in the units that they note.
    frames : sequence of (int, int)
        (time, angle) numbers of the frames to show.
    limits : tuple of float, optional
        Phase in radians at the ends of the colour scale; default: all that is shown.

    Returns
    -------
    matplotlib.figure.Figure
        All pictures on one colour scale; `napari_phase4d.io.write_figure` saves it.

    Raises
    ------
    ValueError
        If there is nothing to show, a stack has no such frame, or the limits do not rise.
    """
    from matplotlib.figure import Figure

    if not columns or len(frames) == 0:
        msg = "columns and frames must name something to show, but one of them is empty"
        raise ValueError(msg)
    stacks = {title: to_draw(stack, title) for title, stack in columns.items()}
    for title, stack in stacks.items():
        check_frames(frames, stack, title)
    check_limits(limits)
    first = next(iter(stacks.values()))
    rows, n_columns = len(frames), len(columns)
    figure = Figure(figsize=(CELL * n_columns + 1.2, CELL * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, n_columns, squeeze=False)
    pictures = [frame_of(s, t, a) for s in stacks.values() for t, a in frames]
    low, high = limits or phase_limits(pictures)
    colours = phase_scale(low, high)
    for row, (t, a) in enumerate(frames):
        for column, (title, stack) in enumerate(stacks.items()):
            axis = axes[row, column]
            image = axis.imshow(
                frame_of(stack, t, a), vmin=low, vmax=high, cmap=colours, extent=extent_of(stack)
            )
            axis.set_xticks([])
            axis.set_yticks([])
            if row == 0:
                axis.set_title(title, fontsize=9)
            if column == 0:
                axis.set_ylabel(f"{view_of(first, a)}\n{time_label(first, t)}", fontsize=8)
    add_scale_bar(axes[0, 0], first)
    figure.colorbar(image, ax=axes, label="phase (rad)", shrink=0.8)
    return figure


def to_draw(stack: xr.DataArray, title: str) -> xr.DataArray:
    """Return a stack (time, angle, y, x) with coordinates in the usual units, phase in radians.

    What is no phase, as a map of confidence, stays as it is.
    """
    missing = [axis for axis in AXES if axis not in stack.dims]
    found = in_units(stack, title).expand_dims(missing).transpose(*AXES)
    units = stack.attrs.get("units")
    factor = factor_to(units, "rad") if isinstance(units, str) else None
    return found if factor in (None, 1.0) else found.copy(data=found.data * np.float32(factor))


def check_frames(frames: Sequence[tuple[int, int]], stack: xr.DataArray, title: str) -> None:
    """Refuse frames (time, angle) that a stack has not."""
    n_times, n_angles = stack.sizes["time"], stack.sizes["angle"]
    for time, angle in frames:
        if not (-n_times <= time < n_times and -n_angles <= angle < n_angles):
            msg = (
                f"frames must be (time, angle) below ({n_times}, {n_angles}), which {title} has, "
                f"but one is ({time}, {angle})"
            )
            raise ValueError(msg)


def check_limits(limits: tuple[float, float] | None) -> None:
    """Refuse ends of the colour scale that do not rise."""
    if limits is not None and not -math.inf < limits[0] < limits[1] < math.inf:
        msg = f"limits must be two finite numbers that rise, but are {shown(limits)}"
        raise ValueError(msg)


def add_scale_bar(axis: Axes, stack: xr.DataArray) -> None:
    """Draw a bar of a round length into the lower right corner, where pixels have a size."""
    from matplotlib.font_manager import FontProperties
    from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

    if stack["x"].attrs.get("units") != "um":
        return
    _, width, height, _ = extent_of(stack)
    length = round_length(SCALE_BAR * width)
    looks = {"color": "white", "frameon": False, "fontproperties": FontProperties(size=7)}
    size = {"pad": 0.3, "sep": 2, "size_vertical": 0.01 * height}
    words = f"{length:g} µm"
    axis.add_artist(AnchoredSizeBar(axis.transData, length, words, "lower right", **size, **looks))


def round_length(most: float) -> float:
    """Return the largest of 1, 2, 5, 10, 20, 50, ... that is no larger.

    Examples
    --------
    >>> round_length(7.3), round_length(0.3), round_length(20)
    (5.0, 0.2, 20.0)
    """
    decade = 10.0 ** math.floor(math.log10(most))
    return float(max(n * decade for n in (1, 2, 5) if n * decade <= most * (1 + 1e-9)))


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


@checked_call
def movie_frames(
    columns: Mapping[str, xr.DataArray], limits: tuple[float, float], *, title: str = ""
) -> Iterator[NDArray[np.uint8]]:
    """Draw stacks over time: one column a stack, one row a viewing angle.

    Parameters
    ----------
    columns : mapping of str to DataArray
        Name to phase (time, angle, y, x), or what else is to be drawn so, each with the same times
        and as many angles; in the units that it notes.
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
        If there are no stacks, they differ in their number of times or angles, or the limits do
        not rise.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    stacks = checked_stacks(columns)
    check_limits(limits)
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
    images, colours = [], phase_scale(*limits)
    for row in range(grid.n_rows):
        for column, stack in enumerate(stacks):
            axis = figure.add_axes(grid.place(row, column))
            axis.set_axis_off()
            axis.set_title(titles[column] if row == 0 else "", fontsize=9, pad=3)
            image = axis.imshow(
                stack.values[0, row],
                vmin=limits[0],
                vmax=limits[1],
                cmap=colours,
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
    stacks = [in_memory(to_draw(stack, name)) for name, stack in columns.items()]
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
    found = {view_of(stack, row).replace(", ", "\n") for stack in stacks}
    return found.pop() if len(found) == 1 else ""


def extent_of(stack: xr.DataArray) -> tuple[float, float, float, float]:
    """Return the edges of a frame in micrometres, as matplotlib wants them."""
    width, height = (length_of(stack[axis].values) for axis in ("x", "y"))
    return (0.0, width, height, 0.0)


def length_of(places: NDArray[Any]) -> float:
    """Return how far even places reach from edge to edge; 1 for a single one."""
    n = len(places)
    return abs(float(places[-1] - places[0])) * n / (n - 1) or 1.0 if n > 1 else 1.0


#: Seconds from which on times are told in minutes; digits that they have at least and at most.
LONG_S, FEWEST, MOST = 600, 3, 12


def time_label(stack: xr.DataArray, t: int) -> str:
    """Return the time of a frame, in minutes where a recording lasts some.

    It has as many digits as tell following frames apart.
    """
    times, unit = np.asarray(stack["time"].values, dtype=np.float64), "s"
    if np.abs(times).max() >= LONG_S:
        times, unit = times / 60, "min"
    steps = np.abs(np.diff(times))
    finest = min(float(np.median(steps[steps > 0])), 1.0) if steps.any() else 1.0
    digits = math.ceil(math.log10(max(np.abs(times).max() / finest, 1.0))) + 1
    return f"t = {times[t]:.{min(max(digits, FEWEST), MOST)}g} {unit}"


#: Name under which the truth is shown.
EXACT = "exact"


@checked_call
def named_results(
    comparison: Comparison, truth: xr.DataArray | None = None
) -> dict[str, xr.DataArray]:
    """Return the truth, where it is known, and every result by the name of its method.

    Parameters
    ----------
    comparison : Comparison
        Results and their table, as `napari_phase4d.compare` gives them.
    truth : xarray.DataArray, optional
        Exact phase in radians.

    Returns
    -------
    dict of str to DataArray
        Phase in radians by short name, such as "T/A"; the truth comes first, as "exact".
    """
    labels = comparison.table["method"]
    named = {str(labels[method]): result for method, result in comparison.results.items()}
    return named if truth is None else {EXACT: truth, **named}


@checked_call
def telling_frames(
    phase: xr.DataArray, boundary: tuple[int, int], also: tuple[int, int] | None = None
) -> list[tuple[int, int]]:
    """Return frames worth a picture: the thin one, half way, and the last from both ends.

    Parameters
    ----------
    phase : xarray.DataArray
        Any of the stacks, dims (time, angle, y, x).
    boundary : tuple of int
        The optically thin frame (time, angle); negative numbers count from the end.
    also : tuple of int, optional
        One more frame, such as the one on screen, instead of the one half way.

    Returns
    -------
    list of (int, int)
        Frame numbers (time, angle) from 0, at most four, each once.
    """
    last, far, (t, a) = phase.sizes["time"] - 1, phase.sizes["angle"] - 1, boundary
    frames = [(t % (last + 1), a % (far + 1)), also or (last // 2, 0), (last, 0), (last, far)]
    return list(dict.fromkeys(frames))
