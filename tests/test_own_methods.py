"""Unwrapping methods that an installed package brings."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

import napari_phase4d as p4d
from napari_phase4d.pipeline import find_place, phase_needs, unwrap_by
from napari_phase4d.task import UNWATCHED
from napari_phase4d.unwrapping import (
    BUILT_IN,
    Method,
    Option,
    Problem,
    frame_by_frame,
    registry,
    run_method,
)
from napari_phase4d.unwrapping.registry import WithInstalled

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "phase4d-least-squares"
STORY = """
import numpy as np, napari_phase4d as p4d, json, sys
exact = p4d.simulation.swimming_euglena((64, 80), 4, peak_rad=9)["phase"]
wrapped = np.angle(np.exp(1j * exact)).astype("f4")
found = p4d.compare(wrapped, ["spatial-2d", "least-squares"], truth=exact)
noisy = np.angle(np.exp(1j * (exact + np.random.default_rng(0).normal(0, 0.8, exact.shape))))
raw = p4d.unwrap(noisy, "least-squares", congruent=False)
print(json.dumps({
    "last": list(p4d.METHODS)[-1],
    "labels": [p4d.METHODS[m].label for m in found.table.index],
    "mse": list(found.table["mse_rad2"]),
    "attrs": found.results["least-squares"].attrs["package"],
    "turns": float(abs(np.angle(np.exp(1j * (found.results["least-squares"] - wrapped)))).max()),
    "raw_turns": float(abs(np.angle(np.exp(1j * (raw - noisy)))).max()),
}))
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Install the example as a user would, in a folder of its own."""
    folder = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(folder), str(EXAMPLE)], check=True)
    paths = [str(folder), os.environ.get("PYTHONPATH", "")]
    return os.environ | {"PYTHONPATH": os.pathsep.join(p for p in paths if p)}


def python(environment: dict[str, str], *arguments: str | Path) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, arguments)], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.thorough
@pytest.mark.release
def test_an_installed_method_is_one_of_all(environment: dict[str, str]) -> None:
    found = json.loads(python(environment, "-c", STORY))
    assert found["last"] == "least-squares"
    assert found["labels"] == ["2-D", "LSQ"]
    assert found["attrs"] == "phase4d-least-squares 1.0"
    # Without noise or steep steps both are exact but for a constant of whole turns.
    assert found["mse"][1] < 1e-6
    assert found["turns"] < 1e-5 < 1e-3 < found["raw_turns"]


@pytest.mark.thorough
def test_an_installed_method_on_the_command_line(
    environment: dict[str, str], tmp_path: Path
) -> None:
    exact = p4d.simulation.swimming_euglena((64, 80), 4, peak_rad=9)["phase"]
    p4d.write_phase(tmp_path / "exact.ome.tif", exact)
    wrapped = exact.copy(data=np.angle(np.exp(1j * exact.values)).astype(np.float32))
    p4d.write_phase(tmp_path / "wrapped.ome.tif", wrapped.assign_attrs(units="rad"))
    command = ["-m", "napari_phase4d", "compare", tmp_path / "wrapped.ome.tif"]
    said = python(
        environment, *command, "--truth", tmp_path / "exact.ome.tif", "--out", tmp_path / "out"
    )
    assert "LSQ" in said
    table = (tmp_path / "out" / "table.csv").read_text()
    assert "\nleast-squares,LSQ," in table
    video = p4d.simulation.multiplexed_video(exact)
    np.save(tmp_path / "video.npy", video.holograms.values)
    run = ["-m", "napari_phase4d", "run", tmp_path / "video.npy", "--method", "least-squares"]
    python(environment, *run, "--out", tmp_path / "run")
    recipe = json.loads((tmp_path / "run" / "recipe.json").read_text())
    assert recipe["methods"] == ["least-squares"]
    result = p4d.read_results(tmp_path / "run" / "least-squares.ome.tif")
    assert result.attrs["provenance"]["packages"] == ["phase4d-least-squares 1.0"]


def test_without_the_package_a_recipe_that_names_it_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="method must be one of .*'least-squares'"):
        p4d.Recipe(methods=("least-squares",))


def point(value: str, name: str = "mine") -> EntryPoint:
    return EntryPoint(name, value, registry.GROUP)


GOOD = Method("Mine", "nowhere", "Nothing.", frame_by_frame(lambda wrapped, mask: wrapped))
STREAMS = Method(
    "Streams", "nowhere", "As it is.", frame_by_frame(lambda wrapped, mask: wrapped), streams=True
)
CLASHES = Method("Mine", "nowhere", "Nothing.", GOOD.function, (Option("mask", 1, "Clashes."),))


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        (point("there_is_no_such_module:METHOD"), "mine.* is left out: No module named"),
        (point("exits_on_import:METHOD"), "mine.* is left out: nothing to see here"),
        (point("test_own_methods:NOTHING"), "mine.* is left out: .*no attribute 'NOTHING'"),
        (point("test_own_methods:STORY"), "test_own_methods:STORY is a str, not a Method"),
        (point("test_own_methods:CLASHES"), "an option can't be called 'mask'"),
        (point("test_own_methods:GOOD", "temporal"), "'temporal' .* a method of this id already"),
        (point("test_own_methods:GOOD", "../up"), "an id is made of small letters"),
    ],
)
def test_what_cant_be_used_is_left_out_and_said(
    monkeypatch: pytest.MonkeyPatch, entry: EntryPoint, sentence: str
) -> None:
    points = [entry, point("test_own_methods:GOOD", "z-good")]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    methods = WithInstalled(BUILT_IN)
    with pytest.warns(UserWarning, match=sentence):
        assert list(methods) == [*BUILT_IN, "z-good"]
    assert methods["z-good"].label == "Mine"


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("raise GeneratorExit", "GeneratorExit"),
        ("class Base(BaseException): ...\nraise Base('gone')", "gone"),
        ("raise BaseExceptionGroup('both', [SystemExit()])", "both"),
        ("class Mute(Exception):\n  def __str__(self): raise ValueError\nraise Mute", "Mute"),
        ("import sys\nsys.stdout = None\nmethod = 3", "is a int, not a Method"),
    ],
)
def test_no_way_to_fail_on_import_ends_the_program(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, body: str, why: str
) -> None:
    name = f"fails_{abs(hash(body))}"
    (tmp_path / f"{name}.py").write_text(body)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(registry, "entry_points", lambda group: [point(f"{name}:method")])
    said_on = sys.stdout
    with pytest.warns(UserWarning, match=f"mine.* is left out: .*{why}"):
        assert list(WithInstalled(BUILT_IN)) == list(BUILT_IN)
    assert sys.stdout is said_on


def broken(wrapped: np.ndarray, mask: np.ndarray, *, how: str = "raises") -> object:
    if how == "raises":
        raise ZeroDivisionError
    frames = {"nan": wrapped * np.nan, "shape": wrapped[1:], "text": wrapped.astype("U9")}
    return frames[how]


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ("raises", "ZeroDivisionError"),
        ("nan", "NaN or infinite"),
        ("shape", r"\(8, 9\) came back as float32 \(7, 9\)"),
        ("text", "came back as <U9"),
    ],
)
def test_a_method_that_fails_is_named(
    monkeypatch: pytest.MonkeyPatch, how: str, sentence: str
) -> None:
    options = (Option("how", "raises", "How it fails."),)
    bad = Method("Bad", "nowhere", "Fails.", frame_by_frame(broken), options, package="bad 2.1")
    monkeypatch.setitem(p4d.METHODS._own, "bad", bad)
    wrapped = np.zeros((2, 1, 8, 9), np.float32)
    with pytest.raises(ValueError, match=f"Bad of the package bad 2.1 failed: .*{sentence}"):
        p4d.unwrap(wrapped, "bad", how=how)


def put_into(phase: np.ndarray, where: str) -> Method:
    """Return a method of a package that writes where it may only look."""

    def function(problem: Problem, progress: object, cancelled: object) -> np.ndarray:
        arrays = {
            "wrapped": lambda: problem.wrapped,
            "mask": lambda: problem.mask,
            "amplitude": lambda: problem.amplitude,
            "template": lambda: problem.template.values,
            "spatial": problem.spatial,
            "shifts": problem.shifts,
            "background": lambda: problem.background().level,
        }
        arrays[where]()[...] = 0
        return np.zeros(phase.shape, np.float32)

    return Method("Writes", "nowhere", "Writes.", function, package="bad 2.1")


@pytest.mark.parametrize(
    "where", ["wrapped", "mask", "amplitude", "template", "spatial", "shifts", "background"]
)
def test_a_method_writes_into_nothing_that_others_look_at(
    monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    wrapped = p4d.simulation.swimming_euglena((64, 80), 3, peak_rad=9)["wrapped"].values
    given, amplitude = wrapped.copy(), np.ones_like(wrapped)
    monkeypatch.setitem(p4d.METHODS._own, "writes", put_into(wrapped, where))
    problem = Problem(given, mask="auto", amplitude=amplitude)
    before = run_method(problem, "temporal", UNWATCHED, {})
    with pytest.raises(ValueError, match="Writes of the package bad 2.1 failed: .*read-only"):
        run_method(problem, "writes", UNWATCHED, {})
    np.testing.assert_array_equal(given, wrapped)
    after = run_method(problem, "temporal", UNWATCHED, {})
    np.testing.assert_array_equal(after, before)


def test_a_method_that_finds_the_object_by_itself_does_not_depend_on_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whether the object was found before, for another method, does not change its result."""
    wrapped = p4d.simulation.swimming_euglena((64, 80), 3, peak_rad=9)["wrapped"].values
    whole = Method(
        "Whole", "nowhere", "As it is.", lambda problem, *_: problem.wrapped + 1,
        finds_object=True, package="whole 1.0",
    )  # fmt: skip
    monkeypatch.setitem(p4d.METHODS._own, "whole", whole)
    alone = p4d.unwrap(wrapped, "whole", mask="auto")
    after = p4d.compare(wrapped, ["temporal", "whole"], mask="auto").results["whole"]
    np.testing.assert_array_equal(alone, after)
    np.testing.assert_array_equal(alone, wrapped + 1)


