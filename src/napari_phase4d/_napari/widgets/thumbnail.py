"""One frame of wrapped phase, small, with words beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import Qt
from qtpy.QtGui import QPixmap
from qtpy.QtWidgets import QHBoxLayout, QLabel, QWidget

from napari_phase4d._napari.widgets.view_strip import phase_image

__all__ = ["Thumbnail"]

SIDE = 64


class Thumbnail(QWidget):  # type: ignore[misc]
    """A picture of 64 pixels and a few lines of text."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.picture = QLabel()
        self.picture.setObjectName("thumbnail")
        self.picture.setFixedSize(SIDE, SIDE)
        self.picture.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.words = QLabel()
        self.words.setObjectName("thumbnail_words")
        self.words.setWordWrap(True)
        self.words.setAlignment(Qt.AlignmentFlag.AlignVCenter)
        row = QHBoxLayout(self)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(self.picture)
        row.addWidget(self.words, 1)
        self.setFixedHeight(SIDE)

    def show_frame(self, frame: NDArray[np.float32] | None, words: str) -> None:
        """Show wrapped phase (y, x) in radians, None for no picture, and what there is to say."""
        self.words.setText(words)
        if frame is None:
            self.picture.clear()
            return
        step = max(1, max(frame.shape) // (2 * SIDE))
        pixmap = QPixmap.fromImage(phase_image(frame[::step, ::step]))
        self.picture.setPixmap(
            pixmap.scaled(
                SIDE,
                SIDE,
                Qt.AspectRatioMode.KeepAspectRatio,
                Qt.TransformationMode.SmoothTransformation,
            )
        )
