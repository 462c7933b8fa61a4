"""Dilate-erode-propagate (DE), after Barnhill et al. 2015."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.compiling import compiled
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["dilate_erode"]

TURN = 2 * np.pi
#: Quality of pixels whose window leaves the frame or the mask: they come last.
WORST = -np.finfo(np.float64).max
#: A window as flat as this, in radians, says nothing about its middle.
FLAT = 1e-6

Frame = tuple[int, int]
Numbers = NDArray[np.float64]
Turns = NDArray[np.int64]


def dilate_erode(
    problem: Problem,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    variant: str = "textbook",
    max_window: int = 0,
    erode_threshold: float = 6.0,
) -> NDArray[np.float32]:
    """Mend the boundary frame by itself, then carry its phase from frame to frame.

    Each frame is brought to within half a turn of the last valid value of every pixel; then it is
    dilated and eroded; then those of its pixels become the last valid ones whose second difference
    over the last three frames is small. The way goes from the boundary frame through all angles of
    its time, then forward and backward in time, each angle from itself.

    Parameters
    ----------
    problem : Problem
        Boundary frame: the one to start from, PhaseTools' "slice currently displayed".
    progress, cancelled : callable or None
        See `unwrap`.
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
    ndarray of shape (time, angle, y, x)
        In radians, congruent with the wrapped phase inside the mask, 0 outside.
    """
    if max_window < 0 or not erode_threshold > 0:
        msg = (
            "max_window must be 0 or more and erode_threshold positive, "
            f"but they are {max_window} and {erode_threshold:g}"
        )
        raise ValueError(msg)
    side = max(problem.wrapped.shape[2:])
    if max_window > side:
        msg = f"max_window is {max_window}, but must be at most {side}, the frames' longer side"
        raise ValueError(msg)
    watch = Watch(problem.n_frames, "dilating and eroding", progress, cancelled)
    erodes, lags = variant == "textbook", variant == "phasetools"
    wrapped = problem.wrapped.astype(np.float64)
    turns = np.zeros(wrapped.shape, dtype=np.int64)
    valid: dict[Frame, Numbers] = {}
    for path in paths(problem.first, wrapped.shape[:2]):
        for i, here in enumerate(path):
            if here in valid:
                continue
            watch.check()
            mask = problem.mask[here]
            if i > 0:
                turns[here] = nearest_turns(valid[path[i - 1]] - wrapped[here])
            dilate_and_erode(wrapped[here], turns[here], mask, max_window, watch, erodes=erodes)
            now = np.where(mask, wrapped[here] + TURN * turns[here], np.nan)
            before = [
                np.where(problem.mask[f], wrapped[f] + TURN * turns[f], np.nan)
                for f in path[max(i - 2, 0) : i]
            ]
            old = valid[path[i - 1]] if i > 0 else now
            newest = before[-1] if lags and before else now
            trusted = (steepness(before, now) < erode_threshold) | np.isnan(old)
            valid[here] = np.where(trusted & np.isfinite(newest), newest, old)
            watch.step()
    result = problem.wrapped + np.float32(TURN) * turns.astype(np.float32)
    return np.where(problem.mask, result, np.float32(0))


def paths(first: Frame, shape: tuple[int, ...]) -> Iterator[list[Frame]]:
    """Yield the chains of frames along which phase is carried, in their order."""
    t0, a0 = first
    yield [(t0, a) for a in range(a0, shape[1])]
    yield [(t0, a) for a in range(a0, -1, -1)]
    for a in range(shape[1]):
        yield [(t, a) for t in range(t0, shape[0])]
        yield [(t, a) for t in range(t0, -1, -1)]


def nearest_turns(difference: Numbers) -> Turns:
    """Return the turns nearest to a difference in radians; none where it is not known."""
    return np.round(np.nan_to_num(difference) / TURN).astype(np.int64)


def steepness(before: list[Numbers], now: Numbers) -> Numbers:
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
    mean = ndimage.uniform_filter(phase, width, mode="constant")
    whole = ndimage.minimum_filter(mask, width, mode="constant", cval=0)
    found: Numbers = -np.abs(width**2 * (mean - phase))
    found[found > -FLAT] = np.nan
    found[~whole] = WORST
    found[~mask] = np.nan
    return found


def ordered(quality: Numbers, mask: NDArray[np.bool_]) -> Turns:
    """Return the flat indices of the pixels that have a quality, best first."""
    known = np.flatnonzero(np.isfinite(quality) & mask)
    return known[np.argsort(-quality.ravel()[known], kind="stable")]


@compiled
def dilate(wrapped: Numbers, turns: Turns, order: Turns, mask: NDArray[np.bool_]) -> None:
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
def erode(wrapped: Numbers, turns: Turns, order: Turns, mask: NDArray[np.bool_]) -> None:
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
