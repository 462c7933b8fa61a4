"""What each cell is at each time, seen from each angle: place, size, mass, and its error."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
import skimage
from numpy.typing import NDArray

from napari_phase4d.analysis.cell_frames import level_beside, level_of, risen
from napari_phase4d.later import pd, xr
from napari_phase4d.optics import Optics
from napari_phase4d.stack import parts_over_time
from napari_phase4d.stacks import WAVELENGTH, wavelengths_of
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping import noise_of
from napari_phase4d.warned import warn

__all__ = ["NoCellsError", "path_scale", "table_of_cells"]

#: Sides in pixels of the squares of empty field by whose means the error of a sum is told, how
#: many of them there must be, and how far from cells they lie.
SQUARES, LEAST_SQUARES, AWAY = (1, 2, 4, 8, 16, 32), 6, 4
#: Of what so many pixels at the rim of a cell hold, this share is uncertain: where a cell ends is
#: a choice, and pixels are coarse.
RIM, RIM_SHARE = 3, 0.002
#: Within so many pixels of where cells touch, this share of what they hold is uncertain.
CONTACT, CONTACT_SHARE = 3, 0.08
#: Pixels whose wrap count is right with less than this chance are in doubt. One standard deviation
#: is what 68 of 100 values lie within, and those that are surer than that leave it as it is.
SURE = 0.68
#: Beside a mask phase is not further from 0 than this, in radians, where the empty field is at 0.
LEVEL_KNOWN = 0.1
#: Pixels round a cell over which its mass is summed as well.
BLURRED = 3
#: A cell is not wholly in view where the phase of more than this share of it is not known.
UNKNOWN_SHARE = 0.01
#: No light of a view comes from further aside.
STEEPEST_DEG = 85.0
TURN = 2 * math.pi

Image = NDArray[np.floating]
Labels = NDArray[np.integer]


class NoCellsError(ValueError):
    """There is no cell of which anything is known."""


def table_of_cells(
    stack: xr.DataArray,
    labels: Any,
    parents: dict[int, int],
    optics: Optics,
    *,
    overlaps: Sequence[tuple[float, ...]] = (),
    sides_um: tuple[float, float],
    object_index: float | None,
    refraction_increment_ml_per_g: float,
    oblique: bool,
    confidence: Any,
    watch: Watch,
) -> pd.DataFrame:
    """Return a row for every cell in every frame, see `measure`."""
    places = {
        dim: np.asarray(stack[dim].values, dtype=np.float64)
        if dim in stack.coords
        else np.full(stack.sizes[dim], np.nan)
        for dim in ("time", "angle", "y", "x")
    }
    if oblique and not (np.abs(places["angle"]) < STEEPEST_DEG).all():
        msg = (
            f"oblique needs viewing angles of less than {STEEPEST_DEG:g} degrees, but they are "
            f"{places['angle'].tolist()}"
        )
        raise ValueError(msg)
    pixel_um2 = sides_um[0] * sides_um[1]
    scale = path_scale(stack, optics)
    light = wavelengths_of(stack) if WAVELENGTH in stack.coords else None
    masked = stack.attrs.get("mask", "none") != "none"
    frames: list[dict[str, Any]] = []
    for part, phase in parts_over_time(stack):

        def measured(place: tuple[int, int], part: Any = part, phase: Any = phase) -> Any:
            """Return the cells of one frame."""
            (i, angle), time = place, part.start + place[0]
            # Some programs number in 8 bits, in which SciPy can't count up.
            of_frame = np.asarray(labels[time, angle]).astype(np.int32)
            trust = None if confidence is None else np.asarray(confidence[time, angle])
            found = cells_of_frame(phase[i, angle], of_frame, trust, sides_um, masked=masked)
            along = math.cos(math.radians(places["angle"][angle])) if oblique else 1.0
            return found | {
                "time (s)": places["time"][time],
                "angle (deg)": places["angle"][angle],
                "frame": time,
                "view": angle,
                "along": along if math.isfinite(along) else 1.0,
            }

        every = in_threads(measured, np.ndindex(*phase.shape[:2]), watch)
        frames += [found for found in every if len(found["cell"])]
    if not frames:
        msg = (
            "there are no cells where the phase is known; find_cells() finds what rises above the "
            "empty field"
        )
        raise NoCellsError(msg)
    if not is_levelled(stack):
        doubt_level([bool(found["level known"]) for found in frames], masked)
    # A table for each frame would take more memory, and time, than all that is in them.
    table = pd.DataFrame(
        {
            name: np.concatenate([np.broadcast_to(f[name], f["cell"].shape) for f in frames])
            for name in frames[0]
            if name != "level known"
        }
    )
    sums, masses, errors = (
        table[c].to_numpy() * table["along"].to_numpy() for c in ("sum", "mass", "error")
    )
    # What is proportional to the path is taken of phase as it is at the optics' wavelength.
    own = scale[table["view"].to_numpy()]
    masses, errors = masses * own, errors * own
    errors = np.hypot(errors, shared(table, masses, overlaps))
    area = table["count"].to_numpy() * pixel_um2
    mass_of_one = optics.dry_mass_pg(1.0, pixel_um2, refraction_increment_ml_per_g)
    mass, mass_error = masses * mass_of_one, errors * mass_of_one  # a NaN stays one
    mean, mean_error = (each / table["count"].to_numpy() for each in (sums, errors))
    largest = table["largest"].to_numpy() * table["along"].to_numpy()
    columns: dict[str, Any] = {
        "cell": table["cell"],
        "parent": [parents.get(cell, 0) for cell in table["cell"]],
        "time (s)": table["time (s)"],
        "angle (deg)": table["angle (deg)"],
        "y (um)": [at(places["y"], y) for y in table["y"]],
        "x (um)": [at(places["x"], x) for x in table["x"]],
        "area (um^2)": area,
        "mean phase (rad)": mean,
        "largest phase (rad)": largest,
        "mean optical path difference (nm)": 1000 * optics.optical_path_um(mean * own),
        "mean optical path difference error (nm)": 1000 * optics.optical_path_um(mean_error),
        "largest optical path difference (nm)": 1000 * optics.optical_path_um(largest * own),
        "dry mass (pg)": mass,
        "dry mass error (pg)": mass_error,
        "mass density (pg/um^2)": mass / area,
        "mass density error (pg/um^2)": mass_error / area,
        "circularity": np.minimum(
            4 * math.pi * area / np.maximum(table["perimeter"], min(sides_um)) ** 2, 1.0
        ),
        "wholly in view": table["whole"],
    }
    if object_index is not None:
        columns["mean height (um)"] = optics.height_um(mean * own, object_index)
        columns["mean height error (um)"] = np.abs(optics.height_um(mean_error, object_index))
        columns["volume (um^3)"] = optics.height_um(masses, object_index) * pixel_um2
        columns["volume error (um^3)"] = np.abs(optics.height_um(errors, object_index)) * pixel_um2
    if np.median(mass) < 0:
        warn(
            "most cells have a negative dry mass; where they are denser than the medium, the sign "
            "of the phase is wrong: flip the lobe, or give -phase"
        )
    result = pd.DataFrame(columns)
    keys = ["angle (deg)"]
    if light is not None:
        result.insert(4, "wavelength (um)", light[table["view"].to_numpy()])
        keys.append("wavelength (um)")
    result.insert(list(result.columns).index("x (um)") + 1, "speed (um/s)", speeds(result, keys))
    return result.sort_values(["cell", "time (s)", *keys], ignore_index=True)


def path_scale(stack: xr.DataArray, optics: Optics) -> NDArray[np.float64]:
    """Return what phase of each view is multiplied by to be that at the optics' wavelength.

    It is 1 where views do not differ in wavelength: then the optics count.
    """
    light = wavelengths_of(stack)
    if light is None or WAVELENGTH not in stack.coords:
        return np.ones(stack.sizes.get("angle", 1))
    return light / optics.wavelength_um


def shared(
    table: pd.DataFrame, masses: NDArray[np.float64], overlaps: Sequence[tuple[float, ...]]
) -> NDArray[np.float64]:
    """Return how far masses lie from those before and after, where cells lie over one another.

    It is the root mean square over each time that they do: nobody knows how what they have
    together is shared between them. It is NaN where a cell is never seen alone and whole.
    """
    off = np.zeros(len(table))
    times, whole = table["time (s)"].to_numpy(np.float64), table["whole"].to_numpy(bool)
    spans: dict[tuple[float, float], list[tuple[float, float]]] = defaultdict(list)
    for cell, angle, begin, end in overlaps:
        spans[cell, angle].append((begin, end))
    # As many masks as overlaps, each of all rows, would take more memory than the table.
    rows_of = table.groupby(["cell", "angle (deg)"]).indices
    for key in spans.keys() & rows_of.keys():
        rows = np.sort(rows_of[key])
        runs = [rows[(begin <= times[rows]) & (times[rows] <= end)] for begin, end in spans[key]]
        free = np.setdiff1d(rows[whole[rows]], np.concatenate(runs))
        free = free[np.argsort(times[free])]
        for run in runs:
            if not len(free):
                off[run] = np.nan
            elif len(run):
                way = masses[run] - np.interp(times[run], times[free], masses[free])
                off[run] = math.sqrt(float(np.mean(way**2)))
    return off


def at(places: NDArray[np.float64], pixel: float) -> float:
    """Return the place between two pixels, in micrometres."""
    return float(np.interp(pixel, np.arange(len(places)), places))


def cells_of_frame(
    phase: Image,
    labels: Labels,
    trust: Image | None,
    sides_um: tuple[float, float],
    *,
    masked: bool,
) -> dict[str, Any]:
    """Return sums over the pixels of every cell of a frame (y, x), and their errors, in radians.

    The level of the empty field round the cells is taken off. Where a mask has left that out, as
    0, the level is taken to be 0, and the error is that of the noise alone. What rises as cells do
    is no empty field, whether it has a label or not: cells may be left out, or be too small.
    """
    masked = masked and bool((phase == 0).any())  # or it has left out nothing
    known = np.isfinite(phase) & ((phase != 0) | (not masked))
    inside = np.where(known, labels, 0)
    counts = np.bincount(inside.ravel())
    numbers = np.flatnonzero(counts[1:]) + 1
    if not len(numbers):
        return {"cell": numbers}
    # The optics blur the end of a cell: what lies just outside of it is part of its mass.
    wider = skimage.segmentation.expand_labels(labels, BLURRED)
    summed = np.where(known, wider, 0)
    n_summed = np.bincount(summed.ravel())[numbers]
    filled = np.where(known, phase, 0).astype(np.float32)
    noise = noise_of(filled, known)
    field = 0.0 if masked else level_of(filled[known])
    object_ = risen(filled, known, field, noise)[1] | (labels > 0)
    empty = known & (scipy.ndimage.maximum_filter(object_.view(np.uint8), 2 * AWAY + 1) == 0)
    level = float(np.median(phase[empty])) if empty.any() else 0.0
    aside = abs(level_beside(phase, phase == 0)) if masked else math.inf
    level_known = empty.any() or aside < LEVEL_KNOWN
    height = np.where(known, phase - level, 0.0)
    sums = np.bincount(inside.ravel(), height.ravel())[numbers]
    masses = np.bincount(summed.ravel(), height.ravel())[numbers]
    count = counts[numbers]
    squared = (n_summed * error_of_mean(height, empty, n_summed, noise)) ** 2
    rim = inside * (scipy.ndimage.grey_erosion(inside, 2 * RIM + 1) != inside)
    of_rim = np.bincount(rim.ravel(), height.ravel(), counts.size)[numbers]
    squared += (RIM_SHARE * of_rim) ** 2
    touching = np.bincount(summed.ravel(), (height * at_contact(summed)).ravel(), counts.size)
    squared += (CONTACT_SHARE * touching[numbers]) ** 2
    if trust is not None:
        off = 1 - np.nan_to_num(trust)
        doubt = np.bincount(inside.ravel(), np.where(off > 1 - SURE, off, 0).ravel(), counts.size)
        squared += (TURN * doubt[numbers]) ** 2
    centres = np.array(scipy.ndimage.center_of_mass(np.ones(labels.shape), inside, numbers))
    edge = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    unknown = np.bincount(wider[~np.isfinite(phase)], minlength=counts.size)[numbers]
    return {
        "level known": level_known,
        "cell": numbers,
        "count": count,
        "sum": sums,
        "mass": masses,
        "error": np.sqrt(squared),
        "largest": scipy.ndimage.maximum(height, inside, numbers),
        "y": centres[:, 0],
        "x": centres[:, 1],
        "perimeter": perimeters_um(inside, sides_um)[numbers],
        "whole": ~np.isin(numbers, edge) & (unknown <= UNKNOWN_SHARE * (n_summed + unknown)),
    }


def is_levelled(stack: xr.DataArray) -> bool:
    """Say whether the empty field was put to 0 in each frame when holograms were reconstructed."""
    noted = stack.attrs
    return bool(noted.get("drift_removed")) and noted.get("background", "none") != "none"


def doubt_level(known: Sequence[bool], masked: bool) -> None:
    """Warn if the level of the empty field is not known in some frames."""
    unknown = len(known) - sum(known)
    if not unknown:
        return
    if masked:
        warn(
            f"in {unknown} of {len(known)} frames the mask left out the empty field, and its "
            "level counts as 0, which may be wrong; with_empty_field(result, wrapped) brings it "
            "back"
        )
        return
    warn(
        f"in {unknown} of {len(known)} frames no empty field is seen round the cells; its level "
        "counts as 0 there, which may be wrong, and errors don't tell"
    )


def perimeters_um(labels: Labels, sides_um: tuple[float, float]) -> NDArray[np.float64]:
    """Return how long the outline of each label is; of 0, too.

    By the formula of Cauchy and Crofton: half of how often lines along rows, columns and both
    diagonals cross it, times how far the lines lie apart and the range of angles that they stand
    for. Of squares it is scikit-image's ``perimeter_crofton``.
    """
    high, wide = sides_um
    diagonal, slope = math.hypot(high, wide), math.atan2(high, wide)
    around = np.pad(labels, 1)
    pairs = (
        (around[:, 1:], around[:, :-1], high * slope),
        (around[1:], around[:-1], wide * (math.pi / 2 - slope)),
        (around[1:, 1:], around[:-1, :-1], high * wide / diagonal * math.pi / 4),
        (around[1:, :-1], around[:-1, 1:], high * wide / diagonal * math.pi / 4),
    )
    found = np.zeros(int(labels.max()) + 1)
    for here, there, share in pairs:
        crossed = here != there
        for side in (here, there):
            found += share / 2 * np.bincount(side[crossed], minlength=found.size)
    return found


def at_contact(labels: Labels) -> NDArray[np.bool_]:
    """Return the pixels near to where cells touch: which of them they belong to is a choice."""
    highest = scipy.ndimage.maximum_filter(labels, 3)
    lowest = scipy.ndimage.minimum_filter(np.where(labels > 0, labels, np.iinfo(np.int32).max), 3)
    line = (labels > 0) & (highest != lowest)
    found: NDArray[np.bool_] = scipy.ndimage.binary_dilation(line, iterations=CONTACT) & (
        labels > 0
    )
    return found


def error_of_mean(
    height: Image, empty: NDArray[np.bool_], count: NDArray[np.intp], noise: float
) -> Image:
    """Return the standard deviation of means of so many pixels, as the empty field shows it.

    Means over squares of several sizes tell what noise is left in a mean, and what is no noise but
    an uneven background. Beyond the largest squares that fit it stays as it is there. Without
    empty field in view there is but the noise of single pixels to go by.
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
        of_level = noise**2 / n_empty if (n_empty := np.count_nonzero(empty)) else 0.0
        return np.asarray(np.sqrt(noise**2 / count + of_level))
    found: Image = np.exp(np.interp(np.log(count), np.log(sizes), np.log(spread)))
    # The level was told from the same field.
    return np.hypot(found, spread[-1] / math.sqrt(max(int(empty.sum()) / sizes[-1], 1.0)))


def speeds(table: pd.DataFrame, keys: list[str]) -> NDArray[np.float64]:
    """Return how fast each cell moves from the frame before, NaN at its first.

    ``keys`` are the columns that tell a view.
    """
    ordered = table.sort_values(["cell", *keys, "time (s)"])
    of_cell = ordered.groupby(["cell", *keys], dropna=False)
    steps = of_cell[["y (um)", "x (um)", "time (s)"]].diff()
    values = steps.to_numpy(np.float64)
    speed = np.hypot(values[:, 0], values[:, 1]) / values[:, 2]
    found: NDArray[np.float64] = pd.Series(speed, ordered.index).reindex(table.index).to_numpy()
    return found
