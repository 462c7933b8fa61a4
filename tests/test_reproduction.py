"""The paper's table, figures and visualizations."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pandas as pd
import pytest

import napari_phase4d as p4d
from napari_phase4d.analysis import mean_squared_error
from napari_phase4d.pipeline.guarding import guarded_folder
from napari_phase4d.pipeline.provenance import Fingerprint
from napari_phase4d.reproduction import PAPER_MSE, Reproduction, reproduce, write_reproduction
from napari_phase4d.simulation import budding_yeast
from small_disks import small_disk


@pytest.fixture(scope="module")
def found() -> Reproduction:
    return reproduce()


def test_the_papers_figures_are_the_papers() -> None:
    assert list(PAPER_MSE.values()) == [2.55, 1.70, 0.95, 0.79, 0.82, 8.68, 6.15, 12.79]


@pytest.mark.thorough
def test_table_holds_the_errors_of_the_methods(found: Reproduction) -> None:
    data = budding_yeast()
    for method in PAPER_MSE:
        result = p4d.unwrap(data["wrapped"], method, mask="auto")
        expected = mean_squared_error(result, data["phase"])
        assert found.table.loc[method, "mse_rad2"] == pytest.approx(expected)
    published = p4d.unwrap(data["wrapped"], "laplacian", mask="auto", variant="phasetools")
    assert found.table.loc["laplacian", "phasetools_mse_rad2"] == pytest.approx(
        mean_squared_error(published, data["phase"])
    )
    assert found.table["phasetools_mse_rad2"].notna().sum() == 3


@pytest.mark.slow
def test_errors_come_in_the_papers_order(found: Reproduction) -> None:
    mse = found.table["mse_rad2"]
    assert 2.0 <= mse["spatial-2d"] <= 3.1
    assert mse["spatial-2d"] > mse["angular"] > mse["temporal"]
    for both in ("temporal-angular", "angular-temporal"):
        assert mse["temporal"] >= mse[both]
        assert mse[both] == pytest.approx(0.8, abs=0.2)
    assert mse["laplacian"] > mse["spatial-2d"]
    assert mse["dilate-erode"] > mse["spatial-2d"]


@pytest.mark.slow
def test_boundary_frame_is_free_of_error(found: Reproduction) -> None:
    exact = found.yeast["actual"].values[0, 0]
    for title in ("2-D", "Angular", "Temporal", "T/A", "A/T"):
        assert np.abs(found.yeast[title].values[0, 0] - exact).max() < 1e-4


@pytest.mark.slow
def test_full_disk_leaves_the_older_figure(found: Reproduction, tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk") as disk:
        figure = disk / "figure_2.png"
        with guarded_folder(disk, [figure.name]) as kept:
            figure.write_bytes(b"an older figure")
            kept.settle([figure], "", Fingerprint("an older run"))
        (disk / "full").write_bytes(bytes(2**20 - 2**16))
        with pytest.raises(OSError, match="No space left on device"):
            write_reproduction(found, disk, movies=False)
        assert figure.read_bytes() == b"an older figure"
        assert (disk / "table.csv").exists()


@pytest.mark.thorough
@pytest.mark.slow
def test_everything_is_written(found: Reproduction, tmp_path: Path) -> None:
    written = write_reproduction(found, tmp_path)
    assert [p.name for p in written[:3]] == ["table.csv", "figure_2.png", "figure_4.png"]
    assert len(pd.read_csv(written[0])) == 8
    movies = written[3:]
    assert [int(p.name.split("_")[1]) for p in movies] == list(range(1, 15))
    assert len(iio.imread(movies[0])) == 19
    assert all(n % 2 == 0 for n in iio.imread(movies[0]).shape[1:3])
    frames = iio.imread(movies[-1])
    assert len(frames) == 40
    assert (frames[0] != frames[-1]).any()
    assert not list(tmp_path.glob(".*"))  # nothing half-written is left
