"""The paper's methods: angular, temporal, and both one after the other (T/A and A/T)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.progress import CancelledCall, ProgressCall, Watch, in_threads
from napari_phase4d.unwrapping.combined import unwrap_line
from napari_phase4d.unwrapping.growing import coherence
from napari_phase4d.unwrapping.problem import Boundary, Problem
from napari_phase4d.unwrapping.registration import moved
from napari_phase4d.unwrapping.spatial import unwrap_frames

__all__ = [
    "ORDERS",
    "angular",
    "angular_temporal",
    "spatial_2d",
    "starts_on",
    "temporal",
    "temporal_angular",
]

Stack = NDArray[np.float32]

#: Dimensions that each of these methods goes along, one after the other (Fig. 1).
ORDERS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "temporal-angular": ("time", "angle"),
        "angular-temporal": ("angle", "time"),
        "temporal": ("time",),
        "angular": ("angle",),
    }
)


def spatial_2d(
    problem: Problem,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    reliability: str = "herraez",
) -> Stack:
    """Unwrap each frame by itself (step 1 of T/A and A/T).

    Parameters
    ----------
    problem : Problem
        What to unwrap.
    progress, cancelled : callable or None
        See `unwrap`.
    reliability : str, optional
        What is joined first: "herraez", pixels of small second differences (default, and what
        the paper's methods start from), or "coherence", steps that are like those round them.
    """
    if reliability == "herraez":
        found = problem.spatial(progress, cancelled)
        return found if problem.for_one_method else found.copy()
    watch = Watch(problem.n_frames, "2-D unwrapping", progress, cancelled)
    return unwrap_frames(problem.wrapped, problem.mask, problem.first, watch, coherence)


def chained(
    problem: Problem,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    order: tuple[str, ...],
    registration: bool = True,
    split: bool = True,
) -> Stack:
    """Apply the building block along one dimension after the other.

    The result of one pass is the initial method of the next (steps 3 and 4 of T/A and A/T).
    """
    initial = problem.spatial(progress, cancelled)
    shifts = np.zeros((*initial.shape[:2], 2), dtype=np.intp)
    if registration:
        shifts = problem.shifts(progress, cancelled)
    wrapped, mask = moved(problem.wrapped, shifts), moved(problem.mask, shifts)
    before = moved(initial, shifts)
    result = np.empty_like(before)
    for dim in order:
        one_pass(
            dim,
            wrapped,
            before,
            mask,
            result,
            problem.boundaries,
            progress,
            cancelled,
            split=split,
        )
        before = result
    return moved(result, -shifts)


def one_pass(
    dim: str,
    wrapped: Stack,
    initial: Stack,
    mask: NDArray[np.bool_],
    result: Stack,
    boundaries: list[Boundary],
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
    *,
    split: bool,
) -> None:
    """Apply the building block to every line of frames along time or angle."""
    lines = list(lines_along(dim, wrapped.shape, boundaries))
    watch = Watch(len(lines), f"unwrapping along {dim}", progress, cancelled)

    def work(line: tuple[tuple[slice | int, slice | int], list[int]]) -> None:
        index, starts = line
        unwrap_line(
            wrapped[index],
            initial[index],
            mask[index],
            starts,
            split=split,
            check=watch.check,
            out=result[index],
        )

    for _ in in_threads(work, lines, watch):
        pass


def lines_along(
    dim: str, shape: tuple[int, ...], boundaries: list[Boundary]
) -> Iterator[tuple[tuple[slice | int, slice | int], list[int]]]:
    """Yield each line of frames and where on it the thin frames are."""
    for other in range(shape[1 if dim == "time" else 0]):
        index: tuple[slice | int, slice | int]
        index = (slice(None), other) if dim == "time" else (other, slice(None))
        yield index, starts_on(dim, other, boundaries)


def starts_on(dim: str, other: int, boundaries: list[Boundary]) -> list[int]:
    """Return where on a line of frames the thin ones are.

    A boundary frame counts for its own line; a line without one starts where the others do, as
    Fig. 1 shows: the first pass leaves the row of the boundary time (or angle) from which the
    second starts.

    Parameters
    ----------
    dim : str
        "time" or "angle", along which the line goes.
    other : int
        Number of the line: of its angle, if it goes along time, else of its time.
    boundaries : list of (int, int)
        Thin frames (time, angle).
    """
    along, across = (0, 1) if dim == "time" else (1, 0)
    own = sorted({b[along] for b in boundaries if b[across] == other})
    return own or sorted({b[along] for b in boundaries})


#: Along the angle at each time ([11] in the paper).
angular = partial(chained, order=ORDERS["angular"])
#: Along time for each angle.
temporal = partial(chained, order=ORDERS["temporal"])
#: T/A: along time for each angle, then along the angle at each time (Fig. 1a).
temporal_angular = partial(chained, order=ORDERS["temporal-angular"])
#: A/T: along the angle at each time, then along time for each angle (Fig. 1b).
angular_temporal = partial(chained, order=ORDERS["angular-temporal"])
