"""Whether the mass of objects adds up from frame to frame, as it does unless an object slips.

The phase summed over an object is its dry mass (Barer 1952, Nature 169, 366). It stays what it is
where the object moves, turns, changes its form, divides or meets another one, and growth changes
it slowly. An object that slips by a turn loses a turn over all of its area at once. So does one
that truly loses as much, as a cell that bursts: the two can't be told apart by this.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.analysis.cell_frames import Labels
from napari_phase4d.analysis.objects import object_of, solid_pieces
from napari_phase4d.stack import Block
from napari_phase4d.task import Task, Watch, in_threads
from napari_phase4d.unwrapping import Judged, Problem, border_medians, shrunk, working_blocks

__all__ = [
    "BALANCE",
    "MISSING_MASS",
    "Balance",
    "balance_of",
    "frames_missing_mass",
]

TURN = 2 * np.pi
#: Pixels are clearly no empty field that differ from it by so many radians and so many times the
#: noise.
CLEAR, NOISES = 0.3, 3.0
#: One object becomes another one that takes at least this share of the smaller one's pixels.
OVERLAP = 0.1
#: What a change of mass is held against: so many changes before and after it; at least so many in
#: all.
NEAR, FEWEST = 3, 2
#: Mass is missing if a change differs from their median by more than so many times their median
#: deviation from it, and by a turn over this share of the area.
TIMES, SHARE = 5.0, 0.05
#: An object may have slipped if a turn over a share of it between the middle two is missing: with
#: less it is a part of it at most, and more than all of it none can miss.
NONE_OF_IT, MOST, ALL, TOO_MUCH = 0.4, 0.7, 1.2, 1.5
#: It is said of a frame if an object there has slipped more likely than not.
SAID = 0.5
#: By which names a problem knows the balance of directional L1, and these frames.
BALANCE, MISSING_MASS = "balance", "missing mass"

Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class Balance:
    """How likely objects have slipped, by the mass that is missing since the boundary frame.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    slipped : list of list of ndarray
        From 0 to 1 for the objects of each frame, by time and the problem's angle, see
        `solid_pieces`.
    """

    problem: Problem
    slipped: list[list[Numbers]]

    def frames(self) -> Mask:
        """Mark the frames (time, angle) in which an object has slipped more likely than not."""
        return np.array([[(each > SAID).any() for each in views] for views in self.slipped])

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
                labels = solid_pieces(inside[frame])
                found[frame] = np.concatenate([[0], each])[labels]
        return found


# ---- what is looked at -----------------------------------------------------------------------


@dataclass(frozen=True)
class Objects:
    """The objects of a frame.

    Parameters
    ----------
    mass : ndarray of float
        Phase above the empty field, summed over each: turns times pixels.
    size, area : ndarray of int
        Pixels of each that are clearly no empty field; all pixels of each.
    intact : ndarray of bool
        Whether each lies wholly within what is known.
    """

    mass: Numbers
    size: Index
    area: Index
    intact: Mask


@dataclass(frozen=True)
class Change:
    """What becomes of the objects of a frame in the next one of its view that says anything.

    Objects that lie on each other, see `OVERLAP`, are of one group: what divides or meets stays
    in one.

    Parameters
    ----------
    before, after : ndarray of int
        The group of each object of this frame, and of the next one.
    gain, area : ndarray of float
        Mass that each group gains, turns times pixels; the pixels of its objects in that frame in
        which they are more.
    known : ndarray of bool
        Whether it is known: not where objects come or go, or are cut off.
    steps : int
        Frames from this one to the next one: more than one if some between are lost.
    """

    before: Index
    after: Index
    gain: Numbers
    area: Numbers
    known: Mask
    steps: int


@dataclass(frozen=True)
class Look:
    """A frame at a time, its objects numbered."""

    time: int
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

    def __call__(self, block: Block) -> list[list[tuple[int, Objects, Change | None]]]:
        """Return time, objects and change of each frame of the block, by view."""
        lost = self.problem.frames_left_out()
        views = range(lost.shape[1])
        looks: list[list[Look]] = [[] for _ in views]
        following = [np.flatnonzero(~lost[block.stop :, angle])[:1] for angle in views]
        after = sorted({int(t) + block.stop for each in following for t in each})
        for own in (block, *(Block(t, t + 1) for t in after)):
            for angle, of_view in enumerate(self._looks(own)):
                if own is block or own.start - block.stop in following[angle]:
                    looks[angle] += of_view
        found = []
        for of_view in looks:
            changes = [change_between(*two) for two in pairwise(of_view)]
            own_looks = [look for look in of_view if look.time < block.stop]
            found.append(
                [
                    (look.time, look.objects, changes[i] if i < len(changes) else None)
                    for i, look in enumerate(own_looks)
                ]
            )
        return found

    def _looks(self, block: Block) -> list[list[Look]]:
        """Look at the frames of a block that say anything, by angle."""
        background = self.problem.background()
        steady = self.result.read(block) - background.ground(self.level, block)
        usable = object_of(self.problem, None, block)
        empty = background.empty.read(block)
        clear = CLEAR + NOISES * background.noise
        kept = ~self.problem.frames_left_out()[block.start : block.stop]
        return [
            [
                look_at(block.start + t, steady[t, a], usable[t, a], empty[t, a], clear)
                for t in np.flatnonzero(kept[:, a]).tolist()
            ]
            for a in range(kept.shape[1])
        ]


def look_at(
    time: int, phase: NDArray[np.float32], usable: Mask, empty: Mask, clear: float
) -> Look:
    """Look at the objects of a frame.

    Parameters
    ----------
    time : int
        Which it is.
    phase : ndarray of float, shape (y, x)
        Radians, the empty field level; NaN counts as empty field.
    usable, empty : ndarray of bool, same shape
        What is known; the empty field.
    clear : float
        What differs from the empty field by so many radians is clearly something else.
    """
    labels = solid_pieces(usable & ~empty)
    count = int(labels.max()) + 1
    ground = phase[empty & np.isfinite(phase)]
    level = np.median(ground) if ground.size else 0.0
    above = np.nan_to_num(phase - np.float32(level))
    mass = np.bincount(labels.ravel(), above.ravel(), minlength=count) / TURN
    size = np.bincount(labels[np.abs(above) > clear], minlength=count)
    area = np.bincount(labels.ravel(), minlength=count)
    intact = np.ones(count, dtype=bool)
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        intact[edge] = False
    if not usable.all():
        intact[labels[~shrunk(usable, beyond=True)]] = False
    return Look(time, labels, Objects(mass[1:], size[1:], area[1:], intact[1:]))


def change_between(one: Look, other: Look) -> Change:
    """Return what becomes of the objects of a frame in another one."""
    sizes = len(one.objects.mass), len(other.objects.mass)
    both = (one.labels > 0) & (other.labels > 0)
    codes, shared = np.unique(
        (one.labels[both] - 1) * sizes[1] + other.labels[both] - 1, return_counts=True
    )
    first, second = codes // max(sizes[1], 1), codes % max(sizes[1], 1)
    smaller = np.minimum(one.objects.area[first], other.objects.area[second])
    enough = shared >= OVERLAP * smaller
    pairs = first[enough], second[enough] + sizes[0]
    links = scipy.sparse.coo_array((np.ones(len(pairs[0])), pairs), shape=(sum(sizes),) * 2)
    count, group = scipy.sparse.csgraph.connected_components(links, directed=False)
    known, gain, areas = np.ones(count, dtype=bool), np.zeros(count), []
    groups = group[: sizes[0]].astype(np.intp), group[sizes[0] :].astype(np.intp)
    for look, own, sign in ((one, groups[0], -1), (other, groups[1], 1)):
        gain += sign * np.bincount(own, look.objects.mass, minlength=count)
        areas.append(np.bincount(own, look.objects.area, minlength=count))
        known &= np.bincount(own, minlength=count) > 0
        known &= np.bincount(own, ~look.objects.intact, minlength=count) == 0
    return Change(*groups, gain, np.maximum(*areas), known, other.time - one.time)


# ---- what adds up ----------------------------------------------------------------------------


def balance_of(problem: Problem, result: Judged, task: Task) -> Balance:
    """Return how likely the objects of a result have slipped, by the mass that they miss.

    An object that grows from the first boundary frame on does not lose mass at once, unless part
    of it is taken for a turn less. What an object, or what it came from, lost at once is counted
    on the way out from there, until it comes back or is not known. Cells that touch are told
    apart: what one of them lost is not missed by the other.

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
        changes = [change for _, _, change in line if change is not None]
        jumps = sudden(changes, watch)
        objects = [seen for _, seen, _ in line]
        start = nearest([time for time, _, _ in line], problem.first[0])
        found = missing_turns(changes, jumps, objects, start, watch)
        for (time, _, _), likely in zip(line, found, strict=True):
            slipped[time][angle] = likely
    return Balance(problem, slipped)


