"""Frames that the camera lost: blank, saturated, without fringes, damaged.

Their fields are held against each other in tiles: by how alike a field is to itself some pixels
on, which tells fringes from noise, and by how strong the fringes are, also next to the light that
there is. Before the lobes are known (`spectrum`), fields are those of the strongest peaks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled, unchecked, vectorized
from napari_phase4d.holography.demodulation import Demodulator
from napari_phase4d.recording import BrokenFrameError, Recording
from napari_phase4d.task import UNWATCHED, Task, Watch, in_threads
from napari_phase4d.words import counted

__all__ = [
    "STATIC_FRAMES",
    "Fringes",
    "LostFrames",
    "all_lost",
    "are_usual",
    "first_seen",
    "is_full",
    "lost_sentence",
    "reason_alone",
    "usual_fringes",
]

#: Tiles across a frame, along y and along x.
TILES = 8
#: Pixels are looked at on so many rows.
ROWS = 128
#: A frame is saturated if so large a share of its pixels has the largest value there is.
SATURATED = 0.75
#: A tile is bad if the power of its fringes is this small, or this large, next to what it usually
#: is; a frame is lost if this share of its tiles is bad, or if all of it is a quarter as strong as
#: usual (a sixteenth in power).
WEAK, STRONG, BAD_TILES, COLLAPSED = 0.04, 10.0, 0.15, 0.06
#: A field is compared with itself so many pixels on, on about so many rows or columns ...
APART, LINES = 3, 64
#: ... and a tile is noise if it is so much less alike than usual; so is the frame, if most are.
INCOHERENT, NOISE = 0.3, 0.4
#: ... but only if the amplitude of such tiles varies more than this, as noise's does (pi/4; that
#: of dense layers of steep cells is 0.87 and more), or has less than this share of its power.
EVEN, AS_STRONG = 0.85, 0.5
#: Noise is less alike to itself than this whatever others show (it measures 0.3 in small fields,
#: 0.05 in large ones; weak fringes in noise 0.5 and more).
ALIKE, NEARLY = 0.35, 0.7
#: A tile tells nothing if it is usually that dark, as a share of the brightest one's power.
DARK = 1e-3
TINY = float(np.finfo(np.float64).tiny)
#: What is said where no fringes are seen, as where a beam is blocked; other views may show theirs.
WITHOUT_FRINGES = "without fringes"
#: What is said of a frame of which that holds for some views only; the others are kept.
VIEWS_WITHOUT_FRINGES = "without fringes in some views"
NEVER_ALL = (
    "no frame of {} shows the fringes of all views at once; where beams are on in turn, save the "
    "frames of each beam as a recording of their own, and look for one view there"
)
#: Frames from which what all have in common is measured, and some of them that tell what is usual.
STATIC_FRAMES, SAMPLE = 32, 9

Tiles = NDArray[np.float64]


def plain_reason(frame: NDArray[np.generic]) -> str:
    """Say whether a frame is blank or saturated, by some of its pixels; "" if neither."""
    return reason_by(some_rows(frame))


def reason_by(some: NDArray[np.generic]) -> str:
    """Say whether a frame some of whose rows are given is blank or saturated."""
    low, high = some.min(), some.max()
    if low == high:
        return "saturated" if is_full(high) else "blank"
    return "saturated" if np.count_nonzero(some == high) > SATURATED * some.size else ""


def is_full(value: np.generic) -> bool:
    """Say whether a grey value is the largest of a camera of 8 bits or more."""
    number = int(value) if float(value).is_integer() else 0
    return number >= 255 and number & (number + 1) == 0


def some_rows(frame: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return some rows of a frame, drawn by chance once: no fringes are in step with them."""
    return frame[rows_among(len(frame))]


@lru_cache(maxsize=4)
def rows_among(height: int) -> NDArray[np.intp]:
    """Return which rows of so many are looked at, always the same."""
    drawn = np.random.default_rng(0).permutation(height)[:ROWS]
    return np.sort(drawn)


