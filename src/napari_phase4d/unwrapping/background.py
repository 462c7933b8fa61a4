"""What of the field is empty: where the phase is flat and joined to the border."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.phasors import phasors
from napari_phase4d.stack import Block, Memory, Stack, Store
from napari_phase4d.task import UNWATCHED, Task, on_all_cores
from napari_phase4d.unwrapping.border import (
    FINDING,
    FLAT,
    SHORTER,
    Limits,
    levels_of,
    limits_for,
    rim,
    smoothed_field,
)
from napari_phase4d.unwrapping.filters import keep_touching, shrunk
from napari_phase4d.unwrapping.given import (
    Given,
    WithoutLost,
    as_given,
    lost_of,
    sampled_noise,
    working_blocks,
)
from napari_phase4d.unwrapping.neighbours import LEAST_WEIGHT, box_mean

__all__ = ["Background", "background_of", "find_background", "plane"]

#: Share of the frames that have to show one for it to be levelled frame by frame.
FRAME_SHARE = 0.9
#: Smaller islands at the border, in pixels, are no background.
SMALLEST = 12
#: Times and angles that the field of noisy frames is averaged over, where there are so many.
BOX = 3

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


def background_of(
    given: Given,
    lost: Mask,
    store: Store,
    task: Task = UNWATCHED,
    first: tuple[int, int] | None = None,
) -> Background:
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
    first : (int, int), optional
        Time and angle of a frame whose border tells best what is empty field; default that of
        whose border most lies level.
    """
    looked_at = WithoutLost(given, lost)
    noise = sampled_noise(looked_at)
    limits = limits_for(noise)
    levels = levels_of(looked_at, limits, task, first)
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


def filled(level: NDArray[np.float64], known: Mask) -> NDArray[np.float64]:
    """Take unknown levels from the nearest known frame."""
    nearest = scipy.ndimage.distance_transform_edt(
        ~known, return_distances=False, return_indices=True
    )
    found: NDArray[np.float64] = level[tuple(nearest)]
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
