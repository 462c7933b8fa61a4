"""What the empty field round the object tells: tilt, curvature, aberrations and drift.

Also what is left of it after it has been taken off, and what would take off more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography.aberrations import surface_of, terms_at
from napari_phase4d.holography.emptyfield import (
    ENOUGH_BACKGROUND,
    fitted,
    mode_phase,
    solved,
    wrapped,
)
from napari_phase4d.holography.surfaces import (
    LEAST_SIDE,
    LOOK_PIXELS,
    Judgement,
    Look,
    curved_starts,
    lit_part,
    may_be_the_object,
    reached,
    refined,
    tightened,
)
from napari_phase4d.task import nothing

__all__ = [
    "MUCH_LEFT_RAD",
    "BetterSurface",
    "Fit",
    "Surface",
    "aligned_to",
    "background_advice",
    "curvature_advice",
    "fitted_surface",
]

Mask = NDArray[np.bool_]

#: Background pixels deviate from the fit by less than this, in radians; first a generous limit.
LIMITS_RAD = (1.5, 1.2, 1.0, 0.8, 0.8, 0.6, 0.6)
#: Slopes are fitted to about so many pixels, so many times over.
SLOPE_PIXELS, SLOPE_ROUNDS = 16_000, 12
#: A surface with more terms than a tilt has is fitted to about so many pixels at least.
SURFACE_PIXELS = 100_000
#: A surface that explains so much of a view leaves no room for another.
CLEAR_SHARE = 0.75
#: Another surface is taken if it explains so much more than the one found first.
CLEARLY_MORE = 1.1
#: Which of two surfaces is right can't be told if one explains so much of what the other does and
#: they differ by so many radians rms.
RIVAL_SHARE, RIVAL_RAD = 0.7, 0.5


def fitted_surface(
    fields: NDArray[np.complex64], order: int, kind: str = "powers"
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Fit a surface to the phase of the background.

    The background is what most frames have in common: the fields are averaged after their
    constant phases have been aligned, a first surface is guessed from the wrapped differences of
    neighbours, and the surface is fitted to the pixels near the most frequent phase, again and
    again with a tighter limit. A plain tilt begins with the median difference of neighbours. All
    else begins with a robust fit of the slopes, since strong curvature or coma leaves no one tilt
    to begin with.

    Parameters
    ----------
    fields : ndarray of shape (frame, y, x)
        Complex fields of one view.
    order : int
        Degree of the surface: 1 for tilt, 2 for tilt and curvature, up to 8; 0 for nothing.
    kind : str, optional
        "powers" (default, up to order 2), "polynomial" or "zernike"; see `Surface`.

    Returns
    -------
    ndarray of shape (y, x)
        Phase in radians with mean 0, to be subtracted.
    ndarray of float
        The coefficients of the surface's terms in radians.
    """
    mean = aligned_mean(fields)
    return Surface(kind, order, mean.shape).fitted_to(mean)


