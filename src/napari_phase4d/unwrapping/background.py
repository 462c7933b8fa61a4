"""What of the field is empty: where the phase is flat and joined to the border."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import vectorized
from napari_phase4d.phasors import parts_of, phasors, turned
from napari_phase4d.stack import Block, Memory, Stack, Store
from napari_phase4d.task import UNWATCHED, Task, on_all_cores
from napari_phase4d.unwrapping.filters import keep_touching, shrunk
from napari_phase4d.unwrapping.frames import BORDER, border_of
from napari_phase4d.unwrapping.given import (
    Given,
    WithoutLost,
    as_given,
    lost_of,
    sampled_noise,
    working_blocks,
)
from napari_phase4d.unwrapping.neighbours import LEAST_WEIGHT, box_mean

__all__ = ["Background", "background_of", "find_background", "plane", "tilt_of"]

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
#: Share of the frames that have to show one for it to be levelled frame by frame.
FRAME_SHARE = 0.9
#: Smaller islands at the border, in pixels, are no background.
SMALLEST = 12
#: Times and angles that the field of noisy frames is averaged over, where there are so many.
BOX = 3


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
class Background:
    """The empty field of a stack (time, angle, y, x).

    Parameters
    ----------
    empty : Stack
        Marks empty pixels; none in frames that show no background.
    level : ndarray of float, shape (time, angle)
        Phase of the empty field in radians, which is to be taken off every frame.
    noise : float
        Standard deviation of the phase's noise in radians.
    tilt : ndarray of float, shape (time, angle, 2)
        By how many radians the empty field of every frame rises from pixel to pixel along y and
        x, about the middle of the frame.
    shown : ndarray of bool, shape (time, angle)
        Frames whose own empty field gave their level; others have that of the nearest.
    """

    empty: Stack
    level: NDArray[np.float64]
    noise: float
    tilt: NDArray[np.float64]
    shown: Mask

    @property
    def mask(self) -> Mask:
        """All empty pixels, in memory."""
        return self.empty.read(Block(0, self.empty.shape[0]))

    def ground(self, level: NDArray[np.float64], block: Block | None = None) -> Image:
        """Return the phase of the empty field everywhere, for some levels of the frames.

        The shape is (time, angle, y, x), or (time, angle, 1, 1) where nothing is tilted.

        Parameters
        ----------
        level : ndarray of float, shape (time, angle)
            Of all frames.
        block : Block, optional
            The frames that are asked for; default all.
        """
        frames = slice(None) if block is None else slice(block.start, block.stop)
        return self.ground_of(level[frames], self.tilt[frames])

    def ground_of(self, level: NDArray[np.float64], tilt: NDArray[np.float64]) -> Image:
        """Return the phase of the empty field for some frames' level and tilt."""
        flat: Image = level[..., None, None].astype(np.float32)
        return flat + plane(tilt, self.empty.shape[2:]) if self.tilt.any() else flat


