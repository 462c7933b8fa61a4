"""4-D phase in files: results as OME-TIFF or OME-Zarr, tables, wrapped phase of any program."""

from __future__ import annotations

import json
import uuid
from collections.abc import Sequence
from contextlib import closing
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from napari_phase4d.io.atomic import written_whole
from napari_phase4d.io.describing import (
    PROGRAM,
    checked,
    described,
    is_even,
    name_of,
    restored,
    slabs,
    stack_of,
    step_of,
    view_names,
)
from napari_phase4d.io.lazy import in_one_line
from napari_phase4d.io.microscopes import is_koala_phase
from napari_phase4d.io.plain_phase import plain_phase
from napari_phase4d.io.raw import holds_holograms
from napari_phase4d.io.reading import check_there
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.tiff import check_described
from napari_phase4d.io.video import (
    TIME,
    Video,
    axes_in_words,
    check_fits,
    choice,
    quiet,
    sensible,
    taken_for_time,
)
from napari_phase4d.io.zarr_files import check_zarr_or_none
from napari_phase4d.io.zarr_results import read_zarr_result, write_zarr_result, zarr_description
from napari_phase4d.later import pd, tifffile, xr
from napari_phase4d.optics import pixel_note
from napari_phase4d.stacks import (
    AXES,
    PLAIN_AXES,
    coordinate,
    in_units,
    looks_wrapped,
    spacing,
    with_coordinates,
)
from napari_phase4d.task import UNWATCHED, CancelledCall, ProgressCall, Task
from napari_phase4d.words import (
    as_numbers,
    as_path,
    check_positive,
    checked_call,
    local_path,
    shown,
)

__all__ = [
    "PhaseBy",
    "file_pixel_um",
    "holds_phase",
    "is_result",
    "open_phase",
    "phase_by",
    "read_results",
    "read_tiff_result",
    "result_attrs",
    "tiff_description",
    "write_phase",
    "write_table",
    "write_tiff_result",
]

#: Pixels up to this size leave room for the directory in a file whose places are 32 bits wide.
CLASSIC_BYTES = 2**32 - 2**27
#: Numbers that an OME-TIFF can hold.
OME_TYPES = tuple(
    np.dtype(name)
    for name in (
        "bool", "int8", "int16", "int32", "uint8", "uint16", "uint32", "float32", "float64",
        "complex64", "complex128",
    )
)  # fmt: skip
#: Ids of files are made from what is noted in them, so that the same run gives the same bytes.
NAMESPACE = uuid.uuid5(uuid.NAMESPACE_OID, PROGRAM)


def write_tiff_result(
    path: Path,
    stack: xr.DataArray,
    task: Task = UNWATCHED,
) -> None:
    """Write a stack (time, angle, y, x) as OME-TIFF, some frames at a time."""
    metadata = ome_metadata(stack)
    with (
        written_whole(path) as temporary,
        closing(slabs(stack, task)) as parts,
    ):
        tifffile.imwrite(
            temporary,
            (frame for _, values in parts for frame in values.reshape(-1, *values.shape[2:])),
            shape=stack.shape,
            dtype=stack.dtype,
            ome=True,
            bigtiff=stack.nbytes > CLASSIC_BYTES,
            photometric="minisblack",
            metadata=metadata,
        )


def ome_metadata(stack: xr.DataArray) -> dict[str, Any]:
    """Return what OME can say of a stack, and in its description what it can't."""
    times = np.asarray(stack["time"].values, dtype=np.float64)
    n_angles = stack.sizes["angle"]
    description = json.dumps(described(stack))
    metadata: dict[str, Any] = {
        "axes": "TCYX",
        "UUID": str(uuid.uuid5(NAMESPACE, f"{stack.shape} {stack.dtype} {description}")),
        # The description has the whole name; tifffile before 2026.2.24 doesn't escape quotes here.
        "Name": name_of(stack).replace('"', "'"),
        "Channel": {"Name": view_names(stack)},
        "PhysicalSizeX": step_of(stack["x"].values),
        "PhysicalSizeXUnit": "µm",
        "PhysicalSizeY": step_of(stack["y"].values),
        "PhysicalSizeYUnit": "µm",
        "TimeIncrement": step_of(times),
        "TimeIncrementUnit": "s",
        "Description": description,
    }
    if not is_even(times):
        metadata["Plane"] = {
            "DeltaT": [float(t) for t in np.repeat(times, n_angles)],
            "DeltaTUnit": ["s"] * (len(times) * n_angles),
        }
    return metadata


