"""What the session keeps when microscope, frame rate, frames or views become others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from napari_phase4d.analysis import REFERENCE, Verdict, with_wavelength
from napari_phase4d.holography import Lobe, pair_distance, recalibrated
from napari_phase4d.later import xr
from napari_phase4d.pipeline import Outcome, Recipe
from napari_phase4d.recording import Recording
from napari_phase4d.stacks import wavelengths_of
from napari_phase4d.stacks.coordinates import scaled_like

if TYPE_CHECKING:
    from napari_phase4d._napari.session.state import State

__all__ = ["changed_views", "checked_frames", "moved_frames", "recalibrate"]

Stack = TypeVar("Stack", "xr.Dataset", "xr.DataArray")


def recalibrate(state: State, recording: Recording) -> None:
    """Let a state have the same frames with other optics or times; all else gets the new scale."""
    changes = {"optics": recording.optics, "frame_rate_hz": recording.even_rate_hz}
    state.recording = recording
    state.phase_recipe = recalibrated_recipe(state.phase_recipe, changes)
    if state.reconstruction is not None:
        state.reconstruction = recalibrated(state.reconstruction, recording)
        put_on_grid(state, state.reconstruction["phase"])
    if state.noise is not None:
        light = None if state.reconstruction is None else wavelengths_of(state.reconstruction)
        state.noise = with_wavelength(
            state.noise, recording.optics.wavelength_um if light is None else light
        )
    if state.scores is not None:
        state.scores = state.scores.assign_coords(time=recording.times_s)
    if state.outcome is not None:
        up_to_date = not state.scores_are_old
        state.outcome = rescaled(state.outcome, recording, changes, state.truth)
        if up_to_date:  # its scale is no reason to hold the frames against it again
            state.scored_by = state.results.get(REFERENCE)
    state.measured = state.cells = None  # their areas are of the old scale
    state.cells_changed.emit()
    state.update(**changes)


def put_on_grid(state: State, phase: xr.DataArray) -> None:
    """Give what lies on the grid of the phase its new coordinates, and let words name them."""
    grid = {d: phase[d] for d in ("time", "y", "x")}
    was_known = state.truth is state.known_truth
    for name in ("truth", "known_truth"):
        exact = getattr(state, name)
        setattr(state, name, None if exact is None else exact.assign_coords(grid))
    state.truth = state.known_truth if was_known else state.truth
    state.confidence = {m: scaled_like(c, phase) for m, c in state.confidence.items()}
    if isinstance(state.verdict, Verdict):
        state.verdict = state.verdict.on_grid_of(phase)
    state.margin = None if state.margin is None else state.margin.assign_coords(grid)


def rescaled(
    outcome: Outcome, recording: Recording, changes: dict[str, Any], truth: xr.DataArray | None
) -> Outcome:
    """Return results with the scale of a recording, and exact phase that has it already."""

    def scaled(stack: Stack) -> Stack:
        return recalibrated(stack, recording)

    before = outcome.comparison
    results = {m: scaled(r) for m, r in before.results.items()}
    reconstruction, scores = scaled(outcome.reconstruction), outcome.scores
    return replace(
        outcome,
        recording=recording,
        recipe=recalibrated_recipe(outcome.recipe, changes),
        reconstruction=reconstruction,
        comparison=before.on_grid_of(scaled(before.phase), results),
        truth=truth,
        scores=None if scores is None else scaled_like(scores, reconstruction["phase"]),
        cells=None,
    )


def recalibrated_recipe(recipe: Recipe, changes: dict[str, Any]) -> Recipe:
    """Return the recipe of what was made before, with another microscope or frame rate.

    Refocused phase belongs to the microscope that it was refocused with.
    """
    if recipe.refocus_um is None:
        return recipe.changed(**changes)
    return recipe.changed(frame_rate_hz=changes["frame_rate_hz"])


def changed_views(recipe: Recipe, lobes: Sequence[Lobe]) -> dict[str, Any]:
    """Return the settings that views bring with them.

    Angles and wavelengths that were known ahead go where the views say others, as they would come
    before these in a run; they stay while there is no view.
    """
    fields = {"angles_deg": "angle_deg", "wavelengths_um": "wavelength_um"}
    old = [
        name
        for name, field in fields.items()
        if lobes and getattr(recipe, name) != tuple(getattr(lobe, field) for lobe in lobes)
    ]
    return {"lobes": tuple(lobes), **dict.fromkeys(old)}


def moved_frames(
    frames: Sequence[tuple[int, int]], old: xr.Dataset | None, new: xr.Dataset
) -> tuple[tuple[int, int], ...]:
    """Return the same frames (time, angle) in a new reconstruction, without those that have gone.

    Parameters
    ----------
    frames : sequence of tuple of int
        In the old reconstruction.
    old : xarray.Dataset or None
        What they were chosen in; None if there was nothing yet.
    new : xarray.Dataset
        The new reconstruction.
    """
    if old is not None:
        moved = [(t, same_view(old, a, new)) for t, a in frames]
        frames = [(t, a) for t, a in moved if a is not None]
    shape = new["phase"].shape[:2]
    return tuple(frame for frame in frames if is_frame(frame, shape))


def is_frame(frame: tuple[int, int], shape: tuple[int, ...]) -> bool:
    """Say whether there is a frame (time, angle); negative numbers count from the end."""
    return all(-n <= i < n for i, n in zip(frame, shape, strict=True))


def checked_frames(
    frames: Sequence[tuple[int, int]], shape: tuple[int, ...]
) -> tuple[tuple[int, int], ...]:
    """Return frames (time, angle) counted from 0.

    Raises
    ------
    ValueError
        If one of them is not there.
    """
    missing = [frame for frame in frames if not is_frame(frame, shape)]
    if missing:
        msg = f"there is no thin frame {missing[0]}; there are {shape[0]} times, {shape[1]} views"
        raise ValueError(msg)
    return tuple((t % shape[0], a % shape[1]) for t, a in frames)


def same_view(old: xr.Dataset, view: int, new: xr.Dataset) -> int | None:
    """Return the number in a new reconstruction of a view of an old one, None if it has gone."""
    lobes = old.attrs["lobes"]
    if not -len(lobes) <= view < len(lobes):
        return None
    distances = [
        pair_distance(lobe["carrier"], lobes[view]["carrier"]) for lobe in new.attrs["lobes"]
    ]
    nearest = min(distances)
    return distances.index(nearest) if nearest < lobes[view]["radius"] else None
