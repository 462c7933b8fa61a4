"""One file after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer
from rich.markup import escape

from napari_phase4d.cli.console import console, errors
from napari_phase4d.cli.printing import bar
from napari_phase4d.pipeline import Recipe, run_batch

__all__ = ["batch", "stoppable"]

#: What a shell gives for a program that Ctrl-C has ended.
STOPPED_BY_USER = 130


def batch(recipe: Recipe, files: Sequence[Path], out: Path, **options: Any) -> None:
    """Work on each file, see `run_batch`; of several, one that fails does not stop the others.

    Raises
    ------
    ValueError
        If any failed.
    """
    with bar() as progress:
        table = run_batch(recipe, files, out, progress=progress, told=tell, **options)
    console.print(f"The summary is in [bold]{(out / 'summary.csv').resolve()}[/bold]")
    failed = table[table["status"] == "failed"]
    if len(failed):
        names = ", ".join(Path(file).name for file in failed["file"])
        msg = f"{len(failed)} of {len(table)} files failed: {names}"
        raise ValueError(msg)


def tell(line: str) -> None:
    """Print a line of the log."""
    console.print(escape(line))


@contextmanager
def stoppable() -> Iterator[None]:
    """Let Ctrl-C end the work with one sentence."""
    try:
        yield
    except KeyboardInterrupt:
        errors.print("Stopped by Ctrl-C. What is written is whole; --resume goes on with a batch.")
        raise typer.Exit(STOPPED_BY_USER) from None
