"""What of the field is empty: where the phase is flat and joined to the border."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.progress import on_all_cores
from napari_phase4d.unwrapping.spatial import BORDER, border_of

__all__ = ["Background", "find_background", "lost_frames", "noise_of", "turned"]

TURN = 2 * np.pi
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
#: The noise is measured on about so many pixels: every so manieth time of longer recordings.
ENOUGH_PIXELS = 1_000_000
#: To tell whether a frame says anything, about so many of its pixels will do, in whole rows.
ENOUGH_IN_FRAME = 4_000
#: Smaller islands at the border, in pixels, are no background.
SMALLEST = 12
#: Times and angles that the field of noisy frames is averaged over.
BOX = 3
#: Share of the weight of a window below which a mean counts as nothing.
LEAST_WEIGHT = 1e-3
#: Bins of the histogram of phases in which a frame's level is looked for, and its sharpness.
BINS, SHARPNESS = 72, 4.0
#: A frame shows the same everywhere if this share of its steps, taken along x, is less than so
#: many radians from none or from half a turn, as where a field of zero has changed its sign ...
SAME_SHARE, SAME = 0.98, 1e-3
#: ... which no camera does that sees anything, if other frames have more noise than this.
SOME_NOISE = 1e-3
#: A frame is nothing but noise if that is larger than this in radians, and larger than that of
#: the others by so much. Pure noise measures 0.95.
NOISE_ONLY, NOISIER = 0.85, 0.15
#: Tilts are looked for up to so many radians from side to side, on a grid of so many ...
STEEPEST, TILTS = 3.0, 9
#: ... and are taken off where so much more of the border lies level then.
WORTH_A_TILT = 0.08
#: ... and this share of it altogether: a slope may also be that of a cell at the border.
WHOLE = 0.9

Stack = NDArray[np.float32]
Mask = NDArray[np.bool_]
CROSS = ndimage.generate_binary_structure(2, 1)
SQUARE = ndimage.generate_binary_structure(2, 2)


@dataclass(frozen=True)
class Background:
    """The empty field of a stack (time, angle, y, x).

    Parameters
    ----------
    mask : ndarray of bool, shape (time, angle, y, x)
        Empty pixels; none in frames that show no background.
    level : ndarray of float, shape (time, angle)
        Phase of the empty field in radians, which is to be taken off every frame.
    noise : float
        Standard deviation of the phase's noise in radians.
    tilt : ndarray of float, shape (time, angle, 2)
        By how many radians the empty field of every frame rises from pixel to pixel along y and
        x, about the middle of the frame.
    """

    mask: Mask
    level: NDArray[np.float64]
    noise: float
    tilt: NDArray[np.float64]

    def ground(self, level: NDArray[np.float64]) -> Stack:
        """Return the phase of the empty field everywhere, for some levels of the frames.

        The shape is (time, angle, y, x), or (time, angle, 1, 1) where nothing is tilted.
        """
        flat: Stack = level[..., None, None].astype(np.float32)
        return flat + plane(self.tilt, self.mask.shape[2:]) if self.tilt.any() else flat


def plane(tilt: NDArray[np.float64], shape: tuple[int, ...]) -> Stack:
    """Return planes of some tilts (..., 2), zero in the middle."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    found: Stack = (tilt[..., 0, None, None] * y[:, None] + tilt[..., 1, None, None] * x).astype(
        np.float32
    )
    return found


