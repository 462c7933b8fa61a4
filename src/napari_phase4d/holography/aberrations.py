"""Aberrations of the optics as a sum of terms, and which curved surface the empty field has.

Terms are polynomials, or Zernike's circle polynomials, numbered and scaled after Noll (Journal of
the Optical Society of America 66, 207, 1976), so that each coefficient is the root mean square,
over the circle, of what its term adds to the phase. The circle goes through the corners of the
frame. All terms up to one degree span the same surfaces as all polynomials up to that degree; they
differ in what the single numbers mean: j = 4 is defocus, 5 and 6 are astigmatism, 7 and 8 coma, 11
is spherical aberration.

The smooth middle of a thick cell can be fitted as well as the field round it, and where it fills
most of the view it outvotes it. So several surfaces are tried, each from the slopes in three small
squares, and each is judged by how much of the view it explains. Pixels far from the middle count
most, since it is there that a view is empty. Where two surfaces explain about as much, or the one
that explains most leaves the corners to the object, nothing in the field tells which is right.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.polynomial import legendre
from numpy.typing import NDArray

from napari_phase4d.holography.emptyfield import fitted, joined_to_the_border, mode_phase, wrapped

__all__ = [
    "ABERRATION_NAMES",
    "LOOK_PIXELS",
    "MAX_ORDER",
    "MIN_ORDER",
    "Judgement",
    "Look",
    "curved_starts",
    "noll",
    "refined",
    "surface_of",
    "surface_terms",
    "terms_at",
    "zernike",
]

#: Degrees of the polynomials that can be asked for.
MIN_ORDER, MAX_ORDER = 1, 8
#: What the first of Noll's terms are called.
ABERRATION_NAMES = {
    2: "tilt x",
    3: "tilt y",
    4: "defocus",
    5: "astigmatism 45°",
    6: "astigmatism 0°",
    7: "coma y",
    8: "coma x",
    9: "trefoil y",
    10: "trefoil x",
    11: "spherical",
}

Terms = NDArray[np.float64]


def surface_terms(kind: str, order: int, shape: tuple[int, ...]) -> Terms:
    """Return the terms that a background is fitted with, the constant first.

    Parameters
    ----------
    kind : str
        "powers" (up to degree 2), "polynomial" or "zernike".
    order : int
        Highest degree, 1 to 8.
    shape : tuple of int
        Height and width in pixels.

    Returns
    -------
    ndarray of shape (term, y, x)
        float64; Noll's order for "zernike".
    """
    y, x = (np.linspace(-1, 1, int(n)) for n in shape)
    return terms_at(kind, order, y, x, shape)


def terms_at(kind: str, order: int, y: Terms, x: Terms, shape: tuple[int, ...]) -> Terms:
    """Return the terms of `surface_terms` on some rows and columns only.

    Parameters
    ----------
    kind, order, shape
        As there.
    y, x : ndarray of shape (row,), (column,)
        Where, from -1 at the first to 1 at the last pixel of a side.

    Returns
    -------
    ndarray of shape (term, row, column)
        float64.
    """
    return TERMS[kind](order, y, x, (int(shape[0]), int(shape[1])))


def surface_of(
    coefficients: Terms, kind: str, order: int, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Return the sum of the terms with these coefficients on every pixel.

    A polynomial of degree n is known by its values on n + 1 rows and columns, so two products of
    matrices give it, and no term is ever as large as the frame.

    Parameters
    ----------
    coefficients : ndarray of shape (term,)
        Of the terms of `surface_terms`.
    kind, order, shape
        As there.

    Returns
    -------
    ndarray of shape (y, x)
        float64.
    """
    nodes, _ = legendre.leggauss(order + 1)
    values = np.tensordot(coefficients, terms_at(kind, order, nodes, nodes, shape), 1)
    known = np.linalg.inv(legendre.legvander(nodes, order))
    rows, columns = (legendre.legvander(np.linspace(-1, 1, n), order) @ known for n in shape)
    surface: NDArray[np.float64] = rows @ values @ columns.T
    return surface


def powers(order: int, y: Terms, x: Terms, _: tuple[int, int]) -> Terms:
    """Return 1, y, x, and with order 2 also y^2, y x, x^2; y and x from -1 to 1."""
    y, x = np.broadcast_arrays(y[:, None], x[None, :])
    terms = [np.ones(y.shape), y, x]
    if order >= 2:
        terms += [y**2, y * x, x**2]
    return np.stack(terms)


def products(order: int, y: Terms, x: Terms, _: tuple[int, int]) -> Terms:
    """Return the products of Legendre's polynomials of y and x up to a total degree.

    They span all polynomials of that degree, and being orthogonal they are fitted more exactly
    than powers are.
    """
    rows, columns = (legendre.legvander(places, order) for places in (y, x))
    degrees = sorted(
        ((i, j) for i in range(order + 1) for j in range(order + 1 - i)), key=lambda d: sum(d)
    )
    return np.stack([np.outer(rows[:, i], columns[:, j]) for i, j in degrees])


def circle_terms(order: int, y: Terms, x: Terms, shape: tuple[int, int]) -> Terms:
    """Return Noll's terms up to a radial degree; the circle goes through the corners."""
    height, width = shape
    across = math.hypot(height, width)
    y, x = np.broadcast_arrays(y[:, None] * height / across, x[None, :] * width / across)
    rho, theta = np.hypot(y, x), np.arctan2(y, x)
    return np.stack([zernike(j, rho, theta) for j in range(1, number_of_terms(order) + 1)])


def number_of_terms(order: int) -> int:
    """Return how many terms there are up to a degree."""
    return (order + 1) * (order + 2) // 2


def noll(j: int) -> tuple[int, int]:
    """Return radial degree n and angular frequency m of Noll's term j, counted from 1.

    m > 0 stands for the cosine, m < 0 for the sine.

    Raises
    ------
    ValueError
        If j is below 1.
    """
    if j < 1:
        msg = f"Noll's terms are counted from 1, but j is {j}"
        raise ValueError(msg)
    n = (math.isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2  # from 1, within this degree
    m = 2 * (place // 2) if n % 2 == 0 else 2 * ((place - 1) // 2) + 1
    return n, m if j % 2 == 0 else -m


def zernike(j: int, rho: Terms, theta: Terms) -> Terms:
    """Return Zernike's polynomial with Noll's number j, of root mean square 1 over the unit disk.

    Parameters
    ----------
    j : int
        From 1.
    rho, theta : ndarray
        Distance from the middle, 1 at the rim, and angle from the x axis in radians.

    Returns
    -------
    ndarray
        Of the shape of ``rho``.
    """
    n, m = noll(j)
    radial = sum(
        (
            (-1) ** k
            * math.comb(n - k, k)
            * math.comb(n - 2 * k, (n - abs(m)) // 2 - k)
            * rho ** (n - 2 * k)
            for k in range((n - abs(m)) // 2 + 1)
        ),
        start=np.zeros_like(rho),
    )
    if m == 0:
        return math.sqrt(n + 1) * radial
    turn = np.cos(m * theta) if m > 0 else np.sin(-m * theta)
    return math.sqrt(2 * (n + 1)) * radial * turn


#: What a background is fitted with: name -> terms of (order, rows, columns, shape).
TERMS: dict[str, Callable[[int, Terms, Terms, tuple[int, int]], Terms]] = {
    "powers": powers,
    "polynomial": products,
    "zernike": circle_terms,
}


# ---- which surface the empty field has ------------------------------------------------------


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
        smooth = scipy.ndimage.uniform_filter(rest, 3)
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
