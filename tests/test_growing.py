"""Region growing: the exact result of joining along the cheapest steps first, in quick ways."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.restoration import unwrap_phase

import napari_phase4d as p4d
from napari_phase4d import compiling
from napari_phase4d.unwrapping import methods_for
from napari_phase4d.unwrapping.growing import (
    Workspace,
    coherence,
    grow_grid,
    grow_list,
    growth,
    second_differences,
)
from napari_phase4d.unwrapping.growing.costs import Costs, half_stencil
from napari_phase4d.unwrapping.growing.merging import joined, mark_cheap, mark_cheapest_of_each
from napari_phase4d.unwrapping.growing.rows import BORDER, full_shape, integrated, residue_limit

TURN = 2 * np.pi
#: Like scikit-image: pixels at all faces of a volume are the least reliable.
AT_ALL_FACES = partial(second_differences, bounded=(1, 2))


def wrap(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * phase)).astype(np.float32)


def scene(kind: str, shape: tuple[int, ...] = (128, 160), seed: int = 0) -> np.ndarray:
    """Wrapped phase of smooth cells, of steep ones, of noise, or of frames hard to unwrap."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: shape[-2], : shape[-1]]
    if kind == "spiral":  # a vortex: no way round it closes
        return np.broadcast_to(np.arctan2(y - 60.3, x - 70.2).astype(np.float32), shape).copy()
    if kind == "random":
        return rng.uniform(-np.pi, np.pi, shape).astype(np.float32)
    sigma, peak = {"smooth": (0.1, 12), "noisy": (0.6, 12), "steep": (0.2, 60), "hard": (0.9, 12)}[
        kind
    ]
    height = np.zeros(shape)
    for cy, cx, r in ((0.35, 0.4, 0.25), (0.65, 0.6, 0.2)):
        rho = ((y - cy * shape[-2]) ** 2 + (x - cx * shape[-1]) ** 2) / (r * shape[-2]) ** 2
        height = np.maximum(height, peak * np.exp(-2 * rho))
    return wrap(height + rng.normal(0, sigma, shape))


KINDS = ("smooth", "noisy", "steep", "hard", "spiral", "random")


def differing(turns: np.ndarray, wrapped: np.ndarray, peer: np.ndarray) -> np.ndarray:
    """Mark pixels whose turns differ from those of a peer by more than one number for all."""
    off = turns - np.round((peer - wrapped) / TURN).astype(int)
    values, counts = np.unique(off, return_counts=True)
    return off != values[np.argmax(counts)]


# ---- against an independent program ----------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", KINDS)
def test_a_frame_is_scikit_images(kind: str, seed: int) -> None:
    """Equal but for pixels at the frame's border, whose order is left to chance there."""
    wrapped = scene(kind, seed=seed)
    turns, _ = grow_grid(wrapped)
    wrong = differing(turns, wrapped, unwrap_phase(wrapped, rng=0))
    assert not wrong[1:-1, 1:-1].any()
    assert wrong.mean() < 1e-3


@pytest.mark.parametrize("kind", ["smooth", "noisy", "hard"])
def test_a_volume_is_scikit_images(kind: str) -> None:
    """Equal but for pixels at the faces, whose order is left to chance there."""
    wrapped = scene(kind, (7, 60, 70))
    turns, _ = grow_grid(wrapped, None, AT_ALL_FACES)
    wrong = differing(turns, wrapped, unwrap_phase(wrapped, rng=0))
    assert not wrong[1:-1, 1:-1, 1:-1].any()
    assert wrong.mean() < 3e-3
    assert kind == "hard" or not wrong.any()


@pytest.mark.parametrize("sigma", [0.5, 0.7, 0.8])
def test_masked_frames_are_scikit_images(sigma: float) -> None:
    """Two pixels inside the mask; its rim is left to chance there."""
    y, x = np.indices((128, 160))
    radius = np.hypot(y - 64, x - 80)
    mask = radius < 55
    wrong = []
    for seed in range(5):
        bump = 9 * np.exp(-((radius / 40) ** 2))
        wrapped = wrap(bump + np.random.default_rng(seed).normal(0, sigma, radius.shape))
        ours = p4d.unwrap(wrapped, "spatial-2d", mask=mask).values
        peer = np.ma.getdata(unwrap_phase(np.ma.masked_array(wrapped, ~mask), rng=0))
        turns = np.round((ours - wrapped) / TURN).astype(int)
        wrong.append(differing(turns[mask], wrapped[mask], peer[mask])[(radius < 53)[mask]].mean())
    assert np.median(wrong) == 0
    assert max(wrong) < 1e-3


