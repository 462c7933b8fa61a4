"""The paper's Fig. 1, from what the program does: which frame is unwrapped from which."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from napari_phase4d.simulation import budding_yeast
from napari_phase4d.unwrapping import ORDERS
from napari_phase4d.unwrapping.chain import Line, Maps, starts_on, unwrap_line
from picture_making.saving import save_figure

Frame = tuple[int, int]

BOUNDARY = (0, 0)
METHODS = {
    "(a)  T/A: along time, then along the angle": "temporal-angular",
    "(b)  A/T: along the angle, then along time": "angular-temporal",
}
#: A map of one pixel: here nothing but the order matters.
PIXEL = Maps(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.int16), np.ones((1, 1), dtype=bool))
#: Every third minute of the yeast, and four of its six views.
FRAMES = {"time": slice(0, 18, 3), "angle": [0, 2, 3, 5]}
#: The part of the field in which the yeast is.
FIELD = {"y": slice(1, 36), "x": slice(7, 42)}
#: Side of a frame; frames are 1 apart, and arrows go from one to the next.
SIDE = 0.7
BLUE, PALE_BLUE, RED = "#1f5fd0", "#a9c3f2", "#d0312d"


def steps_of(order: tuple[str, ...], shape: tuple[int, int]) -> Iterator[tuple[int, Frame, Frame]]:
    """Yield pass, frame that is unwrapped from, and frame that is unwrapped."""
    n_times, n_angles = shape
    for number, dim in enumerate(order, start=1):
        n_lines, length = (n_angles, n_times) if dim == "time" else (n_times, n_angles)
        for other in range(n_lines):
            done: list[int] = []
            for k in order_of(length, starts_on(dim, other, [BOUNDARY])):
                before = next((n for n in (k - 1, k + 1) if n in done), None)
                done.append(k)
                if before is not None:
                    frames = (on_line(dim, other, n) for n in (before, k))
                    yield number, next(frames), next(frames)


def order_of(n_maps: int, starts: list[int]) -> list[int]:
    """Return in which order the program unwraps the maps of a line."""
    order: list[int] = []
    line = Line(n_maps, lambda _: PIXEL, lambda k, _: order.append(k))
    unwrap_line(line, starts, split=False)
    return order


def on_line(dim: str, other: int, k: int) -> Frame:
    """Return the k-th frame (time, angle) of a line."""
    return (k, other) if dim == "time" else (other, k)


def figure_1(wanted: set[str]) -> None:
    """Draw both orders side by side over frames of the budding yeast."""
    wrapped = budding_yeast()["wrapped"].isel(FRAMES | FIELD)
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    for axis, (title, method) in zip(figure.subplots(1, 2), METHODS.items(), strict=True):
        show_frames(axis, wrapped)
        for number, start, end in steps_of(ORDERS[method], wrapped.shape[:2]):
            show_step(axis, number, start, end, ORDERS[method])
        axis.set_title(title, fontsize=11)
    figure.legend(handles=legend(), loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    save_figure(figure, *wanted)


def show_frames(axis: Axes, wrapped: xr.DataArray) -> None:
    """Draw wrapped phase of every frame, time to the right, angle upwards."""
    n_times, n_angles = wrapped.shape[:2]
    for t, a in np.ndindex(n_times, n_angles):
        half = SIDE / 2
        extent = (t - half, t + half, a - half, a + half)
        axis.imshow(wrapped[t, a], cmap="twilight_shifted", vmin=-np.pi, vmax=np.pi, extent=extent)
        thin = (t, a) == BOUNDARY
        edge = {"ec": "black", "lw": 4} if thin else {"ec": "0.5", "lw": 0.6}
        axis.add_patch(Rectangle((t - half, a - half), SIDE, SIDE, fill=False, **edge))
    axis.set_xlim(-0.5, n_times - 0.5)
    axis.set_ylim(-0.5, n_angles - 0.5)
    minutes = wrapped["time"].values / 60
    axis.set_xticks(range(n_times), [f"{m:g} min" for m in minutes])
    axis.set_yticks(range(n_angles), [f"{a:g}°" for a in wrapped["angle"].values])
    axis.tick_params(length=0)
    axis.spines[:].set_visible(False)
    axis.set_xlabel("time")
    axis.set_ylabel("viewing angle")


def show_step(axis: Axes, number: int, start: Frame, end: Frame, order: tuple[str, ...]) -> None:
    """Draw an arrow from one frame to the next, in the gap between them."""
    way = np.subtract(end, start)
    across = 1 if order[0] == "time" else 0
    needed = number == 2 or start[across] == BOUNDARY[across]
    colour = RED if number == 2 else BLUE if needed else PALE_BLUE
    middle = np.add(start, end) / 2
    reach = 0.21
    look = {"color": colour, "lw": 2.4 if needed else 1.6, "shrinkA": 0, "shrinkB": 0}
    axis.annotate(
        "",
        middle + reach * way,
        middle - reach * way,
        arrowprops={"arrowstyle": "-|>", "mutation_scale": 13, **look},
        zorder=4 if needed else 3,
    )


def legend() -> list[Any]:
    """Return what the marks mean."""
    return [
        Rectangle((0, 0), 1, 1, fc="none", ec="black", lw=3, label="thin frame: it starts here"),
        Line2D([], [], color=BLUE, lw=2.4, marker=">", label="first pass"),
        Line2D([], [], color=PALE_BLUE, lw=1.6, marker=">", label="first pass on other lines"),
        Line2D([], [], color=RED, lw=2.4, marker=">", label="second pass"),
    ]
