"""One door for every kind of recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from napari_phase4d.io.phases import PhaseBy, open_phase, phase_by
from napari_phase4d.io.raw import RawLayout
from napari_phase4d.io.reading import (
    JOINED_SUFFIXES,
    READABLE_SUFFIXES,
    check_there,
    folder_of_list,
    read_list,
    read_video,
)
from napari_phase4d.io.remote import address_of
from napari_phase4d.io.results import result_attrs
from napari_phase4d.io.video import (
    LARGEST_SIDE,
    TIME,
    Video,
    axes_in_words,
    axes_to_choose,
    choice,
    colour_sentence,
    memory_lacks,
    sensible,
    taken_for_time,
)
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics, optics_for_pixel
from napari_phase4d.recording import Recording
from napari_phase4d.stacks import (
    PLAIN_AXES,
    check_pixel,
    check_rising,
    doubt_numbers,
    factor_to,
    looks_wrapped,
    spacing,
    times_in_s,
    with_coordinates,
)
from napari_phase4d.warned import warn
from napari_phase4d.words import (
    as_path,
    check_type,
    is_table,
    printable,
)

__all__ = [
    "JOINED_SUFFIXES",
    "READABLE_SUFFIXES",
    "open_input",
    "open_recording",
    "recording_of",
]

#: Share of the free memory that a single frame may take.
SHARE_OF_A_FRAME = 0.25
#: Noted of a list of files that is not what its folder opens as.
NO_NAME = "A recipe can't name these files, as their folder holds others, or in another order."
#: Noted of phase that is told from holograms by nothing else; these may be normalised.
TAKEN_FOR_PHASE = (
    "Taken for wrapped phase, as its numbers lie between -pi and pi; if they are holograms, say "
    "so (content='holograms')."
)


def open_recording(
    path_or_array: Any,
    optics: Optics | None = None,
    frame_rate_hz: float | None = None,
    *,
    dataset: str | None = None,
    raw: RawLayout | None = None,
) -> Recording:
    """Open a hologram video, lazily where the format allows it.

    Parameters
    ----------
    path_or_array : str, Path, list of them, array, DataArray, napari layer or Recording
        A TIFF, film, HDF5, Zarr, NPY, NPZ, raw or image file, see "What can be opened"
        among the how-tos; a folder of images or stacks, or a name with ``*``, or a list of files,
        joined over time; a recording of Koala; an array (time, y, x) or (y, x) of NumPy, dask or
        xarray; or a napari image layer.
    optics : Optics, optional
        The microscope. Default: that of the paper, its magnification set so that the pixel is as
        wide as the file says (where it says so).
    frame_rate_hz : float, optional
        Frames per second. Default: what the file says, else 1.
    dataset : str, optional
        Which array of an HDF5, Zarr or .npz file, or which place on axes other than time, y
        and x, such as "Z=0".
    raw : RawLayout, optional
        How frames lie in a raw file, which can't say it.

    Returns
    -------
    Recording
        Its ``kind`` says what was read, its ``notes`` what had to be assumed.

    Raises
    ------
    OSError
        If a file is missing, damaged, or of a kind that can't be read.
    TypeError, ValueError
        If the data are no hologram video.

    See Also
    --------
    find_lobes : What comes next.
    run : Opens and does all that a recipe says.

    Examples
    --------
    >>> import numpy as np
    >>> import napari_phase4d as p4d
    >>> frames = np.zeros((12, 512, 512), np.uint8)
    >>> rec = p4d.open_recording(frames, p4d.Optics(magnification=52), frame_rate_hz=6)
    >>> rec.n_frames, rec.frame_shape, rec.optics.pixel_um
    (12, (512, 512), 0.1)

    The same of a file; what had to be assumed is noted:

    >>> np.save("video.npy", frames)
    >>> for note in p4d.open_recording("video.npy").notes:
    ...     print(note)
    The frame rate is not in the data; 1 frame a second is assumed.
    The microscope is not in the data; that of the paper is assumed.
    """
    if optics is not None:
        check_type("optics", optics, Optics, "give Optics(wavelength_um=...)")
    if isinstance(path_or_array, Recording):
        return path_or_array.calibrated(optics, frame_rate_hz)
    if isinstance(path_or_array, (str, Path)):
        path = as_path(path_or_array).expanduser()
        video = read_video(path, dataset, raw)
        source = address_of(path) or str(path)
        found = recording_of(video, path.name, source, optics, frame_rate_hz)
        return replace(found, dataset=dataset, raw=raw)
    if is_list_of_paths(path_or_array):
        files = [as_path(p).expanduser() for p in path_or_array]
        found = open_list(files, read_list(files, None, dataset, raw), raw, optics, frame_rate_hz)
        return replace(found, dataset=dataset, raw=raw)
    if isinstance(path_or_array, xr.DataArray):
        return open_data_array(path_or_array, optics, frame_rate_hz)
    # In this order, since arrays of dates have no ``data``.
    if hasattr(path_or_array, "axis_labels") and hasattr(path_or_array, "data"):
        return open_layer(path_or_array, optics, frame_rate_hz)
    if is_table(path_or_array):
        msg = f"path_or_array is a {type(path_or_array).__name__}; give one array of it"
        raise TypeError(msg)
    if isinstance(path_or_array, np.ndarray) and looks_wrapped(path_or_array):
        warn(
            "the array lies between -pi and pi on both sides of zero, as wrapped phase does and "
            "light does not; give phase to unwrap()"
        )
    return recording_of(Video(path_or_array), "the array", "", optics, frame_rate_hz)


def open_list(
    files: Sequence[Path],
    video: Video,
    raw: RawLayout | None,
    optics: Optics | None,
    frame_rate_hz: float | None,
) -> Recording:
    """Return the recording that files make, with their folder as source if that opens so."""
    folder = folder_of_list(files, raw)
    if folder is None:
        video = replace(video, notes=(*video.notes, NO_NAME))
    source = "" if folder is None else str(folder)
    return recording_of(video, files[0].name, source, optics, frame_rate_hz)


def is_list_of_paths(given: Any) -> bool:
    """Say whether several files were given."""
    if not isinstance(given, (list, tuple)) or not given:
        return False
    return all(isinstance(one, (str, Path)) for one in given)


def open_input(
    path: str | Path,
    optics: Optics | None = None,
    frame_rate_hz: float | None = None,
    *,
    dataset: str | None = None,
    raw: RawLayout | None = None,
    angles_deg: Sequence[float] | None = None,
    content: str = "auto",
) -> Recording | xr.DataArray:
    """Open a file that holds holograms or wrapped phase.

    Parameters
    ----------
    path : str or Path
        The file or folder.
    optics, frame_rate_hz, dataset, raw
        See `open_recording`.
    angles_deg : sequence of float, optional
        Viewing angles of wrapped phase, where its file does not say them.
    content : str, optional
        "holograms", "phase", or "auto" (default) to look, see `holds_phase`. What
        only its numbers tell is noted.

    Returns
    -------
    Recording or xarray.DataArray
        The hologram video, or the stack (time, angle, y, x) of wrapped phase.

    Raises
    ------
    OSError, TypeError, ValueError
        If the file can't be read as such.
    """
    if as_path(path).exists():
        check_there(Path(path))  # a pipe would be waited for
    noted = result_attrs(path) or {}
    if "method" in noted:
        msg = (
            f"{Path(path).name} is unwrapped already, by {noted['method']}; give the wrapped phase"
        )
        raise ValueError(msg)
    why = phase_by(path, dataset) if content == "auto" else None
    if why is None and content != "phase":
        return open_recording(path, optics, frame_rate_hz, dataset=dataset, raw=raw)
    phase = open_phase(
        path,
        dataset,
        pixel_um=None if optics is None else optics.pixel_um,
        frame_rate_hz=frame_rate_hz,
        angles_deg=angles_deg,
    )
    if why is not PhaseBy.NUMBERS:
        return phase
    return phase.assign_attrs(notes=[*phase.attrs.get("notes", ()), TAKEN_FOR_PHASE])


def recording_of(
    video: Video,
    name: str,
    source: str,
    optics: Optics | None,
    frame_rate_hz: float | None,
) -> Recording:
    """Join a file's frames with the user's and the file's own facts.

    Parameters
    ----------
    video : Video
        Frames and what their file says of them.
    name : str
        How the recording is called on screen and in messages.
    source : str
        Where it was read from, so that it can be opened again.
    optics : Optics or None
        The microscope. None: that of the paper, with the magnification that gives the file's pixel
        where the file names one.
    frame_rate_hz : float or None
        Frames per second. None: the file's times or interval, else 1.

    Returns
    -------
    Recording
        Its ``notes`` say what had to be assumed.
    """
    frames = video.frames
    if video.colour and getattr(frames, "ndim", 0) >= 3:
        raise ValueError(colour_sentence(name))
    check_axes(video, name)
    check_frame_size(frames, name)
    notes = list(video.notes)
    interval, pixel = sensible(video.interval_s), sensible(video.pixel_um)
    times_s = None
    if frame_rate_hz is None and len(video.axes) == getattr(frames, "ndim", 0) == 3:
        notes += [taken_for_time(axis) for axis in video.axes[:1] if axis not in TIME]
    if frame_rate_hz is None and video.times_s is not None:
        times_s = video.times_s
    elif frame_rate_hz is None and interval is not None:
        frame_rate_hz = 1 / interval
    elif frame_rate_hz is None:
        notes.append("The frame rate is not in the data; 1 frame a second is assumed.")
    if optics is None and pixel is not None:
        notes += notes_of_height(sensible(video.height_um) or pixel, pixel)
        optics = optics_for_pixel(pixel)
        notes.append(
            f"The pixel is {pixel:.4g} um wide according to the file; "
            "check the wavelength of the microscope."
        )
    elif optics is None:
        notes.append("The microscope is not in the data; that of the paper is assumed.")
    recording = Recording.from_frames(
        frames,
        optics=optics,
        frame_rate_hz=frame_rate_hz,
        times_s=times_s,
        name=printable(name),
        source=source,
        notes=tuple(notes),
        kind=video.kind,
    )
    recording = replace(recording, file_pixel_um=pixel)
    return replace(recording, notes=(*recording.notes, *recording.pixel_notes))


def check_axes(video: Video, name: str) -> None:
    """Raise ValueError if a file has axes beyond time, y and x, and say how to choose."""
    shape = getattr(video.frames, "shape", ())
    if len(video.axes) != len(shape) or len(shape) <= 3:
        return
    left = axes_to_choose(video.axes, has_time="T" in video.axes)
    msg = (
        f"{name} has {len(shape)} dimensions, {axes_in_words(video.axes, shape)}; a hologram "
        f"video has three: time, y, x, so choose one place, as with {choice(left)}"
    )
    raise ValueError(msg)


def check_frame_size(frames: Any, name: str) -> None:
    """Raise ValueError if a frame is absurdly large, as a damaged file may say of its size."""
    shape = tuple(getattr(frames, "shape", ()))
    if len(shape) >= 2 and max(shape[-2:]) > LARGEST_SIDE:
        msg = (
            f"{name} says that its frames are {shape[-2]} x {shape[-1]} pixels, more than a "
            "camera has; it may be damaged"
        )
        raise ValueError(msg)
    if len(shape) < 2 or isinstance(frames, np.ndarray):
        return
    needed = math.prod(int(n) for n in shape[-2:]) * np.dtype(frames.dtype).itemsize
    if lacks := memory_lacks(needed, SHARE_OF_A_FRAME):
        msg = (
            f"one frame of {name} ({shape[-2]} x {shape[-1]} pixels) takes {lacks}; "
            "the file may be damaged"
        )
        raise ValueError(msg)


#: How programs write that numbers are phase.
RADIANS = ("rad", "radian", "radians")


def open_data_array(
    data: xr.DataArray, optics: Optics | None, frame_rate_hz: float | None
) -> Recording:
    """Take frames from an xarray array; its own times and pixels are kept."""
    axes, name = PLAIN_AXES[3], "the array" if data.name is None else str(data.name)
    if data.ndim in (2, 3) and not set(data.dims) <= set(axes):
        msg = f"the array has dims {tuple(data.dims)}; a hologram video has time, y and x"
        raise ValueError(msg)
    if data.attrs.get("units") in RADIANS:
        msg = f"{name} is phase in radians, as it notes, and no hologram; give it to unwrap()"
        raise ValueError(msg)
    if data.ndim in (2, 3):
        data = with_coordinates(data.transpose(*(d for d in axes if d in data.dims)), name)
        check_rising(data, name)
    in_time = "time" in data.dims and "time" in data.coords
    recording = recording_of(
        Video(
            data.data,
            times_s=times_in_s(data["time"].values) if in_time else None,
            pixel_um=square_pixel_um(data, name) if optics is None else noted_pixel_um(data),
        ),
        name,
        "",
        optics,
        frame_rate_hz,
    )
    recording.holograms.attrs.update({str(k): v for k, v in data.attrs.items()})
    return recording


def square_pixel_um(data: xr.DataArray, name: str) -> float | None:
    """Return the width of a pixel by the places along y and x, None where there are none.

    Without a unit they count as micrometres.

    Raises
    ------
    ValueError
        If it is not as high as wide, or in another unit.
    """
    known = [axis for axis in ("y", "x") if data.sizes.get(axis, 1) > 1 and axis in data.coords]
    steps = [spacing(data, axis, name) for axis in known]
    if steps:
        check_pixel(steps[0], steps[-1], name)
        doubt_numbers(data, name)
    if len(steps) == 2:
        check_square(steps[0], steps[1], name, "correct the coordinates, or give optics")
    return steps[-1] if steps else None


def noted_pixel_um(data: xr.DataArray) -> float | None:
    """Return the width of a pixel by the places along x where the microscope is given.

    Places that say nothing of it are no fault then: None.
    """
    if data.sizes.get("x", 1) < 2 or "x" not in data.coords:
        return None
    step = spacing(data, "x", "the array")
    return None if step == 1 and not data["x"].attrs.get("units") else step  # numbers of pixels


def notes_of_height(height_um: float, width_um: float) -> list[str]:
    """Return the note that a file names pixels which are not as high as wide, if it does."""
    if math.isclose(height_um, width_um, rel_tol=0.01):
        return []
    return [
        f"Pixels are {height_um:.4g} um high and {width_um:.4g} um wide according to the file; "
        "the width is taken for both, check it."
    ]


def check_square(height_um: float, width_um: float, name: str, advice: str) -> None:
    """Refuse pixels that are not as high as wide."""
    if not math.isclose(height_um, width_um, rel_tol=0.01):
        msg = (
            f"the pixels of {name} are {height_um:g} um high and {width_um:g} um wide, but must "
            f"be square; {advice}"
        )
        raise ValueError(msg)


def steps_in(wanted: str, scale: Sequence[float], units: Sequence[str]) -> list[float | None]:
    """Return steps along a layer's axes in a unit, None where it names none of that kind."""
    factors = [factor_to(unit, wanted) for unit in units]
    return [
        None if factor is None else step * factor
        for step, factor in zip(scale, factors, strict=True)
    ]


def open_layer(layer: Any, optics: Optics | None, frame_rate_hz: float | None) -> Recording:
    """Take frames from a napari image layer, with its time step where that is in seconds."""
    units = tuple(str(u) for u in getattr(layer, "units", ()))
    scale = tuple(float(s) for s in getattr(layer, "scale", ()))
    known = len(scale) == len(units) >= 2
    interval = steps_in("s", scale[:1], units[:1])[0] if known and len(scale) == 3 else None
    height, pixel = steps_in("um", scale[-2:], units[-2:]) if known else (None, None)
    if height and pixel and optics is None:
        check_square(height, pixel, str(layer.name), "correct the layer's scale, or give optics")
        check_pixel(height, pixel, str(layer.name))
    video = Video(
        layer.data, pixel_um=pixel, interval_s=interval, colour=bool(getattr(layer, "rgb", False))
    )
    return recording_of(video, str(layer.name), "", optics, frame_rate_hz)
