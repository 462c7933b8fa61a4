"""A run as a Python script, to keep, to repeat, and to learn the library from."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

from napari_phase4d.analysis import CellSettings
from napari_phase4d.holography import Lobe
from napari_phase4d.io import RawLayout
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import Recipe, found_anywhere
from napari_phase4d.pipeline.provenance import program_version
from napari_phase4d.unwrapping import METHODS

__all__ = ["as_python"]

WIDTH = 99
STEP = "    "
#: Settings that are written even where they have their usual value.
ALWAYS = ("recording", "boundary", "methods")

#: What each setting of a `Recipe` is, in plain words.
WORDS: Mapping[str, str] = MappingProxyType(
    {
        "recording": "Where the frames are: a file, a folder of images, or a sample.",
        "dataset": "Which array of the file.",
        "raw": "How frames lie in a raw camera file: pixels, their type, bytes to leave out.",
        "content": 'What the file holds: "holograms", or "phase" that is wrapped.',
        "optics": "The microscope; lengths in micrometres.",
        "frame_rate_hz": "Frames per second.",
        "n_views": "How many views to look for in the spectrum, where no lobes are given.",
        "angles_deg": "Viewing angles in degrees.",
        "wavelengths_um": "Wavelengths of the views in micrometres, where they differ.",
        "lobes": "The views: each is a lobe, a bright disk in the spectrum of the frames. Its "
        "carrier is where its middle lies (ky, kx), in cycles per camera pixel, as is its radius; "
        "flip takes the disk opposite instead, which changes the sign of the phase.",
        "reference": "What the fields are divided by, so that the errors of the optics drop out: "
        'the number of a frame, "median" for the median over time, or a file with a hologram '
        "without the object.",
        "window": "How a lobe is cut out of the spectrum.",
        "background": "What is fitted to the empty field and taken off.",
        "background_order": "Degree of the surface that is fitted.",
        "refocus_um": "How far the fields are carried along the light, in micrometres; "
        '"auto" looks for the focus.',
        "drift": "Whether the phase of the empty field is set to zero in every frame.",
        "tilt_per_frame": "Whether a tilt is taken off each frame too, fitted to its own empty "
        "field.",
        "first_frames": "Lobes, background and focus are taken from so many frames at the "
        "beginning only.",
        "mask": "None: the whole field is unwrapped, not the object alone.",
        "boundary": "Where the object is optically thin, so that unwrapping can start there: "
        '(time, angle) as frame numbers, counted from 0; "auto" looks for the safest frame.',
        "methods": "How to unwrap; each method gives a result.",
        "options": "Settings of single methods.",
        "confidence": "Whether to say how far each pixel of each result is to be trusted.",
        "cells": "How cells are found, followed and measured in the result most to be trusted.",
        "storage": 'Where stacks are held: "memory", "disk", or "auto" for memory if they fit.',
    }
)

HEAD = '''\
"""From a recording to unwrapped phase: all that napari-phase4d did, to be done again.

Run it with Python where napari-phase4d is installed. Made by version {version}.
"""

from pathlib import Path

import napari_phase4d as p4d

# The settings. What is not written here has its usual value; help(p4d.Recipe) lists them all.
recipe = '''

TAIL = """

# The work: read the frames, reconstruct the wrapped phase, unwrap it with each method.
outcome = p4d.run(recipe)
print(outcome.comparison.table)

# The stacks have the axes time, angle, y and x, in seconds, degrees and micrometres; phase is in
# radians. OME-TIFF keeps all of this; p4d.read_results(file) gives the same stack again.
folder = Path({folder})
p4d.write_phase(folder / "wrapped.ome.tif", outcome.reconstruction["phase"])
if "amplitude" in outcome.reconstruction:
    p4d.write_phase(folder / "amplitude.ome.tif", outcome.reconstruction["amplitude"])
for method, phase in outcome.comparison.results.items():
    p4d.write_phase(folder / f"{{method}}.ome.tif", phase)
"""

CELLS = """\
# The cells: their labels, a row for each cell, time and view, and a row for each cell.
# A warning has said why, if they could not be found.
if outcome.cells is not None:
    p4d.write_phase(folder / "cells.ome.tif", outcome.cells.labels)
    outcome.cells.table.to_csv(folder / "cells.csv", index=False)
    outcome.cells.summary.to_csv(folder / "cell_summary.csv", index=False)
"""

END = """\
outcome.comparison.table.to_csv(folder / "table.csv")
outcome.recipe.to_file(folder / "recipe.json")
"""

END_WITH_TRUST = """\
# How far each pixel of each result is to be trusted, from 0 to 1.
trust = {method: outcome.comparison.confidence(method) for method in recipe.methods}
for method, stack in trust.items():
    p4d.write_phase(folder / f"confidence_{method}.ome.tif", stack)
