"""The paper's methods: from a thin frame along time, along the angle, and both in turn.

Section 2, steps 1 to 4: the maps are arranged from the optically thin one, which is unwrapped by
the initial method, to the thick ones; each next map is unwrapped pixel by pixel relative to the
one before; the maximum of this and the initial method is taken; the mask is applied. The result
of one pass is the initial method of the next.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block, Limits, Stack, block_at, is_same, room_in, widest
from napari_phase4d.stacks import AXES
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.unwrapping.alone import (
    FinishBlock,
    Framewise,
    Mask,
    Phase,
    Turns,
    lifted_turns,
    write_block,
    write_phase,
    written_alone,
)
from napari_phase4d.unwrapping.given import Given
from napari_phase4d.unwrapping.growing import coherence
from napari_phase4d.unwrapping.pieces import (
    Last,
    Line,
    Maps,
    first_turns,
    last_known,
    next_turns,
    unwrap_line,
)

__all__ = [
    "ORDERS",
    "AlongAngle",
    "Chain",
    "Last",
    "along_time",
    "angular",
    "angular_temporal",
    "onwards",
    "spatial_2d",
    "starts_on",
    "temporal",
    "temporal_angular",
]

TURN = np.float32(2 * np.pi)
ALL = slice(None)
Boundary = tuple[int, int]
Check = Callable[[], None]

#: Dimensions that each of these methods goes along, one after the other (Fig. 1).
ORDERS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "temporal-angular": ("time", "angle"),
        "angular-temporal": ("angle", "time"),
        "temporal": ("time",),
        "angular": ("angle",),
    }
)


class Chained(Framewise, Protocol):
    """What the paper's methods ask of a problem."""

    @property
    def shared(self) -> bool:
        """Whether other methods start from the frames that are unwrapped one by one as well."""

    @property
    def boundaries(self) -> list[Boundary]:
        """The thin frames (time, angle)."""

    def alone(self, task: Task) -> Stack:
        """Return the turns of all frames unwrapped one by one (step 1)."""

    def counted(self, task: Task) -> Stack:
        """Return the pixels to unwrap."""

    def shifts(
        self, progress: ProgressCall | None, cancelled: CancelledCall | None
    ) -> NDArray[np.intp]:
        """Return the shifts that register all frames (step 2), shape (time, angle, 2)."""


# ---- the methods -----------------------------------------------------------------------------


def spatial_2d(
    problem: Chained,
    result: Stack,
    task: Task,
    *,
    reliability: str = "herraez",
) -> list[Limits]:
    """Unwrap each frame by itself (step 1 of T/A and A/T).

    Parameters
    ----------
    problem : Chained
        What to unwrap.
    result : Stack
        Where the unwrapped phase goes.
    task : Task
        Who is told of it, and may stop it.
    reliability : str, optional
        What is joined first: "herraez", pixels of small second differences (default, and what
        the paper's methods start from), or "coherence", steps that are like those round them.

    Returns
    -------
    list of (float, float)
        Smallest and largest phase of every block, radians; none where nobody asks for them.
    """
    if reliability == "herraez" and not problem.finds_mask and not problem.shared:
        written_alone(problem, result, task)
        return []
    turns, mask = problem.alone(task), problem.counted(task)
    if reliability != "herraez":
        turns = lifted_turns(problem, mask, coherence, task)
    finish = FinishBlock(problem.given, turns, mask, result)
    return problem.each(finish, "writing", task)


def chained(
    problem: Chained,
    result: Stack,
    task: Task,
    *,
    order: tuple[str, ...],
    registration: bool = True,
    split: bool = True,
) -> list[Limits]:
    """Apply the building block along one dimension after the other (steps 3 and 4)."""
    shape = problem.given.shape
    # Along a single frame there is nothing to follow.
    order = tuple(dim for dim in order if shape[AXES.index(dim)] > 1)
    if not order:
        return spatial_2d(problem, result, task)
    before, mask = problem.alone(task), problem.counted(task)
    shifts = np.zeros((*shape[:2], 2), dtype=np.intp)
    if registration:
        shifts = problem.shifts(**task.calls)
    chain = Chain(problem.given, mask, shifts, problem.boundaries, split)
    for dim in order:
        message = f"unwrapping along {dim}"
        if dim == "angle" and dim == order[-1]:
            return problem.each(AlongAngle(chain, before, result, finishes=True), message, task)
        after = problem.store.temporary(f"along_{dim}", shape, "int16")
        if dim == "angle":
            problem.each(AlongAngle(chain, before, after), message, task)
        else:
            along_time(chain, before, after, Watch(shape[1], message, task))
        before = after
    finish = FinishBlock(problem.given, before, mask, result)
    return problem.each(finish, "writing", task)


