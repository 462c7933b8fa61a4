"""Runs that start from the safest frame, and say which that was."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import napari_phase4d as p4d
from napari_phase4d.cli import app
from napari_phase4d.io import read_results, write_phase
from napari_phase4d.pipeline import run_batch, unwrap_by, write_outcome
from napari_phase4d.scripting import as_python
from napari_phase4d.simulation import moving_shape, with_noise

METHODS = ("temporal-angular", "angular-temporal")


def backwards(name: str, seed: int = 1) -> xr.DataArray:
    """A cell that is thick first and thin last, so that the first frame is no good start."""
    data = with_noise(moving_shape(name, (48, 48), 8), 0.2, seed=seed)["wrapped"]
    return data.copy(data=data.values[::-1].copy())


def told(*arguments: object) -> str:
    """What a command prints, in one line."""
    found = CliRunner().invoke(app, [str(part) for part in arguments])
    assert found.exit_code == 0, found.output
    return " ".join(found.output.split())


@pytest.fixture
def phase_file(tmp_path: Path) -> Path:
    return write_phase(tmp_path / "phase.ome.tif", backwards("swelling"))


@pytest.mark.slow
def test_the_default_takes_the_star(phase_file: Path) -> None:
    recipe = p4d.Recipe(recording=str(phase_file), methods=METHODS)
    assert recipe.boundary == "auto"
    outcome = p4d.run(recipe)
    phase = outcome.reconstruction["phase"]
    best = tuple(p4d.score_boundaries(phase).attrs["best"])
    assert best[0] == 7  # where the cell is thin
    assert outcome.recipe.boundary == (best,)
    expected = p4d.compare(phase, METHODS, best, mask="auto").results
    for method in METHODS:
        result = outcome.comparison.results[method]
        np.testing.assert_array_equal(result.values, expected[method].values)
        assert result.attrs["boundary"] == [list(best)]
        assert result.attrs["boundary_found_by"] == outcome.scores.attrs["basis"]


@pytest.mark.slow
def test_unwrapping_by_a_recipe_finds_the_start_too(phase_file: Path) -> None:
    recipe = p4d.Recipe(recording=str(phase_file), methods=METHODS[:1])
    outcome = p4d.run(recipe)
    found = unwrap_by(recipe, outcome.reconstruction["phase"]).results["temporal-angular"]
    xr.testing.assert_identical(found, outcome.comparison.results["temporal-angular"])


def test_a_named_frame_is_kept(phase_file: Path) -> None:
    recipe = p4d.Recipe(recording=str(phase_file), methods=METHODS, boundary=((0, 1),))
    outcome = p4d.run(recipe)
    assert outcome.recipe.boundary == ((0, 1),)
    assert outcome.scores is None
    assert "boundary_found_by" not in outcome.comparison.results["temporal-angular"].attrs


@pytest.mark.slow
def test_what_is_written_names_the_frame_and_makes_the_same_arrays(
    phase_file: Path, tmp_path: Path
) -> None:
    outcome = p4d.run(p4d.Recipe(recording=str(phase_file), methods=METHODS))
    write_outcome(outcome, tmp_path / "one")
    (frame,) = outcome.recipe.boundary
    recipe = p4d.Recipe.from_file(tmp_path / "one" / "recipe.json")
    assert recipe.boundary == (frame,)
    again = p4d.run(recipe)
    for method in METHODS:
        written = read_results(tmp_path / "one" / f"{method}.ome.tif")
        found = written.attrs["provenance"]
        assert found["boundary"] == [list(frame)]
        assert found["boundary_found_by"] == "the frame alone and all frames together (WL1)"
        np.testing.assert_array_equal(again.comparison.results[method].values, written.values)


@pytest.mark.slow
def test_a_run_on_disk_starts_where_one_in_memory_does(phase_file: Path, tmp_path: Path) -> None:
    recipe = p4d.Recipe(recording=str(phase_file), methods=METHODS)
    in_memory = p4d.run(recipe)
    on_disk = p4d.run(recipe.changed(storage="disk"), folder=tmp_path / "disk")
    assert on_disk.recipe.boundary == in_memory.recipe.boundary
    for method, result in in_memory.comparison.results.items():
        xr.testing.assert_identical(on_disk.comparison.results[method].compute(), result)


@pytest.mark.slow
def test_every_file_of_a_batch_has_its_own_star_also_when_resumed(tmp_path: Path) -> None:
    files = [
        write_phase(tmp_path / "late.ome.tif", backwards("swelling")),
        write_phase(tmp_path / "early.ome.tif", backwards("swelling")[::-1].assign_coords(
            time=np.arange(8.0))),
    ]  # fmt: skip
    recipe = p4d.Recipe(methods=("temporal-angular",))
    out = tmp_path / "out"
    table = run_batch(recipe, files, out)
    starts = [
        p4d.Recipe.from_file(out / folder / "recipe.json").start_frames[0]
        for folder in table["folder"]
    ]
    assert [time for time, _ in starts] == [7, 0]
    assert list(table["boundary"]) == [f"{t},{a}" for t, a in starts]
    asked = json.loads((out / table["folder"][1] / "run.json").read_text())["asked"]
    assert asked["recipe"]["boundary"] == "auto"
    again = run_batch(recipe, files, out, resume=True)
    assert list(again["status"]) == ["complete already"] * 2
    assert list(again["boundary"]) == list(table["boundary"])
    named = run_batch(recipe.changed(boundary=((0, 0),)), files, out, resume=True)
    assert list(named["status"]) == ["done"] * 2


@pytest.mark.thorough
def test_commands_take_auto_or_a_frame_and_say_which(phase_file: Path) -> None:
    line = ("run", phase_file, "--method", "temporal-angular", "--out", phase_file.parent / "out")
    for more in ((), ("--boundary", "auto")):
        assert "Start: safest frame, time 7, angle" in told(*line, *more)
        assert "(found automatically)" in told(*line, *more)
    assert "Start: time 2, angle 1, counted from 0 (chosen)." in told(*line, "--boundary", "2,1")
    assert "time 7, angle" in told("compare", *line[1:])


@pytest.mark.slow
def test_script_starts_from_the_same_frame(phase_file: Path) -> None:
    recipe = p4d.Recipe(recording=str(phase_file), methods=METHODS[:1])
    assert 'boundary="auto"' in as_python(recipe)
    outcome = p4d.run(recipe)
    (frame,) = outcome.recipe.boundary
    assert f"boundary=({frame},)" in as_python(outcome.recipe)


def test_recipes_say_what_a_boundary_can_be() -> None:
    with pytest.raises(ValueError, match="boundary"):
        p4d.Recipe().changed(boundary="first")
    with pytest.raises(ValueError, match="has not been looked for"):
        _ = p4d.Recipe().start_frames
    assert p4d.Recipe(boundary=((1, 0),)).start_frames == ((1, 0),)
