"""What the summary says of a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import xarray as xr

from napari_phase4d.analysis import most_trusted
from napari_phase4d.pipeline.running import Outcome

__all__ = ["facts_of", "facts_of_input"]


def facts_of(outcome: Outcome, folder: Path) -> dict[str, Any]:
    """Return what the summary says of a run, from what was written of it."""
    import pandas as pd

    phase = outcome.reconstruction["phase"]
    results = outcome.comparison.results
    best = most_trusted(results)
    facts = {
        "frames": int(phase.sizes["time"]),
        "views": int(phase.sizes["angle"]),
        "boundary": " ".join(f"{t},{a}" for t, a in outcome.recipe.start_frames),
        "results": len(results),
        "best_method": best,
        "notes": " ".join(notes_of(outcome, phase)),
    }
    table = pd.read_csv(folder / "table.csv", index_col="id")
    if "doubtful_percent" in table.columns:
        doubtful = float(table["doubtful_percent"].to_dict()[best])
        facts["doubtful_percent"] = None if math.isnan(doubtful) else doubtful
    return facts


def notes_of(outcome: Outcome, phase: xr.DataArray) -> Sequence[str]:
    """Return what had to be assumed of an input."""
    if outcome.recording is not None:
        return outcome.recording.notes
    return [str(note) for note in phase.attrs.get("notes", ())]


def facts_of_input(known: dict[str, Any]) -> dict[str, Any]:
    """Return what the summary says of an input."""
    return {"input_bytes": known.get("bytes"), "input_sha256": known.get("sha256")}
