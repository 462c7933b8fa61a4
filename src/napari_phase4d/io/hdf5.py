"""HDF5 files, read with h5py, and whether they hold what they say."""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import FrameReader, Unsound, beside, in_one_line, lazy_frames
from napari_phase4d.io.sequences import gap_in
from napari_phase4d.io.video import (
    LARGEST_PIECE,
    MICROMETRES,
    SECONDS,
    Facts,
    Found,
    Video,
    chosen_name,
    other_arrays,
)
from napari_phase4d.words import size_in_words

__all__ = ["HDF5_SUFFIXES", "hdf5_parts", "read_hdf5"]

HDF5_SUFFIXES = (".h5", ".hdf5", ".hdf", ".hspy", ".nxs", ".emd")
#: Arrays looked at; a file with more is no recording, or made to keep us busy.
MOST_ARRAYS = 20_000

#: Attributes that say the pixel in the sample, and their unit in micrometres.
PIXEL_ATTRS = {"pixel_size_um": 1.0, "pixel_um": 1.0, "pixel size": 1e6, "pixel_size_m": 1e6}
#: Attributes that say the time between frames, and their unit in seconds.
INTERVAL_ATTRS = {"frame_interval_s": 1.0, "interval_s": 1.0, "frame_interval_ms": 1e-3}
RATE_ATTRS = ("frame_rate_hz", "frame_rate", "fps")


