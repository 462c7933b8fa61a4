"""How a recording grows: by files in a folder, by pages of a TIFF, by the length of a Zarr."""

from __future__ import annotations

import os
import struct
import time
import zlib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.arriving import (
    AHEAD,
    UNFINISHED,
    Arrival,
    Arriving,
    Calm,
    NotYetError,
    State,
)
from napari_phase4d.io.folder_events import FolderEvents
from napari_phase4d.io.lazy import stamp_of
from napari_phase4d.io.sequences import (
    IMAGE_SUFFIXES,
    Numbering,
    in_order,
    load_image,
    of_usual_pattern,
    pattern_of,
    read_image,
)
from napari_phase4d.io.tiff import TIFF_SUFFIXES, check_complete, read_tiff
from napari_phase4d.io.video import Video, grey, quiet
from napari_phase4d.io.zarr_files import ZarrReader, is_zarr, read_zarr
from napari_phase4d.later import tifffile
from napari_phase4d.recording import reader_of

__all__ = ["arriving_at"]

#: Where the system tells what is new in a folder, all its names are looked at all the same: after
#: so many seconds, and as it takes a while in large folders, in so much of the time.
SCAN_S, SHARE_OF_SCANNING = 1.0, 0.01
#: In so many places of a page so many bytes are summed, to know it again.
SAMPLES, SAMPLED = 16, 4096


def arriving_at(
    path: Path, patience_s: float, dataset: str | None = None, *, whole: bool = False
) -> Arriving:
    """Return what gives out the frames that arrive in a folder, a TIFF or a Zarr store.

    Parameters
    ----------
    path : Path
        It need not be there yet: its name tells what it will be.
    patience_s : float
        See `Arriving`.
    dataset : str, optional
        Which array of a Zarr store that holds several.
    whole : bool, optional
        Whether it is a folder in which files get their names only when they are whole.

    Returns
    -------
    Arriving
        What gives out each frame once, in their order.

    Raises
    ------
    ValueError
        If frames of such a file can't be read before it is complete.
    """
    if whole:
        return FolderArriving(path, patience_s, settled_s=0.0)
    suffix = path.suffix.lower()
    if suffix == ".zarr" or (path.is_dir() and is_zarr(path)):
        return ZarrArriving(path, patience_s, dataset)
    if dataset is not None:
        msg = f"{path.name} has one array only; leave dataset out, which is {dataset!r}"
        raise ValueError(msg)
    if suffix in TIFF_SUFFIXES and not path.is_dir():
        return TiffArriving(path, patience_s)
    if path.is_file():
        msg = (
            f"frames of {path.name} can't be read while it is written; watch a folder of images, "
            f"a TIFF ({', '.join(TIFF_SUFFIXES)}) or a Zarr store, or run it when it is complete"
        )
        raise ValueError(msg)
    return FolderArriving(path, patience_s)


# ---- a folder --------------------------------------------------------------------------------


