"""Frames of a recording that grows: how they are waited for, and what the first ones settle.

What is told meanwhile, too. Lobes, background, the view to start from and the recipe are settled
on the first frames. A run with that recipe gives the same numbers for the finished recording:
whatever looks at frames from all over a recording looks at the first ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography import (
    FrameReconstructor,
    PhaseSettings,
    find_lobes,
    frame_reconstructor,
    light_of,
    reconstruct_frames,
    warn_of_doubts,
)
from napari_phase4d.io import Arrival, ArrivedFrames, Arriving, recording_of
from napari_phase4d.io.lazy import lazy_frames
from napari_phase4d.io.video import Video
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import opened_reference, phase_settings
from napari_phase4d.pipeline.starting import found_anywhere, lobes_of, open_by, typed_into
from napari_phase4d.recording import Recording
from napari_phase4d.task import Cancelled, CancelledCall, Task
from napari_phase4d.unwrapping import (
    check_light,
    checked_boundaries,
    for_what_comes,
    scores_of_some,
)
from napari_phase4d.warned import warn
from napari_phase4d.words import counted

__all__ = [
    "FIRST_FRAMES",
    "Feed",
    "Listener",
    "LiveStatus",
    "Settled",
    "check_live",
    "recording_at_the_end",
    "settle",
    "stacked",
]

#: Seconds between two looks at what is there where nothing tells of it; a look may take a tenth of
#: the time.
LOOK_S, SHARE_OF_LOOKING = 0.03, 0.1
#: Seconds between two lines that say how far it is.
LINE_S = 1.0


@dataclass(frozen=True)
class LiveStatus:
    """How far the work on a growing recording is.

    Parameters
    ----------
    seen : int
        Frames that were announced so far, those that never came included.
    done : int
        Frames that are done, or were given up.
    lost : int
        Frames among them that never came, or could not be read.
    low, high : float
        Smallest and largest phase of the last frames, by the method that is shown, in radians;
        NaN as long as there is none.
    delay_s : float
        Seconds from when the last of them was seen until it was done; NaN before the first.

    See Also
    --------
    watch : Tells it.

    Examples
    --------
    >>> from napari_phase4d.pipeline import LiveStatus
    >>> print(LiveStatus(seen=12, done=10, lost=1, low=-0.5, high=7.25, delay_s=0.2).sentence)
    12 frames seen, 10 done, 2 behind, 1 dropped, phase -0.5 to 7.2 rad, 0.20 s late
    """

    seen: int = 0
    done: int = 0
    lost: int = 0
    low: float = float("nan")
    high: float = float("nan")
    delay_s: float = float("nan")

    @property
    def behind(self) -> int:
        """How many frames wait."""
        return self.seen - self.done

    @property
    def sentence(self) -> str:
        """All of it in one line."""
        known = self.low == self.low
        phase = f", phase {self.low:.1f} to {self.high:.1f} rad" if known else ""
        late = f", {self.delay_s:.2f} s late" if self.delay_s == self.delay_s else ""
        return (
            f"{counted(self.seen, 'frame')} seen, {self.done} done, {self.behind} behind, "
            f"{self.lost} dropped{phase}{late}"
        )


class Listener:
    """Tells how far it is, and asks whether to go on.

    Parameters
    ----------
    told : callable, optional
        ``told(line)``: what happened to a frame, in words.
    status : callable, optional
        ``status(LiveStatus)``, once a second.
    stopped : callable, optional
        See `watch`.
    task : Task
        Who may stop it.
    """

    def __init__(
        self,
        told: Callable[[str], None] | None,
        status: Callable[[LiveStatus], None] | None,
        stopped: CancelledCall | None,
        task: Task,
    ) -> None:
        self._told, self._status = told, status
        self._stopped, self._cancelled = stopped, task.cancelled
        self._next_line = time.monotonic() + LINE_S
        #: How far it is.
        self.now = LiveStatus()
        #: What happened to the recording that its results should not be seen without.
        self.notes: list[str] = []

    def tell(self, line: str) -> None:
        """Say something that happened."""
        if self._told is not None:
            self._told(line)

    def insist(self, line: str) -> None:
        """Say what must not be missed: a warning, where nobody is told."""
        if self._told is None:
            warn(line)
        self.tell(line)

    def note(self, line: str) -> None:
        """Insist on what happened to the recording, and keep it for the end."""
        self.insist(line)
        self.notes.append(f"{line[:1].upper()}{line[1:]}.")

    def heed(self, arriving: Arriving) -> None:
        """Say what there is to say, and raise `Cancelled` if nothing more is wished for."""
        while arriving.notes:
            self.tell(arriving.notes.pop(0))
        self.now = replace(self.now, seen=arriving.seen, lost=len(arriving.lost))
        if time.monotonic() >= self._next_line:
            self.line()
        if self._cancelled is not None and self._cancelled():
            msg = f"watching {arriving.path.name}: cancelled after {self.now.done} frames"
            raise Cancelled(msg)

    def line(self) -> None:
        """Say how far it is."""
        self._next_line = time.monotonic() + LINE_S
        if self._status is not None:
            self._status(self.now)

    def wishes_end(self) -> bool:
        """Say whether the recording is to be taken as complete."""
        return self._stopped is not None and self._stopped()


class Feed:
    """Gives frames in their order as they come, until no more are to be waited for.

    Parameters
    ----------
    arriving : Arriving
        What arrives.
    frames : int or None
        How many to wait for.
    patience_s : float
        Seconds without anything new after which the recording is taken as complete.
    listener : Listener
        Who is told, and asked.
    """

    def __init__(
        self, arriving: Arriving, frames: int | None, patience_s: float, listener: Listener
    ) -> None:
        self.arriving, self.listener = arriving, listener
        self._frames, self._patience_s = frames, patience_s
        self._last_new = time.monotonic()
        self._next_look = 0.0
        #: How many frames there are, once that is known.
        self._end: int | None = None
        self._told_anew = False

    def gather(self, n_frames: int) -> list[Arrival]:
        """Return the first frames: so many, or some more, if they come."""
        # What counts them shows in the names of several.
        while not self._ended() and self.arriving.seen < self._wanted(n_frames):
            self._look()
        found: list[Arrival] = []
        for batch in self.batches(n_frames):
            found += batch
            if len(found) >= n_frames:
                break
        return found

    def batches(self, at_most: int) -> Iterator[list[Arrival]]:
        """Yield the frames that are there by now, so many at a time at most, until the end."""
        while True:
            self.listener.heed(self.arriving)
            if not self._ended() or self.arriving.held:
                self._poll()
            limit = self.arriving.seen if self._end is None else self._end
            wanted = min(at_most, self._wanted(limit) - self.arriving.taken)
            batch = self.arriving.take(wanted) if wanted > 0 else []
            if batch:
                self._last_new = time.monotonic()
                yield batch
            elif self._complete(limit):
                self.listener.heed(self.arriving)
                return
            else:
                self._rest()

    def _wanted(self, n_frames: int) -> int:
        """Return how many of so many frames are wanted."""
        return n_frames if self._frames is None else min(n_frames, self._frames)

    def _complete(self, limit: int) -> bool:
        """Say whether nothing is waited for any more."""
        enough = self._frames is not None and self.arriving.taken >= self._frames
        return enough or (self._end is not None and self.arriving.taken >= limit)

    def _look(self) -> None:
        """Look what is there, and wait a little."""
        self._poll()
        self.listener.heed(self.arriving)
        self._rest()

    def _rest(self) -> None:
        """Wait for what comes next, but not before it is time for the next look."""
        pause = min(LOOK_S, max(0.0, self._next_look - time.monotonic()))
        time.sleep(pause)
        self.arriving.wait(LOOK_S - pause)

    def _poll(self) -> None:
        """Look what is there, not too often where that takes a while, as in large folders."""
        began = time.monotonic()
        if began < self._next_look:
            return
        if self.arriving.poll():
            self._last_new = time.monotonic()
        ended = time.monotonic()
        self._next_look = ended + (ended - began) / SHARE_OF_LOOKING

    def _ended(self) -> bool:
        """Say whether frames that come from now on are not waited for."""
        late = time.monotonic() - self._last_new > self._patience_s
        if self._end is None and (late or self.listener.wishes_end()):
            self.arriving.poll()
            self._end = self.arriving.seen
            self.listener.tell("no more frames are waited for; what has come is finished")
        if self.arriving.begun_anew and not self._told_anew:
            self._told_anew, self._end = True, self.arriving.taken
            self.listener.note(anew_sentence(self.arriving.path.name))
        return self._end is not None


def anew_sentence(name: str) -> str:
    """Say that another recording has been begun in the place of one."""
    return (
        f"an acquisition has begun anew in {name}: its first frame is another one by now. What "
        "came before is finished, as far as it had been read; watch the new one by itself"
    )


# ---- what is settled on the first frames ----------------------------------------------------


#: Frames on which all is settled, unless the recipe says it.
FIRST_FRAMES = 8


@dataclass(frozen=True)
class Settled:
    """What no later frame changes.

    Parameters
    ----------
    recipe : Recipe
        All settings; a run with it gives the same numbers.
    first : Recording
        The first frames.
    facts : Video
        What the file says of pixel and frame rate.
    work : FrameReconstructor
        What turns a frame into phase and amplitude.
    """

    recipe: Recipe
    first: Recording
    facts: Video
    work: FrameReconstructor


def check_live(recipe: Recipe) -> None:
    """Refuse settings that a growing recording can't be worked on with.

    Raises
    ------
    ValueError
        In one sentence that says what to do.
    """
    reference = recipe.reference
    n_first = recipe.first_frames or FIRST_FRAMES
    faults: dict[str, object] = {
        "how far to trust a frame hangs on frames that come later; leave confidence out, and run "
        "the recipe on the finished recording for it": recipe.confidence,
        "wrapped phase can't be watched; give a recording of holograms": recipe.content == "phase",
        "raw files can't be watched, as nothing in them says where a frame ends": recipe.raw,
        f"reference frame {reference} is not among the first {n_first}, which is all that is "
        "known when the first phase is shown; give one of these, or a file": isinstance(
            reference, int
        )
        and not 0 <= reference < n_first,
        "frames that come are unwrapped from the first one on; give a boundary at time 0, such as "
        '((0, 0),), or "auto"': recipe.boundary != "auto"
        and any(frame for frame, _ in recipe.boundary),
    }
    for fault, is_there in faults.items():
        if is_there:
            raise ValueError(fault)


def stacked(arrivals: Sequence[Arrival], arriving: Arriving) -> NDArray[np.generic]:
    """Return the frames that arrived (time, y, x); black where one never came."""
    assert arriving.shape is not None  # a frame has been read
    black = np.zeros(arriving.shape, arriving.dtype)
    return np.stack([black if each.frame is None else each.frame for each in arrivals])


def settle(
    recipe: Recipe,
    arriving: Arriving,
    arrivals: Sequence[Arrival],
    task: Task,
    numbers: Mapping[str, float],
) -> Settled:
    """Settle on the first frames what holds for all; ``numbers`` of the microscope were typed in.

    Raises
    ------
    OSError, ValueError
        If no frame came, or a setting does not fit them.
    """
    source = str(arriving.path)
    if not arrivals:
        msg = f"no frame came to {source}; is the recording written there?"
        raise OSError(msg)
    if arriving.shape is None:
        why = arrivals[0].why
        msg = f"no frame of {arriving.path.name} can be read: frame {arriving.label(0)} {why}"
        raise OSError(msg)
    facts = facts_of(arriving)
    frames = stacked(arrivals, arriving)
    first = recording_of(
        replace(facts, frames=frames, times_s=None, axes=""),
        arriving.path.name,
        source,
        None if numbers else recipe.optics,
        recipe.frame_rate_hz,
    )
    if numbers:
        first = first.calibrated(typed_into(recipe.optics, numbers, first))
    lobes = lobes_of(recipe) or find_lobes(
        first,
        recipe.wanted_views,
        angles_deg=recipe.angles_deg,
        wavelengths_um=recipe.wavelengths_um,
        cancelled=task.cancelled,
    )
    warn_of_doubts(lobes, first.name)
    check_light(recipe.methods, *light_of(lobes, first.optics.wavelength_um))
    if recipe.boundary != "auto":  # its times are checked where frames are unwrapped
        views = [(0, view) for _, view in recipe.start_frames]
        checked_boundaries(views, (len(frames), len(lobes)))
    used = recipe.changed(
        recording=found_anywhere(source),
        content="holograms",
        lobes=tuple(lobes),
        optics=first.optics,
        first_frames=len(frames),
        options=for_what_comes(recipe.options),
    )
    chosen = PhaseSettings(opened_reference(used, first), **phase_settings(used))
    work = frame_reconstructor(first, lobes, chosen, task)
    used = used.changed(refocus_um=work.attrs.get("refocus_um"))
    if used.boundary == "auto":
        used = used.changed(boundary=((0, safest_view(work, first, task)),))
    return Settled(used, first, facts, work)


def safest_view(work: FrameReconstructor, first: Recording, task: Task) -> int:
    """Return the view of the first frame that is safest to start from."""
    phase = reconstruct_frames(work, first, task.quiet)["phase"]
    if phase.isel(time=0).isnull().all():
        return 0
    scores = scores_of_some(phase, task.quiet).values[0]
    return 0 if np.isnan(scores).all() else int(np.nanargmax(scores))


def facts_of(arriving: Arriving) -> Video:
    """Return what a file says of pixel and frame rate; nothing where it is not whole yet."""
    with suppress(OSError, ValueError):
        return arriving.facts()
    return Video(None)


def recording_at_the_end(settled: Settled, arriving: Arriving) -> Recording:
    """Return the recording as it is now: as a run opens it, if it holds what was watched.

    Otherwise it holds the frames that were watched, black where one never came or is gone.
    """
    recipe = settled.recipe
    if not arriving.lost and not arriving.gone:
        with suppress(OSError, ValueError):
            whole = open_by(recipe)
            if isinstance(whole, Recording) and whole.n_frames == arriving.taken:
                return whole
    frames = lazy_frames(ArrivedFrames(arriving))
    return recording_of(
        replace(settled.facts, frames=frames, times_s=None, axes=""),
        arriving.path.name,
        str(Path(recipe.recording)),
        recipe.optics,
        recipe.frame_rate_hz,
    )