def read_tiff_result(path: Path) -> xr.DataArray:
    """Read a stack that `write_tiff_result` wrote.

    Raises
    ------
    OSError
        If the file is missing, damaged, or was not written by this program.
    """
    try:
        with quiet(), tifffile.TiffFile(path) as tif:
            description = description_of(tif)
            if description is None:
                msg = f"{path.name} holds no phase written by napari-phase4d"
                raise OSError(msg)
            check_described(tif, path)
            check_size(tif, description, path)
            return stack_of(description, tif.asarray())
    except OSError:
        raise
    except Exception as error:  # tifffile raises what it likes for damaged files
        msg = f"{path.name} can't be read; it may be cut short or damaged ({in_one_line(error)})"
        raise OSError(msg) from error


def check_size(tif: tifffile.TiffFile, description: dict[str, Any], path: Path) -> None:
    """Raise OSError if the pixels are not those described; nothing of them is read."""
    wanted = tuple(len(places) for places in description["coords"].values())
    series = tif.series[0]
    if int(np.prod(series.shape, dtype=object)) != int(np.prod(wanted, dtype=object)):
        msg = f"{path.name} is damaged: it has {series.shape} pixels, but notes {wanted}"
        raise OSError(msg)
    size = path.stat().st_size
    needed = 0 if series.dataoffset is None else series.dataoffset + series.nbytes
    if needed > size:
        msg = f"{path.name} is cut short: its frames need {needed} bytes, the file has {size}"
        raise OSError(msg)
    check_fits(series.nbytes, path.name)


def tiff_description(path: str | Path) -> dict[str, Any] | None:
    """Return what `write_tiff_result` noted in a file, or None if it did not write it."""
    try:
        with quiet(), tifffile.TiffFile(path) as tif:
            return description_of(tif)
    except Exception:  # of a damaged file, which whoever reads it will tell
        return None


def description_of(tif: tifffile.TiffFile) -> dict[str, Any] | None:
    """Return what `write_tiff_result` noted in an open file."""
    if not tif.is_ome or PROGRAM not in (tif.ome_metadata or ""):
        return None
    try:
        image = tifffile.xml2dict(tif.ome_metadata)["OME"]["Image"]
        return checked(json.loads(str(image.get("Description", ""))))
    except (ValueError, KeyError, TypeError, AttributeError, SyntaxError):
        return None


# ---- results of any form --------------------------------------------------------------------


#: What the name of an OME-Zarr ends with; everything else is written as OME-TIFF.
ZARR_SUFFIX = ".zarr"


