"""Frames unwrapped as they come, by methods that need nothing but the past.

Each frame by itself, along the angle at each time, and along time from the first frame on: the
steps of `alone`, `frames` and `chain`, on the frames that have just come instead of on all.
The numbers are those of the same methods on the finished recording, to the last bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block, InMemory, Stack
from napari_phase4d.task import CancelledCall, Task, Watch, in_threads
from napari_phase4d.unwrapping.alone import (
    FindBlock,
    FinishBlock,
    Lifted,
    Mask,
    Phase,
    Turns,
    UnwrapBlock,
)
from napari_phase4d.unwrapping.chain import ORDERS, AlongAngle, Chain, Last, onwards
from napari_phase4d.unwrapping.frames import (
    centre_of_mass_shifts,
    lift_of,
    likeness,
    next_shift,
    says_nothing,
)
from napari_phase4d.unwrapping.given import Counted, Given
from napari_phase4d.unwrapping.growing import coherence
from napari_phase4d.unwrapping.running import all_options, check_method, options_by_id

__all__ = ["CAUSAL", "Causal", "causal_methods", "for_what_comes"]

#: Methods that give the phase of a frame without looking at those after it.
CAUSAL = ("spatial-2d", *ORDERS)
R = TypeVar("R")


def for_what_comes(options: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return options with which the methods along time need the past only.

    A line over time is otherwise started anew where the object has become as thin again, and that
    is known only once it has grown thick again: ``split`` is set to False.

    Parameters
    ----------
    options : mapping
        Method id to that method's options.

    Returns
    -------
    dict of str to dict
        The same options, and those of every method that goes along time.

    Examples
    --------
    >>> from napari_phase4d.unwrapping import for_what_comes
    >>> for_what_comes({"temporal": {"registration": False}})["temporal"]
    {'registration': False, 'split': False}
    """
    found = {method: dict(own) for method, own in options.items()}
    for method, order in ORDERS.items():
        if "time" in order:
            found[method] = {**found.get(method, {}), "split": False}
    return found