def frames_missing_mass(problem: Problem) -> Mask:
    """Mark the frames (time, angle) in which an object misses mass as if it had slipped.

    Nothing is computed: only what is known by `BALANCE` of the problem, or its parts, counts.
    """
    found = np.zeros(problem.given.shape[:2], dtype=bool)
    for views, part in problem.by_wavelength():
        if part.knows(BALANCE):
            found[:, views] = part.known(BALANCE).frames()
    return found


def nearest(times: list[int], wanted: int) -> int:
    """Return the number of the time that is nearest to a wanted one; 0 without any."""
    return int(np.argmin(np.abs(np.array(times) - wanted))) if times else 0


def sudden(changes: list[Change], watch: Watch) -> list[Numbers]:
    """Return by how much the gain of each group differs from those before and after it.

    0 where it does not stand out, or is not known. Gains are those of one frame to the next: over
    a gap there are more of them.
    """
    found = []
    for number, change in enumerate(changes):
        watch.check()
        before, after = (
            range(number - 1, number - 1 - NEAR, -1),
            range(number + 1, number + 1 + NEAR),
        )
        near = np.concatenate([along(changes, number, before), along(changes, number, after)])
        count = np.isfinite(near).sum(axis=0)
        middle = median_of_known(near)
        jump = change.gain - change.steps * middle
        # Of few changes the deviation may be small by chance.
        times = TIMES * 2 * NEAR / np.maximum(count, 1)
        usual = change.steps * times * median_of_known(np.abs(near - middle))
        stands_out = np.abs(jump) > np.maximum(usual, SHARE * change.area)
        found.append(np.where(change.known & (count >= FEWEST) & stands_out, jump, 0.0))
    return found


