"""Wrapped phase in files of any program: what its axes are, and what tells it from holograms."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from napari_phase4d.io.hdf5 import HDF5_SUFFIXES, read_hdf5
from napari_phase4d.io.microscopes import is_koala_phase, read_koala_phase
from napari_phase4d.io.raw import holds_holograms, read_npy, read_npz
from napari_phase4d.io.reading import check_there
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.results import is_result, read_results, result_attrs
from napari_phase4d.io.tiff import TIFF_SUFFIXES, read_tiff
from napari_phase4d.io.video import (
    TIME,
    Video,
    axes_in_words,
    check_fits,
    choice,
    sensible,
    taken_for_time,
)
from napari_phase4d.io.zarr_files import is_zarr, read_zarr
from napari_phase4d.later import xr
from napari_phase4d.optics import pixel_note
from napari_phase4d.stacks import (
    AXES,
    PLAIN_AXES,
    coordinate,
    looks_wrapped,
    spacing,
)
from napari_phase4d.words import (
    as_numbers,
    as_path,
    check_positive,
    shown,
)

__all__ = ["PhaseBy", "file_pixel_um", "holds_phase", "open_phase", "open_truth", "phase_by"]

#: Names looked for first in an .npz file with several arrays.
PHASE_NAMES = ("wrapped", "phase", "unwrapped")
#: What to do with phase that is no file.
ARRAYS = "phase that is an array already goes to unwrap() as it is"
#: No pixel in a sample is wider.
LARGE_PIXEL_UM = 1e4
#: How a note begins that names what a file does not say.
COUNTED_IN_ONES = "Not in the file, so counted in ones: "
#: What a file may not say, as notes call it -> the axes of which it tells the places.
AXES_OF_GAP = {"pixel": ("y", "x"), "frame rate": ("time",), "viewing angles": ("angle",)}
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
    return phase_with_gaps(path, dataset, pixel_um, frame_rate_hz, angles_deg)[0]


def open_truth(path: str | Path) -> xr.DataArray:
    """Read exact phase from a file, see `open_phase`, without the places that it does not note.

    Counted in ones they would be others than those of the phase that it is held against.
    """
    phase, missing = phase_with_gaps(path)
    return phase.drop_vars([axis for gap in missing for axis in AXES_OF_GAP[gap]])


def phase_with_gaps(
    path: str | Path,
    dataset: str | None = None,
    pixel_um: float | None = None,
    frame_rate_hz: float | None = None,
    angles_deg: Sequence[float] | None = None,
) -> tuple[xr.DataArray, list[str]]:
    """Return what `open_phase` does, and which of the keys of `AXES_OF_GAP` nobody knows."""
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
        named = found.attrs.get("object", path.stem)
        return found.assign_attrs(source=str(path), object=named), []
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
    full = stack.expand_dims([d for d in AXES if d not in dims]).transpose(*AXES)
    if video.lost:
        full = full.copy()
        full[{"time": list(video.lost)}] = np.nan
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
    return full.assign_coords(coords).assign_attrs(attrs), missing


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
    given = dict(zip(AXES_OF_GAP, (known_um, rate, angles_deg), strict=True))
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

    Parameters
    ----------
    path : str or Path
        A file, a folder or the address of a store.
    dataset : str, optional
        Which array of a file that holds several. Default: the one that is found by itself.

    Returns
    -------
    bool
        False also if it is not there or can't be read as phase.
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


def plain_phase(path: Path, dataset: str | None) -> Video:
    """Return the numbers of a file that says nothing about them, lazily where it allows that."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return read_npy(path)
    if suffix == ".npz":
        return read_npz(path, dataset, PHASE_NAMES, (2, 3, 4))
    if suffix in TIFF_SUFFIXES:
        return read_tiff(path, dataset)
    if suffix in HDF5_SUFFIXES:
        return read_hdf5(path, dataset)
    if is_zarr(path):
        return read_zarr(path, dataset)
    if is_koala_phase(path):
        return read_koala_phase(path)
    msg = (
        f"{path.name} is of a kind that can't be read as phase; use OME-TIFF, OME-Zarr, HDF5, "
        ".npy, .npz or .bin of Koala"
    )
    raise OSError(msg)
