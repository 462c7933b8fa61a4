"""NumPy files. Nothing in them is ever unpickled."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.video import Video

__all__ = ["holds_holograms", "read_npy", "read_npz"]

#: Names looked for first in an .npz file with several arrays; the last one says the least.
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


def read_npz(
    path: Path,
    dataset: str | None = None,
    usual_names: Sequence[str] = USUAL_NAMES,
    dimensions: Sequence[int] = (2, 3),
) -> Video:
    """Read one array of an .npz file.

    Parameters
    ----------
    path : Path
        The file.
    dataset : str, optional
        Name of the array. Default: the only one, else ``holograms``, ``hologram``, ``mux``,
        ``frames`` or ``data``, else the first with two or three dimensions.
    usual_names : sequence of str, optional
        Names to look for first, instead of those.
    dimensions : sequence of int, optional
        Numbers of dimensions that the array may have.

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
            name = dataset or found_name(archive, path, usual_names, dimensions)
            if name not in archive.files:
                known = ", ".join(archive.files) or "none"
                msg = f"{path.name} has no array {name!r}; it has {known}"
                raise ValueError(msg)
            return Video(member(archive, name, path))
    except (zipfile.BadZipFile, EOFError, OSError, TypeError) as error:
        raise OSError(unreadable(path, error)) from error


def holds_holograms(path: Path) -> bool:
    """Say whether an .npz file has an array that is named as holograms are.

    Raises
    ------
    OSError
        If the file is damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return any(name in archive.files for name in USUAL_NAMES[:-1])
    except (zipfile.BadZipFile, EOFError, OSError, ValueError) as error:
        raise OSError(unreadable(path, error)) from error


def found_name(
    archive: Any, path: Path, usual_names: Sequence[str], dimensions: Sequence[int]
) -> str:
    """Return the name of the array to read where none was given."""
    names = list(archive.files)
    for name in usual_names:
        if name in names:
            return name
    for name in names:
        array = member(archive, name, path)
        if array.ndim in dimensions and array.dtype.kind in "buif":
            return str(name)
    found = ", ".join(names) or "none"
    wanted = " or ".join(str(n) for n in dimensions)
    msg = f"{path.name} has no array with {wanted} dimensions; it has {found}"
    raise ValueError(msg)


def member(archive: Any, name: str, path: Path) -> NDArray[Any]:
    """Return one array of an archive, unless it would have to be unpickled."""
    try:
        return np.asarray(archive[name])
    except ValueError as error:
        raise OSError(unreadable(path, error)) from error


def unreadable(path: Path, error: Exception) -> str:
    """Return the sentence for a NumPy file that can't be read."""
    if "pickle" in str(error).lower() or "object" in str(error).lower():
        return (
            f"{path.name} holds Python objects, which are never loaded because they could run "
            "code; save it as plain numbers"
        )
    return f"{path.name} can't be read as a NumPy file; it may be cut short or damaged"
