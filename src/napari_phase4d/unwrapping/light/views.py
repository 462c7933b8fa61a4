"""Views of several wavelengths: which belong together, the ladder of synthetic wavelengths.

The phases of one path L at two wavelengths differ by 2 pi L / W, where W = w1 w2 / |w2 - w1| is
the *synthetic* (or beat) wavelength, so that a path up to W is told by them without ambiguity
(Polhemus, Appl. Opt. 12, 2071, 1973; for holographic phase Gass, Dakoff & Kim, Opt. Lett. 28,
1141, 2003). Noise of the phases is that of a path W / w times longer, so that the long wavelength
does no more than choose the whole turns of a shorter one, and that of the next, down to the
shortest, whose noise is that of the result (hierarchical temporal unwrapping; Towers, Towers &
Jones, Opt. Lett. 28, 887, 2003; of multiplexed holograms Mirsky & Shaked, Sci. Rep. 13, 19293,
2023).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.stack import Block, ReadOnly, Stack, Store, Temporary

__all__ = [
    "Named",
    "Rung",
    "Together",
    "ViewsOf",
    "frames_among",
    "ladder_of",
    "noise_between",
    "views_by_light",
]

ALL = slice(None)
Views = tuple[int, ...]
Frame = tuple[int, int]


def views_by_light(wavelengths_um: NDArray[np.float64] | None) -> list[Views]:
    """Return the numbers of the views of each wavelength, shortest first.

    Parameters
    ----------
    wavelengths_um : ndarray of shape (view,) or None
        In micrometres; None where they are not known.

    Returns
    -------
    list of tuple of int
        Empty if there is one wavelength only.
    """
    if wavelengths_um is None or len(np.unique(wavelengths_um)) < 2:
        return []
    return [
        tuple(np.flatnonzero(wavelengths_um == light).tolist())
        for light in np.unique(wavelengths_um)
    ]


def frames_among(
    frames: Sequence[Frame], views: Sequence[int], places: NDArray[np.floating]
) -> list[Frame]:
    """Return which frames of some views stand for the boundary frames of all views.

    A boundary frame holds at its time for every wavelength: there it is the frame of the same
    angle, or of the nearest.

    Parameters
    ----------
    frames : sequence of (int, int)
        Boundary frames (time, view) among all views.
    views : sequence of int
        The views that are asked for.
    places : ndarray of shape (view,)
        Angle of every view in degrees.
    """
    found = []
    for time, view in frames:
        near = np.abs(places[list(views)] - places[view])
        found.append((time, int(np.argmin(near))))
    return list(dict.fromkeys(found))


@dataclass(frozen=True)
class ViewsOf:
    """Some views of a stack.

    Parameters
    ----------
    stack : Stack
        All views.
    views : tuple of int
        Which of them.
    """

    stack: Stack
    views: Views

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, view, y, x)."""
        n_times, _, *frame = self.stack.shape
        return (n_times, len(self.views), *frame)

    def read(self, block: Block, angles: slice = ALL) -> NDArray[Any]:
        """Return the frames of a block, or some of its views."""
        each = [self.stack.read(block, slice(v, v + 1)) for v in self.views[angles]]
        return each[0] if len(each) == 1 else np.concatenate(each, axis=1)

    def write(self, block: Block, values: NDArray[Any], angles: slice = ALL) -> None:
        """Write the frames of a block, or some of its views."""
        for i, view in enumerate(self.views[angles]):
            self.stack.write(block, values[:, i : i + 1], slice(view, view + 1))


