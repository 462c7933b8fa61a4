"""The paper's five methods: against scikit-image, a literal transcription, and exact truth."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr
from skimage.restoration import unwrap_phase

import napari_phase4d as p4d
from napari_phase4d.simulation import Ellipsoid, phase_stack
from napari_phase4d.task import Watch
from napari_phase4d.unwrapping import Problem
from napari_phase4d.unwrapping.chain import Line, Maps, unwrap_line
from napari_phase4d.unwrapping.frames import (
    border_medians,
    border_values,
    centre_of_mass_shifts,
    lift_of,
    median_and_field,
    moved,
)
from napari_phase4d.unwrapping.growing import Workspace, smooth_turns
from napari_phase4d.unwrapping.objects import object_mask
from napari_phase4d.unwrapping.pieces import (
    Piece,
    peak_phase,
    pieces_between,
    with_thin_turning_points,
)

FIVE = ("spatial-2d", "angular", "temporal", "temporal-angular", "angular-temporal")
TURN = 2 * np.pi


def growing_cell(n_times: int = 8, n_angles: int = 3, speed_um: float = 0.0) -> xr.Dataset:
    """A cell that thickens from a phase that 2-D unwrapping follows to one that it can't."""

    def bodies(time: float) -> list[Ellipsoid]:
        thick = 0.4 + 0.12 * time
        return [Ellipsoid((speed_um * time - 1, 0.3, 0), (4.0, 3.2, thick), 0.55)]

    return phase_stack(
        bodies, times_s=range(n_times), angles_deg=[5.0 * a for a in range(n_angles)],
        shape=(40, 48), pixel_um=0.3, optics=p4d.Optics(), attrs={},
    )  # fmt: skip


def literal_combined(
    wrapped: np.ndarray, initial: np.ndarray, masks: np.ndarray, start: int
) -> np.ndarray:
    """Do section 2's steps 1 to 4 of the paper pixel by pixel, as they are written there."""
    n, height, width = wrapped.shape
    maps = np.zeros_like(initial)

    def arranged(order: list[int]) -> None:
        # Step 1: the thin map is unwrapped by the initial method, the others are wrapped.
        maps[order[0]] = initial[order[0]] * masks[order[0]]
        for previous, k in itertools.pairwise(order):
            for i in range(height):
                for j in range(width):
                    # Step 2: 1-D unwrapping relative to the (k-1)'th map.
                    difference = wrapped[k, i, j] - maps[previous, i, j]
                    while difference > np.pi:
                        difference -= TURN
                    while difference < -np.pi:
                        difference += TURN
                    along = maps[previous, i, j] + difference
                    # Step 3: the maximum of the initial and the 1-D unwrapping.
                    largest = max(initial[k, i, j], along)
                    # Step 4: the mask.
                    maps[k, i, j] = largest * masks[k, i, j]

    arranged(list(range(start, n)))
    arranged(list(range(start, -1, -1)))
    return maps


def literal(
    method: str, wrapped: np.ndarray, initial: np.ndarray, masks: np.ndarray, bc: tuple[int, int]
) -> np.ndarray:
    """Do the paper's T/A (or one of its parts) with loops over angles and times."""
    wrapped, initial = wrapped.astype(np.float64), initial.astype(np.float64)

    def along_time(first: np.ndarray) -> np.ndarray:
        result = np.zeros_like(first)
        for a in range(wrapped.shape[1]):
            result[:, a] = literal_combined(wrapped[:, a], first[:, a], masks[:, a], bc[0])
        return result

    def along_angle(first: np.ndarray) -> np.ndarray:
        result = np.zeros_like(first)
        for t in range(wrapped.shape[0]):
            result[t] = literal_combined(wrapped[t], first[t], masks[t], bc[1])
        return result

    return {
        "angular": lambda: along_angle(initial),
        "temporal": lambda: along_time(initial),
        "temporal-angular": lambda: along_angle(along_time(initial)),
        "angular-temporal": lambda: along_time(along_angle(initial)),
    }[method]()


