"""Cells through recipe, command line, batch and script; and regions that go along with them."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import ndimage
from typer.testing import CliRunner

import napari_phase4d as p4d
from napari_phase4d.analysis import (
    cells_in,
    region_with_cell,
    summary_of_cells,
    with_empty_field,
)
from napari_phase4d.cli.app import app
from napari_phase4d.cli.options import with_settings
from napari_phase4d.pipeline import run_batch, running, write_outcome
from napari_phase4d.scripting import as_python
from napari_phase4d.simulation import swimming_cells


@pytest.fixture(scope="module")
def sample() -> xr.Dataset:
    return swimming_cells((128, 160), 10, 3, divisions=1, leaving=1, entering=0)


@pytest.fixture(scope="module")
def file(sample: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return p4d.write_phase(tmp_path_factory.mktemp("cells") / "wrapped.ome.tif", sample["wrapped"])


def recipe_for(file: Path, **settings: float) -> p4d.Recipe:
    cells = p4d.CellSettings(**settings)
    return p4d.Recipe(recording=str(file), methods=("directional-l1",), mask=None, cells=cells)


@pytest.mark.slow
def test_a_run_finds_what_the_functions_find(file: Path, tmp_path: Path) -> None:
    outcome = p4d.run(recipe_for(file, smallest_um2=5, object_index=1.4))
    phase = outcome.comparison.results["directional-l1"]
    cells = p4d.find_cells(phase, smallest_um2=5)
    assert outcome.cells is not None
    assert outcome.cells.method == "directional-l1"
    np.testing.assert_array_equal(outcome.cells.labels, cells)
    trust = outcome.comparison.confidence("directional-l1")
    table = p4d.measure(phase, cells, p4d.Optics(), object_index=1.4, confidence=trust)
    pd.testing.assert_frame_equal(outcome.cells.table, table)
    write_outcome(outcome, tmp_path)
    labels = p4d.read_results(tmp_path / "cells.ome.tif")
    np.testing.assert_array_equal(labels, cells)
    assert [list(pair) for pair in labels.attrs["parents"]] == cells.attrs["parents"]
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "cells.csv"), table)
    read = pd.read_csv(tmp_path / "cell_summary.csv")
    pd.testing.assert_frame_equal(read, outcome.cells.summary)
    assert p4d.Recipe.from_file(tmp_path / "recipe.json").cells == outcome.recipe.cells


@pytest.mark.slow
def test_a_run_counts_pixels_in_doubt() -> None:
    """Too thick and noisy for this method: masses are off by turns, and their errors say so."""
    sample = swimming_cells((128, 160), 6, 3, peak_rad=12, divisions=0, leaving=0, entering=0)
    exact, rng = sample["phase"], np.random.default_rng(0)
    noisy = np.angle(np.exp(1j * (exact.values + rng.normal(0, 0.5, exact.shape))))
    wrapped = sample["wrapped"].copy(data=noisy.astype(np.float32))
    comparison = p4d.compare(wrapped, ["temporal"])
    recipe = p4d.Recipe(methods=("temporal",), cells=p4d.CellSettings(), optics=p4d.Optics())
    cells = running.cells_by(recipe, comparison, wrapped)
    assert cells is not None
    result = comparison.results["temporal"]
    without = p4d.measure(result, cells.labels, p4d.Optics())
    true = p4d.measure(exact, cells.labels, p4d.Optics())
    mass, error = "dry mass (pg)", "dry mass error (pg)"
    off = (without[mass] - true[mass]).abs()
    assert (off / without[error]).median() > 10
    assert (off / cells.table[error]).median() < 1.5
    trust = comparison.confidence("temporal")
    wanted = p4d.measure(result, cells.labels, p4d.Optics(), confidence=trust)
    pd.testing.assert_frame_equal(cells.table, wanted)


@pytest.mark.thorough
def test_a_run_on_disk_finds_the_same_cells(file: Path, tmp_path: Path) -> None:
    """Confidence is counted in errors on disk only where a recipe asks for it."""
    recipe = recipe_for(file)
    expected = p4d.run(recipe).cells
    assert expected is not None
    on_disk = recipe.changed(storage="disk")
    with pytest.warns(UserWarning, match="errors of the cells leave out pixels in doubt"):
        lone = p4d.run(on_disk, folder=tmp_path / "lone").cells
    asked = p4d.run(on_disk.changed(confidence=True), folder=tmp_path / "asked").cells
    assert lone is not None
    assert asked is not None
    error = "dry mass error (pg)"
    pd.testing.assert_frame_equal(
        lone.table.drop(columns=error), expected.table.drop(columns=error)
    )
    pd.testing.assert_frame_equal(asked.table, expected.table)


@pytest.mark.slow
def test_the_summary_has_the_true_masses(sample: xr.Dataset, file: Path) -> None:
    outcome = p4d.run(recipe_for(file))
    assert outcome.cells is not None
    summary = outcome.cells.summary.set_index("cell")
    first = sample["cells"].values[0, 0]
    labels = outcome.cells.labels.values[0, 0]
    for cell in (1, 2, 3):
        found = int(np.bincount(labels[first == cell]).argmax())
        true = float(np.nanmedian(sample["dry_mass_pg"].sel(cell=cell)))
        assert summary["dry mass (pg)"][found] == pytest.approx(true, rel=0.01)
    daughters = summary[summary["parent"] > 0]
    assert len(daughters) == 2
    mother = daughters["parent"].iloc[0]
    assert daughters["dry mass (pg)"].sum() == pytest.approx(
        summary["dry mass (pg)"][mother], rel=0.01
    )
    assert (summary["from (s)"][daughters.index] > summary["to (s)"][mother]).all()


def test_the_summary_leaves_out_what_the_border_cuts() -> None:
    table = pd.DataFrame(
        {
            "cell": [1, 1, 1, 2],
            "parent": [0, 0, 0, 1],
            "time (s)": [0.0, 1.0, 2.0, 2.0],
            "dry mass (pg)": [10.0, 12.0, 3.0, 5.0],
            "wholly in view": [True, True, False, False],
        }
    )
    summary = summary_of_cells(table)
    assert summary["dry mass (pg)"].tolist() == [11.0, 5.0]
    assert summary["to (s)"].tolist() == [2.0, 2.0]
    assert summary["frames"].tolist() == [3, 1]


@pytest.mark.slow
def test_no_cells_are_said_and_stop_no_run(file: Path, tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="no cells were found"):
        outcome = p4d.run(recipe_for(file, smallest_um2=1e5))
    assert outcome.cells is not None
    assert outcome.cells.table.empty
    assert outcome.cells.summary.empty
    write_outcome(outcome, tmp_path)
    assert pd.read_csv(tmp_path / "cells.csv").empty


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("fault", "sentence"),
    [(OSError("no room for the labels"), "no room"), (KeyError("frame"), "an unexpected fault")],
)
def test_results_are_written_where_cells_can_not_be_found(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Exception, sentence: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise fault

    monkeypatch.setattr(running, "cells_in", fail)
    out = tmp_path / "out"
    words = ["run", str(file), "--method", "WL1", "--cells", "--out", str(out)]
    with pytest.warns(UserWarning, match=f"the cells could not be found: .*{sentence}"):
        ended = CliRunner().invoke(app, words)
    assert ended.exit_code == 1
    assert isinstance(ended.exception, ValueError)
    assert f"written, but without their cells: {sentence}" in str(ended.exception)
    result = p4d.read_results(out / "directional-l1.ome.tif")
    wanted = p4d.run(p4d.Recipe(recording=str(file), methods=("directional-l1",))).comparison
    np.testing.assert_array_equal(result, wanted.results["directional-l1"])
    for name in ("table.csv", "recipe.json", "run.json"):
        assert (out / name).exists()
    assert not (out / "cells.csv").exists()


@pytest.mark.thorough
def test_a_batch_keeps_results_where_cells_can_not_be_found(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [tmp_path / f"{name}.ome.tif" for name in "abc"]
    for name in names:
        name.write_bytes(file.read_bytes())
    real, count = running.cells_in, iter(range(9))

    def second_fails(*given: object, **options: object) -> object:
        if next(count) == 1:
            msg = "no room for the labels"
            raise OSError(msg)
        return real(*given, **options)

    monkeypatch.setattr(running, "cells_in", second_fails)
    told: list[str] = []
    with warnings.catch_warnings(record=True) as said:  # scikit-image's own among them
        warnings.simplefilter("always")
        table = run_batch(recipe_for(file), names, tmp_path / "out", told=told.append)
    assert any("no room" in str(one.message) for one in said)
    assert table["status"].tolist() == ["done", "failed", "done"]
    assert table["results"].tolist() == [1, 1, 1]
    assert table["error"][2] == "without cells: no room for the labels"
    assert any("failed: without cells: no room" in line for line in told)
    assert (tmp_path / "out" / "b" / "directional-l1.ome.tif").exists()
    cells = pd.read_csv(tmp_path / "out" / "cells.csv")
    assert cells["file"].unique().tolist() == [str(names[0]), str(names[2])]
    again = run_batch(recipe_for(file), names, tmp_path / "out", resume=True)
    assert again["status"].tolist() == ["complete already", "done", "complete already"]
    assert again["cells"].tolist() == [again["cells"][1]] * 3


@pytest.mark.slow
def test_cells_on_the_command_line(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["run", str(file), "--method", "WL1", "--smallest-cell", "5", "--increment", "0.2"]
    said = CliRunner().invoke(app, [*words, "--object-index", "1.4", "--out", str(out)]).output
    assert "cells in the result of WL1" in said
    kept = json.loads((out / "recipe.json").read_text())["cells"]
    assert (kept["smallest_um2"], kept["refraction_increment_ml_per_g"]) == (5, 0.2)
    summary = pd.read_csv(out / "cell_summary.csv")
    assert f"{summary['dry mass (pg)'][0]:.1f}"[:4] in said
    assert "volume (um^3)" in summary


@pytest.mark.thorough
def test_a_batch_has_a_row_for_each_cell(file: Path, tmp_path: Path) -> None:
    copy = tmp_path / "other.ome.tif"
    copy.write_bytes(file.read_bytes())
    recipe = recipe_for(file)
    table = run_batch(recipe, [file, copy], tmp_path / "out")
    cells = pd.read_csv(tmp_path / "out" / "cells.csv")
    assert cells["file"].unique().tolist() == [str(file), str(copy)]
    assert table["cells"].tolist() == [len(cells) // 2] * 2
    again = run_batch(recipe, [file, copy], tmp_path / "out", resume=True)
    assert again["status"].tolist() == ["complete already"] * 2
    assert again["cells"].tolist() == table["cells"].tolist()
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "out" / "cells.csv"), cells)
    # A batch that finds none leaves no table of an earlier one.
    run_batch(recipe.changed(cells=None), [file], tmp_path / "out")
    assert not (tmp_path / "out" / "cells.csv").exists()


@pytest.mark.slow
def test_the_script_gives_the_same_cells(file: Path, tmp_path: Path) -> None:
    recipe = recipe_for(file, smallest_um2=5)
    (tmp_path / "script").mkdir()
    script = as_python(recipe, folder=str(tmp_path / "script"))
    exec(compile(script, "script", "exec"), {})
    write_outcome(p4d.run(recipe), tmp_path / "run")
    for name in ("cells.csv", "cell_summary.csv"):
        assert (tmp_path / "script" / name).read_text() == (tmp_path / "run" / name).read_text()
    ours, theirs = (p4d.read_results(tmp_path / d / "cells.ome.tif") for d in ("script", "run"))
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.slow
def test_lazy_phase_gives_the_same_cells_in_a_file(sample: xr.Dataset) -> None:
    lazy = sample["phase"].chunk({"time": 3})
    found, wanted = p4d.find_cells(lazy), p4d.find_cells(sample["phase"])
    np.testing.assert_array_equal(found, wanted)
    assert found.attrs == wanted.attrs
    base = found.data
    while base.base is not None and not isinstance(base, np.memmap):
        base = base.base
    assert isinstance(base, np.memmap)


@pytest.mark.slow
@pytest.mark.parametrize("blur", [0.0, 1.0])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_outlines_are_where_cells_end(blur: float, noise: float) -> None:
    data = swimming_cells((128, 160), 2, 3, divisions=0, leaving=0, entering=0)
    rng = np.random.default_rng(0)
    values = ndimage.gaussian_filter(data["phase"].values, (0, 0, blur, blur))
    values = values + rng.normal(0, noise, values.shape).astype(np.float32)
    found = p4d.find_cells(data["phase"].copy(data=values)).values > 0
    true = data["cells"].values > 0
    assert found.sum() == pytest.approx(true.sum(), rel=0.12)
    assert (found & true).sum() > 0.85 * (found | true).sum()


@pytest.mark.slow
def test_a_region_goes_along_with_its_cell(sample: xr.Dataset) -> None:
    cells = p4d.find_cells(sample["phase"])
    labels = cells.values
    spot = np.zeros(labels.shape[2:], dtype=bool)
    middle = np.array(ndimage.center_of_mass(labels[0, 1] == 2)).round().astype(int)
    spot[middle[0] - 2 : middle[0] + 3, middle[1] - 2 : middle[1] + 3] = True
    moved = region_with_cell(spot, (0, 1), cells)
    np.testing.assert_array_equal(moved[0, 1], spot)
    for place in np.ndindex(*labels.shape[:2]):
        there = np.array(ndimage.center_of_mass(labels[place] == 2))
        assert moved[place].sum() == 25
        np.testing.assert_allclose(np.array(ndimage.center_of_mass(moved[place])), there, atol=1)
    leaving = np.argmax((labels == 1).any(axis=(1, 2, 3))[::-1] == 0)
    assert leaving >= 0
    empty = np.zeros_like(spot)
    empty[:3, :3] = True
    if not labels[0, 0][empty].any():
        with pytest.raises(ValueError, match="there is no cell in the region"):
            region_with_cell(empty, (0, 0), cells)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"smallest_um2": -1}, "smallest_um2 must be above 0"),
        ({"smallest_um2": 9, "largest_um2": 3}, "is larger than the largest"),
        ({"object_index": 0.5}, "object_index must be at least 1"),
        ({"threshold_rad": float("nan")}, "threshold_rad must be above 0"),
        ({"at_border": "perhaps"}, "at_border must be True or False"),
        ({"refraction_increment_ml_per_g": "x"}, "must be a number"),
    ],
)
def test_settings_that_can_not_be_are_refused(settings: dict, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        p4d.CellSettings(**settings)
    with pytest.raises(ValueError, match="cells"):
        p4d.Recipe(cells=settings)


@pytest.mark.slow
def test_labels_of_another_program_are_measured_as_they_are(sample: xr.Dataset) -> None:
    labels = sample["cells"].copy(data=sample["cells"].values * 7)
    cells = cells_in(sample["phase"], p4d.Optics(), labels=labels)
    np.testing.assert_array_equal(cells.labels.values > 0, labels.values > 0)
    assert cells.summary["cell"].max() <= 5


@pytest.mark.parametrize(
    ("typed", "oblique"),
    [
        ({"angle": [-7, 21]}, True),
        ({"angle": [-7, 21], "oblique": False}, False),
        ({"angle": [-7, 21], "turned": True}, False),
        ({"angle": [-7, 21], "turned": True, "oblique": True}, True),
        ({}, False),
    ],
)
def test_oblique_views_are_corrected_where_angles_are_typed_in(
    typed: dict[str, Any], oblique: bool
) -> None:
    recipe = with_settings(p4d.Recipe(), cells=True, **typed)
    assert recipe.cells is not None
    assert recipe.cells.oblique is oblique


def test_no_oblique_asks_for_no_cells_and_those_of_a_recipe_follow_typed_angles() -> None:
    assert with_settings(p4d.Recipe(), oblique=False).cells is None
    recipe = with_settings(p4d.Recipe(cells=p4d.CellSettings()), angle=[-7, 21])
    assert recipe.cells is not None
    assert recipe.cells.oblique


def test_angles_of_a_recipe_count_as_those_typed_in_and_what_it_says_of_them_holds() -> None:
    angles = p4d.Recipe(angles_deg=(-7, 21))
    found = with_settings(angles, cells=True).cells
    assert found is not None
    assert found.oblique
    off = with_settings(angles.changed(cells=p4d.CellSettings(oblique=False)), angle=[-7, 21])
    assert off.cells is not None
    assert not off.cells.oblique


@pytest.mark.thorough
def test_a_sample_is_turned_and_its_beam_is_not(tmp_path: Path) -> None:
    """The angles belong to the object, so that the masses of both views agree."""
    words = ["run", "sample:cells", "--cells", "--angle", "-7", "--angle", "21", "--method", "2-D"]
    said = CliRunner().invoke(app, [*words, "--out", str(tmp_path)]).output
    assert "cells in the result" in said
    assert "cosine" not in said
    assert not json.loads((tmp_path / "recipe.json").read_text())["cells"]["oblique"]


@pytest.mark.parametrize("levels", [[0, 0, 0], [3.2, 3.2, 3.2], [0, 2, 4.5], "from 0 to a turn"])
def test_a_mask_costs_no_mass_wherever_the_empty_field_lies(levels: list[float] | str) -> None:
    """What a mask leaves out is added as it was measured, which may be wrapped."""
    exact = swimming_cells((40, 50), 3, 1, divisions=0, leaving=0, entering=0)["phase"]
    noise = np.random.default_rng(0).normal(0, 0.1, exact.shape)
    shift = np.zeros(3) if isinstance(levels, str) else np.array(levels)
    values = np.angle(np.exp(1j * (exact.values + noise + shift[:, None, None, None])))
    if isinstance(levels, str):
        values %= 2 * np.pi
    wrapped = exact.copy(data=values.astype(np.float32))
    unwrapped = p4d.unwrap(wrapped, "directional-l1", mask="auto")
    table = cells_in(unwrapped, p4d.Optics(), wrapped=wrapped).table
    true = cells_in(exact, p4d.Optics()).table["dry mass (pg)"]
    assert len(table) == len(true) == exact.sizes["time"] * exact.sizes["angle"]
    np.testing.assert_allclose(table["dry mass (pg)"], true, rtol=0.02)


@pytest.mark.parametrize("inside", [0, 10, 20])
def test_the_empty_field_stays_where_it_is_however_steep_the_edge_of_a_mask(inside: int) -> None:
    """A mask may end where the object is more than half a turn high."""
    y, x = np.mgrid[:120, :120]
    away = np.hypot(y - 60, x - 60)
    dome = 15 * np.sqrt(np.maximum(1 - (away / 45) ** 2, 0)).astype(np.float32)
    noise = np.random.default_rng(0).normal(0, 0.1, (3, 1, 120, 120)).astype(np.float32)
    dims = ("time", "angle", "y", "x")
    exact = xr.DataArray(dome + noise, dims=dims)
    mask = away < 45 - inside
    result = exact.where(mask, 0).assign_attrs(mask="given", boundary=[[0, 0]])
    filled = with_empty_field(result, exact.copy(data=np.angle(np.exp(1j * exact.values))))
    empty = away > 46
    assert abs(np.median(filled.values[:, 0, empty], axis=1)).max() < 0.1
    assert (filled.values[:, 0, mask] == exact.values[:, 0, mask]).all()
