"""Finding the lobes of a recording without help.

The steps:

1. the transforms of some windowed frames, and their mean power (`spectrum`);
2. peaks that stand out of the ring of equal frequency (`find_peaks`);
3. which of them are views, how many there are, and how sure that is (`beams`), in two looks: a
   second window shows more of what lies near the border of the frames;
4. the carrier to a hundredth of a pixel of the spectrum, and the largest radius that fits;
5. which of two conjugates shows a dense object bright (`signs`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.beams import Choice, choices, clues_of, most_likely
from napari_phase4d.holography.lobes import MAX_VIEWS, Lobe, pair_distance, wrapped_distance
from napari_phase4d.holography.lost import first_seen, is_full
from napari_phase4d.holography.peaks import (
    MAIN_LOBE,
    Peak,
    brightest_places,
    half_plane,
    refined,
)
from napari_phase4d.holography.signs import sign_doubts, sign_evidence, together
from napari_phase4d.holography.spectrum import (
    first_spectrum,
    mean_power,
    wide_window,
    windowed_spectrum,
)
from napari_phase4d.recording import Recording
from napari_phase4d.task import CancelledCall, ProgressCall, Task, Watch, in_threads
from napari_phase4d.warned import warn
from napari_phase4d.words import (
    as_numbers,
    check_bool,
    check_positive,
    check_type,
    counted,
    shown,
)

__all__ = ["FoundLobes", "find_lobes", "views_doubt", "warn_of_doubts"]

#: Frames that the spectrum is made of at most, and the memory that their transforms may take.
MAX_FRAMES, MAX_BYTES = 16, 512 * 2**20
#: A second look takes so many frames at most, of so many pixels together, or else one.
MAX_WIDE, WIDE_PIXELS = 4, 2**20
#: A choice of views, and their number, with less of a chance than this is in doubt. Set on 4,500
#: recordings that no weight was fitted to and on 3,600 that the other half of was: it found 38 of
#: 40 and 18 of 19 wrong ones.
SURE = SURE_NUMBER = 0.96
#: Where the views that fit best can't be, and so many were asked for, the next best count with
#: more of a chance than this.
LEAST_CHANCE = 0.1
SECOND_BEST = (
    "What fits best here can't be, since faint peaks or copies of brighter ones would be views, "
    "and their beats are not seen; these circles are the next best choice."
)
NEAR_HARMONIC = (
    "One of these views lies where a saturated camera would copy a brighter one to: it may be no "
    "view."
)
#: Where so large a share of a frame is at the largest value of the camera, and so much of it lies
#: beside what is not, fringes are clipped: their copies may be taken for views, and some views get
#: the wrong sign (from 0.47 on; at 0.42 all was right). Not where there are so few values.
MANY_SATURATED, CLIPS_FRINGES, FEW_VALUES = 0.25, 0.05, 8
#: With more of a chance than this it is said that another number was asked for than is there.
CLEAR_NUMBER = 0.9
#: A lobe larger than this share of its distance from zero would reach into the zero order.
MAX_RADIUS_SHARE = 0.42
MIN_RADIUS_SHARE = 1 / 3
#: A peak that lies farther than so many pixels of the spectrum beside the light round the object,
#: no neighbour of it, is pulled there by the object. Fringes that the optics bend move it by one.
PULLED = 1.5


class FoundLobes(list[Lobe]):
    """The lobes that were found, what is in doubt about them, and the next best choice.

    Attributes
    ----------
    chance : float
        Chance, from 0 to 1, that these peaks are the views, if there are so many.
    doubts : tuple of str
        What can't be known of this recording, each in a sentence; empty if nothing is in doubt.
    doubts_of_views : tuple of str
        Those among them about which peaks are views, and how many; not about signs.
    other : list of Lobe
        The next best choice of as many views; empty if there is none worth a look.

    See Also
    --------
    find_lobes : Makes it.

    Examples
    --------
    >>> from napari_phase4d import Lobe
    >>> from napari_phase4d.holography import FoundLobes
    >>> found = FoundLobes([Lobe((0.19, 0.21), 0.09)], chance=0.7, doubts_of_views=["Unsure."])
    >>> len(found), found.chance, found.doubts
    (1, 0.7, ('Unsure.',))
    """

    def __init__(
        self,
        lobes: Iterable[Lobe] = (),
        chance: float = 1.0,
        doubts_of_views: Sequence[str] = (),
        other: Sequence[Lobe] = (),
    ) -> None:
        super().__init__(lobes)
        self.chance = chance
        self.doubts_of_views = tuple(doubts_of_views)
        every = (*doubts_of_views, *(lobe.doubt for lobe in self))
        self.doubts = tuple(dict.fromkeys(filter(None, every)))
        self.other = list(other)


@dataclass(frozen=True)
class Plane:
    """The Fourier plane of some frames of a recording.

    Parameters
    ----------
    frames : callable
        ``frames()`` yields some frames (y, x) for the sign, the middle one first.
    spectra : list of ndarray of shape (y, x // 2 + 1)
        Transforms of all of them, windowed.
    half : ndarray of shape (y, x // 2 + 1)
        Their mean power.
    wide, wide_half : list of ndarray, ndarray
        The same of a few frames in a window that shows more of their border.
    shape : tuple of int
        Height and width of the frames.
    peaks : list of Peak
        What stands out.
    places : list of tuple of float
        Where the wide window is brightest near each of them.
    """

    frames: Callable[[], Iterator[NDArray[np.float32]]]
    spectra: list[NDArray[np.complex64]]
    half: NDArray[np.float64]
    wide: list[NDArray[np.complex64]]
    wide_half: NDArray[np.float64]
    shape: tuple[int, int]
    peaks: list[Peak]
    places: list[tuple[float, float]]


def find_lobes(
    rec: Recording,
    n_views: int | None = None,
    *,
    angles_deg: Sequence[float] | None = None,
    wavelengths_um: Sequence[float] | None = None,
    radius: float | None = None,
    orient: bool = True,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> FoundLobes:
    """Find the cross-correlation terms of the views in the spectrum of a recording.

    Parameters
    ----------
    rec : Recording
        The hologram video; up to 16 frames of it are looked at, fewer of very large ones.
    n_views : int, optional
        How many views there are, 1 to 6. Default: as many as there are angles or wavelengths,
        else as many as there seem to be.
    angles_deg : sequence of float, optional
        Viewing angles in degrees, in the order of the lobes. A hologram can't tell them; by
        default the views are numbered 0, 1, 2 ...
    wavelengths_um : sequence of float, optional
        Wavelengths in micrometres, in the order of the lobes, where views differ in them. A
        hologram can't tell them either. Default: all have that of the recording.
    radius : float, optional
        Radius of all lobes in cycles per pixel, 0.001 to 0.5. Default: as large as the pupil
        seems to be and as the neighbours allow.
    orient : bool, optional
        Whether to flip a lobe in which a clear object would come out with less phase than the
        background. Default True: cells are denser than water.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the search.

    Returns
    -------
    FoundLobes
        A list of `Lobe`, with carriers in the half plane kx >= 0, ordered counter-clockwise as
        seen on the screen (y down), starting from straight down. Its ``doubts`` say in words what
        can't be known of this recording, ``chance`` how likely the choice is, and ``other`` is
        the next best.

    Raises
    ------
    ValueError
        If ``n_views`` or ``radius`` is out of range, or fewer carriers can be seen.
    TypeError
        If ``rec`` is no recording.
    OSError
        If its frames can't be read.
    Cancelled
        If ``cancelled()`` returned True.

    Warns
    -----
    UserWarning
        If there seem to be fewer views than asked for, or the recording is overexposed.

    See Also
    --------
    power_spectrum : What they are found in.
    reconstruct : What they are for.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> exact = p4d.simulation.swimming_euglena(n_times=2)
    >>> rec = p4d.simulation.multiplexed_video(exact["phase"])
    >>> lobes = p4d.find_lobes(rec, n_views=2, angles_deg=(-7, 21))
    >>> for lobe in lobes:
    ...     print(lobe.angle_deg, [round(k, 2) for k in lobe.carrier])
    -7.0 [0.19, 0.21]
    21.0 [-0.21, 0.19]
    >>> lobes.doubts
    ()
    """
    task = Task(progress, cancelled)
    check_type("rec", rec, Recording, "open_recording() makes one of a file or an array")
    n_views = checked_number(n_views, angles_deg, wavelengths_um)
    check_bool("orient", orient)
    if radius is not None and not 1e-3 <= check_positive("radius", radius) <= 0.5:
        msg = f"radius must lie between 0.001 and 0.5 cycles per pixel, but is {shown(radius)}"
        raise ValueError(msg)
    plane = plane_of(rec, task)
    plain = sum(peak.is_plain for peak in plane.peaks)
    if not plain or len(plane.peaks) < (n_views or 1):
        raise ValueError(too_few(rec.name, plain, n_views))
    halves = ((plane.half, len(plane.spectra)), (plane.wide_half, len(plane.wide)))
    looks = clues_of(plane.peaks, plane.places, halves, plane.spectra, plane.shape)
    found = choices(looks, MAX_VIEWS if n_views is None else min(n_views + 1, MAX_VIEWS))
    can = [[can_be(choice, plane.peaks) for choice in each] for each in found]
    likely, chances = most_likely(found, can)
    best, *others = found[(n_views or likely) - 1]
    second = not can_be(best, plane.peaks) and bool(others)
    if second and (n_views is None or others[0].chance > LEAST_CHANCE):
        best, others = others[0], []  # which of two counts is the one that may be
    if not can_be(best, plane.peaks):
        raise ValueError(too_few(rec.name, plain, n_views))
    lobes, signs = lobes_of(best, plane, angles_deg, radius, orient=orient)
    doubts = list(number_doubts(n_views, likely, chances))
    if doubts and likely < (n_views or 0):  # one of them may be the beat of two others
        warn(f"{rec.name}: {doubts[0]}")
    if clipped := clipped_sentence(rec):
        warn(f"{rec.name}: {clipped}")
        doubts.append(clipped)
    if second:
        doubts.append(SECOND_BEST)
    if any(plane.peaks[i].near_harmonic for i in best.views):
        doubts.append(NEAR_HARMONIC)
    other: list[Lobe] = []
    if best.chance < SURE and others:
        other, _ = lobes_of(others[0], plane, angles_deg, radius, orient=orient)
        doubts.append(views_doubt(best, others[0], lobes, other))
    doubted = [
        replace(lobe, doubt=doubts[-1] if other and not is_among(lobe, other) else sign)
        for lobe, sign in zip(lobes, sign_doubts(signs), strict=True)
    ]
    coloured = [coloured_lobes(each, wavelengths_um) for each in (doubted, other)]
    return FoundLobes(coloured[0], best.chance, doubts, coloured[1])


def clipped_sentence(rec: Recording) -> str:
    """Say how much of the frames is saturated, "" where that clips no fringes."""
    frames = [first_seen(rec)]
    frames += [np.asarray(rec.holograms[i]) for i in {rec.n_frames // 2, rec.n_frames - 1} - {0}]
    share = max(clipped_share(frame) for frame in frames)
    if not share:
        return ""
    return (
        f"{100 * share:.0f} % of a frame is saturated, which clips the fringes: views may be "
        "missed, false, or of the wrong sign; record with less light."
    )


def clipped_share(frame: NDArray[np.generic]) -> float:
    """Return the share of a frame that is saturated, 0 where that clips no fringes."""
    full = frame == frame.max()
    share = float(full.mean())
    if share < MANY_SATURATED or not is_full(frame.max()):
        return 0.0
    if np.mean(full[:, 1:] != full[:, :-1]) < CLIPS_FRINGES or len(np.unique(frame)) <= FEW_VALUES:
        return 0.0
    return share


def warn_of_doubts(lobes: Iterable[Lobe], name: str) -> None:
    """Warn of what is in doubt about lobes that were found, and nobody has looked at.

    Parameters
    ----------
    lobes : FoundLobes or iterable of Lobe
        Those that were given are not in doubt.
    name : str
        Of the recording.
    """
    for doubt in lobes.doubts if isinstance(lobes, FoundLobes) else ():
        warn(f"{name}: {doubt}")


def coloured_lobes(lobes: list[Lobe], wavelengths_um: Sequence[float] | None) -> list[Lobe]:
    """Return lobes with the wavelengths that were named, in their order."""
    if wavelengths_um is None or not lobes:
        return lobes
    pairs = zip(lobes, wavelengths_um, strict=True)
    return [replace(lobe, wavelength_um=float(light)) for lobe, light in pairs]


def can_be(choice: Choice, peaks: Sequence[Peak]) -> bool:
    """Say whether some peaks may be views: a faint one or a ghost only if its beat is seen."""
    return choice.beats_seen or all(peaks[i].is_plain for i in choice.views)


def checked_number(
    n_views: int | None,
    angles_deg: Sequence[float] | None,
    wavelengths_um: Sequence[float] | None = None,
) -> int | None:
    """Return how many views to look for; ValueError if that can't be."""
    if wavelengths_um is not None:
        light = as_numbers("wavelengths_um", wavelengths_um)
        if light.ndim != 1 or not (np.isfinite(light).all() and (light > 0).all()):
            msg = f"wavelengths_um must be lengths above 0, but is {shown(wavelengths_um)}"
            raise ValueError(msg)
        if angles_deg is None and n_views is None:
            n_views = len(light)
    known = isinstance(n_views, (int, np.integer)) and not isinstance(n_views, bool)
    if n_views is not None and not (known and 1 <= n_views <= MAX_VIEWS):
        msg = f"n_views must lie between 1 and {MAX_VIEWS}, but is {shown(n_views)}"
        raise ValueError(msg)
    if angles_deg is not None and np.ndim(as_numbers("angles_deg", angles_deg)) != 1:
        msg = f"angles_deg must be a list of degrees, but is {shown(angles_deg)}"
        raise TypeError(msg)
    if n_views is None and angles_deg is not None:
        n_views = len(angles_deg)
    if angles_deg is not None and len(angles_deg) != n_views:
        msg = f"angles_deg has {len(angles_deg)} angles for {n_views} views; give one each"
        raise ValueError(msg)
    if wavelengths_um is not None and len(wavelengths_um) != n_views:
        msg = f"wavelengths_um has {len(wavelengths_um)} for {n_views} views; give one each"
        raise ValueError(msg)
    return n_views


def plane_of(rec: Recording, task: Task) -> Plane:
    """Transform some frames of a recording and look for peaks."""
    height, width = rec.frame_shape
    at_most = int(np.clip(MAX_BYTES // (8 * height * (width // 2 + 1)), 1, MAX_FRAMES))
    indices = rec.sample_indices(at_most)
    watch = Watch(len(indices) + 1, "finding the lobes", task)
    first = first_spectrum(rec, indices, task, watch)
    watch.step()
    seen = [index for index in indices if index not in first.lost]
    frame = rec.frame(seen[len(seen) // 2])
    wide = wide_spectra(rec, seen, frame, watch)
    wide_half = mean_power(wide)
    carriers = [peak.carrier for peak in first.peaks]
    places = brightest_places(carriers, wide_half, rec.frame_shape)

    def frames() -> Iterator[NDArray[np.float32]]:
        yield frame
        yield from (rec.frame(index) for index in dict.fromkeys((seen[0], seen[-1])))

    shape = rec.frame_shape
    return Plane(frames, first.spectra, first.half, wide, wide_half, shape, first.peaks, places)


def wide_spectra(
    rec: Recording, seen: Sequence[int], middle: NDArray[np.float32], watch: Watch
) -> list[NDArray[np.complex64]]:
    """Transform a few of the frames that were seen, or the middle one, in a wide window."""
    window = wide_window(rec.frame_shape)
    count = min(WIDE_PIXELS // middle.size, MAX_WIDE, len(seen))
    if count < 2:
        return [windowed_spectrum(middle, window)]
    places = np.linspace(0, len(seen) - 1, count).round().astype(int)
    found = []
    for i in places:
        watch.check()
        found.append(windowed_spectrum(rec.frame(seen[i]), window))
    return found


def lobes_of(
    choice: Choice,
    plane: Plane,
    angles_deg: Sequence[float] | None,
    radius: float | None,
    *,
    orient: bool,
) -> tuple[list[Lobe], list[float]]:
    """Return the lobes of a choice of peaks, in order, and the evidence for their signs."""
    carriers = [carrier_near(i, plane) for i in choice.views]
    others = [p.carrier for i, p in enumerate(plane.peaks) if i not in choice.views and p.is_plain]
    # The 10 % quantile of exponential noise, times two.
    noise = 2 * float(np.quantile(plane.half[::4], 0.1)) / 0.105
    # All views pass one pupil, so one radius serves all.
    radius = radius or within_edges(
        min(proposed_radius(k, [*carriers, *others], plane, noise) for k in carriers),
        carriers,
        plane,
        noise,
    )
    lobes = [Lobe(k, radius) for k in carriers]
    evidence = bright(choice, plane, lobes) if orient else [np.inf] * len(lobes)
    order = sorted(range(len(lobes)), key=lambda i: math.atan2(-carriers[i][0], carriers[i][1]))
    angles = range(len(lobes)) if angles_deg is None else angles_deg
    ordered = [
        replace(lobes[i], flip=evidence[i] < 0, angle_deg=float(angle))
        for i, angle in zip(order, angles, strict=True)
    ]
    return ordered, [evidence[i] for i in order]


def carrier_near(number: int, plane: Plane) -> tuple[float, float]:
    """Return the carrier of a view to a hundredth of a pixel of the spectrum.

    Where an object fills the middle of the frames, structure of its lobe may be brighter than the
    light that nothing scattered, or pull at it. That comes from round the object, so that the wide
    window tells. Where they are neighbours it is the middle that counts: fringes that the optics
    bend have no one carrier.
    """
    peak, place = plane.peaks[number].carrier, plane.places[number]
    if pair_distance(peak, place, plane.shape) > PULLED:
        return refined(place, plane.wide, plane.shape)
    return refined(peak, plane.spectra, plane.shape)


def bright(choice: Choice, plane: Plane, lobes: Sequence[Lobe]) -> list[float]:
    """Return for each lobe the logarithm of the odds that a dense object is bright in it.

    The beats tell which views lie on the same side, so that there is one question for all views
    together; where no beat is seen, each view answers for itself.
    """
    watch = Watch(len(lobes), "telling the signs")
    for frame in plane.frames():
        evidence = list(in_threads(partial(sign_evidence, frame), lobes, watch))
        if any(evidence):  # else there is no object in this frame, but there may be in another
            break
    if not choice.beats_seen:
        return evidence
    sides = [
        -1 if mirrored ^ is_conjugate(lobe.carrier, plane.places[i]) else 1
        for i, mirrored, lobe in zip(choice.views, choice.mirrored, lobes, strict=True)
    ]
    total = together([side * each for side, each in zip(sides, evidence, strict=True)])
    return [side * total for side in sides]


def is_conjugate(carrier: tuple[float, float], place: tuple[float, float]) -> bool:
    """Say whether a carrier came out on the other side of zero, as near the ky axis it may."""
    ky, kx = place
    return wrapped_distance((-ky, -kx), carrier) < wrapped_distance(place, carrier)


def is_among(lobe: Lobe, others: Sequence[Lobe]) -> bool:
    """Say whether one of some lobes is the same view."""
    return distance_to(lobe, others) < lobe.radius


def distance_to(lobe: Lobe, others: Sequence[Lobe]) -> float:
    """Return the distance to the nearest of some lobes, or their conjugates, in cycles/px."""
    return min((pair_distance(lobe.carrier, o.carrier) for o in others), default=np.inf)


def too_few(name: str, found: int, wanted: int | None) -> str:
    """Say that fewer carriers can be seen than there should be views, and what to do."""
    seen = f"{name} shows {counted(found, 'carrier')}"
    if wanted is None:
        return f"{seen}{' that no views fit' if found else ''}; place the lobes by hand"
    asked = f"{counted(wanted, 'view')} {'was' if wanted == 1 else 'were'}"
    instead = f"ask for {counted(found, 'view')}, or " if found else ""
    return f"{seen}, but {asked} asked for; {instead}place the lobes by hand"


def number_doubts(wanted: int | None, likely: int, chances: NDArray[np.float64]) -> Iterable[str]:
    """Say if the number of views is in doubt, or another than was asked for."""
    if wanted is None:
        if chances[likely - 1] < SURE_NUMBER:
            second = int(np.argsort(-chances)[1]) + 1
            yield (
                f"The spectrum looks like {counted(likely, 'view')} "
                f"(chance {100 * chances[likely - 1]:.0f} %), but there may be {second}."
            )
    elif likely != wanted and chances[likely - 1] > CLEAR_NUMBER:
        yield (
            f"{counted(wanted, 'view')} asked for, but the spectrum looks like "
            f"{counted(likely, 'view')}."
        )


def views_doubt(best: Choice, second: Choice, lobes: list[Lobe], other: list[Lobe]) -> str:
    """Say that other peaks may be the views."""
    elsewhere = [lobe for lobe in other if not is_among(lobe, lobes)]
    if not elsewhere:  # in one of the same circles, at another of its peaks
        elsewhere = [max(other, key=lambda lobe: distance_to(lobe, lobes))]
    changed = [f"({lobe.carrier[0]:+.3f}, {lobe.carrier[1]:+.3f})" for lobe in elsewhere]
    return (
        f"Views and their beats look alike here: these circles are right with a chance of "
        f"{100 * best.chance:.0f} %; the next best choice ({100 * second.chance:.0f} %) has a "
        f"view at {' and '.join(changed)} cycles/px instead."
    )


def proposed_radius(
    carrier: tuple[float, float],
    all_carriers: Sequence[tuple[float, float]],
    plane: Plane,
    noise: float,
) -> float:
    """Return the radius where the lobe ends, within what neighbours and the zero order allow."""
    distance = float(np.hypot(*carrier))
    neighbours = [pair_distance(carrier, k) for k in all_carriers if k != carrier]
    conjugate = wrapped_distance(carrier, [-v for v in carrier]) / 2
    # A peak nearer than the least radius is structure of this lobe, not a neighbour.
    limits = [n / 2 for n in neighbours if n > MIN_RADIUS_SHARE * distance]
    limit = min([MAX_RADIUS_SHARE * distance, conjugate, *limits])
    floor = min(MIN_RADIUS_SHARE * distance, limit)
    return float(np.clip(lobe_extent(carrier, plane, noise, limit), floor, limit))


def within_edges(
    radius: float, carriers: Sequence[tuple[float, float]], plane: Plane, noise: float
) -> float:
    """Return the radius, or the one at which all lobes end within the spectrum.

    That is taken only where it costs nothing of what is seen of the pupil: beyond the edge a lobe
    goes on at the opposite one.
    """
    edge = 0.5 - max(abs(k) for carrier in carriers for k in carrier)
    if radius <= edge or any(lobe_extent(k, plane, noise, radius) > edge for k in carriers):
        return radius
    return edge


def lobe_extent(carrier: tuple[float, float], plane: Plane, noise: float, limit: float) -> float:
    """Return the distance from the carrier at which the power has sunk to the noise (+3 dB)."""
    ky, kx = half_plane(plane.shape)
    dy, dx = ky - carrier[0], kx - carrier[1]
    dy -= np.round(dy)
    step = max(1.5 / min(plane.shape), 0.004)
    rows, columns = (np.flatnonzero(np.abs(d) < limit + step) for d in (dy[:, 0], dx[0]))
    half = plane.half[np.ix_(rows, columns)]
    distance = np.hypot(dy[rows], dx[:, columns])
    for inner in np.arange(MAIN_LOBE / min(plane.shape), limit, step):
        ring = half[(distance >= inner) & (distance < inner + step)]
        if ring.size and np.median(ring) / np.log(2) < noise:
            return float(inner + step)
    return limit
