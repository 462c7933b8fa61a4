"""Which pages of a TIFF are the frames of a recording, and how they are read."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import FrameReader, WrongFrameError, lazy_frames
from napari_phase4d.io.video import colour_sentence, grey, quiet
from napari_phase4d.later import tifffile
from napari_phase4d.words import counted

__all__ = [
    "frames_among_others",
    "layout_of",
    "lost_among",
    "main_series",
    "paged_frames",
    "pages_left_out",
]

#: How many frames there must be among pages of other kinds, and how large a share of them these
#: may be in between, to be taken for frames that are lost.
LEAST_AMONG, MOST_LOST = 3, 0.25
#: Pages that are named one by one.
NAMED = 6


def layout_of(tif: tifffile.TiffFile, mixed: Sequence[Any]) -> tuple[str, tuple[int, ...], bool]:
    """Return axes and shape of the frames, and whether each is a series of its own."""
    series = main_series(tif, mixed)
    single = single_frames(tif)
    if single:
        return f"T{series.axes}", (len(single), *series.shape), True
    if mixed:
        return "TYX", (len(mixed), *mixed[0].shape), True
    added = added_frames(tif)
    n_times = (len(added),) if added else series.shape[:1]
    return series.axes, tuple(int(n) for n in (*n_times, *series.shape[1:])), False


def main_series(tif: tifffile.TiffFile, mixed: Sequence[Any]) -> Any:
    """Return the series of a file that holds its frames, or the first of them."""
    starts = {page.offset for page in mixed if page is not None}
    found = (s for s in tif.series if any(page.offset in starts for page in s.pages))
    return next(found, tif.series[0])


def pages_left_out(tif: tifffile.TiffFile, mixed: Sequence[Any]) -> tuple[str, ...]:
    """Say that a file has pages besides those that are read: of another kind, or added later."""
    if mixed:
        return left_out_among(mixed, [page.offset for page in tif.pages])
    used, further = len(tif.series[0].pages), sum(len(s.pages) for s in tif.series[1:])
    if not further or single_frames(tif) or added_frames(tif):
        return ()
    return (
        f"Of {used + further} pages {used} are read; the others are of another kind, or "
        "were added later. Write them as one stack if they belong to it.",
    )


def lost_among(mixed: Sequence[Any], place: int | slice) -> tuple[int, ...]:
    """Return which of the chosen frames are lost, see `frames_among_others`."""
    if not mixed:
        return ()
    chosen = mixed[place] if isinstance(place, slice) else [mixed[place]]
    return tuple(i for i, page in enumerate(chosen) if page is None)


def left_out_among(frames: Sequence[Any], offsets: Sequence[int]) -> tuple[str, ...]:
    """Say which pages among those at some offsets are no frames."""
    first = offsets.index(frames[0].offset)
    lost = [first + i + 1 for i, page in enumerate(frames) if page is None]
    further, notes = len(offsets) - len(frames), []
    if lost:
        are, frames_are = (
            ("is", "a frame that is") if len(lost) == 1 else ("are", "frames that are")
        )
        more = " ..." if len(lost) > NAMED else ""
        named = ", ".join(map(str, lost[:NAMED])) + more
        notes.append(
            f"Of {len(offsets)} pages {len(lost)} {are} of another size or kind than the others "
            f"({named}), and {are} taken for {frames_are} lost."
        )
    if further:
        are = "is" if further == 1 else "are"
        notes.append(
            f"{counted(further, 'page')} before or behind the frames {are} of another size or "
            f"kind, and {are} left out."
        )
    return tuple(notes)


def frames_among_others(tif: tifffile.TiffFile) -> list[Any]:
    """Return the frames of a file some pages of which are no frames, else none.

    The frames are pages that have the most frequent size and kind. Others that lie between these
    are None, as frames that are lost: what comes later keeps its time. A camera's program writes
    such pages where its settings are changed meanwhile, or to show the field.
    """
    if tif.is_ome or tif.is_imagej or (len(tif.series) < 2 and not is_uneven(tif)):
        return []
    if single_frames(tif) or added_frames(tif):
        return []
    pages = [described(tif, page) for page in tif.pages]
    kinds = [(page.shape, page.dtype) for page in pages]
    usual, n_usual = Counter(kinds).most_common(1)[0]
    if n_usual == len(kinds):
        return []
    places = [i for i, kind in enumerate(kinds) if kind == usual]
    frames = [pages[i] if kinds[i] == usual else None for i in range(places[0], places[-1] + 1)]
    n_lost = len(frames) - n_usual
    if n_usual < LEAST_AMONG or len(usual[0]) != 2 or n_lost > MOST_LOST * n_usual:
        return []
    of_frames = [s for s in tif.series if (s.keyframe.shape, s.keyframe.dtype) == usual]
    whole = n_lost == 0 and len(of_frames) == 1 and of_frames[0] is tif.series[0]
    return [] if whole or 2 * n_usual <= len(pages) or not follow(of_frames) else frames


def follow(series: Sequence[Any]) -> bool:
    """Say whether series are one video: frames that are written one by one, or added to a stack.

    One picture before a stack may be a reference, and of series with further axes nobody knows
    what they are to each other.
    """
    n_axes = [len(each.shape) for each in series]
    return max(n_axes) == 2 or (n_axes[0] == 3 and max(n_axes) == 3)


def is_uneven(tif: tifffile.TiffFile) -> bool:
    """Say whether some pages of a series have more bytes than others though none is compressed.

    tifffile takes pages for alike once it has compared a few of them.
    """
    if tif.is_shaped or tif.series[0].keyframe.compression != 1:
        return False
    return len({sum(page.databytecounts) for page in tif.pages}) > 1


def described(tif: tifffile.TiffFile, page: Any) -> Any:
    """Return a page with its own size and kind, where it was taken for one like the first."""
    if isinstance(page, tifffile.TiffPage):
        return page
    tif.filehandle.seek(page.offset)
    return tifffile.TiffPage(tif, index=page.index)


def single_frames(tif: tifffile.TiffFile) -> list[Any]:
    """Return the pages of a file whose frames were written one by one, else none.

    Such a file describes every frame as a series of its own.
    """
    if tif.is_ome or tif.is_imagej or len(tif.series) < 2:
        return []
    kinds = {(series.shape, series.dtype, len(series.levels)) for series in tif.series}
    if len(kinds) > 1 or any(len(series.pages) != 1 for series in tif.series):
        return []
    return [series.pages[0] for series in tif.series]


def added_frames(tif: tifffile.TiffFile) -> list[Any]:
    """Return the pages of a video to which frames of the same kind were added later, else none.

    Each addition describes itself as a series. OME-TIFF and ImageJ say how many series there are.
    """
    first = tif.series[0]
    if tif.is_ome or tif.is_imagej or len(tif.series) < 2 or len(first.shape) != 3:
        return []
    kinds = {(series.shape[-2:], series.dtype, len(series.levels)) for series in tif.series}
    if len(kinds) > 1 or any(s.axes[-2:] != "YX" or len(s.shape) > 3 for s in tif.series):
        return []
    return [page for series in tif.series for page in series.pages]


def paged_frames(
    path: Path,
    shape: tuple[int, ...],
    places: tuple[int | slice, ...],
    dtype: np.dtype[Any],
    *,
    colour: bool,
    mixed: bool = False,
) -> Any:
    """Return the chosen pages of a file as a dask array with one page a chunk."""
    n_picture = 3 if colour else 2
    leading = shape[:-n_picture]
    with quiet():
        pages = TiffPages(path, shape[-n_picture:], dtype, mixed=mixed)
    numbers = np.arange(int(np.prod(leading, dtype=np.int64))).reshape(leading)
    numbers = np.asarray(numbers[places[: len(leading)]])
    reader = pages.taking(numbers.ravel())
    frames = lazy_frames(reader)
    return frames if numbers.ndim == 1 else frames.reshape(*numbers.shape, *reader.shape[1:])


class TiffPages(FrameReader):
    """Reads single pages; the file stays open, so that its directory is parsed once.

    Parameters
    ----------
    path : Path
        The file.
    picture : tuple of int
        Shape of a page, its last axis colour if there are three.
    dtype : dtype
        Of the pixels.
    numbers : ndarray of int, optional
        The page that holds each frame.
    mixed : bool, optional
        Whether pages that are no frames lie between them, see `frames_among_others`.

    Raises
    ------
    ValueError
        If the first page is in colour.
    """

    arguments = ("path", "picture", "dtype", "numbers", "mixed")

    def __init__(
        self,
        path: Path,
        picture: tuple[int, ...],
        dtype: np.dtype[Any],
        numbers: NDArray[np.int64] | None = None,
        mixed: bool = False,
    ) -> None:
        self.picture, self.mixed = picture, mixed
        self.numbers = np.arange(1) if numbers is None else numbers
        super().__init__(path, (len(self.numbers), picture[0], picture[1]), dtype)
        self._lock = threading.RLock()
        self._file: tifffile.TiffFile | None = None
        self._series: Any = None

    def taking(self, numbers: NDArray[np.int64]) -> TiffPages:
        """Return a reader of these pages."""
        reader = TiffPages(self.path, self.picture, self.dtype, numbers, self.mixed)
        if len(self.picture) == 3:
            reader.frame(0)
        return reader

    def read(self, index: int) -> NDArray[Any]:
        """Return one page."""
        with quiet():
            with self._lock:
                page = self._pages()[int(self.numbers[index])]
            if page is None and self.mixed:
                return np.zeros(self.shape[1:], self.dtype)
            if page is None:
                msg = "the file does not hold it"
                raise ValueError(msg)
            image = grey(self._decoded(page))
        if image.ndim > 2:
            raise WrongFrameError(colour_sentence(self.path.name))
        return image.reshape(self.shape[1:])

    def _decoded(self, page: Any) -> NDArray[Any]:
        """Return the pixels of a page, of which another file of a series may hold it."""
        handle = page.parent.filehandle
        if page.parent is self._file:
            # The lock guards the file alone, so that several threads can decode.
            return np.asarray(page.asarray(lock=self._lock))
        with self._lock:
            handle.open()
            try:
                return np.asarray(page.asarray())
            finally:
                handle.close()

    def _pages(self) -> Any:
        """Return the pages of the open file."""
        if self._file is None:
            self._file = tifffile.TiffFile(self.path)
            self._series = (
                (frames_among_others(self._file) if self.mixed else [])
                or single_frames(self._file)
                or added_frames(self._file)
                or self._file.series[0]
            )
        return self._series

    def __del__(self) -> None:
        if getattr(self, "_file", None) is not None:
            self._file.close()  # type: ignore[union-attr]
