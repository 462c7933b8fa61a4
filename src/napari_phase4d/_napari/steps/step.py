"""What all five steps of the dock have in common."""

from __future__ import annotations

from typing import Any

from psygnal import EmitLoopError
from qtpy.QtCore import Signal
from qtpy.QtWidgets import (
    QAbstractSpinBox,
    QFormLayout,
    QLabel,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from napari_phase4d._napari.jobs import Jobs, sentence_of
from napari_phase4d._napari.presenter import Presenter
from napari_phase4d._napari.session import Session
from napari_phase4d._napari.steps.wheel import WheelGuard

__all__ = ["Step"]


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
    """

    failed = Signal(str)

    #: Heading of the step.
    title = ""
    #: One sentence under the heading: what to do here.
    purpose = ""

    def __init__(self, session: Session, jobs: Jobs, presenter: Presenter) -> None:
        super().__init__()
        self.session = session
        self.jobs = jobs
        self.presenter = presenter
        self.wheel = WheelGuard(self)
        self.column = QVBoxLayout(self)
        self.column.setContentsMargins(4, 2, 4, 6)
        self.column.setSpacing(6)
        self.column.addWidget(self.text(self.purpose, "purpose"))
        self.form = QFormLayout()
        self.form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        self.build()

    def build(self) -> None:
        """Make the widgets."""

    def text(self, words: str, name: str) -> QLabel:
        """Return a label that wraps its lines."""
        label = QLabel(words)
        label.setWordWrap(True)
        label.setObjectName(name)
        return label

    def button(self, words: str, name: str, tooltip: str, clicked: Any) -> QPushButton:
        """Return a button whose errors end as a sentence in the dock."""
        button = QPushButton(words)
        button.setObjectName(name)
        button.setToolTip(tooltip)
        button.clicked.connect(lambda: self.guarded(clicked))
        return button

    def field(self, label: str, widget: Any) -> Any:
        """Add a magicgui widget to the form, its name and tooltip on the label too."""
        native = widget.native
        native.setObjectName(widget.name)
        native.setToolTip(widget.tooltip)
        self.wheel.watch(native)
        if isinstance(native, QAbstractSpinBox):
            native.setKeyboardTracking(False)
        self.form.addRow(label, native)
        self.form.labelForField(native).setToolTip(widget.tooltip)
        return widget

    def guarded(self, action: Any) -> None:
        """Run an action; a wrong input becomes one sentence."""
        try:
            action()
        except (OSError, TypeError, ValueError, EmitLoopError) as error:
            self.failed.emit(sentence_of(error))
