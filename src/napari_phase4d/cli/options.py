"""Options that several commands have, and what they do to a recipe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypedDict, Unpack

import typer

from napari_phase4d.analysis import CellSettings
from napari_phase4d.io import RawLayout
from napari_phase4d.pipeline import Recipe

__all__ = [
    "Angles",
    "Boundary",
    "CameraPixel",
    "Cells",
    "Colours",
    "Confidence",
    "Dataset",
    "FrameRate",
    "Increment",
    "Magnification",
    "MethodIds",
    "ObjectIndex",
    "Oblique",
    "Raw",
    "Refocus",
    "SmallestCell",
    "Storage",
    "TiltPerFrame",
    "Views",
    "Wavelength",
    "WholeField",
    "distance_of",
    "is_recipe",
    "raw_layout",
    "recipe_and_files",
    "with_settings",
]

Views = Annotated[int | None, typer.Option(help="Number of views, 1 to 6.")]
Angles = Annotated[
    list[float] | None, typer.Option(help="Viewing angle in degrees; once for each view.")
]
Colours = Annotated[
    list[float] | None,
    typer.Option(
        "--view-wavelength",
        help="Wavelength of a view in um, where views differ; once for each, as --angle.",
    ),
]
Boundary = Annotated[
    str | None,
    typer.Option(
        help="Frame to start from as TIME,ANGLE, counted from 0, or auto (default) for the safest."
    ),
]
MethodIds = Annotated[
    list[str] | None, typer.Option(help="Method id; may be given several times.")
]
Wavelength = Annotated[float | None, typer.Option(help="Wavelength in um.")]
CameraPixel = Annotated[float | None, typer.Option(help="Camera pixel in um.")]
Magnification = Annotated[float | None, typer.Option(help="From sample to camera.")]
FrameRate = Annotated[float | None, typer.Option(help="Frames per second.")]
Dataset = Annotated[str | None, typer.Option(help="Which array of a file that has several.")]
Raw = Annotated[
    str | None,
    typer.Option(
        help="Frames of a raw file: HEIGHT,WIDTH,TYPE,HEADER, such as 512,640,uint16,0; "
        "a TYPE such as >uint16 has the large byte first."
    ),
]
Storage = Annotated[
    str | None,
    typer.Option(help="Where stacks are held: memory, disk, or auto (default) if they fit."),
]
Refocus = Annotated[
    str | None, typer.Option(help='How far to refocus in um, or "auto" to find the focus.')
]
TiltPerFrame = Annotated[
    bool,
    typer.Option("--tilt-per-frame", help="Take a tilt off each frame, by its own empty field."),
]
WholeField = Annotated[
    bool, typer.Option("--whole-field", help="Unwrap the whole field, not the object only.")
]
Confidence = Annotated[
    bool, typer.Option(help="Also write how far to trust each pixel of each result.")
]
Cells = Annotated[
    bool, typer.Option("--cells", help="Find, follow and measure cells in the best result.")
]
SmallestCell = Annotated[
    float | None, typer.Option(help="Area in um^2 that a cell has at least; implies --cells.")
]
ObjectIndex = Annotated[
    float | None,
    typer.Option(help="Refractive index of the cells, for height and volume; implies --cells."),
]
Increment = Annotated[
    float | None,
    typer.Option(
        help="Refraction increment in mL/g (default 0.18), for dry mass; implies --cells."
    ),
]
Oblique = Annotated[
    bool | None,
    typer.Option(
        "--oblique/--no-oblique",
        help="Multiply phase of cells by the cosine of the viewing angle, as rays that come at an "
        "angle go through more of them; on where angles are given, but for samples. Implies "
        "--cells.",
    ),
]


def recipe_and_files(inputs: Sequence[Path]) -> tuple[Recipe, list[Path]]:
    """Tell the recipe from the recordings."""
    recipes = [p for p in inputs if is_recipe(p)]
    if len(recipes) > 1:
        msg = "give one recipe at most"
        raise ValueError(msg)
    recipe = Recipe.from_file(recipes[0]) if recipes else Recipe()
    return recipe, [p for p in inputs if not is_recipe(p)]


def is_recipe(path: Path) -> bool:
    """Say whether a file is a recipe, by its name."""
    return path.suffix.lower() == ".json"


class Typed(TypedDict, total=False):
    """What can be typed in of a recipe; None, or nothing, where it was not."""

    views: int | None
    angle: Sequence[float] | None
    view_wavelength: Sequence[float] | None
    boundary: str | None
    method: Sequence[str] | None
    frame_rate: float | None
    confidence: bool
    dataset: str | None
    raw: str | None
    storage: str | None
    refocus: str | None
    tilt_per_frame: bool
    whole_field: bool
    cells: bool
    smallest_cell: float | None
    object_index: float | None
    increment: float | None
    oblique: bool | None
    #: Whether views differ by how the object is turned, and not the beam.
    turned: bool


def with_settings(recipe: Recipe, **typed: Unpack[Typed]) -> Recipe:
    """Return a recipe with what was typed in, each option under its own name."""
    views, angles = typed.get("views"), typed.get("angle")
    methods, boundary = typed.get("method"), typed.get("boundary")
    changes: dict[str, object] = {
        "n_views": len(angles) if angles and views is None else views,
        "angles_deg": tuple(angles) if angles else None,
        "wavelengths_um": tuple(typed.get("view_wavelength") or ()) or None,
        "methods": tuple(methods) if methods else None,
        "frame_rate_hz": typed.get("frame_rate"),
        "boundary": boundary_of(boundary),
        "confidence": typed.get("confidence") or None,
        "dataset": typed.get("dataset"),
        "raw": raw_layout(typed.get("raw")),
        "storage": typed.get("storage"),
        "tilt_per_frame": typed.get("tilt_per_frame") or None,
        "refocus_um": distance_of(typed.get("refocus")),
    }
    chosen = {k: v for k, v in changes.items() if v is not None}
    if typed.get("whole_field"):
        chosen["mask"] = None
    numbers = {
        "smallest_um2": typed.get("smallest_cell"),
        "object_index": typed.get("object_index"),
        "refraction_increment_ml_per_g": typed.get("increment"),
        "oblique": typed.get("oblique"),
    }
    of_cells: dict[str, Any] = {k: v for k, v in numbers.items() if v is not None}
    asked = any(value is not False for value in of_cells.values())
    if typed.get("cells") or asked or recipe.cells is not None:
        # Who types in angles has beams that come at them.
        of_cells = ({"oblique": True} if angles and not typed.get("turned") else {}) | of_cells
        chosen["cells"] = replace(recipe.cells or CellSettings(), **of_cells)
    return recipe.changed(**chosen)


def boundary_of(text: str | None) -> str | tuple[tuple[int, int], ...] | None:
    """Read the frame to start from, or "auto"."""
    if text is None or text == "auto":
        return text
    return (frame_numbers(text),)


def frame_numbers(text: str) -> tuple[int, int]:
    """Read TIME,ANGLE."""
    try:
        time, angle = (int(part) for part in text.split(","))
    except ValueError as error:
        msg = (
            f"--boundary takes two frame numbers TIME,ANGLE such as 0,0, or auto, but got {text!r}"
        )
        raise ValueError(msg) from error
    return time, angle


def raw_layout(text: str | None) -> RawLayout | None:
    """Read HEIGHT,WIDTH,TYPE,HEADER of a raw file; the last two may be left out."""
    if text is None:
        return None
    parts = [part.strip() for part in text.split(",")]
    try:
        height, width, *more = parts
        kind, header = [*more, *("uint16", "0")[len(more) :]]
        order, kind = (kind[0], kind[1:]) if kind[:1] in ("<", ">") else ("<", kind)
        return RawLayout(int(height), int(width), kind, order, int(header))
    except ValueError as error:
        why = str(error) if "raw" in str(error) else f"but got {text!r}"
        msg = f"--raw takes HEIGHT,WIDTH,TYPE,HEADER such as 512,640,uint16,0; {why}"
        raise ValueError(msg) from error


def distance_of(text: str | None) -> float | str | None:
    """Read a distance in micrometres, or "auto"."""
    if text is None or text == "auto":
        return text
    try:
        return float(text)
    except ValueError as error:
        msg = f'--refocus takes micrometres such as 12.5, or "auto", but got {text!r}'
        raise ValueError(msg) from error
