"""Tabs that take no more height than they need."""

from __future__ import annotations

from qtpy.QtCore import QSize
from qtpy.QtWidgets import QTabWidget

__all__ = ["LowTabs"]


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
