"""Recordings in many files: one image a frame, or one stack after the other."""

from __future__ import annotations

import os
import re
import threading
import warnings
from bisect import bisect_right
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import FrameReader, Unsound, WrongFrameError, lazy_frames
from napari_phase4d.io.tiff import TIFF_SUFFIXES, check_described, tiff_parts
from napari_phase4d.io.video import Video, colour_sentence, grey, listed, quiet
from napari_phase4d.later import tifffile
from napari_phase4d.recording import one_frame

__all__ = [
    "IMAGE_SUFFIXES",
    "PATTERN_SIGNS",
    "PICTURE_SUFFIXES",
    "Numbering",
    "by_number",
    "files_of",
    "files_of_folder",
    "gap_in",
    "in_order",
    "load_image",
    "notes_of_names",
    "of_usual_pattern",
    "pattern_of",
    "read_files",
    "read_image",
]

PATTERN_SIGNS = ("*", "?")
#: Files that are kept open at a time.
MOST_OPEN = 8

#: Opens one file.
ReadOne = Callable[[Path], Video]


def files_of_folder(folder: Path, suffixes: Sequence[str]) -> tuple[list[Path], tuple[str, ...]]:
    """Return the files of a folder that make a recording, in the order of their numbers.

    Where there are images, they are taken; of several kinds the most frequent one. What has
    another name than most of them is left out, as where a background lies among frames.

    Raises
    ------
    OSError
        If there are none.
    """
    with os.scandir(folder) as entries:
        names = [e.name for e in entries if not e.name.startswith(".")]
    kinds = Counter(Path(n).suffix.lower() for n in names)
    usable = [s for s in kinds if s in IMAGE_SUFFIXES] or [s for s in kinds if s in suffixes]
    if not usable:
        msg = f"{folder.name} holds no images ({', '.join(IMAGE_SUFFIXES)})"
        raise OSError(msg)
    best = max(usable, key=lambda s: (kinds[s], s))
    alike, strange = by_name([n for n in names if Path(n).suffix.lower() == best])
    notes = []
    if others := [s for s in usable if s != best]:
        notes.append(f"{folder.name} also holds {', '.join(others)} files, which are not read.")
    if strange:
        are = "is" if len(strange) == 1 else "are"
        notes.append(
            f"{listed(strange)} {are} named otherwise than the other files, and {are} left out; "
            "to read all, give a name with * or a list."
        )
    return in_order(folder / name for name in alike), tuple(notes)


def files_of(pattern: Path) -> list[Path]:
    """Return the files that a name with * or ? stands for, in the order of their numbers.

    Raises
    ------
    OSError
        If there are none.
    """
    files = in_order(p for p in pattern.parent.glob(pattern.name) if p.is_file())
    if not files:
        msg = f"there is no file {pattern}"
        raise OSError(msg)
    return files


def read_files(
    name: Path, files: Sequence[Path], read_one: ReadOne, *, whole: bool = True
) -> Video:
    """Open files as one video, lazily.

    Images are frames, and only the first is read. Stacks are joined over time, and of each the
    header is read. The files of an OME-TIFF series are one stack.

    Parameters
    ----------
    name : Path
        What to call them all in messages: the folder or pattern.
    files : sequence of Path
        In the order of time, all of one kind.
    read_one : callable
        Opens a single file; of the top level of a module, so that other processes find it.
    whole : bool, optional
        Whether files of one image may be read as images (default), or only ``read_one`` knows
        what of them is to be read.

    Raises
    ------
    OSError
        If the first file, or any stack, can't be read.
    ValueError
        If stacks differ in size or kind of pixels. Images that do are found while reading them.
    """
    if whole and files[0].suffix.lower() in PICTURE_SUFFIXES:
        image = load_image(files[0])
        if image.ndim == 3:
            return Video(image, colour=True)
        images = ImageFiles(name, files, (len(files), *image.shape), image.dtype)
        return Video(
            lazy_frames(images), kind=f"{len(files)} {files[0].suffix[1:].upper()} images"
        )
    first = read_one(files[0])
    shape, dtype = frame_kind(first)
    alone = first.frames.ndim == 2 or len(first.frames) == 1
    if whole and alone and files[0].suffix.lower() in IMAGE_SUFFIXES:
        images = ImageFiles(name, files, (len(files), *shape), dtype)
        return replaced(Video(lazy_frames(images)), first, f"{len(files)} {first.kind} images")
    stacks = without_parts(files)
    if len(stacks) == 1 < len(files):
        return read_one(stacks[0])
    files = stacks
    lengths = [length_of(path, read_one, shape, dtype) for path in files]
    reader = JoinedFiles(name, files, lengths, (sum(lengths), *shape), dtype, read_one)
    return replaced(Video(lazy_frames(reader)), first, f"{len(files)} {first.kind} files")