@pytest.mark.slow
@pytest.mark.parametrize("bc", [(0, 0), (3, 1)])
@pytest.mark.parametrize("method", FIVE[1:])
@pytest.mark.parametrize("masked", [False, True])
def test_methods_equal_a_literal_transcription(
    method: str, masked: bool, bc: tuple[int, int]
) -> None:
    data = growing_cell(6, 3)
    rng = np.random.default_rng(5)
    noisy = data["phase"] + rng.normal(0, 0.3, data["phase"].shape)
    wrapped = np.angle(np.exp(1j * noisy.values)).astype(np.float32)
    mask = (data["phase"].values > 0.5) if masked else None
    result = p4d.unwrap(wrapped, method, bc, mask, registration=False, split=False).values
    problem = Problem(wrapped, bc, mask)
    expected = literal(method, problem.wrapped, problem.spatial(), problem.mask, bc)
    np.testing.assert_allclose(result, expected, atol=1e-4)


def test_spatial_2d_is_scikit_images_frame_by_frame() -> None:
    wrapped = growing_cell()["wrapped"].values
    result = p4d.unwrap(wrapped, "spatial-2d").values
    for index in np.ndindex(*wrapped.shape[:2]):
        offset = result[index] - unwrap_phase(wrapped[index])
        turns = offset / TURN
        np.testing.assert_allclose(turns, np.round(turns.flat[0]), atol=1e-5)
        assert abs(np.median(result[index][:2])) < np.pi


def test_spatial_2d_inside_a_mask_is_scikit_images() -> None:
    data = growing_cell(3, 2)
    wrapped, mask = data["wrapped"].values, data["phase"].values > 0.3
    result = p4d.unwrap(wrapped, "spatial-2d", mask=mask).values
    assert (result[~mask] == 0).all()
    for index in np.ndindex(*wrapped.shape[:2]):
        theirs = unwrap_phase(np.ma.masked_array(wrapped[index], ~mask[index]), rng=0)
        turns = ((result[index] - theirs) / TURN)[mask[index]]
        np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-5)
    # The mask cuts the cell off from the background; its level must be right all the same.
    np.testing.assert_allclose(result[0, 0][mask[0, 0]], data["phase"].values[0, 0][mask[0, 0]],
                               atol=1e-4)  # fmt: skip


def test_parts_of_a_mask_keep_their_levels() -> None:
    """Two separate cells of different height, both easy: each must come out at its own level."""
    y, x = np.indices((60, 120))
    heights = (8.0, 18.0, -10.0)
    for left, right in ((0, 1), (2, 1), (1, 2)):
        truth = sum(
            heights[i] * np.exp(-((y - 30) ** 2 + (x - c) ** 2) / 200)
            for i, c in ((left, 30), (right, 90))
        )
        mask = (np.hypot(y - 30, x - 30) < 18) | (np.hypot(y - 30, x - 90) < 18)
        wrapped = np.angle(np.exp(1j * truth)).astype(np.float32)
        result = p4d.unwrap(wrapped, "spatial-2d", mask=mask).values
        np.testing.assert_allclose(result[mask], truth[mask], atol=1e-4)


def test_mask_follows_the_axes_of_the_phase() -> None:
    data = growing_cell(3, 3)
    turned = data["wrapped"].transpose("angle", "x", "time", "y")
    mask = data["phase"].transpose("x", "time", "angle", "y") > 0.5
    expected = p4d.unwrap(data["wrapped"], mask=data["phase"] > 0.5)
    result = p4d.unwrap(turned, mask=mask)
    np.testing.assert_array_equal(result.transpose(*expected.dims).values, expected.values)
    plain = p4d.unwrap(turned, mask=(data["phase"] > 0.5).values)  # time, angle, y, x
    np.testing.assert_array_equal(plain.values, result.values)
    with pytest.raises(ValueError, match="does not fit the phase.* name its axes"):
        p4d.unwrap(turned, mask=mask.values)


