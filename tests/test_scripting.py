"""A run as a Python script: always Python, the same recipe, the same arrays to the last bit."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import random
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import tifffile
import xarray as xr

import napari_phase4d as p4d
from helpers import command, run_script
from napari_phase4d.holography import BACKGROUND_ORDERS, WINDOWS, Lobe
from napari_phase4d.pipeline import Outcome, Recipe, found_anywhere, open_by, write_outcome
from napari_phase4d.recording import Recording
from napari_phase4d.sample import Sample, yeast_sample
from napari_phase4d.scripting import WORDS, as_python

NASTY = (
    "C:\\new\\table.tif", "it's \"here\".tif", "zelle_äöü_細胞.tif", 'a"b.npy', "a'b.npy",
    "\\", "two\nlines.tif", "{braces} %s.tif", "\u200bhidden.tif", "sample:euglena",
    "'''", '"""',
)  # fmt: skip


def random_recipe(seed: int) -> Recipe:
    """A recipe with some of its settings set to anything that they can be."""
    rng = random.Random(seed)

    def number(low: float, high: float) -> float:
        return rng.choice([rng.uniform(low, high), round(rng.uniform(low, high), 2)])

    def lobe() -> Lobe:
        carrier = (number(-0.5, 0.5), number(-0.5, 0.5))
        return Lobe(carrier, number(0.01, 0.5), number(-90, 90), flip=rng.random() < 0.5)

    methods = rng.sample(list(p4d.METHODS), rng.randint(0, len(p4d.METHODS)))
    options = {
        m: {
            o.name: rng.choice(o.choices) if o.choices else o.default
            for o in p4d.METHODS[m].options
            if rng.random() < 0.6
        }
        for m in rng.sample(list(p4d.METHODS), rng.randint(0, 4))
    }
    settings = {
        "dataset": rng.choice(NASTY),
        "content": rng.choice(["holograms", "phase"]),
        "optics": p4d.Optics(number(0.3, 1), number(1, 10), number(1, 100), number(1, 1.6)),
        "frame_rate_hz": rng.choice([number(0.1, 1e4), 1e-300, 1e300]),
        "n_views": rng.randint(1, 6),
        "angles_deg": tuple(number(-90, 90) for _ in range(rng.randint(0, 6))),
        "lobes": tuple(lobe() for _ in range(rng.randint(0, 4))),
        "reference": rng.choice([None, 0, 7, "median", *NASTY]),
        "window": rng.choice(list(WINDOWS)),
        "background": rng.choice(list(BACKGROUND_ORDERS)),
        "drift": False,
        "mask": None,
        "boundary": tuple(
            (rng.randint(-5, 400), rng.randint(-1, 3)) for _ in range(rng.randint(1, 30))
        ),
        "methods": tuple(methods),
        "options": options,
        "confidence": True,
    }
    chosen = {name: value for name, value in settings.items() if rng.random() < 0.5}
    return Recipe(recording=rng.choice(NASTY), **chosen)


def recipe_in(script: str) -> Recipe:
    """The recipe that a script makes, which its other lines are not needed for."""
    made = next(
        node for node in ast.parse(script).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "recipe"
    )  # fmt: skip
    found = eval(compile(ast.Expression(made.value), "script", "eval"), {"p4d": p4d})
    assert isinstance(found, Recipe)
    return found


@pytest.mark.slow
def test_any_recipe_comes_back_equal() -> None:
    for seed in range(300):
        recipe = random_recipe(seed)
        script = as_python(recipe, folder=NASTY[seed % len(NASTY)])
        assert recipe_in(script) == recipe, seed
        assert repr(recipe_in(script)) == repr(recipe), seed  # 1 is not 1.0, 0.0 is not -0.0


def test_only_what_matters_is_written() -> None:
    script = as_python(Recipe(recording="a.tif"))
    made = next(n for n in ast.walk(ast.parse(script)) if isinstance(n, ast.Call)
                and ast.unparse(n.func) == "p4d.Recipe")  # fmt: skip
    assert [k.arg for k in made.keywords] == ["recording", "boundary", "methods"]
    lines = [k.value.lineno for k in made.keywords]
    assert len(set(lines)) == 3


