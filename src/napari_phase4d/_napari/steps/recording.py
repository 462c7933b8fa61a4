"""Step 1: open a recording and say with which microscope it was made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from magicgui.widgets import ComboBox, FloatSpinBox
from napari.layers import Image
from qtpy.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QFormLayout,
    QInputDialog,
    QLabel,
    QSpinBox,
    QWidget,
)

from napari_phase4d._napari.preferences import in_micrometres, remember_optics, with_own_optics
from napari_phase4d._napari.session import Opened, plan_opening
from napari_phase4d._napari.steps.live import LivePart
from napari_phase4d._napari.steps.step import (
    Seen,
    Step,
    doubts_of_recording,
    facts_of_phase,
    facts_of_recording,
)
from napari_phase4d._napari.viewing.layers import (
    METADATA_KEY,
    is_hologram_layer,
    is_phase_layer,
    recalibrate_layer,
    recipe_of_layer,
    recording_of_layer,
    stack_of_layer,
    truth_among,
)
from napari_phase4d.io import READABLE_SUFFIXES, RawLayout, address_of, needs_layout
from napari_phase4d.io.raw import KINDS
from napari_phase4d.io.video import LARGEST_SIDE
from napari_phase4d.optics import Optics
from napari_phase4d.recording import Recording
from napari_phase4d.sample import (
    CELLS_SOURCE,
    EUGLENA_SOURCE,
    RECORDINGS,
    SAMPLES,
    YEAST_SOURCE,
    Sample,
)

__all__ = ["RawDialog", "RecordingStep"]

WELCOME = (
    "Phase 4D turns a video of off-axis holograms into unwrapped phase over time and viewing "
    "angle. Open a recording, or try the sample to see how it goes."
)
#: name: label, value, lowest, highest, step, decimals, tooltip
NUMBERS: dict[str, tuple[str, float, float, float, float, int, str]] = {
    "wavelength_nm": (
        "Wavelength (nm)", 632.8, 0.0001, 1e6, 0.1, 4, "Of the laser in vacuum, in nanometres.",
    ),
    "camera_pixel_um": (
        "Camera pixel (µm)", 5.2, 0.0001, 1e5, 0.01, 4,
        "From the middle of one pixel of the camera to the next, in micrometres.",
    ),
    "magnification": (
        "Magnification (×)", 60, 0.0001, 1e7, 0.1, 4, "From the sample to the camera.",
    ),
    "medium_index": (
        "Medium index", 1.333, 1, 4, 0.001, 4,
        "Refractive index round the object: water 1.333, no unit.",
    ),
    "frame_rate_hz": (
        "Frames per second", 1, 1e-6, 1e7, 0.1, 6, "Of the recording, in 1/s.",
    ),
}  # fmt: skip


class RecordingStep(Step):
    """Open a file, a folder, the sample, or take a layer."""

    title = "1  Recording"
    purpose = WELCOME

    def build(self) -> None:
        """Make the widgets."""
        self._raw: Any = None
        self._layout: RawLayout | None = None
        self._looked_at: tuple[Any, Seen] = (None, Seen(0.0, 0.0))
        self._build_buttons()
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
        self.layer.changed.connect(lambda chosen: self.guarded(lambda: self._choose_layer(chosen)))
        self._build_optics()
        self.remove_raw = self.button(
            "Remove the uncalibrated layer",
            "remove_raw",
            "Takes the layer that you chose out of the viewer; its frames stay in the new layer.",
            self._remove_raw,
        )
        self.remove_raw.hide()
        self.column.addWidget(self.remove_raw)
        self.facts = self.text("", "recording_facts")
        self.column.addWidget(self.facts)
        self.session.recording_changed.connect(self._new_recording)
        self.session.spectrum_changed.connect(self._show)
        self.session.calibration_changed.connect(self._show)
        self.presenter.holograms_came.connect(self._show)
        self.session.reconstruction_changed.connect(self._show_phase)
        self._show()

    def _build_buttons(self) -> None:
        self.open_file = self.button(
            "Open a recording…",
            "open_file",
            "A hologram video, one image, wrapped phase, or a recipe that was saved before. "
            "A file dropped on this dock is opened too.",
            self._ask_file,
        )
        self.open_folder = self.button(
            "Open folder…",
            "open_folder",
            "A folder of equally large, numbered images; or of results that were saved before.",
            self._ask_folder,
        )
        self.open_address = self.button(
            "Address…",
            "open_address",
            "A Zarr or OME-Zarr store on a server: https://…, http://… or s3://…; frames are "
            "fetched as they are looked at.",
            self._ask_address,
        )
        self.try_sample = self.button(
            "Try the sample",
            "try_sample",
            "A simulated hologram video whose phase is known: a euglena, two views, 40 frames.",
            lambda: self.open_path(EUGLENA_SOURCE),
        )
        self.try_yeast = self.button(
            "Sample phase",
            "try_yeast",
            "Simulated wrapped phase, exact phase known: a budding yeast, 6 views, 19 times.",
            lambda: self.open_path(YEAST_SOURCE),
        )
        self.live = LivePart(self.session, self.jobs, self.presenter)
        self.live.failed.connect(self.failed)
        self.column.addLayout(self.row(self.open_file, self.open_folder))
        self.column.addLayout(self.row(self.open_address, self.live.begin))
        self.column.addWidget(self.live)
        self.try_cells = self.button(
            "Sample cells",
            "try_cells",
            "A simulated hologram video of several cells whose masses are known: they swim, "
            "touch, divide, leave and come in. For the tab Cells of step 5.",
            lambda: self.open_path(CELLS_SOURCE),
        )
        self.column.addLayout(self.row(self.try_sample, self.try_cells, self.try_yeast))

    def _build_optics(self) -> None:
        self.numbers: dict[str, FloatSpinBox] = {}
        for name, (label, value, low, high, step, decimals, tooltip) in NUMBERS.items():
            box = FloatSpinBox(
                name=name, value=value, min=low, max=high, step=step, tooltip=tooltip
            )
            box.native.setDecimals(decimals)
            self.numbers[name] = self.field(label, box)
            if name == "frame_rate_hz":
                self.when_changed(box, self._rate_changed)
            else:
                self.when_changed(box, partial(self._optics_changed, name))
        self.remember = self.button(
            "This is my microscope",
            "remember_optics",
            "Keep these four numbers in napari's preferences, for recordings that don't say them.",
            self._remember,
        )
        self.form.addRow("", self.remember)

    def layer_choices(self) -> list[Any]:
        """Return the layers that could be holograms, or are wrapped phase."""
        images = [la for la in self.presenter.viewer.layers if isinstance(la, Image)]
        return [la for la in images if is_hologram_layer(la) or is_phase_layer(la)]

    def open_path(self, path: str | Path, content: str = "auto") -> None:
        """Open a file, a folder, a recipe or a sample, in a thread.

        Parameters
        ----------
        path : str or Path
            The file or folder, or "sample:euglena", "sample:cells", "sample:yeast".
        content : str, optional
            "holograms", "phase", or "auto" (default) to look.
        """
        raw = None
        if needs_layout(Path(path)):
            raw = self._ask_layout(Path(path))
            if raw is None:
                return
        sample = str(path) in SAMPLES
        title = "Simulating the sample" if sample else f"Opening {Path(path).name}"
        plan = plan_opening(self.session, path, content, title, raw)
        self.jobs.start(replace(plan, receive=self._take_opened))

    def _take_opened(self, opened: Opened) -> None:
        """Take what was opened; a microscope that had to be assumed is the user's own."""
        if isinstance(opened.content, Recording) and opened.recipe is None:
            opened = replace(opened, content=with_own_optics(opened.content))
        self.session.take(opened)

    def optics(self) -> Optics:
        """Return the microscope as typed in."""
        return Optics(
            in_micrometres(self.numbers["wavelength_nm"].value),
            self.numbers["camera_pixel_um"].value,
            self.numbers["magnification"].value,
            self.numbers["medium_index"].value,
        )

    def reset_choices(self) -> None:
        """Look for layers again, and say that one may be taken while there is nothing else."""
        before = list(self.layer.choices)
        self.look_again(self.layer)
        session = self.session
        new = [la for la in self.layer.choices if la is not None and la not in before]
        if new and session.recording is None and session.reconstruction is None:
            self.said.emit(f"To work on “{new[-1].name}”, choose it as the layer in step 1.")

    def _ask_file(self) -> None:
        kinds = " ".join(f"*{suffix}" for suffix in READABLE_SUFFIXES)
        filters = {
            f"Hologram video, wrapped phase or recipe ({kinds} *.json)": "auto",
            f"Hologram video ({kinds}) ": "holograms",
            f"Wrapped phase ({kinds})  ": "phase",
            "All files (*)": "auto",
        }
        path, chosen = QFileDialog.getOpenFileName(self, "Open", "", ";;".join(filters))
        if path:
            self.open_path(path, filters.get(chosen, "auto"))

    def _ask_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Open images, Zarr, Koala or results")
        if path:
            self.open_path(path)

    def _ask_address(self) -> None:
        words = "Address of a Zarr store (https://…, s3://…):"
        text, wanted = QInputDialog.getText(self, "Open address", words)
        if not wanted:
            return
        if address_of(text.strip()) is None:
            msg = "an address begins with https://, http:// or s3://"
            raise ValueError(msg)
        self.open_path(text.strip())

    def _ask_layout(self, path: Path) -> RawLayout | None:
        """Ask how frames lie in a raw file; None if the user thinks better of it."""
        dialog = RawDialog(path, self._layout, self)
        if not dialog.exec():
            return None
        self._layout = dialog.layout_of_frames()
        return self._layout

    def _remember(self) -> None:
        remember_optics(self.optics())
        self.said.emit("Kept in File > Preferences, page Phase 4D.")

    def _choose_layer(self, layer: Any) -> None:
        """Take a layer; one that is refused is not shown as chosen, so that it can be again."""
        try:
            self._take_layer(layer)
        except Exception:
            self._show_layer()
            raise

    def _show_layer(self) -> None:
        """Show which layer is worked on."""
        shown = None if self.session.recording is None else self.presenter.holograms
        with self.own_change():
            self.layer.value = shown if shown in self.layer.choices else None

    def _take_layer(self, layer: Any) -> None:
        if layer is None or self.filling:
            return
        if self.jobs.running:
            msg = "another job is still running; wait for it or press Cancel"
            raise ValueError(msg)
        if is_phase_layer(layer):
            self._take_phase(layer)
            return
        noted = recording_of_layer(layer)
        recording = with_own_optics(noted)
        own = METADATA_KEY in layer.metadata
        if own:
            recalibrate_layer(layer, recording, noted.optics.pixel_um)
            self.presenter.adopt(recording, layer)
        recipe = recipe_of_layer(layer)
        if recipe is not None:
            self.session.take(Opened(recording, recipe=recipe))
        elif (name := layer.metadata.get(METADATA_KEY, {}).get("sample")) in RECORDINGS:
            sample = Sample(recording, RECORDINGS[name])
            opened = Opened(recording, sample.angles_deg, sample.truth)
            self.session.take(opened)
        else:
            self.session.set_recording(recording)
        if not own:
            # Without time, angle and micrometres, its axes don't fit those of the results.
            self._raw = layer
            layer.visible = False
            self._show()

    def _take_phase(self, layer: Any) -> None:
        """Take a layer of wrapped phase, with the truth if another layer shows it."""
        phase = stack_of_layer(layer)
        self.presenter.adopt(phase.data, layer)
        truth = truth_among(self.presenter.viewer.layers, phase)
        self.session.set_phase(phase, truth=truth, recipe=recipe_of_layer(layer))

    def _remove_raw(self) -> None:
        """Take the user's layer out of the viewer, as asked."""
        if self._raw in self.presenter.viewer.layers:
            self.presenter.viewer.layers.remove(self._raw)
        self._raw = None
        self._show()

    def _new_recording(self) -> None:
        self._raw = None
        self._show()

    def _optics_changed(self, name: str) -> None:
        """Take one number of the microscope as typed in; frames and lobes stay."""
        recording = self.session.recording
        if recording is None:
            return
        value = self.numbers[name].value
        field, value = (
            ("wavelength_um", in_micrometres(value)) if name == "wavelength_nm" else (name, value)
        )
        optics = replace(recording.optics, **{field: value})
        self.session.recalibrate(recording.calibrated(optics))

    def _rate_changed(self) -> None:
        """Take the frame rate as typed in."""
        if self.session.recording is not None:
            rate = self.numbers["frame_rate_hz"].value
            self.session.recalibrate(self.session.recording.calibrated(frame_rate_hz=rate))

    def _show(self) -> None:
        """Show the recording's facts and optics; without one, only how to open one."""
        recording = self.session.recording
        opened = recording is not None or self.session.reconstruction is not None
        self.explanation.setText("Check the microscope." if recording is not None else WELCOME)
        self.explanation.setVisible(recording is not None or not opened)
        optics_fields: list[QWidget] = [box.native for box in self.numbers.values()]
        for widget in (*optics_fields, self.remember):
            self.form.setRowVisible(widget, recording is not None)
        if recording is None:
            self.remove_raw.hide()
            self.facts.setVisible(opened)
            self._show_layer()
            return
        optics = recording.optics
        values = {
            "wavelength_nm": 1000 * optics.wavelength_um,
            "camera_pixel_um": optics.camera_pixel_um,
            "magnification": optics.magnification,
            "medium_index": optics.medium_index,
            "frame_rate_hz": recording.frame_rate_hz,
        }
        with self.own_change():
            for name, value in values.items():
                box = self.numbers[name]
                # One frame has no rate; that of the recording before must not stay.
                shown_value = NUMBERS[name][1] if value is None else value
                box.value = min(max(shown_value, box.min), box.max)
        self._show_layer()
        self._show_facts(recording)

    def _show_phase(self) -> None:
        """Say what wrapped phase is being worked on, where there is no recording."""
        if self.session.recording is None:
            self._show()
            phase = self.session.needed_reconstruction()["phase"]
            self.facts.setText(facts_of_phase(phase, self.session.name))

    def doubts(self) -> Sequence[str]:
        """Return what is to be looked after in the recording."""
        recording = self.session.recording
        if recording is None:
            return ()
        return doubts_of_recording(recording, self._seen(recording), self.session.lost)

    def _seen(self, recording: Recording) -> Seen:
        """Return what the first frame shows, looked at once: the file may be far away."""
        data = recording.holograms.data
        if self._looked_at[0] is not data:  # another microscope leaves the frames as they are
            self._looked_at = (data, Seen.of(recording))
        return self._looked_at[1]

    def _show_facts(self, recording: Recording) -> None:
        """Show what the recording is, and what to look after."""
        words = facts_of_recording(recording, self._seen(recording), self.session.lost)
        raw = self._raw is not None and self._raw in self.presenter.viewer.layers
        if raw:
            words += (
                f"<br>⚠ The layer “{self._raw.name}” has no angle, so that the sliders don't fit "
                "together. Its frames are in the new layer."
            )
        self.remove_raw.setVisible(raw)
        self.facts.setText(words)
        self.facts.setVisible(True)


