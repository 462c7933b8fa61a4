"""What a session can be opened with: files, samples, recipes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from napari_phase4d.io import RawLayout, open_input, open_recording
from napari_phase4d.later import xr
from napari_phase4d.pipeline import Outcome, Recipe, holds_outcome, open_by, read_outcome
from napari_phase4d.recording import Recording
from napari_phase4d.sample import (
    CELLS_SOURCE,
    EUGLENA_SOURCE,
    SAMPLES,
    YEAST_SOURCE,
    Sample,
    cells_sample,
    euglena_sample,
    is_sample,
    open_sample,
    yeast_sample,
)

__all__ = ["Opened", "TruthCall", "open_anything", "open_recipe"]

#: Gives the exact phase on the grid of a reconstruction; ValueError where it is not known.
TruthCall: TypeAlias = Callable[["xr.DataArray"], "xr.DataArray"]


@dataclass(frozen=True)
class Opened:
    """A recording or wrapped phase, with what is known of it.

    Parameters
    ----------
    content : Recording or DataArray
        Holograms, or wrapped phase (time, angle, y, x) in radians.
    angles_deg : sequence of float, optional
        Viewing angles of a recording, where they are known.
    truth : DataArray or callable, optional
        Exact phase, or for a recording what gives it on a reconstruction's grid.
    recipe : Recipe, optional
        The settings to go on with.
    kind : str
        What it was told to be: "holograms", "phase", or "auto" if it was looked at.
    raw : RawLayout, optional
        How the frames of a raw file were told to lie in it.
    outcome : Outcome, optional
        Results that were made of the phase in an earlier run.
    """

    content: Recording | xr.DataArray
    angles_deg: Sequence[float] | None = None
    truth: xr.DataArray | TruthCall | None = None
    recipe: Recipe | None = None
    kind: str = "auto"
    raw: RawLayout | None = None
    outcome: Outcome | None = None


def open_anything(source: Any, content: str = "auto", raw: RawLayout | None = None) -> Opened:
    """Open a file, a folder, results of a run, a recipe, a sample, or an array.

    Parameters
    ----------
    source : str, Path, or array_like
        What to open; a sample is named as "sample:euglena" is.
    content : str, optional
        "holograms", "phase", or "auto" (default) to look.
    raw : RawLayout, optional
        How the frames of a raw file lie in it.

    Raises
    ------
    OSError, TypeError, ValueError
        If it can't be read; one sentence says why.
    """
    if not isinstance(source, str | Path):
        return Opened(open_recording(source))
    if str(source) == EUGLENA_SOURCE:
        return opened_sample(euglena_sample())
    if str(source) == CELLS_SOURCE:
        return opened_sample(cells_sample())
    if str(source) == YEAST_SOURCE:
        return opened_yeast()
    if is_sample(str(source)):
        return Opened(open_sample(str(source)))
    if Path(source).suffix.lower() == ".json":
        return open_recipe(Recipe.from_file(source))
    if content != "holograms" and holds_outcome(source):
        return open_results(read_outcome(source))
    return Opened(open_input(source, content=content, raw=raw), kind=content, raw=raw)


def open_results(outcome: Outcome) -> Opened:
    """Return the phase of an earlier run with what was made of it."""
    phase = outcome.reconstruction["phase"]
    return Opened(phase, truth=outcome.truth, recipe=outcome.recipe, outcome=outcome)


def opened_sample(sample: Sample) -> Opened:
    """Return the sample video with all that is known of it."""
    return Opened(sample.recording, sample.angles_deg, sample.truth)


def opened_yeast() -> Opened:
    """Return the sample phase with its exact phase."""
    data = yeast_sample()
    return Opened(data["wrapped"], truth=data["phase"])


def open_recipe(recipe: Recipe) -> Opened:
    """Open what a recipe names, to go on with its settings.

    Raises
    ------
    OSError, ValueError
        If the recipe names no file, or one that can't be read.
    """
    if not recipe.recording:
        msg = "the recipe names no recording; open the recording first, then set it up anew"
        raise ValueError(msg)
    truth = None
    if recipe.recording in SAMPLES:
        truth = open_anything(recipe.recording).truth
    return Opened(open_by(recipe), truth=truth, recipe=recipe)
