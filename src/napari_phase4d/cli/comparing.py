"""All methods side by side."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
import xarray as xr
from rich.markup import escape

from napari_phase4d.analysis import (
    best_known,
    itoh_margin,
    order_shares,
    order_verdict,
    residues,
    steps_sentence,
)
from napari_phase4d.cli.batches import batch, stoppable
from napari_phase4d.cli.console import console
from napari_phase4d.cli.options import (
    Angles,
    Boundary,
    Confidence,
    Dataset,
    Raw,
    Refocus,
    TiltPerFrame,
    Views,
    WholeField,
    is_recipe,
    recipe_and_files,
    with_settings,
)
from napari_phase4d.cli.printing import (
    bar,
    print_missed_views,
    print_notes,
    print_start,
    print_table,
    print_verdict,
    write_picture,
)
from napari_phase4d.io import open_phase
from napari_phase4d.pipeline import (
    Outcome,
    Recipe,
    fingerprinting,
    found_anywhere,
    result_folder,
    run,
    sentence_of,
    stacks_beside,
    write_outcome,
)
from napari_phase4d.unwrapping import METHODS

#: The picture of all results.
PICTURE = "comparison.png"

__all__ = ["compare_command"]


def compare_command(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            help="Wrapped phase (OME-TIFF of this program, NPY, NPZ, TIFF) or hologram videos; "
            "a .json among them is the recipe."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("phase4d_compare"),
    truth: Annotated[
        Path | None, typer.Option(help="Exact or published phase on the same grid.")
    ] = None,
    views: Views = None,
    angle: Angles = None,
    boundary: Boundary = None,
    method: Annotated[
        list[str] | None, typer.Option(help="Method id; default: all of them.")
    ] = None,
    *,
    confidence: Confidence = False,
    dataset: Dataset = None,
    raw: Raw = None,
    refocus: Refocus = None,
    tilt_per_frame: TiltPerFrame = False,
    whole_field: WholeField = False,
) -> None:
    """Put all methods side by side: table, picture, and where unwrapping has to fail."""
    recipe, files = recipe_and_files(inputs)
    all_methods = None if any(is_recipe(p) for p in inputs) else list(METHODS)
    recipe = with_settings(
        recipe,
        views=views,
        angle=angle,
        boundary=boundary,
        method=method or all_methods,
        confidence=confidence,
        dataset=dataset,
        raw=raw,
        refocus=refocus,
        tilt_per_frame=tilt_per_frame,
        whole_field=whole_field,
    )
    exact = None if truth is None else open_phase(truth)
    if not files and not recipe.recording:
        msg = "give at least one file to compare the methods on"
        raise ValueError(msg)
    with stoppable():
        if len(files) > 1:
            batch(recipe, files, out, truth=exact, finished=partial(finish, exact))
            return
        recording = found_anywhere(files[0] if files else recipe.recording)
        compare_one(recipe.changed(recording=recording), exact, out)


def compare_one(recipe: Recipe, exact: xr.DataArray | None, out: Path) -> None:
    """Compare the methods on one file, and write what comes out."""
    with (
        result_folder(out, recipe, [PICTURE]) as kept,
        fingerprinting(recipe.recording) as hashing,
        stacks_beside(out, None) as place,
        bar() as progress,
    ):
        outcome = run(recipe, truth=exact, progress=progress, folder=place)
        written = write_outcome(outcome, out, progress, source=hashing.result())
        kept.settle([*written, out / PICTURE], recipe.recording, hashing.result())
    print_missed_views(outcome, recipe)
    finish(exact, outcome, out)
    console.print(f"{len(written) + 1} files written to [bold]{out.resolve()}[/bold]")


def finish(exact: xr.DataArray | None, outcome: Outcome, folder: Path) -> None:
    """Print the table and what is known of the steps, and write the picture."""
    print_notes(outcome)
    print_start(outcome)
    print_table(outcome.comparison.table)
    try:
        print_itoh(outcome, exact)
    except OSError as error:  # results larger than memory
        console.print(f"[yellow]{escape(sentence_of(error))}[/yellow]")
    write_picture(outcome, exact, folder / PICTURE)


def print_itoh(outcome: Outcome, exact: xr.DataArray | None) -> None:
    """Say where steps are too large, and which order suits the object."""
    results = outcome.comparison.results
    known, origin = best_known(results, exact)
    found = residues(outcome.reconstruction["phase"])
    console.print(steps_sentence(itoh_margin(known), origin))
    console.print(f"Residues in the wrapped phase: {int(abs(found).sum())}")
    ways = order_shares(known, outcome.recipe.start_frames[0])
    words = ", ".join(f"{METHODS[m].label} {100 * share:.2f} %" for m, share in ways.items())
    verdict = order_verdict(results, outcome.recipe.start_frames[0], exact)
    console.print(f"Of the steps on their way: {words}. {verdict}")
    labels = outcome.comparison.table["method"]
    for method, sentence in outcome.comparison.warnings().items():
        console.print(f"[yellow]{labels[method]}: {sentence}[/yellow]")
    print_verdict(outcome)
