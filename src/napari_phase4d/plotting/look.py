"""The figure of what a recording holds: a hologram, its spectrum with the lobes, the views."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.plotting.colours import phase_scale, shares_of
from napari_phase4d.words import checked_call, view_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


__all__ = [
    "Circle",
    "look_figure",
]

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