@pytest.mark.parametrize("method", FIVE)
@pytest.mark.parametrize("mask", [None, "auto", "array"])
def test_results_are_congruent_inside_the_mask(method: str, mask: object) -> None:
    data = growing_cell(6, 3, speed_um=0.5)
    rng = np.random.default_rng(7)
    noisy = data["phase"] + rng.normal(0, 0.4, data["phase"].shape)
    wrapped = data["wrapped"].copy(data=np.angle(np.exp(1j * noisy.values)).astype(np.float32))
    inside = data["phase"].values > 0.5 if mask == "array" else None
    result = p4d.unwrap(wrapped, method, mask=inside if mask == "array" else mask)
    where = inside if mask == "array" else result.values != 0
    error = (result.values - wrapped.values)[where]
    assert np.abs(error - TURN * np.round(error / TURN)).max() < 1e-4
    assert result.dtype == np.float32
    assert result.dims == wrapped.dims
    xr.testing.assert_equal(result["angle"], wrapped["angle"])
    assert result.attrs["method"] == method
    assert result.attrs["boundary"] == [[0, 0]]


def test_temporal_is_right_where_2d_is_wrong() -> None:
    """The paper's point: a cell too thick for 2-D is right from its thin moment on."""
    data = growing_cell(9, 1)
    truth = data["phase"].values
    wrong = {
        m: np.mean(np.abs(p4d.unwrap(data["wrapped"], m).values - truth) > np.pi)
        for m in ("spatial-2d", "temporal", "temporal-angular")
    }
    assert wrong["spatial-2d"] > 0.02
    assert wrong["temporal"] < 0.3 * wrong["spatial-2d"]
    assert wrong["temporal-angular"] == wrong["temporal"]  # one angle adds nothing


def test_boundary_frame_is_kept() -> None:
    data = growing_cell(5, 3)
    for method in FIVE:
        result = p4d.unwrap(data["wrapped"], method).values[0, 0]
        np.testing.assert_allclose(result, data["phase"].values[0, 0], atol=1e-4)


def test_boundary_may_be_anywhere_and_negative() -> None:
    data = growing_cell(6, 2)
    backwards = data["wrapped"].isel(time=slice(None, None, -1))
    for method in FIVE:
        forward = p4d.unwrap(data["wrapped"].values, method, (0, 1)).values
        backward = p4d.unwrap(backwards.values, method, (-1, 1)).values
        np.testing.assert_array_equal(forward, backward[::-1])


def test_thin_frames_on_both_sides() -> None:
    """Thin, thick, thin: from one thin frame the far end comes out wrong, from two it doesn't."""
    data = growing_cell(8, 1)
    both = np.concatenate([data["wrapped"].values, data["wrapped"].values[::-1]])
    truth = np.concatenate([data["phase"].values, data["phase"].values[::-1]])
    two = p4d.unwrap(both, "temporal", [(0, 0), (15, 0)], split=False).values
    assert_half = p4d.unwrap(data["wrapped"].values, "temporal", split=False).values
    np.testing.assert_array_equal(two[:8], assert_half)
    np.testing.assert_array_equal(two[8:], assert_half[::-1])
    one = p4d.unwrap(both, "temporal", (0, 0), split=False).values
    split = p4d.unwrap(both, "temporal", (0, 0), split=True).values
    assert np.mean((split - truth) ** 2) <= np.mean((one - truth) ** 2)
    np.testing.assert_array_equal(split[-1], two[-1])


def test_sequence_is_cut_where_it_is_thickest() -> None:
    profile = np.array([3.0, 5, 9, 12, 8, 4, 3.1, 6, 10, 7, 9])
    assert with_thin_turning_points(profile, [0]) == [0, 6]
    assert pieces_between([0, 6], 11, profile) == [Piece(0, 0, 3), Piece(3, 6, 11)]
    assert pieces_between([2], 5, None) == [Piece(0, 2, 5)]
    assert pieces_between([0, 4], 5, None) == [Piece(0, 0, 3), Piece(3, 4, 5)]
    rising = np.array([3.0, 4, 5, 6])
    assert with_thin_turning_points(rising, [0]) == [0]
    noisy = np.array([3.0, 3.2, 3.0, 3.3, 3.1])  # thin all along: no reason to start anew
    assert with_thin_turning_points(noisy, [0]) == [0]


