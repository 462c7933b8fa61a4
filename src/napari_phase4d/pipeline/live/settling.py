"""What is settled on the first frames: lobes, background, the view to start from, and the recipe.

A run with the recipe that comes out gives the same numbers for the finished recording: whatever
looks at frames from all over a recording looks at the first ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.holography import (
    FrameReconstructor,
    PhaseSettings,
    find_lobes,
    frame_reconstructor,
    light_of,
    reconstruct_frames,
)
from napari_phase4d.io import Arrival, ArrivedFrames, Arriving, recording_of
from napari_phase4d.io.lazy import lazy_frames
from napari_phase4d.io.video import Video
from napari_phase4d.pipeline.recipe import Recipe
from napari_phase4d.pipeline.running import opened_reference, phase_settings
from napari_phase4d.pipeline.starting import found_anywhere, open_by
from napari_phase4d.recording import Recording
from napari_phase4d.task import Task
from napari_phase4d.unwrapping import check_light, for_what_comes, scores_of_some

__all__ = ["FIRST_FRAMES", "Settled", "check_live", "recording_at_the_end", "settle", "stacked"]

#: Frames on which all is settled, unless the recipe says it.
FIRST_FRAMES = 8


@dataclass(frozen=True)
class Settled:
    """What no later frame changes.

    Parameters
    ----------
    recipe : Recipe
        All settings; a run with it gives the same numbers.
    first : Recording
        The first frames.
    facts : Video
        What the file says of pixel and frame rate.
    work : FrameReconstructor
        What turns a frame into phase and amplitude.
    """

    recipe: Recipe
    first: Recording
    facts: Video
    work: FrameReconstructor


def check_live(recipe: Recipe) -> None:
    """Refuse settings that a growing recording can't be worked on with.

    Raises
    ------
    ValueError
        In one sentence that says what to do.
    """
    reference = recipe.reference
    n_first = recipe.first_frames or FIRST_FRAMES
    faults: dict[str, object] = {
        "how far to trust a frame hangs on frames that come later; leave confidence out, and run "
        "the recipe on the finished recording for it": recipe.confidence,
        "wrapped phase can't be watched; give a recording of holograms": recipe.content == "phase",
        "raw files can't be watched, as nothing in them says where a frame ends": recipe.raw,
        f"reference frame {reference} is not among the first {n_first}, which is all that is "
        "known when the first phase is shown; give one of these, or a file": isinstance(
            reference, int
        )
        and not 0 <= reference < n_first,
        "frames that come are unwrapped from the first one on; give a boundary at time 0, such as "
        '((0, 0),), or "auto"': recipe.boundary != "auto"
        and any(frame for frame, _ in recipe.boundary),
    }
    for fault, is_there in faults.items():
        if is_there:
            raise ValueError(fault)


def stacked(arrivals: Sequence[Arrival], arriving: Arriving) -> NDArray[np.generic]:
    """Return the frames that arrived (time, y, x); black where one never came."""
    assert arriving.shape is not None  # a frame has been read
    black = np.zeros(arriving.shape, arriving.dtype)
    return np.stack([black if each.frame is None else each.frame for each in arrivals])


def settle(
    recipe: Recipe,
    arriving: Arriving,
    arrivals: Sequence[Arrival],
    task: Task,
) -> Settled:
    """Settle on the first frames what holds for all.

    Raises
    ------
    OSError, ValueError
        If no frame came, or a setting does not fit them.
    """
    source = str(arriving.path)
    if not arrivals:
        msg = f"no frame came to {source}; is the recording written there?"
        raise OSError(msg)
    if arriving.shape is None:
        why = arrivals[0].why
        msg = f"no frame of {arriving.path.name} can be read: frame {arriving.label(0)} {why}"
        raise OSError(msg)
    facts = facts_of(arriving)
    frames = stacked(arrivals, arriving)
    first = recording_of(
        replace(facts, frames=frames, times_s=None, axes=""),
        arriving.path.name,
        source,
        recipe.optics,
        recipe.frame_rate_hz,
    )
    lobes = list(recipe.lobes) or find_lobes(
        first,
        recipe.wanted_views,
        angles_deg=recipe.angles_deg,
        wavelengths_um=recipe.wavelengths_um,
        cancelled=task.cancelled,
    )
    check_light(recipe.methods, *light_of(lobes, first.optics.wavelength_um))
    used = recipe.changed(
        recording=found_anywhere(source),
        content="holograms",
        lobes=tuple(lobes),
        optics=first.optics,
        first_frames=len(frames),
        options=for_what_comes(recipe.options),
    )
    chosen = PhaseSettings(opened_reference(used, first), **phase_settings(used))
    work = frame_reconstructor(first, lobes, chosen, task)
    used = used.changed(refocus_um=work.attrs.get("refocus_um"))
    if used.boundary == "auto":
        used = used.changed(boundary=((0, safest_view(work, first, task)),))
    return Settled(used, first, facts, work)


def safest_view(work: FrameReconstructor, first: Recording, task: Task) -> int:
    """Return the view of the first frame that is safest to start from."""
    phase = reconstruct_frames(work, first, task.quiet)["phase"]
    if phase.isel(time=0).isnull().all():
        return 0
    scores = scores_of_some(phase, task.quiet).values[0]
    return 0 if np.isnan(scores).all() else int(np.nanargmax(scores))


def facts_of(arriving: Arriving) -> Video:
    """Return what a file says of pixel and frame rate; nothing where it is not whole yet."""
    with suppress(OSError, ValueError):
        return arriving.facts()
    return Video(None)


def recording_at_the_end(settled: Settled, arriving: Arriving) -> Recording:
    """Return the recording as it is now: as a run opens it, if it holds what was watched.

    Otherwise it holds the frames that were watched, black where one never came.
    """
    recipe = settled.recipe
    if not arriving.lost:
        with suppress(OSError, ValueError):
            whole = open_by(recipe)
            if isinstance(whole, Recording) and whole.n_frames == arriving.taken:
                return whole
    frames = lazy_frames(ArrivedFrames(arriving))
    return recording_of(
        replace(settled.facts, frames=frames, times_s=None, axes=""),
        arriving.path.name,
        str(Path(recipe.recording)),
        recipe.optics,
        recipe.frame_rate_hz,
    )
