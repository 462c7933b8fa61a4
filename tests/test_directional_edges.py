"""Recordings whose empty field is not flat, and objects that the edge of the view cuts off."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

import napari_phase4d as p4d
from napari_phase4d.unwrapping import given
from napari_phase4d.unwrapping.background import find_background
from napari_phase4d.unwrapping.directional.registration import Look, kept_in_view
from napari_phase4d.unwrapping.directional.scene import Margins, ends_of
from napari_phase4d.unwrapping.directional.sides import (
    BIN,
    FURTHER,
    Looked,
    Rims,
    bins_but_rare,
    bins_of,
    came_back,
)

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from scenes import four_balls_through_a_pupil

TURN = 2 * np.pi
WL1, RGD = "directional-l1", "directional-growing"


def wrong(
    phase: np.ndarray, empty: np.ndarray, noise: float | np.ndarray, method: str, **options: object
) -> int:
    """Return on how many pixels a result is turns off, each frame above its empty field."""
    exact = phase + noise * np.random.default_rng(3).standard_normal(phase.shape)
    wrapped = np.angle(np.exp(1j * exact)).astype(np.float32)
    off = np.round((p4d.unwrap(wrapped, method, **options).values - exact) / TURN)
    for frame in np.ndindex(*off.shape[:2]):
        off[frame] -= np.median(off[frame][empty[frame]])
    return int(np.count_nonzero(off))


def blurred(phase: np.ndarray) -> np.ndarray:
    """Blur frames as optics do, so that no step is steeper than half a turn."""
    return ndimage.gaussian_filter(phase, (0, 1.2, 1.2))


def layer_of_cells(n_times: int, apart: int) -> np.ndarray:
    """A layer that fills the view and changes slowly, seen in two views some pixels apart."""
    draw = np.random.default_rng(3)
    first, second = (
        ndimage.gaussian_filter(draw.normal(size=(64, 80 + apart)), 7) for _ in range(2)
    )
    t = 0.12 * np.arange(n_times)[:, None, None]
    wide = 9 * (np.cos(t) * first / first.std() + np.sin(t) * second / second.std())
    return np.stack([wide[..., :80], wide[..., apart:]], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("method", [WL1, RGD])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_views_of_a_layer_without_empty_field_differ_by_more_than_half_a_turn(
    noise: float, method: str
) -> None:
    # 1.6 % of the voxels were turns off, where each frame by itself has a few pixels wrong.
    phase = layer_of_cells(10, apart=3)
    assert (np.abs(np.diff(phase, axis=1)) > np.pi).mean() > 0.05
    assert wrong(phase, np.ones(phase.shape, bool), noise, method) == 0


def sheet_that_grows(height: float, n_times: int = 20) -> np.ndarray:
    """A sheet with a flat top grows from the left edge until it covers most of the view."""
    y, x = np.mgrid[:60, :80]
    edges = np.linspace(10, 54, n_times)[:, None, None]
    return (height / (1 + np.exp((x - edges - 5 * np.sin(y / 9)) / 2.5)))[:, None]


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("height", [10.0, 17.0])
def test_what_grows_over_the_view_with_a_flat_top_is_not_taken_for_the_empty_field(
    height: float, noise: float
) -> None:
    # From the middle on, more of the border is the top of the sheet than is empty.
    phase = sheet_that_grows(height)
    assert wrong(phase, phase < 0.1, noise, WL1) == 0
    wrapped = np.angle(
        np.exp(1j * (phase + noise * np.random.default_rng(5).normal(size=phase.shape)))
    )
    found = find_background(wrapped.astype(np.float32))
    assert found.shown.all()
    np.testing.assert_allclose(found.level, 0, atol=0.3)
    assert not found.mask[phase > 0.5 * height].any()


@pytest.mark.parametrize("turn", [0.5, 1.6, 4.0])
@pytest.mark.parametrize("blank", [False, True])
def test_empty_field_that_truly_lies_elsewhere_is_found_there(turn: float, blank: bool) -> None:
    """The stage jumps, so that a flat cell on one side of the view lies on the other."""
    y, x = np.mgrid[-24:24, -24:24] + 0.5
    away = np.where(np.arange(16) < 8, 20, -20)[:, None, None]
    far = np.hypot(y - away * np.sin(turn), x - away * np.cos(turn))
    phase = (4 / (1 + np.exp(far - 24)))[:, None]
    wrapped = np.angle(np.exp(1j * phase)).astype(np.float32)
    lost = np.zeros((16, 1), dtype=bool)
    if blank:
        lost[7:9] = True
        wrapped[7:9] = 0
    found = find_background(wrapped, lost=lost)
    np.testing.assert_allclose(found.level[~lost], 0, atol=0.3)
    assert found.shown[~lost].all()


def ball_over_a_bowl(rises: float, side: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A ball goes through an empty field that rises by so much towards the edges."""
    y, x = np.mgrid[-28:28, -28:28] + 0.5
    bowl = rises * (y**2 + x**2) / 28**2
    places = np.linspace(-18, 18, 8)
    far = np.stack([(y**2 + (x - place) ** 2) / 11**2 for place in places])
    phase = side * (bowl + blurred(13 * np.sqrt(np.maximum(1 - far, 0))))
    return phase[:, None], (far > 1.6)[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("noise", [0, 0.2])
@pytest.mark.parametrize("rises", [0, 1, 2, 5, -4])
def test_empty_field_that_sags_under_the_object(rises: float, noise: float, side: int) -> None:
    """The field beside the object lies below that of the border, and is no error."""
    phase, empty = ball_over_a_bowl(rises, side)
    assert max(np.abs(np.diff(phase, axis=axis)).max() for axis in (2, 3)) < np.pi
    assert wrong(phase, empty, noise, WL1) == 0


def test_what_many_steps_hold_tells_how_far_a_pixel_may_lie_on_the_other_side() -> None:
    beyond = np.concatenate([np.zeros(900), np.full(90, 1.04), np.full(9, 2.04), np.full(1, 90.0)])
    counts = bins_of(beyond.astype(np.float32))
    assert counts.sum() == 1000
    assert counts[0] == 900
    assert counts[-1] == 1
    assert BIN * bins_but_rare(counts, 0.003 * 1000) == pytest.approx(2.0)
    assert bins_but_rare(bins_of(np.zeros(50, np.float32)), 0.15) == 0


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("sags", "may"), [(0, 0), (2, 2 * FURTHER), (4, 4.4)])
def test_the_empty_field_tells_how_far_it_sags(sags: float, may: float, side: int) -> None:
    """Parts that slipped lie on the other side too; they let no pixel lie there."""
    field = bins_of(np.full(100, sags + 0.04, np.float32))
    all_ = field + bins_of(np.full(100, 4.44, np.float32))
    other, none = np.stack([all_, field]), np.zeros((2, len(field)), np.int64)
    above, below = (none, other) if side > 0 else (other, none)
    nothing = np.zeros(0, np.float32)
    rims = Rims(0, 0, above, below, np.zeros(0, np.intp), nothing, nothing)
    assert Looked(side, rims).usual() == pytest.approx(may)