# ---- against joining pixel by pixel ----------------------------------------------------------


def kruskal(
    first: np.ndarray, second: np.ndarray, steps: np.ndarray, cost: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Join nodes one step after the other; return parts and turns."""
    turns, group = np.zeros(n, int), np.arange(n)
    for i in np.argsort(cost, kind="stable"):
        a, b = first[i], second[i]
        if group[a] != group[b]:
            moved = group == group[b]
            turns[moved] += turns[a] + steps[i] - turns[b]
            group[moved] = group[a]
    return group, turns


def same_up_to_parts(parts: np.ndarray, turns: np.ndarray, other: np.ndarray) -> bool:
    """Say whether turns differ by one number in each part."""
    off = turns - other
    return all(np.ptp(off[parts == p]) == 0 for p in np.unique(parts))


def jump(before: float, after: float) -> int:
    """Turns to add after a step so that it is no larger than half a turn."""
    step = float(after) - float(before)
    return int(step < -np.pi) - int(step > np.pi)


def steps_in_order(wrapped: np.ndarray, costs: Costs) -> tuple[np.ndarray, ...]:
    """All steps of a grid, pixel by pixel: those to each row axis by axis, then along it."""
    shape = costs.shape
    w, number = wrapped.reshape(shape), np.arange(wrapped.size).reshape(shape)
    found = []
    for t, a, y in np.ndindex(*shape[:3]):
        for axis in range(4):
            for x in range(shape[3]):
                here = (t, a, y, x)
                before = tuple(i - (k == axis) for k, i in enumerate(here))
                if before[axis] < 0:
                    continue
                if costs.steps.size:
                    cost = costs.steps[axis - 2].reshape(shape)[before] if axis > 1 else np.inf
                else:
                    cost = costs.point.reshape(shape)[before] + costs.point.reshape(shape)[here]
                if np.isfinite(cost):
                    found.append((number[before], number[here], jump(w[before], w[here]), cost))
    return tuple(np.array(column) for column in zip(*found, strict=True))


@pytest.mark.parametrize("kind", ["smooth", "noisy", "hard", "random"])
@pytest.mark.parametrize("shape", [(7,), (9, 8), (4, 6, 5), (3, 3, 5, 4), (2, 1, 6, 5), (5, 2)])
def test_growing_is_kruskals_order(shape: tuple[int, ...], kind: str) -> None:
    ways = [second_differences, *([coherence] if len(shape) == 2 else [])]
    for seed, costs_of in itertools.product(range(3), ways):
        wrapped = scene(kind, shape, seed) if len(shape) > 1 else wrap(np.arange(7) * 2.5)
        mask = np.random.default_rng(seed).random(shape) > 0.15
        for chosen in (None, mask):
            costs = costs_of(wrapped, chosen, Workspace())
            first, second, steps, cost = steps_in_order(wrapped, costs)
            group, expected = kruskal(first, second, steps, cost, wrapped.size)
            turns, parts = grow_grid(wrapped, chosen, costs_of)
            assert same_up_to_parts(group, turns.ravel(), expected)
            if parts is not None:  # the same parts as well
                pairs = np.unique(np.stack([parts.ravel(), group]), axis=1)
                assert pairs.shape[1] == len(np.unique(group)) == len(np.unique(parts))


def test_lists_of_steps_with_equal_costs_go_in_their_order() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        n, m = 40, 150
        first, second = rng.integers(0, n, (2, m))
        steps, cost = rng.integers(-2, 3, m), rng.integers(-3, 4, m).astype(float)
        parts, turns, n_parts = grow_list(first, second, steps, cost, n)
        group, expected = kruskal(first, second, steps, cost, n)
        assert n_parts == len(np.unique(group)) == parts.max() + 1
        assert same_up_to_parts(group, turns, expected)
        for part in range(n_parts):  # relative to the first of each part
            assert turns[np.flatnonzero(parts == part)[0]] == 0


# ---- without a compiler ----------------------------------------------------------------------


WITHOUT = """
import warnings, numpy as np, numba
def fail(*args, **kwargs):
    raise RuntimeError("no LLVM here")
numba.njit = fail
warnings.simplefilter("ignore")
import napari_phase4d as p4d
from napari_phase4d.unwrapping import methods_for
wrapped = np.random.default_rng(0).uniform(-3, 3, (3, 2, 8, 8)).astype(np.float32)
for method in methods_for(None):
    np.save(f"{method}.npy", p4d.unwrap(wrapped, method).values)
"""


@pytest.mark.thorough
@pytest.mark.slow
def test_all_methods_give_the_same_where_nothing_compiles(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-c", WITHOUT], check=True, cwd=tmp_path, timeout=120)
    wrapped = np.random.default_rng(0).uniform(-3, 3, (3, 2, 8, 8)).astype(np.float32)
    for method in methods_for(None):
        found = np.load(tmp_path / f"{method}.npy")
        expected = p4d.unwrap(wrapped, method).values
        np.testing.assert_allclose(found, expected, atol=1e-5, err_msg=method)


def test_a_compiler_that_fails_is_named_once(monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    def fail(**_: object) -> None:
        msg = "no LLVM here"
        raise RuntimeError(msg)

    monkeypatch.setattr(numba, "njit", fail)
    compiling.can_compile.cache_clear()
    try:
        with pytest.warns(RuntimeWarning, match="numba can't compile here .*no LLVM here"):
            assert not compiling.can_compile()
        assert not compiling.can_compile()  # no second warning
    finally:
        compiling.can_compile.cache_clear()


def test_what_has_compiled_once_is_not_loaded_to_see_that_it_can() -> None:
    compiling.can_compile.cache_clear()
    compiling.jitted(compiling.one_more, {})(1)  # so that it is kept
    trial = compiling.jitted(compiling.one_more, {})
    assert compiling.has_compiled(trial)
    assert not trial.signatures
    for kept in compiling.kept_forms(trial):
        os.utime(kept, (1, 1))  # as from before the libraries were installed
    assert not compiling.has_compiled(trial)
    assert compiling.can_compile()
    assert compiling.has_compiled(trial)


# ---- the single kernels ----------------------------------------------------------------------


def test_stencils_have_the_published_numbers_of_pairs() -> None:
    assert [len(half_stencil((5,) * n)) for n in (2, 3, 4)] == [4, 13, 40]
    assert len(half_stencil((1, 2, 5, 5))) == 4


def test_unreliability_is_the_published_sum() -> None:
    wrapped = scene("hard", (5, 9, 11))
    mask = np.random.default_rng(1).random(wrapped.shape) > 0.2
    found = second_differences(wrapped, mask, Workspace()).point.reshape(wrapped.shape)
    w = wrapped.astype(float)
    for t, y, x in np.ndindex(*wrapped.shape):
        at = np.array((t, y, x))
        total, count = 0.0, 0
        for offset in itertools.product((-1, 0, 1), repeat=3):
            if offset <= (0, 0, 0):
                continue
            ahead, behind = tuple(at + offset), tuple(at - offset)
            inside = all(
                (np.array(p) >= 0).all() and (p < np.array(w.shape)).all() for p in (ahead, behind)
            )
            if inside and mask[ahead] and mask[behind]:
                steps = (w[behind] - w[t, y, x], w[t, y, x] - w[ahead])
                before, after = (np.angle(np.exp(1j * step)) for step in steps)
                total += (before - after) ** 2
                count += 1
        if not mask[t, y, x]:
            assert np.isinf(found[t, y, x])
        elif y in (0, 8) or x in (0, 10) or not count:
            assert found[t, y, x] == BORDER
        else:
            assert found[t, y, x] == pytest.approx(total * 13 / count, rel=1e-9)


def test_one_pass_is_enough_without_residues_and_stops_at_one() -> None:
    wrapped = scene("smooth", (3, 2, 40, 30))
    rows, shape = wrapped.reshape(-1, 30), full_shape(wrapped.shape)
    turns = np.empty(rows.shape, np.int32)
    assert integrated(rows, shape, np.pi, turns)
    truth = wrapped.astype(float)
    for axis in range(4):
        truth = np.unwrap(truth, axis=axis)
    assert np.ptp(turns.reshape(wrapped.shape) - np.round((truth - wrapped) / TURN)) == 0


@pytest.mark.parametrize("plane", list(itertools.combinations(range(4), 2)))
def test_a_vortex_in_any_plane_is_seen(plane: tuple[int, int]) -> None:
    shape = (4, 4, 6, 6)
    a, b = (np.indices(shape)[axis] - shape[axis] / 2 + 0.6 for axis in plane)
    wrapped = np.arctan2(a, b).astype(np.float32).reshape(-1, shape[3])
    assert not integrated(wrapped, shape, np.pi, np.empty(wrapped.shape, np.int32))


def residues_by_hand(w: np.ndarray, cost: dict) -> float:
    """The least, over all loops of four steps that don't close, of the dearest step."""
    least = np.inf
    for index in np.ndindex(*w.shape):
        for i, j in itertools.combinations(range(w.ndim), 2):
            corner = [np.array(index) for _ in range(4)]
            corner[1][i] += 1
            corner[2][i] += 1
            corner[2][j] += 1
            corner[3][j] += 1
            if any((c >= w.shape).any() for c in corner):
                continue
            loop = [tuple(c) for c in (*corner, corner[0])]
            steps = [jump(w[a], w[b]) for a, b in itertools.pairwise(loop)]
            if sum(steps):
                edges = [tuple(sorted(pair)) for pair in itertools.pairwise(loop)]
                least = min(least, max(cost[a] + cost[b] for a, b in edges))
    return least


@pytest.mark.parametrize("shape", [(1, 1, 9, 8), (1, 4, 5, 6), (3, 3, 4, 4)])
def test_the_limit_is_that_of_the_cheapest_residue(shape: tuple[int, int, int, int]) -> None:
    rng = np.random.default_rng(4)
    wrapped = wrap(rng.normal(0, 1.3, shape))
    point = rng.random((wrapped.size // shape[3], shape[3]))
    none = np.empty((0, 0, 0))
    rows = wrapped.reshape(point.shape)
    cost = {index: point.reshape(shape)[index] for index in np.ndindex(*shape)}
    found = residue_limit(rows, np.pi, point, none, shape, rows.size)
    assert found == pytest.approx(residues_by_hand(wrapped, cost))
    assert residue_limit(rows, np.pi, point, none, shape, 0) == -np.inf


def test_steps_that_disagree_are_seen_when_joined() -> None:
    wrapped = scene("spiral", (20, 24))
    wrapped = np.arctan2(*(np.mgrid[:20, :24] - np.array([9.4, 11.6])[:, None, None])).astype(
        np.float32
    )
    shape = full_shape(wrapped.shape)
    marks = np.full(wrapped.shape, 4 + 8, np.uint8)
    marks[:, -1] &= 4
    group, turns = np.empty(wrapped.shape, np.int32), np.empty(wrapped.shape, np.int32)
    assert joined(wrapped, shape, np.pi, marks, group, turns) == -1


def test_a_loop_round_a_hole_makes_the_limit_fall() -> None:
    """All loops of four close but those in a dear hole, round which the phase turns once."""
    y, x = np.mgrid[:40, :40] - 19.5
    wrapped = np.arctan2(y, x).astype(np.float32)
    hole = np.hypot(y, x) < 8
    rng = np.random.default_rng(0)
    wrapped[hole] = rng.uniform(-3, 3, hole.sum())
    turns, _ = grow_grid(wrapped)
    wrong = differing(turns, wrapped, unwrap_phase(wrapped, rng=0))
    assert not wrong[1:-1, 1:-1].any()


def test_marks_are_the_cheap_steps_and_the_cheapest_of_each() -> None:
    rng = np.random.default_rng(2)
    point = rng.random((6, 7))
    shape, none = full_shape((6, 7)), np.empty((0, 0, 0))
    down, right = point[:-1] + point[1:], point[:, :-1] + point[:, 1:]
    marks = np.zeros((6, 7), np.uint8)
    mark_cheapest_of_each(point, none, shape, 0.0, marks, 0, len(marks))
    expected = np.zeros((6, 7), np.uint8)
    for i, j in np.ndindex(6, 7):
        around = [
            (down[i - 1, j], (i - 1, j), 4) if i else None,
            (right[i, j - 1], (i, j - 1), 8) if j else None,
            (right[i, j], (i, j), 8) if j < 6 else None,
            (down[i, j], (i, j), 4) if i < 5 else None,
        ]
        _, at, bit = min(a for a in around if a)
        expected[at] |= bit
    np.testing.assert_array_equal(marks, expected)
    marks[:] = 0
    mark_cheap(point, none, shape, 1.0, marks)
    np.testing.assert_array_equal((marks[:, :-1] & 8) > 0, right < 1)
    assert not (((marks[:-1] & 4) > 0) & (down >= 1)).any()
    # Left out are only those that close a square of cheap steps.
    left_out = (down < 1) & ((marks[:-1] & 4) == 0)
    assert (right[:-1] < 1)[left_out[:, 1:]].all()
    assert (right[1:] < 1)[left_out[:, 1:]].all()
    assert not left_out[:, 0].any()


def test_memory_used_again_leaves_no_traces() -> None:
    work = Workspace()
    large, small = scene("hard", (60, 70)), scene("noisy", (30, 20))
    for frame in (large, small, large, small):
        turns, _ = grow_grid(frame, work=work)
        np.testing.assert_array_equal(turns, grow_grid(frame)[0])


def test_growing_stops_when_asked_to() -> None:
    asked = iter([False, False, True])

    def check() -> None:
        if next(asked):
            raise p4d.Cancelled

    with pytest.raises(p4d.Cancelled):
        grow_grid(scene("hard"), check=check)


def test_the_cheaper_steps_first_makes_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    wrapped = scene("random", (60, 70))
    turns = grow_grid(wrapped)[0].copy()
    monkeypatch.setattr(growth, "MANY_LEFT", 2.0)
    np.testing.assert_array_equal(turns, grow_grid(wrapped)[0])


def test_frames_come_out_the_same_however_many_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    wrapped = np.stack([[scene("hard", (50, 60), s)] for s in range(8)])
    expected = p4d.unwrap(wrapped, "spatial-2d").values
    for threads in (1, 2, 5, 8):
        monkeypatch.setattr("napari_phase4d.task.cores", lambda n=threads: n)
        np.testing.assert_array_equal(p4d.unwrap(wrapped, "spatial-2d").values, expected)


def test_steps_of_infinite_cost_are_taken_last() -> None:
    first, second, steps = np.array([[0, 1, 0], [1, 2, 2], [1, 1, 5]])
    cost = np.array([np.inf, 1.0, np.inf])
    parts, turns, n_parts = grow_list(first, second, steps, cost, 3)
    assert n_parts == 1
    np.testing.assert_array_equal(turns, [0, 1, 2])
    np.testing.assert_array_equal(parts, 0)


def test_masks_of_lonely_pixels_come_to_an_end() -> None:
    wrapped = scene("random", (2, 3, 12, 13))
    for seed in range(5):
        mask = np.random.default_rng(seed).random(wrapped.shape) < 0.04
        for variant in ("textbook", "phasetools"):
            found = p4d.unwrap(wrapped, "region-growing", mask=mask, variant=variant).values
            turns = (found - np.mod(wrapped, TURN))[mask] / TURN
            np.testing.assert_allclose(turns, np.round(turns), atol=1e-5)


def test_arrays_in_any_order_are_left_as_they_are() -> None:
    wrapped = scene("hard", (40, 50))
    mask = np.random.default_rng(0).random(wrapped.shape) > 0.1
    expected = p4d.unwrap(wrapped, "spatial-2d", mask=mask).values
    twice = np.repeat(np.repeat(wrapped, 2, 0), 2, 1)
    locked = wrapped.copy()
    locked.flags.writeable = False
    for given in (np.asfortranarray(wrapped), twice[::2, ::2], locked, wrapped.astype(">f4")):
        before = np.array(given)
        np.testing.assert_array_equal(p4d.unwrap(given, "spatial-2d", mask=mask).values, expected)
        np.testing.assert_array_equal(given, before)


# ---- the other reliability -------------------------------------------------------------------


def test_coherence_follows_slopes_that_second_differences_lose() -> None:
    """Share of wrong pixels on steep cells with noise, against exact truth."""
    wrong: dict[str, list[float]] = {"herraez": [], "coherence": []}
    for seed in range(4):
        rng = np.random.default_rng(seed)
        y, x = np.mgrid[:200, :200]
        rho = ((y - 100) / 60) ** 2 + ((x - 100) / 50) ** 2
        height = gaussian_filter(45 * np.sqrt(np.clip(1 - rho, 0, None)), 1.5)
        truth = height + rng.normal(0, 0.3, rho.shape)
        for name, shares in wrong.items():
            found = p4d.unwrap(wrap(truth), "spatial-2d", reliability=name).values
            off = np.round((found - truth) / TURN)
            shares.append(float((off != np.median(off[rho > 1.2])).mean()))
    assert np.mean(wrong["herraez"]) > 0.002
    assert np.mean(wrong["coherence"]) < 0.5 * np.mean(wrong["herraez"])


def test_the_other_reliability_is_named_with_its_result() -> None:
    wrapped = scene("noisy", (30, 40))
    options = {"spatial-2d": {"reliability": "coherence"}}
    table = p4d.compare(wrapped, ["spatial-2d"], options=options).table
    assert table.loc["spatial-2d", "method"] == "2-D (coherence)"
    with pytest.raises(ValueError, match="reliability must be one of herraez, coherence"):
        p4d.unwrap(wrapped, "spatial-2d", reliability="other")
