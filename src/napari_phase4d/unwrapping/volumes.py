"""Reliability sorting over more than two dimensions: region growing and per-angle volumes.

Region growing also as PhaseTools computes it (its build of 2015, the year of Barnhill et al.),
which differs from Abdul-Rahman et al. 2007 in three ways. The differences to the neighbours are
not wrapped, so that a pixel next to a wrap counts as unreliable. Missing neighbours multiply a
penalty. And what is meant as the edge to the next time joins pixels of one row: its other end is
found ``depth + 2`` pixels further in memory instead of one volume further. So no edge joins
times, unless a frame has fewer pixels than there are angles, and each is joined by itself.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block, Limits, ReadOnly, Stack
from napari_phase4d.task import Task, Watch, nothing, watched
from napari_phase4d.unwrapping.alone import FinishBlock
from napari_phase4d.unwrapping.frames import NEAR_LEVEL, median_and_field
from napari_phase4d.unwrapping.given import Given, working_blocks
from napari_phase4d.unwrapping.growing import Contracted, Joining, closed, contracted, grow_list
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["memory_edges", "penalised_differences", "region_growing", "spatial_3d"]

#: (first pixel, second pixel) of every edge, as flat indices.
Edges = tuple[NDArray[np.int64], NDArray[np.int64]]

TURN = 2 * np.pi
#: Penalty of a pair of opposite neighbours of which one, or both, are missing.
ONE_MISSING, BOTH_MISSING = 2.0, 4.0


def grown_as_phasetools(
    wrapped: NDArray[np.float32],
    mask: NDArray[np.bool_],
    seen: Block,
    block: Block,
    threshold: float,
) -> tuple[Contracted, NDArray[np.int32], NDArray[np.int32]]:
    """Join the pixels of a block, whose edges join no times; returns what `contracted` does.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians of the frames of ``seen``.
    mask : ndarray of bool, same shape
        Pixels to join.
    seen, block : Block
        The frames that are given: those of the block with one more at least at either end, where
        there are any.
    threshold : float
        Step in radians beyond which a turn is added.
    """
    own = block.of(seen)
    unreliability = penalised_differences(wrapped, mask)[own].ravel()
    wrapped, mask = wrapped[own], mask[own]
    phase = np.mod(wrapped, np.float32(TURN))
    first, second = memory_edges(mask)
    change = phase.ravel()[second].astype(np.float64) - phase.ravel()[first]
    steps = (change < -threshold).astype(np.int32) - (change > threshold)
    # Infinite where a pixel has no neighbour; such a step is taken last.
    cost = unreliability[first] + unreliability[second]
    parts, turns, _ = grow_list(first, second, steps, cost, phase.size, overwrite=True)
    lifted = np.round((phase - wrapped) / np.float32(TURN)).astype(np.int32)
    return closed(block, lifted + turns.reshape(mask.shape), parts.reshape(mask.shape), mask)


def times_touch(shape: tuple[int, ...]) -> bool:
    """Say whether some edges may join pixels of different times, in frames of very few pixels."""
    _, depth, height, width = (n + 2 for n in shape)
    return depth > 2 * height * width


def penalised_differences(
    wrapped: NDArray[np.float32], mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the unreliability of every pixel of a stack (time, angle, y, x).

    Over the 40 pairs of opposite neighbours, with differences d1, d2 of the phase in [0, 2 pi):
    the sum of sqrt(d1^2 + d2^2), or of |d| where one neighbour is missing, times the penalties.
    Infinite where all neighbours are missing.
    """
    phase = np.where(mask, np.mod(wrapped.astype(np.float64), TURN), np.nan)
    padded = np.pad(phase, 1, constant_values=np.nan)
    total, penalty = np.zeros(phase.shape), np.ones(phase.shape)
    seen = np.zeros(phase.shape, dtype=bool)
    offsets = [o for o in itertools.product((-1, 0, 1), repeat=4) if o > (0, 0, 0, 0)]
    for offset in offsets:
        ahead = np.abs(padded[window(offset, 1)] - phase)
        behind = np.abs(padded[window(offset, -1)] - phase)
        missing = np.isnan(ahead).astype(int) + np.isnan(behind)
        total += np.hypot(np.nan_to_num(ahead), np.nan_to_num(behind))
        penalty *= np.choose(missing, (1.0, ONE_MISSING, BOTH_MISSING))
        seen |= missing < 2
    found = total * penalty
    found[~seen] = np.inf
    return found


