"""What the rooms within the window's may not know; `test_architecture` holds who imports whom."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import napari_phase4d

ROOM = Path(napari_phase4d.__file__).parent / "_napari"
#: Widgets know no viewer, and the session knows nothing of the window.
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
def test_inner_rooms_know_nothing_of_the_window(path: Path) -> None:
    room = path.relative_to(ROOM).parts[0].removesuffix(".py")
    for name in imported(path):
        package = name.split(".")[0]
        assert package not in WITHOUT.get(room, set()), f"{room} imports {name}"
