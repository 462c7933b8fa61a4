"""The frames of a recording: level with their empty field, and registered by coherence.

A frame is moved so that the object stays where it is in the frame before. Between the two the
object may grow, so they are not compared by how little its phase has changed: a wrong shift, which
lowers one rim and raises the other, can make up for some of that. What has changed is a map that
is smooth where the shift is right, and torn at rims where it is wrong. Interferometric coherence
tells the two apart, as where radar images are registered.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import inlined, vectorized
from napari_phase4d.phasors import turned
from napari_phase4d.stack import Block
from napari_phase4d.task import UNWATCHED, Task, Watch, in_threads
from napari_phase4d.unwrapping.alone import Framewise
from napari_phase4d.unwrapping.background import Background
from napari_phase4d.unwrapping.frames import centre
from napari_phase4d.unwrapping.given import working_blocks

__all__ = ["Frames", "Recorded", "Seen", "Shifts", "follow_object"]

#: Coherence at a pixel is that of a square which reaches so far round it.
REACH = 3
SIDE = 2 * REACH + 1
#: Neighbours of a pixel (view, y, x) in its own view.
WITHIN_VIEW = np.pad(np.ones((1, 3, 3), dtype=bool), ((1, 1), (0, 0), (0, 0)))
#: No shift may take a part of the object over an edge of the view that has at least this share of
#: its pixels: a speck at the edge is no reason not to follow a cell.
LARGE_PART = 0.1
#: A new shift must make neighbours more coherent by this much ...
ADVANTAGE = 0.03
#: ... and by this much for every pixel that it moves. Where noise makes coherence lower, both are
#: lower by the same factor.
COST_OF_A_PIXEL = 0.005

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]
Shifts = NDArray[np.intp]

NO_TIMES: NDArray[np.intp] = np.zeros(0, dtype=np.intp)


class Recorded(Framewise, Protocol):
    """What the directional methods ask of a problem."""

    def lost(self) -> Mask:
        """Frames that say nothing."""

    def background(self, task: Task = UNWATCHED) -> Background:
        """Return the empty field."""

    def amplitude_of(self, block: Block) -> Image | None:
        """Amplitude of a block as a share of its view's median, or None."""


@dataclass(frozen=True)
class Seen:
    """Some frames, ready to be joined.

    Parameters
    ----------
    phase : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians less the frames' empty fields.
    empty, usable : ndarray of bool, same shape
        Empty field; pixels that count.
    amplitude : ndarray of float, same shape, or None
        Amplitude as a share of its view's median; None too where it was not asked for.
    """

    phase: Image
    empty: Mask
    usable: Mask
    amplitude: Image | None

    @property
    def free(self) -> Mask:
        """Pixels that count and are not empty: those of the object."""
        found: Mask = self.usable & ~self.empty
        return found


