"""The border of every frame: the level of its empty field, and where round the frame it lies."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import vectorized
from napari_phase4d.phasors import parts_of, phasors, turned
from napari_phase4d.stack import Block
from napari_phase4d.task import UNWATCHED, Task, Watch, on_all_cores
from napari_phase4d.unwrapping.filters import shrunk
from napari_phase4d.unwrapping.frames import BORDER, border_of
from napari_phase4d.unwrapping.given import WithoutLost, working_blocks
from napari_phase4d.unwrapping.neighbours import LEAST_WEIGHT

__all__ = [
    "FINDING",
    "FLAT",
    "SHORTER",
    "Limits",
    "levels_of",
    "limits_for",
    "rim",
    "smoothed_field",
    "tilt_of",
]

TURN = 2 * np.pi
#: What is being done, where it is told.
FINDING = "looking for the empty field"
#: Up to this noise in radians, frames count as free of noise.
QUIET = 0.1
#: Width in pixels of the Gaussian that the field is smoothed with: quiet frames, others.
SMOOTHING = (0.7, 1.2)
#: The empty field lies within this many radians of its level ...
FLAT = 0.5
#: ... a frame's border within this many more of its commonest phase ...
NEAR_LEVEL = 0.3
#: ... and the smoothed field there is shorter than that of pure noise by at most this.
SHORTER = 0.06
#: Share of the border that has to be flat for a frame to show a background.
BORDER_SHARE = 0.4
#: Where it goes on from the frame before, this share is enough.
SHARE_THAT_GOES_ON = BORDER_SHARE / 2
#: The border is divided into so many sectors. A frame is asked again if of those that lie level in
#: it, or did in the frame before, less than this share does in both; what lay there before counts
#: if it is now more than so many radians off.
SECTORS, IN_COMMON, OTHER_LEVEL = 64, 0.75, 0.25
#: The field has moved all the same if less than this share of where it was is still level, and
#: this many times as much of the border lies level elsewhere.
STILL, CLEARER = 0.6, 1.5
#: A sector lies level if the mean phasor of its pixels does so within this many radians.
LEVEL_SECTOR = 0.4
#: Bins of the histogram of phases in which a frame's level is looked for, and its sharpness.
BINS, SHARPNESS = 72, 4.0
#: Tilts are looked for up to so many radians from side to side, on a grid of so many ...
STEEPEST, TILTS = 3.0, 9
#: ... and are taken off where so much more of the border lies level then.
WORTH_A_TILT = 0.08
#: ... and this share of it altogether: a slope may also be that of a cell at the border.
WHOLE = 0.9

Image = NDArray[np.float32]
Fields = NDArray[np.complex64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Limits:
    """What counts as empty at some noise.

    Parameters
    ----------
    noise : float
        In radians.
    width : float
        Of the Gaussian that the field is smoothed with, in pixels.
    left : float
        Noise that smoothing leaves, in radians.
    shortest : float
        Length of the smoothed field where it is flat, at least.
    """

    noise: float
    width: float
    left: float
    shortest: float

    @property
    def quiet(self) -> bool:
        """Whether there is hardly any noise."""
        return self.noise < QUIET


def limits_for(noise: float) -> Limits:
    """Return what counts as empty where the noise is so many radians."""
    width = SMOOTHING[int(noise >= QUIET)]
    left = noise / (2 * math.sqrt(math.pi) * width)
    return Limits(noise, width, left, math.exp(-(noise**2) / 2) - 2 * left)


@dataclass(frozen=True)
class Levels:
    """What the border says of the empty field of each frame (time, angle).

    Parameters
    ----------
    level, tilt : ndarray of float, shapes (time, angle) and (time, angle, 2)
        Of the empty field.
    share : ndarray of float, shape (time, angle)
        How much of the border lies at that level.
    found : ndarray of bool, shape (time, angle)
        Whether that is enough.
    sectors : ndarray of bool, shape (time, angle, sectors)
        Where round the frame it does.
    """

    level: NDArray[np.float64]
    tilt: NDArray[np.float64]
    share: NDArray[np.float64]
    found: Mask
    sectors: Mask

    @classmethod
    def of_frames(cls, shape: tuple[int, int]) -> Levels:
        """Return room for those of so many times and angles."""
        return cls(
            np.zeros(shape),
            np.zeros((*shape, 2)),
            np.zeros(shape),
            np.zeros(shape, dtype=bool),
            np.zeros((*shape, SECTORS), dtype=bool),
        )

    def note(self, at: tuple[int, int], border: Border) -> None:
        """Take what the border of a frame says."""
        self.level[at], self.tilt[at], self.share[at], self.sectors[at] = border


class Border(NamedTuple):
    """What the border of a frame says of its empty field, see `Levels`."""

    level: float
    tilt: NDArray[np.float64]
    share: float
    sectors: Mask


def levels_of(
    given: WithoutLost,
    limits: Limits,
    task: Task = UNWATCHED,
    first: tuple[int, int] | None = None,
) -> Levels:
    """Look for the level of each frame's border, and say whether enough of it lies there."""
    found = Levels.of_frames((given.shape[0], given.shape[1]))

    def look(block: Block) -> None:
        wrapped, usable = given.read(block)
        for i, angle in np.ndindex(*wrapped.shape[:2]):
            border = border_of_frame(wrapped[i, angle], usable[i, angle], limits)
            found.note((block.start + i, angle), border)

    on_all_cores(look, working_blocks(given.shape), task, FINDING)
    found.found[:] = found.share > BORDER_SHARE
    if found.found.any():
        keep_in_place(found, given, limits, Watch(1, FINDING, task), first)
    return found


