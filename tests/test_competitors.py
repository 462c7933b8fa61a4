"""Laplacian estimate, region growing and 3-D sorting, against formulas and other programs."""

from __future__ import annotations

import itertools
import os
import threading
import time
from functools import partial

import numpy as np
import pytest
from scipy.fft import dct
from skimage.restoration import unwrap_phase

import napari_phase4d as p4d
from napari_phase4d.machine import measured
from napari_phase4d.unwrapping import methods_for
from napari_phase4d.unwrapping.volumes import memory_edges, penalised_differences

TURN = 2 * np.pi


def noisy_bump(shape: tuple[int, ...], sigma: float, seed: int = 0) -> np.ndarray:
    grids = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    radius = sum(g**2 for g in grids)
    return 9 * np.exp(-3 * radius) + np.random.default_rng(seed).normal(0, sigma, shape)


def wrapped(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * phase)).astype(np.float32)


def test_laplacian_solves_the_published_equation() -> None:
    """L u = cos w L sin w - sin w L cos w, the sum over neighbours of sin(w' - w), in loops."""
    w = wrapped(noisy_bump((4, 3, 9, 8), 0.4))
    u = p4d.unwrap(w, "laplacian").values.astype(np.float64)
    for index in np.ndindex(*w.shape):
        laplacian = source = 0.0
        for axis in range(4):
            for step in (-1, 1):
                other = list(index)
                other[axis] += step
                if 0 <= other[axis] < w.shape[axis]:
                    laplacian += u[tuple(other)] - u[index]
                    source += np.sin(float(w[tuple(other)]) - float(w[index]))
        assert laplacian == pytest.approx(source, abs=2e-4)


def test_laplacian_is_near_for_gentle_phase_and_rounds_to_it() -> None:
    phase = np.broadcast_to(noisy_bump((40, 40), 0.0), (6, 3, 40, 40))
    raw = p4d.unwrap(wrapped(phase), "laplacian").values
    assert 0.01 < np.abs(raw - phase).max() < np.pi  # an estimate, never exact
    rounded = p4d.unwrap(wrapped(phase), "laplacian", rounded=True).values
    np.testing.assert_allclose(rounded, phase, atol=1e-4)


