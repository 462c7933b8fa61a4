"""Growing by blocks of frames: what is certain whatever lies outside is joined at once.

The cheapest step of a group of pixels is in the tree of cheapest steps (Boruvka 1926). So a group
may be joined along it as soon as all its steps are known, those that lead out of the block as
well; a group whose cheapest step leads out has to wait (`join_certain`). Of the steps between
groups that wait, the dearest of every loop is in no such tree and is dropped (`forest`). What is
left of a block is small, and what is left of all blocks up to a frame is no more than one step for
each pixel of that frame, however long the recording is (`Joining`).

Steps are listed in the order of the grid all the way. Equal costs go by their place in the list,
so that the tree is that of the whole grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block, Stack, Store
from napari_phase4d.task import nothing
from napari_phase4d.unwrapping.growing.costs import Costs, second_differences
from napari_phase4d.unwrapping.growing.growth import (
    HALF,
    MANY_LEFT,
    cheaper_cost,
    check_size,
    grow_grid,
    steps_between,
)
from napari_phase4d.unwrapping.growing.merging import (
    among_all,
    cheapest_steps,
    count_between,
    join_along,
    joined,
    keep_between,
    leave_out_alone,
    mark_cheapest_of_each,
    pass_on,
)
from napari_phase4d.unwrapping.growing.rows import Floats, Phase, Whole, Workspace

__all__ = ["Contracted", "Joining", "closed", "contracted", "whole"]

Mask = NDArray[np.bool_]
#: Nothing lies outside where all steps are known.
NEVER = np.inf


class Steps(NamedTuple):
    """Steps between groups, in the order of the grid."""

    first: Whole
    second: Whole
    #: Those of the second group less those of the first.
    turns: Whole
    cost: Floats

    def some(self, which: NDArray[np.bool_] | slice) -> Steps:
        """Return some of them."""
        return Steps(self.first[which], self.second[which], self.turns[which], self.cost[which])

    def renamed(self, number: Whole) -> Steps:
        """Return the same between groups of other numbers."""
        return Steps(number[self.first], number[self.second], self.turns, self.cost)


@dataclass(frozen=True)
class Contracted:
    """What is left of a block of frames.

    Parameters
    ----------
    block : Block
        The frames.
    steps : Steps
        Those between groups; a first group of -1 - p is pixel p of the frame before the block.
    beyond : ndarray of float64, shape (groups,)
        What the cheapest step of each group to the frame after the block costs; infinite for none.
    """

    block: Block
    steps: Steps
    beyond: Floats


def contracted(
    wrapped: Phase,
    mask: Mask,
    seen: Block,
    block: Block,
    n_times: int,
    check: Callable[[], None] = nothing,
) -> tuple[Contracted, Whole, Whole]:
    """Join what is certain in a block.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (time, angle, y, x)
        Wrapped phase in radians of the frames of ``seen``.
    mask : ndarray of bool, same shape
        Pixels to join.
    seen, block : Block
        The frames that are given: those of the block with two more at either end, where there are
        any.
    n_times : int
        How many frames there are in all.
    check : callable, optional
        Called between stages; may raise to stop.

    Returns
    -------
    Contracted
        What is left.
    groups, turns : ndarray of int32, shape of the block
        Group of every pixel, -1 outside the mask; its turns relative to that.
    """
    if len(block) == n_times:
        return whole(wrapped, mask, check)
    check_size(wrapped.size)
    work = Workspace()
    wrapped = np.require(wrapped, np.float32, ["C", "W"])
    every = second_differences(wrapped, None if mask.all() else np.require(mask, bool, "C"), work)
    check()
    a_frame = wrapped.shape[1] * wrapped.shape[2]  # in rows
    near = block.wider(1, 1, n_times)
    start, stop = ((t - near.start) * a_frame for t in (block.start, block.stop))
    place = slice((near.start - seen.start) * a_frame, (near.stop - seen.start) * a_frame)
    rows, point = wrapped.reshape(-1, wrapped.shape[3])[place], every.point[place]
    costs = Costs((len(near), *every.shape[1:]), point)
    marks = work.array("marks", point[:stop].shape, np.uint8)
    marks[:] = 0
    mark_cheapest_of_each(*costs.arguments, 0.0, marks, start, stop)
    # From here on without the frame after the block.
    rows, costs = rows[:stop], Costs((stop // a_frame, *every.shape[1:]), point[:stop])
    group = work.array("group", rows.shape, np.int32)
    turns = work.array("turns", rows.shape, np.int32)
    n = joined(rows, costs.shape, HALF, marks, group, turns)
    outside = start * rows.shape[1]  # each pixel of the frame before is a group of its own
    beyond = np.full(n, NEVER)
    if near.stop > block.stop:
        last = slice(stop - a_frame, stop)
        np.minimum.at(beyond, group[last].ravel(), (point[last] + point[stop:]).ravel())
    left = count_between(*costs.arguments, np.inf, group, start)
    several = left > MANY_LEFT * group.size
    for below in (cheaper_cost(costs), np.inf) if several else (np.inf,):
        check()
        steps = Steps(*steps_between(rows, costs, below, group, turns, work, start))
        of_group, more, beyond, steps = join_certain(steps, len(beyond), outside, beyond, check)
        pass_on(group.ravel(), turns.ravel(), of_group, more)
    steps = forest(steps, len(beyond))
    inside = mask[block.of(seen)]
    own = group[start:].reshape(inside.shape)
    number = numbered(own[inside], len(beyond))
    leads_in = np.where(steps.first < outside, -1 - steps.first, number[steps.first])
    steps = steps.renamed(number)._replace(first=leads_in)
    found = Contracted(block, steps, beyond[number >= 0])
    return (
        found,
        np.where(inside, number[own], np.int32(-1)),
        turns[start:].reshape(inside.shape).copy(),
    )


def whole(
    wrapped: Phase, mask: Mask, check: Callable[[], None] = nothing
) -> tuple[Contracted, Whole, Whole]:
    """Join all there is, where one block holds all frames; returns what `contracted` does."""
    block = Block(0, len(wrapped))
    turns, parts = grow_grid(wrapped, mask, check=check)
    if parts is not None:
        return closed(block, turns, parts, mask)
    return Contracted(block, no_steps(), np.full(1, NEVER)), np.zeros_like(turns), turns


def closed(
    block: Block, turns: Whole, parts: Whole, mask: Mask
) -> tuple[Contracted, Whole, Whole]:
    """Return parts that no step joins to another one, in the form of `contracted`."""
    number = numbered(parts[mask], int(parts.max()) + 1)
    nothing_left = Contracted(block, no_steps(), np.full(int(number.max()) + 1, NEVER))
    return nothing_left, np.where(mask, number[parts], np.int32(-1)), turns


def no_steps() -> Steps:
    """Return an empty list of steps."""
    none = np.zeros(0, dtype=np.int32)
    return Steps(none, none, none, np.zeros(0))


def numbered(present: Whole, n: int) -> Whole:
    """Return new numbers of those of n groups that are present, -1 for the others."""
    there = np.zeros(n, dtype=bool)
    there[present] = True
    number = np.cumsum(there, dtype=np.int32) - np.int32(1)
    number[~there] = -1
    return number


def join_certain(
    steps: Steps,
    n: int,
    outside: int,
    beyond: Floats,
    check: Callable[[], None] = nothing,
) -> tuple[Whole, Whole, Floats, Steps]:
    """Join groups along their cheapest steps, as far as these are known for certain.

    Parameters
    ----------
    steps : Steps
        The steps that are known; overwritten.
    n : int
        Number of groups.
    outside : int
        So many of the first groups are never joined: not all their steps are known.
    beyond : ndarray of float64, shape (n,)
        What the cheapest of the steps costs that are not known, for the other groups; they come
        after all known ones.
    check : callable, optional
        Called before every round; may raise to stop.

    Returns
    -------
    group, turns : ndarray of int32, shape (n,)
        New group of each one, those outside first, and its turns relative to that.
    beyond : ndarray of float64
        As given, for the new groups.
    steps : Steps
        Those that are left between them.
    """
    which = leave_out_alone(steps.first, steps.second, n)
    left, out = len(which), int(np.searchsorted(which, outside))
    of_some, turns_of_some = np.arange(left, dtype=np.int32), np.zeros(left, dtype=np.int32)
    least = beyond[which]
    while True:
        check()
        chosen = cheapest_steps(steps.first, steps.second, steps.cost, left)
        leave_out_doubted(chosen, steps.first, steps.cost, out, least)
        group, turns = np.empty(left, dtype=np.int32), np.empty(left, dtype=np.int32)
        now = join_along(chosen, steps.first, steps.second, steps.turns, group, turns)
        if now == left:
            break
        steps = steps.some(slice(keep_between(*steps, group, turns)))
        pass_on(of_some, turns_of_some, group, turns)
        least = least_of(least, group, now)
        left = now
    part, relative = np.empty(n, dtype=np.int32), np.empty(n, dtype=np.int32)
    n_parts = among_all(which, of_some, turns_of_some, part, relative)
    number = np.empty(left, dtype=np.int32)
    number[of_some] = part[which]
    return part, relative, least_of(beyond, part, n_parts), steps.renamed(number)


@compiled
def leave_out_doubted(
    chosen: Whole, first: Whole, cost: Floats, outside: int, beyond: Floats
) -> None:
    """Leave out the choice of groups that have steps not known, or choose one that leads out."""
    for i in range(len(chosen)):
        e = chosen[i]
        if i < outside or (e >= 0 and (first[e] < outside or cost[e] > beyond[i])):
            chosen[i] = -1


@compiled
def least_of(values: Floats, group: Whole, n: int) -> Floats:
    """Return the smallest value in each of n groups."""
    least = np.full(n, np.inf)
    for i in range(len(group)):
        least[group[i]] = min(least[group[i]], values[i])
    return least


def forest(steps: Steps, n: int) -> Steps:
    """Return those steps that are in the tree of cheapest steps of each part, in their order."""
    kept = np.zeros(len(steps.cost), dtype=bool)
    # Their places take the place of turns, which do not count here.
    place = np.arange(len(kept), dtype=np.int32)
    left_over = Steps(steps.first.copy(), steps.second.copy(), place, steps.cost.copy())
    none = np.zeros(len(kept), dtype=np.int32)
    left = len(leave_out_alone(left_over.first, left_over.second, n))
    while len(left_over.cost):
        first, second, place, cost = left_over
        chosen = cheapest_steps(first, second, cost, left)
        kept[place[chosen[chosen >= 0]]] = True
        group, turns = np.empty(left, dtype=np.int32), np.empty(left, dtype=np.int32)
        left = join_along(chosen, first, second, none, group, turns)
        left_over = left_over.some(slice(keep_between(*left_over, group, turns)))
    return steps.some(kept)


class Joining:
    """Joins blocks to each other, one after the other.

    What is carried on is one step at most for each pixel of the last frame. Which group became
    part of which is written away for every block, and followed backwards in the end.

    Parameters
    ----------
    pixels : int
        Pixels of a frame.
    store : Store
        Where lists of groups are kept.
    name : str
        What they are called.
    """

    def __init__(self, pixels: int, store: Store, name: str) -> None:
        self._store = store
        self._name = name
        self._n = 0
        self._steps = no_steps()
        self._node = np.full(pixels, -1, dtype=np.int32)
        self._turns = np.zeros(pixels, dtype=np.int32)
        self._maps: list[tuple[int, Stack]] = []
        #: Number of parts that no step joins to another one, so far.
        self.n_parts = 0

    def add(
        self, found: Contracted, groups: Whole, turns: Whole, check: Callable[[], None] = nothing
    ) -> None:
        """Take the next block, and the groups and turns of its last frame."""
        own = found.steps
        leads_in = own.first < 0
        pixel = -1 - own.first[leads_in]
        first, between = own.first + np.int32(self._n), own.turns.copy()
        first[leads_in] = self._node[pixel]
        between[leads_in] += self._turns[pixel]
        steps = Steps(
            np.concatenate([self._steps.first, first]),
            np.concatenate([self._steps.second, own.second + np.int32(self._n)]),
            np.concatenate([self._steps.turns, between]),
            np.concatenate([self._steps.cost, own.cost]),
        )
        beyond = np.concatenate([np.full(self._n, NEVER), found.beyond])
        of, more, beyond, steps = join_certain(steps, len(beyond), 0, beyond, check)
        open_ = np.isfinite(beyond)
        node = np.cumsum(open_, dtype=np.int32) - np.int32(1)
        part = np.cumsum(~open_, dtype=np.int32) - np.int32(1 - self.n_parts)
        target = np.where(open_, node, -1 - part)
        self._keep(np.stack([target[of], more]))
        in_frame = groups.ravel() >= 0
        which = groups.ravel()[in_frame] + self._n
        self._node[:], self._turns[:] = -1, 0
        self._node[in_frame] = target[of[which]]
        self._turns[in_frame] = turns.ravel()[in_frame] + more[which]
        self._n = int(open_.sum())
        self.n_parts += int((~open_).sum())
        self._steps = forest(steps.renamed(node), self._n)

    def _keep(self, lists: Whole) -> None:
        """Write what became of the groups that were carried on, and of those of a block."""
        number = len(self._maps)
        kept = self._store.temporary(
            f"{self._name} {number} joined", (2, 1, 1, lists.shape[1]), "int32"
        )
        kept.write(Block(0, 2), lists[:, None, None])
        self._maps.append((self._n, kept))

    def finished(self) -> list[Stack]:
        """Return part and turns of every group of each block, each a stack (2, 1, 1, group)."""
        found: list[Stack] = []
        known = np.zeros((2, 0), dtype=np.int32)
        for number in reversed(range(len(self._maps))):
            carried, kept = self._maps[number]
            target, turns = kept.read(Block(0, 2))[:, 0, 0]
            done = target < 0
            part, more = -1 - target, turns.copy()
            part[~done] = known[0, target[~done]]
            more[~done] += known[1, target[~done]]
            known = np.stack([part[:carried], more[:carried]])
            final = np.stack([part[carried:], more[carried:]])
            name = f"{self._name} {number} parts"
            own = self._store.temporary(name, (2, 1, 1, final.shape[1]), "int32")
            own.write(Block(0, 2), final[:, None, None])
            found.append(own)
        return found[::-1]