#: Along the angle at each time ([11] in the paper).
angular = partial(chained, order=ORDERS["angular"])
#: Along time for each angle.
temporal = partial(chained, order=ORDERS["temporal"])
#: T/A: along time for each angle, then along the angle at each time (Fig. 1a).
temporal_angular = partial(chained, order=ORDERS["temporal-angular"])
#: A/T: along the angle at each time, then along time for each angle (Fig. 1b).
angular_temporal = partial(chained, order=ORDERS["angular-temporal"])


def starts_on(dim: str, other: int, boundaries: list[Boundary]) -> list[int]:
    """Return where on a line of frames the thin ones are.

    A boundary frame counts for its own line; a line without one starts where the others do, as
    Fig. 1 shows: the first pass leaves the row of the boundary time (or angle) from which the
    second starts.

    Parameters
    ----------
    dim : str
        "time" or "angle", along which the line goes.
    other : int
        Number of the line: of its angle, if it goes along time, else of its time.
    boundaries : list of (int, int)
        Thin frames (time, angle).
    """
    along, across = (0, 1) if dim == "time" else (1, 0)
    own = sorted({b[along] for b in boundaries if b[across] == other})
    return own or sorted({b[along] for b in boundaries})


# ---- one pass --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Chain:
    """What all passes of a method need.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    mask : Stack
        Pixels to unwrap.
    shifts : ndarray of int, shape (time, angle, 2)
        How frames are moved, so that the object stays in place.
    boundaries : list of (int, int)
        Thin frames (time, angle).
    split : bool
        Whether a line that gets thick and thin again is broken into monotonic pieces (last
        paragraph of section 2).
    """

    given: Given
    mask: Stack
    shifts: NDArray[np.intp]
    boundaries: list[Boundary]
    split: bool

    def read(
        self, block: Block, turns: Stack, angles: slice = ALL
    ) -> tuple[list[list[Maps]], Mask]:
        """Return what is known of the frames of a block, by time and angle; what counts at all."""
        wrapped, mask, usable = self.given.read_marked(block, self.mask, angles)
        shifts = self.shifts[block.start : block.stop, angles].tolist()
        known = [[bool(frame.any()) for frame in of_time] for of_time in usable]
        of_times = zip(wrapped, turns.read(block, angles), mask, shifts, known, strict=True)
        maps = [[Maps(*frame) for frame in zip(*of_time, strict=True)] for of_time in of_times]
        return maps, usable


@dataclass(frozen=True)
class AlongAngle:
    """One pass along the angle at each time of a block.

    Parameters
    ----------
    chain : Chain
        What all passes need.
    initial, result : Stack
        Turns of the initial method, and where those of the result go.
    finishes : bool, optional
        Whether the result is the unwrapped phase itself. Default False: its turns.
    """

    chain: Chain
    initial: Stack
    result: Stack
    finishes: bool = False

    def __call__(self, block: Block) -> Limits:
        """Do a block; return its smallest and largest number."""
        chain, limits = self.chain, []
        found = room_in(self.result, block, np.float32 if self.finishes else np.int16)
        every, usable = chain.read(block, self.initial)
        room = np.empty(found.shape[1:], np.int16) if self.finishes else None
        for i, maps in enumerate(every):
            starts = starts_on("angle", block.start + i, chain.boundaries)
            turns = found[i] if room is None else room
            write = partial(self._write, found[i])
            line = Line(len(maps), maps.__getitem__, turns.__getitem__, write)
            unwrap_line(line, starts, split=chain.split)
            limits.append((float(found[i].min()), float(found[i].max())))
        if self.finishes:
            return write_block(chain.given, self.result, block, found, usable, widest(limits))
        self.result.write(block, found)
        return widest(limits)

    def _write(self, out: Phase | Turns, k: int, maps: Maps, turns: Turns) -> None:
        """Write a finished map, its phase if this finishes, among those of its time."""
        if self.finishes:
            write_phase(maps.wrapped, turns, maps.mask, out[k])
        elif not is_same(out[k], turns):
            out[k] = turns


