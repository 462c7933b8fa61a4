"""One door for every kind of recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.io.images import IMAGE_SUFFIXES, TIFF_SUFFIXES, read_image, read_image_folder
from napari_phase4d.io.numpy_files import read_npy, read_npz
from napari_phase4d.io.phases import holds_phase, open_phase
from napari_phase4d.io.results import result_attrs
from napari_phase4d.io.tiff import read_tiff
from napari_phase4d.io.video import Video
from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording

__all__ = ["READABLE_SUFFIXES", "open_input", "open_recording"]

READABLE_SUFFIXES = (*IMAGE_SUFFIXES, ".npy", ".npz")


def open_recording(
    path_or_array: Any,
    optics: Optics | None = None,
    frame_rate_hz: float | None = None,
    *,
    dataset: str | None = None,
) -> Recording:
    """Open a hologram video, lazily where the format allows it.

    Parameters
    ----------
    path_or_array : str, Path, array, DataArray, napari layer or Recording
        A multi-page, ImageJ or OME TIFF; a folder of images; a .npy or .npz file; one image; an
        array (time, y, x) or (y, x) of NumPy, dask or xarray; or a napari image layer.
    optics : Optics, optional
        The microscope. Default: that of the paper, its magnification set so that the pixel is as
        wide as the file says (where it says so).
    frame_rate_hz : float, optional
        Frames per second. Default: what the file says, else 1.
    dataset : str, optional
        Which array of an .npz file.

    Returns
    -------
    Recording
        Its ``notes`` say what had to be assumed.

    Raises
    ------
    OSError
        If a file is missing, damaged, or of a kind that can't be read.
    TypeError, ValueError
        If the data are no hologram video.
    """
    if isinstance(path_or_array, Recording):
        return path_or_array.calibrated(optics, frame_rate_hz)
    if isinstance(path_or_array, (str, Path)):
        return open_path(Path(path_or_array).expanduser(), optics, frame_rate_hz, dataset)
    if isinstance(path_or_array, xr.DataArray):
        return open_data_array(path_or_array, optics, frame_rate_hz)
    if hasattr(path_or_array, "data") and hasattr(path_or_array, "axis_labels"):
        return open_layer(path_or_array, optics, frame_rate_hz)
    return recording_of(Video(path_or_array), "the array", "", optics, frame_rate_hz)


def open_input(
    path: str | Path,
    optics: Optics | None = None,
    frame_rate_hz: float | None = None,
    *,
    dataset: str | None = None,
    angles_deg: Sequence[float] | None = None,
    content: str = "auto",
) -> Recording | xr.DataArray:
    """Open a file that holds holograms or wrapped phase.

    Parameters
    ----------
    path : str or Path
        The file or folder.
    optics, frame_rate_hz, dataset
        See `open_recording`.
    angles_deg : sequence of float, optional
        Viewing angles of wrapped phase, where its file does not say them.
    content : str, optional
        "holograms", "phase", or "auto" (default) to look, see `holds_phase`.

    Returns
    -------
    Recording or xarray.DataArray
        The hologram video, or the stack (time, angle, y, x) of wrapped phase.

    Raises
    ------
    OSError, TypeError, ValueError
        If the file can't be read as such.
    """
    noted = result_attrs(path) or {}
    if "method" in noted:
        msg = (
            f"{Path(path).name} is unwrapped already, by {noted['method']}; give the wrapped phase"
        )
        raise ValueError(msg)
    is_phase = holds_phase(path, dataset) if content == "auto" else content == "phase"
    if not is_phase:
        return open_recording(path, optics, frame_rate_hz, dataset=dataset)
    return open_phase(
        path,
        dataset,
        pixel_um=None if optics is None else optics.pixel_um,
        frame_rate_hz=frame_rate_hz,
        angles_deg=angles_deg,
    )


def open_path(
    path: Path, optics: Optics | None, frame_rate_hz: float | None, dataset: str | None
) -> Recording:
    """Open a file or folder."""
    if not path.exists():
        msg = f"there is no file or folder {path}"
        raise OSError(msg)
    video = read_video(path, dataset)
    return recording_of(video, path.name, str(path), optics, frame_rate_hz)


def read_video(path: Path, dataset: str | None) -> Video:
    """Choose the reader by the file's ending."""
    suffix = path.suffix.lower()
    if path.is_dir():
        return read_image_folder(path)
    if path.stat().st_size == 0:
        msg = f"{path.name} is empty (0 bytes)"
        raise OSError(msg)
    if suffix in TIFF_SUFFIXES:
        return read_tiff(path)
    if suffix == ".npy":
        return read_npy(path)
    if suffix == ".npz":
        return read_npz(path, dataset)
    if suffix in IMAGE_SUFFIXES:
        return read_image(path)
    kinds = ", ".join(READABLE_SUFFIXES)
    msg = f"{path.name} is of a kind that can't be read; readable are {kinds} and image folders"
    raise OSError(msg)


