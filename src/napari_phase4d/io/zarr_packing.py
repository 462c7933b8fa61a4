"""How much the pieces of a Zarr array unpack to: looked at before any of them is unpacked.

A piece of a few kilobytes may say, or turn out, to hold gigabytes.
"""

from __future__ import annotations

import bz2
import lzma
import math
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from napari_phase4d.io.lazy import Unsound

__all__ = ["check_packed_once", "check_unpacked"]

#: Bytes at the beginning of a piece that say how it is packed.
HEAD_BYTES = 32
#: A piece may unpack to so many times what it stands for; filters may add some.
MOST_UNPACKED = 2
#: What unpacks streams that don't say how much they hold, and by what factor they pack at most.
STREAMS: Mapping[str, tuple[Callable[[], Any], float]] = {
    "gzip": (lambda: zlib.decompressobj(31), 1032),
    "zlib": (zlib.decompressobj, 1032),
    "bz2": (bz2.BZ2Decompressor, 5e7),
    "lzma": (lzma.LZMADecompressor, 1e5),
}
#: All that packs, by what their classes are called.
PACKERS = (*STREAMS, "zstd", "blosc", "lz4")
#: Streams that hold less than this are not looked into, and others so many bytes at a time.
HARMLESS, PART_BYTES = 2**28, 2**20
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
#: How a shard says where a piece of it lies: its place and its bytes, both this if there is none.
ENTRY, MISSING = np.dtype("<u8"), 2**64 - 1
#: Bytes of the checksum of such a list.
CHECKSUM_BYTES = 4


def check_packed_once(path: Path, metadata: Any) -> None:
    """Raise Unsound for pieces that are packed more than once, as only files made to harm are."""
    outer, inner = packers_of(metadata)
    if len(outer) + len(inner) > 1 or (outer and shard_of(metadata) is not None):
        msg = (
            f"{path.name} packs its pieces more than once ({', '.join((*inner, *outer))}), which "
            "is not unpacked; save it packed once"
        )
        raise Unsound(msg)


def check_unpacked(file: IO[bytes], size: int, name: str, array: Any) -> None:
    """Raise OSError for a piece that is cut short, or would unpack to more than it stands for.

    Parameters
    ----------
    file : file
        With the piece, or with a shard of pieces.
    size : int
        Its bytes.
    name : str
        What to call it.
    array : zarr.Array
        What it belongs to.
    """
    packing = next(iter(sum(packers_of(array.metadata), ())), "")
    holds = math.prod(int(n) for n in array.chunks) * np.dtype(array.dtype).itemsize
    shard = shard_of(array.metadata)
    parts = [(0, size)] if shard is None else parts_of(file, size, name, array, shard)
    for start, length in parts:
        file.seek(start)
        head = file.read(min(HEAD_BYTES, length))
        if "blosc" in packing and int.from_bytes(head[12:16], "little") > length:
            msg = f"its piece {name} is cut short"
            raise OSError(msg)
        limit = MOST_UNPACKED * holds
        if unpacked_bytes(file, start, length, head, packing, limit) > limit:
            msg = f"its piece {name} would unpack to more than {holds} bytes"
            raise OSError(msg)


def parts_of(
    file: IO[bytes], size: int, name: str, array: Any, shard: Any
) -> list[tuple[int, int]]:
    """Return where the pieces of a shard lie in it, and their bytes.

    See the specification of Zarr's sharding codec, version 1.0, "Binary shard format".
    """
    count = math.prod(s // c for s, c in zip(array.shards, array.chunks, strict=True))
    names = [type(codec).__name__.lower() for codec in shard.index_codecs]
    checked = CHECKSUM_BYTES if any("crc32c" in name for name in names) else 0
    length = 2 * ENTRY.itemsize * count
    at_end = "end" in str(shard.index_location).lower()
    if len(names) - bool(checked) != 1 or size < length + checked:
        msg = f"its piece {name} is cut short, or lists what it holds in an unusual way"
        raise OSError(msg)
    file.seek(size - length - checked if at_end else 0)
    entries = np.frombuffer(file.read(length), ENTRY).reshape(count, 2).tolist()
    return [(start, long) for start, long in entries if start != MISSING]


def shard_of(metadata: Any) -> Any:
    """Return what joins the pieces of an array in shards, None if nothing does."""
    found = getattr(metadata, "codecs", None) or ()
    return next((c for c in found if "sharding" in type(c).__name__.lower()), None)


def packers_of(metadata: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of what packs the pieces of an array, or its shards, and what is in them.

    What joins pieces within pieces counts as well.
    """
    codecs = getattr(metadata, "codecs", None)
    if codecs is None:
        codecs = (*(metadata.filters or ()), metadata.compressor)
    shard = shard_of(metadata)
    inner = () if shard is None else tuple(shard.codecs)
    return packers_in(c for c in codecs if c is not shard), packers_in(inner)


def packers_in(codecs: Any) -> tuple[str, ...]:
    """Return the names of those that pack, in small letters."""
    names = [type(codec).__name__.lower() for codec in codecs]
    return tuple(n for n in names if any(packer in n for packer in (*PACKERS, "sharding")))


def unpacked_bytes(
    file: IO[bytes], start: int, length: int, head: bytes, packing: str, limit: int
) -> int:
    """Return how many bytes a packed piece says, or is found, to hold; 0 where it can't be told.

    Parameters
    ----------
    file : file
        With the piece.
    start, length : int
        Where it begins, and its bytes.
    head : bytes
        Its first bytes.
    packing : str
        Name of what packed it, in small letters.
    limit : int
        What is packed by gzip and the like doesn't say it: it is unpacked up to here to see.
    """
    if "blosc" in packing:  # c-blosc's header
        return int.from_bytes(head[4:8], "little")
    if "lz4" in packing:  # as numcodecs writes it
        return int.from_bytes(head[:4], "little")
    if "zstd" in packing:
        return zstd_bytes(head)
    for name, (stream_of, ratio) in STREAMS.items():
        if name in packing and length * ratio > max(limit, HARMLESS):
            file.seek(start)
            return streamed_bytes(file.read(length), stream_of(), limit)
    return 0


def streamed_bytes(packed: bytes, stream: Any, limit: int) -> int:
    """Return how many bytes a piece unpacks to, of which one part at a time is held."""
    found = 0
    while found <= limit and not stream.eof:
        part = len(stream.decompress(packed, PART_BYTES))
        found += part
        # zlib gives back what it has not looked at; the others keep it.
        packed = getattr(stream, "unconsumed_tail", b"")
        if not part and not packed:
            break
    return found


def zstd_bytes(head: bytes) -> int:
    """Return how many bytes a Zstandard frame says that it holds (RFC 8878, section 3.1.1.1)."""
    if head[:4] != ZSTD_MAGIC or len(head) < 5:
        return 0
    descriptor = head[4]
    single = descriptor >> 5 & 1
    size = (single, 2, 4, 8)[descriptor >> 6]
    start = 5 + (1 - single) + (0, 1, 2, 4)[descriptor & 3]
    return int.from_bytes(head[start : start + size], "little") + (256 if size == 2 else 0)
