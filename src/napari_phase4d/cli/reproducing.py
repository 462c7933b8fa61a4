"""The paper, once more."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from napari_phase4d.cli.console import console
from napari_phase4d.cli.printing import bar, print_table

__all__ = ["reproduce"]


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
        found = reproduce_all(progress)
        print_table(found.table, "Budding yeast, 6 angles, 19 times")
        written = write_reproduction(found, out, movies=movies, progress=progress)
    console.print(f"{len(written)} files written to [bold]{out.resolve()}[/bold]:")
    for path in written:
        console.print(f"  {path.name}")
