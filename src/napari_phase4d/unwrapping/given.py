"""Phase, amplitude and boundary as given: checked, read in blocks, their noise, lost frames."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.machine import cores
from napari_phase4d.phasors import phasors, turned
from napari_phase4d.stack import Block, InMemory, ReadOnly, Stack, block_at, block_frames
from napari_phase4d.task import UNWATCHED, Task, on_all_cores
from napari_phase4d.unwrapping.filters import median_of
from napari_phase4d.unwrapping.light.views import ViewsOf
from napari_phase4d.words import shown

__all__ = [
    "LARGEST",
    "PURE",
    "Boundary",
    "Counted",
    "Given",
    "KeptFrames",
    "WithoutLost",
    "all_known",
    "as_given",
    "blocks_within",
    "brightness_of",
    "checked_boundaries",
    "is_known",
    "lost_frames",
    "lost_of",
    "noise_of",
    "refuse_unknown",
    "relative_amplitude",
    "sampled_noise",
    "working_blocks",
    "working_frames",
]

#: A frame by its numbers (time, angle), which unwrapping starts from.
Boundary = tuple[int, int]
#: Beyond so many radians, single precision no longer tells the parts of a turn.
LARGEST = 1e5
#: Times at which the usual amplitude is looked at.
BRIGHTNESS_TIMES = 24
#: Blocks that `KeptFrames` holds, or two for each thread.
KEPT_BLOCKS = 8
#: Work that looks at neighbouring frames too takes about so many pixels at a time, of all views,
#: but so many frames if they have no more than four times the pixels, since what it needs of the
#: frames around is done twice. On the way it takes some hundred bytes a pixel.
WORKING_PIXELS, FEW_FRAMES = 2**20, 8
#: It takes no more frames than this.
WORKING_FRAMES = 32


def is_known(phase: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Mark the pixels that are neither NaN nor infinite, nor so large that a turn is lost.

    Parameters
    ----------
    phase : ndarray of float
        Phase in radians, of any shape.

    Returns
    -------
    ndarray of bool
        In the form of ``phase``.
    """
    known: NDArray[np.bool_] = np.abs(phase) <= LARGEST
    return known


ALL = slice(None)


