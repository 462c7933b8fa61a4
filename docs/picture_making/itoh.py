"""Itoh's condition along one line: where it holds, and where it does not."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import napari_phase4d as p4d
from napari_phase4d.analysis import itoh_margin
from napari_phase4d.simulation.ellipsoids import wrap
from picture_making.saving import save_figure

#: Height of the object in radians, and the width of its steeper edge in pixels.
OBJECTS = {
    "every step is below half a turn: right": (11.0, 3.0),
    "one step is larger: wrong from there on": (11.0, 0.5),
}
N_PIXELS, LEFT_EDGE, RIGHT_EDGE, GENTLE = 48, 13.0, 34.5, 3.0
#: Empty pixels at the left that are not shown. The level of a frame is that of its border; of a
#: line all pixels are border, so that most of them must lie before the object.
BEFORE = 2 * N_PIXELS
TICKS = {-1: "−π", 0: "0", 1: "π", 2: "2π", 4: "4π"}


def figure_of_itoh(wanted: set[str]) -> None:
    """Draw true, wrapped and unwrapped phase along a line, and its steps."""
    figure = Figure(figsize=(9.5, 5.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=(1.7, 1))
    for column, (title, (height, width)) in enumerate(OBJECTS.items()):
        true = line(height, width)
        wrapped = wrap(true)
        found = p4d.unwrap(wrapped, "spatial-2d")
        show_phases(axes[0, column], true, wrapped, found)
        axes[0, column].set_title(title, fontsize=10)
        show_steps(axes[1, column], true)
    axes[0, 0].set_ylabel("phase (rad)")
    axes[1, 0].set_ylabel("step to a neighbour\n(half turns)")
    axes[0, 0].set_yticks([np.pi * n for n in TICKS], list(TICKS.values()))
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    save_figure(figure, *wanted)


def line(height: float, right_width: float) -> xr.DataArray:
    """Return an object along one line: up gently, and down as gently as is asked for."""
    x = np.arange(-BEFORE, N_PIXELS, dtype=np.float64)
    up = 1 / (1 + np.exp(-(x - LEFT_EDGE) / GENTLE))
    down = 1 / (1 + np.exp((x - RIGHT_EDGE) / right_width))
    phase = (height * up * down).astype(np.float32)
    return xr.DataArray(phase[None], dims=("y", "x"))


def show_phases(axis: Any, true: xr.DataArray, wrapped: xr.DataArray, found: xr.DataArray) -> None:
    """Draw the three phases of a line."""
    axis.axhspan(-np.pi, np.pi, color="0.94", zorder=0)
    axis.plot(true[0, BEFORE:], color="0.65", lw=6, label="true", solid_capstyle="round")
    axis.plot(wrapped[0, BEFORE:], "o", color="C0", ms=3.5, label="wrapped")
    axis.plot(found[0, BEFORE:], color="C3", lw=1.5, label="unwrapped")


def show_steps(axis: Any, true: xr.DataArray) -> None:
    """Draw how large the steps are, as a share of the largest that can be unwrapped."""
    margin = itoh_margin(true)["along_x"][0, BEFORE:]
    beyond = margin > 1
    x = np.arange(margin.size)
    axis.axhline(1, color="0.4", lw=0.8, ls="--")
    axis.bar(x[~beyond], margin[~beyond], color="C0", width=0.8)
    axis.bar(x[beyond], margin[beyond], color="C3", width=0.8)
    axis.annotate(
        "half a turn", (0, 1), (0, 3), textcoords="offset points", fontsize=8, color="0.3"
    )
    axis.set_xlabel("pixel")