def keep_in_place(
    levels: Levels,
    given: WithoutLost,
    limits: Limits,
    watch: Watch,
    first: tuple[int, int] | None = None,
) -> None:
    """Take the empty field, where it seems to change places, for where it was before.

    What grows over the view with a flat top takes more of the border than the empty field from
    some frame on. But the field is not all at once where the object was a frame ago. So from the
    first frame on to both sides, a frame that lies level where the one before did not is asked
    what lies where the field was; only if too little of that lies level has it truly moved.
    """
    n_times, n_angles = levels.found.shape
    time, angle = first = start_of(levels, first)
    along = AlongFrames(levels, given, limits, watch)
    here = levels.sectors[first]
    along([(time, a) for a in range(angle + 1, n_angles)], here)
    along([(time, a) for a in reversed(range(angle))], here)
    for a in range(n_angles):
        near = levels.sectors[time, a] if levels.found[time, a] else here
        along([(t, a) for t in range(time + 1, n_times)], near)
        along([(t, a) for t in reversed(range(time))], near)


@dataclass(frozen=True)
class AlongFrames:
    """Follows the empty field from frame to frame, see `keep_in_place`.

    Parameters
    ----------
    levels : Levels
        What each frame says by itself; changed where the field went on elsewhere.
    given : WithoutLost
        Wrapped phase, and the pixels that count.
    limits : Limits
        What counts as empty.
    watch : Watch
        Stops the work.
    """

    levels: Levels
    given: WithoutLost
    limits: Limits
    watch: Watch

    def __call__(self, frames: Iterable[tuple[int, int]], before: Mask) -> None:
        """Follow it along frames (time, angle), from the sectors in which it was before."""
        levels = self.levels
        nothing = turned_down = np.zeros_like(before)
        lost = False
        for at in frames:
            now = levels.sectors[at]
            if lost and levels.found[at]:  # much may have moved in the meantime
                before, turned_down = now, nothing
            elif levels.found[at] and changes_places(now, before):
                self.watch.check()
                turned_down = self._look_again(at, before, turned_down)
            lost = not levels.share[at]
            if levels.found[at] and levels.sectors[at].any():
                before = levels.sectors[at]

    def _look_again(self, at: tuple[int, int], before: Mask, turned_down: Mask) -> Mask:
        """Ask a frame what lies where the field was; return what is known not to be the field."""
        levels = self.levels
        wrapped, usable = self.given.read(Block(at[0], at[0] + 1))
        border = border_of_frame(wrapped[0, at[1]], usable[0, at[1]], self.limits, before)
        now, own = levels.sectors[at], float(levels.share[at])
        still = int((border.sectors & before).sum()) / max(int(before.sum()), 1)
        if still < STILL and own > CLEARER * border.share:  # it has truly moved
            return np.zeros_like(before)
        if border.share > SHARE_THAT_GOES_ON:
            if abs(turned(border.level - levels.level[at])) > OTHER_LEVEL:
                levels.note(at, border)
                others: Mask = now & ~border.sectors
                return others
        elif turned_down.any():
            # What was not the field stays what it is when the field leaves the view.
            levels.found[at] = (now & turned_down).sum() < 0.5 * turned_down.sum()
        return turned_down