@dataclass(frozen=True)
class Given:
    """Wrapped phase, and which pixels count.

    Parameters
    ----------
    phase : Stack
        Wrapped phase in radians.
    usable : Stack, optional
        Pixels that count; their phase is known. Default those whose phase is known.
    """

    phase: Stack
    usable: Stack | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        return self.phase.shape

    def read(
        self, block: Block, angles: slice = ALL
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the phase of a block, 0 where it is not known, and which pixels count."""
        wrapped = self.phase.read(block, angles)
        if self.usable is not None:
            return wrapped, self.usable.read(block, angles)
        # Which is told several times as fast as for each pixel, and holds of nearly all blocks.
        if all_within(np.require(wrapped, np.float32, ["C", "W"]).ravel(), np.float32(LARGEST)):
            return wrapped, np.ones(wrapped.shape, dtype=bool)
        known = is_known(wrapped)
        return np.where(known, wrapped, np.float32(0)), known

    def read_marked(
        self, block: Block, marks: Stack, angles: slice = ALL
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]:
        """Return what `read` does and, between the two, what is marked; read but once for all."""
        wrapped, usable = self.read(block, angles)
        marked = usable if isinstance(marks, Counted) else marks.read(block, angles)
        return wrapped, marked, usable

    def of_views(self, views: tuple[int, ...]) -> Given:
        """Return some views of it."""
        usable = None if self.usable is None else ViewsOf(self.usable, views)
        return Given(ViewsOf(self.phase, views), usable)

    def without_unknown(
        self, unwrapped: NDArray[np.float32], usable: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Make those pixels of a result NaN, in place, whose phase is not known.

        Where it is said which pixels count, nobody knows here which phase was known.
        """
        if self.usable is None and not usable.all():
            unwrapped[~usable] = np.nan
        return unwrapped


@dataclass(frozen=True)
class Counted(ReadOnly):
    """The pixels that count, in the form of a stack.

    Parameters
    ----------
    given : Given
        Wrapped phase, and the pixels that count.
    """

    given: Given

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        return self.given.shape

    def read(self, block: Block, angles: slice = ALL) -> NDArray[np.bool_]:
        """Return some of it."""
        return self.given.read(block, angles)[1]


class KeptFrames:
    """Single frames of a stack, of which a few blocks are held; several threads may read them.

    Parameters
    ----------
    shape : tuple of int
        Shape of the stack.
    read : callable
        ``read(block, angles)`` returns some of its frames.
    """

    def __init__(
        self, shape: tuple[int, ...], read: Callable[[Block, slice], NDArray[Any]]
    ) -> None:
        self.shape = shape
        self._read = read
        self._blocks: OrderedDict[tuple[int, int], NDArray[Any]] = OrderedDict()
        self._lock = threading.Lock()

    def __getitem__(self, frame: tuple[int, int]) -> NDArray[Any]:
        """Return frame (time, angle), shape (y, x)."""
        time, angle = frame
        block = block_at(self.shape, time)
        name = (block.start, angle)
        with self._lock:
            frames = self._blocks.get(name)
        if frames is None:
            frames = self._read(block, slice(angle, angle + 1))
        with self._lock:
            self._blocks[name] = frames
            self._blocks.move_to_end(name)
            if len(self._blocks) > max(KEPT_BLOCKS, 2 * cores()):
                self._blocks.popitem(last=False)
        found: NDArray[Any] = frames[time - block.start, 0]
        return found


def as_given(wrapped: NDArray[np.float32], usable: NDArray[np.bool_] | None = None) -> Given:
    """Return arrays (time, angle, y, x) in the form of `Given`; by default all pixels count."""
    if usable is None:
        usable = np.ones(wrapped.shape, dtype=bool)
    return Given(InMemory(wrapped), InMemory(usable))


def working_frames(shape: Sequence[int]) -> int:
    """Return how many frames of (time, angle, y, x) to work on at a time."""
    frame = max(math.prod(shape[1:]), 1)
    frames = max(WORKING_PIXELS // frame, min(FEW_FRAMES, 4 * WORKING_PIXELS // frame), 1)
    frames = min(frames, WORKING_FRAMES)
    # What lies on disk lies in blocks: parts of one are slow to write.
    block = block_frames(shape)
    return min(frames - frames % block if frames > block else frames, shape[0])


def working_blocks(shape: Sequence[int]) -> list[Block]:
    """Cut a stack into blocks to work on; results must not depend on where."""
    each = working_frames(shape)
    return [Block(t, min(t + each, shape[0])) for t in range(0, shape[0], each)]


def blocks_within(block: Block, shape: Sequence[int]) -> list[Block]:
    """Cut some frames of a stack of a shape into blocks to work on."""
    return [
        Block(block.start + part.start, block.start + part.stop)
        for part in working_blocks((len(block), *shape[1:]))
    ]


# ---- noise, and lost frames -----------------------------------------------------------------


Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
#: The noise is measured on about so many pixels: every so manieth time of longer recordings.
ENOUGH_PIXELS = 1_000_000
#: Neighbours share noise if it is so many times larger from frame to frame, and between pixels
#: that lie so far apart; but what grows with distance like this from one to the next is a slope.
SHARED, LAGS, LIKE_A_SLOPE = 1.4, (2, 4, 8), 1.6
#: From frame to frame it is measured at so many times.
TRIPLES = 8
#: To tell whether a frame says anything, about so many of its pixels will do, in whole rows.
ENOUGH_IN_FRAME = 4_000
#: A frame shows the same everywhere if this share of its steps, taken along x, is less than so
#: many radians from none or from half a turn, as where a field of zero has changed its sign ...
SAME_SHARE, SAME = 0.98, 1e-3
#: ... which no camera does that sees anything, if other frames have more noise than this.
SOME_NOISE = 1e-3
#: A frame is nothing but noise if that is larger than this in radians, and larger than that of
#: clearer frames by so much. Pure noise measures 0.95, and noise of 1 rad 0.89.
NOISE_ONLY, NOISIER, PURE = 0.85, 0.15, 0.93


def lost_frames(wrapped: Image, usable: Mask | None = None) -> Mask:
    """Mark the frames that say nothing of the object.

    Lost are frames without a usable pixel; those that are the same everywhere between others
    that are not, such as black or saturated ones; and those that are nothing but noise, unless
    all are.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    usable : ndarray of bool, same shape, optional
        Pixels that may be looked at; default all.

    Returns
    -------
    ndarray of bool, shape (time, angle)
    """
    return lost_of(as_given(wrapped, usable))


def lost_of(given: Given, task: Task = UNWATCHED) -> Mask:
    """Do `lost_frames` for phase that is read a block at a time."""
    shape = given.shape[:2]
    blind, same = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    noise = np.zeros(shape)
    every = 1 + math.prod(given.shape[2:]) // ENOUGH_IN_FRAME

    def look(block: Block) -> None:
        wrapped, usable = given.read(block)
        for i, angle in np.ndindex(*wrapped.shape[:2]):
            frame = block.start + i, angle
            inside = usable[i, angle]
            blind[frame] = not inside.any()
            some = wrapped[i, angle, ::every]
            few = None if inside.all() else inside[::every]
            same[frame] = is_same(some, few)
            noise[frame] = noise_of(some, few, axes=(-1,))

    on_all_cores(look, working_blocks(given.shape), task, "looking for lost frames")
    same &= ~blind
    seen = ~blind & ~same
    if not seen.any():
        return blind
    clear = seen & (noise <= NOISE_ONLY)
    typical = float(np.median(noise[clear])) if clear.any() else math.inf
    noisy = seen & (noise > NOISE_ONLY) & (noise > typical + NOISIER)
    # More than half of all frames may be nothing but noise, but not because a few are clearer.
    if 2 * noisy.sum() > seen.sum() and float(np.median(noise[noisy])) < PURE:
        noisy[:] = False
    if typical < SOME_NOISE:  # free of noise, as simulated phase is: it may show an empty field
        good = seen & ~noisy
        before = np.logical_or.accumulate(good, axis=0)
        after = np.logical_or.accumulate(good[::-1], axis=0)[::-1]
        same &= before & after
    return blind | same | noisy


def is_same(frame: Image, usable: Mask | None) -> bool:
    """Say whether a frame (y, x) shows the same phase everywhere, up to its sign."""
    if frame.shape[1] < 2:
        return False
    step = np.abs(np.sin(np.diff(frame, axis=1)))
    if usable is not None:
        step = step[usable[:, 1:] & usable[:, :-1]]
    return step.size > 0 and float((step < SAME).mean()) >= SAME_SHARE


def noise_of(
    wrapped: Image,
    usable: Mask | None = None,
    axes: tuple[int, ...] = (-1, -2),
    lag: int = 1,
) -> float:
    """Return the standard deviation of the noise in radians, from second differences.

    The median of the wrapped second differences along y or x, whichever is smaller; for white
    noise it is 0.6745 sqrt(6) standard deviations.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    usable : ndarray of bool, optional
        Pixels that count; default all.
    axes : tuple of int, optional
        Along which to measure, counted from the last; the least noise counts.
    lag : int, optional
        How far apart pixels are whose differences are taken.
    """
    if wrapped.size > ENOUGH_PIXELS and wrapped.ndim == 4:
        some = np.s_[:: 1 + wrapped.size // ENOUGH_PIXELS]
        wrapped = wrapped[some]
        usable = None if usable is None else usable[some]
    found = []
    for axis in axes:
        if wrapped.shape[axis] <= 2 * lag:
            continue
        step = turned(apart(wrapped, axis, lag))
        second = np.abs(turned(apart(step, axis, lag)))
        if usable is not None:
            last = wrapped.ndim + axis
            thrice = [
                usable[(slice(None),) * last + (slice(i, i + second.shape[axis]),)]
                for i in (0, lag, 2 * lag)
            ]
            second = second[thrice[0] & thrice[1] & thrice[2]]
        if second.size:
            found.append(median_of(second.ravel()) / 0.6745 / np.sqrt(6))
    return min(found, default=0.0)


def apart(values: Image, axis: int, lag: int) -> Image:
    """Return the differences of values that lie so far apart along an axis."""
    before, after = (
        tuple(own if i == axis % values.ndim else slice(None) for i in range(values.ndim))
        for own in (slice(None, -lag), slice(lag, None))
    )
    return values[after] - values[before]


@dataclass(frozen=True)
class WithoutLost:
    """Phase of which no pixel of a lost frame counts, unless all are lost."""

    given: Given
    lost: Mask

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack."""
        return self.given.shape

    def read(self, block: Block) -> tuple[Image, Mask]:
        """Return the phase of a block, and which pixels count."""
        wrapped, usable = self.given.read(block)
        lost = self.lost[block.start : block.stop]
        if lost.any() and not self.lost.all():
            usable = usable & ~lost[..., None, None]
        return wrapped, usable


def sampled_noise(given: WithoutLost) -> float:
    """Return the standard deviation of the noise in radians, of evenly spaced times.

    That of `noise_of`, unless what changes from frame to frame is as much larger as it is between
    pixels further apart: noise that neighbours share, as where a view has many more pixels than
    its pupil lets through, does not show between them, but is new in every frame.
    """
    times = range(0, given.shape[0], 1 + math.prod(given.shape) // ENOUGH_PIXELS)
    parts = [given.read(Block(t, t + 1)) for t in times]
    wrapped, usable = (np.concatenate(part) for part in zip(*parts, strict=True))
    known = None if usable.all() else usable
    found = noise_of(wrapped, known)
    in_time = noise_in_time(given)
    if in_time < SHARED * found:
        return found
    lags = [lag for lag in LAGS if 2 * lag < min(given.shape[2:])]
    if not found or len(lags) < 2:  # too small to tell noise from slopes
        return found
    further = [noise_of(wrapped, known, lag=lag) for lag in lags]
    shared, grows = min(in_time, max(further)), further[0] / found
    is_noise = grows > SHARED and further[-1] < min(grows, LIKE_A_SLOPE) * further[-2]
    return shared if is_noise and shared > SHARED * found else found


def noise_in_time(given: WithoutLost) -> float:
    """Return `noise_of` along time, of some times and those before and after each; 0 of fewer."""
    n = given.shape[0]
    if n < 3:
        return 0.0
    rows = np.s_[..., :: 1 + 3 * TRIPLES * math.prod(given.shape[1:]) // ENOUGH_PIXELS, :]
    blocks = [Block(t, t + 3) for t in range(0, n - 2, 1 + (n - 3) // TRIPLES)]
    parts = [[part[rows].copy() for part in given.read(block)] for block in blocks]
    wrapped, usable = (np.stack(part) for part in zip(*parts, strict=True))
    # A level that changes with time is no noise.
    level = np.angle(np.where(usable, phasors(wrapped), 0).mean(axis=(-2, -1), keepdims=True))
    return noise_of(wrapped - level, None if usable.all() else usable, axes=(-4,))


# ---- pixels that are known, and their amplitude ---------------------------------------------


def all_known(stack: NDArray[np.float32]) -> bool:
    """Say whether `is_known` holds everywhere in a stack."""
    bad = threading.Event()

    def look(times: slice) -> None:
        numbers = np.require(stack[times], np.float32, ["C", "W"]).ravel()
        if not all_within(numbers, np.float32(LARGEST)):
            bad.set()

    each = -(-len(stack) // (2 * cores()))
    on_all_cores(look, [slice(t, t + each) for t in range(0, len(stack), each)])
    return not bad.is_set()


@compiled
def all_within(numbers: NDArray[np.float32], largest: np.float32) -> bool:
    """Say whether no number is NaN or larger than this, whatever its sign."""
    outside = np.int32(0)
    for k in range(len(numbers)):
        outside |= np.int32(not abs(numbers[k]) <= largest)
    return bool(outside == 0)


def brightness_of(values: Any) -> NDArray[np.float64]:
    """Return the median amplitude of each view of (time, angle, y, x); 0 where it has none.

    It is looked at in no more than 24 evenly spaced times, so that a long recording takes no
    longer. NaN and what is not positive do not count.
    """
    some = np.asarray(values[:: -(-values.shape[0] // BRIGHTNESS_TIMES)])
    found = np.zeros(some.shape[1])
    for angle in range(len(found)):
        view = some[:, angle]
        bright = view[np.isfinite(view) & (view > 0)]
        if bright.size:
            found[angle] = np.median(bright)
    return found


def relative_amplitude(values: NDArray[Any], bright: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return amplitude (time, angle, y, x) as a share of its view's median.

    NaN counts as no amplitude; a view without any is taken as bright everywhere.
    """
    share = np.ones(values.shape, dtype=np.float32)
    for angle in np.flatnonzero(bright):
        view = values[:, angle]
        share[:, angle] = np.where(np.isfinite(view), view, 0) / bright[angle]
    return share


def refuse_unknown(*, known: bool, where: str = "everywhere") -> None:
    """Raise ValueError if nothing is known of some phase."""
    if not known:
        msg = f"the phase is NaN {where}, so there is nothing to unwrap"
        raise ValueError(msg)


def checked_boundaries(
    boundary: Boundary | Sequence[Boundary], shape: tuple[int, ...]
) -> list[Boundary]:
    """Return the boundary frames as a list of index pairs that exist."""
    try:
        pairs = np.atleast_2d(np.asarray(boundary))
    except (TypeError, ValueError):  # pairs of different lengths, or no numbers at all
        pairs = np.empty(0)
    if pairs.size == 0 or pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        msg = (
            "boundary must be (time, angle) frame numbers, one pair or several, not "
            f'{shown(boundary)}; score_boundaries(phase).attrs["best"] is the safest frame'
        )
        raise ValueError(msg)
    found: list[Boundary] = []
    for t, a in pairs.tolist():
        if not (-shape[0] <= t < shape[0] and -shape[1] <= a < shape[1]):
            msg = (
                f"the boundary frame (time {t}, angle {a}) does not exist; "
                f"there are {shape[0]} times and {shape[1]} angles, counted from 0"
            )
            raise ValueError(msg)
        found.append((t % shape[0], a % shape[1]))
    return list(dict.fromkeys(found))
