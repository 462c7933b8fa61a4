"""How much the pieces of a Zarr array unpack to: looked at before any of them is unpacked.

A piece of a few kilobytes may say, or turn out, to hold gigabytes.
"""

from __future__ import annotations

import bz2
import lzma
import math
import zlib
from collections.abc import Callable, Mapping
from copy import copy
from functools import partial
from pathlib import Path
from typing import IO, Any, NamedTuple
from zipfile import ZIP_BZIP2, ZIP_DEFLATED, ZIP_LZMA, ZIP_STORED, ZipFile, ZipInfo

import numpy as np

from napari_phase4d.io.lazy import Unsound

__all__ = ["Pieces", "check_packed_once"]

#: Bytes at the beginning of a piece that say how it is packed.
HEAD_BYTES = 32
#: A piece may unpack to so many times what it stands for; filters may add some.
MOST_UNPACKED = 2
#: Checksums and headers may add so many bytes, which counts for tiny pieces.
MORE_BYTES = 128
#: What unpacks streams that don't say how much they hold, and by what factor they pack at most.
STREAMS: Mapping[str, tuple[Callable[[], Any], float]] = {
    "gzip": (lambda: zlib.decompressobj(31), 1032),
    "zlib": (zlib.decompressobj, 1032),
    "bz2": (bz2.BZ2Decompressor, 5e7),
    "lzma": (lzma.LZMADecompressor, 1e5),
}
#: The same for what a zip packs itself.
ENTRIES: Mapping[int, tuple[Callable[[], Any], float]] = {
    ZIP_DEFLATED: (lambda: zlib.decompressobj(-15), 1032),
    ZIP_BZIP2: STREAMS["bz2"],
    ZIP_LZMA: STREAMS["lzma"],
}
#: All that packs, by what their classes are called.
PACKERS = (*STREAMS, "zstd", "blosc", "lz4")
#: What puts a checksum before or behind, by what their classes are called, and its bytes.
CHECKSUMS, CHECKSUM_BYTES = ("crc32", "adler32", "fletcher32", "jenkins"), 4
#: Streams that hold less than this are not looked into, and others so many bytes at a time.
HARMLESS, PART_BYTES = 2**28, 2**20
#: A stream is given so many bytes at a time: what is behind its end is copied.
SLICE_BYTES = 2**14
#: So many files that have been looked at are noted.
MOST_NOTED = 2**13
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
#: How a shard says where a piece of it lies: its place and its bytes, both this if there is none.
ENTRY, MISSING = np.dtype("<u8"), 2**64 - 1


class Chain(NamedTuple):
    """What the pieces of an array go through when they are written, in order."""

    #: Of a piece.
    inner: tuple[Any, ...]
    #: What joins pieces in shards, None if nothing does.
    shard: Any
    #: Of a shard.
    outer: tuple[Any, ...]


def check_packed_once(path: Path, metadata: Any) -> None:
    """Raise Unsound for pieces that are packed more than once, as only files made to harm are.

    So are those that are changed after they were packed: what they hold can't be told.
    """
    chain = chain_of(metadata)
    inner, outer = packers_in(chain.inner), packers_in(chain.outer)
    within = chain.shard is not None and any("sharding" in name for name in inner)
    if len(inner) + len(outer) > 1 or outer or within:
        msg = (
            f"{path.name} packs its pieces more than once ({', '.join((*inner, *outer))}), which "
            "is not unpacked; save it packed once"
        )
        raise Unsound(msg)
    last = (*behind(chain.inner), *chain.outer) if inner else ()
    changing = [name_of(codec) for codec in last if not is_checksum(codec)]
    if changing:
        msg = (
            f"{path.name} changes its pieces after packing them ({', '.join(changing)}), so that "
            "it can't be told what they unpack to; save it with packing as the last step"
        )
        raise Unsound(msg)