def without_parts(files: Sequence[Path]) -> Sequence[Path]:
    """Return files without those whose frames are read with another one.

    Each file of an OME-TIFF series may describe them all, or only one of them does.
    """
    if files[0].suffix.lower() not in TIFF_SUFFIXES:
        return files
    kept: list[tuple[Path, Path]] = []
    read: set[Path] = set()
    for file in files:
        place = file.resolve()
        if place not in read:
            kept.append((file, place))
            read.update(part.resolve() for part in tiff_parts(file))
    # One that knows nothing of the others may come before the one that names them all.
    return [file for file, place in kept if place not in read]


def replaced(video: Video, first: Video, kind: str) -> Video:
    """Return the video with the facts of its first file."""
    return Video(
        video.frames, pixel_um=first.pixel_um, interval_s=first.interval_s, kind=kind,
        axes=first.axes, notes=first.notes, height_um=first.height_um,
    )  # fmt: skip


def frame_kind(video: Video) -> tuple[tuple[int, int], np.dtype[Any]]:
    """Return height and width of the frames of a file, and their pixels."""
    frames = video.frames
    if video.colour or frames.ndim not in (2, 3):
        msg = f"the files of a sequence must be (time, y, x), but the first is {frames.shape}"
        raise ValueError(msg)
    return (int(frames.shape[-2]), int(frames.shape[-1])), np.dtype(frames.dtype)


def length_of(path: Path, read_one: ReadOne, shape: tuple[int, int], dtype: np.dtype[Any]) -> int:
    """Return the number of frames in a file, or say why it doesn't fit the others."""
    video = read_one(path)
    found = frame_kind(video)
    if found != (shape, dtype):
        msg = (
            f"{path.name} holds {found[1]} frames of {found[0]}, but the first file holds {dtype} "
            f"frames of {shape}; all files of a recording must be of one kind"
        )
        raise ValueError(msg)
    return 1 if video.frames.ndim == 2 else len(video.frames)


class ImageFiles(FrameReader):
    """Reads one image a frame.

    Parameters
    ----------
    path : Path
        What to call them all.
    files : sequence of Path
        One a frame.
    shape, dtype
        Of the recording.
    """

    arguments = ("path", "files", "shape", "dtype")

    def __init__(
        self,
        path: Path,
        files: Sequence[Path],
        shape: tuple[int, int, int],
        dtype: np.dtype[Any],
    ) -> None:
        super().__init__(path, shape, dtype)
        self.files = files

    def read(self, index: int) -> NDArray[Any]:
        """Return one image."""
        path, first = self.files[index], self.files[0].name
        frame = load_image(path)
        if frame.ndim == 3 and frame.shape[-1] in (3, 4):
            raise WrongFrameError(colour_sentence(path.name))
        if frame.shape != self.shape[1:]:
            msg = (
                f"{path.name} is {frame.shape}, but {first} is {self.shape[1:]}; "
                "all images of a folder must be of one size"
            )
            raise WrongFrameError(msg)
        if frame.dtype != self.dtype:
            msg = (
                f"{path.name} holds {frame.dtype} values, but {first} {self.dtype}; "
                "all images of a folder must be of one kind"
            )
            raise WrongFrameError(msg)
        return frame


