"""What the dock is put together of: headings that open and close, low tabs, a quiet wheel."""

from __future__ import annotations

from qtpy.QtCore import QEvent, QObject, QSize, Qt, Signal
from qtpy.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QSizePolicy,
    QTabWidget,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

__all__ = ["LowTabs", "Section", "WheelGuard"]

HEADING_HEIGHT = 25


class Section(QWidget):  # type: ignore[misc]
    """One step with its heading.

    Parameters
    ----------
    title : str
        The heading.
    content : QWidget
        What it opens and closes.

    Signals
    -------
    opened(Section)
        The user has opened this one.
    """

    opened = Signal(object)

    def __init__(self, title: str, content: QWidget) -> None:
        super().__init__()
        self.content = content
        self.heading = QToolButton()
        self.heading.setObjectName(f"heading_{title.split()[1].lower()}")
        self.heading.setText(title)
        self.heading.setToolTip(f"Open or close step {title}.")
        self.heading.setCheckable(True)
        self.heading.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.heading.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.heading.setFixedHeight(HEADING_HEIGHT)
        self.heading.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        bold = self.heading.font()
        bold.setBold(True)
        self.heading.setFont(bold)
        self.heading.toggled.connect(self.set_open)
        self.heading.clicked.connect(self._clicked)
        self.badge = QLabel()
        self.badge.setObjectName(f"state_{title.split()[1].lower()}")
        row = QHBoxLayout()
        row.setContentsMargins(0, 0, 6, 0)
        row.addWidget(self.heading, 1)
        row.addWidget(self.badge)
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 0, 0, 0)
        column.setSpacing(0)
        column.addLayout(row)
        column.addWidget(content)
        self._state = ("", "", "")
        self.set_open(False)

    @property
    def is_open(self) -> bool:
        """Whether the content is shown."""
        return bool(self.heading.isChecked())

    def set_open(self, is_open: bool) -> None:
        """Show or hide the content."""
        self.heading.setChecked(is_open)
        arrow = Qt.ArrowType.DownArrow if is_open else Qt.ArrowType.RightArrow
        self.heading.setArrowType(arrow)
        self.content.setVisible(is_open)

    def _clicked(self, is_open: bool) -> None:
        if is_open:
            self.opened.emit(self)

    def set_state(self, colour: str, words: str, tooltip: str) -> None:
        """Say at the heading how far the step is."""
        if (colour, words, tooltip) == self._state:
            return  # a style that is set anew is worked out anew
        self._state = (colour, words, tooltip)
        self.badge.setText(words)
        self.badge.setToolTip(tooltip)
        self.badge.setStyleSheet(f"color: {colour};")


class LowTabs(QTabWidget):  # type: ignore[misc]
    """A tab widget that asks for its smallest size, so that all is in view on a small screen."""

    def sizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        """Return the smallest size at which no page is cut."""
        return self.minimumSizeHint()

    def hasHeightForWidth(self) -> bool:  # noqa: N802
        """Say that a page's wrapped words do not ask for more height."""
        return False

    def heightForWidth(self, width: int) -> int:  # noqa: N802
        """Return no wish of its own."""
        return -1


class WheelGuard(QObject):  # type: ignore[misc]
    """Leaves the wheel to the dock unless a field has been clicked."""

    def watch(self, field: QWidget) -> None:
        """Guard one field."""
        field.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        field.installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:  # noqa: N802
        """Stop wheel events of fields that have no focus."""
        if (
            event is not None
            and event.type() == QEvent.Type.Wheel
            and isinstance(watched, QWidget)
            and not watched.hasFocus()
        ):
            event.ignore()
            return True
        return False