def test_every_setting_is_said_in_words() -> None:
    assert list(WORDS) == list(Recipe.model_fields)
    script = as_python(random_recipe(3).changed(methods=tuple(p4d.METHODS)))
    for method in p4d.METHODS.values():
        assert method.label in script


def test_scripts_are_as_a_formatter_would_have_them(tmp_path: Path) -> None:
    for seed in range(60):
        recipe = random_recipe(seed).changed(
            recording="a.tif", dataset=None, reference=None, frame_rate_hz=6.0
        )
        script = as_python(recipe)
        assert max(map(len, script.splitlines())) <= 99
        (tmp_path / f"script_{seed}.py").write_text(script, encoding="utf-8")
    if importlib.util.find_spec("ruff") is None:
        pytest.skip("ruff is not installed")
    ruff = [sys.executable, "-m", "ruff", "format", "--check", "--isolated", "--line-length", "99"]
    found = subprocess.run([*ruff, tmp_path], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout


def test_files_are_named_with_their_whole_path(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "video.tif").touch()
    (tmp_path / "empty.tif").touch()
    monkeypatch.chdir(tmp_path)
    found = recipe_in(as_python(Recipe(recording="video.tif", reference="empty.tif")))
    assert Path(found.recording) == (tmp_path / "video.tif").resolve()
    assert Path(str(found.reference)) == (tmp_path / "empty.tif").resolve()
    for name in ("missing.tif", "sample:yeast", "", "a" * 5000, "\0"):
        assert found_anywhere(name) == name


def test_frames_in_memory_make_no_script(small_video: Recording) -> None:
    outcome = p4d.run(Recipe(methods=("spatial-2d",)), small_video)
    with pytest.raises(ValueError, match="in no file, only in memory.*save the recording first"):
        as_python(outcome.recipe)


def script_of(recipe: Recipe, folder: Path) -> Path:
    script = folder / "script.py"
    script.write_text(as_python(recipe, folder="results"), encoding="utf-8")
    return script


def saved_by_script(recipe: Recipe, folder: Path) -> Path:
    """Run the script of a recipe; return where it saved."""
    run_script(script_of(recipe, folder))
    return folder / "results"


def assert_the_same(outcome: Outcome, saved: Path) -> None:
    """Hold every saved array and coordinate against a run in this process."""
    stacks = {"wrapped": outcome.reconstruction["phase"], **outcome.comparison.results}
    if "amplitude" in outcome.reconstruction:
        stacks["amplitude"] = outcome.reconstruction["amplitude"]
    if outcome.recipe.confidence:
        for method in outcome.comparison.results:
            stacks[f"confidence_{method}"] = outcome.comparison.confidence(method)
    assert {p.name for p in saved.iterdir()} - {"run.json"} == {
        *(f"{name}.ome.tif" for name in stacks), "table.csv", "recipe.json",
    }  # fmt: skip
    for name, expected in stacks.items():
        found = p4d.read_results(saved / f"{name}.ome.tif")
        assert found.dtype == np.float32
        assert found.dims == expected.dims
        assert found.values.tobytes() == expected.values.tobytes(), name
        for axis in expected.dims:
            assert found[axis].values.tobytes() == expected[axis].values.tobytes(), (name, axis)
    assert Recipe.from_file(saved / "recipe.json") == outcome.recipe
    table = pd.read_csv(saved / "table.csv", index_col="id")
    assert list(table["method"]) == list(outcome.comparison.table["method"])


@pytest.mark.thorough
@pytest.mark.slow
def test_script_of_the_sample(tmp_path: Path) -> None:
    recipe = Recipe(
        recording="sample:euglena", angles_deg=(-7.0, 21.0),
        methods=("spatial-2d", "temporal-angular", "directional-l1"),
    )  # fmt: skip
    outcome = p4d.run(recipe)
    # With the lobes that were found, as a window has them; where nothing but the script is.
    script = script_of(outcome.recipe, tmp_path)
    done = subprocess.run(
        [sys.executable, script.name], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert not done.stderr
    assert_the_same(outcome, tmp_path / "results")


@pytest.mark.slow
def test_script_of_the_sample_phase(tmp_path: Path) -> None:
    recipe = Recipe(recording="sample:yeast", methods=("temporal",), confidence=True)
    outcome = p4d.run(recipe)
    np.testing.assert_array_equal(outcome.reconstruction["phase"], yeast_sample()["wrapped"])
    assert_the_same(outcome, saved_by_script(recipe, tmp_path))


@pytest.mark.slow
def test_script_of_a_video_with_its_microscope_and_a_reference(
    tmp_path: Path, small_video: Recording
) -> None:
    frames = small_video.holograms.values
    video = tmp_path / 'frames of "Zelle ä".tif'
    tifffile.imwrite(
        video, frames, imagej=True, resolution=(4, 4),
        metadata={"axes": "TYX", "unit": "um", "finterval": 0.3},
    )  # fmt: skip
    tifffile.imwrite(tmp_path / "reference.tif", frames[0])
    recipe = Recipe(
        recording=str(video), optics=p4d.Optics(0.633, 5.2, 1 / 0.3, 1.337), frame_rate_hz=1 / 0.7,
        angles_deg=(-0.1, 0.2), reference=str(tmp_path / "reference.tif"), window="gaussian",
        background="curvature", drift=False, boundary=((1, 0), (-1, 1)),
        methods=("angular-temporal", "region-growing"),
        options={"angular-temporal": {"registration": False, "split": False}},
    )  # fmt: skip
    outcome = p4d.run(recipe)
    lobes = tuple(replace(lobe, flip=True) for lobe in outcome.recipe.lobes)
    outcome = p4d.run(outcome.recipe.changed(lobes=lobes))
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    assert_the_same(outcome, saved_by_script(outcome.recipe, folder))


@pytest.mark.filterwarnings("ignore:.*median over time shows:UserWarning")
@pytest.mark.slow
def test_script_of_one_array_of_a_file(tmp_path: Path, small_video: Recording) -> None:
    frames = small_video.holograms.values
    path = tmp_path / "several.npz"
    np.savez(path, frames=frames[::-1], second=frames[:, :, ::-1].astype(np.float64))
    recipe = Recipe(
        recording=str(path), dataset="second", reference="median", mask=None,
        methods=("directional-l1", "spatial-2d"), confidence=True,
        options={"spatial-2d": {"reliability": "coherence"}},
    )  # fmt: skip
    outcome = p4d.run(recipe)
    np.testing.assert_array_equal(outcome.recording.holograms, frames[:, :, ::-1])
    # Without lobes, so that the script finds them anew.
    assert_the_same(outcome, saved_by_script(recipe, tmp_path))


@pytest.mark.thorough
@pytest.mark.slow
def test_script_of_phase_with_gaps(tmp_path: Path) -> None:
    wrapped = yeast_sample()["wrapped"].values.copy()
    wrapped[:, :, :5, :9] = np.nan
    path = tmp_path / "phase.npy"
    np.save(path, wrapped)
    recipe = Recipe(
        recording=str(path), content="phase", angles_deg=(0, 5.5, 10, 15, 20, 25),
        optics=p4d.Optics(magnification=26), frame_rate_hz=1 / 60, mask=None,
        methods=("temporal-angular", "dilate-erode"),
        options={"dilate-erode": {"max_window": 2}},
    )  # fmt: skip
    assert_the_same(p4d.run(recipe), saved_by_script(recipe, tmp_path))


@pytest.mark.slow
def test_sample_runs_from_the_command_line(tmp_path: Path) -> None:
    recipe = Recipe(recording="sample:yeast", methods=("angular",))
    recipe.to_file(tmp_path / "yeast.json")
    done = command("run", "yeast.json", "--out", "results", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert_the_same(p4d.run(recipe), tmp_path / "results")


@pytest.mark.thorough
def test_samples_are_the_same_in_every_process(sample: Sample) -> None:
    code = (
        "import hashlib\n"
        "from napari_phase4d.pipeline import Recipe, open_by\n"
        "for name in ('holograms', ''):\n"
        "    found = open_by(Recipe(recording='sample:euglena' if name else 'sample:yeast'))\n"
        "    values = getattr(found, name) if name else found\n"
        "    print(hashlib.sha256(values.values.tobytes()).hexdigest())\n"
    )
    here = [sample.recording.holograms, yeast_sample()["wrapped"]]
    expected = [hashlib.sha256(stack.values.tobytes()).hexdigest() for stack in here]
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert found.stdout.split() == expected


@pytest.mark.thorough
def test_samples_are_opened_by_name(sample: Sample) -> None:
    recording = sample.recording
    assert recording.source == "sample:euglena"
    optics = p4d.Optics(magnification=40)
    other = open_by(Recipe(recording="sample:euglena", optics=optics, frame_rate_hz=3))
    assert isinstance(other, Recording)
    assert (other.optics, other.frame_rate_hz, other.source) == (optics, 3, recording.source)
    np.testing.assert_array_equal(other.holograms.values, recording.holograms.values)
    # What a window notes of the recording gives the same times again.
    noted = Recipe(recording=recording.source, optics=recording.optics, frame_rate_hz=6.0)
    assert recording.frame_rate_hz == 6.0
    xr.testing.assert_identical(open_by(noted).holograms, recording.holograms)
    phase = open_by(Recipe(recording="sample:yeast"))
    assert isinstance(phase, xr.DataArray)
    assert phase.attrs["source"] == "sample:yeast"
    with pytest.raises(
        ValueError, match="no sample 'sample:cat'.*sample:euglena, sample:cells, sample:yeast"
    ):
        open_by(Recipe(recording="sample:cat"))


@pytest.mark.thorough
@pytest.mark.slow
def test_outcome_is_written_with_truth_and_trust(tmp_path: Path) -> None:
    data = yeast_sample()
    recipe = Recipe(recording="sample:yeast", methods=("temporal",), confidence=True)
    outcome = p4d.run(recipe, truth=data["phase"].transpose("y", "x", "angle", "time"))
    written = write_outcome(outcome, tmp_path)
    names = {"wrapped", "temporal", "exact", "confidence_temporal"}
    assert {p.name for p in written} == {
        *(f"{name}.ome.tif" for name in names), "table.csv", "recipe.json",
    }  # fmt: skip
    exact = p4d.read_results(tmp_path / "exact.ome.tif")
    np.testing.assert_array_equal(exact.values, data["phase"].values)
    assert exact.attrs["exact"] is True
    for axis in exact.dims:
        np.testing.assert_array_equal(exact[axis], data["phase"][axis])
    table = pd.read_csv(tmp_path / "table.csv", index_col="id")
    assert table.loc["temporal", "mse_rad2"] == pytest.approx(
        outcome.comparison.table.loc["temporal", "mse_rad2"]
    )
    assert 0 <= table.loc["temporal", "doubtful_percent"] <= 100
    for name in names:  # as another program reads them
        with tifffile.TiffFile(tmp_path / f"{name}.ome.tif") as tif:
            image = tifffile.xml2dict(tif.ome_metadata)["OME"]["Image"]
            assert tif.series[0].axes == "TCYX"
        pixels = image["Pixels"]
        assert pixels["PhysicalSizeX"] == pytest.approx(0.2)
        assert pixels["PhysicalSizeXUnit"] == "µm"
        assert (pixels["TimeIncrement"], pixels["TimeIncrementUnit"]) == (60, "s")
        assert [c["Name"] for c in pixels["Channel"]][:2] == ["view 0 deg", "view 5 deg"]