class JoinedFiles(FrameReader):
    """Reads frames of stacks that follow one another; few of them are open at a time.

    Parameters
    ----------
    path : Path
        What to call them all.
    files : sequence of Path
        The stacks.
    lengths : sequence of int
        Frames in each.
    shape, dtype
        Of the recording.
    read_one : callable
        Opens a stack.
    """

    arguments = ("path", "files", "lengths", "shape", "dtype", "read_one")

    def __init__(
        self,
        path: Path,
        files: Sequence[Path],
        lengths: Sequence[int],
        shape: tuple[int, int, int],
        dtype: np.dtype[Any],
        read_one: ReadOne,
    ) -> None:
        super().__init__(path, shape, dtype)
        self.files = files
        self.lengths = lengths
        self.read_one = read_one
        self.ends = np.cumsum(lengths).tolist()
        self._open: OrderedDict[int, Any] = OrderedDict()
        self._lock = threading.Lock()

    def read(self, index: int) -> NDArray[Any]:
        """Return one frame."""
        place = bisect_right(self.ends, index)
        within = index - (self.ends[place - 1] if place else 0)
        return one_frame(self._opened(place), within)

    def _opened(self, place: int) -> Any:
        """Return the frames of a stack (time, y, x)."""
        with self._lock:
            if place not in self._open:
                frames = self.read_one(self.files[place]).frames
                self._open[place] = frames[None] if frames.ndim == 2 else frames
                if len(self._open) > MOST_OPEN:
                    self._open.popitem(last=False)
            self._open.move_to_end(place)
            return self._open[place]


def by_number(path: Path) -> tuple[list[int], str]:
    """Sort key: the numbers in the name as numbers, so that frame2 comes before frame10."""
    return [int(n) for n in re.findall(r"\d+", path.stem)], path.name


def in_order(files: Iterable[Path], beside: Sequence[str] = ()) -> list[Path]:
    """Return files in the order of the numbers in their names, decimal ones too.

    Names of others of the same recording, if given, help to tell whether they are decimal.
    """
    found = list(files)
    key = by_decimal if have_decimals([file.name for file in found] + list(beside)) else by_number
    return sorted(found, key=key)


def have_decimals(names: Sequence[str]) -> bool:
    """Say whether digits behind a point in some names are decimals.

    They are where some have more of them than others and none ends in 0, as programs write times;
    else they are numbers of their own, which go on from 9 to 10, as they are in dates. So they are
    behind one number that all names have, unless that is 0: run2.9 comes before run2.11.
    """
    stems = [Path(name).stem for name in names]
    parts = [part for stem in stems for part in re.findall(r"(?<=\d\.)\d+", stem)]
    whole = {n for stem in stems for n in re.findall(r"(\d+)\.\d", stem)}
    if len(whole) == 1 and int(*whole) > 0:
        return False
    if len(set(map(len, parts))) < 2 or any(re.search(r"\d\.\d+\.\d", stem) for stem in stems):
        return False
    return not any(len(part) > 1 and part.endswith("0") for part in parts)


def by_decimal(path: Path) -> tuple[list[float], str]:
    """Sort key: the numbers in the name, with their decimals."""
    return [float(n) for n in re.findall(r"\d+(?:\.\d+)?", path.stem)], path.name


#: Not more than this share of the files of a folder are something else beside a recording.
FEW = 0.1
PICTURE_SUFFIXES = (".png", ".bmp", ".jpg", ".jpeg", ".pgm", ".jp2")
IMAGE_SUFFIXES = (*PICTURE_SUFFIXES, *TIFF_SUFFIXES)
#: Values that an image may have: more than any camera's, times three for colour.
MOST_VALUES = 2**29
#: Values in a byte: more than deflate (1032) and JPEG make of one. Small images are never absurd.
MOST_PER_BYTE, NEVER_ABSURD = 1100, 2**24


def read_image(path: Path) -> Video:
    """Read one image as a recording of one frame.

    Raises
    ------
    OSError
        If the image can't be decoded.
    """
    image = load_image(path)
    kind = "JPEG" if path.suffix.lower() in (".jpg", ".jpeg") else path.suffix[1:].upper()
    return Video(image, colour=image.ndim == 3, kind=f"{kind} image")