@pytest.mark.slow
def test_two_thick_cells_that_touch_do_not_let_each_other_slip() -> None:
    """Steps put parts of a rim a turn below; so might all others lie, and did: 2.3 rad²."""
    exact = 1.75 * p4d.simulation.moving_shape("touching")["phase"].values[::-1]
    noise = 0.3 * np.random.default_rng(7).standard_normal(exact.shape)
    found = p4d.unwrap(np.angle(np.exp(1j * (exact + noise))).astype(np.float32), WL1).values
    off = np.round((found - exact - noise) / TURN)
    assert TURN**2 * np.mean(off**2) < 0.5


def swimming_in_and_out(views: int) -> tuple[np.ndarray, np.ndarray]:
    """A long cell on a circle, most of which is out of view; frames do not overlap by much."""
    y, x = np.mgrid[-56:56, -56:56].astype(float)
    frames, fields = [], []
    for t in range(12):
        way = 0.5 * t
        along = (y - 26 * np.sin(way)) * np.cos(way) - (x - 26 * np.cos(way)) * np.sin(way)
        across = (y - 26 * np.sin(way)) * np.sin(way) + (x - 26 * np.cos(way)) * np.cos(way)
        far = (along / 19) ** 2 + (across / 11) ** 2
        frames.append(blurred(13.5 * np.sqrt(np.maximum(1 - far, 0))[None])[0])
        fields.append(far > 1.6)
    inside = np.s_[:, None, 28:84, 28:84]
    phase, empty = (np.repeat(np.stack(a)[inside], views, axis=1) for a in (frames, fields))
    return phase, empty


