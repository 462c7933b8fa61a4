"""Raw camera dumps: pixels one after the other, described by the user."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from napari_phase4d.io.lazy import map_frames
from napari_phase4d.io.video import LARGEST_SIDE, Video

__all__ = ["KINDS", "RAW_SUFFIXES", "RawLayout", "read_raw"]

RAW_SUFFIXES = (".raw", ".bin", ".dat")
#: Numbers that a camera may write.
KINDS = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "float32", "float64")


@dataclass(frozen=True)
class RawLayout:
    """How the frames of a raw file lie in it.

    Parameters
    ----------
    height, width : int
        Of a frame in pixels, from 1 to 1048576.
    dtype : str
        What a pixel is: uint8, int8, uint16 (default), int16, uint32, int32, float32 or float64.
    byte_order : str
        "<" if the small byte comes first (default, as on all usual computers), else ">".
    header_bytes : int
        Bytes before the first frame, default 0.
    gap_bytes : int
        Bytes between a frame and the next one, default 0.

    Raises
    ------
    TypeError
        If a size is no whole number.
    ValueError
        If a value is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> import napari_phase4d as p4d
    >>> np.arange(3 * 48 * 64, dtype=np.uint16).tofile("camera.raw")
    >>> p4d.open_recording("camera.raw", raw=RawLayout(height=48, width=64)).n_frames
    3
    """

    height: int
    width: int
    dtype: str = "uint16"
    byte_order: str = "<"
    header_bytes: int = 0
    gap_bytes: int = 0

    def __post_init__(self) -> None:
        for name in ("height", "width", "header_bytes", "gap_bytes"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
                msg = f"{name} of raw frames must be a whole number, but is {value!r}"
                raise TypeError(msg)
        for name in ("height", "width"):
            value = getattr(self, name)
            if not 1 <= value <= LARGEST_SIDE:
                msg = f"the {name} of raw frames must be 1 to {LARGEST_SIDE}, but is {value!r}"
                raise ValueError(msg)
        if self.dtype not in KINDS:
            msg = f"raw pixels must be one of {', '.join(KINDS)}, but are {self.dtype!r}"
            raise ValueError(msg)
        if self.byte_order not in ("<", ">"):
            msg = f'the byte order of raw pixels must be "<" or ">", but is {self.byte_order!r}'
            raise ValueError(msg)
        for name in ("header_bytes", "gap_bytes"):
            if getattr(self, name) < 0:
                msg = f"{name} of a raw file must be 0 or more, but is {getattr(self, name)!r}"
                raise ValueError(msg)

    @property
    def pixel(self) -> np.dtype[np.generic]:
        """NumPy's name for a pixel, with its byte order."""
        return np.dtype(f"{self.byte_order}{np.dtype(self.dtype).str[1:]}")

    @property
    def frame_bytes(self) -> int:
        """Size of a frame in bytes, without the gap behind it."""
        return self.height * self.width * self.pixel.itemsize


def read_raw(path: Path, layout: RawLayout | None) -> Video:
    """Map a raw file; the number of frames follows from its size.

    Parameters
    ----------
    path : Path
        The file.
    layout : RawLayout or None
        How frames lie in it; the file can't say it.

    Raises
    ------
    OSError
        If it is shorter than one frame.
    ValueError
        If no layout is given.
    """
    if layout is None:
        msg = (
            f"{path.name} is raw and can't say how large its frames are; say it with --raw "
            'HEIGHT,WIDTH,TYPE, or in Python with raw=RawLayout(height, width, dtype="uint16")'
        )
        raise ValueError(msg)
    size, step = path.stat().st_size, layout.frame_bytes + layout.gap_bytes
    # The gap behind the last frame may be missing.
    count = (size - layout.header_bytes + layout.gap_bytes) // step
    if count < 1:
        msg = (
            f"{path.name} has {size} bytes, but one frame of {layout.height} x {layout.width} "
            f"{layout.dtype} needs {layout.header_bytes + layout.frame_bytes}"
        )
        raise OSError(msg)
    left = size - layout.header_bytes - count * step
    row = layout.width * layout.pixel.itemsize
    frames = map_frames(
        path,
        layout.pixel,
        (count, layout.height, layout.width),
        layout.header_bytes,
        (step, row, layout.pixel.itemsize),
    )
    notes = []
    if left > 0:
        notes.append(
            f"{left} bytes are left over behind frame {count - 1}; "
            "check the size of the frames, or the last one is cut short."
        )
    return Video(frames, kind="raw", notes=tuple(notes))