def load_image(path: Path) -> NDArray[Any]:
    """Return an image, (y, x) where its channels are equal, or raise OSError in one sentence."""
    if path.exists() and not path.is_file():  # which might be waited for without an end
        msg = f"{path.name} is not a file, but a folder, a pipe or a device"
        raise Unsound(msg)
    try:
        if path.suffix.lower() in TIFF_SUFFIXES:
            with quiet(), tifffile.TiffFile(path) as tif:
                check_described(tif, path)
                check_size(path, tif.series[0].shape)
                return grey(np.asarray(tif.asarray()))
        import imageio.v3 as iio
        from PIL import Image

        # Opened here, since Pillow leaves open what it refuses.
        with warnings.catch_warnings(), path.open("rb") as file:
            warnings.simplefilter("ignore")  # Pillow's warning of large images
            with Image.open(file) as image:
                check_size(path, (image.height, image.width, len(image.getbands())))
            return grey(np.asarray(iio.imread(path)))
    except Unsound:
        raise
    except Exception as error:
        # Decoders raise SyntaxError, struct.error and more for damaged files.
        msg = f"{path.name} can't be read as an image; it may be cut short or damaged"
        raise OSError(msg) from error


def check_size(path: Path, shape: tuple[int, ...]) -> None:
    """Raise Unsound if an image has absurdly many pixels."""
    values = np.prod([float(n) for n in shape])
    most = max(NEVER_ABSURD, MOST_PER_BYTE * path.stat().st_size)
    if values > min(MOST_VALUES, most):
        size = " x ".join(str(n) for n in shape)
        msg = f"{path.name} says that it has {size} pixels, more than so small a file can hold"
        raise Unsound(msg)


# ---- what in the names of files counts frames ---------------------------------------------------


class Numbering:
    """What in the names of files counts the frames.

    Of several numbers in a name it is the one that goes up by one from file to file, the last of
    these; where there is none, nothing counts them.

    Parameters
    ----------
    names : sequence of str
        Names of the same pattern, those that are there first.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.pattern = pattern_of(names[0])
        rows = np.array([numbers_of(name) for name in names], dtype=object)
        n_numbers = rows.shape[1] if rows.ndim == 2 else 0
        self.column: int | None = n_numbers - 1 if n_numbers and len(names) == 1 else None
        for column in range(n_numbers) if len(names) > 1 else ():
            values = sorted(rows[:, column].tolist())
            steps = sorted(b - a for a, b in pairwise(values))
            if steps[0] > 0 and steps[len(steps) // 2] == 1:
                self.column = column
        self.base = 0 if self.column is None else min(rows[:, self.column].tolist())

    def count(self, names: Sequence[str]) -> int:
        """Return how many frames there are by their names, those that are missing included."""
        if self.column is None:
            return len(names)
        return max(numbers_of(name)[self.column] for name in names) - self.base + 1

    def index(self, name: str) -> int | None:
        """Return the number of a frame, from 0; None where its name does not say it."""
        return None if self.column is None else numbers_of(name)[self.column] - self.base


def numbers_of(name: str) -> list[int]:
    """Return all numbers in a name, without its ending."""
    return by_number(Path(name))[0]


def pattern_of(name: str) -> str:
    """Return a name with a sign for each number."""
    path = Path(name)
    return re.sub(r"\d+", "#", path.stem) + path.suffix.lower()


def of_usual_pattern(names: Sequence[str]) -> list[str]:
    """Return those of some names that have the most frequent pattern."""
    patterns = Counter(map(pattern_of, names))
    usual = max(patterns, key=lambda p: (patterns[p], p), default="")
    return [name for name in names if pattern_of(name) == usual]


def by_name(names: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return names that are of one recording, and those of something else beside it.

    Of something else is what has no number, and what few have whose letters are more or less than
    those of the others: the name of a month, and what tells morning from afternoon, change in the
    course of a recording.
    """
    strange, word = named_otherwise(names)
    if not strange:  # perhaps several series, or names that change in the course of a recording
        uncounted = sorted(name for name in names if not re.search(r"\d", Path(name).stem))
        beside = uncounted if len(uncounted) <= FEW * len(names) else []
        return [name for name in names if name not in beside], beside
    few = len(strange) <= FEW * len(names)
    beside = [
        name
        for name in strange
        if not re.search(r"\d", Path(name).stem) or (few and len(letters_of(name)) != len(word))
    ]
    return [name for name in names if name not in beside], beside


