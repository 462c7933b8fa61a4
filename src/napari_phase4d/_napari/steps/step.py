"""What all steps have in common: their form, how they say what is wrong, fields of several."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from typing import Any, NamedTuple

import numpy as np
from magicgui.widgets import FloatSpinBox
from psygnal import EmitLoopError
from qtpy.QtCore import Qt, Signal
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QComboBox,
    QFormLayout,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from napari_phase4d._napari.jobs import Jobs, sentence_of
from napari_phase4d._napari.preferences import own_refraction_increment
from napari_phase4d._napari.session import Session, as_sentence
from napari_phase4d._napari.viewing.presenter import Presenter
from napari_phase4d._napari.widgets.section import WheelGuard
from napari_phase4d.analysis import noise_sentence
from napari_phase4d.holography import Focus, first_seen, fringe_contrast, reconstruction_advice
from napari_phase4d.later import pd, xr
from napari_phase4d.recording import Recording
from napari_phase4d.words import counted, size_in_words

__all__ = [
    "Seen",
    "Step",
    "doubts_of_reconstruction",
    "doubts_of_recording",
    "facts_of_phase",
    "facts_of_reconstruction",
    "facts_of_recording",
    "focus_in_words",
    "in_grid",
    "increment_field",
    "index_field",
]

#: Letters that a drop-down list shows at least.
SHORTEST_CHOICE = 7


class Step(QWidget):  # type: ignore[misc]
    """One step: a column of widgets that reads and changes the session.

    Parameters
    ----------
    session : Session
        What the dock knows.
    jobs : Jobs
        Runs long work.
    presenter : Presenter
        Shows results in the viewer.

    Signals
    -------
    failed(str)
        A sentence for the user.
    said(str)
        What has been done.
    """

    failed = Signal(str)
    said = Signal(str)

    #: Heading of the step.
    title = ""
    #: One sentence under the heading: what to do here.
    purpose = ""
    #: Whether it has a picture or a table that can use the height that is left in the dock.
    grows = False

    def __init__(self, session: Session, jobs: Jobs, presenter: Presenter) -> None:
        super().__init__()
        self.session = session
        self.jobs = jobs
        self.presenter = presenter
        self.filling = False
        self.wheel = WheelGuard(self)
        self.column = QVBoxLayout(self)
        self.column.setContentsMargins(4, 2, 4, 6)
        self.column.setSpacing(5)
        self.explanation = self.text(self.purpose, "purpose")
        self.column.addWidget(self.explanation)
        self.explanation.setVisible(bool(self.purpose))
        self.heard = self.text("", "heard")
        self.heard.setTextFormat(Qt.TextFormat.RichText)
        self.heard.setVisible(False)
        self.column.addWidget(self.heard)
        self.form = QFormLayout()
        self.form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        self.form.setVerticalSpacing(4)
        self.build()

    def build(self) -> None:
        """Make the widgets."""

    def doubts(self) -> Sequence[str]:
        """Return what is to be looked after in what this step has done; each a sentence."""
        return ()

    def show_heard(self, sentences: Sequence[str]) -> None:
        """Show what work has warned of."""
        self.heard.setText("<br>".join(f"⚠ {escape(each)}" for each in sentences))
        self.heard.setVisible(bool(sentences))

    def text(self, words: str, name: str) -> QLabel:
        """Return a label that wraps its lines."""
        label = QLabel(words)
        label.setWordWrap(True)
        label.setObjectName(name)
        return label

    def label(self, words: str) -> QLabel:
        """Return a label of one word, as narrow as that."""
        label = QLabel(words)
        label.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Preferred)
        return label

    def button(self, words: str, name: str, tooltip: str, clicked: Any) -> QPushButton:
        """Return a button whose errors end as a sentence in the dock."""
        button = QPushButton(words)
        button.setObjectName(name)
        button.setToolTip(tooltip)
        button.setAccessibleDescription(tooltip)
        button.clicked.connect(lambda: self.guarded(clicked, button))
        return button

    def row(self, *widgets: QWidget) -> QHBoxLayout:
        """Return widgets next to each other."""
        row = QHBoxLayout()
        row.setSpacing(4)
        for widget in widgets:
            row.addWidget(widget)
        return row

    def field(self, label: str, widget: Any) -> Any:
        """Add a magicgui widget to the form, its name and tooltip on the label too."""
        self.watched(widget)
        self.form.addRow(label, widget.native)
        self.form.labelForField(widget.native).setToolTip(widget.tooltip)
        widget.native.setAccessibleName(label)
        return widget

    def watched(self, widget: Any) -> Any:
        """Give a magicgui widget its name and tooltip, and leave the wheel to the dock."""
        native = widget.native
        native.setObjectName(widget.name)
        native.setToolTip(widget.tooltip)
        # What a screen reader says where no label is joined to it.
        native.setAccessibleName(widget.name.replace("_", " "))
        native.setAccessibleDescription(widget.tooltip)
        self.wheel.watch(native)
        if isinstance(native, QAbstractSpinBox):
            native.setKeyboardTracking(False)
        if isinstance(native, QComboBox):  # a long name must not widen the dock
            native.setSizeAdjustPolicy(
                QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon
            )
            native.setMinimumContentsLength(SHORTEST_CHOICE)
        return widget

    @contextmanager
    def own_change(self) -> Iterator[None]:
        """Let a change of the widgets not be taken for the user's."""
        before, self.filling = self.filling, True
        try:
            yield
        finally:
            self.filling = before

    def look_again(self, widget: Any) -> bool:
        """Look again for the layers that a magicgui widget offers; say if its choice is there.

        A layer that was renamed stays chosen.
        """
        chosen = widget.value
        with self.own_change():
            widget.reset_choices()
            there = chosen in widget.choices
            if there:
                widget.value = chosen
        return there

    def when_changed(self, widget: Any, action: Callable[[], None]) -> None:
        """Run an action when the user changes a magicgui widget."""

        def changed(_: Any) -> None:
            if not self.filling:
                self.guarded(action)

        widget.changed.connect(changed)

    def when_chosen(
        self, widget: Any, action: Callable[[], None], put_back: Callable[[], None]
    ) -> None:
        """Run an action as `when_changed`; a choice that is refused or cancelled is put back."""

        def choose() -> None:
            try:
                action()
            except Exception:
                put_back()
                raise

        self.when_changed(widget, choose)
        self.jobs.idle.connect(lambda _: put_back())

    def guarded(self, action: Callable[[], Any], pressed: QWidget | None = None) -> None:
        """Run an action; what it shows comes up in steps, a wrong input becomes one sentence.

        That stands below what was pressed, where it is given, also if a job fails later.
        """
        # What an action sets on the way is asked for by what was pressed too.
        before, self.jobs.asked_by = self.jobs.asked_by, pressed or self.jobs.asked_by
        try:
            with self.presenter.turns.unhurried():
                action()
        except (OSError, TypeError, ValueError, EmitLoopError) as error:
            self.failed.emit(sentence_of(error))
        finally:
            self.jobs.asked_by = before


