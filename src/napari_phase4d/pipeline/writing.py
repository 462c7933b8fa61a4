"""What a run gives, as files in a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, get_args

import xarray as xr

from napari_phase4d.io import write_phase, write_table
from napari_phase4d.io.zarr_results import note_zarr_result
from napari_phase4d.pipeline.fingerprint import Fingerprint
from napari_phase4d.pipeline.provenance import provenance_of, with_provenance
from napari_phase4d.pipeline.running import Outcome
from napari_phase4d.progress import CancelledCall, ProgressCall

__all__ = ["Form", "checked_form", "write_outcome"]

#: What stacks are written as.
Form = Literal["tiff", "zarr"]
ENDINGS: dict[Form, str] = {"tiff": ".ome.tif", "zarr": ".ome.zarr"}


def write_outcome(
    outcome: Outcome,
    folder: str | Path,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    form: str | None = None,
    source: Fingerprint | None = None,
) -> list[Path]:
    """Write phase, amplitude, every result, the table and the recipe into a folder.

    Where they are there, the exact phase is written too, and how far to trust each result. All
    stacks have their pixel, times and angles, and note in ``attrs["provenance"]`` what made them,
    see `write_phase`.

    Parameters
    ----------
    outcome : Outcome
        What a run gave.
    folder : str or Path
        Where to write; made if it is not there.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.
    form : str, optional
        "tiff" for OME-TIFF or "zarr" for OME-Zarr. Default: OME-TIFF, or OME-Zarr if the stacks
        are lazy, as those of a run larger than memory are.
    source : Fingerprint, optional
        That of the input, if it is known already. Default: it is computed now.

    Raises
    ------
    OSError
        If a file can't be written; files of that name are then left as they were.
    ValueError
        If there is no such form.
    Cancelled
        If ``cancelled()`` returned True; the files written by then are whole.
    """
    chosen = checked_form(form)
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
    ending = ENDINGS[chosen or usual_form(stacks)]
    provenance = provenance_of(outcome, source, cancelled)
    written = []
    for place, (name, stack) in enumerate(stacks.items(), 1):
        report = named(progress, f"{name} ({place} of {len(stacks)})")
        noted = with_provenance(stack, provenance)
        written.append(put(folder / f"{name}{ending}", noted, report, cancelled))
    written.append(write_table(folder / "table.csv", comparison.table))
    written.append(outcome.recipe.to_file(folder / "recipe.json"))
    return written


def put(
    path: Path,
    stack: xr.DataArray,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
) -> Path:
    """Write a stack; of one that lies there already, only note what made it."""
    source = stack.encoding.get("source")
    if source is None or stack.chunks is None or Path(source).resolve() != path.resolve():
        return write_phase(path, stack, progress, cancelled)
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


def named(progress: ProgressCall | None, name: str) -> ProgressCall | None:
    """Let every message end with what is worked on."""
    if progress is None:
        return None
    return lambda done, total, message: progress(done, total, f"{message} {name}")


def exact_phase(truth: Any, phase: xr.DataArray) -> xr.DataArray:
    """Return truth with the axes and places of wrapped phase, noted to be exact."""
    is_named = isinstance(truth, xr.DataArray)
    exact = phase.copy(data=truth.transpose(*phase.dims).values if is_named else truth)
    exact.attrs = {**(truth.attrs if is_named else {}), "units": "rad", "exact": True}
    return exact.rename("exact")
