"""Cells of a result, from pixels to a table: found, followed, measured; regions on them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.analysis.cell_table import NoCellsError
from napari_phase4d.analysis.cells import find_cells, follow_cells_of
from napari_phase4d.analysis.measures import measure
from napari_phase4d.later import pd, xr
from napari_phase4d.optics import REFRACTION_INCREMENT_ML_PER_G, Optics
from napari_phase4d.stack import PART_BYTES, frame_of, parts_over_time
from napari_phase4d.stacks import AXES
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.unwrapping import border_medians
from napari_phase4d.words import as_numbers, check_bool, check_number, checked_call, shown

__all__ = [
    "CellSettings",
    "Cells",
    "cells_in",
    "region_with_cell",
    "summary_of_cells",
    "with_empty_field",
]

TURN = np.float32(2 * np.pi)
#: A level so near half a turn may lie on either side of it, radians; and of so many pixels of the
#: empty field its level is found.
NEAR_HALF, ENOUGH_FOR_LEVEL = 2.5, 20_000
Image = NDArray[np.float32]


@dataclass(frozen=True)
class CellSettings:
    """How cells are found and measured, see `find_cells` and `measure`.

    Parameters
    ----------
    threshold_rad : float, optional
        Phase above the empty field that some pixel of a cell must have. Default 0.25 rad, more
        with much noise.
    smallest_um2, largest_um2 : float, optional
        Areas between which a cell lies, in square micrometres. Default 30 pixels, and no upper
        limit.
    at_border : bool
        Whether cells count that the border of the frame cuts off. Default True.
    split : bool
        Whether blobs are cut where they have a neck. Default True.
    oblique : bool
        Whether phase of oblique views is multiplied by the cosine of their angle. Default False.
    object_index : float, optional
        Refractive index of the cells; without it there is neither height nor volume.
    refraction_increment_ml_per_g : float
        How much one gram of dry matter in a millilitre raises the refractive index, in mL/g.
        Default 0.18.

    Raises
    ------
    TypeError, ValueError
        If a number can't be.

    Examples
    --------
    >>> from napari_phase4d.analysis import CellSettings
    >>> CellSettings(smallest_um2=20, at_border=False).smallest_um2
    20
    """

    threshold_rad: float | None = None
    smallest_um2: float | None = None
    largest_um2: float | None = None
    at_border: bool = True
    split: bool = True
    oblique: bool = False
    object_index: float | None = None
    refraction_increment_ml_per_g: float = REFRACTION_INCREMENT_ML_PER_G

    def __post_init__(self) -> None:
        for name in ("at_border", "split", "oblique"):
            check_bool(name, getattr(self, name))
        least = {"object_index": 1.0}
        for name in (
            "threshold_rad",
            "smallest_um2",
            "largest_um2",
            "object_index",
            "refraction_increment_ml_per_g",
        ):
            value = getattr(self, name)
            if value is None:
                continue
            number = check_number(name, value)
            if not (math.isfinite(number) and number > 0 and number >= least.get(name, 0.0)):
                limit = f"at least {least[name]:g}" if name in least else "above 0"
                msg = f"{name} must be {limit}, but is {shown(value)}"
                raise ValueError(msg)
        if None not in (self.smallest_um2, self.largest_um2) and (
            (self.smallest_um2 or 0) > (self.largest_um2 or 0)
        ):
            msg = (
                f"the smallest cell, {self.smallest_um2:g} um^2, is larger than the largest, "
                f"{self.largest_um2:g} um^2; exchange them"
            )
            raise ValueError(msg)

    @property
    def finding(self) -> dict[str, Any]:
        """The arguments of `find_cells`."""
        names = ("threshold_rad", "smallest_um2", "largest_um2", "at_border", "split")
        return {name: getattr(self, name) for name in names}


#: Columns of the table where there are no cells.
NO_CELLS = ("cell", "parent", "time (s)", "angle (deg)", "dry mass (pg)", "dry mass error (pg)")


@dataclass(frozen=True)
class Cells:
    """The cells of a result.

    Parameters
    ----------
    labels : xarray.DataArray
        int32, dims (time, angle, y, x): 0 where there is none, else the cell's number.
    table : pandas.DataFrame
        A row a cell, time and view, see `measure`.
    method : str
        Id of the method whose result they are of.
    """

    labels: xr.DataArray
    table: pd.DataFrame
    method: str = ""

    @property
    def summary(self) -> pd.DataFrame:
        """A row a cell, see `summary_of_cells`."""
        return summary_of_cells(self.table)


@checked_call
def cells_in(
    unwrapped: xr.DataArray,
    optics: Optics,
    settings: CellSettings | None = None,
    *,
    method: str = "",
    wrapped: xr.DataArray | None = None,
    labels: xr.DataArray | None = None,
    confidence: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Cells:
    """Find, follow and measure the cells of a result.

    Parameters
    ----------
    unwrapped : xarray.DataArray
        Unwrapped phase in radians, dims (time, angle, y, x), with coordinates.
    optics : Optics
        The microscope.
    settings : CellSettings, optional
        How they are found and measured.
    method : str, optional
        Id of the method that gave the phase, to be noted.
    wrapped : xarray.DataArray, optional
        The wrapped phase that it was made of, for the empty field that a mask has left out, see
        `with_empty_field`.
    labels : xarray.DataArray, optional
        Cells of another program, or corrected by hand: taken as they are, and only followed.
    confidence : xarray.DataArray, optional
        What `confidence` gives: pixels in doubt make errors larger, see `measure`.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    Cells
        Labels, dims (time, angle, y, x), and the table of what was measured, a row a cell, time
        and view.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit. That there are no cells is no error: the table is empty then.
    ImportError
        If the package that follows cells is not installed.
    Cancelled
        If ``cancelled()`` returned True.
    """
    how = settings or CellSettings()
    if wrapped is not None:
        unwrapped = with_empty_field(unwrapped, wrapped)
    if labels is None:
        found = find_cells(unwrapped, **how.finding, progress=progress, cancelled=cancelled)
    else:
        found = follow_cells_of(unwrapped, labels, Task(progress, cancelled))
    found.attrs["method"] = method
    try:
        table = measure(
            unwrapped,
            found,
            optics,
            object_index=how.object_index,
            refraction_increment_ml_per_g=how.refraction_increment_ml_per_g,
            oblique=how.oblique,
            confidence=confidence,
            progress=progress,
            cancelled=cancelled,
        )
    except NoCellsError:
        table = pd.DataFrame({name: [] for name in NO_CELLS})
    return Cells(found, table, method)


@checked_call
def with_empty_field(unwrapped: xr.DataArray, wrapped: xr.DataArray) -> xr.DataArray:
    """Return a result in which the empty field is there that a mask had left out.

    Within half a turn of its level it needs no unwrapping. Levels go on from frame to frame as
    unwrapping lets them, from the boundary frame on. The field's noise tells how far sums are to
    be trusted, and what the optics blur out of the mask is part of the mass.

    Parameters
    ----------
    unwrapped, wrapped : xarray.DataArray
        A result, 0 where it was masked, and the phase that it was made of, radians.

    Returns
    -------
    xarray.DataArray
        float32 in radians, with the dims and coordinates of ``unwrapped``, and ``attrs["mask"]``
        "none"; ``unwrapped`` itself where it had no mask.
    """
    if unwrapped.attrs.get("mask", "none") == "none":
        return unwrapped
    field = wrapped.transpose(*unwrapped.dims).assign_coords(unwrapped.coords)
    filled: xr.DataArray = xr.apply_ufunc(
        with_field_of_frame,
        unwrapped,
        field,
        field_levels(unwrapped, field),
        input_core_dims=[["y", "x"], ["y", "x"], []],
        output_core_dims=[["y", "x"]],
        vectorize=True,
        keep_attrs=True,
        dask="parallelized",  # stacks on disk stay there
        dask_gufunc_kwargs={"allow_rechunk": True},
        output_dtypes=[np.float32],
    )
    return filled.transpose(*unwrapped.dims).assign_attrs({**unwrapped.attrs, "mask": "none"})


def with_field_of_frame(result: Image, wrapped: Image, level: float) -> Image:
    """Return a frame of a result with the empty field of some level beside what was unwrapped."""
    turns = np.round((wrapped - np.float32(level)) / TURN)
    found: Image = np.where(result == 0, wrapped - TURN * turns, result)
    return found


def field_levels(unwrapped: xr.DataArray, wrapped: xr.DataArray) -> xr.DataArray:
    """Return the level of the empty field of each frame, (time, angle), as a result goes on."""
    shape = unwrapped.sizes["time"], unwrapped.sizes["angle"]
    levels, steps = np.full(shape, np.nan), np.full(shape, np.nan)
    for time, angle in np.ndindex(shape):
        here = {"time": time, "angle": angle}
        result, field = (stack.isel(here).values for stack in (unwrapped, wrapped))
        levels[time, angle] = level_of_field(field[(result == 0) & np.isfinite(field)])
        steps[time, angle] = step_at_edge(result, float(levels[time, angle]))
    start, view = first = first_frame(unwrapped)
    for order in (range(start, shape[0]), range(start, -1, -1)):
        for before, now in pairwise(order):  # where no field is seen it stays where it was
            levels[now] = np.where(np.isnan(levels[now]), levels[before], levels[now])
    found = border_medians(np.nan_to_num(levels), first)
    if abs(found[start, view]) > NEAR_HALF and np.isfinite(steps).any():
        # On which side of half a turn the result has it, its edges tell.
        off = np.round(np.nanmedian(steps - (found - levels)) / TURN)
        found = found + TURN * off
    return xr.DataArray(found, dims=("time", "angle")).assign_coords(
        {axis: unwrapped[axis] for axis in ("time", "angle") if axis in unwrapped.coords}
    )


def level_of_field(field: NDArray[np.floating]) -> float:
    """Return the level of the phase of some pixels in radians, NaN if there are none."""
    some = field[:: 1 + field.size // ENOUGH_FOR_LEVEL].astype(np.float64)
    if not some.size:
        return math.nan
    mean = float(np.angle(np.exp(1j * some).mean()))
    return mean + float(np.median(np.angle(np.exp(1j * (some - mean)))))


def step_at_edge(result: Image, level: float) -> float:
    """Return by how much the edge of what was unwrapped lies above a level, NaN without any."""
    inside = result != 0
    edge = inside & ~scipy.ndimage.binary_erosion(inside, border_value=1) & np.isfinite(result)
    return float(np.median(result[edge])) - level if edge.any() else math.nan


def first_frame(unwrapped: xr.DataArray) -> tuple[int, int]:
    """Return the frame (time, angle) that a result goes on from, as it notes."""
    noted = unwrapped.attrs.get("boundary") or [(0, 0)]
    time, angle = (int(index) for index in noted[0])
    return time % unwrapped.sizes["time"], angle % unwrapped.sizes["angle"]


#: Columns of the summary that are medians over the frames of a cell.
MEDIANS = (
    "dry mass (pg)",
    "dry mass error (pg)",
    "area (um^2)",
    "mass density (pg/um^2)",
    "volume (um^3)",
    "speed (um/s)",
)


@checked_call
def summary_of_cells(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each cell.

    Parameters
    ----------
    table : pandas.DataFrame
        Of cells, see `measure`.

    Returns
    -------
    pandas.DataFrame
        "cell", "parent", "from (s)" and "to (s)" (when it is seen), "frames" (times at which it
        is found in some view); then medians over times and views, of those where it is wholly in
        view if there are any: "dry mass (pg)", "dry mass error (pg)" (of a single frame), "area
        (um^2)", "mass density (pg/um^2)", "speed (um/s)", where known "volume (um^3)".
    """
    if "cell" not in table:
        msg = 'table has no column "cell"; give the table of cells, as cells_in() makes it'
        raise ValueError(msg)
    rows: list[dict[str, Any]] = []
    for number in dict.fromkeys(table["cell"].tolist()):
        of_cell = table[table["cell"] == number]
        whole = of_cell[of_cell["wholly in view"].to_numpy(bool)]
        used = whole if len(whole) else of_cell
        times = of_cell["time (s)"].to_numpy(np.float64)
        row: dict[str, Any] = {
            "cell": int(number),
            "parent": int(of_cell["parent"].iloc[0]),
            "from (s)": float(times.min()),
            "to (s)": float(times.max()),
            "frames": len(np.unique(times)),
        }
        for name in MEDIANS:
            if name in used:
                values = used[name].to_numpy(np.float64)
                known = values[np.isfinite(values)]
                row[name] = float(np.median(known)) if known.size else float("nan")
        rows.append(row)
    return pd.DataFrame(rows, columns=None if rows else ["cell", "parent", *MEDIANS[:3]])


