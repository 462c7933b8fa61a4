"""NumPy files. Nothing in them is ever unpickled."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.choosing import USUAL_NAMES, Found, listed
from napari_phase4d.io.lazy import Unsound, map_frames
from napari_phase4d.io.video import Video, memory_lacks

__all__ = ["holds_holograms", "read_npy", "read_npz"]

#: Names that only holograms have.
HOLOGRAM_NAMES = ("holograms", "hologram", "mux", "frames")


def read_npy(path: Path) -> Video:
    """Open an .npy file as a memory map.

    Raises
    ------
    OSError
        If the file is damaged, cut short, or holds pickled objects.
    """
    try:
        found: NDArray[Any] = np.lib.format.open_memmap(path, mode="r")
    except Exception as error:
        # NumPy parses the header as Python, whose SyntaxError and others come through.
        raise OSError(unreadable(path, error)) from error
    if found.size:
        place = found.offset  # type: ignore[attr-defined]
        found = map_frames(path, found.dtype, found.shape, place, found.strides)
    return Video(found, kind="NPY")


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
        ``frames``, ``images``, ``image`` or ``data``, else the first with two or three
        dimensions.
    usual_names : sequence of str, optional
        Names to look for first, instead of those.
    dimensions : sequence of int, optional
        Numbers of dimensions that the array may have.

    Raises
    ------
    OSError
        If the file is damaged, holds pickled objects, or an array that the memory can't hold: it
        can be read only as a whole.
    ValueError
        If there is no such array.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = declared_arrays(archive)
            name = dataset or found_name(arrays, path, usual_names, dimensions)
            if name not in arrays:
                msg = f"{path.name} has no array {name!r}; it has {listed(list(arrays))}"
                raise ValueError(msg)
            check_size(path, name, arrays[name], archive)
        values = loaded(path, name)
    except (Unsound, ValueError, MemoryError):
        raise
    except Exception as error:
        raise OSError(unreadable(path, error)) from error
    notes: tuple[str, ...] = ()
    if dataset is None and name not in usual_names and len(arrays) > 1:
        notes = (
            f"{path.name} holds {listed(list(arrays))}; {name} is read. Name another as dataset.",
        )
    return Video(values, kind="NPZ", dataset=name if len(arrays) > 1 else "", notes=notes)


def loaded(path: Path, name: str) -> NDArray[Any]:
    """Return one array of an .npz file, unless it would have to be unpickled."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as members:
            return member(members, name, path)
    except ValueError as error:  # a file that NumPy takes for another kind
        raise OSError(unreadable(path, error)) from error


def declared_arrays(archive: zipfile.ZipFile) -> dict[str, Found]:
    """Return shape and kind of every array of an .npz file, from their headers."""
    arrays: dict[str, Found] = {}
    for info in archive.infolist():
        if not info.filename.endswith(".npy"):
            continue
        name = info.filename.removesuffix(".npy")
        try:
            with archive.open(info) as file:
                version = np.lib.format.read_magic(file)
                read = (
                    np.lib.format.read_array_header_1_0
                    if version == (1, 0)
                    else np.lib.format.read_array_header_2_0
                )
                shape, _, dtype = read(file)
        except Exception:  # NumPy parses the header as Python
            shape, dtype = (), np.dtype("O")  # reading it will say what is wrong
        arrays[name] = (shape, dtype)
    return arrays


def check_size(path: Path, name: str, found: Found, archive: zipfile.ZipFile) -> None:
    """Raise Unsound if an array takes more memory than is free, or more than is in the file."""
    shape, dtype = found
    needed = math.prod(int(n) for n in shape) * dtype.itemsize
    if dtype.kind != "O" and needed > archive.getinfo(f"{name}.npy").file_size:
        msg = f"{path.name} says that {name!r} is {dtype} {shape}, but holds less; it is damaged"
        raise Unsound(msg)
    if lacks := memory_lacks(max(needed, archive.getinfo(f"{name}.npy").file_size)):
        msg = (
            f"{name!r} of {path.name}, which is read whole, takes {lacks}; "
            "save it as .npy, which is read in parts"
        )
        raise Unsound(msg)


def holds_holograms(path: Path) -> bool:
    """Say whether an .npz file has an array that is named as holograms are.

    Raises
    ------
    OSError
        If the file is damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            return any(name in archive.files for name in HOLOGRAM_NAMES)
    except Exception as error:  # of zip, zlib, or the parser of NumPy's headers
        raise OSError(unreadable(path, error)) from error


def found_name(
    arrays: Mapping[str, Found], path: Path, usual_names: Sequence[str], dimensions: Sequence[int]
) -> str:
    """Return the name of the array to read where none was given."""
    for name in usual_names:
        if name in arrays:
            return name
    for name, (shape, dtype) in arrays.items():
        if len(shape) in dimensions and dtype.kind in "buif":
            return name
    found = listed(list(arrays))
    wanted = " or ".join(str(n) for n in dimensions)
    msg = f"{path.name} has no array with {wanted} dimensions; it has {found}"
    raise ValueError(msg)


def member(archive: Any, name: str, path: Path) -> NDArray[Any]:
    """Return one array of an archive, unless it would have to be unpickled."""
    try:
        return np.asarray(archive[name])
    except Exception as error:
        raise OSError(unreadable(path, error)) from error


def unreadable(path: Path, error: Exception) -> str:
    """Return the sentence for a NumPy file that can't be read."""
    if "pickle" in str(error).lower() or "object" in str(error).lower():
        return (
            f"{path.name} holds Python objects, which are never loaded because they could run "
            "code; save it as plain numbers"
        )
    return f"{path.name} can't be read as a NumPy file; it may be cut short or damaged"