def along(changes: list[Change], start: int, numbers: range) -> Numbers:
    """Return what the groups of a change (columns) gain a frame in others (rows); NaN if unknown.

    The numbers of these are counted away from the start. A group is followed to all groups that
    its objects belong to.
    """
    groups = len(changes[start].gain)
    found = np.full((len(numbers), groups), np.nan)
    first = here = np.arange(groups)
    gone = np.zeros(groups, dtype=bool)
    previous = start
    for row, number in enumerate(numbers):
        if not 0 <= number < len(changes):
            break
        one, other = changes[previous], changes[number]
        ends = (one.after, other.before) if number > previous else (one.before, other.after)
        first, here = followed(first, here, *ends, gone)
        gone[first[~other.known[here]]] = True
        gain = np.bincount(first, other.gain[here], minlength=groups) / other.steps
        found[row] = np.where(gone, np.nan, gain)
        previous = number
    return found


def followed(
    first: Index, here: Index, groups: Index, others: Index, gone: Mask
) -> tuple[Index, Index]:
    """Follow pairs of groups (where one began, and where it is) through shared objects.

    Parameters
    ----------
    first, here : ndarray of int
        The pairs.
    groups, others : ndarray of int
        The group of each object in this change, and in the next one.
    gone : ndarray of bool
        Marks the groups that lead nowhere, in place.
    """
    order = np.argsort(groups, kind="stable")
    begin, end = (np.searchsorted(groups[order], here, side) for side in ("left", "right"))
    count = end - begin
    gone[first[count == 0]] = True
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    to = others[order][np.repeat(begin, count) + place]
    most = int(others.max(initial=0)) + 1
    pairs = np.unique(np.repeat(first, count) * most + to)
    return pairs // most, pairs % most


