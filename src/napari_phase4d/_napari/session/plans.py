"""What the session can do: each piece of long work as a `Plan`."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import xarray as xr

from napari_phase4d._napari.session.opening import Opened, TruthCall, open_anything
from napari_phase4d._napari.session.plan import Plan
from napari_phase4d._napari.session.state import Changed, State
from napari_phase4d._napari.session.states import phase_is_stale
from napari_phase4d.evaluation import (
    REFERENCE,
    Comparison,
    best_known,
    held,
    itoh_margin,
    noise_figures,
)
from napari_phase4d.holography import Focus, Lobe, find_lobes, pair_distance, power_spectrum
from napari_phase4d.io import RawLayout
from napari_phase4d.pipeline import (
    Outcome,
    estimated_seconds,
    find_place,
    focus_by,
    needs_of,
    phase_needs,
    reconstruct_by,
    unwrap_by,
)
from napari_phase4d.progress import Cancelled, CancelledCall, ProgressCall, Watch
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import METHODS, score_boundaries

__all__ = [
    "plan_confidence",
    "plan_estimate",
    "plan_focus",
    "plan_lobes",
    "plan_margin",
    "plan_noise",
    "plan_opening",
    "plan_reconstruction",
    "plan_scores",
    "plan_spectrum",
    "plan_truth",
    "plan_unwrapping",
]

#: Frames averaged for the spectrum on screen.
SPECTRUM_FRAMES = 32
#: Times that are scored of a recording larger than memory.
SCORED_TIMES = 100


def plan_opening(
    state: State,
    source: object,
    content: str = "auto",
    title: str = "",
    raw: RawLayout | None = None,
) -> Plan:
    """Plan to open a file, folder, recipe or sample, see `open_anything`."""

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> Opened:
        return open_anything(source, content, raw)

    return Plan(title or "Opening", work, state.take, cancellable=False)


def plan_lobes(state: State) -> Plan:
    """Plan to find the lobes."""
    recording, recipe = state.needed_recording(), state.recipe
    angles = recipe.angles_deg
    if angles is not None and len(angles) != recipe.n_views:
        angles = None

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> tuple[xr.DataArray, list[Lobe] | ValueError]:
        spectrum = power_spectrum(
            recording, max_frames=SPECTRUM_FRAMES, progress=progress, cancelled=cancelled
        )
        try:
            return spectrum, found_lobes(recording, recipe.n_views, angles, progress, cancelled)
        except ValueError as error:
            # The spectrum is needed all the more, to place the lobes by hand.
            return spectrum, error

    def receive(found: tuple[xr.DataArray, list[Lobe] | ValueError]) -> None:
        check_recording(state, recording)
        state.spectrum, lobes = found
        state.spectrum_changed.emit()
        if isinstance(lobes, ValueError):
            raise lobes
        if len(lobes) < state.recipe.n_views:
            state.update(n_views=len(lobes), angles_deg=None)
        state.set_lobes(with_known_views(lobes, recipe.lobes))

    return Plan("Finding the lobes", work, receive)


def plan_spectrum(state: State) -> Plan:
    """Plan to compute the spectrum alone, until something else is asked for."""
    recording = state.needed_recording()

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> xr.DataArray:
        return power_spectrum(
            recording, max_frames=SPECTRUM_FRAMES, progress=progress, cancelled=cancelled
        )

    def receive(spectrum: xr.DataArray) -> None:
        # Another microscope leaves the frames, and so their spectrum, as they are.
        now = state.recording
        if now is not None and now.holograms.data is recording.holograms.data:
            state.spectrum = spectrum
            state.spectrum_changed.emit()

    return Plan("Computing the spectrum", work, receive, gives_way=True)


def plan_reconstruction(state: State) -> Plan:
    """Plan to reconstruct wrapped phase and amplitude.

    Raises
    ------
    ValueError
        If there is no recording or no lobe yet.
    """
    recording, recipe = state.needed_recording(), state.recipe
    truth_for = state.truth_for
    if not recipe.lobes:
        msg = "there are no lobes yet; press Find lobes in step 2"
        raise ValueError(msg)

    lobes = list(recipe.lobes)
    # Methods that need all frames at once can still be left out.
    modest = recipe.changed(methods=[m for m in recipe.methods if METHODS[m].streams])
    place = find_place(recipe, needs_of(modest, recording, lobes))

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> tuple[xr.Dataset, xr.DataArray | None]:
        data = reconstruct_by(recipe, recording, lobes, progress, cancelled, place=place)
        return data, known_truth(truth_for, data["phase"])

    def receive(found: tuple[xr.Dataset, xr.DataArray | None]) -> None:
        check_recording(state, recording)
        state.leave_place(place)
        data, state.known_truth = found
        state.truth = state.known_truth
        # "auto" has become a number of micrometres.
        used = recipe.changed(refocus_um=data.attrs.get("refocus_um"))
        if state.recipe.refocus_um == recipe.refocus_um:
            state.update(refocus_um=used.refocus_um)
        state.set_reconstruction(data, used)

    return Plan("Reconstructing", work, receive)


def plan_focus(state: State) -> Plan:
    """Plan to find the distance at which the object is sharp.

    Raises
    ------
    ValueError
        If there is no recording or no lobe yet.
    """
    recording, recipe = state.needed_recording(), state.recipe
    if not recipe.lobes:
        msg = "there are no lobes yet; press Find lobes in step 2"
        raise ValueError(msg)

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> Focus:
        return focus_by(recipe, recording, list(recipe.lobes), progress, cancelled)

    def receive(focus: Focus) -> None:
        check_recording(state, recording)
        state.focus = focus
        state.update(refocus_um=round(focus.distance_um, 2))

    return Plan("Looking for the focus", work, receive)


def plan_noise(state: State) -> Plan:
    """Plan to measure how noisy the phase is, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data = state.needed_reconstruction()

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> pd.DataFrame:
        return noise_figures(data, progress, cancelled)

    def receive(noise: pd.DataFrame) -> None:
        if state.reconstruction is not data:
            raise Changed
        state.noise = noise
        state.noise_changed.emit()

    return Plan("Measuring the noise", work, receive, gives_way=True)