def plane(tilt: NDArray[np.float64], shape: tuple[int, ...]) -> Image:
    """Return planes of some tilts (..., 2), zero in the middle."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    found: Image = (tilt[..., 0, None, None] * y[:, None] + tilt[..., 1, None, None] * x).astype(
        np.float32
    )
    return found


def find_background(
    wrapped: Image, usable: Mask | None = None, lost: Mask | None = None
) -> Background:
    """Find the empty field of every frame, and its level.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    usable : ndarray of bool, optional
        Pixels that may be looked at; default all. The border is then theirs.
    lost : ndarray of bool, shape (time, angle), optional
        Frames that say nothing; default those that `lost_frames` marks.
    """
    given = as_given(wrapped, usable)
    return background_of(given, lost_of(given) if lost is None else lost, Memory())


def background_of(given: Given, lost: Mask, store: Store, task: Task = UNWATCHED) -> Background:
    """Do `find_background` for phase that is read a block at a time.

    Parameters
    ----------
    given : Given
        Wrapped phase, and the pixels that count.
    lost : ndarray of bool, shape (time, angle)
        Frames that say nothing.
    store : Store
        Where the empty field is kept.
    task : Task, optional
        Who may stop it.
    """
    looked_at = WithoutLost(given, lost)
    noise = sampled_noise(looked_at)
    limits = limits_for(noise)
    levels = levels_of(looked_at, limits, task)
    views = shows_field(levels.found, ~lost if not lost.all() else lost)
    shown = levels.found & views
    level = np.where(views, filled(levels.level, shown), 0) if shown.any() else 0 * levels.level
    tilt = levels.tilt * views[..., None]
    found = Background(store.temporary("empty", given.shape, "bool"), level, noise, tilt, shown)
    mark = MarkBlock(looked_at, found, limits)
    on_all_cores(mark, working_blocks(given.shape), task, FINDING)
    return found


def shows_field(found: Mask, seen: Mask) -> Mask:
    """Mark the views (1, angle) whose empty field is to be relied on.

    Where too few frames of a view show one, what looks like it in some may lie inside the object.
    Where all views together show enough, single frames of any view may lack it. A view that the
    camera never saw is noise in every frame, and no reason to doubt the others.

    Parameters
    ----------
    found : ndarray of bool, shape (time, angle)
        Frames that seem to show an empty field.
    seen : ndarray of bool, same shape
        Frames that say something.
    """
    if found[seen].mean() >= FRAME_SHARE:
        return np.ones((1, found.shape[1]), dtype=bool)
    counts = np.maximum(seen.sum(axis=0, keepdims=True), 1)
    enough: Mask = (found & seen).sum(axis=0, keepdims=True) / counts >= FRAME_SHARE
    return enough


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
    """Level and tilt of the empty field of each frame (time, angle), and whether it is in view."""

    level: NDArray[np.float64]
    tilt: NDArray[np.float64]
    found: Mask


def levels_of(given: WithoutLost, limits: Limits, task: Task = UNWATCHED) -> Levels:
    """Look for the level of each frame's border, and say whether enough of it lies there."""
    shape = given.shape[:2]
    found = Levels(np.zeros(shape), np.zeros((*shape, 2)), np.zeros(shape, dtype=bool))

    def look(block: Block) -> None:
        wrapped, usable = given.read(block)
        for i, angle in np.ndindex(*wrapped.shape[:2]):
            inside = None if usable[i, angle].all() else usable[i, angle]
            t = block.start + i, angle
            found.level[t], found.tilt[t], found.found[t] = level_of_frame(
                wrapped[i, angle], inside, limits
            )

    on_all_cores(look, working_blocks(given.shape), task, FINDING)
    return found


def level_of_frame(
    wrapped: Image, usable: Mask | None, limits: Limits
) -> tuple[float, NDArray[np.float64], bool]:
    """Return level and tilt of a frame's border, and whether enough of it lies there."""
    edge = border_of(wrapped.shape) if usable is None else rim(usable, BORDER)
    within = FLAT + NEAR_LEVEL + 2 * limits.left
    y, x = np.nonzero(edge)
    at_edge = smoothed_border(wrapped, usable, limits.width)[y, x]
    clear = np.abs(at_edge) > limits.shortest - SHORTER
    tilt = np.zeros(2)
    if not clear.any():
        return 0.0, tilt, False
    values = np.angle(at_edge[clear]).astype(np.float64)
    level, near = level_of(values, within)
    if near < (1 - WORTH_A_TILT) * len(values):
        height, width = wrapped.shape
        found = tilt_of(values, y[clear] - (height - 1) / 2, x[clear] - (width - 1) / 2, within)
        if found[2] > max(near + WORTH_A_TILT * len(values), WHOLE * len(y)):
            level, tilt, near = found
    return level, tilt, near / max(len(y), 1) > BORDER_SHARE


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


