"""What a comparison comes to, in words: which result to use, and which order suits the object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.analysis.confidence import REFERENCE, turns_off
from napari_phase4d.analysis.differences import wrong_cycle_share
from napari_phase4d.analysis.itoh import order_shares
from napari_phase4d.analysis.slips import Counts, Tally
from napari_phase4d.later import xr
from napari_phase4d.stacks import Doubt, doubts_of
from napari_phase4d.unwrapping import METHODS, Problem, ViewsApart, views_apart
from napari_phase4d.words import checked_call, frame_in_words, view_of

__all__ = [
    "Verdict",
    "best_known",
    "counting_turns",
    "most_trusted",
    "order_verdict",
    "steps_sentence",
    "verdict_on",
]

#: A result in which more of the object than this share is in doubt is not safe.
SAFE = 0.1
#: Results count as equally good if their shares in doubt differ by less than this.
ALIKE = 1e-3
#: A view of which more than this share is in doubt is so as a whole.
MOST_OF_VIEW = 0.5
#: What is said where nothing is known to be at zero.
NO_FIELD = (
    "No empty field is in view, so nothing tells the level of the whole, and parts of it may be "
    "whole turns off each other where all looks smooth."
)
#: Methods that don't count turns, but estimate the phase; they differ from all others everywhere.
ESTIMATES = ("laplacian",)


class Verdict(str):
    """One sentence, and what it says in numbers.

    Attributes
    ----------
    method : str
        Id of the method whose result to use.
    doubtful_percent : float
        Share of the object in that result that is more likely wrong than right, in percent.
    frame : tuple of int or None
        (time, angle) index of the frame in which methods disagree most; None where they agree.
    disagreement_percent : float
        Share of the object there on which not all methods agree, in percent.
    lost_frames : list of tuple of int
        Frames (time, angle) that say nothing of the object, or fit neither those before nor after.
    disagreement : DataArray
        Share of each frame's object on which not all methods agree, 0 to 1.
    views_apart : list of ViewsApart
        Views of several wavelengths that are shifted against each other.
    blurred_percent : float
        Share of the jumps of the wrapped phase that take several pixels, as after smoothing, in
        percent; 0 where it does not seem to have been smoothed, resized, turned or averaged, or
        where something else is wrong with it.
    doubts : list of str
        What is probably wrong with the wrapped phase, as its units; no result is safe then.
    """

    __slots__ = (
        "_words",
        "blurred_percent",
        "disagreement",
        "disagreement_percent",
        "doubtful_percent",
        "doubts",
        "frame",
        "lost_frames",
        "method",
        "views_apart",
    )

    method: str
    doubtful_percent: float
    frame: tuple[int, int] | None
    disagreement_percent: float
    lost_frames: list[tuple[int, int]]
    disagreement: xr.DataArray
    views_apart: list[ViewsApart]
    blurred_percent: float
    doubts: list[str]
    _words: Words

    def on_grid_of(self, phase: xr.DataArray) -> Verdict:
        """Return the same verdict in words of other times and angles of the same frames.

        Parameters
        ----------
        phase : DataArray
            The wrapped phase, with its new coordinates.
        """
        found = Verdict(self._words(phase))
        found._words = self._words
        found.method, found.doubtful_percent = self.method, self.doubtful_percent
        found.frame, found.lost_frames = self.frame, self.lost_frames
        found.disagreement_percent = self.disagreement_percent
        found.views_apart, found.doubts = self.views_apart, self.doubts
        found.blurred_percent = self.blurred_percent
        found.disagreement = of_frames(self.disagreement.values, phase)
        return found

    @property
    def is_safe(self) -> bool:
        """Whether no more than a tenth of the object is in doubt, and the phase itself is not."""
        return bool(self.doubtful_percent <= 100 * SAFE) and not self.doubts

    def __call__(self) -> Verdict:
        """Return itself, for those who call it."""
        return self


@dataclass(frozen=True)
class Words:
    """What a verdict says, but for the times and angles, which are those of a stack.

    Parameters
    ----------
    label : str
        What the method is called whose result to use.
    doubt, own : float
        Shares of the object in doubt: of that result, of directional L1 if that was not run.
    n_results : int
        How many results were held against each other.
    frame : tuple of int
        (time, angle) index of the frame in which these disagree most.
    most : float
        Share of the object there on which they do.
    doubtful, inside : ndarray of int, shape (time, angle)
        Pixels of the object that are in doubt, and all of them.
    lost, outliers : list of tuple of int
        Frames (time, angle) that say nothing, and that fit neither neighbour.
    shows_field : bool
        Whether any frame shows an empty field.
    apart : list of ViewsApart
        Views of several wavelengths that are shifted against each other.
    doubts : list of Doubt
        What is probably wrong with the wrapped phase.
    """

    label: str
    doubt: float
    own: float | None
    n_results: int
    frame: tuple[int, int]
    most: float
    doubtful: Counts
    inside: Counts
    lost: list[tuple[int, int]]
    outliers: list[tuple[int, int]]
    shows_field: bool
    apart: list[ViewsApart]
    doubts: list[Doubt]

    def __call__(self, stack: xr.DataArray) -> str:
        """Return the sentence for a stack that has these frames."""
        parts = [
            first_words(self.label, self.doubt, self.n_results, self.doubts),
            where_words(frame_in_words(stack, *self.frame), self.most, self.n_results),
            view_words(self.doubtful, self.inside, stack),
            "" if self.shows_field else NO_FIELD,
            apart_words(self.apart, stack),
            better_words(self.own, self.doubt),
            lost_words(self.lost, stack, self.inside.size),
            outlier_words(self.outliers, stack),
        ]
        return " ".join(part for part in parts if part)


def counting_turns(results: Mapping[str, xr.DataArray]) -> Mapping[str, xr.DataArray]:
    """Leave estimates out, where two other results are left."""
    exact = {m: r for m, r in results.items() if m not in ESTIMATES}
    return exact if len(exact) > 1 else results


def verdict_on(
    problem: Problem,
    results: Mapping[str, xr.DataArray],
    tally: Tally,
    labels: Mapping[str, str],
    phase: xr.DataArray,
    own: float | None = None,
) -> Verdict:
    """Say which result to use, how much of it is in doubt, and where methods disagree most.

    Parameters
    ----------
    problem : Problem
        What was unwrapped.
    results : mapping of str to DataArray
        Unwrapped phase of each method.
    tally : Tally
        What their maps of confidence come to.
    labels : mapping of str to str
        What each method is called.
    phase : DataArray
        The wrapped phase, which says when and where frames are.
    own : float, optional
        The share of the object that is in doubt in directional L1, if that is not among them.
    """
    doubt = {m: np.nan_to_num(tally.doubtful_share(m)) for m in results}
    best = min(doubt, key=lambda m: (round(doubt[m] / ALIKE), m != REFERENCE))
    values = tally.disagreement
    lost, outliers = (
        [(int(t), int(a)) for t, a in np.argwhere(mask)]
        for mask in (problem.lost(), problem.frames_left_out() & ~problem.lost())
    )
    time, angle = np.unravel_index(int(np.argmax(values)), values.shape)
    frame, most = (int(time), int(angle)), float(values.max(initial=0.0))

    words = Words(
        label=labels[best],
        doubt=float(doubt[best]),
        own=None if own is None else float(np.nan_to_num(own)),
        n_results=len(results),
        frame=frame,
        most=most,
        doubtful=tally.doubtful[best],
        inside=tally.inside,
        lost=lost,
        outliers=outliers,
        shows_field=tally.shows_field,
        apart=views_apart(problem),
        doubts=doubts_of(phase, problem.kept),
    )
    found = Verdict(words(phase))
    found._words, found.views_apart = words, words.apart
    found.doubts = [f"The wrapped phase {doubt.verdict}." for doubt in words.doubts]
    found.blurred_percent = max((100 * doubt.blurred for doubt in words.doubts), default=0.0)
    found.method, found.doubtful_percent = best, 100 * doubt[best]
    found.frame = frame if most > 0 else None
    found.disagreement_percent, found.lost_frames = 100 * most, sorted(lost + outliers)
    found.disagreement = of_frames(values, phase)
    return found


def apart_words(apart: list[ViewsApart], stack: xr.DataArray) -> str:
    """Say which views of several wavelengths lie off each other, at the angles of a stack."""
    if not apart:
        return ""
    said = ", and ".join(
        f"{view_of(stack, pair.views[1])} {pair.place} {view_of(stack, pair.views[0])}"
        for pair in apart
    )
    return f"Views do not lie on each other: {said}; Synthetic goes wrong there."


def of_frames(values: NDArray[np.float64], template: xr.DataArray) -> xr.DataArray:
    """Return numbers of all frames (time, angle) with the dims and places of those of a stack."""
    frames = template.isel(dict.fromkeys(("y", "x"), 0), drop=True)
    full = xr.DataArray(values, dims=("time", "angle"))
    missing = [d for d in ("time", "angle") if d not in frames.dims]
    return full.isel(dict.fromkeys(missing, 0)).assign_coords(frames.coords)


def percent(share: float) -> str:
    """Return a share in words."""
    if share < 1e-4:
        return "less than 0.01 %"
    return (
        f"{100 * share:.{0 if share >= 0.1 else 1}f} %"
        if share >= 0.01
        else f"{100 * share:.2g} %"
    )


def first_words(label: str, doubt: float, n: int, doubts: Sequence[Doubt] = ()) -> str:
    """Say which result to use and how far."""
    if doubts:
        why = ", and ".join(each.verdict for each in doubts)
        besides = f"In {label} {percent(doubt)} of the object is in doubt besides" + "," * (n > 1)
        return f"No result is safe: the wrapped phase {why}. {besides}"
    if doubt > SAFE:
        start = f"No result is safe: even in {label}" if n > 1 else f"{label} is not safe:"
        return f"{start} {percent(doubt)} of the object is more likely wrong than right"
    if n == 1:
        return f"{label} alone was run: {percent(doubt)} of the object is in doubt"
    return f"Use {label}: {percent(doubt)} of the object is in doubt"


def where_words(where: str, most: float, n: int) -> str:
    """Say where methods disagree most."""
    if n == 1:
        return "(run others to compare)."
    if most == 0:
        return "and all methods agree."
    at = f" at {where}" if where else ""
    return f"and methods disagree most{at}, on {percent(most)} of the object there."


def view_words(doubtful: Counts, inside: Counts, stack: xr.DataArray) -> str:
    """Say which views are in doubt, if they are as a whole and the others hardly are.

    Parameters
    ----------
    doubtful, inside : ndarray of int, shape (time, angle)
        Pixels of the object that are in doubt, and all of them.
    stack : DataArray
        The phase, whose views these are.
    """
    each, every = doubtful.sum(axis=0), inside.sum(axis=0)
    bad = each > MOST_OF_VIEW * every
    rest = int(every[~bad].sum())
    if not bad.any() or not rest or each[~bad].sum() > SAFE * rest:
        return ""
    names = " and ".join(view_of(stack, int(v), "angle ") for v in np.flatnonzero(bad))
    share = percent(float(each[~bad].sum() / rest))
    return f"This is {names} above all; of what else was seen {share} is in doubt."


def better_words(own: float | None, doubt: float) -> str:
    """Say whether directional L1, which was not asked for, would be better."""
    if own is None or own > doubt - ALIKE:
        return ""
    return f"{METHODS[REFERENCE].label} would leave {percent(own)} in doubt."


def lost_words(lost: list[tuple[int, int]], stack: xr.DataArray, n: int) -> str:
    """Say which frames say nothing."""
    if not lost:
        return ""
    first = frame_in_words(stack, *lost[0])
    if len(lost) == 1:
        return f"The frame at {first} says nothing and is not to be used."
    return f"{len(lost)} of {n} frames say nothing and are not to be used, first {first}."


def outlier_words(outliers: list[tuple[int, int]], stack: xr.DataArray) -> str:
    """Say at which times frames fit neither those before nor those after."""
    times = sorted({time for time, _ in outliers})
    if not times:
        return ""
    one_view = stack.isel(angle=0, drop=True) if "angle" in stack.dims else stack
    first = frame_in_words(one_view, times[0], 0)
    at = f"At {first}" if len(times) == 1 else f"At {len(times)} times, first {first},"
    return (
        f"{at} what is seen fits neither the frame before nor the one after, though these fit "
        "each other: it counts for nothing here; look whether it is damaged."
    )


BOTH = ("temporal-angular", "angular-temporal")
#: Results in the order in which a look at the steps relies on them.
TRUSTED = ("synthetic-wavelength", REFERENCE, *BOTH, "temporal", "angular")
#: The choice between T/A and A/T makes no difference where what one has less lies below this share
#: of all pixels, or below this part of what the worse one has: of 108 simulated recordings,
#: all 6 in which the one nearer to directional L1 was the worse one lie within that part.
LEAST_SHARE, LEAST_PART = 0.0005, 0.1


@checked_call
def most_trusted(results: Mapping[str, xr.DataArray]) -> str:
    """Return the id of the method among the results that is most to be relied on.

    Parameters
    ----------
    results : mapping of str to DataArray
        Method id to unwrapped phase; at least one.

    Returns
    -------
    str
        The first that is there of Synthetic, WL1, T/A, A/T, Temporal and Angular; the first of the
        results if none of these is.
    """
    if not results:
        msg = "results is empty; give at least one"
        raise ValueError(msg)
    return next((m for m in TRUSTED if m in results), next(iter(results)))


@checked_call
def best_known(
    results: Mapping[str, xr.DataArray], truth: xr.DataArray | None = None
) -> tuple[xr.DataArray, str]:
    """Return the phase that is most to be relied on, and what it is in words.

    Parameters
    ----------
    results : mapping of str to DataArray
        Method id to unwrapped phase in radians; at least one where there is no truth.
    truth : xarray.DataArray, optional
        Exact phase in radians, where it is known.

    Returns
    -------
    phase : xarray.DataArray
        The truth, or the result of `most_trusted`, as it was given.
    words : str
        What it is, such as "the exact phase" or "the result of T/A".
    """
    if truth is not None:
        return truth, "the exact phase"
    method = most_trusted(results)
    label = METHODS[method].label if method in METHODS else method
    return results[method], f"the result of {label}"


def steps_sentence(margin: xr.Dataset, basis: str) -> str:
    """Say along which dimensions how many steps are too large to be unwrapped.

    Parameters
    ----------
    margin : Dataset
        What `itoh_margin` gives.
    basis : str
        What it was told from, in words, as `best_known` says it.
    """
    if not margin.data_vars:
        return "There is but one pixel, and no step from it to another."
    shares = ", ".join(
        f"{str(name).removeprefix('along_')} {100 * along.attrs['share_beyond']:.3g} %"
        for name, along in margin.data_vars.items()
    )
    return f"Steps beyond half a cycle, by {basis}: {shares}."


@checked_call
def order_verdict(
    results: Mapping[str, xr.DataArray],
    boundary: tuple[int, int] = (0, 0),
    truth: xr.DataArray | None = None,
) -> str:
    """Say in one sentence which of T/A and A/T suits the object better, and why.

    Where the truth is known, the one that is right in more pixels, or, before both were run, the
    one that meets fewer steps beyond half a cycle; where the result of directional L1 is, the one
    that is nearer to it. The results of the two alone can't tell: that of T/A looks smooth along
    the angle, because its last pass made it so, and that of A/T along time.

    Parameters
    ----------
    results : mapping of str to DataArray
        Unwrapped phase of some methods.
    boundary : tuple of int, optional
        The optically thin frame (time, angle).
    truth : DataArray, optional
        Exact phase, where it is known.

    Returns
    -------
    str
        A whole sentence; where it can't be told, it says so and which methods to run.
    """
    if not has_order(truth, *results.values()):
        return "Of one time, or of one view, there is no order to choose."
    both = all(method in results for method in BOTH)
    reference = METHODS[REFERENCE].label
    if truth is not None and both:
        wrong = {m: wrong_cycle_share(results[m], truth) for m in BOTH}
        return fewer(wrong, "is wrong in")
    if truth is not None:
        return fewer_steps(order_shares(truth, boundary))
    if both and REFERENCE in results:
        return nearer(results)
    missing = [METHODS[m].label for m in (*BOTH, REFERENCE) if m not in results]
    needed = " and ".join(missing)
    return (
        f"Which of T/A and A/T suits better can't be told yet: run {needed} too, since the one "
        f"that is nearer to {reference} is the better one."
    )


def has_order(*stacks: xr.DataArray | None) -> bool:
    """Say whether there are several times and several views, or nothing that tells."""
    known = [stack for stack in stacks if stack is not None]
    return not known or all(known[0].sizes.get(axis, 1) > 1 for axis in ("time", "angle"))


def nearer(results: Mapping[str, xr.DataArray]) -> str:
    """Say which of T/A and A/T differs from the result of directional L1 in fewer pixels."""
    shares = {m: float((turns_off(results[m], results[REFERENCE]) != 0).mean()) for m in BOTH}
    return fewer(shares, f"differs from {METHODS[REFERENCE].label} in")


def fewer(shares: Mapping[str, float], does: str) -> str:
    """Say which of the two does it in fewer of the pixels, or that it makes no difference."""
    first, second = sorted(BOTH, key=lambda m: shares[m])
    labels, said = (
        (METHODS[first].label, METHODS[second].label),
        [percent(shares[m]) for m in (first, second)],
    )
    if alike(shares[first], shares[second]):
        return (
            f"T/A or A/T makes no difference: {labels[0]} {does} {said[0]} of the pixels, "
            f"{labels[1]} in {said[1]}."
        )
    return (
        f"{labels[0]} suits better: it {does} {said[0]} of the pixels, {labels[1]} in {said[1]}."
    )


def fewer_steps(shares: Mapping[str, float]) -> str:
    """Say which of the two meets fewer steps beyond half a cycle in the exact phase."""
    first, second = sorted(BOTH, key=lambda m: shares[m])
    if alike(shares[first], shares[second]):
        return "T/A and A/T meet equally many, by the exact phase."
    return f"{METHODS[first].label} meets fewer of them, by the exact phase."


def alike(less: float, more: float) -> bool:
    """Say whether two shares of all pixels are about the same."""
    return more - less < max(LEAST_SHARE, LEAST_PART * more)
