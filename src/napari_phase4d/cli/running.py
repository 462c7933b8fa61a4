"""From files to unwrapped phase."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
import xarray as xr

from napari_phase4d.cli.batches import batch, stoppable
from napari_phase4d.cli.console import console
from napari_phase4d.cli.options import (
    Angles,
    Boundary,
    Confidence,
    Dataset,
    Raw,
    Refocus,
    Storage,
    TiltPerFrame,
    Views,
    WholeField,
    recipe_and_files,
    with_settings,
)
from napari_phase4d.cli.printing import (
    bar,
    print_lobes,
    print_missed_views,
    print_notes,
    print_start,
    print_table,
    print_verdict,
)
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import (
    Outcome,
    Recipe,
    checked_form,
    fingerprinting,
    found_anywhere,
    open_by,
    result_folder,
    run,
    stacks_beside,
    write_outcome,
)
from napari_phase4d.recording import Recording
from napari_phase4d.words import counted

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
    resume: Annotated[
        bool, typer.Option("--resume", help="Leave files whose results are complete as they are.")
    ] = False,
    form: Annotated[
        str | None,
        typer.Option(help="tiff or zarr: OME-TIFF (default), or OME-Zarr, also beyond memory."),
    ] = None,
    dataset: Dataset = None,
    raw: Raw = None,
    storage: Storage = None,
    refocus: Refocus = None,
    tilt_per_frame: TiltPerFrame = False,
    whole_field: WholeField = False,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a dask.distributed scheduler to work on.")
    ] = None,
) -> None:
    """Take recordings from file to unwrapped phase, table and recipe.

    Several files, or --resume, make a batch: a folder for each, and a summary.
    """
    checked_form(form)
    recipe, files = recipe_and_files(inputs)
    recipe = with_settings(
        recipe,
        views=views,
        angle=angle,
        boundary=boundary,
        method=method,
        frame_rate=frame_rate,
        confidence=confidence,
        dataset=dataset,
        raw=raw,
        storage=storage,
        refocus=refocus,
        tilt_per_frame=tilt_per_frame,
        whole_field=whole_field,
    )
    adapt = partial(
        typed_in,
        wavelength_um=wavelength,
        camera_pixel_um=camera_pixel,
        magnification=magnification,
    )
    with stoppable():
        if len(files) > 1 or (files and resume):
            wishes = {"resume": resume, "form": form, "scheduler": scheduler}
            batch(recipe, files, out, prepared=adapt, **wishes)
        else:
            named = {"recording": found_anywhere(files[0])} if files else {}
            process(adapt(recipe.changed(**named)), out, form, scheduler)


def typed_in(recipe: Recipe, **numbers: float | None) -> Recipe:
    """Return a recipe with the optics that were typed in; the rest is as the file says."""
    typed = {name: number for name, number in numbers.items() if number is not None}
    if not typed or not recipe.recording:
        return recipe
    known = recipe.optics or optics_of(open_by(recipe))
    return recipe.changed(optics=replace(known, **typed))


def process(recipe: Recipe, folder: Path, form: str | None, scheduler: str | None) -> None:
    """Run one recording and write what comes out."""
    if not recipe.recording:
        run(recipe)  # which says what is missing
    with (
        result_folder(folder, recipe) as kept,
        fingerprinting(recipe.recording) as hashing,
        stacks_beside(folder, form) as place,
    ):
        with bar() as progress:
            outcome: Outcome = run(recipe, progress=progress, folder=place, scheduler=scheduler)
        print_notes(outcome)
        print_lobes(outcome.recipe.lobes)
        print_missed_views(outcome, recipe)
        print_start(outcome)
        print_table(outcome.comparison.table)
        with bar() as progress:
            source = hashing.result()
            written = write_outcome(outcome, folder, progress, form=form, source=source)
            kept.settle(written, recipe.recording, source)
        if recipe.confidence:
            print_verdict(outcome)
    console.print(f"{counted(len(written), 'file')} written to [bold]{folder.resolve()}[/bold]")


def optics_of(opened: Recording | xr.DataArray) -> Optics:
    """Return the microscope that a file names, or the paper's."""
    return opened.optics if isinstance(opened, Recording) else Optics()
