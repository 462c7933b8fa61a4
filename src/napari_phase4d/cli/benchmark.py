"""The command that scores every installed method."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from napari_phase4d.cli.printing import bar, console, print_table

__all__ = ["benchmark"]

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
    from napari_phase4d.benchmark import (
        check_folder,
        run_benchmark,
        summary_of,
        write_benchmark,
    )
    from napari_phase4d.pipeline.ahead import warm_up

    check_folder(out)  # before minutes of work
    with bar() as progress:
        progress(0, 1, "compiling")
        warm_up()  # which would count as the time of the first method
        table = run_benchmark(method, group, progress)
    summary = summary_of(table)
    shown = summary[list(SHOWN)]
    for name in ("ns_a_voxel", "peak_mb"):
        shown = shown.assign(**{name: [f"{value:.0f}" for value in shown[name]]})
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