def start_of(levels: Levels, first: tuple[int, int] | None) -> tuple[int, int]:
    """Return the first frame if it shows a field, else the clearest, of several the nearest."""
    if first is not None and levels.found[first]:
        return first
    times, angles = np.indices(levels.found.shape)
    time, angle = (0, 0) if first is None else first
    away = (np.abs(times - time) + np.abs(angles - angle)) / (1 + levels.found.size)
    share = np.where(levels.found, levels.share, 0)
    best = int(np.lexsort((away.ravel(), -share.ravel()))[0])
    return best // levels.found.shape[1], best % levels.found.shape[1]


def changes_places(now: Mask, before: Mask) -> bool:
    """Say whether two places round a frame have less in common than what goes on has."""
    return int((now & before).sum()) < IN_COMMON * max(int(now.sum()), int(before.sum()))


def border_of_frame(
    wrapped: Image, usable: Mask, limits: Limits, sectors: Mask | None = None
) -> Border:
    """Return what the border of a frame says, or what some of its sectors do."""
    inside = None if usable.all() else usable
    within = FLAT + NEAR_LEVEL + 2 * limits.left
    places = whole_border(wrapped.shape) if inside is None else places_of(rim(inside, BORDER))
    at_edge = smoothed_border(wrapped, inside, limits.width)[places.pixels]
    y, x, sector = places.y, places.x, places.sector
    n = max(len(y), 1)
    clear = np.abs(at_edge) > limits.shortest - SHORTER
    tilt = np.zeros(2)
    if not clear.any():
        return Border(0.0, tilt, 0.0, np.zeros(SECTORS, dtype=bool))
    y, x, sector = y[clear], x[clear], sector[clear]
    values = np.angle(at_edge[clear]).astype(np.float64)
    asked = values if sectors is None else values[sectors[sector]]
    level, near = level_of(asked, within)
    if sectors is not None and near <= len(asked) / 2:  # nothing lies level there any more
        return Border(0.0, tilt, 0.0, np.zeros(SECTORS, dtype=bool))
    if sectors is None and near < (1 - WORTH_A_TILT) * len(values):
        found = tilt_of(values, y, x, within)
        if found[2] > max(near + WORTH_A_TILT * len(values), WHOLE * n):
            level, tilt, near = found
    off = turned(values - tilt[0] * y - tilt[1] * x - level)
    share = int((np.abs(off) < within).sum()) / n
    return Border(level, tilt, share, level_sectors(off, sector))


class Places(NamedTuple):
    """Pixels of a border: where they lie, also from the middle, and their sectors."""

    pixels: tuple[NDArray[np.intp], NDArray[np.intp]]
    y: NDArray[np.float64]
    x: NDArray[np.float64]
    sector: NDArray[np.intp]


def places_of(edge: Mask) -> Places:
    """Return the places of a border (y, x)."""
    rows, columns = np.nonzero(edge)
    y, x = (at - (size - 1) / 2 for at, size in zip((rows, columns), edge.shape, strict=True))
    return Places((rows, columns), y, x, sectors_of(y, x))


@lru_cache(maxsize=8)
def whole_border(shape: tuple[int, int]) -> Places:
    """Return the places of the border of whole frames, which is the same for all of them."""
    return places_of(border_of(shape))


def level_sectors(off: NDArray[np.floating], sector: NDArray[np.intp]) -> Mask:
    """Mark the sectors whose mean phasor is hardly off the level.

    What is off by less than single pixels may be, by chance or as the field is not flat, is not
    the field all the same if all of a sector is.
    """
    real, imaginary = (np.bincount(sector, part, SECTORS) for part in (np.cos(off), np.sin(off)))
    return (np.hypot(real, imaginary) > 0) & (np.abs(np.arctan2(imaginary, real)) < LEVEL_SECTOR)