def test_peak_of_a_map_is_that_of_its_object() -> None:
    rng = np.random.default_rng(5)
    for shape, share in (((40, 30), 0.4), ((3, 2), 0.5), ((200, 180), 0.9)):
        wrapped, mask = rng.uniform(-3, 3, shape).astype(np.float32), rng.random(shape) < share
        turns = np.where(mask, rng.integers(-1, 4, shape), 90).astype(np.int16)
        inside = (np.float32(TURN) * turns + wrapped)[mask]
        expected = np.quantile(inside.astype(np.float64), 0.99)
        assert peak_phase(wrapped, turns, mask) == pytest.approx(expected, rel=1e-6)
    assert peak_phase(wrapped, turns, np.zeros_like(mask)) == 0


def test_line_is_unwrapped_anew_from_a_map_that_turns_out_as_thin_as_the_first() -> None:
    rises = np.array([0.0, 2.5, 5.0, 7.5, 5.0, 2.5, 0.0])
    one, mask = np.ones((5, 4), np.float32), np.ones((5, 4), bool)
    wrapped = [np.angle(np.exp(1j * rise)).astype(np.float32) * one for rise in rises]
    own = [np.full(one.shape, -int(k > 2), np.int16) for k in range(7)]
    found = np.zeros((7, *one.shape), np.int16)
    for split in (False, True):
        line = Line(
            7,
            lambda k: Maps(wrapped[k], own[k], mask),
            lambda k: found[k],
            lambda k, _, turns: found.__setitem__(k, turns),
        )
        unwrap_line(line, [0], split=split)
        # What follows the thickest map follows from what the last one is by itself.
        expected = rises - TURN * (split * np.arange(7) > 2)
        unwrapped = np.stack(wrapped) + np.float32(TURN) * found
        np.testing.assert_allclose(unwrapped, expected[:, None, None] * one, atol=1e-4)
        if split:
            np.testing.assert_allclose(line.profile, rises, atol=1e-4)


def test_line_is_unwrapped_outwards_from_every_start() -> None:
    steps = np.array([0.0, 2.5, 5.0, 7.5, 5.0, 2.5])[:, None, None] * np.ones((6, 3, 3))
    wrapped = np.angle(np.exp(1j * steps)).astype(np.float32)
    mask = np.ones((3, 3), dtype=bool)
    maps = [Maps(phase, np.int16([[-(k > 0)] * 3] * 3), mask) for k, phase in enumerate(wrapped)]
    found = np.zeros(wrapped.shape, np.int16)
    room = np.zeros_like(found)

    def write(k: int, _: Maps, turns: np.ndarray) -> None:
        found[k] = turns

    line = Line(6, maps.__getitem__, room.__getitem__, write)
    unwrap_line(line, [0], split=False)
    np.testing.assert_allclose(wrapped + TURN * found, steps, atol=1e-5)


def test_moving_cell_is_registered_and_moved_back() -> None:
    data = growing_cell(8, 2, speed_um=0.6)  # two pixels a frame
    truth = data["phase"].values
    problem = Problem(data["wrapped"])
    shifts = problem.shifts()
    assert (shifts[:, :, 0] == 0).all()
    np.testing.assert_allclose(shifts[:, 0, 1], -2 * np.arange(8), atol=1)
    registered = p4d.unwrap(data["wrapped"], "temporal-angular").values
    fixed = p4d.unwrap(data["wrapped"], "temporal-angular", registration=False).values
    errors = [np.mean((r - truth) ** 2) for r in (registered, fixed)]
    assert errors[0] < 0.5 * errors[1]


def test_failing_masks_do_not_move_a_field_that_stands_still() -> None:
    rng = np.random.default_rng(3)
    still = np.repeat(rng.normal(0, 1, (1, 2, 32, 32)), 6, axis=0)
    wrapped = np.angle(np.exp(1j * still)).astype(np.float32)
    masks = rng.random(wrapped.shape) < 0.3
    masks[:, :, :16] |= rng.random((6, 2, 1, 1)) < 0.5  # now and then half the frame more
    shifts = centre_of_mass_shifts(wrapped, masks, (0, 0), Watch(12, ""))
    assert (shifts == shifts[0]).all()


def test_moving_there_and_back_changes_nothing() -> None:
    rng = np.random.default_rng(4)
    stack = rng.normal(size=(3, 2, 5, 7))
    shifts = rng.integers(-9, 9, (3, 2, 2))
    np.testing.assert_array_equal(moved(moved(stack, shifts), -shifts), stack)