class FolderArriving(Arriving):
    """A folder into which one image a frame is written.

    Their numbers say the order, and which never came. What has another name is no frame. Where the
    system tells that a file was closed, it is whole; elsewhere it is once it has stayed as it is.
    """

    def __init__(self, path: Path, patience_s: float, settled_s: float | None = None) -> None:
        super().__init__(path, patience_s)
        self._calm = Calm(settled_s)
        self._names: set[str] = set()
        self._numbering: Numbering | None = None
        #: The file of each frame.
        self._files: dict[int, Path] = {}
        self._last = -1
        #: What the system tells, and whether that has been found to be all.
        self._events: FolderEvents | None = None
        self._told_all = False
        self._next_scan = 0.0

    def look(self) -> int:
        """Look which files are there."""
        names = self._new_names()
        new = self._in_order(n for n in names if self._may_be_frame(n))
        self._names |= names
        if self._numbering is None:
            waiting = [n for n in self._names if self._may_be_frame(n)]
            self._look_at(self.path / name for name in waiting[: 2 * AHEAD])
            usual = of_usual_pattern(waiting)
            return Numbering(usual).count(usual) if usual else 0
        for name in new:
            self._add(name)
        ahead = range(self.taken, self.taken + AHEAD)
        self._look_at(self._files[i] for i in ahead if i in self._files)
        return self._last + 1

    def take(self, at_most: int) -> list[Arrival]:
        """Return the next frames; what counts them is settled when the first are asked for."""
        if self._numbering is None and self.seen:
            names = of_usual_pattern([n for n in self._names if self._may_be_frame(n)])
            self._numbering = Numbering(names)
            if self._numbering.column is None and len(names) > 1:
                self.notes.append(
                    f"the names in {self.path.name} do not count the frames one by one: one that "
                    "never comes can't be noticed"
                )
            self._names -= {n for n in self._names if self._may_be_frame(n)}
            self.poll()
        return super().take(at_most)

    def read(self, index: int) -> NDArray[Any]:
        """Return a frame."""
        if index not in self._files:
            raise FileNotFoundError(self.label(index))
        path = self._files[index]
        if self._events is None or not self._events.is_whole(path.name):
            self._calm.check(path)
        frame = whole_image(path)
        self._calm.forget(path)
        if self._events is not None:
            self._events.forget(path.name)
        return frame

    def found_late(self, index: int) -> bool:
        """Look through the whole folder for a frame of which the system may not have told."""
        if index in self._files:
            return False
        self._told_all, self._next_scan = False, 0.0
        self.look()
        return index in self._files

    def wait(self, seconds: float) -> None:
        """Wait until something happens in the folder, at most so long."""
        if self._events is None:
            super().wait(seconds)
        else:
            self._events.wait(seconds)

    def close(self) -> None:
        """Let the system tell no more; what came can still be read."""
        if self._events is not None:
            self._events.close()
            self._events = None

    def changed(self, index: int) -> float:
        """Return when the file of a frame was last seen to change."""
        return self._calm.changed(self._files[index]) if index in self._files else -np.inf

    def again(self, index: int) -> NDArray[Any]:
        """Return a frame that was given out before."""
        return whole_image(self._files[index])

    def state(self, index: int) -> State:
        """Return the stamp of the file of a frame."""
        return stamp_of(self._files[index])

    def facts(self) -> Video:
        """Return what the first file says."""
        first = self._files[min(self._files)]
        return read_tiff(first) if first.suffix.lower() in TIFF_SUFFIXES else read_image(first)

    def label(self, index: int) -> str:
        """Return the number of a frame as in the names of the files."""
        numbering = self._numbering
        return str(index if numbering is None else index + numbering.base)

    def _new_names(self) -> set[str]:
        """Return names that were not there before.

        Those that the system tells are believed to be all as long as no other is found among all.
        """
        told = self._news()
        if self._told_all and time.monotonic() < self._next_scan:
            return self._usual(told)
        began = time.monotonic()
        with os.scandir(self.path) as entries:
            names = {e.name for e in entries} - self._names
        ended = time.monotonic()
        meanwhile = self._news()
        if names:
            self._told_all = self._numbering is not None and names <= told | meanwhile
        self._next_scan = ended + max(SCAN_S, (ended - began) / SHARE_OF_SCANNING)
        return names | self._usual(meanwhile)

    def _usual(self, told: set[str]) -> set[str]:
        """Return names that are new and those of frames.

        Others may be gone in a moment, as are names that files have until they are whole.
        """
        if self._numbering is None:
            return set()
        return {n for n in told if pattern_of(n) == self._numbering.pattern} - self._names

    def _news(self) -> set[str]:
        """Return the names of files that the system tells of, if it does."""
        if self._events is not None and self._events.broken:
            self.close()
        if self._events is None:
            self._told_all = False
            with suppress(OSError):
                self._events = FolderEvents(self.path)
        return set() if self._events is None else self._events.news()

    def _may_be_frame(self, name: str) -> bool:
        """Say whether a file may be a frame, by its name."""
        return not name.startswith(".") and Path(name).suffix.lower() in IMAGE_SUFFIXES

    def _in_order(self, names: Iterable[str]) -> list[str]:
        """Return names in the order of their numbers, decimal if those that came before are."""
        before = [path.name for path in islice(reversed(self._files.values()), AHEAD)]
        return [path.name for path in in_order(map(Path, names), before)]

    def _look_at(self, paths: Any) -> None:
        """Look at files, so that it is known for how long they have been as they are."""
        for path in paths:
            try:
                self._calm.look(path)
            except FileNotFoundError:
                continue  # renamed, as files are that get their names when they are whole

    def _add(self, name: str) -> None:
        """Note the file of a frame."""
        assert self._numbering is not None
        if pattern_of(name) != self._numbering.pattern:
            self.notes.append(f"{name} has another name than the frames, and is left out")
            return
        index = self._numbering.index(name)
        if index is None:
            index = self._last + 1
            last = self._files[index - 1].name if index else name
            late = self._in_order([last, name])[0] != last
        else:
            late = index < self.taken
        if late or index in self._files:
            self.notes.append(f"{name} came too late, and is left out")
            return
        self._files[index] = self.path / name
        self._last = max(self._last, index)


