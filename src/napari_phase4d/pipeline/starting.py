"""Which frame a run starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import xarray as xr

from napari_phase4d.analysis import Comparison
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.unwrapping import best_frame, scores_of_some, scores_sentence

__all__ = ["FOUND_BY", "noting_start", "start_sentence", "start_words", "with_start"]

#: Attribute of results whose boundary frame was found: what told it.
FOUND_BY = "boundary_found_by"


def with_start(
    recipe: Recipe,
    phase: xr.DataArray,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> tuple[Recipe, xr.DataArray | None]:
    """Return a recipe with the frame to start from, and the scores if it had to be found.

    It depends on the phase only, wherever that lies: a run on disk starts as one in memory.

    Parameters
    ----------
    recipe : Recipe
        Its boundary may be "auto".
    phase : xarray.DataArray
        Wrapped phase (time, angle, y, x), in memory or lazy.
    progress, cancelled : callable, optional
        See `run`.
    """
    if recipe.boundary != "auto":
        return recipe, None
    scores = scores_of_some(phase, progress, cancelled)
    return recipe.changed(boundary=(best_frame(scores),)), scores


def noting_start(comparison: Comparison, scores: xr.DataArray | None) -> Comparison:
    """Let results note that their boundary frame was found, and by what."""
    if scores is None:
        return comparison
    note = {FOUND_BY: scores.attrs["basis"]}
    results = {m: result.assign_attrs(note) for m, result in comparison.results.items()}
    return replace(comparison, results=results)


def start_words(frames: Sequence[tuple[int, int]], *, found: bool) -> str:
    """Say from which frames (time, angle) a run starts, and whether they were found or chosen."""
    named = " and ".join(f"time {time}, view {view}" for time, view in frames)
    if not found:
        return f"Start: {named} (chosen)."
    return f"Start: safest frame, {named} (found automatically)."


def start_sentence(recipe: Recipe, scores: xr.DataArray | None) -> str:
    """Say which frame a run started from, and how far that is to be relied on.

    Parameters
    ----------
    recipe : Recipe
        That of the outcome.
    scores : xarray.DataArray or None
        What the frame was found by; None if it was chosen.
    """
    words = start_words(recipe.start_frames, found=scores is not None)
    return words if scores is None else f"{words} {scores_sentence(scores)}"
