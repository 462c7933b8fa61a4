"""Files of wrapped phase, and runs that begin with one."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from helpers import command
from napari_phase4d.analysis import order_shares
from napari_phase4d.io import (
    holds_phase,
    open_input,
    open_phase,
    open_truth,
    read_results,
    write_phase,
)
from napari_phase4d.pipeline import write_outcome
from napari_phase4d.simulation import budding_yeast
from napari_phase4d.unwrapping import methods_for

YEAST = budding_yeast((32, 32), 5, angles_deg=(0.0, 5.0, 10.0))


@pytest.mark.parametrize("shape", [(6, 7), (3, 6, 7), (3, 2, 6, 7)])
@pytest.mark.parametrize("kind", ["npy", "npz", "tif"])
def test_plain_stacks_get_all_four_axes(tmp_path: Path, kind: str, shape: tuple) -> None:
    values = np.random.default_rng(0).uniform(-3, 3, shape).astype(np.float32)
    path = tmp_path / f"phase.{kind}"
    if kind == "npy":
        np.save(path, values)
    elif kind == "npz":
        np.savez(path, other=np.zeros(3), wrapped=values)
    else:
        tifffile.imwrite(path, values, photometric="minisblack")
    assert holds_phase(path)
    found = open_phase(path)
    assert found.dims == ("time", "angle", "y", "x")
    np.testing.assert_array_equal(found.values.reshape(shape), values)
    assert found["y"].attrs["units"] == "um"


def test_own_results_keep_their_coordinates(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "wrapped.ome.tif", YEAST["wrapped"])
    assert holds_phase(path)
    xr.testing.assert_equal(open_phase(path), YEAST["wrapped"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stack.ome.tif", "stack.ome.zarr"])
def test_own_results_without_a_unit_are_known_by_their_numbers(tmp_path: Path, name: str) -> None:
    plain = YEAST["wrapped"].drop_attrs()
    path = write_phase(tmp_path / name, plain)
    assert holds_phase(path)
    xr.testing.assert_equal(open_phase(path), plain)
    assert not holds_phase(write_phase(path, abs(plain)))
    assert not holds_phase(write_phase(path, plain.assign_attrs(method="temporal")))


def test_a_damaged_result_without_a_unit_is_no_phase(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "stack.ome.zarr", YEAST["wrapped"].drop_attrs())
    for file in (path / "0").glob("c.*"):
        file.write_bytes(file.read_bytes()[:-9])
    assert not holds_phase(path)


NOT_PHASE = {
    "counts": np.ones((3, 8, 8), np.uint8),
    "fringes about zero": np.random.default_rng(0).uniform(-1, 1, (3, 8, 8)),
    "never negative": np.random.default_rng(0).uniform(0, 3, (3, 8, 8)),
    "beyond half a cycle": np.linspace(-9, 9, 64).reshape(8, 8),
    "no numbers": np.full((8, 8), np.nan),
    "one axis": np.linspace(-1, 1, 9),
}


@pytest.mark.parametrize("case", NOT_PHASE)
def test_other_files_are_not_taken_for_phase(tmp_path: Path, case: str) -> None:
    path = tmp_path / "file.npy"
    np.save(path, NOT_PHASE[case])
    assert not holds_phase(path)
    assert not holds_phase(tmp_path)
    assert not holds_phase(tmp_path / "missing.npy")


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        (np.ones((3, 8, 8), np.uint8), "holds uint8 numbers"),
        (np.zeros(5), r"of shape \(5,\)"),
        (np.zeros((0, 4, 4)), r"of shape \(0, 4, 4\)"),
    ],
)
def test_what_is_no_phase_is_said(tmp_path: Path, values: np.ndarray, sentence: str) -> None:
    path = tmp_path / "file.npy"
    np.save(path, values)
    with pytest.raises(ValueError, match=sentence):
        open_phase(path)


def test_files_that_cant_be_read(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="there is no file"):
        open_phase(tmp_path / "missing.npy")
    other = tmp_path / "phase.csv"
    other.write_text("1,2")
    with pytest.raises(OSError, match="of a kind that can't be read as phase"):
        open_phase(other)


@pytest.mark.parametrize("ending", [".npy", ".tif"])
def test_phase_larger_than_memory_is_refused_before_it_is_read(
    tmp_path: Path, ending: str
) -> None:
    path = tmp_path / f"long{ending}"
    shape = (2 + psutil.virtual_memory().total // 2**26, 1, 4096, 4096)
    if ending == ".npy":
        np.lib.format.open_memmap(path, "w+", np.float32, shape)
    else:
        tifffile.imwrite(path, shape=shape, dtype=np.float32, bigtiff=True)
    assert path.stat().st_blocks < 2**20, "the test needs a file system with sparse files"
    with pytest.raises(OSError, match=r"long.* is read whole and takes .* GB of memory are free"):
        open_phase(path)


@pytest.mark.slow
def test_a_run_may_begin_with_wrapped_phase(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "wrapped.ome.tif", YEAST["wrapped"])
    outcome = p4d.run(p4d.Recipe(recording=str(path)), truth=YEAST["phase"])
    assert outcome.recording is None
    expected = p4d.unwrap(YEAST["wrapped"], "temporal-angular", mask="auto")
    np.testing.assert_array_equal(outcome.comparison.results["temporal-angular"], expected)
    assert "mse_rad2" in outcome.comparison.table


@pytest.mark.thorough
@pytest.mark.slow
def test_compare_on_the_command_line(tmp_path: Path) -> None:
    write_phase(tmp_path / "wrapped.ome.tif", YEAST["wrapped"])
    write_phase(tmp_path / "exact.ome.tif", YEAST["phase"])
    done = command(
        "compare", "wrapped.ome.tif", "--truth", "exact.ome.tif", "--out", "out", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "out" / "table.csv", index_col="id")
    assert list(table.index) == methods_for(None)
    expected = p4d.compare(YEAST["wrapped"], truth=YEAST["phase"], mask="auto").table
    np.testing.assert_allclose(table["mse_rad2"], expected["mse_rad2"], rtol=1e-6)
    assert (table["peak_mb"] >= 0).all()
    ways = order_shares(YEAST["phase"])
    said = re.search(r"T/A ([\d.]+) %, A/T ([\d.]+) %", done.stdout)
    assert said is not None
    np.testing.assert_allclose([float(v) for v in said.groups()], [100 * s for s in ways.values()],
                               atol=0.006)  # fmt: skip
    assert (tmp_path / "out" / "comparison.png").stat().st_size > 10_000
    unwrapped = read_results(tmp_path / "out" / "network-flow.ome.tif")
    assert unwrapped.shape == YEAST["phase"].shape


@pytest.mark.slow
def test_compare_takes_several_files_and_chosen_methods(tmp_path: Path) -> None:
    for name in ("one", "two"):
        np.save(tmp_path / f"{name}.npy", YEAST["wrapped"].values[:2])
    done = command("compare", "one.npy", "two.npy", "--method", "laplacian", "--out", "out",
                   cwd=tmp_path)  # fmt: skip
    assert done.returncode == 0, done.stderr
    for name in ("one", "two"):
        assert len(pd.read_csv(tmp_path / "out" / name / "table.csv")) == 1


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("missing.npy",), "there is no file or folder"),
        (("wrapped.npy", "--truth", "missing.npy"), "there is no file"),
        (("wrapped.npy", "--truth", "small.npy"), "truth is"),
        (("wrapped.npy", "--boundary", "7,0"), "does not exist"),
    ],
)
@pytest.mark.slow
def test_wrong_comparisons_end_with_one_sentence(
    tmp_path: Path, arguments: tuple, sentence: str
) -> None:
    np.save(tmp_path / "wrapped.npy", YEAST["wrapped"].values[:2])
    np.save(tmp_path / "small.npy", YEAST["wrapped"].values[:1])
    done = command("compare", *arguments, "--out", "none", cwd=tmp_path)
    assert done.returncode == 1
    assert sentence in " ".join(done.stderr.split())
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_what_the_file_does_not_say_can_be_given(tmp_path: Path) -> None:
    np.save(tmp_path / "w.npy", YEAST["wrapped"].values)
    plain = open_phase(tmp_path / "w.npy")
    assert plain.attrs["notes"] == [
        "Not in the file, so counted in ones: pixel, frame rate, viewing angles."
    ]
    recipe = p4d.Recipe(
        recording=str(tmp_path / "w.npy"),
        angles_deg=(0, 5, 10),
        frame_rate_hz=2,
        optics=p4d.Optics(camera_pixel_um=6, magnification=30),
        methods=("spatial-2d",),
    )
    found = p4d.run(recipe).comparison.results["spatial-2d"]
    np.testing.assert_allclose(found["angle"], [0, 5, 10])
    np.testing.assert_allclose(found["time"][:2], [0, 0.5])
    np.testing.assert_allclose(found["x"][:2], [0, 0.2])
    with pytest.raises(ValueError, match="has 3 views, but 2 angles are given"):
        p4d.run(recipe.changed(angles_deg=(0, 5)))


def test_content_can_be_said(tmp_path: Path) -> None:
    """A hologram whose mean was taken off may look like phase, and phase may be all positive."""
    hologram = 3 * np.cos(np.arange(32 * 32).reshape(1, 32, 32) * 1.3)
    np.save(tmp_path / "h.npy", hologram)
    assert isinstance(open_input(tmp_path / "h.npy"), xr.DataArray)
    assert isinstance(open_input(tmp_path / "h.npy", content="holograms"), p4d.Recording)
    np.save(tmp_path / "p.npy", np.mod(YEAST["wrapped"].values[:, 0], 2 * np.pi))
    assert isinstance(open_input(tmp_path / "p.npy"), p4d.Recording)
    assert isinstance(open_input(tmp_path / "p.npy", content="phase"), xr.DataArray)
    np.savez(tmp_path / "both.npz", holograms=np.ones((2, 8, 8)), phase=YEAST["wrapped"].values)
    assert isinstance(open_input(tmp_path / "both.npz"), p4d.Recording)


def test_unwrapped_phase_is_not_unwrapped_again(tmp_path: Path) -> None:
    done = p4d.unwrap(YEAST["wrapped"], "spatial-2d")
    path = write_phase(tmp_path / "spatial-2d.ome.tif", done)
    with pytest.raises(ValueError, match="is unwrapped already, by spatial-2d"):
        p4d.run(p4d.Recipe(recording=str(path)))


@pytest.mark.slow
@pytest.mark.parametrize("mask", ["auto", None])
def test_missing_pixels_are_left_out(tmp_path: Path, mask: str | None) -> None:
    holes, truth = YEAST["wrapped"].copy(deep=True), YEAST["phase"].copy(deep=True)
    holes[:, :, :5, :5] = np.nan
    truth[:, :, :5, :5] = np.nan
    path = write_phase(tmp_path / "wrapped.ome.tif", holes)
    recipe = p4d.Recipe(recording=str(path), mask=mask, methods=("spatial-2d", "region-growing"))
    outcome = p4d.run(recipe, truth=truth)
    for method, result in outcome.comparison.results.items():
        np.testing.assert_array_equal(np.isnan(result.values), np.isnan(holes.values))
        row = outcome.comparison.table.loc[method]
        error = (result - truth).values[np.isfinite(truth.values)]
        assert row["mse_rad2"] == pytest.approx(np.mean(error**2), rel=1e-5)
        assert row["wrong_cycles_percent"] == pytest.approx(
            100 * np.mean(np.round(error / (2 * np.pi)) != 0)
        )


@pytest.mark.slow
def test_one_bad_file_does_not_stop_the_others(tmp_path: Path) -> None:
    np.save(tmp_path / "good.npy", YEAST["wrapped"].values[:2])
    (tmp_path / "bad.npy").write_bytes(b"nothing")
    done = command("compare", "bad.npy", "good.npy", "--method", "spatial-2d", "--out", "out",
                   cwd=tmp_path)  # fmt: skip
    assert done.returncode == 1
    assert "1 of 2 files failed: bad.npy" in " ".join(done.stderr.split())
    assert (tmp_path / "out" / "good" / "table.csv").exists()


@pytest.mark.slow
def test_info_says_what_a_phase_file_holds(tmp_path: Path) -> None:
    write_phase(tmp_path / "wrapped.ome.tif", YEAST["wrapped"])
    said = command("info", "wrapped.ome.tif", cwd=tmp_path)
    assert said.returncode == 0, said.stderr
    assert "wrapped phase, 5 times, 3 views of 32 x 32 pixels" in said.stdout
    assert "viewing angles 0, 5, 10 degrees" in said.stdout


def test_phase_that_only_its_numbers_tell_is_noted(tmp_path: Path) -> None:
    values = np.random.default_rng(0).uniform(-3, 3, (2, 2, 16, 16)).astype(np.float32)
    said = (
        "Taken for wrapped phase, as its numbers lie between -pi and pi; if they are holograms, "
        "say so (content='holograms')."
    )
    np.save(tmp_path / "one.npy", values[0])
    np.save(tmp_path / "views.npy", values)
    found = open_input(tmp_path / "one.npy")
    assert said in found.attrs["notes"]
    assert len(found.attrs["notes"]) == 2
    assert said not in open_input(tmp_path / "one.npy", content="phase").attrs["notes"]
    assert isinstance(open_input(tmp_path / "one.npy", content="holograms"), p4d.Recording)
    assert said not in open_input(tmp_path / "views.npy").attrs["notes"]
    path = p4d.write_phase(tmp_path / "own.ome.tif", p4d.open_phase(tmp_path / "views.npy"))
    assert said not in open_input(path).attrs.get("notes", ())


@pytest.fixture(scope="module")
def compared_with_other_order(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder and the words of a comparison whose truth has its views turned round."""
    folder = tmp_path_factory.mktemp("other_order")
    few = YEAST.isel(time=slice(2), angle=slice(2))
    write_phase(folder / "wrapped.ome.tif", few["wrapped"])
    write_phase(folder / "truth.ome.tif", few["phase"].isel(angle=[1, 0]))
    done = command(
        "compare", "wrapped.ome.tif", "--truth", "truth.ome.tif", "--method", "temporal",
        "--out", "out", cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder / "out", done.stdout


@pytest.mark.slow
def test_truth_in_another_order_is_written_as_the_table_takes_it(
    compared_with_other_order: tuple[Path, str],
) -> None:
    folder, _ = compared_with_other_order
    few = YEAST["phase"].isel(time=slice(2), angle=slice(2))
    exact = read_results(folder / "exact.ome.tif")
    np.testing.assert_array_equal(exact["angle"], few["angle"])
    np.testing.assert_allclose(exact, few, atol=1e-4)


def test_steps_of_truth_in_another_order_are_told_and_all_noted_files_are_there(
    compared_with_other_order: tuple[Path, str],
) -> None:
    folder, words = compared_with_other_order
    assert "by the exact phase" in words
    noted = json.loads((folder / "run.json").read_text(encoding="utf-8"))["files"]
    assert "comparison.png" in {file["name"] for file in noted}
    assert all((folder / file["name"]).exists() for file in noted)


@pytest.mark.slow
def test_truth_in_degrees_is_written_in_radians(tmp_path: Path) -> None:
    few = YEAST.isel(time=slice(2), angle=slice(2))
    path = write_phase(tmp_path / "wrapped.ome.tif", few["wrapped"])
    degrees = few["phase"].copy(data=np.rad2deg(few["phase"].values))
    degrees.attrs["units"] = "deg"
    outcome = p4d.run(p4d.Recipe(recording=str(path), methods=("temporal",)), truth=degrees)
    write_outcome(outcome, tmp_path / "out")
    exact = read_results(tmp_path / "out" / "exact.ome.tif")
    np.testing.assert_allclose(exact, few["phase"], atol=1e-4)


def test_truth_of_a_file_without_places_is_taken_by_its_shape(tmp_path: Path) -> None:
    few = YEAST.isel(time=slice(2), angle=slice(2))
    np.save(tmp_path / "exact.npy", few["phase"].values)
    wrapped = write_phase(tmp_path / "wrapped.ome.tif", few["wrapped"])
    exact = open_truth(tmp_path / "exact.npy")
    assert not exact.coords
    phase = p4d.open_phase(wrapped)
    found, wanted = (
        p4d.compare(phase, ("temporal",), truth=truth).table["mse_rad2"].item()
        for truth in (exact, few["phase"])
    )
    assert found == wanted
    # What the file says itself still counts.
    path = write_phase(tmp_path / "exact.ome.tif", few["phase"].isel(time=[1]))
    assert open_truth(path)["time"].item() == few["time"].values[1]