@dataclass(frozen=True)
class Together(ReadOnly):
    """Stacks of some views each, put together to one of all; to be read only.

    Parameters
    ----------
    parts : tuple of (tuple of int, Stack)
        Numbers of the views, and their stack; every view is in one of them.
    """

    parts: tuple[tuple[Views, Stack], ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the stack (time, view, y, x)."""
        n_times, _, *frame = self.parts[0][1].shape
        return (n_times, sum(len(views) for views, _ in self.parts), *frame)

    def read(self, block: Block, angles: slice = ALL) -> NDArray[Any]:
        """Return the frames of a block, or some of its views."""
        place = {view: (stack, i) for views, stack in self.parts for i, view in enumerate(views)}
        wanted = [place[view] for view in range(self.shape[1])[angles]]
        return np.concatenate([stack.read(block, slice(i, i + 1)) for stack, i in wanted], axis=1)


@dataclass(frozen=True)
class Named:
    """A store whose stacks have a word before their names, so that several may share a place.

    Parameters
    ----------
    store : Store
        The place.
    word : str
        The word.
    """

    store: Store
    word: str

    def temporary(self, name: str, shape: tuple[int, ...], dtype: str) -> Temporary:
        """Return a new stack of zeros."""
        return self.store.temporary(f"{self.word}_{name}", shape, dtype)


# ---- the ladder of wavelengths --------------------------------------------------------------


@dataclass(frozen=True)
class Rung:
    """One wavelength of the ladder, synthetic or not.

    Parameters
    ----------
    wavelength_um : float
        Its wavelength in micrometres.
    weights : tuple of float
        What the phase of each view of an angle is multiplied by; their sum is its phase.
    """

    wavelength_um: float
    weights: tuple[float, ...]

    def phase(self, phases: NDArray[np.floating]) -> NDArray[np.floating]:
        """Return its phase in radians, not wrapped, of the views' phases (view, ...)."""
        found = np.zeros(phases.shape[1:], dtype=phases.dtype)
        for weight, phase in zip(self.weights, phases, strict=True):
            if weight:
                found += phase.dtype.type(weight) * phase
        return found


def rungs_of(wavelengths_um: Sequence[float]) -> tuple[list[Rung], list[Rung]]:
    """Return all synthetic wavelengths, longest first, and the plain ones, shortest first."""
    n = len(wavelengths_um)
    plain = [
        Rung(wavelengths_um[i], tuple(float(j == i) for j in range(n)))
        for i in np.argsort(wavelengths_um)
    ]
    beats = []
    for i, j in combinations(np.argsort(wavelengths_um).tolist(), 2):
        short, long = wavelengths_um[i], wavelengths_um[j]
        weights = tuple(float(k == i) - float(k == j) for k in range(n))
        beats.append(Rung(short * long / (long - short), weights))
    return sorted(beats, key=lambda rung: -rung.wavelength_um), plain


def noise_between(coarse: Rung, fine: Rung) -> float:
    """Return the noise, in turns for each radian of it in a view, with which turns are chosen.

    The phase of the shorter wavelength that the longer one predicts, less that which was measured,
    is a sum of the views' phases, whose noise is independent.

    Parameters
    ----------
    coarse, fine : Rung
        The longer wavelength and the next.
    """
    scale = coarse.wavelength_um / fine.wavelength_um
    off = [scale * c - f for c, f in zip(coarse.weights, fine.weights, strict=True)]
    return float(np.linalg.norm(off)) / (2 * np.pi)


def ladder_of(wavelengths_um: Sequence[float]) -> list[Rung]:
    """Return the wavelengths to go down by: the longest synthetic one first, the shortest last.

    Of all ways down, the one whose noisiest step is least noisy; of equal ones the shortest.

    Parameters
    ----------
    wavelengths_um : sequence of float
        Of the views of one angle, in micrometres, all different; of one alone it is the ladder.

    Examples
    --------
    >>> [round(rung.wavelength_um, 3) for rung in ladder_of((0.532, 0.6328))]
    [3.34, 0.532]
    >>> [round(rung.wavelength_um, 3) for rung in ladder_of((0.532, 0.561, 0.6328))]
    [10.291, 3.34, 0.532]
    """
    beats, plain = rungs_of(wavelengths_um)
    if not beats:
        return plain
    best: tuple[float, int, list[Rung]] | None = None
    for count in range(len(beats)):
        for between in combinations(beats[1:], count):
            way = [beats[0], *between, plain[0]]
            worst = max(noise_between(a, b) for a, b in pairwise(way))
            if best is None or worst < best[0] - 1e-9:
                best = (worst, len(way), way)
    assert best is not None
    return best[2]
