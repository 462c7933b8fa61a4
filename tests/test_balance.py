"""Whether mass that goes missing at once tells objects that slipped."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis import slipped_frames
from napari_phase4d.analysis.balance import (
    Claims,
    Objects,
    balance_of,
    claims_of_groups,
    clear_pixels,
    likely_slipped,
)
from napari_phase4d.analysis.cell_frames import cells_that_touch
from napari_phase4d.analysis.slips import slip_words
from napari_phase4d.simulation import hard_shape, with_noise
from napari_phase4d.stack import Block, InMemory
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import Judged, Problem

TURN = 2 * np.pi
N = 12
Y, X = np.mgrid[:64, :96].astype(float)


def dome(mass: float, y: float, x: float, radius: float) -> np.ndarray:
    """Return the phase of a round cell whose phase sums up to so many turns times its area."""
    height = np.maximum(1 - ((Y - y) ** 2 + (X - x) ** 2) / radius**2, 0)
    return mass * TURN * np.pi * radius**2 * height / height.sum()


def two_cells(mass: float = 1.5, growth: float = 0.0) -> np.ndarray:
    """Return a large cell that moves and a small one that changes its size, mass unchanged."""
    frames = []
    for t in range(N):
        more = 1 + growth * t
        large = dome(mass * more, 22 + t, 28, 15)
        radius = 9 + 0.2 * t
        small = dome(mass * more * 81 / radius**2, 40 - t, 70, radius)
        frames.append(large + small)
    return np.stack(frames)[:, None].astype(np.float32)


def likely(
    phase: np.ndarray, slipped: np.ndarray, first: int = 0, mask: np.ndarray | None = None
) -> np.ndarray:
    """Return how likely each pixel slipped in a result that is off by so many turns."""
    wrapped = np.angle(np.exp(1j * phase)).astype(np.float32)
    data = xr.DataArray(wrapped, dims=("time", "angle", "y", "x"))
    problem = Problem(data, boundary=(first, 0), mask=mask)
    result = (phase + TURN * slipped).astype(np.float32)
    found = balance_of(problem, Judged(InMemory(result)), UNWATCHED)
    return found.read(Block(0, len(phase)))


def slip(phase: np.ndarray, times: slice, columns: slice, turns: int = -1) -> np.ndarray:
    """Return turns that are off at some times on the cell that some columns hold."""
    off = np.zeros_like(phase)
    inside = np.zeros_like(phase, dtype=bool)
    inside[times, :, :, columns] = True
    off[inside & (phase > 0.3)] = turns
    return off


LARGE, SMALL = slice(0, 50), slice(55, 96)


def test_mass_that_stays_raises_no_doubt() -> None:
    phase = two_cells()
    assert not likely(phase, np.zeros_like(phase)).any()


@pytest.mark.parametrize("growth", [0.05, -0.06])
def test_steady_growth_raises_no_doubt(growth: float) -> None:
    phase = two_cells(growth=growth)
    assert not likely(phase, np.zeros_like(phase)).any()


@pytest.mark.parametrize("columns", [LARGE, SMALL])
def test_the_object_that_slips_is_told_from_then_on(columns: slice) -> None:
    phase = two_cells()
    off = slip(phase, slice(5, None), columns)
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()
    assert not found[:5].any()
    other = SMALL if columns is LARGE else LARGE
    assert not found[..., other].any()


def test_two_objects_that_slip_at_once_are_both_told() -> None:
    phase = two_cells()
    off = slip(phase, slice(5, None), LARGE) + slip(phase, slice(5, None), SMALL)
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()


def test_what_others_lose_in_the_same_frame_is_theirs() -> None:
    phase = two_cells()
    phase[5:, ..., SMALL] *= 0.8  # truly less by 0.3 turns
    off = slip(phase, slice(5, None), LARGE)
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()
    assert not found[..., SMALL].any()


def test_an_object_that_comes_back_is_told_meanwhile_only() -> None:
    phase = two_cells()
    off = slip(phase, slice(4, 7), LARGE)
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()
    assert not found[[*range(4), *range(7, N)]].any()


def test_it_is_counted_outwards_from_the_boundary_frame() -> None:
    phase = two_cells(3.0)
    off = slip(phase, slice(None, 5), LARGE)
    assert (likely(phase, off, first=9)[off != 0] > 0.9).all()
    # From the other side it is a gain, and growth may come at once.
    assert not likely(phase, off, first=0).any()


def test_an_object_thinner_than_its_medium_misses_what_it_lacks() -> None:
    phase = -two_cells()
    off = np.zeros_like(phase)
    off[5:, :, :, LARGE][phase[5:, :, :, LARGE] < -0.3] = 1
    assert (likely(phase, off)[off != 0] > 0.9).all()


def test_nothing_is_said_of_what_is_cut_off() -> None:
    phase = two_cells()
    off = slip(phase, slice(5, None), LARGE)
    cut = slice(0, 24)  # through the large cell, along its way
    assert not likely(phase[..., 26:], off[..., 26:])[..., cut].any()
    known = np.ones(phase.shape, dtype=bool)
    known[:, :, 26:30, 26:30] = False
    found = likely(phase, off, mask=known)
    assert not found[..., LARGE].any()


def test_two_cells_that_meet_and_part_keep_their_mass_together() -> None:
    frames = [
        dome(1.5, 32, 48 - abs(6 - t) * 4, 12) + dome(1.5, 32, 48 + abs(6 - t) * 4, 12)
        for t in range(N + 1)
    ]
    phase = np.stack(frames)[:, None].astype(np.float32)
    assert not likely(phase, np.zeros_like(phase)).any()
    off = np.zeros_like(phase)
    off[11:, :, :, :48][phase[11:, :, :, :48] > 0.3] = -1  # slips after they have parted
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()
    assert not found[11:, :, :, 52:].any()


@pytest.mark.parametrize("n", [1, 2, 3])
def test_few_frames_say_nothing(n: int) -> None:
    phase = two_cells()[:n]
    off = slip(phase, slice(n - 1, None), LARGE)
    assert not likely(phase, off).any()


def test_frames_without_an_object_say_nothing() -> None:
    phase = two_cells()
    phase[::3] = 0
    assert not likely(phase, np.zeros_like(phase)).any()


def test_lost_frames_are_bridged() -> None:
    phase = two_cells()
    off = slip(phase, slice(6, None), LARGE)
    phase[5] = np.nan
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()
    assert not found[:6].any()


def test_cells_that_lie_close_do_not_share_a_loss() -> None:
    left, right = 29, 55  # what is found of one reaches where the other one was
    phase = np.stack(
        [
            dome(1.5, 32, left + 4 * (t % 2), 11) + dome(1.5, 32, right + 4 * (t % 2), 11)
            for t in range(N)
        ]
    )[:, None].astype(np.float32)
    off = slip(phase, slice(5, None), slice(0, 44))
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()
    assert not found[..., 52:].any()


def test_of_two_turns_one_may_come_back() -> None:
    phase = two_cells()
    off = slip(phase, slice(4, 7), LARGE, -2) + slip(phase, slice(7, None), LARGE)
    found = likely(phase, off)
    assert (found[7:][off[7:] != 0] > 0.9).all()
    assert not found[4:7].any()  # two turns are not a turn


def daughters(before: int = 6) -> np.ndarray:
    """Return a cell that divides after so many frames; its daughters part."""
    frames = [dome(3.0, 32, 48, 16)] * before
    for t in range(6):
        apart, radius = 5 * (t + 1), 16 / 2**0.5
        frames.append(dome(3.0, 32, 48 - apart, radius) + dome(3.0, 32, 48 + apart, radius))
    return np.stack(frames)[:, None].astype(np.float32)


def test_both_daughters_of_what_slipped_are_told() -> None:
    phase = daughters()
    off = slip(phase, slice(3, None), slice(None))
    found = likely(phase, off)
    assert (found[-1][off[-1] != 0] > 0.9).all()
    assert not found[:3].any()


def test_a_daughter_that_comes_back_leaves_the_other_one_behind() -> None:
    """Neither misses two turns. So each missed one, and the other one still does."""
    phase = daughters(12)
    off = slip(phase, slice(7, 15), slice(0, 48)) + slip(phase, slice(3, None), slice(48, 96))
    found = likely(phase, off)
    assert (found[14][off[14] != 0] > 0.7).all()
    assert (found[15:][off[15:] != 0] > 0.7).all()
    assert not found[15:, ..., :48].any()


@pytest.mark.parametrize("columns", [slice(0, 46), slice(46, 96)])
def test_cells_that_touch_are_told_apart(columns: slice) -> None:
    cells = dome(1.5, 32, 34, 12) + dome(1.5, 32, 58, 10)
    phase = np.stack([cells] * N)[:, None].astype(np.float32)
    off = slip(phase, slice(5, None), columns)
    found = likely(phase, off)
    assert (found[off != 0] > 0.9).all()
    other = phase[0, 0] > 0.3
    other[:, columns] = False
    assert other.sum() > 200
    assert not found[..., other].any()


@pytest.mark.parametrize("scale", [1, 7])
def test_cells_that_touch_are_known_by_their_form(scale: int) -> None:
    """Also where there are so many pixels that it is looked at with fewer."""
    y, x = np.mgrid[: 40 * scale, : 64 * scale] / scale
    one, other = np.hypot(y - 18, x - 20) < 13, np.hypot(y - 22, x - 43) < 11
    found = cells_that_touch(one | other)
    assert found is not None
    assert found.max() == 2
    assert not found[~(one | other)].any()
    for cell, beyond in ((one & ~other, other & ~one), (other & ~one, one & ~other)):
        number = np.bincount(found[cell]).argmax()
        assert (found[cell] == number).mean() > 0.98
        assert (found[beyond] == number).mean() < 0.02
    for single in (one, np.hypot(y - 20, (x - 32) / 2) < 15):
        assert cells_that_touch(single) is None


@pytest.mark.parametrize(
    ("radius", "rows", "columns"), [(10, 1, 9), (10, 1, 16), (30, 1, 8), (10, 6, 12)]
)
def test_many_cells_that_touch_are_all_known(radius: int, rows: int, columns: int) -> None:
    apart, count = round(1.8 * radius), rows * columns
    y, x = np.mgrid[: rows * apart + 2 * radius, : columns * apart + 2 * radius]
    places = [
        (radius + 5 + apart * i, radius + 5 + apart * j)
        for i in range(rows)
        for j in range(columns)
    ]
    found = cells_that_touch(
        np.any([np.hypot(y - cy, x - cx) < radius for cy, cx in places], axis=0)
    )
    assert found is not None
    assert len({int(found[place]) for place in places}) == count == found.max()


def test_a_thin_tail_belongs_to_the_cell_that_it_is_of() -> None:
    y, x = np.mgrid[:100, :300]
    cells = (np.hypot(y - 50, x - 50) < 40) | (np.hypot(y - 50, x - 122) < 40)
    found = cells_that_touch(cells | ((y == 50) & (x > 160) & (x < 290)))
    assert found is not None
    assert found[50, 50] != found[50, 122]
    assert (found[50, 165:289] == found[50, 122]).all()


def test_what_comes_back_after_a_second_meeting_is_told() -> None:
    places = [7] * 11 + [14] * 3 + [7] * 3 + [14] * 6
    frames = [dome(2.0, 32, 48 - d, 11) + dome(2.0, 32, 48 + d, 11) for d in places]
    phase = np.stack(frames)[:, None].astype(np.float32)
    off = slip(phase, slice(7, 20), slice(0, 48)) + slip(phase, slice(3, None), slice(48, 96))
    found = likely(phase, off)
    assert (found[12:20][off[12:20] != 0] > 0.7).all()
    assert (found[20:][off[20:] != 0] > 0.7).all()
    assert not found[20:, ..., :46].any()


def test_what_two_cells_that_meet_again_and_again_miss_is_counted_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Losses that are parted at every meeting would be twice as many each time."""
    apart = [8 if t % 2 else 14 for t in range(20)]
    frames = [np.maximum(dome(1.5, 32, 48 - d, 12), dome(1.5, 32, 48 + d, 12)) for d in apart]
    phase = np.stack(frames)[:, None].astype(np.float32)
    off = np.where(phase > 0.3, -1, 0) * (np.arange(20) >= 3)[:, None, None, None]
    held: list[int] = []

    def counted(claims: list[Claims], objects: Objects) -> np.ndarray:
        held.append(max((len(own) for own in claims), default=0))
        return likely_slipped(claims, objects)

    monkeypatch.setattr("napari_phase4d.analysis.balance.likely_slipped", counted)
    found = likely(phase, off)
    assert found[3:].max() > 0.9
    assert 0 < max(held) < 60


