"""Curves in the window: traces of a pixel for every method, dry mass for every region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike
from qtpy.QtCore import QEvent, QSize, Qt
from qtpy.QtGui import QPalette, QShowEvent
from qtpy.QtWidgets import QLabel, QStackedLayout, QWidget

from napari_phase4d._napari.widgets.curve_figure import CurveFigure, Panel, values_of
from napari_phase4d.io.atomic import written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["CurvePlot", "Panel"]

NOTHING = "Move the mouse over a result."
SIZE, LEAST_SIZE = (360, 200), (280, 140)
FORMATS = (".png", ".svg")


class CurvePlot(QWidget):  # type: ignore[misc]
    """One or more panels of named curves that can be renewed many times a second.

    Until there are curves it shows a sentence, and matplotlib is not loaded.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        self._live: CurveFigure | None = None
        super().__init__(parent)
        self.setObjectName("curve_plot")
        self._words = QLabel(NOTHING)
        self._words.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._words.setWordWrap(True)
        self._stack = QStackedLayout(self)
        self._stack.addWidget(self._words)

    @property
    def figure(self) -> Figure | None:
        """The matplotlib figure; None before the first curve."""
        return None if self._live is None else self._live.figure

    @property
    def has_curves(self) -> bool:
        """Whether curves are shown, not a sentence."""
        return self._stack.currentWidget() is not self._words

    def message(self, text: str = NOTHING) -> None:
        """Show a sentence instead of curves."""
        self._words.setText(text)
        self._stack.setCurrentWidget(self._words)

    def show_traces(self, panels: Sequence[Panel]) -> None:
        """Show panels of curves; quick if only their values have changed since the last time.

        Parameters
        ----------
        panels : sequence of Panel
            Such as one over time and one over the angle, side by side; a name has the same colour
            in each. Without any curve, a sentence is shown.

        Raises
        ------
        ValueError
            If a curve has not as many points as there are positions.
        """
        for panel in panels:
            values_of(panel)
        if not any(panel.curves for panel in panels):
            self.message()
            return
        if self._live is None:
            self._live = CurveFigure(self.logicalDpiX())
            self._stack.addWidget(self._live.canvas)
            self._paint()
        self._stack.setCurrentWidget(self._live.canvas)
        self._live.show(panels)

    def show_curves(
        self, x: ArrayLike, curves: Mapping[str, ArrayLike], x_label: str, y_label: str
    ) -> None:
        """Show one panel, such as the dry mass of every region over time.

        Parameters
        ----------
        x, curves, x_label, y_label
            See `Panel`.
        """
        self.show_traces([Panel(x, curves, x_label, y_label)])

    def save(self, path: str | Path) -> None:
        """Write the curves to a file, black on white.

        Parameters
        ----------
        path : str or Path
            Ends with .png or .svg.

        Raises
        ------
        ValueError
            If there are no curves, or the ending is another one.
        OSError
            If the file can't be written.
        """
        target = Path(path)
        if self._live is None or not self.has_curves:
            msg = "there are no curves to save yet"
            raise ValueError(msg)
        if target.suffix.lower() not in FORMATS:
            msg = f"curves are saved as {' or '.join(FORMATS)}, but the file is {target.name!r}"
            raise ValueError(msg)
        with written_whole(target) as temporary:
            self._live.save(temporary)

    def sizeHint(self) -> QSize:  # noqa: N802 - Qt's name
        """Return the size at which two panels can be read."""
        return QSize(*SIZE)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the least size at which it can be read."""
        return QSize(*LEAST_SIZE)

    def showEvent(self, event: QShowEvent | None) -> None:  # noqa: N802
        """Draw what has changed while nobody saw it."""
        super().showEvent(event)
        if self._live is not None:
            self._live.redraw(everything=True)

    def changeEvent(self, event: QEvent | None) -> None:  # noqa: N802
        """Follow the theme."""
        super().changeEvent(event)
        changes = (QEvent.Type.PaletteChange, QEvent.Type.StyleChange)
        if event is not None and event.type() in changes:
            self._paint()

    def _paint(self) -> None:
        """Use the colours of the theme."""
        if self._live is None:
            return
        palette = self.palette()
        ink, ground = (QPalette.ColorRole.WindowText, QPalette.ColorRole.Window)
        self._live.paint(palette.color(ink).name(), palette.color(ground).name())