def recording_of(
    video: Video,
    name: str,
    source: str,
    optics: Optics | None,
    frame_rate_hz: float | None,
) -> Recording:
    """Join a file's frames with the user's and the file's own facts."""
    frames = video.frames
    if video.colour and getattr(frames, "ndim", 0) >= 3:
        msg = (
            f"{name} is in colour; a hologram has one grey value a pixel, "
            "so pick one channel first"
        )
        raise ValueError(msg)
    notes = []
    if frame_rate_hz is None and video.interval_s is not None:
        frame_rate_hz = 1 / video.interval_s
    elif frame_rate_hz is None:
        notes.append("The frame rate is not in the data; 1 frame a second is assumed.")
    if optics is None and video.pixel_um is not None:
        optics = optics_for_pixel(video.pixel_um)
        notes.append(
            f"The pixel is {video.pixel_um:.4g} um wide according to the file; "
            "check the wavelength of the microscope."
        )
    elif optics is None:
        notes.append("The microscope is not in the data; that of the paper is assumed.")
    return Recording.from_frames(
        frames,
        optics=optics,
        frame_rate_hz=frame_rate_hz,
        name=name,
        source=source,
        notes=tuple(notes),
    )


def open_data_array(
    data: xr.DataArray, optics: Optics | None, frame_rate_hz: float | None
) -> Recording:
    """Take frames from an xarray array; its own times are kept."""
    if data.ndim in (2, 3) and not set(data.dims) <= {"time", "y", "x"}:
        msg = f"the array has dims {tuple(data.dims)}; a hologram video has time, y and x"
        raise ValueError(msg)
    if data.ndim in (2, 3):
        data = data.transpose(*(d for d in ("time", "y", "x") if d in data.dims))
    times = None
    if frame_rate_hz is None and "time" in data.dims and "time" in data.coords:
        times = seconds(data["time"].values)
    if optics is None and "x" in data.coords and data["x"].attrs.get("units") == "um":
        optics = optics_for_pixel(float(data["x"][1] - data["x"][0]))
    return Recording.from_frames(
        data.data,
        optics=optics,
        frame_rate_hz=frame_rate_hz,
        times_s=times,
        name="the array" if data.name is None else str(data.name),
        attrs={str(k): v for k, v in data.attrs.items()},
    )


def seconds(times: NDArray[Any]) -> NDArray[np.float64]:
    """Return times in seconds; dates count from the first one."""
    if times.dtype.kind in "mM":
        since = times - times[0] if times.dtype.kind == "M" else times
        return np.asarray(since / np.timedelta64(1, "s"), dtype=np.float64)
    return np.asarray(times, dtype=np.float64)


def optics_for_pixel(pixel_um: float) -> Optics:
    """Return the paper's microscope with the magnification that gives this pixel."""
    base = Optics()
    return replace(base, magnification=base.camera_pixel_um / pixel_um)


def open_layer(layer: Any, optics: Optics | None, frame_rate_hz: float | None) -> Recording:
    """Take frames from a napari image layer, with its time step where that is in seconds."""
    units = tuple(str(u) for u in getattr(layer, "units", ()))
    scale = tuple(float(s) for s in getattr(layer, "scale", ()))
    interval = scale[0] if len(scale) == 3 and units[:1] == ("second",) else None
    pixel = scale[-1] if units[-1:] == ("micrometer",) else None
    video = Video(
        layer.data, pixel_um=pixel, interval_s=interval, colour=bool(getattr(layer, "rgb", False))
    )
    return recording_of(video, str(layer.name), "", optics, frame_rate_hz)
