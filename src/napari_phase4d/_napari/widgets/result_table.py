"""A table of figures that can be sorted and copied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from qtpy.QtCore import Qt
from qtpy.QtGui import (
    QColor,
    QGuiApplication,
    QIcon,
    QKeyEvent,
    QKeySequence,
    QPixmap,
    QShowEvent,
)
from qtpy.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
    QWidget,
)

from napari_phase4d.later import pd

__all__ = ["ResultTable", "on_screen"]

#: Most rows that are laid out; the clipboard and files hold all.
MOST_ROWS = 500


def on_screen(heading: str) -> str:
    """Return a heading of a file with the signs of its units.

    Examples
    --------
    >>> on_screen("area (um^2)"), on_screen("angle (deg)")
    ('area (µm²)', 'angle (°)')
    """
    name, bracket, unit = heading.partition(" (")
    for plain, sign in (("um", "µm"), ("^2", "²"), ("^3", "³"), ("deg", "°")):
        unit = unit.replace(plain, sign)
    return name + bracket + unit


class Cell(QTableWidgetItem):  # type: ignore[misc]
    """A cell that sorts by its value, not by its words; what is not known comes last."""

    def __init__(self, value: Any, form: str = ".3g") -> None:
        words = value if isinstance(value, str) else f"{value:{form}}"
        super().__init__("–" if words == "nan" else words)
        self.value = value

    def __lt__(self, other: object) -> bool:
        mine, theirs = self.value, getattr(other, "value", "")
        if isinstance(mine, str) or isinstance(theirs, str):
            return str(mine) < str(theirs)
        if mine != mine or theirs != theirs:  # NaN is neither less nor more
            last = theirs if self._rises() else mine
            return bool(last != last and (mine == mine or theirs == theirs))
        return bool(mine < theirs)

    def _rises(self) -> bool:
        """Say whether the table is being sorted upwards; downwards Qt asks the other way round."""
        table = self.tableWidget()
        order = None if table is None else table.horizontalHeader().sortIndicatorOrder()
        return bool(order != Qt.SortOrder.DescendingOrder)


class TrueColours(QStyledItemDelegate):  # type: ignore[misc]
    """Draws the squares of selected rows in their own colours: Qt would tint them."""

    def initStyleOption(self, option: QStyleOptionViewItem | None, index: Any) -> None:  # noqa: N802 - Qt's name
        """Take the same picture for a row that is selected."""
        super().initStyleOption(option, index)
        colour = index.data(Qt.ItemDataRole.DecorationRole)
        if option is not None and isinstance(colour, QColor):
            square = QPixmap(option.decorationSize)
            square.fill(colour)
            icon = QIcon(square)
            icon.addPixmap(square, QIcon.Mode.Selected)
            option.icon = icon


class ResultTable(QTableWidget):  # type: ignore[misc]
    """Shows a data frame; a click on a heading sorts, Ctrl+C copies all of it.

    Parameters
    ----------
    name : str
        The widget's name.
    parent : QWidget, optional
        Its parent.
    """

    def __init__(self, name: str, parent: QWidget | None = None) -> None:
        super().__init__(0, 0, parent)
        self.setObjectName(name)
        self._frame: pd.DataFrame | None = None
        self.setAccessibleName(name.replace("_", " "))
        self.setItemDelegate(TrueColours(self))
        self.setTabKeyNavigation(False)  # Tab leaves the table; arrows go through it
        self.verticalHeader().setVisible(False)
        self.setStyleSheet("QHeaderView::section { padding: 1px 2px; }")
        self.verticalHeader().setDefaultSectionSize(22)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.horizontalHeader().sortIndicatorChanged.connect(self._make_room)
        self.setHorizontalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)

    @property
    def frame(self) -> pd.DataFrame:
        """What is shown; pandas is not loaded to show nothing."""
        return pd.DataFrame() if self._frame is None else self._frame

    def show_frame(
        self,
        frame: pd.DataFrame,
        headings: Mapping[str, tuple[str, ...]],
        tooltips: Mapping[int, str] | None = None,
        colours: Sequence[str] = (),
    ) -> None:
        """Show a data frame.

        Parameters
        ----------
        frame : DataFrame
            Texts and numbers.
        headings : mapping
            Column to its heading, tooltip and, if it is not ".3g", the format of its numbers;
            other columns are left out.
        tooltips : mapping of int to str, optional
            Row number to what is said of it.
        colours : sequence of str, optional
            Colour of a square at the beginning of each row.
        """
        self._frame = frame
        names = [name for name in headings if name in frame.columns]
        self.setSortingEnabled(False)
        self.setColumnCount(len(names))
        self.setHorizontalHeaderLabels([headings[name][0] for name in names])
        rows = min(len(frame), MOST_ROWS)
        self.setRowCount(rows)
        for column, name in enumerate(names):
            self.horizontalHeaderItem(column).setToolTip(headings[name][1])
            for row, value in enumerate(frame[name].iloc[:rows]):
                cell = Cell(value, *headings[name][2:])
                cell.setToolTip((tooltips or {}).get(row, ""))
                if column == 0 and row < len(colours):
                    cell.setData(Qt.ItemDataRole.DecorationRole, QColor(colours[row]))
                self.setItem(row, column, cell)
        self._fit()
        self.setSortingEnabled(True)
        # As it came; the mark of a sorted column would be wrong.
        self.horizontalHeader().setSortIndicator(-1, Qt.SortOrder.AscendingOrder)

    def _fit(self) -> None:
        """Make columns as wide as they need; unsorted, without room for the mark of sorting."""
        header = self.horizontalHeader()
        header.setSortIndicatorShown(False)
        header.setSectionResizeMode(QHeaderView.ResizeMode.Interactive)
        header.setStretchLastSection(False)
        self.resizeColumnsToContents()
        header.setStretchLastSection(True)

    def showEvent(self, event: QShowEvent | None) -> None:  # noqa: N802 - Qt's name
        """Fit the columns anew: the last one was stretched over the room that there was before."""
        super().showEvent(event)
        self._fit()

    def _make_room(self, column: int, _: Any) -> None:
        """Let the heading that is sorted by show its mark beside its words."""
        if column >= 0:
            self.resizeColumnToContents(column)

    def clear_rows(self) -> None:
        """Show nothing."""
        self._frame = None
        self.setRowCount(0)

    def copy(self) -> None:
        """Put the whole table on the clipboard, tabs between the columns.

        Raises
        ------
        ValueError
            If there is nothing to copy.
        """
        if self.frame.empty:
            msg = "the table is empty; there is nothing to copy yet"
            raise ValueError(msg)
        text = self.frame.to_csv(sep="\t", index=False, lineterminator="\n")
        QGuiApplication.clipboard().setText(text)

    def keyPressEvent(self, event: QKeyEvent | None) -> None:  # noqa: N802 - Qt's name
        """Copy with the usual key."""
        if event is not None and event.matches(QKeySequence.StandardKey.Copy):
            if not self.frame.empty:
                self.copy()
            return
        super().keyPressEvent(event)