def named_otherwise(names: Sequence[str]) -> tuple[list[str], str]:
    """Return the names that have other letters than most, sorted, and the letters of most.

    Where no pattern is that of most names, there are none; nor is what has the same letters, since
    programs give the first of several files no number.
    """
    usual = of_usual_pattern(names)
    if 2 * len(usual) <= len(names):
        return [], ""
    word = letters_of(usual[0])
    return sorted(name for name in names if letters_of(name) != word), word


def letters_of(name: str) -> str:
    """Return the letters in a name, small, without its ending."""
    return re.sub(r"[\W\d_]+", "", Path(name).stem).casefold()


def notes_of_names(files: Sequence[Path]) -> tuple[str, ...]:
    """Return what the names of files that are read one after the other let doubt."""
    names = [file.name for file in files]
    strange, _ = named_otherwise(names)
    notes = []
    if strange:
        are = "is" if len(strange) == 1 else "are"
        notes.append(
            f"{listed(strange)} {are} named otherwise than the other files, but read with them."
        )
    notes += series_in(names)
    if have_decimals(names):
        notes.append("Digits behind a point in the names of the files are taken for decimals.")
    elif len(set(map(pattern_of, names))) == 1:
        notes += [*gap_in(names), *grid_in(names)]
    return tuple(notes)


def series_in(names: Sequence[str]) -> Iterator[str]:
    """Yield a note where names count the same with other letters, as those of two series do.

    Letters right behind a number, as in img1a and img1b, count on within it, as do those of
    hexadecimal numbers.
    """
    if all(re.search(r"\d[a-z]?$|[0-9a-f]{2,}$", Path(name).stem) for name in names) and any(
        re.search(r"\d[a-z]+$|[a-f]\d+$|[a-f]{2}$", Path(name).stem) for name in names
    ):
        return
    by_count: dict[tuple[int, ...], set[str]] = {}
    for name in names:
        by_count.setdefault(tuple(numbers_of(name)), set()).add(name)
    shared = [each for count, each in by_count.items() if count and len(each) > 1]
    if len(shared) > 1 and 2 * sum(map(len, shared)) > len(names):
        first = sorted(min(shared, key=sorted))
        yield (
            f"{listed(first)}, and others, count the same with other letters, and are read in "
            "turn; if they are several series, put each into a folder of its own."
        )


def gap_in(names: Sequence[str], what: str = "files") -> Iterator[str]:
    """Yield a note where the numbers that count files, or what else has names, leave some out."""
    numbering = Numbering(names)
    missing = numbering.count(names) - len(names)
    # Digits behind a point are a part of a number, as of a time, and count nothing.
    is_part = numbering.pattern.split("#")[numbering.column or 0] == "."
    if missing > 0 and not is_part:
        ordered = sorted(names, key=lambda name: numbering.index(name) or 0)
        steps = np.diff([numbering.index(name) or 0 for name in ordered])
        are = "number is" if missing == 1 else "numbers are"
        yield (
            f"{missing} {are} missing in the names of the {what}, the first behind "
            f"{ordered[int(np.argmax(steps > 1))]}; frames follow each other all the same, so "
            "that later ones come too early."
        )


def grid_in(names: Sequence[str]) -> Iterator[str]:
    """Yield a note where several numbers vary, as channels and times do, and none counts all."""
    rows = [re.findall(r"\d+(?:\.\d+)?", Path(name).stem) for name in names]
    lengths = {len(row) for row in rows}
    counts = [len(set(column)) for column in zip(*rows, strict=True)] if len(lengths) == 1 else []
    varying = [n for n in counts if n > 1]
    if len(varying) > 1 and max(varying) < len(names):
        yield (
            f"{len(varying)} numbers in the names of the files vary and none counts them all, as "
            "where channels or positions have files of their own; all are read one after the "
            "other, and a name with * reads some."
        )
