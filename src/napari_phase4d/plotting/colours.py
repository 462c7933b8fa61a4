"""Colours that are told apart everywhere: of cells, phase, safety; and the ends of scales."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.words import checked_call

if TYPE_CHECKING:
    from matplotlib.colors import Colormap


__all__ = [
    "CURVE_COLOURS",
    "OBJECT_COLOUR",
    "colour_of",
    "phase_colours",
    "phase_limits",
    "phase_scale",
    "safety_colours",
    "shares_of",
]

#: Told apart by colour-blind people, and readable on dark and on light (after Okabe & Ito).
CURVE_COLOURS = ("#3a9bdc", "#e08a00", "#009e73", "#cc6fa3", "#d9541e", "#7f7fd5")
#: Likewise, for many cells.
CELL_COLOURS = (*CURVE_COLOURS, "#b5a642", "#46c7c7", "#a8763e", "#8fbf3f")
#: Line round the object; none of the colours of wrapped phase.
OBJECT_COLOUR = "#2ee66b"
#: Colours in a scale.
N_COLOURS = 256
#: Phase below zero, from zero on: as dark at zero as inferno, which is above it, then light blue.
BELOW_ZERO = ((0.0, 0.0, 0.016), (0.04, 0.13, 0.42), (0.1, 0.42, 0.75), (0.8, 0.96, 1.0))
#: Safety goes by the score to this power: most scores are near 1, and a frame of 0.7, wrong on
#: nearly a third of the object, must not look safe.
SAFETY_POWER = 3


@checked_call
def colour_of(cell: int) -> str:
    """Return the colour of a cell, from 1: the same in picture, curve and table.

    Parameters
    ----------
    cell : int
        Number of the cell, as `napari_phase4d.analysis.find_cells` gives it.

    Returns
    -------
    str
        Red, green and blue, such as "#b5a642". After the last colour the first comes again.
    """
    return CELL_COLOURS[(cell - 1) % len(CELL_COLOURS)]


@checked_call
def phase_colours(low: float, high: float) -> NDArray[np.float64]:
    """Return the colours of unwrapped phase between two limits; zero is always black.

    Above zero they are those of inferno, below it blue, so that colour-blind people tell them
    apart, and equally far from zero they are about equally light.

    Parameters
    ----------
    low, high : float
        Phase at the ends of the scale, in radians.

    Returns
    -------
    ndarray, shape (256, 4)
        Red, green, blue and opacity, 0 to 1.

    Examples
    --------
    >>> float(phase_colours(0, 12)[0].max()), float(phase_colours(-12, 0)[-1, :3].max() < 0.02)
    (1.0, 1.0)
    """
    value = np.linspace(low, high, N_COLOURS)
    share = value / max(abs(low), abs(high), np.finfo(float).tiny)
    above = named_colours("inferno")
    place = np.abs(share) * (N_COLOURS - 1)
    table = np.ones((N_COLOURS, 4))
    below = np.linspace(0, N_COLOURS - 1, len(BELOW_ZERO))
    for channel in range(3):
        up = np.interp(place, np.arange(N_COLOURS), above[:, channel])
        down = np.interp(place, below, [colour[channel] for colour in BELOW_ZERO])
        table[:, channel] = np.where(share >= 0, up, down)
    return table


def safety_colours(scores: ArrayLike) -> NDArray[np.float64]:
    """Return the colours of scores from 0, unsafe, to 1, safe; brighter is safer (viridis).

    Parameters
    ----------
    scores : array_like
        Numbers from 0 to 1.

    Returns
    -------
    ndarray, shape (..., 4)
        Red, green, blue and opacity, 0 to 1.

    Examples
    --------
    >>> light = safety_colours([0, 0.5, 1])[:, :3].sum(axis=1)
    >>> bool(light[0] < light[1] < light[2])
    True
    """
    level = np.clip(np.asarray(scores, dtype=np.float64), 0, 1) ** SAFETY_POWER
    return named_colours("viridis")[np.round((N_COLOURS - 1) * level).astype(np.intp)]


@cache
def named_colours(name: str) -> NDArray[np.float64]:
    """Return the 256 colours of one of matplotlib's scales."""
    from matplotlib import colormaps

    table: NDArray[np.float64] = colormaps[name](np.linspace(0, 1, N_COLOURS))
    return table


@checked_call
def phase_limits(stacks: Sequence[NDArray[np.floating]]) -> tuple[float, float]:
    """Return the range of phase of several pictures, without a few extreme pixels and NaN.

    Parameters
    ----------
    stacks : sequence of ndarray
        Pictures in radians, of any shape.

    Returns
    -------
    low, high : float
        Radians: a thousandth of the known pixels lie below, half a thousandth above. -pi and pi if
        no pixel is known.
    """
    shown = np.concatenate([np.ravel(s) for s in stacks])
    low, high = shares_of(shown, (0.001, 0.9995), (-np.pi, np.pi))
    return low, high


def phase_scale(low: float, high: float) -> Colormap:
    """Return `phase_colours` as matplotlib wants them."""
    from matplotlib.colors import ListedColormap

    return ListedColormap(phase_colours(low, high), name="phase")


def shares_of(
    picture: NDArray[Any], shares: tuple[float, ...], unknown: tuple[float, ...]
) -> tuple[float, ...]:
    """Return quantiles of the pixels that are known, or others where none is."""
    known = picture[np.isfinite(picture)]
    return tuple(float(v) for v in np.quantile(known, shares)) if known.size else unknown