class Frames:
    """The frames of a recording, levelled; some are left out.

    Times at which all views are lost are left out, and so are outliers, and the rest solved as if
    they were adjacent. Where a view is lost by itself at one time, its frame before is held: so
    what changes from there to the frame after is one step. What would be made up half way between
    them would mislead other views. Where it is lost for longer, its pixels don't count.

    Parameters
    ----------
    recorded : Recorded
        What was recorded.
    task : Task, optional
        Who may stop it while the empty field is looked for.
    outliers : ndarray of int, optional
        Times that are left out as well, see `outlying_frames`. Default none.

    Attributes
    ----------
    lost : ndarray of bool, shape (time, angle)
        Frames that say nothing, and outliers.
    kept : ndarray of int
        Times that are not left out. Blocks of `read` count these.
    start : tuple of int
        The kept frame (time, angle) that lies next to the boundary frame.
    """

    def __init__(
        self,
        recorded: Recorded,
        task: Task = UNWATCHED,
        outliers: NDArray[np.intp] = NO_TIMES,
    ) -> None:
        self.recorded = recorded
        self.background = recorded.background(task)
        lost = recorded.lost()
        self.lost = np.zeros_like(lost) if lost.all() else lost
        self.outliers = outliers
        if len(outliers):
            self.lost = self.lost.copy()
            self.lost[outliers] = True
        self.kept = np.flatnonzero(~self.lost.all(axis=1))
        nearest = int(np.argmin(np.abs(self.kept - recorded.first[0])))
        self.start = nearest, recorded.first[1]
        self.shape = (len(self.kept), *recorded.given.shape[1:])

    def read(self, block: Block, *, amplitude: bool = False) -> Seen:
        """Return some of the kept frames; their amplitude only if it is asked for."""
        times = self.kept[block.start : block.stop]
        seen = self._seen(times, amplitude=amplitude)
        if self.lost[times].any():
            seen = Seen(seen.phase, seen.empty.copy(), seen.usable.copy(), seen.amplitude)
            for i, angle in np.argwhere(self.lost[times]):
                self._hold(seen, int(i), int(angle), int(times[i]))
        return seen

    def read_free(self, block: Block) -> Mask:
        """Return the object's pixels of some of the kept frames, as `read` does."""
        times = self.kept[block.start : block.stop]
        if self.lost[times].any():
            return self.read(block).free
        around = Block(int(times[0]), int(times[-1]) + 1)
        _, usable = self.recorded.given.read(around)
        found: Mask = usable & ~self.background.empty.read(around)
        return found if len(times) == len(around) else found[times - around.start]

    def read_empty(self, block: Block) -> Mask:
        """Return the empty field of some of the kept frames."""
        times = self.kept[block.start : block.stop]
        if self.lost[times].any():
            return self.read(block).empty
        around = Block(int(times[0]), int(times[-1]) + 1)
        return self.background.empty.read(around)[times - around.start]

    def all_times(self, block: Block) -> NDArray[np.intp]:
        """Return for the times of a block which kept frame stands for each: the one before."""
        found = np.searchsorted(self.kept, np.arange(block.start, block.stop), side="right") - 1
        return np.maximum(found, 0)

    def _seen(self, times: NDArray[np.intp], *, amplitude: bool = False) -> Seen:
        """Return the frames of some rising times as they were seen."""
        around = Block(int(times[0]), int(times[-1]) + 1)
        wrapped, usable = self.recorded.given.read(around)
        empty = self.background.empty.read(around)
        bright = self.recorded.amplitude_of(around) if amplitude else None
        if len(times) < len(around):
            own = times - around.start
            wrapped, usable, empty = wrapped[own], usable[own], empty[own]
            bright = None if bright is None else bright[own]
        level, tilt = self.background.level[times], self.background.tilt[times]
        levelled = turned(wrapped - self.background.ground_of(level, tilt))
        return Seen(levelled, empty, usable, bright)

    def _hold(self, seen: Seen, i: int, angle: int, time: int) -> None:
        """Hold the frame before a lost one of a view, or leave it out if either side is lost."""
        now = int(np.searchsorted(self.kept, time))
        next_to_it = self.kept[max(now - 1, 0) : now + 2 : 2]
        if now == 0 or len(next_to_it) < 2 or self.lost[next_to_it, angle].any():
            seen.usable[i, angle] = False
            return
        one = self._seen(next_to_it[:1])
        seen.phase[i, angle], seen.empty[i, angle] = one.phase[0, angle], one.empty[0, angle]
        seen.usable[i, angle] = one.usable[0, angle]


# ---- registration ----------------------------------------------------------------------------


def follow_object(frames: Frames, watch: Watch) -> Shifts:
    """Return shifts (time, angle, 2) in pixels that keep the object in place.

    They are the sum of one shift for each time and one for each angle. The centre of mass of the
    object proposes; of the shifts round it and the one before, that is taken which makes
    neighbouring frames most coherent. An object so smooth that it stays coherent where it is, and
    moves slowly, is left there: its changes are smooth as well.

    Parameters
    ----------
    frames : Frames
        Of which those pixels are the object that count and are not empty.
    watch : Watch
        Stops the work.
    """
    n_times, n_angles = frames.shape[:2]
    centres = centres_of(frames, watch)
    shifts = np.zeros((n_times, n_angles, 2), dtype=np.intp)
    shifts += along_time(frames, mean_of(centres, 1), watch)[:, None]
    if n_angles > 1:
        shifts += along_angle(frames, mean_of(centres, 0), watch)[None]
    return shifts


def centres_of(frames: Frames, watch: Watch) -> NDArray[np.float64]:
    """Return the centre of mass of the object in every frame (time, angle, 2)."""
    blocks = working_blocks(frames.shape)

    def work(block: Block) -> NDArray[np.float64]:
        free = frames.read_free(block)
        return np.array([[centre(mask) for mask in views] for views in free])

    return np.concatenate(list(in_threads(work, blocks, watch.quiet(len(blocks)))))


