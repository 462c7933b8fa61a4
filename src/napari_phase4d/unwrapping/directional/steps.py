"""Steps between neighbours, what turns they ask for, and how far each is to be trusted.

A step along time and angle links two frames: their change is unwrapped as a map, see
`lifts_of_changes`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, vectorized
from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, blocks_outwards
from napari_phase4d.task import Watch, in_threads
from napari_phase4d.unwrapping.directional.changes import Denied, changes_along
from napari_phase4d.unwrapping.directional.registration import Seen
from napari_phase4d.unwrapping.directional.residues import (
    FEW,
    residues_of_maps,
    torn_changes,
    torn_objects,
    torn_of_few,
    torn_views,
)
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.given import working_frames
from napari_phase4d.unwrapping.neighbours import change_on_both_sides, ends_along, known_mean

__all__ = [
    "FLOOR_TIMES",
    "HALF_A_TURN",
    "Along",
    "Courses",
    "Floors",
    "Opinion",
    "Weighed",
    "along",
    "courses_of",
    "fading",
    "floors_of",
    "noisier",
    "roughness",
    "turns_between",
    "weighed_steps",
]

TURN = np.float32(2 * np.pi)
HALF_A_TURN = np.float32(np.pi)

#: Fewest steps of the empty field from which the noise floor is taken.
ENOUGH = 50
#: The noise floor is measured at no more times than this, evenly spaced, and so is how thin the
#: object is.
FLOOR_TIMES = 12
#: Mean of D^2 for white noise of one radian: 12 + 2 * 4.7 where there are two changes, which share
#: two thirds of their noise, and 4 * 2 where there is a single step.
OF_TWO_CHANGES, OF_ONE_STEP = 21.4, 8.0
#: Amplitude, as a share of its median, below which fading does not grow; and the roughness in
#: radians that half the median stands for. Any value from 0.5 to 4 does about as well.
FAINTEST, FADING = 0.05, 2.0
#: Changes that are torn count for as little as steps that are so rough, in radians. From 4.5 on it
#: is the same.
TORN = np.float32(6)
#: Pixels, of all views, whose steps are weighed at a time, unless one frame has more.
STEP_PIXELS = 400_000
#: Frames before and after a frame that the weights of its steps depend on: by their roughness, and
#: by whether a change is torn.
BEFORE, AFTER = 2, 3

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Opinion:
    """What the steps along one axis ask for.

    Parameters
    ----------
    turns : ndarray of int16
        Turns of the second end minus those of the first.
    rough : ndarray of float32
        How much steps change along their own direction here, radians.
    kept : ndarray of bool
        Which steps there are.
    small : ndarray of bool
        Steps of less than one radian on which there is no other opinion.
    """

    turns: NDArray[np.int16]
    rough: Image
    kept: Mask
    small: Mask


@dataclass(frozen=True)
class Weighed:
    """All steps of a block of frames, and those to the frame after each.

    Parameters
    ----------
    block : Block
        The kept frames.
    free : ndarray of bool
        The object in its box of them.
    by_axis : dict of int to Opinion
        Steps along time (to the next frame), angle, y and x; none along an axis of one.
    followed : dict of int to Opinion
        A second opinion on some steps along y and x: what they have become since the start.
    along : dict of int to Courses
        What the second opinion follows from.
    """

    block: Block
    free: Mask
    by_axis: dict[int, Opinion]
    followed: dict[int, Opinion] = field(default_factory=dict)
    along: dict[int, Courses] = field(default_factory=dict)


@dataclass(frozen=True)
class Floors:
    """What noise alone makes of the squares that steps are weighed by.

    Parameters
    ----------
    rough : dict of int to float
        For each axis, of the squared roughness.
    change : dict of int to (float, float)
        For y and x, of the squared change over time, and which share of the noise was left there.
    """

    rough: dict[int, float]
    change: dict[int, tuple[float, float]]


@dataclass(frozen=True)
class Along:
    """Steps along one axis before they are weighed.

    Parameters
    ----------
    difference, step : ndarray of float32
        Difference of the wrapped phases in radians, and the step that it stands for.
    inside, valid, bare : ndarray of bool
        Where both ends count; where they are neighbours too; where both are empty field.
    """

    difference: Image
    step: Image
    inside: Mask
    valid: Mask
    bare: Mask


def along(
    axis: int, seen: Seen, seams: NDArray[np.int8], lifts: NDArray[np.int8] | None = None
) -> Along:
    """Return the steps along an axis, with the turns that their maps are lifted by."""
    head, tail = ends_along(axis, 4)
    difference = seen.phase[tail] - seen.phase[head]
    inside = seen.usable[head] & seen.usable[tail]
    valid = inside & (seams[head] == seams[tail])
    bare = seen.empty[head] & seen.empty[tail]
    step = turned(difference)
    if lifts is not None:
        step += TURN * lifts.astype(np.float32)
    return Along(difference, step, inside, valid, bare)


def part_of(seen: Seen, frames: slice) -> Seen:
    """Return some of the frames."""
    amplitude = None if seen.amplitude is None else seen.amplitude[frames]
    return Seen(seen.phase[frames], seen.empty[frames], seen.usable[frames], amplitude)


# ---- noise floors ----------------------------------------------------------------------------


def floors_of(scene: Scene, watch: Watch) -> Floors:
    """Measure on the empty field what noise alone makes of the squares."""
    n = scene.shape[0]
    times = range(0, n, -(-n // FLOOR_TIMES))

    def work(time: int) -> dict[tuple[str, int], tuple[float, float, int]]:
        return ground_squares(scene, time)

    total: dict[tuple[str, int], list[float]] = {}
    for found in in_threads(work, times, watch.quiet(len(times))):
        for name, sums in found.items():
            old = total.setdefault(name, [0.0, 0.0, 0.0])
            total[name] = [a + b for a, b in zip(old, sums, strict=True)]
    rough, change = {}, {}
    for axis in (axis for axis in range(4) if scene.part[axis] > 1):
        of_noise = OF_ONE_STEP if scene.part[axis] == 2 else OF_TWO_CHANGES
        squares, _, count = total.get(("rough", axis), (0.0, 0.0, 0))
        rough[axis] = squares / count if count >= ENOUGH else of_noise * scene.noise**2
        squares, shares, count = total.get(("change", axis), (0.0, 0.0, 0))
        floor = squares / count if count >= ENOUGH else 4 * scene.noise**2
        change[axis] = floor, shares / count if count else 1.0
    return Floors(rough, change)


def ground_squares(scene: Scene, time: int) -> dict[tuple[str, int], tuple[float, float, int]]:
    """Return sums of squares on the empty field at a time, of the noise left, and their number."""
    n = scene.shape[0]
    own = Block(time, time + 1)
    around = own.wider(1, 2, n)
    seen, seams, left = scene.boxed(around)
    found = {}
    for axis in (axis for axis in range(4) if seen.phase.shape[axis] > 1):
        if axis == 0 and time + 1 == n:
            continue
        frames = slice(None) if axis == 0 else own.of(around)
        lifts = scene.lifts_of(axis, around if axis == 0 else own)
        steps = along(axis, part_of(seen, frames), seams[frames], lifts)
        here = own.of(around) if axis == 0 else slice(None)
        squares = change_on_both_sides(steps.step, axis, steps.valid)[here]
        ground = (steps.bare & steps.valid)[here]
        found["rough", axis] = float(squares[ground].sum(dtype=np.float64)), 0.0, int(ground.sum())
        if axis >= 2 and time + 1 < n:
            both = Block(time, time + 2).of(around)
            steps = along(axis, part_of(seen, both), seams[both])
            squares, known, share = changes(steps, None if left is None else left[both], axis)
            ground = steps.bare[1:] & steps.bare[:-1] & known
            shares = 0.0 if share is None else float(share[ground].sum(dtype=np.float64))
            total = float(squares[ground].sum(dtype=np.float64))
            found["change", axis] = total, shares, int(ground.sum())
    return found


# ---- weights ---------------------------------------------------------------------------------


def weighed_steps(
    scene: Scene, floors: Floors, watch: Watch, *, frames: int = 0
) -> Iterator[Weighed]:
    """Yield the steps of all frames in blocks: from the start on, then those before it.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    floors : Floors
        What noise alone makes.
    watch : Watch
        Counts blocks.
    frames : int, optional
        How many frames to work on at a time.
    """
    start = scene.frames.start[0]
    # Several blocks wait for each other, and each takes some fifty bytes a pixel.
    most = max(STEP_PIXELS // math.prod(scene.shape[1:]), 1)
    frames = frames or min(working_frames(scene.part), most)
    ahead, behind = blocks_outwards(scene.shape[0], start, frames)
    watch.total = len(ahead) + len(behind)

    def work(block: Block) -> Weighed:
        return weigh(scene, floors, block)

    return in_threads(work, [*ahead, *behind], watch, large=True)


def weigh(scene: Scene, floors: Floors, block: Block) -> Weighed:
    """Weigh the steps of a block of frames."""
    n = scene.shape[0]
    around, near = block.wider(BEFORE, AFTER, n), block.with_neighbours(n)
    seen, seams, left = scene.boxed(around, amplitude=True)
    frames, own = near.of(around), block.of(near)
    close, close_seams = part_of(seen, frames), seams[frames]
    share = None if left is None else left[frames]
    forward = block.start >= scene.frames.start[0]
    way = block.wider(1, 0, n) if forward else block.wider(0, 1, n)
    courses = {}

    # What an axis takes on the way goes before the next one.
    def weigh_along(axis: int) -> Opinion:
        if axis == 0:
            steps = along(axis, seen, seams, scene.lifts_of(axis, around))
            inner = block.of(around)
            found = opinion(axis, steps, steps.valid, floors, seen.amplitude, inner)
            doubt_lifted(found, steps.step[inner], seen, inner, few=n <= FEW)
            return found
        steps = along(axis, close, close_seams, scene.lifts_of(axis, near))
        kept = steps.valid
        if axis > 1:  # within an island of the empty field there is nothing to ask
            kept = kept & ~steps.bare
            if n > 1:
                courses[axis] = courses_of(axis, steps, share, floors, close, near, way)
        return opinion(axis, steps, kept, floors, close.amplitude, own)

    by_axis = {axis: weigh_along(axis) for axis in range(4) if scene.part[axis] > 1}
    doubt_torn(by_axis, seen, seams, block.of(around), n <= FEW)
    return Weighed(block, part_of(seen, block.of(around)).free, by_axis, {}, courses)


def doubt_torn(
    by_axis: dict[int, Opinion], seen: Seen, seams: NDArray[np.int8], own: slice, few: bool
) -> None:
    """Let objects count for little in changes that they tear, in place; see `torn_changes`."""
    if 0 not in by_axis:  # nothing to compare them with
        return
    over_time = changes_along(0, seen, seams)
    for axis in (axis for axis in by_axis if axis < 2):
        maps = over_time if axis == 0 else changes_along(axis, seen, seams)
        counts = residues_of_maps(*maps, axis)
        if axis == 1:
            torn = torn_views(residues_of_maps(*over_time, axis), counts)
        elif few:
            torn = torn_of_few(counts, residues_of_maps(seen.phase, seen.usable, seen.empty, 0))
        else:
            torn = torn_changes(counts)
        rough, (change, known, bare) = by_axis[axis].rough, (part[own] for part in maps)
        for frame in np.argwhere(torn[own]):
            at = tuple(frame)
            by = torn_objects(change[at], known[at], bare[at])
            rough[at][by] = np.maximum(rough[at][by], TORN)


def doubt_lifted(opinion: Opinion, step: Image, seen: Seen, own: slice, *, few: bool) -> None:
    """Let changes over time count for little where the frames deny them; see `Denied`."""
    denied = Denied(seen, few=few)
    for i, angle in np.ndindex(*step.shape[:2]):
        if np.abs(step[i, angle]).max() > HALF_A_TURN:
            by = denied(own.start + i, angle, step[i, angle])
            opinion.rough[i, angle][by] = np.maximum(opinion.rough[i, angle][by], TORN)


def opinion(
    axis: int, steps: Along, kept: Mask, floors: Floors, amplitude: Image | None, own: slice
) -> Opinion:
    """Return what the weighed steps of some frames ask for."""
    rough = roughness(steps.step, axis, steps.valid, floors.rough[axis])
    step = steps.step[own]
    turns = turns_between(steps.difference[own], step)
    return Opinion(
        turns,
        rough[own] + faint(axis, amplitude, own),
        kept[own].copy(),  # a part would hold the frames next to it in memory
        np.abs(step) < np.float32(1),
    )


def faint(axis: int, amplitude: Image | None, own: slice) -> Image | np.float32:
    """Return the roughness that stands for amplitude that fades at either end of a step."""
    if amplitude is None:
        return np.float32(0)
    head, tail = ends_along(axis, 4)
    return fading(np.minimum(amplitude[head], amplitude[tail])[own])


def fading(amplitude: Image) -> Image:
    """Return the roughness in radians that counts for amplitude below its median."""
    return (FADING * (noisier(amplitude) - 1)).astype(np.float32)


def noisier(amplitude: Image) -> Image:
    """Return how many times as noisy phase is where amplitude is below its median, else 1."""
    return np.float32(1) / np.clip(amplitude, np.float32(FAINTEST), np.float32(1))


def roughness(step: Image, axis: int, valid: Mask, floor: float) -> Image:
    """Return how much steps change along their own axis, averaged over a box, less the noise.

    D = |g(j+1) - g(j)| + |g(j) - g(j-1)|, where a missing neighbour counts as the other one, and
    2 |g| where there is none; the root of the mean of D^2 over the valid steps of the box, less
    what noise alone makes of it.

    Parameters
    ----------
    step : ndarray of float32, shape (time, angle, y, x)
        Steps g along the axis, radians.
    axis : int
        Which axis.
    valid : ndarray of bool, same shape
        Steps that count.
    floor : float
        Mean of D^2 where there is nothing but noise.
    """
    rough = known_mean(change_on_both_sides(step, axis, valid), valid)
    rough -= np.float32(floor)
    np.maximum(rough, 0, out=rough)
    np.sqrt(rough, out=rough)
    return rough


# ---- following steps over time ---------------------------------------------------------------


@dataclass(frozen=True)
class Courses:
    """What the steps of a block along y or x do over time.

    Parameters
    ----------
    way : Block
        The frames: those of the block, and the one next to it on the way from the start.
    difference : ndarray of float32
        Difference of the wrapped phases in radians.
    fade : ndarray of float32
        Roughness in radians that fading amplitude stands for.
    unsteady : ndarray of float32
        From each of the frames to the next: twice the root mean square change over 3 x 3 steps,
        less the noise, in radians; infinite where it is not known.
    """

    way: Block
    difference: Image
    fade: Image | np.float32
    unsteady: Image


def changes(steps: Along, left: Image | None, axis: int) -> tuple[Image, Mask, Image | None]:
    """Return squared changes of steps over time, which are known, and the share of noise left."""
    known = steps.valid[1:] & steps.valid[:-1]
    squares = turned(steps.step[1:] - steps.step[:-1])
    square_known(squares.reshape(-1), known.reshape(-1))
    if left is None:
        return squares, known, None
    head, tail = ends_along(axis, 4)
    share = left[head] + left[tail]
    share *= np.float32(0.5)
    mean = share[1:] + share[:-1]
    mean *= np.float32(0.5)
    return squares, known, mean


@compiled
def square_known(numbers: Image, known: Mask) -> None:
    """Square numbers in place; those that are not known become 0."""
    for i in range(len(numbers)):
        numbers[i] = numbers[i] * numbers[i] if known[i] else np.float32(0)


@compiled
def write_unsteady(
    mean: Image, share: Image, floor: np.float32, known: Mask, unsteady: Image
) -> None:
    """Write twice the root of mean squares less the noise; infinite where it is not known."""
    two, none = np.float32(2), np.float32(0)
    for i in range(len(mean)):
        change = two * np.sqrt(max(mean[i] - floor * share[i], none))
        unsteady[i] = change if known[i] else np.float32(np.inf)


def courses_of(
    axis: int,
    steps: Along,
    left: Image | None,
    floors: Floors,
    seen: Seen,
    near: Block,
    way: Block,
) -> Courses:
    """Return how steady the steps of some of the frames that are near a block are over time."""
    frames = way.of(near)
    steps = Along(*(part[frames] for part in vars(steps).values()))
    squares, known, share = changes(steps, None if left is None else left[frames], axis)
    mean = known_mean(squares, known, axes=(2, 3))
    floor, usual = floors.change[axis]
    # Where things move fast less noise was averaged out than on the empty field.
    noise = floor / usual if usual and share is not None else floor
    share = np.ones(mean.shape, dtype=np.float32) if share is None else share
    unsteady = np.empty(mean.shape, dtype=np.float32)
    write_unsteady(
        mean.reshape(-1),
        share.reshape(-1),
        np.float32(noise),
        known.reshape(-1),
        unsteady.reshape(-1),
    )
    fade = faint(axis, seen.amplitude, frames)
    return Courses(way, steps.difference.copy(), fade, unsteady)


def turns_between(difference: Image, step: Image) -> NDArray[np.int16]:
    """Return the turns that make steps of differences of wrapped phase."""
    turns = np.empty(step.shape, dtype=np.int16)
    count_turns(difference.reshape(-1), step.reshape(-1), turns.reshape(-1))
    return turns


@vectorized
def count_turns(difference: Image, step: Image, turns: NDArray[np.int16]) -> None:
    """Do `turns_between` for lines."""
    turn = np.float32(2 * np.pi)
    for i in range(len(turns)):
        turns[i] = np.int16(np.rint((step[i] - difference[i]) / turn))
