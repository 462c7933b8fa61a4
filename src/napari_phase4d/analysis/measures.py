"""Regions, and what is in them over time and angle: area, optical path, height, dry mass."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import skimage
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.analysis.cell_table import path_scale, table_of_cells
from napari_phase4d.later import pd, xr
from napari_phase4d.optics import REFRACTION_INCREMENT_ML_PER_G, Optics
from napari_phase4d.stack import PART_BYTES, each_frame, parts_over_time
from napari_phase4d.stacks import (
    AXES,
    PLAIN_AXES,
    WAVELENGTH,
    beside,
    checked_labels,
    mask_on,
    on_grid_of,
    pixel_um,
    unwrapped_stack,
    wavelengths_of,
)
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.warned import warn
from napari_phase4d.words import (
    as_numbers,
    check_bool,
    check_number,
    is_list,
    shown,
)

__all__ = ["measure", "polygon_mask", "region_masks"]

Mask = NDArray[np.bool_]


def region_masks(labels: ArrayLike) -> dict[str, Mask]:
    """Return a mask of every label.

    Parameters
    ----------
    labels : array_like of int, dims (y, x), (time, y, x) or (time, angle, y, x)
        0 is no region; every other number is one.

    Returns
    -------
    dict
        "label 3" and so on, by rising number, to a mask of the shape of the labels.

    Raises
    ------
    TypeError
        If the labels are no whole numbers.
    ValueError
        If they have other dims, or if all are 0.

    Examples
    --------
    >>> from napari_phase4d.analysis import region_masks
    >>> list(region_masks([[0, 2, 2], [0, 0, 7]]))
    ['label 2', 'label 7']
    """
    image = as_numbers("labels", labels)
    if image.dtype.kind not in "iub":
        msg = f"labels must be whole numbers, but are {image.dtype}"
        raise TypeError(msg)
    if image.ndim not in (2, 3, 4):
        msg = (
            f"the labels have {image.ndim} dimensions {image.shape}; they must have two (y, x), "
            "three (time, y, x) or four (time, angle, y, x)"
        )
        raise ValueError(msg)
    # Unlike numpy.unique this does not sort all pixels.
    numbers = sorted(int(n) for n in pd.unique(image.ravel()) if n != 0)
    if not numbers:
        msg = "there are no labels; paint at least one region"
        raise ValueError(msg)
    return {f"label {n}": image == n for n in numbers}


def polygon_mask(vertices_yx: ArrayLike, shape: tuple[int, int]) -> Mask:
    """Return the pixels of a frame whose centre lies in a polygon.

    Parameters
    ----------
    vertices_yx : array_like of shape (n, 2)
        Corners (y, x) in pixels, three or more; the centres of pixels are at whole numbers. What
        lies outside of the frame is cut off.
    shape : tuple of int
        Height and width of the frame in pixels.

    Returns
    -------
    ndarray of bool, shape (y, x)

    Raises
    ------
    ValueError
        If the corners make no polygon, or if it holds no pixel of the frame.

    Examples
    --------
    >>> from napari_phase4d.analysis import polygon_mask
    >>> polygon_mask([(0, 0), (0, 2), (2, 2), (2, 0)], (4, 5)).astype(int)
    array([[1, 1, 1, 0, 0],
           [1, 1, 1, 0, 0],
           [1, 1, 1, 0, 0],
           [0, 0, 0, 0, 0]])
    """
    if not is_list(shape) or np.shape(shape) != (2,) or np.asarray(shape).dtype.kind not in "iu":
        msg = f"shape must be the height and width of a frame, but is {shown(shape)}"
        raise ValueError(msg)
    corners = as_numbers("vertices_yx", vertices_yx).astype(np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        msg = f"a polygon needs three or more corners (y, x), but has shape {corners.shape}"
        raise ValueError(msg)
    if not np.isfinite(corners).all():
        msg = "the corners of the polygon must be finite numbers"
        raise ValueError(msg)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (high < -0.5).any() or (low > np.array(shape) - 0.5).any():
        msg = (
            f"the polygon (y {low[0]:.4g} to {high[0]:.4g}, x {low[1]:.4g} to {high[1]:.4g} "
            f"pixels) lies outside of the frame of {shape[0]} x {shape[1]} pixels"
        )
        raise ValueError(msg)
    mask: Mask = skimage.draw.polygon2mask(shape, corners)
    if not mask.any():
        msg = "there is no pixel of the frame in the polygon; draw a larger one"
        raise ValueError(msg)
    return mask


NM_PER_UM = 1000
#: Nothing transparent has a larger refractive index.
LARGE_INDEX = 5.0


def measure(
    unwrapped: xr.DataArray,
    regions: Mapping[str, Any] | xr.DataArray | ArrayLike,
    optics: Optics,
    *,
    object_index: float | None = None,
    refraction_increment_ml_per_g: float = REFRACTION_INCREMENT_ML_PER_G,
    oblique: bool = False,
    confidence: xr.DataArray | ArrayLike | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> pd.DataFrame:
    """Measure cells, or regions, in every frame.

    NaN and infinite pixels count as outside; pixels that a mask set to 0 count as flat. In regions
    phase is taken as it is: the empty field should be at 0. For cells the level of the empty field
    round them is taken off. Where a mask has left it out it counts as 0, which is warned of where
    it may be wrong; `with_empty_field` brings it back.

    Parameters
    ----------
    unwrapped : xarray.DataArray
        Unwrapped phase in radians, dims among (time, angle, y, x), with coordinates in seconds,
        degrees and micrometres.
    regions : array of int, or mapping of str to array of bool
        Cells as `find_cells` gives them: 0 is none, a number is the same cell everywhere; dims
        or shape as those of the phase. Or name to mask: a DataArray that names its dims, or a
        plain array (y, x), (time, y, x), which holds at every angle, or (time, angle, y, x); see
        `region_masks` and `polygon_mask`. Time and angle may be 1 long and then hold always.
    optics : Optics
        The microscope; its wavelength must be that of the phase, where the phase notes one. Where
        views differ in wavelength, that of each view counts instead.
    object_index : float, optional
        Refractive index of the object, taken as the same everywhere in it. Without it there is
        neither height nor volume.
    refraction_increment_ml_per_g : float, optional
        How much one gram of dry matter in a millilitre raises the refractive index. Default 0.18
        mL/g (Barer, Nature 169, 366, 1952), which is 0.18 um^3/pg.
    oblique : bool, optional
        Whether phase of oblique views is multiplied by the cosine of their angle in the medium,
        by which rays that come at an angle go through more of the object, where the image is
        not foreshortened as well. Default False. For cells only.
    confidence : DataArray or array_like, optional
        What `confidence` gives: each pixel that is right with a chance of less than 0.68 makes
        the error of its cell larger, by the chance that it is wrong times a whole turn.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each region or frame; ``cancelled()`` stops the
        work.

    Returns
    -------
    pandas.DataFrame
        Of cells one row a cell, time and angle, by number. Columns: "cell", "parent" (0 if it came
        from no other), "time (s)", "angle (deg)", "y (um)", "x (um)" (its middle),
        "speed (um/s)", "area (um^2)", "mean phase (rad)", "largest phase (rad)",
        "mean optical path difference (nm)", "largest optical path difference (nm)",
        "dry mass (pg)", "mass density (pg/um^2)", "circularity" (1 is a disc), "wholly in view"
        (whether it does not touch the border of the frame, and the phase of 99 % of it is known);
        with ``object_index``
        "mean height (um)", "volume (um^3)". What is summed or averaged has its error in the
        column after it, "dry mass error (pg)" and so on. An error is one standard deviation: of
        means over as much empty field, of where the cell ends, of pixels in doubt, and of how
        cells that lie over one another share what they hold; not of the refraction increment.
        It is NaN while a cell lies over another if it is never seen alone and wholly in view.

        Where views differ in wavelength, "wavelength (um)" stands beside the angle.

        Of regions one row a region, time and angle, in this order. Columns: "region", "time (s)",
        "angle (deg)", "area (um^2)", "mean phase (rad)", "mean optical path difference (nm)";
        with ``object_index`` "mean height (um)" and "volume (um^3)"; "dry mass (pg)". Where a
        region has no pixel in a frame, its area is 0 and all else NaN; a cell that is not found in
        a frame has no row there. Time or angle are NaN where the phase has no such coordinate.

    Raises
    ------
    TypeError
        If the phase is no DataArray, or a mask is not of bool.
    ValueError
        If a mask does not fit the phase, coordinates are missing, or a number can't be.
    Cancelled
        If ``cancelled()`` returned True.

    See Also
    --------
    polygon_mask, region_masks : Make masks.

    Examples
    --------
    >>> import numpy as np
    >>> from napari_phase4d import measure
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena((48, 64), 2)["phase"]
    >>> everything = np.ones((48, 64), dtype=bool)
    >>> table = measure(exact, {"field": everything}, p4d.Optics())
    >>> table[["region", "time (s)", "angle (deg)"]].values[1].tolist()
    ['field', 0.0, 21.0]
    >>> bool((table["dry mass (pg)"] > 0).all())
    True
    """
    task = Task(progress, cancelled)
    stack = on_four_axes(unwrapped)
    check_numbers(stack, optics, object_index, refraction_increment_ml_per_g)
    check_bool("oblique", oblique)
    if hasattr(regions, "dtype") or is_list_of_labels(regions):
        return table_of_cells(
            stack, labels_on(regions, unwrapped, stack), parents_of(regions), optics,
            overlaps=overlaps_of(regions),
            sides_um=pixel_um(stack, "the phase"),
            object_index=object_index,
            refraction_increment_ml_per_g=refraction_increment_ml_per_g,
            oblique=oblique,
            confidence=None if confidence is None else chances(confidence, unwrapped),
            watch=Watch(math.prod(stack.shape[:2]), "measuring", task),
        )  # fmt: skip
    if oblique or confidence is not None:
        warn("oblique and confidence count for cells only; for regions they do nothing")
    masks = {name: fitted(name, mask, stack) for name, mask in checked_regions(regions).items()}
    pixel_um2 = pixel_area_um2(stack)
    scale = np.tile(path_scale(stack, optics), stack.shape[0])
    watch = Watch(len(masks), "measuring", task)
    watch.check()
    tables = []
    for name, mask in masks.items():
        sums, counts = totals(stack, mask, watch)
        sums[counts == 0] = np.nan  # what is not seen weighs nobody knows what
        row = {"region": name, **frames_of(stack), "area (um^2)": counts * pixel_um2}
        row |= light_column(stack)
        row |= phase_columns(sums, counts, pixel_um2, optics, object_index, scale)
        mass = optics.dry_mass_pg(1.0, pixel_um2, refraction_increment_ml_per_g)
        row["dry mass (pg)"] = sums * scale * mass
        tables.append(pd.DataFrame(row))
        watch.step()
    return pd.concat(tables, ignore_index=True)


def is_list_of_labels(regions: Any) -> bool:
    """Say whether regions are a nested list of whole numbers, and not one of masks."""
    if not is_list(regions) or any(hasattr(each, "dtype") for each in regions):
        return False
    try:
        return np.asarray(regions).dtype.kind in "iu"
    except ValueError:  # its rows differ in length
        return False


def labels_on(labels: Any, phase: xr.DataArray, stack: xr.DataArray) -> Any:
    """Return labels (time, angle, y, x) that fit the phase, or say why they don't.

    Plain ones of the shape of the phase have its dims. The stack is the phase with all four.
    """
    if not hasattr(labels, "dtype"):
        labels = np.asarray(labels)
    if labels.ndim not in PLAIN_AXES:
        msg = f"the cells are {shown(labels)}, which does not fit the phase, {stack.shape}"
        raise ValueError(msg)
    if not isinstance(labels, xr.DataArray):
        labels = beside(labels, phase, "the cells")
    labels = checked_labels(labels, "the cells")
    missing = [dim for dim in stack.dims if dim not in labels.dims and stack.sizes[dim] == 1]
    if missing:  # as the phase was before it had four axes
        labels = labels.drop_vars(missing, errors="ignore").expand_dims(missing)
    found = labels.data
    if set(labels.dims) == set(stack.dims):
        # Lazy ones stay so: they are brought into memory a frame at a time.
        found = on_grid_of(labels, stack, "the cells").transpose(*AXES).data
    if found.shape != stack.shape:
        msg = f"the cells are {found.shape}, which does not fit the phase, {stack.shape}"
        raise ValueError(msg)
    return found


def parents_of(labels: Any) -> dict[int, int]:
    """Return the parent of each cell that came from another one."""
    noted = getattr(labels, "attrs", {}).get("parents", ())
    try:
        return {int(child): int(parent) for child, parent in noted}
    except (TypeError, ValueError) as error:
        msg = (
            f'the cells note parents as {shown(noted)}; attrs["parents"] must be a list of '
            "(daughter, parent), as find_cells() gives it"
        )
        raise ValueError(msg) from error


def overlaps_of(labels: Any) -> list[tuple[float, ...]]:
    """Return when cells can't be told from others: (cell, angle, from, to)."""
    noted = getattr(labels, "attrs", {}).get("overlaps", ())
    try:
        return [(int(cell), float(a), float(b), float(c)) for cell, a, b, c in noted]
    except (TypeError, ValueError) as error:
        msg = (
            f'the cells note overlaps as {shown(noted)}; attrs["overlaps"] must be a list of '
            "(cell, angle, from, to), as find_cells() gives it"
        )
        raise ValueError(msg) from error


