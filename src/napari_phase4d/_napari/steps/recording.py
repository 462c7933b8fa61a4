"""Step 1: open a recording and say with which microscope it was made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from magicgui.widgets import ComboBox, FloatSpinBox
from napari.layers import Image
from qtpy.QtWidgets import QFileDialog, QGridLayout

from napari_phase4d._napari.layers import (
    METADATA_KEY,
    is_hologram_layer,
    is_phase_layer,
    recording_of_layer,
    stack_of_layer,
    truth_among,
)
from napari_phase4d._napari.session import Plan
from napari_phase4d._napari.steps.step import Step
from napari_phase4d.io import READABLE_SUFFIXES, open_input
from napari_phase4d.optics import Optics
from napari_phase4d.progress import CancelledCall, ProgressCall
from napari_phase4d.recording import Recording
from napari_phase4d.sample import EUGLENA, Sample, euglena_sample, yeast_sample

__all__ = ["RecordingStep"]


class RecordingStep(Step):
    """Open a file, a folder, the sample, or take a layer."""

    title = "1  Recording"
    purpose = "Open a hologram video, or try a sample. Then check the microscope."

    def build(self) -> None:
        """Make the widgets."""
        self._filling = False
        buttons = QGridLayout()
        self.open_file = self.button(
            "Open file…", "open_file", "A TIFF, NPY or NPZ video, or one image.", self._ask_file
        )
        self.open_folder = self.button(
            "Open folder…",
            "open_folder",
            "A folder of equally large, numbered images.",
            self._ask_folder,
        )
        self.try_sample = self.button(
            "Sample video",
            "try_sample",
            "A simulated hologram video whose phase is known: a euglena, two views, 40 frames.",
            self.open_sample,
        )
        self.try_yeast = self.button(
            "Sample phase",
            "try_yeast",
            "Simulated wrapped phase, exact phase known: a budding yeast, 6 views, 19 times.",
            self.open_yeast,
        )
        buttons.addWidget(self.open_file, 0, 0)
        buttons.addWidget(self.open_folder, 0, 1)
        buttons.addWidget(self.try_sample, 1, 0)
        buttons.addWidget(self.try_yeast, 1, 1)
        self.column.addLayout(buttons)
        self.column.addLayout(self.form)
        self.layer = self.field(
            "or layer",
            ComboBox(
                name="layer",
                choices=lambda _: self.layer_choices(),
                nullable=True,
                tooltip="An image layer that shows holograms (time, y, x), or wrapped phase.",
            ),
        )
        self.layer.changed.connect(lambda chosen: self.guarded(lambda: self._take_layer(chosen)))
        numbers = {
            "wavelength_nm": ("Wavelength (nm)", 632.8, 0.0001, 1e6, 0.1, "Vacuum wavelength."),
            "camera_pixel_um": ("Camera pixel (µm)", 5.2, 0.0001, 1e5, 0.01, "Pixel pitch."),
            "magnification": ("Magnification (×)", 60, 0.0001, 1e7, 0.1, "Sample to camera."),
            "medium_index": ("Medium index", 1.333, 1, 4, 0.001, "Refractive index around it."),
            "frame_rate_hz": ("Frames per second", 1, 1e-6, 1e7, 0.1, "Of the recording."),
        }
        for name, (label, value, low, high, step, tooltip) in numbers.items():
            box = FloatSpinBox(
                name=name, value=value, min=low, max=high, step=step, tooltip=tooltip
            )
            box.native.setDecimals(6 if name == "frame_rate_hz" else 4)
            setattr(self, name, self.field(label, box))
            changed = self._rate_changed if name == "frame_rate_hz" else self._optics_changed
            box.changed.connect(lambda _, changed=changed: self.guarded(changed))
        self.remove_raw = self.button(
            "Remove the uncalibrated layer",
            "remove_raw",
            "Takes the layer that you chose out of the viewer; its frames stay in the new layer.",
            self._remove_raw,
        )
        self.remove_raw.hide()
        self.column.addWidget(self.remove_raw)
        self.facts = self.text("No recording yet.", "recording_facts")
        self.column.addWidget(self.facts)
        self._raw: Any = None
        self.session.recording_changed.connect(self._show)
        self.session.calibration_changed.connect(self._show_facts)
        self.session.reconstruction_changed.connect(self._show_phase)

    def layer_choices(self) -> list[Any]:
        """Return the layers that could be holograms, or are wrapped phase."""
        images = [la for la in self.presenter.viewer.layers if isinstance(la, Image)]
        return [la for la in images if is_hologram_layer(la) or is_phase_layer(la)]

    def open_path(self, path: str | Path, content: str = "auto") -> None:
        """Open a file or folder, in a thread.

        Parameters
        ----------
        path : str or Path
            The file or folder.
        content : str, optional
            "holograms", "phase", or "auto" (default) to look.
        """

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> Recording | xr.DataArray:
            return open_input(path, content=content)

        title = f"Opening {Path(path).name}"
        self.jobs.start(Plan(title, work, self.session.take, cancellable=False))

    def open_sample(self) -> None:
        """Simulate the sample, in a thread."""

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> Sample:
            return euglena_sample()

        self.jobs.start(Plan("Simulating the sample", work, self._take_sample, cancellable=False))

    def open_yeast(self) -> None:
        """Simulate the sample of wrapped phase, in a thread."""

        def work(
            progress: ProgressCall | None = None, cancelled: CancelledCall | None = None
        ) -> xr.Dataset:
            return yeast_sample()

        def receive(data: xr.Dataset) -> None:
            self.session.set_phase(data["wrapped"], data.attrs["boundary"], data["phase"])

        self.jobs.start(Plan("Simulating the sample", work, receive, cancellable=False))

    def _take_sample(self, sample: Sample) -> None:
        self.session.set_recording(
            sample.recording, sample.angles_deg, sample.boundary, sample.truth
        )

    def optics(self) -> Optics:
        """Return the microscope as typed in."""
        return Optics(
            self.wavelength_nm.value / 1000,
            self.camera_pixel_um.value,
            self.magnification.value,
            self.medium_index.value,
        )

    def reset_choices(self) -> None:
        """Look for layers again."""
        with self._own_change():
            self.layer.reset_choices()

    def _ask_file(self) -> None:
        kinds = " ".join(f"*{suffix}" for suffix in READABLE_SUFFIXES)
        filters = {
            f"Hologram video or wrapped phase ({kinds})": "auto",
            f"Hologram video ({kinds}) ": "holograms",
            f"Wrapped phase ({kinds})  ": "phase",
            "All files (*)": "auto",
        }
        path, chosen = QFileDialog.getOpenFileName(self, "Open", "", ";;".join(filters))
        if path:
            self.open_path(path, filters.get(chosen, "auto"))

    def _ask_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Open a folder of images")
        if path:
            self.open_path(path)

    def _take_layer(self, layer: Any) -> None:
        if layer is None or self._filling:
            return
        if self.jobs.running:
            msg = "another job is still running; wait for it or press Cancel"
            raise ValueError(msg)
        if is_phase_layer(layer):
            self._take_phase(layer)
            return
        recording = recording_of_layer(layer)
        if METADATA_KEY in layer.metadata:
            self.presenter.adopt(recording, layer)
        else:
            # Without time, angle and micrometres, its axes don't fit those of the results.
            self._raw = layer
            layer.visible = False
        if layer.metadata.get(METADATA_KEY, {}).get("sample") == EUGLENA:
            self._take_sample(Sample(recording))
        else:
            self.session.set_recording(recording)

    def _take_phase(self, layer: Any) -> None:
        """Take a layer of wrapped phase, with the truth if another layer shows it."""
        phase = stack_of_layer(layer)
        self.presenter.adopt(phase.data, layer)
        truth = truth_among(self.presenter.viewer.layers, phase)
        self.session.set_phase(phase, truth=truth)

    def _remove_raw(self) -> None:
        """Take the user's layer out of the viewer, as asked."""
        if self._raw in self.presenter.viewer.layers:
            self.presenter.viewer.layers.remove(self._raw)
        self._raw = None
        self._show_facts()

    @contextmanager
    def _own_change(self) -> Iterator[None]:
        """Let a change of the widgets not be taken for the user's."""
        self._filling = True
        try:
            yield
        finally:
            self._filling = False

    def _optics_changed(self) -> None:
        """Take the microscope as typed in; frames and lobes stay."""
        if not self._filling and self.session.recording is not None:
            self.session.recalibrate(self.session.recording.calibrated(self.optics()))

    def _rate_changed(self) -> None:
        """Take the frame rate as typed in."""
        if not self._filling and self.session.recording is not None:
            rate = self.frame_rate_hz.value
            self.session.recalibrate(self.session.recording.calibrated(frame_rate_hz=rate))

    def _show(self) -> None:
        """Show the recording's facts and optics."""
        recording = self.session.recording
        for box in (
            self.wavelength_nm,
            self.camera_pixel_um,
            self.magnification,
            self.medium_index,
            self.frame_rate_hz,
        ):
            box.enabled = recording is not None
        if recording is None:
            self.remove_raw.hide()
            with self._own_change():
                self.layer.value = None
            return
        optics = recording.optics
        rate = recording.frame_rate_hz
        with self._own_change():
            for box, value in (
                (self.wavelength_nm, 1000 * optics.wavelength_um),
                (self.camera_pixel_um, optics.camera_pixel_um),
                (self.magnification, optics.magnification),
                (self.medium_index, optics.medium_index),
                (self.frame_rate_hz, rate),
            ):
                if value is not None:
                    box.value = min(max(value, box.min), box.max)
            shown = self.presenter.holograms
            self.layer.value = shown if shown in self.layer.choices else None
        self._show_facts()

    def _show_phase(self) -> None:
        """Say what wrapped phase is being worked on, where there is no recording."""
        if self.session.recording is None:
            phase = self.session.needed_reconstruction()["phase"]
            n_times, n_angles, height, width = phase.shape
            lines = [
                f"<b>{self.session.name}</b>",
                f"Wrapped phase: {n_times} times × {n_angles} views, {width} × {height} pixels. "
                "Go on with step 4.",
                *(f"⚠ {note}" for note in phase.attrs.get("notes", ())),
            ]
            self.facts.setText("<br>".join(lines))

    def _show_facts(self) -> None:
        """Show what the recording is, and what to look after."""
        words = facts_of(self.session.needed_recording())
        raw = self._raw in self.presenter.viewer.layers if self._raw is not None else False
        if raw:
            words += (
                f"<br>⚠ The layer “{self._raw.name}” has no angle, so that the sliders don't fit "
                "together. Its frames are in the new layer."
            )
        self.remove_raw.setVisible(raw)
        self.facts.setText(words)


def facts_of(recording: Recording) -> str:
    """Return what a recording is, in a few lines."""
    height, width = recording.frame_shape
    dtype = recording.holograms.dtype
    first = recording.frame(0)
    lines = [
        f"<b>{recording.name}</b>",
        f"{recording.n_frames} frames of {width} × {height} pixels, {dtype}, "
        f"{recording.nbytes / 2**20:.1f} MB",
        f"pixel in the sample {recording.optics.pixel_um:.4g} µm",
    ]
    if dtype.kind in "iu":
        share = float((first >= np.iinfo(dtype).max).mean())
        if share > 0.001:
            lines.append(f"⚠ {100 * share:.1f} % of the first frame is saturated.")
    lines += [f"⚠ {note}" for note in recording.notes]
    return "<br>".join(lines)
