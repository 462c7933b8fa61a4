"""Step 3: reconstruct wrapped phase and amplitude."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from magicgui.widgets import CheckBox, ComboBox
from qtpy.QtWidgets import QFileDialog

from napari_phase4d._napari.session import plan_reconstruction
from napari_phase4d._napari.steps.step import Step
from napari_phase4d.holography import BACKGROUND_ORDERS, WINDOWS
from napari_phase4d.pipeline import needed_bytes

__all__ = ["PhaseStep"]

FILE = "hologram in a file"
REFERENCES: dict[str, int | str | None] = {
    "none": None,
    "median over time": "median",
    "first frame": 0,
    "last frame": -1,
}


class PhaseStep(Step):
    """Reference, background, drift, and the Reconstruct button."""

    title = "3  Phase"
    purpose = (
        "Turn every frame into wrapped phase: press Reconstruct. The settings mostly fit as they "
        "are."
    )

    def build(self) -> None:
        """Make the widgets."""
        self._reference_file = ""
        self.column.addLayout(self.form)
        self.reference = self.field(
            "Reference",
            ComboBox(
                name="reference",
                choices=[*REFERENCES, FILE],
                value="none",
                tooltip="What to divide by, so that fixed errors of the optics drop out.",
            ),
        )
        self.choose_file = self.button(
            "Choose the file…",
            "choose_reference",
            "A hologram of the same microscope without the object.",
            self._ask_file,
        )
        self.form.addRow("", self.choose_file)
        self.background = self.field(
            "Remove",
            ComboBox(
                name="background",
                choices=list(BACKGROUND_ORDERS),
                value=self.session.recipe.background,
                tooltip="What to fit to the empty field and take off, once for all frames.",
            ),
        )
        self.drift = self.field(
            "Drift",
            CheckBox(
                name="drift",
                value=self.session.recipe.drift,
                text="set empty field to 0 in every frame",
                tooltip="Takes off what the interferometer's arms drift against each other.",
            ),
        )
        self.window = self.field(
            "Window",
            ComboBox(
                name="window",
                choices=list(WINDOWS),
                value=self.session.recipe.window,
                tooltip="How a lobe is cut out of the spectrum.",
            ),
        )
        for widget in (self.reference, self.background, self.drift, self.window):
            self.when_changed(widget, self._settings_changed)
        self.go = self.button(
            "Reconstruct",
            "reconstruct",
            "Wrapped phase of all views and frames.",
            self.reconstruct,
        )
        self.column.addWidget(self.go)
        self.facts = self.text("", "phase_facts")
        self.column.addWidget(self.facts)
        self._show_settings()
        self.session.recording_changed.connect(self._new_recording)
        self.session.recipe_changed.connect(self._show_settings)
        self.session.lobes_changed.connect(self._show_need)
        self.session.reconstruction_changed.connect(self._show)

    def reconstruct(self) -> None:
        """Reconstruct, in a thread."""
        if self.reference.value == FILE and not self._reference_file:
            msg = "choose the file with the reference hologram first"
            raise ValueError(msg)
        self.jobs.start(plan_reconstruction(self.session))

    def take_reference(self, path: str | Path) -> None:
        """Divide by a hologram without the object."""
        self._reference_file = str(path)
        self.session.update(reference=self._reference_file)

    def _settings_changed(self) -> None:
        """Put the widgets' values into the recipe."""
        chosen = self.reference.value
        self.form.setRowVisible(self.choose_file, chosen == FILE)
        known = REFERENCES | {FILE: self._reference_file or None}
        # A frame that only a recipe names stays as it is.
        reference = known.get(chosen, self.session.recipe.reference)
        self.session.update(
            reference=reference,
            background=self.background.value,
            drift=self.drift.value,
            window=self.window.value,
        )

    def _show_settings(self) -> None:
        """Show what the recipe says."""
        recipe = self.session.recipe
        named = next((name for name, r in REFERENCES.items() if r == recipe.reference), None)
        with self.own_change():
            self.background.value = recipe.background
            self.drift.value = recipe.drift
            self.window.value = recipe.window
            if named is None and isinstance(recipe.reference, int):
                named = f"frame {recipe.reference}"
                self.reference.choices = [*REFERENCES, FILE, named]
            elif named is None:
                self._reference_file = str(recipe.reference)
                self.choose_file.setText(Path(self._reference_file).name)
            # "File" with none chosen yet is no reference so far.
            waiting = self.reference.value == FILE and recipe.reference is None
            if not waiting:
                self.reference.value = named or FILE
        self.form.setRowVisible(self.choose_file, self.reference.value == FILE)

    def _new_recording(self) -> None:
        """Forget the reference of the last recording."""
        if self.session.recipe.reference is None:
            self._reference_file = ""
            self.choose_file.setText("Choose the file…")
            with self.own_change():
                self.reference.value = "none"
        self.facts.setText("")
        self._show_settings()

    def _ask_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "Hologram without the object")
        if path:
            self.take_reference(path)

    def showEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        """Say what the next steps need when the step is opened."""
        super().showEvent(event)
        if self.session.reconstruction is None:
            self._show_need()

    def _show_need(self) -> None:
        """Say how much memory the next steps will take."""
        recording, lobes = self.session.recording, self.session.lobes
        if recording is not None and lobes and self.isVisible():
            need = needed_bytes(recording, lobes, self.session.recipe.methods) / 2**20
            self.facts.setText(
                f"Reconstructing, and unwrapping by the ticked methods, takes about {need:.0f} MB."
            )

    def _show(self) -> None:
        data = self.session.needed_reconstruction()
        n_times, n_angles, height, width = data["phase"].shape
        lines = [f"{n_times} times × {n_angles} views, {width} × {height} pixels"]
        if data.attrs.get("drift_removed") and data.attrs["background_share"] < 0.3:
            lines.append("⚠ Little empty field is in view; check that the background is at 0.")
        angles = data["angle"].values
        if n_angles > 2 and not np.allclose(np.diff(angles), angles[1] - angles[0]):
            listed = ", ".join(f"{a:g}°" for a in angles)
            lines.append(f"⚠ Angles are uneven; the slider counts evenly. They are {listed}.")
        self.facts.setText("<br>".join(lines))