def window(offset: tuple[int, ...], sign: int) -> tuple[slice, ...]:
    """Return where the neighbours in one direction lie in the padded stack."""
    shifts = [1 + sign * o for o in offset]
    return tuple(slice(s, s - 2 or None) for s in shifts)


def memory_edges(mask: NDArray[np.bool_]) -> Edges:
    """Return the edges as they lie in memory: along x, y, angle, and ``depth + 2`` pixels on.

    Indices are those of the stack (time, angle, y, x).
    """
    padded = np.pad(mask, 1).ravel()
    index = np.pad(np.arange(mask.size).reshape(mask.shape), 1).ravel()
    _, depth, height, width = (n + 2 for n in mask.shape)
    first, second = [], []
    for step in (1, width, width * height, depth):
        both = padded[:-step] & padded[step:]
        first.append(index[:-step][both])
        second.append(index[step:][both])
    return np.concatenate(first), np.concatenate(second)


# ---- growing over blocks of frames ----------------------------------------------------------


Phase = NDArray[np.float32]
Mask = NDArray[np.bool_]
Whole = NDArray[np.int32]
Turns = NDArray[np.int64]
#: Part, turns that it is off, and how many pixels say so.
Votes = NDArray[np.int64]
#: Joins what is certain in a block, see `contracted`.
Contracts = Callable[
    [Phase, Mask, Block, Block, int, Callable[[], None]], tuple[Contracted, Whole, Whole]
]

ALL = slice(None)
#: Frames before and after a block that its steps depend on.
AROUND = 2


def region_growing(
    problem: Problem,
    result: Stack,
    task: Task,
    *,
    variant: str = "textbook",
    rga_threshold: float = 3.14,
) -> list[Limits]:
    """Join pixels over time, angle, y and x, most reliable edges first (RG).

    The reliability sorting of Herraez et al. 2002 and Abdul-Rahman et al. 2007 in four dimensions,
    as Barnhill et al. 2015 describe it: second differences over the 40 pairs of opposite
    neighbours; edges along the four axes, in the order of the sum of their ends' unreliabilities.

    Parameters
    ----------
    problem : Problem
        Any; the boundary frame's border gives the level.
    result : Stack
        Where the unwrapped phase goes.
    task : Task
        Who is told of it, and may stop it.
    variant : str, optional
        "textbook" (default), or "phasetools": as PhaseTools computes it, see
        `napari_phase4d.unwrapping.volumes`.
    rga_threshold : float, optional
        Only with "phasetools": step in radians beyond which a turn is added; published default
        3.14.
    """
    if not 0 < rga_threshold < TURN:
        msg = f"rga_threshold must lie between 0 and 2 pi, but is {rga_threshold:g}"
        raise ValueError(msg)
    growing = Growing(problem, "region growing", task)
    if variant == "textbook":
        return growing.finish([growing.grown(ALL)], result)
    whole = times_touch(problem.given.shape)
    contract = AsPhasetools(rga_threshold)
    return growing.finish([growing.grown(ALL, contract, in_blocks=not whole)], result)


def spatial_3d(
    problem: Problem,
    result: Stack,
    task: Task,
) -> list[Limits]:
    """Join pixels over time, y and x for each angle by itself, most reliable edges first."""
    growing = Growing(problem, "3-D reliability sorting", task)
    angles = range(problem.given.shape[1])
    return growing.finish([growing.grown(slice(a, a + 1)) for a in angles], result)


@dataclass(frozen=True)
class AsPhasetools:
    """Joins a block as PhaseTools does.

    Parameters
    ----------
    threshold : float
        Step in radians beyond which a turn is added.
    """

    threshold: float

    def __call__(
        self,
        wrapped: Phase,
        mask: Mask,
        seen: Block,
        block: Block,
        n_times: int,
        check: Callable[[], None],
    ) -> tuple[Contracted, Whole, Whole]:
        """Do a block, see `contracted`."""
        return grown_as_phasetools(wrapped, mask, seen, block, self.threshold)


