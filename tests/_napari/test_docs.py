"""The examples of the documents run as they are written; what they call by name is there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from qtpy.QtWidgets import QAbstractButton, QComboBox, QLabel, QTabWidget

import napari_phase4d as p4d
from helpers import run_script

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
#: Pages with examples that open the files of the fixture `files`, or none.
WITH_EXAMPLES = [
    "README.md",
    "docs/explanation/reproduction.md",
    "docs/how-to/batch.md",
    "docs/how-to/benchmark.md",
    "docs/how-to/boundary.md",
    "docs/how-to/disagree.md",
    "docs/how-to/formats.md",
    "docs/how-to/lobes.md",
    "docs/how-to/measure.md",
    "docs/how-to/microscope.md",
    "docs/how-to/optics.md",
]
#: Pages in which bold words name what is on screen.
OF_THE_WINDOW = ["tutorial/index.md"] + [
    f"how-to/{name}.md"
    for name in ("boundary", "disagree", "formats", "lobes", "measure", "microscope", "save")
]


@pytest.mark.thorough
@pytest.mark.gui
@pytest.mark.slow
def test_examples_of_scripting_run_from_top_to_bottom(tmp_path: Path) -> None:
    script = tmp_path / "example.py"
    script.write_text(example_of("docs/how-to/scripting.md"), encoding="utf-8")
    # A window of its own, with a process of its own.
    done = subprocess.run(
        [sys.executable, script.name], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert list(tmp_path.rglob("*.ome.tif"))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the files that the examples open."""
    folder = tmp_path_factory.mktemp("examples")
    exact = p4d.simulation.swimming_euglena((192, 192), 4)
    video = p4d.simulation.multiplexed_video(exact["phase"])
    frames = np.asarray(video.holograms)
    for name in ("video", "cell_00", "cell_01"):
        tifffile.imwrite(folder / f"{name}.tif", frames, photometric="minisblack")
    p4d.Recipe(methods=("temporal",)).to_file(folder / "recipe.json")
    one = p4d.simulation.multiplexed_video(exact["phase"][:, :1], carriers=[(0.2, 0.2)])
    tifffile.imwrite(folder / "cells.tif", np.asarray(one.holograms), photometric="minisblack")
    np.zeros((2, 1024, 1280), "<u2").tofile(folder / "camera.raw")
    return folder


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_EXAMPLES)
def test_examples_run_as_they_are_written(page: str, files: Path) -> None:
    script = files / f"{Path(page).stem}.py"
    script.write_text(example_of(page), encoding="utf-8")
    run_script(script)


def example_of(page: str) -> str:
    """Return the Python of a page, from top to bottom, but for what shows a dialogue."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    return "\n".join(["import napari_phase4d as p4d", *blocks])


@pytest.mark.thorough
@pytest.mark.gui
@pytest.mark.parametrize("page", OF_THE_WINDOW)
def test_what_stands_in_bold_is_on_screen(page: str, dock: Any) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    named = set(re.findall(r"\*\*(.+?)\*\*", text, re.DOTALL)) - SAID_IN_BOLD
    assert named
    assert sorted(named - words_on_screen(dock)) == []


#: Bold words of these pages that are no names.
SAID_IN_BOLD = {
    "A dense object is on the bright side of its surroundings after unwrapping.",
    "A hologram\ncan't tell its viewing angles: type them in.",
    "HDF5 with a dataset a frame",
    "Is the unwrapping right?",
    "It counts at all times and angles",
    "More axes than time, y, x",
    "No line marked ⚠.",
    "Several arrays",
    "The empty field is one even colour",
    "The empty field must be at 0",
    "blue and red arrows",
    "black square",
    "colour",
    "in bold",
    "star",
    "white outline",
}


def words_on_screen(dock: Any) -> set[str]:
    """Return the names of all headings, buttons, fields, tabs and choices of the dock."""
    found = {button.text() for button in dock.findChildren(QAbstractButton)}
    found |= {label.text() for label in dock.findChildren(QLabel)}
    for tabs in dock.findChildren(QTabWidget):
        found |= {tabs.tabText(number) for number in range(tabs.count())}
    for box in dock.findChildren(QComboBox):
        found |= {box.itemText(number) for number in range(box.count())}
    return found
