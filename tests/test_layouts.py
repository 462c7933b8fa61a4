"""The finder on random layouts: right, or in doubt; views counted; signs of large cells."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import scipy.fft
import scipy.ndimage
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.holography.beams import COUNT_WEIGHTS, Choice, most_likely
from napari_phase4d.holography.finding import views_doubt
from napari_phase4d.holography.lobes import pair_distance, wrapped_distance
from napari_phase4d.holography.peaks import (
    Peak,
    brightest_near,
    brightest_places,
    is_ghost,
    refined,
)
from napari_phase4d.holography.signs import evidence_of, sign_doubts, together
from napari_phase4d.simulation import multiplexed_video, swimming_euglena

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
from layouts import Layout, layout, steep_cell

LAYOUTS = 30


@pytest.fixture(scope="module")
def found() -> list[tuple[Layout, p4d.holography.FoundLobes]]:
    cases = [layout(seed) for seed in range(LAYOUTS)]
    with warnings.catch_warnings():  # some are so hard that their number is doubted as well
        warnings.simplefilter("ignore", UserWarning)
        return [(case, p4d.find_lobes(case.rec, len(case.carriers))) for case in cases]


@pytest.mark.thorough
def test_random_layouts_are_right_or_in_doubt(found) -> None:
    wrong = [lobes for case, lobes in found if not case.found_by(lobes)]
    right = [lobes for case, lobes in found if case.found_by(lobes)]
    assert len(wrong) <= 0.05 * LAYOUTS
    assert all(lobes.doubts_of_views for lobes in wrong)
    assert sum(bool(lobes.doubts_of_views) for lobes in right) <= 0.15 * LAYOUTS


@pytest.mark.parametrize("seed", [200138, 200428, 202247])
def test_structure_of_a_strong_lobe_takes_no_part_of_it_away(seed: int) -> None:
    """Weak peaks in a view's lobe hid where it ends, and its beat was taken instead."""
    case = layout(seed)
    assert case.found_by(p4d.find_lobes(case.rec, len(case.carriers)))


@pytest.mark.parametrize("seed", [402339, 402693])
def test_objects_near_the_border_of_a_view_are_a_reason_for_doubt(seed: int) -> None:
    """A Blackman window hid them in one view, which then passed for the reference, for sure."""
    case = layout(seed)
    lobes = p4d.find_lobes(case.rec, len(case.carriers))
    assert lobes.doubts_of_views


@pytest.mark.slow
def test_a_carrier_is_found_beside_brighter_structure() -> None:
    """A large object scatters nearly all light in the middle of the frame."""
    case = layout(404251)
    assert case.found_by(p4d.find_lobes(case.rec, len(case.carriers)))


@pytest.mark.parametrize(
    ("side", "views", "peak", "cover", "off"),
    [(224, 1, 18.0, 0.51, (0, 20)), (384, 2, 22.0, 0.54, (36, -27))],
)
def test_light_round_a_steep_cell_is_found_behind_its_own_structure(
    side, views, peak, cover, off
) -> None:
    """The flanks scatter the middle of the frame away from the carrier, farther than 0.03."""
    rec, carriers = steep_cell(side, views, peak, cover=cover, power=1.5, off=off)
    lobes = p4d.find_lobes(rec, len(carriers))
    for carrier in carriers:
        assert min(pair_distance(lobe.carrier, carrier) for lobe in lobes) < 0.001
    assert not lobes.doubts_of_views


@pytest.mark.parametrize(
    ("peak", "cover", "off"), [(26.0, 0.58, (-30, 15)), (25.0, 0.53, (10, -27))]
)
def test_what_outshines_the_carrier_in_one_look_only_is_a_doubt(peak, cover, off) -> None:
    """It was taken for sure, 0.055 cycles/px beside it, by its power in the Blackman window."""
    rec, (carrier,) = steep_cell(224, 1, peak, cover=cover, power=1.5, off=off)
    lobes = p4d.find_lobes(rec, 1)
    assert pair_distance(lobes[0].carrier, carrier) < 2 / 224
    assert pair_distance(lobes.other[0].carrier, carrier) > 0.03


def test_a_slope_is_not_followed_to_zero() -> None:
    """Near the zero order the light round an object is its own peak, or not known."""
    shape = (256, 256)
    ky, kx = scipy.fft.fftfreq(256)[:, None], scipy.fft.rfftfreq(256)[None]
    power = np.exp(-((ky**2 + kx**2) / 0.012**2)) + 1e-4 * (kx == 12 / 256) * (ky == 0)
    for carrier in ((0.0, 8 / 256), (0.0, 12 / 256), (0.0, 15 / 256)):
        found = brightest_near(0, [carrier], power, shape)
        assert pair_distance(found, (0.0, 0.0)) > 0.03


def test_a_place_is_that_of_one_peak() -> None:
    """Two peaks beside the same light: it is that of the stronger one."""
    shape, power = (256, 256), np.zeros((256, 129))
    power[51, 51] = 1
    carriers = [(46 / 256, 51 / 256), (56 / 256, 51 / 256)]
    assert brightest_places(carriers, power, shape) == [(51 / 256, 51 / 256), carriers[1]]


@pytest.mark.parametrize("place", [(0.2, 0.25), (0.0, 0.3), (-0.25, 0.0), (0.25, 0.01)])
def test_the_brightest_place_near_a_carrier(place: tuple[float, float]) -> None:
    """Also across an axis and a way off, but not on the slope of another peak that is known."""
    shape = (256, 200)
    y, x = (scipy.fft.fftfreq(n) * n for n in shape)
    row, column = (round(k * n) for k, n in zip(place, shape, strict=True))

    def seen_from(down: int, across: int, width: float, *, known: bool) -> tuple[float, float]:
        power = np.zeros(shape)
        for sign in (1, -1):
            dy, dx = y[:, None] - sign * (row + down), x[None, :] - sign * (column + across)
            power += np.exp(-(dy**2 + dx**2) / width**2)
        carriers = [(row / shape[0], column / shape[1])]
        if known:
            carriers.append(((row + down) / shape[0], (column + across) / shape[1]))
        return brightest_near(0, carriers, power[:, : shape[1] // 2 + 1], shape)

    for down, across, width, known in (
        (0, 0, 1.0, False),
        (1, -1, 1.0, False),
        (4, -3, 1.0, False),
        (9, 6, 5.0, False),
        (9, 6, 5.0, True),
    ):
        found = seen_from(down, across, width, known=known)
        if known:
            down = across = 0
        there = ((row + down) / shape[0], (column + across) / shape[1])
        assert p4d.holography.pair_distance(found, there) < 1e-9


@pytest.mark.thorough
def test_doubt_comes_with_another_choice_of_as_many_views(found) -> None:
    for _, lobes in found:
        assert 0 < lobes.chance <= 1
        assert set(lobes.doubts) >= {lobe.doubt for lobe in lobes if lobe.doubt}
        if lobes.other:
            assert len(lobes.other) == len(lobes)
            assert "next best choice" in lobes.doubts_of_views[-1]


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 6])
def test_views_are_counted(n: int) -> None:
    six = ((0.42, 0.05), (0.30, 0.20), (0.12, 0.33), (-0.05, 0.42), (-0.2, 0.3), (-0.35, 0.15))
    exact = swimming_euglena((256, 256), 4, angles_deg=range(n), pixel_um=5.2 / 30)
    rec = multiplexed_video(
        exact["phase"], carriers=six[:n], pupil_radius=0.03, reference_amplitude=3.0
    )
    assert len(p4d.find_lobes(rec, None)) == n


def test_the_number_counts_all_choices_of_so_many_views() -> None:
    """The likeliest two of three peaks may explain less than the next likeliest two."""

    def choice(views: tuple[int, ...], score: float) -> Choice:
        tally = score * COUNT_WEIGHTS / (COUNT_WEIGHTS @ COUNT_WEIGHTS)
        return Choice(views, tuple(False for _ in views), 0.5, True, tally)

    found = [[choice((0,), 3.0)], [choice((0, 1), 0.0), choice((0, 2), 5.0)]]
    likely, chances = most_likely(found, [[True], [True, True]])
    assert likely == 2
    assert chances == pytest.approx(np.array([0.119, 0.881]), abs=1e-3)
    assert most_likely(found, [[True], [True, False]])[0] == 1


@pytest.mark.parametrize(("off", "ghost"), [(0.3, True), (1.5, False)])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_ghost_lies_within_half_a_pixel_along_either_side(
    axis: int, off: float, ghost: bool
) -> None:
    """Of long frames too, the pixels of whose spectrum are not square."""
    shape, at = (128, 1024), (0.1, 0.2)
    place = [at[0] + 0.5, at[1]]  # as interlaced video copies it
    place[axis] += off / shape[axis]
    source, peak = Peak(at, 1.0), Peak((place[0], place[1]), 0.2)
    assert is_ghost(peak, peak.carrier, at, source, shape) == ghost


def saturated(
    gain: float, carriers: list[tuple[float, float]], amplitudes: tuple[float, ...]
) -> p4d.Recording:
    """Return the video of a camera whose brightest pixels are cut off."""
    exact = swimming_euglena((256, 256), 3, pixel_um=5.2 / 30, peak_rad=6)["phase"]
    rec = multiplexed_video(
        exact.isel(angle=slice(len(carriers))),
        carriers=carriers,
        pupil_radius=0.05,
        beam_amplitudes=amplitudes,
        reference_amplitude=2.5,
    )
    frames = np.stack([rec.frame(i) for i in range(3)]).astype(float)
    frames = np.clip(gain * frames, 0, np.percentile(frames, 99.9))
    return p4d.open_recording((250 * frames / frames.max()).astype(np.uint8))


def test_views_that_can_not_be_are_refused_not_replaced_by_unlikely_ones() -> None:
    with pytest.raises(ValueError, match="ask for 1 view"):
        p4d.find_lobes(saturated(1.3, [(-0.204, 0.242)], (1.0,)), 3)


def test_a_view_near_a_harmonic_is_doubted() -> None:
    """An object spreads the harmonic: its brightest pixel lies 2.7 from twice the carrier."""
    rec = saturated(1.4, [(-0.204, 0.242), (-0.232, 0.166)], (1.0, 0.06))
    lobes = p4d.find_lobes(rec)
    near = [k for k in (lobe.carrier for lobe in lobes) if np.hypot(*k) > 0.5]
    assert near, "not what is tested any more: the harmonic is not taken for a view"
    assert any("saturated" in doubt for doubt in lobes.doubts)


@pytest.mark.slow
def test_another_number_of_views_than_asked_for_is_said() -> None:
    exact = swimming_euglena((256, 256), 4, pixel_um=5.2 / 30, peak_rad=6)
    rec = multiplexed_video(exact["phase"])
    assert p4d.find_lobes(rec, 2).doubts == ()
    assert "the spectrum looks like 2 views" in p4d.find_lobes(rec, 1).doubts[0]
    with pytest.warns(UserWarning, match="the spectrum looks like 2 views"):
        found = p4d.find_lobes(rec, 3)
    assert "the spectrum looks like 2 views" in found.doubts[0]


@pytest.mark.slow
@pytest.mark.parametrize("cover", [0.1, 0.5, 0.75, 0.85])
@pytest.mark.parametrize("side", [-1, 1])
def test_the_sign_of_a_large_cell_is_right(cover: float, side: int) -> None:
    """A carrier with kx < 0 is found as its conjugate, so that it must be flipped."""
    y, x = np.mgrid[:256, :256] / 256 - 0.5
    inside = 1 - ((y - 0.02) ** 2 + x**2) * np.pi / cover
    phase = xr.DataArray(
        np.float32(12 * np.sqrt(np.maximum(inside, 0)))[None, None],
        dims=("time", "angle", "y", "x"),
        coords={"time": [0.0], "angle": [0.0]},
    )
    (lobe,) = p4d.find_lobes(multiplexed_video(phase, carriers=[(0.2, 0.2 * side)]), 1)
    assert lobe.flip == (side < 0)


@pytest.mark.slow
def test_signs_of_all_views_go_together() -> None:
    """One view shows little of the object; the beat tells that it lies on the other one's side."""
    exact = swimming_euglena((256, 256), 3, pixel_um=5.2 / 30, peak_rad=6)["phase"].copy()
    exact[:, 1] *= 0.3
    for carriers in (((0.19, 0.21), (-0.21, 0.19)), ((0.19, 0.21), (0.21, -0.19))):
        rec = multiplexed_video(exact, carriers=carriers, reference_amplitude=2.5)
        first, second = p4d.find_lobes(rec, 2)
        assert (first.flip, second.flip) == (False, carriers[1][1] < 0)


def test_carriers_are_refined_from_spectra_as_from_the_frame() -> None:
    """The transform of a pure carrier between pixels has its maximum at the carrier."""
    rng = np.random.default_rng(3)
    shape = (96, 120)
    y, x = (np.arange(n) for n in shape)
    window = np.outer(*(np.blackman(n + 2)[1:-1] for n in shape))
    for _ in range(10):
        ky, kx = rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.3)
        frame = np.cos(2 * np.pi * (ky * y[:, None] + kx * x[None, :]) + rng.uniform(0, 6))
        spectrum = scipy.fft.rfft2((frame * window).astype(np.float32))
        coarse = (round(ky * shape[0]) / shape[0], round(kx * shape[1]) / shape[1])
        near = refined(coarse, [spectrum], shape)
        assert np.hypot((near[0] - ky) * shape[0], (near[1] - kx) * shape[1]) < 0.02


@pytest.mark.parametrize("peak", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("side", [1, -1])
def test_a_small_cell_tells_the_sign_and_an_empty_field_does_not(side: int, peak: float) -> None:
    """A cell of 0.6 % of the field hardly adds to how far all of it deviates."""
    y, x = np.mgrid[:256, :256]
    phase = peak * np.sqrt(np.maximum(1 - ((y - 90) ** 2 + (x - 150) ** 2) / 11.0**2, 0))
    exact = xr.DataArray(
        phase[None, None].astype(np.float32),
        dims=("time", "angle", "y", "x"),
        coords={"time": [0.0], "angle": [0.0]},
    )
    (lobe,) = p4d.find_lobes(multiplexed_video(exact, carriers=[(0.19 * side, 0.21 * side)]), 1)
    if peak:
        assert lobe.flip == (side < 0)
    else:
        assert "No object is seen" in lobe.doubt


def test_a_cell_that_is_away_half_way_tells_the_sign_as_well() -> None:
    y, x = np.mgrid[:256, :256]
    cell = 5 * np.sqrt(np.maximum(1 - ((y - 120) ** 2 + (x - 140) ** 2) / 45.0**2, 0))
    frames = np.zeros((9, 1, 256, 256), np.float32)
    frames[:3] = cell
    exact = xr.DataArray(
        frames,
        dims=("time", "angle", "y", "x"),
        coords={"time": np.arange(9.0), "angle": [0.0]},
    )
    (lobe,) = p4d.find_lobes(multiplexed_video(exact, carriers=[(-0.19, -0.21)]), 1)
    assert lobe.flip
    assert not lobe.doubt


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kx", "radius", "peak", "at"),
    [
        (0.0, 0.19, 3.8, (0.53, 0.62)),
        (0.003, 0.33, 4.2, (0.51, 0.42)),
        (0.0016, 0.19, 3.9, (0.67, 0.62)),
    ],
)
def test_a_carrier_next_to_the_axis_gets_the_side_of_its_beats(
    kx: float, radius: float, peak: float, at: tuple[float, float]
) -> None:
    """Its peak may lie on one side, the light that nothing scattered on the other."""
    side = 256
    y, x = np.mgrid[:side, :side]
    away = (y - at[0] * side) ** 2 + (x - at[1] * side) ** 2
    cell = peak * np.sqrt(np.maximum(1 - away / (radius * side) ** 2, 0))
    exact = xr.DataArray(
        np.stack([cell, cell])[None].astype(np.float32),
        dims=("time", "angle", "y", "x"),
        coords={"time": [0.0], "angle": [0.0, 1.0]},
    )
    carriers = [(-0.36, kx), (-0.12, 0.3)]
    rec = multiplexed_video(exact, carriers=carriers, pupil_radius=0.06, seed=0)
    for lobe in p4d.find_lobes(rec, 2):
        near = min(carriers, key=lambda k: pair_distance(lobe.carrier, k))
        assert lobe.flip == (wrapped_distance(lobe.carrier, near) > 0.05)


def test_the_sign_in_a_field_too_small_to_ask_is_a_guess() -> None:
    assert sign_doubts([evidence_of(np.ones((4, 9), np.complex64))]) != [""]


@pytest.mark.parametrize("side", range(4, 41, 4))
def test_tiny_frames_are_answered_or_refused_in_words(side: int) -> None:
    """A lobe of a low frame may be only a few pixels high: too few for a border and more."""
    y, x = np.mgrid[:side, :64]
    phase = 2 * np.exp(-(((y - side / 2) / 2) ** 2) - ((x - 32) / 9) ** 2)
    frames = 100 + 50 * np.cos(2 * np.pi * (0.25 * y + 0.2 * x) + phase)
    for frame in (frames, frames.T, frames[:, :side]):
        try:
            rec = p4d.open_recording(frame[None].astype(np.uint8))
            words = f"{len(p4d.find_lobes(rec, 1, radius=0.08))} lobe"
        except ValueError as error:
            words = str(error)
        assert any(w in words for w in ("1 lobe", "at least 8 x 8", "shows 0 carriers"))


def bumpy(places: list[tuple[float, float]]) -> np.ndarray:
    """Cells of 4 rad at these places of a field of 96 x 112 pixels."""
    y, x = np.mgrid[:96, :112] + 0.5
    far = [((y - cy) ** 2 + (x - cx) ** 2) / 9**2 for cy, cx in places]
    cells = sum(4 * np.sqrt(np.maximum(1 - each, 0)) for each in far)
    return scipy.ndimage.gaussian_filter(cells, 1.2)


def walls(rad: float, wide: float) -> np.ndarray:
    """A channel across a field of 96 x 112 pixels, its walls so much denser."""
    y = np.arange(96)[:, None] + 0.5
    line = rad * (1 / (1 + np.exp(y - wide)) + 1 / (1 + np.exp(96 - wide - y)))
    return np.repeat(line, 112, axis=1)


LAYER = [(y, x) for y in range(11, 100, 17) for x in range(11, 115, 17)]
DENSE_ROUND_THE_MIDDLE = {
    "walls of 1.5 rad": walls(1.5, 25),
    "walls of 3.5 rad": walls(3.5, 15),
    "wide walls of 6 rad": walls(6, 25),
    "wound": bumpy([at for at in LAYER if np.hypot(at[0] - 48, at[1] - 56) > 25]),
}


@pytest.mark.parametrize("phase", DENSE_ROUND_THE_MIDDLE.values(), ids=DENSE_ROUND_THE_MIDDLE)
@pytest.mark.parametrize("side", [1, -1])
def test_dense_matter_round_an_empty_middle_has_a_sign_that_is_a_guess(
    phase: np.ndarray, side: int
) -> None:
    """Nothing tells it from a thin strip or a hole in something dense, in any number of views."""
    field = np.exp(1j * side * phase).astype(np.complex64)
    evidence = evidence_of(field)
    assert sign_doubts([together([evidence])] * 2) != ["", ""]
    assert sign_doubts([together([evidence, evidence, evidence])]) != [""]


def test_guesses_of_several_views_are_no_certainty() -> None:
    assert together([2.0, 1.9]) == pytest.approx(2.5)
    assert together([-2.0, -2.4, 0.3]) == pytest.approx(-2.5)
    assert together([4.0, -1.0]) == 3.0


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("at", [(48, 56), (6, 56), (90, 105), (48, 3)])
def test_a_cell_at_the_border_has_a_sign_that_is_sure(at: tuple[int, int], side: int) -> None:
    y, x = np.mgrid[:96, :112] + 0.5
    far = ((y - at[0]) ** 2 + (x - at[1]) ** 2) / 22**2
    cell = scipy.ndimage.gaussian_filter(7 * np.sqrt(np.maximum(1 - far, 0)), 1.5)
    evidence = evidence_of(np.exp(1j * side * cell).astype(np.complex64))
    assert sign_doubts([evidence]) == [""]
    assert np.sign(evidence) == side


def test_another_choice_in_the_same_circle_has_a_place() -> None:
    """Of choices that differ by less than a lobe is wide, the view that differs most is named."""
    best, second = (
        Choice((0, 1), (False, False), chance, beats_seen=True, tally=np.zeros(2))
        for chance in (0.8, 0.2)
    )
    lobes = [p4d.Lobe((0.2, 0.1), 0.08), p4d.Lobe((-0.1, 0.25), 0.08)]
    near = [lobes[0], p4d.Lobe((-0.12, 0.25), 0.08)]
    assert "has a view at (-0.120, +0.250) cycles/px instead" in views_doubt(
        best, second, lobes, near
    )
    far = [lobes[0], p4d.Lobe((0.3, 0.3), 0.08)]
    assert "at (+0.300, +0.300) cycles" in views_doubt(best, second, lobes, far)
