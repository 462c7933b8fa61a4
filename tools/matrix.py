"""Try the wheel in fresh environments: both Qt bindings, newest, lowest and coming dependencies.

``python3 dev.py matrix`` builds sdist and wheel and, for each combination, makes an environment in
a temporary folder, installs the wheel there, and runs the tests that the sdist brings: the checks
of what is released, the story of the window, and the quick tests; with the lowest versions also
the slow ones.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from dev import ROOT
from tools.environments import Combination, Environment, interpreter

#: Which tests are run beside the release checks; the lowest versions are tried in depth.
TESTS = {
    "newest": "(not gui and not slow and not release) or story",
    "next": "(not gui and not slow and not release) or story",
    "lowest": "(not gui and not release) or story",
}
COLUMNS = ("Python", "Qt", "dependencies", "versions", "release checks", "tests", "minutes")


@dataclass(frozen=True)
class Row:
    """What came of one combination."""

    cells: tuple[str, ...]
    passed: bool


def main(arguments: list[str]) -> int:
    """Run what was asked for, print the table, and return 1 if anything failed."""
    parser = argparse.ArgumentParser(prog="dev.py matrix", description=__doc__.splitlines()[0])
    parser.add_argument("only", nargs="*", help="words that a combination must have, e.g. lowest")
    asked = parser.parse_args(arguments).only
    chosen = [c for c in combinations() if set(asked) <= {c.python, c.qt, c.dependencies}]
    if not chosen:
        parser.error(f"no combination has {' and '.join(asked)}")
    folder = Path(tempfile.mkdtemp(prefix="phase4d-matrix-"))
    print(f"Logs are in {folder}", flush=True)
    wheel, source = built(folder)
    rows = []
    for combination in chosen:
        rows.append(row_of(combination, folder, wheel, source))
        print(" | ".join(rows[-1].cells), flush=True)
    print(as_table(rows))
    return 0 if all(row.passed for row in rows) else 1


def combinations() -> list[Combination]:
    """Return what is tried: all of this Python, and the newest of the other ones."""
    here = f"{sys.version_info.major}.{sys.version_info.minor}"
    found = [
        Combination(here, "PyQt6", "newest"),
        Combination(here, "PySide6", "newest"),
        Combination(here, "PyQt6", "lowest"),
        Combination(here, "PyQt6", "next"),
    ]
    return found + [Combination(v, "PyQt6", "newest") for v in supported() if v != here]


def supported() -> list[str]:
    """Return the Pythons that the package says it works with."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = (re.search(r":: (3\.\d+)$", line) for line in project["classifiers"])
    return [match[1] for match in found if match]


def built(folder: Path) -> tuple[Path, Path]:
    """Build sdist and, from it, the wheel; return the wheel and the unpacked sdist."""
    dist = folder / "dist"
    subprocess.run([sys.executable, "-m", "build", "--outdir", dist, ROOT],
                   check=True, stdout=subprocess.DEVNULL)  # fmt: skip
    files = sorted(dist.iterdir())
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *files], check=True)
    (sdist,) = dist.glob("*.tar.gz")
    (wheel,) = dist.glob("*.whl")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    return wheel, folder / sdist.name.removesuffix(".tar.gz")


def row_of(combination: Combination, folder: Path, wheel: Path, source: Path) -> Row:
    """Install and test one combination."""
    begin = monotonic()
    python = interpreter(combination.python)
    head = (combination.python, combination.qt, combination.dependencies)
    if python is None:
        return Row((*head, "", "not on this machine", "not run", ""), passed=True)
    environment = Environment(combination, folder / combination.name, source)
    try:
        environment.make(python, wheel)
    except subprocess.CalledProcessError as error:
        print(error.stderr or error, flush=True)
        return Row((*head, "", "could not be installed", "not run", ""), passed=False)
    checks = environment.tested("release", "-m", "release")
    wanted = TESTS[combination.dependencies]
    if os.name == "nt" and "CI" in os.environ:  # the machines that GitHub lends have no OpenGL
        wanted = wanted.removesuffix(" or story")
    quick = environment.tested("quick", "-m", wanted, "-n", "3", "--dist", "worksteal")
    minutes = f"{(monotonic() - begin) / 60:.1f}"
    cells = (*head, environment.versions(), str(checks), str(quick), minutes)
    return Row(cells, passed=checks.passed and quick.passed)


def as_table(rows: list[Row]) -> str:
    """Return the rows as a table in Markdown."""
    lines = [COLUMNS, ("---",) * len(COLUMNS), *(row.cells for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
