"""Views of several wavelengths, of which some say nothing in a frame: what becomes of the others.

NaN or pure noise at one wavelength must never choose the turns of another one.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.analysis.confidence import chances_of_right
from napari_phase4d.pipeline.stored import Shelf, stored_at
from napari_phase4d.pipeline.streaming import ProblemOnDisk
from napari_phase4d.simulation import at_wavelengths, step_phantom, swimming_euglena, with_noise
from napari_phase4d.stack import Block
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping.light import ladder_of
from napari_phase4d.unwrapping.problem import Problem
from napari_phase4d.unwrapping.running import run_method

METHOD = "synthetic-wavelength"
TWO, THREE = (0.532, 0.6328), (0.532, 0.561, 0.6328)
BEATS = ["spatial", "temporal-angular", "directional-l1", "wrapped"]
KINDS = ["nan", "noise"]


def plates(lights: tuple[float, ...]) -> xr.Dataset:
    """Return plates that no wavelength tells by itself, from two angles at three times."""
    exact = step_phantom((64, 96), (0.4, 0.9, 1.4), 3, angles_deg=(-7.0, 21.0))
    return with_noise(at_wavelengths(exact, lights), 0.1, seed=1)


def without(wrapped: xr.DataArray, frames: object, kind: str) -> xr.DataArray:
    """Return phase of which some frames say nothing."""
    values = wrapped.values.copy()
    shape = values[frames].shape
    noise = np.random.default_rng(0).uniform(-np.pi, np.pi, shape)
    values[frames] = np.nan if kind == "nan" else noise
    return wrapped.copy(data=values)


def wrong(found: xr.DataArray, exact: xr.DataArray) -> np.ndarray:
    """Mark the pixels that are wrong by a turn or more."""
    return np.asarray(np.abs(found.values - exact.values) > np.pi)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("beat", BEATS)
def test_what_has_lost_its_partner_is_not_trusted(kind: str, beat: str) -> None:
    """The frame of 532 nm whose 633 nm says nothing; all others are as right as ever."""
    data = plates(TWO)
    wrapped = without(data["wrapped"], (1, 1), kind)
    found = p4d.compare(wrapped, [METHOD], options={METHOD: {"beat": beat}})
    trust = found.confidence(METHOD).values
    off = wrong(found.results[METHOD], data["phase"])
    assert found.verdict.lost_frames == [(1, 1)]
    assert (trust[1, 0] == 0).all()
    left = np.ones(trust.shape[:2], dtype=bool)
    left[1, :2] = False
    assert off[left].mean() < 0.001
    assert trust[left].mean() > 0.99
    assert found.verdict.doubtful_percent > 5


@pytest.mark.parametrize("kind", KINDS)
def test_what_has_lost_its_partner_is_unwrapped_by_itself(kind: str) -> None:
    data = plates(TWO)
    wrapped = without(data["wrapped"], (1, 1), kind)
    found = p4d.unwrap(wrapped, METHOD).values[1, 0]
    alone = p4d.unwrap(data["wrapped"].isel(time=[1], angle=[0]), "spatial-2d").values[0, 0]
    np.testing.assert_allclose(found, alone, atol=1e-4)
    cell = at_wavelengths(swimming_euglena((64, 80), 3, peak_rad=12, pixel_um=0.45), TWO)
    smooth = p4d.unwrap(without(cell["wrapped"], (1, 1), kind), METHOD)
    assert not wrong(smooth, cell["phase"])[:, 0].any()
    assert np.isnan(smooth.values[1, 1]).all() == (kind == "nan")


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("beat", BEATS[:3])
def test_of_three_wavelengths_two_are_enough(kind: str, beat: str) -> None:
    """As right, and as much trusted, as if there had never been a third."""
    data = plates(THREE)
    for lost in (0, 1, 2):
        wrapped = without(data["wrapped"], (1, lost), kind)
        found = p4d.compare(wrapped, [METHOD], options={METHOD: {"beat": beat}})
        off = wrong(found.results[METHOD], data["phase"])
        trust = found.confidence(METHOD).values
        left = np.ones(off.shape[:2], dtype=bool)
        left[1, lost] = False
        assert off[left].mean() < 0.001
        assert trust[left].mean() > 0.99
        assert (trust[1, lost] == 0).all()
        if kind == "noise":  # the path is known, and what noise there is lies about it
            assert off[1, lost].mean() < 0.1


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*nothing but noise:UserWarning")
@pytest.mark.parametrize("beat", BEATS)
def test_a_wavelength_that_is_lost_everywhere_leaves_the_other(beat: str) -> None:
    """There is no beat in any frame; each is unwrapped by itself, and nothing is trusted."""
    data = plates(TWO)
    wrapped = without(data["wrapped"], np.s_[:, 1::2], "noise")
    found = p4d.compare(wrapped, [METHOD], options={METHOD: {"beat": beat}})
    assert (found.confidence(METHOD).values == 0).all()
    assert not found.verdict.is_safe
    if beat != "wrapped":
        alone = p4d.unwrap(data["wrapped"].isel(angle=[0, 2]), "spatial-2d").values
        np.testing.assert_allclose(found.results[METHOD].values[:, ::2], alone, atol=1e-4)


@pytest.mark.parametrize("mask", [None, "auto"])
@pytest.mark.parametrize("method", [METHOD, "spatial-2d"])
def test_a_wavelength_that_is_known_nowhere_is_named(method: str, mask: str | None) -> None:
    data = plates(TWO)
    wrapped = without(data["wrapped"], np.s_[:, 1::2], "nan")
    with pytest.raises(
        ValueError, match=r"of the phase at 0\.6328 um is known and in the mask; leave"
    ):
        p4d.unwrap(wrapped, method, mask=mask)


@pytest.mark.slow
@pytest.mark.parametrize("storage", ["memory", "disk"])
def test_it_is_named_wherever_results_lie(storage: str, tmp_path: Path) -> None:
    data = plates(TWO)
    path = tmp_path / "phase.ome.zarr"
    p4d.write_phase(path, without(data["wrapped"], np.s_[:, 1::2], "nan"))
    recipe = p4d.Recipe(recording=str(path), methods=("spatial-2d",), storage=storage)
    with pytest.raises(ValueError, match=r"nothing of the phase at 0\.6328 um is known"):
        p4d.run(recipe, folder=tmp_path / "out")


@pytest.mark.slow
def test_other_methods_are_not_judged_by_a_partner_that_says_nothing() -> None:
    data = plates(TWO)
    wrapped = without(data["wrapped"], (1, 1), "noise")
    found = p4d.compare(wrapped, ["directional-l1", "spatial-2d"])
    for method in found.results:
        assert (found.confidence(method).values[1, :2] == 0).all(), method
        assert found.confidence(method).values[1, 2:].mean() > 0.5, method


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("beat", BEATS[:3])
@pytest.mark.parametrize("lights", [TWO, THREE])
def test_on_disk_the_same_is_lost(
    tmp_path: Path, kind: str, beat: str, lights: tuple[float, ...]
) -> None:
    exact = step_phantom((48, 64), (0.4, 0.9), 11, angles_deg=(-7.0, 21.0))
    data = with_noise(at_wavelengths(exact, lights), 0.1, seed=1)
    wrapped = without(data["wrapped"], np.s_[7:10, 1], kind)
    known = np.isfinite(wrapped.values)
    memory = Problem(wrapped, (0, 0), None if known.all() else known)
    shelf = Shelf(tmp_path / "shelf")
    phase = shelf.take("wrapped", memory.template.copy(data=wrapped.values))
    stored = stored_at(phase)
    assert stored is not None
    disk = ProblemOnDisk(phase, stored, shelf, (0, 0), finds_mask=False)
    results, trust = [], []
    for problem in (memory, disk):
        result = run_method(problem, METHOD, UNWATCHED, {"beat": beat})
        chance = chances_of_right(problem, {METHOD: result}, result)[METHOD]
        results.append(result.values)
        trust.append(chance.read(Block(0, len(wrapped))))
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(trust[0], trust[1])


def test_the_ladder_of_one_wavelength_is_that_wavelength() -> None:
    (only,) = ladder_of((0.532,))
    assert (only.wavelength_um, only.weights) == (0.532, (1.0,))


# ---- views in another order ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("order", "said"),
    [
        ([1, 0, 3, 2], r"wavelengths of phase do not rise at the angle -7 \(0\.6328 um, then"),
        ([0, 1, 3, 2], r"wavelengths of phase do not rise at the angle 21 \(0\.6328 um, then"),
        ([3, 1, 2, 0], r"the angle coordinates of phase do not rise \(21, -7, 21, \.\.\.\)"),
    ],
)
def test_views_out_of_order_are_told_how_to_be_sorted(order: list[int], said: str) -> None:
    """What the sentence advises is what helps."""
    wrapped = plates(TWO)["wrapped"].isel(time=[0])
    other = wrapped.isel(angle=order)
    with pytest.raises(ValueError, match=said + r".*sortby\(\['angle', 'wavelength'\]\)"):
        p4d.unwrap(other, METHOD)
    xr.testing.assert_equal(other.sortby(["angle", "wavelength"]), wrapped)
