"""Frames that arrive while one records, in their order, each when it is whole.

Where nothing tells when a frame is whole, all is looked at twice: a file, page or piece is read
once it has stayed as it is for a while, and can be read. Until then it is waited for. Linux tells
when a file of a folder was closed. What was given out is known again by a sum of its pixels: an
acquisition that begins anew under the same names is another recording.
"""

from __future__ import annotations

import math
import time
import zlib
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.io.lazy import FrameReader, Stamp, WrongFrameError, in_one_line, stamp_of
from napari_phase4d.io.video import Video
from napari_phase4d.task import UNWATCHED, Task, Watch

__all__ = [
    "AHEAD",
    "SETTLED_S",
    "UNFINISHED",
    "Arrival",
    "ArrivedFrames",
    "Arriving",
    "Calm",
    "NotYetError",
    "State",
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


#: Seconds for which the first frame must stay another one before it counts as that of another
#: recording, which ends a watch for good.
ANEW_S = 1.0
#: How often what can't be read is looked at once more before it counts as gone.
TRIES = 3

#: Sizes, times and numbers of the files that hold a frame, or sums of what they hold; nothing if
#: they are gone.
State = tuple[int, ...]


class GivenOut:
    """Frames that were given out, to be known again.

    Parameters
    ----------
    arriving : Arriving
        What gave them out.
    """

    def __init__(self, arriving: Arriving) -> None:
        self._arriving = arriving
        #: A sum of the pixels of each, and the state of its files then, hashed.
        self._sums: dict[int, int] = {}
        self._states: dict[int, int | None] = {}
        #: Number of the first one that was whole for sure.
        self.first: int | None = None

    def add(self, index: int, frame: NDArray[Any], before: State | None, *, sure: bool) -> None:
        """Remember a frame, read when its files were in some state."""
        self._sums[index] = sum_of(frame)
        now = self.state(index)
        # What was written again in between is held against its sum when it is asked for.
        self._states[index] = hash(now) if now and now == before else None
        if sure and self.first is None:
            self.first = index

    def forget(self, indices: Iterable[int]) -> None:
        """Forget frames that were not given out after all."""
        for index in indices:
            self._sums.pop(index, None)
            self._states.pop(index, None)
        if self.first not in self._sums:
            self.first = None

    def state(self, index: int) -> State | None:
        """Return the state of the files of a frame; nothing if they are gone, None if unknown."""
        try:
            return self._arriving.state(index)
        except (FileNotFoundError, KeyError, NotADirectoryError):
            return ()
        except OSError:  # as of a server that does not answer
            return None

    def is_same(self, index: int) -> bool | None:
        """Say whether a frame that lies there has the pixels that were given out.

        None where that can't be said: it is gone, or can't be read (any more, or yet).
        """
        state = self.state(index)
        if not state:
            return None
        if hash(state) == self._states[index]:
            return True
        try:
            found = self._arriving.again(index)
        except (IndexError, NotYetError, OSError, ValueError):
            return None
        same = sum_of(found) == self._sums[index]
        if same:  # its file has grown, or what it says beside the pixels has changed
            now = self.state(index)
            self._states[index] = hash(now) if now else None
            return True
        return None if self._arriving.doubtful(found) else False

    def all_gone(self, task: Task) -> set[int]:
        """Return the numbers of those that are gone, or others, by now."""
        looking = Watch(len(self._sums), "looking whether the frames are still there", task)
        found = set()
        for index in self._sums:
            same = self.is_same(index)
            for _ in range(TRIES):
                if same is not None or self.state(index) == ():
                    break
                time.sleep(SETTLED_S)  # it may be being written, with frames of its own beside it
                same = self.is_same(index)
            if not same:
                found.add(index)
            looking.step()
        return found


def sum_of(frame: NDArray[Any]) -> int:
    """Return a sum of the pixels of a frame, of their kind and number."""
    kind = zlib.crc32(f"{frame.dtype.str} {frame.shape}".encode())
    return zlib.crc32(np.ascontiguousarray(frame).data, kind)


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
        #: Frames that came, and are gone or others by now, see `look_back`.
        self.gone: set[int] = set()
        #: Whether another recording has been begun in the place of this one.
        self.begun_anew = False
        #: Whether frames are held back until it is known whether that is so.
        self.held = False
        #: Whether what is there could not be looked at, which has been said.
        self._failing = False
        self._given_out = GivenOut(self)
        #: What the first frame was last seen to be, where it is not as it was, and since when.
        self._doubted: tuple[State | None, float] = ((), -math.inf)
        #: Since when it is not as it was.
        self._unlike_since = math.inf
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
    def state(self, index: int) -> State:
        """Return what is another if a frame that was given out is written again.

        Raises
        ------
        FileNotFoundError
            If its file is gone.
        """

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
        if self.begun_anew:
            return False
        before = self.seen
        try:
            self.seen = max(self.seen, self.look())
            self._failing = False
        except FileNotFoundError:
            pass  # not yet, or not any more
        except OSError as error:  # as of a server that does not answer for a while
            if not before:
                raise
            if not self._failing:
                self.notes.append(f"{self.path.name} can't be looked at ({in_one_line(error)})")
            self._failing = True
        # Asked in this order: what is in the place of a later frame came after the first one.
        self._look_at_first()
        if self.seen > before:
            self._announced.append((self.seen, time.monotonic()))
        return self.seen > before

    def take(self, at_most: int) -> list[Arrival]:
        """Return the next frames that are whole, or were given up, in order; so many at most."""
        found: list[Arrival] = []
        if self.held or self.begun_anew:
            return found
        before = self.taken
        while len(found) < at_most and self.taken < self.seen:
            arrival = self._next()
            if arrival is None:
                break
            found.append(arrival)
            self.taken += 1
        if found and not self._look_at_first():  # they may be those of another recording
            self._given_out.forget(range(before, self.taken))
            self.taken = before
            self.seen = before if self.begun_anew else self.seen
            return []
        for arrival in found:
            if arrival.frame is None:
                self.lost.add(arrival.index)
                self.notes.append(f"frame {self.label(arrival.index)} {arrival.why}")
        return found

    def look_back(self, task: Task = UNWATCHED) -> set[int]:
        """Return the frames that came and are gone or others by now, and note them as `gone`.

        Raises
        ------
        Cancelled
            If ``cancelled()`` returned True.
        """
        self.renew()
        self.gone = self._given_out.all_gone(task)
        return self.gone

    def renew(self) -> None:  # noqa: B027 - most keep nothing
        """Forget what was kept of the files, so that they are read as they are now."""

    def _look_at_first(self) -> bool:
        """Say whether the recording is still the same one, as far as is known.

        An acquisition that begins anew in the place of another one begins with its first frame.
        """
        first = self._given_out.first
        if first is None:
            return True
        same, now = self._given_out.is_same(first), time.monotonic()
        state = self._given_out.state(first)
        if (
            same or state == ()
        ):  # it may be gone, as where files are moved away when they are whole
            self._unlike_since, self.held = math.inf, False
            return True
        self._unlike_since = min(self._unlike_since, now)
        if self._doubted[0] != state:
            self._doubted = (state, now)
        self.begun_anew = same is False and now - self._doubted[1] >= ANEW_S
        self.held = now - self._unlike_since < max(self.patience_s, 2 * ANEW_S)
        if self.begun_anew:
            self.seen, self.held = self.taken, False
        return not (self.held or self.begun_anew)

    def _next(self) -> Arrival | None:
        """Return the next frame, None if it is still waited for."""
        now, index = time.monotonic(), self.taken
        frame: NDArray[Any] | None = None
        why = ""
        while self._announced[0][0] <= index:
            self._announced.popleft()
        since, before = self._announced[0][1], self._given_out.state(index)
        try:
            frame = self._fitting(self.read(index))
            if not self.doubtful(frame):
                self._given_out.add(index, frame, before, sure=True)
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
            self._given_out.add(index, frame, before, sure=False)
            return Arrival(index, frame, since=since)
        why = "never became whole" if why == UNFINISHED else why
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
    """The frames that arrived, read again when they are asked for.

    Black are those that never came, and those that are gone.

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
        if index in self.arriving.lost or index in self.arriving.gone:
            return np.zeros(self.shape[1:], self.dtype)
        return self.arriving.again(index)
