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