@pytest.mark.parametrize("method", [WL1, RGD])
@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("noise", [0, 0.2])
def test_cell_that_the_edge_of_the_view_cuts_off(noise: float, views: int, method: str) -> None:
    """2-D is right in every frame: what comes in at the other edge must not be held against it."""
    phase, empty = swimming_in_and_out(views)
    assert max(np.abs(np.diff(phase, axis=axis)).max() for axis in (2, 3)) < np.pi
    assert wrong(phase, empty, 0, "spatial-2d") == 0
    assert wrong(phase, empty, noise, method) == 0


def look_at(mask: np.ndarray) -> Look:
    nothing = np.zeros(mask.shape, dtype=np.float32)
    return Look(nothing, nothing, mask, mask.any(axis=(0, 2)), mask.any(axis=(0, 1)))


def test_no_new_shift_takes_a_large_part_of_an_object_over_the_edge() -> None:
    mask = np.zeros((2, 20, 30), dtype=bool)
    mask[:, 4:12, 5:25] = True
    tried = [np.array(shift) for shift in ((0, 0), (-4, 0), (-5, 0), (8, 5), (9, 0), (0, 6))]
    kept = [tuple(shift) for shift in kept_in_view(look_at(mask), tried)]
    assert kept == [(0, 0), (-4, 0), (8, 5)]
    # A speck at the edge may go.
    mask[0, 18:, 28:] = True
    assert [tuple(shift) for shift in kept_in_view(look_at(mask), tried)] == kept
    # An object that lies at all edges stays as it was in the frame before.
    assert [tuple(s) for s in kept_in_view(look_at(np.ones_like(mask)), tried[1:])] == [(-4, 0)]