def read_hdf5(path: Path, dataset: str | None = None) -> Video:
    """Open a dataset of an HDF5 file, lazily.

    Datasets with numbers for names, of one size and kind and in one group, are the frames of one
    recording, as programs write them that keep each frame with its own attributes. Pixel size and
    frame interval are taken from attributes that name their unit, from ``pixel size`` in metres
    as qpformat and qpimage write it (https://qpimage.readthedocs.io), ``element_size_um`` (the
    HDF5 plugin of Fiji), and the axes of HyperSpy files (https://hyperspy.org).

    Parameters
    ----------
    path : Path
        The file.
    dataset : str, optional
        Name of the dataset, as "group/name", or of a group whose datasets are frames. Default:
        a guess, see `choosing.chosen_name`, told in ``notes``.

    Raises
    ------
    OSError
        If the file is damaged, cut short or no HDF5 file, or its numbers lie in other files.
    ValueError
        If there is no such dataset.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            arrays, members = found_arrays(file)
            name = chosen_name(path, arrays, dataset)
            names = members.get(name, (name,))
            check_sound(path, file[names[0]])
            facts = facts_of(file, names[0])
    except Exception as error:
        # h5py raises what it likes for damaged files; sentences of ours begin with the name.
        if isinstance(error, Unsound | ValueError) and str(error).startswith(path.name):
            raise
        msg = (
            f"{path.name} can't be read as an HDF5 file; it may be cut short or damaged "
            f"({in_one_line(error)})"
        )
        raise OSError(msg) from error
    return Video(
        frames_of(path, names, *arrays[name]),
        kind="HDF5",
        dataset=name,
        notes=(*other_arrays(name, arrays, dataset), *gap_in(names, "datasets")),
        **facts,
    )


class Hdf5Reader(FrameReader):
    """Reads frames of one dataset, or of one dataset a frame.

    Parameters
    ----------
    path : Path
        The file; every process opens it for itself.
    names : tuple of str
        The dataset, or one for each frame.
    shape, dtype
        Of the recording.
    """

    arguments = ("path", "names", "shape", "dtype")

    def __init__(
        self,
        path: Path,
        names: tuple[str, ...],
        shape: tuple[int, int, int],
        dtype: np.dtype[Any],
    ) -> None:
        super().__init__(path, shape, dtype)
        self.names = names
        self._lock = threading.Lock()
        self._file: Any = None
        self._complete = False

    def read(self, index: int) -> NDArray[Any]:
        """Return one frame."""
        with self._lock:
            if len(self.names) > 1:
                data = self._open()[self.names[index]]
                check_sound(self.path, data)
                check_written(data, ())
                return data[()].reshape(self.shape[1:])  # type: ignore[no-any-return]
            data = self._open()[self.names[0]]
            long = [n > 1 for n in data.shape[:-2]]
            place = tuple(index if is_time else 0 for is_time in long)
            if not self._complete:
                check_written(data, place)
            return data[place].reshape(self.shape[1:])  # type: ignore[no-any-return]

    def _open(self) -> Any:
        """Return the open file, its cache large enough that no piece is unpacked twice."""
        import h5py

        if self._file is None:
            with h5py.File(self.path, "r") as file:
                data = file[self.names[0]]
                piece = math.prod(data.chunks or ()) * data.dtype.itemsize if data.chunks else 0
                across = [-(-n // c) for n, c in zip(data.shape, data.chunks or (), strict=False)]
            needed = piece * math.prod(across[-2:])
            self._file = h5py.File(self.path, "r", rdcc_nbytes=min(max(2**20, needed), 2**28))
            self._complete = is_complete(self._file[self.names[0]])
        return self._file


def frames_of(
    path: Path, names: tuple[str, ...], shape: tuple[int, ...], dtype: np.dtype[Any]
) -> Any:
    """Return lazy frames of a dataset with two or three long axes, else of any number."""
    video = video_shape(shape)
    if video is None:
        msg = f"{path.name} has {len(shape)} axes {shape} in {names[0]!r}; time, y, x are needed"
        raise ValueError(msg)
    return lazy_frames(Hdf5Reader(path, names, video, dtype))


def video_shape(shape: tuple[int, ...]) -> tuple[int, int, int] | None:
    """Return (time, y, x) of an array whose other axes have length 1, else None."""
    before = [n for n in shape[:-2] if n != 1]
    if len(shape) < 2 or len(before) > 1:
        return None
    return (before[0] if before else 1), shape[-2], shape[-1]


def found_arrays(file: Any) -> tuple[dict[str, Found], dict[str, tuple[str, ...]]]:
    """Return shape and kind of every dataset; numbered ones joined, with their members.

    Links to other files are not followed.
    """
    import h5py

    arrays: dict[str, Found] = {}

    def note(name: str, item: Any) -> bool | None:
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            try:
                arrays[name] = (tuple(int(n) for n in item.shape), item.dtype)
            except TypeError:  # of a kind that NumPy hasn't, such as H5T_TIME
                return None
        return True if len(arrays) >= MOST_ARRAYS else None

    file.visititems(note)
    groups: dict[str, list[str]] = {}
    for name in arrays:
        group, _, last = name.rpartition("/")
        if re.fullmatch(r"\d+", last):
            groups.setdefault(group, []).append(name)
    members: dict[str, tuple[str, ...]] = {}
    for group, names in groups.items():
        same = len({arrays[n] for n in names}) == 1 and len(arrays[names[0]][0]) == 2
        if len(names) > 1 and same:
            ordered = tuple(sorted(names, key=lambda n: int(n.rpartition("/")[2])))
            members[group or "numbered frames"] = ordered
            shape, dtype = arrays[names[0]]
            arrays[group or "numbered frames"] = ((len(names), *shape), dtype)
    return arrays, members


def facts_of(file: Any, name: str) -> Facts:
    """Return pixel (um) and interval (s) from attributes of a dataset and of the groups above."""
    facts: Facts = {}
    item = file[name]
    nearest_last = (axes_facts(item.parent), facts_in(file.attrs), facts_in(item.parent.attrs))
    for found in (*nearest_last, facts_in(item.attrs)):
        if "pixel_um" in found:  # which may be another one than that whose height is known
            facts.pop("height_um", None)
        facts.update(found)
    return facts


def facts_in(attrs: Mapping[str, Any]) -> Facts:
    """Return what one set of attributes says clearly."""
    facts: Facts = {}
    for name, unit in PIXEL_ATTRS.items():
        if positive(attrs.get(name)):
            facts["pixel_um"] = positive(attrs.get(name)) * unit
    sizes = np.ravel(attrs.get("element_size_um", ()))
    if len(sizes) and positive(sizes[-1]):
        facts["pixel_um"] = positive(sizes[-1])
        if positive(sizes[-2:][0]):
            facts["height_um"] = positive(sizes[-2:][0])
    for name, unit in INTERVAL_ATTRS.items():
        if positive(attrs.get(name)):
            facts["interval_s"] = positive(attrs.get(name)) * unit
    for name in RATE_ATTRS:
        if positive(attrs.get(name)):
            facts.setdefault("interval_s", 1 / positive(attrs.get(name)))
    return facts


def axes_facts(group: Any) -> Facts:
    """Return what the axes of a HyperSpy file say: groups axis-0, axis-1 ... beside the data."""
    facts: Facts = {}
    names = [n for n in sorted(group) if re.fullmatch(r"axis-\d+", n) and leads_inside(group, n)]
    axes = [group[n].attrs for n in names]
    if len(axes) < 2:
        return facts
    unit = MICROMETRES.get(text(axes[-1].get("units")))
    if unit and positive(axes[-1].get("scale")):
        facts["pixel_um"] = positive(axes[-1].get("scale")) * unit
    unit = MICROMETRES.get(text(axes[-2].get("units")))
    if unit and positive(axes[-2].get("scale")):
        facts["height_um"] = positive(axes[-2].get("scale")) * unit
    unit = SECONDS.get(text(axes[0].get("units")))
    if len(axes) == 3 and unit and positive(axes[0].get("scale")):
        facts["interval_s"] = positive(axes[0].get("scale")) * unit
    return facts


def positive(value: Any) -> float:
    """Return a number above 0, else 0."""
    try:
        number = float(np.ravel(value)[0])
    except (TypeError, ValueError, IndexError):
        return 0.0
    return number if math.isfinite(number) and number > 0 else 0.0


def text(value: Any) -> str:
    """Return an attribute as text."""
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


#: Soft links that are followed one after the other.
MOST_LINKS = 16


def is_complete(data: Any) -> bool:
    """Say whether every piece of a dataset was written."""
    if data.chunks is None or data.is_virtual:
        return True
    pieces = math.prod(-(-n // c) for n, c in zip(data.shape, data.chunks, strict=True))
    written: int = data.id.get_num_chunks()
    return bool(written == pieces)


def check_written(data: Any, place: tuple[int, ...]) -> None:
    """Raise OSError if a piece of a frame was never written; it would come as zeros."""
    if data.chunks is None or data.is_virtual:
        return
    first = tuple(p - p % c for p, c in zip(place, data.chunks, strict=False))
    sides = zip(data.shape[-2:], data.chunks[-2:], strict=True)
    for corner in product(*(range(0, n, c) for n, c in sides)):
        if data.id.get_chunk_info_by_coord((*first, *corner)).byte_offset is None:
            msg = "it, or a part of it, was never written"
            raise OSError(msg)


def check_sound(path: Path, data: Any) -> None:
    """Raise Unsound if a dataset can't hold what it says, or lies in other files."""
    if data.external:
        msg = f"{path.name} keeps {data.name!r} in other files, which are not followed; copy it in"
        raise Unsound(msg)
    if data.is_virtual:
        check_sources(path, data)
        return
    piece = math.prod(data.chunks) * data.dtype.itemsize if data.chunks else 0
    if piece > LARGEST_PIECE:
        msg = (
            f"{path.name} packs {data.name!r} in pieces of {size_in_words(piece)}, "
            "more than can be unpacked for a frame; save it in pieces of a frame"
        )
        raise Unsound(msg)
    if data.size and data.id.get_storage_size() == 0:
        msg = f"{path.name} says that {data.name!r} is {data.shape}, but holds nothing of it"
        raise Unsound(msg)


