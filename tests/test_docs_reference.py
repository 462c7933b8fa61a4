"""The reference of the site is whole, and says what the program says."""

from __future__ import annotations

import importlib
import inspect
import json
import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import napari_phase4d as p4d
from napari_phase4d.cli.app import app

pytest.importorskip("sphinx", reason="the group 'docs' is not installed")

DOCS = Path(__file__).resolve().parents[1] / "docs"
REFERENCE = DOCS / "reference"
ROOMS = (
    "unwrapping", "holography", "analysis", "plotting", "simulation", "io", "pipeline",
    "benchmark", "scripting", "optics", "recording",
)  # fmt: skip


@pytest.fixture
def extension(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Import a module of docs/_ext."""
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    return importlib.import_module


@pytest.fixture(scope="module")
def sentences() -> list[Any]:
    """Return all sentences of the page."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS / "_ext"))
        return list(importlib.import_module("sentences").all_sentences())


def public_names() -> set[str]:
    """Return all public names; what is also a name of the package itself goes by that one."""
    top = {f"napari_phase4d.{name}": getattr(p4d, name) for name in p4d.__all__}
    del top["napari_phase4d.simulation"]
    names = set(top)
    for room in ROOMS:
        module = importlib.import_module(f"napari_phase4d.{room}")
        for name in module.__all__:
            value = getattr(module, name)
            if not any(value is known for known in top.values()):
                names.add(f"napari_phase4d.{room}.{name}")
    return names


@pytest.mark.thorough
def test_every_public_name_is_in_the_reference(extension: Callable[[str], ModuleType]) -> None:
    fill = extension("written").fill
    pages = [fill(page.read_text(encoding="utf-8")) for page in REFERENCE.glob("*.md")]
    listed = re.findall(
        r"^(?:   ~|\.\. [a-z:]+:: )(napari_phase4d\.[\w.]+)$", "".join(pages), re.MULTILINE
    )
    assert sorted(public_names() - set(listed)) == []
    assert sorted(set(listed) - public_names()) == [], "names that are not public any more"
    assert len(listed) == len(set(listed)), "a name stands twice"


#: Of which a sentence and an example say all.
PLAIN = {"size_in_words", "time_in_words", "sentence_of"}


def test_every_function_with_a_page_says_what_it_takes_and_gives() -> None:
    lacking = []
    pages = "".join(page.read_text(encoding="utf-8") for page in REFERENCE.glob("*.md"))
    listed = re.findall(r"^   ~(napari_phase4d\.[\w.]+)$", pages, re.MULTILINE)
    assert len(listed) > 100
    for full in listed:
        room, _, name = full.rpartition(".")
        function = getattr(importlib.import_module(room), name)
        if not inspect.isfunction(function) or name in PLAIN:
            continue
        text, signature = function.__doc__ or "", inspect.signature(function)
        if signature.parameters and "Parameters\n    ---" not in text:
            lacking.append(f"{full}: no parameters")
        missing = [p for p in signature.parameters if not re.search(rf"\b{p}\b", text)]
        lacking += [f"{full}: {parameter}" for parameter in missing]
        gives = signature.return_annotation not in (None, "None")
        if gives and not re.search(r"(Returns|Yields)\n    ---", text):
            lacking.append(f"{full}: not what it gives")
    assert lacking == []


@pytest.mark.slow
def test_every_command_and_option_is_in_the_reference(
    extension: Callable[[str], ModuleType],
) -> None:
    page = extension("commands").markdown()
    runner = CliRunner()
    shown = runner.invoke(app, ["--help"], env={"COLUMNS": "200", "NO_COLOR": "1"}).output
    commands = re.findall(r"^\W*([a-z]+)  +[A-Z]", shown, re.MULTILINE)
    assert len(commands) >= 6
    for command in commands:
        section = page.split(f"## {command}\n")[1].split("\n## ")[0]
        helped = runner.invoke(app, [command, "--help"], env={"COLUMNS": "200", "NO_COLOR": "1"})
        options = set(re.findall(r"--[a-z-]+", helped.output))
        assert options
        assert options - set(re.findall(r"--[a-z-]+", section)) == set()


def test_every_setting_is_in_the_reference_with_its_default(
    extension: Callable[[str], ModuleType],
) -> None:
    page = extension("recipe_fields").markdown()
    rows = [line.split(" | ") for line in page.split("## ")[0].splitlines()[2:] if line]
    found = {cells[0].strip("| `"): json.loads(cells[2].strip("`")) for cells in rows}
    assert found == json.loads(p4d.Recipe().model_dump_json())
    example = re.search(r"```json\n(.*?)```", page, re.DOTALL)
    assert example is not None
    assert p4d.Recipe.model_validate_json(example[1]).optics == p4d.Optics(magnification=60)


def wrong_file(folder: Path) -> None:
    (folder / "cells.npy").write_bytes(b"no numbers")
    p4d.open_recording(folder / "cells.npy")


def wrong_command(folder: Path) -> None:
    from napari_phase4d.cli.options import frame_numbers

    frame_numbers("first")


MISTAKES: list[Callable[[Path], Any]] = [
    lambda _: p4d.Optics(magnification=0),
    lambda _: p4d.Optics(medium_index=0.5),
    lambda _: p4d.Optics(camera_pixel_um=1e300, magnification=1e-300),
    lambda _: p4d.open_recording(np.zeros((2, 3, 4, 5, 6))),
    lambda _: p4d.open_recording(np.zeros((2, 4, 4))),
    lambda _: p4d.open_recording(np.zeros((2, 64, 64)), frame_rate_hz=-1),
    lambda folder: p4d.open_recording(folder / "missing.tif"),
    wrong_file,
    lambda _: p4d.unwrap(np.zeros((8, 8)), "magic"),
    lambda _: p4d.unwrap(np.zeros((8, 8)), "laplacian", variant="mine"),
    lambda _: p4d.unwrap(np.zeros((4, 2, 8, 8)), boundary=(9, 0)),
    lambda _: p4d.compare(np.zeros((4, 2, 8, 8)), ["spatial-2d"], truth=np.zeros((8, 8))),
    lambda _: p4d.Lobe((0.9, 0), 0.1),
    lambda _: p4d.run(p4d.Recipe()),
    lambda _: p4d.Recipe().changed(window="round"),
    lambda _: p4d.simulation.moving_shape("square"),
    lambda _: p4d.find_lobes(p4d.open_recording(np.ones((1, 64, 64))), n_views=2),
    lambda folder: p4d.run(p4d.Recipe(recording="sample:cat")),
    wrong_command,
]


@pytest.mark.thorough
@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_is_said_stands_in_the_reference(
    mistake: Callable[[Path], Any], sentences: list[Any], tmp_path: Path
) -> None:
    with pytest.raises((ValueError, TypeError, OSError)) as caught:
        mistake(tmp_path)
    said = str(caught.value)
    kinds = {kind.__name__ for kind in type(caught.value).__mro__}
    found = [
        entry.found
        for entry in sentences
        if re.search(pattern_of(entry.found.sentence), said, re.DOTALL)
        and len(fixed_words(entry.found.sentence)) >= 12
    ]
    assert any(one.kind in kinds for one in found), said
    assert all(one.purpose for one in found)


def fixed_words(sentence: str) -> str:
    """Return a sentence without what is put in; one of little else would stand for all."""
    return re.sub(r"\{[^}]*\}", "", sentence).strip()


def pattern_of(sentence: str) -> str:
    """Return a pattern that a sentence matches, whatever is put in."""
    return ".*".join(re.escape(part) for part in re.split(r"\{[^}]*\}", sentence))


@pytest.mark.thorough
def test_pages_are_filled_in(extension: Callable[[str], ModuleType]) -> None:
    fill = extension("written").fill
    marked = [p for p in REFERENCE.glob("*.md") if "<!-- written" in p.read_text("utf-8")]
    assert marked
    for page in marked:
        assert "<!-- written" not in fill(page.read_text(encoding="utf-8")), page.name
