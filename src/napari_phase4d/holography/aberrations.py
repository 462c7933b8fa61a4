"""Aberrations of the optics as a sum of terms.

Terms are polynomials, or Zernike's circle polynomials, numbered and scaled after Noll (Journal of
the Optical Society of America 66, 207, 1976), so that each coefficient is the root mean square,
over the circle, of what its term adds to the phase. The circle goes through the corners of the
frame. All terms up to one degree span the same surfaces as all polynomials up to that degree; they
differ in what the single numbers mean: j = 4 is defocus, 5 and 6 are astigmatism, 7 and 8 coma, 11
is spherical aberration.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

__all__ = [
    "ABERRATION_NAMES",
    "MAX_ORDER",
    "MIN_ORDER",
    "noll",
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
