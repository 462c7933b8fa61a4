"""Pictures of results side by side, after the paper's Figs. 2 and 4."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["comparison_figure", "movie_frames", "phase_limits"]

#: Inches that one picture takes.
CELL = 1.7
#: Pixels of a movie an inch.
MOVIE_DPI = 100
COLOURS = "turbo"


def comparison_figure(
    columns: Mapping[str, xr.DataArray],
    frames: Sequence[tuple[int, int]],
    path: str | Path | None = None,
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
    path : str or Path, optional
        Where to save it; the ending chooses the format.
    limits : tuple of float, optional
        Phase in radians at the ends of the colour scale; default: all that is shown.

    Returns
    -------
    matplotlib.figure.Figure
        All pictures on one colour scale.
    """
    from matplotlib.figure import Figure

    first = next(iter(columns.values()))
    rows, n_columns = len(frames), len(columns)
    figure = Figure(figsize=(CELL * n_columns + 1.2, CELL * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, n_columns, squeeze=False)
    shown = [s.values[t, a] for s in columns.values() for t, a in frames]
    low, high = limits or phase_limits(shown)
    for row, (t, a) in enumerate(frames):
        for column, (title, stack) in enumerate(columns.items()):
            axis = axes[row, column]
            image = axis.imshow(
                stack.values[t, a], vmin=low, vmax=high, cmap=COLOURS, extent=extent_of(first)
            )
            axis.set_xticks([])
            axis.set_yticks([])
            if row == 0:
                axis.set_title(title, fontsize=9)
            if column == 0:
                label = f"{float(first['angle'][a]):g}°\n{time_label(first, t)}"
                axis.set_ylabel(label, fontsize=8)
    figure.colorbar(image, ax=axes, label="phase (rad)", shrink=0.8)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure


def movie_frames(
    stack: xr.DataArray, title: str, limits: tuple[float, float]
) -> Iterator[NDArray[np.uint8]]:
    """Draw a stack over time, all viewing angles next to each other.

    Parameters
    ----------
    stack : xarray.DataArray
        Phase (time, angle, y, x) in radians.
    title : str
        What it shows.
    limits : tuple of float
        Phase in radians at the ends of the colour scale.

    Yields
    ------
    ndarray of uint8, shape (height, width, 3)
        One picture a time.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    n_angles = stack.sizes["angle"]
    figure = Figure(figsize=(CELL * n_angles + 1.0, CELL + 0.7), dpi=MOVIE_DPI)
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(1, n_angles, squeeze=False)[0]
    figure.subplots_adjust(left=0.01, right=0.86, top=0.72, bottom=0.03, wspace=0.05)
    images = []
    for a, axis in enumerate(axes):
        axis.set_axis_off()
        axis.set_title(f"{float(stack['angle'][a]):g}°", fontsize=9)
        frame = stack.values[0, a]
        images.append(
            axis.imshow(
                frame, vmin=limits[0], vmax=limits[1], cmap=COLOURS, extent=extent_of(stack)
            )
        )
    bar = figure.add_axes((0.88, 0.08, 0.02, 0.6))
    figure.colorbar(images[-1], cax=bar, label="rad")
    heading = figure.suptitle("", fontsize=10, animated=True)
    canvas.draw()
    # What stays the same is drawn once.
    still = canvas.copy_from_bbox(figure.bbox)
    for t in range(stack.sizes["time"]):
        canvas.restore_region(still)
        heading.set_text(f"{title}, {time_label(stack, t)}")
        figure.draw_artist(heading)
        for a, image in enumerate(images):
            image.set_data(stack.values[t, a])
            axes[a].draw_artist(image)
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def phase_limits(stacks: Sequence[NDArray[np.floating]]) -> tuple[float, float]:
    """Return the range of phase of several pictures, without a few extreme pixels."""
    shown = np.concatenate([np.ravel(s) for s in stacks])
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
