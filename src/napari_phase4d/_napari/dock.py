"""The dock: five steps from a hologram video to 4-D phase."""

from __future__ import annotations

from typing import Any

from napari.viewer import Viewer
from qtpy.QtCore import QEvent, QObject, Qt
from qtpy.QtGui import QShowEvent
from qtpy.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from napari_phase4d._napari.jobs import Jobs
from napari_phase4d._napari.presenter import Presenter
from napari_phase4d._napari.session import Session
from napari_phase4d._napari.steps import (
    CompareStep,
    LobesStep,
    PhaseStep,
    RecordingStep,
    UnwrapStep,
)
from napari_phase4d._napari.steps.section import Section
from napari_phase4d.unwrapping import warm_up_elsewhere

__all__ = ["Phase4DDock"]

WIDTH = 380
#: Readable on napari's dark and light themes.
WRONG_STYLE = "color: #e8594a; font-weight: bold;"


class Phase4DDock(QWidget):  # type: ignore[misc]
    """Five steps, a progress bar and a line that says what is happening.

    Parameters
    ----------
    napari_viewer : napari.viewer.Viewer
        Where the layers go.
    """

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self.session = Session()
        self._next_words = ""
        self.jobs = Jobs(self)
        self.presenter = Presenter(napari_viewer, self.session)
        parts = (self.session, self.jobs, self.presenter)
        self.recording = RecordingStep(*parts)
        self.lobes = LobesStep(*parts)
        self.phase = PhaseStep(*parts)
        self.unwrap = UnwrapStep(*parts)
        self.compare = CompareStep(*parts)
        self.steps = (self.recording, self.lobes, self.phase, self.unwrap, self.compare)
        self._build()
        self._listen()
        self.say("Open a recording, or try a sample.")
        warm_up_elsewhere()

    def reset_choices(self, event: Any = None) -> None:
        """Let napari tell that layers were added or removed."""
        self.recording.reset_choices()

    def say(self, sentence: str, *, wrong: bool = False) -> None:
        """Show one sentence at the foot of the dock."""
        self.status.setText(f"⚠ {sentence}" if wrong else sentence)
        self.status.setProperty("wrong", wrong)
        self.status.setStyleSheet(WRONG_STYLE if wrong else "")

    def show_step(self, number: int) -> None:
        """Open one step (0 to 4), close the others and scroll to it."""
        for i, section in enumerate(self.sections):
            section.set_open(i == number)
        self.scroll.ensureWidgetVisible(self.sections[number], 0, 0)

    def showEvent(self, event: QShowEvent | None) -> None:  # noqa: N802 - Qt's name
        """Watch the window that the dock is in, to stop work when it closes."""
        super().showEvent(event)
        self.window().installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:  # noqa: N802
        """Stop what is running when the window closes."""
        if event is not None and event.type() == QEvent.Type.Close:
            self.jobs.cancel()
        return False

    def changeEvent(self, event: QEvent | None) -> None:  # noqa: N802
        """Stop what is running when the dock is taken out of its window."""
        super().changeEvent(event)
        if event is not None and event.type() == QEvent.Type.ParentChange and not self.parent():
            self.jobs.cancel()

    def _build(self) -> None:
        column = QVBoxLayout(self)
        column.setContentsMargins(4, 4, 4, 4)
        inner = QWidget()
        sections = QVBoxLayout(inner)
        sections.setContentsMargins(0, 0, 0, 0)
        self.sections: list[Section] = []
        for step in self.steps:
            section = Section(step.title, step)
            sections.addWidget(section)
            self.sections.append(section)
        sections.addStretch()
        self.scroll = QScrollArea()
        self.scroll.setWidget(inner)
        self.scroll.setWidgetResizable(True)
        self.scroll.setFrameShape(QFrame.Shape.NoFrame)
        self.scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        column.addWidget(self.scroll)
        row = QHBoxLayout()
        self.progress = QProgressBar()
        self.progress.setObjectName("progress")
        self.cancel = QPushButton("Cancel")
        self.cancel.setObjectName("cancel")
        self.cancel.setToolTip("Stop what is running; finished results stay.")
        self.cancel.clicked.connect(self._cancel)
        row.addWidget(self.progress)
        row.addWidget(self.cancel)
        column.addLayout(row)
        self.status = QLabel()
        self.status.setObjectName("status")
        self.status.setWordWrap(True)
        self.status.setMinimumHeight(2 * self.status.fontMetrics().lineSpacing())
        column.addWidget(self.status)
        self.setMinimumWidth(WIDTH)
        self._idle()
        self.show_step(0)

    def _listen(self) -> None:
        for step in self.steps:
            step.failed.connect(lambda sentence: self.say(sentence, wrong=True))
        self.jobs.started.connect(self._started)
        self.jobs.progressed.connect(self._progressed)
        self.jobs.finished.connect(self._finished)
        self.jobs.cancelled.connect(self._cancelled)
        self.jobs.failed.connect(self._failed)
        self.session.recording_changed.connect(self._recording_opened)
        self.session.reconstruction_changed.connect(self._reconstructed)
        self.session.lobes_changed.connect(self._lobes_changed)
        self.session.outcome_changed.connect(self._unwrapped)
        self.session.margin_changed.connect(self._margin_shown)
        self.session.confidence_changed.connect(self._confidence_shown)
        self.session.scores_changed.connect(self._suggested)

    def _started(self, title: str) -> None:
        self._next_words = ""
        self.progress.setRange(0, 0)
        self.progress.setVisible(True)
        self.cancel.setEnabled(True)
        self.cancel.setVisible(True)
        self.say(f"{title} …")

    def _progressed(self, done: int, total: int, message: str) -> None:
        if not self.jobs.running:  # a late word of a job that has ended
            return
        self.progress.setRange(0, total)
        self.progress.setValue(done)
        self.say(f"{message}: {done} of {total}")

    def _idle(self) -> None:
        self.progress.setVisible(False)
        self.cancel.setVisible(False)

    def _cancel(self) -> None:
        self.cancel.setEnabled(False)
        self.say("Stopping …")
        self.jobs.cancel()

    def _cancelled(self, title: str) -> None:
        self._idle()
        self.say(f"{title}: cancelled.")

    def _failed(self, sentence: str) -> None:
        self._idle()
        self.say(sentence, wrong=True)

    def _finished(self, title: str) -> None:
        self._idle()
        self.say(self._next_words or f"{title}: done.")
        self._next_words = ""
        self._show_spectrum()

    def _recording_opened(self) -> None:
        if self.session.recording is None:
            return
        # What had to be assumed of the microscope is to be checked first.
        assumed = bool(self.session.recording.notes)
        self._go_on(0 if assumed else 1, "Check the microscope, then find the lobes in step 2.")
        self._show_spectrum()

    def _show_spectrum(self) -> None:
        """Compute the spectrum unasked, while nothing else is being done."""
        waiting = self.session.recording is not None and self.session.spectrum is None
        if waiting and not self.jobs.running:
            self.jobs.start(self.session.plan_spectrum())

    def _lobes_changed(self) -> None:
        words = "Drag the circles to correct them, then press Reconstruct in step 3."
        self._next_words = words if self.jobs.running else ""
        self.say(words)

    def _reconstructed(self) -> None:
        self._go_on(3, "Choose a frame in which the object is thin, then press Run.")

    def _unwrapped(self) -> None:
        self._go_on(4, "Move the sliders: all results follow.")

    def _margin_shown(self) -> None:
        self._go_on(4, self.compare.words_on_the_steps())

    def _confidence_shown(self) -> None:
        self._go_on(4, self.compare.words_on_confidence())

    def _suggested(self) -> None:
        self._go_on(3, self.unwrap.words_on_the_suggestion())

    def _go_on(self, step: int, words: str) -> None:
        """Open the next step and say what to do there, also once a job has ended."""
        self.show_step(step)
        self.say(words)
        self._next_words = words if self.jobs.running else ""
