"""The page of a benchmark: its table, its figure, what the numbers mean, how to cite it."""

from __future__ import annotations

import html
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from napari_phase4d.benchmark.cases import GROUPS, SUITE_VERSION
from napari_phase4d.benchmark.scoring import summary_of
from napari_phase4d.io import write_figure, write_table
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.later import pd
from napari_phase4d.pipeline import program_version
from napari_phase4d.words import counted, local_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["check_folder", "write_benchmark"]

TABLE, SUMMARY, FIGURE, PAGE = "benchmark.csv", "summary.csv", "benchmark.png", "benchmark.html"
#: Share of wrong cycles in percent that has the darkest colour.
DARKEST_PERCENT = 30.0
#: Column of the summary -> its heading, how it is written, and whether less is better.
COLUMNS = {
    "method": ("method", "{}"),
    **{group: (group, "{:.2f}") for group in GROUPS},
    "all": ("all groups", "{:.2f}"),
    "worst": ("worst recording", "{:.1f}"),
    "mse_rad2": ("mean squared error (rad²)", "{:.4f}"),
    "confidence_auc": ("confidence: area under curve", "{:.3f}"),
    "ns_a_voxel": ("time (ns a pixel)", "{:.0f}"),
    "peak_mb": ("most memory (MB)", "{:.0f}"),
    "without_result": ("recordings without result", "{}"),
}
STYLE = """
body { font: 15px/1.5 sans-serif; max-width: 75em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: 1em 0 }
th, td { padding: .3em .6em; border-bottom: 1px solid #ccc; text-align: right }
th:first-child, td:first-child { text-align: left }
img { max-width: 100% }
"""
MEANING = """
<p>Wrong cycles: of the object's pixels, the percentage whose cycle is off relative to the empty
field of their frame, since nothing in a recording tells a level of 2π n from none. Each group is
the mean of its recordings; <i>all groups</i> is the mean of the groups. Mean squared error: of all
pixels, relative to the same field. Confidence: how often a wrong pixel is trusted less than a
right one; 0.5 is chance, 1 always. Time depends on the machine and counts everything that a
method needs; memory is what it took beyond what was taken before it, so that what methods share
counts with the first. What a method gives nothing for counts as all wrong. Every method starts
from the frame in which the object is thinnest.</p>
"""


def check_folder(folder: str | Path) -> Path:
    """Return a folder that a benchmark may be written to.

    Raises
    ------
    OSError
        If a file would be written over that no benchmark has made.
    """
    folder = local_path(folder)
    nearest = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not nearest.is_dir() or not os.access(nearest, os.W_OK):
        msg = f"the folder {folder} can't be made or written to; choose another one"
        raise OSError(msg)
    there = [name for name in (TABLE, SUMMARY, FIGURE, PAGE) if (folder / name).exists()]
    if there and not is_ours(folder / TABLE):
        msg = f"{folder / there[0]} was not made by a benchmark; choose another folder"
        raise OSError(msg)
    return folder


def is_ours(path: Path) -> bool:
    """Say whether a table begins as those that are written here."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.readline(100).startswith("suite,group,case,id,method")
    except OSError:
        return False


def write_benchmark(table: pd.DataFrame, folder: str | Path) -> list[Path]:
    """Write the rows, the summary, the figure and a page with all of it.

    Parameters
    ----------
    table : pandas.DataFrame
        What `run_benchmark` gave.
    folder : str or Path
        Where to write; made if it is not there. The files of an earlier benchmark are replaced.

    Returns
    -------
    list of Path
        ``benchmark.csv``, ``summary.csv``, ``benchmark.png`` and ``benchmark.html``.

    Raises
    ------
    OSError
        If a file can't be written, or one would be replaced that no benchmark has made.
    """
    folder = check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    summary = summary_of(table)
    written = [
        write_table(folder / TABLE, table.set_index("suite")),
        write_table(folder / SUMMARY, summary),
        write_figure(folder / FIGURE, heat_map(summary)),
    ]
    page = folder / PAGE
    with written_whole(page) as temporary:
        temporary.write_text(page_of(table, summary), encoding="utf-8")
    return [*written, page]


def heat_map(summary: pd.DataFrame) -> Figure:
    """Return a picture of wrong cycles, a row for each method, a column for each group."""
    from matplotlib.figure import Figure

    groups = [name for name in (*GROUPS, "all") if name in summary.columns]
    values = summary[groups].to_numpy(dtype=float)
    figure = Figure(figsize=(1.5 + 1.25 * len(groups), 1.6 + 0.34 * len(summary)))
    axes = figure.add_subplot()
    # By the logarithm, as methods differ by factors; what is below a hundredth of a percent is 0.
    axes.imshow(
        np.log10(np.clip(np.nan_to_num(values, nan=DARKEST_PERCENT), 0.01, None)),
        cmap="cividis_r", vmin=-2, vmax=np.log10(DARKEST_PERCENT), aspect="auto",
    )  # fmt: skip
    for (row, column), value in np.ndenumerate(values):
        axes.text(
            column, row, f"{value:.2f}", ha="center", va="center", fontsize=8,
            color="white" if value > 1.5 or np.isnan(value) else "black",
        )  # fmt: skip
    axes.set_xticks(
        range(len(groups)), [name.replace(" ", "\n", 1) for name in groups], fontsize=8
    )
    axes.set_yticks(range(len(summary)), list(summary["method"]), fontsize=9)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    figure.supxlabel(f"Wrong cycles in % of the object, suite {SUITE_VERSION}", fontsize=9)
    figure.tight_layout()
    return figure


def page_of(table: pd.DataFrame, summary: pd.DataFrame) -> str:
    """Return the page as HTML that needs nothing but the figure beside it."""
    columns = {name: how for name, how in COLUMNS.items() if name in summary.columns}
    head = "".join(f"<th>{html.escape(words)}</th>" for words, _ in columns.values())
    body = "\n".join(
        "<tr>" + "".join(f"<td>{cell_of(row[n], how)}</td>" for n, (_, how) in columns.items())
        + "</tr>"
        for _, row in summary.iterrows()
    )  # fmt: skip
    recordings = counted(table.groupby(["group", "case"]).ngroups, "recording")
    version, day = program_version(), datetime.now(UTC).date()
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>4-D phase unwrapping benchmark {SUITE_VERSION}</title>
<style>{STYLE}</style></head>
<body>
<h1>4-D phase unwrapping benchmark, suite {SUITE_VERSION}</h1>
<p>{recordings} with exact phase, (time, angle, y, x); napari-phase4d {version}, {day}.
Wrong cycles in percent, the best method first.</p>
<table><thead><tr>{head}</tr></thead><tbody>
{body}
</tbody></table>
<p><img src="{FIGURE}" alt="Wrong cycles of each method in each group"></p>
<h2>What the numbers mean</h2>{MEANING}
<p>Every recording by itself is in <a href="{TABLE}">{TABLE}</a>.</p>
<h2>Your own method</h2>
<p>Install a package with the entry point <code>napari_phase4d.methods</code>, and run
<code>napari-phase4d benchmark</code> again: it is scored with the others.</p>
<h2>How to cite</h2>
<p>The napari-phase4d developers, <i>napari-phase4d {version}, 4-D phase unwrapping benchmark,
suite {SUITE_VERSION}</i>, {day.year}. Say the version of the suite: figures of different suites
can't be compared.</p>
</body></html>
"""


def cell_of(value: object, how: str) -> str:
    """Return a number as it stands in the table; a dash where there is none."""
    return "–" if value != value else html.escape(how.format(value))