def sectors_of(y: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the sector round the middle that each place lies in.

    Axes and diagonals are middles of sectors, so that mirrored frames have mirrored ones.
    """
    return np.rint(np.arctan2(y, x) * (SECTORS / TURN)).astype(np.intp) % SECTORS


def smoothed_border(wrapped: Image, usable: Mask | None, width: float) -> Fields:
    """Return the smoothed field of a frame; of a whole frame at its border alone."""
    reach = BORDER + len(gaussian(width)) // 2
    if usable is not None or min(wrapped.shape) <= 4 * reach:
        return smoothed_field(wrapped, usable, width)
    found = np.zeros(wrapped.shape, dtype=np.complex64)
    for strip, kept in (
        (slice(0, reach), slice(0, BORDER)),
        (slice(-reach, None), slice(-BORDER, None)),
    ):
        found[kept] = smoothed_field(wrapped[strip], None, width)[kept]
        found[:, kept] = smoothed_field(wrapped[:, strip], None, width)[:, kept]
    return found


def smoothed_field(wrapped: Image, usable: Mask | None, width: float) -> Fields:
    """Return the field of a frame (y, x), smoothed over the pixels that count."""
    field = phasors(wrapped)
    if usable is None:
        return smoothed(field, width)
    weights = usable.astype(np.float32)
    field = smoothed(field * weights, width)
    spread = smoothed(weights.astype(np.complex64), width).real
    field /= np.maximum(spread, np.float32(LEAST_WEIGHT))
    return field


def gaussian(width: float) -> Image:
    """Return the weights of a Gaussian of so many pixels, cut off at 2.5 of them."""
    reach = int(2.5 * width + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    found: Image = (weights / weights.sum()).astype(np.float32)
    return found


def smoothed(field: Fields, width: float) -> Fields:
    """Return a field (y, x) smoothed with a Gaussian; beyond its border it goes on as it is.

    `scipy.ndimage.gaussian_filter` gives the same with ``mode="nearest"``, ten times as slowly.
    """
    found = np.empty(field.shape, dtype=np.complex64)
    smooth_parts(parts_of(field), gaussian(width), parts_of(found))
    return found


@vectorized
def smooth_parts(parts: Image, weights: Image, out: Image) -> None:
    """Smooth real and imaginary parts, which take turns along x."""
    height, width = parts.shape
    n, reach = len(weights), len(weights) // 2
    padded = np.empty(width + 4 * reach, dtype=np.float32)
    rows = np.zeros((height, width), dtype=np.float32)
    for y in range(height):
        for i in range(width):
            padded[2 * reach + i] = parts[y, i]
        for i in range(2 * reach):
            padded[i] = parts[y, i % 2]
            padded[2 * reach + width + i] = parts[y, width - 2 + i % 2]
        for k in range(n):
            w = weights[k]
            for i in range(width):
                rows[y, i] += w * padded[2 * k + i]
    for y in range(height):
        for i in range(width):
            out[y, i] = 0
        for k in range(n):
            w, source = weights[k], min(max(y + k - reach, 0), height - 1)
            for i in range(width):
                out[y, i] += w * rows[source, i]


def level_of(values: NDArray[np.floating], within: float) -> tuple[float, int]:
    """Return the phase that most values have, and how many lie near it."""
    grid = np.linspace(-np.pi, np.pi, BINS, endpoint=False)
    likeness = np.exp(SHARPNESS * (np.cos(grid[:, None] - grid) - 1))
    bins = np.round((values + np.pi) * (BINS / TURN)).astype(np.intp) % BINS
    mode = grid[np.argmax(likeness @ np.bincount(bins, minlength=BINS))]
    off = turned(values - mode)
    near = np.abs(off) < within
    if not near.any():
        return 0.0, 0
    return mode + float(np.median(off[near])), int(near.sum())


def tilt_of(
    values: NDArray[np.float64], y: NDArray[np.float64], x: NDArray[np.float64], within: float
) -> tuple[float, NDArray[np.float64], int]:
    """Return the level and tilt of the plane that most values lie near, and how many do.

    The plane at which the phasors add up to most, of a grid of tilts; then fitted to the values
    that lie near it.
    """
    z = np.exp(1j * values)
    rises = np.linspace(-STEEPEST, STEEPEST, TILTS)
    height, width = (max(float(np.ptp(c)), 1.0) for c in (y, x))
    along_y = np.exp(-1j * rises[:, None] / height * y) * z
    along_x = np.exp(-1j * rises[:, None] / width * x)
    steepest = np.argmax(np.abs(along_y @ along_x.T))
    i, j = np.unravel_index(steepest, (TILTS, TILTS))
    tilt = np.array([rises[i] / height, rises[j] / width])
    level = 0.0
    for _ in range(3):
        level, _ = level_of(turned(values - tilt[0] * y - tilt[1] * x), within)
        off = turned(values - tilt[0] * y - tilt[1] * x - level)
        close = np.abs(off) < within
        if close.sum() < 3:
            break
        terms = np.stack([np.ones(close.sum()), y[close], x[close]], axis=1)
        fit = np.linalg.lstsq(terms, off[close], rcond=None)[0]
        tilt = tilt + fit[1:]
        level += float(fit[0])
    off = turned(values - tilt[0] * y - tilt[1] * x - level)
    return level, tilt, int((np.abs(off) < within).sum())


def rim(usable: Mask, width: int) -> Mask:
    """Mark the outermost pixels of those that are usable."""
    inner = usable
    for _ in range(width):
        inner = shrunk(inner, beyond=False)
    found: Mask = usable & ~inner
    return found
