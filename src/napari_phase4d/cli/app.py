"""The program that all commands belong to; the demo, the paper once more, and the benchmark."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape

import napari_phase4d
from napari_phase4d.cli.look import info, look
from napari_phase4d.cli.printing import (
    bar,
    console,
    errors,
    print_lobes,
    print_start,
    print_table,
    write_picture,
)
from napari_phase4d.cli.running import compare_command, run_command, watch_command
from napari_phase4d.pipeline import (
    EXPECTED,
    Recipe,
    result_folder,
    run,
    sentence_of,
    write_files,
)
from napari_phase4d.pipeline.provenance import source_of
from napari_phase4d.sample import euglena_sample
from napari_phase4d.task import Task

__all__ = ["app", "main"]

#: Columns of the summary that are printed, with their headings; all are in the page.
SHOWN = {
    "method": "method",
    "all": "wrong (%)",
    "worst": "worst (%)",
    "mse_rad2": "MSE (rad²)",
    "confidence_auc": "AUC",
    "ns_a_voxel": "ns a pixel",
    "peak_mb": "MB",
    "without_result": "failed",
}


def benchmark(
    out: Annotated[Path, typer.Option(help="Folder for the page, its table and figure.")] = Path(
        "phase4d_benchmark"
    ),
    method: Annotated[
        list[str] | None, typer.Option(help="Id of a method; once for each. Default: all.")
    ] = None,
    group: Annotated[
        list[str] | None, typer.Option(help="Group of recordings; once for each. Default: all.")
    ] = None,
) -> None:
    """Score every installed unwrapper on a fixed suite of 4-D recordings with exact truth."""
    from napari_phase4d.benchmark import check_folder, run_benchmark, summary_of, write_benchmark
    from napari_phase4d.benchmark.scoring import cell_of
    from napari_phase4d.pipeline.ahead import warm_up

    check_folder(out)  # before minutes of work
    with bar() as progress:
        progress(0, 1, "compiling")
        warm_up()  # which would count as the time of the first method
        table = run_benchmark(method, group, progress)
    summary = summary_of(table)
    shown = summary[list(SHOWN)]
    for name in ("ns_a_voxel", "peak_mb"):
        shown = shown.assign(**{name: [cell_of(value, "{:.0f}") for value in shown[name]]})
    print_table(
        shown.rename(columns=SHOWN),
        "Wrong cycles in % of the object, mean of the groups; AUC of the confidence",
    )
    written = write_benchmark(table, out)
    faults = table[table["fault"] != ""]
    for label, fault in faults.groupby("method")["fault"].first().items():
        console.print(f"[yellow]{escape(f'{label}: {fault}')}[/yellow]")
    console.print(f"{len(written)} files written to [bold]{escape(str(out.resolve()))}[/bold]:")
    for path in written:
        console.print(f"  {path.name}")


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
    picture, screenshot = out / "comparison.png", out / "window.png"
    with result_folder(out, recipe, [picture.name, screenshot.name]) as kept:
        with bar() as progress:
            plain = run(recipe, sample.recording, progress=progress)
        truth = sample.truth(plain.reconstruction["phase"])
        outcome = replace(plain, comparison=plain.comparison.against(truth), truth=truth)
        print_lobes(outcome.recipe.lobes, outcome.recipe.optics)
        print_start(outcome)
        print_table(outcome.comparison.table)
        source = source_of(outcome)
        results = write_files(outcome, out, source=source)
        write_picture(outcome, truth, picture)
        window.picture_of_the_window(screenshot)
        written = [screenshot, picture, *results]
        kept.settle(written, recipe.recording, source)
    console.print(f"\nResults are in [bold]{out.resolve()}[/bold]:")
    for path in written:
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
    from napari_phase4d.reproduction import check_reproduction_folder, write_reproduction
    from napari_phase4d.reproduction import reproduce as reproduce_all

    check_reproduction_folder(out)  # before minutes of work
    with bar() as progress:
        found = reproduce_all(Task(progress))
        print_table(found.table, "Budding yeast, 6 angles, 19 times")
        written = write_reproduction(found, out, movies=movies, task=Task(progress))
    console.print(f"{len(written)} files written to [bold]{out.resolve()}[/bold]:")
    for path in written:
        console.print(f"  {path.name}")


# ---- all commands ---------------------------------------------------------------------------


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