def along_time(chain: Chain, initial: Stack, result: Stack, watch: Watch) -> None:
    """Do a pass along time, each angle in a thread of its own.

    One frame follows from the other, so that it is done right here, not on a cluster.

    Parameters
    ----------
    chain : Chain
        What all passes need.
    initial, result : Stack
        Turns of the initial method, and where those of the result go.
    watch : Watch
        Counts angles.
    """

    def work(angle: int) -> None:
        maps = MapsOfAngle(chain, initial, result, angle)
        line = Line(chain.given.shape[0], maps.read, maps.room, maps.write)
        unwrap_line(
            line,
            starts_on("time", angle, chain.boundaries),
            split=chain.split,
            check=watch.check,
        )
        maps.finish()

    for _ in in_threads(work, range(chain.given.shape[1]), watch, wait=True):
        pass


def onwards(chain: Chain, initial: Stack, result: Stack, before: list[Last]) -> list[Last]:
    """Do more of a pass along time, from a thin frame on, as frames come; not split into pieces.

    Parameters
    ----------
    chain : Chain
        What all passes need, of the frames that came.
    initial, result : Stack
        Turns of the initial method, and where those of the result go.
    before : list of (Maps, ndarray)
        What this gave for the frames before, empty at the beginning.

    Returns
    -------
    list of (Maps, ndarray)
        The last map of each angle, and its turns.
    """
    return [
        carried_on(
            MapsOfAngle(chain, initial, result, angle),
            chain.given.shape[0],
            before[angle] if before else None,
        )
        for angle in range(chain.given.shape[1])
    ]


def carried_on(maps: MapsOfAngle, n: int, before: Last | None) -> Last:
    """Unwrap n maps of an angle after the one before, or from their first one on."""
    for k in range(n):
        now = maps.read(k)
        if before is None:
            found = first_turns(now)
        else:
            found = maps.room(k)
            next_turns(before, now, found)
        maps.write(k, now, found)
        before = (now, found) if before is None else last_known(before, (now, found))
    maps.finish()
    assert before is not None  # there is one frame at least
    last, turns = before
    return last, turns.copy()  # they lie in the result


class MapsOfAngle:
    """The maps of one angle over time, of which a block is held, and what was found in it.

    Parameters
    ----------
    chain, initial, result
        See `along_time`.
    angle : int
        Number of the angle.
    """

    def __init__(self, chain: Chain, initial: Stack, result: Stack, angle: int) -> None:
        self._chain, self._initial, self._result = chain, initial, result
        self._angle = slice(angle, angle + 1)
        self._block = self._found = Block(0, 0)
        self._held: list[list[Maps]]
        #: What was found, of which as much as `_found` says has not been written.
        self._room: Turns
        self._room_of = Block(0, 0)

    def read(self, k: int) -> Maps:
        """Return what is known of map k."""
        if k not in self._block.times:
            self._block = block_at(self._chain.given.shape, k)
            self._held, _ = self._chain.read(self._block, self._initial, self._angle)
        return self._held[k - self._block.start][0]

    def room(self, k: int) -> Turns:
        """Return where the turns of map k go, which are written with those beside it."""
        start, stop = self._found.start, self._found.stop
        if not (k in self._room_of.times and start - 1 <= k <= stop):
            self.finish()
            self._room_of, self._found = block_at(self._chain.given.shape, k), Block(k, k)
            self._room = room_in(self._result, self._room_of, np.int16, self._angle)
        found: Turns = self._room[k - self._room_of.start, 0]
        return found

    def write(self, k: int, maps: Maps, turns: Turns) -> None:
        """Take the turns of the finished map k."""
        room = self.room(k)
        if not is_same(room, turns):
            room[...] = turns
        self._found = Block(min(self._found.start, k), max(self._found.stop, k + 1))

    def finish(self) -> None:
        """Write what has not been written."""
        if len(self._found):
            found = self._room[self._found.of(self._room_of)]
            self._result.write(self._found, found, self._angle)
        self._found = Block(0, 0)
