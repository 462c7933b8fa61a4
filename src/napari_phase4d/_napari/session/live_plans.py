"""The plan that works on a recording while it is written, and what is newest of it."""

from __future__ import annotations

import math
import operator
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from queue import Empty
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d._napari.session.history import StepNumber
from napari_phase4d._napari.session.phase_plans import Plan
from napari_phase4d._napari.session.state import State
from napari_phase4d.io import FromCamera
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import (
    LiveStatus,
    Outcome,
    find_place,
    phase_needs,
    read_outcome,
    shown_method,
    watch,
)
from napari_phase4d.plotting import phase_colours
from napari_phase4d.task import CancelledCall, Task
from napari_phase4d.unwrapping import METHODS
from napari_phase4d.words import as_path

__all__ = ["PATIENCE_S", "LiveView", "plan_watching"]

#: Seconds without a new frame after which a recording is taken as complete.
PATIENCE_S = 30.0
WRAPPED = "wrapped"
#: Seconds without a new frame after which it is said.
QUIET_S = 2.0


@dataclass(frozen=True)
class LiveView:
    """What is newest of a recording that grows.

    Parameters
    ----------
    index : int
        The number of the newest frame; -1 before the first.
    done_s : float
        When its phase was there, by ``time.monotonic``.
    shown : dict of str to ndarray
        Its phase (angle, y, x), wrapped and by the method that is shown, by their ids.
    like : xarray.DataArray, optional
        A stack of one frame, whose axes and notes are those of what is shown.
    status : LiveStatus
        How far the work is.
    not_shown : int
        Frames that gave way to later ones before they were looked at.
    line : str
        What was told last of single frames.
    """

    index: int = -1
    done_s: float = math.nan
    shown: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    like: xr.DataArray | None = None
    status: LiveStatus = field(default_factory=LiveStatus)
    not_shown: int = 0
    line: str = ""

    def headline(self, now_s: float, *, shown: bool = True) -> str:
        """Say whether frames come, and how late the newest one is if it is shown now."""
        if self.index < 0:
            return "The first frames are looked at"
        waited = now_s - self.done_s
        if waited > QUIET_S and self.status.behind > 0:
            return f"Frame {self.index + 2} is worked on, {self.status.behind} wait"
        if waited > QUIET_S:
            return f"No new frame for {waited:.0f} s"
        late = waited + self.status.delay_s  # NaN as long as nobody knows
        after = f", shown {late:.2f} s after it came" if shown and late == late else ""
        return f"Live: frame {self.index + 1}{after}"

    @property
    def sentence(self) -> str:
        """How far it is, in one line."""
        # What is told once a second may be older than the newest frame.
        done, known = self.index + 1, self.status
        status = replace(
            known, seen=max(known.seen, done), done=max(known.done, done), delay_s=math.nan
        )
        hidden = f"; {self.not_shown} not shown" if self.not_shown else ""
        return f"{status.sentence}{hidden}"


