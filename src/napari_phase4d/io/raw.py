"""Numbers one after the other: raw camera dumps, described by the user, and NumPy files.

Nothing in NumPy files is ever unpickled.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import Unsound, map_frames
from napari_phase4d.io.video import LARGEST_SIDE, USUAL_NAMES, Found, Video, listed, memory_lacks
from napari_phase4d.words import shown

__all__ = [
    "KINDS",
    "RAW_SUFFIXES",
    "RawLayout",
    "holds_holograms",
    "read_npy",
    "read_npz",
    "read_raw",
]

RAW_SUFFIXES = (".raw", ".bin", ".dat")
#: Numbers that a camera may write.
KINDS = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")


@dataclass(frozen=True)
class RawLayout:
    """How the frames of a raw file lie in it.

    Parameters
    ----------
    height, width : int
        Of a frame in pixels, from 1 to 1048576.
    dtype : str
        What a pixel is: uint8, int8, uint16 (default), int16, uint32, int32, float32 or float64.
    byte_order : str
        "<" if the small byte comes first (default, as on all usual computers), else ">".
    header_bytes : int
        Bytes before the first frame, default 0.
    gap_bytes : int
        Bytes between a frame and the next one, default 0.

    Raises
    ------
    TypeError
        If a size is no whole number.
    ValueError
        If a value is out of its range.

    Examples
    --------
    >>> from napari_phase4d import RawLayout
    >>> import numpy as np
    >>> import napari_phase4d as p4d
    >>> np.arange(3 * 48 * 64, dtype=np.uint16).tofile("camera.raw")
    >>> p4d.open_recording("camera.raw", raw=RawLayout(height=48, width=64)).n_frames
    3
    """

    height: int
    width: int
    dtype: str = "uint16"
    byte_order: str = "<"
    header_bytes: int = 0
    gap_bytes: int = 0

    def __post_init__(self) -> None:
        for name in ("height", "width", "header_bytes", "gap_bytes"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
                msg = f"{name} of raw frames must be a whole number, but is {shown(value)}"
                raise TypeError(msg)
        for name in ("height", "width"):
            value = getattr(self, name)
            if not 1 <= value <= LARGEST_SIDE:
                msg = (
                    f"the {name} of raw frames must be 1 to {LARGEST_SIDE}, but is {shown(value)}"
                )
                raise ValueError(msg)
        if not isinstance(self.dtype, str) or self.dtype not in KINDS:
            msg = f"raw pixels must be one of {', '.join(KINDS)}, but are {shown(self.dtype)}"
            raise ValueError(msg)
        if not isinstance(self.byte_order, str) or self.byte_order not in ("<", ">"):
            msg = (
                f'the byte order of raw pixels must be "<" or ">", but is {shown(self.byte_order)}'
            )
            raise ValueError(msg)
        for name in ("header_bytes", "gap_bytes"):
            if getattr(self, name) < 0:
                msg = (
                    f"{name} of a raw file must be 0 or more, but is {shown(getattr(self, name))}"
                )
                raise ValueError(msg)

    @property
    def pixel(self) -> np.dtype[np.generic]:
        """NumPy's name for a pixel, with its byte order."""
        return np.dtype(f"{self.byte_order}{np.dtype(self.dtype).str[1:]}")

    @property
    def frame_bytes(self) -> int:
        """Size of a frame in bytes, without the gap behind it."""
        return self.height * self.width * self.pixel.itemsize


def read_raw(path: Path, layout: RawLayout | None) -> Video:
    """Map a raw file; the number of frames follows from its size.

    Parameters
    ----------
    path : Path
        The file.
    layout : RawLayout or None
        How frames lie in it; the file can't say it.

    Raises
    ------
    OSError
        If it is shorter than one frame.
    ValueError
        If no layout is given.
    """
    if layout is None:
        msg = (
            f"{path.name} is raw and can't say how large its frames are; say it with --raw "
            'HEIGHT,WIDTH,TYPE, or in Python with raw=RawLayout(height, width, dtype="uint16")'
        )
        raise ValueError(msg)
    size, step = path.stat().st_size, layout.frame_bytes + layout.gap_bytes
    # The gap behind the last frame may be missing.
    count = (size - layout.header_bytes + layout.gap_bytes) // step
    if count < 1:
        msg = (
            f"{path.name} has {size} bytes, but one frame of {layout.height} x {layout.width} "
            f"{layout.dtype} needs {layout.header_bytes + layout.frame_bytes}"
        )
        raise OSError(msg)
    left = size - layout.header_bytes - count * step
    row = layout.width * layout.pixel.itemsize
    frames = map_frames(
        path,
        layout.pixel,
        (count, layout.height, layout.width),
        layout.header_bytes,
        (step, row, layout.pixel.itemsize),
    )
    notes = []
    if left > 0:
        notes.append(
            f"{left} bytes are left over behind frame {count - 1}; "
            "check the size of the frames, or the last one is cut short."
        )
    return Video(frames, kind="raw", notes=tuple(notes))


# ---- NumPy files ----------------------------------------------------------------------------


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
