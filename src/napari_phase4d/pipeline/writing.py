"""What a run gives, as files in a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import xarray as xr

from napari_phase4d.io import write_phase, write_table
from napari_phase4d.pipeline.running import Outcome
from napari_phase4d.progress import CancelledCall, ProgressCall, Watch

__all__ = ["write_outcome"]


def write_outcome(
    outcome: Outcome,
    folder: str | Path,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> list[Path]:
    """Write phase, amplitude, every result, the table and the recipe into a folder.

    Where they are there, the exact phase is written too, and how far to trust each result. All
    stacks are OME-TIFF with their pixel, times and angles, see `write_phase`.

    Raises
    ------
    OSError
        If a file can't be written; files of that name are then left as they were.
    Cancelled
        If ``cancelled()`` returned True; the files written by then are whole.
    """
    folder, comparison = Path(folder), outcome.comparison
    stacks = {
        "wrapped" if name == "phase" else str(name): stack
        for name, stack in outcome.reconstruction.data_vars.items()
    } | dict(comparison.results)
    if outcome.truth is not None:
        stacks["exact"] = exact_phase(outcome.truth, outcome.reconstruction["phase"])
    if outcome.recipe.confidence:
        trust = {m: comparison.confidence(m, progress, cancelled) for m in comparison.results}
        stacks |= {f"confidence_{method}": stack for method, stack in trust.items()}
        comparison = comparison.with_suspicion(trust)
    watch = Watch(len(stacks), "saving", progress, cancelled)
    written = []
    for name, stack in stacks.items():
        written.append(write_phase(folder / f"{name}.ome.tif", stack))
        watch.step()
    written.append(write_table(folder / "table.csv", comparison.table))
    written.append(outcome.recipe.to_file(folder / "recipe.json"))
    return written


def exact_phase(truth: Any, phase: xr.DataArray) -> xr.DataArray:
    """Return truth with the axes and places of wrapped phase, noted to be exact."""
    is_named = isinstance(truth, xr.DataArray)
    exact = phase.copy(data=truth.transpose(*phase.dims).values if is_named else truth)
    exact.attrs = {**(truth.attrs if is_named else {}), "units": "rad", "exact": True}
    return exact.rename("exact")
