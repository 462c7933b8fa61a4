"""Steps from pixel to pixel, as all wavelengths of an angle see them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["AlongAxis", "Steps", "steps_between", "wrapped_to_turn"]

Image = NDArray[np.float32]

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


def wrapped_to_turn(phase: NDArray[np.floating]) -> Image:
    """Return phase within half a turn of zero."""
    found: Image = (phase - TURN * np.rint(phase / TURN)).astype(np.float32)
    return found
