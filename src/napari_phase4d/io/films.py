"""Camera films: AVI, MP4, MOV and MKV, read with PyAV (FFmpeg), each frame by its number."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.film_facts import gaps_in, kind_of, notes_of, timing
from napari_phase4d.io.film_index import FilmIndex, declared_size, index_of
from napari_phase4d.io.film_pixels import (
    grey_values,
    is_lossy,
    is_tinted,
    palette_of,
    through_palette,
)
from napari_phase4d.io.grey import colour_sentence
from napari_phase4d.io.lazy import FrameReader, WrongFrameError, in_one_line, lazy_frames
from napari_phase4d.io.video import Video

__all__ = ["FILM_SUFFIXES", "read_film"]

FILM_SUFFIXES = (".avi", ".mp4", ".mkv", ".mov", ".m4v")
#: Decoded frames kept, since threads ask for neighbours in nearly the right order.
KEPT = 8
#: Frames decoded and thrown away rather than to search the file anew.
PATIENCE = 32


def read_film(path: Path) -> Video:
    """Open a film lazily, with exact access to each frame.

    An index of all frames is made once without decoding; a frame is decoded from the key frame
    before it. Grey and YUV films give their brightness values as they are.

    Parameters
    ----------
    path : Path
        An AVI, MP4, MOV or MKV file with one grey value a pixel.

    Raises
    ------
    OSError
        If the package ``av`` is missing, or the file is damaged, cut short or no film.
    ValueError
        If it is in colour.
    """
    av = imported(path)
    size = path.stat().st_size
    needed = declared_size(path)
    if needed > size:
        msg = f"{path.name} is cut short: its header tells of {needed} bytes, the file has {size}"
        raise OSError(msg)
    try:
        with av.open(str(path)) as container:
            stream = film_stream(container)
            index = index_of(container, stream, size)
            told = stream.frames
            rate = float(stream.average_rate or stream.guessed_rate or 0)
            tick = float(stream.time_base or 0)
            kind = kind_of(path, container, stream)
            lossy = is_lossy(stream.codec_context)
    except Exception as error:
        # FFmpeg's errors have many classes, and PyAV's own for odd files are no fewer.
        msg = (
            f"{path.name} can't be read as a film; it may be cut short or damaged "
            f"({in_one_line(error)})"
        )
        raise OSError(msg) from error
    if index.n_frames == 0:
        msg = f"{path.name} holds no frames; the recording may not have been finished"
        raise OSError(msg)
    if index.damaged is not None:
        msg = f"{path.name} is cut short or damaged: frame {index.damaged} is only partly there"
        raise OSError(msg)
    reader, tinted = opened_reader(path, index)
    notes = list(notes_of(index, told, lossy=lossy, tinted=tinted))
    interval, times = timing(index, tick, rate)
    if times is not None:
        notes += gaps_in(times, tick)
    return Video(
        lazy_frames(reader), interval_s=interval, times_s=times, kind=kind, notes=tuple(notes)
    )


class FilmReader(FrameReader):
    """Decodes frames by their number; threads take turns, as a film has one place at a time.

    Parameters
    ----------
    path : Path
        The film; every process opens it for itself.
    index : FilmIndex
        Where each frame lies.
    shape, dtype
        Of the recording.
    """

    arguments = ("path", "index", "shape", "dtype")

    def __init__(
        self,
        path: Path,
        index: FilmIndex,
        shape: tuple[int, int, int] = (0, 0, 0),
        dtype: np.dtype[Any] = np.dtype(np.uint8),  # noqa: B008 - a constant
    ) -> None:
        super().__init__(path, shape, dtype)
        self.index = index
        self._lock = threading.Lock()
        self._container: Any = None
        self._running: Iterator[tuple[int, Any]] = iter(())
        self._next = -1
        self._palette: NDArray[np.uint8] | None = None
        self._kept: OrderedDict[int, Any] = OrderedDict()

    def read(self, index: int) -> NDArray[Any]:
        """Return one frame as its grey values."""
        with self._lock:  # the conversion of one picture by two threads at once never ends
            grey = self._grey(self._picture(index))
        if grey is None:
            raise WrongFrameError(colour_sentence(f"frame {index} of {self.path.name}"))
        return grey

    def _grey(self, picture: Any) -> NDArray[Any] | None:
        """Return grey values; some containers give the palette with the first frame only."""
        if picture.format.name != "pal8":
            return grey_values(picture)
        if self._palette is None:
            self._palette = palette_of(self._picture(0))
        return through_palette(picture, self._palette)

    def is_tinted(self) -> bool:
        """Say whether the first frame has colour beside its brightness."""
        with self._lock:
            return is_tinted(self._picture(0))

    def _picture(self, index: int) -> Any:
        """Return one frame as FFmpeg decodes it."""
        if index not in self._kept:
            try:
                self._decode_up_to(index)
            except Exception:
                self.close()
                raise
        return self._kept[index]

    def close(self) -> None:
        """Close the file; the next frame opens it again."""
        if self._container is not None:
            self._container.close()
        self._container, self._running, self._next = None, iter(()), -1

    def _decode_up_to(self, index: int) -> None:
        """Decode on to a frame if it is near ahead, else from the key frame before it."""
        start = self.index.start_for(index)
        near = index <= self._next + PATIENCE or start == self._place()
        if not (0 <= self._next <= index and near):
            self._search(start)
        for number, picture in self._running:
            self._next = number + 1
            self._kept[number] = picture
            self._kept.move_to_end(number)
            if len(self._kept) > KEPT:
                self._kept.popitem(last=False)
            if number == index and not picture.is_corrupt:
                return
            if number >= index and not self.index.by_counting:
                break
        msg = "it can't be decoded"
        raise ValueError(msg)

    def _place(self) -> int:
        """Return the key packet from which the next frame comes, -1 if it lies behind."""
        behind = self._next >= self.index.n_frames
        return -1 if behind else self.index.start_for(self._next)

    def _search(self, start: int) -> None:
        """Go to a packet, and check that it is that one; else begin at the first."""
        for begin in dict.fromkeys((start, 0)):
            packets = self._packets_from(begin)
            if packets is not None:
                self._running = self._pictures(packets)
                return
        msg = "its place can't be found again"
        raise ValueError(msg)

    def _packets_from(self, start: int) -> Iterator[tuple[int, Any]] | None:
        """Return numbered packets from one on, None if the file doesn't lead there."""
        stream = self._reopened() if start == 0 else self._opened()
        if start > 0:
            ticks = next(int(t) for t in self.index.stamps[start] if t > -(2**63))
            self._container.seek(ticks, stream=stream)
        packets = (p for p in self._container.demux(stream) if p.size or p.dts is None)
        first = next(packets, None)
        number = None if first is None else self._number_of(first, start)
        if number is None or first is None:
            return None

        def numbered() -> Iterator[tuple[int, Any]]:
            place, packet = number, first
            while packet is not None:
                if place >= start:
                    yield place, packet
                place, packet = place + 1, next(packets, None)

        return numbered()

    def _number_of(self, packet: Any, start: int) -> int | None:
        """Return which packet was found after a search, None if it lies behind ``start``."""
        if start == 0:
            return 0
        stamps = self.index.stamps
        found = np.ones(len(stamps), bool)
        for column, tick in enumerate((packet.dts, packet.pts)):
            if tick is not None:
                found &= stamps[:, column] == tick
        places = np.flatnonzero(found)
        return int(places[0]) if len(places) == 1 and places[0] <= start else None

    def _pictures(self, packets: Iterator[tuple[int, Any]]) -> Iterator[tuple[int, Any]]:
        """Decode packets; yield each frame with its number."""
        stream = film_stream(self._container)
        index, count = self.index, 0
        for place, packet in packets:
            if place < index.n_frames and packet.size:
                # The decoder hands the time through, so it may carry the frame's number.
                packet.pts = int(index.shown[place])
            for picture in stream.codec_context.decode(packet if packet.size else None):
                yield (count if index.by_counting else picture.pts), picture
                count += 1

    def _opened(self) -> Any:
        """Return the stream of the open file."""
        import av

        if self._container is None:
            self._container = av.open(str(self.path))
            film_stream(self._container).thread_type = "AUTO"
        return film_stream(self._container)

    def _reopened(self) -> Any:
        """Return the stream of the file opened anew."""
        self.close()
        return self._opened()


def opened_reader(path: Path, index: FilmIndex) -> tuple[FilmReader, bool]:
    """Return a reader whose first frame was decoded, and whether that one has colour."""
    reader = FilmReader(path, index)
    try:
        first, tinted = reader.read(0), reader.is_tinted()
    except WrongFrameError as error:
        raise ValueError(colour_sentence(path.name)) from error
    except Exception as error:
        msg = (
            f"{path.name} can't be read as a film; its first frame can't be decoded "
            f"({in_one_line(error)})"
        )
        raise OSError(msg) from error
    height, width = first.shape
    reader.shape, reader.dtype = (index.n_frames, height, width), first.dtype
    return reader, tinted


def film_stream(container: Any) -> Any:
    """Return the first stream of pictures that FFmpeg can decode."""
    known = [s for s in container.streams.video if s.codec_context is not None]
    if not known:
        msg = "it holds no film that can be decoded"
        raise ValueError(msg)
    return known[0]


def imported(path: Path) -> Any:
    """Return PyAV, or say how to get it."""
    try:
        import av
    except ImportError as error:
        msg = f'{path.name} is a film; to read it, pip install "napari-phase4d[video]"'
        raise OSError(msg) from error
    return av