def test_object_mask_is_the_objects_shadow() -> None:
    data = growing_cell(8, 1)
    rng = np.random.default_rng(2)
    phase = data["phase"].values[7, 0]
    noisy = (phase + rng.normal(0, 0.1, phase.shape)).astype(np.float32)
    mask = object_mask(noisy)
    assert mask[phase > 1].all()
    assert mask[phase == 0].mean() < 0.25
    everywhere = np.linspace(0, 20, 48 * 40).reshape(40, 48).astype(np.float32)
    assert object_mask(everywhere).all()  # no single object: nothing is left out


@pytest.mark.parametrize("rad", [0.3, 0.9])  # without residues, and with some in every frame
def test_a_field_that_drifts_is_lifted_the_same_alone_and_among_other_methods(rad: float) -> None:
    noise = np.random.default_rng(0).normal(0, rad, (30, 2, 20, 24))
    drift = np.linspace(-9, 30, 30)[:, None, None, None]
    phase = np.angle(np.exp(1j * (noise + drift))).astype(np.float32)
    assert all((smooth_turns(one, Workspace()) is None) == (rad > 0.5) for one in phase[:, 0])
    for boundary in ((0, 0), (17, 1)):
        alone = p4d.unwrap(phase, "spatial-2d", boundary)
        among = p4d.compare(phase, ["spatial-2d", "temporal"], boundary).results["spatial-2d"]
        np.testing.assert_array_equal(alone, among)
        steps = np.diff(np.median(alone.values, axis=(2, 3)), axis=0)
        np.testing.assert_allclose(steps, 39 / 29, atol=rad)


def test_level_of_the_border_is_followed_from_frame_to_frame() -> None:
    drift = 0.9 * np.arange(10)[:, None] + np.array([0.0, 0.5])
    wrapped = np.angle(np.exp(1j * drift))
    np.testing.assert_allclose(border_medians(wrapped, (0, 0)), drift)
    for first in ((9, 1), (9, 0), (4, 1)):  # the boundary frame is the one within half a turn
        found = border_medians(wrapped, first)
        np.testing.assert_allclose(found - found[first], drift - drift[first], atol=1e-9)
        assert abs(found[first]) <= np.pi
    views = np.array([[0.0, 2.5, 5.0]] * 3)
    found = border_medians(np.angle(np.exp(1j * views)), (2, 0))
    np.testing.assert_allclose(found, views, atol=1e-9)


@pytest.mark.parametrize(
    "method", ["spatial-2d", "temporal-angular", "region-growing", "spatial-3d", "network-flow"]
)
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_level_is_that_of_the_field_where_a_slope_covers_half_of_the_border(
    method: str, noise: float
) -> None:
    """The border's median is 4 rad here, and half of the border's pixels lie further up."""
    x = np.broadcast_to(np.arange(48), (48, 48))
    wall = 16 / (1 + np.exp(-(x - 27 - 0.5 * np.arange(3)[:, None, None]) / 4))
    truth = wall[:, None] + np.random.default_rng(2).normal(0, noise, (3, 2, 48, 48))
    medians = [np.median(border_values(frame)) for frame in truth[:, 0]]
    assert max(medians) > np.pi
    wrapped = np.angle(np.exp(1j * truth)).astype(np.float32)
    unwrapped = p4d.unwrap(wrapped, method, boundary=(2, 1))
    assert np.mean(np.abs(unwrapped.values - truth) > 1) < (0.01 if noise else 1e-9)


def test_a_border_shows_a_field_where_much_of_it_lies_close_together() -> None:
    """A tilt has no such place; half a field under a slope has one."""
    rising = np.linspace(-4, 5, 500).astype(np.float32)
    np.testing.assert_equal(median_and_field(rising), (np.median(rising), np.nan))
    even = np.random.default_rng(0).normal(0.2, 0.1, 400).astype(np.float32)
    assert median_and_field(even) == (np.median(even), np.median(even))
    slope = np.linspace(1, 16, 600, dtype=np.float32)
    median, field = median_and_field(np.concatenate([even, slope]))
    assert field == pytest.approx(0.2, abs=0.05)
    assert median > 2
    few = np.concatenate([even[:100], slope])
    np.testing.assert_equal(median_and_field(few), (np.median(few), np.nan))


