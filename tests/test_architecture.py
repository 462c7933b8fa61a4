"""The rooms: who imports whom, and what importing the package loads."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "napari_phase4d"

#: Room -> rooms that it may import. Lower rooms never know of higher ones.
ALLOWED = {
    "machine": set(),
    "compiling": set(),
    "later": set(),
    "optics": set(),
    "phasors": set(),
    "task": set(),
    "warned": set(),
    "words": set(),
    "stacks": set(),
    "stack": {"stacks"},
    "recording": {"optics"},
    "io": {"optics", "recording", "stack", "task"},
    "holography": {"optics", "recording", "phasors", "task"},
    "unwrapping": {"phasors", "task", "stack"},
    "analysis": {"optics", "task", "stack", "unwrapping"},
    "plotting": {"analysis"},
    "simulation": {"optics", "recording"},
    "sample": {"optics", "recording", "simulation"},
    "pipeline": {
        "optics", "recording", "task", "stack", "io", "holography", "unwrapping", "analysis",
        "sample",
    },
    "scripting": {"optics", "io", "holography", "unwrapping", "analysis", "pipeline"},
    "reproduction": {
        "task", "io", "analysis", "plotting", "unwrapping", "pipeline", "sample", "simulation",
    },
    "benchmark": {
        "optics", "task", "io", "holography", "unwrapping", "analysis", "pipeline",
        "simulation",
    },
    "cli": {
        "optics", "recording", "task", "io", "holography", "unwrapping", "analysis",
        "plotting", "pipeline", "sample", "reproduction", "benchmark", "_napari",
    },
    "__main__": {"cli"},
    "_napari": {
        "optics", "recording", "task", "io", "holography", "unwrapping", "analysis",
        "plotting", "pipeline", "sample", "scripting",
    },
}  # fmt: skip
#: Part of the window -> other parts of it that it may import.
INNER = {
    "session": set(),
    "widgets": set(),
    "preferences": set(),
    "turns": set(),
    "beginning": set(),
    "viewing": {"session", "turns"},
    "jobs": {"session", "turns"},
    "menus": {"jobs", "preferences", "session", "viewing"},
    "steps": {"jobs", "preferences", "session", "viewing", "widgets"},
    "dock": {"beginning", "jobs", "session", "steps", "turns", "viewing", "widgets"},
    "demo": {"dock", "session"},
    "__init__": set(),
}
#: Modules that import nothing of ours, so that every room may use them.
LEAVES = {"compiling", "later", "machine", "warned", "words"}
#: The place where stacks come in imports leaves only, so that every room above may ask it.
INTAKE = "stacks"
#: Libraries that take from 5 to 300 ms to load, of what naming, asking and opening do without.
HEAVY = {
    "PIL", "dask.array", "h5py", "imageio", "matplotlib", "numba", "pandas", "scipy.fft",
    "scipy.ndimage", "scipy.optimize", "scipy.special", "skimage.measure", "tifffile", "xarray",
    "zarr",
}  # fmt: skip
GUI = {"napari", "qtpy", "magicgui", "superqt", "PyQt6", "PySide6", "PyQt5", "PySide2"}


def modules() -> list[Path]:
    return sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


def imports_of(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively"
            names.add(node.module or "")
            # ``from napari_phase4d import x`` names a room as well.
            names |= {f"{node.module}.{a.name}" for a in node.names if node.module == PACKAGE.name}
    return names


@pytest.mark.parametrize(
    "path",
    sorted((PACKAGE / "_napari").rglob("*.py")),
    ids=lambda p: str(p.relative_to(PACKAGE)),
)
def test_the_parts_of_the_window_import_one_way(path: Path) -> None:
    part = path.relative_to(PACKAGE / "_napari").parts[0].removesuffix(".py")
    for name in imports_of(path):
        if name.startswith("napari_phase4d._napari."):
            other = name.split(".")[2]
            assert other == part or other in INNER[part], f"{part} imports {other}"
        if part == "session":
            assert name.split(".")[0] not in GUI, f"the session imports {name}"


def imported_names(path: Path) -> Iterator[tuple[str, str]]:
    """Yield module and name of all that a file imports from this package."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("napari_phase4d"):
            for alias in node.names:
                yield str(node.module), alias.name


