"""Files of wrapped phase, and runs that begin with one."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.evaluation import order_shares
from napari_phase4d.io import holds_phase, open_phase, read_results, write_phase
from napari_phase4d.simulation import budding_yeast

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


NOT_PHASE = {
    "counts": np.ones((3, 8, 8), np.uint8),
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


def test_a_run_may_begin_with_wrapped_phase(tmp_path: Path) -> None:
    path = write_phase(tmp_path / "wrapped.ome.tif", YEAST["wrapped"])
    outcome = p4d.run(p4d.Recipe(recording=str(path)), truth=YEAST["phase"])
    assert outcome.recording is None
    expected = p4d.unwrap(YEAST["wrapped"], "temporal-angular", mask="auto")
    np.testing.assert_array_equal(outcome.comparison.results["temporal-angular"], expected)
    assert "mse_rad2" in outcome.comparison.table


def command(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "napari_phase4d", *map(str, arguments)]
    return subprocess.run(line, capture_output=True, text=True, cwd=cwd, check=False)


def test_compare_on_the_command_line(tmp_path: Path) -> None:
    write_phase(tmp_path / "wrapped.ome.tif", YEAST["wrapped"])
    write_phase(tmp_path / "exact.ome.tif", YEAST["phase"])
    done = command(
        "compare", "wrapped.ome.tif", "--truth", "exact.ome.tif", "--out", "out", cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "out" / "table.csv", index_col="id")
    assert list(table.index) == list(p4d.METHODS)
    expected = p4d.compare(YEAST["wrapped"], truth=YEAST["phase"], mask="auto").table
    np.testing.assert_allclose(table["mse_rad2"], expected["mse_rad2"], rtol=1e-6)
    assert (table["peak_mb"] > 0).all()
    ways = order_shares(YEAST["phase"])
    said = re.search(r"T/A ([\d.]+) %, A/T ([\d.]+) %", done.stdout)
    assert said is not None
    np.testing.assert_allclose([float(v) for v in said.groups()], [100 * s for s in ways.values()],
                               atol=0.006)  # fmt: skip
    assert (tmp_path / "out" / "comparison.png").stat().st_size > 10_000
    unwrapped = read_results(tmp_path / "out" / "network-flow.ome.tif")
    assert unwrapped.shape == YEAST["phase"].shape


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
def test_wrong_comparisons_end_with_one_sentence(
    tmp_path: Path, arguments: tuple, sentence: str
) -> None:
    np.save(tmp_path / "wrapped.npy", YEAST["wrapped"].values[:2])
    np.save(tmp_path / "small.npy", YEAST["wrapped"].values[:1])
    done = command("compare", *arguments, "--out", "none", cwd=tmp_path)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert sentence in " ".join(done.stderr.split())
    assert not (tmp_path / "none").exists()