#: Share of saturated pixels that is worth a warning, and fringe contrast that is.
MANY_SATURATED, WEAK_FRINGES = 0.001, 0.05
#: Views of fewer pixels along a side show hardly anything.
FEW_PIXELS = 12


class Seen(NamedTuple):
    """What the first frame of a recording shows: fringe contrast, share of saturated pixels."""

    contrast: float
    saturated: float

    @classmethod
    def of(cls, recording: Recording) -> Seen:
        """Look at the first frame that is not lost; this reads from the file."""
        first, dtype = np.asarray(first_seen(recording)), recording.holograms.dtype
        whole = dtype.kind in "iu"
        saturated = float(np.mean(first == np.iinfo(dtype).max)) if whole else 0.0
        return cls(fringe_contrast(first.astype(np.float32)), saturated)


def facts_of_recording(recording: Recording, seen: Seen, lost: str = "") -> str:
    """Return what a recording is: size, pixel, fringe contrast, and what to look after.

    ``lost`` says which frames the camera lost.
    """
    height, width = recording.frame_shape
    lines = [
        f"<b>{recording.name}</b>",
        f"{counted(recording.n_frames, 'frame')} of {width} × {height} pixels, "
        f"{recording.holograms.dtype}, {size_in_words(recording.nbytes)}",
        f"pixel in the sample {recording.optics.pixel_um:.4g} µm, "
        f"fringe contrast {seen.contrast:.2f}",
    ]
    lines += [f"⚠ {doubt}" for doubt in doubts_of_recording(recording, seen, lost)]
    return "<br>".join(lines)


def doubts_of_recording(recording: Recording, seen: Seen, lost: str = "") -> list[str]:
    """Return what is to be looked after in a recording; each a sentence."""
    doubts = []
    if seen.contrast < WEAK_FRINGES:
        doubts.append("The fringes are weak; the phase will be noisy.")
    if seen.saturated > MANY_SATURATED:
        doubts.append(f"{100 * seen.saturated:.1f} % of the first frame is saturated.")
    return [*doubts, *([lost] if lost else []), *recording.notes]


def facts_of_phase(phase: xr.DataArray, name: str) -> str:
    """Return what wrapped phase is, where there is no recording."""
    n_times, n_angles, height, width = phase.shape
    lines = [
        f"<b>{name}</b>",
        f"Wrapped phase: {counted(n_times, 'time')} × {counted(n_angles, 'view')}, "
        f"{width} × {height} pixels. "
        "Go on with step 4.",
        *(f"⚠ {note}" for note in phase.attrs.get("notes", ())),
    ]
    return "<br>".join(lines)


