"""What all five steps of the dock have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from psygnal import EmitLoopError
from qtpy.QtCore import Signal
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QComboBox,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from napari_phase4d._napari.jobs import Jobs, sentence_of
from napari_phase4d._napari.session import Session
from napari_phase4d._napari.viewing.presenter import Presenter
from napari_phase4d._napari.widgets.wheel import WheelGuard

__all__ = ["Step"]

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
        self.form = QFormLayout()
        self.form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        self.form.setVerticalSpacing(4)
        self.build()

    def build(self) -> None:
        """Make the widgets."""

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
        button.clicked.connect(lambda: self.guarded(clicked))
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
        return widget

    def watched(self, widget: Any) -> Any:
        """Give a magicgui widget its name and tooltip, and leave the wheel to the dock."""
        native = widget.native
        native.setObjectName(widget.name)
        native.setToolTip(widget.tooltip)
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

    def when_changed(self, widget: Any, action: Callable[[], None]) -> None:
        """Run an action when the user changes a magicgui widget."""

        def changed(_: Any) -> None:
            if not self.filling:
                self.guarded(action)

        widget.changed.connect(changed)

    def guarded(self, action: Callable[[], Any]) -> None:
        """Run an action; a wrong input becomes one sentence."""
        try:
            action()
        except (OSError, TypeError, ValueError, EmitLoopError) as error:
            self.failed.emit(sentence_of(error))
