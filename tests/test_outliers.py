"""A frame that fits neither neighbour, while these fit each other, is left out and named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage

import napari_phase4d as p4d
from napari_phase4d.analysis.comparison import compare_on
from napari_phase4d.pipeline.stored import Shelf
from napari_phase4d.pipeline.streaming import ProblemOnDisk
from napari_phase4d.stack import Block, InMemory
from napari_phase4d.stacks import wrapped_stack
from napari_phase4d.task import Watch
from napari_phase4d.unwrapping import Problem
from napari_phase4d.unwrapping.directional import outliers
from napari_phase4d.unwrapping.directional.outliers import outlying_frames, outlying_shares
from napari_phase4d.unwrapping.directional.registration import Frames, Seen

TURN = 2 * np.pi
WL1, RGD = "directional-l1", "directional-growing"
N, BAD = 10, 6


def cell(places: np.ndarray, peak: float, views: int = 2) -> np.ndarray:
    """A thick round cell at these places (time, 2) of a field of 64 x 72 pixels."""
    y, x = np.mgrid[:64, :72] + 0.5
    frames = []
    for t, (cy, cx) in enumerate(places):
        for view in range(views):
            far = ((y - cy) ** 2 + (x - cx - view) ** 2) / 22**2
            frames.append(peak * (1 + 0.02 * t) * np.maximum(1 - far, 0))
    phase = np.reshape(frames, (len(places), views, 64, 72))
    return ndimage.gaussian_filter(phase, (0, 0, 1.2, 1.2))


def drifting(peak: float, speed: float = 0.6) -> np.ndarray:
    return cell(np.stack([32 + 0 * np.arange(N), 33 + speed * np.arange(N)], axis=1), peak)


def torn(phase: np.ndarray, time: int, by: int) -> np.ndarray:
    """Move the lower half of a frame sideways, as after a lost packet."""
    found = phase.copy()
    found[time, :, 32:] = np.roll(phase[time, :, 32:], by, axis=-1)
    return found


def noisy(phase: np.ndarray, noise: float) -> np.ndarray:
    return phase + noise * np.random.default_rng(5).standard_normal(phase.shape)


def wrapped(phase: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * phase)).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("method", [WL1, RGD])
@pytest.mark.parametrize("noise", [0, 0.3])
@pytest.mark.parametrize("by", [18, 25])
@pytest.mark.parametrize("peak", [12.0, 20.0])
def test_a_torn_frame_spoils_no_other(peak: float, by: int, noise: float, method: str) -> None:
    """What changes on the way there and back said the same in both, and all frames followed."""
    exact = noisy(torn(drifting(peak), BAD, by), noise)
    found = p4d.unwrap(wrapped(exact), method)
    assert found.attrs["lost_frames"] == [[BAD, 0], [BAD, 1]]
    off = np.round((found.values - exact) / TURN)
    assert not off[np.arange(N) != BAD].any()
    # It is unwrapped by itself.
    flat = p4d.unwrap(wrapped(exact), "spatial-2d").values
    assert np.array_equal(np.round((found.values - flat)[BAD] / TURN), 0 * flat[BAD])


@pytest.mark.slow
def test_it_is_not_trusted_and_the_verdict_names_it() -> None:
    found = p4d.compare(wrapped(noisy(torn(drifting(15), BAD, 25), 0.2)), [WL1, "spatial-2d"])
    assert found.verdict.lost_frames == [(BAD, 0), (BAD, 1)]
    assert f"At time {BAD} what is seen fits neither the frame before" in found.verdict
    for method in (WL1, "spatial-2d"):
        trust = found.confidence(method).values
        assert (trust[BAD] == 0).all()
        assert np.median(trust[BAD - 1]) > 0.9


@pytest.mark.slow
def test_two_of_many_are_both_left_out() -> None:
    phase = np.concatenate([drifting(12, 0.3)] * 3)
    phase = torn(torn(phase, 4, 25), 17, 20)
    found = p4d.unwrap(wrapped(noisy(phase, 0.2)), WL1)
    assert {t for t, _ in found.attrs["lost_frames"]} == {4, 17}


@pytest.mark.slow
@pytest.mark.parametrize("times", [(1, 3), (4, 6, 8), (56, 58)])
def test_two_apart_are_no_witnesses_of_each_other(times: tuple[int, ...]) -> None:
    phase = np.concatenate([drifting(12, 0.3)[:1]] * 60)
    for number, time in enumerate(times):
        phase = torn(phase, time, 20 + 3 * number)
    found = p4d.unwrap(wrapped(noisy(phase, 0.2)), WL1)
    assert {t for t, _ in found.attrs["lost_frames"]} == set(times)


@pytest.mark.parametrize("each", [1, 2, 4])
def test_blocks_do_not_matter(each: int, monkeypatch: pytest.MonkeyPatch) -> None:
    phase = torn(drifting(12, 1.5), BAD, 18)
    still = np.zeros((N, 2, 2), dtype=np.intp)
    frames = Frames(Problem(wrapped_stack(wrapped(noisy(phase, 0.3)))))
    whole = outlying_frames(frames, still, Watch(1, ""))
    assert whole.tolist() == [time == BAD for time in range(N)]
    blocks = [Block(t, min(t + each, N)) for t in range(0, N, each)]
    monkeypatch.setattr(outliers, "working_blocks", lambda _: blocks)
    assert outlying_frames(frames, still, Watch(1, "")).tolist() == whole.tolist()


def beating(n: int) -> np.ndarray:
    """A cell that is here in one frame, and there in the next."""
    return cell(np.stack([32 + 0 * np.arange(n), 30 + 12 * (np.arange(n) % 2)], axis=1), 12)


@pytest.mark.parametrize(
    "phase",
    [
        drifting(12),
        drifting(12, 3),
        beating(10),
        beating(3),
        torn(drifting(12), 0, 25),
        torn(drifting(12), N - 1, 25),
        torn(drifting(12)[:5], 2, 25),
        drifting(12) * (1 + 0.4 * (np.arange(N) >= BAD))[:, None, None, None],
    ],
    ids=["drifts", "flows", "beats", "beats, few", "first", "last", "few", "grows at once"],
)
def test_what_nothing_tells_from_life_is_kept(phase: np.ndarray) -> None:
    assert "lost_frames" not in p4d.unwrap(wrapped(noisy(phase, 0.2)), WL1).attrs


def test_shares_are_counted_where_the_two_others_agree() -> None:
    phase = np.zeros((4, 1, 4, 5), dtype=np.float32)
    phase[[0, 2, 3], :, 0] = 3.0  # five pixels that are empty once
    phase[1:, :, 1] = 3.0  # five that have changed for good
    phase[2, :, 2, :2] = 2 * np.pi - 0.1  # the same but for a turn
    empty = np.zeros(phase.shape, dtype=bool)
    empty[:, :, 3] = True
    seen = Seen(phase, empty, np.ones(phase.shape, dtype=bool), None)
    still = np.zeros((4, 1, 2), dtype=np.intp)
    shares = outlying_shares(seen, still, 0.0)
    assert shares[:, 0].tolist() == shares[:, 1].tolist() == [0, pytest.approx(5 / 15), 0, 0]
    assert not outlying_shares(seen, still, 1.2).any()
    # What comes for one frame is no reason to doubt it.
    phase[:, :, 0], phase[1, :, 0] = 0.0, 3.0
    assert not outlying_shares(seen, still, 0.0)[1].any()


def test_an_object_that_has_only_moved_there_and_back_is_no_outlier() -> None:
    """Held in place it is the same in all frames; the least of both ways counts."""
    phase = np.zeros((4, 1, 6, 9), dtype=np.float32)
    phase[[0, 1, 3], :, :, 2:5], phase[2, :, :, 4:7] = 2.5, 2.5
    seen = Seen(phase, phase == 0, np.ones(phase.shape, dtype=bool), None)
    shifts = np.zeros((4, 1, 2), dtype=np.intp)
    assert outlying_shares(seen, shifts, 0.0)[2] == pytest.approx([24 / 30] * 2)
    shifts[2] = 0, -2
    assert not outlying_shares(seen, shifts, 0.0)[2].any()


def test_what_changes_by_half_a_turn_a_frame_is_no_outlier() -> None:
    """Two steps of it are a turn, so that the frame before and the one after are the same."""
    steps = np.array([0, 2.4, 2.9, 3.1, 3.2, 2.8], dtype=np.float32).cumsum()
    phase = np.zeros((6, 1, 4, 5), dtype=np.float32)
    phase[:, :, :3] = steps[:, None, None, None]
    seen = Seen(phase, phase == 0, np.ones(phase.shape, dtype=bool), None)
    still = np.zeros((6, 1, 2), dtype=np.intp)
    apart, steady = outlying_shares(seen, still, 0.0).T
    assert apart.max() > 0.5
    assert not steady.any()
    phase[[0, 1, 3], :, :3], phase[2, :, :3] = 3.0, 0.2
    assert (outlying_shares(seen, still, 0.0)[2] > 0.5).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "factor", "times", "noise"),
    [
        ("tumbling", 2, slice(None), 0.2),
        ("tumbling", 1.75, slice(None, None, -1), 0.3),
        ("tumbling", 1.35, slice(1, None, 2), 0.4),
        ("returning", 1.25, slice(None, None, 2), 0),
    ],
)
def test_a_thick_cell_that_turns_fast_is_kept(
    name: str, factor: float, times: slice, noise: float
) -> None:
    """It was taken for damaged, and the frames beside came out turns off: 0.9 to 4.6 rad²."""
    exact = p4d.simulation.moving_shape(name).isel(time=times)["phase"].values
    exact = noisy(factor * exact, noise)
    found = p4d.unwrap(wrapped(exact), WL1)
    assert "lost_frames" not in found.attrs
    assert TURN**2 * np.mean(np.round((found.values - exact) / TURN) ** 2) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("times", [(7, 15, 22), (4,)])
def test_a_cell_that_is_seen_once_is_kept(times: tuple[int, ...]) -> None:
    """As in a fast flow: the frames beside it agree, as both are empty."""
    n = 30 if len(times) > 1 else 8
    phase = cell(np.full((n, 2), 34.0), 14)
    phase[[t for t in range(n) if t not in times]] = 0
    exact = noisy(phase, 0.1)
    found = p4d.compare(wrapped(exact), [WL1])
    assert found.verdict.lost_frames == []
    assert not np.round((found.results[WL1].values - exact) / TURN).any()


def test_a_boundary_frame_that_is_left_out_spoils_nothing() -> None:
    exact = noisy(torn(drifting(15), BAD, 25), 0.2)
    found = p4d.unwrap(wrapped(exact), WL1, boundary=(BAD, 0))
    assert found.attrs["lost_frames"] == [[BAD, 0], [BAD, 1]]
    off = np.round((found.values - exact) / TURN)
    off -= np.median(off, axis=(2, 3), keepdims=True)
    assert not off[np.arange(N) != BAD].any()


@pytest.mark.slow
def test_on_disk_it_is_remembered_for_the_verdict(tmp_path: Path) -> None:
    """What is needed on the way only goes there, and the verdict comes last."""
    values = wrapped(noisy(torn(drifting(15), BAD, 25), 0.2))
    coords = {"time": np.arange(float(N)), "angle": [0.0, 1.0]}
    phase = xr.DataArray(values, dims=("time", "angle", "y", "x"), coords=coords)
    problem = ProblemOnDisk(phase, InMemory(values), Shelf(tmp_path), (0, 0), finds_mask=False)
    on_disk = compare_on(problem, [WL1, "spatial-2d"], None, {})
    here = p4d.compare(phase, [WL1, "spatial-2d"])
    assert on_disk.verdict.lost_frames == [(BAD, 0), (BAD, 1)]
    assert on_disk.verdict == here.verdict
    for method in (WL1, "spatial-2d"):
        assert np.array_equal(on_disk.results[method].values, here.results[method].values)
