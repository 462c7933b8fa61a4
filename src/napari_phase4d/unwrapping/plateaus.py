"""What lies whole turns above the empty field: its wrapped phase is the field's.

A sheet of cells, a biofilm or a layer that grows over the view is as flat as the empty field.
Where it is a turn thick, or two, no wrapped frame tells them apart. Directional L1 does, by the
slopes between them and by what came before. So what it has found is asked before anything is
judged by the empty field.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.stack import Block, ReadOnly, Stack
from napari_phase4d.task import Task, Watch, in_threads
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.directional.ground import FIELD_SHARE
from napari_phase4d.unwrapping.directional.support import Judged
from napari_phase4d.unwrapping.frames import border_medians
from napari_phase4d.unwrapping.given import working_blocks
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.shared_steps import PLATEAUS

__all__ = ["every_plateau", "on_its_field", "plateaus_of", "settle_plateaus", "shown_field"]

TURN = 2 * np.pi
Turns = NDArray[np.int16]
Frame = tuple[int, int]
#: Turns of each island of what looks empty, by the frame (time, angle); frames without a plateau
#: are left out.
Plateaus = Mapping[Frame, Turns]


def plateaus_of(problem: Problem, reference: Judged, task: Task) -> Plateaus:
    """Return which islands of what looks empty lie whole turns off the field.

    Small ones alone are not believed: noise may put them there, or a plateau inside of a cell.
    Once one is as large as a field, small ones count as well, as it has begun as one of these.

    Parameters
    ----------
    problem : Problem
        What was unwrapped; all its views have one wavelength.
    reference : Judged
        The result of directional L1.
    task : Task
        Who is told of it, and may stop it.
    """

    def find() -> Plateaus:
        background = problem.background(task)
        level = border_medians(background.level, problem.first)
        blocks = working_blocks(problem.given.shape)
        watch = Watch(len(blocks), "telling sheets from the field", task)
        look = IslandBlock(reference, background, level)
        found: dict[Frame, Islands] = {}
        for some in in_threads(look, blocks, watch, wait=True):
            found |= some
        least = FIELD_SHARE * math.prod(problem.given.shape[2:])
        above = {at: one.turns for at, one in found.items()}
        sheets = sheets_among(found, least)
        for at, own in above.items():
            # A sheet is as high where it covers all of the view as where it does not yet; else
            # the frame has slipped with its field.
            if own.all() and (at[1], found[at].of_largest) not in sheets:
                above[at] = own - found[at].of_largest
        return {at: own for at, own in above.items() if own.any()} if sheets else {}

    return problem.once(PLATEAUS, find)


def sheets_among(found: Mapping[Frame, Islands], least: float) -> set[tuple[int, int]]:
    """Return angle and turns of islands of at least so many pixels beside which there is field."""
    return {
        (at[1], turns)
        for at, one in found.items()
        if not one.turns.all()
        for turns in one.turns[(one.turns != 0) & (one.size >= least)].tolist()
    }


class Islands(NamedTuple):
    """Turns and pixels of the islands of a frame."""

    turns: Turns
    size: NDArray[np.intp]

    @property
    def of_largest(self) -> int:
        """Turns of the largest."""
        return int(self.turns[np.argmax(self.size)])


@dataclass(frozen=True)
class IslandBlock:
    """Looks at which level the islands of a block lie.

    Parameters
    ----------
    reference : Judged
        The result of directional L1.
    background : Background
        What looks empty.
    level : ndarray of float, shape (time, angle)
        Phase of the empty field of every frame, radians.
    """

    reference: Judged
    background: Background
    level: NDArray[np.float64]

    def __call__(self, block: Block) -> dict[Frame, Islands]:
        """Return the islands of the frames in which any is off the level of the field."""
        found: dict[Frame, Islands] = {}
        empty = self.background.empty.read(block)
        above = self.reference.read(block) - self.background.ground(self.level, block)
        turns = np.nan_to_num(np.round(above / np.float32(TURN)))
        for i, angle in zip(*np.nonzero((empty & (turns != 0)).any(axis=(2, 3))), strict=True):
            frame = empty[i, angle]
            labels, count = scipy.ndimage.label(frame)
            size = np.bincount(labels.ravel(), minlength=count + 1)[1:]
            own = scipy.ndimage.median(turns[i, angle], labels, np.arange(1, count + 1))
            own = np.round(own).astype(np.int16)
            if own.any():
                found[block.start + int(i), int(angle)] = Islands(own, size)
        return found


@dataclass(frozen=True)
class FieldAlone(ReadOnly):
    """The empty field without plateaus; to be read only.

    Parameters
    ----------
    empty : Stack
        What looks empty.
    plateaus : mapping
        See `plateaus_of`.
    """

    empty: Stack
    plateaus: Plateaus

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, angle, y, x)."""
        return self.empty.shape

    def read(self, block: Block, angles: slice = slice(None)) -> NDArray[Any]:
        """Return the frames of a block, or some of its views."""
        found = self.empty.read(block, angles).copy()
        for i, time in enumerate(block.times):
            for k, angle in enumerate(range(self.shape[1])[angles]):
                if (time, angle) in self.plateaus:
                    labels = scipy.ndimage.label(found[i, k])[0]
                    kept = np.append(False, self.plateaus[time, angle] == 0)
                    found[i, k] = kept[labels]
        return found


def on_its_field(problem: Problem, reference: Judged, task: Task) -> Problem:
    """Return the problem itself, or, where there are plateaus, one whose empty field has none.

    Parameters
    ----------
    problem, reference, task
        See `plateaus_of`.
    """
    plateaus = plateaus_of(problem, reference, task)
    if not plateaus:
        return problem
    background = problem.background(task)
    return problem.with_background(without_plateaus(background, plateaus))


def without_plateaus(background: Background, plateaus: Plateaus) -> Background:
    """Return the empty field without plateaus."""
    return replace(background, empty=FieldAlone(background.empty, plateaus))


def settle_plateaus(problem: Problem, reference: Judged, task: Task) -> None:
    """Look for plateaus in views of any wavelengths, if that has not been done; see `plateaus_of`.

    Then `shown_field` knows them.
    """
    if problem.knows(PLATEAUS):
        return
    for views, part in problem.by_wavelength():
        plateaus_of(part, reference.of_views(views), task)
    problem.once(PLATEAUS, lambda: every_plateau(problem))


def every_plateau(problem: Problem) -> Plateaus:
    """Return the plateaus that are known of a problem and its parts, by its own angles.

    Nothing is computed. Parts may be forgotten, and this stays.
    """
    return {
        (time, views[angle]): turns
        for views, part in problem.by_wavelength()
        if part.knows(PLATEAUS)
        for (time, angle), turns in part.known(PLATEAUS).items()
    }


def shown_field(problem: Problem, task: Task) -> Stack:
    """Return the empty field of a problem that was judged, without the plateaus that are known."""
    empty = problem.background(task).empty
    plateaus: Plateaus = problem.known(PLATEAUS) if problem.knows(PLATEAUS) else {}
    return FieldAlone(empty, plateaus) if plateaus else empty
