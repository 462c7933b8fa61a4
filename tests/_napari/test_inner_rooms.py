"""The rooms within the window's: who imports whom."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import napari_phase4d

ROOM = Path(napari_phase4d.__file__).parent / "_napari"
#: Inner room -> inner rooms that it may import. Widgets know neither session nor viewer, and the
#: session knows nothing of the window.
ALLOWED = {
    "widgets": set(),
    "session": set(),
    "preferences": set(),
    "jobs": {"session"},
    "viewing": {"session"},
    "steps": {"jobs", "preferences", "session", "viewing", "widgets"},
    "dock": {"jobs", "session", "steps", "viewing", "widgets"},
    "demo": {"dock", "session"},
    "one_shot": {"jobs", "preferences", "viewing"},
    "live": {"jobs", "preferences", "viewing"},
    "files": {"session", "viewing"},
}
#: What these inner rooms may not know of the outer ones either.
WITHOUT = {"session": {"napari", "qtpy", "magicgui"}, "widgets": {"napari", "magicgui"}}


def modules() -> list[Path]:
    return sorted(path for path in ROOM.rglob("*.py") if path != ROOM / "__init__.py")


def imported(path: Path) -> Iterator[str]:
    """Every name that a module imports, in full."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(ROOM)))
def test_inner_imports_go_one_way(path: Path) -> None:
    room = path.relative_to(ROOM).parts[0].removesuffix(".py")
    for name in imported(path):
        package, *rest = name.split(".")
        assert package not in WITHOUT.get(room, set()), f"{room} imports {name}"
        if package == "napari_phase4d" and rest[0] == "_napari":
            assert rest[1] in {room, *ALLOWED[room]}, f"{room} imports {name}"
