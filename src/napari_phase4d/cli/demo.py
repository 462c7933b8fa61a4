"""The demo: the whole chain on a simulated video."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from napari_phase4d.cli.console import console
from napari_phase4d.cli.printing import bar, print_lobes, print_start, print_table, write_picture
from napari_phase4d.pipeline import Recipe, run, write_outcome
from napari_phase4d.sample import euglena_sample

__all__ = ["demo"]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for pictures and results.")] = Path(
        "demo_output"
    ),
    headless: Annotated[
        bool, typer.Option("--headless", help="Run to the end without waiting for a user.")
    ] = False,
) -> None:
    """Show the whole chain on a simulated hologram video of a swimming euglena."""
    if not headless:
        from napari_phase4d._napari.demo import open_demo

        open_demo()
        return
    console.print("Simulating a hologram video: a euglena, two views, 40 frames ...")
    sample = euglena_sample()
    recipe = Recipe(
        recording=sample.recording.source,
        angles_deg=sample.angles_deg,
    )
    with bar() as progress:
        plain = run(recipe, sample.recording, progress=progress)
    truth = sample.truth(plain.reconstruction["phase"])
    outcome = replace(plain, comparison=plain.comparison.against(truth), truth=truth)
    print_lobes(outcome.recipe.lobes)
    print_start(outcome)
    print_table(outcome.comparison.table)
    written = write_outcome(outcome, out)
    picture = out / "comparison.png"
    write_picture(outcome, truth, picture)
    from napari_phase4d._napari.demo import picture_of_the_window

    screenshot = picture_of_the_window(out / "window.png")
    console.print(f"\nResults are in [bold]{out.resolve()}[/bold]:")
    for path in [screenshot, picture, *written]:
        console.print(f"  {path.name}")