class Pieces:
    """Looks at the packed pieces of an array, at each of them once as long as it stays as it is.

    A shard holds pieces of many frames.

    Parameters
    ----------
    array : zarr.Array
        What they belong to.
    """

    def __init__(self, array: Any) -> None:
        self._chain = chain_of(array.metadata)
        self._codec = next((codec for codec in self._chain.inner if packs(codec)), None)
        # zarr-python takes the shards for the pieces where something else comes after them.
        joined = math.prod(int(n) for n in array.shards or array.chunks)
        shard = self._chain.shard
        alone = joined if shard is None else math.prod(int(n) for n in shard.chunk_shape)
        #: Bytes of a piece as it is used, how many may come out, and how many pieces a shard has.
        self._holds = alone * np.dtype(array.dtype).itemsize
        self._limit = MOST_UNPACKED * self._holds + MORE_BYTES
        self._count = joined // alone
        #: What has been looked at; in the order of looking.
        self._sound: dict[tuple[Any, ...], None] = {}

    def check(
        self, opened: Callable[[], IO[bytes]], size: int, name: str, stamp: tuple[Any, ...]
    ) -> None:
        """Raise OSError for a piece that is cut short, or would unpack to more than it stands for.

        Parameters
        ----------
        opened : callable
            Opens the file with the piece, or with a shard of pieces.
        size : int
            Its bytes.
        name : str
            What to call it.
        stamp : tuple
            What tells this state of this file from all others.
        """
        if self._codec is None or stamp in self._sound:
            return
        with opened() as file:
            whole = without_checksums((0, size), self._chain.outer)
            for part in self._parts(file, whole, name):
                self._check_part(file, without_checksums(part, behind(self._chain.inner)), name)
        self._note(stamp)

    def check_entry(self, archive: ZipFile, info: ZipInfo, name: str) -> None:
        """Raise OSError if what a zip has packed holds more than a piece, or a shard, may have.

        Parameters
        ----------
        archive : ZipFile
            The store.
        info : ZipInfo
            What it says of the piece, which need not be true.
        name : str
            What to call the piece.
        """
        stamp = ("in a zip", info.filename, info.header_offset)
        if info.compress_type == ZIP_STORED or stamp in self._sound:
            return
        limit = self._count * self._limit
        if info.file_size > limit or entry_bytes(archive, info, limit) > limit:
            msg = f"its piece {name} would unpack to more than {self._count * self._holds} bytes"
            raise OSError(msg)
        self._note(stamp)

    def _note(self, stamp: tuple[Any, ...]) -> None:
        """Note that a file is sound."""
        self._sound[stamp] = None
        if len(self._sound) > MOST_NOTED:
            del self._sound[next(iter(self._sound))]

    def _check_part(self, file: IO[bytes], part: tuple[int, int], name: str) -> None:
        """Look at one piece."""
        start, length = part
        file.seek(start)
        head = file.read(min(HEAD_BYTES, length))
        if "blosc" in name_of(self._codec) and int.from_bytes(head[12:16], "little") > length:
            msg = f"its piece {name} is cut short"
            raise OSError(msg)
        if unpacked_bytes(file, start, length, head, self._codec, self._limit) > self._limit:
            msg = f"its piece {name} would unpack to more than {self._holds} bytes"
            raise OSError(msg)

    def _parts(self, file: IO[bytes], whole: tuple[int, int], name: str) -> list[tuple[int, int]]:
        """Return where the pieces lie in a file, and their bytes."""
        if self._chain.shard is None:
            return [whole]
        return places_in_shard(file, whole, name, self._count, self._chain.shard)


