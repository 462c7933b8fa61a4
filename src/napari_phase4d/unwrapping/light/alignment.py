"""Whether the views of an angle at several wavelengths lie on each other, pixel by pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block
from napari_phase4d.unwrapping.light.steps import wrapped_to_turn
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.words import warn

__all__ = ["ViewsApart", "views_apart", "warn_of_views_apart"]

Image = NDArray[np.float32]

#: Name under which a problem notes what `views_apart` found.
VIEWS_APART = "views_apart"
#: Frames that are looked at, evenly over time.
FRAMES = 8
#: Slopes must be so much alike where they fit best. Those of noise alone reach 0.12 by chance in
#: frames of 96 x 120 pixels, and less in larger ones; those of cells and plates have 0.2 to 1.
ALIKE = 0.15
#: ... and so many times more than where the views lie. It is 1.03 or more for a shift of one
#: pixel, and 1.01 for half of one, which is as near as whole pixels tell.
ALIKER = 1.02
#: Views are looked for within this part of a frame's shorter side: further off, plates of another
#: height are found, whose walls one wavelength shows and the other does not.
REACH = 1 / 8
#: Where they lie they are most alike, it may be, among so many pixels to each side. They fit then,
#: whatever else is like them further off.
NEAR = 2
#: Slopes are averaged over so many pixels, of which noise has less than objects.
SMOOTH_PX = 1.0


@dataclass(frozen=True)
class ViewsApart:
    """Two views of an angle that are shifted against each other.

    Parameters
    ----------
    angle_deg : float
        Their angle in degrees.
    views : tuple of int
        Their numbers.
    wavelengths_um : tuple of float
        Their wavelengths in micrometres.
    shift : tuple of int
        Pixels (down, right) by which the second lies off the first.
    """

    angle_deg: float
    views: tuple[int, int]
    wavelengths_um: tuple[float, float]
    shift: tuple[int, int]


def views_apart(problem: Problem) -> list[ViewsApart]:
    """Return which views of an angle lie off its first one by a pixel or more.

    The slopes of the phase lie at the same places whatever the wavelength, and wrapping leaves
    them alone where they are not steep. Where they are as like each other as can be, by their
    cross-correlation over some frames together, the views lie on each other. Objects must be
    seen in both for that: of empty views, or of those in which noise hides the slopes, nothing
    is told.

    Parameters
    ----------
    problem : Problem
        Views of several wavelengths.
    """
    return problem.once(VIEWS_APART, lambda: found_apart(problem))


def warn_of_views_apart(problem: Problem) -> None:
    """Warn of views that lie off each other."""
    apart = views_apart(problem)
    if not apart:
        return
    said = "; ".join(
        f"at angle {pair.angle_deg:g}, {pair.wavelengths_um[1]:g} um lies "
        f"{pair.shift[0]:+d} px down and {pair.shift[1]:+d} px right of "
        f"{pair.wavelengths_um[0]:g} um"
        for pair in apart
    )
    warn(
        f"views of several wavelengths do not lie on each other: {said}; synthetic-wavelength "
        "goes wrong by whole turns at slopes and edges then, so move the views onto each other "
        "before, or use another method"
    )


def found_apart(problem: Problem) -> list[ViewsApart]:
    """Return the same, looked for anew."""
    wavelengths, lost = problem.wavelengths_um, problem.lost()
    assert wavelengths is not None
    found = []
    for angle in np.unique(problem.angles_deg):
        first, *others = np.flatnonzero(problem.angles_deg == angle).tolist()
        for other in others:
            seen = np.flatnonzero(~lost[:, first] & ~lost[:, other])
            times = np.unique(seen[np.linspace(0, len(seen) - 1, FRAMES).astype(int)])
            shift = shift_between(problem, first, other, times.tolist()) if len(seen) else (0, 0)
            if shift != (0, 0):
                light = (float(wavelengths[first]), float(wavelengths[other]))
                found.append(ViewsApart(float(angle), (first, other), light, shift))
    return found


def shift_between(problem: Problem, first: int, other: int, times: list[int]) -> tuple[int, int]:
    """Return by how many pixels (down, right) one view lies off another; 0 if it can't be told."""
    from scipy import fft

    height, width = problem.given.shape[2:]
    if min(height, width) < 3:
        return 0, 0
    power: NDArray[np.complexfloating] | float = 0.0
    strengths = np.zeros(2)
    for time in times:
        wrapped, usable = problem.given.read(Block(time, time + 1))
        both = [slopes(wrapped[0, view], usable[0, view]) for view in (first, other)]
        strengths += [float(np.vdot(one, one)) for one in both]
        spectra = [fft.rfft2(one) for one in both]
        power = power + np.conj(spectra[0]) * spectra[1]
    strength = math.sqrt(strengths.prod())
    if not strength:
        return 0, 0
    alike = fft.fftshift(fft.irfft2(power, s=(height - 1, width - 1)) / strength)
    zero = (height - 1) // 2, (width - 1) // 2
    here = float(alike[zero])
    if here >= ALIKE and here >= around(alike, zero, NEAR).max():
        return 0, 0
    looked_at = around(alike, zero, max(1, int(REACH * min(height, width))))
    best = np.unravel_index(int(looked_at.argmax()), looked_at.shape)
    if looked_at[best] < ALIKE or looked_at[best] < ALIKER * here:
        return 0, 0
    down, right = (int(i) - n // 2 for i, n in zip(best, looked_at.shape, strict=True))
    return down, right


def around(values: NDArray[np.floating], place: tuple[int, int], reach: int) -> Image:
    """Return what lies round a place in an image, so far to each side at most."""
    far = min(reach, *place, *(n - 1 - i for i, n in zip(place, values.shape, strict=True)))
    found: Image = values[tuple(slice(i - far, i + far + 1) for i in place)]
    return found


def slopes(wrapped: Image, usable: NDArray[np.bool_]) -> Image:
    """Return how steep the phase of a frame is, less its mean; 0 beside what is not known.

    Its shape is (y - 1, x - 1).
    """
    from scipy import ndimage

    down = wrapped_to_turn(np.diff(wrapped, axis=0))[:, :-1]
    right = wrapped_to_turn(np.diff(wrapped, axis=1))[:-1]
    known = usable[:-1, :-1] & usable[1:, :-1] & usable[:-1, 1:]
    steep = np.where(known, np.hypot(down, right), np.float32(0))
    steep = ndimage.gaussian_filter(steep, SMOOTH_PX)
    mean = steep[known].mean() if known.any() else 0.0
    found: Image = np.where(known, steep - mean, 0).astype(np.float32)
    return found
