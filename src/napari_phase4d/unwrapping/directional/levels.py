"""How far the level of an object is known: the residues that stand in the way of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block, Stack
from napari_phase4d.task import UNWATCHED, Task, Watch, in_threads
from napari_phase4d.unwrapping.directional.methods import prepared
from napari_phase4d.unwrapping.directional.residues import residues_of_objects
from napari_phase4d.unwrapping.directional.scene import Scene
from napari_phase4d.unwrapping.given import working_blocks
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.shared_steps import RESIDUES

__all__ = ["Residues", "level_residues"]

#: Noise of so many radians makes residues by itself, everywhere.
NOISY = 0.55

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Counts = NDArray[np.uint8]


@dataclass(frozen=True)
class Residues:
    """How many residues stand in the way of the level of each pixel's object.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    counts : Stack
        For kept and moved frames, up to 255.
    """

    scene: Scene
    counts: Stack

    def read(self, block: Block) -> Image:
        """Return it for some times."""
        (counts,) = self.scene.put_back(block, lambda kept: (self.counts.read(kept),))
        found: Image = counts.astype(np.float32)
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
        names = ("residues", "residues_of_changes")
        counts, changes = (problem.store.temporary(n, scene.shape, "uint8") for n in names)
        blocks = working_blocks(scene.shape)
        watch = Watch(3 * len(blocks), "counting residues", task)
        for _ in in_threads(CountBlock(scene, counts, changes), blocks, watch, wait=True):
            pass
        carry_on(counts, changes, blocks, watch)
        carry_back(counts, changes, blocks, watch)
        return Residues(scene, counts)

    return problem.once(RESIDUES, count)


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
        around = block.wider(0, 1, scene.shape[0])
        seen, seams = scene.read_box(around), scene.seams(around).astype(np.int16)
        own, changes = (np.zeros((len(block), *scene.shape[1:]), np.uint8) for _ in range(2))
        inside = (slice(None), slice(None), *scene.box)
        noisy = scene.noise > NOISY
        for i, angle in np.ndindex(len(block), scene.shape[1]):
            frame, after = (i, angle), (i + 1, angle)
            known, thing = seen.usable[frame], ~seen.empty[frame]
            own[inside][frame] = residues_of_objects(
                seen.phase[frame], known, thing, seams[frame], noisy
            )
            if i + 1 < len(seen.phase):
                change = turned(seen.phase[after] - seen.phase[frame])
                both, either = known & seen.usable[after], thing | ~seen.empty[after]
                sides = seams[frame] + np.int16(64) * seams[after]  # a seam of either frame
                changes[inside][frame] = residues_of_objects(change, both, either, sides, noisy)
        self.own.write(block, own)
        self.changes.write(block, changes)


def carry_on(counts: Stack, changes: Stack, blocks: list[Block], watch: Watch) -> None:
    """Let a frame have no more in its way than the frame before, or what led from there."""
    last: Counts | None = None
    for block in blocks:
        here = counts.read(block).copy()
        around = block.wider(1, 0, block.stop)
        steps = changes.read(around)  # what led to a frame stands with the one before it
        for i, time in enumerate(block.times):
            if last is not None:
                led = steps[time - 1 - around.start]
                np.minimum(here[i], np.maximum(led, last), out=here[i])
            last = here[i]
        counts.write(block, here)
        watch.step()


def carry_back(counts: Stack, changes: Stack, blocks: list[Block], watch: Watch) -> None:
    """Let a frame have no more in its way than the frame after, or what led there."""
    after: Counts | None = None
    for block in reversed(blocks):
        here, steps = counts.read(block).copy(), changes.read(block)
        for i in reversed(range(len(block))):
            if after is not None:
                np.minimum(here[i], np.maximum(steps[i], after), out=here[i])
            after = here[i]
        counts.write(block, here)
        watch.step()