def write_phase(
    path: str | Path,
    stack: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Path:
    """Write a 4-D stack as OME-TIFF or OME-Zarr with pixel size, times, angles and provenance.

    Lazy stacks are computed and written some frames at a time, so that they may be larger than
    memory. The same stack gives the same bytes.

    The viewing angles lie on the channel axis, which OME has no better name for, and name the
    channels. Angles, times, places and attributes are also noted as they are, from where
    `read_results` restores them exactly: in the description of an OME-TIFF, and in the attribute
    "napari-phase4d" of an OME-Zarr.

    Parameters
    ----------
    path : str or Path
        File to write, replaced if it exists: a name that ends with ``.zarr``, by custom
        ``.ome.zarr``, gives a folder in OME-Zarr 0.5 (Zarr 3, one chunk a frame, compressed); any
        other, by custom ``.ome.tif``, gives an OME-TIFF (BigTIFF beyond 4 GB).
    stack : xarray.DataArray
        Dims (time, angle, y, x), backed by NumPy or dask.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was. So is a folder
        that is no Zarr.
    TypeError, ValueError
        If the stack has other dims, no pixels, places that are no numbers, or numbers that such a
        file can't hold.
    Cancelled
        If ``cancelled()`` returned True; an older file of that name is then left as it was.

    See Also
    --------
    read_results : Reads it back.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> yeast = p4d.simulation.budding_yeast(n_times=3)
    >>> path = p4d.write_phase("yeast.ome.tif", yeast["wrapped"])
    >>> p4d.read_results(path).equals(yeast["wrapped"])
    True
    """
    path = local_path(path)
    if not isinstance(stack, xr.DataArray) or set(stack.dims) != set(AXES):
        msg = "only a DataArray with dims time, angle, y and x can be written as a result"
        raise TypeError(msg)
    if 0 in stack.shape:
        msg = f"the stack for {path.name} is empty: its shape is {stack.shape}"
        raise ValueError(msg)
    stack = stack.transpose(*AXES)
    plain = all(stack[axis].dtype.kind in "iuf" for axis in AXES)
    stack = in_units(stack, "the stack") if plain else with_coordinates(stack, "the stack")
    task = Task(progress, cancelled)
    if path.suffix.lower() == ZARR_SUFFIX:
        check_zarr_or_none(path)
        write_zarr_result(path, stack, task)
    else:
        if stack.dtype.newbyteorder("=") not in OME_TYPES:
            msg = (
                f"an OME-TIFF can't hold numbers of {stack.dtype}; give them as float32, as "
                'stack.astype("float32") does, or write a .ome.zarr'
            )
            raise TypeError(msg)
        write_tiff_result(path, stack, task)
    return path


def read_results(path: str | Path) -> xr.DataArray:
    """Read a stack that `write_phase` wrote: same numbers, coordinates and attributes.

    The numbers of an OME-Zarr stay on disk, as a dask array of one frame a chunk, and are read
    when they are used.

    Raises
    ------
    OSError
        If the file is missing, damaged, or was not written by this program.

    See Also
    --------
    write_phase : Writes it, with an example.
    """
    path = local_path(path)
    if not path.exists():
        msg = f"there is no file or folder {path}"
        raise FileNotFoundError(msg)
    return read_zarr_result(path) if path.is_dir() else read_tiff_result(path)


def is_result(path: str | Path) -> bool:
    """Say whether a file or folder was written by `write_phase`."""
    return result_attrs(path) is not None


def result_attrs(path: str | Path) -> dict[str, Any] | None:
    """Return the attributes of what `write_phase` wrote to a file here, None for any other."""
    if address_of(path) is not None:
        return None
    path = local_path(path)
    if path.exists() and not (path.is_dir() or path.is_file()):  # a pipe would be waited for
        return None
    description = zarr_description(path) if path.is_dir() else tiff_description(path)
    return None if description is None else dict(restored(description.get("attrs", {})))


def as_table_file(path: str | Path) -> Path:
    """Return the name that a table is written under."""
    path = local_path(path)
    if path.suffix.lower() not in ("", ".csv"):
        msg = f"a table is written as .csv, but the name is {path.name}"
        raise ValueError(msg)
    return path if path.suffix else path.with_suffix(".csv")


@checked_call
def write_table(path: str | Path, table: pd.DataFrame) -> Path:
    """Write a table as CSV and return its path, which gets the ending .csv if it has none.

    Raises
    ------
    ValueError
        If the name has another ending.
    OSError
        If it can't be written; an older file of that name is then left as it was.
    """
    path = as_table_file(path)
    with written_whole(path) as temporary:
        table.to_csv(temporary)
    return path


# ---- wrapped phase of any program -----------------------------------------------------------


#: What to do with phase that is no file.
ARRAYS = "phase that is an array already goes to unwrap() as it is"
#: No pixel in a sample is wider.
LARGE_PIXEL_UM = 1e4
#: How a note begins that names what a file does not say.
COUNTED_IN_ONES = "Not in the file, so counted in ones: "
#: Axes that views lie on in files of other programs: channels, and angles.
VIEWS = "CA"


def open_phase(
    path: str | Path,
    dataset: str | None = None,
    *,
    pixel_um: float | None = None,
    frame_rate_hz: float | None = None,
    angles_deg: Sequence[float] | None = None,
) -> xr.DataArray:
    """Read a stack of phase in radians.

    Parameters
    ----------
    path : str or Path
        An OME-TIFF or OME-Zarr that this program wrote, with its times, angles and pixels; a
        .npy, .npz or TIFF file with (y, x), (time, y, x) or (time, angle, y, x); an HDF5, Zarr or
        OME-Zarr of any program with (y, x) or (time, y, x); or phase of Koala, a .bin file or a
        folder of them. Axes that a TIFF names are taken by their names: of T and another one T is
        time, and channels are views.
    dataset : str, optional
        Which array of an .npz, HDF5 or Zarr file, or which place on further axes of a TIFF or
        OME-Zarr, as "C=0". Default, for .npz: ``wrapped``, ``phase`` or ``unwrapped``, else the
        first with two to four dimensions; for HDF5 and Zarr: as for holograms.
    pixel_um, frame_rate_hz, angles_deg : float, float, sequence of float, optional
        Pixel in the sample, frames per second and viewing angles of a file that does not say
        them; default 1 um, 1 a second, and numbers from 0. ``attrs["notes"]`` says what had to be
        assumed.

    Returns
    -------
    xarray.DataArray
        float32, dims (time, angle, y, x).

    Raises
    ------
    OSError
        If the file is missing, damaged, or of a kind that can't be read.
    ValueError
        If it holds no such stack.
    """
    path = as_path(path, ARRAYS)
    if pixel_um is not None:
        check_positive("pixel_um", pixel_um, LARGE_PIXEL_UM)
    if frame_rate_hz is not None:
        check_positive("frame_rate_hz", frame_rate_hz)
    if angles_deg is not None:
        check_angles(angles_deg)
    check_there(path)
    if is_result(path):
        found = read_results(path)
        return found.assign_attrs(source=str(path), object=found.attrs.get("object", path.stem))
    video = plain_phase(path, dataset)
    values = video.frames
    if values.ndim not in PLAIN_AXES or values.dtype.kind != "f" or 0 in values.shape:
        msg = (
            f"{path.name} holds {values.dtype} numbers of shape {values.shape}; phase is a stack "
            "of floating-point radians (y, x), (time, y, x) or (time, angle, y, x)"
        )
        raise ValueError(msg)
    check_fits(values.size * np.dtype(np.float32).itemsize, path.name)
    dims, notes = axes_of_phase(video, path.name)
    stack = xr.DataArray(np.asarray(values, dtype=np.float32), dims=dims, name=path.stem)
    if video.lost:
        stack = stack.copy()
        stack[{"time": list(video.lost)}] = np.nan
    full = stack.expand_dims([d for d in AXES if d not in dims]).transpose(*AXES)
    if angles_deg is not None and len(angles_deg) != full.sizes["angle"]:
        msg = (
            f"{path.name} has {full.sizes['angle']} views, but {len(angles_deg)} angles are given"
        )
        raise ValueError(msg)
    coords, missing = places_of_phase(full, video, pixel_um, frame_rate_hz, angles_deg)
    attrs: dict[str, Any] = {
        "units": "rad",
        "object": path.stem,
        "source": address_of(path) or str(path),
    }
    notes += place_notes(pixel_um, video, missing)
    if notes:
        attrs["notes"] = notes
    return full.assign_coords(coords).assign_attrs(attrs)


def places_of_phase(
    stack: xr.DataArray,
    video: Video,
    pixel_um: float | None,
    frame_rate_hz: float | None,
    angles_deg: Sequence[float] | None,
) -> tuple[dict[str, Any], list[str]]:
    """Return coordinates by what is given, else by the file, and what neither of them says."""
    height_um = pixel_um
    if pixel_um is None:
        pixel_um = sensible(video.pixel_um)
        height_um = sensible(video.height_um) if pixel_um else None
    interval_s = sensible(video.interval_s) if frame_rate_hz is None else 1 / frame_rate_hz
    times_s = video.times_s if frame_rate_hz is None else None
    steps = {"time": interval_s or 1, "y": height_um or pixel_um or 1, "x": pixel_um or 1}
    places = {d: np.arange(stack.sizes[d]) * float(steps.get(d, 1)) for d in AXES}
    if times_s is not None:
        places["time"] = times_s
    if angles_deg is not None:
        places["angle"] = np.asarray(angles_deg, dtype=np.float64)
    rate = interval_s if times_s is None else times_s
    # To be told a pixel of 1 um is to count in ones, as the optics of who knows no pixel do.
    known_um = None if pixel_um == 1 and not sensible(video.pixel_um) else pixel_um
    given = {"pixel": known_um, "frame rate": rate, "viewing angles": angles_deg}
    missing = [name for name, value in given.items() if value is None]
    return {d: coordinate(d, places[d]) for d in AXES}, missing


def place_notes(pixel_um: float | None, video: Video, missing: Sequence[str]) -> list[str]:
    """Return notes of a pixel that is not the file's, and of what had to be counted."""
    other = "" if pixel_um is None else pixel_note(pixel_um, sensible(video.pixel_um))
    counted = f"{COUNTED_IN_ONES}{', '.join(missing)}." if missing else ""
    return [note for note in (other, counted) if note]


def file_pixel_um(phase: xr.DataArray) -> float | None:
    """Return the width of a camera pixel in the sample that a file of phase names, None if none.

    Parameters
    ----------
    phase : xarray.DataArray
        What `open_phase` has read without being told a pixel.
    """
    notes = phase.attrs.get("notes", ())
    if any(note.startswith(f"{COUNTED_IN_ONES}pixel") for note in notes) or phase.sizes["x"] < 2:
        return None
    ratio = float(phase.attrs.get("pixel_ratio", (1, 1))[1])
    return spacing(phase, "x", str(phase.name)) / ratio


def axes_of_phase(video: Video, name: str) -> tuple[tuple[str, ...], list[str]]:
    """Return the axes of phase by the letters of the file, and its notes.

    Raises
    ------
    ValueError
        If of two axes before y and x none is time.
    """
    n_axes, notes = video.frames.ndim, list(video.notes)
    further = video.axes[:-2] if len(video.axes) == n_axes else ""
    in_time = [axis for axis in further if axis in TIME]
    if not further or (len(in_time) > 1 and "T" not in in_time):
        return PLAIN_AXES[n_axes], notes
    if video.loose_axes and "T" not in further:
        return PLAIN_AXES[n_axes], [*notes, *taken_by_place(further)]
    if len(further) > 1 and not in_time:
        words = axes_in_words(video.axes, video.frames.shape)
        msg = (
            f"{name} has {words}, none of which is time; phase is a stack (time, angle, y, x), so "
            f"choose one place, as with {choice(further[:1])}"
        )
        raise ValueError(msg)
    time = "T" if "T" in further else (in_time or [a for a in further if a not in VIEWS])[:1]
    dims = tuple("time" if axis in time else "angle" for axis in further)
    for axis, dim in zip(further, dims, strict=True):
        if dim == "time" and axis not in TIME:
            notes.append(taken_for_time(axis))
        elif dim == "angle" and axis not in TIME and (len(further) == 1 or axis not in VIEWS):
            notes.append(f"The axis {axis} is taken for views.")
    return (*dims, "y", "x"), notes


def taken_by_place(further: str) -> list[str]:
    """Return the note that axes before y and x are taken by their place, whatever they are called.

    Two of them are those of a stack (time, angle, y, x).
    """
    if len(further) == 1:
        return [taken_for_time(further)]
    return [f"The axes {' and '.join(further)} are taken for time and views."]


def check_angles(angles_deg: Any) -> None:
    """Refuse what is no list of different angles in degrees."""
    angles = as_numbers("angles_deg", angles_deg)
    if angles.ndim != 1 or angles.dtype.kind == "b":
        msg = (
            f"angles_deg must be a list of degrees, one for each view, but is {shown(angles_deg)}"
        )
        raise TypeError(msg)
    if not np.isfinite(angles).all() or np.unique(angles).size < angles.size:
        msg = (
            f"angles_deg must be finite and different from each other, but is {shown(angles_deg)}"
        )
        raise ValueError(msg)


def holds_phase(path: str | Path, dataset: str | None = None) -> bool:
    """Say whether a file holds wrapped phase rather than holograms.

    Holograms are counts of light; wrapped phase lies within half a cycle of zero, on both sides,
    and spans more than half a cycle. Stacks of four dimensions are phase. Of files that this
    program wrote, those in radians are that no method has unwrapped; of those without a unit, as
    a script may write them, those whose numbers are such.
    """
    return phase_by(path, dataset) is not None


class PhaseBy(Enum):
    """What tells that a file holds wrapped phase."""

    NOTED = "what the file says"
    VIEWS = "its four axes"
    NUMBERS = "its numbers"


def phase_by(path: str | Path, dataset: str | None = None) -> PhaseBy | None:
    """Return what tells that a file holds wrapped phase, None if nothing does."""
    path = Path(path)
    if not path.exists() and address_of(path) is None:
        return None
    noted = result_attrs(path)
    if noted is not None and "units" in noted:
        is_phase = noted["units"] == "rad" and "method" not in noted
        return PhaseBy.NOTED if is_phase else None
    if noted is None and is_koala_phase(path):
        return PhaseBy.NOTED
    try:
        if noted is not None:  # amplitude has four axes as well
            is_phase = "method" not in noted and looks_wrapped(read_results(path).data)
            return PhaseBy.NUMBERS if is_phase else None
        if path.suffix.lower() == ".npz" and dataset is None and holds_holograms(path):
            return None
        values = plain_phase(path, dataset).frames
    except (OSError, ValueError):
        return None
    if is_stack_of_views(values):
        return PhaseBy.VIEWS
    return PhaseBy.NUMBERS if values.ndim in PLAIN_AXES and looks_wrapped(values) else None


def is_stack_of_views(values: Any) -> bool:
    """Say whether numbers have four axes, as holograms never do."""
    return bool(values.dtype.kind == "f" and values.ndim == 4 and 0 not in values.shape)
