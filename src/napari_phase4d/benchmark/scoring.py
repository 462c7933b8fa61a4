"""What each method gets for each recording of the suite."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from napari_phase4d.analysis import Comparison, compare
from napari_phase4d.benchmark.cases import GROUPS, SUITE_VERSION, Case, cases, checked_groups
from napari_phase4d.later import pd, xr
from napari_phase4d.task import Cancelled, CancelledCall, ProgressCall, Task, Watch
from napari_phase4d.unwrapping import METHODS, methods_for
from napari_phase4d.words import sentence_of

__all__ = ["run_benchmark", "summary_of"]

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
        Ids among `METHODS`, those of installed packages included. Default: all that need no more
        than one wavelength.
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
    unknown = [method for method in chosen if method not in METHODS]
    if unknown:
        msg = f"method must be one of {', '.join(METHODS)}, but is {unknown[0]!r}"
        raise ValueError(msg)
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
        recordings; ``ns_a_voxel``; ``peak_mb``, the most; ``without_result``, how many recordings
        it gave nothing for, which count
        as all wrong. Index: ids.
    """
    rows = {}
    for method, own in table.groupby("id", sort=False):
        # What gives nothing is wrong: else failing where it is hard would pay.
        own = own.fillna({"wrong_cycles_percent": 100.0})
        by_group = own.groupby("group", sort=False)["wrong_cycles_percent"].mean()
        rows[method] = {
            "method": own["method"].iloc[0],
            **by_group,
            "all": by_group.mean(),
            "worst": own["wrong_cycles_percent"].max(),
            "mse_rad2": own["mse_rad2"].mean(skipna=False),
            "confidence_auc": own["confidence_auc"].mean(),
            "ns_a_voxel": 1e9 * own["seconds"].sum() / own["voxels"].sum(),
            "peak_mb": own["peak_mb"].max(),
            "without_result": int((own["fault"] != "").sum()),
        }
    found = pd.DataFrame.from_dict(rows, orient="index").rename_axis("id")
    return found.astype({"without_result": int}).sort_values("all", kind="stable")
