"""The demo, the whole chain on a simulated video, and the paper once more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from napari_phase4d.cli.printing import (
    bar,
    console,
    print_lobes,
    print_start,
    print_table,
    write_picture,
)
from napari_phase4d.pipeline import Recipe, run, write_outcome
from napari_phase4d.sample import euglena_sample
from napari_phase4d.task import Task

__all__ = ["demo", "reproduce"]


def demo(
    out: Annotated[Path, typer.Option(help="Folder for pictures and results.")] = Path(
        "demo_output"
    ),
    headless: Annotated[
        bool, typer.Option("--headless", help="Run to the end without waiting for a user.")
    ] = False,
) -> None:
    """Show the whole chain on a simulated hologram video of a swimming euglena."""
    window = window_of_napari()
    if not headless:
        window.open_demo()
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
    screenshot = window.picture_of_the_window(out / "window.png")
    console.print(f"\nResults are in [bold]{out.resolve()}[/bold]:")
    for path in [screenshot, picture, *written]:
        console.print(f"  {path.name}")


def window_of_napari() -> Any:
    """Return what opens napari's window; both ways of the demo do.

    Raises
    ------
    ImportError
        If napari or Qt are missing; one sentence says what to install.
    """
    try:
        from napari_phase4d._napari import demo as window
    except ImportError as error:
        msg = (
            "the demo opens napari's window, which needs napari and Qt; run: "
            'pip install "napari-phase4d[all]"'
        )
        raise ImportError(msg) from error
    return window


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for figures, table and movies.")] = Path(
        "reproduction"
    ),
    movies: Annotated[bool, typer.Option(help="Also write the movies.")] = True,
) -> None:
    """Reproduce the paper's table, its Figs. 2 and 4, and its visualizations."""
    from napari_phase4d.reproduction import reproduce as reproduce_all
    from napari_phase4d.reproduction import write_reproduction

    with bar() as progress:
        found = reproduce_all(Task(progress))
        print_table(found.table, "Budding yeast, 6 angles, 19 times")
        written = write_reproduction(found, out, movies=movies, task=Task(progress))
    console.print(f"{len(written)} files written to [bold]{out.resolve()}[/bold]:")
    for path in written:
        console.print(f"  {path.name}")