def places_in_shard(
    file: IO[bytes], whole: tuple[int, int], name: str, count: int, shard: Any
) -> list[tuple[int, int]]:
    """Return where the pieces of a shard lie in its file, in order, and their bytes.

    See the specification of Zarr's sharding codec, version 1.0, "Binary shard format".
    """
    begin, size = whole
    names = [name_of(codec) for codec in shard.index_codecs]
    checked = CHECKSUM_BYTES if any("crc32c" in name for name in names) else 0
    length = 2 * ENTRY.itemsize * count
    at_end = "end" in str(shard.index_location).lower()
    if len(names) - bool(checked) != 1 or size < length + checked:
        msg = f"its piece {name} is cut short, or lists what it holds in an unusual way"
        raise OSError(msg)
    file.seek(begin + (size - length - checked if at_end else 0))
    big = any("big" in str(getattr(codec, "endian", "")).lower() for codec in shard.index_codecs)
    entry = ENTRY.newbyteorder(">" if big else "<")
    entries = np.frombuffer(file.read(length), entry).reshape(count, 2).tolist()
    places = sorted((begin + start, long) for start, long in entries if start != MISSING)
    if any(start + long > begin + size for start, long in places):
        msg = f"its piece {name} is cut short"
        raise OSError(msg)
    return places


def chain_of(metadata: Any) -> Chain:
    """Return what the pieces of an array go through."""
    codecs = getattr(metadata, "codecs", None)
    if codecs is None:  # version 2 of the format
        codecs = (*(metadata.filters or ()), metadata.compressor)
    codecs = tuple(codec for codec in codecs if codec is not None)
    for number, codec in enumerate(codecs):
        if "sharding" in name_of(codec):
            return Chain(tuple(codec.codecs), codec, codecs[number + 1 :])
    return Chain(codecs, None, ())


def packers_in(codecs: Any) -> tuple[str, ...]:
    """Return the names of those that pack; what joins pieces within pieces counts as well."""
    return tuple(name_of(codec) for codec in codecs if packs(codec))


def packs(codec: Any) -> bool:
    """Say whether something packs pieces, or joins them."""
    return any(packer in name_of(codec) for packer in (*PACKERS, "sharding"))


