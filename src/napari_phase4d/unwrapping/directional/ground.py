"""Which island of the empty field holds the level of its frame: it is followed along time.

Most often it is the largest. But a sheet of cells that is a turn thick looks like empty field, and
one that grows over the view is larger than that from some frame on. The field does not change
places: what was field a frame ago still is, or it is covered.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block
from napari_phase4d.unwrapping.directional.scene import Scene

__all__ = ["FIELD_SHARE", "Grounds", "Islands", "islands_of"]

#: An island of the empty field that takes at least this share of the frame holds its level.
FIELD_SHARE = 0.05
#: Smaller ones, as a share of the frame, are not looked at, unless they are the largest.
SMALLEST_SHARE = 0.001
#: An island goes on from what was field before if they have this share of the smaller one in
#: common.
IN_COMMON = 0.5
#: Outlines have about so many pixels along y and x.
OUTLINE = 32

Index = NDArray[np.int32]
Mask = NDArray[np.bool_]
Bits = NDArray[np.uint8]
Frame = tuple[int, int]


class Islands(NamedTuple):
    """The islands of a frame that are not small.

    Parameters
    ----------
    listed : ndarray of int, shape (islands, 4)
        Number, group, turns relative to the group, and pixels of each, in order.
    outline : ndarray of uint8
        Where the largest was seen: a bit for each of some pixels that are spread over the frame.
    """

    listed: Index
    outline: Bits

    @property
    def largest(self) -> int:
        """Which of them is the largest."""
        return int(np.argmax(self.listed[:, 3]))


def islands_of(numbers: Index, seen: Index, of_group: Index) -> Islands | None:
    """List the islands of a frame; None if it has none.

    Parameters
    ----------
    numbers, seen : ndarray of int, shape (y, x)
        The number of each pixel's island, from 0, -1 where there is none: of the frame moved into
        place, and as it was seen.
    of_group : ndarray of int, shape (islands, 2)
        Group of each island, and its turns relative to that.
    """
    if not len(of_group):
        return None
    pixels = np.bincount(numbers.ravel() + 1, minlength=len(of_group) + 1)[1:]
    largest = np.argmax(pixels)
    kept = pixels >= SMALLEST_SHARE * seen.size
    kept[largest] = True
    listed = np.column_stack([np.arange(len(of_group)), of_group, pixels]).astype(np.int32)
    rows, columns = (max(n // OUTLINE, 1) for n in seen.shape)
    return Islands(listed[kept], np.packbits(seen[::rows, ::columns] == largest))


@dataclass
class Before:
    """What was field in a frame.

    Parameters
    ----------
    frame : tuple of int
        Its time and angle.
    number : int
        The island that held its level.
    outline : ndarray of uint8 or None
        Where it lay, see `Islands`; None if that was not the largest.
    field, other : ndarray of bool, optional
        What was field, and what looked like it, once it has been asked.
    """

    frame: Frame
    number: int
    outline: Bits | None
    field: Mask | None = None
    other: Mask | None = None


@dataclass
class Grounds:
    """Finds which island holds the level of each frame.

    Parameters
    ----------
    scene : Scene
        What is unwrapped.
    islands : dict
        The islands of each frame (time, angle) that has any.
    others : list of tuple of int
        Group, turns and pixels of large islands that do not go on from the field, once it has
        been followed: a sheet, or field that an object cuts off.
    """

    scene: Scene
    islands: dict[Frame, Islands] = field(default_factory=dict)
    others: list[tuple[int, int, int]] = field(default_factory=list)

    def followed(self) -> NDArray[np.int64]:
        """Return group, turns and pixels of the island of each frame (time, angle, 3); -1: none.

        It is the largest in the frame that is begun from; in others the largest of those that go
        on from there, frame by frame.
        """
        n_times, n_angles = self.scene.shape[:2]
        found = np.full((n_times, n_angles, 3), -1, dtype=np.int64)
        if not self.islands:
            return found
        time, angle = first = self._first()
        before = self._take_largest(first, found)
        of_view = {angle: before}
        for views in (range(angle + 1, n_angles), range(angle - 1, -1, -1)):
            near = before
            for a in views:
                near = of_view[a] = self._next((time, a), near, found)
        for a in range(n_angles):
            self._along([(t, a) for t in range(time + 1, n_times)], of_view[a], found)
            self._along([(t, a) for t in range(time - 1, -1, -1)], of_view[a], found)
        return found

    def _first(self) -> Frame:
        """Return the frame that is begun from; where it has no island, that with the largest."""
        start = self.scene.frames.start
        if start in self.islands:
            return start
        return max(sorted(self.islands), key=lambda at: int(self.islands[at].listed[:, 3].max()))

    def _take(self, frame: Frame, row: int, found: NDArray[np.int64]) -> int:
        """Note an island of a frame; return its number."""
        number, *rest = self.islands[frame].listed[row].tolist()
        found[frame] = rest
        return int(number)

    def _take_largest(self, frame: Frame, found: NDArray[np.int64]) -> Before:
        """Note the largest island of a frame."""
        own = self.islands[frame]
        return Before(frame, self._take(frame, own.largest, found), own.outline)

    def _along(self, frames: Iterable[Frame], before: Before, found: NDArray[np.int64]) -> None:
        """Follow the field along frames."""
        for frame in frames:
            before = self._next(frame, before, found)

    def _next(self, frame: Frame, before: Before, found: NDArray[np.int64]) -> Before:
        """Note the island of a frame that goes on from what was field before, if there is one."""
        if frame not in self.islands:
            return before
        own = self.islands[frame]
        pixels = own.listed[:, 3]
        least = FIELD_SHARE * math.prod(self.scene.frames.shape[2:])
        large = pixels >= least
        alone = np.count_nonzero(large) == 1
        if alone and before.outline is not None and much_in_common(own.outline, before.outline):
            return self._take_largest(frame, found)
        if not large.any():  # it holds no level
            return before
        numbers = self._numbers(frame)
        goes_on = self._goes_on(own.listed, numbers, before)
        if not goes_on.any() and self._elsewhere(own, numbers, before):
            return self._take_largest(frame, found)
        self.others += [tuple(row) for row in own.listed[large & ~goes_on, 1:].tolist()]
        if not goes_on.any():
            return before
        row = int(np.argmax(np.where(goes_on, pixels, 0)))
        if alone and row == own.largest:
            return self._take_largest(frame, found)
        mask = np.isin(numbers, own.listed[goes_on, 0])
        return Before(frame, self._take(frame, row, found), None, mask, (numbers >= 0) & ~mask)

    def _elsewhere(self, own: Islands, numbers: Index, before: Before) -> bool:
        """Say whether the largest island lies mostly where nothing looked like field before.

        So it is where a stage has moved, or in another view: nothing says that it is no field.
        """
        assert before.field is not None  # it has been asked, see `_goes_on`
        assert before.other is not None
        largest = numbers == own.listed[own.largest, 0]
        known = np.count_nonzero(largest & (before.field | before.other))
        return bool(known < IN_COMMON * np.count_nonzero(largest))

    def _goes_on(self, listed: Index, numbers: Index, before: Before) -> Mask:
        """Say which islands of a frame go on from what was field before.

        They have much in common with it, and more than with what only looked like it.
        """
        if before.field is None:
            earlier = self._numbers(before.frame)
            before.field = earlier == before.number
            before.other = (earlier >= 0) & ~before.field
        ours, theirs = (
            np.bincount(numbers[mask] + 1, minlength=int(listed[:, 0].max()) + 2)[listed[:, 0] + 1]
            for mask in (before.field, before.other)
        )
        smaller = np.minimum(listed[:, 3], np.count_nonzero(before.field))
        found: Mask = (ours > theirs) & (ours >= IN_COMMON * smaller)
        return found

    def _numbers(self, frame: Frame) -> Index:
        """Return the number of each pixel's island in a frame, which is not moved.

        The field stays where it is when the object is held in place, and what is moved out of view
        comes in at the opposite edge.
        """
        time, angle = frame
        found: Index = self.scene.islands_as_seen(Block(time, time + 1))[0, angle]
        return found


def much_in_common(one: Bits, other: Bits) -> bool:
    """Say whether two outlines share enough of the smaller one."""
    shared, *sizes = (int(np.bitwise_count(bits).sum()) for bits in (one & other, one, other))
    return shared > 0 and shared >= IN_COMMON * min(sizes)
