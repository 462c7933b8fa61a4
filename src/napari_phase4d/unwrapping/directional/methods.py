"""Directional growing and directional L1: this project's own unwrappers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, Limits, Stack, limits_of
from napari_phase4d.task import Task, Watch, in_threads
from napari_phase4d.unwrapping.directional.bunches import Bunch, Bunches
from napari_phase4d.unwrapping.directional.changes import lifts_of_changes, turns_above_field
from napari_phase4d.unwrapping.directional.following import followed_steps
from napari_phase4d.unwrapping.directional.groups import PARTS, Index, weight_of
from napari_phase4d.unwrapping.directional.least_turns import LeastTurns, Limit
from napari_phase4d.unwrapping.directional.regions import Regions, find_regions
from napari_phase4d.unwrapping.directional.registration import Recorded
from napari_phase4d.unwrapping.directional.scene import Scene, find_scene
from napari_phase4d.unwrapping.directional.steps import Floors, fading, floors_of, noisier
from napari_phase4d.unwrapping.frames import border_medians
from napari_phase4d.unwrapping.given import working_blocks
from napari_phase4d.unwrapping.growing import Workspace, grow_list
from napari_phase4d.unwrapping.objects import object_mask
from napari_phase4d.unwrapping.shared_steps import FIELD, FRAMES_LEFT_OUT

__all__ = [
    "Field",
    "Unwraps",
    "directional_growing",
    "directional_l1",
    "median_of",
    "prepared",
]

T = TypeVar("T")

TURN = np.float32(2 * np.pi)
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Whole = NDArray[np.int32]
Short = NDArray[np.int16]
Turns = NDArray[np.signedinteger[Any]]
Counts = NDArray[np.int64]

#: A pixel lies beyond the empty field if its phase does so by this many radians and twice its
#: noise, which is the larger the fainter its light. Each turn beyond costs as much as a step of
#: so much roughness, in radians, that is off.
BEYOND, AS_ROUGH_AS = 0.5, 2.0
#: What many steps hold may lie on the other side as well, as where the empty field sags under the
#: object. A pixel pays only beyond that, but for this share of it, in bins of so many radians.
RARE, BIN = 0.003, 0.1
#: Only regions of so few pixels pay, as many as a cube of three: the price is for rims, not for
#: what many steps hold.
RIM = 27
#: Largest share of the object's pixels that the price may move.
MOST = 0.5
#: An object lies on one side of the empty field if this share of what is a turn off does.
NEARLY_ALL = 0.9
#: A rim that slipped leaves steps that contradict each other. Where all of them together cost so
#: many times less than lying on the wrong side would, no rim has slipped, and the object does lie
#: on both sides: a cell in a channel with thicker walls, say, all of it too steep to be held.
IN_EARNEST = 12


class Unwraps(Recorded, Protocol):
    """What the directional methods ask of a problem, to write a result."""

    @property
    def finds_mask(self) -> bool:
        """Whether the object is what is to be unwrapped."""

    def once(self, name: str, work: Callable[[], T]) -> T:
        """Return what ``work()`` returned when it was first asked for by this name."""

    def note(self, name: str, found: object) -> None:
        """Keep something by a name."""

    def settle_frames(self, task: Task) -> None:
        """Unwrap each frame by itself, if that has not been done."""

    def frame_by_frame(self, block: Block) -> Image:
        """Return the phase of a block as each frame is unwrapped by itself."""


@dataclass(frozen=True)
class Field:
    """What both methods start from.

    Parameters
    ----------
    scene : Scene
        The frames, the object held in place.
    floors : Floors
        What noise alone makes of the weights.
    regions : Regions
        Pixels that certain steps join, and the edges between them.
    """

    scene: Scene
    floors: Floors
    regions: Regions


def prepared(problem: Unwraps, task: Task) -> Field:
    """Return what both methods start from, computed once for a problem."""

    def prepare() -> Field:
        watch = Watch(4, "finding the object", task)
        scene = find_scene(problem, watch)
        problem.note(FRAMES_LEFT_OUT, scene.frames.lost)
        scene = replace(scene, lifts=lifts_of_changes(scene, problem.store, watch))
        watch.step()
        watch = Watch(1, "weighing the steps", task)
        floors = floors_of(scene, watch)
        steps = followed_steps(scene, floors, watch)
        return Field(scene, floors, find_regions(scene, steps, problem.store, watch))

    return problem.once(FIELD, prepare)


def directional_growing(
    problem: Unwraps,
    result: Stack,
    task: Task,
) -> list[Limits]:
    """Join pixels over time, angle, y and x, first where steps change least along themselves.

    A step is trusted by how little it differs from the steps before and behind it in its own
    direction, so that a slope counts as smooth however steep it is. Pixels that certain steps
    join come first, then the islands of the empty field, those first whose majority is largest:
    one step that looks smooth by accident is not to tie an island to a cell. Then come all
    others.

    Region growing (Abdul-Rahman et al. 2007) trusts pixels by second differences in all
    directions instead.
    """
    field = prepared(problem, task)
    watch = Watch(len(field.regions.bunches), "directional growing", task)
    parts, turns = together(field.regions, grown, watch)
    return finish(problem, field, turns, parts, result, task)


#: Part and turns of every region of a bunch.
Placed = tuple[Whole, Turns]


def together(
    regions: Regions, work: Callable[[Bunch], Placed], watch: Watch
) -> tuple[Whole, Turns]:
    """Place each bunch of regions; return part and turns of all, the part that is held being 0."""
    bunches = regions.bunches
    parts = np.zeros(regions.n, dtype=np.int32)
    turns = np.full(regions.n, -regions.held_turns, dtype=np.int32)

    def place(number: int) -> tuple[Bunch, Placed]:
        bunch = bunches.read(number)
        return bunch, work(bunch)

    count = 1
    for bunch, (part, own) in in_threads(place, range(len(bunches)), watch):
        held = part == part[bunch.held]
        parts[bunch.regions] = np.where(held, 0, part + count)
        turns[bunch.regions] = own
        count += int(part.max()) + 1
    return parts, turns


def grown(bunch: Bunch) -> Placed:
    """Go along the edges, smoothest first, as Kruskal does; return part and turns of regions."""
    edges = bunch.edges
    votes = edges.ground > 0
    first, second, asked = (
        np.concatenate([column[votes], column])
        for column in (edges.first, edges.second, edges.turns)
    )
    costs = np.concatenate([-edges.ground[votes] / PARTS, edges.rough])
    parts, turns, _ = grow_list(first, second, asked, costs, bunch.n, overwrite=True)
    level = turns[bunch.held] + bunch.held_turns
    return parts, turns.astype(np.int64) - np.where(parts == parts[bunch.held], level, 0)


def directional_l1(
    problem: Unwraps,
    result: Stack,
    task: Task,
    *,
    one_sided: bool = True,
) -> list[Limits]:
    """Find the turns that disagree least with all steps, each weighted by its smoothness.

    With J the turns of a step that Itoh's condition would give and D its roughness in radians,
    the sum of (0.5 + D)^-6 |k_q - k_p - J| over all steps is made smallest.

    Parameters
    ----------
    problem : Unwraps
        What to unwrap.
    result : Stack
        Where the unwrapped phase goes.
    task : Task
        Who is told of it, and may stop it.
    one_sided : bool, optional
        Whether to prefer, where steps can't tell, that the object lies on one side of the empty
        field: nowhere thinner optically, or nowhere denser. Default True.
    """
    field = prepared(problem, task)
    watch = Watch(2, "directional L1", task)
    bunches = watch.quiet(len(field.regions.bunches))

    costs: list[int] = []

    def least(bunch: Bunch) -> Placed:
        solver = LeastTurns(bunch, watch.check)
        parts, start = solver.start()
        turns = solver.descend(start)
        costs.append(solver.cost(turns))
        return parts, turns

    parts, turns = together(field.regions, least, bunches)
    watch.step()
    if one_sided:
        turns = on_one_side(field, turns, parts, sum(costs), watch)
    watch.step()
    return finish(problem, field, turns, parts, result, task)


# ---- on one side of the empty field ----------------------------------------------------------


def on_one_side(field: Field, plain: Turns, parts: Whole, cost: int, watch: Watch) -> Turns:
    """Return the turns of every region, after lying on the wrong side has had its price.

    Parameters
    ----------
    field, plain, parts
        What was started from; turns and part of every region, as the steps alone have them.
    cost : int
        Cost of these turns, see `LeastTurns.cost`.
    watch : Watch
        Stops the work.
    """
    limit = side_of_object(field, plain, parts, watch)
    if limit is None or not len(limit.region):
        return plain
    if limit.paid(plain, field.regions.n).sum() > IN_EARNEST * cost:
        return plain
    bunches = field.regions.bunches
    of_pixel = bunches.of_region[limit.region]
    order = np.argsort(of_pixel, kind="stable")
    numbers, starts = np.unique(of_pixel[order], return_index=True)
    cuts = [slice(*ends) for ends in pairwise([*starts, len(order)])]

    def least(of_bunch: tuple[int, slice]) -> tuple[Index, Turns]:
        number, cut = of_bunch
        bunch = bunches.read(number)
        solver = LeastTurns(bunch, watch.check)
        turns = plain[bunch.regions].astype(np.int64)
        return bunch.regions, solver.descend(turns, limit.some(order[cut]).of(bunch))

    after = plain.copy()
    work = list(zip(numbers.tolist(), cuts, strict=True))
    for own, turns in in_threads(least, work, watch.quiet(len(work))):
        after[own] = turns
    regions = field.regions
    object_ = np.where(parts == parts[regions.held], regions.size, 0)
    moved_ = object_[after != plain].sum() / max(object_.sum(), 1)
    # If most of it moves, the side was mistaken.
    return plain if moved_ > MOST else after


@dataclass(frozen=True)
class Rims:
    """Pixels of the smallest regions, and how much of all others lies on which side.

    Parameters
    ----------
    positive, clear : int
        Pixels that are more than a turn above the empty field; that are above or below it.
    above, below : ndarray of int
        How many pixels of larger regions lie so far above the empty field, or below it, in bins
        up to a turn; the last has all beyond.
    region : ndarray of int
        Region of each pixel of small regions.
    phase : ndarray of float
        Its phase in radians, where its region has no turns.
    amplitude : ndarray of float
        Its amplitude as a share of its view's median; 1 where amplitude is not known.
    """

    positive: int
    clear: int
    above: Counts
    below: Counts
    region: Index
    phase: Image
    amplitude: Image

    def limit(self, side: int, noise: float, turns: Turns, bunches: Bunches) -> Limit:
        """Return what pixels pay on the wrong side, of the bunches in which any does.

        In all others the turns are the least already.
        """
        other = self.below if side > 0 else self.above
        usual = BIN * usual_bins(other, self.above.sum())
        noises = noise * noisier(self.amplitude).astype(np.float64)
        allowed = BEYOND + np.maximum(2 * noises, usual)
        steps = np.ceil((-allowed - side * self.phase.astype(np.float64)) / (2 * np.pi))
        # A region of so few pixels has few turns.
        whole = (side * steps).astype(np.int16)
        paying = bunches.of_region[self.region[side * (whole - turns[self.region]) > 0]]
        mine = np.isin(bunches.of_region[self.region], paying[paying >= 0])
        rough = np.float32(AS_ROUGH_AS) + fading(self.amplitude[mine])
        weight = np.round(PARTS * weight_of(rough))
        return Limit(self.region[mine], whole[mine], weight, side)


def usual_bins(other: Counts, all_: int) -> int:
    """Return how many bins hold all pixels on a side but the rare ones."""
    further = np.cumsum(other[::-1])[::-1]
    return int(np.count_nonzero(further[1:] > RARE * all_))


def rims_of(field: Field, turns: Turns, joined: NDArray[np.bool_], block: Block) -> Rims:
    """Look at a block for `side_of_object`."""
    regions = field.regions
    seen = field.scene.read(block, amplitude=True)
    free = seen.free
    region, relative = (part[free] for part in regions.read(block))
    phase = seen.phase[free]
    unwrapped = phase + TURN * (turns[region] + relative).astype(np.float32)
    known = joined[region]
    clear = known & (np.abs(unwrapped) > TURN)
    is_small = regions.size[region] <= RIM
    small, large = known & is_small, unwrapped[known & ~is_small]
    above, below = (bins_of(np.maximum(side * large, 0)) for side in (1, -1))
    own = phase[small] + TURN * relative[small].astype(np.float32)
    bright = np.ones_like(own) if seen.amplitude is None else seen.amplitude[free][small]
    positive = int((unwrapped[clear] > 0).sum())
    return Rims(positive, int(clear.sum()), above, below, region[small], own, bright)


def bins_of(beyond: Image) -> Counts:
    """Count phase by how far it lies on a side, in bins up to a turn; the first has the rest."""
    last = int(TURN / BIN)
    numbers = np.minimum(beyond / np.float32(BIN), last).astype(np.intp)
    return np.bincount(numbers, minlength=last + 1).astype(np.int64)


def side_of_object(field: Field, turns: Turns, parts: Whole, watch: Watch) -> Limit | None:
    """Return the price of lying on the other side of the empty field than nearly all else.

    Nearly all cells are denser than what they lie in, everywhere. At a rim that is steeper than
    half a turn a pixel, the steps alone can't tell a phase of 5 rad from one of 5 - 2 pi.
    """
    joined = parts == parts[field.regions.held]
    blocks = working_blocks(field.scene.shape)

    def work(block: Block) -> Rims:
        return rims_of(field, turns, joined, block)

    looks = list(in_threads(work, blocks, watch.quiet(len(blocks))))
    clear = sum(rims.clear for rims in looks)
    share = sum(rims.positive for rims in looks) / clear if clear else 0.5
    if 1 - NEARLY_ALL < share < NEARLY_ALL:
        return None
    above, below = (
        np.stack([getattr(rims, name) for rims in looks]).sum(axis=0)
        for name in ("above", "below")
    )
    region, phase, amplitude = (
        np.concatenate([getattr(rims, name) for rims in looks])
        for name in ("region", "phase", "amplitude")
    )
    rims = Rims(0, clear, above, below, region, phase, amplitude)
    side = 1 if share > 0.5 else -1
    return rims.limit(side, field.scene.noise, turns, field.regions.bunches)


# ---- the result ------------------------------------------------------------------------------


def finish(
    problem: Unwraps,
    field: Field,
    turns: Turns,
    parts: Whole,
    result: Stack,
    task: Task,
) -> list[Limits]:
    """Write the unwrapped phase, congruent with the wrapped phase; 0 where it is not wanted.

    Parts that no edge joins to the empty field take their level from the two-dimensional
    unwrapping of the boundary frame. A mask that was to be found is found in this result.
    """
    level = border_medians(problem.background().level, problem.first)
    blocks = working_blocks(problem.given.shape)
    lift = np.zeros(field.regions.n, dtype=np.int32)
    if (parts != parts[field.regions.held]).any():
        problem.settle_frames(task)
        watch = Watch(len(blocks), "placing loose parts", task)
        look = LooseBlock(problem, field, turns, parts, level)
        lift = lifts(list(in_threads(look, blocks, watch)), parts)
    watch = Watch(len(blocks), "writing", task)
    write = FinishBlock(problem, field, turns + lift, level, result)
    return list(in_threads(write, blocks, watch, wait=True))


def lifted(
    problem: Unwraps, field: Field, turns: Turns, level: NDArray[np.float64], block: Block
) -> tuple[Image, Whole]:
    """Return the unwrapped phase of a block of all times, and the region of every pixel."""

    def of_kept(kept: Block) -> tuple[Image, Whole]:
        region, relative = field.regions.read(kept)
        phase = field.scene.read(kept).phase
        return phase + TURN * (turns[region] + relative).astype(np.float32), region

    estimate, region = field.scene.put_back(block, of_kept)
    wrapped, usable = problem.given.read(block)
    ground = problem.background().ground(level, block)
    found = congruent(estimate + ground, wrapped)
    for time in set(block.times) & set(field.scene.frames.outliers.tolist()):
        i = time - block.start
        empty = problem.background().empty.read(Block(time, time + 1))[0] & usable[i]
        for angle in np.flatnonzero(empty.any(axis=(1, 2))):
            at = (i, angle)
            found[at] = by_itself(wrapped[at], usable[at], empty[angle], ground[at])
    return found, region


def by_itself(wrapped: Image, known: Mask, empty: Mask, ground: Image) -> Image:
    """Return the unwrapped phase of a frame (y, x) that is like none of the others."""
    flat = turned(wrapped - ground)
    turns = turns_above_field(flat, known, empty, Workspace())
    return congruent(flat + TURN * turns.astype(np.float32) + ground, wrapped)


def congruent(estimate: Image, wrapped: Image) -> Image:
    """Return the wrapped phase plus the whole turns that bring it nearest to an estimate."""
    turns = np.round((estimate - wrapped) / TURN).astype(np.float32)
    result: Image = wrapped + TURN * turns
    return result


@dataclass(frozen=True)
class FinishBlock:
    """Writes the unwrapped phase of a block.

    Parameters
    ----------
    problem : Unwraps
        What was to be unwrapped.
    field : Field
        What the method started from.
    turns : ndarray of int
        Turns of every region.
    level : ndarray of float, shape (time, angle)
        Phase of the empty field of every frame, radians.
    result : Stack
        Where the phase goes.
    """

    problem: Unwraps
    field: Field
    turns: Turns
    level: NDArray[np.float64]
    result: Stack

    def __call__(self, block: Block) -> Limits:
        """Do a block; return its smallest and largest phase."""
        unwrapped, _ = lifted(self.problem, self.field, self.turns, self.level, block)
        _, usable = self.problem.given.read(block)
        wanted = usable
        if self.problem.finds_mask:
            # Each frame about zero, so that an aperture's outside, which is 0, is no step.
            ground = self.problem.background().ground(self.level, block)
            about_zero = np.where(usable, unwrapped - ground, np.float32(0))
            found = np.empty(wanted.shape, dtype=bool)
            for frame in np.ndindex(*wanted.shape[:2]):
                found[frame] = object_mask(about_zero[frame])
            wanted = usable & found
        unwrapped = np.where(wanted, unwrapped, np.float32(0))
        unwrapped = self.problem.given.without_unknown(unwrapped, usable)
        self.result.write(block, unwrapped)
        return limits_of(unwrapped)


#: Part, turns that it is off, and how many pixels say so.
Votes = NDArray[np.int64]


@dataclass(frozen=True)
class LooseBlock:
    """Looks how many turns parts are off the frames unwrapped one by one.

    Parameters
    ----------
    problem, field, turns, level
        See `FinishBlock`.
    parts : ndarray of int
        Part of every region.
    """

    problem: Unwraps
    field: Field
    turns: Turns
    parts: Whole
    level: NDArray[np.float64]

    def __call__(self, block: Block) -> tuple[Votes, Votes, Votes]:
        """Return what the boundary frame says of the block, then its time, then all."""
        unwrapped, region = lifted(self.problem, self.field, self.turns, self.level, block)
        _, usable = self.problem.given.read(block)
        part = self.parts[region]
        loose = usable & (part != self.parts[self.field.regions.held])
        flat = self.problem.frame_by_frame(block)
        off = np.round((flat - unwrapped) / TURN).astype(np.int64)
        frames = self.field.scene.frames  # a boundary frame that is left out says nothing
        time, angle = int(frames.kept[frames.start[0]]), frames.start[1]
        none = np.zeros(loose.shape, dtype=bool)
        of_frame, of_time = none, none.copy()
        if time in block.times:
            at = time - block.start
            of_frame[at, angle] = loose[at, angle]
            of_time[at] = loose[at]
        first, second, third = (
            votes(part[asked], off[asked]) for asked in (of_frame, of_time, loose)
        )
        return first, second, third


def votes(part: Whole, off: Turns) -> Votes:
    """Count which parts are how many turns off, shape (kinds, 3)."""
    pairs, counts = np.unique(np.stack([part, off], axis=1), axis=0, return_counts=True)
    return np.concatenate([pairs, counts[:, None]], axis=1).astype(np.int64)


def lifts(looks: list[tuple[Votes, Votes, Votes]], parts: Whole) -> Turns:
    """Return the turns to add to each region: the median of what is said first of its part."""
    of_part = np.zeros(int(parts.max()) + 1, dtype=np.int32)
    known = np.zeros(len(of_part), dtype=bool)
    for kind in zip(*looks, strict=True):
        said = np.concatenate(kind)
        for part in np.unique(said[:, 0]):
            if not known[part]:
                of_part[part] = median_of(said[said[:, 0] == part])
                known[part] = True
    return of_part[parts]


def median_of(said: Votes) -> int:
    """Return the median of turns, each of which is counted so often, a half rounded up."""
    said = said[np.argsort(said[:, 1])]
    until = np.cumsum(said[:, 2])
    low, high = (
        np.searchsorted(until, k, side="right") for k in ((until[-1] - 1) // 2, until[-1] // 2)
    )
    # Always up, so that it does not matter what the part's turns are counted from.
    return int((said[low, 1] + said[high, 1] + 1) // 2)
