"""Opening hologram videos and results by drag and drop or File > Open."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from napari_phase4d._napari.layers import LayerTuple, hologram_layer, stack_layer
from napari_phase4d.io import (
    READABLE_SUFFIXES,
    open_input,
    read_results,
)
from napari_phase4d.io.results import is_result
from napari_phase4d.recording import Recording

__all__ = ["get_reader"]


def get_reader(path: str | list[str]) -> Callable[[Any], list[LayerTuple]] | None:
    """Return the function that reads a file, or None if this plugin can't."""
    if isinstance(path, list):
        return None if len(path) != 1 else get_reader(path[0])
    file = Path(path)
    if file.is_dir() or file.suffix.lower() in READABLE_SUFFIXES:
        return read
    return None


def read(path: str | list[str]) -> list[LayerTuple]:
    """Read a hologram video, wrapped phase, or a result that this program wrote."""
    file = Path(path[0] if isinstance(path, list) else path)
    if file.suffix.lower() in (".tif", ".tiff") and is_result(file):
        stack = read_results(file)
        return [stack_layer(stack, file.name.removesuffix(".ome.tif"), kind_of(stack.attrs))]
    opened = open_input(file)
    if isinstance(opened, Recording):
        return [hologram_layer(opened)]
    return [stack_layer(opened, file.stem, "wrapped")]


def kind_of(attrs: dict[Any, Any]) -> str:
    """Return the kind of a result from its attributes."""
    if "of" in attrs:
        return "confidence"
    if "method" in attrs:
        return "unwrapped"
    if attrs.get("exact"):
        return "exact"
    return "wrapped" if attrs.get("units") == "rad" else "amplitude"
