"""Recordings larger than memory: a block of frames at a time, here or on a cluster.

Reading, transforming, unwrapping and writing overlap on all cores; results lie on disk and are
the same numbers as in memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography import FrameReconstructor
from napari_phase4d.later import xr
from napari_phase4d.pipeline.starting import FrameSource
from napari_phase4d.pipeline.stored import Shelf, Stored, stored_at
from napari_phase4d.stack import Block, Limits, Stack, Store, blocks_of, limits_of, widest
from napari_phase4d.stacks import AXES, KIND
from napari_phase4d.task import UNWATCHED, Task, Threads, Watch, Workers
from napari_phase4d.unwrapping import FRAMES_LEFT_OUT, PLATEAUS, Problem, SharedSteps, is_known
from napari_phase4d.unwrapping.alone import ALL_USABLE
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.given import (
    Boundary,
    Given,
    all_known,
    brightness_of,
    checked_boundaries,
    refuse_unknown,
    relative_amplitude,
)
from napari_phase4d.unwrapping.light import Named, ViewsOf, frames_among, views_by_light

__all__ = ["ProblemOnDisk", "reconstruct_to_disk"]

R = TypeVar("R")
T = TypeVar("T")

#: Beginnings of the names of what stays when the shelf is cleared: maps that are whole, numbers.
LASTING = (
    "confidence of", "tally", "lost", FRAMES_LEFT_OUT, "brightness", ALL_USABLE, "missing mass",
    PLATEAUS,
)  # fmt: skip


def reconstruct_to_disk(
    source: FrameSource,
    work: FrameReconstructor,
    shelf: Shelf,
    workers: Workers,
    task: Task = UNWATCHED,
) -> xr.Dataset:
    """Reconstruct a recording a block of frames at a time.

    Parameters
    ----------
    source : FrameSource
        The frames.
    work : FrameReconstructor
        What turns one into phase and amplitude.
    shelf : Shelf
        Where "wrapped" and "amplitude" go.
    workers : Workers
        Who works on the blocks.
    task : Task, optional
        Who is told of it, and may stop it.

    Returns
    -------
    xarray.Dataset
        As `reconstruct` returns it, its stacks on disk.
    """
    recording = source.recording
    shape = work.stack_shape(recording.n_frames)
    phase, amplitude = (shelf.new(name, shape, packed=False) for name in ("wrapped", "amplitude"))
    blocks = blocks_of(shape)
    watch = Watch(len(blocks), "reconstruct", task)
    each = ReconstructBlock(source, work, phase, amplitude)
    shares, limits = zip(*workers.map(each, blocks, watch), strict=True)
    empty = without_values(shape)
    each_share = [share for of_block in shares for share in of_block]
    plan = work.as_dataset(recording, empty, empty, each_share)
    plan["phase"] = shelf.put("wrapped", plan["phase"], (-math.pi, math.pi))
    plan["amplitude"] = shelf.put("amplitude", plan["amplitude"], widest(limits))
    return plan


def without_values(shape: tuple[int, ...]) -> Any:
    """Return a lazy array where only the axes and notes of a stack count."""
    import dask.array as da  # which takes a tenth of a second

    return da.broadcast_to(da.zeros(1, dtype=np.float32), shape)


@dataclass(frozen=True)
class ReconstructBlock:
    """Reads, transforms and writes the frames of a block.

    Parameters
    ----------
    source : FrameSource
        The frames.
    work : FrameReconstructor
        What turns one into phase and amplitude.
    phase, amplitude : Stored
        Where they go.
    """

    source: FrameSource
    work: FrameReconstructor
    phase: Stored
    amplitude: Stored

    def __call__(self, block: Block) -> tuple[list[tuple[float, ...]], Limits]:
        """Do a block.

        Returns
        -------
        list of tuple of float, Limits
            What `FrameReconstructor` tells of each frame; smallest and largest amplitude.
        """
        phase = np.empty((len(block), *self.phase.shape[1:]), dtype=np.float32)
        amplitude = np.empty_like(phase)
        shares = [
            self.work.read(self.source, time, phase[i], amplitude[i])
            for i, time in enumerate(block.times)
        ]
        self.phase.write(block, phase)
        self.amplitude.write(block, amplitude)
        return shares, limits_of(amplitude)


# ---- unwrapped ------------------------------------------------------------------------------


class ProblemOnDisk(Problem):
    """Wrapped phase on disk: the same problem, which holds no more than some blocks of it.

    Parameters
    ----------
    phase : xarray.DataArray
        Wrapped phase, dims (time, angle, y, x).
    stored : Stack
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
    store : Store, optional
        Where stacks lie that are needed on the way; default the shelf.
    """

    held = False

    def __init__(
        self,
        phase: xr.DataArray,
        stored: Stack,
        shelf: Shelf,
        boundary: Any,
        *,
        finds_mask: bool,
        amplitude: xr.DataArray | None = None,
        workers: Workers | None = None,
        store: Store | None = None,
    ) -> None:
        SharedSteps.__init__(self)
        self.template = phase
        self.boundaries = checked_boundaries(boundary, stored.shape[:2])
        self.finds_mask = finds_mask
        self._stored = stored
        self._shelf = shelf
        self._clearings = shelf.clearings
        self._store: Store = shelf if store is None else store
        self._amplitude = amplitude
        self._workers = Threads() if workers is None else workers
        #: The phase in memory, for methods that need all of it.
        self._whole: Problem | None = None

    @property
    def given(self) -> Given:
        """The wrapped phase, 0 where it is not known, and the pixels that count."""
        return Given(self._stored)

    @property
    def store(self) -> Store:
        """Where stacks lie that are needed on the way."""
        return self._store

    @property
    def has_amplitude(self) -> bool:
        """Whether there is an amplitude."""
        return self._amplitude is not None

    def check_phase(self) -> None:
        """Raise ValueError if nothing of the phase, or of a wavelength, is known.

        It is read as far as to what is.
        """
        n_views = self.given.shape[1]
        parts = views_by_light(self.wavelengths_um) or [tuple(range(n_views))]
        known = np.zeros(n_views, dtype=bool)
        for block in self.blocks():
            known |= self.given.read(block)[1].any(axis=(0, 2, 3))
            if all(known[list(views)].any() for views in parts):
                return
        refuse_unknown(known=bool(known.any()))
        for views in parts:
            self.refuse_unseen(views, known=bool(known[list(views)].any()))

    @property
    def all_usable(self) -> bool:
        """Whether the phase is known everywhere."""

        def look() -> bool:
            return all(self.each(KnownBlock(self.given), "looking for gaps", UNWATCHED))

        return self.once(ALL_USABLE, look)

    @property
    def kept(self) -> None:
        """No mask is given for stacks on disk."""
        return None

    def blocks(self) -> list[Block]:
        """Cut the frames into blocks as they lie on disk."""
        return blocks_of(self._stored.shape)

    def on_workers(
        self, work: Callable[[Block], R], blocks: list[Block], watch: Watch
    ) -> Iterator[R]:
        """Do some work on blocks, here or on a cluster."""
        return self._workers.map(work, blocks, watch)

    def amplitude_of(self, block: Block) -> NDArray[np.float32] | None:
        """Return the amplitude of a block as a share of its view's median, or None."""
        if self._amplitude is None:
            return None
        data = self._amplitude.data
        bright = self.once("brightness", lambda: brightness_of(data))
        stored = stored_at(self._amplitude)  # read past the lazy stack, whose frames come singly
        values = (
            np.asarray(data[block.start : block.stop]) if stored is None else stored.read(block)
        )
        return relative_amplitude(values, bright)

    def in_memory(self) -> Problem:
        """Return the problem in memory, for methods that need all frames at once."""
        if self._whole is None:
            mask: Any = None
            if self.finds_mask:
                mask = "auto"
            elif not all_known(self.template.values):
                mask = is_known(self.template.values)
            self._whole = Problem(self.template, self.boundaries, mask, self._amplitude)
        return self._whole

    def _part(self, number: int, views: tuple[int, ...]) -> Problem:
        """Return the problem of some views, which lie where they lie."""
        chosen = list(views)
        return ProblemOnDisk(
            self.template.isel(angle=chosen),
            ViewsOf(self._stored, views),
            self._shelf,
            frames_among(self.boundaries, views, self.angles_deg),
            finds_mask=self.finds_mask,
            amplitude=None if self._amplitude is None else self._amplitude.isel(angle=chosen),
            workers=self._workers,
            store=Named(self._shelf, f"light{number}"),
        )

    def derived(
        self, stack: Stack, coords: dict[str, Any], boundaries: list[Boundary], name: str
    ) -> Problem:
        """Return the problem of wrapped phase that follows from this one's, see `Problem`."""
        return ProblemOnDisk(
            xr.DataArray(without_values(stack.shape), dims=AXES, coords=coords),
            stack,
            self._shelf,
            boundaries,
            finds_mask=False,
            workers=self._workers,
            store=Named(self._shelf, name),
        )

    def with_background(self, background: Background) -> Problem:
        """Return the same phase with another empty field, see `Problem`."""
        found = super().with_background(background)
        assert isinstance(found, ProblemOnDisk)
        found._store = Named(self._store, "on_its_field")
        return found

    def result_stack(self, method: str) -> Stack:
        """Return a new stack on disk for the result of a method."""
        # What is 0 outside of the object is packed to a fraction.
        return self._shelf.new(method, self._stored.shape, packed=self.finds_mask)

    def finished(
        self,
        values: Stack | NDArray[np.float32],
        method: str,
        attrs: dict[str, Any],
        limits: Sequence[Limits] = (),
    ) -> xr.DataArray:
        """Give a result its name, axes and notes, and return it as it lies on disk."""
        if isinstance(values, np.ndarray):
            return self._shelf.take(method, self.in_memory().finished(values, method, attrs))
        result = self.template.copy(deep=False).rename(method)
        result.attrs = {**self.template.attrs, "units": "rad", **attrs}
        return self._shelf.put(method, result, widest(limits))

    def map_of(self, values: Stack, name: str, attrs: dict[str, Any]) -> xr.DataArray:
        """Return a map of something else than phase, see `Problem`, as it lies on disk."""
        found = self.template.copy(deep=False).rename(name)
        found.attrs = {k: v for k, v in self.template.attrs.items() if k != KIND} | attrs
        return self._shelf.put(name, found, (0.0, 1.0))

    # ---- what lies on the shelf may have been cleared away ----

    def once(self, name: str, work: Callable[[], T]) -> T:
        """Return what ``work()`` returned when it was first asked for by this name."""
        with self.locks.changing:  # or what another thread has found since would go as well
            if self._shelf.clearings != self._clearings:
                self._clearings = self._shelf.clearings
                self._known = {k: v for k, v in self._known.items() if k.startswith(LASTING)}
        return super().once(name, work)

    def knows(self, name: str) -> bool:
        """Say whether something has been computed by this name, and is still there."""
        there = self._shelf.clearings == self._clearings or name.startswith(LASTING)
        return there and super().knows(name)

    def tidy(self) -> None:
        """Remove what was needed on the way only."""
        self._shelf.clear()


class KnownBlock:
    """Says whether all phase of a block is known."""

    def __init__(self, given: Given) -> None:
        self._given = given

    def __call__(self, block: Block) -> bool:
        """Do a block."""
        return bool(self._given.read(block)[1].all())