def whole_image(path: Path) -> NDArray[Any]:
    """Return an image; one that is cut short is an error."""
    if path.suffix.lower() in TIFF_SUFFIXES:
        if not path.stat().st_size:
            raise NotYetError(UNFINISHED)
        try:
            with quiet(), tifffile.TiffFile(path) as tif:
                check_complete(tif, path)
        except OSError:
            raise
        except Exception as error:  # what is not whole yet leads to any error
            msg = f"{path.name} is cut short or damaged"
            raise OSError(msg) from error
    return load_image(path)


# ---- a TIFF ----------------------------------------------------------------------------------


class TiffArriving(Arriving):
    """A TIFF to which pages are appended."""

    def __init__(self, path: Path, patience_s: float) -> None:
        super().__init__(path, patience_s)
        self._calm = Calm()
        #: Where the directory of each page lies.
        self._offsets: list[int] = []
        #: Where the pixels of pages lie that were read, first and last byte.
        self._pixels: dict[int, tuple[int, int]] = {}
        #: Size and number of the file.
        self._file = (0, 0)

    def look(self) -> int:
        """Follow the chain of pages as far as it goes."""
        self._calm.look(self.path)
        size, _, number = stamp_of(self.path)
        if size < self._file[0] or number != self._file[1]:
            self._forget()
        self._file = (size, number)
        with self.path.open("rb", buffering=0) as file:  # nothing old from a buffer
            chain = Chain.of(file.read(16))
            if chain is None:
                return 0
            if self._offsets and not chain.begins(file, self._offsets[:2]):
                self._forget()
            if not self._offsets and chain.first:
                self._offsets.append(chain.first)
            while self._offsets:
                following = chain.following(file, self._offsets[-1])
                if not following or following in self._offsets[-2:]:
                    break
                self._offsets.append(following)
        return len(self._offsets)

    def read(self, index: int) -> NDArray[Any]:
        """Return a page."""
        if index == len(self._offsets) - 1:  # those before it are whole: another one follows
            self._calm.check(self.path)
        return self._page(index)

    def changed(self, index: int) -> float:
        """Return when the file was last seen to change, where that may be the page."""
        return self._calm.changed(self.path) if index == len(self._offsets) - 1 else -np.inf

    def again(self, index: int) -> NDArray[Any]:
        """Return a page that was given out before."""
        return self._page(index)

    def state(self, index: int) -> State:
        """Return a sum of bytes from all over a page: the file changes with each page."""
        if index not in self._pixels:
            return stamp_of(self.path)
        start, stop = self._pixels[index]
        each, found = -(-(stop - start) // SAMPLES), 0
        with self.path.open("rb", buffering=0) as file:
            for place in range(start, stop, each):
                file.seek(place)
                found = zlib.crc32(file.read(min(SAMPLED, each, stop - place)), found)
        return start, stop, found

    def facts(self) -> Video:
        """Return what the file says, if that can be read by now."""
        return read_tiff(self.path)

    def _forget(self) -> None:
        """Forget where the pages lie, as the file is written anew from its beginning."""
        self._offsets.clear()
        self._pixels.clear()

    def _page(self, index: int) -> NDArray[Any]:
        """Return the pixels of a page."""
        try:
            with quiet(), tifffile.TiffFile(self.path) as tif:
                tif.filehandle.seek(self._offsets[index])
                page = tifffile.TiffPage(tif, index=index)
                ends = [o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)]
                if not ends or max(ends) > self.path.stat().st_size:
                    raise NotYetError(UNFINISHED)
                frame = grey(np.asarray(page.asarray()))
        except (NotYetError, OSError):
            raise
        except Exception as error:  # what is not whole yet leads to any error
            msg = f"page {index} can't be decoded"
            raise OSError(msg) from error
        self._pixels[index] = (min(page.dataoffsets), max(ends))
        return frame


