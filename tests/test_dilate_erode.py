"""Dilate-erode-propagate against a literal transcription, and cases that need its windows."""

from __future__ import annotations

import heapq
import itertools

import numpy as np
import pytest

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.stack import blocks_of
from napari_phase4d.unwrapping import dilate_erode as de

TURN = 2 * np.pi


def bump(peak: float, width: float, n: int = 40) -> np.ndarray:
    y, x = np.indices((n, n)) - n // 2
    return peak * np.exp(-(x**2 + y**2) / (2 * width**2))


def propagated(
    w: np.ndarray, first: tuple[int, int], threshold: float, *, lag: bool
) -> np.ndarray:
    """The published order of frames, pixel by pixel, with no windows.

    With ``lag`` the last valid value is taken from the frame before the newest, as in PhaseTools.
    """
    n_times, n_angles = w.shape[:2]
    out, trusted = w.astype(float).copy(), w.astype(float).copy()

    def follow(path: list[tuple[int, int]]) -> None:
        for i in range(1, len(path)):
            for p in np.ndindex(*w.shape[2:]):
                here, last = (*path[i], *p), (*path[i - 1], *p)
                out[here] -= TURN * np.round((out[here] - trusted[last]) / TURN)
                if i == 1:
                    second = out[here] - out[last]
                else:
                    second = out[(*path[i - 2], *p)] - 2 * out[last] + out[here]
                newest = out[last] if lag else out[here]
                trusted[here] = newest if abs(second) < threshold else trusted[last]

    t0, a0 = first
    follow([(t0, a) for a in range(a0, n_angles)])
    follow([(t0, a) for a in range(a0, -1, -1)])
    for a in range(n_angles):
        follow([(t, a) for t in range(t0, n_times)])
        follow([(t, a) for t in range(t0, -1, -1)])
    return out


@pytest.mark.parametrize("threshold", [6.0, 2.0])
@pytest.mark.parametrize("first", [(0, 0), (2, 1)])
@pytest.mark.parametrize("variant", ["textbook", "phasetools"])
def test_published_defaults_only_propagate(
    variant: str, first: tuple[int, int], threshold: float
) -> None:
    rng = np.random.default_rng(4)
    growing = np.linspace(0.3, 1.0, 5)[:, None, None, None] * bump(14, 3, 12)
    w = wrap(np.repeat(growing, 3, 1) + rng.normal(0, 0.7, (5, 3, 12, 12))).astype(np.float32)
    options = {"erode_threshold": threshold, "variant": variant}
    found = p4d.unwrap(w, "dilate-erode", boundary=first, **options).values
    expected = propagated(w, first, threshold, lag=variant == "phasetools")
    np.testing.assert_allclose(found, expected, atol=1e-4)
    np.testing.assert_array_equal(found[first], w[first])


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["textbook", "phasetools"])
def test_a_window_wider_than_the_wraps_unwraps_the_boundary_frame(variant: str) -> None:
    phase = bump(4, 3)  # wrapped within 4 pixels of the middle
    w = wrap(phase)

    def wrong(max_window: int) -> int:
        options = {"max_window": max_window, "variant": variant}
        found = p4d.unwrap(w, "dilate-erode", **options).values
        return int((np.abs(found - phase) > np.pi).sum())

    assert wrong(0) > 10
    assert wrong(4) == 0


def test_quality_is_the_distance_to_the_mean_of_the_window() -> None:
    phase = np.random.default_rng(0).normal(0, 1, (9, 10))
    mask = np.ones(phase.shape, dtype=bool)
    mask[0, 0] = False
    turns = np.zeros(phase.shape, dtype=np.int64)
    found = de.quality(phase, turns, mask, 2)
    expected = -abs(phase[2:7, 3:8].sum() - 25 * phase[4, 5])
    assert found[4, 5] == pytest.approx(expected)
    assert found[1, 5] == de.WORST  # its window leaves the frame
    assert found[2, 2] == de.WORST  # its window holds a masked pixel
    assert np.isnan(found[0, 0])


@pytest.mark.slow
def test_erosion_brings_back_a_single_pixel() -> None:
    flat, mask = np.full((5, 5), 0.3), np.ones((5, 5), dtype=bool)
    turns = np.zeros((5, 5), dtype=np.int64)
    turns[2, 2] = 2
    de.erode(flat, turns, np.arange(25), mask)
    assert not turns.any()