def reason_alone(rec: Recording, index: int) -> str:
    """Say why a frame is lost whatever others show; "" if it is not."""
    try:
        return plain_reason(rec.raw_frame(index))
    except BrokenFrameError:
        return "NaN"


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
    >>> from napari_phase4d import Recording
    >>> from napari_phase4d.holography import first_seen
    >>> import numpy as np
    >>> frames = np.random.default_rng(0).integers(0, 255, (3, 16, 16))
    >>> frames[0] = 0
    >>> bool((first_seen(Recording.from_frames(frames)) == frames[1]).all())
    True
    """
    for index in rec.sample_indices(SAMPLE):
        if not reason_alone(rec, index):
            return rec.raw_frame(index)
    return rec.raw_frame(0)


def lost_sentence(lost: Mapping[int, str], looked_at: int) -> str:
    """Say which frames are lost; "" if none is.

    Parameters
    ----------
    lost : mapping of int to str
        What `lost_frames` gave.
    looked_at : int
        How many frames were looked at.

    Returns
    -------
    str
        How many frames, their numbers, and why; frames without fringes in some views have a
        sentence of their own.

    Examples
    --------
    >>> from napari_phase4d.holography import lost_sentence
    >>> lost_sentence({2: "blank"}, 4)
    '1 frame of 4 is lost and left out: 2 (blank).'
    >>> lost_sentence({2: "without fringes in some views"}, 4)
    '1 frame of 4 shows no fringes in some views: 2.'
    """
    partly = [str(index) for index, why in lost.items() if why == VIEWS_WITHOUT_FRINGES]
    whole = [f"{index} ({why})" for index, why in lost.items() if why != VIEWS_WITHOUT_FRINGES]
    verbs = (
        (whole, "is lost and left out", "are lost and left out"),
        (partly, "shows no fringes in some views", "show no fringes in some views"),
    )
    return " ".join(
        f"{counted(len(frames), 'frame')} of {looked_at} {one if len(frames) == 1 else more}: "
        f"{first_few(frames)}."
        for frames, one, more in verbs
        if frames
    )


def first_few(frames: Sequence[str]) -> str:
    """Return the first few frames, and how many more there are."""
    more = f" and {len(frames) - 5} more" if len(frames) > 5 else ""
    return ", ".join(frames[:5]) + more


@dataclass(frozen=True)
class Fringes:
    """What the fields of a frame show in each tile.

    Parameters
    ----------
    power : ndarray of shape (view, tile, tile)
        Squared mean amplitude.
    coherence : ndarray of shape (view, tile, tile)
        How alike the field is to itself some pixels on, from 0 for noise to 1.
    evenness : ndarray of shape (view, tile, tile)
        Squared mean amplitude next to the mean of its square: 1 if it is the same everywhere, pi/4
        for noise, which varies as speckle does.
    light : float
        Mean grey value.
    """

    power: Tiles
    coherence: Tiles
    evenness: Tiles
    light: float

    @cached_property
    def alike(self) -> NDArray[np.float64]:
        """How alike the fields are to themselves in most of each view."""
        found: NDArray[np.float64] = np.median(self.coherence, axis=(1, 2))
        return found

    @property
    def are_seen(self) -> bool:
        """Whether every view surely shows more than noise."""
        return bool((self.alike > ALIKE).all())

    @cached_property
    def lit(self) -> NDArray[np.bool_]:
        """Tiles that are no dark border."""
        brightest = self.power.max(axis=(1, 2), keepdims=True)
        found: NDArray[np.bool_] = self.power > DARK * brightest
        return found

    def reason(self, usual: Fringes) -> str:
        """Say why any view of a frame is lost where others are as usual; "" if none is."""
        return next(filter(None, self.reasons(usual)), "")

    def reasons(self, usual: Fringes) -> list[str]:
        """Say of each view why it is lost where others are as usual; "" if it is not."""
        if are_usual(self.power, self.coherence, usual.power, usual.coherence, usual.lit):
            return [""] * len(self.power)  # as most are: what follows takes ten times as long
        return [self._reason(usual, view) for view in range(len(self.power))]

    def _reason(self, usual: Fringes, view: int) -> str:
        lit = usual.lit[view]
        if not lit.any():
            return ""
        power, usually = self.power[view][lit], usual.power[view][lit]
        # Strength alone does not say so, as there may be more light or less, nor does
        # contrast, as light without fringes may come with it.
        said = difference(power / usually)
        brighter = self.brighter(usual, power, usually)
        said = said if said and difference(power / usually / brighter) else ""
        if said == WITHOUT_FRINGES:  # asked first, as noise in a narrow lobe hangs together, too
            return said
        likely = np.maximum(usual.coherence[view][lit], TINY)
        alike = self.coherence[view][lit] / likely
        unlike = alike < NOISE
        if unlike.any() and slopes(
            power[unlike] / usually[unlike], self.evenness[view][lit][unlike]
        ):
            alike[unlike] = 1.0
        # Where the least is not below a limit, no median is, which takes longest of all.
        if alike.min() < NOISE and float(np.median(alike)) < NOISE:
            return WITHOUT_FRINGES
        # Where noise is usual, or rough phase, one frame is as good as another.
        incoherent = float(((alike < INCOHERENT) & (likely > ALIKE)).mean()) > BAD_TILES
        return "damaged" if incoherent else said

    def brighter(self, usual: Fringes, power: Tiles, usually: Tiles) -> float:
        """Return by how much the squares of grey values are more than usual, as the light is.

        It is 1 where they say nothing of the light: fringes of light are weaker than the light
        is, so something was taken off.
        """
        lights, powers = (self.light, usual.light), (power, usually)
        if any(n <= np.sqrt(np.median(p)) for n, p in zip(lights, powers, strict=True)):
            return 1.0
        return (self.light / usual.light) ** 2


@unchecked
def are_usual(
    power: Tiles,
    coherence: Tiles,
    usual_power: Tiles,
    usual_coherence: Tiles,
    lit: NDArray[np.bool_],
) -> bool:
    """Say whether no lit tile of any view is so unlike usual that the frame may be lost."""
    for view in range(len(power)):
        count = strong = 0
        for tile in np.ndindex(power[view].shape):
            if not lit[view][tile]:
                continue
            alike = coherence[view][tile] / max(usual_coherence[view][tile], TINY)
            relative = power[view][tile] / usual_power[view][tile]
            if alike < max(NOISE, INCOHERENT) or relative < max(COLLAPSED, WEAK):
                return False
            count += 1
            strong += relative > STRONG
        if strong > BAD_TILES * count:
            return False
    return True


def difference(relative: Tiles) -> str:
    """Say how fringes differ whose power is so much of the usual one in tiles; "" if hardly."""
    middle = float(np.median(relative))
    if middle < COLLAPSED:
        return WITHOUT_FRINGES
    # Stronger as a whole is a brighter beam.
    bad = (relative < WEAK) | (relative > STRONG * max(1.0, middle))
    return "damaged" if float(bad.mean()) > BAD_TILES else ""


def slopes(power: Tiles, evenness: Tiles) -> bool:
    """Say whether tiles are no noise that are less alike to themselves than usual.

    Where cells arrive, slopes make them so; but their fringes are as strong as usual, and as even.
    All tiles are asked together: small ones hold few grains of what varies as speckle does.

    Parameters
    ----------
    power, evenness : ndarray of shape (tile,)
        Of each, power as a share of the usual one, and see `Fringes`.
    """
    even = float(np.sqrt(power).mean() ** 2 / (power / evenness).mean())
    return even >= EVEN and float(np.median(power)) >= AS_STRONG


def fringes_of(some: NDArray[np.generic], fields: NDArray[np.complex64]) -> Fringes:
    """Return what the fields (view, y, x) of a frame show, some of whose rows are given.

    Some of their pixels are looked at.
    """
    views, height, width = fields.shape
    step = max(1, min(height, width) // LINES)
    apart = APART if min(height, width) > APART + 4 * APART * step else 0
    tiles = min(TILES, height, width)
    power = np.empty((views, tiles, tiles))
    coherence, evenness = np.ones_like(power), np.empty_like(power)
    tiles_of_views(fields, step, apart, power, coherence, evenness)
    return Fringes(power, coherence, evenness, float(some.mean(dtype=np.float64)))


@compiled
def tiles_of_views(
    fields: NDArray[np.complex64],
    step: int,
    apart: int,
    power: Tiles,
    coherence: Tiles,
    evenness: Tiles,
) -> None:
    """Do `tile_sums` for all views."""
    for view in range(len(fields)):
        tile_sums(fields[view], step, apart, power[view], coherence[view], evenness[view])


@vectorized
def tile_sums(
    field: NDArray[np.complex64],
    step: int,
    apart: int,
    power: Tiles,
    coherence: Tiles,
    evenness: Tiles,
) -> None:
    """Write the squared mean amplitude of tiles, how alike the field is to itself, and how even.

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
            evenness[v, u] = power[v, u] / max(square / count, TINY)
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
        """Say why any view of a frame with some fields (view, y, x) is lost; "" if none is."""
        found = self.reasons(frame, fields)
        if WITHOUT_FRINGES in found and "" in found:
            return VIEWS_WITHOUT_FRINGES
        return next(filter(None, found), "")

    def reasons(self, frame: NDArray[np.generic], fields: NDArray[np.complex64]) -> list[str]:
        """Say of each view why it is lost; "" if it is not.

        A view without fringes is lost by itself: its beam may be blocked. What is damaged is the
        frame, with all views that it holds.
        """
        some = some_rows(frame)
        if alone := reason_by(some):
            return [alone] * len(fields)
        found = fringes_of(some, fields).reasons(self.usual)
        damaged = next((each for each in found if each not in ("", WITHOUT_FRINGES)), "")
        return [damaged] * len(fields) if damaged else found