def test_laplacian_as_phasetools_has_it() -> None:
    """The published formula with dense cosine matrices."""
    w = wrapped(noisy_bump((3, 2, 6, 5), 0.3)).astype(np.float64)
    factor = sum(
        ((np.arange(n) + 1.0) ** 2).reshape([-1 if i == axis else 1 for i in range(4)])
        for axis, n in enumerate(w.shape)
    )

    def transform(values: np.ndarray, inverse: bool) -> np.ndarray:
        for axis, n in enumerate(values.shape):
            matrix = dct(np.eye(n), norm="ortho", axis=0)
            matrix = matrix.T if inverse else matrix
            values = np.moveaxis(np.tensordot(matrix, values, (1, axis)), 0, axis)
        return values

    def term(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        inner = transform(factor * transform(b, False), True)
        return transform(transform(a * inner, False) / factor, True)

    expected = term(np.cos(w), np.sin(w)) - term(np.sin(w), np.cos(w))
    found = p4d.unwrap(w, "laplacian", variant="phasetools").values
    np.testing.assert_allclose(found - found.mean(), expected - expected.mean(), atol=1e-4)
    with pytest.raises(ValueError, match="variant must be"):
        p4d.unwrap(w, "laplacian", variant="other")


def kruskal(w: np.ndarray, edges: tuple, cost: np.ndarray) -> np.ndarray:
    """Join groups pixel by pixel, as Herraez et al. describe it."""
    turns, group = np.zeros(w.size, int), np.arange(w.size)
    flat = w.ravel()
    for i in np.argsort(cost, kind="stable"):
        a, b = edges[0][i], edges[1][i]
        if group[a] != group[b]:
            step = (flat[b] + TURN * turns[b]) - (flat[a] + TURN * turns[a])
            moved = group == group[b]
            turns[moved] -= int(np.round(step / TURN))
            group[moved] = group[a]
    return (flat + TURN * turns).reshape(w.shape)


@pytest.mark.parametrize("sigma", [0.3, 0.6, 0.8])
def test_one_frame_of_region_growing_is_scikit_images(sigma: float) -> None:
    """On a single frame the merging order is that of Herraez et al., so the result is the same."""
    w = wrapped(noisy_bump((90, 100), sigma))
    ours = p4d.unwrap(w, "region-growing").values
    turns = (ours - unwrap_phase(w, rng=0)) / TURN
    np.testing.assert_allclose(turns, np.round(np.median(turns)), atol=1e-5)


def test_volumes_are_right_where_single_frames_are_not() -> None:
    """Strong noise: frame by frame fails, joined over time it does not."""
    still = noisy_bump((40, 40), 0.0)
    phase = still + np.random.default_rng(5).normal(0, 0.95, (12, 2, 40, 40))
    w = wrapped(phase)
    wrong = {
        m: np.mean(np.abs(p4d.unwrap(w, m).values - phase) > np.pi)
        for m in ("spatial-2d", "spatial-3d", "region-growing")
    }
    assert wrong["spatial-2d"] > 5 * wrong["spatial-3d"]
    assert wrong["region-growing"] <= wrong["spatial-3d"] + 1e-3


def test_3d_agrees_with_scikit_images_volume() -> None:
    phase = noisy_bump((9, 30, 30), 0.5)
    ours = p4d.unwrap(wrapped(phase)[:, None], "spatial-3d").values[:, 0]
    theirs = unwrap_phase(wrapped(phase), rng=0)
    turns = np.round((ours - theirs) / TURN)
    assert (turns == np.median(turns)).mean() > 0.999


@pytest.mark.parametrize("method", ["laplacian", "region-growing", "spatial-3d", "network-flow"])
def test_masked_parts_are_levelled_and_nothing_lies_outside(method: str) -> None:
    y, x = np.indices((60, 120))
    one = 8 * np.exp(-((y - 30) ** 2 + (x - 30) ** 2) / 200)
    two = 14 * np.exp(-((y - 30) ** 2 + (x - 90) ** 2) / 200)
    phase = np.repeat((one + two)[None, None], 3, axis=0)
    mask = (np.hypot(y - 30, x - 30) < 25) | (np.hypot(y - 30, x - 90) < 25)
    options = {"rounded": True} if method == "laplacian" else {}
    result = p4d.unwrap(wrapped(phase), method, mask=mask, **options).values
    assert (result[:, :, ~mask] == 0).all()
    error = result[:, :, mask] - wrapped(phase)[:, :, mask]
    np.testing.assert_allclose(error / TURN, np.round(error / TURN), atol=1e-5)
    if method != "laplacian":
        np.testing.assert_allclose(result[:, :, mask], phase[:, :, mask], atol=1e-4)


@pytest.mark.parametrize("method", ["laplacian", "region-growing", "spatial-3d", "dilate-erode"])
def test_progress_and_cancel(method: str) -> None:
    w = wrapped(noisy_bump((3, 2, 12, 12), 0.1))
    seen: list[tuple[int, int]] = []
    p4d.unwrap(w, method, progress=lambda d, t, _: seen.append((d, t)))
    assert seen[-1][0] == seen[-1][1]
    with pytest.raises(p4d.Cancelled):
        p4d.unwrap(w, method, cancelled=lambda: True)


def published_unreliability(w: np.ndarray, index: tuple[int, ...]) -> float:
    """PhaseTools' sum over 40 pairs of neighbours, pixel by pixel."""
    phase = np.mod(w, TURN)
    total, penalty = 0.0, 1.0
    for offset in itertools.product((-1, 0, 1), repeat=4):
        if offset <= (0, 0, 0, 0):
            continue
        known = []
        for sign in (1, -1):
            other = tuple(i + sign * o for i, o in zip(index, offset, strict=True))
            if all(0 <= i < n for i, n in zip(other, w.shape, strict=True)):
                known.append(phase[other] - phase[index])
        penalty *= (4, 2, 1)[len(known)]
        total += float(np.sqrt(sum(d**2 for d in known)))
    return total * penalty


@pytest.mark.slow
def test_region_growing_as_phasetools_has_it() -> None:
    """Unreliability and edges from loops over a padded volume; joined in that order."""
    w = wrapped(noisy_bump((4, 3, 5, 14), 0.8, seed=2))
    mask = np.ones(w.shape, dtype=bool)
    found = penalised_differences(w, mask)
    expected = np.array([published_unreliability(w, i) for i in np.ndindex(*w.shape)])
    np.testing.assert_allclose(found.ravel(), expected, rtol=1e-5)

    depth, height, width = 3 + 2, 5 + 2, 14 + 2
    place = {}  # position in the padded memory -> pixel
    for number, (t, a, y, x) in enumerate(np.ndindex(*w.shape)):
        place[(((t + 1) * depth + a + 1) * height + y + 1) * width + x + 1] = number
    pairs = {
        (n, place[m + step])
        for step in (1, width, width * height, depth)
        for m, n in place.items()
        if m + step in place
    }
    edges = memory_edges(mask)
    assert set(zip(*(e.tolist() for e in edges), strict=True)) == pairs

    joined = kruskal(np.mod(w, np.float32(TURN)), edges, expected[edges[0]] + expected[edges[1]])
    ours = p4d.unwrap(w, "region-growing", variant="phasetools").values
    turns = (ours - joined) / TURN
    np.testing.assert_allclose(turns, np.round(turns.flat[0]), atol=1e-5)


def test_phasetools_threshold_is_the_step_at_which_a_turn_is_added() -> None:
    ramp = np.broadcast_to(np.array([0.1, 1.1, 3.0, 4.4, 6.2]), (5, 5))[None, None]
    kept = p4d.unwrap(ramp, "region-growing", variant="phasetools", rga_threshold=6.2).values
    np.testing.assert_allclose(np.diff(kept, axis=-1), np.diff(ramp, axis=-1), atol=1e-5)
    eager = p4d.unwrap(ramp, "region-growing", variant="phasetools", rga_threshold=1.5).values
    assert np.abs(np.diff(eager, axis=-1)).max() > 1.9
    with pytest.raises(ValueError, match="rga_threshold must lie between"):
        p4d.unwrap(ramp, "region-growing", variant="phasetools", rga_threshold=0.0)


@pytest.mark.parametrize("method", methods_for(None))
@pytest.mark.parametrize("shape", [(1, 1), (5, 1), (1, 6), (1, 2, 1, 1)])
@pytest.mark.filterwarnings("ignore:Image has a length 1 dimension")
def test_narrow_frames(method: str, shape: tuple[int, ...]) -> None:
    found = p4d.unwrap(np.full(shape, 0.3, np.float32), method).values
    np.testing.assert_allclose(found, 0.3, atol=1e-5)


@pytest.mark.parametrize("method", ["spatial-2d", "region-growing", "spatial-3d", "network-flow"])
def test_a_mask_within_the_object_keeps_its_level(method: str) -> None:
    y, x = np.indices((40, 40))
    radius = np.hypot(y - 20, x - 20)
    phase = np.broadcast_to(9 / (1 + np.exp((radius - 10) / 2)), (3, 2, 40, 40))
    found = p4d.unwrap(wrapped(phase), method, mask=radius < 7).values
    np.testing.assert_allclose(found[..., radius < 7], phase[..., radius < 7], atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["region-growing", "spatial-3d", "network-flow", "laplacian"])
def test_work_looks_up_within_a_second_whether_to_stop(method: str) -> None:
    w = wrapped(noisy_bump((10, 2, 120, 120), 0.8))
    p4d.unwrap(w[:2, :, :20, :20], method)  # so that nothing is imported or compiled meanwhile
    # Of this process alone: what else is running must not count.
    gaps, last = [0.0], [time.process_time()]

    def cancelled() -> bool:
        gaps.append(time.process_time() - last[0])
        last[0] = time.process_time()
        return False

    p4d.unwrap(w, method, cancelled=cancelled)
    assert max(gaps) < 1


@pytest.mark.slow
def test_work_that_is_stopped_half_way_ends_at_once() -> None:
    w = wrapped(noisy_bump((40, 4, 150, 150), 0.8))
    p4d.unwrap(w[:2, :, :20, :20], "region-growing")  # so that nothing is compiled meanwhile
    asked = threading.Event()
    threading.Timer(0.1, asked.set).start()
    began = time.monotonic()
    with pytest.raises(p4d.Cancelled):
        p4d.unwrap(w, "region-growing", cancelled=asked.is_set)
    assert 0.1 < time.monotonic() - began < 1.1


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.3, 0.7])
@pytest.mark.parametrize("shape", [(10, 1, 90, 90), (6, 3, 80, 70)])
@pytest.mark.usefixtures("traced_memory")
def test_methods_stay_within_the_memory_they_name(shape: tuple[int, ...], noise: float) -> None:
    w = wrapped(noisy_bump(shape, noise))
    some = np.random.default_rng(0).random(w.shape) < 0.5
    variants = {"region-growing": {"variant": "phasetools"}}
    p4d.compare(w[:2], methods_for(None))  # so that no import or compilation is measured
    for mask, options in ((None, {}), ("auto", {}), (some, {}), (None, variants)):
        p4d.compare(w[:, :, :50], methods_for(None), options=options)
        table = p4d.compare(w, methods_for(None), mask=mask, options=options).table
        for method, row in table.iterrows():
            stacks = p4d.METHODS[str(method)].working_stacks
            if method == "region-growing" and method not in options:
                stacks = 15  # of the textbook's form
            frames = 20 * (os.cpu_count() or 1) / (shape[0] * shape[1])
            assert row["peak_mb"] * 2**20 / w.nbytes <= stacks + frames, method


@pytest.mark.slow
@pytest.mark.usefixtures("traced_memory")
def test_growing_needs_little_memory_as_volumes_grow() -> None:
    """Unwrapping takes at most 12 sizes of its input; so does an input twice as large."""
    for n_times in (6, 12):
        w = wrapped(noisy_bump((n_times, 3, 110, 120), 0.6))
        p4d.unwrap(w[:3], "region-growing")
        for method in ("spatial-2d", "temporal-angular", "region-growing", "spatial-3d"):
            cost = measured(partial(p4d.unwrap, w, method))
            assert cost.peak_mb * 2**20 <= 12 * w.nbytes, method
