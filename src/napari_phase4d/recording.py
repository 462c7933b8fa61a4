"""A hologram video with what is known about it: frames, times, microscope."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.later import xr
from napari_phase4d.optics import Optics, pixel_note
from napari_phase4d.stacks import PLAIN_AXES, coordinate
from napari_phase4d.warned import warn
from napari_phase4d.words import check_type, shown

__all__ = ["BrokenFrameError", "Recording", "one_frame", "reader_of", "remember_reader"]

#: Frames per second assumed where neither the file nor the user says it.
DEFAULT_FRAME_RATE_HZ = 1.0
#: Share of a frame's pixels that may be masked without its being lost.
FEW_PIXELS = 0.02
#: Share of the time between two frames by which even ones are rounded at most.
UNEVEN = 1e-6
#: Frames per second that a recording may have, from less than one a century to light's period.
LEAST_RATE_HZ, LARGEST_RATE_HZ = 1e-10, 1e15
#: Larger floating-point pixels overflow in the spectrum's power in single precision.
LARGEST = 1e12


class BrokenFrameError(ValueError):
    """A frame that holds NaN, infinity or numbers from which no phase can be computed."""


class ReadsFrames(Protocol):
    """Reads frames by their number."""

    def frame(self, index: int) -> NDArray[Any]:
        """Return one frame, shape (y, x)."""


#: Who reads the frames of a dask array, by the array's name. One frame through dask's graph costs
#: milliseconds, more than reading it.
READERS: WeakValueDictionary[str, ReadsFrames] = WeakValueDictionary()


def remember_reader(name: str, reader: ReadsFrames) -> None:
    """Let single frames of the dask array of this name be read by its reader, without dask.

    Parameters
    ----------
    name : str
        The array's ``name``.
    reader : object
        Its ``frame(index)`` returns one frame (y, x). It is forgotten when nobody else holds it.
    """
    READERS[name] = reader


def reader_of(frames: Any) -> ReadsFrames | None:
    """Return who reads the frames of a dask array, if that is known; not of a part or a copy.

    Parameters
    ----------
    frames : array_like
        Frames (time, y, x); an array that is not of dask has no reader.

    Returns
    -------
    object or None
        Its ``frame(index)`` returns one frame, shape (y, x).
    """
    return READERS.get(str(getattr(frames, "name", "")))


def one_frame(frames: Any, index: int) -> NDArray[np.generic]:
    """Return one frame of an array (time, y, x), by the shortest way.

    Parameters
    ----------
    frames : array_like
        Frames (time, y, x), in memory or lazy.
    index : int
        Number of the frame from 0; negative numbers count from the end.

    Returns
    -------
    ndarray, shape (y, x)
        The frame's numbers as they are, in memory.
    """
    reader = reader_of(frames)
    # The length of a dask array is counted anew each time, over all of its chunks.
    n_frames = frames.shape[0]
    frame = frames[index] if reader is None else reader.frame(range(n_frames)[index])
    return np.asarray(frame)


@dataclass(frozen=True)
class Recording:
    """A lazy hologram video.

    Parameters
    ----------
    holograms : xarray.DataArray
        Camera frames with dims ``("time", "y", "x")``, any integer or float dtype. Times are in
        seconds, ``y`` and ``x`` in micrometres in the sample. The frames may be backed by dask
        and larger than memory.
    optics : Optics
        The microscope.
    name : str
        What to call the recording in messages and layers.
    source : str, optional
        The file or folder that the frames come from; empty for arrays, and for files that no name
        stands for.
    notes : tuple of str, optional
        What the reader assumed, in sentences for the user ("no frame rate in the file ...").
    kind : str, optional
        What was read, in words ("BigTIFF", "H.264 in MP4"); empty for arrays.
    file_pixel_um : float, optional
        Width of a pixel in the sample according to the file, whatever the optics; None where it
        says nothing of it.
    dataset : str, optional
        Which array, or place on further axes, of the source it is, as `open_recording` was told.
    raw : RawLayout, optional
        How the frames of a raw file lie in it, as `open_recording` was told.

    See Also
    --------
    open_recording : Makes one from a file or an array.

    Examples
    --------
    >>> from napari_phase4d import Recording
    >>> import numpy as np
    >>> rec = Recording.from_frames(np.zeros((12, 64, 64)), frame_rate_hz=6)
    >>> rec.n_frames, rec.frame_shape, rec.frame_rate_hz
    (12, (64, 64), 6.0)
    """

    holograms: xr.DataArray
    optics: Optics
    name: str = "recording"
    source: str = ""
    notes: tuple[str, ...] = field(default=())
    kind: str = ""
    file_pixel_um: float | None = None
    dataset: str | None = None
    raw: Any = None

    @property
    def times_s(self) -> NDArray[np.float64]:
        """Time of each frame in seconds."""
        return np.asarray(self.holograms["time"].values, dtype=np.float64)

    @property
    def frame_rate_hz(self) -> float | None:
        """Mean frames per second, None for a single frame or for frames of one time."""
        times = self.times_s
        span = float(times[-1] - times[0])
        if span <= 0:
            return None
        rate = (len(times) - 1) / span
        # Of the neighbouring numbers, the one that gives the same times again to the last bit.
        near = (rate, math.nextafter(rate, math.inf), math.nextafter(rate, 0))
        numbers = np.arange(len(times))
        return next((r for r in near if np.array_equal(numbers / r, times)), rate)

    @property
    def even_rate_hz(self) -> float | None:
        """Frames per second from 0 s on that say all times; None where they are not even."""
        rate = self.frame_rate_hz
        if rate is None:
            return None
        off_by = np.abs(self.times_s * rate - np.arange(self.n_frames))
        return rate if off_by.max() < UNEVEN else None

    @property
    def pixel_notes(self) -> tuple[str, ...]:
        """What is to be said of a pixel that is not the file's; empty where it is."""
        whose = "the file says" if self.source else "the data say"
        note = pixel_note(self.optics.pixel_um, self.file_pixel_um, whose)
        return (note,) if note else ()

    def calibrated(
        self, optics: Optics | None = None, frame_rate_hz: float | None = None
    ) -> Recording:
        """Return the same frames with another microscope or other, evenly spaced times."""
        frames = Recording.from_frames(
            self.holograms.data,
            optics=optics or self.optics,
            frame_rate_hz=frame_rate_hz,
            times_s=self.times_s if frame_rate_hz is None else None,
            name=self.name,
            source=self.source,
            notes=tuple(
                note
                for note in self.notes
                if not (optics is not None and "microscope" in note)
                and note not in self.pixel_notes
                and not (frame_rate_hz is not None and "frame rate" in note)
            ),
            attrs={str(k): v for k, v in self.holograms.attrs.items()},
            kind=self.kind,
        )
        frames = replace(
            frames, file_pixel_um=self.file_pixel_um, dataset=self.dataset, raw=self.raw
        )
        return replace(frames, notes=(*frames.notes, *frames.pixel_notes))

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return int(self.holograms.sizes["time"])

    @property
    def frame_shape(self) -> tuple[int, int]:
        """Height and width of a frame in camera pixels."""
        return int(self.holograms.sizes["y"]), int(self.holograms.sizes["x"])

    @property
    def nbytes(self) -> int:
        """Size of the frames in bytes, if all were in memory."""
        return int(self.holograms.nbytes)

    def frame(self, index: int) -> NDArray[np.float32]:
        """Return one frame as float32, shape (y, x).

        Raises
        ------
        OSError
            If the file can't be read there any more.
        ValueError
            If the frame holds NaN, infinity or numbers beyond 1e12, from which no phase can be
            computed.
        """
        return np.asarray(self.raw_frame(index), dtype=np.float32)

    def raw_frame(self, index: int) -> NDArray[np.generic]:
        """Return one frame, shape (y, x), its integers as they are: often a view of the file.

        Floats come as float32. It is quicker than `frame` where the work converts the numbers.

        Raises
        ------
        OSError
            If the file can't be read there any more.
        ValueError
            If the frame holds NaN, infinity or numbers beyond 1e12, from which no phase can be
            computed.
        """
        raw = one_frame(self.holograms.data, index)
        if raw.dtype.kind != "f":
            return raw
        with np.errstate(over="ignore"):  # what float32 can't hold becomes infinite
            frame = np.asarray(raw, dtype=np.float32)
        known = np.abs(frame) <= LARGEST
        if not known.all():
            count = int(frame.size - np.count_nonzero(known))
            msg = (
                f"frame {index} of {self.name} holds {count} NaN or infinite pixels "
                f"(or beyond {LARGEST:g}); replace them before opening the recording"
            )
            raise BrokenFrameError(msg)
        return frame

    def frames(self) -> Iterator[NDArray[np.float32]]:
        """Iterate over the frames as float32 arrays (y, x), one in memory at a time."""
        for index in range(self.n_frames):
            yield self.frame(index)

    def first(self, count: int) -> Recording:
        """Return the first frames as a recording of their own."""
        # A frame with NaN may be among them; who looks at it finds out.
        few = np.stack(
            [one_frame(self.holograms.data, i) for i in range(min(count, self.n_frames))]
        )
        return Recording.from_frames(
            few, optics=self.optics, times_s=self.times_s[: len(few)], name=self.name
        )

    def sample_indices(self, at_most: int) -> list[int]:
        """Return up to ``at_most`` frame numbers, spread evenly over the recording."""
        count = min(at_most, self.n_frames)
        return sorted({int(i) for i in np.linspace(0, self.n_frames - 1, count).round()})

    @classmethod
    def from_frames(
        cls,
        frames: Any,
        *,
        optics: Optics | None = None,
        frame_rate_hz: float | None = None,
        times_s: NDArray[np.float64] | None = None,
        name: str = "recording",
        source: str = "",
        notes: tuple[str, ...] = (),
        attrs: dict[str, object] | None = None,
        kind: str = "",
    ) -> Recording:
        """Make a recording from an array of frames.

        Parameters
        ----------
        frames : array_like
            Shape (time, y, x), or (y, x) for a single frame; real numbers. Dask arrays and
            memory maps stay lazy.
        optics : Optics, optional
            Default: the microscope of the paper.
        frame_rate_hz : float, optional
            Frames per second, default 1.
        times_s : array_like, optional
            Time of each frame in seconds, instead of ``frame_rate_hz``.
        name, source, notes, attrs, kind : optional
            See the class; ``attrs`` go to ``holograms.attrs``.

        Raises
        ------
        TypeError, ValueError
            If the array is not a video of one grey value a pixel.
        """
        video = checked_frames(known_pixels(frames), name)
        if optics is None:
            optics = Optics()
        check_type("optics", optics, Optics, "give Optics(wavelength_um=...)")
        n_frames, height, width = video.shape
        if times_s is None:
            rate = DEFAULT_FRAME_RATE_HZ if frame_rate_hz is None else frame_rate_hz
            if not (isinstance(rate, (int, float)) and LEAST_RATE_HZ <= rate <= LARGEST_RATE_HZ):
                msg = (
                    f"frame_rate_hz must be a number above 0, from {LEAST_RATE_HZ:g} to "
                    f"{LARGEST_RATE_HZ:g}, but is {shown(rate)}"
                )
                raise ValueError(msg)
            times_s = np.arange(n_frames) / rate
        else:
            times_s, told = apart(np.asarray(times_s, dtype=np.float64), name)
            notes = (*notes, *told)
        coords = {
            "time": coordinate("time", np.asarray(times_s, dtype=np.float64)),
            "y": coordinate("y", np.arange(height) * optics.pixel_um),
            "x": coordinate("x", np.arange(width) * optics.pixel_um),
        }
        holograms = xr.DataArray(video, dims=PLAIN_AXES[3], coords=coords, attrs=attrs or {})
        return cls(holograms, optics, name, source, notes, kind)


