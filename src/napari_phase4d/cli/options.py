"""Options that several commands have, and what they do to a recipe."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypedDict, TypeVar, Unpack, get_type_hints

import typer

from napari_phase4d.analysis import CellSettings
from napari_phase4d.holography import Lobe, angles_unknown
from napari_phase4d.holography.lobes import in_order_of_angle
from napari_phase4d.io import RawLayout
from napari_phase4d.pipeline import Recipe
from napari_phase4d.words import counted

__all__ = [
    "Dataset",
    "Raw",
    "Refocus",
    "Typed",
    "distance_of",
    "is_recipe",
    "raw_layout",
    "recipe_and_files",
    "taking_settings",
    "typed_optics",
    "with_settings",
]

F = TypeVar("F", bound=Callable[..., None])

Dataset = Annotated[str | None, typer.Option(help="Which array of a file that has several.")]
Raw = Annotated[
    str | None,
    typer.Option(
        help="Frames of a raw file: HEIGHT,WIDTH,TYPE,HEADER, such as 512,640,uint16,0; "
        "a TYPE such as >uint16 has the large byte first."
    ),
]
Refocus = Annotated[
    str | None, typer.Option(help='How far to refocus in um, or "auto" to find the focus.')
]


class Typed(TypedDict, total=False):
    """What can be typed in of a recipe, in the order of the help; None or False where it was not.

    Each is an option of the commands that `taking_settings` marks.
    """

    views: Annotated[int | None, typer.Option(help="Number of views, 1 to 6.")]
    angle: Annotated[
        list[float] | None, typer.Option(help="Viewing angle in degrees; once for each view.")
    ]
    view_wavelength: Annotated[
        list[float] | None,
        typer.Option(
            help="Wavelength of a view in um, where views differ; once for each, as --angle."
        ),
    ]
    boundary: Annotated[
        str | None,
        typer.Option(
            help="Frame to start from as TIME,ANGLE, counted from 0, or auto (default) for the "
            "safest."
        ),
    ]
    method: Annotated[
        list[str] | None, typer.Option(help="Method id; may be given several times.")
    ]
    wavelength: Annotated[float | None, typer.Option(help="Wavelength in um.")]
    camera_pixel: Annotated[float | None, typer.Option(help="Camera pixel in um.")]
    magnification: Annotated[float | None, typer.Option(help="From sample to camera.")]
    frame_rate: Annotated[float | None, typer.Option(help="Frames per second.")]
    confidence: Annotated[
        bool | None,
        typer.Option(
            "--confidence/--no-confidence",
            help="Also write how far to trust each pixel of each result.",
        ),
    ]
    dataset: Dataset
    raw: Raw
    storage: Annotated[
        str | None,
        typer.Option(help="Where stacks are held: memory, disk, or auto (default) if they fit."),
    ]
    refocus: Refocus
    tilt_per_frame: Annotated[
        bool,
        typer.Option(
            "--tilt-per-frame", help="Take a tilt off each frame, by its own empty field."
        ),
    ]
    whole_field: Annotated[
        bool, typer.Option("--whole-field", help="Unwrap the whole field, not the object only.")
    ]
    cells: Annotated[
        bool,
        typer.Option(
            "--cells",
            help="Find, follow and measure cells: in Synthetic, WL1 or T/A, the first there is.",
        ),
    ]
    smallest_cell: Annotated[
        float | None, typer.Option(help="Area in um^2 that a cell has at least; implies --cells.")
    ]
    object_index: Annotated[
        float | None,
        typer.Option(
            help="Refractive index of the cells, for height and volume; implies --cells."
        ),
    ]
    increment: Annotated[
        float | None,
        typer.Option(
            help="Refraction increment in mL/g (default 0.18), for dry mass; implies --cells."
        ),
    ]
    oblique: Annotated[
        bool | None,
        typer.Option(
            "--oblique/--no-oblique",
            help="Multiply phase of cells by the cosine of the viewing angle, as rays that come "
            "at an angle go through more of them; on where angles are given, but for samples. "
            "Implies --cells.",
        ),
    ]


def taking_settings(*, but: Sequence[str] = (), **instead: object) -> Callable[[F], F]:
    """Give a command the options of `Typed` in the place of its ``**typed``.

    Typer makes options of the parameters that a function shows. They follow those of the command
    that are not keyword-only.

    Parameters
    ----------
    but : sequence of str, optional
        Those that the command does not have.
    **instead
        Annotations of options that are said in other words here, by their names.
    """

    def marked(command: F) -> F:
        shown = inspect.signature(command, eval_str=True)
        own = [p for p in shown.parameters.values() if p.kind is not p.VAR_KEYWORD]
        first = [p for p in own if p.kind is not p.KEYWORD_ONLY]
        hints = get_type_hints(Typed, include_extras=True) | instead
        settings = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=False if hint.__origin__ is bool else None,
                annotation=hint,
            )
            for name, hint in hints.items()
            if name not in but
        ]
        command.__signature__ = shown.replace(  # type: ignore[attr-defined]
            parameters=[*first, *settings, *own[len(first) :]]
        )
        return command

    return marked


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


def typed_lobes(recipe: Recipe, typed: Typed) -> dict[str, object]:
    """Return the lobes of a recipe with the angles and wavelengths that were typed in.

    Raises
    ------
    ValueError
        If it has another number of lobes, or a boundary frame would lie in another view.
    """
    lobes = list(recipe.lobes)
    angles, lights = typed.get("angle"), typed.get("view_wavelength")
    given = {
        "--views": typed.get("views"),
        "--angle": len(angles) if angles else None,
        "--view-wavelength": len(lights) if lights else None,
    }
    for option, count in given.items():
        if lobes and count not in (None, len(lobes)):
            msg = (
                f"{option} asks for {counted(count, 'view')}, but the recipe has "
                f"{counted(len(lobes), 'lobe')}; ask for as many, or take its lobes out of it"
            )
            raise ValueError(msg)
    named = lobes
    if angles and lobes:
        named = [replace(b, angle_deg=a) for b, a in zip(named, angles, strict=True)]
    if lights and lobes:
        named = [replace(b, wavelength_um=w) for b, w in zip(named, lights, strict=True)]
    moved = carriers_in_order(named) != carriers_in_order(lobes)
    if moved and recipe.boundary != "auto" and typed.get("boundary") is None:
        msg = (
            "what was typed in puts the views into another order than that in which the recipe "
            "counts its boundary frame; give --boundary too"
        )
        raise ValueError(msg)
    return {"lobes": tuple(named)} if lobes else {}


def carriers_in_order(lobes: Sequence[Lobe]) -> list[tuple[float, float]]:
    """Return the carriers of lobes as their views are put in order."""
    return [lobe.carrier for lobe in in_order_of_angle(lobes)[0]]


def with_settings(recipe: Recipe, *, turned: bool = False, **typed: Unpack[Typed]) -> Recipe:
    """Return a recipe with what was typed in but optics, each option under its own name.

    Parameters
    ----------
    recipe : Recipe
        What holds where nothing was typed in.
    turned : bool, optional
        Whether views differ by how the object is turned, and not the beam.
    **typed
        See `Typed`.
    """
    views, angles = typed.get("views"), typed.get("angle")
    methods, boundary = typed.get("method"), typed.get("boundary")
    changes: dict[str, object] = {
        "n_views": len(angles) if angles and views is None else views,
        "angles_deg": tuple(angles) if angles else None,
        "wavelengths_um": tuple(typed.get("view_wavelength") or ()) or None,
        "methods": tuple(methods) if methods else None,
        "frame_rate_hz": typed.get("frame_rate"),
        "boundary": boundary_of(boundary),
        "confidence": typed.get("confidence"),
        "dataset": typed.get("dataset"),
        "raw": raw_layout(typed.get("raw")),
        "storage": typed.get("storage"),
        "tilt_per_frame": typed.get("tilt_per_frame") or None,
        "refocus_um": distance_of(typed.get("refocus")),
    }
    chosen = {k: v for k, v in changes.items() if v is not None} | typed_lobes(recipe, typed)
    if typed.get("whole_field"):
        chosen["mask"] = None
    cells = typed_cells(recipe, typed, turned=turned)
    if cells is not None:
        chosen["cells"] = cells
    return recipe.changed(**chosen)


def typed_cells(recipe: Recipe, typed: Typed, *, turned: bool) -> CellSettings | None:
    """Return what a recipe does with cells, with what was typed in; None if it looks for none.

    Angles that are given are those of beams, unless the object is turned. What a recipe that has
    angles of its own says of them holds.
    """
    numbers = {
        "smallest_um2": typed.get("smallest_cell"),
        "object_index": typed.get("object_index"),
        "refraction_increment_ml_per_g": typed.get("increment"),
        "oblique": typed.get("oblique"),
    }
    given: dict[str, Any] = {k: v for k, v in numbers.items() if v is not None}
    asked = any(value is not False for value in given.values())
    if not (typed.get("cells") or asked or recipe.cells is not None):
        return None
    own = has_angles(recipe)
    said = recipe.cells is not None and own
    on = (bool(typed.get("angle")) or own) and not said and not turned
    oblique = {"oblique": True} if on else {}
    return replace(recipe.cells or CellSettings(), **(oblique | given))


def has_angles(recipe: Recipe) -> bool:
    """Say whether a recipe knows its viewing angles; one view alone has none to be told."""
    if recipe.angles_deg is not None:
        return True
    return len(recipe.lobes) > 1 and not angles_unknown(recipe.lobes)


def typed_optics(typed: Typed) -> dict[str, float]:
    """Return the numbers of `Optics` that were typed in."""
    numbers = {
        "wavelength_um": typed.get("wavelength"),
        "camera_pixel_um": typed.get("camera_pixel"),
        "magnification": typed.get("magnification"),
    }
    return {name: number for name, number in numbers.items() if number is not None}


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