class Growing:
    """Region growing of a problem, block by block; what is in memory is one block.

    Parameters
    ----------
    problem : Problem
        What to unwrap.
    message : str
        What is being done.
    task : Task
        Who is told of it, and may stop it.
    """

    def __init__(
        self,
        problem: Problem,
        message: str,
        task: Task,
    ) -> None:
        self._problem = problem
        self._message = message
        self._task = task
        self._mask = problem.counted(task)
        store, shape = problem.store, problem.given.shape
        self._groups = store.temporary("grown", shape, "int32")
        self._turns = store.temporary("grown turns", shape, "int32")

    def grown(
        self, angles: slice, contract: Contracts = contracted, *, in_blocks: bool | None = None
    ) -> Grown:
        """Join the frames of some angles.

        Parameters
        ----------
        angles : slice
            Which.
        contract : callable, optional
            Joins what is certain in a block.
        in_blocks : bool, optional
            Whether to go block by block; default: where the problem is not held in memory.
        """
        problem, shape = self._problem, self._problem.given.shape
        in_blocks = not problem.held if in_blocks is None else in_blocks
        blocks = working_blocks(shape) if in_blocks else [Block(0, shape[0])]
        work = ContractBlock(
            problem.given, self._mask, self._groups, self._turns, angles, contract
        )
        times = self._task.counting(len(blocks[0]), shape[0])
        watch = Watch(len(blocks), self._message, times)
        first, last, _ = angles.indices(shape[1])
        joining = Joining((last - first) * shape[2] * shape[3], problem.store, f"grown {first}")
        for found in self._each(work, blocks, watch):
            end = Block(found.block.stop - 1, found.block.stop)
            joining.add(
                found, self._groups.read(end, angles), self._turns.read(end, angles), watch.check
            )
        parts = joining.finished()
        return Grown(
            angles, len(blocks[0]), tuple(parts), joining.n_parts, self._groups, self._turns
        )

    def _each(
        self, work: ContractBlock, blocks: list[Block], watch: Watch
    ) -> Iterator[Contracted]:
        """Do all blocks; a large one looks up by itself whether to stop."""
        if len(blocks) > 1:
            yield from self._problem.on_workers(work, blocks, watch)
        else:
            yield watched(lambda: work(blocks[0], watch.check), watch)
            watch.step()

    def finish(self, grown: list[Grown], result: Stack) -> list[Limits]:
        """Choose each part's open multiple of 2 pi, and write the result.

        The border of the frames is brought within half a turn of zero; round an object that was
        found, the rim of its mask. Parts of any other mask take it from the two-dimensional
        unwrapping, which looks at whole frames. The boundary frame decides for the parts in it,
        then its time, then all frames.
        """
        problem, task = self._problem, self._task
        by_frames = not problem.finds_mask and not problem.all_usable
        flat = problem.alone(task) if by_frames else None
        levels = [np.zeros(of.n_parts, dtype=np.int64) for of in grown]
        known = [np.zeros(of.n_parts, dtype=bool) for of in grown]
        time, angle = problem.first
        watch = Watch(1, self._message, task)
        look = VoteBlock(problem.given, self._mask, grown, flat, known, angle)
        settle(levels, known, [look(Block(time, time + 1))])
        watch.check()
        if not all(each.all() for each in known):
            look = VoteBlock(problem.given, self._mask, grown, flat, known)
            votes = problem.each(look, "placing loose parts", task)
            settle(levels, known, votes)
        turns = LiftedParts(problem.given.shape, grown, levels)
        finish = FinishBlock(problem.given, turns, self._mask, result)
        return problem.each(finish, "writing", task)


