"""Camera films: AVI, MP4, MOV and MKV, read with PyAV (FFmpeg), each frame by its number."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.film_index import FilmIndex, declared_size, index_of
from napari_phase4d.io.lazy import FrameReader, WrongFrameError, in_one_line, lazy_frames
from napari_phase4d.io.video import Video, colour_sentence

__all__ = ["FILM_SUFFIXES", "read_film"]

FILM_SUFFIXES = (".avi", ".mp4", ".mkv", ".mov", ".m4v")
#: Of what FFmpeg knows: a list of other files that is called .mp4 is not followed.
FILMS_ONLY = {"format_whitelist": "avi,mov,matroska,webm", "protocol_whitelist": "file"}
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
        with av.open(str(path), options=FILMS_ONLY) as container:
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
            self._container = av.open(str(self.path), options=FILMS_ONLY)
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


CONTAINERS = {"avi": "AVI", "matroska": "MKV"}
CODECS = {
    "rawvideo": "uncompressed", "ffv1": "FFV1", "h264": "H.264", "hevc": "H.265",
    "mjpeg": "Motion JPEG", "mpeg4": "MPEG-4", "huffyuv": "HuffYUV", "png": "PNG",
}  # fmt: skip


def notes_of(index: FilmIndex, told: int, *, lossy: bool, tinted: bool) -> Iterator[str]:
    """Yield what the user should know of a film."""
    if lossy:
        yield "The film is compressed with loss, which changes fringes and so the phase."
    if tinted:
        yield "The film is in colour; its brightness is used."
    if told and told != index.n_frames:
        yield f"The header tells of {told} frames, but the film has {index.n_frames}."
    if index.by_counting:
        yield "The file doesn't say in which order frames are shown; going back in it is slow."


def timing(
    index: FilmIndex, tick: float, rate: float
) -> tuple[float | None, NDArray[np.float64] | None]:
    """Return the interval of evenly spaced frames, or else the times of all."""
    ticks = index.times()
    if ticks is None or index.n_frames < 2:
        return (1 / rate if rate > 0 else None), None
    times = ticks * tick
    mean = float(times[-1] / (len(times) - 1))
    even = np.abs(times - mean * np.arange(len(times))).max() <= 1.01 * tick
    if not even:
        return None, np.asarray(times, np.float64)
    # Ticks are coarse (milliseconds in MKV); the rate is exact where it means the same.
    agrees = rate > 0 and abs(times[-1] - (len(times) - 1) / rate) <= 1.01 * tick
    return (1 / rate if agrees else mean), None


def gaps_in(times: NDArray[np.float64], tick: float) -> Iterator[str]:
    """Yield a note if frames seem to be missing: even steps, but for a few that are multiples."""
    steps = np.diff(times)
    usual = float(np.median(steps))
    missing = np.round(steps / usual) - 1
    even = np.abs(steps - (missing + 1) * usual) <= 2.01 * tick
    if even.all() and 0 < (missing > 0).mean() < 0.1:
        place = int(np.argmax(missing > 0))
        yield (
            f"{int(missing.sum())} frames seem to be missing, the first behind frame {place}; "
            "the times are as the film gives them."
        )


def kind_of(path: Path, container: Any, stream: Any) -> str:
    """Return what a film is, in words."""
    codec = stream.codec_context.name
    outer = CONTAINERS.get(container.format.name.split(",")[0], path.suffix[1:].upper())
    return f"{CODECS.get(codec, codec)} in {outer}"


#: Codecs that keep every value.
LOSSLESS = {
    "rawvideo", "ffv1", "huffyuv", "ffvhuff", "utvideo", "png", "v210", "v410", "r210", "tiff",
    "magicyuv", "qtrle", "msrle", "bmp", "targa", "lagarith", "zlib", "rawvid", "gif",
    "bitpacked",
}  # fmt: skip
#: Where brightness stands in formats that mix it with colour: first byte, step.
MIXED = {"yuyv422": (0, 2), "yvyu422": (0, 2), "uyvy422": (1, 2)}
#: Colour difference, in units of 1 / 255, that a grey film may have after compression.
FAINT = 6


def grey_values(picture: Any) -> NDArray[Any] | None:
    """Return the grey values of a decoded frame (y, x), None if it is in colour.

    Brightness comes as it is stored, without stretching its range. Pictures with a palette are for
    `through_palette`.
    """
    name = picture.format.name
    if name in MIXED:
        first, step = MIXED[name]
        return plane(picture, 0, 2 * picture.width)[:, first::step].copy()
    if picture.format.is_rgb:
        return equal_channels(picture)
    if name.startswith("bayer"):
        return None
    if name.startswith("mono"):
        return plane_of(picture.reformat(format="gray"))
    return plane_of(picture)


def plane_of(picture: Any) -> NDArray[Any]:
    """Return the first plane: grey, or the brightness of YUV."""
    bits = picture.format.components[0].bits
    kind: np.dtype[Any] = np.dtype(np.uint8 if bits <= 8 else np.uint16)
    if is_float(picture):
        kind = np.dtype(np.float32)
    if picture.format.is_big_endian:
        kind = kind.newbyteorder(">")
    values = plane(picture, 0, picture.width * kind.itemsize).view(kind)
    return values.astype(kind.newbyteorder("="))


def is_float(picture: Any) -> bool:
    """Say whether grey values are floating-point numbers."""
    return str(picture.format.name).startswith("grayf32")


def plane(picture: Any, number: int, width: int) -> NDArray[np.uint8]:
    """Return the bytes of a plane without the padding of its lines, the upper line first."""
    part = picture.planes[number]
    lines = np.frombuffer(part, np.uint8).reshape(-1, abs(part.line_size))[: part.height]
    if part.line_size < 0:  # from the bottom up, as uncompressed films of Windows are stored
        if lines.ctypes.data == part.buffer_ptr and part.height > 1:
            # The upper line lies last, but older PyAV takes it for the first one and reads on.
            msg = 'it is stored from the bottom up; to read it, pip install --upgrade "av"'
            raise ValueError(msg)
        lines = lines[::-1]
    return np.ascontiguousarray(lines[:, :width])


def palette_of(picture: Any) -> NDArray[np.uint8]:
    """Return the colours that the numbers of a picture stand for, shape (256, 4)."""
    return np.frombuffer(picture.planes[1], np.uint8)[:1024].reshape(256, 4).copy()


def through_palette(picture: Any, palette: NDArray[np.uint8]) -> NDArray[Any] | None:
    """Return the grey values that the numbers of a picture stand for, None if any is a colour."""
    numbers = plane(picture, 0, picture.width)
    used = palette[np.unique(numbers)]
    if (used[:, 0] != used[:, 1]).any() or (used[:, 1] != used[:, 2]).any():
        return None
    return np.asarray(palette[:, 0][numbers])


def equal_channels(picture: Any) -> NDArray[Any] | None:
    """Return one channel of red, green and blue if they are equal, else None."""
    deep = picture.format.components[0].bits > 8
    image = picture.to_ndarray(format="rgb48le" if deep else "rgb24")
    first = image[..., 0]
    if (image[..., 1] == first).all() and (image[..., 2] == first).all():
        return np.ascontiguousarray(first)
    return None


def is_tinted(picture: Any) -> bool:
    """Say whether a YUV frame has colour."""
    form = picture.format
    if form.is_rgb or len(picture.planes) < 2 or form.name == "pal8":
        return False
    bits = form.components[1].bits
    kind = np.dtype(np.uint8 if bits <= 8 else np.uint16)
    if form.is_big_endian:
        kind = kind.newbyteorder(">")
    middle, faint = 2 ** (bits - 1), FAINT * 2 ** (bits - 8)
    for number in range(1, len(picture.planes)):
        width = picture.planes[number].width * kind.itemsize
        values = plane(picture, number, width).view(kind)[::2, ::2].astype(np.int32)
        if np.abs(values - middle).mean() > faint:
            return True
    return False


def is_lossy(codec: Any) -> bool:
    """Say whether a codec may change values."""
    return codec.name not in LOSSLESS
