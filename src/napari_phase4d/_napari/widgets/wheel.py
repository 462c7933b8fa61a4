"""The wheel scrolls the dock; it must not change a number on the way."""

from __future__ import annotations

from qtpy.QtCore import QEvent, QObject, Qt
from qtpy.QtWidgets import QWidget

__all__ = ["WheelGuard"]


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
