"""Public names that no page lists by hand: they come last, under what they are called."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import constants

import napari_phase4d

__all__ = ["markdown"]

REFERENCE = Path(__file__).resolve().parents[1] / "reference"
PACKAGE = napari_phase4d.__name__


def markdown(*rooms: str) -> str:
    """Return an entry for every public name that no page lists; "" if there is none."""
    names = [name for room in rooms for name in unlisted(room)]
    if not names:
        return ""
    entries = "\n\n".join(entry(name) for name in names)
    return f"## For other parts of the program\n\n```{{eval-rst}}\n{entries}\n```"


def unlisted(room: str) -> list[str]:
    """Return the public names of a room that no page lists, nor the package has itself."""
    module = importlib.import_module(room)
    own = [getattr(napari_phase4d, name) for name in napari_phase4d.__all__]
    listed = listed_names()
    return [
        f"{room}.{name}"
        for name in module.__all__
        if f"{room}.{name}" not in listed
        and not any(getattr(module, name) is value for value in own)
    ]


def listed_names() -> set[str]:
    """Return all names that stand on the pages of the reference."""
    pages = (page.read_text(encoding="utf-8") for page in sorted(REFERENCE.glob("*.md")))
    return {name for page in pages for name in re.findall(rf"{PACKAGE}\.[\w.]*\w", page)}


def entry(full_name: str) -> str:
    """Return what documents a name."""
    room, _, name = full_name.rpartition(".")
    value: Any = getattr(importlib.import_module(room), name)
    if inspect.isclass(value):
        return f".. autoclass:: {full_name}\n   :members:\n   :exclude-members: model_config\n"
    if inspect.isfunction(value):
        return f".. autofunction:: {full_name}\n"
    return constants.entry(full_name)
