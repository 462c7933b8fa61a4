"""The paper's Fig. 1, from what the program does: which frame is unwrapped from which."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from napari_phase4d.unwrapping.combined import follow_line
from napari_phase4d.unwrapping.four_d import angular_temporal, lines_along, temporal_angular

from napari_phase4d.simulation import budding_yeast
from picture_making.saving import save_figure

Frame = tuple[int, int]

BOUNDARY = (0, 0)
ORDERS = {
    "(a)  T/A: along time, then along the angle": temporal_angular,
    "(b)  A/T: along the angle, then along time": angular_temporal,
}
#: Every third minute of the yeast, and four of its six views.
FRAMES = {"time": slice(0, 18, 3), "angle": [0, 2, 3, 5]}
#: The part of the field in which the yeast is.
FIELD = {"y": slice(1, 36), "x": slice(7, 42)}
#: Side of a frame; frames are 1 apart, and arrows go from one to the next.
SIDE = 0.7
BLUE, PALE_BLUE, RED = "#1f5fd0", "#a9c3f2", "#d0312d"


@dataclass
class Watched:
    """A line of maps that notes in which order they are unwrapped.

    It has the form that `follow_line` asks for; of the maps only the order matters here.
    """

    n_maps: int
    order: list[int] = field(default_factory=list)

    def __len__(self) -> int:
        return self.n_maps

    def given(self, k: int) -> tuple[Any, Any, Any]:
        """Return wrapped phase, initial phase and mask of a map of one pixel."""
        return np.zeros((1, 1), np.float32), np.zeros((1, 1), np.float32), np.ones((1, 1), bool)

    def room(self, k: int) -> Any:
        """Return where the map goes."""
        return np.empty((1, 1), np.float32)

    def done(self, k: int, values: Any) -> None:
        """Note that a map has been unwrapped."""
        self.order.append(k)


def steps_of(order: tuple[str, ...], shape: tuple[int, int]) -> Iterator[tuple[int, Frame, Frame]]:
    """Yield pass, frame that is unwrapped from, and frame that is unwrapped."""
    for number, dim in enumerate(order, start=1):
        for index, starts in lines_along(dim, (*shape, 1, 1), [BOUNDARY]):
            watched = Watched(shape[0] if dim == "time" else shape[1])
            follow_line(watched, starts, split=False)
            done: list[int] = []
            for k in watched.order:
                before = next((n for n in (k - 1, k + 1) if n in done), None)
                done.append(k)
                if before is not None:
                    yield number, on_line(index, before), on_line(index, k)


def on_line(index: tuple[Any, Any], k: int) -> Frame:
    """Return the k-th frame (time, angle) of a line."""
    t, a = (k if isinstance(part, slice) else int(part) for part in index)
    return t, a


def figure_1(wanted: set[str]) -> None:
    """Draw both orders side by side over frames of the budding yeast."""
    wrapped = budding_yeast()["wrapped"].isel(FRAMES | FIELD)
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    for axis, (title, method) in zip(figure.subplots(1, 2), ORDERS.items(), strict=True):
        show_frames(axis, wrapped)
        for number, start, end in steps_of(method.keywords["order"], wrapped.shape[:2]):
            show_step(axis, number, start, end, method.keywords["order"])
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
