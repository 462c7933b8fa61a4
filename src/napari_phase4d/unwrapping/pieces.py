"""Breaking a sequence into pieces that each go from optically thin to thick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.unwrapping.filters import upper_quantile

__all__ = ["Piece", "pieces_between", "thickness", "thickness_profile", "with_thin_turning_points"]

#: A map is as thin as the boundary map if its peak phase is at most this many times as large.
AS_THIN = 1.1
#: The sequence must have been thicker in between by at least this share of the boundary's peak.
CLEARLY_THICKER = 0.25


@dataclass(frozen=True)
class Piece:
    """Maps ``first`` to ``stop - 1``, unwrapped outwards from ``start``."""

    first: int
    start: int
    stop: int


def thickness_profile(
    unwrapped: NDArray[np.float32], mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return the peak phase (99th percentile inside the mask) of each map, in radians."""
    return np.array(
        [thickness(phase, inside) for phase, inside in zip(unwrapped, mask, strict=True)]
    )


def thickness(unwrapped: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """Return the peak phase (99th percentile inside the mask) of one map, in radians."""
    return float(upper_quantile(unwrapped[mask], 0.99)) if mask.any() else 0.0


def with_thin_turning_points(profile: NDArray[np.float64], starts: Sequence[int]) -> list[int]:
    """Return the starts and those maps where the object has become as thin again.

    Parameters
    ----------
    profile : ndarray of shape (n,)
        Peak phase of each map as a first pass found it; it is more to be trusted than a
        two-dimensional unwrapping, which finds thick maps too thin.
    starts : sequence of int
        Maps that the user knows to be thin.
    """
    found = set(starts)
    thin = max(profile[s] for s in starts)
    for k in range(len(profile)):
        nearest = min(starts, key=lambda s: abs(s - k))
        between = profile[min(k, nearest) : max(k, nearest) + 1]
        left = profile[k - 1] if k > 0 else np.inf
        right = profile[k + 1] if k + 1 < len(profile) else np.inf
        turns = profile[k] <= min(left, right) and profile[k] < max(left, right)
        was_thicker = between.max() > (1 + CLEARLY_THICKER) * max(thin, profile[k])
        if turns and profile[k] <= AS_THIN * thin and was_thicker:
            found.add(k)
    return sorted(found)


def pieces_between(
    starts: Sequence[int], n: int, profile: NDArray[np.float64] | None
) -> list[Piece]:
    """Cut a sequence of n maps between its starts.

    Parameters
    ----------
    starts : sequence of int
        Where pieces start.
    n : int
        Number of maps.
    profile : ndarray or None
        Peak phase of each map: the cut is where it is largest; without it, half way.
    """
    ordered = sorted(set(starts))
    cuts = [0]
    for a, b in pairwise(ordered):
        if profile is None:
            cuts.append((a + b) // 2 + 1)
        else:
            cuts.append(a + 1 + int(np.argmax(profile[a + 1 : b + 1])) if b > a + 1 else b)
    cuts.append(n)
    return [
        Piece(first, s, stop) for s, (first, stop) in zip(ordered, pairwise(cuts), strict=True)
    ]
