"""What a run begins with: the files that a recipe names, and the frame it starts from."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import xarray as xr

from napari_phase4d.analysis import Comparison
from napari_phase4d.io import address_of, open_input
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.recording import Recording
from napari_phase4d.sample import is_sample, open_sample
from napari_phase4d.task import UNWATCHED, Task
from napari_phase4d.unwrapping import best_frame, scores_of_some, scores_sentence
from napari_phase4d.words import frame_in_words

__all__ = [
    "FOUND_BY",
    "found_anywhere",
    "noting_start",
    "open_by",
    "start_sentence",
    "start_words",
    "with_start",
]


def open_by(recipe: Recipe) -> Recording | xr.DataArray:
    """Open the file or sample that a recipe names: holograms, or wrapped phase.

    Raises
    ------
    OSError, TypeError, ValueError
        If there is no such file or sample, or it can't be read.
    """
    if is_sample(recipe.recording):
        return open_sample(recipe.recording, recipe.optics, recipe.frame_rate_hz)
    return open_input(
        recipe.recording,
        recipe.optics,
        recipe.frame_rate_hz,
        dataset=recipe.dataset,
        raw=recipe.raw,
        angles_deg=recipe.angles_deg,
        content=recipe.content,
    )


def found_anywhere(source: str | Path) -> str:
    """Return a recording's name as it holds in every folder: files get their whole path.

    Names of samples, and of files that are not there, stay as they are.
    """
    if (address := address_of(source)) is not None:
        return address
    if str(source) and not is_sample(str(source)):
        # Not there, no name of a file at all, or a link to itself.
        with suppress(OSError, RuntimeError, ValueError):
            return str(Path(source).resolve(strict=True))
    return str(source)


#: Attribute of results whose boundary frame was found: what told it.
FOUND_BY = "boundary_found_by"


def with_start(
    recipe: Recipe,
    phase: xr.DataArray,
    task: Task = UNWATCHED,
) -> tuple[Recipe, xr.DataArray | None]:
    """Return a recipe with the frame to start from, and the scores if it had to be found.

    It depends on the phase only, wherever that lies: a run on disk starts as one in memory.

    Parameters
    ----------
    recipe : Recipe
        Its boundary may be "auto".
    phase : xarray.DataArray
        Wrapped phase (time, angle, y, x), in memory or lazy.
    task : Task, optional
        Who is told of it, and may stop it.
    """
    if recipe.boundary != "auto":
        return recipe, None
    scores = scores_of_some(phase, task)
    return recipe.changed(boundary=(best_frame(scores),)), scores


def noting_start(comparison: Comparison, scores: xr.DataArray | None) -> Comparison:
    """Let results note that their boundary frame was found, and by what."""
    if scores is None:
        return comparison
    note = {FOUND_BY: scores.attrs["basis"]}
    results = {m: result.assign_attrs(note) for m, result in comparison.results.items()}
    return replace(comparison, results=results)


def start_words(
    frames: Sequence[tuple[int, int]], *, found: bool, of: xr.DataArray | None = None
) -> str:
    """Say from which frames (time, angle) a run starts, and whether they were found or chosen.

    They are said by their numbers, as settings have them, or by time and angle ``of`` a stack.
    """
    named = " and ".join(
        f"time {time}, view {view}" if of is None else frame_in_words(of, time, view)
        for time, view in frames
    )
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
