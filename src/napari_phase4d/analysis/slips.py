"""What maps of confidence come to, frame by frame: pixels in doubt, objects that slipped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.analysis.cell_frames import Labels
from napari_phase4d.analysis.confidence import above_field, whole_turns
from napari_phase4d.analysis.differences import DOUBTFUL
from napari_phase4d.analysis.objects import (
    SMALLEST_OBJECT,
    object_of,
    told_apart,
    without_rims,
)
from napari_phase4d.later import xr
from napari_phase4d.stack import Block, Stack, stack_of
from napari_phase4d.task import UNWATCHED, Task, Watch, in_threads
from napari_phase4d.unwrapping import Problem, shown_field, working_blocks

__all__ = [
    "Counts",
    "Tally",
    "slip_warning",
    "slip_words",
    "slipped_frames",
    "tally_of",
]

#: An object may have slipped if at least this share of it is trusted less than so much.
MOST, FIRM = 0.5, 0.7

#: What is said of frames in which an object misses mass.
MISSING = (
    "an object has less mass than nearer to the boundary frame, by what an error of a cycle takes "
    "from it: look whether part of it truly came or went"
)

Counts = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Tally:
    """Pixels counted in every frame (time, angle).

    Parameters
    ----------
    inside : ndarray of int
        Those of the object; of the usable field, where no object is found at all.
    doubtful : dict of str to ndarray of int
        Of these, those that are more likely wrong than right, by method.
    slipped : dict of str to ndarray of bool
        Whether most of an object may be off by the same cycles, by method.
    differ : ndarray of int
        Those inside on which not all results have the same wrap count.
    shows_field : bool
        Whether any frame shows an empty field.
    """

    inside: Counts
    doubtful: dict[str, Counts]
    slipped: dict[str, Mask]
    differ: Counts
    shows_field: bool

    def doubtful_share(self, method: str) -> float:
        """Return the share of all pixels inside that are in doubt; NaN without any."""
        count = int(self.inside.sum())
        return int(self.doubtful[method].sum()) / count if count else float("nan")

    @property
    def disagreement(self) -> NDArray[np.float64]:
        """Share of each frame's pixels on which results differ; 0 where there is no object."""
        return self.differ / np.maximum(self.inside, 1)


def tally_of(
    problem: Problem,
    results: Mapping[str, xr.DataArray],
    trust: Mapping[str, Stack],
    task: Task = UNWATCHED,
) -> Tally:
    """Count what is in doubt and where results differ, of stacks of any length.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    results : mapping of str to DataArray
        Unwrapped phase of methods that are held against each other.
    trust : mapping of str to Stack
        Maps of confidence by method.
    task : Task, optional
        Who is told of it, and may stop it.
    """
    count = Count(
        problem,
        shown_field(problem, task),
        [stack_of(result) for result in results.values()],
        list(trust.values()),
    )
    blocks = working_blocks(problem.given.shape)
    watch = Watch(len(blocks), "counting what is in doubt", task)
    found = list(in_threads(count, blocks, watch, wait=True))
    in_object, in_field, slipped, shown = (
        np.concatenate(part) for part in zip(*found, strict=True)
    )
    counts = in_object if in_object[..., 0].any() else in_field
    return Tally(
        counts[..., 0],
        {method: counts[..., 2 + i] for i, method in enumerate(trust)},
        {method: slipped[..., i] for i, method in enumerate(trust)},
        counts[..., 1],
        bool(shown.any()),
    )


