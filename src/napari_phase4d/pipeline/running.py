"""From the recording to the unwrapped phase, as a recipe says."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from napari_phase4d.analysis import Cells, Comparison, cells_in, compare, most_trusted
from napari_phase4d.analysis.cell_tracks import check_follower
from napari_phase4d.holography import (
    Focus,
    Lobe,
    PhaseSettings,
    beginning_of,
    find_focus,
    find_lobes,
    frame_reconstructor,
    light_of,
    reconstruct_frames,
    reconstruction_advice,
    warn_of_doubts,
)
from napari_phase4d.holography.lobes import lobe_doubts, with_wavelengths
from napari_phase4d.holography.reconstruction import FEW_LOST
from napari_phase4d.io import open_recording
from napari_phase4d.later import xr
from napari_phase4d.pipeline.places import Place, needs_of, phase_needs, place_for
from napari_phase4d.pipeline.recipe import PHASE_SETTINGS, Recipe
from napari_phase4d.pipeline.starting import (
    FrameSource,
    light_for,
    lobes_of,
    noting_start,
    open_by,
    say_what_counts,
    say_what_file_says,
    with_start,
    without_holograms,
)
from napari_phase4d.pipeline.streaming import reconstruct_to_disk
from napari_phase4d.recording import Recording
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.task import UNWATCHED, Cancelled, CancelledCall, ProgressCall, Task
from napari_phase4d.unwrapping import (
    check_light,
    is_known,
)
from napari_phase4d.unwrapping.given import all_known, checked_boundaries
from napari_phase4d.warned import warn
from napari_phase4d.words import advised_call, sentence_of

__all__ = [
    "Outcome",
    "advice_on",
    "cells_by",
    "focus_by",
    "mask_of",
    "opened_reference",
    "phase_settings",
    "reconstruct_by",
    "run",
    "run_unwarned",
    "unwrap_by",
]


@dataclass(frozen=True)
class Outcome:
    """What a run gives.

    Parameters
    ----------
    recording : Recording or None
        The hologram video; None if the run began with wrapped phase.
    recipe : Recipe
        All settings that were used, with the lobes, the optics and the frame that was started
        from.
    reconstruction : xarray.Dataset
        Wrapped ``phase``, dims (time, angle, y, x); and ``amplitude``, where it is known.
    comparison : Comparison
        Unwrapped phase of every method, and the table.
    truth : xarray.DataArray, optional
        Exact phase on the reconstruction's grid, where it is known.
    scores : xarray.DataArray, optional
        How safe each frame was found to be as the start, see `score_boundaries`; None if the
        recipe named the frame.
    cells : Cells, optional
        The cells of the result most to be trusted, if the recipe asks for them.
    cells_error : Exception, optional
        Why there are none although the recipe asks for them; all else is whole.
    """

    recording: Recording | None
    recipe: Recipe
    reconstruction: xr.Dataset
    comparison: Comparison
    truth: xr.DataArray | None = None
    scores: xr.DataArray | None = None
    cells: Cells | None = None
    cells_error: Exception | None = None


@advised_call(
    recipe="give Recipe(...), or Recipe.from_file(path)",
    recording="open_recording() makes one of a file",
)
def run(
    recipe: Recipe,
    recording: Recording | None = None,
    truth: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    folder: str | Path | None = None,
    scheduler: str | None = None,
) -> Outcome:
    """Follow a recipe from the recording to the unwrapped phase.

    A recording that does not fit into memory is worked on a block of frames at a time; the stacks
    that come out lie on disk then, and are the same numbers. Where the recipe's boundary is
    "auto", the safest frame is looked for once there is phase, and the outcome's recipe names it.

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
    folder : str or Path, optional
        Where stacks lie that are not held in memory. Those of an earlier run are replaced, and
        can't be read any more by what that one returned: give each run a folder of its own.
        `write_outcome` to the same folder finds them there. Default: a temporary folder that
        goes when Python ends.
    scheduler : str, optional
        Address of a ``dask.distributed`` scheduler whose workers see the recording and the folder
        under the same paths. All stacks lie on disk then.

    Returns
    -------
    Outcome
        The recipe as it was followed, wrapped phase, unwrapped phase of every method, their table,
        and cells if they are asked for.

    Raises
    ------
    OSError, TypeError, ValueError
        If the recording can't be read, a setting does not fit it, or memory or disk are too small.
        Cells that can't be found are warned of, see `Outcome`.
    Cancelled
        If ``cancelled()`` returned True.

    Warns
    -----
    UserWarning
        Of what is probably wrong with the phase of holograms, as `reconstruct` does.

    See Also
    --------
    Recipe : All settings.
    napari_phase4d.pipeline.write_outcome : Writes what comes out into a folder.

    Examples
    --------
    >>> import napari_phase4d as p4d
    >>> recipe = p4d.Recipe(recording="sample:yeast", methods=("spatial-2d",))
    >>> outcome = p4d.run(recipe)
    >>> outcome.comparison.results["spatial-2d"].sizes["time"]
    19
    """
    task = Task(progress, cancelled)
    outcome = run_unwarned(recipe, recording, truth, task, folder=folder, scheduler=scheduler)
    name = "" if outcome.recording is None else outcome.recording.name
    for advice in advice_on(outcome, FEW_LOST):
        warn(f"{name}: {advice}")
    return outcome


def advice_on(outcome: Outcome, few_lost: float = 0.0, *, of_lobes: bool = True) -> list[str]:
    """Return what is to be looked after in the phase of holograms; each part a sentence.

    Parameters
    ----------
    outcome : Outcome
        What a run gave.
    few_lost : float, optional
        Up to which share of all frames lost ones are not worth a word.
    of_lobes : bool, optional
        Whether to say what is in doubt of the lobes, too.
    """
    if outcome.recording is None:
        return []
    advice = reconstruction_advice(
        outcome.reconstruction.attrs, outcome.recording.n_frames, few_lost
    )
    light = outcome.recording.optics.wavelength_um
    doubts = lobe_doubts(with_wavelengths(outcome.recipe.lobes, light)) if of_lobes else []
    return doubts + advice


def run_unwarned(
    recipe: Recipe,
    recording: Recording | None = None,
    truth: xr.DataArray | None = None,
    task: Task = UNWATCHED,
    *,
    folder: str | Path | None = None,
    scheduler: str | None = None,
) -> Outcome:
    """Do what `run` does, but leave it to the caller to say what is to be looked after."""
    progress, cancelled = task.progress, task.cancelled
    if recording is None and not recipe.recording:
        msg = "the recipe names no recording; give run() one, or a recipe with a file"
        raise ValueError(msg)
    if recipe.cells is not None:
        check_follower()
    if recording is not None:
        say_what_counts(recipe, recording)
    opened = recording if recording is not None else open_by(recipe)
    if isinstance(opened, xr.DataArray):
        recipe = without_holograms(recipe)
        say_what_file_says(recipe, opened)
        check_start(recipe, opened.shape)
        check_light(recipe.methods, wavelengths_of(opened), opened["angle"].values)
        finds_start = recipe.boundary == "auto"
        needs = phase_needs(
            recipe.methods, opened.shape, finds_start=finds_start, confidence=recipe.confidence
        )
        with place_for(recipe, needs, folder, scheduler) as place:
            used, scores = with_start(recipe, opened, task)
            comparison = unwrap_by(used, opened, truth, progress, cancelled, place=place)
            trust_on_disk(used, comparison, task)
        comparison = noting_start(comparison, scores)
        # Which lies in the folder, where stacks lie on disk: what is judged is read from there.
        data = xr.Dataset({"phase": comparison.phase})
        outcome = Outcome(None, used, data, comparison, truth, scores)
        return with_cells(outcome, task)
    recording = opened
    lobes = lobes_of(recipe) or find_lobes(
        beginning_of(recording, recipe.first_frames),
        recipe.wanted_views,
        angles_deg=recipe.angles_deg,
        wavelengths_um=recipe.wavelengths_um,
        progress=progress,
        cancelled=cancelled,
    )
    warn_of_doubts(lobes, recording.name)
    check_start(recipe, (recording.n_frames, len(lobes)))
    check_light(recipe.methods, *light_of(lobes, recording.optics.wavelength_um))
    needs = needs_of(recipe, recording, lobes)
    with place_for(recipe, needs, folder, scheduler) as place:
        data = reconstruct_by(recipe, recording, lobes, progress, cancelled, place=place)
        used, scores = with_start(recipe, data["phase"], task)
        comparison = unwrap_by(
            used,
            data["phase"],
            truth,
            progress,
            cancelled,
            amplitude=data["amplitude"],
            place=place,
        )
        trust_on_disk(used, comparison, task)
    used = used.changed(
        lobes=tuple(lobes), optics=recording.optics, refocus_um=data.attrs.get("refocus_um")
    )
    comparison = noting_start(comparison, scores)
    outcome = Outcome(recording, used, data, comparison, truth, scores)
    return with_cells(outcome, task)


def trust_on_disk(
    recipe: Recipe,
    comparison: Comparison,
    task: Task,
) -> None:
    """Make maps of confidence that a recipe asks for, if they lie on disk, as results do there."""
    if recipe.confidence and not comparison.held:
        comparison.confidences(None, **task.calls)


def with_cells(
    outcome: Outcome,
    task: Task = UNWATCHED,
) -> Outcome:
    """Return what a run gave with the cells that its recipe asks for.

    What has been computed by then is not lost if they can't be found.
    """
    try:
        cells = cells_by(outcome.recipe, outcome.comparison, outcome.reconstruction["phase"], task)
    except Cancelled:
        raise
    except Exception as error:  # of whatever library
        warn(f"the cells could not be found: {sentence_of(error)}; all else is in the outcome")
        return replace(outcome, cells_error=error)
    return replace(outcome, cells=cells)


def cells_by(
    recipe: Recipe,
    comparison: Comparison,
    wrapped: xr.DataArray,
    task: Task = UNWATCHED,
) -> Cells | None:
    """Find, follow and measure cells as a recipe asks for, None if it does not.

    They are those of the result most to be trusted; where the recipe names no microscope, that
    which the phase notes counts. Pixels in doubt make their errors larger; after a run larger than
    memory they do so if the recipe asks for confidence.
    """
    if recipe.cells is None:
        return None
    method = most_trusted(comparison.results)
    result = comparison.results[method]
    trust = comparison.known_confidence(method, **task.calls)
    found = cells_in(
        result,
        light_for(recipe.optics, result),
        recipe.cells,
        method=method,
        wrapped=wrapped,
        confidence=trust,
        **task.calls,
    )
    if found.table.empty:
        warn(
            "no cells were found; is the object thinner than threshold_rad, smaller than "
            "smallest_um2, or lower than the empty field (then flip the lobe, or give -phase)?"
        )
    elif trust is None:
        warn(
            "the errors of the cells leave out pixels in doubt about their cycle: of results that "
            "lie on disk, confidence is computed where a recipe for the finished recording asks "
            "for it (confidence=True)"
        )
    return found


def check_start(recipe: Recipe, shape: Sequence[int]) -> None:
    """Refuse frames to start from that are not there, before the long work."""
    if recipe.boundary != "auto":
        checked_boundaries(recipe.boundary, tuple(shape[:2]))


def unwrap_by(
    recipe: Recipe,
    phase: xr.DataArray,
    truth: xr.DataArray | None = None,
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    amplitude: xr.DataArray | None = None,
    finished: Callable[[str, Comparison], None] | None = None,
    place: Place | None = None,
) -> Comparison:
    """Unwrap wrapped phase with a recipe's methods and settings; NaN are left out.

    The safest frame to start from is looked for where the recipe names none.

    ``finished`` is told each method and the comparison so far, see `compare`. With a ``place``,
    results are written there a block at a time.

    Parameters
    ----------
    recipe : Recipe
        Its methods, options, ``boundary`` and ``mask`` count.
    phase : xarray.DataArray
        Wrapped phase in radians, dims (time, angle, y, x).
    truth : xarray.DataArray, optional
        Exact phase in radians, for the errors in the table.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each step; ``cancelled()`` stops the work.
    amplitude : xarray.DataArray, optional
        Amplitude of the field, dims as those of the phase.
    finished : callable, optional
        ``finished(method, comparison)``.
    place : Place, optional
        From `find_place`. Default: everything is held in memory.

    Returns
    -------
    Comparison
        Unwrapped phase of every method in radians, and their table.
    """
    task = Task(progress, cancelled)
    recipe, scores = with_start(recipe, phase, task)
    if place is not None:
        found = place.unwrap(recipe, phase, amplitude, truth, task, finished)
        return noting_start(found, scores)
    found = compare(
        phase,
        recipe.methods,
        recipe.start_frames,
        truth,
        mask=mask_of(recipe, phase),
        amplitude=amplitude,
        options=recipe.options,
        progress=progress,
        cancelled=cancelled,
        finished=finished,
    )
    return noting_start(found, scores)


def mask_of(recipe: Recipe, phase: xr.DataArray) -> NDArray[np.bool_] | str | None:
    """Return what a recipe unwraps of a phase in memory: what is known, where it says nothing."""
    if recipe.mask is not None:
        return recipe.mask
    if all_known(phase.values):
        return None
    known = is_known(phase.values)
    return known if known.any() else None  # or the error would be that of an empty mask


def reconstruct_by(
    recipe: Recipe,
    recording: Recording,
    lobes: list[Lobe],
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
    *,
    place: Place | None = None,
) -> xr.Dataset:
    """Reconstruct a recording with a recipe's settings; a reference file is opened.

    With a ``place``, phase and amplitude are written there a block at a time.

    Parameters
    ----------
    recipe : Recipe
        Its window, reference, background and focus count.
    recording : Recording
        The hologram video.
    lobes : list of Lobe
        The views.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each frame; ``cancelled()`` stops the work.
    place : Place, optional
        From `find_place`. Default: everything is held in memory.

    Returns
    -------
    xarray.Dataset
        ``phase`` wrapped, in radians, and ``amplitude``, dims (time, angle, y, x), as
        `reconstruct` returns them.
    """
    task = Task(progress, cancelled)
    reference = opened_reference(recipe, recording)
    chosen = PhaseSettings(reference, **phase_settings(recipe))
    work = frame_reconstructor(recording, lobes, chosen, Task(None, cancelled))
    if place is None:
        return reconstruct_frames(work, recording, task)
    source = FrameSource(recipe, recording)
    return reconstruct_to_disk(source, work, place.shelf, place.workers, task)


def focus_by(
    recipe: Recipe,
    recording: Recording,
    lobes: list[Lobe],
    progress: ProgressCall | None = None,
    cancelled: CancelledCall | None = None,
) -> Focus:
    """Find the focus of a recording with a recipe's settings, see `find_focus`.

    Parameters
    ----------
    recipe : Recipe
        Its window, reference and background count; fields are not refocused before.
    recording : Recording
        The hologram video.
    lobes : list of Lobe
        The views.
    progress, cancelled : callable, optional
        ``progress(done, total, message)`` after each plane; ``cancelled()`` stops the search.

    Returns
    -------
    Focus
        Distance in micrometres, kind of object, and the measure over distance.
    """
    settings = phase_settings(recipe) | {"refocus_um": None}
    reference = opened_reference(recipe, recording)
    chosen = PhaseSettings(reference, **settings)
    work = frame_reconstructor(recording, lobes, chosen, Task(None, cancelled))
    return find_focus(work, recording, progress=progress, cancelled=cancelled)


def opened_reference(recipe: Recipe, recording: Recording) -> Any:
    """Return a recipe's reference as `reconstruct` takes it; a file is opened.

    What had to be assumed of the file is warned of; its times do not count.
    """
    if recipe.reference_file is None:
        return recipe.reference
    found = open_recording(recipe.reference_file, recording.optics, 1, raw=recipe.raw)
    for note in found.notes:
        warn(f"the reference {found.name}: {note.removesuffix('.')}")
    return found


def phase_settings(recipe: Recipe) -> dict[str, Any]:
    """Return what a recipe sets of `reconstruct`, beside lobes and reference."""
    return {name: getattr(recipe, name) for name in PHASE_SETTINGS}


# ---- ahead of a run: how long it will take, and compiling -----------------------------------
