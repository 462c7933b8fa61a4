"""The program that all commands belong to."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated

import typer
from rich.markup import escape

import napari_phase4d
from napari_phase4d.cli.benchmark import benchmark
from napari_phase4d.cli.demo import demo, reproduce
from napari_phase4d.cli.live import watch_command
from napari_phase4d.cli.look import info, look
from napari_phase4d.cli.printing import console, errors
from napari_phase4d.cli.running import compare_command, run_command
from napari_phase4d.pipeline import EXPECTED, sentence_of

__all__ = ["app", "main"]

app = typer.Typer(
    help="From a multiplexed off-axis hologram video to unwrapped phase.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def show_version(wanted: bool) -> None:
    """Print the version and stop, if that is wanted."""
    if wanted:
        console.print(napari_phase4d.__version__)
        raise typer.Exit


@app.callback()
def for_all_commands(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=show_version, is_eager=True, help="Print the version and stop."
        ),
    ] = False,
) -> None:
    """Take what belongs to no command."""


# In the order of the help.
app.command("demo")(demo)
app.command("info")(info)
app.command("look")(look)
app.command("run")(run_command)
app.command("watch")(watch_command)
app.command("compare")(compare_command)
app.command("reproduce")(reproduce)
app.command("benchmark")(benchmark)


def main() -> None:
    """Run the command line; a wrong input ends it with one sentence instead of a traceback."""
    try:
        check_words(sys.argv[1:])
        with warnings.catch_warnings():
            warnings.showwarning = say_doubt
            app()
    except EXPECTED as error:
        errors.print(f"[red]Error:[/red] {escape(sentence_of(error))}")
        raise SystemExit(1) from None


def check_words(words: Sequence[str]) -> None:
    """Raise ValueError for an empty word: as a folder it would be the one the program runs in."""
    for before, word in pairwise(["", *words]):
        if not word or (word.startswith("--") and word.endswith("=")):
            after = f" after {word or before}" if word or before else ""
            msg = f"a word{after} is empty; was a variable of a script never set?"
            raise ValueError(msg)


def say_doubt(message: Warning | str, *_: object, **__: object) -> None:
    """Print what is probably wrong with the input in words, without the line of the program."""
    errors.print(f"[yellow]{escape(' '.join(str(message).split()))}[/yellow]")
