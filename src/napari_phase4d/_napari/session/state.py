"""The state of a session: what is open, its settings, what was made, how far each step is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any

from psygnal import Signal

from napari_phase4d._napari.session.brought import Brought
from napari_phase4d._napari.session.history import Heard, LobeHistory, StepNumber
from napari_phase4d._napari.session.opening import Opened, TruthCall, open_anything
from napari_phase4d._napari.session.recalibrating import (
    changed_views,
    checked_frames,
    moved_frames,
    recalibrate,
)
from napari_phase4d.analysis import REFERENCE, Cells, Comparison
from napari_phase4d.holography import BACKGROUND_ORDERS, Focus, FoundLobes, Lobe, first_seen
from napari_phase4d.io import RawLayout
from napari_phase4d.later import pd, xr
from napari_phase4d.pipeline import (
    PHASE_SETTINGS,
    Outcome,
    Place,
    Recipe,
    find_place,
    lobes_of,
    phase_needs,
)
from napari_phase4d.recording import Recording
from napari_phase4d.stacks import in_all_axes, wavelengths_of
from napari_phase4d.unwrapping import METHODS, best_frame, why_unsuited

__all__ = ["TIME_FIELDS", "Changed", "State", "StepState", "phase_is_stale", "step_states"]

#: Settings that wrapped phase depends on.
PHASE_FIELDS = ("lobes", "reference", *PHASE_SETTINGS)
#: Settings that the time of a run depends on.
TIME_FIELDS = ("methods", "options", "mask")


class Changed(ValueError):  # noqa: N818 - it reports what happened, not a fault
    """A result belongs to what has been changed since."""

    def __init__(self) -> None:
        super().__init__(
            "the recording, the microscope or a result has changed meanwhile; "
            "press the button again"
        )


class State:
    """Recording, lobes, reconstruction, outcome and the recipe, with a signal for each."""

    recording_changed = Signal()
    spectrum_changed = Signal()
    lobes_changed = Signal()
    calibration_changed = Signal()
    reconstruction_changed = Signal()
    #: A method of a run that goes on, what it is called, and its result.
    result_finished = Signal(str, str, object)
    #: What is newest of a recording that is watched: a `LiveView`.
    live_changed = Signal(object)
    outcome_changed = Signal()
    margin_changed = Signal()
    confidence_changed = Signal()
    scores_changed = Signal()
    recipe_changed = Signal()
    truth_changed = Signal()
    noise_changed = Signal()
    estimate_changed = Signal()
    measured_changed = Signal()
    cells_changed = Signal()

    def __init__(self) -> None:
        self.recipe = Recipe()
        self.recording: Recording | None = None
        self.spectrum: xr.DataArray | None = None
        #: Which frames the camera lost, in a sentence; empty if none is known to be.
        self.lost = ""
        #: What was found last, with what is in doubt about it.
        self.found: FoundLobes | None = None
        self.reconstruction: xr.Dataset | None = None
        #: Exact phase on the grid of the reconstruction, where it is known.
        self.truth: xr.DataArray | None = None
        #: The truth that came with the recording or phase, such as that of a sample.
        self.known_truth: xr.DataArray | None = None
        #: The last results, with the recipe that made them.
        self.outcome: Outcome | None = None
        #: How near steps come to the largest that can be unwrapped, see `itoh_margin`.
        self.margin: xr.Dataset | None = None
        #: What that says, and which order suits the object; "" until it was asked for.
        self.steps_words = ""
        #: How far to trust each result, and what to say of whole objects: method id -> it.
        self.confidence: dict[str, xr.DataArray] = {}
        self.warnings: dict[str, str] = {}
        #: Which result to use and how far to trust it, in words; "" until that is known.
        self.verdict = ""
        #: Seconds that these methods will take, about, once it is known.
        self.estimate: tuple[tuple[str, ...], float] | None = None
        #: How the last search for the focus ended, see `autofocus`.
        self.focus: Focus | None = None
        #: How noisy the phase is, see `noise_figures`.
        self.noise: pd.DataFrame | None = None
        #: What was measured last, see `measure`.
        self.measured: pd.DataFrame | None = None
        #: The cells that were found last.
        self.cells: Cells | None = None
        #: How safe each frame is as boundary condition, see `score_boundaries`.
        self.scores: xr.DataArray | None = None
        #: The result of directional L1 that the frames were held against, None if it was none.
        self.scored_by: xr.DataArray | None = None
        self.truth_for: TruthCall | None = None
        #: Where stacks lie that do not fit into memory, None if they do.
        self.place: Place | None = None
        #: The recipe that the present reconstruction was made with.
        self.phase_recipe = self.recipe
        #: What a recipe or a watch has set unseen, which does not hold for the next recording.
        self.brought = Brought()
        self._history = LobeHistory()
        self.heard = Heard()

    @property
    def name(self) -> str:
        """What is being worked on."""
        if self.recording is not None:
            return self.recording.name
        return str(self.needed_reconstruction()["phase"].attrs.get("object", "phase"))

    @property
    def lobes(self) -> list[Lobe]:
        """The views."""
        return list(self.recipe.lobes)

    @property
    def results(self) -> Mapping[str, xr.DataArray]:
        """Unwrapped phase of every method that was run; empty before."""
        return {} if self.outcome is None else self.outcome.comparison.results

    @property
    def start_frames(self) -> tuple[tuple[int, int], ...]:
        """Frames (time, angle) that a run would start from; none while they are looked for."""
        if self.recipe.boundary != "auto":
            return self.recipe.boundary
        return () if self.scores is None else (best_frame(self.scores),)

    @property
    def scores_are_old(self) -> bool:
        """Whether there is a result of directional L1 to hold the frames against by now."""
        reference = self.results.get(REFERENCE)
        return reference is not None and reference is not self.scored_by and self.place is None

    def why_unsuited(self, method: str) -> str:
        """Say why a method makes no sense for the phase that there is; "" where it does."""
        if self.reconstruction is None:
            return why_unsuited(method, None)
        phase = self.reconstruction["phase"]
        return why_unsuited(method, wavelengths_of(phase), phase.shape[:2])

    @property
    def to_run(self) -> tuple[str, ...]:
        """The ticked methods, without those that make no sense for the phase that there is."""
        if self.reconstruction is None:
            return self.recipe.methods
        return tuple(m for m in self.recipe.methods if not self.why_unsuited(m))

    def update(self, **settings: Any) -> None:
        """Change settings of the recipe.

        Raises
        ------
        ValueError
            If a setting has no such value.
        """
        recipe = self.recipe.changed(**settings)
        if (
            recipe.boundary != "auto"
            and "boundary" in settings
            and self.reconstruction is not None
        ):
            shape = self.reconstruction["phase"].shape[:2]
            recipe = recipe.changed(boundary=checked_frames(recipe.boundary, shape))
        if recipe != self.recipe:
            if any(getattr(recipe, f) != getattr(self.recipe, f) for f in TIME_FIELDS):
                self.estimate = None
            self.recipe = recipe
            self.recipe_changed.emit()

    def open(self, source: Any, content: str = "auto", raw: RawLayout | None = None) -> None:
        """Open and take a file, a folder, a recipe, a sample such as "sample:euglena", an array.

        ``raw`` says how the frames of a raw camera file lie in it.

        Raises
        ------
        OSError, TypeError, ValueError
            If it can't be read.
        """
        self.take(open_anything(source, content, raw))

    def take(self, opened: Opened | Recording | xr.DataArray) -> None:
        """Take what was opened: a recording or wrapped phase, with what is known of it."""
        if not isinstance(opened, Opened):
            opened = Opened(opened)
        kind = opened.kind if opened.recipe is None else opened.recipe.content
        if isinstance(opened.content, Recording):
            self.set_recording(
                opened.content,
                opened.angles_deg,
                truth=opened.truth,  # type: ignore[arg-type] # of a recording it is a function
                recipe=opened.recipe,
                kind=kind,
                raw=opened.raw,
            )
        else:
            self.set_phase(
                opened.content,
                truth=opened.truth,  # type: ignore[arg-type] # of phase it is a stack
                recipe=opened.recipe,
                kind=kind,
                outcome=opened.outcome,
            )

    def set_recording(
        self,
        recording: Recording,
        angles_deg: Sequence[float] | None = None,
        boundary: tuple[int, int] | None = None,
        truth: TruthCall | None = None,
        *,
        recipe: Recipe | None = None,
        kind: str = "auto",
        raw: RawLayout | None = None,
    ) -> None:
        """Take a recording; what belonged to an earlier one is forgotten.

        Parameters
        ----------
        recording : Recording
            The hologram video.
        angles_deg : sequence of float, optional
            Viewing angles, where they are known.
        boundary : tuple of int, optional
            The frame (time, angle) to start from; default: the safest one, once it is found.
        truth : callable, optional
            Gives the exact phase on the grid of the wrapped phase, where it is known.
        recipe : Recipe, optional
            Settings to go on with, lobes and thin frame among them.
        kind : str, optional
            What the file was told to hold, see `Recipe.content`.
        raw : RawLayout, optional
            How the frames of a raw file were told to lie in it.
        """
        first_seen(recording)  # a frame that can't be read is better found now
        settings: dict[str, Any] = {
            "recording": recording.source,
            "content": kind,
            "optics": recording.optics,
            "frame_rate_hz": recording.even_rate_hz,  # uneven times are those of the file
        }
        if recipe is None:
            angles = None if angles_deg is None else tuple(angles_deg)
            settings |= {
                "dataset": recording.dataset,
                "raw": raw or recording.raw,
                "lobes": (),
                "angles_deg": angles,
                "wavelengths_um": None,
                "n_views": None if angles is None else len(angles),
                "reference": None,
                "refocus_um": None,
                "boundary": "auto" if boundary is None else (boundary,),
            }
        else:
            settings["lobes"] = tuple(lobes_of(recipe))
        self._begin(recording, truth, self._begun_with(recipe).changed(**settings), recipe)

    def set_phase(
        self,
        phase: xr.DataArray,
        boundary: tuple[int, int] | None = None,
        truth: xr.DataArray | None = None,
        *,
        recipe: Recipe | None = None,
        kind: str = "auto",
        outcome: Outcome | None = None,
    ) -> None:
        """Take wrapped phase that has been reconstructed before; all else is forgotten.

        Parameters
        ----------
        phase : xarray.DataArray
            Wrapped phase in radians, dims among (time, angle, y, x).
        boundary : tuple of int, optional
            The frame (time, angle) to start from; default: what ``phase.attrs`` say, else the
            safest one, once it is found.
        truth : xarray.DataArray, optional
            Exact phase on the same grid.
        recipe : Recipe, optional
            Settings to go on with.
        kind : str, optional
            What the file was told to hold, see `Recipe.content`.
        outcome : Outcome, optional
            What an earlier run has made of it.
        """
        phase = in_all_axes(phase)
        given = boundary or phase.attrs.get("boundary")
        source = str(phase.attrs.get("source", ""))
        settings: dict[str, Any] = {"recording": source, "content": kind, "lobes": ()}
        if recipe is None:
            settings |= {
                "dataset": None,
                "raw": None,
                "optics": None,
                "angles_deg": None,
                "wavelengths_um": None,
                "frame_rate_hz": None,
                "boundary": "auto" if given is None else ((int(given[0]), int(given[1])),),
            }
        new = self._begun_with(recipe).changed(**settings)
        if new.boundary != "auto":
            new = new.changed(boundary=checked_frames(new.boundary, phase.shape[:2]))
        self._begin(None, None, new, recipe)
        if phase.chunks is not None:  # phase on disk may be larger than memory
            modest = [m for m in self.recipe.methods if METHODS[m].streams]
            self.leave_place(find_place(self.recipe, phase_needs(modest, phase.shape)))
        self.truth = self.known_truth = truth
        self.reconstruction = (
            xr.Dataset({"phase": phase}) if outcome is None else outcome.reconstruction
        )
        self.phase_recipe = self.recipe
        self.reconstruction_changed.emit()
        if outcome is not None:
            self.take_outcome(outcome)
            self.outcome_changed.emit()

    def _begun_with(self, recipe: Recipe | None) -> Recipe:
        """Return the settings to begin with; what an earlier recipe has set unseen is gone."""
        return self.brought.without(self.recipe) if recipe is None else recipe

    def _begin(
        self,
        recording: Recording | None,
        truth: TruthCall | None,
        recipe: Recipe,
        given: Recipe | None,
    ) -> None:
        """Forget what was before; what the recipe that was given sets unseen ends with it."""
        self.brought.begin(self.recipe, given)
        self.heard.forget(StepNumber.RECORDING)
        self.recording, self.recipe = recording, recipe
        self.spectrum = self.focus = self.found = None
        self.lost, self.reconstruction = "", None
        self.leave_place()
        self.truth = self.known_truth = None
        self._history.forget()
        self.forget_results()
        self.truth_for = truth
        self.recording_changed.emit()
        self.recipe_changed.emit()

    def leave_place(self, place: Place | None = None) -> None:
        """Let stacks lie elsewhere from now on; those that are shown stay where they are."""
        if self.place is not None:
            self.place.close()
        self.place = place

    def catch_up(self) -> None:
        """Tell all that listen what is known, as if it had just been found."""
        if self.recording is None and self.reconstruction is None:
            return
        known = [self.recording_changed]
        known += [self.spectrum_changed] if self.spectrum is not None else []
        known += [self.lobes_changed] if self.recipe.lobes else []
        if self.reconstruction is not None:
            known += [self.reconstruction_changed, self.truth_changed]
            known += [self.scores_changed] if self.scores is not None else []
            known += [self.noise_changed] if self.noise is not None else []
        if self.outcome is not None:
            known += [self.outcome_changed]
            known += [self.confidence_changed] if self.confidence else []
            known += [self.measured_changed] if self.measured is not None else []
            known += [self.cells_changed] if self.cells is not None else []
        for signal in (*known, self.recipe_changed):
            signal.emit()

    def part(self) -> None:
        """Let nobody listen any more."""
        for name, kind in vars(State).items():
            if isinstance(kind, Signal):
                getattr(self, name).disconnect()

    def forget_results(self) -> None:
        """Forget what was made of the phase."""
        self.scores = self.scored_by = self.noise = self.estimate = None
        self.take_outcome(None)

    def take_outcome(self, outcome: Outcome | None) -> None:
        """Take results, and forget what was made of others."""
        self.outcome, self.margin, self.measured, self.cells = outcome, None, None, None
        self.confidence, self.warnings, self.verdict, self.steps_words = {}, {}, "", ""
        self.heard.forget(StepNumber.PHASE if outcome is None else StepNumber.UNWRAP)

    def take_finished(
        self, data: xr.Dataset, method: str, name: str, result: xr.DataArray
    ) -> None:
        """Tell of a method that has ended while others run on, if its phase is still wanted."""
        if self.reconstruction is data:
            self.result_finished.emit(method, name, result)

    def recalibrate(self, recording: Recording) -> None:
        """Take the same frames with other optics or times; all else gets the new scale."""
        recalibrate(self, recording)
        self.calibration_changed.emit()

    def set_truth(self, truth: xr.DataArray | None) -> None:
        """Count errors against exact phase, None to count none.

        Raises
        ------
        ValueError
            If it has another shape than the phase.
        """
        comparison = None if self.outcome is None else self.outcome.comparison.against(truth)
        self.take_truth(truth, comparison)

    def take_truth(self, truth: xr.DataArray | None, judged: Comparison | None) -> None:
        """Take exact phase, and the comparison whose errors are counted against it."""
        if self.outcome is not None and judged is not None:
            self.outcome = replace(self.outcome, comparison=judged, truth=truth)
        self.truth = truth
        self.truth_changed.emit()

    def set_lobes(self, lobes: Sequence[Lobe], *, undoable: bool = True) -> None:
        """Take the views.

        Parameters
        ----------
        lobes : sequence of Lobe
            One a view.
        undoable : bool, optional
            Whether `undo_lobes` comes back to what was before; False while the mouse moves.
        """
        if undoable:
            self.remember_lobes()
        self.update(**changed_views(self.recipe, lobes))
        self.lobes_changed.emit()

    def remember_lobes(self) -> None:
        """Let `undo_lobes` come back to the lobes as they are now."""
        self._history.remember(self.recipe.lobes)

    def undo_lobes(self) -> None:
        """Take back the last change of the lobes.

        Raises
        ------
        ValueError
            If there is nothing to take back.
        """
        self.set_lobes(self._history.back_from(self.recipe.lobes), undoable=False)

    def set_reconstruction(self, data: xr.Dataset, recipe: Recipe) -> None:
        """Take wrapped phase and amplitude with the recipe that made them."""
        chosen = self.recipe.boundary
        kept = () if chosen == "auto" else moved_frames(chosen, self.reconstruction, data)
        self.reconstruction = data
        self.forget_results()  # what was made of an earlier phase; its layers stay
        self.phase_recipe = recipe
        self.update(boundary=kept or "auto")
        self.reconstruction_changed.emit()

    def check_is(self, recording: Recording) -> None:
        """Refuse a result that belongs to an earlier recording or calibration."""
        if self.recording is not recording:
            raise Changed

    def check_phase(self, data: xr.Dataset | None) -> None:
        """Refuse a result that belongs to an earlier reconstruction or calibration."""
        if self.reconstruction is not data:
            raise Changed

    def needed_recording(self) -> Recording:
        """Return the recording, or raise ValueError if there is none."""
        if self.recording is None and self.reconstruction is not None:
            msg = "this is wrapped phase, not a hologram video; go on with step 4"
            raise ValueError(msg)
        if self.recording is None:
            msg = "there is no recording yet; open one in step 1"
            raise ValueError(msg)
        return self.recording

    def needed_lobes(self) -> list[Lobe]:
        """Return the views, or raise ValueError if there are none."""
        if not self.recipe.lobes:
            msg = "there are no lobes yet; press Find in step 2"
            raise ValueError(msg)
        return self.lobes

    def needed_reconstruction(self) -> xr.Dataset:
        """Return the reconstruction, or raise ValueError if there is none."""
        if self.reconstruction is None:
            msg = "there is no phase yet; press Reconstruct in step 3"
            raise ValueError(msg)
        return self.reconstruction

    def needed_outcome(self) -> Outcome:
        """Return the last results, or raise ValueError if there are none."""
        if self.outcome is None:
            msg = "there are no results yet; press Run in step 4"
            raise ValueError(msg)
        return self.outcome


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
    ticked = [m for m in state.to_run if m in state.results]
    same = all(now.options.get(m, {}) == then.options.get(m, {}) for m in ticked)
    return not same or len(ticked) < len(state.to_run)