def check_sources(path: Path, data: Any) -> None:
    """Raise Unsound if a virtual dataset has no plain ones for its parts, or they lie elsewhere.

    HDF5 ends the program on virtual datasets that lead to themselves.
    """
    sources = {(source.file_name, source.dset_name) for source in data.virtual_sources()}
    if not sources:
        msg = f"{path.name} says that {data.name!r} is {data.shape}, but holds nothing of it"
        raise Unsound(msg)
    for name, dataset in sources:
        other = path if name == "." else beside(path, name)
        if not other.is_file():
            msg = f"{path.name} needs {name}, which is not there"
            raise Unsound(msg)
        if not is_plain(other, dataset):
            msg = f"{path.name} needs {dataset!r} of {other.name}, which has no numbers of its own"
            raise Unsound(msg)


def hdf5_parts(path: Path) -> list[Path]:
    """Return the other files that virtual datasets of a file show; none of one that is damaged."""
    import h5py

    found: set[str] = set()

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.is_virtual:
            found.update(source.file_name for source in item.virtual_sources())

    try:
        with h5py.File(path, "r") as file:
            file.visititems(note)
    except Exception:  # h5py raises what it likes; reading it will say what is wrong
        return []
    return [path.parent / name for name in sorted(found - {"."})]


def is_plain(path: Path, name: str) -> bool:
    """Say whether a file has a dataset that holds its numbers itself."""
    import h5py

    with h5py.File(path, "r") as file:
        item = item_inside(file, name)
        return isinstance(item, h5py.Dataset) and not (item.is_virtual or item.external)


def leads_inside(group: Any, name: str) -> bool:
    """Say whether a member of a group lies in the same file."""
    return item_inside(group.file, f"{group.name}/{name}") is not None


def item_inside(file: Any, name: str, links_left: int = MOST_LINKS) -> Any:
    """Return what a name stands for in this very file; None if it leads out of it or nowhere."""
    import h5py

    item = file
    for part in name.split("/"):
        if part in ("", "."):
            continue
        link = item.get(part, getlink=True) if isinstance(item, h5py.Group) else None
        if isinstance(link, h5py.HardLink):
            item = item[part]
        elif isinstance(link, h5py.SoftLink) and links_left:
            target = link.path if link.path.startswith("/") else f"{item.name}/{link.path}"
            item = item_inside(file, target, links_left - 1)
        else:
            return None
    return item
