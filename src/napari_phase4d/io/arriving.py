"""Frames that arrive while one records, in their order, each when it is whole.

Where nothing tells when a frame is whole, all is looked at twice: a file, page or piece is read
once it has stayed as it is for a while, and can be read. Until then it is waited for. Linux tells
when a file of a folder was closed. A camera that Micro-Manager drives gives frames as files too,
each as soon as it has come.
"""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import FrameReader, Stamp, WrongFrameError, in_one_line, stamp_of
from napari_phase4d.io.video import Video, colour_sentence, grey
from napari_phase4d.later import tifffile
from napari_phase4d.words import as_path, shown

__all__ = [
    "AHEAD",
    "SETTLED_S",
    "UNFINISHED",
    "Arrival",
    "ArrivedFrames",
    "Arriving",
    "Calm",
    "FromCamera",
    "NotYetError",
]

#: Seconds for which a file must stay as it is before it is taken to be whole.
SETTLED_S = 0.1


#: Frames ahead that are looked at while those before them are read, so that they have settled.
AHEAD = 64
UNFINISHED = "is still being written"


class NotYetError(Exception):
    """A frame is not whole yet; says why."""


@dataclass(frozen=True)
class Arrival:
    """A frame that came, or did not.

    Parameters
    ----------
    index : int
        Its number, from 0.
    frame : ndarray of shape (y, x), or None
        Its grey values; None if it never came.
    why : str
        Why there is none, as "never came".
    since : float
        When it was announced, by ``time.monotonic``.
    """

    index: int
    frame: NDArray[Any] | None
    why: str = ""
    since: float = math.nan


class Calm:
    """Says of files whether they have stayed as they are for a while.

    The clock of this machine alone counts: that of a server may differ.

    Parameters
    ----------
    seconds : float, optional
        For how long; default `SETTLED_S`.
    """

    def __init__(self, seconds: float | None = None) -> None:
        self._seconds = SETTLED_S if seconds is None else seconds
        self._seen: dict[Path, tuple[Stamp, float]] = {}

    def look(self, path: Path) -> float:
        """Look at a file; return for how many seconds it has been seen as it is."""
        now, stamp = time.monotonic(), stamp_of(path)
        if path not in self._seen or self._seen[path][0] != stamp:
            self._seen[path] = (stamp, now)
        return now - self._seen[path][1]

    def check(self, path: Path) -> None:
        """Raise `NotYetError` if a file has changed a moment ago, or is new."""
        if self.look(path) < self._seconds:
            raise NotYetError(UNFINISHED)

    def changed(self, path: Path) -> float:
        """Return when a file was first seen as it is now; the beginning of time if never."""
        return self._seen[path][1] if path in self._seen else -math.inf

    def keep(self, paths: Iterable[Path]) -> None:
        """Let go of all files but these."""
        self._seen = {path: self._seen[path] for path in paths if path in self._seen}

    def forget(self, path: Path) -> None:
        """Let go of a file that has been read."""
        self._seen.pop(path, None)


#: Why a frame is given up of which there is no file.
NEVER_CAME = "never came"