def median_of_known(values: Numbers) -> Numbers:
    """Return the median of each column of what is not NaN; NaN where all is."""
    ordered, count = np.sort(values, axis=0), np.isfinite(values).sum(axis=0)
    columns = np.arange(values.shape[1])
    low, high = (
        ordered[np.maximum(middle, 0), columns] for middle in ((count - 1) // 2, count // 2)
    )
    found: Numbers = np.where(count > 0, (low + high) / 2, np.nan)
    return found


#: What an object may have lost, by the change and the group that did: turns times pixels, and over
#: how many pixels; both are negative if it lies below the empty field.
Claims = dict[tuple[int, ...], tuple[float, float]]


def missing_turns(
    changes: list[Change], jumps: list[Numbers], objects: list[Objects], start: int, watch: Watch
) -> list[Numbers]:
    """Return from 0 to 1 how well a slip by a turn explains what the objects of frames miss.

    What a group loses at once may be missed by any object that comes of it, or by all. Each loss
    has a name, so that it is counted once where such objects meet again. Where an object is cut
    off, or nothing is known of a change, nothing is carried on.

    Parameters
    ----------
    changes : list of Change
        From each frame of a view to the next one.
    jumps : list of ndarray of float
        What groups gain at once in each.
    objects : list of Objects
        Those of each frame.
    start : int
        Number of the frame from which it is counted.
    watch : Watch
        May stop it.
    """
    found = [np.zeros(len(seen.mass)) for seen in objects]
    for numbers in (range(start, len(changes)), range(start - 1, -1, -1)):
        claims: list[Claims] = []
        for number in numbers:
            change, forwards = changes[number], number >= start
            near, far = (
                (change.before, change.after) if forwards else (change.after, change.before)
            )
            at, to = (number, number + 1) if forwards else (number + 1, number)
            gained = jumps[number] if forwards else -jumps[number]
            if not claims and not gained.any():
                continue
            watch.check()
            sizes = clear_pixels(near, objects[at], far, objects[to], gained)
            groups = claims_of_groups(claims, gained, near, objects[at], sizes, number)
            claims = [groups[g] if change.known[g] else {} for g in far]
            found[to] = likely_slipped(claims, objects[to])
            claims = shared_out(claims, objects[to], number) if any(claims) else []
    return found


def clear_pixels(
    near: Index, before: Objects, far: Index, after: Objects, gained: Numbers
) -> Numbers:
    """Return over how many pixels each group gained a turn: between its sizes before and after.

    As many as explain it best: what slips may look empty after it, what shrinks at once has less.
    One at least, where noise leaves none of them clear.
    """
    one, other = (
        np.bincount(groups, objects.size, minlength=len(gained))
        for groups, objects in ((near, before), (far, after))
    )
    least, most = (np.maximum(pick(one, other), 1) for pick in (np.minimum, np.maximum))
    return np.clip(np.abs(gained), least, most)


def claims_of_groups(
    claims: list[Claims],
    gained: Numbers,
    near: Index,
    objects: Objects,
    sizes: Numbers,
    number: int,
) -> list[Claims]:
    """Return what each group misses: what its objects did, and what it lost at once.

    Parameters
    ----------
    claims : list of dict
        What each object of the frame before misses; empty if none misses anything.
    gained : ndarray of float
        What each group gains at once, turns times pixels.
    near : ndarray of int
        The group of each object of the frame before.
    objects : Objects
        These objects.
    sizes : ndarray of float
        Over how many pixels each group gained it.
    number : int
        Number of the change.
    """
    found: list[Claims] = [{} for _ in gained]
    area = np.bincount(near, objects.area, minlength=len(gained))
    for group in {int(near[i]) for i, own in enumerate(claims) if own}:
        inside = np.flatnonzero(near == group)
        parts: dict[tuple[int, ...], Claims] = {}
        for i in inside:
            for loss, claim in claims[i].items():
                parts.setdefault(loss[:2], {})[loss] = claim
        for first, own in parts.items():
            holders = [i for i in inside if own.keys() & claims[i].keys()]
            lost, over = (sum(numbers) for numbers in zip(*own.values(), strict=True))
            if not over:  # as much up as down
                continue
            # What joins them may as well be what lost it.
            share = objects.area[holders].sum() / area[group]
            # Parts of a loss that are together again are one.
            loss = next(iter(own)) if len(own) == 1 else (*first, number, -1 - group)
            found[group][loss] = lost, over / float(share)
    for group in np.flatnonzero(gained).tolist():
        own = near == group
        right = objects.mass[own].sum() + sum(lost for lost, _ in found[group].values())
        over = float(np.copysign(sizes[group], right))
        found[group][number, group] = -float(gained[group]), over
    return found


def likely_slipped(claims: list[Claims], objects: Objects) -> Numbers:
    """Return from 0 to 1 how well a slip by a turn explains what objects may miss.

    Of each object alone, or of all of those that one loss may be of.
    """
    found = np.zeros(len(claims))
    alone = turns_alone(claims, objects)
    for i, own in enumerate(claims):
        if own and objects.intact[i]:
            together = sum(lost / over for lost, over in own.values())
            found[i] = max(a_turn_off(together), a_turn_off(float(alone[i])))
    return found


def turns_alone(claims: list[Claims], objects: Objects) -> Numbers:
    """Return how many turns each object misses if it has lost alone all that it may have lost."""
    area = areas_of_losses(claims, objects)
    return np.array(
        [
            sum(lost / (over * objects.area[i] / area[loss]) for loss, (lost, over) in own.items())
            for i, own in enumerate(claims)
        ],
        dtype=float,
    )


def areas_of_losses(claims: list[Claims], objects: Objects) -> dict[tuple[int, ...], float]:
    """Return over how many pixels the objects extend that each loss may be of."""
    area: dict[tuple[int, ...], float] = {}
    for i, own in enumerate(claims):
        for loss in own:
            area[loss] = area.get(loss, 0.0) + float(objects.area[i])
    return area


def shared_out(claims: list[Claims], objects: Objects, number: int) -> list[Claims]:
    """Return claims with those losses parted among their objects that none can have had alone.

    Where two daughters miss two turns between them, none misses two. So each misses one, also when
    the other one's has come back. Parts have names of their own, which begin as that of the loss,
    and the number of this change.
    """
    area, alone = areas_of_losses(claims, objects), turns_alone(claims, objects)
    holders = Counter(loss for own in claims for loss in own)
    parted = {loss for loss, count in holders.items() if count > 1}
    for i, own in enumerate(claims):
        if alone[i] <= TOO_MUCH:
            parted -= set(own)
    found: list[Claims] = []
    for i, own in enumerate(claims):
        share = {loss: float(objects.area[i]) / area[loss] for loss in parted & own.keys()}
        rest = {loss: claim for loss, claim in own.items() if loss not in parted}
        ours = {
            (*loss[:2], number, i): (own[loss][0] * s, own[loss][1] * s)
            for loss, s in share.items()
        }
        found.append(rest | ours)
    return found


def a_turn_off(missing: float) -> float:
    """Return from 0 to 1 how well a slip by a turn explains that so many turns are missing."""
    rises = (missing - NONE_OF_IT) / (MOST - NONE_OF_IT)
    falls = (TOO_MUCH - missing) / (TOO_MUCH - ALL)
    return float(np.clip(min(rises, falls), 0, 1))