@dataclass(frozen=True)
class Count:
    """Counts in a block.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    empty : Stack
        The empty field.
    results : list of Stack
        What is held against each other.
    trust : list of Stack
        Maps of confidence.
    """

    problem: Problem
    empty: Stack
    results: list[Stack]
    trust: list[Stack]

    def __call__(self, block: Block) -> tuple[Counts, Counts, Mask, Mask]:
        """Return what is counted in the object, in the field, where objects slipped, and fields.

        The last axis of the counts is: pixels, those that differ, those in doubt of each method.
        """
        field = object_of(self.problem, None, block)
        empty = self.empty.read(block)
        inside = field & ~empty
        maps = [stack.read(block) for stack in self.trust]
        looks = [np.ones_like(field), self._differ(block, empty), *(m < DOUBTFUL for m in maps)]
        in_object, in_field = (
            np.stack([np.count_nonzero(look & where, axis=(2, 3)) for look in looks], axis=-1)
            for where in (inside, field)
        )
        slipped = np.zeros((*inside.shape[:2], len(maps)), dtype=bool)
        for frame in np.ndindex(*inside.shape[:2]):
            objects = without_rims(inside[frame], empty[frame])
            slipped[frame] = slips(objects, empty[frame], [m[frame] < FIRM for m in maps])
        return in_object, in_field, slipped, np.asarray(empty.any(axis=(1, 2, 3)))

    def _differ(self, block: Block, empty: Mask) -> Mask:
        """Mark where not all results have the same wrap count."""
        found = np.zeros_like(empty)
        if len(self.results) > 1:
            first, *others = (result.read(block) for result in self.results)
            for other in others:
                found |= above_field(whole_turns(other, first), empty) != 0
        return found


def slips(objects: Labels, empty: Mask, wrong: list[Mask]) -> list[bool]:
    """Say for each mask of doubt whether most of an object of the frame lies in it.

    Cells that touch are one object. They are told apart by their necks, as `find_cells` does it,
    where most of one of them might lie in it.
    """
    found = [mostly_in(objects, mask) for mask in wrong]
    inside, least = objects > 0, MOST * SMALLEST_OBJECT
    unsure = [
        i
        for i, mask in enumerate(wrong)
        if not found[i] and np.count_nonzero(mask & inside) >= least
    ]
    if unsure:
        cells = told_apart(objects, empty, [wrong[i] for i in unsure], least)
        for i in unsure:
            found[i] = mostly_in(cells, wrong[i])
    return found


def mostly_in(objects: Labels, mask: Mask) -> bool:
    """Say whether most of any numbered object of a frame lies in a mask."""
    size = np.bincount(objects.ravel())
    bad = np.bincount(objects[mask], minlength=size.size)
    return bool(((size >= SMALLEST_OBJECT) & (bad >= MOST * size))[1:].any())


def slipped_frames(problem: Problem, trust: xr.DataArray) -> Mask:
    """Mark the frames (time, angle) in which most of an object may be off by the same cycles.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    trust : DataArray
        What `confidence` gave.

    Returns
    -------
    ndarray of bool, shape (time, angle)
        True for the frames in which they may.
    """
    return tally_of(problem, {}, {"": stack_of(trust)}).slipped[""]


def slip_warning(problem: Problem, trust: xr.DataArray) -> str:
    """Say in one sentence in which frames whole objects may have slipped; "" if in none.

    `Comparison.warnings` says of directional L1 as well in how many of them mass is missing.

    Parameters
    ----------
    problem, trust
        See `slipped_frames`.

    Returns
    -------
    str
        How many frames those are, and which is the first, counted from 0.
    """
    return slip_words(slipped_frames(problem, trust))


def slip_words(slipped: Mask, missing: Mask | None = None) -> str:
    """Say in which of the frames (time, angle) whole objects may have slipped; "" if in none.

    Parameters
    ----------
    slipped : ndarray of bool
        The frames in which they may.
    missing : ndarray of bool, optional
        Those in which an object misses mass.
    """
    count = int(slipped.sum())
    if not count:
        return ""
    time, angle = np.argwhere(slipped)[0]
    said = (
        f"in {count} of {slipped.size} frames most of an object may be off by a cycle, "
        f"first in frame (time {time}, angle {angle}), counted from 0"
    )
    short = 0 if missing is None else int((slipped & missing).sum())
    return f"{said}; in {short} of them {MISSING}" if short else said
