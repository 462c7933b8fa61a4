"""The examples in the docstrings of the library give what they say."""

from __future__ import annotations

import doctest
import importlib
from pathlib import Path

import pytest

import napari_phase4d

PACKAGE = Path(napari_phase4d.__file__).parent


def modules_with_examples() -> list[str]:
    """Return the modules that show an example; those of the window need a window."""
    found = [
        path.relative_to(PACKAGE.parent).with_suffix("")
        for path in sorted(PACKAGE.rglob("*.py"))
        if "_napari" not in path.parts and ">>> " in path.read_text(encoding="utf-8")
    ]
    return [".".join(path.parts).removesuffix(".__init__") for path in found]


@pytest.mark.thorough
@pytest.mark.parametrize("name", modules_with_examples())
def test_examples_give_what_they_say(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # some write files
    found = doctest.testmod(importlib.import_module(name))
    assert found.attempted > 0
    assert found.failed == 0


@pytest.mark.parametrize(
    "name",
    [
        "Optics", "Recipe", "compare", "find_lobes", "open_recording", "power_spectrum",
        "reconstruct", "run", "score_boundaries", "unwrap",
    ],
)  # fmt: skip
def test_every_part_of_the_chain_shows_an_example(name: str) -> None:
    assert ">>> " in (getattr(napari_phase4d, name).__doc__ or "")
