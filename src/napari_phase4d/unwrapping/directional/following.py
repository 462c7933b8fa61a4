"""Steps followed over time from a frame where they are small: a second opinion on each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.directional.groups import CERTAIN, heavier
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import (
    FLOOR_TIMES,
    HALF_A_TURN,
    Courses,
    Floors,
    Opinion,
    Weighed,
    along,
    turns_between,
    weighed_steps,
)

__all__ = ["follow", "followed_steps"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
#: A spatial step beyond this many radians makes a start of following as doubtful as roughness, and
#: a boundary frame with many of them is not thin.
STEEP = 1.5
#: The boundary frame is thin if none of the others looked at has less than this share of its steep
#: steps. Any share from 0.15 to 0.5 does the same.
THINNER = 1 / 3
#: Steps within a thin boundary frame weigh so many times as much, but no more than those that are
#: just not certain. From 20 times on walls come right in more noise, and thick cells wrong whose
#: boundary frame is wrong by itself.
AUTHORITY = 12
#: Followed steps count where they are steadier than this, in radians.
FOLLOWED = 3.0
#: A step is at least this share as doubtful as it was once followed, see `remember`.
REMEMBERED = np.float32(0.6)


def followed_steps(
    scene: Scene, floors: Floors, watch: Watch, *, frames: int = 0, remembering: bool = True
) -> Iterator[Weighed]:
    """Yield all steps with their second opinions, see `weighed_steps` and `with_followed`.

    With `remembering`, those within a thin boundary frame weigh more, see `outweigh`.
    """
    start = scene.frames.start[0]
    steps = weighed_steps(scene, floors, watch, frames=frames)
    if not remembering:
        return with_followed(steps, start, remembering=False)
    return with_followed(steps, start, thin=is_thin(scene, watch))


# ---- the boundary frame ----------------------------------------------------------------------


def is_thin(scene: Scene, watch: Watch) -> bool:
    """Say whether the object is about as thin in the boundary frame as at any time looked at.

    A recording that begins where the object is thickest is known by its other frames. Of one time
    alone there is nothing to hold it against. Where part of the object has left the field, as
    much less of it is steep, which says nothing.
    """
    n, start = scene.shape[0], scene.frames.start[0]
    times = sorted({start, *range(0, n, -(-n // FLOOR_TIMES))})

    def work(time: int) -> tuple[int, int]:
        return steep_steps(scene, time)

    found = dict(zip(times, in_threads(work, times, watch.quiet(len(times))), strict=True))
    steep, every = found[start]
    return n > 1 and all(
        some * every >= THINNER * steep * min(every, of_all) for some, of_all in found.values()
    )


def steep_steps(scene: Scene, time: int) -> tuple[int, int]:
    """Count the object's steps along y and x at a time, in all views: the steep ones, and all."""
    block = Block(time, time + 1)
    seen, seams = scene.read_box(block), scene.seams(block)
    counts = np.zeros(2, dtype=np.int64)
    for axis in (axis for axis in (2, 3) if scene.part[axis] > 1):
        steps = along(axis, seen, seams)
        inside = steps.valid & ~steps.bare
        steep = np.abs(steps.step) > np.float32(STEEP)
        counts += np.count_nonzero(steep & inside), np.count_nonzero(inside)
    return int(counts[0]), int(counts[1])


def outweigh(rough: Image) -> None:
    """Let steps within a thin boundary frame weigh more, in place, where they are not smooth.

    A wall or a rim that is steep there may pass half a turn soon after. From then on it looks
    smoother a turn lower, the more so the higher it gets, and many such frames outvote the few
    before. What has changed between them is known well and would be the same either way. So the
    frame that the paper takes its boundary condition from (section 2) decides.
    """
    rough[:] = np.minimum(rough, np.maximum(heavier(rough, AUTHORITY), CERTAIN))


# ---- steps followed --------------------------------------------------------------------------


def with_followed(
    blocks: Iterable[Weighed], start: int, *, remembering: bool = True, thin: bool = False
) -> Iterator[Weighed]:
    """Add the second opinions: steps followed along time from a frame where they are small.

    A wall that grows through half a turn looks smooth again near a whole one. Its step a moment
    before was smaller and is known; what it has changed since is small and is known as well. So a
    step may be that at the start plus all its changes since; it is as doubtful as the roughest
    that was met on the way.

    Parameters
    ----------
    blocks : iterable of Weighed
        From the start on, then those before it.
    start : int
        Frame at which the object is thin.
    remembering : bool, optional
        Whether steps are no smoother than what they went through allows, see `remember`.
    thin : bool, optional
        Whether those within the frame at the start weigh more, see `outweigh`.
    """
    first: dict[int, tuple[Image, Image]] = {}
    last: dict[int, tuple[Image, Image]] = {}
    for weighed in blocks:
        block = weighed.block
        for axis, course in weighed.along.items():
            forward = block.start >= start
            before = None
            if block.start > start:
                before = last[axis]
            elif not forward:
                before = first[axis]
            # Not kept with every block that waits: they take as much memory as the phase.
            step = turned(course.difference)
            rough = weighed.by_axis[axis].rough
            rough -= fade_of(course, block)
            followed, doubt = follow(course, step, rough, block, before, forward=forward)
            if remembering:
                remember(rough.reshape(-1), doubt.reshape(-1))
            if thin and block.start == start:
                outweigh(rough[0])  # as far as amplitude does not fade
            rough += fade_of(course, block)
            if block.start == start:
                first[axis] = followed[0].copy(), doubt[0].copy()
            edge = -1 if forward else 0
            ends = followed[edge].copy(), doubt[edge].copy()
            if forward:
                last[axis] = ends
            else:
                first[axis] = ends
            second_opinion(weighed, axis, step, followed, doubt)
        weighed.along.clear()
        yield weighed


