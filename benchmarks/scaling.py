"""How cost grows with the size of a recording, and what the first use costs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from measuring import median_seconds, peak_bytes
from scenes import moving_cells

import napari_phase4d as p4d

METHODS = ("spatial-2d", "temporal-angular", "laplacian", "region-growing", "directional-l1")
#: (time, angle, y, x) that the others are multiples of.
SMALLEST = (8, 3, 128, 128)
NOISE = 0.5
YTICKS = (10, 20, 50, 100, 200, 500, 1000)
PICTURE = Path(__file__).parents[1] / "docs" / "pictures" / "speed_growth.png"


def grown_shapes() -> dict[str, list[tuple[int, ...]]]:
    t, a, y, x = SMALLEST
    return {
        "time": [(n * t, a, y, x) for n in (1, 2, 4)],
        "angle": [(t, n * a, y, x) for n in (1, 2, 4)],
        "pixels": [(t, a, y, x), (t, a, 2 * y, x), (t, a, 2 * y, 2 * x)],
    }


def growth_lines() -> Iterator[str]:
    """Seconds a voxel at one, two and four times the size, as a share of the first."""
    yield "| method | grows in | ns a voxel at 1x | 2x | 4x | bytes a voxel at 1x | 4x |"
    yield "|---|---|---|---|---|---|---|"
    points: dict[str, dict[str, list[float]]] = {}
    for method in METHODS:
        for dim, shapes in grown_shapes().items():
            costs, memory = [], []
            for shape in shapes:
                volume = grown_volume(shape)
                p4d.unwrap(volume[:2], method)
                p4d.unwrap(volume, method)
                seconds = median_seconds(partial(p4d.unwrap, volume, method))
                costs.append(1e9 * seconds / volume.size)
                memory.append(peak_bytes(partial(p4d.unwrap, volume, method)) / volume.size)
            points.setdefault(method, {})[dim] = costs
            shares = " | ".join(f"{c / costs[0]:.2f} times" for c in costs[1:])
            yield (
                f"| {p4d.METHODS[method].label} | {dim} | {costs[0]:.0f} | {shares} "
                f"| {memory[0]:.0f} | {memory[2]:.0f} |"
            )
    draw_growth(points)


def grown_volume(shape: tuple[int, ...]) -> np.ndarray:
    """Return cells of the same size in pixels, side by side in larger frames."""
    size = SMALLEST[3]
    tile = moving_cells(shape[0], shape[1], size, NOISE)
    return np.tile(tile, (1, 1, shape[2] // size, shape[3] // size))


def draw_growth(points: dict[str, dict[str, list[float]]]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    for ax, dim in zip(axes, ("time", "angle", "pixels"), strict=True):
        for method, costs in points.items():
            ax.plot((1, 2, 4), costs[dim], "o-", label=p4d.METHODS[method].label)
        ax.set(xscale="log", yscale="log", xticks=(1, 2, 4), xticklabels=("1x", "2x", "4x"))
        ax.set(yticks=YTICKS, yticklabels=YTICKS, ylim=(YTICKS[0], YTICKS[-1]))
        ax.set_title(f"longer in {dim}" if dim != "pixels" else "more pixels")
        ax.minorticks_off()
    axes[0].set_ylabel("ns a voxel")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    figure.savefig(PICTURE, dpi=110)


SCRIPTS = {
    "import napari_phase4d": "import napari_phase4d",
    "... and unwrap() a frame of 64 x 64 (T/A)": (
        "import numpy as np, napari_phase4d as p4d; "
        "p4d.unwrap(np.random.default_rng(0).uniform(-3, 3, (2, 2, 64, 64)), 'temporal-angular')"
    ),
    "... and by all methods": (
        "import numpy as np, napari_phase4d as p4d; "
        "p4d.compare(np.random.default_rng(0).uniform(-3, 3, (3, 2, 40, 40)))"
    ),
}


def first_use_lines() -> Iterator[str]:
    """Seconds of a fresh interpreter, before and after the kernels have been compiled once."""
    yield "| a fresh Python | first time (s), measured once | later (s) |"
    yield "|---|---|---|"
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}

        def run(script: str) -> None:
            subprocess.run([sys.executable, "-c", script], check=True, env=environment)

        for what, script in SCRIPTS.items():
            first = median_seconds(partial(run, script), 1)
            yield f"| {what} | {first:.1f} | {median_seconds(partial(run, script)):.1f} |"
