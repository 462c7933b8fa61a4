"""Frames that the camera lost: blank, saturated, without fringes, damaged.

Frames are held against each other in tiles: by the contrast of their fringes, their strength
next to the light that there is, and by what tells fringes from noise. Before the lobes are known
that is how alike neighbouring pixels are, afterwards how alike a field is to itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import vectorized
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.recording import BrokenFrameError, Recording
from napari_phase4d.task import UNWATCHED, CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.words import counted

__all__ = [
    "STATIC_FRAMES",
    "FrameLook",
    "LostFrames",
    "all_lost",
    "first_seen",
    "look_at",
    "lost_among",
    "lost_frames",
    "lost_sentence",
    "safe_look",
    "usual_fringes",
]

#: Tiles across a frame, along y and along x.
TILES = 8
#: Fringes are looked at on about so many rows and columns.
ROWS = 128
#: A frame is saturated if so large a share of its pixels has the largest value there is.
SATURATED = 0.75
#: A tile is bad if the squared contrast of its fringes is this small, or this large, next to the
#: usual one; a frame is lost if this share of its tiles is bad, or if its contrast is a quarter of
#: what is usual (a sixteenth squared).
WEAK, STRONG, BAD_TILES, COLLAPSED = 0.04, 10.0, 0.15, 0.06
#: A field is compared with itself so many pixels on, on about so many rows or columns ...
APART, LINES = 3, 64
#: ... and a tile is noise if it is so much less alike than usual; so is the frame, if most are.
INCOHERENT, NOISE = 0.3, 0.4
#: Noise is less alike to itself than this whatever others show (it measures 0.3 in small fields,
#: 0.05 in large ones; weak fringes in noise 0.5 and more).
ALIKE = 0.35
#: Groups of neighbouring rows that tell noise from fringes, and the side of a tile in them.
GROUPS, GROUP_TILE = 32, 32
#: How alike the differences of neighbouring pixels are to the next ones and those after them, in
#: noise of which each pixel is by itself; and to this much.
WHITE_NOISE, WHITE = np.array([-0.5, 0.0]), 0.06
#: A tile whose fringes usually differ so much from that noise is damaged if it came this far on
#: the way to it: lobes are narrow, and hold fringes that are a tenth of what a pixel shows.
UNLIKE_NOISE, TO_NOISE = 0.3, 0.85
#: The mean grey value of fringes is no less than their amplitude; where it is less than this share
#: of their strength, it has been taken off.
LIT = 0.25
TINY = float(np.finfo(np.float64).tiny)
#: Frames from which what all have in common is measured, and some of them that tell what is usual.
STATIC_FRAMES, SAMPLE = 32, 9

Tiles = NDArray[np.float64]


@dataclass(frozen=True)
class FrameLook:
    """What one look at a camera frame tells.

    Parameters
    ----------
    strength : ndarray of shape (tile, tile)
        Mean squared difference of neighbouring pixels in each tile.
    alike : ndarray of shape (2, 2, tile, tile)
        How alike differences along y and x are to the next one and the one after it, from -1 to 1.
    light : float
        Mean grey value.
    reason : str
        Why it is lost whatever other frames show; empty if it is not.
    """

    strength: Tiles
    alike: Tiles
    light: float
    reason: str = ""

    @property
    def is_white(self) -> bool:
        """Whether it looks like noise of which each pixel is by itself.

        Fringes of a third of a cycle a pixel do too, to the next pixel.
        """
        return bool(abs(self.alike[:, 0].mean() - WHITE_NOISE[0]) < WHITE)


def nothing_in(reason: str) -> FrameLook:
    """Return what is seen in a frame that says nothing."""
    return FrameLook(np.zeros((1, 1)), np.zeros((2, 2, 1, 1)), 0.0, reason)


def plain_reason(frame: NDArray[np.generic]) -> str:
    """Say whether a frame is blank or saturated, by some of its pixels; "" if neither."""
    step = max(1, min(frame.shape) // ROWS)
    # Neighbours among them, so that fringes of any period are seen.
    some = np.asarray(frame[::step])
    low, high = some.min(), some.max()
    if low == high:
        return "saturated" if is_full(high) else "blank"
    return "saturated" if np.count_nonzero(some == high) > SATURATED * some.size else ""


def light_of(frame: NDArray[np.generic]) -> float:
    """Return the mean grey value of a frame, by some of its rows."""
    return float(frame[:: max(1, min(frame.shape) // ROWS)].mean(dtype=np.float64))


def is_full(value: np.generic) -> bool:
    """Say whether a grey value is the largest of a camera of 8 bits or more."""
    number = int(value) if float(value).is_integer() else 0
    return number >= 255 and number & (number + 1) == 0


def look_at(frame: NDArray[np.generic]) -> FrameLook:
    """Look at a camera frame (y, x) of any real type."""
    if reason := plain_reason(frame):
        return nothing_in(reason)
    step = max(1, len(frame) // ROWS)
    # Neighbouring rows, so that fringes along either axis are seen.
    below = frame[1::step].astype(np.float32)
    rows = frame[::step][: len(below)].astype(np.float32)
    across, down = np.diff(rows, axis=1), below[:, 1:] - rows[:, 1:]
    strength = tiled(np.square(across, out=across)) + tiled(np.square(down, out=down))
    return FrameLook(strength, alike_next(frame), light_of(frame))


def alike_next(frame: NDArray[np.generic]) -> Tiles:
    """Return how alike differences of neighbouring pixels are to the next ones, by some rows.

    In white noise the correlation with the next difference, which shares a pixel, is -1/2, and
    with the one after it 0; in fringes of k cycles per pixel they are cos 2 pi k and cos 4 pi k.

    Returns
    -------
    ndarray of shape (2, 2, tile, tile)
        Along y and x; the next, and the one after it. Tiles are larger in small frames.
    """
    step = max(1, (len(frame) - 3) // GROUPS)
    starts = np.arange(0, max(1, len(frame) - 3), step)
    last = len(frame) - 1
    rows = np.stack([frame[np.minimum(starts + i, last)].astype(np.float32) for i in range(4)])
    rows /= max(float(np.abs(rows).max()), float(np.finfo(np.float32).tiny))
    tiles = max(1, min(TILES, min(frame.shape) // GROUP_TILE))
    down, across = np.diff(rows, axis=0), np.diff(rows[0], axis=1)
    pairs = [(down[0], down[n]) for n in (1, 2)]
    pairs += [(across[:, :-n], across[:, n:]) for n in (1, 2)]
    found = [
        tiled(one * other, tiles) / np.maximum(tiled(one**2 + other**2, tiles) / 2, TINY)
        for one, other in pairs
    ]
    return np.stack(found).reshape(2, 2, tiles, tiles)


def tiled(values: NDArray[np.floating], tiles: int = TILES) -> Tiles:
    """Return the means over tiles of an image."""
    edges = [np.linspace(0, n, min(tiles, n) + 1).astype(int)[:-1] for n in values.shape]
    down = np.add.reduceat(values, edges[0], axis=0, dtype=np.float64)
    sums = np.add.reduceat(down, edges[1], axis=1)
    heights, widths = (np.diff([*edge, n]) for edge, n in zip(edges, values.shape, strict=True))
    means: Tiles = sums / np.outer(heights, widths)
    return means


def lost_among(looks: Mapping[int, FrameLook]) -> dict[int, str]:
    """Return which of some frames are lost, and why.

    Parameters
    ----------
    looks : mapping of int to FrameLook
        What each frame shows, by its number.
    """
    lost = {index: look.reason for index, look in looks.items() if look.reason}
    kept = {index: look for index, look in looks.items() if not look.reason}
    if kept:
        # Where most frames are dark, noise is all that they show, and not what is usual.
        every = list(kept.values())
        some = [look for look in every if not look.is_white]
        usual = usual_look(some if 0 < len(some) <= len(every) / 2 else every)
        for index, look in kept.items():
            if reason := noise_in(look, usual) or contrast_lost(look, usual):
                lost[index] = reason
    return dict(sorted(lost.items()))


def usual_look(looks: Sequence[FrameLook]) -> FrameLook:
    """Return what frames usually show."""
    strength = np.median([look.strength for look in looks], axis=0)
    alike = np.median([look.alike for look in looks], axis=0)
    return FrameLook(strength, alike, float(np.median([look.light for look in looks])))


def contrast_lost(look: FrameLook, usual: FrameLook) -> str:
    """Say how the contrast of a frame differs from what is usual; "" if it does not."""
    strongest = float(np.sqrt(np.median(usual.strength)))
    return difference(look.strength, usual.strength, dimmed(look.light, usual.light, strongest))


def noise_in(look: FrameLook, usual: FrameLook) -> str:
    """Say whether noise stands where others show fringes, along y or x; "" if it does not."""
    noise = WHITE_NOISE[:, None, None]
    way = noise - usual.alike  # (axis, pixels on, tile, tile)
    far = np.maximum((way**2).sum(axis=1), TINY)
    come = ((look.alike - usual.alike) * way).sum(axis=1) / far
    bad = ((come > TO_NOISE) & (far > UNLIKE_NOISE**2)).mean(axis=(1, 2)).max()
    if bad > 0.5:
        return "without fringes"
    return "damaged" if bad > BAD_TILES else ""


def dimmed(light: float, usual: float, strongest: float) -> float:
    """Return by how much the squares of grey values are less than usual, as there is less light.

    It is 1 where the mean grey value says nothing of the light, next to the fringes' strength.
    """
    if usual <= LIT * strongest:
        return 1.0
    return (max(light, 0.0) / usual) ** 2


def difference(power: Tiles, usual: Tiles, light: float = 1.0) -> str:
    """Say how the power of a frame's fringes differs from what is usual; "" if it does not.

    The light is that of the frame over what is usual, squared.
    """
    relative = power / np.maximum(usual * light, np.finfo(float).tiny)
    if relative.min() < COLLAPSED and float(np.median(relative)) < COLLAPSED:
        return "without fringes"
    bad = (relative < WEAK) | (relative > STRONG)
    return "damaged" if float(bad.mean()) > BAD_TILES else ""


def lost_frames(
    rec: Recording,
    at_most: int | None = None,
    *,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> dict[int, str]:
    """Return which frames the camera lost, and why.

    Parameters
    ----------
    rec : Recording
        The hologram video.
    at_most : int, optional
        Look at so many frames at most, evenly over the recording. Default: all.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Returns
    -------
    dict of int to str
        Frame number: "blank", "saturated", "without fringes", "damaged" or "NaN".

    See Also
    --------
    lost_sentence : Says it in words.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena((64, 64), 4, pixel_um=0.7)
    >>> frames = p4d.simulation.multiplexed_video(exact["phase"]).holograms.values.copy()
    >>> frames[2] = 0
    >>> lost_frames(p4d.open_recording(frames))
    {2: 'blank'}
    """
    task = Task(progress, cancelled)
    indices = rec.sample_indices(at_most or rec.n_frames)
    watch = Watch(len(indices), "looking for lost frames", task)
    looks = in_threads(lambda index: safe_look(rec, index), indices, watch)
    return lost_among(dict(zip(indices, looks, strict=True)))


def first_seen(rec: Recording) -> NDArray[np.generic]:
    """Return the first frame that is not lost by itself; the first of all if none is.

    Parameters
    ----------
    rec : Recording
        The hologram video; some of its frames are looked at.

    Returns
    -------
    ndarray of shape (y, x)
        Its numbers as they are.

    Raises
    ------
    ValueError
        If no frame looked at shows anything, and the first holds NaN.

    Examples
    --------
    >>> import numpy as np
    >>> frames = np.random.default_rng(0).integers(0, 255, (3, 16, 16))
    >>> frames[0] = 0
    >>> bool((first_seen(Recording.from_frames(frames)) == frames[1]).all())
    True
    """
    for index in rec.sample_indices(SAMPLE):
        if not safe_look(rec, index).reason:
            return rec.raw_frame(index)
    return rec.raw_frame(0)


def safe_look(rec: Recording, index: int) -> FrameLook:
    """Look at a frame that may hold NaN."""
    try:
        return look_at(rec.raw_frame(index))
    except BrokenFrameError:
        return nothing_in("NaN")


def lost_sentence(lost: Mapping[int, str], looked_at: int) -> str:
    """Say which frames are lost; "" if none is.

    Parameters
    ----------
    lost : mapping of int to str
        What `lost_frames` gave.
    looked_at : int
        How many frames were looked at.

    Examples
    --------
    >>> lost_sentence({2: "blank"}, 4)
    '1 frame of 4 is lost and left out: 2 (blank).'
    """
    if not lost:
        return ""
    named = [f"{index} ({reason})" for index, reason in list(lost.items())[:5]]
    more = f" and {len(lost) - 5} more" if len(lost) > 5 else ""
    number = counted(len(lost), "frame")
    verb = "is" if len(lost) == 1 else "are"
    return f"{number} of {looked_at} {verb} lost and left out: {', '.join(named)}{more}."


@dataclass(frozen=True)
class Fringes:
    """What the fields of a frame show in each tile.

    Parameters
    ----------
    power : ndarray of shape (view, tile, tile)
        Squared mean amplitude.
    coherence : ndarray of shape (view, tile, tile)
        How alike the field is to itself some pixels on, from 0 for noise to 1.
    light : float
        Mean grey value.
    """

    power: Tiles
    coherence: Tiles
    light: float

    @property
    def are_seen(self) -> bool:
        """Whether every view shows more than noise."""
        return bool((np.median(self.coherence, axis=(1, 2)) > ALIKE).all())

    def reason(self, usual: Fringes) -> str:
        """Say why a frame is lost where others are as usual; "" if it is not."""
        alike = self.coherence / np.maximum(usual.coherence, np.finfo(float).tiny)
        # Where the least is not below a limit, no median is; and a median takes longest of all.
        if alike.min() < NOISE and (np.median(alike, axis=(1, 2)) < NOISE).any():
            return "without fringes"
        if ((alike < INCOHERENT).mean(axis=(1, 2)) > BAD_TILES).any():
            return "damaged"
        light = dimmed(self.light, usual.light, float(np.sqrt(np.median(usual.power))))
        pairs = zip(self.power, usual.power, strict=True)
        return next((said for pair in pairs if (said := difference(*pair, light))), "")


def fringes_of(frame: NDArray[np.generic], fields: NDArray[np.complex64]) -> Fringes:
    """Return what the fields (view, y, x) of a frame show; some of their pixels are looked at."""
    views, height, width = fields.shape
    step = max(1, min(height, width) // LINES)
    apart = APART if min(height, width) > APART + 4 * APART * step else 0
    tiles = min(TILES, height, width)
    power = np.empty((views, tiles, tiles))
    coherence = np.ones_like(power)
    for view, field in enumerate(fields):
        tile_sums(field, step, apart, power[view], coherence[view])
    return Fringes(power, coherence, light_of(frame))


@vectorized
def tile_sums(
    field: NDArray[np.complex64], step: int, apart: int, power: Tiles, coherence: Tiles
) -> None:
    """Write the squared mean amplitude of tiles, and how alike the field is to itself there.

    Alike means: some pixels on, along y or x, whichever is less, next to the mean squared
    amplitude, which hardly changes within some pixels.
    """
    tiles = len(power)
    rows, columns = (field.shape[0] - apart) // tiles, (field.shape[1] - apart) // tiles
    for v in range(tiles):
        for u in range(tiles):
            count = size = square = 0.0
            down = across = 0j
            for y in range(v * rows, (v + 1) * rows, step):
                for x in range(u * columns, (u + 1) * columns, step):
                    here = field[y, x]
                    squared = here.real**2 + here.imag**2
                    count += 1
                    size += np.sqrt(squared)
                    square += squared
                    down += here.conjugate() * field[y + apart, x]
                    across += here.conjugate() * field[y, x + apart]
            power[v, u] = (size / count) ** 2
            if apart:
                least = min(abs(down), abs(across))
                coherence[v, u] = min(least / max(square, TINY), 1.0)


@dataclass(frozen=True)
class LostFrames:
    """Tells frames that the camera lost by their pixels and their fields.

    Parameters
    ----------
    usual : Fringes
        What the fields of the recording usually show.
    """

    usual: Fringes

    def reason(self, frame: NDArray[np.generic], fields: NDArray[np.complex64]) -> str:
        """Say why a frame with some fields (view, y, x) is lost; "" if it is not."""
        return plain_reason(frame) or fringes_of(frame, fields).reason(self.usual)


def usual_fringes(
    rec: Recording, demodulate: Demodulator, task: Task = UNWATCHED
) -> tuple[LostFrames, dict[int, NDArray[np.complex64]]]:
    """Return what tells lost frames, and the fields of those looked at that are not lost.

    Raises
    ------
    ValueError
        If every frame that was looked at is lost.
    """
    among = rec.sample_indices(STATIC_FRAMES)
    indices = among[:: max(1, len(among) // SAMPLE)]
    watch = Watch(2 * len(indices), "looking for lost frames", task.quiet)

    def look(index: int) -> tuple[NDArray[np.complex64], Fringes] | str:
        try:
            frame = rec.raw_frame(index)
        except BrokenFrameError:
            return "NaN"
        if reason := plain_reason(frame):
            return reason
        fields = demodulate(frame)
        return fields, fringes_of(frame, fields)

    def look_at_all(indices: Sequence[int]) -> None:
        for index, found in zip(indices, in_threads(look, indices, watch), strict=True):
            if isinstance(found, str):
                unseen[index] = found
            else:
                known[index], fringes[index] = found

    unseen: dict[int, str] = {}
    known: dict[int, NDArray[np.complex64]] = {}
    fringes: dict[int, Fringes] = {}
    look_at_all(indices)
    if sum(each.are_seen for each in fringes.values()) <= len(indices) // 2:
        # Light that is on in every second frame is in none or all of frames evenly apart.
        looked_at = unseen.keys() | known.keys()
        look_at_all([i + 1 for i in indices if i + 1 < rec.n_frames and i + 1 not in looked_at])
    if not known:
        raise ValueError(all_lost(rec.name, unseen))
    # Where most frames are dark, they are not what is usual.
    good = [each for each in fringes.values() if each.are_seen] or list(fringes.values())
    usual = Fringes(
        np.median([each.power for each in good], axis=0),
        np.median([each.coherence for each in good], axis=0),
        float(np.median([each.light for each in good])),
    )
    kept = {i: known[i] for i in sorted(known) if not fringes[i].reason(usual)}
    if not kept:
        reasons = {i: each.reason(usual) for i, each in fringes.items()}
        raise ValueError(all_lost(rec.name, reasons))
    return LostFrames(usual), kept


def all_lost(name: str, lost: Mapping[int, str]) -> str:
    """Say that nothing is left to work on."""
    index, reason = next(iter(lost.items()))
    return f"no frame of {name} shows fringes: frame {index} is {reason}"
