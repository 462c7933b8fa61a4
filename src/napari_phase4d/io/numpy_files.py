"""NumPy files. Nothing in them is ever unpickled."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.video import Video

__all__ = ["read_npy", "read_npz"]

#: Names looked for first in an .npz file with several arrays.
USUAL_NAMES = ("holograms", "hologram", "mux", "frames", "data")


def read_npy(path: Path) -> Video:
    """Open an .npy file as a memory map.

    Raises
    ------
    OSError
        If the file is damaged, cut short, or holds pickled objects.
    """
    try:
        return Video(np.load(path, mmap_mode="r", allow_pickle=False))
    except (ValueError, EOFError, OSError) as error:
        raise OSError(unreadable(path, error)) from error


def read_npz(path: Path, dataset: str | None = None) -> Video:
    """Read one array of an .npz file.

    Parameters
    ----------
    path : Path
        The file.
    dataset : str, optional
        Name of the array. Default: the only one, else ``holograms``, ``hologram``, ``mux``,
        ``frames`` or ``data``, else the first with two or three dimensions.

    Raises
    ------
    OSError
        If the file is damaged or holds pickled objects.
    ValueError
        If there is no such array.
    """
    try:
        if not zipfile.is_zipfile(path):
            raise zipfile.BadZipFile
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            name = chosen_name(archive, path, dataset)
            return Video(member(archive, name, path))
    except (zipfile.BadZipFile, EOFError, OSError, TypeError) as error:
        raise OSError(unreadable(path, error)) from error


def chosen_name(archive: Any, path: Path, dataset: str | None) -> str:
    """Return the name of the array to read."""
    names = list(archive.files)
    if dataset is not None:
        if dataset not in names:
            msg = f"{path.name} has no array {dataset!r}; it has {', '.join(names) or 'none'}"
            raise ValueError(msg)
        return dataset
    for name in USUAL_NAMES:
        if name in names:
            return name
    for name in names:
        if is_image_like(member(archive, name, path)):
            return str(name)
    found = ", ".join(names) or "none"
    msg = f"{path.name} has no array with two or three dimensions; it has {found}"
    raise ValueError(msg)


def member(archive: Any, name: str, path: Path) -> NDArray[Any]:
    """Return one array of an archive, unless it would have to be unpickled."""
    try:
        return np.asarray(archive[name])
    except ValueError as error:
        raise OSError(unreadable(path, error)) from error


def is_image_like(array: NDArray[Any]) -> bool:
    """Say whether an array could be a frame or a video."""
    return array.ndim in (2, 3) and array.dtype.kind in "buif"


def unreadable(path: Path, error: Exception) -> str:
    """Return the sentence for a NumPy file that can't be read."""
    if "pickle" in str(error).lower() or "object" in str(error).lower():
        return (
            f"{path.name} holds Python objects, which are never loaded because they could run "
            "code; save it as plain numbers"
        )
    return f"{path.name} can't be read as a NumPy file; it may be cut short or damaged"
