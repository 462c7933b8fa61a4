"""Dilate-erode-propagate (DE), after Barnhill et al. 2015."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Limits, Stack, block_at, blocks_of, limits_of
from napari_phase4d.task import Task, Watch, in_threads
from napari_phase4d.unwrapping.alone import Mask, Phase, with_turns
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["dilate_erode"]

TURN = 2 * np.pi
#: Quality of pixels whose window leaves the frame or the mask: they come last.
WORST = -np.finfo(np.float64).max
#: A window as flat as this, in radians, says nothing about its middle.
FLAT = 1e-6

Numbers = NDArray[np.float64]
Turns = NDArray[np.int32]
Order = NDArray[np.intp]


def dilate_erode(
    problem: Problem,
    result: Stack,
    task: Task,
    *,
    variant: str = "textbook",
    max_window: int = 0,
    erode_threshold: float = 6.0,
) -> list[Limits]:
    """Mend the boundary frame by itself, then carry its phase from frame to frame.

    Each frame is brought to within half a turn of the last valid value of every pixel; then it is
    dilated and eroded; then those of its pixels become the last valid ones whose second difference
    over the last three frames is small. The way goes from the boundary frame through all angles of
    its time, then forward and backward in time, each angle from itself.

    Parameters
    ----------
    problem : Problem
        Boundary frame: the one to start from, PhaseTools' "slice currently displayed".
    result : Stack
        Where the unwrapped phase goes: in radians, congruent with the wrapped phase inside the
        mask, 0 outside.
    task : Task
        Who is told of it, and may stop it.
    variant : str, optional
        "textbook" (default): as it is described. "phasetools": as it is programmed there. There
        the last valid value is that of the frame before the newest one; and in the erosion the
        pixel itself has to agree with its neighbours, so that nothing is ever changed.
    max_window : int, optional
        Half the width of the largest window in pixels; with 0, the published default, frames are
        neither dilated nor eroded.
    erode_threshold : float, optional
        Largest second difference in radians of a valid pixel; published default 6.

    Returns
    -------
    list of (float, float)
        Smallest and largest phase of every block, radians.
    """
    if max_window < 0 or not erode_threshold > 0:
        msg = (
            "max_window must be 0 or more and erode_threshold positive, "
            f"but they are {max_window} and {erode_threshold:g}"
        )
        raise ValueError(msg)
    shape = problem.given.shape
    side = max(shape[2:])
    if max_window > side:
        msg = f"max_window is {max_window}, but must be at most {side}, the frames' longer side"
        raise ValueError(msg)
    mask = problem.counted(task)
    blocks = blocks_of(shape)
    frames = task.counting(len(blocks[0]) * shape[1], shape[0] * shape[1])
    watch = Watch(len(blocks), "dilating and eroding", frames)
    rule = Rule(variant, max_window, erode_threshold, watch)
    t0, a0 = problem.first
    limits: dict[int, Limits] = {}

    def write(block: Block, wrapped: Phase, inside: Mask, usable: Mask, turns: Turns) -> None:
        unwrapped = problem.given.without_unknown(with_turns(wrapped, turns, inside), usable)
        result.write(block, unwrapped)
        limits[block.start] = limits_of(unwrapped)
        watch.step()

    def on(block: Block, trails: list[Trail], *, forward: bool) -> list[Trail]:
        wrapped, inside, usable = problem.given.read_marked(block, mask)
        turns = np.zeros(wrapped.shape, dtype=np.int32)
        times = range(len(block)) if forward else range(len(block) - 1, -1, -1)
        trails = rule.through(times, trails, wrapped, inside, turns)
        write(block, wrapped, inside, usable, turns)
        return trails

    watch.check()
    first = block_at(shape, t0)
    wrapped, inside, usable = problem.given.read_marked(first, mask)
    turns = np.zeros(wrapped.shape, dtype=np.int32)
    row = t0 - first.start
    trails = rule.across(a0, wrapped[row], inside[row], turns[row])
    ahead = rule.through(range(row + 1, len(first)), trails, wrapped, inside, turns)
    behind = rule.through(range(row - 1, -1, -1), trails, wrapped, inside, turns)
    write(first, wrapped, inside, usable, turns)
    for block in (b for b in blocks if b.start > first.start):
        ahead = on(block, ahead, forward=True)
    for block in (b for b in reversed(blocks) if b.start < first.start):
        behind = on(block, behind, forward=False)
    return [limits[block.start] for block in blocks]


@dataclass(frozen=True)
class Trail:
    """What is carried along a chain of frames.

    Parameters
    ----------
    valid : ndarray of shape (y, x)
        Last valid phase of every pixel in radians; NaN where there was none.
    newest : tuple of ndarray
        Phase of the last two frames (of one after the first), NaN outside the mask.
    """

    valid: Numbers
    newest: tuple[Numbers, ...]


@dataclass(frozen=True)
class Rule:
    """How phase is carried on.

    Parameters
    ----------
    variant, max_window, erode_threshold
        See `dilate_erode`.
    watch : Watch
        Asked before each frame whether to stop.
    """

    variant: str
    max_window: int
    erode_threshold: float
    watch: Watch

    def across(self, start: int, wrapped: Phase, mask: Mask, turns: Turns) -> list[Trail]:
        """Carry phase from one angle to all others (angle, y, x) of a time; fill the turns.

        Returns
        -------
        list of Trail
            Of every angle, to go on from in time.
        """
        own: dict[int, Trail] = {}
        for way in (range(start, len(wrapped)), range(start, -1, -1)):
            trail: Trail | None = None
            for a in way:
                if a in own:
                    trail = own[a]
                    continue
                trail = self.on(trail, wrapped[a], mask[a], turns[a])
                own[a] = Trail(trail.valid, trail.newest[-1:])
        return [own[a] for a in range(len(wrapped))]

    def through(
        self, times: range, trails: list[Trail], wrapped: Phase, mask: Mask, turns: Turns
    ) -> list[Trail]:
        """Carry phase through some times of a stack (time, angle, y, x); fill the turns."""

        def work(angle: int) -> Trail:
            trail = trails[angle]
            for t in times:
                trail = self.on(trail, wrapped[t, angle], mask[t, angle], turns[t, angle])
            return trail

        angles = range(len(trails))
        return list(in_threads(work, angles, self.watch.quiet(len(trails)), wait=True))

    def on(self, trail: Trail | None, wrapped: Phase, mask: Mask, turns: Turns) -> Trail:
        """Do the next frame of a chain; fill its turns."""
        self.watch.check()
        exact = wrapped.astype(np.float64)
        if trail is not None:
            turns[:] = nearest_turns(trail.valid - exact)
        erodes, lags = self.variant == "textbook", self.variant == "phasetools"
        dilate_and_erode(exact, turns, mask, self.max_window, self.watch, erodes=erodes)
        now = np.where(mask, exact + TURN * turns, np.nan)
        before = trail.newest if trail is not None else ()
        old = trail.valid if trail is not None else now
        newest = before[-1] if lags and before else now
        trusted = (steepness(before, now) < self.erode_threshold) | np.isnan(old)
        valid = np.where(trusted & np.isfinite(newest), newest, old)
        return Trail(valid, (*before, now)[-2:])


def nearest_turns(difference: Numbers) -> Turns:
    """Return the turns nearest to a difference in radians; none where it is not known."""
    return np.round(np.nan_to_num(difference) / TURN).astype(np.int32)


def steepness(before: Sequence[Numbers], now: Numbers) -> Numbers:
    """Return the second difference to the two frames before, or the first to the one before."""
    if not before:
        return np.zeros_like(now)
    if len(before) == 1:
        return np.abs(now - before[0])
    return np.abs(before[0] - 2 * before[1] + now)


def dilate_and_erode(
    wrapped: Numbers,
    turns: Turns,
    mask: NDArray[np.bool_],
    max_window: int,
    watch: Watch,
    *,
    erodes: bool,
) -> None:
    """Bring the pixels of one frame together, with windows that grow and shrink; in place."""
    for largest in up_and_down(max_window):
        for size in up_and_down(largest):
            watch.check()
            dilate(wrapped, turns, ordered(quality(wrapped, turns, mask, size), mask), mask)
            if erodes:
                worst_first = ordered(quality(wrapped, turns, mask, size), mask)[::-1]
                erode(wrapped, turns, worst_first, mask)


def up_and_down(largest: int) -> list[int]:
    """Return 1, 2 ... largest ... 2, 1."""
    return [*range(1, largest), *range(largest, 0, -1)]


def quality(wrapped: Numbers, turns: Turns, mask: NDArray[np.bool_], size: int) -> Numbers:
    """Return how near each pixel is to the mean of the window of ``2 size + 1`` pixels round it.

    -|sum over the window of v - N v|; NaN where the window is flat or the pixel is masked.
    """
    phase = np.where(mask, wrapped + TURN * turns, 0.0)
    width = 2 * size + 1
    mean = scipy.ndimage.uniform_filter(phase, width, mode="constant")
    whole = scipy.ndimage.minimum_filter(mask, width, mode="constant", cval=0)
    found: Numbers = -np.abs(width**2 * (mean - phase))
    found[found > -FLAT] = np.nan
    found[~whole] = WORST
    found[~mask] = np.nan
    return found


def ordered(quality: Numbers, mask: NDArray[np.bool_]) -> Order:
    """Return the flat indices of the pixels that have a quality, best first."""
    known = np.flatnonzero(np.isfinite(quality) & mask)
    return known[np.argsort(-quality.ravel()[known], kind="stable")]


@compiled
def dilate(wrapped: Numbers, turns: Turns, order: Order, mask: NDArray[np.bool_]) -> None:
    """Let each pixel that no better one has reached bring its free neighbours to itself."""
    height, width = wrapped.shape
    hit = np.zeros((height, width), dtype=np.bool_)
    for index in order:
        y, x = index // width, index % width
        if hit[y, x]:
            continue
        value = wrapped[y, x] + TURN * turns[y, x]
        for j in range(max(y - 1, 0), min(y + 2, height)):
            for i in range(max(x - 1, 0), min(x + 2, width)):
                if (j != y or i != x) and mask[j, i] and not hit[j, i]:
                    step = wrapped[j, i] + TURN * turns[j, i] - value
                    turns[j, i] -= int(np.rint(step / TURN))
                    hit[j, i] = True


@compiled
def erode(wrapped: Numbers, turns: Turns, order: Order, mask: NDArray[np.bool_]) -> None:
    """Bring each pixel to its neighbours where they all are off by the same number of turns."""
    height, width = wrapped.shape
    for index in order:
        y, x = index // width, index % width
        value = wrapped[y, x] + TURN * turns[y, x]
        common, agreed, seen = 0, True, False
        for j in range(max(y - 1, 0), min(y + 2, height)):
            for i in range(max(x - 1, 0), min(x + 2, width)):
                if (j == y and i == x) or not mask[j, i]:
                    continue
                off = int(np.rint((wrapped[j, i] + TURN * turns[j, i] - value) / TURN))
                agreed = agreed and (not seen or off == common)
                common, seen = off, True
        if agreed:
            turns[y, x] += common