def usual_fringes(
    rec: Recording,
    demodulate: Demodulator,
    task: Task = UNWATCHED,
    among: Sequence[int] | None = None,
) -> tuple[LostFrames, dict[int, NDArray[np.complex64]]]:
    """Return what tells lost frames, and the fields of those looked at that are not lost.

    Some of the frames given are looked at; by default, of those from all over the recording.

    Raises
    ------
    ValueError
        If every frame that was looked at is lost.
    """
    among = rec.sample_indices(STATIC_FRAMES) if among is None else among
    indices = among[:: max(1, len(among) // SAMPLE)]
    watch = Watch(2 * len(indices), "looking for lost frames", task.quiet)

    def look(index: int) -> tuple[NDArray[np.complex64], Fringes] | str:
        try:
            frame = rec.raw_frame(index)
        except BrokenFrameError:
            return "NaN"
        some = some_rows(frame)
        if reason := reason_by(some):
            return reason
        fields = demodulate(frame)
        return fields, fringes_of(some, fields)

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
    usual = usual_among(list(fringes.values()))
    kept = {i: known[i] for i in sorted(known) if not fringes[i].reason(usual)}
    if not kept:
        raise ValueError(never_all(rec.name, {i: f.reasons(usual) for i, f in fringes.items()}))
    return LostFrames(usual), kept


def usual_among(fringes: Sequence[Fringes]) -> Fringes:
    """Return what some frames usually show of each view: the median of those that show it.

    So where most frames are dark, or a beam is blocked in most of them, that is not usual. Weak
    fringes are hardly more alike than noise, but what is nearly as good as the best is none; and
    noise in a narrow lobe is as alike as fringes, but weaker. One frame may be bright by accident.
    """
    alike = np.array([each.alike for each in fringes])
    strength = np.array([np.median(each.power, axis=(1, 2)) for each in fringes])
    least = np.minimum(ALIKE, NEARLY * alike.max(axis=0))
    strong = np.sort(strength, axis=0)[-min(2, len(fringes))]
    shown = (alike > least) & (strength >= COLLAPSED * strong)
    shown[:, ~shown.any(axis=0)] = True
    every = shown.all(axis=1) if shown.all(axis=1).any() else np.ones(len(fringes), dtype=bool)
    power, coherence, evenness = (
        np.nanmedian(np.where(shown[..., None, None], each, np.nan), axis=0)
        for each in (
            [each.power for each in fringes],
            [each.coherence for each in fringes],
            [each.evenness for each in fringes],
        )
    )
    light = np.array([each.light for each in fringes])
    return Fringes(power, coherence, evenness, float(np.median(light[every])))


def never_all(name: str, lost: Mapping[int, Sequence[str]]) -> str:
    """Say that no frame shows all views, by why each frame's views are lost."""
    if any("" in reasons for reasons in lost.values()):
        return NEVER_ALL.format(name)
    return all_lost(name, {index: reasons[0] for index, reasons in lost.items()})


def all_lost(name: str, lost: Mapping[int, str]) -> str:
    """Say that nothing is left to work on."""
    index, reason = next(iter(lost.items()))
    return f"no frame of {name} shows fringes: frame {index} is {reason}"
