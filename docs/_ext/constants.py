"""Public constants, with the comment (``#:``) that stands above them in the code."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sphinx.pycode import ModuleAnalyzer

__all__ = ["markdown"]

#: Longer values are left out.
LONGEST = 70


def markdown(*names: str) -> str:
    """Return an entry for each name such as ``napari_phase4d.unwrapping.METHODS``."""
    entries = "\n\n".join(entry(name) for name in names)
    return f"```{{eval-rst}}\n{entries}\n```"


def entry(full_name: str) -> str:
    """Return the entry of one constant."""
    room, _, name = full_name.rpartition(".")
    value = getattr(importlib.import_module(room), name)
    words = " ".join(comment_of(room, name))
    return f".. py:data:: {full_name}\n{shown(value)}\n   {words.strip()}\n"


def shown(value: Any) -> str:
    """Return the line that shows a value: if it is short, itself; of a mapping its keys."""
    if isinstance(value, Mapping):
        return ""
    text = repr(value)
    return f"   :value: {text}\n" if len(text) <= LONGEST else ""


def comment_of(room: str, name: str) -> list[str]:
    """Return the comment above a constant, where it is made; nothing if there is none."""
    home = home_of(room, name)
    comments = ModuleAnalyzer.for_module(home).find_attr_docs()
    return comments.get(("", name), [])


def home_of(room: str, name: str) -> str:
    """Return the module that makes a name, by the imports of those that pass it on."""
    path = importlib.import_module(room).__file__
    for node in ast.walk(ast.parse(Path(str(path)).read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and name in {alias.name for alias in node.names}:
            return home_of(str(node.module), name)
    return room
