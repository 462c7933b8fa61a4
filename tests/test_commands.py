"""The command line: what it writes, where it stops, and in which words."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import napari_phase4d as p4d
from napari_phase4d.cli import app, main
from napari_phase4d.cli.options import raw_layout, recipe_and_files, with_settings
from napari_phase4d.io import write_phase

RECIPE = p4d.Recipe(methods=("spatial-2d", "temporal-angular"), mask=None)


def told(*arguments: object) -> str:
    """Return what a command prints."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None:
        raise result.exception
    return result.output


def refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: object
) -> str:
    """Return the sentence with which a command ends."""
    monkeypatch.setattr(sys, "argv", ["napari-phase4d", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1
    return capsys.readouterr().err


@pytest.fixture
def phase_file(tmp_path: Path) -> Path:
    data = p4d.simulation.budding_yeast((16, 16), n_times=3, angles_deg=(0.0, 5.0))
    np.save(tmp_path / "phase.npy", data["wrapped"].values)
    return tmp_path / "phase.npy"


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.slow
def test_compare_of_stacks_on_disk_writes_everything(phase_file: Path, tmp_path: Path) -> None:
    recipe = RECIPE.changed(storage="disk").to_file(tmp_path / "recipe.json")
    out = tmp_path / "out"
    words = told("compare", recipe, phase_file, "--out", out)
    results = {"wrapped.ome.zarr", "spatial-2d.ome.zarr", "temporal-angular.ome.zarr"}
    assert names(out) == results | {"table.csv", "recipe.json", "run.json", "comparison.png"}
    assert "Steps beyond half a cycle" in words


@pytest.mark.slow
def test_compare_writes_results_before_it_looks_at_all_frames(
    phase_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stack = sys.modules["napari_phase4d.stack"]
    monkeypatch.setattr(stack, "COPIES", 10**12)  # as if there were too little memory
    recipe = RECIPE.changed(storage="disk").to_file(tmp_path / "recipe.json")
    words = told("compare", recipe, phase_file, "--out", tmp_path / "out")
    assert "this looks at all frames at once" in words
    assert {"temporal-angular.ome.zarr", "comparison.png"} <= names(tmp_path / "out")


@pytest.mark.parametrize("command", ["run", "compare"])
def test_folder_that_is_a_file_is_one_sentence(
    phase_file: Path,
    tmp_path: Path,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "afile").write_text("no folder")
    line = (command, phase_file, "--method", "spatial-2d", "--out", tmp_path / "afile")
    said = refused(monkeypatch, capsys, *line)
    assert f"the folder {tmp_path / 'afile'} can't be made" in said
    assert "Errno" not in said


def test_missing_package_is_one_sentence(
    phase_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    line = ("run", phase_file, "--scheduler", "tcp://127.0.0.1:1", "--out", tmp_path / "out")
    said = refused(monkeypatch, capsys, *line)
    assert said.startswith("Error: a cluster needs one more package; run: pip install")


@pytest.mark.slow
def test_too_little_memory_is_one_sentence(
    phase_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def greedy(*_: Any, **__: Any) -> None:
        raise MemoryError

    monkeypatch.setattr(sys.modules["napari_phase4d.cli.look"], "scores_of_some", greedy)
    said = refused(monkeypatch, capsys, "info", phase_file)
    assert said == "Error: it needs more memory than there is\n"


@pytest.mark.thorough
def test_info_says_the_needs_before_it_looks_at_few_times(tmp_path: Path) -> None:
    data = p4d.simulation.budding_yeast((16, 16), n_times=3, angles_deg=(0.0, 5.0))["wrapped"]
    times = np.arange(103) % 3
    long = data.isel(time=times).assign_coords(time=np.arange(103.0))
    long[100:] = np.random.default_rng(0).uniform(-3, 3, (3, 2, 16, 16))  # full of residues
    write_phase(tmp_path / "wrapped.ome.zarr", long)
    words = told("info", tmp_path / "wrapped.ome.zarr")
    first = int(abs(p4d.analysis.residues(long[:100])).sum())
    assert f"{first} residues of the first 100 times" in words
    assert words.index("What a run needs") < words.index("residues")
    assert "103 times, 2 views" in words


def test_recipes_are_told_by_their_ending_in_any_case(tmp_path: Path) -> None:
    path = RECIPE.to_file(tmp_path / "RECIPE.JSON")
    recipe, files = recipe_and_files([path, Path("a.npy")])
    assert (recipe, files) == (RECIPE, [Path("a.npy")])


@pytest.mark.parametrize(("order", "large_first"), [("", False), ("<", False), (">", True)])
def test_raw_frames_of_either_byte_order(tmp_path: Path, order: str, large_first: bool) -> None:
    frames = np.arange(2 * 8 * 9).reshape(2, 8, 9) * 300
    frames.astype(">u2" if large_first else "<u2").tofile(tmp_path / "a.raw")
    layout = raw_layout(f"8,9,{order}uint16,0")
    found = p4d.open_recording(tmp_path / "a.raw", raw=layout)
    np.testing.assert_array_equal(np.asarray(found.holograms), frames)
    with pytest.raises(ValueError, match="--raw takes HEIGHT,WIDTH,TYPE,HEADER"):
        raw_layout("8,9,=uint16,0")


@pytest.mark.slow
def test_wrapped_phase_that_is_the_input_stays_as_it_is(phase_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for form, ending in (("zarr", "zarr"), ("tiff", "tif")):
        told("run", phase_file, "--method", "spatial-2d", "--form", form, "--out", out)
        wrapped = out / f"wrapped.ome.{ending}"
        before = contents(wrapped)
        told("run", wrapped, "--method", "temporal-angular", "--form", form, "--out", out)
        assert contents(wrapped) == before
        found = p4d.read_results(out / f"temporal-angular.ome.{ending}")
        assert found.attrs["provenance"]["input"]["name"] == wrapped.name
        assert isinstance(found, xr.DataArray)


def contents(path: Path) -> dict[Path, tuple[bytes, int]]:
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    return {p: (p.read_bytes(), p.stat().st_mtime_ns) for p in files}


@pytest.mark.thorough
def test_the_demo_without_qt_says_what_to_install(tmp_path: Path) -> None:
    """Where no binding can be imported, as in an environment that has none."""
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['PyQt6', 'PySide6', 'PyQt5', 'PySide2'])); "
        f"sys.argv = ['p', 'demo', '--headless', '--out', {str(tmp_path / 'out')!r}]; "
        "from napari_phase4d.cli import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("Error: the demo opens napari's window")
    assert 'pip install "napari-phase4d[all]"' in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_an_empty_word_is_refused(
    phase_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(phase_file.parent)
    for words in (("run", phase_file, "--out", ""), ("benchmark", "--out="), ("info", ""), ("",)):
        assert "is empty; was a variable" in refused(monkeypatch, capsys, *words)
    assert names(phase_file.parent) == {"phase.npy"}


@pytest.mark.thorough
@pytest.mark.skipif(os.name != "posix", reason="names of files hold no such letters")
@pytest.mark.parametrize("name", ["red\x1b[31m.npy", "two\nlines.npy", "bell\x07.npy"])
def test_names_can_not_speak_to_the_terminal(phase_file: Path, name: str) -> None:
    strange = phase_file.rename(phase_file.with_name(name))
    out = strange.parent / "out"
    for words in (("info", strange), ("run", strange, "--out", out, "--method", "spatial-2d")):
        command = [sys.executable, "-m", "napari_phase4d", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        for printed in (done.stdout, done.stderr):
            assert not set(printed) & {"\x1b", "\x07"}
        if words[0] == "info":
            assert done.stdout.splitlines()[0] == name.encode("unicode_escape").decode()
    strange.unlink()
    done = subprocess.run([*command[:3], "info", strange], capture_output=True, text=True)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.thorough
def test_doubts_are_said_in_words(tmp_path: Path) -> None:
    degrees = np.linspace(-179, 179, 4 * 2 * 24 * 32).reshape(4, 2, 24, 32)
    np.save(tmp_path / "phase.npy", degrees)
    command = ["-m", "napari_phase4d", "run", tmp_path / "phase.npy", "--boundary", "0,0"]
    done = subprocess.run(
        [sys.executable, *command, "--method", "spatial-2d", "--out", tmp_path / "out"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0
    said = " ".join(done.stderr.split())
    assert said.count("as degrees do; give radians, with numpy.deg2rad(phase)") == 1
    assert "UserWarning" not in said


def test_angles_and_wavelengths_that_are_typed_in_go_to_the_lobes_of_a_recipe() -> None:
    lobes = (p4d.Lobe((0.2, 0.1), 0.08, 0), p4d.Lobe((0.1, 0.2), 0.08, 1))
    recipe = p4d.Recipe(recording="sample:euglena", lobes=lobes, boundary=(0, 1))
    named = with_settings(recipe, angle=[-7, 21], view_wavelength=[0.5, 0.6], views=2)
    assert [(lobe.angle_deg, lobe.wavelength_um) for lobe in named.lobes] == [(-7, 0.5), (21, 0.6)]
    assert [lobe.carrier for lobe in named.lobes] == [lobe.carrier for lobe in lobes]
    assert with_settings(recipe, frame_rate=3.0).lobes == lobes
    for typed in ({"views": 1}, {"angle": [1, 2, 3]}, {"view_wavelength": [0.5]}):
        with pytest.raises(ValueError, match=r"asks for \d views?, but the recipe has 2 lobes"):
            with_settings(recipe, **typed)
    # The second view would become the first, in which the boundary frame lies.
    with pytest.raises(ValueError, match="give --boundary too"):
        with_settings(recipe, angle=[5, -5])
    alike = recipe.changed(lobes=tuple(replace(b, angle_deg=3) for b in named.lobes))
    with pytest.raises(ValueError, match="give --boundary too"):
        with_settings(alike, view_wavelength=[0.6, 0.5])
    turned = with_settings(recipe, angle=[5, -5], boundary="0,0")
    assert [lobe.angle_deg for lobe in turned.lobes] == [5, -5]
    assert turned.boundary == ((0, 0),)


@pytest.mark.parametrize(("typed", "left"), [(None, True), (True, True), (False, False)])
def test_no_confidence_takes_back_what_a_recipe_asks_for(typed: bool | None, left: bool) -> None:
    recipe = p4d.Recipe(confidence=True)
    assert with_settings(recipe, confidence=typed).confidence is left


def test_resume_with_the_file_of_a_recipe_makes_a_batch(phase_file: Path, tmp_path: Path) -> None:
    recipe = RECIPE.changed(recording=str(phase_file), methods=("spatial-2d",))
    line = ("run", recipe.to_file(tmp_path / "recipe.json"), "--resume", "--out", tmp_path / "out")
    assert "summary" in told(*line)
    result = tmp_path / "out" / "phase" / "spatial-2d.ome.tif"
    before = result.stat().st_mtime_ns
    told(*line)
    assert result.stat().st_mtime_ns == before


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "compare"])
def test_what_needs_holograms_is_not_noted_of_phase(
    phase_file: Path, tmp_path: Path, command: str
) -> None:
    words = ["--method", "2-D", "--refocus", "12", "--tilt-per-frame", "--out", tmp_path / "out"]
    with pytest.warns(UserWarning, match="refocusing and taking .* need holograms"):
        told(command, phase_file, *words)
    used = p4d.Recipe.from_file(tmp_path / "out" / "recipe.json")
    assert used.refocus_um is None
    assert not used.tilt_per_frame


@pytest.mark.slow
def test_info_says_that_a_file_of_phase_has_its_own_views(phase_file: Path) -> None:
    with pytest.warns(UserWarning, match="has 2 views, whatever --views says"):
        told("info", phase_file, "--views", 3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:no cells were found")
def test_a_file_takes_the_place_of_the_sample_of_a_recipe(
    phase_file: Path, tmp_path: Path
) -> None:
    """Its angles are those of beams then."""
    recipe = RECIPE.changed(recording="sample:cells", methods=("spatial-2d",))
    recipe.to_file(tmp_path / "recipe.json")
    line = ("run", tmp_path / "recipe.json", phase_file, "--angle", 0, "--angle", 5, "--cells")
    told(*line, "--wavelength", 0.633, "--out", tmp_path / "out")
    used = p4d.Recipe.from_file(tmp_path / "out" / "recipe.json")
    assert used.cells is not None
    assert used.cells.oblique


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "file"),
    [
        (("reproduce", "--no-movies"), "table.csv"),
        (("reproduce",), "figure_2.png"),
        (("demo", "--headless"), "comparison.png"),
        (("demo", "--headless"), "window.png"),
    ],
)
def test_demo_and_reproduction_write_over_nothing(
    line: tuple[str, ...],
    file: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / file).write_text("mine")
    said = refused(monkeypatch, capsys, *line, "--out", tmp_path)
    assert f"{file} is there already and was not made by a run" in said
    assert (tmp_path / file).read_text() == "mine"


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 1, 8, 9), (1, 1, 1, 1)])
def test_of_one_frame_no_order_is_advised(shape: tuple[int, ...], tmp_path: Path) -> None:
    frame = np.random.default_rng(0).uniform(-1, 1, shape).astype(np.float32)
    np.save(tmp_path / "one.npy", frame)
    words = told("compare", tmp_path / "one.npy", "--method", "2-D", "--out", tmp_path / "out")
    assert "there is no order to choose" in words
    assert "run T/A" not in words
    assert "on their way" not in words
    assert ("There is but one pixel" in words) == (shape[2:] == (1, 1))
