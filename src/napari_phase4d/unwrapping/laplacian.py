"""The Laplacian-based estimate (LBE), in four dimensions.

A cosine transform over four axes is one along each axis after the other, and the lines along an
axis do not depend on each other. So frames are transformed by themselves over angle, y and x, then
pixels by themselves along time; in between, a stack on the way holds what one has written and the
other reads. In memory it is the same program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block, Limits, Stack, Temporary, limits_of
from napari_phase4d.task import Task, Watch
from napari_phase4d.unwrapping.frames import border_of
from napari_phase4d.unwrapping.given import Given
from napari_phase4d.unwrapping.neighbours import ends_along
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["laplacian"]

TURN = 2 * np.pi
#: Numbers that are transformed along time at once.
AT_ONCE = 2**23

Phase = NDArray[np.float32]


def laplacian(
    problem: Problem,
    result: Stack,
    task: Task,
    *,
    variant: str = "textbook",
    rounded: bool = False,
) -> list[Limits]:
    """Estimate the phase from the Laplacian of its wrapped values.

    Textbook form (Schofield & Zhu 2003): u = L^-1[cos w L(sin w) - sin w L(cos w)], with L the
    second-difference operator over time, angle, y and x that has no flux across the borders; its
    eigenvalues in the cosine transform are the sums of 2 cos(pi k / n) - 2.

    The form of PhaseTools (Barnhill et al. 2015) divides inside each transform by
    K = sum of (k + 1)^2 over all axes, k counted in samples:
    u = D^-1[D(c D^-1(K D(s))) / K] - D^-1[D(s D^-1(K D(c))) / K].

    Parameters
    ----------
    problem : Problem
        Pixels outside the mask count as phase 0.
    result : Stack
        Where the estimate goes, in radians. Its constant is open; the border of the boundary frame
        is set to the wrapped phase there (0 outside the mask).
    task : Task
        Who is told of it, and may stop it.
    variant : str, optional
        "textbook" (default) or "phasetools".
    rounded : bool, optional
        Whether to add to the wrapped phase the number of turns that comes nearest to the
        estimate. Default False: the raw estimate, which is not congruent with the wrapped phase.

    Returns
    -------
    list of (float, float)
        Smallest and largest phase of every block, radians.
    """
    mask = problem.counted(task)
    stages = Stages(problem, mask, task)
    terms = stages.textbook() if variant == "textbook" else stages.phasetools()
    time, angle = problem.first
    estimate = EstimateBlock(problem.given, mask, terms, result, 0.0, rounded)
    level = missing_level(estimate, Block(time, time + 1), angle)
    work = EstimateBlock(problem.given, mask, terms, result, level, rounded)
    return problem.each(work, "writing", task)


class Stages:
    """What is done one after the other.

    Parameters
    ----------
    problem : Problem
        What to estimate.
    mask : Stack
        Its mask.
    task : Task
        Who is told of it, and may stop it.
    """

    def __init__(
        self,
        problem: Problem,
        mask: Stack,
        task: Task,
    ) -> None:
        self._problem = problem
        self._mask = mask
        self._task = task

    def textbook(self) -> tuple[Stack, ...]:
        """Solve the discrete Poisson equation with free borders."""
        source = self._over_frames("transformed", laplacian_of_wrapped)
        return (self._along_time(source, "along time", divide_by_eigenvalues),)

    def phasetools(self) -> tuple[Stack, ...]:
        """Return the two terms that PhaseTools' estimate is the difference of."""
        return (
            self._term(np.cos, np.sin, "first term"),
            self._term(np.sin, np.cos, "second term"),
        )

    def _term(self, outer: np.ufunc, inner: np.ufunc, name: str) -> Stack:
        """Return D^-1[D(a D^-1(K D(b))) / K] but for the last transform over each frame."""
        found = self._over_frames("transformed", inner)
        found = self._along_time(found, "along time", multiply_by_factor)
        found = self._over_frames("transformed", outer, found)
        return self._along_time(found, name, divide_by_factor)

    def _over_frames(
        self, name: str, of_phase: Callable[[Phase], Phase], times: Stack | None = None
    ) -> Temporary:
        """Transform something over each frame."""
        problem, shape = self._problem, self._problem.given.shape
        out = problem.store.temporary(name, shape, "float32")
        work = FramesBlock(problem.given, self._mask, of_phase, times, out)
        problem.each(work, "Laplacian estimate, frame by frame", self._task)
        return out

    def _along_time(self, source: Temporary, name: str, change: Change) -> Temporary:
        """Change a transform, between a transform of each pixel along time and back."""
        problem, shape = self._problem, self._problem.given.shape
        out = problem.store.temporary(name, shape, "float32")
        count = int(np.prod(shape[1:]))
        each = max(1, AT_ONCE // shape[0])
        parts = [Block(p, min(p + each, count)) for p in range(0, count, each)]
        watch = Watch(len(parts), "Laplacian estimate, along time", self._task)
        for _ in problem.on_workers(TimeBlock(source, out, change), parts, watch):
            pass
        return out


# ---- over each frame --------------------------------------------------------------------------


def forward(times: Phase) -> Phase:
    """Transform the frames of each time over x, y and angle."""
    return np.stack([over_axes(scipy.fft.dct, frames, (2, 1, 0)) for frames in times])


def backward(times: Phase) -> Phase:
    """Transform the frames of each time back, over angle, y and x."""
    return np.stack([over_axes(scipy.fft.idct, frames, (0, 1, 2)) for frames in times])


def over_axes(transform: Callable[..., Any], frames: Phase, axes: tuple[int, ...]) -> Phase:
    """Transform along one axis after the other.

    It is always one time that is given: what is done to a line must not depend on where a
    recording is cut, down to which lines a processor takes together.
    """
    for axis in axes:
        frames = transform(frames, axis=axis, norm="ortho")
    return frames


@dataclass(frozen=True)
class FramesBlock:
    """Transforms frames of something that follows from the phase.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    mask : Stack
        Pixels outside count as phase 0.
    of_phase : callable
        What follows from the phase; of the frames before and after, one counts at most.
    times : Stack or None
        By which transform, transformed back, that is multiplied.
    out : Stack
        Where it goes.
    """

    given: Given
    mask: Stack
    of_phase: Callable[[Phase], Phase]
    times: Stack | None
    out: Stack

    def __call__(self, block: Block) -> None:
        """Do a block."""
        seen = block.wider(1, 1, self.given.shape[0])
        wrapped = np.where(self.mask.read(seen), self.given.read(seen)[0], np.float32(0))
        found = self.of_phase(wrapped)[block.of(seen)]
        if self.times is not None:
            found = found * backward(self.times.read(block))
        self.out.write(block, forward(found))


def laplacian_of_wrapped(wrapped: Phase) -> Phase:
    """Return what the Laplacian of the phase is, as its wrapped values say."""
    cosine, sine = np.cos(wrapped), np.sin(wrapped)
    source = cosine * second_difference(sine)
    source -= sine * second_difference(cosine)
    return source


def second_difference(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return for each pixel the sum of the differences of its neighbours to it."""
    total = np.zeros_like(values)
    for axis in range(values.ndim):
        step = np.diff(values, axis=axis)
        head, tail = ends_along(axis, values.ndim)
        total[head] += step
        total[tail] -= step
    return total


# ---- along time -------------------------------------------------------------------------------

#: Changes some pixels of a transform (time, pixel) of a stack of some shape, in place.
Change = Callable[[Phase, tuple[int, ...], Block], None]


@dataclass(frozen=True)
class TimeBlock:
    """Transforms pixels along time, changes them, and transforms them back.

    Parameters
    ----------
    source, out : Temporary
        Where they lie, and where they go.
    change : callable
        What is done to them.
    """

    source: Temporary
    out: Temporary
    change: Change

    def __call__(self, pixels: Block) -> None:
        """Do some pixels of all times."""
        spectrum = scipy.fft.dct(self.source.read_pixels(pixels), axis=0, norm="ortho")
        self.change(spectrum, self.source.shape, pixels)
        self.out.write_pixels(pixels, scipy.fft.idct(spectrum, axis=0, norm="ortho"))


def divide_by_eigenvalues(spectrum: Phase, shape: tuple[int, ...], pixels: Block) -> None:
    """Divide by the eigenvalues of the second difference; the mean of the phase is open."""
    eigenvalues = sum_over_axes(shape, pixels, lambda n: 2 * np.cos(np.pi * np.arange(n) / n) - 2)
    if pixels.start == 0:
        eigenvalues[0, 0] = 1
    spectrum /= eigenvalues
    if pixels.start == 0:
        spectrum[0, 0] = 0


def multiply_by_factor(spectrum: Phase, shape: tuple[int, ...], pixels: Block) -> None:
    """Multiply by K, see `laplacian`."""
    spectrum *= sum_over_axes(shape, pixels, squares)


def divide_by_factor(spectrum: Phase, shape: tuple[int, ...], pixels: Block) -> None:
    """Divide by K, see `laplacian`."""
    spectrum /= sum_over_axes(shape, pixels, squares)


def squares(n: int) -> NDArray[np.floating]:
    """Return the squares of 1 to n."""
    return (np.arange(n) + 1.0) ** 2


def sum_over_axes(
    shape: tuple[int, ...], pixels: Block, values: Callable[[int], NDArray[np.floating]]
) -> Phase:
    """Return the sum of a function of each axis' indices, for some pixels of all times."""
    total = np.zeros((shape[0], len(pixels)), dtype=np.float32)
    total += values(shape[0])[:, None]
    places = np.unravel_index(np.arange(pixels.start, pixels.stop), shape[1:])
    for n, place in zip(shape[1:], places, strict=True):
        total += values(n)[place]
    return total


# ---- the estimate -----------------------------------------------------------------------------


@dataclass(frozen=True)
class EstimateBlock:
    """Writes the estimate.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    mask : Stack
        0 outside.
    terms : tuple of Stack
        Transform of the estimate, or of the two that it is the difference of.
    result : Stack
        Where it goes.
    level : float
        What is added, radians.
    rounded : bool
        Whether to add whole turns to the wrapped phase instead.
    """

    given: Given
    mask: Stack
    terms: tuple[Stack, ...]
    result: Stack
    level: float
    rounded: bool

    def estimate(self, block: Block) -> Phase:
        """Return the estimate of a block, whose constant is open."""
        first, *others = (backward(term.read(block)) for term in self.terms)
        for other in others:
            first = first - other
        return first

    def __call__(self, block: Block) -> Limits:
        """Do a block; return its smallest and largest phase."""
        wrapped, usable = self.given.read(block)
        estimate = self.estimate(block)
        estimate += self.level
        if self.rounded:
            turns = np.round((estimate - wrapped) / TURN).astype(np.float32)
            estimate = wrapped + np.float32(TURN) * turns
        estimate = np.where(self.mask.read(block), estimate, np.float32(0))
        estimate = self.given.without_unknown(estimate, usable)
        self.result.write(block, estimate)
        return limits_of(estimate)


def missing_level(estimate: EstimateBlock, at: Block, angle: int) -> float:
    """Return what is missing to the phase at the border of the boundary frame, radians."""
    wrapped, _ = estimate.given.read(at)
    frame = np.where(estimate.mask.read(at), wrapped, np.float32(0))[0, angle]
    edge = border_of(frame.shape)
    return float(np.median(frame[edge]) - np.median(estimate.estimate(at)[0, angle][edge]))
