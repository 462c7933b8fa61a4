"""The program that all commands belong to."""

from __future__ import annotations

import typer
from rich.markup import escape

from napari_phase4d.cli.comparing import compare_command
from napari_phase4d.cli.console import errors
from napari_phase4d.cli.demo import demo
from napari_phase4d.cli.info import info
from napari_phase4d.cli.look import look
from napari_phase4d.cli.reproducing import reproduce
from napari_phase4d.cli.running import run_command
from napari_phase4d.pipeline import EXPECTED, sentence_of

__all__ = ["app", "main"]

app = typer.Typer(
    help="From a multiplexed off-axis hologram video to unwrapped phase.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
# In the order of the help.
app.command("demo")(demo)
app.command("info")(info)
app.command("look")(look)
app.command("run")(run_command)
app.command("compare")(compare_command)
app.command("reproduce")(reproduce)


def main() -> None:
    """Run the command line; a wrong input ends it with one sentence instead of a traceback."""
    try:
        app()
    except EXPECTED as error:
        errors.print(f"[red]Error:[/red] {escape(sentence_of(error))}")
        raise SystemExit(1) from None
