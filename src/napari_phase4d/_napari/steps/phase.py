"""Step 3: reconstruct wrapped phase and amplitude."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from magicgui.widgets import CheckBox, ComboBox, FloatSpinBox, SpinBox
from qtpy.QtWidgets import QFileDialog

from napari_phase4d._napari.session import plan_focus, plan_reconstruction
from napari_phase4d._napari.steps.step import (
    Step,
    doubts_of_reconstruction,
    facts_of_reconstruction,
    focus_in_words,
)
from napari_phase4d.holography import BACKGROUND_ORDERS, MAX_ORDER, MIN_ORDER, WINDOWS
from napari_phase4d.pipeline import needed_bytes
from napari_phase4d.words import size_in_words

__all__ = ["PhaseStep"]

FILE = "hologram in a file"
#: What the box of the distance holds where a recipe says to find the focus.
FIND_IT = -100_000.0
#: Distances are shown to a hundredth of a micrometre.
SHOWN_UM = 0.00501
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
        #: A frame that a recipe names as the reference: what it is called, and its number.
        self._named_frame: dict[str, int] = {}
        self.column.addLayout(self.form)
        self._build_reference()
        self._build_background()
        self._build_refocus()
        self._build_drift_and_window()
        for widget in (
            self.reference,
            self.background,
            self.order,
            self.refocus,
            self.drift,
            self.tilt,
            self.window,
        ):
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
        self.session.calibration_changed.connect(self._show_made)
        self.session.noise_changed.connect(self._show_made)

    def _build_reference(self) -> None:
        """Make what fields are divided by, and the button that asks for a file."""
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

    def _build_drift_and_window(self) -> None:
        """Make the ticks for drift and tilt, and how a lobe is cut out."""
        self.drift = self.field(
            "Drift",
            CheckBox(
                name="drift",
                value=self.session.recipe.drift,
                text="set empty field to 0 in every frame",
                tooltip="Takes off what the interferometer's arms drift against each other.",
            ),
        )
        self.tilt = self.field(
            "Tilt",
            CheckBox(
                name="tilt_per_frame",
                value=self.session.recipe.tilt_per_frame,
                text="take a tilt off every frame",
                tooltip="For arms that tilt against each other during the recording: fitted to "
                "the empty field of each frame.",
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

    def _build_background(self) -> None:
        """Make what is removed from the background: how, and up to which degree."""
        self.background = self.watched(
            ComboBox(
                name="background",
                choices=list(BACKGROUND_ORDERS),
                value=self.session.recipe.background,
                tooltip="What to fit to the empty field and take off, once for all frames. "
                "Polynomial and zernike take off all aberrations up to an order.",
            )
        )
        self.order = self.watched(
            SpinBox(
                name="background_order",
                value=self.session.recipe.background_order,
                min=MIN_ORDER,
                max=MAX_ORDER,
                tooltip="Highest order: 2 astigmatism and defocus, 3 coma, 4 spherical "
                "aberration, no unit.",
            )
        )
        self.order_label = self.label("order")
        row = self.row(self.background.native, self.order_label, self.order.native)
        row.setStretch(0, 1)
        self.form.addRow("Remove", row)
        self.form.labelForField(row).setToolTip(self.background.tooltip)

    def _build_refocus(self) -> None:
        """Make the distance to refocus by, and the button that finds it."""
        self.refocus = self.watched(
            FloatSpinBox(
                name="refocus_um",
                value=0,
                min=FIND_IT,
                max=-FIND_IT,
                step=0.5,
                tooltip="How far to refocus, in micrometres in the medium; positive along the "
                "light, 0 for not at all.",
            )
        )
        native = self.refocus.native
        native.setDecimals(2)
        native.setSuffix(" µm")
        native.setSpecialValueText("to the focus")  # a recipe may say "auto"
        self.find_focus = self.button(
            "Auto",
            "find_focus",
            "Find the distance at which the object is sharp.",
            self.look_for_focus,
        )
        row = self.row(native, self.find_focus)
        row.setStretch(0, 1)
        self.form.addRow("Refocus", row)
        self.form.labelForField(row).setToolTip(self.refocus.tooltip)

    def look_for_focus(self) -> None:
        """Find the distance to refocus by, in a thread."""
        self.jobs.start(plan_focus(self.session), self._tell_focus)

    def _tell_focus(self) -> None:
        """Say where the focus was found."""
        if self.session.focus is not None:
            self.said.emit(focus_in_words(self.session.focus))

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
        known = REFERENCES | self._named_frame | {FILE: self._reference_file or None}
        self.session.update(
            reference=known[chosen],
            background=self.background.value,
            background_order=self.order.value,
            refocus_um=self._distance(),
            drift=self.drift.value,
            tilt_per_frame=self.tilt.value,
            window=self.window.value,
        )

    def _distance(self) -> float | str | None:
        """Return the distance to refocus by; one with more digits than are shown stays."""
        known = self.session.recipe.refocus_um
        same = abs(self.refocus.value - shown_distance(known)) < SHOWN_UM
        return known if same else distance_of(self.refocus.value)

    def _show_settings(self) -> None:
        """Show what the recipe says."""
        recipe = self.session.recipe
        named = next((name for name, r in REFERENCES.items() if r == recipe.reference), None)
        with self.own_change():
            self.background.value = recipe.background
            self.order.value = recipe.background_order
            self.refocus.value = shown_distance(recipe.refocus_um)
            self.drift.value = recipe.drift
            self.tilt.value = recipe.tilt_per_frame
            self.window.value = recipe.window
            if named is None and isinstance(recipe.reference, int):
                named = f"frame {recipe.reference}"
                self._offer({named: recipe.reference})
            elif named is None:
                self._reference_file = str(recipe.reference)
                self.choose_file.setText(Path(self._reference_file).name)
            # "File" with none chosen yet is no reference so far.
            waiting = self.reference.value == FILE and recipe.reference is None
            if not waiting:
                self.reference.value = named or FILE
        self.form.setRowVisible(self.choose_file, self.reference.value == FILE)
        asks = BACKGROUND_ORDERS[recipe.background] is None
        self.order_label.setVisible(asks)
        self.order.native.setVisible(asks)

    def _offer(self, named_frame: dict[str, int]) -> None:
        """Offer a frame as the reference that only a recipe names, or no such frame."""
        self._named_frame = named_frame
        self.reference.choices = [*REFERENCES, FILE, *named_frame]

    def _new_recording(self) -> None:
        """Forget the reference of the last recording."""
        with self.own_change():
            self._offer({})
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

    def doubts(self) -> Sequence[str]:
        """Return what is to be looked after in the phase."""
        data = self.session.reconstruction
        if self.session.recording is None or data is None:
            return ()
        return doubts_of_reconstruction(data)

    def _show_need(self) -> None:
        """Say how much memory the next steps will take."""
        recording, lobes = self.session.recording, self.session.lobes
        if recording is not None and lobes and self.isVisible():
            need = size_in_words(needed_bytes(recording, lobes, self.session.recipe.methods))
            self.facts.setText(
                f"Reconstructing, and unwrapping by the ticked methods, takes about {need}."
            )

    def _show_made(self) -> None:
        """Renew what is said of the phase, if there is any from holograms."""
        if self.session.recording is not None and self.session.reconstruction is not None:
            self._show()

    def _show(self) -> None:
        """Say what was reconstructed, and how noisy it is."""
        data = self.session.needed_reconstruction()
        lines = facts_of_reconstruction(data, self.session.noise)
        self.facts.setText("<br>".join(lines))


def distance_of(value: float) -> float | str | None:
    """Return the distance of a recipe for what the box shows."""
    if value <= FIND_IT:
        return "auto"
    return value or None


def shown_distance(distance_um: float | str | None) -> float:
    """Return what the box shows for the distance of a recipe."""
    if isinstance(distance_um, str):
        return FIND_IT
    return min(max(distance_um or 0.0, FIND_IT), -FIND_IT)
