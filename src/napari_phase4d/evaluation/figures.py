"""Pictures of results side by side, after the paper's Figs. 2 and 4."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["comparison_figure"]

#: Inches that one picture takes.
CELL = 1.7


def comparison_figure(
    columns: Mapping[str, xr.DataArray],
    frames: Sequence[tuple[int, int]],
    path: str | Path | None = None,
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
    shown = np.concatenate([s.values[t, a].ravel() for s in columns.values() for t, a in frames])
    low, high = (float(v) for v in np.quantile(shown, (0.001, 0.9995)))
    extent = (0.0, float(first["x"][-1]), float(first["y"][-1]), 0.0)
    for row, (t, a) in enumerate(frames):
        for column, (title, stack) in enumerate(columns.items()):
            axis = axes[row, column]
            image = axis.imshow(
                stack.values[t, a], vmin=low, vmax=high, cmap="turbo", extent=extent
            )
            axis.set_xticks([])
            axis.set_yticks([])
            if row == 0:
                axis.set_title(title, fontsize=9)
            if column == 0:
                label = f"{float(first['angle'][a]):g}°\nt = {float(first['time'][t]):.3g} s"
                axis.set_ylabel(label, fontsize=8)
    figure.colorbar(image, ax=axes, label="phase (rad)", shrink=0.8)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure
