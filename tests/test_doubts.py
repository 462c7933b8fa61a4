"""Wrapped phase in other units, cut out or filtered is said to be so, and no result is safe."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import napari_phase4d as p4d
from helpers import measured, wrap
from napari_phase4d.stacks.numbers import Doubt, what_is_wrong

Stack = NDArray[np.float64]

#: What users give in place of radians, and what is said of it.
UNITS: dict[str, tuple[Callable[[Stack], Stack], str]] = {
    "parts of pi": (lambda w: w / np.pi, "multiply it by 3.14"),
    "grey from 0 to 1 less a little": (lambda w: (w + np.pi) / 7, "multiply it by 7"),
    "path in micrometres": (lambda w: w / (2 * np.pi) * 0.633, "multiply it by 9.9"),
    "the wrong wavelength": (lambda w: 1.1 * w, "multiply it by 0.909"),
    "degrees": (np.rad2deg, "as degrees do"),
    "turns": (lambda w: w / (2 * np.pi), "as turns do"),
    "from arctan": (lambda w: np.arctan(np.tan(w)), "half a turn"),
    "half of it": (lambda w: w / 2, "half a turn"),
}


def exact_of(name: str) -> Stack:
    """Return the phase of an object, thick enough to wrap."""
    if name == "euglena":
        sample = p4d.simulation.swimming_euglena((96, 128), 3, peak_rad=20)
    elif name == "yeast":
        sample = p4d.simulation.budding_yeast(n_times=3)
    else:
        sample = p4d.simulation.moving_shape(name, (80, 80), 3, angles_deg=(0.0, 6.0))
    values: Stack = sample["phase"].values.astype(np.float64)
    return values


def noisy(exact: Stack, noise: float) -> Stack:
    """Return wrapped phase with noise of so many radians."""
    added = noise * np.random.default_rng(3).standard_normal(exact.shape)
    return wrap(exact + added).astype(np.float64)


def looks(phase: Stack) -> list[Doubt]:
    """Return what is probably wrong with numbers."""
    return list(what_is_wrong(phase.ravel(), phase.shape[-1]))


def said_of(phase: Stack) -> list[str]:
    """Return what is said of wrapped phase before it is unwrapped."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        known = np.isfinite(phase)
        p4d.unwrap(phase, "spatial-2d", mask=None if known.all() else known)
    return [str(each.message) for each in heard if issubclass(each.category, UserWarning)]


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("name", ["euglena", "yeast", "swelling"])
@pytest.mark.parametrize("unit", UNITS)
def test_other_units_are_told_by_the_heights_of_jumps(unit: str, name: str, noise: float) -> None:
    change, expected = UNITS[unit]
    phase = noisy(exact_of(name), noise)
    found = looks(change(phase))
    assert len(found) == 1
    assert expected in found[0].warning
    assert found[0].verdict
    assert not looks(phase)
    assert not looks(phase + np.pi)


def test_what_they_are_to_be_multiplied_by_is_right() -> None:
    exact = exact_of("euglena")
    phase = noisy(exact, 0.1)
    (said,) = said_of(phase / (2 * np.pi) * 0.633)
    factor = float(said.rsplit(" ", 1)[1])
    right = p4d.unwrap(phase / (2 * np.pi) * 0.633 * factor, "directional-l1").values
    turns = np.round((right - exact) / (2 * np.pi))
    assert np.mean(turns != np.median(turns)) < 1e-3


def cut_out(exact: Stack, phase: Stack, smaller: int) -> Stack:
    """Set the field to 0, and a rim of the object so many pixels wide as well."""
    inside = np.abs(exact) > 0.6
    for _ in range(abs(smaller)):
        grown = ndimage.binary_erosion if smaller > 0 else ndimage.binary_dilation
        inside = grown(inside, np.ones((1, 1, 3, 3), dtype=bool))
    return np.where(inside, phase, 0)


@pytest.mark.parametrize("noise", [0.05, 0.2, 0.4])
@pytest.mark.parametrize("name", ["euglena", "swelling", "tumbling", "bending"])
def test_a_cell_cut_out_without_its_rim_is_said(name: str, noise: float) -> None:
    """All of it was off by turns, and confidence sure of it."""
    exact = exact_of(name)
    phase = noisy(exact, noise)
    for smaller in (1, 2, 3):
        (said,) = said_of(cut_out(exact, phase, smaller))
        assert "is just 0 on" in said
    # With some of the field round it nothing is lost.
    assert not said_of(cut_out(exact, phase, -3))


@pytest.mark.slow
def test_the_verdict_calls_no_result_safe_of_what_was_cut_out() -> None:
    exact = exact_of("swelling")
    phase = cut_out(exact, noisy(exact, 0.1), 2)
    methods = ["directional-l1", "spatial-2d"]
    with pytest.warns(UserWarning, match="is just 0 on"):
        verdict = p4d.compare(phase, methods).verdict
    assert verdict.startswith("No result is safe: the wrapped phase is just 0 on")
    assert not verdict.is_safe
    assert verdict.doubts
    assert verdict.blurred_percent == 0
    whole = p4d.compare(noisy(exact, 0.1), methods).verdict
    assert whole.is_safe
    assert whole.doubts == []


def test_dead_columns_are_said() -> None:
    """Beside four of them, 40 % of a cell was wrong."""
    phase = noisy(exact_of("euglena"), 0.1)
    phase[..., 62:66] = 0
    (said,) = said_of(phase)
    assert "is just 0 on 3.1 % of its pixels" in said
    phase[..., 62:66] = np.nan
    assert not said_of(phase)


