"""How well the wavelengths of an angle agree on an unwrapped phase."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.stack import Block
from napari_phase4d.unwrapping.light.ladder import noise_between
from napari_phase4d.unwrapping.light.settling import SHARED, STAYS
from napari_phase4d.unwrapping.light.synthetic import (
    Group,
    groups_of,
    has_every_wavelength,
    scene_of,
)
from napari_phase4d.unwrapping.problem import Problem

__all__ = ["all_wavelengths_known", "chance_by_wavelengths"]

Image = NDArray[np.float32]

#: Width in pixels of the box that errors are averaged over.
BOX = 5
#: Share of pixels that are wrong by themselves, among neighbours that are right, before a look.
LONERS = 0.02
#: Turns that a result may be off, beside none.
OTHERS = (-2, -1, 1, 2)


def all_wavelengths_known(problem: Problem) -> bool:
    """Say whether every angle has several wavelengths, which can be held against each other."""
    return has_every_wavelength(problem.wavelengths_um, problem.angles_deg)


def chance_by_wavelengths(problem: Problem, unwrapped: Image, block: Block) -> Image:
    """Return the chance that each wrap count is right, by how far the wavelengths agree on it.

    Every angle must have several, see `all_wavelengths_known`.

    The difference of the unwrapped phases at two wavelengths is that of their synthetic one. It
    predicts each of them, and is off by a turn where a count is wrong, so that noise tells the
    chance, of the pixel and of the box of 5 x 5 round it. What is wrong by one and the same path
    at all wavelengths, a whole synthetic wavelength, they can't tell.

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
        From 0 to 1.
    """
    groups = groups_of(problem, 0.0)
    ground = scene_of(problem, groups).ground(block)
    about_zero = unwrapped - ground
    chance = np.ones_like(unwrapped)
    for group in groups:
        views = list(group.views)
        for time in range(len(unwrapped)):
            known = np.isfinite(about_zero[time, views]).all(axis=0)
            found = chance_of_frame(group, np.nan_to_num(about_zero[time, views]), known)
            chance[time, views] = found
    return chance


def chance_of_frame(group: Group, phases: Image, known: NDArray[np.bool_]) -> Image:
    """Return the chance that the counts of all views of a frame are right."""
    chance = np.ones(phases.shape[1:], dtype=np.float32)
    weight = np.maximum(ndimage.uniform_filter(known.astype(np.float32), BOX), 1e-6)
    for coarse, fine in pairwise(group.ladder):
        scale = np.float32(coarse.wavelength_um / fine.wavelength_um)
        off = (scale * coarse.phase(phases) - fine.phase(phases)) / np.float32(2 * np.pi)
        off = np.where(known, off, np.float32(0))
        noise = noise_between(coarse, fine) * group.noise
        mean = ndimage.uniform_filter(off, BOX) / weight
        left = np.hypot(noise * np.sqrt(SHARED) / BOX, STAYS)
        chance *= likely(mean, left, 1.0) * likely(off - mean, np.hypot(noise, STAYS), LONERS)
    return np.where(known, chance, np.float32(0))


def likely(off: Image, noise: float, rate: float) -> Image:
    """Return the chance that what is off by some turns is off by none, but for noise."""
    against = np.zeros(off.shape, dtype=np.float64)
    for turns in OTHERS:
        odds = (off**2 - (off - turns) ** 2) / (2 * noise**2)
        against += rate * np.exp(np.clip(odds, -50, 50))
    found: Image = (1 / (1 + against)).astype(np.float32)
    return found
