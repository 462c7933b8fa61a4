"""Directional growing and directional L1: this project's own unwrappers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, Limits, Stack, limits_of
from napari_phase4d.task import Task, Watch, in_threads
from napari_phase4d.unwrapping.directional.bunches import Bunch
from napari_phase4d.unwrapping.directional.changes import lifts_of_changes, turns_above_field
from napari_phase4d.unwrapping.directional.following import followed_steps
from napari_phase4d.unwrapping.directional.groups import PARTS
from napari_phase4d.unwrapping.directional.least_turns import LeastTurns
from napari_phase4d.unwrapping.directional.regions import Field, Regions, find_regions
from napari_phase4d.unwrapping.directional.registration import Recorded
from napari_phase4d.unwrapping.directional.scene import find_scene
from napari_phase4d.unwrapping.directional.sides import on_one_side
from napari_phase4d.unwrapping.directional.steps import floors_of
from napari_phase4d.unwrapping.frames import border_medians
from napari_phase4d.unwrapping.given import PURE, working_blocks
from napari_phase4d.unwrapping.growing import Workspace, grow_list
from napari_phase4d.unwrapping.objects import object_mask
from napari_phase4d.unwrapping.shared_steps import FIELD, FRAMES_LEFT_OUT
from napari_phase4d.warned import warn

__all__ = [
    "Unwraps",
    "directional_growing",
    "directional_l1",
    "median_of",
    "prepared",
]

T = TypeVar("T")

#: Of less phase it is not said that it is noise.
MANY_PIXELS = 4_000
TURN = np.float32(2 * np.pi)
Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Whole = NDArray[np.int32]
Turns = NDArray[np.signedinteger[Any]]


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


def prepared(problem: Unwraps, task: Task) -> Field:
    """Return what both methods start from, computed once for a problem."""

    def prepare() -> Field:
        watch = Watch(4, "finding the object", task)
        scene = find_scene(problem, watch)
        # So much leaves one problem of all pixels; few of them tell nothing.
        if scene.noise > PURE and math.prod(scene.shape) > MANY_PIXELS:
            warn(
                "the phase is nothing but noise, as random numbers are: no result means anything, "
                "and WL1 may take long; is it wrapped phase in radians?"
            )
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
