"""Every sentence that the program says when something is wrong, from its source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from md import code
from raised import Raised, raised_in

import napari_phase4d

__all__ = ["all_sentences", "markdown"]

PACKAGE = Path(napari_phase4d.__file__).parent
#: Room -> its heading, in the order of the page. A room is a folder or a file of the package.
ROOMS = {
    "words": "Arguments of the wrong type",
    "stacks": "Stacks that come in",
    "stack": "Stacks of frames",
    "optics": "The microscope",
    "compiling": "Compiling",
    "recording": "Recordings",
    "io": "Files",
    "sample": "Samples",
    "holography": "From holograms to phase",
    "unwrapping": "Unwrapping",
    "analysis": "Comparing and measuring",
    "plotting": "Figures and movies",
    "pipeline": "Recipes, runs and batches",
    "scripting": "Copy as Python",
    "reproduction": "Reproduction of the paper",
    "benchmark": "Benchmark",
    "simulation": "Simulation",
    "cli": "Command line",
    "_napari": "The window",
}
#: Sentences for developers, which no user meets.
LEFT_OUT = {"__init__", "__main__", "task"}


@dataclass(frozen=True)
class Entry:
    """One sentence and where it comes from.

    Parameters
    ----------
    room : str
        Folder or file of the package.
    module : str
        Module below the package.
    found : Raised
        The sentence, its kind, and the function.
    """

    room: str
    module: str
    found: Raised


def all_sentences() -> Iterator[Entry]:
    """Iterate over all sentences of the package."""
    paths = sorted(PACKAGE.rglob("*.py"))
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in paths]
    for path, raised in zip(paths, raised_in(trees), strict=True):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        for found in raised:
            yield Entry(parts[0], ".".join(p for p in parts if p != "__init__"), found)


def markdown() -> str:
    """Return a section for every room.

    Raises
    ------
    KeyError
        If there is a new room that this page does not know.
    """
    by_room: dict[str, dict[str, list[Entry]]] = {room: {} for room in ROOMS}
    for entry in all_sentences():
        if entry.room not in LEFT_OUT:
            by_room[entry.room].setdefault(entry.found.sentence, []).append(entry)
    parts = []
    for room, sentences in by_room.items():
        if sentences:
            parts.append(f"## {ROOMS[room]}")
            parts += [definition(s, entries) for s, entries in sorted(sentences.items(), key=key)]
    return "\n\n".join(parts)


def key(item: tuple[str, list[Entry]]) -> str:
    """Sort sentences by their words, those that begin with a placeholder too."""
    return item[0].lower().lstrip("{")


def definition(sentence: str, entries: list[Entry]) -> str:
    """Return one sentence with its kinds and its sources."""
    kinds = sorted({e.found.kind for e in entries})
    places = {f"{e.module}.{e.found.function}": e.found.purpose for e in entries}
    said = "; ".join(f"{code(place)}: {what}" for place, what in places.items())
    return f"{code(sentence)}\n: {', '.join(kinds)}. From {said}"