class Chain:
    """How the pages of a TIFF follow one another (TIFF 6.0, section 2; BigTIFF).

    Parameters
    ----------
    order : str
        "<" or ">".
    big : bool
        Whether it is a BigTIFF.
    first : int
        Where the first page's directory lies, 0 if there is none yet.
    """

    def __init__(self, order: str, first: int, *, big: bool) -> None:
        self.first = first
        self.count = struct.Struct(f"{order}{'Q' if big else 'H'}")
        self.offset = struct.Struct(f"{order}{'Q' if big else 'I'}")
        self.tag = 20 if big else 12

    @classmethod
    def of(cls, head: bytes) -> Chain | None:
        """Return the chain that the beginning of a file tells of, None if it is too short."""
        orders = {b"II": "<", b"MM": ">"}
        if len(head) < 8 or head[:2] not in orders:
            return None
        order = orders[head[:2]]
        big = struct.unpack(f"{order}H", head[2:4]) == (43,)
        if big and len(head) < 16:
            return None
        (first,) = struct.unpack(f"{order}{'Q' if big else 'I'}", head[8:] if big else head[4:8])
        return cls(order, first, big=big)

    def begins(self, file: Any, offsets: Sequence[int]) -> bool:
        """Say whether a file begins with a page at the first offset, then one at the second."""
        return self.first == offsets[0] and all(
            self.following(file, one) == other for one, other in pairwise(offsets)
        )

    def following(self, file: Any, offset: int) -> int:
        """Return where the page after the one at an offset lies; 0 if there is none yet."""
        file.seek(offset)
        head = file.read(self.count.size)
        if len(head) < self.count.size:
            return 0
        (count,) = self.count.unpack(head)
        file.seek(offset + self.count.size + count * self.tag)
        tail = file.read(self.offset.size)
        if not count or len(tail) < self.offset.size:
            return 0
        return int(self.offset.unpack(tail)[0])


# ---- a Zarr store ----------------------------------------------------------------------------


class ZarrArriving(Arriving):
    """A Zarr array that grows along time, in a folder.

    It is longer before the pieces of its new frames are there, which Zarr reads as black; so
    these are waited for. Pieces that hold several frames are written again for each.
    """

    def __init__(self, path: Path, patience_s: float, dataset: str | None) -> None:
        super().__init__(path, patience_s)
        self.dataset = dataset
        self._calm = Calm()
        self._reader: ZarrReader | None = None
        #: What frames are read again with, and the state of the pieces that it has read.
        self._again: tuple[State, ZarrReader] | None = None

    def look(self) -> int:
        """Look how long the array is."""
        if not self.path.exists():
            raise FileNotFoundError(self.path)
        try:
            reader = self._opened() if self._reader is None else self._reader.as_it_is_now()
        except (OSError, ValueError):
            return 0  # its description is being written
        self._reader = reader
        ahead = range(self.taken, min(self.taken + AHEAD, reader.shape[0]))
        pieces = {file for index in ahead for file in reader.files(index)}
        self._calm.keep(pieces)
        for file in pieces:
            self._calm.look(file)
        return reader.shape[0]

    def read(self, index: int) -> NDArray[Any]:
        """Return a frame."""
        reader = self._reader
        assert reader is not None  # it has been looked at
        pieces = reader.files(index)
        if not pieces:
            raise FileNotFoundError(self.label(index))
        for file in pieces:
            self._calm.check(file)
        return reader.frame(index)

    def doubtful(self, frame: NDArray[Any]) -> bool:
        """Say whether a piece of a frame is black, as those are that are not there yet."""
        return self._reader is not None and self._reader.unwritten(frame)

    def learn(self, frame: NDArray[Any]) -> None:
        """Learn nothing: a piece that is missing is always black."""

    def changed(self, index: int) -> float:
        """Return when the pieces of a frame were last seen to change."""
        if self._reader is None:
            return -np.inf
        return max(map(self._calm.changed, self._reader.files(index)), default=-np.inf)

    def again(self, index: int) -> NDArray[Any]:
        """Return a frame that was given out before, not from what was read of it then."""
        assert self._reader is not None
        state = self.state(index)
        if self._again is None or self._again[0] != state:
            try:
                self._again = state, self._reader.as_it_is_now()
                return self._again[1].frame(index)
            except (OSError, ValueError):  # it may be an array of another size
                self._again = state, self._opened()
        return self._again[1].frame(index)

    def renew(self) -> None:
        """Forget the pieces that were read."""
        self._again = None

    def state(self, index: int) -> State:
        """Return the stamps of the pieces of a frame."""
        assert self._reader is not None
        return tuple(number for file in self._reader.files(index) for number in stamp_of(file))

    def facts(self) -> Video:
        """Return what the store says."""
        return read_zarr(self.path, self.dataset)

    def _opened(self) -> ZarrReader:
        """Return a new reader of the array."""
        reader = reader_of(read_zarr(self.path, self.dataset).frames)
        assert isinstance(reader, ZarrReader)
        return reader
