"""What each cell is at each time, seen from each angle: place, size, mass, and its error."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage
from skimage.measure import regionprops_table

from napari_phase4d.analysis.loading import parts_over_time
from napari_phase4d.optics import Optics
from napari_phase4d.progress import Watch

__all__ = ["table_of_cells"]

#: Sides in pixels of the squares of empty field by whose means the error of a sum is told, how
#: many of them there must be, and how far from cells they lie.
SQUARES, LEAST_SQUARES, AWAY = (1, 2, 4, 8, 16, 32), 6, 4
#: Of what so many pixels at the rim of a cell hold, this share is uncertain: where a cell ends is
#: a choice, and pixels are coarse.
RIM, RIM_SHARE = 3, 0.008
TURN = 2 * math.pi

Image = NDArray[np.floating]
Labels = NDArray[np.integer]


def table_of_cells(
    stack: xr.DataArray,
    labels: NDArray[Any],
    parents: dict[int, int],
    optics: Optics,
    *,
    sides_um: tuple[float, float],
    object_index: float | None,
    refraction_increment_ml_per_g: float,
    oblique: bool,
    confidence: NDArray[Any] | None,
    watch: Watch,
) -> pd.DataFrame:
    """Return a row for every cell in every frame, see `measure`."""
    places = {
        dim: np.asarray(stack[dim].values, dtype=np.float64)
        if dim in stack.coords
        else np.full(stack.sizes[dim], np.nan)
        for dim in ("time", "angle", "y", "x")
    }
    pixel_um2 = sides_um[0] * sides_um[1]
    frames = []
    for part, phase in parts_over_time(stack):
        for i, angle in np.ndindex(*phase.shape[:2]):
            watch.check()
            time = part.start + i
            of_frame = np.asarray(labels[time, angle])
            trust = None if confidence is None else np.asarray(confidence[time, angle])
            found = cells_of_frame(phase[i, angle], of_frame, trust)
            if len(found["cell"]):
                along = math.cos(math.radians(places["angle"][angle])) if oblique else 1.0
                found |= {
                    "time (s)": places["time"][time],
                    "angle (deg)": places["angle"][angle],
                    "frame": time,
                    "view": angle,
                    "along": along if math.isfinite(along) else 1.0,
                }
                frames.append(pd.DataFrame(found))
            watch.step()
    if not frames:
        msg = "there are no cells to measure; find some with find_cells()"
        raise ValueError(msg)
    table = pd.concat(frames, ignore_index=True)
    sums, errors = (table[c].to_numpy() * table["along"].to_numpy() for c in ("sum", "error"))
    area = table["count"].to_numpy() * pixel_um2
    increment = refraction_increment_ml_per_g
    mass = np.array([optics.dry_mass_pg(s, pixel_um2, increment) for s in sums])
    mean = sums / table["count"].to_numpy()
    columns: dict[str, Any] = {
        "cell": table["cell"],
        "parent": [parents.get(cell, 0) for cell in table["cell"]],
        "time (s)": table["time (s)"],
        "angle (deg)": table["angle (deg)"],
        "y (um)": [at(places["y"], y) for y in table["y"]],
        "x (um)": [at(places["x"], x) for x in table["x"]],
        "area (um^2)": area,
        "mean phase (rad)": mean,
        "largest phase (rad)": table["largest"].to_numpy() * table["along"].to_numpy(),
        "mean optical path difference (nm)": 1000 * optics.optical_path_um(mean),
        "dry mass (pg)": mass,
        "dry mass error (pg)": [optics.dry_mass_pg(e, pixel_um2, increment) for e in errors],
        "mass density (pg/um^2)": mass / area,
        "circularity": np.minimum(
            4 * math.pi * table["count"] / np.maximum(table["perimeter"], 1.0) ** 2, 1.0
        ),
    }
    if object_index is not None:
        columns["mean height (um)"] = optics.height_um(mean, object_index)
        columns["volume (um^3)"] = optics.height_um(sums, object_index) * pixel_um2
        columns["volume error (um^3)"] = np.abs(optics.height_um(errors, object_index)) * pixel_um2
    result = pd.DataFrame(columns)
    result.insert(6, "speed (um/s)", speeds(result))
    return result.sort_values(["cell", "time (s)", "angle (deg)"], ignore_index=True)


def at(places: NDArray[np.float64], pixel: float) -> float:
    """Return the place between two pixels, in micrometres."""
    return float(np.interp(pixel, np.arange(len(places)), places))


def cells_of_frame(phase: Image, labels: Labels, trust: Image | None) -> dict[str, Any]:
    """Return sums over the pixels of every cell of a frame (y, x), and their errors, in radians.

    The level of the empty field round the cells is taken off.
    """
    known = np.isfinite(phase)
    inside = np.where(known, labels, 0)
    counts = np.bincount(inside.ravel())
    numbers = np.flatnonzero(counts[1:]) + 1
    if not len(numbers):
        return {"cell": numbers}
    empty = known & (ndimage.maximum_filter(labels, 2 * AWAY + 1) == 0)
    level = float(np.median(phase[empty])) if empty.any() else 0.0
    height = np.where(known, phase - level, 0.0)
    sums = np.bincount(inside.ravel(), height.ravel())[numbers]
    count = counts[numbers]
    squared = (count * error_of_mean(height, empty, count)) ** 2
    rim = inside * (ndimage.grey_erosion(inside, 2 * RIM + 1) != inside)
    of_rim = np.bincount(rim.ravel(), height.ravel(), counts.size)[numbers]
    squared += (RIM_SHARE * of_rim) ** 2
    if trust is not None:
        doubt = np.bincount(inside.ravel(), (1 - np.nan_to_num(trust)).ravel(), counts.size)
        squared += (TURN * doubt[numbers]) ** 2
    centres = np.array(ndimage.center_of_mass(np.ones(labels.shape), inside, numbers))
    props = regionprops_table(inside, properties=("label", "perimeter_crofton"))
    return {
        "cell": numbers,
        "count": count,
        "sum": sums,
        "error": np.sqrt(squared),
        "largest": ndimage.maximum(height, inside, numbers),
        "y": centres[:, 0],
        "x": centres[:, 1],
        "perimeter": props["perimeter_crofton"],
    }


def error_of_mean(height: Image, empty: NDArray[np.bool_], count: NDArray[np.intp]) -> Image:
    """Return the standard deviation of means of so many pixels, as the empty field shows it.

    Means over squares of several sizes tell what noise is left in a mean, and what is no noise but
    an uneven background. Beyond the largest squares that fit it stays as it is there.
    """
    sizes, spread = [], []
    for side in SQUARES:
        rows, columns = (n // side for n in height.shape)
        if not (rows and columns):
            break
        cut = (slice(0, rows * side), slice(0, columns * side))
        shape = (rows, side, columns, side)
        whole = empty[cut].reshape(shape).all(axis=(1, 3))
        if np.count_nonzero(whole) < LEAST_SQUARES:
            break
        means = height[cut].reshape(shape).mean(axis=(1, 3))[whole]
        sizes.append(side * side)
        spread.append(max(float(np.std(means)), 1e-9))
    if not sizes:
        return np.full(len(count), np.nan)
    found: Image = np.exp(np.interp(np.log(count), np.log(sizes), np.log(spread)))
    # The level was told from the same field.
    return np.hypot(found, spread[-1] / math.sqrt(max(int(empty.sum()) / sizes[-1], 1.0)))


def speeds(table: pd.DataFrame) -> NDArray[np.float64]:
    """Return how fast each cell moves from the frame before, NaN at its first."""
    ordered = table.sort_values(["cell", "angle (deg)", "time (s)"])
    of_cell = ordered.groupby(["cell", "angle (deg)"], dropna=False)
    steps = of_cell[["y (um)", "x (um)", "time (s)"]].diff()
    values = steps.to_numpy(np.float64)
    speed = np.hypot(values[:, 0], values[:, 1]) / values[:, 2]
    found: NDArray[np.float64] = pd.Series(speed, ordered.index).reindex(table.index).to_numpy()
    return found