class Arriving(ABC):
    """Frames that arrive, given out in their order; each once.

    Parameters
    ----------
    path : Path
        The folder or file; it need not be there yet.
    patience_s : float
        For so many seconds a frame is waited for that was announced, by its own file or by a
        later frame; then it is given up. While its file changes, it is not.
    """

    def __init__(self, path: Path, patience_s: float) -> None:
        self.path = path
        self.patience_s = patience_s
        #: Frames that were announced so far, those that never came included.
        self.seen = 0
        #: Frames that were given out so far.
        self.taken = 0
        #: What is to be said of the frames, each once; emptied by who says it.
        self.notes: list[str] = []
        self.shape: tuple[int, int] | None = None
        self.dtype: np.dtype[Any] | None = None
        #: Frames that never came.
        self.lost: set[int] = set()
        self._dark_ends = False
        #: Numbers of frames that were seen, and when.
        self._announced: deque[tuple[int, float]] = deque()

    @abstractmethod
    def look(self) -> int:
        """Look what is there; return how many frames are announced, counted from the first."""

    @abstractmethod
    def read(self, index: int) -> NDArray[Any]:
        """Return a frame.

        Raises
        ------
        NotYetError
            If it is not there, or not whole.
        OSError, ValueError
            If it can't be read, which may be because it is not whole.
        """

    @abstractmethod
    def again(self, index: int) -> NDArray[Any]:
        """Return a frame that was given out before."""

    @abstractmethod
    def facts(self) -> Video:
        """Return what is said of pixel and frame rate; the frames do not count."""

    def doubtful(self, frame: NDArray[Any]) -> bool:
        """Say whether a frame may not be whole though it can be read; then it is waited for.

        Programs that make a file as long as it will be, before they write into it, leave its end
        black.
        """
        return not self._dark_ends and not frame[-1].any()

    def learn(self, frame: NDArray[Any]) -> None:
        """Learn of a frame that stayed doubtful: if all frames end black, this says nothing."""
        self._dark_ends = bool(frame.any())

    def changed(self, index: int) -> float:
        """Return when what holds a frame last changed, by ``time.monotonic``."""
        return -math.inf

    def found_late(self, index: int) -> bool:
        """Look once more for a frame before it is given up; say whether it is there after all."""
        return False

    def wait(self, seconds: float) -> None:
        """Wait until something may have come, at most so long."""
        time.sleep(seconds)

    def close(self) -> None:  # noqa: B027 - most have nothing to close
        """Look at nothing any more; what was given out can be read again."""

    def poll(self) -> bool:
        """Look what is there; say whether there is more than before."""
        before = self.seen
        with suppress(FileNotFoundError):  # not yet, or not any more
            self.seen = max(self.seen, self.look())
        if self.seen > before:
            self._announced.append((self.seen, time.monotonic()))
        return self.seen > before

    def take(self, at_most: int) -> list[Arrival]:
        """Return the next frames that are whole, or were given up, in order; so many at most."""
        found: list[Arrival] = []
        while len(found) < at_most and self.taken < self.seen:
            arrival = self._next()
            if arrival is None:
                break
            found.append(arrival)
            self.taken += 1
        return found

    def _next(self) -> Arrival | None:
        """Return the next frame, None if it is still waited for."""
        now, index = time.monotonic(), self.taken
        frame: NDArray[Any] | None = None
        why = ""
        while self._announced[0][0] <= index:
            self._announced.popleft()
        since = self._announced[0][1]
        try:
            frame = self._fitting(self.read(index))
            if not self.doubtful(frame):
                return Arrival(index, frame, since=since)
        except NotYetError as error:
            why = str(error)
        except FileNotFoundError:
            why = NEVER_CAME
        except (OSError, ValueError) as error:
            why = f"can't be read ({in_one_line(error)})"
        if now - max(since, self.changed(index)) < self.patience_s:
            return None
        if why == NEVER_CAME and self.found_late(index):
            return None
        if frame is not None:
            self.learn(frame)
            return Arrival(index, frame, since=since)
        self.lost.add(index)
        why = "never became whole" if why == UNFINISHED else why
        self.notes.append(f"frame {self.label(index)} {why}")
        return Arrival(index, None, why, since)

    def label(self, index: int) -> str:
        """Return how a frame is called: its number."""
        return str(index)

    def _fitting(self, frame: NDArray[Any]) -> NDArray[Any]:
        """Return a frame that is of the size and kind of the first one."""
        if self.shape is None or self.dtype is None:
            if frame.ndim != 2:
                msg = f"it has the axes {frame.shape}, not y and x"
                raise WrongFrameError(msg)
            self.shape, self.dtype = (frame.shape[0], frame.shape[1]), frame.dtype
        if frame.shape != self.shape or frame.dtype != self.dtype:
            msg = f"it is {frame.dtype} {frame.shape}, the others are {self.dtype} {self.shape}"
            raise WrongFrameError(msg)
        return frame


class ArrivedFrames(FrameReader):
    """The frames that arrived, read again when they are asked for; black where one never came.

    Parameters
    ----------
    arriving : Arriving
        What gave them out.
    """

    arguments = ("arriving",)

    def __init__(self, arriving: Arriving) -> None:
        assert arriving.shape is not None and arriving.dtype is not None  # noqa: PT018
        super().__init__(arriving.path, (arriving.taken, *arriving.shape), arriving.dtype)
        self.stamp = None  # it may go on growing
        self.arriving = arriving

    def read(self, index: int) -> NDArray[Any]:
        """Return one frame."""
        if index in self.arriving.lost:
            return np.zeros(self.shape[1:], self.dtype)
        return self.arriving.again(index)


# ---- a camera -------------------------------------------------------------------------------


#: Seconds between two looks into the camera's buffer while nothing is there.
LOOK_S = 0.002
#: Megabytes of frames that the camera may be ahead of the disk.
BUFFER_MB = 512
#: How files of frames are called.
NAME = "frame_{:06}.tif"


