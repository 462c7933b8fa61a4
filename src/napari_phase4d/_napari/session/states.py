"""How far each of the five steps is."""

from __future__ import annotations

from enum import Enum

from napari_phase4d._napari.session.state import PHASE_FIELDS, State
from napari_phase4d.holography import BACKGROUND_ORDERS

__all__ = ["StepState", "phase_is_stale", "step_states"]


class StepState(Enum):
    """State of one step; the value is the word on screen."""

    TO_DO = "to do"
    READY = "ready"
    DONE = "done"
    DOUBTED = "look"
    STALE = "changed"


def step_states(state: State) -> tuple[StepState, ...]:
    """Return the states of Recording, Lobes, Phase, Unwrap and Compare.

    A step is stale if what it made belongs to other settings than those that are set now, its own
    or those of an earlier step.
    """
    phase, unwrapped = phase_state(state), unwrap_state(state)
    compared = unwrapped if unwrapped in (StepState.DONE, StepState.STALE) else StepState.TO_DO
    opened = state.recording is not None or state.reconstruction is not None
    first = StepState.DONE if opened else StepState.READY
    return first, lobes_state(state), phase, unwrapped, compared


def lobes_state(state: State) -> StepState:
    """Return the state of step 2."""
    if state.recording is None:
        # Wrapped phase has no lobes to look for.
        return StepState.TO_DO if state.reconstruction is None else StepState.DONE
    return StepState.DONE if state.recipe.lobes else StepState.READY


def phase_state(state: State) -> StepState:
    """Return the state of step 3."""
    if state.reconstruction is not None:
        return StepState.STALE if phase_is_stale(state) else StepState.DONE
    return StepState.READY if state.recipe.lobes else StepState.TO_DO


def unwrap_state(state: State) -> StepState:
    """Return the state of step 4."""
    if state.outcome is None:
        waits = state.reconstruction is None or phase_is_stale(state)
        return StepState.TO_DO if waits else StepState.READY
    stale = phase_is_stale(state) or results_are_stale(state)
    return StepState.STALE if stale else StepState.DONE


def phase_is_stale(state: State) -> bool:
    """Say whether the phase was made with other lobes or settings than those set now."""
    if state.recording is None:
        return False
    now, then = state.recipe, state.phase_recipe
    changed = {f for f in PHASE_FIELDS if getattr(now, f) != getattr(then, f)}
    if BACKGROUND_ORDERS[now.background] is not None:  # the order does nothing then
        changed.discard("background_order")
    if now.refocus_um is not None and now.optics != then.optics:
        return True
    return bool(changed)


def start_is_stale(state: State) -> bool:
    """Say whether another frame to start from was chosen since.

    A star that the results themselves have moved makes them no older.
    """
    if state.outcome is None:
        return False
    if state.recipe.boundary == "auto" and state.outcome.scores is not None:
        return False
    return state.start_frames != state.outcome.recipe.boundary


def results_are_stale(state: State) -> bool:
    """Say whether what is ticked now would give other results than those that there are."""
    if state.outcome is None:
        return False
    now, then = state.recipe, state.outcome.recipe
    if now.mask != then.mask or start_is_stale(state):
        return True
    ticked = [m for m in now.methods if m in state.results]
    same = all(now.options.get(m, {}) == then.options.get(m, {}) for m in ticked)
    return not same or len(ticked) < len(now.methods)
