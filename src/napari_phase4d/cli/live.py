"""Phase while one records: the command that watches a recording grow."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Unpack

import typer
from rich.markup import escape

from napari_phase4d.cli.options import (
    Typed,
    recipe_and_files,
    taking_settings,
    typed_optics,
    with_settings,
)
from napari_phase4d.cli.printing import (
    console,
    errors,
    print_cells,
    print_lobes,
    print_notes,
    print_start,
    print_table,
)
from napari_phase4d.cli.running import ToldToEndError, listening
from napari_phase4d.io import FromCamera
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import LiveStatus, Recipe, watch
from napari_phase4d.words import counted

__all__ = ["watch_command"]

#: Seconds between two lines of what is done at the end.
LINE_S = 2.0


@taking_settings(but=("confidence", "raw", "storage"))
def watch_command(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            help="A folder that gets an image a frame, a TIFF that gets pages, or a Zarr array "
            "that grows, there already or not; a .json beside it is the recipe."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("phase4d_output"),
    frames: Annotated[int | None, typer.Option(help="End after so many frames.")] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            help="Configuration of Micro-Manager (.cfg), or demo: its camera is started, and "
            "writes its frames into the folder."
        ),
    ] = None,
    patience: Annotated[
        float, typer.Option(help="End after so many seconds without a new frame.")
    ] = 30.0,
    frame_patience: Annotated[
        float,
        typer.Option(
            help="Give up a frame that was announced and is not whole after so many seconds."
        ),
    ] = 5.0,
    first_frames: Annotated[
        int | None,
        typer.Option(
            help="Find lobes, background and focus on so many frames at the beginning; default 8."
        ),
    ] = None,
    *,
    form: Annotated[
        str | None, typer.Option(help="tiff or zarr: OME-TIFF, or OME-Zarr (default).")
    ] = None,
    **typed: Unpack[Typed],
) -> None:
    """Work on a recording while it is written, and write its results when it is complete.

    It is complete after --frames, or --patience seconds without a new one. Ctrl-C ends it
    earlier, and writes the results of what has come; a second one gives them up.
    """
    recipe, files = recipe_and_files(inputs)
    source = the_one(recipe, files)
    recipe = with_settings(recipe, **typed)
    if first_frames is not None:
        recipe = recipe.changed(first_frames=first_frames)
    if numbers := typed_optics(typed):  # there is no file yet that may say the rest
        recipe = recipe.changed(optics=replace(recipe.optics or Optics(), **numbers))
    with ending() as came:
        outcome = watch(
            source if camera is None else FromCamera.configured(camera, source, frames),
            recipe,
            out,
            frames=frames,
            patience_s=patience,
            frame_patience_s=frame_patience,
            form=form,
            told=tell,
            status=tell_status,
            progress=Lines(),
            stopped=lambda: bool(came),
        )
    print_notes(outcome)
    print_lobes(outcome.recipe.lobes)
    print_start(outcome)
    print_table(outcome.comparison.table)
    print_cells(outcome)
    n_frames = outcome.reconstruction.sizes["time"]
    console.print(f"{counted(n_frames, 'frame')}: results are in [bold]{out.resolve()}[/bold]")
    if came:
        raise typer.Exit(128 + came[0])


def the_one(recipe: Recipe, files: list[Path]) -> Path:
    """Return what is to be watched.

    Raises
    ------
    ValueError
        If it is not one folder or file.
    """
    named = files or ([Path(recipe.recording)] if recipe.recording else [])
    if len(named) != 1:
        msg = f"give one folder or file to watch, not {len(named)}"
        raise ValueError(msg)
    return named[0]


def tell(line: str) -> None:
    """Print what happened."""
    console.print(f"[yellow]{escape(line[:1].upper() + line[1:])}.[/yellow]")


def tell_status(status: LiveStatus) -> None:
    """Print how far it is."""
    console.print(status.sentence)


class Lines:
    """Prints how far what is done at the end is, now and then."""

    def __init__(self) -> None:
        self._next = time.monotonic() + LINE_S

    def __call__(self, done: int, total: int, message: str) -> None:
        """Take a step."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + LINE_S
            console.print(f"{escape(message)}: {done} of {total}")


@contextmanager
def ending() -> Iterator[list[int]]:
    """Give the signals that have come: the first is a wish to end well, a second one to give up.

    Yields
    ------
    list of int
        Empty until one comes.
    """
    came: list[int] = []

    def stop(number: int, _: object) -> None:
        came.append(number)
        if len(came) > 1:
            raise ToldToEndError

    before = listening(stop, ("SIGINT", "SIGTERM", "SIGHUP"))
    try:
        yield came
    except KeyboardInterrupt:
        errors.print("Given up; no results are written.")
        raise typer.Exit(128 + came[0] if came else 128 + signal.SIGINT) from None
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
