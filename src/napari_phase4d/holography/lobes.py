"""Lobes, the cross-correlation terms of a hologram's spectrum, and what disturbs them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.words import (
    check_bool,
    check_number,
    check_positive,
    checked_call,
    shown,
    views_are_numbered,
)

__all__ = [
    "MAX_VIEWS",
    "Lobe",
    "StrayTerm",
    "angles_unknown",
    "canonical",
    "check_lobes",
    "in_order_of_angle",
    "light_of",
    "lobe_doubts",
    "lobe_warnings",
    "one_wavelength",
    "pair_distance",
    "stray_terms",
    "with_wavelengths",
    "wrapped_distance",
]

#: Views that a hologram is taken to hold at most.
MAX_VIEWS = 6

#: (ky, kx) in cycles per pixel.
Frequency = Sequence[float] | NDArray[np.float64]


@dataclass(frozen=True)
class Lobe:
    """One view of the object: a disk round one carrier in the Fourier plane.

    Parameters
    ----------
    carrier : tuple of float
        ``(ky, kx)`` in cycles per camera pixel, each within [-0.5, 0.5].
    radius : float
        Radius of the disk that is cut out, in cycles per camera pixel, above 0 and at most 0.5.
    angle_deg : float
        Viewing angle in degrees. A hologram can't tell it; until it is given, views are numbered.
    flip : bool
        Whether to take the conjugate term instead, which changes the sign of the phase.
    wavelength_um : float, optional
        Vacuum wavelength of the view in micrometres, where several are recorded in one hologram.
        Default None: that of the recording's `Optics`.
    doubt : str
        What `find_lobes` could not know of it, in a sentence; empty if nothing. It does not count
        where lobes are compared.

    Raises
    ------
    ValueError
        If the carrier or the radius lies outside the spectrum, or the wavelength is not above 0.

    See Also
    --------
    find_lobes : Finds them in a recording.
    reconstruct : Takes them.

    Examples
    --------
    >>> from napari_phase4d import Lobe
    >>> Lobe(carrier=(0.19, 0.21), radius=0.09, angle_deg=-7)
    Lobe(carrier=(0.19, 0.21), radius=0.09, angle_deg=-7.0, flip=False, wavelength_um=None)
    """

    carrier: tuple[float, float]
    radius: float
    angle_deg: float = 0.0
    flip: bool = False
    wavelength_um: float | None = None
    doubt: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        ky, kx = carrier_of(self.carrier)
        check_number("the lobe radius", self.radius)
        check_number("angle_deg", self.angle_deg)
        check_bool("flip", self.flip)
        if not all(math.isfinite(k) and abs(k) <= 0.5 for k in (ky, kx)):
            msg = (
                f"the carrier ({ky:g}, {kx:g}) lies outside the spectrum, "
                "which ends at +-0.5 cycles/px"
            )
            raise ValueError(msg)
        if not (math.isfinite(self.radius) and 0 < self.radius <= 0.5):
            msg = f"the lobe radius must lie between 0 and 0.5 cycles/px, but is {self.radius:g}"
            raise ValueError(msg)
        if not math.isfinite(self.angle_deg):
            msg = f"the viewing angle must be a number of degrees, but is {shown(self.angle_deg)}"
            raise ValueError(msg)
        object.__setattr__(self, "carrier", (ky, kx))
        if self.wavelength_um is not None:
            light = check_number("wavelength_um of a lobe", self.wavelength_um)
            if not (math.isfinite(light) and light > 0):
                msg = (
                    f"wavelength_um of a lobe must be a number of micrometres above 0, but is "
                    f"{shown(self.wavelength_um)}"
                )
                raise ValueError(msg)
            object.__setattr__(self, "wavelength_um", light)
        # As plain numbers, which recipes can be written with.
        object.__setattr__(self, "radius", float(self.radius))
        object.__setattr__(self, "angle_deg", float(self.angle_deg))
        object.__setattr__(self, "flip", bool(self.flip))


def carrier_of(carrier: Any) -> tuple[float, float]:
    """Return a carrier as two numbers, or say that it is none."""
    try:
        ky, kx = (float(k) for k in carrier)
    except (TypeError, ValueError, OverflowError) as error:
        msg = f"carrier must be two numbers (ky, kx) in cycles per pixel, but is {shown(carrier)}"
        raise ValueError(msg) from error
    return ky, kx


def wrapped_distance(a: Frequency, b: Frequency, scale: Sequence[float] = (1, 1)) -> float:
    """Return the distance of two frequencies; a sampled spectrum repeats with period 1.

    With the shape of the frames as the scale it is one in pixels of their spectrum.
    """
    off = (x - y for x, y in zip(a, b, strict=True))
    return math.hypot(*((d - round(d)) * n for d, n in zip(off, scale, strict=True)))


def pair_distance(a: Frequency, b: Frequency, scale: Sequence[float] = (1, 1)) -> float:
    """Return the distance of a to b or to its conjugate -b, whichever is nearer.

    Parameters
    ----------
    a, b : sequence of float
        Two frequencies ``(ky, kx)`` in cycles per camera pixel.
    scale : sequence of float, optional
        What the distances along y and x are multiplied by. Default (1, 1); with the shape of the
        frames it is one in pixels of their spectrum.

    Returns
    -------
    float
        In cycles per camera pixel, times the scale; a spectrum repeats with period 1, and the
        shortest way counts.
    """
    return min(wrapped_distance(a, b, scale), wrapped_distance(a, [-v for v in b], scale))


def canonical(carrier: Sequence[float], tolerance: float = 1e-9) -> tuple[float, float]:
    """Return the carrier or its conjugate: the one with kx > 0, or kx = 0 and ky > 0.

    A carrier on the ky axis, measured with some error, may come out on either side of it;
    within ``tolerance`` of the axis the sign of ky decides.
    """
    ky, kx = (float(k) - round(float(k)) for k in carrier)
    if kx < -tolerance or (abs(kx) <= tolerance and ky < 0):
        return -ky, -kx
    return ky, kx


#: A stray term is strong up to this share of its radius, where the correlation of two disks has
#: sunk to a fifth of its peak. Farther out it does little harm; `find_lobes` goes as near as that.
STRONG_SHARE = 0.68
#: Circles that only touch do not overlap, however their numbers are rounded.
TINY = 1e-6
#: Two carriers nearer than this share of a radius are of the same view.
SAME = 0.1


@dataclass(frozen=True)
class StrayTerm:
    """A disk in the Fourier plane that holds no view, but may disturb one.

    Parameters
    ----------
    centre : tuple of float
        ``(ky, kx)`` in cycles per camera pixel; its conjugate lies at the opposite place.
    radius : float
        How far it reaches, in cycles per camera pixel.
    pair : tuple of int, optional
        The two views, counted from 0, that interfere with each other here. None for the zero
        order, where every beam interferes with itself.
    """

    centre: tuple[float, float]
    radius: float
    pair: tuple[int, int] | None = None

    @property
    def label(self) -> str:
        """What it is called on the screen."""
        return "zero order" if self.pair is None else "beat"

    def disturbs(self, lobe: Lobe) -> bool:
        """Say whether a lobe overlaps the strong part of the term or of its conjugate."""
        reach = lobe.radius + STRONG_SHARE * self.radius
        return pair_distance(self.centre, lobe.carrier) < reach - TINY

    def hides_under(self, lobe: Lobe) -> bool:
        """Say whether the middle of the term or of its conjugate lies within a lobe."""
        return pair_distance(self.centre, lobe.carrier) < lobe.radius


def stray_terms(lobes: Sequence[Lobe], wavelength_um: float | None = None) -> list[StrayTerm]:
    """Return the zero order and the beats of some views.

    Where two beams interfere, the Fourier plane holds the correlation of their two disks, which
    reaches as far as both radii together (Goodman, Introduction to Fourier Optics, on the least
    angle of the reference): the largest lobe with itself round zero, and lobes i and j with each
    other, the *beat*, round k_i - k_j. Beams of different wavelengths do not interfere: their
    beat moves by terahertz, and no camera sees it.

    Parameters
    ----------
    lobes : sequence of Lobe
        The views.
    wavelength_um : float, optional
        What those have that name none, in micrometres: that of the recording's `Optics`. Default:
        it is not known, and none of those that are named.

    Returns
    -------
    list of StrayTerm
        The zero order, then one beat for each pair of views of one wavelength; empty if there is
        no view.
    """
    if not lobes:
        return []
    terms = [StrayTerm((0.0, 0.0), 2 * max(lobe.radius for lobe in lobes))]
    for (i, a), (j, b) in itertools.combinations(enumerate(lobes), 2):
        if (a.wavelength_um or wavelength_um) != (b.wavelength_um or wavelength_um):
            continue
        ky, kx = (float(d - round(d)) for d in np.subtract(a.carrier, b.carrier))
        terms.append(StrayTerm((ky, kx), a.radius + b.radius, (i, j)))
    return terms


@checked_call
def lobe_warnings(lobes: Sequence[Lobe], wavelength_um: float | None = None) -> list[str]:
    """Say in words what is wrong with the circles on the spectrum, and what to do about it.

    A circle may reach beyond the edge of the spectrum, and may overlap the zero order, a beat,
    another circle or a conjugate. Circles are counted from 1.

    Parameters
    ----------
    lobes : sequence of Lobe
        The chosen lobes.
    wavelength_um : float, optional
        What those have that name none, in micrometres: that of the recording's `Optics`. Default:
        it is not known, and none of those that are named.

    Returns
    -------
    list of str
        At most one sentence for each circle and kind of trouble; empty if all is well.
    """
    if wavelength_um is not None:
        lobes = with_wavelengths(lobes, check_positive("wavelength_um", wavelength_um))
    terms = stray_terms(lobes)
    found: list[str] = []
    for index, lobe in enumerate(lobes):
        found += place_warnings(index, lobe, terms[0])
        found += neighbour_warnings(index, lobes)
        found += beat_warnings(index, lobe, terms[1:])
    return found + angle_warnings(lobes)


def check_lobes(lobes: Sequence[Lobe]) -> None:
    """Refuse lobes that hold no view of their own: on the zero order, or the same one twice.

    Raises
    ------
    ValueError
        In one sentence that counts the lobes from 1.
    """
    for index, lobe in enumerate(lobes):
        if math.hypot(*lobe.carrier) < TINY:
            msg = (
                f"lobe {index + 1} lies on the zero order, which holds no phase; give the carrier "
                "of a view, as find_lobes() finds it"
            )
            raise ValueError(msg)
        for number, other in enumerate(lobes[index + 1 :], start=index + 2):
            if pair_distance(lobe.carrier, other.carrier) < SAME * min(lobe.radius, other.radius):
                msg = (
                    f"lobes {index + 1} and {number} are the same view (or its conjugate); leave "
                    "one of them out"
                )
                raise ValueError(msg)


def lobe_doubts(lobes: Sequence[Lobe]) -> list[str]:
    """Say which lobes hold much that may be no view of theirs; "lobe 1" is the first.

    They reach beyond the spectrum or over the zero order, or one of three is the beat of the other
    two. Which one it is, places don't tell: if k3 = k1 - k2, then k2 = k1 - k3.
    """
    beats = stray_terms(lobes)[1:]
    found, triples = [], set()
    for index, lobe in enumerate(lobes):
        name, smaller = f"lobe {index + 1}", "make its radius smaller"
        if max(abs(k) for k in lobe.carrier) + lobe.radius > 0.5 + TINY:
            found.append(f"{name} reaches beyond the edge of the spectrum; {smaller}")
        elif math.hypot(*lobe.carrier) < lobe.radius:
            found.append(f"{name} reaches over the zero order; {smaller}")
        triples |= {tuple(sorted((index, *pair))) for pair in pairs_within(index, lobe, beats)}
    return found + [
        f"one of lobes {i + 1}, {j + 1} and {k + 1} lies where the other two interfere with each "
        "other, so that its phase may be a mixture or that of no view; leave it out, most often "
        "the weakest"
        for i, j, k in sorted(triples)
    ]


def pairs_within(index: int, lobe: Lobe, beats: Sequence[StrayTerm]) -> list[tuple[int, int]]:
    """Return which two other views have the middle of their beat, or its conjugate, in a lobe."""
    pairs = [beat.pair for beat in beats if beat.pair and beat.hides_under(lobe)]
    return [pair for pair in pairs if index not in pair]


def place_warnings(index: int, lobe: Lobe, zero_order: StrayTerm) -> list[str]:
    """Say where a circle lies too near to the middle or to the edges of the spectrum."""
    found = []
    if max(abs(k) for k in lobe.carrier) + lobe.radius > 0.5 + TINY:
        found.append(
            f"Circle {index + 1} reaches beyond the edge of the spectrum: "
            "make it smaller or move it inwards."
        )
    if zero_order.disturbs(lobe):
        found.append(
            f"Circle {index + 1} overlaps the zero order: make it smaller or move it outwards."
        )
    elif wrapped_distance(lobe.carrier, [-k for k in lobe.carrier]) < 2 * lobe.radius - TINY:
        found.append(
            f"Circle {index + 1} overlaps its own conjugate (dashed): "
            "make it smaller or move it inwards."
        )
    return found


def neighbour_warnings(index: int, lobes: Sequence[Lobe]) -> list[str]:
    """Say which of the circles after it, or of their conjugates, a circle overlaps."""
    lobe = lobes[index]
    circles, conjugates = [], []
    for number, other in enumerate(lobes[index + 1 :], start=index + 2):
        reach = lobe.radius + other.radius - TINY
        if wrapped_distance(lobe.carrier, other.carrier) < reach:
            circles.append(number)
        elif pair_distance(lobe.carrier, other.carrier) < reach:
            conjugates.append(number)
    advice = "make them smaller or move them apart."
    found = []
    if circles:
        found.append(f"Circle {index + 1} overlaps {named('circle', circles)}: {advice}")
    if conjugates:
        others = named("circle", conjugates)
        found.append(f"Circle {index + 1} overlaps the conjugate (dashed) of {others}: {advice}")
    return found


def beat_warnings(index: int, lobe: Lobe, beats: Sequence[StrayTerm]) -> list[str]:
    """Say where two views interfere with each other at the place of a circle."""
    inside = pairs_within(index, lobe, beats)
    near = [beat.pair for beat in beats if beat.pair and beat.disturbs(lobe)]
    within = [f"{i + 1} and {j + 1}" for i, j in inside]
    beside = [f"{i + 1} and {j + 1}" for i, j in near if (i, j) not in inside]
    found = []
    if within:
        found.append(
            f"Circle {index + 1} lies on {beats_of(within)}: "
            "it may be no view of its own; move or remove it."
        )
    if beside:
        found.append(
            f"Circle {index + 1} overlaps {beats_of(beside)}: make it smaller or move it away."
        )
    return found


def beats_of(pairs: Sequence[str]) -> str:
    """Return "the beat of circles 1 and 2" or "the beats of circles 1 and 2, 1 and 3"."""
    return f"the beat{'s' if len(pairs) > 1 else ''} of circles {', '.join(pairs)}"


def angle_warnings(lobes: Sequence[Lobe]) -> list[str]:
    """Say which circles have the same viewing angle, and the same wavelength."""
    by_angle: dict[tuple[float, float | None], list[int]] = {}
    for number, lobe in enumerate(lobes, start=1):
        by_angle.setdefault((lobe.angle_deg, lobe.wavelength_um), []).append(number)
    return [
        f"{named('Circle', numbers)} have the same angle ({angle:g}°): "
        "type in their angles, or all views will be numbered."
        for (angle, _), numbers in by_angle.items()
        if len(numbers) > 1
    ]


def angles_unknown(lobes: Sequence[Lobe]) -> bool:
    """Say whether views are only numbered, 0, 1, 2 ..., as they are until angles are given.

    Parameters
    ----------
    lobes : sequence of Lobe
        The views. One alone needs no angle.

    Examples
    --------
    >>> angles_unknown([Lobe((0.2, 0.2), 0.1, 0), Lobe((-0.2, 0.2), 0.1, 1)])
    True
    >>> angles_unknown([Lobe((0.2, 0.2), 0.1, -7), Lobe((-0.2, 0.2), 0.1, 21)])
    False
    """
    return views_are_numbered([lobe.angle_deg for lobe in lobes])


def in_order_of_angle(lobes: Sequence[Lobe]) -> tuple[list[Lobe], list[float]]:
    """Return the lobes sorted by angle, and their angles (numbers if not all differ).

    Views of one angle that differ in wavelength follow each other by it.
    """

    def place(lobe: Lobe) -> tuple[float, float]:
        return lobe.angle_deg, lobe.wavelength_um or 0.0

    if len({place(lobe) for lobe in lobes}) < len(lobes):
        return list(lobes), [float(i) for i in range(len(lobes))]
    ordered = sorted(lobes, key=place)
    return ordered, [lobe.angle_deg for lobe in ordered]


def with_wavelengths(lobes: Sequence[Lobe], wavelength_um: float) -> list[Lobe]:
    """Return lobes each of which names its wavelength, or none if that is the recording's.

    Where all of them name that of the recording, they keep it: it stays theirs if the recording
    gets another.

    Parameters
    ----------
    lobes : sequence of Lobe
        The views.
    wavelength_um : float
        What those have that name none, in micrometres.

    Returns
    -------
    list of Lobe
        In the same order.
    """
    light = [lobe.wavelength_um or wavelength_um for lobe in lobes]
    named = all(lobe.wavelength_um is not None for lobe in lobes)
    unnamed = not named and set(light) == {wavelength_um}
    return [
        replace(lobe, wavelength_um=None if unnamed else own)
        for lobe, own in zip(lobes, light, strict=True)
    ]


def light_of(
    lobes: Sequence[Lobe], wavelength_um: float
) -> tuple[NDArray[np.float64], list[float]]:
    """Return the wavelength and the angle of each view, in the order of a reconstruction.

    Parameters
    ----------
    lobes : sequence of Lobe
        The views.
    wavelength_um : float
        What those have that name none, in micrometres.

    Returns
    -------
    ndarray of shape (view,), list of float
        Wavelengths in micrometres, and angles in degrees (numbers if not all views differ).
    """
    ordered, angles = in_order_of_angle(with_wavelengths(lobes, wavelength_um))
    return np.array([lobe.wavelength_um or wavelength_um for lobe in ordered]), angles


def one_wavelength(lobes: Sequence[Lobe], wavelength_um: float) -> float | None:
    """Return the wavelength of all views in micrometres, None if they differ in it."""
    light = {lobe.wavelength_um or wavelength_um for lobe in lobes}
    return light.pop() if len(light) == 1 else None


def named(word: str, numbers: Sequence[int]) -> str:
    """Return "circle 2", "circles 2 and 3" or "circles 2, 3 and 4"."""
    if len(numbers) == 1:
        return f"{word} {numbers[0]}"
    first = ", ".join(str(n) for n in numbers[:-1])
    return f"{word}s {first} and {numbers[-1]}"
