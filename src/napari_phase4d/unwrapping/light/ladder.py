"""From the longest synthetic wavelength down to the shortest of all: which, and how noise grows.

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

import numpy as np
from numpy.typing import NDArray

__all__ = ["Rung", "ladder_of", "noise_between"]


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
        Of the views of one angle, in micrometres; two or more, all different.

    Examples
    --------
    >>> [round(rung.wavelength_um, 3) for rung in ladder_of((0.532, 0.6328))]
    [3.34, 0.532]
    >>> [round(rung.wavelength_um, 3) for rung in ladder_of((0.532, 0.561, 0.6328))]
    [10.291, 3.34, 0.532]
    """
    beats, plain = rungs_of(wavelengths_um)
    best: tuple[float, int, list[Rung]] | None = None
    for count in range(len(beats)):
        for between in combinations(beats[1:], count):
            way = [beats[0], *between, plain[0]]
            worst = max(noise_between(a, b) for a, b in pairwise(way))
            if best is None or worst < best[0] - 1e-9:
                best = (worst, len(way), way)
    assert best is not None
    return best[2]