outcome.comparison.with_doubt(trust).table.to_csv(folder / "table.csv")
outcome.recipe.to_file(folder / "recipe.json")
"""


def as_python(recipe: Recipe, *, folder: str = "phase4d_results") -> str:
    """Return a Python script that does what a recipe says and saves what comes out.

    Run in another process, it gives the same arrays to the last bit: numbers are written in
    full. Names of files that are there are written with their whole path.

    Parameters
    ----------
    recipe : Recipe
        The settings, with the file or sample that the frames come from. That of an `Outcome` or
        of a window holds the lobes and the microscope that were used.
    folder : str, optional
        Where the script saves: ``wrapped.ome.tif``, ``amplitude.ome.tif`` where it is known, a
        file for each method named after its id, ``confidence_<id>.ome.tif`` where the recipe asks
        for it, ``cells.ome.tif``, ``cells.csv`` and ``cell_summary.csv`` likewise,
        ``table.csv`` and ``recipe.json``.

    Returns
    -------
    str
        The source of the script; to be saved as UTF-8.

    Raises
    ------
    ValueError
        If the recipe names no recording.
    """
    if not recipe.recording:
        msg = (
            "the frames are in no file, only in memory, so no script could read them; "
            "save the recording first, open that file, and make the script then"
        )
        raise ValueError(msg)
    head = HEAD.format(version=program_version())
    tail = TAIL.format(folder=literal(folder))
    end = END_WITH_TRUST if recipe.confidence else END
    cells = "" if recipe.cells is None else CELLS
    return head + source_of(settings(recipe)) + tail + cells + end


@dataclass(frozen=True)
class Entry:
    """One line of a group, or more where its value is a group.

    Parameters
    ----------
    value : object
        A `Group`, or what a setting of a recipe can be.
    key : str
        What stands before the value.
    words : str
        A comment above it.
    """

    value: object
    key: str = ""
    words: str = ""


@dataclass(frozen=True)
class Group:
    """What stands between brackets, one entry below the other."""

    opening: str
    entries: list[Entry]
    closing: str


def settings(recipe: Recipe) -> Group:
    """Return the call that makes a recipe, without the settings that have their usual value."""
    usual = Recipe()
    entries = [
        Entry(setting(recipe, name), f"{name}=", WORDS[name])
        for name in Recipe.model_fields
        if name in ALWAYS or getattr(recipe, name) != getattr(usual, name)
    ]
    return Group("p4d.Recipe(", entries, ")")


def setting(recipe: Recipe, name: str) -> object:
    """Return the value of a setting, with comments where there is something to say."""
    value = getattr(recipe, name)
    if name == "recording" or (name == "reference" and recipe.reference_file is not None):
        return found_anywhere(str(value))
    if name == "methods" and isinstance(value, tuple) and value:
        return Group("(", [Entry(m, words=method_words(m)) for m in value], ")")
    if name == "options" and isinstance(value, dict):
        entries = [Entry(options_of(m, chosen), f"{literal(m)}: ") for m, chosen in value.items()]
        return Group("{", entries, "}")
    return value


def method_words(method: str) -> str:
    """Say what a method is called on screen and what it does."""
    return f"{METHODS[method].label}: {METHODS[method].summary}"


def options_of(method: str, chosen: Mapping[str, object]) -> Group:
    """Return the options of a method, each with what it does."""
    words = {option.name: option.summary for option in METHODS[method].options}
    entries = [Entry(value, f"{literal(name)}: ", words[name]) for name, value in chosen.items()]
    return Group("{", entries, "}")


def source_of(value: object, indent: str = "", taken: int = 0) -> str:
    """Return a value as Python source.

    Parameters
    ----------
    value : object
        A `Group`, or what a setting of a recipe can be.
    indent : str, optional
        Spaces before the line that it begins in.
    taken : int, optional
        Columns of that line that are taken.
    """
    group = as_group(value, WIDTH - taken)
    if group is None:
        return literal(value)
    if not group.entries:
        return group.opening + group.closing
    inner = indent + STEP
    lines = [group.opening]
    for entry in group.entries:
        start = f"{inner}{entry.key}"
        lines += textwrap.wrap(
            entry.words, WIDTH, initial_indent=f"{inner}# ", subsequent_indent=f"{inner}# "
        )
        lines.append(f"{start}{source_of(entry.value, inner, len(start) + 1)},")
    return "\n".join([*lines, f"{indent}{group.closing}"])


def as_group(value: object, room: int) -> Group | None:
    """Return what has to be written one below the other, None where a line is enough."""
    if isinstance(value, Group):
        return value
    if isinstance(value, CellSettings | Lobe | Optics | RawLayout):
        entries = [Entry(getattr(value, f.name), f"{f.name}=") for f in fields(value)]
        return Group(f"p4d.{type(value).__name__}(", entries, ")")
    if isinstance(value, tuple):
        plain = not any(isinstance(item, Lobe) for item in value)
        if plain and len(literal(value)) <= room:
            return None
        return Group("(", [Entry(item) for item in value], ")")
    return None


def literal(value: object) -> str:
    """Return a value in one line, from which Python makes exactly the same one."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, tuple):
        items = ", ".join(literal(item) for item in value)
        return f"({items},)" if len(value) == 1 else f"({items})"
    if isinstance(value, float) and not math.isfinite(value):
        return f'float("{value}")'
    if isinstance(value, str) and '"' not in value:
        return f'"{repr(value)[1:-1]}"'  # double quotes, as the rest of the script has them
    return repr(value)
