"""Sheets whole turns above the empty field, which look like it: other methods are judged right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d import io
from napari_phase4d.analysis import slipped_frames
from napari_phase4d.simulation import at_wavelengths
from napari_phase4d.stack import Block, InMemory
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import PLATEAUS, Judged, Problem, shown_field
from napari_phase4d.unwrapping.plateaus import plateaus_of

TURN = 2 * np.pi
TIMES, HEIGHT, WIDTH = 20, 56, 64
#: Methods that let such a sheet slip in noise, and the one that does not.
METHODS = ("temporal", "temporal-angular", "angular", "directional-l1")


def sheet(height: float, width: float = 0.8) -> xr.DataArray:
    """Return the phase of a round sheet that grows until it covers nearly all of the view."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    frames = np.empty((TIMES, 2, HEIGHT, WIDTH), dtype=np.float32)
    for t, view in np.ndindex(TIMES, 2):
        away = np.hypot(y - 22, x - 27 - 3 * view)
        frames[t, view] = height / (1 + np.exp((away - 6 - 1.8 * t) / width))
    return xr.DataArray(frames, dims=("time", "angle", "y", "x"))


def noisy(truth: xr.DataArray, noise: float, seed: int = 0) -> tuple[xr.DataArray, xr.DataArray]:
    """Return wrapped phase with noise, and the phase that it has whole turns taken off."""
    more = noise * np.random.default_rng(seed).standard_normal(truth.shape)
    whole = (truth + more).astype(np.float32)
    wrapped = np.angle(np.exp(1j * whole)).astype(np.float32)
    return whole.copy(data=wrapped), whole


def wrong_pixels(unwrapped: xr.DataArray, whole: xr.DataArray, truth: xr.DataArray) -> np.ndarray:
    """Mark the pixels that are off by other turns than the field of their frame, if it has one."""
    off = np.round((unwrapped.values - whole.values) / TURN)
    field = truth.values < 0.3
    for frame in np.ndindex(TIMES, 2):
        if field[frame].sum() > 12:  # fewer are no field that could be seen
            off[frame] -= np.median(off[frame][field[frame]])
    return off != 0


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width", "noise"), [(6.3, 0.8, 0.5), (12.6, 1.4, 0.6)])
def test_a_sheet_a_turn_or_two_high_is_no_field(height: float, width: float, noise: float) -> None:
    truth = sheet(height, width)
    wrapped, whole = noisy(truth, noise)
    compared = p4d.compare(wrapped, list(METHODS))
    inside = truth.values > 0.3
    slipped = 0
    for method, trust in compared.confidences().items():
        off = wrong_pixels(compared.results[method], whole, truth)
        wrong, chance = off[inside], 1 - trust.values[inside]
        sheet_off = np.array(
            [[off[t, a][truth[t, a] > 3].mean() for a in range(2)] for t in range(TIMES)]
        )
        if method == "directional-l1":
            assert wrong.mean() < 1e-3
            assert np.median(chance) < 0.01
        else:
            slipped += int((sheet_off > 0.6).any())
        assert wrong[chance < 0.01].mean() < 0.001
        assert (~wrong[chance > 0.9]).sum() <= 0.01 * wrong.size
        assert slipped_frames(compared.problem, trust)[sheet_off > 0.6].all()
    assert slipped >= 2  # or there was nothing to see
    assert compared.verdict.method == "directional-l1"


@pytest.mark.slow
def test_the_field_that_is_shown_has_no_sheet() -> None:
    truth = sheet(6.3)
    wrapped, _ = noisy(truth, 0.2)
    compared = p4d.compare(wrapped, ["spatial-2d"])
    problem = compared.problem
    every = Block(0, TIMES)
    high = truth.values > 5.8
    before = problem.background().empty.read(every)
    assert (before & high).sum() > 0.5 * high.sum()
    compared.confidences()
    after = shown_field(problem, UNWATCHED).read(every)
    assert not (after & high).any()
    np.testing.assert_array_equal(after & (truth.values < 0.1), before & (truth.values < 0.1))


def test_a_sheet_is_part_of_the_object() -> None:
    truth = sheet(6.3)
    wrapped, _ = noisy(truth, 0.2)
    high = truth.values > 3
    compared = p4d.compare(wrapped, ["directional-l1"])
    inside = compared.object_mask().values
    assert inside[high].all()
    assert inside[truth.values < 0.01].mean() < 0.03
    phase = compared.results["directional-l1"].values
    assert phase[inside].sum() == pytest.approx(truth.values.sum(), rel=0.01)


def test_cells_leave_the_field_as_it_is() -> None:
    sample = p4d.simulation.swimming_euglena((48, 64), 6, peak_rad=14)
    problem = Problem(sample["wrapped"])
    exact = Judged(InMemory(np.ascontiguousarray(sample["phase"].values)))
    assert plateaus_of(problem, exact, UNWATCHED) == {}


@pytest.mark.parametrize(("corner", "covers"), [(900, True), (60, False)])
def test_a_frame_all_of_which_slipped_has_its_field_still(corner: int, covers: bool) -> None:
    """As opposed to a sheet that covers all of the view, which is as high as it was before."""
    values = np.zeros((6, 1, 60, 60), dtype=np.float32)
    side = int(np.sqrt(corner))
    values[:3, 0, :side, :side] = TURN  # a sheet, or too small to be one
    values[4] = TURN
    wrapped = np.zeros_like(values)
    wrapped[:3, 0, side : side + 2, : side + 2] = wrapped[:3, 0, : side + 2, side : side + 2] = 3
    problem = Problem(wrapped)
    found = plateaus_of(problem, Judged(InMemory(values)), UNWATCHED)
    shown = shown_field(problem, UNWATCHED).read(Block(0, 6))
    assert shown[4].any() != covers
    assert set(found) == ({(0, 0), (1, 0), (2, 0), (4, 0)} if covers else set())


@pytest.mark.thorough
@pytest.mark.parametrize("lights", [1, 2])
def test_on_disk_it_is_the_same(tmp_path: Path, lights: int) -> None:
    data = sheet(6.3).assign_attrs(wavelength_um=0.5).to_dataset(name="phase")
    if lights == 2:
        data = at_wavelengths(data, (0.5, 0.6))
    wrapped, _ = noisy(data["phase"], 0.5)
    garbage = np.random.default_rng(1).uniform(-np.pi, np.pi, wrapped[8].shape)
    wrapped[8] = garbage.astype(np.float32)
    path = io.write_phase(tmp_path / "phase.ome.zarr", wrapped)
    found = []
    for storage in ("memory", "disk"):
        recipe = p4d.Recipe(
            recording=str(path),
            content="phase",
            boundary=((0, 0),),
            methods=METHODS[:2],
            storage=storage,
            confidence=True,
        )
        compared = p4d.run(recipe, folder=tmp_path / storage).comparison
        maps = compared.confidences()
        assert compared.problem.known(PLATEAUS)
        left_out = compared.problem.frames_left_out()
        found.append((maps, compared.verdict, compared.warnings(), left_out))
    for method in METHODS[:2]:
        expected = found[0][0][method].values
        np.testing.assert_array_equal(found[1][0][method].values, expected)
        assert not expected[8].any()
        assert expected[7].any()
    assert found[0][1:3] == found[1][1:3]
    np.testing.assert_array_equal(found[0][3], found[1][3])
