"""The plans from phase to results: unwrap them, judge them, measure regions of them."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from napari_phase4d._napari.session.history import StepNumber
from napari_phase4d._napari.session.phase_plans import Plan
from napari_phase4d._napari.session.state import TIME_FIELDS, Changed, State, phase_is_stale
from napari_phase4d.analysis import (
    REFERENCE,
    Comparison,
    best_known,
    in_memory,
    itoh_margin,
    measure,
    most_trusted,
    order_verdict,
    steps_sentence,
)
from napari_phase4d.io import OME_TIFF, write_table
from napari_phase4d.later import pd, xr
from napari_phase4d.optics import REFRACTION_INCREMENT_ML_PER_G, Optics
from napari_phase4d.pipeline import (
    Outcome,
    estimated_seconds,
    light_for,
    noting_start,
    phase_needs,
    result_folder,
    source_of,
    unwrap_by,
    with_start,
    write_files,
)
from napari_phase4d.task import Cancelled, Task, Watch
from napari_phase4d.unwrapping import score_boundaries, scores_of_some

__all__ = [
    "Masks",
    "MasksCall",
    "folder_without_results",
    "plan_confidence",
    "plan_estimate",
    "plan_margin",
    "plan_measuring",
    "plan_saving",
    "plan_scores",
    "plan_truth",
    "plan_unwrapping",
]

#: A method, what it is called, and its result.
Part: TypeAlias = "tuple[str, str, xr.DataArray]"
#: Numbers the runs whose results lie on disk.
RUNS = itertools.count(1)


def plan_unwrapping(state: State, methods: Sequence[str] | None = None) -> Plan:
    """Plan to unwrap with several methods, one after another.

    Parameters
    ----------
    state : State
        The session.
    methods : sequence of str, optional
        Their ids. Default: those that are ticked and make sense for the phase.

    Raises
    ------
    ValueError
        If there is no phase for the present settings, or no method to run.
    """
    methods = state.to_run if methods is None else tuple(methods)
    data = ready_phase(state, methods)
    recording, chosen, truth = state.recording, state.recipe, state.truth
    recipe = state.phase_recipe.changed(
        boundary=state.start_frames or "auto",
        mask=chosen.mask,
        methods=methods,
        options=chosen.options,
        confidence=chosen.confidence,
        cells=None,  # they are looked for when that is asked for
    )
    known = state.scores if chosen.boundary == "auto" else None
    finds_start = recipe.boundary == "auto"
    place, number = state.place, next(RUNS)
    folder = Path(tempfile.gettempdir()) if place is None else place.shelf.folder
    needs = phase_needs(
        recipe.methods,
        data["phase"].shape,
        finds_start=finds_start,
        confidence=recipe.confidence,
    )
    needs.check(folder, on_disk=place is not None)

    parts: SimpleQueue[Part] = SimpleQueue()

    def work(task: Task) -> Outcome:
        used, found = with_start(recipe, data["phase"], task)
        scores = known if found is None else found
        so_far: list[Comparison] = []

        def finished(method: str, comparison: Comparison) -> None:
            so_far.append(comparison)
            label = str(comparison.table["method"][method])
            parts.put((method, label, comparison.results[method]))

        # Each run has a folder of its own: what an earlier one showed stays as it is.
        with nullcontext() if place is None else place.nested(f"run_{number}") as own:
            try:
                comparison = unwrap_by(
                    used,
                    data["phase"],
                    truth,
                    **task.calls,
                    amplitude=data.get("amplitude"),
                    finished=finished,
                    place=own,
                )
            except Cancelled:
                if not so_far:
                    raise
                comparison = so_far[-1]
        done = used.changed(methods=tuple(comparison.results))
        return Outcome(recording, done, data, noting_start(comparison, scores), truth, scores)

    def receive(outcome: Outcome) -> None:
        state.check_phase(data)
        if state.truth is not truth:  # chosen while this was computed
            comparison = outcome.comparison.against(state.truth)
            outcome = replace(outcome, comparison=comparison, truth=state.truth)
        state.take_outcome(outcome)
        if state.scores is None and outcome.scores is not None:
            state.scores = outcome.scores
            state.scores_changed.emit()
        state.outcome_changed.emit()

    return Plan(
        "Unwrapping",
        work,
        receive,
        keeps_parts=True,
        parts=parts,
        receive_part=lambda part: state.take_finished(data, *part),
        step=StepNumber.UNWRAP,
    )


def ready_phase(state: State, methods: Sequence[str]) -> xr.Dataset:
    """Return the phase to unwrap; ValueError if it is old, or there is no method to run."""
    data = state.needed_reconstruction()
    if phase_is_stale(state):
        msg = "the lobes or settings have changed since; press Reconstruct in step 3 again"
        raise ValueError(msg)
    if not methods:
        msg = "no method is ticked; tick at least one in step 4"
        raise ValueError(msg)
    return data


def plan_scores(state: State, *, unasked: bool = False) -> Plan:
    """Plan to score every frame as the one to start from, by the result of WL1 where there is one.

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
    reference = None if state.place is not None else state.results.get(REFERENCE)

    def work(task: Task) -> xr.DataArray:
        if reference is None:
            needs = phase_needs((), data["phase"].shape, finds_start=True)
            needs.check(Path(tempfile.gettempdir()), on_disk=False)
            return scores_of_some(data["phase"], task=task)
        return score_boundaries(data["phase"], reference, **task.calls)

    def receive(scores: xr.DataArray) -> None:
        state.check_phase(data)
        state.scores, state.scored_by = scores, reference
        state.scores_changed.emit()

    return Plan("Scoring the frames", work, receive, gives_way=unasked, step=StepNumber.UNWRAP)


