"""From files to unwrapped phase."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
import xarray as xr

from napari_phase4d.cli.batches import batch
from napari_phase4d.cli.console import console
from napari_phase4d.cli.options import (
    Angles,
    Boundary,
    Confidence,
    Views,
    recipe_and_files,
    with_settings,
)
from napari_phase4d.cli.printing import bar, print_lobes, print_notes, print_table
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import Outcome, Recipe, found_anywhere, open_by, run, write_outcome
from napari_phase4d.recording import Recording

__all__ = ["run_command"]


def run_command(
    inputs: Annotated[
        list[Path], typer.Argument(help="Hologram videos; a .json among them is the recipe.")
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("phase4d_output"),
    views: Views = None,
    angle: Angles = None,
    boundary: Boundary = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Method id; may be given several times.")
    ] = None,
    wavelength: Annotated[float | None, typer.Option(help="Wavelength in um.")] = None,
    camera_pixel: Annotated[float | None, typer.Option(help="Camera pixel in um.")] = None,
    magnification: Annotated[float | None, typer.Option(help="From sample to camera.")] = None,
    frame_rate: Annotated[float | None, typer.Option(help="Frames per second.")] = None,
    *,
    confidence: Confidence = False,
) -> None:
    """Take recordings from file to unwrapped phase, table and recipe."""
    recipe, files = recipe_and_files(inputs)
    recipe = with_settings(
        recipe, views, angle, boundary, method, frame_rate, confidence=confidence
    )
    numbers = {
        "wavelength_um": wavelength,
        "camera_pixel_um": camera_pixel,
        "magnification": magnification,
    }
    typed = {name: number for name, number in numbers.items() if number is not None}
    if not files:
        process(recipe, typed, out)
    else:
        batch(
            lambda file, folder: process(
                recipe.changed(recording=found_anywhere(file)), typed, folder
            ),
            files,
            out,
        )


def process(recipe: Recipe, typed: dict[str, float], folder: Path) -> None:
    """Run one recording, with the optics that were typed in, and write what comes out."""
    if typed and recipe.recording:
        known = recipe.optics or optics_of(open_by(recipe))
        recipe = recipe.changed(optics=replace(known, **typed))
    with bar() as progress:
        outcome: Outcome = run(recipe, progress=progress)
    print_notes(outcome)
    print_lobes(outcome.recipe.lobes)
    print_table(outcome.comparison.table)
    written = write_outcome(outcome, folder)
    console.print(f"{len(written)} files written to [bold]{folder.resolve()}[/bold]")


def optics_of(opened: Recording | xr.DataArray) -> Optics:
    """Return the microscope that a file names, or the paper's."""
    return opened.optics if isinstance(opened, Recording) else Optics()
