"""Which curved surface the empty field has, where an object covers much of the view.

The smooth middle of a thick cell can be fitted as well as the field round it, and where it fills
most of the view it outvotes it. So several surfaces are tried, each from the slopes in three small
squares, and each is judged by how much of the view it explains. Pixels far from the middle count
most, since it is there that a view is empty. Where two surfaces explain about as much, or the one
that explains most leaves the corners to the object, nothing in the field tells which is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from napari_phase4d.holography.emptyfield import (
    fitted,
    joined_to_the_border,
    mode_phase,
    wrapped,
)

__all__ = ["LOOK_PIXELS", "Judgement", "Look", "curved_starts", "refined"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: A field is judged on about so many pixels.
LOOK_PIXELS = 4000
#: So many pixels along the border are not judged: there the lobe's window joins opposite sides.
BLURRED = 3
#: Below this share of the median amplitude there are no fringes to judge.
DARK_SHARE = 0.3
#: Beyond this distance, as a share of the largest, the level of the empty field is looked for.
OUTER = 0.6
#: A pixel is explained if it lies within so many radians of the surface.
EXPLAINED_RAD = 0.4
#: The end of a quarter of the view is its share farthest from the middle.
END = 0.1
#: It is explained if this share of its pixels is.
END_EXPLAINED = 0.7
#: While a surface is refined, its pixels deviate by less than this, in radians.
REFINING_RAD = (1.0, 0.8, 0.6, 0.5, 0.4, 0.4, 0.3, 0.3)
#: Below this share of such pixels a surface is left as it is.
FEW = 0.02
#: Slopes are looked at in a grid of so many squares each way.
SQUARES = 10
#: So many surfaces are tried on the squares, and so many of the best are looked at in pixels.
TRIALS, POLISHED, KEPT = 400, 100, 8
#: Slopes agree within this, and surfaces differ by more, in radians from the middle to the edge.
SLOPE_RAD, OTHER_SLOPE_RAD = 1.5, 1.0
#: Rounds in which a surface takes in the squares that agree with it.
POLISH_ROUNDS = 4


@dataclass(frozen=True)
class Judgement:
    """How much of a view a surface explains.

    Parameters
    ----------
    share : float
        From 0 to 1; pixels far from the middle count most, and those close to the surface.
    ends, of_ends : int
        How many of the view's lit ends are explained, and how many it has, up to 4.
    near : ndarray of bool, shape (y, x)
        The pixels of the coarse grid that are explained.
    rest : ndarray of shape (y, x)
        What the surface leaves, in radians, with the noise smoothed away.
    """

    share: float
    ends: int
    of_ends: int
    near: Mask
    rest: Array


class Look:
    """A coarse look at the phase of a field, to judge surfaces by.

    Parameters
    ----------
    mean : ndarray of shape (y, x)
        The field.
    step : int, optional
        Every so-manieth row and column is looked at; by default about 4000 pixels.

    Attributes
    ----------
    step : int
        Every so-manieth row and column of the field is looked at.
    phase : ndarray of shape (y, x)
        Its phase there, in radians.
    outer : ndarray of bool
        The lit pixels far from the middle.
    """

    def __init__(self, mean: NDArray[np.complex64], step: int | None = None) -> None:
        self.step = step or max(1, math.isqrt(mean.size // LOOK_PIXELS))
        seen = mean[:: self.step, :: self.step]
        self.phase: Array = np.angle(seen).astype(np.float64)
        self.lit: Mask = np.abs(seen) > DARK_SHARE * np.median(np.abs(seen))
        rows, columns = (np.arange(0, n, self.step) for n in mean.shape)
        to_border = np.minimum.outer(
            *(np.minimum(i, n - 1 - i) for i, n in zip((rows, columns), mean.shape, strict=True))
        )
        judged = self.lit & (to_border >= min(BLURRED, *(n // 8 for n in mean.shape)))
        y, x = (2 * i / (n - 1) - 1 for i, n in zip((rows, columns), mean.shape, strict=True))
        away = np.hypot(y[:, None], x[None, :])
        away /= max(float(away.max(where=judged, initial=0)), 1e-6)
        weights = np.where(judged, away, 0) ** 4
        self.weights: Array = weights / max(float(weights.sum()), 1e-12)
        self.outer: Mask = judged & (away > OUTER)
        quarters = [
            np.logical_and.outer(up, left) & judged
            for up in (y < 0, y >= 0)
            for left in (x < 0, x >= 0)
        ]
        self._ends = [q & (away > np.quantile(away[q], 1 - END)) for q in quarters if q.sum() > 9]

    def judged(self, surface: Array) -> Judgement:
        """Judge a surface (y, x) on the coarse grid."""
        rest = wrapped(self.phase - surface)
        rest = wrapped(rest - level_of(rest, self.outer))
        smooth = ndimage.uniform_filter(rest, 3)
        near = self.lit & reached(np.abs(smooth) < EXPLAINED_RAD, self.lit)
        close = np.where(near, 1 - (smooth / EXPLAINED_RAD) ** 2, 0)
        ends = sum(bool(near[end].mean() > END_EXPLAINED) for end in self._ends)
        share = float((close * self.weights).sum())
        return Judgement(share, ends, len(self._ends), near, smooth)


def level_of(rest: Array, outer: Mask) -> float:
    """Return the most frequent phase far from the middle, or of all where nothing is lit."""
    return mode_phase(rest[outer] if outer.any() else rest)


def reached(near: Mask, lit: Mask) -> Mask:
    """Keep the pixels that the border, or the dark round a lit disk, can reach."""
    return joined_to_the_border(near | ~lit) & near


def refined(found: Array, phase: Array, terms: Array, outer: Mask, lit: Mask) -> Array:
    """Return coefficients fitted to the pixels near a surface, with a tighter limit each time.

    The level is that of the pixels far from the middle: the flat top of an object may be more
    frequent than the empty field.
    """
    for limit in REFINING_RAD:
        rest = wrapped(phase - np.tensordot(found, terms, 1))
        rest = wrapped(rest - level_of(rest, outer))
        near = reached((np.abs(rest) < limit) & lit, lit)
        if near.mean() < FEW:
            break
        found = found + fitted(rest, near, terms)
    return found


def curved_starts(unit: NDArray[np.complexfloating]) -> list[Array]:
    """Return tilts with curvature that explain the slopes of many squares, the best first.

    Parameters
    ----------
    unit : ndarray of shape (y, x)
        The field, of amplitude 1.

    Returns
    -------
    list of ndarray
        Coefficients of 1, y, x, y^2, y x, x^2, with y and x from -1 to 1; at most 8 surfaces.
    """
    if min(unit.shape) < 3 * SQUARES:
        return []
    slopes, (y, x) = square_slopes(unit)
    none, one = np.zeros_like(y), np.ones_like(y)
    matrix = np.stack(
        [np.stack([one, none, 2 * y, x, none], 1), np.stack([none, one, none, y, 2 * x], 1)], 1
    )
    weights = (y**2 + x**2) ** 2 + 0.05
    weights /= weights.sum()
    squared = np.einsum("bij,bik->bjk", matrix, matrix)
    towards = np.einsum("bij,bi->bj", matrix, slopes)

    def misses(found: Array) -> Array:
        off: Array = slopes - np.einsum("bij,nj->nbi", matrix, found)
        return np.hypot(off[..., 0], off[..., 1])

    def agreeing(found: Array) -> Array:
        close: Array = np.maximum(1 - (misses(found) / SLOPE_RAD) ** 2, 0)
        return close

    def solutions(each: Array) -> Array:
        """Return the coefficients for weights (trial, square)."""
        normal = np.tensordot(each, squared, 1)
        right = each @ towards
        result: Array = np.linalg.solve(normal + 1e-9 * np.eye(5), right[..., None])[..., 0]
        return result

    rng = np.random.default_rng(0)
    # The three with the largest keys are three drawn without putting back.
    keys = np.log(rng.random((TRIALS, len(y)))) / weights
    chosen = np.zeros(keys.shape)
    np.put_along_axis(chosen, np.argpartition(keys, -3, axis=1)[:, -3:], 1.0, axis=1)
    found = solutions(chosen)
    found = found[np.argsort(-(agreeing(found) @ weights))[:POLISHED]]
    for _ in range(POLISH_ROUNDS):
        found = solutions(agreeing(found) ** 2 * weights)
    kept: list[Array] = []
    for one_found in found[np.argsort(-(agreeing(found) @ weights))]:
        if all(np.linalg.norm(one_found - other) > OTHER_SLOPE_RAD for other in kept):
            kept.append(one_found)
    return [np.concatenate([[0.0], each]) for each in kept[:KEPT]]


def square_slopes(unit: NDArray[np.complexfloating]) -> tuple[Array, tuple[Array, Array]]:
    """Return the mean slopes (square, axis) in a grid of squares, and where these lie.

    The phase of the summed products of neighbours needs no unwrapping.
    """
    here = unit[:-1, :-1].conj()
    sides = [np.linspace(0, n, SQUARES + 1).astype(int) for n in here.shape]
    slopes = []
    for ahead, n in ((unit[1:, :-1], unit.shape[0]), (unit[:-1, 1:], unit.shape[1])):
        products = ahead * here
        summed = np.add.reduceat(np.add.reduceat(products, sides[0][:-1], 0), sides[1][:-1], 1)
        slopes.append(np.angle(summed).ravel().astype(np.float64) * (n - 1) / 2)
    y, x = (
        (side[:-1] + side[1:]) / (n - 1) - 1 for side, n in zip(sides, unit.shape, strict=True)
    )
    middles = np.meshgrid(y, x, indexing="ij")
    return np.stack(slopes, axis=1), (middles[0].ravel(), middles[1].ravel())
