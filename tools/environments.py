"""Fresh environments for the matrix: made by uv, filled with the wheel, tested by pytest."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

from dev import SIDE_BY_SIDE, WARM_UP, XVFB_SCREEN, has_display

EXTRAS = ("bio", "cells", "cluster", "codecs", "flow", "napari", "video")
NAPARI = "napari[{}]>=0.9.2,<0.11"
#: What is tried before it is released.
NEXT_NAPARI = "napari[{}]>=0.10.0rc0,<0.11"
#: What the table names.
SHOWN = ("napari", "numpy", "scipy", "numba", "xarray", "zarr", "pydantic")
UV = (sys.executable, "-m", "uv")
NAME = re.compile(r"^[A-Za-z0-9._-]+")


@dataclass(frozen=True)
class Combination:
    """Which Python, which Qt binding, and which dependencies: newest, lowest, or napari's next."""

    python: str
    qt: str
    dependencies: str

    @property
    def name(self) -> str:
        """The name of its folder."""
        return f"{self.python}-{self.qt}-{self.dependencies}"


@dataclass(frozen=True)
class Outcome:
    """What a run of pytest came to."""

    ran: int
    failed: int
    skipped: int
    code: int

    @property
    def passed(self) -> bool:
        """Whether tests ran and none failed."""
        return self.code == 0 and self.failed == 0 and self.ran > 0

    def __str__(self) -> str:
        good = self.ran - self.failed - self.skipped
        words = f"{good} passed, {self.failed} failed, {self.skipped} skipped"
        return words if self.code in (0, 1) else f"{words}, pytest ended with {self.code}"


class Environment:
    """One environment in a folder of its own.

    Parameters
    ----------
    combination : Combination
        What is put into it.
    folder : Path
        Where it is made; logs lie there too.
    source : Path
        The unpacked sdist, whose tests are run.
    """

    def __init__(self, combination: Combination, folder: Path, source: Path) -> None:
        self.combination = combination
        self.folder = folder
        self.source = source
        self.python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")

    def make(self, interpreter: Path, wheel: Path) -> None:
        """Make it, with the wheel and what its tests need."""
        uv("venv", "--seed", "--python", interpreter, self.folder)
        install = ("pip", "install", "--python", self.python)
        tools = [*install, "--group", f"{self.source / 'pyproject.toml'}:test-tools"]
        following = self.combination.dependencies == "next"
        napari = (NEXT_NAPARI if following else NAPARI).format(self.combination.qt.lower())
        if self.combination.dependencies != "lowest":
            uv(*install, f"{wheel}[{','.join(EXTRAS)}]", napari, *self._left_out())
            uv(*tools, "--group", f"{self.source / 'pyproject.toml'}:test-schemas")
        else:
            pins = self._lowest(napari)
            uv(*install, "--requirements", pins)
            uv(*install, "--no-deps", wheel)
            uv(*tools, "--constraints", self._of_ours(pins))
        compiling = [self.python, "-W", "ignore", "-c", WARM_UP]
        subprocess.run(compiling, cwd=self.folder, check=True, capture_output=True, text=True)

    def _left_out(self) -> list[str]:
        """Return what pyproject.toml says of versions of this binding that its tests can't use."""
        text = (self.source / "pyproject.toml").read_text(encoding="utf-8")
        lines = tomllib.loads(text)["dependency-groups"]["test"]
        return [
            x for x in lines if isinstance(x, str) and normal(x) == normal(self.combination.qt)
        ]

    def _lowest(self, napari: str) -> Path:
        """Write the lowest versions that pyproject.toml allows, of what it names itself."""
        wanted, pins = self.folder / "napari.in", self.folder / "lowest.txt"
        wanted.write_text(f"{napari}\n", encoding="utf-8")
        extras = [part for extra in EXTRAS for part in ("--extra", extra)]
        uv("pip", "compile", self.source / "pyproject.toml", wanted, *extras, "--quiet",
           "--resolution", "lowest-direct", "--no-annotate", "--no-header",
           "--python", self.python, "--output-file", pins)  # fmt: skip
        return pins

    def _of_ours(self, pins: Path) -> Path:
        """Write the pins of what pyproject.toml names, which the tests' tools must leave alone."""
        text = (self.source / "pyproject.toml").read_text(encoding="utf-8")
        project = tomllib.loads(text)["project"]
        extras = project["optional-dependencies"]
        named = [*project["dependencies"], *(line for extra in EXTRAS for line in extras[extra])]
        ours = {normal(line) for line in named}
        lines = pins.read_text(encoding="utf-8").splitlines()
        kept = self.folder / "ours.txt"
        kept.write_text("\n".join(line for line in lines if normal(line) in ours), "utf-8")
        return kept

    def tested(self, name: str, *arguments: str) -> Outcome:
        """Run pytest in the sdist's folder; its output goes to a log beside the environment."""
        report = self.folder / f"{name}.xml"
        command = [self.python, "-m", "pytest", "-p", "no:cacheprovider", f"--junitxml={report}"]
        on_screen = [] if has_display() else ["xvfb-run", "-a", "-s", XVFB_SCREEN]
        binding = self.combination.qt.lower()
        environment = {**os.environ, **SIDE_BY_SIDE, "QT_API": binding, "PYTEST_QT_API": binding}
        environment.pop("PYTHONPATH", None)
        with (self.folder.parent / f"{self.combination.name}-{name}.log").open("w") as log:
            done = subprocess.run(
                [*on_screen, *command, *arguments],
                cwd=self.source, env=environment, stdout=log, stderr=log, check=False,
            )  # fmt: skip
        if not report.exists():
            return Outcome(0, 0, 0, done.returncode)
        suite = next(ET.parse(report).iter("testsuite")).attrib
        failed = int(suite["failures"]) + int(suite["errors"])
        return Outcome(int(suite["tests"]), failed, int(suite["skipped"]), done.returncode)

    def versions(self) -> str:
        """Return the versions that matter, as one line."""
        names = (*SHOWN, self.combination.qt)
        code = (
            "import sys; from importlib.metadata import version\n"
            "print(', '.join(f'{n} {version(n)}' for n in sys.argv[1:]))"
        )
        done = subprocess.run(
            [self.python, "-c", code, *names], capture_output=True, text=True, check=True
        )
        return done.stdout.strip()


def normal(requirement: str) -> str:
    """Return the name that a requirement begins with, as package indexes write it."""
    match = NAME.match(requirement)
    return re.sub(r"[-_.]+", "-", match[0]).lower() if match else ""


def uv(*arguments: str | Path) -> None:
    """Run uv, quietly unless it fails."""
    subprocess.run([*UV, *map(str, arguments)], check=True, capture_output=True, text=True)


def interpreter(version: str) -> Path | None:
    """Return a Python of this version that this machine has and that runs, if there is one."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"))
    places = [
        sys.executable,
        shutil.which(f"python{version}"),
        *sorted(pyenv.glob(f"versions/{version}.*/bin/python")),
        found_by_uv(version),
    ]
    return next((Path(p) for p in places if p and version_of(Path(p)) == version), None)


def found_by_uv(version: str) -> str:
    """Return what uv finds, for example in the registry of Windows."""
    line = [*UV, "python", "find", "--no-project", "--no-python-downloads", version]
    return subprocess.run(line, capture_output=True, text=True, check=False).stdout.strip()


def version_of(python: Path) -> str:
    """Return the version of an interpreter, as 3.12, or nothing if it doesn't run."""
    code = "import sys; print(*sys.version_info[:2], sep='.')"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, check=False)
    return done.stdout.strip()