def facts_of_reconstruction(data: xr.Dataset, noise: pd.DataFrame | None) -> list[str]:
    """Return what was reconstructed: size, focus, noise, and what to look after."""
    n_times, n_angles, height, width = data["phase"].shape
    frames = f"{counted(n_times, 'time')} × {counted(n_angles, 'view')}"
    lines = [f"{frames}, {width} × {height} pixels"]
    if data.attrs.get("refocus_um"):
        lines[0] += f", refocused by {data.attrs['refocus_um']:.4g} µm"
    visibility = data.attrs.get("fringe_visibility", ())
    if len(visibility) and not any(math.isnan(v) for v in visibility):  # some files hide it
        listed = ", ".join(f"{v:.2f}" for v in visibility)
        lines.append(f"Fringe visibility {listed}")
    if noise is not None:
        lines.append(noise_sentence(noise))
    return [*lines, *(f"⚠ {doubt}" for doubt in doubts_of_reconstruction(data))]


def doubts_of_reconstruction(data: xr.Dataset) -> list[str]:
    """Return what is to be looked after in reconstructed phase; each a sentence."""
    attrs, n_times = data.attrs, data.sizes["time"]
    doubts = []
    height, width = data.sizes["y"], data.sizes["x"]
    if min(height, width) < FEW_PIXELS:
        few = f"Only {width} × {height} pixels are resolved"
        doubts.append(f"{few}: the circles in step 2 may be too small.")
    if attrs.get("focus_at_the_end"):
        doubts.append("The focus was found at the end of the search; it may lie beyond.")
    advice = reconstruction_advice(attrs, n_times)
    doubts += [as_sentence(each) for each in advice]
    angles = np.array([*dict.fromkeys(data["angle"].values.tolist())])  # of several wavelengths
    if len(angles) > 2 and not np.allclose(np.diff(angles), angles[1] - angles[0]):
        listed = ", ".join(f"{a:g}°" for a in angles)
        doubts.append(f"Angles are uneven; the slider counts evenly. They are {listed}.")
    return doubts


def focus_in_words(focus: Focus) -> str:
    """Say where the focus was found, and for what kind of object."""
    words = f"Focus found at {focus.distance_um:.2f} µm, for a {focus.objects} object."
    if focus.at_the_end:
        words += " It lies at the end of the search: there may be none within it."
    return words


#: Pixels that a field gets at least.
NARROW = 90


#: Qt's own way to leave the buttons out hides the number too, in this style and with Qt 6.11.3.
NO_BUTTONS = "QAbstractSpinBox::up-button, QAbstractSpinBox::down-button { width: 0; height: 0; }"


def without_buttons(field: FloatSpinBox) -> FloatSpinBox:
    """Return a field for a number without buttons, for which a narrow one has no room."""
    field.native.setStyleSheet(NO_BUTTONS)
    return field


def increment_field(name: str) -> FloatSpinBox:
    """Return a field for the refraction increment."""
    field = FloatSpinBox(
        name=name,
        value=own_refraction_increment(),
        min=0.01,
        max=1,
        step=0.01,
        tooltip="Refraction increment: how much a gram of dry matter in a millilitre "
        "raises the refractive index. 0.18 mL/g is usual for cells (Barer, Nature 169, "
        "366, 1952); proteins have 0.185 (Barer & Joseph 1954) to 0.190 (Zhao et al. 2011).",
    )
    field.native.setSuffix(" mL/g")
    return without_buttons(field)


def index_field(name: str) -> FloatSpinBox:
    """Return a field for the refractive index of the object."""
    field = FloatSpinBox(
        name=name,
        value=1,
        min=1,
        max=4,
        step=0.01,
        tooltip="Refractive index of the object, no unit; without it there is no height "
        "and no volume.",
    )
    field.native.setDecimals(4)
    field.native.setSpecialValueText("none")
    return without_buttons(field)


def in_grid(step: Step, fields: Sequence[tuple[str, Any]]) -> None:
    """Add fields with their names to a step, two in a row; those without a name need none."""
    grid = QGridLayout()
    grid.setSpacing(4)
    for number, (words, field) in enumerate(fields):
        row, side = divmod(number, 2)
        if words:
            label = step.label(words)
            label.setToolTip(field.tooltip)
            label.setBuddy(field.native)
            field.native.setMinimumWidth(NARROW)
            grid.addWidget(label, row, 2 * side)
        grid.addWidget(field.native, row, 2 * side + 1)
    grid.setColumnStretch(1, 1)
    grid.setColumnStretch(3, 1)
    step.column.addLayout(grid)
