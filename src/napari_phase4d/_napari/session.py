"""What the dock knows and can do, without Qt.

The dock's buttons and a script that drives an open window use the same session. Settings live in
its recipe. Long work is a `Plan`: a snapshot of what it works on, so that it can run in a thread
while the user goes on, and a receiver that drops the result if the recording has changed since.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import xarray as xr
from psygnal import Signal

from napari_phase4d.evaluation import REFERENCE, best_known, itoh_margin
from napari_phase4d.holography import (
    Lobe,
    find_lobes,
    pair_distance,
    power_spectrum,
    recalibrated,
)
from napari_phase4d.io import open_input, open_recording
from napari_phase4d.pipeline import Outcome, Recipe, reconstruct_by, unwrap_by
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.recording import Recording
from napari_phase4d.unwrapping import score_boundaries

__all__ = ["Plan", "Session", "TruthCall"]

#: Gives the exact phase on the grid of a reconstruction; ValueError where it is not known.
TruthCall = Callable[[xr.DataArray], xr.DataArray]

#: Frames averaged for the spectrum on screen.
SPECTRUM_FRAMES = 32
#: Settings that wrapped phase depends on.
PHASE_FIELDS = ("lobes", "reference", "window", "background", "drift")
CHANGED = "the recording or the microscope has changed meanwhile; press the button again"


@dataclass(frozen=True)
class Plan:
    """Work that is ready to run anywhere.

    Parameters
    ----------
    title : str
        What the user sees.
    work : callable
        ``work(progress=None, cancelled=None)``; touches nothing but its own snapshot.
    receive : callable
        Takes the result into the session; to be called in the window's thread.
    cancellable : bool
        Whether the work looks at ``cancelled``; if not, its result is just not waited for.
    gives_way : bool
        Whether it runs unseen and ends as soon as other work is started.
    """

    title: str
    work: Callable[..., Any]
    receive: Callable[[Any], None]
    cancellable: bool = True
    gives_way: bool = False

    def run(self) -> None:
        """Do the work here and now."""
        self.receive(self.work())


class Session:
    """State of one dock: recording, lobes, reconstruction, outcome and the recipe."""

    recording_changed = Signal()
    spectrum_changed = Signal()
    lobes_changed = Signal()
    calibration_changed = Signal()
    reconstruction_changed = Signal()
    outcome_changed = Signal()
    margin_changed = Signal()
    confidence_changed = Signal()
    scores_changed = Signal()

    def __init__(self) -> None:
        self.recipe = Recipe()
        self.recording: Recording | None = None
        self.spectrum: xr.DataArray | None = None
        self.reconstruction: xr.Dataset | None = None
        #: Exact phase on the grid of the reconstruction, where it is known.
        self.truth: xr.DataArray | None = None
        #: The last results, with the recipe that made them.
        self.outcome: Outcome | None = None
        #: How near steps come to the largest that can be unwrapped, see `itoh_margin`.
        self.margin: xr.Dataset | None = None
        #: How far to trust each result, and what to say of whole objects: method id -> it.
        self.confidence: dict[str, xr.DataArray] = {}
        self.warnings: dict[str, str] = {}
        #: How safe each frame is as boundary condition, see `score_boundaries`.
        self.scores: xr.DataArray | None = None
        self._truth_for: TruthCall | None = None
        self._phase_recipe = self.recipe

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

    def update(self, **settings: Any) -> None:
        """Change settings of the recipe.

        Raises
        ------
        ValueError
            If a setting has no such value.
        """
        self.recipe = self.recipe.changed(**settings)

    def open(self, path_or_array: Any) -> None:
        """Open a recording, or a file of wrapped phase, and take it."""
        is_file = isinstance(path_or_array, str | Path)
        self.take(open_input(path_or_array) if is_file else open_recording(path_or_array))

    def take(self, opened: Recording | xr.DataArray) -> None:
        """Take what was opened: a recording or wrapped phase."""
        if isinstance(opened, Recording):
            self.set_recording(opened)
        else:
            self.set_phase(opened)

    def set_recording(
        self,
        recording: Recording,
        angles_deg: Sequence[float] | None = None,
        boundary: tuple[int, int] = (0, 0),
        truth: TruthCall | None = None,
    ) -> None:
        """Take a recording; what belonged to an earlier one is forgotten.

        Parameters
        ----------
        recording : Recording
            The hologram video.
        angles_deg : sequence of float, optional
            Viewing angles, where they are known.
        boundary : tuple of int, optional
            The optically thin frame (time, angle), where it is known.
        truth : callable, optional
            Gives the exact phase on the grid of the wrapped phase, where it is known.
        """
        recording.frame(0)  # a frame that can't be read is better found now
        self.update(
            recording=recording.source,
            dataset=None,
            optics=recording.optics,
            frame_rate_hz=recording.frame_rate_hz,
            lobes=(),
            angles_deg=None if angles_deg is None else tuple(angles_deg),
            reference=None,
            boundary=(boundary,),
        )
        self._begin(recording, truth)

    def set_phase(
        self,
        phase: xr.DataArray,
        boundary: tuple[int, int] | None = None,
        truth: xr.DataArray | None = None,
    ) -> None:
        """Take wrapped phase that has been reconstructed before; all else is forgotten.

        Parameters
        ----------
        phase : xarray.DataArray
            Wrapped phase in radians, dims (time, angle, y, x).
        boundary : tuple of int, optional
            The optically thin frame (time, angle); default: what ``phase.attrs`` say, else (0, 0).
        truth : xarray.DataArray, optional
            Exact phase on the same grid.
        """
        t, a = boundary or phase.attrs.get("boundary", (0, 0))
        self.update(
            recording=str(phase.attrs.get("source", "")),
            dataset=None,
            optics=None,
            lobes=(),
            angles_deg=None,
            frame_rate_hz=None,
            boundary=((int(t), int(a)),),
        )
        self._begin(None, None)
        self.truth = truth
        self.reconstruction = xr.Dataset({"phase": phase})
        self._phase_recipe = self.recipe
        self.reconstruction_changed.emit()

    def _begin(self, recording: Recording | None, truth: TruthCall | None) -> None:
        """Forget what belonged to an earlier recording."""
        self.recording = recording
        self.spectrum = None
        self.reconstruction = None
        self.truth = None
        self._forget_results()
        self._truth_for = truth
        self.recording_changed.emit()

    def recalibrate(self, recording: Recording) -> None:
        """Take the same frames with other optics or times; all else gets the new scale."""
        changes = {"optics": recording.optics, "frame_rate_hz": recording.frame_rate_hz}
        self.update(**changes)
        self.recording = recording
        self._phase_recipe = self._phase_recipe.changed(**changes)
        if self.reconstruction is not None:
            self.reconstruction = recalibrated(self.reconstruction, recording)
        if self.truth is not None:
            self.truth = recalibrated(self.truth, recording)
        if self.outcome is not None:
            results = self.outcome.comparison.results
            self.outcome = Outcome(
                recording,
                self.outcome.recipe.changed(**changes),
                recalibrated(self.outcome.reconstruction, recording),
                replace(
                    self.outcome.comparison,
                    results={m: recalibrated(r, recording) for m, r in results.items()},
                ),
            )
        self.calibration_changed.emit()

    def set_lobes(self, lobes: Sequence[Lobe]) -> None:
        """Take the views."""
        self.update(lobes=tuple(lobes))
        self.lobes_changed.emit()

    def plan_lobes(self) -> Plan:
        """Plan to find the lobes."""
        recording, recipe = self.needed_recording(), self.recipe
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
                return spectrum, find_lobes(
                    recording,
                    recipe.n_views,
                    angles_deg=angles,
                    progress=progress,
                    cancelled=cancelled,
                )
            except ValueError as error:
                # The spectrum is needed all the more, to place the lobes by hand.
                return spectrum, error

        def receive(found: tuple[xr.DataArray, list[Lobe] | ValueError]) -> None:
            self._check_recording(recording)
            self.spectrum, lobes = found
            self.spectrum_changed.emit()
            if isinstance(lobes, ValueError):
                raise lobes
            self.set_lobes(with_known_views(lobes, recipe.lobes))

        return Plan("Finding the lobes", work, receive)

    def plan_spectrum(self) -> Plan:
        """Plan to compute the spectrum alone, until something else is asked for."""
        recording = self.needed_recording()

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> xr.DataArray:
            return power_spectrum(
                recording, max_frames=SPECTRUM_FRAMES, progress=progress, cancelled=cancelled
            )

        def receive(spectrum: xr.DataArray) -> None:
            # Another microscope leaves the frames, and so their spectrum, as they are.
            now = self.recording
            if now is not None and now.holograms.data is recording.holograms.data:
                self.spectrum = spectrum
                self.spectrum_changed.emit()

        return Plan("Computing the spectrum", work, receive, gives_way=True)

    def plan_reconstruction(self) -> Plan:
        """Plan to reconstruct wrapped phase and amplitude.

        Raises
        ------
        ValueError
            If there is no recording or no lobe yet.
        """
        recording, recipe = self.needed_recording(), self.recipe
        truth_for = self._truth_for
        if not recipe.lobes:
            msg = "there are no lobes yet; press Find lobes in step 2"
            raise ValueError(msg)

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> tuple[xr.Dataset, xr.DataArray | None]:
            data = reconstruct_by(recipe, recording, list(recipe.lobes), progress, cancelled)
            return data, known_truth(truth_for, data["phase"])

        def receive(found: tuple[xr.Dataset, xr.DataArray | None]) -> None:
            self._check_recording(recording)
            data, self.truth = found
            self._set_reconstruction(data, recipe)

        return Plan("Reconstructing", work, receive)

    def plan_unwrapping(self) -> Plan:
        """Plan to unwrap with the chosen methods.

        Raises
        ------
        ValueError
            If there is no phase for the present settings, or no method is chosen.
        """
        data = self.needed_reconstruction()
        changed = [
            f for f in PHASE_FIELDS if getattr(self.recipe, f) != getattr(self._phase_recipe, f)
        ]
        if changed and self.recording is not None:
            msg = "the lobes or settings have changed since; press Reconstruct in step 3 again"
            raise ValueError(msg)
        recording, chosen, truth = self.recording, self.recipe, self.truth
        if not chosen.methods:
            msg = "no method is ticked; tick at least one in step 4"
            raise ValueError(msg)
        recipe = self._phase_recipe.changed(
            boundary=chosen.boundary,
            mask=chosen.mask,
            methods=chosen.methods,
            options=chosen.options,
        )

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> Outcome:
            comparison = unwrap_by(
                recipe, data["phase"], truth, progress, cancelled, amplitude=data.get("amplitude")
            )
            return Outcome(recording, recipe, data, comparison)

        def receive(outcome: Outcome) -> None:
            if self.reconstruction is not data:
                raise ValueError(CHANGED)
            self._forget_results()
            self.outcome = outcome
            self.outcome_changed.emit()

        return Plan("Unwrapping", work, receive)

    def plan_margin(self) -> Plan:
        """Plan to see where steps are too large, by the truth or else by the best result.

        Raises
        ------
        ValueError
            If there is neither truth nor a result yet.
        """
        outcome, data = self.outcome, self.reconstruction
        results = {} if outcome is None else outcome.comparison.results
        if not results and self.truth is None:
            self.needed_outcome()
        known, _ = best_known(results, self.truth)

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> xr.Dataset:
            return itoh_margin(known)

        def receive(margin: xr.Dataset) -> None:
            if self.outcome is not outcome or self.reconstruction is not data:
                raise ValueError(CHANGED)
            self.margin = margin
            self.margin_changed.emit()

        return Plan("Measuring the steps", work, receive, cancellable=False)

    def plan_confidence(self) -> Plan:
        """Plan to see how far every result is to be trusted.

        Raises
        ------
        ValueError
            If there is no result yet.
        """
        outcome = self.needed_outcome()

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> tuple[dict[str, xr.DataArray], dict[str, str]]:
            comparison = outcome.comparison
            maps = {m: comparison.confidence(m, progress, cancelled) for m in comparison.results}
            return maps, comparison.warnings()

        def receive(found: tuple[dict[str, xr.DataArray], dict[str, str]]) -> None:
            if self.outcome is not outcome:
                raise ValueError(CHANGED)
            self.confidence, self.warnings = found
            self.confidence_changed.emit()

        return Plan("Weighing the results", work, receive)

    def plan_boundary(self) -> Plan:
        """Plan to find the frame that is safest to start from.

        Raises
        ------
        ValueError
            If there is no phase yet.
        """
        data, outcome = self.needed_reconstruction(), self.outcome
        results = {} if outcome is None else outcome.comparison.results
        reference = results.get(REFERENCE)

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> xr.DataArray:
            return score_boundaries(
                data["phase"], reference, progress=progress, cancelled=cancelled
            )

        def receive(scores: xr.DataArray) -> None:
            if self.reconstruction is not data:
                raise ValueError(CHANGED)
            self.scores = scores
            self.update(boundary=(tuple(scores.attrs["best"]),))
            self.scores_changed.emit()

        return Plan("Scoring the frames", work, receive)

    def _forget_results(self) -> None:
        self.outcome = self.margin = self.scores = None
        self.confidence, self.warnings = {}, {}

    def needed_recording(self) -> Recording:
        """Return the recording, or raise ValueError if there is none."""
        if self.recording is None and self.reconstruction is not None:
            msg = "this is wrapped phase, not a hologram video; go on with step 4"
            raise ValueError(msg)
        if self.recording is None:
            msg = "there is no recording yet; open one in step 1"
            raise ValueError(msg)
        return self.recording

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

    def _set_reconstruction(self, data: xr.Dataset, recipe: Recipe) -> None:
        """Take wrapped phase and amplitude with the recipe that made them."""
        t, a = self.recipe.boundary[0]
        if self.reconstruction is not None:
            a = same_view(self.reconstruction, a, data)
        n_times, n_angles = data["phase"].shape[:2]
        self.update(boundary=((t, a) if t < n_times and a < n_angles else (0, 0),))
        self.reconstruction = data
        self._forget_results()  # what was made of an earlier phase; its layers stay
        self._phase_recipe = recipe
        self.reconstruction_changed.emit()

    def _check_recording(self, recording: Recording) -> None:
        """Refuse a result that belongs to an earlier recording or calibration."""
        if self.recording is not recording:
            raise ValueError(CHANGED)


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


def same_view(old: xr.Dataset, view: int, new: xr.Dataset) -> int:
    """Return the number in a new reconstruction of a view of an old one."""
    carrier = old.attrs["lobes"][view]["carrier"]
    distances = [pair_distance(lobe["carrier"], carrier) for lobe in new.attrs["lobes"]]
    return distances.index(min(distances))