def test_a_plateau_that_seems_empty_after_its_slip_is_told() -> None:
    plateau = TURN * (np.hypot(Y - 32, X - 40) < 18) + np.zeros((N, 1, 1, 1))
    phase = (plateau + dome(0.2, 32, 40, 20)).astype(np.float32)
    off = slip(phase, slice(6, None), slice(None))
    assert (likely(phase, off)[6:, :, 20:44, 28:52] > 0.9).all()


def test_a_frame_without_empty_field_says_nothing() -> None:
    phase = two_cells()
    off = slip(phase, slice(5, None), LARGE)
    phase[8] += 4 + 2 * np.sin(Y / 3) * np.sin(X / 3)
    found = likely(phase, off)
    assert not found[8:].any()
    assert (found[5:8][off[5:8] != 0] > 0.9).all()


def test_steady_loss_over_a_gap_raises_no_doubt() -> None:
    phase = two_cells(growth=-0.03)
    phase[5:10] = np.nan
    assert not likely(phase, np.zeros_like(phase)).any()


@pytest.mark.parametrize("each", [1, 2, 5])
def test_blocks_do_not_matter(each: int, monkeypatch: pytest.MonkeyPatch) -> None:
    phase = np.concatenate([two_cells(), two_cells(1.2)], axis=1)
    off = slip(phase, slice(6, None), LARGE)
    phase[4] = phase[5, 1] = phase[9, 0] = np.nan  # lost in all views, in one, in the other
    whole = likely(phase, off)
    blocks = [Block(t, min(t + each, N)) for t in range(0, N, each)]
    monkeypatch.setattr("napari_phase4d.analysis.balance.working_blocks", lambda _: blocks)
    np.testing.assert_array_equal(likely(phase, off), whole)
    known = (off != 0) & np.isfinite(phase)
    assert (whole[known] > 0.9).all()
    assert not whole[:6].any()


