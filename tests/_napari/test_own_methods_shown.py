"""A method that an installed package brings, in the window."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import napari_phase4d as p4d

pytestmark = pytest.mark.gui
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "phase4d-least-squares"


@pytest.fixture
def installed_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install the example package where this process finds it, for one test."""
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(tmp_path), str(EXAMPLE)], check=True)
    monkeypatch.syspath_prepend(str(tmp_path))
    vars(p4d.METHODS).pop("_all", None)  # what was installed before
    yield
    vars(p4d.METHODS).pop("_all", None)
    sys.modules.pop("phase4d_least_squares", None)


@pytest.mark.thorough
def test_it_is_ticked_run_and_shown_as_the_others(
    installed_example: None, viewer: Any, dock: Any, click: Any
) -> None:
    click("try_yeast")
    for method in dock.session.recipe.methods:
        if method != "spatial-2d":
            click(f"method_{method}")
    click("method_least-squares")
    click("run")
    assert dock.session.recipe.methods == ("spatial-2d", "least-squares")
    assert [la.name for la in viewer.layers if la.visible] == ["exact", "2-D", "LSQ"]
    table = dock.compare.figures.table
    assert {table.item(r, 0).text() for r in range(table.rowCount())} == {"2-D", "LSQ"}
    assert "least-squares" in dock.session.script()
