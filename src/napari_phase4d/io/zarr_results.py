"""4-D phase as OME-Zarr: version 0.5 of the format, which is made of Zarr 3.

The format is described at https://ngff.openmicroscopy.org/0.5.
"""

from __future__ import annotations

import json
import math
import os
import re
import uuid
from contextlib import closing
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.atomic import folder_written_whole, text_of, written_whole
from napari_phase4d.io.describing import (
    PROGRAM,
    checked,
    described,
    name_of,
    slabs,
    stack_of,
    step_of,
    view_names,
)
from napari_phase4d.io.frame_files import FrameFiles, hold_frames
from napari_phase4d.io.lazy import in_one_line
from napari_phase4d.io.video import listed
from napari_phase4d.later import xr
from napari_phase4d.recording import reader_of, remember_reader
from napari_phase4d.stack import known_limits
from napari_phase4d.stacks import AXES
from napari_phase4d.task import UNWATCHED, Task, on_all_cores

__all__ = [
    "ALL_CHUNKS",
    "ARRAY",
    "check_own_or_none",
    "create_blocks",
    "finish_blocks",
    "note_zarr_result",
    "path_of",
    "read_zarr_result",
    "set_length",
    "write_zarr_result",
    "zarr_description",
]

VERSION = "0.5"
#: Name of the only array, and of the file that says what a group or an array is.
ARRAY, NOTE = "0", "zarr.json"
#: Names that other programs know these axes by: the angles are channels.
NAMES = ("t", "c", "y", "x")
#: Chunks of zeros are written too: one that is missing is then one that was lost.
ALL_CHUNKS = {"write_empty_chunks": True}
#: All files of an array lie in its own folder: to make several for each takes longer than to write
#: a small file.
FLAT = {"name": "default", "separator": "."}
#: Names of these files; those of version 0.1.0, which lay in folders, were numbers.
FRAMES = re.compile(r"(c(\.[0-9]+){3}\.)?[0-9]+")
#: Smallest and largest number of each angle.
Limits = tuple[NDArray[np.float64], NDArray[np.float64]]


def write_zarr_result(
    path: Path,
    stack: xr.DataArray,
    task: Task = UNWATCHED,
) -> None:
    """Write a stack (time, angle, y, x) as OME-Zarr, some frames at a time."""
    import zarr

    with folder_written_whole(path) as temporary:
        group = zarr.create_group(temporary, zarr_format=3)
        array = new_array(group, stack.shape, stack.dtype)
        files = FrameFiles(array) if hold_frames(array) else None
        low = np.full(stack.sizes["angle"], np.inf)
        high = -low
        with closing(slabs(stack, task)) as parts:
            for times, values in parts:
                found = write_frames(array, files, times.start, values)
                low, high = np.fmin(low, found[0]), np.fmax(high, found[1])
        group.update_attributes({"ome": ome_note(stack, (low, high)), PROGRAM: described(stack)})


def check_own_or_none(path: Path) -> None:
    """Refuse to replace a folder that holds anything that `write_zarr_result` has not written.

    Raises
    ------
    FileExistsError
        If it does.
    """
    if not path.is_dir():
        return
    inside = sorted(entry.name for entry in path.iterdir() if not is_hidden(entry.name))
    others = [name for name in inside if name not in (ARRAY, NOTE)]
    if not others and inside and zarr_description(path) is None:
        others = inside
    if others:
        msg = (
            f"{path} is a folder that holds {listed(others)}, which this program has not written; "
            "choose another name"
        )
        raise FileExistsError(msg)


def is_hidden(name: str) -> bool:
    """Say whether a file or folder is one that systems lay beside others."""
    return name.startswith(".") or name in ("Thumbs.db", "desktop.ini", "@eaDir")


def new_array(
    group: Any,
    shape: tuple[int, ...],
    dtype: Any,
    *,
    frames: int = 1,
    packed_by: Literal["bitshuffle", "shuffle", ""] = "bitshuffle",
) -> Any:
    """Return a new array of a group, a chunk of which holds so many frames of one view.

    All is packed by lz4, which takes less than half the time of zstd, and makes noisy phase as
    small but for a hundredth. Sorted by bits ("bitshuffle") it is made smallest, to about 85 %;
    sorted by bytes ("shuffle") it is unpacked a third quicker; not packed at all ("") it takes
    less than half of that time.
    """
    from zarr.codecs import BloscCodec, Crc32cCodec

    packed = [BloscCodec(cname="lz4", clevel=1, shuffle=packed_by)] if packed_by else []
    return group.create_array(
        ARRAY,
        shape=shape,
        chunks=(min(frames, shape[0]), 1, *shape[2:]),
        dtype=np.dtype(dtype).newbyteorder("="),
        # The sum is checked first: Blosc crashes on what is cut short.
        compressors=[*packed, Crc32cCodec()],
        chunk_key_encoding=FLAT,
        dimension_names=NAMES,
        config=ALL_CHUNKS,
    )


