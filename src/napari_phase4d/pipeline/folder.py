"""What a run gives, as files in a folder: written, and read again to go on with."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from napari_phase4d.analysis import Comparison, as_truth
from napari_phase4d.io import (
    OME_TIFF,
    OME_ZARR,
    open_phase,
    read_results,
    write_phase,
    write_table,
)
from napari_phase4d.io.zarr_results import note_zarr_result, path_of
from napari_phase4d.later import pd, xr
from napari_phase4d.pipeline.places import temporary_folder
from napari_phase4d.pipeline.provenance import Fingerprint, provenance_of, with_provenance
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome, mask_of
from napari_phase4d.pipeline.stored import Shelf, stored_at
from napari_phase4d.pipeline.streaming import ProblemOnDisk
from napari_phase4d.stacks import wrapped_stack
from napari_phase4d.task import UNWATCHED, Task
from napari_phase4d.unwrapping import METHODS, Problem
from napari_phase4d.words import address_of, local_path, shown

__all__ = ["checked_form", "holds_outcome", "lying_in", "read_outcome", "write_files"]

#: What stacks are written as.
Form = Literal["tiff", "zarr"]
ENDINGS: dict[Form, str] = {"tiff": OME_TIFF, "zarr": OME_ZARR}


def write_files(
    outcome: Outcome,
    folder: str | Path,
    task: Task = UNWATCHED,
    *,
    form: str | None = None,
    source: Fingerprint | None = None,
    reference: Fingerprint | None = None,
) -> list[Path]:
    """Write the files of `write_outcome` into a folder that its caller guards."""
    chosen = checked_form(form)
    folder, comparison = local_path(folder), outcome.comparison
    stacks = stacks_of(outcome)
    if outcome.truth is not None:
        stacks["exact"] = exact_phase(outcome.truth, outcome.reconstruction["phase"])
    ending = ENDINGS[chosen or usual_form(stacks)]
    provenance = provenance_of(outcome, source, task, reference)

    def write(stacks: dict[str, xr.DataArray]) -> list[Path]:
        paths = [folder / f"{name}{ending}" for name in stacks]
        for place, (path, (name, stack)) in enumerate(zip(paths, stacks.items(), strict=True), 1):
            if name == "wrapped" and is_input(path, outcome):
                continue
            which = f"{name} ({place} of {len(stacks)})"
            report = task.reworded(partial("{1} {0}".format, which))
            put(path, with_provenance(stack, provenance), report)
        return paths

    written = write(stacks)
    table = write_table(folder / "table.csv", comparison.table)
    written += [table, outcome.recipe.to_file(folder / "recipe.json")]
    if outcome.cells is not None:
        written += write({"cells": outcome.cells.labels})
        written += [
            write_table(folder / "cells.csv", outcome.cells.table.set_index("cell")),
            write_table(folder / "cell_summary.csv", outcome.cells.summary.set_index("cell")),
        ]
    if outcome.recipe.confidence:
        # Only now: what has been found by then is not lost if this fails.
        trust = comparison.confidences(None, **task.calls)
        written += write({f"confidence_{method}": stack for method, stack in trust.items()})
        write_table(table, comparison.with_doubt(trust).table)
    return written


def stacks_of(outcome: Outcome) -> dict[str, xr.DataArray]:
    """Return phase, amplitude and results by the names of their files."""
    return {
        "wrapped" if name == "phase" else str(name): stack
        for name, stack in outcome.reconstruction.data_vars.items()
    } | dict(outcome.comparison.results)


def lying_in(folder: Path, outcome: Outcome) -> set[str]:
    """Return the names of the stacks on disk that a run has left in a folder."""
    stacks = stacks_of(outcome)
    if outcome.cells is not None:
        stacks["cells"] = outcome.cells.labels
    paths = (path_of(stack) for stack in stacks.values())
    where = folder.resolve()
    # The input may lie there too, in a folder of the user's.
    here = any(
        path is not None and path.resolve().parent == where and not is_input(path, outcome)
        for path in paths
    )
    # It may have left some that the outcome holds in memory, and how far to trust them.
    names = [*stacks, *(f"confidence_{method}" for method in outcome.comparison.results)]
    return {f"{name}{OME_ZARR}" for name in names} if here else set()


def is_input(path: Path, outcome: Outcome) -> bool:
    """Say whether a file is the one with the wrapped phase that a run began with."""
    source = outcome.recipe.recording
    if outcome.recording is not None or not source or not path.exists():
        return False
    return Path(source).resolve() == path.resolve()


def put(
    path: Path,
    stack: xr.DataArray,
    task: Task,
) -> Path:
    """Write a stack; of one that lies there already, only note what made it."""
    source = path_of(stack)
    if source is None or source.resolve() != path.resolve():
        return write_phase(path, stack, **task.calls)
    note_zarr_result(path, stack)
    return path


def checked_form(form: str | None) -> Form | None:
    """Return a form if there is such a one, None for the usual one, else raise ValueError.

    Parameters
    ----------
    form : str or None
        What stacks are to be written as: "tiff", "zarr", or None to leave it to the program.

    Returns
    -------
    str or None
        The same form.
    """
    for known in get_args(Form):
        if form == known:
            return known  # type: ignore[no-any-return]
    if form is not None:
        msg = f"form must be tiff or zarr, but is {shown(form)}"
        raise ValueError(msg)
    return None


def usual_form(stacks: dict[str, xr.DataArray]) -> Form:
    """Return the form of stacks for which none is asked for: Zarr if they are lazy."""
    return "zarr" if any(stack.chunks is not None for stack in stacks.values()) else "tiff"


def exact_phase(truth: Any, phase: xr.DataArray) -> xr.DataArray:
    """Return truth as the table takes it, frame by frame that of wrapped phase, noted as exact."""
    exact = as_truth(truth, phase)
    assert exact is not None
    notes = truth.attrs if isinstance(truth, xr.DataArray) else {}
    exact.attrs = {**notes, "units": "rad", "exact": True}
    return exact.rename("exact")


# ---- read again -----------------------------------------------------------------------------


RECIPE, TABLE, WRAPPED = "recipe.json", "table.csv", "wrapped"


def holds_outcome(folder: str | Path) -> bool:
    """Say whether `write_outcome` has written into a folder what `read_outcome` needs.

    Parameters
    ----------
    folder : str or Path
        It need not be there.

    Returns
    -------
    bool
        True if the recipe and the wrapped phase are in it. False for an address on a server.
    """
    if address_of(folder) is not None:
        return False
    folder = local_path(folder)
    return (folder / RECIPE).is_file() and stack_file(folder, WRAPPED) is not None


def read_outcome(folder: str | Path) -> Outcome:
    """Read what `write_outcome` has written: phase, results, table and settings.

    Stacks in OME-Zarr stay on disk and are read a frame at a time. Cells and maps of confidence
    are not read; they are computed anew where they are asked for.

    Parameters
    ----------
    folder : str or Path
        The folder of a run.

    Returns
    -------
    Outcome
        Without a recording; the recipe's ``recording`` is the file of wrapped phase, so that what
        is run with it begins there. Methods whose file is not there are left out.

    Raises
    ------
    OSError
        If the folder, its recipe or a stack is missing or damaged.
    ValueError
        If a result does not fit the wrapped phase, or there is none.
    """
    folder = local_path(folder)
    source = stack_file(folder, WRAPPED)
    if source is None or not (folder / RECIPE).is_file():
        msg = (
            f"{folder} holds no results of a run: {RECIPE} and {WRAPPED}{OME_TIFF} or "
            f"{WRAPPED}{OME_ZARR} are needed; choose the folder that was saved to"
        )
        raise FileNotFoundError(msg)
    recipe = Recipe.from_file(folder / RECIPE)
    phase = open_phase(source)
    stacks = {m: stack for m in METHODS if (stack := stack_in(folder, m, phase)) is not None}
    if not stacks:
        msg = f"{folder} holds wrapped phase but no result; open {source.name} to unwrap it"
        raise ValueError(msg)
    amplitude, exact = (stack_in(folder, name, phase) for name in ("amplitude", "exact"))
    used = recipe.changed(
        recording=str(source), content="phase", lobes=(), methods=tuple(stacks), cells=None
    )
    data = xr.Dataset({"phase": phase} | ({} if amplitude is None else {"amplitude": amplitude}))
    table = table_in(folder, stacks)
    comparison = Comparison(stacks, table, problem_of(used, phase, amplitude), phase)
    return Outcome(None, used, data, comparison, exact)


def problem_of(recipe: Recipe, phase: xr.DataArray, amplitude: xr.DataArray | None) -> Problem:
    """Return what a run has unwrapped; it stays where it lies."""
    stored = stored_at(phase)
    if stored is None:
        mask = mask_of(recipe, phase)
        return Problem(wrapped_stack(phase, mask=mask), recipe.start_frames, mask, amplitude)
    return ProblemOnDisk(
        phase,
        stored,
        Shelf(temporary_folder()),
        recipe.start_frames,
        finds_mask=recipe.mask == "auto",
        amplitude=amplitude,
    )


def stack_file(folder: Path, name: str) -> Path | None:
    """Return where a stack of a run lies, None if it is not there."""
    return next((p for e in (OME_TIFF, OME_ZARR) if (p := folder / f"{name}{e}").exists()), None)


def stack_in(folder: Path, name: str, phase: xr.DataArray) -> xr.DataArray | None:
    """Return a stack of a run, None if it is not there; it has to be of the phase's shape."""
    path = stack_file(folder, name)
    if path is None:
        return None
    stack = read_results(path)
    if stack.shape != phase.shape:
        msg = (
            f"{path} has the shape {stack.shape}, but the wrapped phase beside it {phase.shape}; "
            "they are of different runs, open the file alone"
        )
        raise ValueError(msg)
    return stack


def table_in(folder: Path, stacks: dict[str, Any]) -> pd.DataFrame:
    """Return the table of a run, with a row for each result; figures that it lacks are NaN."""
    rows = pd.DataFrame(index=pd.Index(list(stacks), name="id"))
    if (folder / TABLE).is_file():
        rows = rows.join(pd.read_csv(folder / TABLE, index_col=0))
    for figure in ("seconds", "peak_mb"):
        if figure not in rows:
            rows[figure] = np.nan
    labels = pd.Series({m: METHODS[m].label for m in stacks})
    rows.insert(0, "named", rows.pop("method") if "method" in rows else labels)
    rows["named"] = rows["named"].fillna(labels)
    return rows.rename(columns={"named": "method"})