def plan_estimate(state: State) -> Plan:
    """Plan to see how long the ticked methods will take, until something else is asked for.

    Raises
    ------
    ValueError
        If there is no phase yet.
    """
    data, recipe = state.needed_reconstruction(), state.recipe.changed(methods=state.to_run)
    if state.start_frames:  # found already, which takes no time any more
        recipe = recipe.changed(boundary=state.start_frames)

    def work(task: Task) -> float:
        return estimated_seconds(recipe, data["phase"], cancelled=task.cancelled)

    def receive(seconds: float) -> None:
        state.check_phase(data)
        now = state.recipe.changed(methods=state.to_run)
        if any(getattr(now, field) != getattr(recipe, field) for field in TIME_FIELDS):
            raise Changed
        state.estimate = (recipe.methods, seconds)
        state.estimate_changed.emit()

    return Plan("Estimating the time", work, receive, gives_way=True, step=StepNumber.UNWRAP)


Judged: TypeAlias = "tuple[dict[str, xr.DataArray], dict[str, str], str, Comparison]"


def plan_truth(state: State, truth: xr.DataArray | None) -> Plan:
    """Plan to read exact phase and count errors against it, None to count none."""
    outcome, data, on_disk = state.outcome, state.reconstruction, state.place is not None
    before = None if outcome is None else outcome.comparison

    def work(task: Task) -> tuple[xr.DataArray | None, Comparison | None]:
        # What fits into memory is read here, once, and not at every look at it in the window.
        exact = truth if truth is None or on_disk else in_memory(truth)
        return exact, None if before is None else before.against(exact)

    def receive(found: tuple[xr.DataArray | None, Comparison | None]) -> None:
        now = None if state.outcome is None else state.outcome.comparison
        if now is not before:
            raise Changed
        state.check_phase(data)
        state.take_truth(*found)

    return Plan("Counting errors", work, receive, cancellable=False)