@pytest.mark.slow
def test_a_cell_that_a_shock_takes_a_turn_off_is_told() -> None:
    """All methods agree there on a level that is wrong, along steps that are smooth."""
    exact = hard_shape("shock")
    data = with_noise(exact.assign(phase=np.float32(1.5) * exact["phase"]), 0.4, seed=4)
    compared = p4d.compare(data["wrapped"], ["directional-l1"])
    off = np.round((compared.results["directional-l1"] - data["phase"]) / TURN)
    thick = exact["phase"] > 1
    wrong = ((off != 0) & thick).sum(["y", "x"]) > 0.5 * thick.sum(["y", "x"])
    assert wrong.values.any(), "the method became better: another recording has to be found"
    trust = compared.confidence("directional-l1")
    told = slipped_frames(compared.problem, trust)
    assert told[wrong.values].all()
    assert not told[~wrong.values].any()
    said = compared.warnings()["directional-l1"]
    assert f"in {told.sum()} of them an object has less mass" in said, said


def test_it_is_said_of_how_many_doubtful_frames_mass_is_why() -> None:
    slipped, missing = np.zeros((2, 6, 1), bool)
    slipped[2:5], missing[4:] = True, True
    assert "mass" not in slip_words(slipped)
    assert slip_words(slipped) == slip_words(slipped, np.zeros_like(missing))
    assert "in 3 of 6 frames" in slip_words(slipped, missing)
    assert "in 1 of them an object has less mass" in slip_words(slipped, missing)


