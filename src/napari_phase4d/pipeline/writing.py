"""What a run gives, as files in a folder."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

import xarray as xr

from napari_phase4d.io import OME_TIFF, OME_ZARR, write_phase, write_table
from napari_phase4d.io.zarr_results import note_zarr_result, path_of
from napari_phase4d.pipeline.provenance import Fingerprint, provenance_of, with_provenance
from napari_phase4d.pipeline.running import Outcome
from napari_phase4d.task import UNWATCHED, Task
from napari_phase4d.words import local_path

__all__ = ["Form", "checked_form", "lying_in", "write_files"]

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
    """Return a form if there is such a one, None for the usual one, else raise ValueError."""
    for known in get_args(Form):
        if form == known:
            return known  # type: ignore[no-any-return]
    if form is not None:
        msg = f"form must be tiff or zarr, but is {form!r}"
        raise ValueError(msg)
    return None


def usual_form(stacks: dict[str, xr.DataArray]) -> Form:
    """Return the form of stacks for which none is asked for: Zarr if they are lazy."""
    return "zarr" if any(stack.chunks is not None for stack in stacks.values()) else "tiff"


def exact_phase(truth: Any, phase: xr.DataArray) -> xr.DataArray:
    """Return truth with the axes and places of wrapped phase, noted to be exact."""
    is_named = isinstance(truth, xr.DataArray)
    exact = phase.copy(data=truth.transpose(*phase.dims).values if is_named else truth)
    exact.attrs = {**(truth.attrs if is_named else {}), "units": "rad", "exact": True}
    return exact.rename("exact")
