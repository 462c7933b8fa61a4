"""How long a run will take, from a trial on a few frames."""

from __future__ import annotations

import time
from collections.abc import Sequence

import xarray as xr

from napari_phase4d.holography import Lobe
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import reconstruct_by, unwrap_by
from napari_phase4d.progress import CancelledCall
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import scores_of_some

__all__ = ["estimated_seconds"]

#: Frames of the trial.
TRIAL_FRAMES = 6


def estimated_seconds(
    recipe: Recipe,
    opened: Recording | xr.DataArray,
    lobes: Sequence[Lobe] = (),
    cancelled: CancelledCall | None = None,
) -> float:
    """Return about how many seconds a run will take.

    Some of the first frames are reconstructed and unwrapped twice; the second time counts, since
    compiled code is loaded the first time. Longer recordings take longer in proportion. Where the
    recipe leaves it to be found, the search for the safest frame counts too.

    Parameters
    ----------
    recipe : Recipe
        All settings.
    opened : Recording or DataArray
        The hologram video, or wrapped phase.
    lobes : sequence of Lobe, optional
        The views of a hologram video.
    cancelled : callable, optional
        ``cancelled()`` stops the trial.

    Raises
    ------
    Cancelled
        If ``cancelled()`` returned True.
    """
    n_frames = opened.n_frames if isinstance(opened, Recording) else opened.sizes["time"]
    few = min(n_frames, TRIAL_FRAMES)
    finds_start = recipe.boundary == "auto"
    recipe = recipe.changed(boundary=((0, 0),), reference=None)
    seconds = 0.0
    for _ in range(2):
        began = time.perf_counter()
        if isinstance(opened, Recording):
            data = reconstruct_by(recipe, opened.first(few), list(lobes), cancelled=cancelled)
            phase, amplitude = data["phase"], data["amplitude"]
        else:
            phase, amplitude = opened[:few].load(), None
        if finds_start:
            scores_of_some(phase, cancelled=cancelled)
        unwrap_by(recipe, phase, cancelled=cancelled, amplitude=amplitude)
        seconds = time.perf_counter() - began
    return seconds * n_frames / few
