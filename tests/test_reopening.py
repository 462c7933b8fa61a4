"""Results that lie in a folder are read again as they were."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import napari_phase4d as p4d
from napari_phase4d.io import write_phase
from napari_phase4d.pipeline import Outcome, holds_outcome, read_outcome, write_outcome

METHODS = ("spatial-2d", "temporal-angular", "directional-l1")


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    sample = p4d.simulation.swimming_euglena((48, 64), 6, peak_rad=14)
    wrapped = write_phase(tmp_path_factory.mktemp("in") / "given.ome.tif", sample["wrapped"])
    recipe = p4d.Recipe(recording=str(wrapped), content="phase", methods=METHODS, boundary=(0, 0))
    return p4d.run(recipe, truth=sample["phase"])


@pytest.mark.slow
@pytest.mark.parametrize("form", ["tiff", "zarr"])
def test_all_is_as_it_was(outcome: Outcome, tmp_path: Path, form: str) -> None:
    write_outcome(outcome, tmp_path, form=form)
    assert holds_outcome(tmp_path)
    again = read_outcome(tmp_path)
    assert tuple(again.comparison.results) == METHODS
    pairs = [(again.reconstruction["phase"], outcome.reconstruction["phase"])]
    pairs += [(again.comparison.results[m], outcome.comparison.results[m]) for m in METHODS]
    for found, expected in pairs:
        xr.testing.assert_allclose(found.drop_attrs(), expected.drop_attrs(), rtol=0, atol=0)
    assert again.truth is not None
    np.testing.assert_array_equal(again.truth.values, outcome.truth)
    pd.testing.assert_frame_equal(again.comparison.table, outcome.comparison.table)
    assert again.recipe.start_frames == outcome.recipe.start_frames
    assert again.recipe.mask == outcome.recipe.mask


@pytest.mark.slow
def test_what_is_computed_of_it_is_the_same(outcome: Outcome, tmp_path: Path) -> None:
    write_outcome(outcome, tmp_path)
    again = read_outcome(tmp_path)
    assert again.comparison.verdict == outcome.comparison.verdict
    # The recipe begins with the wrapped phase beside it, and gives the same result.
    rerun = p4d.run(again.recipe)
    for method in METHODS:
        np.testing.assert_array_equal(
            rerun.comparison.results[method], outcome.comparison.results[method]
        )


def test_a_result_that_is_gone_is_left_out(outcome: Outcome, tmp_path: Path) -> None:
    write_outcome(outcome, tmp_path)
    (tmp_path / "spatial-2d.ome.tif").unlink()
    (tmp_path / "table.csv").unlink()
    again = read_outcome(tmp_path)
    assert tuple(again.comparison.results) == METHODS[1:] == again.recipe.methods
    assert list(again.comparison.table["method"]) == ["T/A", "WL1"]
    assert again.comparison.table["seconds"].isna().all()


def test_what_is_no_folder_of_results_is_refused(outcome: Outcome, tmp_path: Path) -> None:
    assert not holds_outcome(tmp_path)
    with pytest.raises(FileNotFoundError, match="holds no results of a run"):
        read_outcome(tmp_path)
    write_outcome(outcome, tmp_path)
    for method in METHODS:
        (tmp_path / f"{method}.ome.tif").unlink()
    with pytest.raises(ValueError, match="wrapped phase but no result"):
        read_outcome(tmp_path)
    some = outcome.comparison.results["spatial-2d"].isel(time=slice(3))
    write_phase(tmp_path / "spatial-2d.ome.tif", some)
    with pytest.raises(ValueError, match="of different runs"):
        read_outcome(tmp_path)
