"""Where each frame of a film lies: AVI, MP4, MOV and MKV, without decoding them."""

from __future__ import annotations

import struct
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["FilmIndex", "declared_size", "index_of"]

#: Timestamp that a packet hasn't got.
UNKNOWN = -(2**63)
#: Kinds of boxes at the top of an MP4 file are looked at up to this many.
MOST_BOXES = 10_000


@dataclass(frozen=True)
class FilmIndex:
    """The packets of a film in the order in which they lie in the file, one a frame.

    Parameters
    ----------
    stamps : ndarray of int64, shape (n, 2)
        Decoding and presentation time of each packet in ticks, `UNKNOWN` where not given.
    keys : ndarray of bool, shape (n,)
        Whether decoding can begin there.
    shown : ndarray of int64, shape (n,)
        Number of the frame that each packet holds, in the order of showing.
    by_counting : bool
        Whether the order of showing is known only by decoding from the start.
    damaged : int or None
        First packet that is only partly there.
    """

    stamps: NDArray[np.int64]
    keys: NDArray[np.bool_]
    shown: NDArray[np.int64]
    by_counting: bool = False
    damaged: int | None = None

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.shown)

    def packet_of(self, frame: int) -> int:
        """Return the packet that holds a frame."""
        return int(self._packets[frame])

    def start_for(self, frame: int) -> int:
        """Return the packet to decode from for a frame: the last key before it in both orders.

        Frames shown before a key, but stored behind it, need the key before that one.
        """
        if self.by_counting:
            return 0
        packet = self.packet_of(frame)
        starts = self._starts
        for place in range(bisect_right(starts, packet) - 1, -1, -1):
            if self.shown[starts[place]] <= frame:
                return int(starts[place])
        return 0

    def times(self) -> NDArray[np.int64] | None:
        """Return the time of each frame in ticks, None if the file doesn't give all."""
        ticks = self.stamps[:, 1][self._packets]
        if self.by_counting or (ticks == UNKNOWN).any() or (np.diff(ticks) <= 0).any():
            return None
        return np.asarray(ticks - ticks[0], np.int64)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_packets", np.argsort(self.shown, kind="stable"))
        object.__setattr__(self, "_starts", np.flatnonzero(self.keys))

    _packets: NDArray[np.int64] = None  # type: ignore[assignment]
    _starts: NDArray[np.int64] = None  # type: ignore[assignment]


def index_of(container: Any, stream: Any, size: int) -> FilmIndex:
    """Return the index of an open film.

    AVI and MP4 keep a list of their packets, which is enough where frames are shown in the order
    in which they are stored. Else all packets are passed over once, without decoding.
    """
    lists_all = container.format.name.startswith(("avi", "mov"))
    found = listed_index(stream, size) if lists_all else None
    return found or scanned_index(container, stream)


def listed_index(stream: Any, size: int) -> FilmIndex | None:
    """Return the index from the file's own list of packets, None if it doesn't tell all."""
    entries = getattr(stream, "index_entries", None)  # PyAV 16 and newer
    if entries is None:
        return None
    count = len(entries)
    if count == 0 or count < stream.frames or stream.codec_context.has_b_frames:
        return None
    if stream.codec_context.name in ("h264", "hevc"):
        return None  # only decoding tells whether they reorder frames
    table = np.array([(e.timestamp, e.is_keyframe, e.pos + e.size) for e in entries], np.int64)
    ticks = table[:, 0]
    if (np.diff(ticks) <= 0).any() or not table[0, 1]:
        return None
    beyond = np.flatnonzero(table[:, 2] > size)
    return FilmIndex(
        np.stack([ticks, ticks], 1),
        table[:, 1].astype(bool),
        np.arange(count),
        damaged=int(beyond[0]) if len(beyond) else None,
    )


def scanned_index(container: Any, stream: Any) -> FilmIndex:
    """Return the index from a pass over all packets."""
    rows: list[tuple[int, int, bool]] = []
    damaged = None
    for packet in container.demux(stream):
        if not packet.size:
            continue
        if packet.is_corrupt and damaged is None:
            damaged = len(rows)
        dts, pts = (UNKNOWN if t is None else int(t) for t in (packet.dts, packet.pts))
        rows.append((dts, pts, packet.is_keyframe))
    table = np.array(rows, np.int64).reshape(-1, 3)
    stamps, keys = table[:, :2], table[:, 2].astype(bool)
    if len(keys):
        keys[0] = True
    ticks = stamps[:, 1]
    known = len(ticks) > 0 and not (ticks == UNKNOWN).any() and len(np.unique(ticks)) == len(ticks)
    # AVI gives the order of storing as if it were the time of showing.
    reordered = bool(stream.codec_context.has_b_frames)
    believable = known and not (container.format.name == "avi" and reordered)
    order = np.argsort(ticks, kind="stable") if believable else np.arange(len(ticks))
    shown = np.empty(len(ticks), np.int64)
    shown[order] = np.arange(len(ticks))
    return FilmIndex(stamps, keys, shown, reordered and not believable, damaged)


def declared_size(path: Path) -> int:
    """Return how many bytes the headers of an AVI, MP4, MOV or MKV file say that it has, else 0.

    Only the sizes of the outermost pieces are looked at (RIFF chunk, ISO 14496-12 box, EBML
    segment); a file that is shorter was cut.
    """
    with path.open("rb") as file:
        start = file.read(64)
        if start[:4] == b"RIFF":
            return 8 + int.from_bytes(start[4:8], "little")
        if start[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
            return boxes_end(file, path.stat().st_size)
        if start[:4] == b"\x1a\x45\xdf\xa3":
            return segment_end(start)
    return 0


def boxes_end(file: Any, size: int) -> int:
    """Return where the last outermost box of an MP4 file ends."""
    place = 0
    for _ in range(MOST_BOXES):
        file.seek(place)
        head = file.read(16)
        if place >= size or len(head) < 8:
            break
        (length,) = struct.unpack(">I", head[:4])
        if length == 1 and len(head) == 16:
            (length,) = struct.unpack(">Q", head[8:])
        if length < 8:  # 0: up to the end of the file
            return size
        place += length
    return int(place)


def segment_end(start: bytes) -> int:
    """Return where the segment of an MKV file ends, 0 if the file doesn't say it."""
    place, header = sized(start, 4)
    if header is None or start[place + header : place + header + 4] != b"\x18\x53\x80\x67":
        return 0
    begin, length = sized(start, place + header + 4)
    return 0 if length is None else begin + length


def sized(start: bytes, place: int) -> tuple[int, int | None]:
    """Return where a piece of an EBML file begins whose size stands here, and that size."""
    if place >= len(start) or start[place] == 0:
        return place, None
    width = 9 - start[place].bit_length()
    number = int.from_bytes(start[place : place + width], "big") & ((1 << 7 * width) - 1)
    unknown = number == (1 << 7 * width) - 1
    return place + width, None if unknown else number