def plan_unwrapping(state: State) -> Plan:
    """Plan to unwrap with the chosen methods, one after another.

    Raises
    ------
    ValueError
        If there is no phase for the present settings, or no method is chosen.
    """
    data = state.needed_reconstruction()
    if phase_is_stale(state):
        msg = "the lobes or settings have changed since; press Reconstruct in step 3 again"
        raise ValueError(msg)
    recording, chosen, truth = state.recording, state.recipe, state.truth
    if not chosen.methods:
        msg = "no method is ticked; tick at least one in step 4"
        raise ValueError(msg)
    recipe = state.phase_recipe.changed(
        boundary=chosen.boundary,
        mask=chosen.mask,
        methods=chosen.methods,
        options=chosen.options,
        confidence=chosen.confidence,
    )
    place = state.place
    folder = Path(tempfile.gettempdir()) if place is None else place.shelf.folder
    phase_needs(recipe.methods, data["phase"].shape).check(folder, on_disk=place is not None)

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> Outcome:
        so_far: list[Comparison] = []
        try:
            comparison = unwrap_by(
                recipe,
                data["phase"],
                truth,
                progress,
                cancelled,
                amplitude=data.get("amplitude"),
                finished=lambda _, comparison: so_far.append(comparison),
                place=place,
            )
        except Cancelled:
            if not so_far:
                raise
            comparison = so_far[-1]
        done = recipe.changed(methods=tuple(comparison.results))
        return Outcome(recording, done, data, comparison, truth)

    def receive(outcome: Outcome) -> None:
        if state.reconstruction is not data:
            raise Changed
        if state.truth is not truth:  # chosen while this was computed
            comparison = outcome.comparison.against(state.truth)
            outcome = replace(outcome, comparison=comparison, truth=state.truth)
        state.outcome, state.margin = outcome, None
        state.confidence, state.warnings = {}, {}
        state.outcome_changed.emit()

    return Plan("Unwrapping", work, receive, keeps_parts=True)


def plan_truth(state: State, truth: xr.DataArray | None) -> Plan:
    """Plan to count errors against exact phase, None to count none.

    Raises
    ------
    ValueError
        If there are no results yet that could be wrong.
    """
    comparison = state.needed_outcome().comparison

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> Comparison:
        return comparison.against(truth)

    def receive(judged: Comparison) -> None:
        if state.outcome is None or state.outcome.comparison is not comparison:
            raise Changed
        state.take_truth(truth, judged)

    return Plan("Counting errors", work, receive, cancellable=False)


def plan_margin(state: State) -> Plan:
    """Plan to see where steps are too large, by the truth or else by the best result.

    Raises
    ------
    ValueError
        If there is neither truth nor a result yet.
    """
    outcome, data = state.outcome, state.reconstruction
    if not state.results and state.truth is None:
        state.needed_outcome()
    known, _ = best_known(state.results, state.truth)

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> xr.Dataset:
        return itoh_margin(known)

    def receive(margin: xr.Dataset) -> None:
        if state.outcome is not outcome or state.reconstruction is not data:
            raise Changed
        state.margin = margin
        state.margin_changed.emit()

    return Plan("Measuring the steps", work, receive, cancellable=False)


