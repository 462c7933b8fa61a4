"""What each method gets for each recording of the suite, and the page that shows it."""

from __future__ import annotations

import html
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.analysis import Comparison, compare
from napari_phase4d.benchmark.cases import GROUPS, SUITE_VERSION, Case, cases, checked_groups
from napari_phase4d.io import write_figure, write_table
from napari_phase4d.io.atomic import written_whole
from napari_phase4d.later import pd, xr
from napari_phase4d.pipeline import program_version
from napari_phase4d.task import Cancelled, CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.unwrapping import METHODS, check_method, methods_for
from napari_phase4d.words import counted, local_path, sentence_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["cell_of", "check_folder", "run_benchmark", "summary_of", "write_benchmark"]

TURN = 2 * np.pi
#: What a method gets that gave nothing.
NOTHING = dict.fromkeys(
    ("wrong_cycles_percent", "mse_rad2", "confidence_auc", "seconds", "peak_mb"), float("nan")
)
#: A level needs so many pixels of empty field, an area under the curve so many wrong pixels.
ENOUGH = 20


def run_benchmark(
    methods: Sequence[str] | None = None,
    groups: Sequence[str] | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> pd.DataFrame:
    """Score methods on the recordings of the suite.

    Parameters
    ----------
    methods : sequence of str, optional
        Ids or labels among `METHODS`, those of installed packages included. Default: all that need
        no more than one wavelength.
    groups : sequence of str, optional
        Some of `GROUPS`. Default: all.
    progress : callable, optional
        ``progress(done, total, message)`` after each recording.
    cancelled : callable, optional
        ``cancelled()`` stops the work.

    Returns
    -------
    pandas.DataFrame
        A row for each recording and method: ``suite`` (its version), ``group``, ``case``, ``id``,
        ``method``; ``wrong_cycles_percent``, of the object's pixels, those whose cycle is off
        relative to the empty field of their frame; ``mse_rad2``, the mean squared error of all
        pixels relative to the same; ``confidence_auc``, how often a wrong pixel is trusted less
        than a right one, 0.5 by chance, NaN where fewer than 20 pixels are wrong; ``seconds``,
        ``voxels``, ``peak_mb``; and ``fault``, why a method gave nothing.

    Raises
    ------
    ValueError
        If there is no such method or group.
    Cancelled
        If ``cancelled()`` returned True.

    Examples
    --------
    >>> from napari_phase4d.benchmark import run_benchmark
    >>> table = run_benchmark(["spatial-2d", "temporal-angular"], ["one view"])
    >>> [len(rows) for _, rows in table.groupby("id")]
    [4, 4]
    """
    task = Task(progress, cancelled)
    if methods is None:
        chosen = methods_for(None)
    else:
        chosen = [methods] if isinstance(methods, str) else list(methods)
    if not chosen or not (groups is None or groups):
        msg = "there is no method or group to score; leave them out for all"
        raise ValueError(msg)
    chosen = list(dict.fromkeys(check_method(method, {}) for method in chosen))
    names = checked_groups(groups)
    watch = Watch(sum(len(GROUPS[name]) for name in names), "scoring", task)
    watch.check()
    rows: list[dict[str, Any]] = []
    for case in cases(names):
        watch.message = f"{case.group}: {case.name}"
        rows += rows_of(case, chosen, Task(None, cancelled))
        watch.step()
    return pd.DataFrame(rows)


def rows_of(case: Case, methods: Sequence[str], task: Task) -> list[dict[str, Any]]:
    """Return a row for each method on a recording.

    All together, so that what they share is computed once; one by one where one of them fails.
    """
    try:
        found = unwrapped(case, methods, task)
        return [row_of(case, method) | scores_of(found, method, case) for method in methods]
    except Cancelled:
        raise
    except Exception as error:
        if len(methods) > 1:
            return [row for method in methods for row in rows_of(case, [method], task)]
        return [row_of(case, methods[0]) | NOTHING | {"fault": sentence_of(error)}]


def unwrapped(case: Case, methods: Sequence[str], task: Task) -> Comparison:
    """Return the results of methods on a recording."""
    return compare(
        case.wrapped, methods, case.boundary, amplitude=case.amplitude, cancelled=task.cancelled
    )


def row_of(case: Case, method: str) -> dict[str, Any]:
    """Return what tells a row from others."""
    return {
        "suite": SUITE_VERSION,
        "group": case.group,
        "case": case.name,
        "id": method,
        "method": METHODS[method].label,
        "voxels": case.voxels,
        "fault": "",
    }


def scores_of(found: Comparison, method: str, case: Case) -> dict[str, Any]:
    """Return how right a result is, how well its confidence knows, and what it cost."""
    result = found.results[method].transpose(*case.truth.dims)
    off = relative_to_field(result.values - case.truth.values, case.empty)
    known = np.isfinite(case.truth.values)
    # A method that gives nothing where there is truth is wrong there, by the phase itself.
    off = np.where(known & ~np.isfinite(off), case.truth.values, off)
    wrong = (np.round(np.nan_to_num(off) / TURN) != 0) | (known & ~np.isfinite(result.values))
    inside = known & ~case.empty
    return {
        "wrong_cycles_percent": 100 * float(wrong[inside].mean()),
        "mse_rad2": float(np.mean(off[known].astype(np.float64) ** 2)),
        "confidence_auc": area_under_curve(found.confidence(method), wrong, inside),
        "seconds": float(found.table["seconds"][method]),
        "peak_mb": float(found.table["peak_mb"][method]),
    }


def relative_to_field(off: NDArray[np.float32], empty: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return errors less the turns by which the empty field of their frame is off.

    Nothing in a recording tells a level of 2 pi n from none.
    """
    off = off.copy()
    for frame in np.ndindex(*off.shape[:2]):
        field = off[frame][empty[frame] & np.isfinite(off[frame])]
        if len(field) > ENOUGH:
            off[frame] -= np.float32(TURN * np.round(np.median(field) / TURN))
    return off


def area_under_curve(
    trust: xr.DataArray, wrong: NDArray[np.bool_], inside: NDArray[np.bool_]
) -> float:
    """Return how often a wrong pixel of the object is trusted less than a right one."""
    doubt, astray = 1 - trust.values[inside], wrong[inside]
    n = int(astray.sum())
    if n < ENOUGH or n == len(astray):
        return float("nan")
    ranks = scipy.stats.rankdata(np.nan_to_num(doubt, nan=1.0))
    return float((ranks[astray].sum() - n * (n + 1) / 2) / (n * (len(astray) - n)))


def summary_of(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each method, the best first.

    Parameters
    ----------
    table : pandas.DataFrame
        What `run_benchmark` gave.

    Returns
    -------
    pandas.DataFrame
        ``method``; the mean wrong cycles in percent of each group, and ``all`` groups, each
        counting the same; ``worst`` recording; ``mse_rad2`` and ``confidence_auc``, means over all
        recordings; ``ns_a_voxel``, of those that it gave a result for; ``peak_mb``, the most;
        ``without_result``, how many recordings it gave nothing for, which count as all wrong.
        Index: ids.
    """
    rows = {}
    for method, own in table.groupby("id", sort=False):
        # What gives nothing is wrong: else failing where it is hard would pay.
        own = own.fillna({"wrong_cycles_percent": 100.0})
        done = own[own["seconds"].notna()]  # of the others nobody knows what they would take
        by_group = own.groupby("group", sort=False)["wrong_cycles_percent"].mean()
        rows[method] = {
            "method": own["method"].iloc[0],
            **by_group,
            "all": by_group.mean(),
            "worst": own["wrong_cycles_percent"].max(),
            "mse_rad2": own["mse_rad2"].mean(skipna=False),
            "confidence_auc": own["confidence_auc"].mean(),
            "ns_a_voxel": (
                1e9 * done["seconds"].sum() / done["voxels"].sum() if len(done) else float("nan")
            ),
            "peak_mb": own["peak_mb"].max(),
            "without_result": int((own["fault"] != "").sum()),
        }
    found = pd.DataFrame.from_dict(rows, orient="index").rename_axis("id")
    return found.astype({"without_result": int}).sort_values("all", kind="stable")


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

    Parameters
    ----------
    folder : str or Path
        It need not be there yet, and is not made.

    Returns
    -------
    Path
        The same folder.

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
