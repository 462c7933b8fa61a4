"""Opening what a recipe names."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import xarray as xr

from napari_phase4d.io import open_input
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.recording import Recording
from napari_phase4d.sample import is_sample, open_sample

__all__ = ["found_anywhere", "open_by"]


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
    if str(source) and not is_sample(str(source)):
        with suppress(OSError, ValueError):  # not there, or no name of a file at all
            return str(Path(source).resolve(strict=True))
    return str(source)
