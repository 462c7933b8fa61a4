"""Whether the mass of objects adds up from frame to frame, as it does unless an object slips.

The phase summed over an object is its dry mass (Barer 1952, Nature 169, 366). It stays what it is
where the object moves, turns, changes its form, divides or meets another one, and growth changes
it slowly. An object that slips by a turn loses a turn over all of its area at once.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block, Stack
from napari_phase4d.task import Task, Watch, in_threads
from napari_phase4d.unwrapping import Judged, Problem, border_medians, shrunk, working_blocks

__all__ = ["Balance", "balance_of", "core_of", "object_of"]

TURN = 2 * np.pi
#: So many pixels are taken off the rim of objects, by which too much is not found empty.
SPARE = 3
#: Pixels are clearly no empty field that differ from it by so many radians and so many times the
#: noise.
CLEAR, NOISES = 0.3, 3.0
#: About so many pixels of the empty field give a frame's level.
ENOUGH = 5000
#: What a change of mass is held against: so many changes before and after it; at least so many in
#: all.
NEAR, FEWEST = 3, 2
#: Mass is missing if a change differs from their median by more than so many times their median
#: deviation from it, and by a turn over this share of the area.
TIMES, SHARE = 5.0, 0.05
#: An object may have slipped if a turn over a share of it between the middle two is missing: with
#: less it is a part of it at most, and more than all of it none can miss.
NONE_OF_IT, MOST, ALL, TOO_MUCH = 0.4, 0.7, 1.2, 1.5

Mask = NDArray[np.bool_]
Labels = NDArray[np.int32]
Whole = NDArray[np.intp]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Balance:
    """How likely objects have slipped, by the mass that is missing since the boundary frame.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    slipped : list of list of ndarray
        From 0 to 1 for the objects of each frame, by time and angle, see `objects_in_frame`.
    """

    problem: Problem
    slipped: list[list[Numbers]]

    def read(self, block: Block) -> NDArray[np.float32]:
        """Return it for every pixel of some times; 0 outside of objects."""
        found = np.zeros((len(block), *self.problem.given.shape[1:]), dtype=np.float32)
        here = self.slipped[block.start : block.stop]
        if not any(each.any() for views in here for each in views):
            return found
        empty = self.problem.background().empty
        inside = object_of(self.problem, empty, block)
        for frame in np.ndindex(*inside.shape[:2]):
            each = here[frame[0]][frame[1]]
            if each.any():
                labels = objects_in_frame(inside[frame])
                found[frame] = np.concatenate([[0], each])[labels]
        return found


def object_of(problem: Problem, empty: Stack | None, block: Block) -> Mask:
    """Mark what of the usable field of a block is not empty; all of it if nothing is given."""
    lost = problem.lost()[block.start : block.stop]
    usable = problem.given.read(block)[1] & ~lost[..., None, None]
    return usable if empty is None else usable & ~empty.read(block)


def core_of(mask: Mask) -> Mask:
    """Return a mask without its rim of `SPARE` pixels; what lies beyond the view has none."""
    for _ in range(SPARE):
        mask = shrunk(mask, beyond=True)
    return mask


def objects_in_frame(inside: Mask) -> Labels:
    """Return numbers from 1 for the pieces of a frame (y, x) that are more than a rim, else 0."""
    labels, count = scipy.ndimage.label(inside)
    solid = np.bincount(labels[core_of(inside)], minlength=count + 1) > 0
    solid[0] = False
    found: Labels = np.where(solid, np.cumsum(solid), 0).astype(np.int32)[labels]
    return found


# ---- what is looked at -----------------------------------------------------------------------


@dataclass(frozen=True)
class Objects:
    """The objects of a frame.

    Parameters
    ----------
    mass : ndarray of float
        Phase above the empty field, summed over each: turns times pixels.
    size : ndarray of int
        Pixels of each that are clearly no empty field.
    whole : ndarray of bool
        Whether each lies wholly within what is known.
    """

    mass: Numbers
    size: Whole
    whole: Mask


@dataclass(frozen=True)
class Change:
    """What becomes of the objects of a frame in the next one of its view that says anything.

    Objects that lie on each other are of one group, so that what divides or meets stays in one.

    Parameters
    ----------
    before, after : ndarray of int
        The group of each object of this frame, and of the next one.
    gain, area : ndarray of float
        Mass that each group gains, turns times pixels; how many pixels it takes in either frame.
    known : ndarray of bool
        Whether it is known: not where objects come or go, or are cut off.
    """

    before: Whole
    after: Whole
    gain: Numbers
    area: Numbers
    known: Mask


@dataclass(frozen=True)
class Look:
    """A frame, its objects numbered."""

    labels: Labels
    objects: Objects


@dataclass(frozen=True)
class BalanceBlock:
    """Looks at the objects of a block, and at what becomes of them.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    result : Judged
        The result that is looked at.
    level : ndarray of float, shape (time, angle)
        Phase of the empty field, radians.
    """

    problem: Problem
    result: Judged
    level: Numbers
    kept: list[Whole] = field(init=False)

    def __post_init__(self) -> None:
        kept = [np.flatnonzero(~of_view) for of_view in self.problem.lost().T]
        object.__setattr__(self, "kept", kept)

    def __call__(self, block: Block) -> list[list[tuple[int, Objects, Change | None]]]:
        """Return time, objects and change of each frame of the block, by view."""
        looks = self._looks(block)
        found = []
        for angle, kept in enumerate(self.kept):
            here = kept[(kept >= block.start) & (kept < block.stop)]
            after = kept[kept >= block.stop][:1]
            views = [looks[time - block.start][angle] for time in here]
            views += [self._looks(Block(int(t), int(t) + 1))[0][angle] for t in after]
            changes = [change_between(*two) for two in pairwise(views)]
            found.append(
                [
                    (int(time), views[i].objects, changes[i] if i < len(changes) else None)
                    for i, time in enumerate(here)
                ]
            )
        return found

    def _looks(self, block: Block) -> list[list[Look]]:
        """Look at all frames of a block, by time and angle."""
        background = self.problem.background()
        steady = self.result.read(block) - background.ground(self.level, block)
        usable = object_of(self.problem, None, block)
        empty = background.empty.read(block)
        times, angles = steady.shape[:2]
        clear = CLEAR + NOISES * background.noise
        return [
            [look_at(steady[t, a], usable[t, a], empty[t, a], clear) for a in range(angles)]
            for t in range(times)
        ]


def look_at(phase: NDArray[np.float32], usable: Mask, empty: Mask, clear: float) -> Look:
    """Look at the objects of a frame.

    Parameters
    ----------
    phase : ndarray of float, shape (y, x)
        Radians, the empty field level; NaN counts as empty field.
    usable, empty : ndarray of bool, same shape
        What is known; the empty field.
    clear : float
        What differs from the empty field by so many radians is clearly something else.
    """
    labels = objects_in_frame(usable & ~empty)
    count = int(labels.max()) + 1
    ground = phase[empty & np.isfinite(phase)]
    level = np.median(ground[:: max(ground.size // ENOUGH, 1)]) if ground.size else 0.0
    above = np.nan_to_num(phase - np.float32(level))
    mass = np.bincount(labels.ravel(), above.ravel(), minlength=count) / TURN
    size = np.bincount(labels[np.abs(above) > clear], minlength=count)
    whole = np.ones(count, dtype=bool)
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        whole[edge] = False
    if not usable.all():
        whole[labels[~shrunk(usable, beyond=True)]] = False
    return Look(labels, Objects(mass[1:], size[1:], whole[1:]))


def change_between(one: Look, other: Look) -> Change:
    """Return what becomes of the objects of a frame in another one."""
    groups, count = scipy.ndimage.label((one.labels > 0) | (other.labels > 0))
    sums: list[NDArray[Any]] = []
    numbers: list[Whole] = []
    known, area = np.ones(count, dtype=bool), np.zeros(count)
    for look in (one, other):
        of_object = np.zeros(len(look.objects.mass), dtype=np.intp)
        seen = look.labels > 0
        of_object[look.labels[seen] - 1] = groups[seen] - 1
        numbers.append(of_object)
        sums.append(np.bincount(of_object, look.objects.mass, minlength=count))
        known &= np.bincount(of_object, minlength=count) > 0
        known &= np.bincount(of_object, ~look.objects.whole, minlength=count) == 0
        area = np.maximum(area, np.bincount(groups[seen] - 1, minlength=count).astype(float))
    return Change(numbers[0], numbers[1], sums[1] - sums[0], area, known)


# ---- what adds up ----------------------------------------------------------------------------


def balance_of(problem: Problem, result: Judged, task: Task) -> Balance:
    """Return how likely the objects of a result have slipped, by the mass that they miss.

    An object that grows from the boundary frame on does not lose mass at once, unless part of it
    is taken for a turn less. What all that it came from lost is counted on the way out from
    there, and what came back is taken off.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    result : Judged
        The result that is looked at.
    task : Task
        Who is told of it, and may stop it.
    """
    level = border_medians(problem.background(task).level, problem.first)
    blocks = working_blocks(problem.given.shape)
    watch = Watch(len(blocks), "adding up the mass", task)
    look = BalanceBlock(problem, result, level)
    times, angles = problem.given.shape[:2]
    lines: list[list[tuple[int, Objects, Change | None]]] = [[] for _ in range(angles)]
    for views in in_threads(look, blocks, watch, wait=True):
        for line, more in zip(lines, views, strict=True):
            line += more
    slipped = [[np.zeros(0)] * angles for _ in range(times)]
    for angle, line in enumerate(lines):
        watch.check()
        changes = [change for _, _, change in line if change is not None]
        start = nearest([time for time, _, _ in line], problem.first[0])
        objects = [seen for _, seen, _ in line]
        for (time, seen, _), missing in zip(
            line, carried(changes, sudden(changes), objects, start), strict=True
        ):
            slipped[time][angle] = likely_slipped(seen, missing)
    return Balance(problem, slipped)


def nearest(times: list[int], wanted: int) -> int:
    """Return the number of the time that is nearest to a wanted one; 0 without any."""
    return int(np.argmin(np.abs(np.array(times) - wanted))) if times else 0


def sudden(changes: list[Change]) -> list[Numbers]:
    """Return by how much the gain of each group differs from those before and after it.

    0 where it does not stand out, or is not known.
    """
    links = [linked(one, other) for one, other in pairwise(changes)]
    found = []
    for number, change in enumerate(changes):
        before, after = (
            range(number - 1, number - 1 - NEAR, -1),
            range(number + 1, number + 1 + NEAR),
        )
        near = np.full((2 * NEAR, len(change.gain)), np.nan)
        near[:NEAR] = along(changes, links, number, before)
        near[NEAR:] = along(changes, links, number, after)
        count = np.isfinite(near).sum(axis=0)
        middle = median_of_known(near)
        jump = change.gain - middle
        # Of few changes the deviation may be small by chance.
        times = TIMES * 2 * NEAR / np.maximum(count, 1)
        usual = times * median_of_known(np.abs(near - middle))
        stands_out = np.abs(jump) > np.maximum(usual, SHARE * change.area)
        found.append(np.where(change.known & (count >= FEWEST) & stands_out, jump, 0.0))
    return found


def linked(one: Change, other: Change) -> Mask:
    """Say which groups of a change go on in which groups of the next one."""
    found = np.zeros((len(one.gain), len(other.gain)), dtype=bool)
    found[one.after, other.before] = True
    return found


def along(changes: list[Change], links: list[Mask], start: int, numbers: range) -> Numbers:
    """Return what the groups of a change (columns) gain in others (rows); NaN if not known."""
    groups = len(changes[start].gain)
    found = np.full((len(numbers), groups), np.nan)
    reached, lost = np.eye(groups, dtype=bool), np.zeros(groups, dtype=bool)
    previous = start
    for row, number in enumerate(numbers):
        if not 0 <= number < len(changes):
            break
        reached = reached @ (links[previous] if number > previous else links[number].T)
        lost = lost | ~reached.any(axis=1) | (reached @ ~changes[number].known)
        found[row] = np.where(lost, np.nan, reached @ changes[number].gain)
        previous = number
    return found


def median_of_known(values: Numbers) -> Numbers:
    """Return the median of each column of what is not NaN; NaN where all is."""
    ordered, count = np.sort(values, axis=0), np.isfinite(values).sum(axis=0)
    columns = np.arange(values.shape[1])
    low, high = (
        ordered[np.maximum(middle, 0), columns] for middle in ((count - 1) // 2, count // 2)
    )
    found: Numbers = np.where(count > 0, (low + high) / 2, np.nan)
    return found


def carried(
    changes: list[Change], jumps: list[Numbers], objects: list[Objects], start: int
) -> list[Numbers]:
    """Add up what is gained at once, outwards from a frame, for the objects of every frame."""
    found = [np.zeros(len(seen.mass)) for seen in objects]
    for i in range(start, len(changes)):
        change = changes[i]
        groups = np.bincount(change.before, found[i], minlength=len(change.gain)) + jumps[i]
        found[i + 1] = groups[change.after]
    for i in range(start - 1, -1, -1):
        change = changes[i]
        groups = np.bincount(change.after, found[i + 1], minlength=len(change.gain)) - jumps[i]
        found[i] = groups[change.before]
    return found


def likely_slipped(objects: Objects, gained: Numbers) -> Numbers:
    """Return from 0 to 1 how well a slip by a turn explains what objects gained at once."""
    side = np.sign(objects.mass - gained)  # on which it would lie without that
    missing = -gained * side / np.maximum(objects.size, 1)
    rises = (missing - NONE_OF_IT) / (MOST - NONE_OF_IT)
    falls = (TOO_MUCH - missing) / (TOO_MUCH - ALL)
    found: Numbers = np.clip(np.minimum(rises, falls), 0, 1)
    return found