def chances(confidence: Any, unwrapped: xr.DataArray) -> Any:
    """Return how far pixels are to be trusted, or say why that can't be."""
    given = on_grid_of(confidence, unwrapped, "the confidence")
    full = given.expand_dims([d for d in AXES if d not in given.dims]).transpose(*AXES)
    if full.dtype.kind not in "fiu":
        msg = f"the confidence must be real numbers from 0 to 1, but is {full.dtype}"
        raise TypeError(msg)
    low, high = np.inf, -np.inf
    for frame in each_frame(full):
        low = min(low, float(np.nanmin(frame, initial=np.inf)))
        high = max(high, float(np.nanmax(frame, initial=-np.inf)))
    if not 0 <= low <= high <= 1:  # high is below low where nothing is known
        msg = f"the confidence must lie between 0 and 1, but runs from {low:.4g} to {high:.4g}"
        raise ValueError(msg)
    return full.data


def totals(
    stack: xr.DataArray, mask: Mask, watch: Watch
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the sum and the number of the finite pixels of a region, frame after frame."""
    sums = np.zeros(stack.shape[:2])
    counts = np.zeros(stack.shape[:2], dtype=np.intp)
    for part, phase in parts_over_time(stack):
        # Phase may be in memory, and a mask of the same length need not be.
        times = max(1, PART_BYTES // 4 // max(phase[0].size, 1))
        for begin in range(0, len(phase), times):
            watch.check()
            start = part.start + begin
            inside = np.asarray(mask[start : min(start + times, part.stop)])
            for time, angle in np.ndindex(*inside.shape[:2]):
                frame = (start + time, angle)
                values = phase[begin + time, angle][inside[time, angle]]
                known = values[np.isfinite(values)]
                sums[frame], counts[frame] = known.sum(dtype=np.float64), known.size
    return sums.ravel(), counts.ravel()


def phase_columns(
    sums: NDArray[np.float64],
    counts: NDArray[np.intp],
    pixel_um2: float,
    optics: Optics,
    object_index: float | None,
    scale: NDArray[np.float64],
) -> dict[str, NDArray[Any]]:
    """Return the columns of phase, optical path and, where it can be told, height and volume.

    ``scale`` is what phase of each frame is multiplied by to be that at the optics' wavelength.
    """
    mean = np.full(sums.shape, np.nan)
    np.divide(sums, counts, out=mean, where=counts > 0)
    columns = {
        "mean phase (rad)": mean,
        "mean optical path difference (nm)": NM_PER_UM * optics.optical_path_um(mean * scale),
    }
    if object_index is not None:
        # All of these are proportional to phase, so that they may be taken of its sum.
        columns["mean height (um)"] = optics.height_um(mean * scale, object_index)
        columns["volume (um^3)"] = optics.height_um(sums * scale, object_index) * pixel_um2
    return columns


def frames_of(stack: xr.DataArray) -> dict[str, NDArray[np.float64]]:
    """Return the time and the angle of frame after frame."""
    places = [
        np.asarray(stack[dim].values if dim in stack.coords else [np.nan], dtype=np.float64)
        for dim in ("time", "angle")
    ]
    times, angles = np.meshgrid(*places, indexing="ij")
    return {"time (s)": times.ravel(), "angle (deg)": angles.ravel()}


def light_column(stack: xr.DataArray) -> dict[str, NDArray[np.float64]]:
    """Return the wavelength of frame after frame, where views differ in it."""
    light = wavelengths_of(stack)
    if light is None or WAVELENGTH not in stack.coords:
        return {}
    return {"wavelength (um)": np.tile(light, stack.shape[0])}


def on_four_axes(unwrapped: xr.DataArray | Any) -> xr.DataArray:
    """Return phase with all four dims, or say what is wrong with it."""
    if not isinstance(unwrapped, xr.DataArray):
        msg = f"the phase must be a DataArray with coordinates, but is {type(unwrapped).__name__}"
        raise TypeError(msg)
    unwrapped = unwrapped_stack(unwrapped, "the phase")
    bare = [str(dim) for dim in unwrapped.dims if dim not in unwrapped.coords]
    if bare:
        msg = (
            f"the phase has no coordinates along {', '.join(bare)}; "
            "give it seconds, degrees and micrometres with assign_coords"
        )
        raise ValueError(msg)
    return unwrapped.expand_dims([d for d in AXES if d not in unwrapped.dims]).transpose(*AXES)


def pixel_area_um2(stack: xr.DataArray) -> float:
    """Return the area of one pixel in square micrometres, from the coordinates."""
    return math.prod(pixel_um(stack, "the phase"))


def fitted(name: str, mask: Any, stack: xr.DataArray) -> Mask:
    """Return a region's mask in the shape of the phase, without a copy."""
    dtype = getattr(mask, "dtype", None) or np.asarray(mask).dtype
    if dtype != np.bool_:
        msg = f"the mask of {name} is {dtype}; make masks of labels with region_masks"
        raise TypeError(msg)
    full = mask_on(mask, stack, f"the mask of {name}")
    if full.shape == stack.shape:  # lazy ones, as large as the phase, stay so
        fit: Mask = full
        return fit
    return np.broadcast_to(np.asarray(full), stack.shape)


def checked_regions(regions: Any) -> Mapping[str, Any]:
    """Return regions by their names, or say what is wrong with them."""
    if not isinstance(regions, Mapping):
        msg = (
            f"regions must be a mapping of names to masks, but are {type(regions).__name__}; give "
            '{"cell": mask}, or region_masks(labels)'
        )
        raise TypeError(msg)
    if not regions:
        msg = "there is no region to measure; draw at least one"
        raise ValueError(msg)
    return regions


def check_numbers(
    stack: xr.DataArray,
    optics: Any,
    object_index: float | None,
    refraction_increment_ml_per_g: float,
) -> None:
    """Raise ValueError for numbers that can't be, and for optics of another wavelength."""
    if not isinstance(optics, Optics):
        msg = f"optics must be an Optics, but is {shown(optics)}; give Optics(wavelength_um=...)"
        raise TypeError(msg)
    noted = None
    if WAVELENGTH not in stack.coords and "wavelength_um" in stack.attrs:
        noted = stack.attrs["wavelength_um"]
    if noted is not None:
        noted = check_number('attrs["wavelength_um"] of the phase', noted)
    if noted is not None and not math.isclose(noted, optics.wavelength_um, rel_tol=1e-6):
        msg = (
            f"the phase was measured at a wavelength of {noted:g} um, but the optics say "
            f"{optics.wavelength_um:g} um; give the optics of the recording"
        )
        raise ValueError(msg)
    if object_index is not None:
        index = check_number("object_index", object_index)
        if not 1 <= index <= LARGE_INDEX:
            msg = f"object_index must lie between 1 and {LARGE_INDEX:g}, but is {index:g}"
            raise ValueError(msg)
        if index < optics.medium_index:
            warn(
                f"the object's refractive index, {index:g}, is below that of the medium, "
                f"{optics.medium_index:g}, so heights and volumes come out negative"
            )
    increment = check_number("refraction_increment_ml_per_g", refraction_increment_ml_per_g)
    if math.isfinite(increment) and increment > 0 and not 0.05 <= increment <= 1:
        warn(
            f"a refraction increment of {increment:g} mL/g is unusual: cells have 0.18 to 0.21; "
            "is it in another unit?"
        )
    if not (math.isfinite(increment) and increment > 0):
        msg = f"refraction_increment_ml_per_g must be a number above 0, but is {shown(increment)}"
        raise ValueError(msg)
