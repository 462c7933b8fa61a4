"""What the dock is put together of: headings that open and close, low tabs, a quiet wheel."""

from __future__ import annotations

from qtpy.QtCore import QEvent, QObject, QSize, Qt, Signal
from qtpy.QtGui import QResizeEvent
from qtpy.QtWidgets import (
    QBoxLayout,
    QHBoxLayout,
    QLabel,
    QLayoutItem,
    QSizePolicy,
    QSplitter,
    QTabWidget,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

__all__ = ["Beside", "LowTabs", "Section", "Turning", "WheelGuard", "split"]

HEADING_HEIGHT = 25
#: Qt's word for no limit of a size.
MOST = 16777215


class Section(QWidget):  # type: ignore[misc]
    """One step with its heading.

    Parameters
    ----------
    title : str
        The heading.
    content : QWidget
        What it opens and closes.
    grows : bool, optional
        Whether it takes the height that is left while it is open.

    Signals
    -------
    opened(Section)
        The user has opened this one.
    """

    opened = Signal(object)

    def __init__(self, title: str, content: QWidget, *, grows: bool = False) -> None:
        super().__init__()
        self.content = content
        self._grows = grows
        self.heading = QToolButton()
        self.heading.setObjectName(f"heading_{title.split()[1].lower()}")
        self.heading.setText(title)
        self.heading.setToolTip(f"Open or close step {title}.")
        self.heading.setCheckable(True)
        self.heading.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
        self.heading.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.heading.setMinimumHeight(HEADING_HEIGHT)
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
        if self._grows:
            policy = QSizePolicy.Policy
            height = policy.Expanding if is_open else policy.Fixed
            self.setSizePolicy(policy.Preferred, height)

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


class Beside(QLabel):  # type: ignore[misc]
    """A sentence that stands in the column of what it is about, below it."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("beside")
        self.setWordWrap(True)
        self.hide()

    def say(self, sentence: str, pressed: QWidget) -> None:
        """Say something of a widget below the row that it is in, if that is in a column."""
        self.take_back()
        parent = pressed.parentWidget()
        while parent is not None and not isinstance(parent.layout(), QVBoxLayout):
            parent = parent.parentWidget()
        if parent is None:
            return
        column = parent.layout()
        for place in range(column.count()):
            if holds(column.itemAt(place), pressed):
                column.insertWidget(place + 1, self)
                self.setText(sentence)
                self.show()
                return

    def take_back(self) -> None:
        """Say nothing any more."""
        self.hide()
        self.clear()


def holds(item: QLayoutItem, widget: QWidget) -> bool:
    """Say whether an item of a layout is a widget, or holds it."""
    own, inner = item.widget(), item.layout()
    if own is not None:
        return own is widget or bool(own.isAncestorOf(widget))
    places = range(0 if inner is None else inner.count())
    return any(holds(inner.itemAt(place), widget) for place in places)


class Turning(QWidget):  # type: ignore[misc]
    """A square with something narrow beside it, or below it where there is the height.

    Parameters
    ----------
    square, narrow : QWidget
        What it shows.
    beside : int
        Width of the narrow one beside the square, and its least height below it, in pixels.
    """

    def __init__(self, square: QWidget, narrow: QWidget, beside: int) -> None:
        super().__init__()
        self._square, self._narrow, self._beside = square, narrow, beside
        self._box = QBoxLayout(QBoxLayout.Direction.LeftToRight, self)
        self._box.setContentsMargins(0, 0, 0, 0)
        self._box.setSpacing(4)
        # A height that goes by the width would be asked for where there is none.
        square.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._box.addWidget(square, 1)
        self._box.addWidget(narrow)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._turn()

    @property
    def is_upright(self) -> bool:
        """Whether one is below the other."""
        return bool(self._box.direction() == QBoxLayout.Direction.TopToBottom)

    def resizeEvent(self, event: QResizeEvent | None) -> None:  # noqa: N802 - Qt's name
        """Turn where the square would else be smaller than it could be."""
        super().resizeEvent(event)
        self._turn()

    def _turn(self) -> None:
        upright = self.height() >= self.width() + self._beside
        direction = QBoxLayout.Direction
        self._box.setDirection(direction.TopToBottom if upright else direction.LeftToRight)
        self._square.setMaximumHeight(self.width() if upright else MOST)
        # Below the square it is as wide as there is room, and keeps nobody from narrowing that.
        self._narrow.setMinimumWidth(0 if upright else self._beside)
        self._narrow.setMaximumWidth(MOST if upright else self._beside)


class LowTabs(QTabWidget):  # type: ignore[misc]
    """A tab widget as low as the page on top can be, so that all is in view on a small screen."""

    def __init__(self) -> None:
        super().__init__()
        self.currentChanged.connect(lambda _: self.updateGeometry())

    def minimumSizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        """Return the smallest size at which the page on top is not cut; the widest one counts."""
        pages = [self.widget(n) for n in range(self.count())]
        least = super().minimumSizeHint()
        heights = [page.minimumSizeHint().height() for page in pages]
        on_top = self.currentWidget()
        if on_top is None:
            return least
        around = least.height() - max(heights)
        return QSize(least.width(), on_top.minimumSizeHint().height() + around)

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


def split(upper: QWidget, lower: QWidget) -> QSplitter:
    """Return two widgets, one below the other, whose heights the user shares out by a handle."""
    splitter = QSplitter(Qt.Orientation.Vertical)
    splitter.setChildrenCollapsible(False)
    for widget, share in ((upper, 3), (lower, 2)):
        splitter.addWidget(widget)
        splitter.setStretchFactor(splitter.count() - 1, share)
    splitter.handle(1).setToolTip("Drag to make the plot or the table higher.")
    return splitter
