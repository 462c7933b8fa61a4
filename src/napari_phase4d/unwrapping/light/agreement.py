"""How well the wavelengths of an angle agree on an unwrapped phase, by whichever method."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.compiling import compiled
from napari_phase4d.stack import Block
from napari_phase4d.unwrapping.light.alignment import views_apart
from napari_phase4d.unwrapping.light.steps import SHARED, STAYS
from napari_phase4d.unwrapping.light.synthetic import Group, groups_of, scene_of
from napari_phase4d.unwrapping.light.views import noise_between
from napari_phase4d.unwrapping.neighbours import ends_along
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["odds_by_wavelengths"]

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

TURN = np.float32(2 * np.pi)
#: So many pixels to each side are asked with a pixel, if their phase is within half a turn of it.
REACH = 2
#: Views of two wavelengths lie within so many pixels of each other, blur included: where phase is
#: steep they differ by more than noise. Chosen among 0.05 to 0.2 on recordings through the optics.
APART = 0.1
#: Turns that a result may be off, beside none.
OTHERS = (-2, -1, 1, 2)
#: The logarithm of the factor by which wavelengths change the odds is no further from 0 than this.
SUREST = 14.0


def odds_by_wavelengths(problem: Problem, unwrapped: Image, block: Block) -> Image:
    """Return the factor by which wavelengths change the odds that each wrap count is right.

    Every angle must have several, see `all_wavelengths_known`.

    The difference of the unwrapped phases at two wavelengths is that of their synthetic one. It
    predicts each of them, and is off by a turn where a count is wrong. How far it is off is
    averaged over the pixels round it that belong to the same part, as their phase is near; of the
    steep ones it means little, where views of two wavelengths never quite lie on each other. What
    is wrong by one and the same path at all wavelengths, a whole synthetic wavelength, they can't
    tell. Views that say nothing in a frame are not asked. Nor is any view of an angle where one of
    them shows no empty field in that frame: the light of each wavelength drifts by itself, and
    only the field tells by how much; nor any of an angle whose views are shifted against each
    other, see `views_apart`: they speak of other places.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    unwrapped : ndarray of shape (time, view, y, x)
        Some times of a result of any method, radians.
    block : Block
        Which times.

    Returns
    -------
    ndarray of float32, same shape
        Above 1 where they agree; 0 where what is seen has no partner at another wavelength; NaN in
        frames in which none is asked.
    """
    groups = groups_of(problem, 0.0)
    scene = scene_of(problem, groups)
    about_zero = unwrapped - scene.ground(block)
    odds = np.zeros_like(unwrapped)
    shifted = {view for pair in views_apart(problem) for view in pair.views}
    for group in groups:
        if shifted.intersection(group.views):
            odds[:, list(group.views)] = np.nan
            continue
        for time in range(len(unwrapped)):
            seen = group.without(scene.lost[block.start + time])
            views = list(seen.views)
            if len(views) < 2:
                continue
            if not scene.background.shown[block.start + time, views].all():
                odds[time, views] = np.nan
                continue
            known = np.isfinite(about_zero[time, views]).all(axis=0)
            found = odds_of_frame(seen, np.nan_to_num(about_zero[time, views]), known)
            odds[time, views] = found
    return odds


def odds_of_frame(group: Group, phases: Image, known: Mask) -> Image:
    """Return the same factor for all views of a frame; 0 where not all are known."""
    shortest = phases[int(np.argmin(group.light))]
    against = np.zeros_like(shortest)
    steepest = np.maximum(steepest_step(shortest, known) - 3 * group.noise, 0)
    for coarse, fine in pairwise(group.ladder):
        scale = np.float32(coarse.wavelength_um / fine.wavelength_um)
        off = (scale * coarse.phase(phases) - fine.phase(phases)) / TURN
        each = noise_between(coarse, fine)  # turns for each radian in a view
        wrong = np.zeros_like(against)
        odds_against(
            off.astype(np.float32),
            shortest,
            known,
            (APART * each * steepest).astype(np.float32),
            ((each * group.noise) ** 2, STAYS**2, SHARED),
            wrong,
        )
        against = against + wrong + against * wrong  # right in all choices, or wrong
    # Where nothing is known each choice is as likely wrong as right, and the odds stay.
    against /= 2 ** (len(group.ladder) - 1) - 1
    odds = 1 / np.clip(against, math.exp(-SUREST), math.exp(SUREST))
    return np.where(known, odds, np.float32(0)).astype(np.float32)


def steepest_step(phase: Image, known: Mask) -> Image:
    """Return the largest step from each pixel of a frame to its four neighbours, if known."""
    found = np.zeros_like(phase)
    for axis in (0, 1):
        head, tail = ends_along(axis, 2)
        step = np.abs(np.diff(phase, axis=axis)) * (known[head] & known[tail])
        for end in (head, tail):
            found[end] = np.maximum(found[end], step)
    return found


@compiled
def odds_against(
    off: Image,
    phase: Image,
    known: Mask,
    steep: Image,
    noise: tuple[float, float, float],
    odds: Image,
) -> None:
    """Write the odds that the count of each pixel of a frame is some turns off, against none.

    Of the other counts all are as likely beforehand, and together as the one there is.

    Parameters
    ----------
    off : ndarray of shape (y, x)
        Turns by which the prediction is off.
    phase : ndarray of shape (y, x)
        Radians; what is more than half a turn away belongs to another part.
    known : ndarray of bool, shape (y, x)
        Pixels that count.
    steep : ndarray of shape (y, x)
        Turns by which views may be off each other for their steepness.
    noise : tuple of float
        Variance of the prediction in turns squared, what no average takes off it, and how many
        pixels share their noise.
    odds : ndarray of float32, shape (y, x)
        Written, where known.
    """
    height, width = off.shape
    single, stays, shared = noise
    # What is further off each other lies on either side of a wall that the phase does not show.
    apart = max(0.5, 3 * math.sqrt(single))
    for y in range(height):
        for x in range(width):
            if not known[y, x]:
                continue
            weights = mean = left = 0.0
            for j in range(max(0, y - REACH), min(height, y + REACH + 1)):
                for i in range(max(0, x - REACH), min(width, x + REACH + 1)):
                    if (
                        known[j, i]
                        and abs(phase[j, i] - phase[y, x]) < np.pi
                        and abs(off[j, i] - off[y, x]) < apart
                    ):
                        variance = steep[j, i] * steep[j, i]
                        weight = 1 / (single + stays + variance)
                        weights += weight
                        mean += weight * off[j, i]
                        left += weight * variance
            mean /= weights
            own = single + stays + steep[y, x] * steep[y, x]
            # Of noise an average leaves less, of views that are apart it does not.
            variance = min(shared / weights, own) + stays + left / weights
            total = 0.0
            for turns in OTHERS:
                likelier = (mean * mean - (mean - turns) ** 2) / (2 * variance)
                total += math.exp(min(max(likelier, -SUREST), SUREST))
            odds[y, x] = total / len(OTHERS)