def note_zarr_result(path: Path, stack: xr.DataArray) -> None:
    """Note anew what an OME-Zarr of this program is; its numbers stay as they are.

    Raises
    ------
    OSError
        If it is not there or can't be written.
    """
    file = path / NOTE
    try:
        note = json.loads(text_of(file))
        note["attributes"][PROGRAM] = described(stack)
    except (ValueError, KeyError, TypeError) as error:
        msg = f"{path.name} is damaged: it does not say any more what it is"
        raise OSError(msg) from error
    with written_whole(file) as temporary:
        temporary.write_text(json.dumps(note, indent=2) + "\n", encoding="utf-8")


def write_frames(array: Any, files: FrameFiles | None, start: int, values: NDArray[Any]) -> Limits:
    """Write the frames of some times, several at once, and return the limits of each angle.

    It waits for all, also if one fails: Zarr itself does not, and would go on writing into a
    folder that is removed. What `FrameFiles` can't take is left to Zarr.
    """
    low, high = (np.full(values.shape[:2], np.nan) for _ in range(2))

    def write(place: tuple[int, ...]) -> None:
        time, angle = place
        frame = values[time, angle]
        if files is None:
            array[start + time, angle] = frame
        else:
            when = slice(start + time, start + time + 1)
            files.write(when, slice(angle, angle + 1), frame[None, None])
        low[place], high[place] = known_limits(frame)

    on_all_cores(write, np.ndindex(values.shape[:2]))
    return np.fmin.reduce(low), np.fmax.reduce(high)


def ome_note(stack: xr.DataArray, limits: Limits) -> dict[str, Any]:
    """Return what OME-Zarr can say of a stack: axes, units, scale, and names of the angles."""
    places = [np.asarray(stack[axis].values, dtype=np.float64) for axis in stack.dims]
    kinds = (
        ("time", "second"),
        ("channel", None),
        ("space", "micrometer"),
        ("space", "micrometer"),
    )
    axes = [
        {"name": name, "type": kind} | ({} if unit is None else {"unit": unit})
        for name, (kind, unit) in zip(NAMES, kinds, strict=True)
    ]
    # Channels are counted, in this format; their angles are their names.
    scale = [1.0 if name == "c" else step_of(p) for name, p in zip(NAMES, places, strict=True)]
    start = [0.0 if name == "c" else float(p.min()) for name, p in zip(NAMES, places, strict=True)]
    transformations = [
        {"type": "scale", "scale": scale},
        {"type": "translation", "translation": start},
    ]
    datasets = [{"path": ARRAY, "coordinateTransformations": transformations}]
    name = name_of(stack)
    channels = [
        channel(view, low, high)
        for view, low, high in zip(view_names(stack), *limits, strict=True)
    ]
    return {
        "version": VERSION,
        "multiscales": [{"name": name, "axes": axes, "datasets": datasets}],
        "omero": {"name": name, "channels": channels, "rdefs": {"model": "greyscale"}},
    }


def channel(label: str, low: float, high: float) -> dict[str, Any]:
    """Return how other programs show one angle: in grey, from its smallest to its largest."""
    low, high = (float(low), float(high)) if low < high else (0.0, 1.0)
    window = {"min": low, "max": high, "start": low, "end": high}
    return {"label": label, "color": "FFFFFF", "active": True, "window": window}


def read_zarr_result(path: Path) -> xr.DataArray:
    """Read a stack that `write_zarr_result` wrote; its frames are read when they are used.

    Raises
    ------
    OSError
        If the folder is damaged, or was not written by this program.
    """
    description = zarr_description(path)
    if description is None:
        msg = f"{path.name} holds no phase written by napari-phase4d"
        raise OSError(msg)
    wanted = tuple(len(places) for places in description["coords"].values())
    try:
        frames = ZarrFrames(path)
    except Exception as error:  # whatever Zarr makes of a damaged description
        msg = f"{path.name} can't be read; it may be damaged ({one_line(error)})"
        raise OSError(msg) from error
    if frames.shape != wanted:
        msg = f"{path.name} is damaged: it has {frames.shape} pixels, but notes {wanted}"
        raise OSError(msg)
    count = count_files(path / ARRAY)
    if count != frames.n_files:
        msg = f"{path.name} is not complete: it has {count} of {frames.n_files} files of frames"
        raise OSError(msg)
    import dask.array as da

    name = f"frames-{uuid.uuid4().hex}"  # spares dask the hashing of what it can't hash
    lazy = da.from_array(
        frames,
        chunks=frames.chunks,
        name=name,
        asarray=False,
        fancy=False,
        meta=np.empty((0,) * 4, frames.dtype),
    )
    remember_reader(name, frames)
    return stack_of(description, lazy)


def count_files(array: Path) -> int:
    """Return how many files of frames an array has, in folders or not.

    A worker that was killed may have left a piece with another name, whose block was done again;
    some systems lay hidden files beside each.
    """
    every = os.walk(array)
    return sum(bool(FRAMES.fullmatch(name)) for _, _, names in every for name in names)