def lost_frames(wrapped: Stack, usable: Mask | None = None) -> Mask:
    """Mark the frames that say nothing of the object.

    Lost are frames without a usable pixel; those that are the same everywhere between others
    that are not, such as black or saturated ones; and those that are nothing but noise, unless
    all are.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    usable : ndarray of bool, same shape, optional
        Pixels that may be looked at; default all.

    Returns
    -------
    ndarray of bool, shape (time, angle)
    """
    shape = wrapped.shape[:2]
    blind, same = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    noise = np.zeros(shape)

    def look(frame: tuple[int, ...]) -> None:
        blind[frame] = usable is not None and not usable[frame].any()
        some = wrapped[frame][:: 1 + wrapped[frame].size // ENOUGH_IN_FRAME]
        few = None
        if usable is not None and not usable[frame].all():
            few = usable[frame][:: 1 + wrapped[frame].size // ENOUGH_IN_FRAME]
        same[frame] = is_same(some, few)
        noise[frame] = noise_of(some, few, axes=(-1,))

    on_all_cores(look, list(np.ndindex(*shape)))
    same &= ~blind
    seen = ~blind & ~same
    if not seen.any():
        return blind
    typical = float(np.median(noise[seen]))
    noisy = seen & (noise > NOISE_ONLY) & (noise > typical + NOISIER)
    if typical < SOME_NOISE:  # free of noise, as simulated phase is: it may show an empty field
        good = seen & ~noisy
        before = np.logical_or.accumulate(good, axis=0)
        after = np.logical_or.accumulate(good[::-1], axis=0)[::-1]
        same &= before & after
    return blind | same | noisy


def is_same(frame: Stack, usable: Mask | None) -> bool:
    """Say whether a frame (y, x) shows the same phase everywhere, up to its sign."""
    if frame.shape[1] < 2:
        return False
    step = np.abs(np.sin(np.diff(frame, axis=1)))
    if usable is not None:
        step = step[usable[:, 1:] & usable[:, :-1]]
    return step.size > 0 and float((step < SAME).mean()) >= SAME_SHARE


def noise_of(
    wrapped: Stack, usable: Mask | None = None, axes: tuple[int, ...] = (-1, -2)
) -> float:
    """Return the standard deviation of the noise in radians, from second differences.

    The median of the wrapped second differences along y or x, whichever is smaller; for white
    noise it is 0.6745 sqrt(6) standard deviations.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    usable : ndarray of bool, optional
        Pixels that count; default all.
    axes : tuple of int, optional
        Along which to measure; the least noise counts.
    """
    if wrapped.size > ENOUGH_PIXELS and wrapped.ndim == 4:
        some = np.s_[:: 1 + wrapped.size // ENOUGH_PIXELS]
        wrapped = wrapped[some]
        usable = None if usable is None else usable[some]
    found = []
    for axis in axes:
        if wrapped.shape[axis] < 3:
            continue
        step = turned(np.diff(wrapped, axis=axis))
        second = np.abs(turned(np.diff(step, axis=axis)))
        if usable is not None:
            last = wrapped.ndim + axis
            thrice = [
                usable[(slice(None),) * last + (slice(i, i + second.shape[axis]),)]
                for i in range(3)
            ]
            second = second[thrice[0] & thrice[1] & thrice[2]]
        if second.size:
            found.append(float(np.median(second)) / 0.6745 / np.sqrt(6))
    return min(found, default=0.0)


def turned(phase: NDArray[np.floating]) -> Stack:
    """Wrap phase into [-pi, pi]."""
    wrapped: Stack = (phase - TURN * np.round(phase / TURN)).astype(np.float32)
    return wrapped


def find_background(
    wrapped: Stack, usable: Mask | None = None, lost: Mask | None = None
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
    if lost is None:
        lost = lost_frames(wrapped, usable)
    if lost.any() and not lost.all():
        every = np.ones(wrapped.shape, dtype=bool) if usable is None else usable
        usable = every & ~lost[..., None, None]
    if usable is None or usable.all():
        usable = None
    seen = ~lost if not lost.all() else lost
    noise = noise_of(wrapped, usable)
    width = SMOOTHING[int(noise >= QUIET)]
    weights = np.float32(1) if usable is None else usable.astype(np.float32)
    length, phase = smoothed_field(wrapped, usable, width)
    left = noise / (2 * np.sqrt(np.pi) * width)  # noise that smoothing leaves
    shortest = np.exp(-(noise**2) / 2) - 2 * left  # length of the field where it is flat
    within = FLAT + NEAR_LEVEL + 2 * left
    level, tilt, has_background = levels(phase, length, usable, shortest - SHORTER, within)
    if has_background[seen].mean() >= FRAME_SHARE:
        level = filled(level, has_background)
        found = Background(np.empty(wrapped.shape, dtype=bool), level, noise, tilt)
        phase = turned(phase - found.ground(level))
    else:
        # Too few frames show one: what looks like it in some may lie inside the object.
        has_background[:] = False
        level[:] = 0
        tilt[:] = 0
    if noise >= QUIET:
        # The empty field is the same at neighbouring times and angles, a cell that moves or turns
        # is not; with less noise, a plateau inside the cell is less often taken for empty.
        sizes = [BOX if n >= BOX else 1 for n in wrapped.shape[:2]] + [1, 1]
        length, phase = mean_field(
            weights * length, phase, weights, lambda part: box_mean(part, sizes)
        )
        left /= float(np.sqrt(np.prod(sizes)))
        shortest = np.exp(-(noise**2) / 2) - 2 * left
    enough = shortest - (SHORTER if noise < QUIET else 0)
    flat = (np.abs(phase) < FLAT + 2 * left) & (length > enough)
    mask = np.zeros(wrapped.shape, dtype=bool)

    def work(frame: tuple[int, ...]) -> None:
        inside = None if usable is None else usable[frame]
        mask[frame] = joined_to_border(flat[frame], inside, quiet=noise < QUIET)

    on_all_cores(work, list(zip(*np.nonzero(has_background), strict=True)))
    return Background(mask, level, noise, tilt)


def smoothed_field(wrapped: Stack, usable: Mask | None, width: float) -> tuple[Stack, Stack]:
    """Return length and phase of the field smoothed over y and x, frame by frame."""
    length, phase = np.empty_like(wrapped), np.empty_like(wrapped)

    def smooth(part: Stack) -> Stack:
        found: Stack = ndimage.gaussian_filter(part, width, mode="nearest", truncate=2.5)
        return found

    def work(frame: tuple[int, ...]) -> None:
        weights = np.float32(1) if usable is None else usable[frame].astype(np.float32)
        length[frame], phase[frame] = mean_field(weights, wrapped[frame], weights, smooth)

    on_all_cores(work, list(np.ndindex(*wrapped.shape[:2])))
    return length, phase


def box_mean(part: Stack, sizes: Sequence[int]) -> Stack:
    """Average over a box."""
    found: Stack = ndimage.uniform_filter(part, sizes, mode="nearest")
    return found


def mean_field(
    length: Stack | np.float32,
    phase: Stack,
    weights: Stack | np.float32,
    smooth: Callable[[Stack], Stack],
) -> tuple[Stack, Stack]:
    """Return length and phase of a smoothed field, over the pixels that have a weight only."""
    real, imaginary = smooth(length * np.cos(phase)), smooth(length * np.sin(phase))
    mean = np.hypot(real, imaginary)
    if np.ndim(weights):
        mean /= np.maximum(smooth(np.asarray(weights)), LEAST_WEIGHT)
    return mean.astype(np.float32), np.arctan2(imaginary, real).astype(np.float32)


def filled(level: NDArray[np.float64], known: Mask) -> NDArray[np.float64]:
    """Take unknown levels from the nearest known frame."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    found: NDArray[np.float64] = level[tuple(nearest)]
    return found


def levels(
    phase: Stack, length: Stack, usable: Mask | None, shortest: float, within: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], Mask]:
    """Return level and tilt of each frame's border, and whether enough of it lies there."""
    shape = phase.shape[2:]
    edge = border_of(shape)
    level, share = np.zeros(phase.shape[:2]), np.zeros(phase.shape[:2])
    tilt = np.zeros((*phase.shape[:2], 2))
    for frame in np.ndindex(*level.shape):
        if usable is not None:
            edge = rim(usable[frame], BORDER)
        clear = edge & (length[frame] > shortest)
        if not clear.any():
            continue
        values = phase[frame][clear].astype(np.float64)
        level[frame], near = level_of(values, within)
        if near < (1 - WORTH_A_TILT) * len(values):
            y, x = np.nonzero(clear)
            found = tilt_of(values, y - (shape[0] - 1) / 2, x - (shape[1] - 1) / 2, within)
            if found[2] > max(near + WORTH_A_TILT * len(values), WHOLE * edge.sum()):
                level[frame], tilt[frame], near = found
        share[frame] = near / edge.sum()
    return level, tilt, share > BORDER_SHARE


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
    found: Mask = usable & ~ndimage.binary_erosion(usable, CROSS, width, border_value=0)
    return found


def joined_to_border(flat: Mask, usable: Mask | None, *, quiet: bool) -> Mask:
    """Return what of the flat pixels of a frame is joined to its border by more than a thread."""
    structure = CROSS if quiet else SQUARE
    edge = np.zeros_like(flat)
    edge[[0, -1]] = edge[:, [0, -1]] = True
    if usable is not None:
        edge = rim(usable, 1)
        # Beyond its border the field counts as going on, as it does beyond the frame's.
        flat = flat | ~usable
    padded = np.pad(flat, 2, mode="edge")
    opened = ndimage.binary_opening(padded, structure)[2:-2, 2:-2]
    if usable is not None:
        opened &= usable
    labels, count = ndimage.label(opened)
    if count == 0:
        return np.zeros_like(flat)
    touching = np.zeros(count + 1, dtype=bool)
    touching[labels[edge]] = True
    touching &= np.bincount(labels.ravel(), minlength=count + 1) >= SMALLEST
    touching[0] = False
    found: Mask = touching[labels]
    if quiet:
        return found
    kept = found if usable is None else found | ~usable
    eroded: Mask = ndimage.binary_erosion(kept, CROSS, border_value=1) & found
    return eroded
