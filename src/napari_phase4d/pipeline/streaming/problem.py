"""Unwrapping phase that lies on disk, a block of frames at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from napari_phase4d.pipeline.streaming.chaining import AlongAngle, AlongTime, Chain, FinishBlock
from napari_phase4d.pipeline.streaming.spatial import (
    LiftBlock,
    UnwrapBlock,
    with_turns,
    without_lost,
)
from napari_phase4d.pipeline.streaming.stored import Limits, Shelf, Stored, limits_of, widest
from napari_phase4d.pipeline.streaming.workers import Threads, Workers
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch
from napari_phase4d.stack import Block, FileStack, KeptFrames, blocks_of
from napari_phase4d.unwrapping import (
    METHODS,
    ORDERS,
    Problem,
    SharedSteps,
    all_options,
    is_known,
    noted,
    run_method,
)
from napari_phase4d.unwrapping.background import Background, background_of, lost_of
from napari_phase4d.unwrapping.directional import OWN
from napari_phase4d.unwrapping.given import Given
from napari_phase4d.unwrapping.growing import coherence
from napari_phase4d.unwrapping.masks import left_out_note
from napari_phase4d.unwrapping.problem import (
    Boundary,
    all_known,
    brightness_of,
    checked_boundaries,
    relative_amplitude,
)
from napari_phase4d.unwrapping.registration import centre_of_mass_shifts
from napari_phase4d.unwrapping.spatial import border_medians

__all__ = ["ProblemOnDisk"]

R = TypeVar("R")

TURN = 2 * np.pi


@dataclass(frozen=True)
class Found:
    """What two-dimensional unwrapping gave for all frames.

    Parameters
    ----------
    turns : FileStack
        Whole turns of each pixel.
    mask, object : FileStack
        Pixels to unwrap, and the object.
    centres : ndarray of shape (time, angle, 2)
        Centre of the object in pixels, NaN where there is none.
    mask_word : str
        What results note of the mask.
    smooth_left_out : float
        Mean share of the field that is no part of the object though its phase is smooth, not flat.
    """

    turns: FileStack
    mask: FileStack
    object: FileStack
    centres: NDArray[np.float64]
    mask_word: str
    smooth_left_out: float


class ProblemOnDisk:
    """Wrapped phase on disk, with the steps that several methods start from.

    It gives the same numbers as `Problem` and `run_method` in memory.

    Parameters
    ----------
    phase : xarray.DataArray
        Wrapped phase, dims (time, angle, y, x).
    stored : Stored
        Where it lies.
    shelf : Shelf
        Where results go.
    boundary : tuple of int or sequence of such
        See `unwrap`.
    finds_mask : bool
        Whether the object is what is to be unwrapped; else the whole field.
    amplitude : xarray.DataArray, optional
        For methods that look at it.
    workers : Workers, optional
        Who works on the blocks; default the threads of this machine.
    """

    def __init__(
        self,
        phase: xr.DataArray,
        stored: Stored,
        shelf: Shelf,
        boundary: Any,
        *,
        finds_mask: bool,
        amplitude: xr.DataArray | None = None,
        workers: Workers | None = None,
    ) -> None:
        self.phase = phase
        self.problem: Problem | None = None
        self.steps = SharedSteps()
        self._stored = stored
        self._shelf = shelf
        self._boundaries: list[Boundary] = checked_boundaries(boundary, stored.shape[:2])
        self._finds_mask = finds_mask
        self._amplitude = amplitude
        self._workers = Threads() if workers is None else workers
        self._blocks = blocks_of(stored.shape)
        #: The phase in memory, for methods that need all of it.
        self._whole: Problem | None = None

    def run(
        self,
        method: str,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
        options: Mapping[str, Any],
    ) -> xr.DataArray:
        """Unwrap by a method, see `unwrap`; the result lies on disk."""
        if not METHODS[method].streams:
            return self._in_memory(method, progress, cancelled, options)
        chosen = all_options(method, options)
        result = self._shelf.new(method, self._stored.shape)
        if method in OWN:
            return self._own(method, result, progress, cancelled, options)
        if method == "spatial-2d":
            turns = self._frame_by_frame(progress, cancelled, **chosen)
            limits = self._finish(turns, result, progress, cancelled)
        else:
            limits = self._chained(ORDERS[method], result, progress, cancelled, **chosen)
        found = self._found(progress, cancelled)
        attrs = noted(
            method,
            options,
            self._boundaries,
            mask=found.mask_word,
            amplitude=self._amplitude is not None,
        )
        if self._finds_mask:
            attrs |= left_out_note(found.smooth_left_out)
        return self._put(method, attrs, limits)

    def _own(
        self,
        method: str,
        result: Stored,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
        options: Mapping[str, Any],
    ) -> xr.DataArray:
        """Unwrap by one of the directional methods."""
        written = Written(result, self.given)
        OWN[method](self, written, progress, cancelled, **all_options(method, options))
        attrs = noted(
            method,
            options,
            self._boundaries,
            mask="auto" if self._finds_mask else "none" if written.all_known else "given",
            amplitude=self._amplitude is not None,
        )
        if self._finds_mask and self.steps.knows("spatial"):
            attrs |= left_out_note(self._found(progress, cancelled).smooth_left_out)
        if self.lost().any():
            attrs["lost_frames"] = np.argwhere(self.lost()).tolist()
        return self._put(method, attrs, widest(written.limits))

    # ---- what the directional methods ask for ----

    @property
    def given(self) -> Given:
        """The wrapped phase, 0 where it is not known, and the pixels that count."""
        return Given(self._stored)

    @property
    def store(self) -> Shelf:
        """Where stacks lie that are needed on the way."""
        return self._shelf

    @property
    def first(self) -> Boundary:
        """The first boundary frame."""
        return self._boundaries[0]

    @property
    def finds_mask(self) -> bool:
        """Whether the object is what is to be unwrapped."""
        return self._finds_mask

    def once(self, name: str, work: Callable[[], R]) -> R:
        """Return what ``work()`` returned when it was first asked for by this name."""
        return self.steps.once(name, work)

    def lost(self) -> NDArray[np.bool_]:
        """Mark the frames (time, angle) that say nothing of the object."""
        return self.once("lost", lambda: lost_of(self.given))

    def background(self) -> Background:
        """Return the empty field of every frame, and its level."""
        return self.once("background", lambda: background_of(self.given, self.lost(), self._shelf))

    def amplitude_of(self, block: Block) -> NDArray[np.float32] | None:
        """Return the amplitude of a block as a share of its view's median, or None."""
        if self._amplitude is None:
            return None
        data = self._amplitude.data
        bright = self.once("brightness", lambda: brightness_of(data))
        return relative_amplitude(np.asarray(data[block.start : block.stop]), bright)

    def settle_frames(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> None:
        """Unwrap each frame by itself, if that has not been done."""
        self._found(progress, cancelled)

    def frame_by_frame(self, block: Block) -> NDArray[np.float32]:
        """Return the phase of a block as each frame is unwrapped by itself."""
        found = self._found(None, None)
        wrapped, _ = self.given.read(block)
        return with_turns(wrapped, found.turns.read(block), found.mask.read(block))

    # ---- the paper's methods ----

    def _finish(
        self,
        turns: FileStack,
        result: Stored,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
    ) -> Limits:
        """Write unwrapped phase from its turns."""
        mask = self._found(progress, cancelled).mask
        finish = FinishBlock(self._stored, turns, mask, result)
        return widest(self._each(finish, "writing", progress, cancelled))

    def _in_memory(
        self,
        method: str,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
        options: Mapping[str, Any],
    ) -> xr.DataArray:
        """Unwrap by a method that needs all frames at once."""
        if self._whole is None:
            mask: Any = None
            if self._finds_mask:
                mask = "auto"
            elif not all_known(self.phase.values):
                mask = is_known(self.phase.values)
            self._whole = Problem(self.phase, self._boundaries, mask, self._amplitude)
        found = run_method(self._whole, method, progress, cancelled, options)
        self._whole.forget_field()
        return self._shelf.take(method, found, progress, cancelled)

    def _put(self, method: str, attrs: Mapping[str, Any], limits: Limits) -> xr.DataArray:
        """Give a result its name, axes and notes."""
        result = self.phase.copy(deep=False).rename(method)
        result.attrs = {**self.phase.attrs, "units": "rad", **attrs}
        return self._shelf.put(method, result, limits)

    def _each(
        self,
        work: Callable[[Block], R],
        message: str,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
    ) -> list[R]:
        """Do some work on every block."""
        watch = Watch(len(self._blocks), message, progress, cancelled)
        return list(self._workers.map(work, self._blocks, watch))

    def _found(self, progress: ProgressCall | None, cancelled: CancelledCall | None) -> Found:
        """Return all frames unwrapped one by one (step 1 of the paper's algorithms)."""
        return self.steps.once("spatial", lambda: self._unwrap_frames(progress, cancelled))

    def _unwrap_frames(
        self, progress: ProgressCall | None, cancelled: CancelledCall | None
    ) -> Found:
        """Unwrap all frames, lift them by whole turns, and find the object."""
        turns = self._scratch("spatial", "int16")
        unwrap = UnwrapBlock(self._stored, turns)
        lift = self._lift(self._each(unwrap, "2-D unwrapping", progress, cancelled))
        found = self._scratch("object", "bool")
        mask = found if self._finds_mask else self._scratch("mask", "bool")
        lifted = self._scratch("lifted", "int16")
        work = LiftBlock(self._stored, turns, lifted, lift, mask, found, self._finds_mask)
        each = self._each(work, "finding the object", progress, cancelled)
        centres, shares = (np.concatenate([block[i] for block in each]) for i in (0, 1))
        word = "auto" if self._finds_mask else "none" if all(k for *_, k in each) else "given"
        return Found(lifted, mask, found, centres, word, float(shares.mean()))

    def _lift(self, borders: list[NDArray[np.float64]]) -> NDArray[np.int16]:
        """Return the turns that bring the borders of all frames together."""
        border = np.concatenate(borders)
        level = border_medians(border, self._boundaries[0])
        lift: NDArray[np.int16] = np.round((level - border) / TURN).astype(np.int16)
        return lift

    def _frame_by_frame(
        self,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
        *,
        reliability: str,
    ) -> FileStack:
        """Return the turns of each frame by itself."""
        found = self._found(progress, cancelled)
        if reliability == "herraez":
            return found.turns
        turns = self._scratch("coherence", "int16")
        unwrap = UnwrapBlock(self._stored, turns, found.mask, coherence)
        lift = self._lift(self._each(unwrap, "2-D unwrapping", progress, cancelled))
        for block in self._blocks:
            lifts = lift[block.start : block.stop, :, None, None]
            turns.write(block, turns.read(block) + lifts)
        return turns

    def _shifts(
        self, progress: ProgressCall | None, cancelled: CancelledCall | None
    ) -> NDArray[np.intp]:
        """Return the shifts that register all frames (step 2)."""
        found = self._found(progress, cancelled)
        n_times, n_angles = self._stored.shape[:2]

        def register() -> NDArray[np.intp]:
            watch = Watch(n_times * n_angles, "registration", progress, cancelled)
            return centre_of_mass_shifts(
                KnownFrames(self._stored),
                KeptFrames(found.object),
                self._boundaries[0],
                watch,
                found.centres,
            )

        return self.steps.once("shifts", register)

    def _chained(
        self,
        order: tuple[str, ...],
        result: Stored,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
        *,
        registration: bool,
        split: bool,
    ) -> Limits:
        """Do one pass after the other (steps 3 and 4), the last one into the result."""
        found = self._found(progress, cancelled)
        shifts = np.zeros((*self._stored.shape[:2], 2), dtype=np.intp)
        if registration:
            shifts = self._shifts(progress, cancelled)
        chain = Chain(self._stored, found.mask, shifts, self._boundaries, split)
        before = found.turns
        for dim in order:
            message = f"unwrapping along {dim}"
            if dim == "angle":
                last = dim == order[-1]
                after = result if last else self._scratch("along_angle", "int16")
                limits = self._each(AlongAngle(chain, before, after), message, progress, cancelled)
                if isinstance(after, Stored):
                    return widest(limits)
            else:
                after = self._scratch("along_time", "int16")
                self._along_time(chain, before, after, message, progress, cancelled)
            before = after
        return self._finish(before, result, progress, cancelled)

    def _along_time(
        self,
        chain: Chain,
        before: FileStack,
        after: FileStack,
        message: str,
        progress: ProgressCall | None,
        cancelled: CancelledCall | None,
    ) -> None:
        """Do a pass along time: one frame follows from the other, so it is done right here."""
        angles = range(self._stored.shape[1])
        watch = Watch(len(angles), message, progress, cancelled)
        along = AlongTime(chain, before, after, watch.check)
        for _ in Threads().map(along, angles, watch):
            pass

    def _scratch(self, name: str, dtype: str) -> FileStack:
        """Return a stack that is needed on the way only."""
        return self._shelf.temporary(name, self._stored.shape, dtype)


class Written:
    """A result on disk: frames of which nothing is known are NaN; notes its limits.

    Parameters
    ----------
    stored : Stored
        Where it lies.
    given : Given
        The wrapped phase.
    """

    def __init__(self, stored: Stored, given: Given) -> None:
        self.shape = stored.shape
        self.limits: list[Limits] = []
        self.all_known = True
        self._stored = stored
        self._given = given

    def read(self, block: Block, angles: slice = slice(None)) -> NDArray[np.float32]:
        """Return the frames of a block, or some of its views."""
        return self._stored.read(block, angles)

    def write(self, block: Block, values: NDArray[np.float32]) -> None:
        """Write the frames of a block."""
        _, known = self._given.read(block)
        self.all_known &= bool(known.all())
        values = without_lost(values, known)
        self._stored.write(block, values)
        self.limits.append(limits_of(values))


class KnownFrames(KeptFrames):
    """Frames of wrapped phase, 0 where it is not known."""

    def __getitem__(self, frame: tuple[int, int]) -> NDArray[Any]:
        """Return frame (time, angle), shape (y, x)."""
        found = super().__getitem__(frame)
        return np.where(is_known(found), found, np.float32(0))
