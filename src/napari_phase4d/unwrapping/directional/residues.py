"""How far the level of an object is known: the residues that stand in the way of it.

Round a residue the steps of a wrapped map do not add up, so that its phase depends on the way
(Goldstein et al. 1988). A map without residues has one phase only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, Stack
from napari_phase4d.task import UNWATCHED, Task, Watch, in_threads
from napari_phase4d.unwrapping.directional.methods import prepared
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.directional.steps import boxed
from napari_phase4d.unwrapping.frames import moved
from napari_phase4d.unwrapping.given import working_blocks
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["Residues", "level_residues"]

#: More are not counted: they fit into a byte.
MOST = 255

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Counts = NDArray[np.uint8]


@dataclass(frozen=True)
class Residues:
    """How many residues stand in the way of the level of each pixel's object.

    Parameters
    ----------
    scene : Scene
        What was unwrapped.
    counts : Stack
        For its kept and moved frames, up to 255.
    """

    scene: Scene
    counts: Stack

    def read(self, block: Block) -> Image:
        """Return it for some times."""
        which = self.scene.frames.all_times(block)
        kept = Block(int(which[0]), int(which[-1]) + 1)
        back = -self.scene.shifts[kept.start : kept.stop]
        counts = self.counts.read(kept).astype(np.float32)
        found: Image = moved(counts, back)[which - kept.start]
        return found


def level_residues(problem: Problem, task: Task = UNWATCHED) -> Residues:
    """Return how many residues stand in the way of the level of each pixel's object.

    An object that has no residues in its own frame has one level only. One that has some may
    still be known by a frame before or after it: if the map of what changes between the two has
    no residues. So of all frames of the same view the one counts from which the fewest residues
    of an object are in the way: its own there, or those of any map of changes from there on.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    task : Task, optional
        Who is told of it, and may stop it.
    """

    def count() -> Residues:
        scene = prepared(problem, task).scene
        names = ("own_residues", "residues_of_changes", "residues_since", "residues")
        own, changes, since, found = (
            problem.store.temporary(name, scene.shape, "uint8") for name in names
        )
        blocks = working_blocks(scene.shape)
        watch = Watch(3 * len(blocks), "counting residues", task)
        for _ in in_threads(CountBlock(scene, own, changes), blocks, watch, wait=True):
            pass
        carry_on(own, changes, since, blocks, watch)
        carry_back(since, changes, found, blocks, watch)
        return Residues(scene, found)

    return problem.once("residues", count)


@dataclass(frozen=True)
class CountBlock:
    """Counts the residues of the objects of a block, and those of their changes.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    own, changes : Stack
        Where the counts go: of each frame, and of what changes to the next one.
    """

    scene: Scene
    own: Stack
    changes: Stack

    def __call__(self, block: Block) -> None:
        """Do a block."""
        scene = self.scene
        seen, _, _ = boxed(scene, block.wider(0, 1, scene.shape[0]))
        own, changes = (np.zeros((len(block), *scene.shape[1:]), np.uint8) for _ in range(2))
        inside = (slice(None), slice(None), *scene.box)
        for i, angle in np.ndindex(len(block), scene.shape[1]):
            frame, after = (i, angle), (i + 1, angle)
            known, thing = seen.usable[frame], ~seen.empty[frame]
            own[inside][frame] = of_objects(seen.phase[frame], known, thing)
            if i + 1 < len(seen.phase):
                change = turned(seen.phase[after] - seen.phase[frame])
                both, either = known & seen.usable[after], thing | ~seen.empty[after]
                changes[inside][frame] = of_objects(change, both, either)
        self.own.write(block, own)
        self.changes.write(block, changes)


def of_objects(wrapped: Image, known: Mask, thing: Mask) -> Counts:
    """Return for every pixel of an object how many residues the object has; 0 elsewhere.

    Parameters
    ----------
    wrapped : ndarray of float32, shape (y, x)
        Wrapped phase, or its change, in radians.
    known, thing : ndarray of bool, same shape
        Where it is known; where it is not empty field.
    """
    thing = thing & known
    # Residues lie between four pixels, and those at a rim belong to what is inside.
    labels, count = scipy.ndimage.label(scipy.ndimage.binary_dilation(thing))
    sums = np.zeros(count + 1, dtype=np.int64)
    if count:
        count_residues(wrapped, known, labels, sums)
    found: Counts = np.where(thing, np.minimum(sums, MOST).astype(np.uint8)[labels], 0)
    return found.astype(np.uint8)


@compiled
def count_residues(
    wrapped: Image, known: Mask, labels: NDArray[np.int32], sums: NDArray[np.int64]
) -> None:
    """Add the residues of a map to those of the part that the pixel at their upper left is of."""
    turn = np.float32(2 * np.pi)
    for y in range(wrapped.shape[0] - 1):
        for x in range(wrapped.shape[1] - 1):
            part = labels[y, x]
            if part == 0 or not (
                known[y, x] and known[y, x + 1] and known[y + 1, x] and known[y + 1, x + 1]
            ):
                continue
            a, b = wrapped[y, x], wrapped[y, x + 1]
            c, d = wrapped[y + 1, x + 1], wrapped[y + 1, x]
            turns = np.rint((b - a) / turn) + np.rint((c - b) / turn)
            turns += np.rint((d - c) / turn) + np.rint((a - d) / turn)
            sums[part] += abs(int(turns))


def carry_on(own: Stack, changes: Stack, since: Stack, blocks: list[Block], watch: Watch) -> None:
    """Write how many are in the way from any frame before, or from the frame itself."""
    last: Counts | None = None
    for block in blocks:
        counts = own.read(block).copy()
        around = block.wider(1, 0, block.stop)
        steps = changes.read(around)  # what led to a frame stands with the one before it
        for i, time in enumerate(block.times):
            if last is not None:
                led = steps[time - 1 - around.start]
                np.minimum(counts[i], np.maximum(led, last), out=counts[i])
            last = counts[i]
        since.write(block, counts)
        watch.step()


def carry_back(
    since: Stack, changes: Stack, found: Stack, blocks: list[Block], watch: Watch
) -> None:
    """Write how many are in the way from any frame, before or after."""
    after: Counts | None = None
    for block in reversed(blocks):
        counts, steps = since.read(block).copy(), changes.read(block)
        for i in reversed(range(len(block))):
            if after is not None:
                np.minimum(counts[i], np.maximum(steps[i], after), out=counts[i])
            after = counts[i]
        found.write(block, counts)
        watch.step()
