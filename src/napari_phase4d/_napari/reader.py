"""Opening hologram videos, results and recipes by drag and drop or File > Open."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from napari_phase4d._napari.session.opening import open_anything
from napari_phase4d._napari.viewing.layers import (
    LayerTuple,
    hologram_layer,
    stack_layer,
    with_recipe,
)
from napari_phase4d.io import (
    JOINED_SUFFIXES,
    OME_TIFF,
    OME_ZARR,
    READABLE_SUFFIXES,
    needs_layout,
    open_recording,
    read_results,
)
from napari_phase4d.io.results import is_result
from napari_phase4d.io.sequences import by_number
from napari_phase4d.pipeline import Recipe
from napari_phase4d.recording import Recording

__all__ = ["get_reader"]

RECIPE_SUFFIX = ".json"
#: What is told by its unit alone.
KINDS_BY_UNIT = {"nm": "optical path", "pg/um^2": "dry mass", "pi rad": "margin"}


def get_reader(path: str | list[str]) -> Callable[[Any], list[LayerTuple]] | None:
    """Return the function that reads a file, or None if this plugin can't."""
    if isinstance(path, list):
        files = [Path(one) for one in path]
        if len(files) == 1:
            return get_reader(path[0])
        one_kind = len({file.suffix.lower() for file in files}) == 1
        return read if one_kind and files[0].suffix.lower() in JOINED_SUFFIXES else None
    file = Path(path)
    if file.suffix.lower() == RECIPE_SUFFIX:
        return read if is_recipe(file) else None
    if file.is_dir() or file.suffix.lower() in READABLE_SUFFIXES:
        return read
    return None


def read(path: str | list[str]) -> list[LayerTuple]:
    """Read a hologram video, wrapped phase, a result, or what a recipe names.

    Several files follow one another in time, in the order of the numbers in their names.
    """
    if isinstance(path, list) and len(path) > 1:
        return [hologram_layer(open_recording(sorted(map(Path, path), key=by_number)))]
    file = Path(path[0] if isinstance(path, list) else path)
    if needs_layout(file):
        msg = (
            f"{file.name} is raw and can't say how large its frames are; "
            "open it in step 1 of the Phase 4D dock, which asks how its frames lie"
        )
        raise ValueError(msg)
    if is_result(file):
        stack = read_results(file)
        kind = kind_of(stack.attrs)
        if kind == "wrapped":  # what is made of it can be made again from this file
            stack = stack.assign_attrs(source=str(file.resolve()))
        return [stack_layer(stack, name_of(file), kind)]
    opened = open_anything(file)
    if isinstance(opened.content, Recording):
        layer = hologram_layer(opened.content)
    else:
        name = Path(str(opened.content.attrs.get("source", file))).stem
        layer = stack_layer(opened.content, name, "wrapped")
    return [layer if opened.recipe is None else with_recipe(layer, opened.recipe)]


def name_of(file: Path) -> str:
    """Return what to call a result: the name of its file without the endings."""
    return file.name.removesuffix(OME_TIFF).removesuffix(OME_ZARR)


def is_recipe(file: Path) -> bool:
    """Say whether a file is a recipe of this program that names a recording."""
    try:
        return bool(Recipe.from_file(file).recording)
    except (OSError, ValueError):
        return False


def kind_of(attrs: dict[Any, Any]) -> str:
    """Return the kind of a result from its attributes."""
    if attrs.get("units") in KINDS_BY_UNIT:
        return KINDS_BY_UNIT[attrs["units"]]
    if "of" in attrs:
        return "confidence"
    if "less" in attrs:
        return "difference"
    if "method" in attrs:
        return "unwrapped"
    if attrs.get("exact"):
        return "exact"
    return "wrapped" if attrs.get("units") == "rad" else "amplitude"
