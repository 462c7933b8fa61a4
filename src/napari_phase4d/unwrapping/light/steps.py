"""Steps from pixel to pixel, as all wavelengths see them together, and what is joined along them.

**Settling.** A coarse phase says of every pixel by itself how many turns a finer one has, with
noise that may well be a turn. The steps from pixel to pixel say with hardly any noise by how many
turns neighbours differ, but nothing of the level, and wrong at a sheer wall. So pixels are joined
along their smoothest steps first, as in reliability sorting (Herraez et al. 2002), and what the
coarse phase says is averaged over each region that has come about; where two regions meet whose
averages contradict the step between them, beyond what noise explains, they are left apart: there
is a wall.

**Where it is smooth.** Where optics blur a sheer wall, the phase in it means nothing, and a way
through it may lead anywhere. So the pixels all of whose steps the wavelengths agree on are
unwrapped among themselves; what is cut off from the field round it has no way at all that could
be relied on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.unwrapping.frames import border_of, unwrap_frame
from napari_phase4d.unwrapping.growing import grow_list
from napari_phase4d.unwrapping.neighbours import ends_along

__all__ = [
    "SHARED",
    "STAYS",
    "led_to_edges",
    "settled_turns",
    "steps_between",
    "unwrapped_where_smooth",
    "wrapped_to_turn",
]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

TURN = np.float32(2 * np.pi)
#: A step may be a turn more or less, at the shortest wavelength, than the least that is possible,
#: if that makes it so much likelier, as a logarithm of the odds.
LIKELIER = 5.0
#: What a step of half a turn costs, beside what noise would have to do, as such a logarithm.
STEEP = 1.0


@dataclass(frozen=True)
class AlongAxis:
    """The steps of a frame along one axis.

    Parameters
    ----------
    asked : ndarray
        Of the turns, or of 2 pi times the path in micrometres, that the second end has more.
    cost : ndarray of float, same shape
        How little they are to be trusted.
    off : ndarray of float, same shape
        How far wavelengths disagree on them, as a logarithm of the odds of noise.
    """

    asked: NDArray[np.number]
    cost: Image
    off: Image


@dataclass(frozen=True)
class Steps:
    """The steps of a frame down and to the right, as 2 pi times the path in micrometres.

    Parameters
    ----------
    down, right : AlongAxis
        Of shape (y - 1, x) and (y, x - 1).
    """

    down: AlongAxis
    right: AlongAxis

    def of(self, wrapped: Image, wavelength_um: float) -> tuple[AlongAxis, AlongAxis]:
        """Return the whole turns that the steps ask for in the phase of some wavelength."""
        found = []
        for axis, steps in enumerate((self.down, self.right)):
            phase = steps.asked / np.float32(wavelength_um)
            asked = np.rint((phase - np.diff(wrapped, axis=axis)) / TURN).astype(np.int32)
            found.append(AlongAxis(asked, steps.cost, steps.off))
        return found[0], found[1]


def steps_between(phases: Image, light: Sequence[float], noise: float) -> Steps:
    """Return the steps from pixel to pixel that make the wavelengths agree best.

    A step of the path is the same at every wavelength, so that each tells of it by so many turns
    more or less. Of the least steps at the shortest wavelength, and those by a turn more or less,
    the likeliest is taken: that on which the others agree best, at the noise there is.

    Parameters
    ----------
    phases : ndarray of shape (view, y, x)
        Wrapped phase of the views of an angle, radians.
    light : sequence of float
        Their wavelengths in micrometres.
    noise : float
        Standard deviation of the noise of a view, radians.
    """
    order = np.argsort(light)
    lengths = np.asarray(light, dtype=np.float32)[order]
    down, right = (along(phases[order], axis, lengths, noise) for axis in (1, 2))
    return Steps(down, right)


def along(phases: Image, axis: int, lengths: Image, noise: float) -> AlongAxis:
    """Return the steps along an axis; the first wavelength is the shortest."""
    least = wrapped_to_turn(np.diff(phases, axis=axis))
    path = cost = np.empty(0, dtype=np.float32)
    for turns in (0, 1, -1):
        found, off = agreed(least, np.float32(turns), lengths)
        price = off / np.float32(4 * noise**2) + np.float32(LIKELIER * abs(turns))
        if not turns:
            path, cost = found, price
            continue
        better = price < cost
        path, cost = np.where(better, found, path), np.where(better, price, cost)
    half = np.float32(np.pi) * lengths[0]
    return AlongAxis(path, cost + np.float32(STEEP) * (path / half) ** 2, cost)


def agreed(least: Image, turns: np.float32, lengths: Image) -> tuple[Image, Image]:
    """Return the path of steps of some turns more, and how far wavelengths disagree on it.

    The first is the mean of what the wavelengths say, each weighted by how little noise its path
    has; the other the sum of the squares, in radians, by which they are off that.
    """
    first = lengths[0] * (least[0] + TURN * turns)
    weights = lengths**-2 / np.sum(lengths**-2)
    paths = [
        length * (step + TURN * np.rint((first / length - step) / TURN))
        for length, step in zip(lengths, least, strict=True)
    ]
    mean = sum(weight * path for weight, path in zip(weights, paths, strict=True))
    off = sum(((path - mean) / length) ** 2 for length, path in zip(lengths, paths, strict=True))
    return np.asarray(mean, dtype=np.float32), np.asarray(off, dtype=np.float32)


def led_to_edges(path: Image, known: Mask) -> Image:
    """Return paths of which the outermost pixels are those of the pixels beside them.

    A transform mixes the outermost rows and columns of a view with those of the opposite edge, so
    that the wavelengths disagree there by more than noise, all along the edge: as at a wall. To
    choose whole turns by, the path next to it is near enough.

    Parameters
    ----------
    path : ndarray of shape (y, x)
        2 pi times the path in micrometres.
    known : ndarray of bool, shape (y, x)
        Pixels that count; others stay as they are, and lead nowhere.
    """
    found = path.copy()
    for axis in (0, 1):
        # Views, so that what is written to them is written to the paths.
        lines, seen = (np.moveaxis(of_all, axis, 0) for of_all in (found, known))
        for edge, beside in ((0, 1), (-1, -2)) if len(lines) > 1 else ():
            led = seen[edge] & seen[beside]
            lines[edge][led] = lines[beside][led]
    return found


def wrapped_to_turn(phase: NDArray[np.floating]) -> Image:
    """Return phase within half a turn of zero."""
    found: Image = (phase - TURN * np.rint(phase / TURN)).astype(np.float32)
    return found


# ---- whole turns settled together -----------------------------------------------------------


Whole = NDArray[np.int32]

#: Pixels that share their noise, since the pupil cuts the spectrum off.
SHARED = 2.0
#: Errors in turns that an average does not make smaller: of the levels, of dispersion.
STAYS = 0.08
#: A wall is believed in if it is so much likelier than noise, as a logarithm of the odds.
LIKELIER_WALL = 5.0


def settled_turns(
    estimate: Image, steps: tuple[AlongAxis, AlongAxis], noise: float, mask: Mask
) -> Whole:
    """Return the whole turns of every pixel of a frame; 0 outside the mask.

    Parameters
    ----------
    estimate : ndarray of shape (y, x)
        Turns by the coarser phase, not rounded.
    steps : two AlongAxis
        Turns that the steps down and to the right ask for in the finer phase.
    noise : float
        Standard deviation of the estimate in turns.
    mask : ndarray of bool, shape (y, x)
        Pixels to settle.
    """
    first, second, asked, order = edges_of(steps, mask)
    turns = np.zeros(mask.size, dtype=np.int32)
    join(
        first[order],
        second[order],
        asked[order],
        estimate.ravel().astype(np.float64),
        (SHARED * noise**2, STAYS**2, LIKELIER_WALL),
        turns,
    )
    return np.where(mask, turns.reshape(mask.shape), np.int32(0))


def edges_of(
    steps: tuple[AlongAxis, AlongAxis], mask: Mask
) -> tuple[NDArray[np.int32], NDArray[np.int32], Whole, NDArray[np.intp]]:
    """Return both ends of the steps inside a mask, the turns they ask for, and their order."""
    number = np.arange(mask.size, dtype=np.int32).reshape(mask.shape)
    parts = []
    for axis, along in enumerate(steps):
        head, tail = ends_along(axis, 2)
        inside = mask[head] & mask[tail]
        ends = number[head][inside], number[tail][inside]
        parts.append((*ends, along.asked[inside], along.cost[inside]))
    first, second, asked, cost = (np.concatenate(column) for column in zip(*parts, strict=True))
    return first, second, asked.astype(np.int32), np.argsort(cost, kind="stable")


@compiled
def join(
    first: NDArray[np.int32],
    second: NDArray[np.int32],
    asked: Whole,
    estimate: NDArray[np.float64],
    odds: tuple[float, float, float],
    turns: Whole,
) -> None:
    """Join pixels step by step, and write the turns of each; see `settled_turns`.

    Parameters
    ----------
    first, second : ndarray of int
        Ends of the steps, in the order in which they are gone along.
    asked : ndarray of int
        Turns that the second end has more than the first.
    estimate : ndarray of float
        Turns of each pixel by the coarser phase.
    odds : tuple of float
        Variance of the estimate in a pixel, and what averaging leaves of it, in turns squared; and
        how much likelier a wall must be.
    turns : ndarray of int
        Written: whole turns of each pixel.
    """
    n = len(estimate)
    parent = np.arange(n)
    # Turns of each pixel against its parent; of a root, the sum and number over its region.
    relative = np.zeros(n, dtype=np.int64)
    total = estimate.copy()
    count = np.ones(n)
    for step in range(len(first)):
        a, up_a = first[step], 0
        while parent[a] != a:
            up_a += relative[a]
            a = parent[a]
        b, up_b = second[step], 0
        while parent[b] != b:
            up_b += relative[b]
            b = parent[b]
        if a == b:
            continue
        # Turns of root b against root a, if this step is to be believed.
        apart = up_a + asked[step] - up_b
        off = total[b] / count[b] - total[a] / count[a] - apart
        whole = np.rint(off)
        if whole != 0:
            variance = odds[0] * (1 / count[a] + 1 / count[b]) + 2 * odds[1]
            if off**2 - (off - whole) ** 2 > 2 * variance * odds[2]:
                continue
        if count[a] < count[b]:
            a, b, apart = b, a, -apart
        parent[b] = a
        relative[b] = apart
        total[a] += total[b] - apart * count[b]
        count[a] += count[b]
    for pixel in range(n):
        root, up = pixel, 0
        while parent[root] != root:
            up += relative[root]
            root = parent[root]
        turns[pixel] = np.rint(total[root] / count[root]) + up


# ---- where it is smooth ---------------------------------------------------------------------


Parts = NDArray[np.int32]

#: A step is smooth if noise alone makes it as rough one time in three hundred, as a logarithm of
#: the odds.
SMOOTH = 4.5
#: A way from part to part goes along a row or a column, over so many pixels at most, and each of
#: its steps is less than this.
FAR, SMALL_STEP = 8, np.float32(np.pi / 2)
#: So many ways must lead from one part to the other, and this share of them agree.
WAYS, AGREE = 3, 0.8


def unwrapped_where_smooth(wrapped: Image, steps: Steps, known: Mask) -> Image:
    """Return phase of a frame, unwrapped inside each smooth part.

    Parts that enough small steps lead to lie where these say. The middle of others is taken to be
    within half a turn of zero.

    Parameters
    ----------
    wrapped : ndarray of shape (y, x)
        Wrapped phase in radians, about 0 in the empty field.
    steps : Steps
        From pixel to pixel.
    known : ndarray of bool, shape (y, x)
        Pixels that count.
    """
    smooth = smooth_pixels(steps, known)
    if not smooth.any():
        return wrapped
    labels, count = scipy.ndimage.label(smooth)
    labels = labels.astype(np.int32)
    unwrapped = unwrap_frame(wrapped, smooth)
    every = np.arange(1, count + 1)
    at_border = np.bincount(labels[border_of(labels.shape) & smooth], minlength=count + 1)[1:]
    size = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    ground = int(np.argmax(at_border if at_border.any() else size))
    edge = labels == ground + 1
    edge &= border_of(labels.shape) if at_border.any() else smooth
    level = np.rint(np.median(unwrapped[edge]) / TURN)
    lift = -np.rint(np.asarray(scipy.ndimage.median(unwrapped, labels, every)) / TURN)
    joined, turns = joined_parts(wrapped, unwrapped, labels, count)
    led_to = joined == joined[ground]
    lift[led_to] = (turns - turns[ground])[led_to] - level
    whole = np.concatenate([[0.0], lift]).astype(np.float32)[labels]
    found = unwrapped + TURN * whole
    # What is not smooth lies nearest to the smooth pixel next to it.
    rows, columns = scipy.ndimage.distance_transform_edt(
        ~smooth, return_distances=False, return_indices=True
    )
    beside = wrapped + TURN * np.rint((found[rows, columns] - wrapped) / TURN)
    result: Image = np.where(smooth, found, beside).astype(np.float32)
    return result


def smooth_pixels(steps: Steps, known: Mask) -> Mask:
    """Mark the pixels all of whose steps are smooth, in squares of four at least."""
    smooth = known.copy()
    for axis, along in enumerate((steps.down, steps.right)):
        rough = along.off > SMOOTH
        before, after = ([(0, 0), (0, 0)] for _ in range(2))
        before[axis], after[axis] = (1, 0), (0, 1)
        smooth &= ~np.pad(rough, before) & ~np.pad(rough, after)
    # Now and then noise makes a step over a wall look smooth: a single one is not to join what
    # lies on either side.
    square = np.ones([min(2, n) for n in smooth.shape])
    found: Mask = scipy.ndimage.binary_opening(smooth, square)
    return found


def joined_parts(
    wrapped: Image, unwrapped: Image, labels: Parts, count: int
) -> tuple[Parts, Parts]:
    """Join parts that small steps lead between; return where each belongs, and its turns.

    Parameters
    ----------
    wrapped, unwrapped : ndarray of shape (y, x)
        Phase in radians; the latter inside the parts.
    labels : ndarray of int, shape (y, x)
        Number of the part that each pixel lies in, from 1.
    count : int
        How many there are.
    """
    along = ways(wrapped, unwrapped, labels)
    across = ways(wrapped.T, unwrapped.T, labels.T)
    every = np.concatenate([along, across], axis=1)
    # The same way, seen from the part of the lower number.
    back = every[0] > every[1]
    every[:, back] = np.stack([every[1], every[0], -every[2]])[:, back]
    votes, number = np.unique(every, axis=1, return_counts=True)
    pairs, place = np.unique(votes[:2], axis=1, return_inverse=True)
    place = place.ravel()
    total = np.bincount(place, number, pairs.shape[1])[place]
    firm = (number >= WAYS) & (number >= AGREE * total)
    first, second, asked = votes[:, firm]
    cost = -number[firm].astype(np.float64)
    parts, turns, _ = grow_list(first, second, asked, cost, count, overwrite=True)
    return parts, turns


def ways(wrapped: Image, unwrapped: Image, labels: Parts) -> Parts:
    """Return the ways from part to part along rows: both parts, from 0, and the turns between."""
    step = wrapped_to_turn(np.diff(wrapped, axis=1))
    gone = np.pad(np.cumsum(step, axis=1, dtype=np.float64), [(0, 0), (1, 0)]).ravel()
    large = np.pad(np.cumsum(np.abs(step) > SMALL_STEP, axis=1), [(0, 0), (1, 0)]).ravel()
    label, phase = labels.ravel(), unwrapped.ravel()
    inside = np.flatnonzero(label)
    a, b = inside[:-1], inside[1:]
    width = wrapped.shape[1]
    leads = (label[a] != label[b]) & (b - a <= FAR) & (a // width == b // width)
    leads &= large[a] == large[b]
    a, b = a[leads], b[leads]
    turns = np.rint((gone[b] - gone[a] - (phase[b] - phase[a])) / TURN)
    return np.stack([label[a] - 1, label[b] - 1, turns]).astype(np.int32)
