"""Results of an earlier run, read from their folder to go on with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from napari_phase4d.analysis import Comparison
from napari_phase4d.io import OME_TIFF, OME_ZARR, open_phase, read_results
from napari_phase4d.pipeline.places import temporary_folder
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import Outcome, mask_of
from napari_phase4d.pipeline.streaming import ProblemOnDisk, Shelf, stored_at
from napari_phase4d.stacks import wrapped_stack
from napari_phase4d.unwrapping import METHODS, Problem
from napari_phase4d.words import address_of, local_path

__all__ = ["holds_outcome", "read_outcome"]

RECIPE, TABLE, WRAPPED = "recipe.json", "table.csv", "wrapped"


def holds_outcome(folder: str | Path) -> bool:
    """Say whether `write_outcome` has written into a folder what `read_outcome` needs."""
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
        return Problem(wrapped_stack(phase), recipe.start_frames, mask, amplitude)
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
