"""Step 3: reconstruct wrapped phase and amplitude."""

from __future__ import annotations

from magicgui.widgets import CheckBox, ComboBox, LineEdit
from qtpy.QtWidgets import QFileDialog

from napari_phase4d._napari.steps.step import Step
from napari_phase4d.holography import BACKGROUND_ORDERS, WINDOWS

__all__ = ["PhaseStep"]

REFERENCES = {
    "none": None,
    "median over time": "median",
    "first frame": 0,
    "last frame": -1,
    "file…": "file",
}


class PhaseStep(Step):
    """Reference, background, drift, and the Reconstruct button."""

    title = "3  Phase"
    purpose = "Turn every frame into wrapped phase. The settings mostly fit as they are."

    def build(self) -> None:
        """Make the widgets."""
        self.column.addLayout(self.form)
        self.reference = self.field(
            "Reference",
            ComboBox(
                name="reference",
                choices=list(REFERENCES),
                value="none",
                tooltip="What to divide by, so that fixed errors of the optics drop out.",
            ),
        )
        self.reference.changed.connect(lambda _: self.guarded(self._choose_reference))
        self.reference_file = self.field(
            "Its file", LineEdit(name="reference_file", tooltip="Hologram without the object.")
        )
        self.reference_file.native.setReadOnly(True)
        self.form.setRowVisible(self.reference_file.native, False)
        self.background = self.field(
            "Remove",
            ComboBox(
                name="background",
                choices=list(BACKGROUND_ORDERS),
                value="tilt",
                tooltip="What to fit to the empty field and take off, once for all frames.",
            ),
        )
        self.drift = self.field(
            "Drift",
            CheckBox(
                name="drift",
                value=True,
                text="set empty field to 0 in every frame",
                tooltip="Takes off what the interferometer's arms drift against each other.",
            ),
        )
        self.window = self.field(
            "Window",
            ComboBox(
                name="window",
                choices=list(WINDOWS),
                value="smooth-disk",
                tooltip="How a lobe is cut out of the spectrum.",
            ),
        )
        self.go = self.button(
            "Reconstruct",
            "reconstruct",
            "Wrapped phase of all views and frames.",
            self.reconstruct,
        )
        self.column.addWidget(self.go)
        self.facts = self.text("", "phase_facts")
        self.column.addWidget(self.facts)
        self.session.recording_changed.connect(lambda: self.facts.setText(""))
        self.session.reconstruction_changed.connect(self._show)

    def reconstruct(self) -> None:
        """Reconstruct, in a thread."""
        chosen = REFERENCES[self.reference.value]
        self.session.update(
            reference=self.reference_file.value if chosen == "file" else chosen,
            background=self.background.value,
            drift=self.drift.value,
            window=self.window.value,
        )
        self.jobs.start(self.session.plan_reconstruction())

    def _choose_reference(self) -> None:
        """Ask for the file if one is wanted."""
        wants_file = REFERENCES[self.reference.value] == "file"
        if wants_file:
            path, _ = QFileDialog.getOpenFileName(self, "Hologram without the object")
            if not path:
                self.reference.value = "none"
                return
            self.reference_file.value = path
        self.form.setRowVisible(self.reference_file.native, wants_file)

    def _show(self) -> None:
        data = self.session.needed_reconstruction()
        n_times, n_angles, height, width = data["phase"].shape
        lines = [f"{n_times} times × {n_angles} views, {width} × {height} pixels"]
        if data.attrs["drift_removed"] and data.attrs["background_share"] < 0.3:
            lines.append("⚠ Little empty field is in view; check that the background is at 0.")
        self.facts.setText("<br>".join(lines))
