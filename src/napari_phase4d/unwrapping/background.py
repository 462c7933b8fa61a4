"""What of the field is empty: where the phase is flat and joined to the border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.unwrapping.spatial import border_of

__all__ = ["Background", "find_background", "noise_of"]

TURN = 2 * np.pi
#: Up to this noise in radians, frames count as free of noise.
QUIET = 0.1
#: Width in pixels of the Gaussian that the field is smoothed with: quiet frames, others.
SMOOTHING = (0.7, 1.2)
#: The empty field lies within this many radians of its level ...
FLAT = 0.5
#: ... and the smoothed field there is shorter than that of pure noise by at most this.
SHORTER = 0.06
#: Share of the border that has to be flat for a frame to show a background.
BORDER_SHARE = 0.4
#: Share of the frames that have to show one for it to be levelled frame by frame.
FRAME_SHARE = 0.9
#: Smaller islands at the border, in pixels, are no background.
SMALLEST = 12
#: Times and angles that the field of noisy frames is averaged over.
BOX = 3
#: Bins of the histogram of phases in which a frame's level is looked for, and its sharpness.
BINS, SHARPNESS = 72, 4.0

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
    """

    mask: Mask
    level: NDArray[np.float64]
    noise: float


def noise_of(wrapped: Stack) -> float:
    """Return the standard deviation of the noise in radians, from second differences.

    The median of the wrapped second differences along y or x, whichever is smaller; for white
    noise it is 0.6745 sqrt(6) standard deviations.
    """
    found = []
    for axis in (-1, -2):
        if wrapped.shape[axis] >= 3:
            step = turned(np.diff(wrapped, axis=axis))
            second = np.abs(turned(np.diff(step, axis=axis)))
            found.append(float(np.median(second)) / 0.6745 / np.sqrt(6))
    return min(found, default=0.0)


def turned(phase: NDArray[np.floating]) -> Stack:
    """Wrap phase into [-pi, pi]."""
    wrapped: Stack = (phase - TURN * np.round(phase / TURN)).astype(np.float32)
    return wrapped


def find_background(wrapped: Stack) -> Background:
    """Find the empty field of every frame, and its level.

    Parameters
    ----------
    wrapped : ndarray of shape (time, angle, y, x)
        Wrapped phase in radians.
    """
    noise = noise_of(wrapped)
    width = SMOOTHING[int(noise >= QUIET)]
    smooth = smoothed(wrapped, width)
    left = noise / (2 * np.sqrt(np.pi) * width)  # noise that smoothing leaves
    shortest = np.exp(-(noise**2) / 2) - 2 * left  # length of the field where it is flat
    length, phase = np.abs(smooth), np.angle(smooth)
    level, has_background = levels(phase, length, shortest - SHORTER, FLAT + 0.3 + 2 * left)
    if has_background.mean() >= FRAME_SHARE:
        level = filled(level, has_background)
        phase = turned(phase - level[..., None, None].astype(np.float32))
    else:
        # Too few frames show one: what looks like it in some may lie inside the object.
        has_background[:] = False
        level[:] = 0
    if noise >= QUIET:
        length, phase, left = averaged(length, phase, left)
        shortest = np.exp(-(noise**2) / 2) - 2 * left
    enough = shortest - (SHORTER if noise < QUIET else 0)
    flat = (np.abs(phase) < FLAT + 2 * left) & (length > enough)
    mask = np.zeros(wrapped.shape, dtype=bool)
    for frame in zip(*np.nonzero(has_background), strict=True):
        mask[frame] = joined_to_border(flat[frame], quiet=noise < QUIET)
    return Background(mask, level, noise)


def filled(level: NDArray[np.float64], known: Mask) -> NDArray[np.float64]:
    """Take unknown levels from the nearest known frame."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    found: NDArray[np.float64] = level[tuple(nearest)]
    return found


def smoothed(wrapped: Stack, width: float) -> NDArray[np.complex64]:
    """Return the field exp(i phase), smoothed over y and x."""
    widths = (0.0, 0.0, width, width)
    parts = [
        ndimage.gaussian_filter(part, widths, mode="nearest", truncate=2.5)
        for part in (np.cos(wrapped), np.sin(wrapped))
    ]
    field: NDArray[np.complex64] = parts[0] + np.complex64(1j) * parts[1]
    return field


def averaged(length: Stack, phase: Stack, left: float) -> tuple[Stack, Stack, float]:
    """Average the smoothed field over neighbouring times and angles.

    The empty field is the same there, a cell that moves or turns is not; what noise is left
    becomes smaller, so that a plateau inside the cell is less often taken for empty.

    Returns
    -------
    length, phase : ndarray
        Of the averaged field.
    left : float
        Noise that is left, in radians.
    """
    sizes = [BOX if n >= BOX else 1 for n in phase.shape[:2]] + [1, 1]
    real, imaginary = (
        ndimage.uniform_filter(length * part(phase), sizes, mode="nearest")
        for part in (np.cos, np.sin)
    )
    left /= float(np.sqrt(np.prod(sizes)))
    return np.hypot(real, imaginary), np.arctan2(imaginary, real), left


def levels(
    phase: Stack, length: Stack, shortest: float, within: float
) -> tuple[NDArray[np.float64], Mask]:
    """Return the phase that most of each frame's border has, and whether that is enough of it."""
    edge = border_of(phase.shape[2:])
    on_border, usable = phase[..., edge], length[..., edge] > shortest
    grid = np.linspace(-np.pi, np.pi, BINS, endpoint=False)
    level = np.zeros(phase.shape[:2])
    share = np.zeros(phase.shape[:2])
    for frame in np.ndindex(*level.shape):
        values = on_border[frame][usable[frame]].astype(np.float64)
        if len(values) == 0:
            continue
        likeness = np.exp(SHARPNESS * (np.cos(grid[:, None] - values) - 1)).sum(axis=1)
        mode = grid[np.argmax(likeness)]
        off = turned(values - mode)
        near = np.abs(off) < within
        if near.any():
            level[frame] = mode + float(np.median(off[near]))
            share[frame] = near.sum() / edge.sum()
    return level, share > BORDER_SHARE


def joined_to_border(flat: Mask, *, quiet: bool) -> Mask:
    """Return what of the flat pixels of a frame is joined to its border by more than a thread."""
    structure = CROSS if quiet else SQUARE
    padded = np.pad(flat, 2, mode="edge")
    opened = ndimage.binary_opening(padded, structure)[2:-2, 2:-2]
    labels, count = ndimage.label(opened)
    if count == 0:
        return np.zeros_like(flat)
    touching = np.zeros(count + 1, dtype=bool)
    for side in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        touching[side] = True
    touching &= np.bincount(labels.ravel(), minlength=count + 1) >= SMALLEST
    touching[0] = False
    found: Mask = touching[labels]
    return found if quiet else ndimage.binary_erosion(found, CROSS, border_value=1)
