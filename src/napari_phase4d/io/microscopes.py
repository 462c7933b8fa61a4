"""Formats of microscopes' own programs: of Koala, by Lyncée Tec, and what the package bioio opens.

The layout of Koala was taken from what public programs read and write; it is not described by
Lyncée Tec:

- holograms: folder ``Holograms`` with ``holo.raw`` or ``00000_holo.tif`` and so on; the raw file
  begins with width, height, bits a pixel (8 seen) and number of frames, each a little-endian
  4-byte integer (https://github.com/iivs-lab/iivs-lib, iivs/dhm/data/hologram)
- times: ``timestamps.txt`` with "number time date milliseconds since the start" a line
  (same place, iivs/dhm/data/timestamp.py)
- phase: .bin files of a 23-byte header, see `PHASE_HEADER`, and 4-byte floats
  (https://github.com/jejmule/pyKoalaUtils, binkoala.py), in ``Phase/Float/Bin``

Raw files of more than 8 bits were not seen by that program either; 16 bits are taken as two bytes,
the small one first.
"""

from __future__ import annotations

import math
import re
import threading
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import FrameReader, in_one_line, lazy_frames, map_frames
from napari_phase4d.io.sequences import by_number, read_files
from napari_phase4d.io.tiff import read_tiff
from napari_phase4d.io.video import (
    LARGEST_KOALA_SIDE,
    Facts,
    Video,
    axes_in_words,
    check_fits,
    choice,
    chosen_places,
    colour_sentence,
    quiet,
)

__all__ = [
    "BIO_SUFFIXES",
    "is_koala",
    "is_koala_phase",
    "is_koala_raw",
    "read_bio",
    "read_koala",
    "read_koala_file",
    "read_koala_phase",
    "times_files",
]

#: Head of a raw file: width, height, bits a pixel, frames.
RAW_HEADER = np.dtype("<i4")
RAW_HEADER_BYTES = 16
PHASE_HEADER = np.dtype(
    [
        ("version", "u1"), ("big_endian", "u1"), ("header_bytes", "<i4"), ("width", "<i4"),
        ("height", "<i4"), ("pixel_m", "<f4"), ("metres_per_rad", "<f4"), ("unit", "u1"),
    ]
)  # fmt: skip
RADIANS, METRES = 1, 2
#: Milliseconds since the start, last in a line of timestamps.txt.
TIME_LINE = re.compile(r"\d+\s+\S+\s+\S+\s+(\d+(?:\.\d+)?)")
#: What Koala calls its raw file.
RAW_NAME = "holo.raw"


def is_koala(folder: Path) -> bool:
    """Say whether a folder is a recording of Koala: one with Holograms, or Holograms itself."""
    holograms = folder / "Holograms"
    if holograms.is_dir():
        return True
    return folder.name == "Holograms" and (
        (folder / RAW_NAME).is_file() or any(folder.glob("*_holo.tif"))
    )


def read_koala(folder: Path) -> Video:
    """Open the holograms of a Koala recording, with the times that it noted.

    Raises
    ------
    OSError
        If there are no holograms, or they are damaged.
    """
    holograms = folder / "Holograms" if (folder / "Holograms").is_dir() else folder
    raw = sorted(holograms.glob("*.raw"))
    images = sorted(holograms.glob("*.tif"), key=by_number)
    if raw:
        video = read_koala_raw(raw[0])
    elif images:
        video = replace(
            read_files(folder, images, read_tiff), kind=f"Koala, {len(images)} TIFF images"
        )
    else:
        msg = f"{folder.name} is a folder of Koala, but has no holograms (holo.raw or .tif)"
        raise OSError(msg)
    return timed(video, folder)


def times_files(folder: Path) -> list[Path]:
    """Return the file with the times of the holograms in a folder; none if there is none."""
    holograms = folder / "Holograms" if (folder / "Holograms").is_dir() else folder
    places = (holograms / "timestamps.txt", holograms.parent / "timestamps.txt")
    return [place for place in places if place.is_file()][:1]


def timed(video: Video, folder: Path) -> Video:
    """Return the video with the times in timestamps.txt, beside Holograms or in it."""
    if not (found := times_files(folder)):
        return video
    lines = found[0].read_text(encoding="utf-8", errors="replace").splitlines()
    matches = [TIME_LINE.fullmatch(line.strip()) for line in lines if line.strip()]
    times = np.array([float(m[1]) / 1000 for m in matches if m], np.float64)
    if len(times) != len(matches) or len(times) != len(video.frames):
        n_frames = len(video.frames)
        msg = f"timestamps.txt has {len(times)} times for {n_frames} frames; it is not used."
        return replace(video, notes=(*video.notes, msg))
    if (np.diff(times) <= 0).any():
        msg = "The times in timestamps.txt do not grow; they are not used."
        return replace(video, notes=(*video.notes, msg))
    return replace(video, times_s=times - times[0])


