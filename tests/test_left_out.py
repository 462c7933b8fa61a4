"""A warning where "object only" leaves out phase that may be measured."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy import ndimage
from typer.testing import CliRunner

import napari_phase4d as p4d
from helpers import wrap
from napari_phase4d.cli.app import app
from napari_phase4d.pipeline import Recipe
from napari_phase4d.stack import Block
from napari_phase4d.task import Task
from napari_phase4d.unwrapping import Problem, left_out_advice
from napari_phase4d.unwrapping.alone import each_alone, found_in
from napari_phase4d.unwrapping.causal import Causal, causal_methods
from napari_phase4d.unwrapping.frames import unwrap_frame
from napari_phase4d.unwrapping.objects import left_out_note, object_mask, smooth_share_left_out


def plume(height_rad: float, noise: float = 0.1, seed: int = 1) -> np.ndarray:
    """A tall jet that enters at the top, over gas that varies smoothly all over the field."""
    y, x = np.mgrid[:160, :200] / 100
    jet = height_rad * np.exp(-(((x - 1) / 0.9) ** 2)) * np.sqrt(np.clip((0.48 - y) / 0.5, 0, 1))
    gas = 1.8 * np.sin(2.5 * x + 2 * y)
    return (jet + gas + np.random.default_rng(seed).normal(0, noise, y.shape)).astype(np.float32)


@pytest.mark.parametrize("height", [12, 25])
@pytest.mark.parametrize("noise", [0.1, 0.3, 0.5, 0.7])
def test_much_smooth_phase_left_out_is_said_so(height: int, noise: float) -> None:
    exact = plume(height, 0)
    phase = wrap(plume(height, noise, seed=height))
    with pytest.warns(UserWarning, match=r"leaves out \d+ % .* try the whole field") as said:
        found = p4d.unwrap(phase, "spatial-2d", mask="auto")
    assert len(said) == 1
    not_flat = np.cos(exact - np.median(exact)) < np.cos(1)  # whole turns aside
    dropped = (found.values == 0) & not_flat
    noted = found.attrs["smooth_left_out_percent"]
    assert noted == pytest.approx(100 * dropped.mean(), abs=8)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.3, 0.5, 0.7])
@pytest.mark.parametrize("shape", sorted(p4d.simulation.SHAPES))
def test_cells_in_an_empty_field_give_no_warning(shape: str, noise: float) -> None:
    exact = p4d.simulation.moving_shape(shape, (96, 128), 3)["phase"].values
    phase = exact + np.random.default_rng(0).normal(0, noise, exact.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        p4d.unwrap(wrap(phase).astype(np.float32), "spatial-2d", mask="auto")


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [0.1, 0.5, 0.9])
def test_the_share_left_out_is_its_formula_in_scipys_words(noise: float) -> None:
    frame = plume(12, noise)
    mask = object_mask(frame)
    out, phase = ~mask[::2, ::2], frame[::2, ::2]
    soft = ndimage.uniform_filter(phase, 3)
    uneven = np.cos(soft - np.median(soft[out])) < np.cos(1)
    smooth = ndimage.uniform_filter(np.cos(phase - soft), 5) > 0.7
    expected = (out & uneven & smooth).mean()
    assert expected > 0.05
    assert smooth_share_left_out(frame, mask) == pytest.approx(expected, abs=2 / out.size)


def test_noise_that_is_left_out_does_not_count() -> None:
    frame = np.random.default_rng(0).uniform(-9, 9, (80, 90)).astype(np.float32)
    assert smooth_share_left_out(frame, np.zeros(frame.shape, bool)) < 0.01
    assert smooth_share_left_out(frame, np.ones(frame.shape, bool)) == 0


@pytest.mark.parametrize("seed", range(5))
def test_unwrapped_noise_does_not_count_alone_nor_beside_a_cell(seed: int) -> None:
    wrapped = np.random.default_rng(seed).uniform(-np.pi, np.pi, (160, 200)).astype(np.float32)
    share = []
    for first_column in (0, 120):  # all of it, or what is to the right of a cell
        exact = p4d.simulation.moving_shape("swelling", (160, 120), 1)["phase"].values
        wrapped[:, :first_column] = wrap(exact.reshape(-1, 160, 120)[0])[:, :first_column]
        unwrapped = unwrap_frame(wrapped, np.ones(wrapped.shape, bool))
        for mask in (object_mask(unwrapped), np.zeros(wrapped.shape, bool)):
            noise = np.zeros(wrapped.shape, bool)
            noise[:, first_column:] = True
            share.append(smooth_share_left_out(unwrapped, mask | ~noise))
    assert max(share) < 0.03


def test_patches_lifted_by_a_turn_are_flat() -> None:
    frame = np.random.default_rng(0).normal(0, 0.3, (80, 90)).astype(np.float32)
    frame[20:50, 20:70] += np.float32(2 * np.pi)
    assert smooth_share_left_out(frame, np.zeros(frame.shape, bool)) < 0.03


def test_the_share_is_that_of_the_slope_that_is_dropped() -> None:
    ramp = np.tile(np.linspace(-4, 4, 100, dtype=np.float32), (60, 1))
    share = smooth_share_left_out(ramp, np.zeros(ramp.shape, bool))
    assert share == pytest.approx(0.75, abs=0.03)  # all but a quarter is more than 1 rad away
    assert left_out_advice({"smooth_left_out_percent": 9.9}) == ""
    assert left_out_note(np.zeros((3, 2))) == left_out_note(np.zeros((0, 0))) == {}
    assert left_out_advice({}) == ""


def among_cells(plumes: list[tuple[int, int]], n_times: int, n_angles: int) -> np.ndarray:
    """Return wrapped frames with a cell, but a plume in some of them (time, angle)."""
    y, x = np.mgrid[:160, :200]
    cell = 9 * np.sqrt(np.clip(1 - ((y - 80) ** 2 + (x - 90) ** 2) / 30**2, 0, 1))
    stack = np.broadcast_to(cell, (n_times, n_angles, 160, 200)).copy()
    stack += np.random.default_rng(2).normal(0, 0.1, stack.shape)
    for number, place in enumerate(plumes):
        stack[place] = plume(12, seed=number)
    return wrap(stack).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("plumes", "words"),
    [
        ([(3, 0)], r"leaves out \d\d % of the field at time 3 though"),
        ([(4, 1)], r"leaves out \d\d % of the field at time 4, view 2 though"),
        (
            [(5, 0), (9, 1)],
            r"leaves out up to \d\d % of the field in 2 frames, the first at time 5,",
        ),
    ],
)
def test_few_bad_frames_among_many_are_said(
    plumes: list[tuple[int, int]], words: str, tmp_path: Path
) -> None:
    stack = among_cells(plumes, 11, 2)
    with pytest.warns(UserWarning, match=words):
        found = p4d.unwrap(stack, "spatial-2d", boundary=(0, 0), mask="auto")
    assert found.attrs["smooth_left_out_frames"] == [list(place) for place in plumes]
    assert found.attrs["smooth_left_out_most_percent"] > 50
    assert found.attrs["smooth_left_out_percent"] < 10
    np.save(tmp_path / "few.npy", stack)
    recipe = Recipe(
        recording=str(tmp_path / "few.npy"), methods=("spatial-2d",), boundary=((0, 0),),
        storage="disk",
    )  # fmt: skip
    on_disk = p4d.run(recipe, folder=tmp_path / "out").comparison.results["spatial-2d"].attrs
    names = [name for name in found.attrs if name.startswith("smooth_left_out")]
    assert len(names) == 3
    assert {name: on_disk[name] for name in names} == {name: found.attrs[name] for name in names}
    assert left_out_advice(on_disk) == left_out_advice(found.attrs)


def test_one_bad_frame_among_thousands_is_noted() -> None:
    shares = np.zeros((5000, 1))
    shares[4321] = 0.66
    assert "66 % of the field at time 4321" in left_out_advice(left_out_note(shares))


def test_views_of_two_wavelengths_are_told_apart() -> None:
    stack = among_cells([(2, 1)], 4, 2)
    axes = {"wavelength": ("angle", [0.5, 0.6])}
    phase = xr.DataArray(stack, dims=("time", "angle", "y", "x"), coords=axes)
    with pytest.warns(UserWarning, match="at time 2, view 2"):
        found = p4d.unwrap(phase, "temporal-angular", boundary=(0, 0), mask="auto")
    assert found.attrs["smooth_left_out_frames"] == [[2, 1]]


def test_frames_that_come_note_the_same() -> None:
    stack = among_cells([(3, 0)], 6, 1)
    causal = Causal(causal_methods(("spatial-2d",), {}), ((0, 0),), finds_mask=True)
    assert left_out_note(causal.smooth_left_out) == {}
    for frames in (stack[:2], stack[2:]):
        causal.more(frames)
    assert left_out_note(causal.smooth_left_out)["smooth_left_out_frames"] == [[3, 0]]


def test_results_on_disk_note_the_same(tmp_path: Path) -> None:
    stack = np.stack(
        [[wrap(plume(12, noise)), wrap(plume(25, noise))] for noise in (0.1, 0.2, 0.3)]
    )
    found = [
        p4d.run(
            Recipe(
                recording=str(tmp_path / "wrapped.npy"), methods=("spatial-2d",),
                boundary=((0, 0),), storage=storage,
            ),
            folder=tmp_path if storage == "disk" else None,
        ).comparison.results["spatial-2d"]
        for storage in ("memory", "disk")
        if np.save(tmp_path / "wrapped.npy", stack) is None
    ]  # fmt: skip
    in_memory, on_disk = (each.attrs["smooth_left_out_percent"] for each in found)
    assert in_memory == on_disk > 20


@pytest.mark.slow
def test_the_command_says_it_and_takes_the_whole_field(tmp_path: Path) -> None:
    np.save(tmp_path / "jet.npy", wrap(plume(12))[None])
    call = ["compare", str(tmp_path / "jet.npy"), "--method", "spatial-2d", "--out"]
    said = CliRunner().invoke(app, [*call, str(tmp_path / "a")])
    assert said.exit_code == 0, said.output
    assert "leaves out" in " ".join(said.output.split())
    whole = CliRunner().invoke(app, [*call, str(tmp_path / "b"), "--whole-field"])
    assert whole.exit_code == 0, whole.output
    assert "leaves out" not in whole.output


def test_the_centre_of_an_object_is_its_mean_place_and_none_if_it_fills_the_frame() -> None:
    """So that a frame without a background is not moved against the others."""
    y, x = np.mgrid[:50, :60]
    cells = 5 * np.exp(-((y - 25) ** 2 + (x - np.array([15, 30, 45])[:, None, None]) ** 2) / 50)
    ramp = np.broadcast_to(x / 3, (1, 50, 60))
    stack = Problem(wrap(np.concatenate([cells, ramp]))[:, None].astype(np.float32))
    found = found_in(stack, each_alone(stack, Task()), Task())
    masks = found.object.read(Block(0, 4))[:, 0]
    assert [bool(mask.all()) for mask in masks] == [False, False, False, True]
    for mask, own in zip(masks[:3], found.centres[:3, 0], strict=True):
        np.testing.assert_allclose(own, np.argwhere(mask).mean(axis=0))
    assert np.isnan(found.centres[3]).all()


@pytest.mark.slow
def test_a_view_that_the_camera_never_saw_makes_no_other_one_doubtful() -> None:
    """One beam was blocked: its lobe holds noise in every frame, smooth over some pixels."""
    wrapped = p4d.simulation.swimming_euglena((64, 64), 6, pixel_um=0.7, peak_rad=9)["wrapped"]
    rng = np.random.default_rng(4)
    field = rng.normal(size=(2, 6, 64, 64))
    field = ndimage.gaussian_filter(field, (0, 0, 0.8, 0.8))
    wrapped[:, 1] = np.angle(field[0] + 1j * field[1])
    both = p4d.compare(wrapped, ["temporal-angular", "directional-l1"])
    alone = p4d.compare(wrapped.isel(angle=[0]), ["temporal-angular", "directional-l1"])
    for method, result in alone.results.items():
        np.testing.assert_array_equal(both.results[method][:, :1].values, result.values)
        assert float(both.confidence(method)[:, 0].min()) > 0.9
        assert float(both.confidence(method)[:, 1].mean()) < 0.5
    assert "This is angle 21° above all; of what else was seen less than 0.01 %" in both.verdict
    assert "above all" not in alone.verdict
    numbered = p4d.compare(wrapped.values, ["directional-l1"]).verdict
    assert "This is view 2 above all" in numbered