def behind(codecs: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return what comes after what packs."""
    first = next((n for n, codec in enumerate(codecs) if packs(codec)), len(codecs))
    return codecs[first + 1 :]


def name_of(codec: Any) -> str:
    """Return what the class of a codec is called, in small letters."""
    return type(codec).__name__.lower()


def is_checksum(codec: Any) -> bool:
    """Say whether a codec only adds a checksum."""
    return any(checksum in name_of(codec) for checksum in CHECKSUMS)


def without_checksums(part: tuple[int, int], codecs: tuple[Any, ...]) -> tuple[int, int]:
    """Return where a piece lies between the checksums that codecs have put around it."""
    start, length = part
    for codec in codecs:
        if is_checksum(codec):
            length -= CHECKSUM_BYTES
            if getattr(in_numcodecs(codec), "location", "end") == "start":
                start += CHECKSUM_BYTES
    return start, max(length, 0)


def in_numcodecs(codec: Any) -> Any:
    """Return what zarr-python has wrapped for version 3 of the format; else the codec itself."""
    configured = getattr(codec, "codec_config", None)
    if configured is None:
        return codec
    import numcodecs

    return numcodecs.get_codec(configured)


def unpacked_bytes(
    file: IO[bytes], start: int, length: int, head: bytes, codec: Any, limit: int
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
    codec : object
        What packed it.
    limit : int
        What is packed by gzip and the like doesn't say it: it is unpacked up to here to see.
    """
    packing = name_of(codec)
    if "blosc" in packing:  # c-blosc's header
        return int.from_bytes(head[4:8], "little")
    if "lz4" in packing:  # as numcodecs writes it
        return int.from_bytes(head[:4], "little")
    file.seek(start)
    if "zstd" in packing:
        return zstd_bytes(file.read(length), limit)
    for name, (stream_of, ratio) in STREAMS.items():
        if name in packing and length * ratio > max(limit, HARMLESS):
            settings = in_numcodecs(codec)
            if name == "lzma":
                stream_of = partial(lzma.LZMADecompressor, settings.format, None, settings.filters)
            return streamed_bytes(file.read(length), stream_of, limit)
    return 0


def entry_bytes(archive: ZipFile, info: ZipInfo, limit: int) -> int:
    """Return how many bytes a packed entry of a zip holds, up to the limit; 0 if few at most.

    A zip says it, but Python unpacks all at once, and then cuts off what is too much.
    """
    stream_of, ratio = ENTRIES.get(info.compress_type, (None, 0.0))
    if stream_of is None:
        msg = f"its piece {info.filename} is packed in a rare way; store it in the zip unpacked"
        raise OSError(msg)
    if info.compress_size * ratio <= max(limit, HARMLESS):
        return 0
    as_it_is = copy(info)
    as_it_is.compress_type, as_it_is.file_size = ZIP_STORED, info.compress_size
    # There is no checksum of what is packed.
    del as_it_is.CRC
    with archive.open(as_it_is) as file:
        packed = file.read()
    if info.compress_type == ZIP_LZMA:  # APPNOTE.TXT 5.8.8, as a stream that says no size
        packed = packed[4:9] + b"\xff" * 8 + packed[9:]
    return streamed_bytes(packed, stream_of, limit)


def streamed_bytes(packed: bytes, stream_of: Callable[[], Any], limit: int) -> int:
    """Return how many bytes a piece unpacks to, of which one part at a time is held.

    It may consist of several streams, with zeros between them. Where one of them is damaged, what
    unpacks it stops as well.
    """
    found, place, stream, waiting = 0, 0, stream_of(), b""
    while found <= limit:
        if stream.eof:
            stream, waiting = stream_of(), stream.unused_data.lstrip(b"\0")
            while not waiting and place < len(packed):
                waiting = packed[place : place + SLICE_BYTES].lstrip(b"\0")
                place += SLICE_BYTES
        elif not waiting and getattr(stream, "needs_input", True):
            waiting = packed[place : place + SLICE_BYTES]
            place += SLICE_BYTES
        try:
            part = len(stream.decompress(waiting, PART_BYTES))
        except (OSError, zlib.error, lzma.LZMAError):
            break
        found += part
        if not part and not waiting and place >= len(packed):
            break
        # zlib gives back what it has not looked at; the others keep it.
        waiting = getattr(stream, "unconsumed_tail", b"")
    return found


def zstd_bytes(packed: bytes, limit: int) -> int:
    """Return how many bytes a piece packed by Zstandard holds, or one more than the limit.

    Where not every frame of it says so, it is unpacked up to the limit to see.
    """
    said = zstd_said(packed)
    if said is not None:
        return said
    import numcodecs

    try:
        numcodecs.Zstd().decode(packed, out=np.empty(limit, np.uint8))
    except (RuntimeError, ValueError) as error:
        # Holding less is an error for numcodecs too, but of other words.
        return limit + 1 if "too small" in str(error) else 0
    return limit


def zstd_said(packed: bytes) -> int | None:
    """Return how many bytes the frames of a piece say that they hold, None unless all say it.

    See RFC 8878, sections 3.1.1 (frames, blocks) and 3.1.2 (what is to be skipped).
    """
    found = place = 0
    while place < len(packed):
        magic, descriptor = packed[place : place + 4], packed[place + 4 : place + 5]
        if magic != ZSTD_MAGIC or not descriptor:
            return None
        single = descriptor[0] >> 5 & 1
        size = (single, 2, 4, 8)[descriptor[0] >> 6]
        if not size:
            return None
        place += 5 + (1 - single) + (0, 1, 2, 4)[descriptor[0] & 3]
        found += int.from_bytes(packed[place : place + size], "little") + 256 * (size == 2)
        place += size
        last = False
        while not last and place < len(packed):
            block = int.from_bytes(packed[place : place + 3], "little")
            last, repeated = bool(block & 1), block >> 1 & 3 == 1
            place += 3 + (1 if repeated else block >> 3)
        place += 4 * (descriptor[0] >> 2 & 1)  # a checksum
    return found