@dataclass(frozen=True)
class MarkBlock:
    """Marks the empty pixels of a block.

    Parameters
    ----------
    given : WithoutLost
        Wrapped phase, and the pixels that count.
    found : Background
        Level and tilt, and which frames show one; where the empty field goes.
    limits : Limits
        What counts as empty.
    """

    given: WithoutLost
    found: Background
    limits: Limits

    def __call__(self, block: Block) -> None:
        """Do a block."""
        n_times, n_angles = self.given.shape[:2]
        limits, mask = self.limits, np.zeros((len(block), *self.given.shape[1:]), dtype=bool)
        shown = self.found.shown[block.start : block.stop]
        if shown.any():
            around = block if limits.quiet else block.with_neighbours(n_times)
            wrapped, usable = self.given.read(around)
            field = self._levelled(around, wrapped, usable)
            left, shortest = limits.left, limits.shortest - SHORTER
            if not limits.quiet:
                # The empty field is the same at neighbouring times and angles, a cell that moves
                # or turns is not; with less noise, a plateau inside the cell is less often taken
                # for empty.
                field = averaged(field, usable)
                averaged_over = [BOX for n in (n_times, n_angles) if n >= BOX]
                left /= math.sqrt(math.prod(averaged_over))
                shortest = math.exp(-(limits.noise**2) / 2) - 2 * left
            own = block.of(around)
            flat = is_flat(field[own], FLAT + 2 * left, shortest)
            for i, angle in zip(*np.nonzero(shown), strict=True):
                inside = usable[own][i, angle]
                mask[i, angle] = joined_to_border(
                    flat[i, angle], None if inside.all() else inside, quiet=limits.quiet
                )
        self.found.empty.write(block, mask)

    def _levelled(self, block: Block, wrapped: Image, usable: Mask) -> Fields:
        """Return the smoothed field, at the level of the empty field."""
        field = np.empty(wrapped.shape, dtype=np.complex64)
        back = phasors(-self.found.ground(self.found.level, block))
        for frame in np.ndindex(*wrapped.shape[:2]):
            inside = None if usable[frame].all() else usable[frame]
            field[frame] = smoothed_field(wrapped[frame], inside, self.limits.width)
            field[frame] *= back[frame]
        return field


def is_flat(field: Fields, within: float, shortest: float) -> Mask:
    """Mark where a field is longer than this and its phase nearer to zero than so many radians."""
    length = np.abs(field)
    flat: Mask = field.real > np.float32(math.cos(min(within, math.pi))) * length
    return flat & (length > shortest)


def averaged(field: Fields, usable: Mask) -> Fields:
    """Return the field averaged over three times and angles, over the pixels that count."""
    if usable.all():
        return box_mean(field, (0, 1))
    weights = usable.astype(np.float32)
    field = box_mean(field * weights, (0, 1))
    field /= np.maximum(box_mean(weights, (0, 1)), np.float32(LEAST_WEIGHT))
    return field


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


def filled(level: NDArray[np.float64], known: Mask) -> NDArray[np.float64]:
    """Take unknown levels from the nearest known frame."""
    nearest = scipy.ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    found: NDArray[np.float64] = level[tuple(nearest)]
    return found


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


def going_on(mask: Mask, by: int) -> Mask:
    """Return a mask that goes on beyond its border as it is there, by so many pixels."""
    height, width = mask.shape
    found = np.empty((height + 2 * by, width + 2 * by), dtype=bool)
    found[by:-by, by:-by] = mask
    found[by:-by, :by], found[by:-by, -by:] = mask[:, :1], mask[:, -1:]
    found[:by], found[-by:] = found[by], found[-by - 1]
    return found


def joined_to_border(flat: Mask, usable: Mask | None, *, quiet: bool) -> Mask:
    """Return what of the flat pixels of a frame is joined to its border by more than a thread."""
    edge = np.zeros_like(flat)
    edge[[0, -1]] = edge[:, [0, -1]] = True
    if usable is not None:
        edge = rim(usable, 1)
        # Beyond its border the field counts as going on, as it does beyond the frame's.
        flat = flat | ~usable
    padded = going_on(flat, 2)
    inner = shrunk(padded, beyond=False, square=not quiet)
    opened = ~shrunk(~inner, beyond=True, square=not quiet)[2:-2, 2:-2]
    if usable is not None:
        opened &= usable
    found = np.ascontiguousarray(opened)
    keep_touching(found, edge, SMALLEST)
    if quiet:
        return found
    kept = found if usable is None else found | ~usable
    return shrunk(kept, beyond=True) & found
