"""One file after the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.markup import escape

from napari_phase4d.cli.console import console, errors

__all__ = ["batch"]


def batch(work: Callable[[Path, Path], None], files: Sequence[Path], out: Path) -> None:
    """Work on each file; of several, one that fails does not stop the others."""
    if len(files) == 1:
        work(files[0], out)
        return
    failed = []
    for file, folder in zip(files, result_folders(files, out), strict=True):
        console.print(f"[bold]{escape(file.name)}[/bold]")
        try:
            work(file, folder)
        except (OSError, TypeError, ValueError) as error:
            failed.append(file.name)
            errors.print(f"[red]Error:[/red] {escape(str(error))}")
    if failed:
        msg = f"{len(failed)} of {len(files)} files failed: {', '.join(failed)}"
        raise ValueError(msg)


def result_folders(files: Sequence[Path], out: Path) -> list[Path]:
    """Return a folder for every file: its name, numbered where two files share it."""
    folders: list[Path] = []
    for file in files:
        candidates = (
            out / f"{file.stem.replace(':', '_')}{end}"
            for end in ("", *(f"_{i}" for i in range(2, 10**6)))
        )
        folders.append(next(c for c in candidates if c not in folders))
    return folders