def apart(times_s: NDArray[np.float64], name: str) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return the times of frames, those that have the same stamp spread evenly, and say so.

    Raises
    ------
    ValueError
        If a frame is earlier than the one before.
    """
    steps = np.diff(times_s)
    if not np.isfinite(times_s).all() or len(times_s) < 2 or (steps > 0).all():
        return times_s, ()
    if (steps < 0).any():
        frame = int(np.argmax(steps < 0)) + 1
        msg = (
            f"frame {frame} of {name} is earlier than the one before ({times_s[frame]:g} s after "
            f"{times_s[frame - 1]:g} s); put the frames in order, or give frame_rate_hz"
        )
        raise ValueError(msg)
    first = np.flatnonzero(np.concatenate([[True], steps > 0]))
    if len(first) == 1:
        spread = times_s[0] + np.arange(len(times_s)) / DEFAULT_FRAME_RATE_HZ
    else:
        # The last stamp lasts as long as the others do on average.
        rate = (first[-1] - first[0]) / (times_s[first[-1]] - times_s[first[0]])
        last = times_s[first[-1]] + (len(times_s) - first[-1]) / rate
        ends = ([*first, len(times_s)], [*times_s[first], last])
        spread = np.interp(np.arange(len(times_s)), *ends)
    return spread, ("Several frames have the same time stamp; they are spread evenly.",)


def known_pixels(frames: Any) -> Any:
    """Return frames with NaN for what is masked in a masked array, and the mean for a few."""
    if not isinstance(frames, np.ma.MaskedArray) or frames.dtype.kind not in "iuf":
        return frames
    if not np.ma.is_masked(frames):
        return frames.data
    known: Any = frames.astype(np.result_type(frames.dtype, np.float32))
    if known.ndim < 2 or np.ma.getmaskarray(known).mean(axis=(-2, -1)).max() > FEW_PIXELS:
        return known.filled(np.nan)
    # Bad pixels of a camera: without the fringes there, but not without the frame.
    means = known.mean(axis=(-2, -1), keepdims=True)
    return np.where(np.ma.getmaskarray(known), means, known.data)


def checked_frames(frames: Any, name: str) -> NDArray[np.generic]:
    """Return frames as (time, y, x), or say in one sentence why they are no hologram video."""
    try:
        has_shape = hasattr(frames, "dtype") and hasattr(frames, "ndim")
        video = frames if has_shape else np.asarray(frames)
    except ValueError as error:
        msg = f"{name} is no array: its rows differ in length"
        raise ValueError(msg) from error
    dtype = np.dtype(video.dtype)
    if dtype.kind == "b":
        warn(
            f"{name} holds True and False, as masks do; if it is a hologram of one bit, its phase "
            "is poor: record grey values"
        )
    if dtype.kind not in "buif":
        msg = f"{name} holds {dtype} values; a hologram video needs real numbers"
        raise TypeError(msg)
    if video.ndim < 2:
        msg = f"{name} has {video.ndim} dimensions; a hologram video has three: time, y, x"
        raise ValueError(msg)
    if 0 in video.shape:
        msg = f"{name} is empty: its shape is {tuple(video.shape)}"
        raise ValueError(msg)
    if video.ndim == 2:
        video = video[None]
    if video.ndim != 3:
        hint = ""
        if video.shape[-1] in (3, 4):
            hint = "; it looks like a colour image, so pick one channel first"
        msg = (
            f"{name} has {video.ndim} dimensions {tuple(video.shape)}; a hologram video has "
            f"three: time, y, x{hint}"
        )
        raise ValueError(msg)
    if min(video.shape[1:]) < 8:
        msg = (
            f"the frames of {name} are {video.shape[1]} x {video.shape[2]} pixels; "
            "at least 8 x 8 are needed"
        )
        raise ValueError(msg)
    result: NDArray[np.generic] = video
    return result
