"""What noise there is, and which frames say nothing of the object."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block
from napari_phase4d.task import on_all_cores
from napari_phase4d.unwrapping.given import Given, as_given, working_blocks

__all__ = ["WithoutLost", "lost_frames", "lost_of", "median_of", "noise_of", "sampled_noise"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
#: The noise is measured on about so many pixels: every so manieth time of longer recordings.
ENOUGH_PIXELS = 1_000_000
#: To tell whether a frame says anything, about so many of its pixels will do, in whole rows.
ENOUGH_IN_FRAME = 4_000
#: A frame shows the same everywhere if this share of its steps, taken along x, is less than so
#: many radians from none or from half a turn, as where a field of zero has changed its sign ...
SAME_SHARE, SAME = 0.98, 1e-3
#: ... which no camera does that sees anything, if other frames have more noise than this.
SOME_NOISE = 1e-3
#: A frame is nothing but noise if that is larger than this in radians, and larger than that of
#: the others by so much. Pure noise measures 0.95.
NOISE_ONLY, NOISIER = 0.85, 0.15


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


def lost_of(given: Given) -> Mask:
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

    on_all_cores(look, working_blocks(given.shape))
    same &= ~blind
    seen = ~blind & ~same
    if not seen.any():
        return blind
    typical = float(np.median(noise[seen]))
    noisy = seen & (noise > NOISE_ONLY) & (noise > typical + NOISIER)
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
    wrapped: Image, usable: Mask | None = None, axes: tuple[int, ...] = (-1, -2)
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
        Along which to measure; the least noise counts.
    """
    if wrapped.size > ENOUGH_PIXELS and wrapped.ndim == 4:
        some = np.s_[:: 1 + wrapped.size // ENOUGH_PIXELS]
        wrapped = wrapped[some]
        usable = None if usable is None else usable[some]
    found = []
    for axis in axes:
        if wrapped.shape[axis] < 3:
            continue
        step = turned(np.diff(wrapped, axis=axis))
        second = np.abs(turned(np.diff(step, axis=axis)))
        if usable is not None:
            last = wrapped.ndim + axis
            thrice = [
                usable[(slice(None),) * last + (slice(i, i + second.shape[axis]),)]
                for i in range(3)
            ]
            second = second[thrice[0] & thrice[1] & thrice[2]]
        if second.size:
            found.append(median_of(second.ravel()) / 0.6745 / np.sqrt(6))
    return min(found, default=0.0)


#: Among fewer numbers the median is found fast enough.
FEW = 4096


def median_of(values: NDArray[np.floating[Any]]) -> float:
    """Return the median of numbers (n,), as ``numpy.median`` gives it.

    It takes a third of the time: only what lies near the median of some of them is sorted out.
    """
    if values.size < FEW:
        return float(np.median(values))
    some = np.sort(values[:: values.size // (FEW // 4)])
    low, high = some[int(0.45 * some.size)], some[int(0.55 * some.size)]
    above = values >= low
    below = int(np.count_nonzero(values < low))
    near = values[above & (values <= high)]
    first, last = (values.size - 1) // 2 - below, values.size // 2 - below
    some_nan = below + np.count_nonzero(above) < values.size
    if some_nan or not 0 <= first <= last < near.size:
        return float(np.median(values))
    return float(np.mean(np.partition(near, (first, last))[first : last + 1]))


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
    """Return `noise_of` phase of which evenly spaced times are looked at."""
    times = range(0, given.shape[0], 1 + math.prod(given.shape) // ENOUGH_PIXELS)
    parts = [given.read(Block(t, t + 1)) for t in times]
    wrapped, usable = (np.concatenate(part) for part in zip(*parts, strict=True))
    return noise_of(wrapped, None if usable.all() else usable)