def objects_of(area: list[int], size: list[int]) -> Objects:
    """Return objects of so many pixels, of which so many are clearly no empty field."""
    n = len(area)
    return Objects(np.ones(n), np.array(size), np.array(area), np.ones(n, dtype=bool))


def test_what_noise_leaves_no_clear_pixel_of_may_miss_something() -> None:
    """Nothing is divided by no pixels, as where an object is as thin as noise is."""
    before, after = objects_of([40, 30], [0, 9]), objects_of([40, 30], [0, 8])
    groups, gained = np.array([0, 1]), np.array([-12.0, -8.5])
    sizes = clear_pixels(groups, before, groups, after, gained)
    assert sizes.tolist() == [1, 8.5]
    claims = claims_of_groups([], gained, groups, before, sizes, 3)
    assert np.isfinite(likely_slipped(claims, after)).all()
    assert likely_slipped(claims, after)[1] == 1


def test_losses_that_cancel_are_none() -> None:
    """Of what two objects may both have lost, one lies above the field and one below it."""
    objects = objects_of([20, 20], [20, 20])
    up, down = {(2, 0, 1): (8.0, 10.0)}, {(2, 0, 2): (-8.0, -10.0)}
    groups, gained = np.array([0, 0]), np.zeros(1)
    found = claims_of_groups([up, down], gained, groups, objects, np.ones(1), 3)
    assert found == [{}]