@pytest.mark.slow
@pytest.mark.parametrize("step", ["dilate", "erode"])
def test_compiled_loops_do_what_is_written(step: str) -> None:
    rng = np.random.default_rng(7)
    phase, mask = rng.normal(0, 0.5, (11, 12)), rng.random((11, 12)) > 0.1
    turns = rng.integers(-2, 3, (11, 12)) * (rng.random((11, 12)) < 0.08)
    order = rng.permutation(np.flatnonzero(mask))
    results = []
    for function in (getattr(de, step), getattr(de, step).py_func):
        changed = turns.copy()
        function(phase, changed, order, mask)
        results.append(changed)
    np.testing.assert_array_equal(*results)
    assert (results[0] != turns).any()


def test_windows_are_sizes_up_and_down() -> None:
    assert de.up_and_down(3) == [1, 2, 3, 2, 1]
    assert de.up_and_down(0) == []


@pytest.mark.parametrize("options", [{"max_window": -1}, {"erode_threshold": 0.0}])
def test_options_out_of_range(options: dict) -> None:
    with pytest.raises(ValueError, match="max_window must be 0 or more"):
        p4d.unwrap(np.zeros((3, 3)), "dilate-erode", **options)


def literal(w: np.ndarray, max_window: int, *, erodes: bool) -> np.ndarray:
    """Dilate and erode one frame as it is described, with heaps and pixel by pixel."""
    p = w.astype(float).copy()
    height, width = p.shape

    def near(y: int, x: int) -> list[tuple[int, int]]:
        box = itertools.product((-1, 0, 1), repeat=2)
        places = [(y + dy, x + dx) for dy, dx in box if (dy, dx) != (0, 0)]
        return [(j, i) for j, i in places if 0 <= j < height and 0 <= i < width]

    def heap(size: int, sign: int) -> list[tuple[float, int, int, int]]:
        found = []
        for number, (y, x) in enumerate(np.ndindex(*p.shape)):
            box = p[max(y - size, 0) : y + size + 1, max(x - size, 0) : x + size + 1]
            inside = box.size == (2 * size + 1) ** 2
            q = -abs(box.sum() - box.size * p[y, x]) if inside else de.WORST
            if q < -de.FLAT:
                found.append((sign * q, sign * -number, y, x))
        heapq.heapify(found)
        return found

    def dilate(size: int) -> None:
        hit, best_first = np.zeros(p.shape, bool), heap(size, -1)
        while best_first:
            *_, y, x = heapq.heappop(best_first)
            if hit[y, x]:
                continue
            for q in near(y, x):
                if not hit[q]:
                    p[q] -= TURN * np.round((p[q] - p[y, x]) / TURN)
                    hit[q] = True

    def erode(size: int) -> None:
        worst_first = heap(size, 1)
        while worst_first:
            *_, y, x = heapq.heappop(worst_first)
            turns = {int(np.round((p[q] - p[y, x]) / TURN)) for q in near(y, x)}
            if len(turns) == 1:
                p[y, x] += TURN * turns.pop()

    sizes = [*range(1, max_window), *range(max_window, 0, -1)]
    for largest in sizes:
        for size in [*range(1, largest), *range(largest, 0, -1)]:
            dilate(size)
            if erodes:
                erode(size)
    return p


@pytest.mark.parametrize("variant", ["textbook", "phasetools"])
def test_windows_do_what_is_described(variant: str) -> None:
    noise = np.random.default_rng(5).normal(0, 1.8, (16, 16))
    w = wrap(bump(14, 4, 16) + noise).astype(np.float32)
    found = p4d.unwrap(w, "dilate-erode", max_window=3, variant=variant).values
    expected = literal(w, 3, erodes=variant == "textbook")
    np.testing.assert_allclose(found, expected, atol=1e-4)
    other = literal(w, 3, erodes=variant != "textbook")
    assert np.abs(other - expected).max() > 1  # the frame tells the variants apart


@pytest.mark.parametrize("frames", [1, 3, 8])
@pytest.mark.parametrize("first", [(0, 0), (7, 1), (18, 0)])
@pytest.mark.parametrize("variant", ["textbook", "phasetools"])
def test_blocks_of_any_length_give_the_same(
    monkeypatch: pytest.MonkeyPatch, variant: str, first: tuple[int, int], frames: int
) -> None:
    rng = np.random.default_rng(8)
    w = rng.uniform(-np.pi, np.pi, (19, 2, 12, 14)).astype(np.float32)
    options = {"variant": variant, "boundary": first, "erode_threshold": 3.0, "max_window": 1}
    whole = p4d.unwrap(w, "dilate-erode", **options).values
    monkeypatch.setattr("napari_phase4d.stack.block_frames", lambda shape: frames)
    assert len(blocks_of(w.shape)) == -(-19 // frames)
    np.testing.assert_array_equal(p4d.unwrap(w, "dilate-erode", **options).values, whole)