class Newest:
    """Holds what is newest of a recording that grows for who looks at it now and then.

    A frame that nobody has looked at in time gives way to the next one, and is counted; so that
    however slow the window is, the work is not held up and no frames pile up.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._now = LiveView()
        self._waits = self._changed = False

    def begin(self, like: xr.DataArray) -> None:
        """Take the axes of all frames."""
        self._change(like=like)

    def status(self, status: LiveStatus) -> None:
        """Take how far the work is."""
        self._change(status=status)

    def tell(self, line: str) -> None:
        """Take a word on single frames."""
        self._change(line=line)

    def put(self, index: int, results: Mapping[str, NDArray[np.float32]]) -> None:
        """Take the newest frame."""
        names = dict.fromkeys((WRAPPED, shown_method(results)))
        shown, now_s = {name: results[name].copy() for name in names}, time.monotonic()
        with self._lock:
            missed = self._now.not_shown + self._waits
            self._now = replace(
                self._now, index=index, done_s=now_s, shown=shown, not_shown=missed
            )
            self._waits = self._changed = True

    def get_nowait(self) -> LiveView:
        """Return what is newest; raise `queue.Empty` if it was returned before."""
        with self._lock:
            if not self._changed:
                raise Empty
            self._waits = self._changed = False
            return self._now

    def _change(self, **changes: Any) -> None:
        with self._lock:
            self._now = replace(self._now, **changes)
            self._changed = True


def plan_watching(
    state: State,
    source: str | Path | FromCamera,
    out: str | Path,
    *,
    frames: int | None = None,
    patience_s: float = PATIENCE_S,
    optics: Optics | None = None,
    stopped: CancelledCall | None = None,
) -> Plan:
    """Plan to work on a recording while it is written, by the present settings.

    Its newest frame is told by ``live_changed``. In the end recording, phase and results are
    taken as those of a run; they lie in the folder.

    Parameters
    ----------
    state : State
        The session.
    source : str, Path or FromCamera
        What grows, see `watch`.
    out : str or Path
        Folder for the results.
    frames : int, optional
        End after so many frames. Default: as many as come.
    patience_s : float, optional
        End after so many seconds without anything new.
    optics : Optics, optional
        The microscope, where the settings name none.
    stopped : callable, optional
        If it returns True, no more frames are waited for.

    Raises
    ------
    ValueError
        If no method is ticked.
    """
    if not state.recipe.methods:
        msg = "no method is ticked; tick at least one in step 4"
        raise ValueError(msg)
    # What a file holds, and cells, are asked for when there is one.
    chosen = state.brought.without(state.recipe)
    recipe = chosen.changed(
        content="holograms", raw=None, cells=None, optics=chosen.optics or optics
    )
    before = frames_in(state)
    newest = Newest()

    def work(task: Task) -> Outcome:
        phase_colours(0.0, 1.0)  # loads the library of colours, which the first picture needs
        found = watch(
            source,
            recipe,
            out,
            frames=frames,
            patience_s=patience_s,
            begun=newest.begin,
            arrived=newest.put,
            told=newest.tell,
            status=newest.status,
            stopped=stopped,
            **task.calls,
        )
        assert found.recording is not None  # it was watched
        found.recording.holograms[:1].compute()  # loads what reads it, which takes a while
        # As it lies there, so that what is made of it later does not go into that folder.
        return replace(read_outcome(out), recording=found.recording, recipe=found.recipe)

    def receive(outcome: Outcome) -> Iterator[None]:
        if not all(map(operator.is_, before, frames_in(state))):
            msg = f"another recording was opened meanwhile; the results are in {out}: open that"
            raise ValueError(msg)
        yield from taking_watched(state, outcome)

    name = as_path(source.folder if isinstance(source, FromCamera) else source).name
    return Plan(
        f"Watching {name}",
        work,
        receive,
        parts=newest,
        receive_part=partial(state.live_changed.emit),
        step=StepNumber.RECORDING,
    )


def frames_in(state: State) -> tuple[Any, Any]:
    """Return the holograms and the phase that there are; another microscope leaves them."""
    recording, data = state.recording, state.reconstruction
    return (
        None if recording is None else recording.holograms.data,
        None if data is None else data["phase"].data,
    )


def taking_watched(state: State, outcome: Outcome) -> Iterator[None]:
    """Take a recording that is complete, then its phase, then its results."""
    assert outcome.recording is not None  # it was watched
    chosen = state.brought.without(state.recipe)
    state.set_recording(outcome.recording, recipe=outcome.recipe, kind="holograms")
    state.brought.take_options(chosen, outcome.recipe)  # as methods along time do not start anew
    yield
    data = outcome.reconstruction
    modest = [m for m in outcome.recipe.methods if METHODS[m].streams]
    state.leave_place(find_place(state.recipe, phase_needs(modest, data["phase"].shape)))
    state.set_reconstruction(data, state.recipe)
    yield
    state.take_outcome(outcome)
    state.outcome_changed.emit()