def path_of(stack: xr.DataArray) -> Path | None:
    """Return the folder that a stack lies in as it is; None of a part or of a copy."""
    reader = reader_of(stack.data)
    if not isinstance(reader, ZarrFrames) or stack.dims != AXES:
        return None
    reader.check()
    return reader.path


class ZarrFrames:
    """The numbers of an OME-Zarr, read when they are asked for.

    Parameters
    ----------
    path : Path
        The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.chunks: tuple[int, ...]
        self._kept: tuple[int, NDArray[Any]] | None
        self._open()

    def check(self) -> None:
        """Refuse to read what has come to lie in this place since it was opened.

        Raises
        ------
        OSError
            If another run has replaced it.
        """
        if which_array(self.path) not in (None, self._which):
            msg = (
                f"{self.path} was replaced since it was opened, as another run with the same "
                "folder does; read it again, or give each run a folder of its own"
            )
            raise OSError(msg)

    def __getitem__(self, key: Any) -> NDArray[Any]:
        self.check()
        try:
            return np.asarray(self._array[key])
        except Exception as error:  # each compressor has errors of its own
            msg = (
                f"frames of {self.path.name} can't be read; it may be damaged, or was moved "
                f"({one_line(error)})"
            )
            raise OSError(msg) from error

    def frame(self, index: int) -> NDArray[Any]:
        """Return the frames of one time, shape (angle, y, x); the last chunk of them is kept."""
        start = index // self.chunks[0] * self.chunks[0]
        kept = self._kept
        if kept is None or kept[0] != start:
            kept = self._kept = (start, self[start : start + self.chunks[0]])
        found: NDArray[Any] = kept[1][index - start]
        return found

    def _open(self) -> None:
        import zarr

        self._kept = None

        self._which = which_array(self.path)
        self._array: Any = zarr.open_array(self.path / ARRAY, mode="r")
        self.shape = tuple(int(n) for n in self._array.shape)
        self.dtype = np.dtype(self._array.dtype)
        self.chunks = tuple(int(n) for n in self._array.chunks)
        #: Files that hold them all.
        self.n_files = math.prod(-(-n // m) for n, m in zip(self.shape, self.chunks, strict=True))
        self.ndim = len(self.shape)

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.path = state["path"]
        self._open()


def which_array(path: Path) -> tuple[int, int] | None:
    """Return what tells the array of an OME-Zarr from one that replaces it; None if it is gone."""
    try:
        status = (path / ARRAY / NOTE).stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns


def zarr_description(path: str | Path) -> dict[str, Any] | None:
    """Return what `write_zarr_result` noted in a folder, or None if it did not write it."""
    try:
        note = json.loads(text_of(Path(path) / NOTE))
        return checked(note["attributes"][PROGRAM])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def one_line(error: Exception) -> str:
    """Return an error in one line of bounded length."""
    return f"{type(error).__name__}: {in_one_line(error)}"


def create_blocks(
    group: Path, shape: tuple[int, ...], frames: int, *, packed: bool = True
) -> Path:
    """Make an empty float32 stack (time, angle, y, x) on disk.

    Parameters
    ----------
    group : Path
        Folder to make.
    shape : tuple of int
        Shape of the stack.
    frames : int
        Frames in a block. A file holds one; different ones may be written at the same time.
    packed : bool, optional
        Whether to pack it: what is noisy everywhere becomes a tenth smaller or so. Default True.

    Returns
    -------
    Path
        The folder of its array, for ``zarr.open_array``.
    """
    import zarr

    # Chunks of single frames take twice as long to write; the packer keeps up with the work.
    top = zarr.create_group(group, zarr_format=3)
    new_array(top, shape, np.float32, frames=frames, packed_by="shuffle" if packed else "")
    return group / ARRAY


def set_length(array: Path, n_times: int) -> None:
    """Say how many times an array on disk has that was made longer than what came.

    Parameters
    ----------
    array : Path
        Its folder, as `create_blocks` gave it.
    n_times : int
        How many there are.
    """
    note = json.loads(text_of(array / NOTE))
    note["shape"][0] = n_times
    with written_whole(array / NOTE) as temporary:
        temporary.write_text(json.dumps(note, indent=2) + "\n", encoding="utf-8")


def finish_blocks(group: Path, stack: xr.DataArray, limits: tuple[float, float]) -> None:
    """Note in a stack that is written by now what it is.

    Parameters
    ----------
    group : Path
        Its folder.
    stack : xarray.DataArray
        Its axes, name and attributes; the values do not count.
    limits : tuple of float
        Smallest and largest number, for programs that show it.
    """
    import zarr

    low, high = (np.full(stack.sizes["angle"], limit) for limit in limits)
    zarr.open_group(group, mode="r+").update_attributes(
        {"ome": ome_note(stack, (low, high)), PROGRAM: described(stack)}
    )
