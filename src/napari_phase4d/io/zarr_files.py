"""Zarr and OME-Zarr, read with zarr-python; versions 2 and 3 of the format."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import IO, Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import FrameReader, Unsound, in_one_line, lazy_frames
from napari_phase4d.io.remote import address_of, is_missing, remote_store, unreached
from napari_phase4d.io.video import (
    LARGEST_PIECE,
    MICROMETRES,
    SECONDS,
    Facts,
    Found,
    Video,
    axes_to_choose,
    choice,
    chosen_name,
    chosen_places,
    other_arrays,
    taken_for_time,
)
from napari_phase4d.io.zarr_packing import Pieces, check_packed_once
from napari_phase4d.words import size_in_words

__all__ = ["ZarrReader", "is_zarr", "read_zarr"]

#: Files of which one lies at the top of every Zarr folder.
MARKS = ("zarr.json", ".zarray", ".zgroup", ".zmetadata")
#: Pieces that hold several frames are kept unpacked up to this size.
LARGEST_KEPT = 2**28


def is_zarr(path: Path) -> bool:
    """Say whether a folder is a Zarr store, or a file a zipped one; an address stands for one."""
    if address_of(path) is not None:
        return True
    if path.is_dir():
        return path.suffix.lower() == ".zarr" or is_marked(path)
    return path.name.lower().endswith((".zarr.zip", ".ozx"))


def is_marked(folder: Path) -> bool:
    """Say whether a folder describes itself as Zarr."""
    return any((folder / mark).is_file() for mark in MARKS)


def read_zarr(path: Path, dataset: str | None = None) -> Video:
    """Open an array of a Zarr store, lazily.

    Of an OME-Zarr image (specification 0.4 and 0.5, https://ngff.openmicroscopy.org) the largest
    level is taken, with its pixel and frame interval where their units are given.

    Parameters
    ----------
    path : Path
        A folder, or a zipped one that ends with .zarr.zip.
    dataset : str, optional
        Name of the array in a group, as "group/name", or the place on further axes of the image
        of an OME-Zarr, as "C=0,Z=1". Default: the image of an OME-Zarr, else a guess, see
        `choosing.chosen_name`, told in ``notes``.

    Raises
    ------
    OSError
        If the store is damaged or would run code.
    ValueError
        If there is no such array.
    """
    import zarr

    try:
        root = opened(path)
        if isinstance(root, zarr.Array):
            return video_of(path, root, "", {}, "Zarr")
        image = ome_image(root.attrs)
        if image and (dataset is None or "=" in dataset):
            name = str(image["datasets"][0]["path"])
            facts, axes = ome_facts(image), axes_of(image)
            return video_of(path, root[name], name, facts, "OME-Zarr", axes, dataset=dataset)
        arrays: dict[str, Found] = {
            name: (tuple(item.shape), np.dtype(item.dtype))
            for name, item in root.members(max_depth=6)
            if isinstance(item, zarr.Array)
        }
        name = chosen_name(path, arrays, dataset)
        notes = other_arrays(name, arrays, dataset)
        return video_of(path, root[name], name, facts_of_group(root, name), "Zarr", notes=notes)
    except (Unsound, ValueError) as error:
        if isinstance(error, Unsound) or str(error).startswith(path.name):
            raise
        raise OSError(unreadable(path, error)) from error
    except Exception as error:
        # zarr-python raises errors of its own, of codecs, and of JSON for a damaged store.
        raise OSError(unreadable(path, error)) from error


class ZarrReader(FrameReader):
    """Reads frames of one array; pieces that hold several frames are unpacked once.

    Parameters
    ----------
    path : Path
        The store; every process opens it for itself.
    name : str
        The array in it, empty where the store is an array.
    axis : int or None
        Which axis of the array is time.
    shape, dtype
        Of the recording.
    leading : tuple of int, optional
        The place on each axis before y and x; default 0.
    """

    arguments = ("path", "name", "axis", "shape", "dtype", "leading")

    def __init__(
        self,
        path: Path,
        name: str,
        axis: int | None,
        shape: tuple[int, int, int],
        dtype: np.dtype[Any],
        leading: tuple[int, ...] = (),
    ) -> None:
        super().__init__(path, shape, dtype)
        self.name = name
        self.axis = axis
        self.leading = leading
        self._lock = threading.Lock()
        self._array: Any = None
        self._pieces: Pieces | None = None
        #: A zipped store; what lies in it takes long to list. It is closed with the reader.
        self._zip: ZipFile | None = None
        #: The last frame that a server is known to have, where it had nothing of one before.
        self._there = -1
        self._block = (0, np.empty((0, *shape[1:]), dtype))

    def read(self, index: int) -> NDArray[Any]:
        """Return one frame."""
        with self._lock:
            array = self._opened()
            step = 1 if self.axis is None else int(array.chunks[self.axis])
            first, block = self._block
            if not first <= index < first + len(block):
                if step * math.prod(self.shape[1:]) * self.dtype.itemsize > LARGEST_KEPT:
                    step = 1
                first = index - index % step
                self._check_pieces(array, index)
                block = self._read(array, first, min(first + step, self.shape[0]))
                self._check_sent(array, index)
                if step > 1:
                    self._block = (first, block)
        return block[index - first]  # type: ignore[no-any-return]

    def as_it_is_now(self) -> ZarrReader:
        """Return a new reader of the array in a folder, with the length that it has by now."""
        import zarr

        array = zarr.open_array(self.path / self.name, mode="r")
        n_frames = self.shape[0] if self.axis is None else int(array.shape[self.axis])
        found = ZarrReader(
            self.path, self.name, self.axis, (n_frames, *self.shape[1:]), self.dtype, self.leading
        )
        found._array = array
        return found

    def files(self, index: int) -> list[Path]:
        """Return the files of a folder that hold a frame, those of them that are there."""
        with self._lock:
            array = self._opened()
        return files_of(self.path, self.name, array, self._place(array, index))

    def unwritten(self, frame: NDArray[Any]) -> bool:
        """Say whether a piece of a frame holds nothing but what Zarr gives for missing ones."""
        with self._lock:
            array = self._opened()
        height, width = array.chunks[-2:]
        pieces = (
            frame[top : top + height, left : left + width]
            for top in range(0, frame.shape[0], height)
            for left in range(0, frame.shape[1], width)
        )
        return any(bool((piece == array.fill_value).all()) for piece in pieces)

    def _read(self, array: Any, first: int, stop: int) -> NDArray[Any]:
        """Return frames from the store."""
        place: list[Any] = [*self._place(array, first), slice(None), slice(None)]
        if self.axis is not None:
            place[self.axis] = slice(first, stop)
        return np.asarray(array[tuple(place)]).reshape(stop - first, *self.shape[1:])

    def _check_pieces(self, array: Any, index: int) -> None:
        """Raise OSError if the pieces of a frame are missing, cut short or hold too much."""
        if self._pieces is None:
            self._pieces = Pieces(array)
        place = self._place(array, index)
        if self.path.is_dir():
            check_pieces(self.path, self.name, array, place, self._pieces, self.axis)
        elif address_of(self.path) is None:
            if self._zip is None:
                self._zip = ZipFile(self.path)
            check_zipped(self._zip, self.name, array, place, self._pieces)

    def _check_sent(self, array: Any, index: int) -> None:
        """Raise OSError if a server had nothing of a frame, nor of any later one."""
        missing = getattr(array.store, "missing", None)
        if (
            not missing
            or index < self._there
            or self._is_there(array, index, missing.__contains__)
        ):
            return
        if self.axis is not None:
            for number in range(self.shape[0] - 1, index, -1):
                if self._is_there(array, number, lambda key: is_missing(array.store, key)):
                    self._there = number
                    return
        msg = "nothing of it is on the server"
        raise OSError(msg)

    def _is_there(self, array: Any, index: int, is_not: Callable[[str], bool]) -> bool:
        """Say whether a server has any piece of a frame."""
        keys = keys_of(array, self._place(array, index))
        return not all(is_not(f"{self.name}/{key}".lstrip("/")) for key in keys)

    def _place(self, array: Any, index: int) -> list[int]:
        """Return the place of a frame on the axes before y and x."""
        place = list(self.leading or [0] * (array.ndim - 2))
        if self.axis is not None:
            place[self.axis] = index
        return place

    def _opened(self) -> Any:
        """Return the array, opened once."""
        if self._array is None:
            root = opened(self.path)
            self._array = root[self.name] if self.name else root
        return self._array


def opened(path: Path) -> Any:
    """Return the group or array at the top of a store."""
    import zarr

    address = address_of(path)
    if address is not None:
        return zarr.open(remote_store(address), mode="r")
    if path.is_dir():
        for depth in ("", "*/", "*/*/"):
            for mark in MARKS:
                check_regular(path, *path.glob(depth + mark))
        return zarr.open(str(path), mode="r")
    return zarr.open(zarr.storage.ZipStore(path, mode="r"), mode="r")


def video_of(
    path: Path,
    array: Any,
    name: str,
    facts: Facts,
    kind: str,
    axes: str = "",
    notes: tuple[str, ...] = (),
    dataset: str | None = None,
) -> Video:
    """Return the lazy frames of an array."""
    check_sound(path, array)
    shape = tuple(int(n) for n in array.shape)
    dtype = np.dtype(array.dtype)
    leading, long = chosen_leading(path, axes.upper(), shape, dataset)
    if len(shape) < 2 or len(long) > 1 or dtype.kind not in "buif":
        of_axes = f" ({axes})" if axes else ""
        msg = (
            f"{path.name} holds {dtype} values {shape}{of_axes}; a hologram video has three axes "
            "of numbers: time, y, x"
        )
        left = [axes[i].upper() for i in long if i < len(axes)]
        if len(long) > 1 and (others := axes_to_choose(left, has_time="t" in axes)):
            msg += f", so choose one place, as with {choice(others)}"
        raise ValueError(msg)
    time = axes.find("t")
    axis = long[0] if long else (time if 0 <= time < len(shape) - 2 else None)
    if long and axes and axis != time:
        facts.pop("interval_s", None)
        notes = (*notes, taken_for_time(axes[long[0]]))
    if axis is None and len(shape) > 2:
        axis = 0
    video = (1 if axis is None else shape[axis], shape[-2], shape[-1])
    reader = ZarrReader(path, name, axis, video, dtype, leading)
    version = array.metadata.zarr_format
    return Video(
        lazy_frames(reader),
        kind=f"{kind} (version {version})",
        dataset=dataset or name,
        notes=notes,
        **facts,
    )


def chosen_leading(
    path: Path, axes: str, shape: tuple[int, ...], dataset: str | None
) -> tuple[tuple[int, ...], list[int]]:
    """Return the place on each axis before y and x, and which of them are still long."""
    n_leading = max(len(shape) - 2, 0)
    if dataset is None or len(axes) != len(shape):
        return (0,) * n_leading, [i for i in range(n_leading) if shape[i] != 1]
    places = chosen_places(path, axes, shape, dataset)[:n_leading]
    chosen = tuple(p if isinstance(p, int) else 0 for p in places)
    return chosen, [i for i, p in enumerate(places) if not isinstance(p, int)]


def facts_of_group(root: Any, name: str) -> Facts:
    """Return what the OME-Zarr image says whose level was chosen by name."""
    parent, _, _ = name.rpartition("/")
    image = ome_image((root[parent] if parent else root).attrs)
    return ome_facts(image) if image else {}


def unreadable(path: Path, error: Exception) -> str:
    """Return the sentence for a store that can't be read."""
    address = address_of(path)
    if address is not None:
        return unreached(address, error)
    return (
        f"{path.name} can't be read as a Zarr store; it may be incomplete or damaged "
        f"({in_one_line(error)})"
    )


def check_sound(path: Path, array: Any) -> None:
    """Raise Unsound if reading an array could run code or take absurd amounts of memory."""
    metadata = array.metadata
    parts: list[Any] = []
    for field in ("codecs", "filters", "compressor"):
        found = getattr(metadata, field, None) or ()
        parts += list(found) if isinstance(found, (list, tuple)) else [found]
    if any("pickle" in f"{type(part).__name__} {part}".lower() for part in parts):
        msg = (
            f"{path.name} holds Python objects, which are never loaded because they could run "
            "code; save it as plain numbers"
        )
        raise Unsound(msg)
    check_packed_once(path, metadata)
    piece = math.prod(int(n) for n in array.chunks) * np.dtype(array.dtype).itemsize
    if piece > LARGEST_PIECE:
        msg = (
            f"{path.name} packs its frames in pieces of {size_in_words(piece)}, more than can be "
            "unpacked for a frame; save it in pieces of a frame"
        )
        raise Unsound(msg)


def check_regular(path: Path, *files: Path) -> None:
    """Raise Unsound if a file of a store is a pipe or a device, or lies outside of the store."""
    for file in files:
        if file.exists() and not file.is_file():
            msg = f"{file.name} is not a file, but a pipe or a device"
            raise Unsound(msg)
        if file.exists() and not file.resolve().is_relative_to(path.resolve()):
            msg = f"{path.name} holds {file.name} as a link to elsewhere; copy the file there"
            raise Unsound(msg)


def check_pieces(
    path: Path, name: str, array: Any, place: list[int], pieces: Pieces, axis: int | None
) -> None:
    """Raise OSError if the pieces of a frame in a folder are missing or cut short.

    zarr-python gives zeros for pieces that aren't there, and Blosc for the missing end of one that
    it could not make smaller. Missing pieces are black, which Zarr leaves out, unless nothing at
    all comes after them: then the recording ended there.
    """
    files = files_of(path, name, array, place)
    if not files and not goes_on(path, name, array, place, axis):
        msg = "nothing of it is in the store"
        raise OSError(msg)
    for file in files:
        found = file.stat()
        stamp = (str(file), found.st_mtime_ns, found.st_size)
        pieces.check(partial(opened_file, file), found.st_size, file.name, stamp)


def opened_file(path: Path) -> IO[bytes]:
    """Return an open file."""
    return path.open("rb")


def check_zipped(store: ZipFile, name: str, array: Any, place: list[int], pieces: Pieces) -> None:
    """Raise OSError if a piece of a frame in a zipped store would unpack to far too much."""
    for key in keys_of(array, place):
        try:
            info = store.getinfo(f"{name}/{key}".lstrip("/"))
        except KeyError:
            continue
        pieces.check_entry(store, info, key)
        stamp = (info.filename, info.header_offset, info.file_size)
        pieces.check(partial(store.open, info), info.file_size, key, stamp)


def keys_of(array: Any, place: list[int]) -> list[str]:
    """Return the names of the pieces of a frame."""
    pieces = array.shards or array.chunks
    counts = [-(-n // p) for n, p in zip(array.shape[-2:], pieces[-2:], strict=True)]
    leading = [p // n for p, n in zip(place, pieces, strict=False)]
    return [
        array.metadata.encode_chunk_key((*leading, row, column))
        for row in range(counts[0])
        for column in range(counts[1])
    ]


def files_of(path: Path, name: str, array: Any, place: list[int]) -> list[Path]:
    """Return the files of a folder that hold a frame."""
    files = [path / name / key for key in keys_of(array, place)]
    check_regular(path, *files)
    return [file for file in files if file.is_file()]


def goes_on(path: Path, name: str, array: Any, place: list[int], axis: int | None) -> bool:
    """Say whether a later frame along an axis is in the store."""
    if axis is None:
        return False
    step = (array.shards or array.chunks)[axis]
    later = range(place[axis] - place[axis] % step + step, array.shape[axis], step)
    return any(
        files_of(path, name, array, [*place[:axis], time, *place[axis + 1 :]]) for time in later
    )


def ome_image(attrs: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the description of the first image of an OME-Zarr group."""
    inner = attrs.get("ome", attrs)
    images = inner.get("multiscales") if isinstance(inner, Mapping) else None
    if not isinstance(images, list) or not images or not isinstance(images[0], dict):
        return None
    return images[0] if images[0].get("datasets") else None


def axes_of(image: Mapping[str, Any]) -> str:
    """Return the axes of an OME-Zarr image as letters."""
    return "".join(
        str(axis.get("name", "?") if isinstance(axis, Mapping) else axis)[:1]
        for axis in image.get("axes", ())
    )


def ome_facts(image: Mapping[str, Any]) -> Facts:
    """Return pixel (um) and interval (s) of an OME-Zarr image, where their units are given."""
    axes = [axis for axis in image.get("axes", ()) if isinstance(axis, Mapping)]
    scale = np.ones(len(axes))
    steps = [part.get("coordinateTransformations") for part in (image, image["datasets"][0])]
    for step in [one for many in steps for one in many or () if one.get("type") == "scale"]:
        if len(step.get("scale", ())) == len(axes):
            scale = scale * np.asarray(step["scale"], np.float64)
    facts: Facts = {}
    for axis, size in zip(axes, scale, strict=True):
        unit = str(axis.get("unit", ""))
        if not (math.isfinite(size) and size > 0):
            continue
        if axis.get("name") == "x" and unit in MICROMETRES:
            facts["pixel_um"] = float(size) * MICROMETRES[unit]
        elif axis.get("name") == "y" and unit in MICROMETRES:
            facts["height_um"] = float(size) * MICROMETRES[unit]
        elif axis.get("type") == "time" and unit in SECONDS:
            facts["interval_s"] = float(size) * SECONDS[unit]
    return facts