def plan_margin(state: State, *, in_words: bool = False) -> Plan:
    """Plan to see where steps are too large, by the truth or else by the best result.

    Parameters
    ----------
    state : State
        The session.
    in_words : bool, optional
        Whether it is also said what that means, and which order suits the object; that looks
        through all results.

    Raises
    ------
    ValueError
        If there is neither truth nor a result yet.
    """
    outcome, data = state.outcome, state.reconstruction
    if not state.results and state.truth is None:
        state.needed_outcome()
    results, truth = state.results, state.truth
    known, basis = best_known(results, truth)
    frames = state.start_frames if outcome is None else outcome.recipe.start_frames
    start = next(iter(frames), (0, 0))

    def work(task: Task) -> tuple[xr.Dataset, str]:
        margin = itoh_margin(known, **task.calls)
        if not in_words:
            return margin, ""
        return margin, f"{steps_sentence(margin, basis)} {order_verdict(results, start, truth)}"

    def receive(found: tuple[xr.Dataset, str]) -> None:
        if state.outcome is not outcome:
            raise Changed
        state.check_phase(data)
        state.margin, state.steps_words = found
        state.margin_changed.emit()

    return Plan("Measuring the steps", work, receive)


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
    OSError
        When it runs: if a file would be written over that no run has made, or among the frames
        of the recording.
    ValueError
        If there is no result yet.
    """
    outcome = state.needed_outcome()

    def work(task: Task) -> Judged:
        comparison = outcome.comparison
        watch = Watch(3, "weighing", task)
        # In memory it is done in no time; on disk it takes longer than the methods.
        maps = comparison.confidences(None, **(task.quiet if comparison.held else task).calls)
        watch.step()
        comparison.tally(maps, **task.quiet.calls)
        warnings = comparison.warnings()
        watch.step()
        verdict = comparison.verdict
        watch.step()
        return maps, warnings, verdict, comparison.with_doubt(maps)

    def receive(found: Judged) -> None:
        now = state.outcome
        if now is None or now.comparison.results is not outcome.comparison.results:
            raise Changed
        state.confidence, state.warnings, state.verdict, judged = found
        if now.comparison is not outcome.comparison:  # another truth was chosen meanwhile
            judged = now.comparison.with_doubt(state.confidence)
        state.outcome = replace(now, comparison=judged)
        state.confidence_changed.emit()

    return Plan("Weighing the results", work, receive, gives_way=unasked)


#: Regions by name, as masks (y, x), (time, y, x) or (time, angle, y, x).
Masks: TypeAlias = Mapping[str, "NDArray[np.bool_] | xr.DataArray"]
#: ``masks(task)`` makes them, which may take a while.
MasksCall = Callable[[Task], Masks]


def plan_measuring(
    state: State,
    method: str | Sequence[str] | None = None,
    regions: Masks | MasksCall | None = None,
    *,
    optics: Optics | None = None,
    object_index: float | None = None,
    refraction_increment_ml_per_g: float = REFRACTION_INCREMENT_ML_PER_G,
) -> Plan:
    """Plan to measure regions of a result over time.

    Parameters
    ----------
    state : State
        The session.
    method : str or sequence of str, optional
        Of which result or results; default: the most reliable one. Of several, the table has a
        column ``method``.
    regions : mapping of str to ndarray, or callable that returns one, optional
        Masks by name; default: the whole object. It is called with a task.
    optics : Optics, optional
        The microscope of phase that does not say it.
    object_index : float, optional
        Refractive index of the object, for height and volume.
    refraction_increment_ml_per_g : float, optional
        How much a gram of dry matter in a millilitre raises the refractive index.

    Raises
    ------
    ValueError
        If there is no result yet.
    """
    comparison = state.needed_outcome().comparison
    method = most_trusted(comparison.results) if method is None else method
    methods = [method] if isinstance(method, str) else list(method)
    used = light_for(state.recipe.optics, comparison.results[methods[0]], optics)
    noted = {"refraction increment (mL/g)": refraction_increment_ml_per_g}
    if object_index is not None:
        noted["object index"] = object_index

    def measured_in(masks: Masks, task: Task) -> pd.DataFrame:
        found = []
        for place, method in enumerate(methods, 1):
            result, label = comparison.results[method], str(comparison.table["method"][method])
            head = f"{label} ({place} of {len(methods)})"
            table = measure(
                result,
                masks,
                used,
                object_index=object_index,
                refraction_increment_ml_per_g=refraction_increment_ml_per_g,
                **task.reworded(partial("{}: {}".format, head)).calls,
            ).assign(**noted)
            if len(methods) > 1:
                table.insert(0, "method", label)
            found.append(table)
        return pd.concat(found, ignore_index=True)

    def work(task: Task) -> pd.DataFrame:
        if callable(regions):
            return measured_in(regions(task), task)
        if regions is not None:
            return measured_in(regions, task)
        with object_in(comparison, task) as masks:
            return measured_in(masks, task)

    def receive(measured: pd.DataFrame) -> None:
        now = state.outcome
        if now is None or now.comparison.results is not comparison.results:
            raise Changed
        state.measured = measured
        state.measured_changed.emit()

    return Plan("Measuring", work, receive)


@contextmanager
def object_in(comparison: Comparison, task: Task) -> Iterator[Masks]:
    """Give the mask of the whole object, the same of results in memory and on disk.

    A recording on disk may be larger than memory, so that it is read a block at a time there.
    """
    with comparison.object_by_blocks(task) as inside:
        # All results have its frames and pixels, though some may note their grid in other digits.
        yield {"object": inside.data}


def plan_saving(state: State, folder: str | Path, regions: pd.DataFrame | None = None) -> Plan:
    """Plan to write what a run gave into a folder, with what was measured of it.

    Parameters
    ----------
    state : State
        The session.
    folder : str or Path
        Where to, see `write_outcome`.
    regions : pandas.DataFrame, optional
        The corners of regions that were drawn.

    Raises
    ------
    ValueError
        If there is no result yet.
    """
    outcome = state.needed_outcome()
    known = {"measured.csv": state.measured, "regions.csv": regions}
    tables = {name: table for name, table in known.items() if table is not None and len(table)}

    def work(task: Task) -> list[Path]:
        source = outcome.recipe.recording
        with result_folder(
            folder, outcome.recipe, tables, with_cells=outcome.cells is not None
        ) as kept:
            made_of = source_of(outcome, cancelled=task.cancelled)
            written = write_files(outcome, folder, task, source=made_of)
            for name, table in tables.items():
                rows = table.set_index(table.columns[0])
                written.append(write_table(Path(folder) / name, rows))
            kept.settle(written, source, made_of)
        return written

    return Plan(f"Saving to {folder}", work, lambda _: None)


def folder_without_results(folder: Path, recording: str = "") -> Path:
    """Return a folder, or a new one in it where results of another run would be replaced.

    So too where it holds the frames of the recording, which results would be taken for.
    """
    is_input = bool(recording) and folder.resolve() == Path(recording).resolve()
    if (
        not is_input
        and not any(folder.glob(f"*{OME_TIFF}"))
        and not (folder / "recipe.json").exists()
    ):
        return folder
    names = (folder / f"results_{number}" for number in itertools.count(1))
    return next(name for name in names if not name.exists())
