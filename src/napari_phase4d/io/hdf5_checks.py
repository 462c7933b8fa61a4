"""Whether an HDF5 dataset holds what it says, and holds it in its own file."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path
from typing import Any

from napari_phase4d.io.lazy import Unsound
from napari_phase4d.io.limits import LARGEST_PIECE
from napari_phase4d.words import size_in_words

__all__ = ["check_sound", "check_written", "is_complete", "leads_inside"]

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
        other = path if name == "." else path.parent / name
        if not other.is_file():
            msg = f"{path.name} needs {name}, which is not there"
            raise Unsound(msg)
        if not other.resolve().is_relative_to(path.parent.resolve()):
            msg = f"{path.name} needs {name}, which is in another folder and not followed; copy it"
            raise Unsound(msg)
        if not is_plain(other, dataset):
            msg = f"{path.name} needs {dataset!r} of {other.name}, which has no numbers of its own"
            raise Unsound(msg)


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
