"""How firmly steps hold the parts of a result."""

from __future__ import annotations

import numpy as np
import pytest

from napari_phase4d.unwrapping.directional.merging import held_by_steps

NO_WAY = 12.0


def random_steps(seed: int) -> tuple[np.ndarray, ...]:
    """Return steps between ten nodes; many are equally rough, and a third disagrees."""
    rng = np.random.default_rng(seed)
    first = rng.integers(0, 10, 30).astype(np.int32)
    second = ((first + rng.integers(1, 10, 30)) % 10).astype(np.int32)
    off = rng.choice([0, 0, 0, 0, 1, -2], 30).astype(np.int32)
    rough = rng.choice([0.0, 0.5, 1.0, 2.0, 3.0], 30).astype(np.float32)
    return first, second, off, rough


def cost(part: set[int], up: int, steps: tuple[np.ndarray, ...]) -> tuple[float, int]:
    """Return what it costs to move a part by a turn, and how many steps lie at its rim."""
    total, count = 0.0, 0
    for a, b, off, rough in zip(*(c.tolist() for c in steps), strict=True):
        if (a in part) == (b in part):
            continue
        count += 1
        moved = off + up if b in part else off - up
        total += (abs(moved) - abs(off)) * (1 + rough) ** -2
    return total, count


def parts_at(limit: float, steps: tuple[np.ndarray, ...]) -> list[set[int]]:
    """Return what hangs together along steps that agree and are no rougher than a limit."""
    parts = [{i} for i in range(10)]
    for a, b, off, rough in zip(*(c.tolist() for c in steps), strict=True):
        if off == 0 and rough <= limit:
            one = next(p for p in parts if a in p)
            other = next(p for p in parts if b in p)
            if one is not other:
                parts.remove(other)
                one |= other
    return parts


@pytest.mark.parametrize("seed", range(20))
def test_it_is_what_trying_every_part_gives(seed: int) -> None:
    steps = random_steps(seed)
    worst, held = held_by_steps(*steps, 10, NO_WAY)
    for node in range(1, 10):
        least, way = 1.0, NO_WAY
        # Before any step is gone, then at each roughness in turn.
        for limit in (-1.0, 0.0, 0.5, 1.0, 2.0, 3.0):
            part = next(p for p in parts_at(limit, steps) if node in p)
            if 0 in part:
                way = limit
                break
            up, count = cost(part, 1, steps)
            down, _ = cost(part, -1, steps)
            least = min(least, min(up, down) / max(count, 1))
        assert worst[node] == np.float32(way)
        assert held[node] == pytest.approx(least if way < NO_WAY else min(least, 0), abs=1e-6)
    assert (worst[0], held[0]) == (0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_the_order_of_steps_does_not_matter(seed: int) -> None:
    steps = random_steps(seed)
    order = np.random.default_rng(seed + 100).permutation(30)
    plain = held_by_steps(*steps, 10, NO_WAY)
    mixed = held_by_steps(*(column[order] for column in steps), 10, NO_WAY)
    np.testing.assert_array_equal(plain[0], mixed[0])
    np.testing.assert_allclose(plain[1], mixed[1], atol=1e-6)


def test_one_smooth_step_against_many_does_not_hold() -> None:
    """Two nodes joined to each other, and to the ground by one step that five contradict."""
    first = np.array([1, 0, 0, 0, 0, 0, 0], dtype=np.int32)
    second = np.array([2, 1, 2, 2, 1, 2, 1], dtype=np.int32)
    off = np.array([0, 0, 1, 1, 1, 1, 1], dtype=np.int32)
    rough = np.zeros(7, dtype=np.float32)
    worst, held = held_by_steps(first, second, off, rough + np.float32(0.1), 3, NO_WAY)
    np.testing.assert_allclose(worst, [0, 0.1, 0.1], rtol=1e-6)
    # Node 2 by itself: one step holds it, three ask for a turn less.
    assert held[2] == pytest.approx((1 - 3) / 4 / 1.1**2)
    agreeing = held_by_steps(first, second, off * 0, rough + np.float32(0.1), 3, NO_WAY)[1]
    assert agreeing[2] == pytest.approx(1 / 1.1**2)


def test_no_steps_are_no_way() -> None:
    none = np.zeros(0, dtype=np.int32)
    worst, held = held_by_steps(none, none, none, none.astype(np.float32), 3, NO_WAY)
    np.testing.assert_array_equal(worst, [0, NO_WAY, NO_WAY])
    np.testing.assert_array_equal(held, [1, 0, 0])
