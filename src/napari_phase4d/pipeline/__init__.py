"""The one path behind the window, scripts and the command line.

A `Recipe` holds every setting; `run` follows it from the recording to the unwrapped phase.
"""

from napari_phase4d.pipeline.needs import needed_bytes, working_bytes
from napari_phase4d.pipeline.opening import found_anywhere, open_by
from napari_phase4d.pipeline.recipe import DEFAULT_METHODS, PAPER_METHODS, Recipe
from napari_phase4d.pipeline.running import (
    Outcome,
    reconstruct_by,
    run,
    unwrap_by,
)
from napari_phase4d.pipeline.writing import write_outcome

__all__ = [
    "DEFAULT_METHODS",
    "PAPER_METHODS",
    "Outcome",
    "Recipe",
    "found_anywhere",
    "needed_bytes",
    "open_by",
    "reconstruct_by",
    "run",
    "unwrap_by",
    "working_bytes",
    "write_outcome",
]