def file_of(module: str) -> Path | None:
    """Return the file of a module of this package, None if there is none."""
    path = PACKAGE.parent.joinpath(*module.split("."))
    return next((p for p in (path / "__init__.py", path.with_suffix(".py")) if p.exists()), None)


@cache
def exported(file: Path) -> set[str]:
    """Return the names in a module's ``__all__``."""
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return set(ast.literal_eval(node.value))
    return set()


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.thorough
@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_one_way(path: Path) -> None:
    room = room_of(path)
    for name in imports_of(path):
        if name.startswith("napari_phase4d."):
            other = name.split(".")[1]
            may_ask = {INTAKE} if ALLOWED[room] else set()
            assert other in {room, *LEAVES, *may_ask, *ALLOWED[room]}, f"{room} imports {other}"
        if name.split(".")[0] in GUI:
            assert room == "_napari", f"{room} imports {name}"


@pytest.mark.thorough
@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_only_what_a_module_exports_is_imported(path: Path) -> None:
    for module, name in imported_names(path):
        file = file_of(module)
        assert file is not None, module
        known = name in exported(file) or file_of(f"{module}.{name}") is not None
        assert known, f"{module} has no {name!r} in its __all__"


@pytest.mark.thorough
@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_no_file_is_too_long(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 600


@pytest.mark.thorough
def test_importing_the_package_loads_neither_qt_nor_napari() -> None:
    code = (
        "import sys, napari_phase4d as p4d; "
        "[getattr(p4d, name) for name in p4d.__all__]; "
        f"print(sorted(set(m.split('.')[0] for m in sys.modules) & {GUI!r}))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


def loaded_by(code: str) -> set[str]:
    """Return the modules that a new Python has loaded after some code."""
    found = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return set(found.stdout.splitlines()[-1].split())


def test_importing_the_package_is_light() -> None:
    light = loaded_by("import napari_phase4d")
    assert not light & {"numpy", "scipy", "skimage", "xarray", "pandas", "importlib.metadata"}


@pytest.mark.slow
@pytest.mark.parametrize("code", [
    "import napari_phase4d as p4d; [getattr(p4d, name) for name in p4d.__all__]",
    "from napari_phase4d.cli.app import app; app(['--help'], standalone_mode=False)",
    "from napari_phase4d._napari.session import Session; Session()",
])  # fmt: skip
def test_naming_what_there_is_loads_nothing_heavy(code: str) -> None:
    assert not loaded_by(code) & HEAVY


@pytest.mark.slow
def test_a_library_is_loaded_once_for_all_threads() -> None:
    code = (
        "import threading, napari_phase4d.later as later\n"
        "kinds, start = [], threading.Barrier(8)\n"
        "def ask():\n"
        "    start.wait()\n"
        "    kinds.append(later.xr.DataArray)\n"
        "threads = [threading.Thread(target=ask) for _ in range(8)]\n"
        "[thread.start() for thread in threads]; [thread.join() for thread in threads]\n"
        "import xarray; assert kinds == 8 * [xarray.DataArray], kinds\n"
        "import pickle; assert pickle.loads(pickle.dumps(later.xr)).Dataset is xarray.Dataset\n"
        "assert 'DataArray' in dir(later.xr)"
    )
    assert "xarray" in loaded_by(code)


def test_every_public_name_exists() -> None:
    import napari_phase4d as p4d

    for name in p4d.__all__:
        assert getattr(p4d, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = p4d.nothing


def test_no_qt_binding_is_a_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for requirement in project["dependencies"]:
        assert "[" not in requirement or requirement.startswith("dask["), requirement
        assert not requirement.lower().startswith(("pyqt", "pyside"))


def test_no_private_attribute_of_napari_is_used() -> None:
    import re

    private = re.compile(r"(viewer|window|layer|canvas|la)\._[a-z]")
    for path in (PACKAGE / "_napari").rglob("*.py"):
        for line in path.read_text(encoding="utf-8").splitlines():
            assert not private.search(line), f"{path.name}: {line.strip()}"