def is_koala_raw(path: Path) -> bool:
    """Say whether a raw file begins as those of Koala do, and is as long as it then must be.

    What is called holo.raw is taken for one, so that it is told where it is damaged.
    """
    found = raw_header(path)
    if found is None or path.name.lower() == RAW_NAME:
        return path.name.lower() == RAW_NAME
    width, height, bits, count = found
    return path.stat().st_size == RAW_HEADER_BYTES + count * height * width * (bits // 8)


def read_koala_file(path: Path) -> Video:
    """Open the raw file of a Koala recording alone, with the times beside or above it.

    Raises
    ------
    OSError
        If it is cut short or damaged.
    """
    return timed(read_koala_raw(path), path.parent)


def read_koala_raw(path: Path) -> Video:
    """Map the holograms in a raw file of Koala.

    Raises
    ------
    OSError
        If it is cut short or damaged.
    """
    found = raw_header(path)
    if found is None:
        msg = f"{path.name} can't be read as holograms of Koala; its header makes no sense"
        raise OSError(msg)
    width, height, bits, count = found
    dtype = np.uint8 if bits == 8 else np.dtype("<u2")
    frames = map_frames(path, dtype, (count, height, width), RAW_HEADER_BYTES)
    return Video(frames, kind="Koala raw")


def raw_header(path: Path) -> tuple[int, int, int, int] | None:
    """Return width, height, bits and number of frames, None if they can't be that."""
    with path.open("rb") as file:
        start = file.read(RAW_HEADER_BYTES)
    if len(start) < RAW_HEADER_BYTES:
        return None
    width, height, bits, count = (int(n) for n in np.frombuffer(start, RAW_HEADER))
    sides = all(0 < side <= LARGEST_KOALA_SIDE for side in (width, height))
    return (width, height, bits, count) if sides and bits in (8, 16) and count > 0 else None


def phase_files(path: Path) -> list[Path]:
    """Return the phase files of a file, of a folder of them, or of a recording; none if none."""
    if path.is_file():
        return [path] if path.suffix.lower() == ".bin" else []
    places = (path / "Phase" / "Float" / "Bin", path)
    found = (sorted(place.glob("*.bin"), key=by_number) for place in places)
    return next((files for files in found if files), [])


def is_koala_phase(path: Path) -> bool:
    """Say whether a file or folder is phase as Koala writes it, and no holograms beside it."""
    if path.is_dir() and is_koala(path):
        return False
    files = phase_files(path)
    if not files:
        return False
    try:
        phase_header(files[0])
    except OSError:
        return False
    return True


def read_koala_phase(path: Path) -> Video:
    """Read phase of Koala in radians, float32, (time, y, x).

    Parameters
    ----------
    path : Path
        A .bin file, a folder of them, or a recording with ``Phase/Float/Bin``.

    Raises
    ------
    OSError
        If a file is damaged, or the files differ in size.
    """
    files = phase_files(path)
    if not files:
        msg = f"{path.name} holds no phase of Koala (.bin files)"
        raise OSError(msg)
    head = phase_header(files[0])
    check_fits(sum(file.stat().st_size for file in files), path.name)
    frames = np.stack([phase_of(file, head) for file in files])
    video = Video(frames, pixel_um=float(head["pixel_m"]) * 1e6, kind="Koala phase")
    return timed(video, path) if path.is_dir() else video


def phase_header(path: Path) -> NDArray[Any]:
    """Return the header of a phase file, see `PHASE_HEADER`."""
    with path.open("rb") as file:
        start = file.read(PHASE_HEADER.itemsize)
    if len(start) == PHASE_HEADER.itemsize:
        head: NDArray[Any] = np.frombuffer(start, PHASE_HEADER)[0]
        sound = (
            int(head["version"]) == 1 and int(head["big_endian"]) == 0
            and int(head["header_bytes"]) == PHASE_HEADER.itemsize
            and 0 < int(head["width"]) <= LARGEST_KOALA_SIDE
            and 0 < int(head["height"]) <= LARGEST_KOALA_SIDE
            and math.isfinite(head["pixel_m"]) and float(head["pixel_m"]) > 0
        )  # fmt: skip
        if sound and (int(head["unit"]) != METRES or float(head["metres_per_rad"]) > 0):
            return head
    msg = f"{path.name} can't be read as phase of Koala; its header makes no sense"
    raise OSError(msg)


def phase_of(path: Path, first: NDArray[Any]) -> NDArray[np.float32]:
    """Return the phase in one file, in radians."""
    head = phase_header(path)
    shape = (int(head["height"]), int(head["width"]))
    if shape != (int(first["height"]), int(first["width"])):
        msg = f"{path.name} is {shape}, but the files before it are not; all must be of one size"
        raise OSError(msg)
    values = np.asarray(map_frames(path, "<f4", shape, PHASE_HEADER.itemsize), np.float32)
    if int(head["unit"]) == METRES:
        values = values / np.float32(head["metres_per_rad"])
    return values


# ---- what bioio opens -----------------------------------------------------------------------


#: The best known; others are tried too.
BIO_SUFFIXES = (".czi", ".dv", ".gif", ".lif", ".nd2", ".oib", ".oif", ".sld", ".stk")
#: Axes of which a place is chosen, and those that are read whole.
CHOSEN, NOT_CHOSEN = "CZ", "TYXS"


def read_bio(path: Path, dataset: str | None = None) -> Video:
    """Open a file with bioio (https://bioio-devs.github.io/bioio), lazily.

    Parameters
    ----------
    path : Path
        The file.
    dataset : str, optional
        A channel and slice where there are several, such as "C=1" or "C=0,Z=2".

    Raises
    ------
    OSError
        If bioio, or its reader for the format, is missing, or the file is damaged.
    ValueError
        If several channels or slices are there and none is chosen, or it is in colour.
    """
    image = opened(path)
    try:
        sizes = {axis: int(getattr(image.dims, axis, 1)) for axis in "TCZYXS"}
        dtype = np.dtype(image.dtype)
        facts = facts_of(image)
    except Exception as error:
        raise OSError(unreadable(path, error)) from error
    if sizes["S"] > 1:
        first = np.asarray(image.get_image_dask_data("YXS", T=0, C=0, Z=0)[..., :3])
        if (first != first[..., :1]).any():
            raise ValueError(colour_sentence(path.name))
    place = chosen_place(path, sizes, dataset)
    reader = BioReader(path, place, (sizes["T"], sizes["Y"], sizes["X"]), dtype)
    kind = f"{path.suffix[1:].upper()}, read with bioio"
    return Video(lazy_frames(reader), kind=kind, dataset=dataset or "", **facts)


class BioReader(FrameReader):
    """Reads frames with bioio.

    Parameters
    ----------
    path : Path
        The file; every process opens it for itself.
    place : dict of str to int
        Channel and slice.
    shape, dtype
        Of the recording.
    """

    arguments = ("path", "place", "shape", "dtype")

    def __init__(
        self,
        path: Path,
        place: dict[str, int],
        shape: tuple[int, int, int],
        dtype: np.dtype[Any],
    ) -> None:
        super().__init__(path, shape, dtype)
        self.place = place
        self._lock = threading.Lock()
        self._frames: Any = None

    def read(self, index: int) -> NDArray[Any]:
        """Return one frame; of grey values stored as colour, the first channel."""
        with self._lock:
            if self._frames is None:
                image = opened(self.path)
                axes = "TYXS" if int(getattr(image.dims, "S", 1)) > 1 else "TYX"
                self._frames = image.get_image_dask_data(axes, **self.place)
            frame = np.asarray(self._frames[index])
        return frame[..., 0] if frame.ndim == 3 else frame


def opened(path: Path) -> Any:
    """Return the image that bioio opens, or say what is missing."""
    ending = path.suffix.lower() or "no ending"
    try:
        import bioio
        from bioio_base.exceptions import UnsupportedFileFormatError
    except ImportError as error:
        msg = (
            f"{path.name} is of a kind ({ending}) that can't be read; for formats of microscopes "
            'pip install "napari-phase4d[bio]" and the reader of the format, such as bioio-czi, '
            "bioio-nd2 or bioio-lif"
        )
        raise OSError(msg) from error
    try:
        with quiet("bioio.bio_image"):
            return bioio.BioImage(path)
    except UnsupportedFileFormatError as error:
        msg = (
            f"{path.name} is of a kind that can't be read ({ending}); if it is of a microscope, "
            "install the reader of bioio for it, such as bioio-czi, bioio-nd2 or bioio-lif"
        )
        raise OSError(msg) from error
    except Exception as error:
        raise OSError(unreadable(path, error)) from error


def chosen_place(path: Path, sizes: dict[str, int], dataset: str | None) -> dict[str, int]:
    """Return the channel and slice to read.

    Raises
    ------
    ValueError
        If several are there and none, or one that isn't there, is chosen.
    """
    axes, shape = "".join(sizes), tuple(sizes.values())
    places = dict(zip(axes, chosen_places(path, axes, shape, dataset, NOT_CHOSEN), strict=True))
    place = {axis: number for axis in CHOSEN if isinstance(number := places[axis], int)}
    if len(place) < len(CHOSEN):
        several = (axis for axis in CHOSEN if axis not in place)
        msg = (
            f"{path.name} has {axes_in_words(axes, shape)}; a hologram video has time, y, x, so "
            f"choose one place, as with {choice(several)}"
        )
        raise ValueError(msg)
    return place


def facts_of(image: Any) -> Facts:
    """Return pixel (um) and interval (s) where the file says them."""
    facts: Facts = {}
    width, height = image.physical_pixel_sizes.X, image.physical_pixel_sizes.Y
    if width and np.isfinite(width) and width > 0:
        facts["pixel_um"] = float(width)
    if height and np.isfinite(height) and height > 0:
        facts["height_um"] = float(height)
    try:
        interval = image.time_interval
    except Exception:
        interval = None
    seconds = interval.total_seconds() if isinstance(interval, timedelta) else interval
    if isinstance(seconds, int | float) and np.isfinite(seconds) and seconds > 0:
        facts["interval_s"] = float(seconds)
    return facts


def unreadable(path: Path, error: Exception) -> str:
    """Return the sentence for a file that bioio can't read."""
    return f"{path.name} can't be read; it may be cut short or damaged ({in_one_line(error)})"
