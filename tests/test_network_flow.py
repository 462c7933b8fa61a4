"""Network flow: exact closing of loops, both solvers, and its two stages."""

from __future__ import annotations

import importlib.util
import itertools

import kamui
import numpy as np
import pytest

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.stack import Block
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import Problem, network_flow
from napari_phase4d.unwrapping.network_flow import whole_turns

TURN = 2 * np.pi
SOLVERS = [network_flow.by_linear_program, network_flow.by_ortools]


def steps(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turns to add to the plain differences so that each is less than half a turn."""
    return -whole_turns(np.diff(w, axis=-2)), -whole_turns(np.diff(w, axis=-1))


def turns_between(unwrapped: np.ndarray) -> float:
    """The cost of an unwrapping: turns by which its steps differ from the wrapped ones."""
    return sum(np.abs(whole_turns(np.diff(unwrapped, axis=i))).sum() for i in (-1, -2))


@pytest.fixture(params=SOLVERS, ids=lambda s: s.__name__)
def solver(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let one of the two solvers do the work."""
    if request.param is network_flow.by_linear_program:
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    else:
        pytest.importorskip("ortools")


@pytest.mark.thorough
@pytest.mark.usefixtures("solver")
def test_no_cheaper_turns_close_the_loops() -> None:
    """All combinations of -1, 0 and 1 on a small grid are tried."""
    rng = np.random.default_rng(3)
    for _ in range(4):
        w = wrap(rng.normal(0, 2, (3, 3)))
        down, right = steps(w)
        costs = rng.integers(1, 9, 12)
        more = network_flow.closing_turns(
            down[None], right[None], costs[:6].reshape(1, 2, 3), costs[6:].reshape(1, 3, 2)
        )
        assert not network_flow.loop_sums(down + more[0][0], right + more[1][0]).any()
        found = int((np.abs(np.concatenate([m.ravel() for m in more])) * costs).sum())
        tried = np.array(list(itertools.product((-1, 0, 1), repeat=12)))
        sums = network_flow.loop_sums(
            down + tried[:, :6].reshape(-1, 2, 3), right + tried[:, 6:].reshape(-1, 3, 2)
        )
        closed = ~sums.any(axis=(1, 2))
        assert found == int((np.abs(tried[closed]) * costs).sum(axis=1).min())


@pytest.mark.usefixtures("solver")
def test_one_frame_costs_as_little_as_kamuis_flow() -> None:
    rng = np.random.default_rng(1)
    y, x = np.indices((40, 44))
    phase = 12 * np.exp(-((y - 20) ** 2 + (x - 22) ** 2) / 60) + rng.normal(0, 0.9, y.shape)
    w = wrap(phase)
    ours = p4d.unwrap(w, "network-flow").values
    theirs = kamui.unwrap_dimensional(w, use_edgelist=True)  # its other mode leaves rims free
    assert turns_between(ours) == turns_between(theirs)
    assert np.mean(np.round((ours - theirs) / TURN) != 0) < 0.01  # equal costs may lie elsewhere


def test_both_solvers_find_the_same_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ortools")
    w = wrap(np.random.default_rng(2).normal(0, 1.3, (30, 30)))
    fast = p4d.unwrap(w, "network-flow").values
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    slow = p4d.unwrap(w, "network-flow").values
    assert turns_between(fast) == turns_between(slow)


@pytest.mark.usefixtures("solver")
def test_steps_beyond_half_a_turn_are_followed_from_the_boundary_frame() -> None:
    """A cliff grows by little at a time: no single frame tells, its history does."""
    cliff = np.zeros((12, 20))
    cliff[:, 10:] = 1
    heights = np.linspace(0, 20, 16)[:, None, None, None] * np.array([1.0, 1.05])[:, None, None]
    phase = heights * cliff
    w = wrap(phase)
    found = p4d.unwrap(w, "network-flow").values
    np.testing.assert_allclose(found, phase, atol=1e-4)
    frame_by_frame = p4d.unwrap(w, "spatial-2d").values
    assert np.abs(frame_by_frame - phase).max() > np.pi


@pytest.mark.usefixtures("solver")
def test_parts_of_a_mask_keep_one_level_and_the_result_is_congruent() -> None:
    y, x = np.indices((30, 60))
    one = 7 * np.exp(-((y - 15) ** 2 + (x - 15) ** 2) / 60)
    two = 9 * np.exp(-((y - 15) ** 2 + (x - 45) ** 2) / 60)
    still = one + two
    phase = np.linspace(0.4, 1, 5)[:, None, None, None] * np.repeat(still[None, None], 2, axis=1)
    noisy = phase + np.random.default_rng(0).normal(0, 0.3, phase.shape)
    mask = np.hypot(y - 15, (x - 30) % 30 - 15) < 13
    w = wrap(noisy).astype(np.float32)
    found = p4d.unwrap(w, "network-flow", mask=mask).values
    assert (found[..., ~mask] == 0).all()
    np.testing.assert_allclose(found[..., mask], noisy[..., mask], atol=1e-4)
    turns = (found - w)[..., mask] / TURN
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)


def test_progress_and_cancel() -> None:
    w = wrap(np.random.default_rng(0).normal(0, 1, (3, 2, 12, 12)))
    seen: list[tuple[int, int, str]] = []
    p4d.unwrap(w, "network-flow", progress=lambda *told: seen.append(told))
    assert {m for _, _, m in seen} == {
        "network flow",
        "network flow over time and angle, along y",
        "network flow over time and angle, along x",
        "network flow in each frame",
        "writing",
    }
    with pytest.raises(p4d.Cancelled):
        p4d.unwrap(w, "network-flow", cancelled=lambda: True)


@pytest.mark.slow
def test_a_mask_that_was_found_does_no_harm() -> None:
    data = p4d.simulation.budding_yeast()
    exact = data["phase"].values

    def error(mask: str | None) -> float:
        found = p4d.unwrap(data["wrapped"], "network-flow", mask=mask).values
        return float(((found - exact) ** 2).mean())

    assert error("auto") <= 1.1 * error(None)


def test_turns_are_dear_where_the_first_stage_closed() -> None:
    """A patch that has been noisy over time is cut through rather than its steady surroundings."""
    rng = np.random.default_rng(0)

    def cost(problem: Problem) -> np.ndarray:
        phase, used = network_flow.copied(problem, UNWATCHED)
        steps = network_flow.steps_over_frames
        _, found = steps(problem, phase, used, UNWATCHED, down=False)
        return found.read(Block(0, 6))[..., :-1]

    w = np.zeros((6, 3, 10, 12))
    w[:, :, 3:7, 3:9] = rng.normal(0, 2.5, (6, 3, 4, 6))
    problem = Problem(wrap(w), (0, 0), None)
    found = cost(problem)
    assert (found[:, :, :2] == network_flow.STEADY).all()
    inner = found[:, :, 4:6, 4:8]
    assert (inner == network_flow.MENDED).mean() > 0.5
    masked = Problem(wrap(w), (0, 0), np.tile(np.arange(12) < 6, (10, 1)))
    found = cost(masked)
    assert (found[..., 6:] == network_flow.OUTSIDE).all()
