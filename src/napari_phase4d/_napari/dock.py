"""The dock: five steps from a hologram video to 4-D phase."""

from __future__ import annotations

import atexit
import sys
import threading
import weakref
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import qtpy
from napari.settings import get_settings
from napari.utils.notifications import show_warning
from napari.viewer import Viewer
from qtpy.QtCore import QCoreApplication, QEvent, QObject, QSize, QTimer
from qtpy.QtGui import QDragEnterEvent, QDropEvent, QShowEvent
from qtpy.QtWidgets import (
    QFrame,
    QHBoxLayout,
    QLabel,
    QMainWindow,
    QProgressBar,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from napari_phase4d._napari.beginning import binding_advice, get_ready
from napari_phase4d._napari.jobs import Jobs, TimeLeft, in_words, sentence_of
from napari_phase4d._napari.session import Plan, StepNumber, StepState, news, step_states
from napari_phase4d._napari.steps import (
    CompareStep,
    LobesStep,
    PhaseStep,
    RecordingStep,
    UnwrapStep,
)
from napari_phase4d._napari.turns import Afterwards, Canvas, Collecting, WhenIdle
from napari_phase4d._napari.viewing.pointing import Following
from napari_phase4d._napari.viewing.presenter import Presenter
from napari_phase4d._napari.widgets.section import Beside, Section
from napari_phase4d.holography import angles_unknown
from napari_phase4d.pipeline import start_words
from napari_phase4d.unwrapping import left_out_advice

__all__ = ["Phase4DDock"]

WIDTH, WIDEST = 380, 480
#: What it takes of the width of a large screen.
OF_SCREEN = 0.25
#: Letters of the font that it is at least as wide as.
LETTERS = 49
#: Readable on napari's dark and light themes.
WRONG_STYLE = "color: #e8594a; font-weight: bold;"
#: Where the keyboard is.
FOCUS_STYLE = """
QPushButton:focus, QToolButton:focus, QAbstractSpinBox:focus, QComboBox:focus, QCheckBox:focus,
QTableWidget:focus, QTabBar:focus, QSlider:focus { border: 1px solid #3d8fe0; }
"""
#: What is done unasked begins so long after the last thing that the user did.
QUIET_AFTER_MS = 150
#: Colour and words of each state; readable on napari's dark and light themes.
LOOKS = {
    StepState.TO_DO: ("#8a8f98", "to do", "An earlier step comes first."),
    StepState.READY: ("#3d8fe0", "● ready", "This is what to do next."),
    StepState.DONE: ("#3aa76d", "✓ done", "Nothing is left to do here; it can be done again."),
    StepState.DOUBTED: ("#d98324", "⚠ look", ""),
    StepState.STALE: (
        "#d98324",
        "↻ changed",
        "What is shown was made with other settings; press the button again.",
    ),
}
FIRST_WORDS = "Open a recording, or try the sample."


class Phase4DDock(QWidget):  # type: ignore[misc]
    """Five steps, a progress bar and a line that says what is happening.

    Parameters
    ----------
    napari_viewer : napari.viewer.Viewer
        Where the layers go.
    """

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self.presenter = Presenter.of(napari_viewer)
        self.session = self.presenter.session
        #: What was said last that was no error.
        self._next_words = self._said = ""
        #: Whether what stands there is the error of a job.
        self._of_job = False
        #: Where the dock has scrolled to by itself.
        self._scrolled_to = 0
        self._time_left = TimeLeft()
        #: Titles of what failed unasked, which is not tried again.
        self._failed_unasked: list[str] = []
        #: What the work that goes on has warned of, by the number of its step.
        self._heard_so_far: dict[int, list[str]] = {}
        self.jobs = Jobs(self, self.presenter.turns)
        self.presenter.turns.failed = lambda error: self.say(sentence_of(error), wrong=True)
        self.presenter.turns.canvas = canvas = Canvas(self)
        turns = self.presenter.turns
        # Its window may go before it is told so; another dock may have taken over by then.
        self.destroyed.connect(lambda: turns.stop() if turns.canvas is canvas else None)
        # Before the steps, which look at what it shows.
        self.presenter.listen()
        parts = (self.session, self.jobs, self.presenter)
        self.recording = RecordingStep(*parts)
        self.lobes = LobesStep(*parts)
        self.phase = PhaseStep(*parts)
        self.unwrap = UnwrapStep(*parts)
        self.compare = CompareStep(*parts)
        self.steps = (self.recording, self.lobes, self.phase, self.unwrap, self.compare)
        self._quiet = QTimer(self)
        self._quiet.setSingleShot(True)
        self._quiet.setInterval(QUIET_AFTER_MS)
        self._quiet.timeout.connect(self._work_unasked)
        dims, camera = napari_viewer.dims, napari_viewer.scene.camera
        self._when_idle = WhenIdle(
            self._clear_up, lambda: (dims.current_step, camera.center, camera.zoom), self
        )
        # A child, so that it goes with the dock if the window takes it away.
        self._closing = QTimer(self)
        self._closing.setSingleShot(True)
        self._closing.setInterval(0)
        self._closing.timeout.connect(self._look_if_closed)
        # The window has grown for the dock only after this.
        self._fitting = QTimer(self)
        self._fitting.setSingleShot(True)
        self._fitting.setInterval(0)
        self._fitting.timeout.connect(self._fit_screen)
        self._opened: Section | None = None
        # What a section holds has its height only once the window has laid it out.
        self._laid_out = QTimer(self)
        self._laid_out.setSingleShot(True)
        self._laid_out.setInterval(0)
        self._laid_out.timeout.connect(self._scroll_to_opened)
        self._build()
        self._listen()
        self.followers = Followers(self.steps, self)
        self.following = Following(napari_viewer, [self.followers])
        self.destroyed.connect(self.following.stop)
        self.setAcceptDrops(True)
        self.say(FIRST_WORDS)
        if advice := binding_advice(sys.version_info[:3], qtpy.PYSIDE_VERSION):
            show_warning(advice)
        self._catch_up()
        # The window is painted first.
        self._gone = threading.Event()
        self.destroyed.connect(self._gone.set)
        QTimer.singleShot(QUIET_AFTER_MS, partial(get_ready, self._gone.is_set))
        atexit.register(close_with_python, weakref.ref(self))
        # Layers would be kept until the dock is closed, also those that are removed.
        self._collecting = None if len(napari_viewer.layers) else Collecting()

    def _catch_up(self) -> None:
        """Go on where an earlier dock of this viewer was closed."""
        session = self.session
        if session.recording is None and session.reconstruction is None:
            return
        self.reset_choices()
        with self.presenter.still():
            session.catch_up()
        with self.presenter.turns.unhurried():
            self.presenter.go_on()
        states = step_states(session)
        ready = [n for n, state in enumerate(states) if state != StepState.DONE]
        self.show_step(ready[0] if ready else len(states) - 1)
        self.say("Here is all as it was when the panel was closed.")

    def reset_choices(self, event: Any = None) -> None:
        """Let napari tell that layers were added or removed."""
        if self.jobs.closed:
            return
        self.recording.reset_choices()
        self.compare.reset_choices()
        self.following.watch_regions(self.compare.region_drawn)

    def say(
        self,
        sentence: str,
        *,
        wrong: bool = False,
        passing: bool = False,
        pressed: QWidget | None = None,
    ) -> None:
        """Show one sentence at the foot of the dock; one in passing does not come back.

        What is wrong stands below what was pressed too, where the eye is.
        """
        self._of_job = False
        if not wrong:
            self._said = "" if passing else sentence
        self.status.setText(f"⚠ {sentence}" if wrong else sentence)
        if wrong and pressed is not None and pressed.isVisible():
            self.beside.say(f"⚠ {sentence}", pressed)
        elif not passing:
            self.beside.take_back()
        if self.status.property("wrong") is not wrong:
            self.status.setProperty("wrong", wrong)
            self.status.setStyleSheet(WRONG_STYLE if wrong else "")

    def show_step(self, number: int) -> None:
        """Open one step (0 to 4), close the others and scroll to it."""
        for i, section in enumerate(self.sections):
            section.set_open(i == number)
        self._look_at_opened(self.sections[number])

    def _look_at_opened(self, section: Section) -> None:
        """Scroll to a step whose heading was clicked: what it holds may lie below the fold."""
        self._opened = section
        self._laid_out.start()

    def _look_again(self) -> None:
        """Scroll to the step that is open, as it has grown, unless the user has scrolled."""
        stays = self.scroll.verticalScrollBar().value() == self._scrolled_to
        if self._opened is not None and self._opened.is_open and stays:
            self._laid_out.start()

    def _scroll_to_opened(self) -> None:
        if self._opened is not None:
            top, port = self._opened.pos().y(), self.scroll.viewport().height()
            if self._opened.height() > port:  # its heading matters most
                self.scroll.verticalScrollBar().setValue(top)
            else:
                self.scroll.ensureWidgetVisible(self._opened, 0, 0)
            self._scrolled_to = self.scroll.verticalScrollBar().value()

    def close_down(self) -> None:
        """Stop what is running and let go of the viewer."""
        self._quiet.stop()
        self._when_idle.stop()
        self._gone.set()
        self.jobs.close()
        self.following.stop()
        self.followers.stop()
        self.presenter.leave()
        if self._collecting is not None:
            self._collecting.end()

    def showEvent(self, event: QShowEvent | None) -> None:  # noqa: N802 - Qt's name
        """Watch the window that the dock is in, to stop work when it closes."""
        super().showEvent(event)
        if isinstance(self.window(), QMainWindow):  # and not a dock that floats
            self.window().installEventFilter(self)
            self._fitting.start()

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:  # noqa: N802
        """Stop what is running when the window closes; napari may ask, and the user refuse."""
        if event is not None and event.type() == QEvent.Type.Close:
            self._closing.start()
        return False

    def _look_if_closed(self) -> None:
        if not self.window().isVisible():
            self.close_down()

    def changeEvent(self, event: QEvent | None) -> None:  # noqa: N802
        """Follow the font; stop what is running when the dock is taken out of its window."""
        super().changeEvent(event)
        fonts = (QEvent.Type.FontChange, QEvent.Type.StyleChange)
        if event is not None and event.type() in fonts and hasattr(self, "status"):
            self._fit_font()
        if event is not None and event.type() == QEvent.Type.ParentChange and not self.parent():
            self.close_down()

    def _fit_font(self) -> None:
        """Take the size of napari's font, and be as wide as its words need.

        Napari gives its size to labels, buttons and fields by their kind. Headings, tables,
        pictures and plots have it from here. The width is at most half of the screen.
        """
        font, size = self.font(), float(get_settings().appearance.font_size)
        if font.pointSizeF() != size:
            font.setPointSizeF(size)
            self.setFont(font)
        screen = self.screen()
        most = WIDTH if screen is None else max(WIDTH, screen.availableGeometry().width() // 2)
        self.status.ensurePolished()
        letters = self.status.fontMetrics().horizontalAdvance("x" * LETTERS)
        self.setMinimumWidth(min(max(WIDTH, letters), most))

    def sizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        """Return the size it opens with: pictures grow with it, as far as the screen has room."""
        hint, screen = super().sizeHint(), self.screen()
        room = 0 if screen is None else int(screen.availableGeometry().width() * OF_SCREEN)
        return QSize(max(self.minimumWidth(), min(room, WIDEST)), hint.height())

    def _fit_screen(self) -> None:
        """Let the window be no larger than the screen that there is."""
        window, screen = self.window(), self.screen()
        if not isinstance(window, QMainWindow) or screen is None or window.isMaximized():
            return
        room = screen.availableGeometry()
        width, height = min(window.width(), room.width()), min(window.height(), room.height())
        if (width, height) != (window.width(), window.height()):
            window.resize(width, height)

    def dragEnterEvent(self, event: QDragEnterEvent | None) -> None:  # noqa: N802
        """Accept one file or folder."""
        if event is not None and len(dropped_paths(event)) == 1:
            event.acceptProposedAction()

    def dropEvent(self, event: QDropEvent | None) -> None:  # noqa: N802
        """Open what is dropped on the dock: a recording, phase, or a recipe."""
        if event is not None:
            (path,) = dropped_paths(event)
            event.acceptProposedAction()
            self.recording.guarded(lambda: self.recording.open_path(path))

    def _build(self) -> None:
        self.setStyleSheet(FOCUS_STYLE)
        column = QVBoxLayout(self)
        column.setContentsMargins(4, 4, 4, 4)
        column.setSpacing(3)
        inner = QWidget()
        sections = QVBoxLayout(inner)
        sections.setContentsMargins(0, 0, 0, 0)
        sections.setSpacing(2)
        self.sections: list[Section] = []
        for step in self.steps:
            section = Section(step.title, step, grows=step.grows)
            section.opened.connect(self._look_at_opened)
            sections.addWidget(section, int(step.grows))
            self.sections.append(section)
        sections.addStretch()
        self.scroll = QScrollArea()
        self.scroll.setWidget(inner)
        self.scroll.setWidgetResizable(True)
        self.scroll.setFrameShape(QFrame.Shape.NoFrame)
        column.addWidget(self.scroll)
        row = QHBoxLayout()
        self.progress = QProgressBar()
        self.progress.setObjectName("progress")
        self.cancel = QPushButton("Cancel")
        self.cancel.setObjectName("cancel")
        self.cancel.setToolTip("Stop what is running within a second; finished results stay.")
        self.cancel.clicked.connect(self._cancel)
        row.addWidget(self.progress)
        row.addWidget(self.cancel)
        column.addLayout(row)
        self.beside = Beside(self)
        self.beside.setStyleSheet(WRONG_STYLE)
        self.status = QLabel()
        self.status.setObjectName("status")
        self.status.setWordWrap(True)
        self.status.setMinimumHeight(2 * self.status.fontMetrics().lineSpacing())
        column.addWidget(self.status)
        self._fit_font()
        self._idle()
        self.show_step(0)

    def _listen(self) -> None:
        for step in self.steps:
            step.failed.connect(self._refused)
            step.said.connect(self._say_last)
        self.lobes.settled.connect(lambda: self.show_step(2))
        self.jobs.started.connect(self._started)
        self.jobs.progressed.connect(self._progressed)
        self.jobs.finished.connect(self._finished)
        self.jobs.cancelled.connect(self._cancelled)
        self.jobs.failed.connect(self._failed)
        self.jobs.idle.connect(self._nothing_runs)
        self.jobs.warned.connect(self._warned)
        session = self.session
        session.recording_changed.connect(self._recording_opened)
        session.reconstruction_changed.connect(self._reconstructed)
        session.lobes_changed.connect(self._lobes_changed)
        session.outcome_changed.connect(self._unwrapped)
        for signal in (
            session.recording_changed,
            session.lobes_changed,
            session.reconstruction_changed,
            session.outcome_changed,
            session.recipe_changed,
            session.spectrum_changed,
            session.calibration_changed,
            session.confidence_changed,
        ):
            signal.connect(self._show_states)
        session.recipe_changed.connect(self._settings_changed)
        session.confidence_changed.connect(self._look_again)
        self.compare.tabs.currentChanged.connect(lambda _: self._look_again())
        self._show_states()

    def _settings_changed(self) -> None:
        """Take an error back, whose cause may be mended now, and compute what is not known."""
        if self.status.property("wrong") and not self._of_job:
            self.say(self._said)
        if not self.jobs.busy:
            self._quiet.start()

    def _show_states(self) -> None:
        """Say at each heading how far its step is."""
        states = step_states(self.session)
        numbered = zip(StepNumber, self.sections, self.steps, states, strict=True)
        for number, section, step, state in numbered:
            said = step.doubts()
            so_far = self._heard_so_far.get(number, ())
            heard = list(dict.fromkeys([*self.session.heard.of(number), *so_far]))
            step.show_heard(heard)
            doubts = (*said, *heard) if state == StepState.DONE else ()
            colour, words, meaning = LOOKS[StepState.DOUBTED if doubts else state]
            section.set_state(colour, words, "\n".join(doubts) or meaning)

    def _warned(self, plan: Plan, sentences: list[str], ended: bool) -> None:
        """Say at its step what work has warned of, and at the foot if it is waited for."""
        new = news(sentences, self.steps[plan.step].doubts())
        if ended:
            self.session.heard.take(plan.step, plan.title, new)
        self._heard_so_far = {} if ended else {plan.step: new}
        self._show_states()
        if ended and new and not plan.gives_way:
            more = f" (and {len(new) - 1} more in step {plan.step + 1})" if new[1:] else ""
            self._next_words = f"⚠ {new[0]}{more} {self._next_words or f'{plan.title}: done.'}"

    def _started(self, title: str) -> None:
        self._next_words = ""
        self.beside.take_back()
        self.progress.setRange(0, 0)
        self.progress.setVisible(True)
        self.cancel.setEnabled(True)
        self.cancel.setVisible(True)
        self.say(f"{title} …", passing=True)

    def _progressed(self, done: int, total: int, message: str) -> None:
        if not self.jobs.running:  # a late word of a job that has ended
            return
        self.progress.setRange(0, total)
        self.progress.setValue(done)
        left = in_words(self._time_left.seconds(done, total, message))
        self.say(f"{message}: {done} of {total}{left}", passing=True)

    def _idle(self) -> None:
        self.progress.setVisible(False)
        self.cancel.setVisible(False)

    def _cancel(self) -> None:
        self.cancel.setEnabled(False)
        self.say("Stopping …", passing=True)
        self.jobs.cancel()

    def _cancelled(self, title: str, has_parts: bool) -> None:
        self._idle()
        kept = " The finished results are shown." if has_parts else ""
        self._next_words = ""
        self.say(f"{title}: cancelled.{kept}")

    def _refused(self, sentence: str) -> None:
        """Say what is wrong with what was just pressed."""
        self.say(sentence, wrong=True, pressed=self.jobs.asked_by)

    def _failed(self, sentence: str) -> None:
        self._idle()
        self.presenter.drop_finished()
        self.say(sentence, wrong=True, pressed=self.jobs.job_asked_by)
        self._of_job = True  # no setting mends it

    def _finished(self, title: str) -> None:
        self._idle()
        self.say(self._next_words or f"{title}: done.")
        self._next_words = ""

    def _nothing_runs(self, failed: str) -> None:
        """Go on with what is best computed unasked, but not with what has failed."""
        if failed:
            self._failed_unasked.append(failed)
        if self._heard_so_far:  # of work that came to nothing
            self._heard_so_far = {}
            self._show_states()
        self._quiet.start()

    def _work_unasked(self) -> None:
        if self.jobs.busy or self.jobs.closed:
            return
        plan = self.session.quiet_plan(self._failed_unasked)
        if plan is not None:
            self.jobs.start(plan)
        else:
            self._when_idle()

    def _clear_up(self) -> None:
        """Look for garbage, unless somebody may be waiting."""
        waited_for = self.jobs.busy or self.jobs.closed or self.presenter.turns.pending
        if self._collecting is not None and not waited_for:
            self._collecting.in_quiet()
        elif not self.jobs.closed:
            self._when_idle()

    def _recording_opened(self) -> None:
        self._failed_unasked = []
        if self.session.recording is None:
            return
        if self.session.lobes:  # those of a recipe
            self._go_on(2, "The lobes are as they were saved: press Reconstruct.")
            return
        # What had to be assumed of the microscope is to be checked first.
        assumed = bool(self.session.recording.notes)
        self._go_on(0 if assumed else 1, "Check the microscope, then find the lobes in step 2.")

    def _lobes_changed(self) -> None:
        unknown = angles_unknown(self.session.lobes)
        typing = " Type the viewing angles into the table." if unknown else ""
        self._say_last(
            f"Drag the circles to correct them, then press Reconstruct in step 3.{typing}"
        )

    def _reconstructed(self) -> None:
        self._failed_unasked = []
        self._go_on(3, "Press Run: it starts from the safest frame, unless you click another.")

    def _unwrapped(self) -> None:
        self._failed_unasked = []
        outcome = self.session.needed_outcome()
        start = start_words(
            outcome.recipe.start_frames,
            found=outcome.scores is not None,
            of=self.session.needed_reconstruction()["phase"],
        )
        found = next(iter(outcome.comparison.results.values())).attrs
        if advice := left_out_advice(found):
            self._go_on(4, f"⚠ {advice} by unticking it. {start}")
        else:
            self._go_on(4, f"{self.compare.follow_words()} {start}")

    def _go_on(self, step: int, words: str) -> None:
        """Open the next step and say what to do there, also once a job has ended."""
        self.show_step(step)
        self._say_last(words)

    def _say_last(self, words: str) -> None:
        """Say something now, and again when the job that is running has ended."""
        self.say(words)
        self._next_words = words if self.jobs.running else ""
        if not self.jobs.busy:
            self._quiet.start()


class Followers:
    """The steps, told of the mouse at once, and of the sliders when the canvas has followed them.

    Parameters
    ----------
    steps : sequence of Step
        A step with ``frame_changed()``, ``cursor_moved()`` or ``clicked()`` is told.
    dock : QObject
        What they go with.
    """

    def __init__(self, steps: Sequence[Any], dock: QObject) -> None:
        self._steps = steps
        self.frame_changed = Afterwards(partial(self._tell, "frame_changed"), dock)
        self.cursor_moved = partial(self._tell, "cursor_moved")
        self.clicked = partial(self._tell, "clicked")

    def stop(self) -> None:
        """Tell nothing any more."""
        self.frame_changed.stop()

    def _tell(self, what: str) -> None:
        for step in self._steps:
            if hasattr(step, what):
                getattr(step, what)()


def close_with_python(dock: weakref.ref[Phase4DDock]) -> None:
    """Close a dock that is still open when Python ends, as after a script without an event loop.

    What is left then PyQt deletes itself, and ends with a crash where that calls so much of Python
    that it has to lay out anew the table of all there is which it goes through. So the dock, of
    which each part would be told of its end, is deleted before.
    """
    still_open = dock()
    if still_open is not None:
        with suppress(RuntimeError):  # Qt has deleted it already
            if not still_open.jobs.closed:
                still_open.close_down()
            still_open.window().removeEventFilter(still_open)
            still_open.close()
            still_open.setParent(None)
            still_open.deleteLater()
            QCoreApplication.sendPostedEvents(still_open, QEvent.Type.DeferredDelete.value)


def dropped_paths(event: QDropEvent) -> list[Path]:
    """Return the files that are being dropped."""
    data = event.mimeData()
    urls = [] if data is None else data.urls()
    return [Path(url.toLocalFile()) for url in urls if url.isLocalFile()]
