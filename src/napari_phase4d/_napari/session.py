"""What the dock knows and can do, without Qt.

The dock's buttons and a script that drives an open window use the same session: settings live in
its recipe, `compute_...` methods do the work (in a worker thread or right here), `set_...`
methods take the result and tell whoever listens.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import xarray as xr
from psygnal import Signal

from napari_phase4d.evaluation import Comparison, compare
from napari_phase4d.holography import Lobe, find_lobes, power_spectrum
from napari_phase4d.io import open_recording
from napari_phase4d.pipeline import Recipe, reconstruct_by
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.recording import Recording

__all__ = ["Session"]

#: Frames averaged for the spectrum on screen.
SPECTRUM_FRAMES = 32


class Session:
    """State of one dock: recording, lobes, reconstruction, results and the recipe."""

    recording_changed = Signal()
    lobes_changed = Signal()
    reconstruction_changed = Signal()
    results_added = Signal(object)

    def __init__(self) -> None:
        self.recipe = Recipe()
        self.recording: Recording | None = None
        self.spectrum: xr.DataArray | None = None
        self.reconstruction: xr.Dataset | None = None
        self.comparison: Comparison | None = None

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
        self.recipe = Recipe.model_validate(self.recipe.model_dump() | settings)

    def open(self, path_or_array: Any) -> Recording:
        """Open a recording and take it."""
        recording = open_recording(path_or_array)
        self.set_recording(recording)
        return recording

    def set_recording(self, recording: Recording) -> None:
        """Take a recording; lobes and results of an earlier one are forgotten."""
        recording.frame(0)  # a frame that can't be read is better found now
        self.recording = recording
        self.spectrum = None
        self.reconstruction = None
        self.comparison = None
        times = recording.times_s
        interval = float(times[1] - times[0]) if len(times) > 1 else 1.0
        self.update(
            recording=recording.source,
            optics=recording.optics,
            frame_rate_hz=1 / interval if interval > 0 else None,
            lobes=(),
            boundary=((0, 0),),
        )
        self.recording_changed.emit()

    def compute_lobes(
        self,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> tuple[xr.DataArray, list[Lobe]]:
        """Return the spectrum and the lobes found in it."""
        recording = self.needed_recording()
        spectrum = power_spectrum(
            recording, max_frames=SPECTRUM_FRAMES, progress=progress, cancelled=cancelled
        )
        angles = self.recipe.angles_deg
        if angles is not None and len(angles) != self.recipe.n_views:
            angles = None
        return spectrum, find_lobes(recording, self.recipe.n_views, angles_deg=angles)

    def set_lobes(self, lobes: Sequence[Lobe]) -> None:
        """Take the views."""
        self.update(lobes=tuple(lobes))
        self.lobes_changed.emit()

    def compute_reconstruction(
        self,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> xr.Dataset:
        """Return wrapped phase and amplitude.

        Raises
        ------
        ValueError
            If there is no recording or no lobe yet.
        """
        recording = self.needed_recording()
        self.check_lobes()
        return reconstruct_by(self.recipe, recording, self.lobes, progress, cancelled)

    def set_reconstruction(self, data: xr.Dataset) -> None:
        """Take wrapped phase and amplitude."""
        self.reconstruction = data
        self.comparison = None
        t, a = self.recipe.boundary[0]
        n_times, n_angles = data["phase"].shape[:2]
        if t >= n_times or a >= n_angles:
            self.update(boundary=((0, 0),))
        self.reconstruction_changed.emit()

    def compute_results(
        self,
        progress: ProgressCall | None = None,
        cancelled: CancelledCall | None = None,
    ) -> Comparison:
        """Return the results of the chosen methods.

        Raises
        ------
        ValueError
            If there is no phase yet or no method is chosen.
        """
        data = self.check_reconstruction()
        if not self.recipe.methods:
            msg = "no method is ticked; tick at least one in step 4"
            raise ValueError(msg)
        return compare(
            data["phase"],
            self.recipe.methods,
            self.recipe.boundary,
            mask=self.recipe.mask,
            options=self.recipe.options,
            progress=progress,
            cancelled=cancelled,
        )

    def add_results(self, comparison: Comparison) -> None:
        """Take the results."""
        self.comparison = comparison
        self.results_added.emit(comparison)

    def recalibrate(self, recording: Recording) -> None:
        """Take the same frames with another microscope or frame rate; lobes stay."""
        self.recording = recording
        times = recording.times_s
        rate = 1 / float(times[1] - times[0]) if len(times) > 1 else self.recipe.frame_rate_hz
        self.update(optics=recording.optics, frame_rate_hz=rate)

    def check_lobes(self) -> None:
        """Raise ValueError if there is no lobe to reconstruct."""
        self.needed_recording()
        if not self.lobes:
            msg = "there are no lobes yet; press Find lobes in step 2"
            raise ValueError(msg)

    def check_reconstruction(self) -> xr.Dataset:
        """Return the reconstruction, or raise ValueError if there is none."""
        if self.reconstruction is None:
            msg = "there is no phase yet; press Reconstruct in step 3"
            raise ValueError(msg)
        return self.reconstruction

    def needed_recording(self) -> Recording:
        """Return the recording, or say that there is none."""
        if self.recording is None:
            msg = "there is no recording yet; open one in step 1"
            raise ValueError(msg)
        return self.recording
