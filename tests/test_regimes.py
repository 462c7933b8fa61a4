"""The error of WL1 in the regimes of the benchmark is still what was measured.

A change that is right for the recordings it was made for may make others worse. Bounds of the mean
are a twentieth and 0.003 rad² above what was measured; where it is large already, the number of
recordings in which something has slipped tells one more.
"""

from __future__ import annotations

import statistics
import sys
from collections.abc import Callable, Iterator

import pytest

from helpers import ROOT

sys.path.append(str(ROOT / "benchmarks"))
import regimes
import trusting
from regimes import Case

#: A test is up to 80 recordings.
pytestmark = [pytest.mark.thorough, pytest.mark.timeout(1200)]

#: An error of more rad² is a slip.
SLIP = 0.1
#: What makes the recordings, and the noise in radians; the mean squared error of WL1 in rad², and
#: how many recordings have more than `SLIP`.
MEASURED: list[tuple[Callable[[float], Iterator[Case]], float, float, int]] = [
    (regimes.own_phantoms, 0.5, 0.0050, 0),
    (regimes.hard_shapes, 0.5, 0.0006, 0),
    (regimes.two_far_views, 0.5, 0.0016, 0),
    (regimes.one_view, 0.5, 0.0076, 0),
    (regimes.one_time, 0.0, 0.2091, 1),
    (regimes.thicker, 0.0, 0.1855, 6),
    (regimes.second_half, 0.5, 0.0961, 1),
    (regimes.every_third, 0.3, 0.1459, 3),
    (regimes.every_second, 0.0, 0.1481, 4),
    (regimes.every_second, 0.3, 0.1517, 4),
    (regimes.curved_field, 0.4, 0.0053, 0),
    (regimes.cut_off, 0.4, 0.0025, 0),
    (regimes.shared_noise, 0.5, 0.0023, 0),
    (regimes.channels, 0.4, 0.0665, 3),
    (regimes.faded, 0.2, 0.0019, 0),
    (regimes.dark_rims, 0.02, 0.2310, 5),
    (regimes.faults, 0.5, 0.1145, 3),
    (regimes.unseen_faults, 0.5, 0.1295, 3),
    (regimes.view_away, 0.5, 0.0105, 1),
    (regimes.views_by_chance, 0.0, 0.0150, 1),
    (regimes.views_by_chance, 0.5, 0.0571, 2),
]
#: The same of `trusting.ELSEWHERE`, on which nothing was chosen.
ELSEWHERE = [(0.7394, 10), (0.8826, 14), (0.2506, 6), (0.0006, 0)]


def is_no_worse(cases: Iterator[Case], mean: float, slips: int) -> None:
    found = {case.name: regimes.error(regimes.WL1, case) for case in cases}
    worst = dict(sorted(found.items(), key=lambda item: -item[1])[: slips + 3])
    assert sum(error > SLIP for error in found.values()) <= slips, worst
    assert statistics.mean(found.values()) <= 1.05 * mean + 0.003, worst


# Frames without noise among others of nothing but noise, and objects of just half a turn.
@pytest.mark.filterwarnings("ignore:phase (is just|jumps by)")
@pytest.mark.parametrize(("cases", "noise", "mean", "slips"), MEASURED)
def test_no_regime_has_become_worse(
    cases: Callable[[float], Iterator[Case]], noise: float, mean: float, slips: int
) -> None:
    is_no_worse(cases(noise), mean, slips)


@pytest.mark.parametrize("number", range(len(trusting.ELSEWHERE)))
def test_nor_has_any_that_nothing_was_chosen_on(number: int) -> None:
    is_no_worse(trusting.others(*trusting.ELSEWHERE[number]), *ELSEWHERE[number])


def test_nor_have_sparse_time_lapses() -> None:
    is_no_worse(regimes.sparse_lapses(), 0.0012, 0)