def test_the_field_is_followed_through_frames_that_do_not_show_it() -> None:
    """Medians rise by 2 rad a frame above a field that drifts; frames are whole turns off."""
    above, field = 2.0 * np.arange(9), 0.3 + 0.1 * np.arange(9)
    own = 2 * np.pi * np.array([0, 3, -2, 1, 0, 0, 5, -1, 2])
    levels = np.stack([above + field + own, field + own], axis=1)[:, None]
    for start, hidden in ((0, [2, 3, 5, 8]), (4, [0, 2, 3, 6, 7])):
        seen = levels.copy()
        seen[hidden, :, 1] = np.nan
        np.testing.assert_array_equal(lift_of(seen, (start, 0))[:, 0], -own / (2 * np.pi))
    # Neither what comes later nor another view changes what was, since frames may come one by
    # one; and a frame without a pixel, the fourth, changes nothing of what follows.
    medians, shown = [0, 2.5, 5, 0, 5, 0, 3], [0, np.nan, np.nan, np.nan, np.nan, 0, 0]
    hidden = np.stack([medians, shown], axis=1)
    whole = lift_of(np.stack([hidden, levels[:7, 0]], axis=1), (0, 0))[:, 0]
    assert not np.delete(whole, 3).any()
    for frames in range(1, 8):
        np.testing.assert_array_equal(lift_of(hidden[:frames, None], (0, 0))[:, 0], whole[:frames])
    # Where it is not seen at the boundary time, no later frame says how high the medians lie.
    seen = levels.copy()
    seen[0, :, 1] = np.nan
    np.testing.assert_array_equal(lift_of(seen, (0, 0)), lift_of(levels[..., [0, 0]], (0, 0)))


@pytest.mark.parametrize("method", FIVE)
def test_one_frame_one_angle_and_fewer_axes(method: str) -> None:
    frame = growing_cell(1, 1)
    two_d = p4d.unwrap(frame["wrapped"].values[0, 0], method)
    assert two_d.dims == ("y", "x")
    np.testing.assert_allclose(two_d.values, frame["phase"].values[0, 0], atol=1e-4)
    three_d = p4d.unwrap(growing_cell(3, 1)["wrapped"].values[:, 0], method)
    assert three_d.dims == ("time", "y", "x")
    named = p4d.unwrap(growing_cell(2, 2)["wrapped"].transpose("y", "x", "angle", "time"), method)
    assert named.dims == ("y", "x", "angle", "time")


@pytest.mark.parametrize("method", FIVE)
def test_progress_and_cancel(method: str) -> None:
    wrapped = growing_cell(4, 2)["wrapped"]
    seen: list[tuple[int, int, str]] = []
    p4d.unwrap(wrapped, method, progress=lambda *step: seen.append(step))
    assert seen[0][:2] == (2, 8)  # both views of the first time
    assert all(0 < done <= total for done, total, _ in seen)
    assert seen[-1][0] == seen[-1][1]
    for after in (0, 3, len(seen) - 1):
        count: list[int] = []
        with pytest.raises(p4d.Cancelled):
            p4d.unwrap(
                wrapped, method, progress=lambda *_, c=count: c.append(1),
                cancelled=lambda c=count, n=after: len(c) >= n,
            )  # fmt: skip
        assert len(count) <= after + 1