# ---- regions that go along with cells -------------------------------------------------------


#: Where no way of a cell is known, since it is not found there.
NOWHERE = np.iinfo(np.int64).min

Mask = NDArray[np.bool_]
Ways = NDArray[np.int64]


@checked_call
def region_with_cell(
    region: Mask,
    frame: tuple[int, int],
    cells: xr.DataArray,
    *,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.DataArray:
    """Let a region that was drawn in one frame go along with the cell that it lies on.

    It keeps its form, and is moved as the middle of the cell moves, through times and views. What
    leaves the field is cut off; where the cell is not found, the region is empty.

    Parameters
    ----------
    region : ndarray of bool, shape (y, x)
        The region.
    frame : (int, int)
        Numbers of the time and angle at which it was drawn.
    cells : xarray.DataArray
        What `find_cells` gives, dims (time, angle, y, x); in memory or lazy.
    progress, cancelled : callable, optional
        See `unwrap`.

    Returns
    -------
    xarray.DataArray
        bool, dims (time, angle, y, x). It is lazy: only where the cell is in each frame is kept,
        and a frame of it is made when it is looked at.

    Raises
    ------
    ValueError
        If there is no cell in the region in that frame.
    Cancelled
        If ``cancelled()`` returned True.
    """
    task = Task(progress, cancelled)
    labels = cells.transpose(*AXES)
    if not (0 <= frame[0] < labels.shape[0] and 0 <= frame[1] < labels.shape[1]):
        msg = (
            f"the region was drawn at time {frame[0]} and angle {frame[1]} (counted from 0), but "
            f"there are {labels.shape[0]} times and {labels.shape[1]} angles; draw it again"
        )
        raise ValueError(msg)
    here = frame_of(labels, *frame)
    region = as_numbers("the region", region)
    if region.dtype != bool or region.shape != here.shape:
        msg = (
            f"the region must be True and False on {here.shape} pixels (y, x), but is "
            f"{region.dtype} of shape {region.shape}"
        )
        raise ValueError(msg)
    inside = here[region & (here > 0)]
    if not inside.size:
        msg = (
            f"there is no cell in the region at time {frame[0]} and angle {frame[1]} (counted "
            "from 0), so it can't go along with one; draw it on a cell, or let it stand still"
        )
        raise ValueError(msg)
    cell = int(np.bincount(inside).argmax())
    watch = Watch(labels.shape[0], "following the region", task)
    ways = ways_of(cell, middle_of(here == cell), labels, watch)
    # Blocks that are small beside what is free, and large beside what a block costs.
    times = max(1, PART_BYTES // 4 // max(labels[0].size, 1))
    begins = range(0, labels.shape[0], times)
    lengths = tuple(min(times, labels.shape[0] - begin) for begin in begins)
    import dask.array as da  # which takes a tenth of a second

    moved = da.map_blocks(
        lambda block_id: block_of(region, ways[begins[block_id[0]] :][:times]),
        chunks=(lengths, *((n,) for n in labels.shape[1:])),
        dtype=bool,
        meta=np.empty((0, 0, 0, 0), dtype=bool),
    )
    return xr.DataArray(moved, dims=AXES, coords=labels.coords, name="region")


def ways_of(cell: int, start: NDArray[np.float64], labels: xr.DataArray, watch: Watch) -> Ways:
    """Return by how many pixels (time, angle, 2) a cell has moved, NOWHERE where it is not."""
    ways = np.full((*labels.shape[:2], 2), NOWHERE)
    watch.check()
    for part, values in parts_over_time(labels):
        for time, views in enumerate(values, part.start):
            for angle, frame in enumerate(views):
                of_cell = frame == cell
                if of_cell.any():
                    ways[time, angle] = np.rint(middle_of(of_cell) - start)
            watch.step()
    return ways


def block_of(region: Mask, ways: Ways) -> Mask:
    """Return a region (time, angle, y, x) moved by such ways."""
    moved = np.zeros((*ways.shape[:2], *region.shape), dtype=bool)
    for place in np.ndindex(*ways.shape[:2]):
        if ways[place][0] != NOWHERE:
            shifted(region, ways[place], moved[place])
    return moved


def middle_of(mask: Mask) -> NDArray[np.float64]:
    """Return the middle (y, x) of the pixels of a mask."""
    return np.array([float(part.mean()) for part in np.nonzero(mask)])


def shifted(mask: Mask, way: Ways, target: Mask) -> None:
    """Move a mask by whole pixels into an empty one; what leaves it is lost."""
    source, goal = [], []
    for step, size in zip(way.tolist(), mask.shape, strict=True):
        source.append(slice(max(-step, 0), max(min(size, size - step), 0)))
        goal.append(slice(max(step, 0), max(min(size, size + step), 0)))
    if mask[tuple(source)].size:
        target[tuple(goal)] = mask[tuple(source)]