def test_a_method_that_says_it_streams_is_run_on_all_frames_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """How a method goes through blocks on disk is written for each, and only in this program."""
    points = [point("test_own_methods:STREAMS", "streams")]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    methods = WithInstalled(BUILT_IN)
    assert not methods["streams"].streams
    monkeypatch.setitem(p4d.METHODS._own, "streams", methods["streams"])
    wrapped = p4d.simulation.swimming_euglena((48, 64), 3, peak_rad=3)["wrapped"]
    recipe = p4d.Recipe(methods=("streams",), mask=None)
    in_memory = unwrap_by(recipe, wrapped)
    needs = phase_needs(recipe.methods, wrapped.shape)
    place = find_place(recipe.changed(storage="disk"), needs)
    on_disk = unwrap_by(recipe, wrapped, place=place)
    place.close()
    np.testing.assert_array_equal(on_disk.results["streams"], in_memory.results["streams"])


def test_levels_go_from_frame_to_frame_as_those_of_the_program() -> None:
    """A frame-wise method that leaves whole turns open agrees with 2-D where both are right."""
    exact = p4d.simulation.swimming_euglena((64, 80), 6, peak_rad=9)["phase"]
    drift = exact + 0.9 * np.arange(6).reshape(6, 1, 1, 1)  # the border rises by 4.5 rad
    wrapped = np.angle(np.exp(1j * drift)).astype("f4")
    turns = iter(np.random.default_rng(0).integers(-3, 4, 12))

    def own(frame: np.ndarray, mask: np.ndarray) -> np.ndarray:
        return p4d.unwrap(frame, "spatial-2d").values + 2 * np.pi * next(turns)

    problem = p4d.unwrapping.Problem(wrapped)
    found = frame_by_frame(own)(problem, None, None)
    np.testing.assert_allclose(found, p4d.unwrap(wrapped, "spatial-2d").values, atol=1e-5)