@pytest.mark.parametrize(
    ("name", "side"), [("euglena", 3), ("swelling", 3), ("swelling", 5), ("tumbling", 3)]
)
def test_a_median_filter_is_said(name: str, side: int) -> None:
    phase = noisy(exact_of(name), 0.1)
    found = [doubt.warning for doubt in looks(median_of(phase, side))]
    assert len(found) == 1
    assert "median filter" in found[0] or "takes several pixels" in found[0]
    # As is advised.
    phasors = median_of(np.cos(phase), side) + 1j * median_of(np.sin(phase), side)
    assert not looks(np.angle(phasors))


def median_of(stack: Stack, side: int) -> Stack:
    """Return the median of so many pixels along y and x."""
    found: Stack = ndimage.median_filter(stack, (1, 1, side, side))
    return found


@pytest.mark.parametrize("bits", [4, 8, 10, 12, 16])
def test_steps_of_grey_and_doubled_pixels_are_nothing_of_the_kind(bits: int) -> None:
    phase = noisy(exact_of("euglena"), 0.1)
    steps = np.round(phase / np.pi * (2 ** (bits - 1) - 1)) / (2 ** (bits - 1) - 1) * np.pi
    assert not looks(steps)
    assert not looks(phase.repeat(2, 2).repeat(2, 3))


def test_phase_that_is_the_same_everywhere_shows_nothing() -> None:
    flat = np.full((3, 2, 40, 40), 1.3)
    verdict = p4d.compare(flat, ["spatial-2d", "temporal"]).verdict
    assert verdict.startswith("No result is safe: the wrapped phase is 1.3 everywhere")


def test_wavelengths_in_nanometres_are_doubted() -> None:
    plates = p4d.simulation.step_phantom((40, 60), (0.25, 0.6), 2)
    phase = p4d.simulation.at_wavelengths(plates, (0.532, 0.633))["wrapped"]
    light = phase["wavelength"] * 1000
    assert not said_of(phase)
    (said,) = said_of(phase.assign_coords(wavelength=light.assign_attrs(units="")))
    assert "532" in said
    assert "if they are in nanometres, divide them by 1000" in said
    assert not said_of(phase.assign_coords(wavelength=light.assign_attrs(units="nm")))


def overexposed(gain: float) -> p4d.Recording:
    """Holograms of 8 bits with so many times the light."""
    exact = p4d.simulation.swimming_euglena((256, 256), 2)
    rec = p4d.simulation.multiplexed_video(exact["phase"])
    frames = rec.holograms.values.astype(np.float64)
    grey = np.clip(np.round(frames / frames.max() * 255 * gain), 0, 255).astype(np.uint8)
    return p4d.open_recording(grey, optics=rec.optics)


@pytest.mark.slow
def test_overexposed_holograms_are_said_to_be_so() -> None:
    """At three and a half times the light one of two views came out with the wrong sign."""
    rec = overexposed(3.5)
    with pytest.warns(UserWarning, match=r"\d\d % of a frame is saturated"):
        lobes = p4d.find_lobes(rec, 2)
    assert any("saturated, which clips the fringes" in doubt for doubt in lobes.doubts)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = p4d.find_lobes(overexposed(1.0), 2)
    assert not any("clips" in doubt for doubt in found.doubts)


@pytest.mark.slow
def test_a_run_says_what_is_in_doubt_about_the_lobes_it_finds() -> None:
    rec = overexposed(3.5)
    recipe = p4d.Recipe(methods=("spatial-2d",), n_views=2)
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        outcome = p4d.run(recipe, rec)
    with pytest.warns(UserWarning, match="saturated"):
        doubts = p4d.find_lobes(rec, 2).doubts
    said = [str(each.message) for each in heard]
    assert all(any(doubt in words for words in said) for doubt in doubts)
    # Of lobes that were chosen nothing is said.
    with warnings.catch_warnings(record=True) as heard_then:
        warnings.simplefilter("always")
        p4d.run(recipe.changed(lobes=outcome.recipe.lobes), rec)
    assert not any("saturated" in str(each.message) for each in heard_then)


@pytest.mark.thorough
def test_thin_and_thick_objects_at_any_level_are_hardly_ever_doubted() -> None:
    rng = np.random.default_rng(5)
    shapes = ["swelling", "tumbling", "bending", "dividing", "translating"]
    scenes = [exact_of(name) for name in (*shapes, "euglena", "yeast")]
    scenes += [p4d.simulation.hard_shape(s)["phase"].values for s in p4d.simulation.HARD_SHAPES]
    doubts = []
    for exact in scenes:
        for scale in (0.05, 0.1, 0.2, 0.3, 0.5, 1.0):
            for level in (-2.0, -1.0, 0.0, 1.0, 2.0):
                for noise in (0.0, 0.02, 0.1, 0.4, 0.7):
                    added = noise * rng.standard_normal(exact.shape)
                    phase = wrap(scale * exact + level + added)
                    doubts.append(len(looks(phase)))
    assert len(doubts) > 3000
    assert np.mean(doubts) < 0.004


def test_measured_phase_whose_holes_were_set_to_zero_is_told_from_the_same_with_holes() -> None:
    with np.load(measured("unwrap/pyrate_cropA_shared.npz"), allow_pickle=False) as arrays:
        phase, valid = arrays["wrapped"].astype(np.float64)[:, None], arrays["valid"][:, None]
    assert not said_of(np.where(valid, phase, np.nan))
    (said,) = said_of(np.where(valid, phase, 0))
    assert "is just 0 on" in said