LARGEST_HEADER = 2**30


class RawDialog(QDialog):  # type: ignore[misc]
    """Height, width, type and header of raw frames; says how many frames that makes.

    Parameters
    ----------
    path : Path
        The file.
    before : RawLayout, optional
        What was typed in for an earlier file.
    parent : QWidget, optional
        The widget that asks.
    """

    def __init__(
        self, path: Path, before: RawLayout | None = None, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle(f"Frames of {path.name}")
        self._bytes = path.stat().st_size
        form = QFormLayout(self)
        words = QLabel(f"{path.name} is raw: it does not say how its frames lie in it.")
        words.setWordWrap(True)
        form.addRow(words)
        usual = before or RawLayout(512, 512)
        self.height_box = self._number("raw_height", usual.height, 1, LARGEST_SIDE)
        self.width_box = self._number("raw_width", usual.width, 1, LARGEST_SIDE)
        self.header_box = self._number("raw_header", usual.header_bytes, 0, LARGEST_HEADER)
        self.kind = QComboBox()
        self.kind.setObjectName("raw_kind")
        self.kind.addItems(KINDS)
        self.kind.setCurrentText(usual.dtype)
        form.addRow("Height", self.height_box)
        form.addRow("Width", self.width_box)
        form.addRow("Pixels are", self.kind)
        form.addRow("Header (bytes)", self.header_box)
        self.verdict = QLabel()
        self.verdict.setObjectName("raw_verdict")
        form.addRow(self.verdict)
        kinds = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(kinds.Open | kinds.Cancel)
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)
        form.addRow(self.buttons)
        for box in (self.height_box, self.width_box, self.header_box):
            box.valueChanged.connect(self._judge)
        self.kind.currentTextChanged.connect(self._judge)
        self._judge()

    def layout_of_frames(self) -> RawLayout:
        """Return what is typed in."""
        return RawLayout(
            self.height_box.value(),
            self.width_box.value(),
            self.kind.currentText(),
            header_bytes=self.header_box.value(),
        )

    def _number(self, name: str, value: int, low: int, high: int) -> QSpinBox:
        box = QSpinBox()
        box.setObjectName(name)
        box.setRange(low, high)
        box.setValue(value)
        return box

    def _judge(self) -> None:
        """Say how many frames there are then, and how many bytes are left over."""
        frames, left = divmod(
            max(self._bytes - self.header_box.value(), 0), self.layout_of_frames().frame_bytes
        )
        self.verdict.setText(f"makes {frames} frames; {left} bytes are left over")
        self.buttons.button(QDialogButtonBox.StandardButton.Open).setEnabled(frames > 0)
