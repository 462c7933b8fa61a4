"""Figures and movies of recordings and results, and colours that are told apart everywhere."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.analysis import Comparison, frame_of, in_memory
from napari_phase4d.later import xr
from napari_phase4d.stacks import in_all_axes
from napari_phase4d.words import checked_call, shown, view_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

__all__ = [
    "CURVE_COLOURS",
    "EXACT",
    "OBJECT_COLOUR",
    "Circle",
    "colour_of",
    "comparison_figure",
    "look_figure",
    "movie_frames",
    "named_results",
    "phase_colours",
    "phase_limits",
    "safety_colours",
    "telling_frames",
]

#: Told apart by colour-blind people, and readable on dark and on light (after Okabe & Ito).
CURVE_COLOURS = ("#3a9bdc", "#e08a00", "#009e73", "#cc6fa3", "#d9541e", "#7f7fd5")
#: Likewise, for many cells.
CELL_COLOURS = (*CURVE_COLOURS, "#b5a642", "#46c7c7", "#a8763e", "#8fbf3f")
#: Line round the object; none of the colours of wrapped phase.
OBJECT_COLOUR = "#2ee66b"
#: Colours in a scale.
N_COLOURS = 256
#: A scale bar takes at most this share of a picture's width.
SCALE_BAR = 0.3
#: Phase below zero, from zero on: as dark at zero as inferno, which is above it, then light blue.
BELOW_ZERO = ((0.0, 0.0, 0.016), (0.04, 0.13, 0.42), (0.1, 0.42, 0.75), (0.8, 0.96, 1.0))
#: Safety goes by the score to this power: most scores are near 1, and a frame of 0.7, wrong on
#: nearly a third of the object, must not look safe.
SAFETY_POWER = 3


@checked_call
def colour_of(cell: int) -> str:
    """Return the colour of a cell, from 1: the same in picture, curve and table.

    Parameters
    ----------
    cell : int
        Number of the cell, as `napari_phase4d.analysis.find_cells` gives it.

    Returns
    -------
    str
        Red, green and blue, such as "#b5a642". After the last colour the first comes again.
    """
    return CELL_COLOURS[(cell - 1) % len(CELL_COLOURS)]


@checked_call
def phase_colours(low: float, high: float) -> NDArray[np.float64]:
    """Return the colours of unwrapped phase between two limits; zero is always black.

    Above zero they are those of inferno, below it blue, so that colour-blind people tell them
    apart, and equally far from zero they are about equally light.

    Parameters
    ----------
    low, high : float
        Phase at the ends of the scale, in radians.

    Returns
    -------
    ndarray, shape (256, 4)
        Red, green, blue and opacity, 0 to 1.

    Examples
    --------
    >>> float(phase_colours(0, 12)[0].max()), float(phase_colours(-12, 0)[-1, :3].max() < 0.02)
    (1.0, 1.0)
    """
    value = np.linspace(low, high, N_COLOURS)
    share = value / max(abs(low), abs(high), np.finfo(float).tiny)
    above = named_colours("inferno")
    place = np.abs(share) * (N_COLOURS - 1)
    table = np.ones((N_COLOURS, 4))
    below = np.linspace(0, N_COLOURS - 1, len(BELOW_ZERO))
    for channel in range(3):
        up = np.interp(place, np.arange(N_COLOURS), above[:, channel])
        down = np.interp(place, below, [colour[channel] for colour in BELOW_ZERO])
        table[:, channel] = np.where(share >= 0, up, down)
    return table


def safety_colours(scores: ArrayLike) -> NDArray[np.float64]:
    """Return the colours of scores from 0, unsafe, to 1, safe; brighter is safer (viridis).

    Parameters
    ----------
    scores : array_like
        Numbers from 0 to 1.

    Returns
    -------
    ndarray, shape (..., 4)
        Red, green, blue and opacity, 0 to 1.

    Examples
    --------
    >>> light = safety_colours([0, 0.5, 1])[:, :3].sum(axis=1)
    >>> bool(light[0] < light[1] < light[2])
    True
    """
    level = np.clip(np.asarray(scores, dtype=np.float64), 0, 1) ** SAFETY_POWER
    return named_colours("viridis")[np.round((N_COLOURS - 1) * level).astype(np.intp)]


@cache
def named_colours(name: str) -> NDArray[np.float64]:
    """Return the 256 colours of one of matplotlib's scales."""
    from matplotlib import colormaps

    table: NDArray[np.float64] = colormaps[name](np.linspace(0, 1, N_COLOURS))
    return table


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
        Title to phase (time, angle, y, x), in the units that it notes.
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
        If there is nothing to show, a stack is no phase or has no such frame, or the limits do not
        rise.
    """
    from matplotlib.figure import Figure

    if not columns or len(frames) == 0:
        msg = "columns and frames must name something to show, but one of them is empty"
        raise ValueError(msg)
    stacks = {title: in_all_axes(stack, title) for title, stack in columns.items()}
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
        Name to phase (time, angle, y, x), in the units that it notes, each with the same times and
        as many angles.
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
        If there are no stacks, one is no phase, they differ in their number of times or angles, or
        the limits do not rise.
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
    stacks = [in_memory(in_all_axes(stack, name)) for name, stack in columns.items()]
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


@checked_call
def phase_limits(stacks: Sequence[NDArray[np.floating]]) -> tuple[float, float]:
    """Return the range of phase of several pictures, without a few extreme pixels and NaN.

    Parameters
    ----------
    stacks : sequence of ndarray
        Pictures in radians, of any shape.

    Returns
    -------
    low, high : float
        Radians: a thousandth of the known pixels lie below, half a thousandth above. -pi and pi if
        no pixel is known.
    """
    shown = np.concatenate([np.ravel(s) for s in stacks])
    low, high = shares_of(shown, (0.001, 0.9995), (-np.pi, np.pi))
    return low, high


def phase_scale(low: float, high: float) -> Colormap:
    """Return `phase_colours` as matplotlib wants them."""
    from matplotlib.colors import ListedColormap

    return ListedColormap(phase_colours(low, high), name="phase")


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


#: Inches of one picture, and of the words below them, a line; letters that fit in one.
LOOK_CELL, LOOK_LINE, LOOK_LETTERS = 3.0, 0.2, 140
#: Inches that stay empty on the left and on the right.
MARGIN = 0.1
#: Rows and columns of a hologram that are shown at the camera's own resolution, so that the
#: fringes can be seen.
DETAIL = 64
#: Of the spectrum, this share of the weakest frequencies is black.
DARKEST = 0.5


@dataclass(frozen=True)
class Circle:
    """A lobe as it is drawn on the spectrum: ``(ky, kx)`` and radius in cycles per pixel.

    Parameters
    ----------
    centre : tuple of float
        Where the lobe lies, ``(ky, kx)`` in cycles per camera pixel.
    radius : float
        How far it reaches, in cycles per camera pixel.
    """

    centre: tuple[float, float]
    radius: float


@checked_call
def look_figure(
    hologram: NDArray[Any],
    spectrum: xr.DataArray,
    circles: Sequence[Circle],
    data: xr.Dataset,
    unwrapped: xr.DataArray,
    *,
    title: str = "",
    words: Sequence[str] = (),
) -> Figure:
    """Draw a hologram, its spectrum with the lobes, and what each view shows of one frame.

    Parameters
    ----------
    hologram : ndarray of shape (y, x)
        Grey values.
    spectrum : xarray.DataArray
        Power, dims (ky, kx) in cycles per pixel.
    circles : sequence of Circle
        The lobes, in the order of the views of ``data``.
    data : xarray.Dataset
        ``phase`` wrapped and ``amplitude``, dims (time, angle, y, x); the first time is shown.
    unwrapped : xarray.DataArray
        Unwrapped phase of the first time, same dims.
    title : str, optional
        What stands above.
    words : sequence of str, optional
        Lines that stand below.

    Returns
    -------
    matplotlib.figure.Figure
        The first row is the hologram, a detail of it and the spectrum; then one row a view with
        amplitude, wrapped and unwrapped phase.
    """
    from matplotlib.figure import Figure

    n_views = data.sizes["angle"]
    height, width = hologram.shape
    cell = LOOK_CELL * min(height / width, 1.4)
    lines = [line for each in words for line in textwrap.wrap(each, LOOK_LETTERS)]
    foot = LOOK_LINE * (len(lines) + 1)
    size = (3 * (LOOK_CELL + 0.7), (1 + n_views) * (cell + 0.35) + foot + 0.3)
    figure = Figure(figsize=size)
    bottom = foot / size[1]
    side = MARGIN / size[0]
    figure.set_layout_engine("constrained", rect=(side, bottom, 1 - 2 * side, 1 - bottom))
    axes = figure.subplots(1 + n_views, 3, squeeze=False)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    show_hologram(axes[0, 0], axes[0, 1], hologram)
    show_spectrum(axes[0, 2], spectrum, circles)
    for view, row in enumerate(axes[1:]):
        show_view(figure, row, data, unwrapped, view)
    figure.suptitle(title, fontsize=11)
    figure.text(0.02, 0.3 * LOOK_LINE / size[1], "\n".join(lines), fontsize=9, va="bottom")
    return figure


def show_hologram(whole: Any, detail: Any, hologram: NDArray[Any]) -> None:
    """Draw a hologram, and its middle magnified, in grey."""
    low, high = np.quantile(hologram, (0.001, 0.999))
    scale = {"cmap": "gray", "vmin": low, "vmax": max(high, low + 1e-6)}
    whole.imshow(hologram, **scale)
    whole.set_title(f"hologram, {hologram.shape[1]} × {hologram.shape[0]}", fontsize=9)
    part = tuple(slice(max(n // 2 - DETAIL // 2, 0), n // 2 + DETAIL // 2) for n in hologram.shape)
    detail.imshow(hologram[part], interpolation="nearest", **scale)
    detail.set_title("its middle, magnified", fontsize=9)


def show_spectrum(axis: Any, spectrum: xr.DataArray, circles: Sequence[Circle]) -> None:
    """Draw the power spectrum on a logarithmic scale, with a numbered circle on each lobe."""
    from matplotlib.patches import Circle as Patch

    power = 10 * np.log10(np.maximum(spectrum.values, np.finfo(np.float32).tiny))
    ky, kx = spectrum["ky"].values, spectrum["kx"].values
    axis.imshow(
        power,
        cmap="magma",
        vmin=float(np.quantile(power, DARKEST)),
        vmax=float(np.quantile(power, 0.9999)),
        extent=(kx[0], kx[-1], ky[-1], ky[0]),
        aspect="auto",
    )
    for number, circle in enumerate(circles, start=1):
        y, x = circle.centre
        axis.add_patch(Patch((x, y), circle.radius, fill=False, edgecolor="cyan"))
        top = (x, y - 1.1 * circle.radius)
        axis.annotate(str(number), top, color="cyan", ha="center", va="bottom", fontsize=10)
    axis.set_title("spectrum (dB), lobes found", fontsize=9)


def show_view(
    figure: Figure, row: Sequence[Any], data: xr.Dataset, unwrapped: xr.DataArray, view: int
) -> None:
    """Draw amplitude, wrapped and unwrapped phase of a view."""
    stacks = (data["amplitude"], data["phase"], unwrapped)
    amplitude, wrapped, height = (stack.values[0, view] for stack in stacks)
    low, high = shares_of(height, (0.002, 0.998), (-np.pi, np.pi))
    (bright,) = shares_of(amplitude, (0.99,), (1.0,))
    pictures: list[tuple[str, NDArray[Any], dict[str, Any]]] = [
        ("amplitude", amplitude, {"cmap": "gray", "vmin": 0, "vmax": bright}),
        ("wrapped phase (rad)", wrapped, {"cmap": "twilight", "vmin": -np.pi, "vmax": np.pi}),
        (
            "unwrapped phase (rad)",
            height,
            {"cmap": phase_scale(low, high), "vmin": low, "vmax": high},
        ),
    ]
    for axis, (name, image, scale) in zip(row, pictures, strict=True):
        shown = axis.imshow(image, **scale)
        axis.set_title(name, fontsize=9)
        figure.colorbar(shown, ax=axis, shrink=0.8)
    called = view_of(data, view, f"view {view + 1}, ")
    row[0].set_ylabel(called, fontsize=9)


def shares_of(
    picture: NDArray[Any], shares: tuple[float, ...], unknown: tuple[float, ...]
) -> tuple[float, ...]:
    """Return quantiles of the pixels that are known, or others where none is."""
    known = picture[np.isfinite(picture)]
    return tuple(float(v) for v in np.quantile(known, shares)) if known.size else unknown


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
