"""Phase that hypothesis makes up, and what to ask of an answer."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

TURN = 2 * np.pi

#: Examples of each property; more to search longer by hand.
EXAMPLES = int(os.environ.get("PHASE4D_EXAMPLES", "8"))

quick = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


class Case:
    """A stack of phase with a frame to start from; shown in one line where a test fails."""

    def __init__(self, phase: np.ndarray, boundary: tuple[int, int], seed: int) -> None:
        self.phase, self.boundary, self.seed = phase, boundary, seed

    def __repr__(self) -> str:
        return f"<{self.phase.shape}, boundary {self.boundary}, seed {self.seed}>"


@st.composite
def noise(draw: Any, smallest: int = 2, *, ties: bool = True) -> Case:
    """Uniform noise; in some examples only few values occur, so that costs tie."""
    sides = st.integers(smallest, 16)
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 3), sides, sides))
    seed = draw(st.integers(0, 2**31))
    levels = draw(st.sampled_from([None, None, 2, 5] if ties else [None]))
    rng = np.random.default_rng(seed)
    phase = rng.uniform(-np.pi, np.pi, shape)
    if levels:
        phase = rng.integers(-levels, levels + 1, shape) * (np.pi / levels)
    return Case(phase.astype(np.float32), boundary_of(draw, shape), seed)


@st.composite
def gentle(draw: Any) -> Case:
    """Waves and noise whose largest step is up to 0.95 of half a turn."""
    sides = st.integers(2, 16)
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 3), sides, sides))
    seed = draw(st.integers(0, 2**31))
    steepest = draw(st.sampled_from([0.3, 0.6, 0.95]))
    rng = np.random.default_rng(seed)
    places = np.indices(shape).astype(float)
    phase = rng.normal(0, 0.1, shape)
    for _ in range(rng.integers(1, 4)):
        waves = np.tensordot(rng.uniform(-1.2, 1.2, 4), places, 1)
        phase += rng.normal() * np.sin(waves + rng.uniform(0, TURN))
    phase += np.tensordot(rng.normal(0, 0.3, 4), places, 1)
    return Case(phase * (steepest * np.pi / largest_step(phase)), boundary_of(draw, shape), seed)


@st.composite
def gentle_cell(draw: Any) -> Case:
    """A cell that grows in an empty field of any phase, as steep as `gentle`."""
    shape = draw(st.tuples(st.integers(1, 4), st.integers(1, 3), *[st.integers(12, 20)] * 2))
    seed, steepest = draw(st.integers(0, 2**31)), draw(st.sampled_from([0.3, 0.6, 0.95]))
    rng = np.random.default_rng(seed)
    time, angle, *place = np.indices(shape).astype(float)
    middle = [n * rng.uniform(0.35, 0.65) for n in shape[2:]]
    off = [(p - m) / (0.3 * n) for p, m, n in zip(place, middle, shape[2:], strict=True)]
    growth = 1 + rng.uniform(0.2, 1) * time + rng.uniform(0, 0.3) * angle
    phase = np.maximum(1 - off[0] ** 2 - off[1] ** 2, 0) ** 2 * growth
    phase = phase * (steepest * np.pi / largest_step(phase)) + rng.uniform(-10, 10)
    return Case(phase, boundary_of(draw, shape), seed)


def largest_step(phase: np.ndarray) -> float:
    return float(max(np.abs(np.diff(phase, axis=i)).max(initial=0) for i in range(4)))


def boundary_of(draw: Any, shape: tuple[int, ...]) -> tuple[int, int]:
    return draw(st.integers(0, shape[0] - 1)), draw(st.integers(0, shape[1] - 1))


def turns_between(result: np.ndarray, wrapped: np.ndarray) -> np.ndarray:
    """Return the whole turns between two phases, and fail where they are not whole."""
    turns = (result.astype(np.float64) - wrapped.astype(np.float64)) / TURN
    rounded = np.round(turns)
    # Single precision rounds to 2^-24 of the result.
    allowed = (1 + np.abs(result).max(initial=0)) * 2.0**-22 / TURN
    assert np.abs(turns - rounded).max(initial=0) <= allowed
    return rounded


def same_but_for_one_number(turns: np.ndarray) -> bool:
    return bool(np.ptp(turns) == 0) if turns.size else True