def causal_methods(
    methods: Iterable[str], options: Mapping[str, Mapping[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Return those of some methods that need the past only, with all their options.

    Parameters
    ----------
    methods : iterable of str
        Ids or labels among `METHODS`.
    options : mapping
        Id or label of a method to that method's options.

    Returns
    -------
    dict of str to dict
        Method id to all its options, those not given by their default. T/A, A/T and Temporal are
        among them only with ``split`` False.
    """
    own = options_by_id(options)
    chosen = (check_method(m, {}) for m in methods)
    found = {m: all_options(m, own.get(m, {})) for m in chosen if m in CAUSAL}
    return {
        method: own
        for method, own in found.items()
        if "time" not in ORDERS.get(method, ()) or not own["split"]
    }


@dataclass(frozen=True)
class Batch:
    """Frames that came together, each found by itself.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    turns, mask, object : Stack
        Turns of each frame by itself, the pixels to unwrap, and the object.
    centres : ndarray of shape (time, angle, 2)
        Centre of the object in pixels, NaN where there is none.
    """

    given: Given
    turns: Stack
    mask: Stack
    object: Stack
    centres: NDArray[np.float64]


@dataclass
class Levels:
    """The levels of the borders of all frames so far, by which each is lifted by whole turns.

    They are a number a frame and angle, and are unwrapped together, as of a finished recording.
    """

    first: tuple[int, int]
    borders: list[NDArray[np.float64]] = field(default_factory=list)

    def lift(self, borders: list[NDArray[np.float64]]) -> Turns:
        """Return the turns to add to the frames that have just come, shape (time, angle)."""
        self.borders = [np.concatenate([*self.borders, *borders])]
        return lift_of(self.borders[0], self.first)[-sum(map(len, borders)) :]


class Registration:
    """Finds how to move each frame, as `centre_of_mass_shifts` does, as frames come.

    Parameters
    ----------
    first : tuple of int
        Boundary frame (time, angle), its time 0.
    """

    def __init__(self, first: tuple[int, int]) -> None:
        self.first = first
        self._begun = False
        #: Where the object is in the boundary frame.
        self._home = np.full(2, np.nan)
        #: Phase and object of the last known frame (1, angle, y, x), and its shifts.
        self._last: tuple[Phase, Mask, NDArray[np.intp]]

    def shifts(
        self, wrapped: Phase, found: Mask, centres: NDArray[np.float64]
    ) -> NDArray[np.intp]:
        """Return the shifts of frames that follow those before, shape (time, angle, 2)."""
        shifts = np.zeros((*wrapped.shape[:2], 2), dtype=np.intp)
        for place in range(len(wrapped)):
            now = slice(place, place + 1)
            if not self._begun:
                watch = Watch(wrapped.shape[1], "registration")
                shifts[now] = centre_of_mass_shifts(
                    wrapped[now], found[now], self.first, watch, centres[now]
                )
                self._home, self._begun = centres[self.first], True
                self._last = wrapped[now].copy(), found[now].copy(), shifts[place]
            else:
                shifts[place] = self._after_last(wrapped[now], found[now], centres[place])
                self._keep(wrapped[now], found[now], shifts[place], centres[place])
        return shifts

    def _keep(
        self, wrapped: Phase, found: Mask, shifts: NDArray[np.intp], centres: NDArray[np.float64]
    ) -> None:
        """Hold a frame, but that before it of views of which nothing is known in it."""
        last_wrapped, last_found, _ = self._last
        known = [not says_nothing(*view) for view in zip(centres, wrapped[0], strict=True)]
        last_wrapped[:, known], last_found[:, known] = wrapped[:, known], found[:, known]
        self._last = last_wrapped, last_found, shifts

    def _after_last(
        self, wrapped: Phase, found: Mask, centres: NDArray[np.float64]
    ) -> NDArray[np.intp]:
        """Return the shifts of the frame after the last one, shape (angle, 2)."""
        last_wrapped, last_found, kept = self._last
        phases = np.concatenate([last_wrapped, wrapped])
        objects = np.concatenate([last_found, found])

        def shift_of(angle: int) -> NDArray[np.intp]:
            return next_shift(
                self._home - centres[angle],
                kept[angle],
                lambda s: likeness(phases, objects, (1, angle), s, (0, angle), kept[angle]),
            )

        return np.stack([shift_of(angle) for angle in range(len(kept))])


class Causal:
    """Unwraps frames in the order in which they come.

    Of the frames before, the last one is held, and a few numbers of each.

    Parameters
    ----------
    methods : mapping
        Id of each method to its options, see `causal_methods`.
    boundaries : sequence of (int, int)
        Thin frames (time, angle), all at time 0.
    finds_mask : bool
        Whether the object is what is to be unwrapped; else the whole field.

    Attributes
    ----------
    n_frames : int
        How many frames came so far.
    all_usable : bool
        Whether the phase of all of them was known everywhere.
    seconds : dict of str to float
        What each method took, with the steps that it shares with others.

    Raises
    ------
    ValueError
        If a thin frame is not at time 0.
    """

    def __init__(
        self,
        methods: Mapping[str, Mapping[str, Any]],
        boundaries: Sequence[tuple[int, int]],
        *,
        finds_mask: bool,
    ) -> None:
        if any(frame for frame, _ in boundaries):
            msg = (
                f"frames that come are unwrapped from the first one on, but boundary is "
                f"{tuple(boundaries)}; give time 0, such as ((0, 0),)"
            )
            raise ValueError(msg)
        self.methods = methods
        self.boundaries = list(boundaries)
        self.finds_mask = finds_mask
        self.n_frames = 0
        self.all_usable = True
        self.seconds = dict.fromkeys(methods, 0.0)
        first = self.boundaries[0]
        self._levels, self._ordered = Levels(first), Levels(first)
        self._registration = Registration(first)
        self._along: dict[tuple[str, int], list[Last]] = {}
        self._left_out: list[NDArray[np.float64]] = []

    @property
    def smooth_left_out(self) -> NDArray[np.float64]:
        """Share of each frame that "object only" leaves out though it is smooth, see `Found`."""
        if not self.finds_mask or not self._left_out:
            return np.zeros((0, 0))
        self._left_out = [np.concatenate(self._left_out)]
        return self._left_out[0]

    def more(
        self, wrapped: NDArray[np.float32], cancelled: CancelledCall | None = None
    ) -> dict[str, NDArray[np.float32]]:
        """Return the unwrapped phase of the next frames, by each method.

        Parameters
        ----------
        wrapped : ndarray of shape (time, angle, y, x)
            Wrapped phase in radians of the frames after those before, NaN where it is not known.
        cancelled : callable, optional
            Stops the work; nothing more can be unwrapped then.
        """
        if not self.methods:
            return {}
        began = time.perf_counter()
        each = Each(len(wrapped), cancelled)
        batch = self._alone(Given(InMemory(wrapped)), each)
        shifts = self._registration.shifts(
            batch.given.read(each.all)[0], batch.object.read(each.all), batch.centres
        )
        found, shared = {}, time.perf_counter() - began
        for method in self.methods:
            began = time.perf_counter()
            result = InMemory(np.empty_like(wrapped))
            turns = self._turns(method, batch, shifts, each)
            each(FinishBlock(batch.given, turns, batch.mask, result))
            found[method] = result.values
            self.seconds[method] += shared + time.perf_counter() - began
        self.n_frames += len(wrapped)
        return found

    def _alone(self, given: Given, each: Each) -> Batch:
        """Unwrap each frame by itself, and find the object, as `each_alone` does."""
        turns = empty(given, np.int16)
        borders, whole = zip(*each(UnwrapBlock(given, turns)), strict=True)
        lifted = Lifted(turns, self._levels.lift([*borders]))
        found = empty(given, bool)
        mask: Stack = found if self.finds_mask else Counted(given)
        done = each(FindBlock(given, lifted, found, self.finds_mask))
        centres, shares = (np.concatenate([part[i] for part in done]) for i in (0, 1))
        self._left_out.append(shares)
        self.all_usable = self.all_usable and all(whole)
        return Batch(given, lifted, mask, found, centres)

    def _by_coherence(self, batch: Batch, each: Each) -> Stack:
        """Return the turns of each frame by itself in another order, as `lifted_turns` does."""
        turns = empty(batch.given, np.int16)
        borders = [
            border for border, _ in each(UnwrapBlock(batch.given, turns, batch.mask, coherence))
        ]
        return Lifted(turns, self._ordered.lift(borders))

    def _turns(self, method: str, batch: Batch, shifts: NDArray[np.intp], each: Each) -> Stack:
        """Return the turns that a method finds."""
        options = self.methods[method]
        if method not in ORDERS:
            if options["reliability"] == "herraez":
                return batch.turns
            return self._by_coherence(batch, each)
        if not options["registration"]:
            shifts = np.zeros_like(shifts)
        chain = Chain(batch.given, batch.mask, shifts, self.boundaries, options["split"])
        before = batch.turns
        for place, dim in enumerate(ORDERS[method]):
            after = empty(batch.given, np.int16)
            if dim == "angle":
                each(AlongAngle(chain, before, after))
            else:
                last = self._along.get((method, place), [])
                self._along[method, place] = onwards(chain, before, after, last)
            before = after
        return before


class Each:
    """Does some work on each of some frames, on all cores.

    Parameters
    ----------
    n : int
        How many frames there are.
    cancelled : callable or None
        Stops the work.
    """

    def __init__(self, n: int, cancelled: CancelledCall | None) -> None:
        self.all = Block(0, n)
        self._blocks = [Block(frame, frame + 1) for frame in range(n)]
        self._cancelled = cancelled

    def __call__(self, work: Callable[[Block], R]) -> list[R]:
        """Return what some work gives for every frame."""
        if len(self._blocks) == 1:
            return [work(self._blocks[0])]
        watch = Watch(len(self._blocks), "unwrapping", Task(None, self._cancelled))
        return list(in_threads(work, self._blocks, watch, wait=True))


def empty(given: Given, dtype: Any) -> InMemory:
    """Return a new stack of the shape of wrapped phase."""
    return InMemory(np.zeros(given.shape, dtype))
