"""Every command that README and documents tell to type exists, with its options."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from napari_phase4d.cli import app

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*/*.md"))]
#: A command in a block of its own, or in a sentence.
PROGRAM = re.compile(r"(?:^ {4}|`)napari-phase4d ([^`\n#]+)", re.MULTILINE)
DEV = re.compile(r"python3? dev\.py (\w+)")


def commands_of(page: Path) -> list[str]:
    found = [words.strip() for words in PROGRAM.findall(page.read_text(encoding="utf-8"))]
    return [words for words in found if not words.startswith("COMMAND ")]


TYPED = sorted({(page, command) for page in PAGES for command in commands_of(page)})


@pytest.mark.parametrize(("page", "command"), TYPED, ids=lambda value: str(value)[-60:])
def test_the_program_has_what_is_typed(page: Path, command: str) -> None:
    name, *arguments = shlex.split(command)
    known = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    assert name in known
    options = {option for parameter in known[name].params for option in parameter.opts}
    assert {word for word in arguments if word.startswith("--")} <= options | {"--help"}


def test_dev_has_what_is_typed() -> None:
    help_text = subprocess.run(
        [sys.executable, "dev.py", "--help"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    known = set(re.findall(r"\w+", re.search(r"\{([\w,\s]+)\}", help_text)[1]))  # type: ignore[index]
    typed = {(page.name, n) for page in PAGES for n in DEV.findall(page.read_text("utf-8"))}
    assert len(typed) > 5
    assert {(page, name) for page, name in typed if name not in known} == set()
