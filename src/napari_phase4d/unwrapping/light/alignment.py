"""Whether the views of an angle at several wavelengths lie on each other, pixel by pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block
from napari_phase4d.task import UNWATCHED, Task, Watch
from napari_phase4d.unwrapping.light.steps import wrapped_to_turn
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.warned import warn

__all__ = ["ViewsApart", "views_apart", "warn_of_views_apart"]

Image = NDArray[np.float32]

#: Name under which a problem notes what `views_apart` found.
VIEWS_APART = "views_apart"
#: Frames that are looked at, evenly over time: at most, at least, and as many as have so many
#: pixels together. Of large frames few are enough, for each has many slopes.
FRAMES, LEAST_FRAMES, PIXELS = 8, 2, 1_000_000
#: Slopes must be so much alike where they fit best; those of cells and plates are 0.2 to 1 ...
ALIKE = 0.15
#: ... or more, if those of noise could be by chance: in n pixels they are about 2.6 / sqrt(n).
BY_CHANCE = 18.0
#: They must be so many times more alike than where the views lie. It is 1.03 or more for a shift
#: of one pixel, and 1.01 for half of one, which is as near as whole pixels tell ...
ALIKER = 1.02
#: ... and by so much more, of n pixels again, since noise moves the best place to one beside it.
MORE_BY_CHANCE = 4.0
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

    @property
    def place(self) -> str:
        """Where the second lies, in words between the two."""
        return f"lies {self.shift[0]:+d} px down and {self.shift[1]:+d} px right of"


def views_apart(problem: Problem, task: Task = UNWATCHED) -> list[ViewsApart]:
    """Return which views of an angle lie off its first one by a pixel or more.

    The slopes of the phase lie at the same places whatever the wavelength, and wrapping leaves
    them alone where they are not steep. Where they are as like each other as can be, by their
    cross-correlation over some frames together, the views lie on each other. Objects must be
    seen in both for that: of empty views, or of those in which noise hides the slopes, nothing
    is told.

    Parameters
    ----------
    problem : Problem
        Where not every angle has several wavelengths, there is none to find.
    task : Task, optional
        Who is told of it, and may stop it.
    """
    return problem.once(VIEWS_APART, lambda: found_apart(problem, task))


def warn_of_views_apart(problem: Problem, task: Task) -> None:
    """Warn of views that lie off each other."""
    apart = views_apart(problem, task)
    if not apart:
        return
    said = "; ".join(
        f"at angle {pair.angle_deg:g}, {pair.wavelengths_um[1]:g} um {pair.place} "
        f"{pair.wavelengths_um[0]:g} um"
        for pair in apart
    )
    warn(
        f"views of several wavelengths do not lie on each other: {said}; synthetic-wavelength "
        "goes wrong by whole turns at slopes and edges then, so move the views onto each other "
        "before, or use another method"
    )


def found_apart(problem: Problem, task: Task) -> list[ViewsApart]:
    """Return the same, looked for anew."""
    wavelengths = problem.wavelengths_um
    if wavelengths is None or len(np.unique(wavelengths)) < 2:
        return []
    lost = problem.lost(task)
    _, n_views, height, width = problem.given.shape
    most = max(LEAST_FRAMES, min(FRAMES, PIXELS // max(height * width, 1)))
    angles = np.unique(problem.angles_deg)
    n_pairs = n_views - len(angles)
    watch = Watch(n_pairs * most, "holding wavelengths against each other", task)
    found = []
    for angle in angles:
        first, *others = np.flatnonzero(problem.angles_deg == angle).tolist()
        for other in others:
            seen = np.flatnonzero(~lost[:, first] & ~lost[:, other])
            some = np.unique(np.linspace(0, len(seen) - 1, min(most, len(seen))).astype(int))
            shift = shift_between(problem, (first, other), seen[some].tolist(), watch)
            if shift != (0, 0):
                light = (float(wavelengths[first]), float(wavelengths[other]))
                found.append(ViewsApart(float(angle), (first, other), light, shift))
    return found


def shift_between(
    problem: Problem, views: tuple[int, int], times: list[int], watch: Watch
) -> tuple[int, int]:
    """Return by how many pixels (down, right) one view lies off another; 0 if it can't be told."""
    from scipy import fft

    height, width = problem.given.shape[2:]
    if min(height, width) < 3:
        return 0, 0
    size = [fft.next_fast_len(n - 1, real=True) for n in (height, width)]
    power = np.zeros((size[0], size[1] // 2 + 1), np.complex128)
    strengths, n_known = np.zeros(2), 0
    for time in times:
        wrapped, usable = problem.given.read(Block(time, time + 1))
        known = usable[0, views[0]] & usable[0, views[1]]
        both = [slopes(wrapped[0, view], known) for view in views]
        strengths += [float(np.vdot(one, one)) for one in both]
        n_known += int(np.count_nonzero(known))
        spectra = [fft.rfft2(one, s=size) for one in both]
        power += np.conj(spectra[0]) * spectra[1]
        watch.step()
    strength = math.sqrt(strengths.prod())
    if not strength:
        return 0, 0
    alike = fft.fftshift(fft.irfft2(power, s=size) / strength)
    return best_shift(alike, max(1, int(REACH * min(height, width))), 1 / math.sqrt(n_known))


def best_shift(alike: NDArray[np.floating], reach: int, chance: float) -> tuple[int, int]:
    """Return where a cross-correlation is largest, from its middle; 0 if that tells nothing.

    Parameters
    ----------
    alike : ndarray of shape (y, x)
        From -1 to 1; no shift in the middle.
    reach : int
        How far to look.
    chance : float
        One by the root of the number of pixels that it was computed from.
    """
    zero = alike.shape[0] // 2, alike.shape[1] // 2
    here = float(alike[zero])
    least = max(ALIKE, BY_CHANCE * chance)
    if here >= least and here >= around(alike, zero, NEAR).max():
        return 0, 0
    looked_at = around(alike, zero, reach)
    far = len(looked_at) // 2
    best = np.unravel_index(int(looked_at.argmax()), looked_at.shape)
    most = float(looked_at[best])
    down, right = (int(i) - far for i in best)
    # What is largest where the looking ends is largest further off.
    at_the_end = max(abs(down), abs(right)) == far
    if at_the_end or most < least or most < max(ALIKER * here, here + MORE_BY_CHANCE * chance):
        return 0, 0
    return down, right


def around(values: NDArray[np.floating], place: tuple[int, int], reach: int) -> Image:
    """Return what lies round a place in an image, so far to each side at most."""
    far = min(reach, *place, *(n - 1 - i for i, n in zip(place, values.shape, strict=True)))
    found: Image = values[tuple(slice(i - far, i + far + 1) for i in place)]
    return found


def slopes(wrapped: Image, known: NDArray[np.bool_]) -> Image:
    """Return how steep the phase of a frame is, less its mean; 0 beside what is not known.

    A tilt of the frame, which may be another one in each view, is taken off before: it would light
    hills from one side. The shape is (y - 1, x - 1).
    """
    from scipy import ndimage

    known = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:]
    if not known.any():
        return np.zeros(known.shape, np.float32)
    steps = np.diff(wrapped, axis=0)[:, :-1], np.diff(wrapped, axis=1)[:-1]
    level = [wrapped_to_turn(step - np.angle(np.exp(1j * step[known]).mean())) for step in steps]
    steep = ndimage.gaussian_filter(np.where(known, np.hypot(*level), np.float32(0)), SMOOTH_PX)
    found: Image = np.where(known, steep - steep[known].mean(), 0).astype(np.float32)
    return found
