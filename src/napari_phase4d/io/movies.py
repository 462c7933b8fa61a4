"""Figures and movies to files: GIF, and MP4 where the package ``av`` is installed."""

from __future__ import annotations

import importlib.util
import io
import operator
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.atomic import written_whole
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.words import checked_call, local_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

__all__ = ["check_figure", "write_figure", "write_movie"]

#: Flat colours come back within 4 of 255, about what video's 8 bits of brightness and colour
#: difference can hold. Without latency each frame is in the file before the next is asked for, so
#: that nothing is left to be done, and to be waited for, at the end.
QUALITY = {"crf": "16", "tune": "zerolatency"}
#: Number of ITU-R BT.709 in the standard H.273. Players take it for granted in large pictures;
#: with another one, or none noted, colours come out up to a tenth of the range off.
BT709 = 1
#: Number of the brightness range 16 to 235, which all players know.
VIDEO_RANGE = 1
#: Frames per second; browsers slow down a GIF that is faster.
FASTEST = MappingProxyType({".gif": 50, ".mp4": 240})

Frame = NDArray[np.uint8]


@checked_call
def write_movie(
    path: str | Path,
    frames: Iterable[Frame],
    frames_a_second: float = 4.0,
    *,
    n_frames: int | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Path:
    """Write frames as a movie: an animated GIF that starts again when it ends, or an MP4.

    Frames are taken one by one. An MP4 keeps none of them in memory, a GIF a byte for each pixel.

    Parameters
    ----------
    path : str or Path
        File to write; its ending, ``.gif`` or ``.mp4``, says which. MP4 (H.264) needs the package
        ``av``. A GIF has 256 colours a frame, counts time in hundredths of a second, and joins
        frames that are alike.
    frames : iterable of ndarray of uint8, shape (height, width, 3)
        Red, green and blue; all of one size. For MP4 an odd last row or column is doubled.
    frames_a_second : float, optional
        How fast it plays, above 0 and at most 50 for GIF or 240 for MP4, default 4.
    n_frames : int, optional
        How many frames there will be, for ``progress``; default: what ``frames`` can tell.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each frame; ``cancelled()`` stops the work.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    ValueError
        If the ending is another one, ``av`` is missing, the number of frames per second is out of
        range, there are no frames, or they are no pictures of one size.
    Cancelled
        If ``cancelled()`` returned True; an older file of that name is then left as it was.
    """
    task = Task(progress, cancelled)
    path = local_path(path)
    write = writer_for(path)
    fastest = FASTEST[path.suffix.lower()]
    if not 0 < frames_a_second <= fastest:
        msg = (
            f"{path.suffix} plays more than 0 and at most {fastest} frames per second, "
            f"but frames_a_second is {frames_a_second!r}"
        )
        raise ValueError(msg)
    total = operator.length_hint(frames) if n_frames is None else n_frames
    watch = Watch(total, "writing the movie", task)
    watch.check()
    pictures = iter(frames)
    first = next(pictures, None)
    if first is None:
        msg = f"there are no frames to write to {path.name}"
        raise ValueError(msg)
    with written_whole(path) as temporary:
        write(temporary, alike(chain([first], pictures)), frames_a_second, watch)
    return path


def alike(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Yield frames of a movie as long as they are pictures in colour, of the same size."""
    size = None
    for number, frame in enumerate(frames):
        picture = np.asarray(frame)
        if picture.ndim == 3 and picture.shape[2] == 4:  # opacity, which a movie does not show
            picture = picture[..., :3]
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            msg = (
                "frames of a movie must be uint8 of shape (height, width, 3), but frame "
                f"{number} is {picture.dtype} of shape {picture.shape}"
            )
            raise ValueError(msg)
        size = size or picture.shape
        if picture.shape != size:
            msg = (
                f"frames of a movie must be of one size, but frame {number} has "
                f"{picture.shape[1]} x {picture.shape[0]} pixels, and the first "
                f"{size[1]} x {size[0]}"
            )
            raise ValueError(msg)
        yield picture


def writer_for(path: Path) -> Callable[[Path, Iterator[Frame], float, Watch], None]:
    """Return what writes the kind of movie that a file's ending names."""
    write = WRITERS.get(path.suffix.lower())
    if write is None:
        msg = f"a movie is written as .gif or .mp4, but the name is {path.name}"
        raise ValueError(msg)
    if write is write_mp4 and importlib.util.find_spec("av") is None:
        msg = (
            'writing .mp4 needs the package av; install it with pip install "napari-phase4d'
            '[video]", or choose a name that ends in .gif'
        )
        raise ValueError(msg)
    return write


def write_gif(path: Path, frames: Iterator[Frame], rate: float, watch: Watch) -> None:
    """Write an animated GIF."""
    from PIL import Image

    def images() -> Iterator[Image.Image]:
        for frame in frames:
            yield Image.fromarray(frame)
            watch.step()

    every = images()
    with WatchedFile(path, watch) as file:
        # All frames are compressed at the end, which may take longer than drawing them did.
        next(every).save(
            file,
            format="GIF",
            save_all=True,
            append_images=every,
            duration=Durations(rate),
            loop=0,
        )


class Durations(list[int]):
    """How many milliseconds each frame of a GIF stays: whole hundredths of a second, as it needs.

    Some are one longer than others, so that all together they take as long as is asked for.
    Pillow takes a list, and asks it for each frame; how many there will be is not known.

    Parameters
    ----------
    rate : float
        Frames a second.
    """

    def __init__(self, rate: float) -> None:
        super().__init__()
        self._rate = rate

    def __getitem__(self, number: Any) -> Any:
        """Return how long one frame stays."""
        start, end = (round(100 * n / self._rate) for n in (number, number + 1))
        return 10 * (end - start)


class WatchedFile(io.BufferedWriter):
    """A file that is written to only as long as the work goes on.

    Parameters
    ----------
    path : Path
        Where the bytes go.
    watch : Watch
        Asked before each piece.
    """

    def __init__(self, path: Path, watch: Watch) -> None:
        super().__init__(io.FileIO(path, "w"))
        self._watch = watch

    def write(self, data: Any, /) -> int:
        """Write some bytes, or raise `Cancelled`."""
        self._watch.check()
        return super().write(data)


def write_mp4(path: Path, frames: Iterator[Frame], rate: float, watch: Watch) -> None:
    """Write an MP4 with H.264 in the form that every player knows."""
    import av

    if "libx264" not in av.codecs_available:
        msg = "this build of the package av can't write H.264; choose a name that ends in .gif"
        raise ValueError(msg)
    first = of_even_size(next(frames))
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream(
            "libx264", rate=Fraction(rate).limit_denominator(10_000), options=QUALITY
        )
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        coding = stream.codec_context
        coding.colorspace = coding.color_primaries = coding.color_trc = BT709
        coding.color_range = VIDEO_RANGE
        for frame in chain([first], map(of_even_size, frames)):
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24").reformat(
                format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
            )
            container.mux(stream.encode(picture))
            watch.step()
        container.mux(stream.encode())


def of_even_size(frame: Frame) -> Frame:
    """Return a frame with an even number of rows and columns, as H.264 needs it."""
    height, width = frame.shape[:2]
    if height % 2 == width % 2 == 0:
        return np.ascontiguousarray(frame)
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


WRITERS = MappingProxyType({".gif": write_gif, ".mp4": write_mp4})


DOTS_PER_INCH = 150
ENDINGS = (".png", ".svg", ".pdf")


def check_figure(path: str | Path) -> Path:
    """Return where a figure is to be written; ValueError if its ending says no picture."""
    path = local_path(path)
    if path.suffix.lower() not in ENDINGS:
        msg = f"{path.name} can't be written as a figure; use one of {', '.join(ENDINGS)}"
        raise ValueError(msg)
    return path


@checked_call
def write_figure(path: str | Path, figure: Figure) -> Path:
    """Write a figure; the ending, .png, .svg or .pdf, says as what.

    Parameters
    ----------
    path : str or Path
        File to write; an older one of that name is replaced.
    figure : matplotlib.figure.Figure
        What is drawn with matplotlib; a .png gets 150 dots per inch.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    OSError
        If it can't be written; an older file of that name is then left as it was.
    ValueError
        If the ending is another one.
    """
    path = check_figure(path)
    import matplotlib as mpl

    # Words of an SVG or a PDF stay words, which can be found and edited.
    words = {"svg.fonttype": "none", "pdf.fonttype": 42}
    with mpl.rc_context(words), written_whole(path) as temporary:
        figure.savefig(temporary, dpi=DOTS_PER_INCH)
    return path
