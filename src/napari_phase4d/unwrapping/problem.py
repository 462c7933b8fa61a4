"""What all unwrapping methods are given: wrapped phase, mask and boundary."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.later import xr
from napari_phase4d.machine import cores
from napari_phase4d.stack import (
    Block,
    InMemory,
    Limits,
    Memory,
    Stack,
    Store,
    Unwritten,
    block_frames,
    blocks_of,
)
from napari_phase4d.stacks import (
    AXES,
    KIND,
    as_stack,
    in_full,
    mask_on,
    on_grid_of,
    wavelengths_of,
)
from napari_phase4d.task import UNWATCHED, CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.unwrapping.alone import ALL_USABLE, Found, each_alone, found_in, with_turns
from napari_phase4d.unwrapping.background import Background, background_of
from napari_phase4d.unwrapping.frames import centre_of_mass_shifts
from napari_phase4d.unwrapping.given import (
    LARGEST,
    Boundary,
    Counted,
    Given,
    KeptFrames,
    all_known,
    brightness_of,
    checked_boundaries,
    is_known,
    lost_of,
    refuse_unknown,
    relative_amplitude,
)
from napari_phase4d.unwrapping.light import Together, frames_among, views_by_light
from napari_phase4d.unwrapping.shared_steps import FRAMES_LEFT_OUT, SharedSteps
from napari_phase4d.warned import warn
from napari_phase4d.words import shown

__all__ = ["Problem"]

#: Names of what each frame by itself gave, and of the object in it, among what a problem shares.
ALONE, OBJECT = "spatial", "object"
#: What does not depend on the empty field.
KEPT = (ALONE, OBJECT, ALL_USABLE, "lost", "brightness", "parts")

R = TypeVar("R")

#: Share of pixels of an amplitude that may be below 0, by noise.
FEW_NEGATIVE = 0.05


class Problem(SharedSteps):
    """Wrapped phase with its mask and boundary frames, checked and brought into one form.

    The two-dimensional unwrapping and the registration, from which the paper's methods start,
    are computed once and shared by all methods that are run on the problem.

    Parameters
    ----------
    phase : DataArray or array_like
        Wrapped phase in radians; dims among (time, angle, y, x), plain arrays in this order:
        (y, x), (time, y, x) or (time, angle, y, x).
    boundary : tuple of int or sequence of such
        (time, angle) index of the optically thin frame or frames; negative ones count from the
        end.
    mask : array_like of bool, "auto" or None
        Pixels to unwrap; any shape that broadcasts to that of the phase. "auto" finds the object
        in every frame. Default None: all pixels.
    amplitude : DataArray, array_like or None, optional
        Amplitude of the field, of the phase's shape; where it fades, the phase is less trusted by
        methods that can tell.
    shared : bool, optional
        Whether several methods are run on it, so that what they start from is kept. Default True.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit; the sentence says which and how.
    """

    #: Whether all of it is held in memory.
    held = True
    #: Whether several methods are run on it.
    shared = True

    def __init__(
        self,
        phase: xr.DataArray | ArrayLike,
        boundary: Boundary | Sequence[Boundary] = (0, 0),
        mask: xr.DataArray | ArrayLike | None = None,
        amplitude: xr.DataArray | ArrayLike | None = None,
        *,
        shared: bool = True,
    ) -> None:
        super().__init__()
        self.shared = shared
        self._given: Given | None = None
        self.template = as_stack(phase)
        values = in_full(self.template)
        self.boundaries = checked_boundaries(boundary, values.shape[:2])
        self.finds_mask = isinstance(mask, str)
        #: Pixels that may be looked at, whether the object is still to be found or not.
        self.usable = self._given_mask(mask, values.shape)
        self._all_usable = True if mask is None else None
        # The caller's own array, where it fits: nobody writes into it.
        with np.errstate(over="ignore"):  # it is infinite then, and left out
            self.wrapped: NDArray[np.float32] = np.require(values, np.float32, ["C", "W"])
        #: Pixels of which no phase is known, NaN in every result; None if all is known.
        self.unknown: NDArray[np.bool_] | None = None
        if not all_known(self.wrapped):
            self._leave_out(~is_known(self.wrapped))
        #: Amplitude as given; methods read it as a share of its view's median, by blocks.
        self._field_amplitude = self._given_amplitude(amplitude)

    def _leave_out(self, bad: NDArray[np.bool_]) -> None:
        """Leave bad pixels out if the object is to be found; else they must lie off the mask."""
        lost = bad.all(axis=(2, 3), keepdims=True)
        refuse_unknown(known=not lost.all())
        self.unknown = bad
        count = int((bad & ~lost & self.usable).sum())
        if count and not self.finds_mask:
            msg = (
                f"the phase holds {count} NaN or infinite pixels (or beyond {LARGEST:g} rad); "
                f"leave them out with mask=numpy.abs(phase) < {LARGEST:g}"
            )
            raise ValueError(msg)
        self.usable, self._all_usable = self.usable & ~bad, None
        refuse_unknown(known=bool(self.usable.any()), where="wherever the mask counts")
        self.wrapped = np.where(bad, np.float32(0), self.wrapped)

    # ---- where it lies and who works on it: another kind of problem has its own ----

    @property
    def given(self) -> Given:
        """The wrapped phase, 0 where it is not known, and the pixels that count."""
        if self._given is None:
            self._given = Given(InMemory(self.wrapped), InMemory(self.usable))
        return self._given

    @property
    def store(self) -> Store:
        """Where stacks lie that are needed on the way."""
        return Memory()

    def each(
        self,
        work: Callable[[Block], R],
        message: str,
        task: Task,
    ) -> list[R]:
        """Do some work on every block of frames, on all cores; progress counts frames."""
        blocks = self.blocks()
        frames = task.counting(len(blocks[0]) * self.given.shape[1], self.n_frames)
        return list(self.on_workers(work, blocks, Watch(len(blocks), message, frames)))

    def blocks(self) -> list[Block]:
        """Cut the frames into blocks: each core is to have some."""
        n = self.given.shape[0]
        frames = min(block_frames(self.given.shape), max(1, n // (2 * cores())))
        return blocks_of(self.given.shape, frames)

    def on_workers(
        self, work: Callable[[Block], R], blocks: list[Block], watch: Watch
    ) -> Iterator[R]:
        """Do some work on blocks, on all cores."""
        return in_threads(work, blocks, watch, wait=True)

    def amplitude_of(self, block: Block) -> NDArray[np.float32] | None:
        """Return the amplitude of a block as a share of its view's median, or None."""
        if self._field_amplitude is None:
            return None
        data = self._field_amplitude
        bright = self.once("brightness", lambda: brightness_of(data))
        return relative_amplitude(data[block.start : block.stop], bright)

    @property
    def amplitude(self) -> NDArray[np.float32] | None:
        """Amplitude of all frames as a share of its view's median, or None; made anew."""
        return self.amplitude_of(Block(0, self.given.shape[0]))

    @property
    def has_amplitude(self) -> bool:
        """Whether there is an amplitude."""
        return self._field_amplitude is not None

    @property
    def all_usable(self) -> bool:
        """Whether all pixels count, before the object is looked for."""
        if self._all_usable is None:
            self._all_usable = bool(self.usable.all())
        return self._all_usable

    @property
    def kept(self) -> NDArray[np.bool_] | None:
        """Which pixels a mask that was given has; None where none was."""
        return None if self.finds_mask or self.all_usable else self.usable

    def result_stack(self, method: str) -> Stack:
        """Return a new stack for the result of a method."""
        return Unwritten(self.wrapped.shape, "float32")

    def in_memory(self) -> Problem:
        """Return the problem in memory, for methods that need all frames at once."""
        return self

    def finished(
        self,
        values: Stack | NDArray[np.float32],
        method: str,
        attrs: dict[str, Any],
        limits: Sequence[Limits] = (),
    ) -> xr.DataArray:
        """Return a result in the form of the phase; what is not known there is NaN.

        Parameters
        ----------
        values : Stack or ndarray of shape (time, angle, y, x)
            The result in radians.
        method : str
            Id of the method.
        attrs : dict
            How it was made.
        limits : sequence of (float, float), optional
            Smallest and largest phase of every block, where they are known.
        """
        if not isinstance(values, np.ndarray):
            values = values.read(Block(0, values.shape[0]))
        if self.unknown is not None:
            values = np.where(self.unknown, np.float32(np.nan), values)
        return self.result(values, method, attrs)

    def map_of(self, values: Stack, name: str, attrs: dict[str, Any]) -> xr.DataArray:
        """Return a map of something else than phase, from 0 to 1, in the form of the phase.

        Parameters
        ----------
        values : Stack
            As `result_stack` made it.
        name : str
            The name that it was made by.
        attrs : dict
            What it is.
        """
        return self.result(values.read(Block(0, values.shape[0])), name, attrs)

    # ---- views of several wavelengths ----

    @property
    def wavelengths_um(self) -> NDArray[np.float64] | None:
        """Wavelength of each view in micrometres, None where the phase does not note it."""
        return wavelengths_of(self.template)

    @property
    def angles_deg(self) -> NDArray[np.float64]:
        """Angle of each view in degrees; numbers where the phase has no angles."""
        n_angles = self.given.shape[1]
        if "angle" not in self.template.coords:
            return np.arange(n_angles, dtype=np.float64)
        return np.broadcast_to(
            np.asarray(self.template["angle"].values, dtype=np.float64), n_angles
        )

    def parts(self) -> list[tuple[tuple[int, ...], Problem]]:
        """Return the views of each wavelength as problems of their own, empty if all have one.

        Phases of different wavelengths say nothing of each other by themselves, so that methods
        which hold views against each other are given one wavelength after the other.
        """

        def divide() -> list[tuple[tuple[int, ...], Problem]]:
            every = views_by_light(self.wavelengths_um)
            return [(views, self._part(number, views)) for number, views in enumerate(every)]

        return self.once("parts", divide)

    def by_wavelength(self) -> list[tuple[tuple[int, ...], Problem]]:
        """Return `parts`; if all views have one wavelength, all of them and the problem itself."""
        return self.parts() or [(tuple(range(self.given.shape[1])), self)]

    def _part(self, number: int, views: tuple[int, ...]) -> Problem:
        """Return the problem of some views."""
        chosen = list(views)
        self.refuse_unseen(views, known=bool(self.usable[:, chosen].any()))
        return Problem(
            self.template.isel(angle=chosen),
            frames_among(self.boundaries, views, self.angles_deg),
            "auto" if self.finds_mask else self.usable[:, chosen],
            None if (share := self.amplitude) is None else share[:, chosen],
        )

    def refuse_unseen(self, views: tuple[int, ...], *, known: bool) -> None:
        """Raise ValueError if nothing is known of the views of one wavelength."""
        lights = self.wavelengths_um
        if not known and lights is not None:
            msg = (
                f"nothing of the phase at {lights[views[0]]:g} um is known and in the mask; leave "
                "these views out"
            )
            raise ValueError(msg)

    def derived(
        self, stack: Stack, coords: dict[str, Any], boundaries: list[Boundary], name: str
    ) -> Problem:
        """Return the problem of wrapped phase that follows from this one's, all pixels of it.

        Parameters
        ----------
        stack : Stack
            The phase in radians, NaN where it is not known.
        coords : dict
            Its times and angles.
        boundaries : list of (int, int)
            Its boundary frames.
        name : str
            What it is called, a word.
        """
        values = stack.read(Block(0, stack.shape[0]))
        known = is_known(values)
        phase = xr.DataArray(values, dims=AXES, coords=coords)
        return Problem(phase, boundaries, None if known.all() else known)

    def with_background(self, background: Background) -> Problem:
        """Return the same phase with another empty field; what is computed of it is its own."""
        found = copy.copy(self)
        SharedSteps.__init__(found)
        for name in KEPT:
            if self.knows(name):
                found.note(name, self.known(name))
        found.note("background", background)
        return found

    def forget_field(self) -> None:
        """Let go of what the directional methods share: it is as large as many results."""
        super().forget_field()
        if self.knows("parts"):
            for _, part in self.parts():
                part.forget_field()

    # ---- what several methods start from ----

    @property
    def first(self) -> Boundary:
        """The first boundary frame."""
        return self.boundaries[0]

    @property
    def n_frames(self) -> int:
        """Number of frames over all times and angles."""
        return math.prod(self.given.shape[:2])

    def alone(self, task: Task = UNWATCHED) -> Stack:
        """Return the turns of all frames unwrapped one by one (step 1 of the algorithms)."""
        return self.once(ALONE, lambda: each_alone(self, task))

    def found(self, task: Task = UNWATCHED) -> Found:
        """Return the object in all frames (step 2)."""
        turns = self.alone(task)
        return self.once(OBJECT, lambda: found_in(self, turns, task))

    def smooth_left_out(self) -> NDArray[np.float64]:
        """Return the share of each frame that is left out though it is smooth and not flat.

        It is looked at where the object is looked for; 0 where that has not been done.
        """
        shares = np.zeros(self.given.shape[:2])
        if self.finds_mask and self.knows("parts") and self.parts():
            for views, part in self.parts():
                shares[:, list(views)] = part.smooth_left_out()
        elif self.finds_mask and self.knows(OBJECT):
            shares = self.found().smooth_left_out
        return shares

    def shifts(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> NDArray[np.intp]:
        """Return the shifts that register all frames (step 2), shape (time, angle, 2)."""
        task = Task(progress, cancelled)
        if self.n_frames == 1:
            return np.zeros((1, 1, 2), dtype=np.intp)
        found = self.found(task)
        return self.once("shifts", lambda: self._register(found, task))

    def _register(self, found: Found, task: Task) -> NDArray[np.intp]:
        """Return the shifts that bring the object of every frame to one place."""
        watch = Watch(self.n_frames, "registration", task)
        given = self.given
        return centre_of_mass_shifts(
            KeptFrames(given.shape, lambda block, angles: given.read(block, angles)[0]),
            KeptFrames(given.shape, found.object.read),
            self.first,
            watch,
            found.centres,
        )

    def settle_mask(self, task: Task = UNWATCHED) -> None:
        """Find the object, where that was asked for, before a method looks at ``mask``."""
        if self.finds_mask:
            self.found(task)

    def counted(self, task: Task = UNWATCHED) -> Stack:
        """Return the pixels to unwrap, in blocks; the object is looked for where it is unknown."""
        return self.found(task).object if self.finds_mask else Counted(self.given)

    def settle_frames(self, task: Task = UNWATCHED) -> None:
        """Do what `frame_by_frame` needs, if that has not been done."""
        self.alone(task)
        self.settle_mask(task)

    def frame_by_frame(self, block: Block) -> NDArray[np.float32]:
        """Return the phase of a block as each frame is unwrapped by itself."""
        wrapped, _ = self.given.read(block)
        return with_turns(wrapped, self.alone().read(block), self.counted().read(block))

    def lost(self, task: Task = UNWATCHED) -> NDArray[np.bool_]:
        """Mark the frames (time, angle) that say nothing of the object, see `lost_frames`."""
        return self.once("lost", lambda: lost_of(self.given, task))

    def frames_left_out(self) -> NDArray[np.bool_]:
        """Mark the frames (time, angle) that are not to be relied on.

        Those that say nothing, and, once a directional method has looked, those that fit neither
        the one before nor the one after, see `outlying_frames`.
        """
        found = self.lost().copy()
        if self.knows(FRAMES_LEFT_OUT):
            found |= self.once(FRAMES_LEFT_OUT, self.lost)
        if self.knows("parts") and self.parts():
            for views, part in self.parts():
                found[:, list(views)] |= part.frames_left_out()
            self.note(FRAMES_LEFT_OUT, found)  # as parts may be forgotten
        return found

    def background(self, task: Task = UNWATCHED) -> Background:
        """Return the empty field of every frame, and its level.

        Who asks first may stop it; later it is there.
        """
        return self.once("background", lambda: self._find_background(task))

    def _find_background(self, task: Task) -> Background:
        """Return the empty field; views of each wavelength are looked at by themselves."""
        parts = self.parts()
        if not parts:
            return background_of(self.given, self.lost(task), self.store, task, self.first)
        found = [(views, part.background(task)) for views, part in parts]
        shape = self.given.shape[:2]
        level, tilt = np.zeros(shape), np.zeros((*shape, 2))
        shown = np.zeros(shape, dtype=bool)
        for views, own in found:
            level[:, list(views)], tilt[:, list(views)] = own.level, own.tilt
            shown[:, list(views)] = own.shown
        empty = Together(tuple((views, own.empty) for views, own in found))
        return Background(empty, level, max(own.noise for _, own in found), tilt, shown)

    # ---- all frames in memory, for methods that look at them at once ----

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels to unwrap; the object, where it is to be found, is looked for when first asked.

        `settle_mask` looks for it with progress.
        """
        if not self.finds_mask:
            return self.usable
        found: NDArray[np.bool_] = self.found().object.read(Block(0, len(self.usable)))
        return found

    def spatial(
        self, progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> NDArray[np.float32]:
        """Return all frames unwrapped one by one (step 1 of the paper's algorithms)."""
        task = Task(progress, cancelled)
        self.settle_frames(task)
        return self.frame_by_frame(Block(0, len(self.wrapped)))

    @property
    def relative_amplitude(self) -> xr.DataArray | None:
        """Amplitude as a share of its view's median, in the form of the phase, or None."""
        share = self.amplitude
        return None if share is None else self.result(share, "amplitude", {"units": "1"})

    def result(self, values: NDArray[Any], name: str, attrs: dict[str, Any]) -> xr.DataArray:
        """Return a stack (time, angle, y, x) in the form in which the phase was given."""
        dims = self.template.dims
        kept = [axis for axis in AXES if axis in dims]
        squeezed = values[tuple(slice(None) if axis in dims else 0 for axis in AXES)]
        ordered = squeezed.transpose([kept.index(str(axis)) for axis in dims])
        known = {key: value for key, value in self.template.attrs.items() if key != KIND}
        result = self.template.copy(deep=False, data=ordered)
        result.attrs = {**known, "units": "rad", **attrs}
        result.encoding = {}
        result.name = name
        return result

    def _given_amplitude(self, amplitude: Any) -> NDArray[Any] | None:
        """Return the amplitude (time, angle, y, x) after a look at it, or None."""
        if amplitude is None:
            return None
        values = in_full(on_grid_of(amplitude, self.template, "the amplitude"))
        if values.dtype.kind not in "fiu":
            msg = f"the amplitude is of {values.dtype}; give real numbers, as reconstruct() does"
            raise TypeError(msg)
        if not values.min(initial=0) >= 0:  # NaN is not
            known = values[np.isfinite(values)]
            if known.size and (known < 0).mean() > FEW_NEGATIVE:
                msg = (
                    "the amplitude is negative in many pixels, as phase is; give that of the "
                    "field, as reconstruct() does"
                )
                raise ValueError(msg)
        if not any(((some > 0) & (some < np.inf)).any() for some in values):
            warn("the amplitude is 0 or not known everywhere, and counts as not given")
            return None
        found: NDArray[Any] = values
        return found

    def _given_mask(self, mask: Any, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return the mask as given, or all pixels where it is still to be found."""
        if mask is None or (isinstance(mask, str) and mask == "auto"):
            return np.ones(shape, dtype=bool)
        if isinstance(mask, str):
            msg = f'mask must be an array, "auto" or None, but is {shown(mask)}'
            raise ValueError(msg)
        found = np.broadcast_to(np.asarray(mask_on(mask, self.template, "the mask")), shape)
        if not found.any():
            msg = "the mask is empty, so there is nothing to unwrap"
            raise ValueError(msg)
        return found