def swimming_through(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Three thick cells swim in and out of view; the second view sees them three pixels off."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:96, :96] + 0.5
    phase, far = np.zeros((9, 2, 96, 96)), np.full((9, 2, 96, 96), 9.0)
    for _ in range(3):
        place = random.uniform((10, 5), (86, 90))
        radius, peak = random.uniform(9, 18), random.uniform(6, 14)
        speed = random.normal(0, 5, 2)
        for t, view in np.ndindex(9, 2):
            at = place + speed * (t - 4.5) - np.array([0, 3 * view])
            own = ((y - at[0]) ** 2 + (x - at[1]) ** 2) / radius**2
            phase[t, view] += peak * np.sqrt(np.maximum(1 - own, 0))
            far[t, view] = np.minimum(far[t, view], own)
    return ndimage.gaussian_filter(phase, (0, 0, 1.6, 1.6)), far > 1.6


@pytest.mark.slow
@pytest.mark.parametrize("method", [WL1, RGD])
@pytest.mark.parametrize("noise", [0, 0.2])
@pytest.mark.parametrize("seed", [13, 15, 23])
def test_there_is_room_for_what_a_shift_takes_over_the_edge(
    seed: int, noise: float, method: str
) -> None:
    """A shift that is right for nearly all may take a cell over the edge of some frames."""
    phase, empty = swimming_through(seed)
    assert max(np.abs(np.diff(phase, axis=axis)).max() for axis in (2, 3)) < 2.6
    assert wrong(phase, empty, noise, method) == 0


def test_margins_are_as_wide_as_what_goes_over_the_edge() -> None:
    lines = np.zeros((3, 1, 20), dtype=bool)
    assert ends_of(lines, np.zeros((3, 1), dtype=np.intp)) == (20, 0)
    lines[0, 0, 4:9], lines[2, 0, 11:19] = True, True
    assert ends_of(lines, np.array([[-6], [100], [3]])) == (-2, 22)
    margins = Margins(rows=(2, 3), columns=(0, 1))
    stack = np.arange(24, dtype=np.float32).reshape(1, 2, 3, 4)
    wider = margins.around(stack, np.nan)
    assert wider.shape == (1, 2, 8, 5)
    assert np.isnan(wider).sum() == wider.size - stack.size
    assert np.array_equal(margins.off(wider), stack)
    assert Margins().around(stack, 0) is stack


def cell_in_a_channel(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A thick cell flows through a channel whose walls are thicker; they reach the border."""
    y, x = np.mgrid[-24:24, -40:40] + 0.5
    walls = np.broadcast_to(8 / (1 + np.exp((13 - np.abs(y)) / 0.9)), (14, *y.shape))
    far = np.stack([(y**2 + (x + 36 - 3 * t) ** 2) / 9.5**2 for t in range(14)])
    cell = ndimage.gaussian_filter(14 * np.sqrt(np.maximum(1 - far, 0)), (0, 0.8, 0.8))
    phase = side * (walls + cell)
    return phase[:, None], np.broadcast_to((np.abs(y) < 8) & (x > 30), phase[:, None].shape)


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("noise", [0.2, 0.4])
def test_cell_that_rises_above_the_walls_of_its_channel(noise: float, side: int) -> None:
    """What nothing contradicts lies on both sides of the border's field in earnest."""
    phase, empty = cell_in_a_channel(side)
    assert wrong(phase, empty, noise, WL1) == 0


@pytest.mark.slow
def test_phase_is_as_noisy_as_light_is_faint() -> None:
    """Where light has faded, noise alone takes pixels to the other side of the empty field."""
    phase, empty = ball_over_a_bowl(0)
    x = np.linspace(0, 1, phase.shape[3])
    amplitude = np.linspace(1, 0.6, len(phase))[:, None, None, None] * (1 - 0.75 * x**2)
    amplitude = np.broadcast_to(amplitude, phase.shape).astype(np.float32)
    noise = 0.2 / amplitude
    assert wrong(phase, empty, noise, WL1, amplitude=amplitude) < 30


def turns_off_through_a_pupil(seed: int, steep: float, **scene: float) -> tuple[np.ndarray, int]:
    """Return how many turns WL1 is off where light came through, and the pixels of the objects."""
    exact, wrapped, amplitude = four_balls_through_a_pupil(seed, steep, **scene)
    assert amplitude.min() < 0.1  # vortices
    known = np.abs(np.angle(np.exp(1j * (wrapped - exact)))) < 1.3
    off = np.round((p4d.unwrap(wrapped, WL1, amplitude=amplitude).values - exact) / TURN)
    return off[known], np.count_nonzero(np.abs(exact) > 0.5)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("seed", [1, 6, 12])
def test_cell_whose_rim_the_pupil_cut_off_does_not_stay_a_turn_low(seed: int, side: int) -> None:
    """Nothing bright joins it to the empty field, and other cells say on which side it lies."""
    off, size = turns_off_through_a_pupil(seed, 1.2, side=side)
    assert np.count_nonzero(off) < 0.005 * size


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("seed", [0, 9, 11])
def test_bubble_whose_rim_the_pupil_cut_off_is_not_taken_for_a_cell(seed: int, side: int) -> None:
    """It lies on the other side with all of it."""
    off, _ = turns_off_through_a_pupil(seed, 0.9, side=side, bubble=1.6)
    assert not off.any()


def test_objects_that_come_back_lay_on_both_sides_have_dark_rims_and_do_so_whole() -> None:
    #        size, moved, right, left, pays, dark
    objects = [
        ([100, 80, 30, 2, 20, 15], True),
        ([100, 20, 15, 2, 20, 15], False),  # a part of it moves
        ([100, 80, 0, 2, 20, 15], False),  # a bubble
        ([100, 80, 30, 20, 20, 15], False),  # much is left behind
        ([100, 80, 30, 2, 20, 5], False),  # its rim is bright
        ([100, 80, 30, 2, 0, 0], False),
        ([0, 0, 0, 0, 0, 0], False),
    ]
    counts, expected = zip(*objects, strict=True)
    np.testing.assert_array_equal(came_back(*np.array(counts).T), expected)


@pytest.mark.slow
def test_objects_come_back_whatever_frames_are_looked_at_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, wrapped, amplitude = four_balls_through_a_pupil(1, 1.2)
    whole = p4d.unwrap(wrapped, WL1, amplitude=amplitude).values
    for frames in (1, 4):
        monkeypatch.setattr(given, "WORKING_FRAMES", frames)
        found = p4d.unwrap(wrapped, WL1, amplitude=amplitude).values
        np.testing.assert_array_equal(found, whole)