BAD = {
    "nan": (lambda w: w.where(w["x"] != 3), {}, "NaN or infinite pixels .*leave them out"),
    "method": (lambda w: w, {"method": "magic"}, "method must be one of spatial-2d"),
    "option": (lambda w: w, {"method": "temporal", "speed": 3}, "temporal has no option 'speed'"),
    "boundary": (
        lambda w: w,
        {"boundary": (9, 0)},
        r"boundary frame \(time 9, angle 0\) does not",
    ),
    "boundary kind": (lambda w: w, {"boundary": (0.5, 0)}, "boundary must be"),
    "boundary shape": (lambda w: w, {"boundary": (1, 2, 3)}, "boundary must be"),
    "mask shape": (lambda w: w, {"mask": np.ones((3, 3))}, "the mask is .* does not fit"),
    "mask word": (lambda w: w, {"mask": "manual"}, 'mask must be an array, "auto" or None'),
    "mask empty": (lambda w: w, {"mask": np.zeros((40, 48))}, "the mask is empty"),
    "dimensions": (lambda w: w.values[0, 0, 0], {}, "phase has 1 dimensions"),
    "names": (lambda w: w.rename(time="frame"), {}, "they must be among time, angle, y, x"),
    "complex": (lambda w: np.exp(1j * w), {}, "phase is complex"),
    "text": (lambda w: np.full((3, 3), "a"), {}, "phase must be real numbers"),
    "empty": (lambda w: w.values[:0], {}, "phase is empty"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gives_one_sentence(case: str) -> None:
    change, arguments, sentence = BAD[case]
    wrapped = change(growing_cell(2, 2)["wrapped"])
    with pytest.raises((TypeError, ValueError), match=sentence) as caught:
        p4d.unwrap(wrapped, **arguments)
    assert "\n" not in str(caught.value)


def test_constant_phase_stays_as_it_is() -> None:
    for method in FIVE:
        result = p4d.unwrap(np.full((3, 2, 16, 16), 0.4, np.float32), method).values
        np.testing.assert_allclose(result, 0.4, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("method", p4d.METHODS)
def test_what_is_not_known_is_not_known_in_the_result(method: str) -> None:
    """It is no zero, which would be measured; a zero is what is left out of the object."""
    if p4d.METHODS[method].wavelengths > 1:
        pytest.skip("needs several wavelengths")
    holes = growing_cell(3, 2)["wrapped"].copy(deep=True)
    holes.values[1:, :, 20:30, 20:] = np.nan
    found = p4d.unwrap(holes, method, mask="auto")
    np.testing.assert_array_equal(np.isnan(found.values), np.isnan(holes.values))
    assert (found.values == 0).any()
    held = p4d.compare(holes, [method], mask="auto").object_mask().values
    assert not held[np.isnan(holes.values)].any()


def test_nan_outside_the_mask_is_fine() -> None:
    data = growing_cell(3, 2)
    holes = data["wrapped"].copy(deep=True)
    holes[:, :, :4, :4] = np.nan
    for method in FIVE:
        result = p4d.unwrap(holes, method, mask=np.isfinite(holes.values)).values
        np.testing.assert_array_equal(np.isnan(result), np.isnan(holes.values))
        np.testing.assert_allclose(result[0, 0, 6:], data["phase"].values[0, 0, 6:], atol=1e-4)


@pytest.mark.slow
def test_input_is_left_as_it_was() -> None:
    wrapped = growing_cell(3, 2)["wrapped"]
    before = wrapped.copy(deep=True)
    holes = wrapped.values.copy()
    holes[0, 0, 0, 0] = np.nan
    for method in FIVE:
        p4d.unwrap(wrapped, method, mask="auto")
        p4d.unwrap(holes, method, mask=np.isfinite(holes))
    xr.testing.assert_identical(wrapped, before)
    assert np.isnan(holes[0, 0, 0, 0])


def test_methods_are_described() -> None:
    assert tuple(p4d.METHODS)[:5] == FIVE
    for method in p4d.METHODS.values():
        assert method.label
        assert method.source
        assert method.summary.endswith(".")
        for option in method.options:
            assert option.summary.endswith(".")


@pytest.mark.parametrize("dtype", [bool, np.uint8, np.float32])
def test_what_is_masked_of_a_mask_is_not_in_it(dtype: type) -> None:
    wrapped = p4d.simulation.budding_yeast((16, 16), 2)["wrapped"]
    inside = np.ones((16, 16), dtype)
    masked = np.ma.masked_array(inside, mask=np.indices(inside.shape)[0] < 4)
    found = p4d.unwrap(wrapped, "temporal", mask=masked).values
    expected = p4d.unwrap(wrapped, "temporal", mask=~masked.mask).values
    np.testing.assert_array_equal(found, expected)
    assert not found[..., :4, :].any()


def test_a_line_is_not_cut_at_a_map_of_which_nothing_is_known() -> None:
    below = np.array([-5, -4, -3, np.nan, -2, -4, -5.0])  # an object thinner than its medium
    assert pieces_between([0, 6], 7, below)[0].stop == 4