def mean_of(centres: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Return the mean of the centres that are known along an axis; NaN if none is."""
    known = np.isfinite(centres).all(axis=2, keepdims=True)
    count = known.sum(axis=axis)
    total = np.where(known, centres, 0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def proposals(off: NDArray[np.float64], before: Shifts) -> list[Shifts]:
    """Return the shifts to try: the one before, and those round what the centres say."""
    if not np.isfinite(off).all():
        return [before]
    rounded = np.floor(off + 0.5).astype(np.intp)
    near = [rounded + np.array(d) for d in product((-1, 0, 1), repeat=2)]
    return [before] + [shift for shift in near if (shift != before).any()]


def most_coherent(
    tried: list[Shifts], coherence: list[float], before: Shifts, noise: float
) -> Shifts:
    """Return the shift that makes frames most coherent; moving must be worth it.

    Between two frames with noise, normal of a standard deviation in radians, coherence is about
    exp(-noise^2) where squares are full; more where few pixels of them count.
    """
    costs = [-ADVANTAGE] + [COST_OF_A_PIXEL * int(np.abs(s - before).sum()) for s in tried[1:]]
    most = math.exp(-(noise**2))
    return tried[int(np.argmax(np.array(coherence) - most * np.array(costs)))]


def along_time(frames: Frames, centres: NDArray[np.float64], watch: Watch) -> Shifts:
    """Return the shift of every time, the same for all angles."""
    found = np.zeros((frames.shape[0], 2), dtype=np.intp)
    noise = frames.background.noise
    last: Look | None = None
    for block in working_blocks(frames.shape):
        for k, now in zip(block.times, looks_at(frames.read(block)), strict=True):
            watch.check()
            if last is not None:
                before = found[k - 1]
                tried = kept_in_view(now, proposals(centres[0] - centres[k], before))
                coherence = [mean_coherence([coherence_of(now, last, s - before)]) for s in tried]
                found[k] = most_coherent(tried, coherence, before, noise)
            last = now
    return found


def kept_in_view(now: Look, tried: list[Shifts]) -> list[Shifts]:
    """Leave out the new shifts that take part of the object over an edge of the view.

    An object that the edge cuts off is not held in place: its centre moves as it comes into view,
    and so do the shifts that it proposes. The first shift, which is that of the frame before,
    stays: a jump back would be no better.
    """
    before, *new = tried
    if not goes_over_edge(now.rows, now.columns, new):
        return tried
    large = large_parts(now.mask)
    rows, columns = (np.asarray(large.any(axis=axes)) for axes in ((0, 2), (0, 1)))
    return [before, *(shift for shift in new if not goes_over_edge(rows, columns, [shift]))]


def goes_over_edge(rows: Mask, columns: Mask, shifts: list[Shifts]) -> bool:
    """Say whether any of some shifts takes a pixel in these rows and columns over an edge."""
    for axis, own in enumerate((rows, columns)):
        places, by = np.flatnonzero(own), [int(shift[axis]) for shift in shifts]
        if by and len(places) and (places[0] + min(by) < 0 or places[-1] + max(by) >= len(own)):
            return True
    return False


def large_parts(mask: Mask) -> Mask:
    """Return the mask of an object in some views (view, y, x) without its smallest parts."""
    labels, count = scipy.ndimage.label(mask, WITHIN_VIEW)
    size = np.bincount(labels.ravel(), minlength=count + 1)
    size[0] = 0
    found: Mask = (size > LARGE_PART * size.sum() / len(mask))[labels]
    return found


def along_angle(frames: Frames, centres: NDArray[np.float64], watch: Watch) -> Shifts:
    """Return the shift of every angle, the same for all times."""
    found = np.zeros((frames.shape[1], 2), dtype=np.intp)
    noise = frames.background.noise
    blocks = working_blocks(frames.shape)
    for k in range(1, len(found)):
        before = found[k - 1]
        tried = proposals(centres[0] - centres[k], before)
        steps = [shift - before for shift in tried]

        def work(block: Block, k: int = k, steps: list[Shifts] = steps) -> list[list[Sums]]:
            seen = frames.read(block)
            pairs = zip(
                looks_at(seen, slice(k, k + 1)), looks_at(seen, slice(k - 1, k)), strict=True
            )
            return [[coherence_of(*pair, step) for step in steps] for pair in pairs]

        of_frames = [
            frame for some in in_threads(work, blocks, watch.quiet(len(blocks))) for frame in some
        ]
        coherence = [mean_coherence(of_shift) for of_shift in zip(*of_frames, strict=True)]
        found[k] = most_coherent(tried, coherence, before, noise)
    return found


# ---- coherence -------------------------------------------------------------------------------


class Look(NamedTuple):
    """Some views of the object: cosine and sine of the phase, and its mask (view, y, x).

    And which rows and columns the mask has pixels in, of any view.
    """

    cosine: Image
    sine: Image
    mask: Mask
    rows: Mask
    columns: Mask


#: Sum of the coherence at some pixels, and their number.
Sums = tuple[float, int]


def looks_at(seen: Seen, angles: slice = slice(None)) -> list[Look]:
    """Return what some frames show, time by time."""
    phase, free = seen.phase[:, angles], seen.free[:, angles]
    rows, columns = (np.asarray(free.any(axis=axes)) for axes in ((1, 3), (1, 2)))
    parts = zip(np.cos(phase), np.sin(phase), free, rows, columns, strict=True)
    return [Look(*of_time) for of_time in parts]


def mean_coherence(sums: Iterable[Sums]) -> float:
    """Return the mean of sums, which are added in the order of time."""
    total, count = 0.0, 0
    for more, number in sums:
        total, count = total + more, count + number
    return total / count if count else 1.0


def coherence_of(now: Look, before: Look, step: Shifts) -> Sums:
    """Return how coherent two looks are where either mask is, if the first is moved.

    At each pixel that is the length of the mean phasor of the phase differences round it, of those
    in either mask: the coherence that radar interferometry estimates, without amplitudes. The
    first look is moved round the edges of the field.
    """
    down, right = int(step[0]), int(step[1])
    rows = np.flatnonzero(before.rows | np.roll(now.rows, down))
    columns = np.flatnonzero(before.columns | np.roll(now.columns, right))
    if not len(rows):
        return 0.0, 0
    box = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    total, count = sum_of_coherence(now[:3], before[:3], down, right, box)
    return total, count


@vectorized
def sum_of_coherence(
    now: tuple[Image, Image, Mask],
    before: tuple[Image, Image, Mask],
    down: int,
    right: int,
    box: tuple[int, int, int, int],
) -> tuple[float, int]:
    """Do `coherence_of` in a box: its first row and the one after its last, columns likewise.

    The phase has to be finite all over it, in pixels that don't count too.
    """
    views, height, width = now[2].shape
    top, bottom, left, end = box
    wide, seam = end - left, right % width
    # Sums over a row and over a square; the last rows, which a square lies in, are kept.
    real, imaginary, either = np.zeros((3, wide + 2 * REACH), np.float32)
    sums = np.zeros((3, wide), np.float32)
    kept = np.zeros((SIDE, 3, wide), np.float32)
    inside = np.zeros((SIDE, wide), np.float32)
    total, count = 0.0, 0
    for view in range(views):
        sums[:], kept[:] = 0, 0
        for y in range(top, bottom + REACH):
            own = y % SIDE
            if y < bottom:
                row = (y - down) % height
                for start, stop, back in (
                    (left, min(end, seam), seam - width),
                    (max(left, seam), end, seam),
                ):
                    if start < stop:
                        at = slice(start - left + REACH, stop - left + REACH)
                        multiply(
                            now[0][view, row, start - back : stop - back],
                            now[1][view, row, start - back : stop - back],
                            now[2][view, row, start - back : stop - back],
                            before[0][view, y, start:stop],
                            before[1][view, y, start:stop],
                            before[2][view, y, start:stop],
                            real[at],
                            imaginary[at],
                            either[at],
                        )
            else:
                real[:], imaginary[:], either[:] = 0, 0, 0
            inside[own] = either[REACH : wide + REACH]
            slide(real, kept[own, 0], sums[0])
            slide(imaginary, kept[own, 1], sums[1])
            slide(either, kept[own, 2], sums[2])
            if y >= top + REACH:
                middle = inside[(y - REACH) % SIDE]
                total += lengths(sums[0], sums[1], sums[2], middle)
                count += int(middle.sum())
    return total, count


@inlined
def multiply(
    cosine: Image,
    sine: Image,
    mask: Mask,
    cosine_before: Image,
    sine_before: Image,
    mask_before: Mask,
    real: Image,
    imaginary: Image,
    either: Image,
) -> None:
    """Write the phasors of phase differences along a row, 0 where neither mask is."""
    # One after the other: a loop that writes several arrays works on one pixel at a time.
    for i in range(len(either)):
        either[i] = np.float32(mask[i] | mask_before[i])
    for i in range(len(either)):
        real[i] = (cosine[i] * cosine_before[i] + sine[i] * sine_before[i]) * either[i]
    for i in range(len(either)):
        imaginary[i] = (sine[i] * cosine_before[i] - cosine[i] * sine_before[i]) * either[i]


@inlined
def slide(row: Image, kept: Image, sums: Image) -> None:
    """Slide sums over squares on by a row: its sums come in, those of the row kept go out."""
    for x in range(len(sums)):
        # As many as `SIDE`; a loop here would be worked on one pixel at a time.
        near = row[x] + row[x + 1] + row[x + 2] + row[x + 3] + row[x + 4] + row[x + 5] + row[x + 6]
        sums[x] += near - kept[x]
        kept[x] = near


@inlined
def lengths(real: Image, imaginary: Image, number: Image, middle: Image) -> float:
    """Return the sum of the lengths of mean phasors at those pixels of a row that are inside."""
    total, one = np.float32(0), np.float32(1)
    for x in range(len(middle)):
        length = np.sqrt(real[x] * real[x] + imaginary[x] * imaginary[x])
        total += middle[x] * length / max(number[x], one)
    return float(total)