@dataclass(frozen=True)
class Surface:
    """Surfaces of one kind, to be fitted to the views of one size; the terms are made once.

    Fitted is what is seen on every so-manieth row and column of a large field, so that memory and
    time don't grow with it; a tilt takes so little that it is fitted to every pixel.

    Parameters
    ----------
    kind : str
        "powers", "polynomial" or "zernike".
    order : int
        The degree; 0 for nothing.
    shape : tuple of int
        Height and width in pixels.
    pixels : int, optional
        About how many of them it is fitted to, at least, if it is more than a tilt.
    """

    kind: str
    order: int
    shape: tuple[int, ...]
    pixels: int = SURFACE_PIXELS

    @property
    def is_tilt(self) -> bool:
        """Whether it has no more terms than a tilt."""
        return self.kind == "powers" and self.order == 1

    @property
    def thin(self) -> int:
        """Of so many rows and columns one is fitted to."""
        size = math.prod(self.shape)
        return 1 if self.is_tilt else max(1, math.isqrt(size // self.pixels))

    @cached_property
    def terms(self) -> NDArray[np.float64]:
        """The terms on the thinned grid, (term, y, x)."""
        return self.terms_seen(self.thin)

    @cached_property
    def slopes(self) -> NDArray[np.float64]:
        """What the terms change by from a pixel to its neighbours, (term, pixel)."""
        steps = []
        for axis in (0, 1):
            ahead, here = neighbours(axis, self.shape)
            step = self._terms_on(*ahead) - self._terms_on(*here)
            steps.append(step.reshape(len(step), -1))
        return np.concatenate(steps, axis=1)

    def _terms_on(self, rows: slice, columns: slice) -> NDArray[np.float64]:
        """Return the terms on some rows and columns."""
        y, x = (np.linspace(-1, 1, n) for n in self.shape)
        return terms_at(self.kind, self.order, y[rows], x[columns], self.shape)

    def fitted_to(
        self, mean: NDArray[np.complex64], check: Callable[[], None] = nothing
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Return the surface that fits the phase of a field's background, and its coefficients.

        Parameters
        ----------
        mean : ndarray of shape (y, x)
            The field.
        check : callable, optional
            Called between rounds; what it raises ends the work.
        """
        fit = self.fit(mean, check)
        return fit.surface, fit.coefficients

    def fit(self, mean: NDArray[np.complex64], check: Callable[[], None] = nothing) -> Fit:
        """Return the same with what speaks against it."""
        if self.order == 0:
            return Fit(np.zeros(mean.shape, dtype=np.float32), np.zeros(0))
        unit = mean / np.maximum(np.abs(mean), np.finfo(np.float32).tiny)
        lit = lit_part(mean)
        found = self._nearest(unit, lit, check)
        # With more terms than curvature has, most objects can be fitted.
        doubt, unsure = "", False
        if self.order == 2:
            found, doubt, unsure = self._chosen(mean, unit, lit, found, check)
        surface = (
            np.tensordot(found, self.terms, 1)
            if self.thin == 1
            else surface_of(found, self.kind, self.order, self.shape)
        )
        return Fit((surface - surface.mean()).astype(np.float32), found, doubt, unsure)

    def _nearest(
        self, unit: NDArray[np.complexfloating], lit: Mask, check: Callable[[], None]
    ) -> NDArray[np.float64]:
        """Return the coefficients fitted to the lit pixels near their most frequent phase."""
        phase = np.angle(unit[:: self.thin, :: self.thin]).astype(np.float64)
        found = (
            first_tilt(unit, lit) if self.is_tilt else fitted_slopes(unit, lit, self.slopes, check)
        )
        lit = lit[:: self.thin, :: self.thin]
        enough = ENOUGH_BACKGROUND * lit.mean()
        for limit in LIMITS_RAD:
            check()
            residual = wrapped(phase - np.tensordot(found, self.terms, 1))
            residual = wrapped(residual - mode_phase(residual[lit]))
            near = reached((np.abs(residual) < limit) & lit, lit)
            if near.mean() < enough:
                break
            found += fitted(residual, near, self.terms)
        return found

    def _chosen(
        self,
        mean: NDArray[np.complex64],
        unit: NDArray[np.complexfloating],
        lit: Mask,
        first: NDArray[np.float64],
        check: Callable[[], None],
    ) -> tuple[NDArray[np.float64], str, bool]:
        """Return the coefficients that explain most of a view, and what speaks against them.

        Last, whether they may be the object's.
        """
        look = Look(mean, lit=lit)
        terms = self.terms_seen(look.step)
        starts = self._curved(unit, lit, look.step)
        found, best, off = self._most_explaining(mean, starts, first, look, check)
        found = tightened(found, look, terms)
        surface = np.tensordot(found, terms, 1)
        return found, doubt_of(best, off), may_be_the_object(look, surface, best)

    def _most_explaining(
        self,
        mean: NDArray[np.complex64],
        starts: Iterator[NDArray[np.float64]],
        first: NDArray[np.float64],
        look: Look,
        check: Callable[[], None],
    ) -> tuple[NDArray[np.float64], Judgement, float]:
        """Return the coefficients that explain most, how much that is, and how far others are.

        Last, by how many radians rms others differ that explain nearly as much.
        """
        terms = self.terms_seen(look.step)
        best = look.judged(np.tensordot(first, terms, 1))
        if best.share > CLEAR_SHARE:
            return first, best, 0.0
        found, tries = first, [(best, first)]
        for start in starts:
            check()
            tried = refined(start, look.phase, terms, look.outer, look.lit)
            tries.append((look.judged(np.tensordot(tried, terms, 1)), tried))
        most, other = max(tries[1:], key=lambda each: each[0].share, default=tries[0])
        if most.share > CLEARLY_MORE * best.share:
            fine = Look(mean, self.thin)
            best, found = most, refined(other, fine.phase, self.terms, fine.outer, fine.lit)
        rivals = [each for judged, each in tries if judged.share > RIVAL_SHARE * best.share]
        off = [float(np.std(np.tensordot(each - found, terms, 1))) for each in rivals]
        return found, best, max(off, default=0.0)

    def terms_seen(self, step: int) -> NDArray[np.float64]:
        """Return the terms on every so-manieth row and column, (term, y, x)."""
        return self._terms_on(*(slice(None, None, step) for _ in self.shape))

    def _curved(
        self, unit: NDArray[np.complexfloating], lit: Mask, step: int
    ) -> Iterator[NDArray[np.float64]]:
        """Yield the coefficients of some surfaces to begin with."""
        y, x = (np.linspace(-1, 1, n)[::step] for n in self.shape)
        known = terms_at("powers", 2, y, x, self.shape)
        matrix = self.terms_seen(step).reshape(len(known), -1)
        for start in curved_starts(unit, lit):
            values = np.tensordot(start, known, 1).ravel()
            yield solved(matrix, np.ones(values.size), values)


@dataclass(frozen=True)
class Fit:
    """A surface fitted to the empty field of a view.

    Parameters
    ----------
    surface : ndarray of shape (y, x)
        Phase in radians with mean 0.
    coefficients : ndarray of shape (term,)
        Of its terms, in radians.
    doubt : str
        Why it is likely to be the object's surface; empty if nothing speaks for that.
    unsure : bool
        Whether too little of the view is surely empty, so that it may be the object's.
    """

    surface: NDArray[np.float32]
    coefficients: NDArray[np.float64]
    doubt: str = ""
    unsure: bool = False


def doubt_of(best: Judgement, off_rad: float) -> str:
    """Say what speaks against the surface that explains most, next to others as good."""
    share = float(best.near.mean())
    if share < ENOUGH_BACKGROUND:
        return f"only {100 * share:.0f} % looks empty"
    if best.ends < best.of_ends - 1:
        return "its corners don't look empty"
    if off_rad > RIVAL_RAD:
        return "its empty field can't be told from the object"
    return ""


def neighbours(
    axis: int, shape: tuple[int, ...]
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Return where pixels are, not too many, and where those before them along an axis."""
    thin = max(1, math.isqrt(math.prod(shape) // SLOPE_PIXELS))
    ahead, here, all_along = slice(1, None, thin), slice(0, -1, thin), slice(0, None, thin)
    if axis == 0:
        return (ahead, all_along), (here, all_along)
    return (all_along, ahead), (all_along, here)


def first_tilt(unit: NDArray[np.complexfloating], lit: Mask) -> NDArray[np.float64]:
    """Return the coefficients of 1, y and x that median differences of lit pixels give."""
    return np.array([0.0, slope(unit, lit, 0), slope(unit, lit, 1)])


def fitted_slopes(
    unit: NDArray[np.complexfloating],
    lit: Mask,
    matrix: NDArray[np.float64],
    check: Callable[[], None] = nothing,
) -> NDArray[np.float64]:
    """Return the coefficients whose slopes fit the wrapped differences of lit neighbours best.

    Differences need no unwrapping. The object's are left out by Tukey's biweight, with a limit of
    4.685 standard deviations, which are told by the median (Huber & Ronchetti, Robust
    Statistics).
    """
    pairs = [neighbours(axis, unit.shape) for axis in (0, 1)]
    steps = [np.angle(unit[ahead] * unit[here].conj()).ravel() for ahead, here in pairs]
    step = np.concatenate(steps).astype(np.float64)
    seen = np.concatenate([(lit[ahead] & lit[here]).ravel() for ahead, here in pairs])
    if seen.any() and not seen.all():
        step, matrix = step[seen], matrix[:, seen]
    weights: NDArray[np.float64] = np.ones(step.size)
    found: NDArray[np.float64] = np.zeros(len(matrix))
    for _ in range(SLOPE_ROUNDS):
        check()
        found = solved(matrix, weights, step)
        rest = wrapped(step - found @ matrix)
        limit = 4.685 * 1.4826 * max(float(np.median(np.abs(rest))), 1e-6)
        weights = np.maximum(1 - (rest / limit) ** 2, 0) ** 2
    return found


def aligned_mean(fields: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """Return the mean over frames after each has been turned to agree with the first."""
    first = fields[0]
    total = first.copy()
    for field in fields[1:]:
        total += aligned_to(first, field.copy())
    mean: NDArray[np.complex64] = total / np.float32(len(fields))
    return mean


def aligned_to(
    first: NDArray[np.complex64], field: NDArray[np.complex64]
) -> NDArray[np.complex64]:
    """Return a field, turned in place so that its constant phase agrees with the first's."""
    overlap = np.vdot(first, field)
    field *= np.complex64(np.exp(-1j * np.angle(overlap)))
    return field


def slope(unit: NDArray[np.complexfloating], lit: Mask, axis: int) -> float:
    """Return the phase from the middle to the edge of a tilt, by the median wrapped difference."""
    ahead = np.roll(unit, -1, axis)
    steps = np.angle(ahead * unit.conj())
    steps = np.delete(steps, -1, axis)
    seen = np.delete(lit & np.roll(lit, -1, axis), -1, axis)
    if seen.any():
        steps = steps[seen]
    half_width: float = (unit.shape[axis] - 1) / 2
    return float(np.median(steps)) * half_width


#: What to try next, what its surface is fitted with, and what is then left as it is now.
NEXT: dict[str, tuple[str, str, int, str]] = {
    "tilt": ("curvature", "powers", 2, "curvature is"),
    "curvature": ("polynomial", "polynomial", 4, "aberrations are"),
}


#: From so many radians rms on it is worth another try.
MUCH_LEFT_RAD = 0.3


@dataclass(frozen=True)
class Left:
    """What is left in the empty field of a view.

    Parameters
    ----------
    rad : float
        In radians rms, without the noise.
    explained : bool
        Whether the next better surface explains all corners of the view, so that aberrations are
        the reason why this one does not.
    """

    rad: float
    explained: bool


class BetterSurface:
    """The next better surface than the one that was taken off, to tell what is left.

    What is left can't be told from the pixels near the surface alone: those far from it would be
    taken for the object, however curved the field is.

    Parameters
    ----------
    background : str
        What was taken off, see `reconstruct`.
    shape : tuple of int
        Height and width of the views in pixels.
    """

    def __init__(self, background: str, shape: tuple[int, ...]) -> None:
        self.surface: Surface | None = None
        if background in NEXT and min(shape) >= LEAST_SIDE:
            _, kind, order, _ = NEXT[background]
            self.surface = Surface(kind, order, shape, LOOK_PIXELS)

    def leaves(self, mean: NDArray[np.complex64], taken: NDArray[np.float32]) -> Left:
        """Return what is left in the empty field of a view.

        Parameters
        ----------
        mean : ndarray of shape (y, x)
            The field before anything was taken off.
        taken : ndarray of shape (y, x)
            The phase that is taken off, in radians.
        """
        look = Look(mean)
        seen = (slice(None, None, look.step),) * 2
        own = look.judged(taken[seen].astype(np.float64))
        if self.surface is not None:
            better = self.surface.fit(mean)
            judged = look.judged(better.surface[seen].astype(np.float64))
            clear = not better.doubt and judged.ends >= judged.of_ends - 1
            if clear and judged.share > CLEARLY_MORE * own.share:
                left = (better.surface - taken)[seen][judged.near] + judged.rest[judged.near]
                return Left(float(np.std(left)), judged.ends == judged.of_ends)
        return Left(float(np.std(own.rest[own.near])) if own.near.any() else 0.0, False)


def background_advice(attrs: Mapping[str, Any]) -> str:
    """Say in which views of a reconstruction much is left, and what to try; empty if in none.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    much = much_left(attrs)
    if not much:
        return ""
    name, _, _, what = NEXT[attrs["background"]]
    views = " and ".join(f"view {view + 1} ({left:.1f} rad rms)" for view, left in much.items())
    doubted = [view for view in attrs.get("curvature_unsure", ()) if view in much]
    if not doubted:
        return f"{what} left in {views}: try background={name!r}"
    return (
        f"{what} left in {views}, or the curvature taken off {named(doubted)} may be the "
        f"object's: try background={name!r}, and if the field round the object is not flat with "
        "it, record a hologram without cells as the reference"
    )


def much_left(attrs: Mapping[str, Any]) -> dict[int, float]:
    """Return how much is left, in the views where a better surface would take much of it off."""
    lefts: Sequence[float] = attrs.get("background_left_rad", ())
    if attrs.get("background") not in NEXT:
        return {}
    return {view: left for view, left in enumerate(lefts) if left > MUCH_LEFT_RAD}


def named(views: Sequence[int]) -> str:
    """Return views in words, counted from 1."""
    return " and ".join(f"view {view + 1}" for view in views)


def curvature_advice(attrs: Mapping[str, Any]) -> str:
    """Say in which views the curvature that was taken off may be the object's; empty if in none.

    Where a higher order would take off what is left, `background_advice` says so.

    Parameters
    ----------
    attrs : mapping
        The notes of a reconstruction.
    """
    much = much_left(attrs)
    views = [view for view in attrs.get("curvature_unsure", ()) if view not in much]
    if not views:
        return ""
    given = attrs.get("reference", "none") not in ("none", "median")
    record = "" if given else "record a hologram without cells as the reference, or "
    return (
        f"the curvature taken off {named(views)} may be the object's, as too little is surely "
        f"empty: {record}compare with background='tilt'"
    )