class FromCamera:
    """Writes the frames of a camera into a folder, for `napari_phase4d.pipeline.watch`.

    A thread takes each frame from the buffer of Micro-Manager and writes it as a TIFF file, which
    gets its name when it is whole. So what is done with the frames may take its time, and they
    stay as a recording that can be run again. Frames are numbered by the camera: those that its
    buffer had no room for are missing in the numbers.

    It is a context manager: the camera runs inside of ``with``; `watch` does that by itself.

    Parameters
    ----------
    core : pymmcore_plus.CMMCorePlus
        With a camera, its exposure and region set; see `configured`.
    folder : str or Path
        Where the frames go; made if it is not there, and it must hold none.
    frames : int, optional
        How many to take. Default: until it is told to end.

    Raises
    ------
    TypeError, ValueError
        If there is no camera, or the number can't be.

    See Also
    --------
    napari_phase4d.pipeline.watch : Works on the frames as they come.
    """

    def __init__(self, core: Any, folder: str | Path, frames: int | None = None) -> None:
        wanted = ("startSequenceAcquisition", "popNextImageAndMD", "getCameraDevice")
        if not all(hasattr(core, name) for name in wanted):
            msg = f"core must be a CMMCorePlus of pymmcore-plus, but is {shown(core)}"
            raise TypeError(msg)
        if frames is not None and (not isinstance(frames, int) or frames < 1):
            msg = f"frames must be a number of frames, 1 or more, but is {shown(frames)}"
            raise ValueError(msg)
        if not core.getCameraDevice():
            msg = "Micro-Manager has no camera; load a configuration with one"
            raise ValueError(msg)
        self.core, self.folder, self.frames = core, as_path(folder), frames
        #: Frames that are files by now.
        self.written = 0
        #: Frames that the camera took and its buffer had no room for.
        self.dropped = 0
        self._error: Exception | None = None
        self._told = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="camera", daemon=True)

    @classmethod
    def configured(
        cls, configuration: str | Path, folder: str | Path, frames: int | None = None
    ) -> FromCamera:
        """Return the camera of a configuration file of Micro-Manager.

        Parameters
        ----------
        configuration : str or Path
            A ``.cfg`` file; "demo" for the simulated camera of Micro-Manager.
        folder, frames
            See the class.

        Raises
        ------
        ImportError
            If pymmcore-plus is not installed.
        OSError
            If the configuration can't be loaded.
        """
        try:
            from pymmcore_plus import CMMCorePlus
        except ImportError as error:
            msg = (
                "a camera needs pymmcore-plus, which is not installed; "
                'pip install "napari-phase4d[camera]"'
            )
            raise ImportError(msg) from error
        core = CMMCorePlus()
        try:
            core.loadSystemConfiguration(
                "MMConfig_demo.cfg" if str(configuration) == "demo" else str(configuration)
            )
        except (OSError, RuntimeError) as error:
            why = " ".join(str(error).split())
            msg = f"the configuration {configuration} can't be loaded ({why})"
            raise OSError(msg) from error
        return cls(core, folder, frames)

    def __enter__(self) -> Self:
        """Start the camera."""
        self.folder.mkdir(parents=True, exist_ok=True)
        there = next((p.name for p in self.folder.iterdir() if counts(p.name)), None)
        if there is not None:
            msg = f"{self.folder} holds {there} already; choose an empty folder for the frames"
            raise OSError(msg)
        try:
            self.core.setCircularBufferMemoryFootprint(BUFFER_MB)
            if self.frames is None:
                self.core.startContinuousSequenceAcquisition(0)
            else:  # on overflow the camera goes on: the numbers say what is missing
                self.core.startSequenceAcquisition(self.frames, 0, False)
        except RuntimeError as error:
            msg = f"the camera can't be started ({' '.join(str(error).split())})"
            raise OSError(msg) from error
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the camera; what it has taken by then is written."""
        self.stop()
        self._thread.join()
        if error is None:
            self.finish()

    @property
    def ended(self) -> bool:
        """Whether no more frames come."""
        return self._thread.ident is not None and not self._thread.is_alive()

    def stop(self) -> None:
        """Tell the camera to take no more frames; those in its buffer are still written."""
        self._told.set()

    def finish(self) -> None:
        """Stop the camera, and wait until what it has taken by then is written.

        Raises
        ------
        OSError
            If the camera or the disk failed meanwhile.
        """
        self.stop()
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _follow(self) -> None:
        """Write frames until the camera has ended and its buffer is empty."""
        expected, stopped = 0, False
        try:
            while True:
                if self._told.is_set() and not stopped:
                    stopped = True
                    self.core.stopSequenceAcquisition()
                # Asked in this order, or a frame that comes in between would stay behind.
                running = self.core.isSequenceRunning()
                if not self.core.getRemainingImageCount():
                    if not running:
                        break
                    time.sleep(LOOK_S)
                    continue
                try:
                    image, notes = self.core.popNextImageAndMD()
                except IndexError:  # a buffer that ran over was emptied meanwhile
                    continue
                number = int(notes["ImageNumber"])
                self.dropped += number - expected
                expected = number + 1
                self._write(number, np.asarray(image))
                self.written += 1
            if self.frames is not None and not stopped:
                self.dropped += self.frames - expected
        except Exception as error:  # of the camera's own library
            why = " ".join(str(error).split()) or type(error).__name__
            self._error = OSError(f"the camera stopped after {self.written} frames ({why})")
        finally:
            if self.core.isSequenceRunning():
                self.core.stopSequenceAcquisition()

    def _write(self, number: int, frame: NDArray[Any]) -> None:
        """Write a frame; its file has its name only when it is whole."""
        frame = grey(frame)
        if frame.ndim != 2:
            raise ValueError(colour_sentence("the camera"))
        path = self.folder / NAME.format(number)
        hidden = path.with_name(f".{path.name}")
        tifffile.imwrite(hidden, frame)
        hidden.replace(path)


def counts(name: str) -> bool:
    """Say whether a file is more than what systems leave in folders, such as ``.DS_Store``."""
    return not name.startswith(".") or name.startswith(".frame_")
