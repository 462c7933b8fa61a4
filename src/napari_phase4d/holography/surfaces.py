"""Which curved surface the empty field of a view has, and how surely it is not the object's.

The smooth middle of a thick cell can be fitted as well as the field round it, and where it fills
most of the view it outvotes it. So several surfaces are tried, each from the slopes in three small
squares, and each is judged by how much of the view it explains. Pixels far from the middle count
most, since it is there that a view is empty. Where two surfaces explain about as much, or the one
that explains most leaves the corners to the object, nothing in the field tells which is right.

A smooth object that fills the view bends as a field does, and a surface comes near to all of it.
But it lies on nothing: what it leaves is bent still. The empty field leaves next to nothing, above
all along the border, and an object on it has an edge. `may_be_the_object` weighs this.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.holography.aberrations import terms_at
from napari_phase4d.holography.emptyfield import fitted, joined_to_the_border, mode_phase, wrapped
from napari_phase4d.holography.quality import alike_around

__all__ = [
    "DARK_SHARE",
    "LEAST_SIDE",
    "LOOK_PIXELS",
    "Judgement",
    "Look",
    "bright_level",
    "curved_starts",
    "lit_part",
    "lit_pixels",
    "may_be_the_object",
    "reached",
    "refined",
    "tightened",
]


Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: A field is judged on about so many pixels.
LOOK_PIXELS = 4000
#: So many pixels of a view along its border are not judged: there the lobe's window joins opposite
#: sides.
BLURRED = 3
#: Below this share of the usual amplitude there are no fringes to judge.
DARK_SHARE = 0.3
#: The usual amplitude is the median, unless that is less than so much of what is bright, the 90 %
#: quantile: then half of the view or more is dark, and the median is that of noise.
MOSTLY_DARK, BRIGHT = 0.5, 0.9
#: Whether a part is lit is told by the mean over so many pixels a side: a rim is no dark part.
LIT_PIXELS = 5
#: Light that is dim hangs together: its phase is more alike to itself some pixels on than this.
ALIKE = 0.8
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
#: At last, as far as noise allows: no limit is tighter than so many standard deviations of it.
TIGHT_RAD = (0.3, 0.25, 0.2, 0.2, 0.15, 0.15, 0.12, 0.12)
TIGHTEST_NOISE = 3.0
#: With less than this share of a view near it a surface is not tightened.
FEW_TIGHT = 0.05
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


def bright_level(size: NDArray[np.floating]) -> float:
    """Return the usual amplitude where there is light, as beyond an aperture there is none."""
    middle, bright = float(np.median(size)), float(np.quantile(size, BRIGHT))
    return bright if middle < MOSTLY_DARK * bright else middle


def lit_part(field: NDArray[np.complexfloating]) -> Mask:
    """Mark the parts of a field (y, x) that have light; elsewhere its phase is noise.

    Single dark pixels, as at the rim of an object, are in lit parts, and so is what is dim but
    hangs together, as the border of a beam that fades. All of a field without any light is marked.
    """
    size = np.abs(field)
    dark = DARK_SHARE * bright_level(size)
    found: Mask = scipy.ndimage.uniform_filter(size, LIT_PIXELS) > dark
    if not found.all():
        found |= phase_alike(field) > ALIKE
    return found if found.any() else np.ones_like(found)


def lit_pixels(field: NDArray[np.complexfloating], part: Mask) -> Mask:
    """Mark the single pixels of a field (y, x) that have light, by the parts that have."""
    size = np.abs(field)
    in_part = part & (size > DARK_SHARE * float(np.median(size)))
    found: Mask = in_part | (size > DARK_SHARE * bright_level(size))
    return found


def phase_alike(field: NDArray[np.complexfloating]) -> NDArray[np.float32]:
    """Return how alike the phase round every pixel is to itself some pixels on, however dim."""
    size = np.maximum(np.abs(field), np.finfo(np.float32).tiny)
    return alike_around(field / size, np.ones(field.shape, np.float32))


class Look:
    """A coarse look at the phase of a field, to judge surfaces by.

    Parameters
    ----------
    mean : ndarray of shape (y, x)
        The field.
    step : int, optional
        Every so-manieth row and column is looked at; by default about 4000 pixels.
    lit : ndarray of bool, shape (y, x), optional
        What `lit_part` gives for the field, where it is known already.

    Attributes
    ----------
    step : int
        Every so-manieth row and column of the field is looked at.
    phase : ndarray of shape (y, x)
        Its phase there, in radians.
    outer : ndarray of bool
        The lit pixels far from the middle.
    """

    def __init__(
        self, mean: NDArray[np.complex64], step: int | None = None, lit: Mask | None = None
    ) -> None:
        self.step = step or max(1, math.isqrt(mean.size // LOOK_PIXELS))
        seen = mean[:: self.step, :: self.step]
        self.phase: Array = np.angle(seen).astype(np.float64)
        lit = lit_part(mean) if lit is None else lit
        self._part = lit[:: self.step, :: self.step]
        self.lit: Mask = lit_pixels(seen, self._part)
        rows, columns = (np.arange(0, n, self.step) for n in mean.shape)
        to_border = np.minimum.outer(
            *(np.minimum(i, n - 1 - i) for i, n in zip((rows, columns), mean.shape, strict=True))
        )
        judged = self.lit & (to_border >= min(BLURRED, *(n // 8 for n in mean.shape)))
        # The edge of an aperture is half noise.
        judged &= scipy.ndimage.binary_erosion(self._part, border_value=1)
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
        smooth = smoothed(rest, self._part)
        near = self.lit & reached(np.abs(smooth) < EXPLAINED_RAD, self.lit)
        close = np.where(near, 1 - (smooth / EXPLAINED_RAD) ** 2, 0)
        ends = sum(bool(near[end].mean() > END_EXPLAINED) for end in self._ends)
        share = float((close * self.weights).sum())
        return Judgement(share, ends, len(self._ends), near, smooth)

    def averaged(self, surface: Array, side: int) -> Look:
        """Return the same look with less noise.

        Averaged are phasors less a surface (y, x), so that it blurs nothing that lies near to it,
        over so many pixels each way.
        """
        unit = self.lit * np.exp(1j * (self.phase - surface))  # what is dark says nothing
        mean = scipy.ndimage.uniform_filter(unit, side)
        found = copy(self)
        found.phase = np.angle(mean) + surface
        return found


def smoothed(rest: Array, part: Mask) -> Array:
    """Return what is left, averaged over the nearest pixels that are in the lit part."""
    if part.all():
        return scipy.ndimage.uniform_filter(rest, 3)  # type: ignore[no-any-return]
    share = scipy.ndimage.uniform_filter(part.astype(np.float64), 3)
    found: Array = scipy.ndimage.uniform_filter(rest * part, 3) / np.maximum(share, 1e-6)
    return found


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


def tightened(found: Array, look: Look, terms: Array) -> Array:
    """Return coefficients fitted once more, to pixels as close to the surface as noise allows.

    The soft foot of an object lies within the limits of `refined`, and bends the surface.
    """
    noise = pixel_noise(look, np.tensordot(found, terms, 1))
    for limit in TIGHT_RAD:
        if limit < TIGHTEST_NOISE * noise:
            break
        rest = wrapped(look.phase - np.tensordot(found, terms, 1))
        rest = wrapped(rest - level_of(rest, look.outer))
        near = reached((np.abs(rest) < limit) & look.lit, look.lit)
        if near.mean() < FEW_TIGHT:
            break
        found = found + fitted(rest, near, terms)
    return found


def pixel_noise(look: Look, surface: Array) -> float:
    """Return how much single pixels deviate from those round them, in radians."""
    rest = wrapped(look.phase - surface)
    rest = wrapped(rest - level_of(rest, look.outer))
    rough = np.abs(wrapped(rest - scipy.ndimage.uniform_filter(rest, 3)))[
        look.judged(surface).near
    ]
    return 1.57 * float(np.median(rough)) if rough.size else math.inf


def curved_starts(unit: NDArray[np.complexfloating], lit: Mask) -> list[Array]:
    """Return tilts with curvature that explain the slopes of many squares, the best first.

    Parameters
    ----------
    unit : ndarray of shape (y, x)
        The field, of amplitude 1.
    lit : ndarray of bool, shape (y, x)
        Its lit parts; squares count by how much of them is lit.

    Returns
    -------
    list of ndarray
        Coefficients of 1, y, x, y^2, y x, x^2, with y and x from -1 to 1; at most 8 surfaces.
    """
    if min(unit.shape) < 3 * SQUARES:
        return []
    slopes, (y, x) = square_slopes(unit)
    light = square_sums(lit[:-1, :-1].astype(np.float64)) / square_sums(np.ones(lit[1:, 1:].shape))
    none, one = np.zeros_like(y), np.ones_like(y)
    matrix = np.stack(
        [np.stack([one, none, 2 * y, x, none], 1), np.stack([none, one, none, y, 2 * x], 1)], 1
    )
    weights = ((y**2 + x**2) ** 2 + 0.05) * np.maximum(light.ravel(), 1e-6)
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
    sides = sides_of_squares(here.shape)
    slopes = []
    for ahead, n in ((unit[1:, :-1], unit.shape[0]), (unit[:-1, 1:], unit.shape[1])):
        summed = square_sums(ahead * here)
        slopes.append(np.angle(summed).ravel().astype(np.float64) * (n - 1) / 2)
    y, x = (
        (side[:-1] + side[1:]) / (n - 1) - 1 for side, n in zip(sides, unit.shape, strict=True)
    )
    middles = np.meshgrid(y, x, indexing="ij")
    return np.stack(slopes, axis=1), (middles[0].ravel(), middles[1].ravel())


def sides_of_squares(shape: tuple[int, ...]) -> list[NDArray[np.intp]]:
    """Return where the squares of the grid begin and end along each axis."""
    return [np.linspace(0, n, SQUARES + 1).astype(np.intp) for n in shape]


def square_sums(values: NDArray[Any]) -> NDArray[Any]:
    """Return the sum of values (y, x) in each square of the grid."""
    rows, columns = sides_of_squares(values.shape)
    found: NDArray[Any] = np.add.reduceat(np.add.reduceat(values, rows[:-1], 0), columns[:-1], 1)
    return found


# ---- whether it may be the object's ---------------------------------------------------------

#: A view with fewer pixels on a side, or a coarse look at it, shows too little to tell.
LEAST_SIDE = 24
#: What a surface leaves of an empty field, in radians, averaged over so many pixels each way.
EMPTY_RAD, VERY_EMPTY_RAD, AVERAGED = 0.08, 0.05, 5
#: Rows of the coarse look along the border in which that is looked for, and those outside of them
#: that are left out. These hold `BLURRED` and more: the clues were fitted so.
BORDER_ROWS, LEFT_OUT = 2, 3
#: Where single pixels deviate by more than this (rad), noise hides what a smooth object leaves.
NOISY_RAD = 0.04
#: Then the phasors of so many pixels each way are averaged: up to which noise, how many beyond.
AVERAGING, MOST_AVERAGED = ((0.12, 3), (0.25, 5)), 7
#: For each radian of noise beyond `NOISY_RAD` the limit of the odds rises by so much: as much as
#: leaves one or two in a hundred that are off untold, in noise of 0.05 to 0.3 rad.
ODDS_PER_RAD = 8.0
#: Roughness (rad) of a field that has texture of its own, if averaging leaves this share of it:
#: of such a field the corners alone are asked.
ROUGH_RAD, ROUGH_SHARE = 0.075, 0.8
#: Pixels within this of the surface are its core.
CORE_RAD = 0.2
#: Fewer pixels than this show no field, or no edge.
FEW_PIXELS, FEW_EDGE_PIXELS = 60, 10
#: The surface explained no more of the fields that the clues were fitted to.
MOST_EXPLAINED = 0.98
#: What the clues add to the logarithm of the odds that a surface is off by more than 0.3 rad, in
#: the order of `odds_of_object`. Fitted to 2100 objects of twelve shapes that cover 10 to 92 %
#: of a bent field.
ODDS = np.array([-0.754, -2.209, 0.607, -0.522, -1.465, 1.145, -0.519])
NO_ODDS = -1.068
#: A chance above this is told.
MAY_BE = 0.065


def may_be_the_object(look: Look, surface: Array, first: Judgement) -> bool:
    """Say whether a surface may be the object's.

    Parameters
    ----------
    look : Look
        The field.
    surface : ndarray of shape (y, x)
        Fitted to it.
    first : Judgement
        Of the surface before it was tightened: where nothing else can be known, it may be the
        object's if it leaves an end of the view unexplained.
    """
    if min(surface.shape) < LEAST_SIDE:
        return first.ends < first.of_ends
    noise = pixel_noise(look, surface)
    if math.isinf(noise):  # it lies near to nothing
        return True
    limit = math.log(MAY_BE / (1 - MAY_BE))
    if noise <= NOISY_RAD:
        return odds_of_object(look.judged(surface)) > limit
    limit += ODDS_PER_RAD * (noise - NOISY_RAD)
    side = next((side for most, side in AVERAGING if noise < most), MOST_AVERAGED)
    averaged = look.averaged(surface, side).judged(surface)
    if roughness(averaged) > max(ROUGH_RAD, ROUGH_SHARE * roughness(look.judged(surface))):
        return first.ends < first.of_ends
    return odds_of_object(averaged) > limit


def roughness(judged: Judgement) -> float:
    """Return how far the core of what is explained deviates from a smooth surface, in radians."""
    core = judged.near & (np.abs(judged.rest) < CORE_RAD)
    if core.sum() < FEW_PIXELS:
        return 0.0
    off = (judged.rest - smooth_part(judged.rest, core))[core]
    return 1.4826 * float(np.median(np.abs(off - np.median(off))))


def smooth_part(rest: Array, where: Mask) -> Array:
    """Return the polynomial of degree 4 that fits what is left best."""
    height, width = rest.shape
    y, x = np.linspace(-1, 1, height), np.linspace(-1, 1, width)
    terms = terms_at("polynomial", 4, y, x, rest.shape)
    found: Array = np.tensordot(fitted(rest, where, terms), terms, 1)
    return found


def odds_of_object(judged: Judgement) -> float:
    """Return the logarithm of the odds that a surface is the object's, not the empty field's."""
    near, rest = judged.near, judged.rest
    if near.sum() < FEW_PIXELS:
        return math.inf
    empty, very = (emptiest(judged, limit) for limit in (EMPTY_RAD, VERY_EMPTY_RAD))
    along = border_rows(near.shape)
    explained = float(near[along].mean())
    clues = [
        log_odds(float(very[along].mean())),
        log_odds(min(float(empty[along].mean()) / max(explained, 0.02), 1.0)),
        log_odds(float(empty.sum() / near.sum())),
        math.log(max(slope_at_edge(near, rest), 0.5)),
        math.log(1.03 - min(float(near.mean()), MOST_EXPLAINED)),
        float(judged.of_ends - judged.ends),
        math.log(max(float(np.std(smooth_part(rest, near)[near])), 0.01)),
    ]
    return NO_ODDS + float(np.dot(ODDS, clues))


def emptiest(judged: Judgement, limit_rad: float) -> Mask:
    """Mark the explained pixels round which less than a limit is left on average."""
    near = judged.near
    share = scipy.ndimage.uniform_filter(near.astype(np.float64), AVERAGED)
    total = scipy.ndimage.uniform_filter(np.where(near, judged.rest, 0.0), AVERAGED)
    found: Mask = near & (np.abs(total / np.maximum(share, 1e-6)) < limit_rad)
    return found


def log_odds(share: float) -> float:
    """Return the logarithm of the odds of a share, finite for none and for all."""
    return math.log((share + 0.02) / (1.02 - share))


def border_rows(shape: tuple[int, ...]) -> Mask:
    """Mark the rows of a coarse look that lie along the border."""
    within = [np.minimum(np.arange(n), np.arange(n)[::-1]) for n in shape]
    to_border = np.minimum.outer(*within)
    found: Mask = (to_border >= LEFT_OUT) & (to_border < LEFT_OUT + BORDER_ROWS)
    return found


def slope_at_edge(near: Mask, rest: Array) -> float:
    """Return how steep what is left is where explained pixels end, in radians per half a view."""
    edge = near & ~scipy.ndimage.binary_erosion(near)
    edge[: LEFT_OUT + 1] = edge[-LEFT_OUT - 1 :] = False
    edge[:, : LEFT_OUT + 1] = edge[:, -LEFT_OUT - 1 :] = False
    if edge.sum() <= FEW_EDGE_PIXELS:
        return 0.0
    along = [wrapped(step) * n / 2 for step, n in zip(np.gradient(rest), rest.shape, strict=True)]
    return float(np.median(np.hypot(*along)[edge]))
