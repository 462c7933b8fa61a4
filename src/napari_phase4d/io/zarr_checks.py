"""Whether a Zarr array can be read safely, and whether the pieces of a frame are there."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from napari_phase4d.io.lazy import Unsound
from napari_phase4d.io.limits import LARGEST_PIECE
from napari_phase4d.words import size_in_words

__all__ = ["check_pieces", "check_regular", "check_sound"]


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
    piece = math.prod(int(n) for n in array.chunks) * np.dtype(array.dtype).itemsize
    if piece > LARGEST_PIECE:
        msg = (
            f"{path.name} packs its frames in pieces of {size_in_words(piece)}, more than can be "
            "unpacked for a frame; save it in pieces of a frame"
        )
        raise Unsound(msg)


def check_regular(*files: Path) -> None:
    """Raise Unsound if one of some files is none, but a pipe or a device: it may have no end."""
    for file in files:
        if file.exists() and not file.is_file():
            msg = f"{file.name} is not a file, but a pipe or a device"
            raise Unsound(msg)


def check_pieces(
    path: Path, name: str, array: Any, place: list[int], axis: int | None = None
) -> None:
    """Raise OSError if the pieces of a frame in a folder are missing or cut short.

    zarr-python gives zeros for pieces that aren't there, and Blosc for the missing end of one that
    it could not make smaller. Missing pieces are black, which Zarr leaves out, unless nothing at
    all comes after them: then the recording ended there.
    """
    if not path.is_dir():
        return
    files = files_of(path, name, array, place)
    if not files and not goes_on(path, name, array, place, axis):
        msg = "nothing of it is in the store"
        raise OSError(msg)
    if array.shards is None and packs_with_blosc(array.metadata):
        for file in files:
            with file.open("rb") as opened_file:
                told = int.from_bytes(opened_file.read(16)[12:], "little")  # c-blosc's header
            if told > file.stat().st_size:
                msg = f"its piece {file.name} is cut short"
                raise OSError(msg)


def files_of(path: Path, name: str, array: Any, place: list[int]) -> list[Path]:
    """Return the files of a folder that hold a frame."""
    pieces = array.shards or array.chunks
    counts = [-(-n // p) for n, p in zip(array.shape[-2:], pieces[-2:], strict=True)]
    leading = [p // n for p, n in zip(place, pieces, strict=False)]
    keys = (
        array.metadata.encode_chunk_key((*leading, row, column))
        for row in range(counts[0])
        for column in range(counts[1])
    )
    files = [path / name / key for key in keys]
    check_regular(*files)
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


def packs_with_blosc(metadata: Any) -> bool:
    """Say whether Blosc packs the pieces of an array last."""
    codecs = getattr(metadata, "codecs", None) or (getattr(metadata, "compressor", None),)
    return "blosc" in type(codecs[-1]).__name__.lower()
