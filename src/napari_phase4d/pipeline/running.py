"""From the recording to the unwrapped phase, as a recipe says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d.evaluation import Comparison, compare
from napari_phase4d.holography import Lobe, find_lobes, reconstruct
from napari_phase4d.io import open_recording
from napari_phase4d.pipeline.opening import open_by
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.recording import Recording

__all__ = ["Outcome", "reconstruct_by", "run", "unwrap_by"]


@dataclass(frozen=True)
class Outcome:
    """What a run gives.

    Parameters
    ----------
    recording : Recording or None
        The hologram video; None if the run began with wrapped phase.
    recipe : Recipe
        All settings that were used, with the lobes and the optics.
    reconstruction : xarray.Dataset
        Wrapped ``phase``, dims (time, angle, y, x); and ``amplitude``, where it is known.
    comparison : Comparison
        Unwrapped phase of every method, and the table.
    truth : xarray.DataArray, optional
        Exact phase on the reconstruction's grid, where it is known.
    """

    recording: Recording | None
    recipe: Recipe
    reconstruction: xr.Dataset
    comparison: Comparison
    truth: xr.DataArray | None = None


def run(
    recipe: Recipe,
    recording: Recording | None = None,
    truth: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Outcome:
    """Follow a recipe from the recording to the unwrapped phase.

    Parameters
    ----------
    recipe : Recipe
        All settings.
    recording : Recording, optional
        The hologram video, instead of the file that the recipe names.
    truth : xarray.DataArray, optional
        Exact phase on the reconstruction's grid, for the table.
    progress, cancelled : callable, optional
        ``progress(done, total, message)``; ``cancelled()`` stops the work.

    Raises
    ------
    OSError, TypeError, ValueError
        If the recording can't be read or a setting does not fit it.
    Cancelled
        If ``cancelled()`` returned True.
    """
    if recording is None and not recipe.recording:
        msg = "the recipe names no recording; give run() one, or a recipe with a file"
        raise ValueError(msg)
    opened = recording if recording is not None else open_by(recipe)
    if isinstance(opened, xr.DataArray):
        comparison = unwrap_by(recipe, opened, truth, progress, cancelled)
        return Outcome(None, recipe, xr.Dataset({"phase": opened}), comparison, truth)
    recording = opened
    lobes = list(recipe.lobes) or find_lobes(
        recording, recipe.n_views, angles_deg=recipe.angles_deg
    )
    data = reconstruct_by(recipe, recording, lobes, progress, cancelled)
    comparison = unwrap_by(
        recipe, data["phase"], truth, progress, cancelled, amplitude=data["amplitude"]
    )
    used = recipe.changed(lobes=tuple(lobes), optics=recording.optics)
    return Outcome(recording, used, data, comparison, truth)


def unwrap_by(
    recipe: Recipe,
    phase: xr.DataArray,
    truth: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    amplitude: xr.DataArray | None = None,
    finished: Callable[[str, Comparison], None] | None = None,
) -> Comparison:
    """Unwrap wrapped phase with a recipe's methods and settings; NaN are left out.

    ``finished`` is told each method and the comparison so far, see `compare`.
    """
    known = np.isfinite(phase.values)
    return compare(
        phase,
        recipe.methods,
        recipe.boundary,
        truth,
        mask=known if recipe.mask is None and not known.all() else recipe.mask,
        amplitude=amplitude,
        options=recipe.options,
        progress=progress,
        cancelled=cancelled,
        finished=finished,
    )


def reconstruct_by(
    recipe: Recipe,
    recording: Recording,
    lobes: list[Lobe],
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> xr.Dataset:
    """Reconstruct a recording with a recipe's settings; a reference file is opened."""
    reference: Any = recipe.reference
    if isinstance(reference, str) and reference != "median":
        reference = open_recording(reference, recording.optics)
    return reconstruct(
        recording,
        lobes,
        reference,
        window=recipe.window,
        background=recipe.background,
        drift=recipe.drift,
        progress=progress,
        cancelled=cancelled,
    )