def plan_confidence(state: State, *, unasked: bool = False) -> Plan:
    """Plan to see how far every result is to be trusted.

    Parameters
    ----------
    state : State
        The session.
    unasked : bool, optional
        Whether to do it unseen, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no result yet.
    """
    outcome = state.needed_outcome()

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> tuple[dict[str, xr.DataArray], dict[str, str], Comparison]:
        comparison = outcome.comparison
        watch = Watch(len(comparison.results) + 1, "weighing", progress, cancelled)
        maps = {}
        for method in comparison.results:
            maps[method] = comparison.confidence(method, None, cancelled)
            watch.step()
        warnings = comparison.warnings()
        watch.step()
        return maps, warnings, comparison.with_suspicion(maps)

    def receive(found: tuple[dict[str, xr.DataArray], dict[str, str], Comparison]) -> None:
        now = state.outcome
        if now is None or now.comparison.results is not outcome.comparison.results:
            raise Changed
        state.confidence, state.warnings, judged = found
        if now.comparison is not outcome.comparison:  # another truth was chosen meanwhile
            judged = now.comparison.with_suspicion(state.confidence)
        state.outcome = replace(now, comparison=judged)
        state.confidence_changed.emit()

    return Plan("Weighing the results", work, receive, gives_way=unasked)


def plan_scores(state: State, *, unasked: bool = False) -> Plan:
    """Plan to score every frame as the one to start from.

    Parameters
    ----------
    state : State
        The session.
    unasked : bool, optional
        Whether to do it unseen, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data = state.needed_reconstruction()
    reference, place = state.results.get(REFERENCE), state.place

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> xr.DataArray:
        if place is not None:
            return scores_of_some(data["phase"], progress, cancelled)
        return score_boundaries(data["phase"], reference, progress=progress, cancelled=cancelled)

    def receive(scores: xr.DataArray) -> None:
        if state.reconstruction is not data:
            raise Changed
        state.scores = scores
        state.scores_changed.emit()

    return Plan("Scoring the frames", work, receive, gives_way=unasked)


def scores_of_some(
    phase: xr.DataArray, progress: ProgressCall | None, cancelled: CancelledCall | None
) -> xr.DataArray:
    """Score some frames of a recording larger than memory; the others stay unknown."""
    every = max(1, -(-phase.sizes["time"] // SCORED_TIMES))
    some = held(phase.isel(time=slice(None, None, every)))
    found = score_boundaries(some, progress=progress, cancelled=cancelled)
    scores = found.reindex(time=phase["time"])
    time, angle = found.attrs["best"]
    return scores.assign_attrs(best=[time * every, angle])


def found_lobes(
    recording: Recording,
    n_views: int,
    angles_deg: Sequence[float] | None,
    progress: ProgressCall | None,
    cancelled: CancelledCall | None,
) -> list[Lobe]:
    """Return so many lobes, or as many as there are where there are fewer."""
    try:
        return find_lobes(
            recording, n_views, angles_deg=angles_deg, progress=progress, cancelled=cancelled
        )
    except ValueError as error:
        try:
            fewer = find_lobes(recording, None, progress=progress, cancelled=cancelled)
        except ValueError:
            raise error from None
        if not len(fewer) < n_views:
            raise
        return fewer


def plan_estimate(state: State) -> Plan:
    """Plan to see how long the ticked methods will take, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data, recipe = state.needed_reconstruction(), state.recipe

    def work(
        progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
    ) -> float:
        return estimated_seconds(recipe, data["phase"], cancelled=cancelled)

    def receive(seconds: float) -> None:
        if state.reconstruction is not data:
            raise Changed
        state.estimate = (recipe.methods, seconds)
        state.estimate_changed.emit()

    return Plan("Estimating the time", work, receive, gives_way=True)


def check_recording(state: State, recording: Recording) -> None:
    """Refuse a result that belongs to an earlier recording or calibration."""
    if state.recording is not recording:
        raise Changed


def with_known_views(found: Sequence[Lobe], known: Sequence[Lobe]) -> list[Lobe]:
    """Return lobes with the angle and sign that the user gave to the same views before."""
    if len(found) != len(known):
        return list(found)
    kept = []
    for lobe in found:
        nearest = min(known, key=lambda k: pair_distance(k.carrier, lobe.carrier))
        same = pair_distance(nearest.carrier, lobe.carrier) < lobe.radius
        known_view = replace(lobe, angle_deg=nearest.angle_deg, flip=nearest.flip)
        kept.append(known_view if same else lobe)
    return kept


def known_truth(truth_for: TruthCall | None, phase: xr.DataArray) -> xr.DataArray | None:
    """Return the exact phase on the grid of wrapped phase, or None where it is not known."""
    if truth_for is None:
        return None
    try:
        return truth_for(phase).assign_attrs(pixel_ratio=phase.attrs["pixel_ratio"])
    except ValueError:  # such as other viewing angles than those that it is known for
        return None
