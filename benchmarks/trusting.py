"""Whether confidence finds wrong pixels and slipped objects where it was not fitted."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np
import xarray as xr
from everyday import SHEETS, sheet_of
from numpy.typing import NDArray
from regimes import (
    OWN_PHANTOMS,
    UNSEEN_FAULTY,
    WALLS,
    Case,
    every_third,
    faults,
    hard_shapes,
    noisy,
    object_,
    one_view,
    own_phantoms,
    sharp_walls,
    sparse_lapses,
    thicker,
    turns_off,
)
from scipy import ndimage
from scipy.stats import rankdata
from tables import heading, line

import napari_phase4d as p4d
from napari_phase4d.analysis import slipped_frames
from napari_phase4d.simulation import HARD_SHAPES

Mask = NDArray[np.bool_]

METHODS = (
    "spatial-2d",
    "temporal",
    "temporal-angular",
    "region-growing",
    "directional-growing",
    "directional-l1",
)
WL1 = "directional-l1"
#: Every other shape and wall, beginning with the first, was looked at when confidence was fitted,
#: and so was every other sparse recording.
FITTED = {*OWN_PHANTOMS[::2], *tuple(HARD_SHAPES)[::2], *tuple(WALLS)[::2]}
#: Walls that were there from the start: nothing in a recording tells 5 rad from 5 - 2 pi.
UNKNOWABLE = ("disc of 5 rad that stays", "disc of 8 rad that falls")
#: An area under the curve needs at least so many wrong pixels; an object so many pixels.
ENOUGH, OBJECT = 20, 30
#: What of a sheet is no sheet any more, in radians.
SLIGHT = 0.3


def unseen(case: Case) -> bool:
    """Say whether a case was not looked at when confidence was fitted."""
    words = case.name.split(",")[0].split("/")[0]
    if words.startswith("seed "):
        return int(words[5:]) % 2 == 1
    return words not in FITTED


REGIMES = (
    ("own phantoms, noise 0.5", lambda: own_phantoms(0.5)),
    ("own phantoms, noise 0.7", lambda: own_phantoms(0.7)),
    ("own phantoms, noise 0.9", lambda: own_phantoms(0.9)),
    ("hard shapes, noise 0.7", lambda: hard_shapes(0.7)),
    ("half as thick again, noise 0.4", lambda: thicker(0.4)),
    ("every third time of the second half, noise 0.3", lambda: every_third(0.3)),
    ("one view, noise 0.5", lambda: one_view(0.5)),
    ("a fault half way, noise 0.5", lambda: faults(0.5, UNSEEN_FAULTY)),
    ("sparse time lapses", sparse_lapses),
    ("sharp walls", sharp_walls),
)


@dataclass
class Tally:
    """What was counted for one method.

    Parameters
    ----------
    areas : list of float
        Area under the curve of every recording that has wrong pixels.
    chances, outcomes : list of ndarray
        Chance of an error of every pixel of the object, and whether there was one.
    """

    areas: list[float] = field(default_factory=list)
    chances: list[NDArray[np.float32]] = field(default_factory=list)
    outcomes: list[Mask] = field(default_factory=list)
    found: int = 0
    slipped: int = 0
    false: int = 0
    right: int = 0

    def add(self, chance: NDArray[np.float32], wrong: Mask) -> None:
        """Count the pixels of a recording."""
        self.chances.append(chance)
        self.outcomes.append(wrong)
        if wrong.sum() >= ENOUGH and not wrong.all():
            self.areas.append(area_under_curve(chance, wrong))

    def add_frames(self, said: Mask, slipped: Mask) -> None:
        """Count the frames of a recording."""
        self.found += int((said & slipped).sum())
        self.slipped += int(slipped.sum())
        self.false += int((said & ~slipped).sum())
        self.right += int((~slipped).sum())


def area_under_curve(score: NDArray[np.float32], wrong: Mask) -> float:
    """Return how often a wrong pixel scores higher than a right one."""
    ranks, n = rankdata(score), int(wrong.sum())
    return float((ranks[wrong].sum() - n * (n + 1) / 2) / (n * (len(wrong) - n)))


def slips(wrong: Mask, inside: Mask) -> Mask:
    """Mark the frames (time, angle) in which most of an object is wrong in truth."""
    found = np.zeros(inside.shape[:2], dtype=bool)
    for frame in np.ndindex(*found.shape):
        labels, count = ndimage.label(inside[frame])
        size = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        bad = np.bincount(labels[wrong[frame] & inside[frame]], minlength=count + 1)[1:]
        found[frame] = bool(((size >= OBJECT) & (bad > 0.5 * size)).any())
    return found


def judge(case: Case, tallies: dict[str, Tally], methods: tuple[str, ...] = METHODS) -> None:
    """Count how well the confidence of methods fits a case."""
    compared = p4d.compare(case.wrapped, list(methods))
    inside = ~case.empty & np.isfinite(case.truth)
    for method, trust in compared.confidences().items():
        off = turns_off(compared.results[method].values, case)
        wrong = np.nan_to_num(off) != 0
        tally = tallies.setdefault(method, Tally())
        tally.add(1 - trust.values[inside], wrong[inside])
        if compared.problem is not None:
            tally.add_frames(slipped_frames(compared.problem, trust), slips(wrong, inside))


def calibration(tally: Tally) -> None:
    """Print whether the confidence of a method may be taken literally."""
    chance, wrong = np.concatenate(tally.chances), np.concatenate(tally.outcomes)
    heading("Confidence of WL1", "chance-to-be-wrong pixels wrong-in-truth-(%)")
    limits = (0, 0.01, 0.03, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0001)
    for low, high in pairwise(limits):
        chosen = (chance >= low) & (chance < high)
        share = f"{100 * wrong[chosen].mean():.3f}" if chosen.any() else ""
        line(f"{low:g} to {min(high, 1):g}", int(chosen.sum()), share)


def confidence() -> None:
    """How well confidence finds wrong pixels and slipped objects where it was not fitted."""
    heading(
        "Confidence of WL1, by regime: area under the curve; frames in which most of an object is "
        "wrong that are warned of, and false alarms",
        "regime recordings with-wrong-pixels mean worst found slipped false-alarms right-frames",
    )
    every: dict[str, Tally] = {}
    for words, cases in REGIMES:
        here: dict[str, Tally] = {}
        count = 0
        for case in cases():
            if unseen(case) and not case.name.startswith(UNKNOWABLE):
                count += 1
                judge(case, here)
        for method, tally in here.items():
            merge(every.setdefault(method, Tally()), tally)
        own = here[WL1]
        mean = statistics.mean(own.areas) if own.areas else ""
        worst = min(own.areas, default="")
        line(
            words, count, len(own.areas), mean, worst, own.found, own.slipped, own.false, own.right
        )
    by_method("Confidence of all methods", every)
    calibration(every[WL1])


def by_method(title: str, every: dict[str, Tally]) -> None:
    """Print what was counted for each method."""
    heading(
        title,
        "method recordings mean worst given-less-than-1-%:-wrong-(%) "
        "given-more-than-90-%:-right-(%) found slipped false-alarms right-frames",
    )
    for method, tally in every.items():
        chance, wrong = np.concatenate(tally.chances), np.concatenate(tally.outcomes)
        safe, bad = wrong[chance < 0.01], ~wrong[chance > 0.9]
        line(
            p4d.METHODS[method].label,
            len(tally.areas),
            statistics.mean(tally.areas) if tally.areas else "",
            min(tally.areas, default=""),
            f"{100 * safe.mean():.3f}",
            f"{100 * bad.mean():.1f}" if bad.size else "",
            tally.found,
            tally.slipped,
            tally.false,
            tally.right,
        )


def sheets() -> None:
    """How well confidence finds what is wrong of sheets that look like the empty field."""
    every: dict[str, Tally] = {}
    for number, kind in enumerate(SHEETS):
        clean = sheet_of(*kind).astype(np.float32)
        for noise in (0.5, 0.7):
            added = np.random.default_rng(number).normal(0, noise, clean.shape)
            phase = clean + added.astype(np.float32)
            wrapped = xr.DataArray(np.angle(np.exp(1j * phase)), dims=("time", "angle", "y", "x"))
            case = Case(f"sheet {number}", wrapped, phase, clean < SLIGHT)
            judge(case, every, (*METHODS, "angular", "angular-temporal"))
    by_method("Confidence of sheets that are about whole turns high", every)


#: Objects that confidence and its mass were not looked at on: words, factor of the phase, which
#: times, noise in radians.
ELSEWHERE = (
    ("twice as thick", 2.0, slice(None), 0.2),
    ("three quarters thicker, turned round in time", 1.75, slice(None, None, -1), 0.3),
    ("a third thicker, every second time", 1.35, slice(1, None, 2), 0.4),
    ("a fifth thinner, every third time", 0.8, slice(2, None, 3), 0.45),
)


def others(words: str, factor: float, times: slice, noise: float) -> Iterator[Case]:
    for name in (*OWN_PHANTOMS, *HARD_SHAPES):
        exact = object_(name).isel(time=times)
        exact = exact.assign_coords(time=np.arange(exact.sizes["time"]) * 1.0)
        exact = exact.assign(phase=np.float32(factor) * exact["phase"])
        yield noisy(name, exact, noise, f"{words}{name}")


def elsewhere() -> None:
    """How well confidence finds WL1's slips in recordings on which nothing was chosen."""
    heading(
        "Confidence of WL1 elsewhere",
        "regime recordings with-wrong-pixels mean worst given-less-than-1-%:-wrong-(%) "
        "found slipped false-alarms right-frames",
    )
    regimes = [(words[0], partial(others, *words)) for words in ELSEWHERE]
    regimes.append(("sparse time lapses", partial(sparse_lapses, range(300, 320))))
    for words, cases in regimes:
        tally, count = Tally(), 0
        for case in cases():
            count += 1
            judge(case, {WL1: tally}, (WL1,))
        areas = tally.areas
        chance, wrong = np.concatenate(tally.chances), np.concatenate(tally.outcomes)
        mean = statistics.mean(areas) if areas else ""
        line(
            words, count, len(areas), mean, min(areas, default=""),
            f"{100 * wrong[chance < 0.01].mean():.3f}",
            tally.found, tally.slipped, tally.false, tally.right,
        )  # fmt: skip


def merge(whole: Tally, part: Tally) -> None:
    """Add what was counted in one regime to what was counted in all."""
    whole.areas += part.areas
    whole.chances += part.chances
    whole.outcomes += part.outcomes
    whole.found, whole.slipped = whole.found + part.found, whole.slipped + part.slipped
    whole.false, whole.right = whole.false + part.false, whole.right + part.right
