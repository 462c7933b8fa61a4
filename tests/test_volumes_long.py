"""3-D, RG and LBE block by block: the same bits as with all frames in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from napari_phase4d.pipeline import streaming
from napari_phase4d.pipeline.stored import Shelf, stored_at
from napari_phase4d.pipeline.streaming import ProblemOnDisk
from napari_phase4d.stack import Block, Memory, blocks_of
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import laplacian, network_flow, volumes
from napari_phase4d.unwrapping.growing import Joining, contracted
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.running import run_method
from test_growing import same_up_to_parts

GROWING = [
    ("spatial-3d", {}),
    ("region-growing", {}),
    ("region-growing", {"variant": "phasetools"}),
]
SHAPES = [(9, 2, 12, 14), (17, 2, 15, 13), (5, 1, 8, 9), (2, 3, 7, 7), (1, 2, 6, 6), (3, 3, 3, 3)]


def scene(shape: tuple[int, ...], noise: float, *, moves: bool = True) -> np.ndarray:
    """An object that grows, moves and leaves, with noise; rounded, so that many costs tie."""
    rng = np.random.default_rng(len(shape) + int(10 * noise))
    t, a, y, x = (np.arange(n).reshape([-1 if k == i else 1 for k in range(4)])
                  for i, n in enumerate(shape))  # fmt: skip
    _, _, height, width = shape
    to = t * width / shape[0] if moves else 0
    far = ((y - height / 2) / (height / 4)) ** 2 + ((x - a - width / 3 - to) / (width / 4)) ** 2
    phase = 9 * (t + 1) / shape[0] * np.exp(-far) + rng.normal(0, noise, shape)
    return np.round(np.angle(np.exp(1j * phase)), 1).astype(np.float32)


def with_gaps(wrapped: np.ndarray) -> np.ndarray:
    """Leave a hole out of all frames, and one frame altogether."""
    wrapped = wrapped.copy()
    wrapped[:, :, 2:4, 2:5] = np.nan
    wrapped[len(wrapped) // 2 :, 0, :, 1] = np.nan
    if len(wrapped) > 4:
        wrapped[len(wrapped) // 2] = np.nan
    return wrapped


def on_disk(
    wrapped: np.ndarray,
    method: str,
    mask: Any,
    boundary: tuple[int, int],
    folder: Path,
    **options: Any,
) -> np.ndarray:
    template = Problem(np.nan_to_num(wrapped)).template
    shelf = Shelf(folder)
    phase = shelf.take("wrapped", template.copy(data=wrapped))
    stored = stored_at(phase)
    assert stored is not None
    problem = ProblemOnDisk(phase, stored, shelf, boundary, finds_mask=mask == "auto")
    return run_method(problem, method, UNWATCHED, options).values


def in_memory(
    wrapped: np.ndarray, method: str, mask: Any, boundary: tuple[int, int], **options: Any
) -> np.ndarray:
    known = np.isfinite(wrapped)
    chosen = "auto" if mask == "auto" else None if known.all() else known
    return run_method(Problem(wrapped, boundary, chosen), method, UNWATCHED, options).values


@pytest.mark.slow
@pytest.mark.parametrize(
    "frames", [3, *(pytest.param(n, marks=pytest.mark.thorough) for n in (1, 8))]
)
@pytest.mark.parametrize("mask", [None, "auto", "gaps"])
@pytest.mark.parametrize(("method", "options"), GROWING, ids=str)
def test_blocks_of_frames_give_the_same(
    method: str,
    options: dict[str, str],
    mask: str | None,
    frames: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(volumes, "working_blocks", lambda shape: blocks_of(shape, frames))
    for shape in SHAPES:
        for noise in (0.5, 3.0):
            wrapped = scene(shape, noise)
            if mask == "gaps":
                wrapped = with_gaps(wrapped)
            start = (0 if mask == "gaps" else shape[0] // 2, shape[1] - 1)
            expected = in_memory(wrapped, method, mask, start, **options)
            found = on_disk(wrapped, method, mask, start, tmp_path, **options)
            np.testing.assert_array_equal(found, expected, f"{shape}, noise {noise}")


@pytest.mark.thorough
@pytest.mark.parametrize("frames", [1, 3, 8])
@pytest.mark.parametrize("mask", [None, "auto", "gaps"])
@pytest.mark.parametrize("variant", ["textbook", "phasetools"])
def test_laplacian_of_blocks_is_the_same(
    variant: str,
    mask: str | None,
    frames: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for shape in [(9, 2, 12, 14), (5, 1, 8, 9), (1, 2, 6, 6), (2, 1, 1, 5)]:
        wrapped = scene(shape, 0.5)
        if mask == "gaps" and min(shape) > 1:
            wrapped = with_gaps(wrapped)
        rounded = shape[0] == 5
        options = {"variant": variant, "rounded": rounded}
        expected = in_memory(wrapped, "laplacian", mask, (0, 0), **options)
        with monkeypatch.context() as patch:
            patch.setattr(streaming, "blocks_of", lambda shape: blocks_of(shape, frames))
            patch.setattr(laplacian, "AT_ONCE", 30 * frames)
            found = on_disk(wrapped, "laplacian", mask, (0, 0), tmp_path, **options)
        np.testing.assert_array_equal(found, expected, f"{shape}")


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1, 3, 8])
@pytest.mark.parametrize("mask", [None, "auto", "gaps"])
def test_flow_of_blocks_is_the_same(
    mask: str | None, frames: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of answers that cost the same any may come out: what is solved together must be the same.
    monkeypatch.setattr(network_flow, "AT_ONCE", 200)
    for shape in [(9, 2, 8, 9), (5, 1, 4, 1), (1, 2, 6, 6)]:
        wrapped = scene(shape, 1.0)
        if mask == "gaps" and min(shape[2:]) > 1:
            wrapped = with_gaps(wrapped)
        expected = in_memory(wrapped, "network-flow", mask, (0, 0))
        with monkeypatch.context() as patch:
            patch.setattr(streaming, "blocks_of", lambda shape: blocks_of(shape, frames))
            found = on_disk(wrapped, "network-flow", mask, (0, 0), tmp_path)
        np.testing.assert_array_equal(found, expected, f"{shape}")


@pytest.mark.parametrize("frames", [1, 2, 4])
@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_what_is_carried_on_is_as_large_as_a_frame(noise: float, frames: int) -> None:
    shape = (12, 2, 10, 11)
    wrapped, mask = scene(shape, noise), np.random.default_rng(0).random(shape) > 0.2
    joining = Joining(220, Memory(), "joined")
    groups, turns = np.empty(shape, np.int32), np.empty(shape, np.int32)
    for block in blocks_of(shape, frames):
        seen = block.wider(2, 2, 12)
        own = slice(seen.start, seen.stop)
        found, g, t = contracted(wrapped[own], mask[own], seen, block, 12)
        joining.add(found, g[-1:], t[-1:])
        groups[block.start : block.stop], turns[block.start : block.stop] = g, t
        assert len(joining._steps[0]) < 220
        assert len(found.beyond) < g.size / 2  # most of it is certain
    assert joining._n == len(joining._steps[0]) == 0
    parts = np.full(shape, -1)
    for block, lists in zip(blocks_of(shape, frames), joining.finished(), strict=True):
        own = slice(block.start, block.stop)
        part, more = lists.read(Block(0, 2))[:, 0, 0]
        inside = groups[own] >= 0
        parts[own][inside] = part[groups[own][inside]]
        turns[own][inside] += more[groups[own][inside]]
    _, all_groups, all_turns = contracted(wrapped, mask, Block(0, 12), Block(0, 12), 12)
    np.testing.assert_array_equal(parts >= 0, mask)
    pairs = np.unique(np.stack([parts[mask], all_groups[mask]]), axis=1)
    assert pairs.shape[1] == joining.n_parts == all_groups.max() + 1
    assert same_up_to_parts(parts[mask], turns[mask], all_turns[mask])


def test_phasetools_joins_times_of_tiny_frames_with_many_views(tmp_path: Path) -> None:
    """There all frames are one block."""
    shape = (5, 30, 1, 2)
    assert volumes.times_touch(shape)
    assert not volumes.times_touch((5, 2, 8, 8))
    wrapped = np.random.default_rng(0).uniform(-3, 3, shape).astype(np.float32)
    expected = in_memory(wrapped, "region-growing", None, (0, 0), variant="phasetools")
    found = on_disk(wrapped, "region-growing", None, (0, 0), tmp_path, variant="phasetools")
    np.testing.assert_array_equal(found, expected)