def follow(
    course: Courses,
    step: Image,
    rough: Image,
    block: Block,
    before: tuple[Image, Image] | None,
    *,
    forward: bool,
) -> tuple[Image, Image]:
    """Return followed steps of a block and their doubt, see `with_followed`.

    Parameters
    ----------
    course : Courses
        What the steps do over time.
    step : ndarray of float32
        The steps of the block and next to it in radians.
    rough : ndarray of float32
        Roughness of those of the block in radians.
    block : Block
        Frames to follow through.
    before : tuple of ndarray, or None
        Followed steps and doubt of the frame next to the block; None at the start itself.
    forward : bool
        Whether that frame lies before the block.
    """
    own = block.of(course.way)
    whole = (len(block), *step.shape[1:])
    shape = (len(block), math.prod(step.shape[1:]))
    followed, doubt = np.empty(shape, np.float32), np.empty(shape, np.float32)
    step, unsteady = (part.reshape(len(part), shape[1]) for part in (step, course.unsteady))
    k = own.start if forward else own.stop - 1
    if before is None:
        steep = np.maximum(np.abs(step[k]) - np.float32(STEEP), 0)
        now = step[k], rough[k - own.start].ravel() + steep
        followed[0], doubt[0] = now
        k += 1
    else:
        now = before[0].ravel(), before[1].ravel()
    way = 1 if forward else -1
    follow_lines(step, unsteady, *now, followed, doubt, k, own.start, own.stop, way)
    return followed.reshape(whole), doubt.reshape(whole)


@compiled
def follow_lines(
    step: Image,
    unsteady: Image,
    before: Image,
    doubt_before: Image,
    followed: Image,
    doubt: Image,
    k: int,
    first: int,
    stop: int,
    way: int,
) -> None:
    """Follow steps (time, place) from frame k on, one way; what was before is given."""
    turn = np.float32(2 * np.pi)
    while first <= k < stop:
        link = min(k, k - way)
        for i in range(step.shape[1]):
            change = step[k, i] - step[k - way, i]
            change -= turn * np.round(change / turn)
            if k - way < first or k - way >= stop:
                followed[k - first, i] = before[i] + change
                doubt[k - first, i] = max(doubt_before[i], unsteady[link, i])
            else:
                followed[k - first, i] = followed[k - way - first, i] + change
                doubt[k - first, i] = max(doubt[k - way - first, i], unsteady[link, i])
        k += way


def fade_of(course: Courses, block: Block) -> Image | np.float32:
    """Return the roughness that fading amplitude stands for in a block."""
    fade = course.fade
    return fade[block.of(course.way)] if isinstance(fade, np.ndarray) else fade


@compiled
def remember(rough: Image, doubt: Image) -> None:
    """Let steps be no smoother than what they went through allows, in place.

    Where noise has blurred a wall, some of its steps passed half a turn unseen on its way to a
    whole one. These look smooth then and have no second opinion, though what they went through was
    rough: one of them that counts as certain would tie all that is inside to what is outside. A
    step that was steep at the start may be one of these as well: nobody saw how it became so.
    """
    for i in range(len(rough)):
        if doubt[i] < np.inf:
            rough[i] = max(rough[i], REMEMBERED * doubt[i])


def second_opinion(
    weighed: Weighed, axis: int, step: Image, followed: Image, doubt: Image
) -> None:
    """Put the second opinion on the steps of a block where it differs and is no more doubtful."""
    course, kept = weighed.along[axis], weighed.by_axis[axis].kept
    own = weighed.block.of(course.way)
    rough = doubt + fade_of(course, weighed.block)
    other = np.empty(rough.shape, dtype=bool)
    steps, opinions, doubts = (part.reshape(-1) for part in (step[own], followed, rough))
    if not mark_others(steps, opinions, doubts, kept.reshape(-1), other.reshape(-1)):
        return
    turns = turns_between(course.difference[own], followed)
    weighed.followed[axis] = Opinion(turns, rough, other, np.zeros_like(other))
    weighed.by_axis[axis].small[other] = False


@compiled
def mark_others(step: Image, followed: Image, rough: Image, kept: Mask, other: Mask) -> bool:
    """Mark the steps on which a second opinion differs and is no more doubtful; say if any is."""
    found = False
    for i in range(len(step)):
        differs = abs(followed[i] - step[i]) > HALF_A_TURN
        other[i] = kept[i] and differs and rough[i] < FOLLOWED
        found = found or other[i]
    return found
