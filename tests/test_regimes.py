"""The error of WL1 in every regime of the benchmark is still that of its table.

A change that is right for the recordings it was made for may make others worse. Every bound is
what was measured, and a twentieth and 0.003 rad² more: one object that slips stands out.
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

pytestmark = pytest.mark.thorough

#: What makes the recordings, the noise in radians, and the mean squared error in rad² of WL1.
MEASURED: list[tuple[Callable[[float], Iterator[Case]], float, float]] = [
    (regimes.own_phantoms, 0.5, 0.0050),
    (regimes.hard_shapes, 0.5, 0.0006),
    (regimes.one_view, 0.5, 0.0076),
    (regimes.one_time, 0.0, 0.2091),
    (regimes.thicker, 0.0, 0.1929),
    (regimes.second_half, 0.5, 0.0961),
    (regimes.every_third, 0.3, 0.1459),
    (regimes.every_second, 0.0, 0.1481),
    (regimes.every_second, 0.3, 0.1517),
    (regimes.curved_field, 0.4, 0.0053),
    (regimes.cut_off, 0.4, 0.0025),
    (regimes.shared_noise, 0.5, 0.0023),
    (regimes.channels, 0.4, 0.0665),
    (regimes.faded, 0.2, 0.0019),
    (regimes.dark_rims, 0.02, 0.2310),
    (regimes.faults, 0.5, 0.1145),
]
#: The same of recordings on which nothing was chosen.
ELSEWHERE = [0.7394, 0.8826, 0.2506]


def mean_error(cases: Iterator[Case]) -> float:
    return statistics.mean(regimes.error(regimes.WL1, case) for case in cases)


def at_most(measured: float) -> float:
    return 1.05 * measured + 0.003


@pytest.mark.parametrize(("cases", "noise", "measured"), MEASURED)
def test_no_regime_has_become_worse(
    cases: Callable[[float], Iterator[Case]], noise: float, measured: float
) -> None:
    assert mean_error(cases(noise)) <= at_most(measured)


@pytest.mark.parametrize("number", range(len(ELSEWHERE)))
def test_nor_has_any_that_nothing_was_chosen_on(number: int) -> None:
    cases = trusting.others(*trusting.ELSEWHERE[number])
    assert mean_error(cases) <= at_most(ELSEWHERE[number])


def test_nor_have_sparse_time_lapses() -> None:
    assert mean_error(regimes.sparse_lapses()) <= at_most(0.0012)