@dataclass(frozen=True)
class ContractBlock:
    """Joins what is certain in a block.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    mask : Stack
        Pixels to join.
    groups, turns : Stack
        Where the group of every pixel goes, and its turns relative to that.
    angles : slice
        Which views.
    contract : callable
        What joins.
    """

    given: Given
    mask: Stack
    groups: Stack
    turns: Stack
    angles: slice
    contract: Contracts

    def __call__(self, block: Block, check: Callable[[], None] = nothing) -> Contracted:
        """Do a block; return what is left of it. ``check`` may raise to stop."""
        n_times = self.given.shape[0]
        seen = block.wider(AROUND, AROUND, n_times)
        wrapped, _ = self.given.read(seen, self.angles)
        mask = self.mask.read(seen, self.angles)
        found, groups, turns = self.contract(wrapped, mask, seen, block, n_times, check)
        self.groups.write(block, groups, self.angles)
        self.turns.write(block, turns, self.angles)
        return found


@dataclass(frozen=True)
class Grown:
    """The parts that the frames of some angles have been joined to.

    Parameters
    ----------
    angles : slice
        Which.
    frames : int
        Frames of each block that was joined, but the last.
    parts : tuple of Stack
        Part of every group of each block, and its turns, see `Joining.finished`.
    n_parts : int
        How many parts there are.
    groups, turns : Stack
        Group of every pixel, and its turns relative to that.
    """

    angles: slice
    frames: int
    parts: tuple[Stack, ...]
    n_parts: int
    groups: Stack
    turns: Stack

    def read(self, block: Block) -> tuple[Whole, Whole]:
        """Return part and turns of every pixel of a block; part -1 outside the mask."""
        found = [
            (np.append(part, np.int32(-1))[group], np.append(more, np.int32(0))[group] + turns)
            for group, turns, part, more in self._pieces(block)
        ]
        parts, turns = zip(*found, strict=True)
        return np.concatenate(parts), np.concatenate(turns)

    def lifted(self, block: Block, level: Turns) -> Whole:
        """Return the turns of every pixel of a block with those of its part; any outside."""
        found = []
        for group, turns, part, more in self._pieces(block):
            own = more + level[part].astype(np.int32)
            found.append(turns + (own if len(own) == 1 else np.append(own, np.int32(0))[group]))
        return found[0] if len(found) == 1 else np.concatenate(found)

    def _pieces(self, block: Block) -> Iterator[tuple[Whole, Whole, Whole, Whole]]:
        """Yield groups and turns of a block as it was joined; part and turns of each group."""
        for number in range(block.start // self.frames, -(-block.stop // self.frames)):
            start = max(block.start, number * self.frames)
            some = Block(start, min(block.stop, (number + 1) * self.frames))
            part, more = self.parts[number].read(Block(0, 2))[:, 0, 0]
            yield (
                self.groups.read(some, self.angles),
                self.turns.read(some, self.angles),
                part,
                more,
            )


# ---- the open multiple of 2 pi of every part --------------------------------------------------


@dataclass(frozen=True)
class VoteBlock:
    """Looks how many turns parts are off a reference.

    Parameters
    ----------
    given : Given
        Wrapped phase.
    mask : Stack
        Pixels that count.
    grown : list of Grown
        The parts.
    flat : Stack or None
        Turns of each frame unwrapped by itself, where that is the reference and all pixels of the
        mask are asked; else it is zero, and the rim of the mask is asked.
    known : list of ndarray of bool
        Parts that are not asked any more.
    angle : int, optional
        View of the boundary frame, at its time: that frame is asked first, then all views.
        Default: the rim, then all pixels.
    """

    given: Given
    mask: Stack
    grown: list[Grown]
    flat: Stack | None
    known: list[Mask]
    angle: int | None = None

    def __call__(self, block: Block) -> list[tuple[Votes, Votes]]:
        """Do a block; return for each angle or all what is asked first, and then."""
        mask = self.mask.read(block)
        wrapped = None
        if self.flat is None:
            wrapped, _ = self.given.read(block)
            off, rim = -np.round(wrapped / np.float32(TURN)).astype(np.int32), rim_of(mask)
        else:
            off, rim = self.flat.read(block).astype(np.int32), mask
        before, after = rim, mask
        if self.angle is not None:
            before, after = np.zeros_like(rim), rim
            before[:, self.angle] = rim[:, self.angle]
        found = []
        for of, known in zip(self.grown, self.known, strict=True):
            part, turns = of.read(block)
            asked = (part >= 0) & ~np.append(known, True)[part]
            both = (before[:, of.angles] & asked, after[:, of.angles] & asked)
            off_here = off[:, of.angles] - turns
            if wrapped is not None:
                # At the boundary time both are borders, of its view and of those that lack it.
                for border in both if self.angle is not None else both[:1]:
                    keep_at_field(border, wrapped[:, of.angles], turns, part)
            first, then = (votes(part[some], off_here[some]) for some in both)
            found.append((first, then))
        return found


def keep_at_field(asked: Mask, wrapped: Phase, turns: Whole, part: Whole) -> None:
    """Leave out of a frame's border, in place, what does not lie at the level of its field.

    That is for where an object covers about half of it; elsewhere the median says the same. Parts
    that do not touch have no common level.
    """
    for frame in np.ndindex(*asked.shape[:2]):
        some = asked[frame]
        phase = wrapped[frame][some] + np.float32(TURN) * turns[frame][some].astype(np.float32)
        if len(phase) and np.ptp(part[frame][some]) == 0:
            median, field = median_and_field(phase)
            if field != median and not np.isnan(field):
                some[some] = np.abs(phase - field) < NEAR_LEVEL


def votes(part: Whole, off: Whole) -> Votes:
    """Count which parts are how many turns off, shape (kinds, 3)."""
    if not len(part):
        return np.zeros((0, 3), dtype=np.int64)
    least = int(off.min())
    width = int(off.max()) - least + 1
    kinds, counts = np.unique(part.astype(np.int64) * width + (off - least), return_counts=True)
    return np.stack([kinds // width, kinds % width + least, counts], axis=1)


def settle(levels: list[Turns], known: list[Mask], votes: list[list[tuple[Votes, Votes]]]) -> None:
    """Give parts the median of the turns that they are said to be off, in place."""
    for number, (level, there) in enumerate(zip(levels, known, strict=True)):
        for kind in (0, 1):
            said = np.concatenate([of_block[number][kind] for of_block in votes])
            said = said[~there[said[:, 0]]]
            if len(said):
                parts, medians = medians_of(said)
                level[parts], there[parts] = medians, True


def medians_of(said: Votes) -> tuple[Turns, Turns]:
    """Return parts, and the median of the turns of each, half ones rounded to even."""
    said = said[np.lexsort((said[:, 1], said[:, 0]))]
    parts, start = np.unique(said[:, 0], return_index=True)
    until = np.cumsum(said[:, 2])
    ends = np.append(start[1:], len(said)) - 1
    before = until[start] - said[start, 2]
    count = until[ends] - before
    low, high = (
        np.searchsorted(until, before + k, "right") for k in ((count - 1) // 2, count // 2)
    )
    return parts, np.round((said[low, 1] + said[high, 1]) / 2).astype(np.int64)


def rim_of(mask: Mask) -> Mask:
    """Mark the border of the frames, or of the object in them."""
    cross = scipy.ndimage.generate_binary_structure(2, 1)[None, None]
    inner = scipy.ndimage.binary_erosion(mask, cross, border_value=0)
    rim: Mask = mask & ~inner
    return rim


@dataclass(frozen=True)
class LiftedParts(ReadOnly):
    """Turns of every pixel with those of its part, which are added as they are read.

    Parameters
    ----------
    shape : tuple of int
        Of the stack (time, angle, y, x).
    grown : list of Grown
        The parts.
    levels : list of ndarray of int
        Turns of each part.
    """

    shape: tuple[int, ...]
    grown: list[Grown]
    levels: list[Turns]

    def read(self, block: Block, angles: slice = ALL) -> Whole:
        """Return the turns of a block, any outside the mask."""
        turns = np.zeros((block.stop - block.start, *self.shape[1:]), dtype=np.int32)
        for of, level in zip(self.grown, self.levels, strict=True):
            turns[:, of.angles] = of.lifted(block, level)
        return turns[:, angles]
