"""The wrapped phase of one frame as small pictures: of every view, or with words beside it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray
from qtpy.QtCore import QPointF, QRectF, QSize, Qt
from qtpy.QtGui import QColor, QImage, QPainter, QPaintEvent, QPen, QPixmap
from qtpy.QtWidgets import QHBoxLayout, QLabel, QSizePolicy, QWidget

from napari_phase4d._napari.widgets.spectrum_picture import VIEW_COLORS, sized, view_color
from napari_phase4d.plotting import OBJECT_COLOUR

__all__ = ["Thumbnail", "ViewStrip", "phase_image"]

NOTHING_YET = "The wrapped phase appears here."
GREY = QColor(140, 140, 140)
#: Line round a picture and space between pictures, in pixels.
FRAME, GAP = 2.0, 4.0
#: Height of a caption's row and of its letters, as shares of the widget's font.
CAPTION, CAPTION_SIZE = 14 / 12, 11 / 12
TINY = 1e-6


class ViewStrip(QWidget):  # type: ignore[misc]
    """One picture a view, framed in its colour, with a caption.

    Black is a phase of +-pi, white is 0.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName("view_strip")
        self.setAccessibleName("Wrapped phase of every view")
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Expanding)
        self.setMinimumSize(80, 120)
        self._pictures: list[QPixmap] = []
        self._captions: list[str] = []

    @property
    def captions(self) -> list[str]:
        """What is written under the pictures."""
        return list(self._captions)

    def set_views(self, images: Sequence[NDArray[np.float32]], captions: Sequence[str]) -> None:
        """Show the wrapped phase of the views, or a sentence if there are none.

        Parameters
        ----------
        images : sequence of ndarray of shape (y, x)
            Radians, -pi to pi; at most 6.
        captions : sequence of str
            A few characters each.

        Raises
        ------
        ValueError
            If there are not as many captions as images, or too many of them.
        """
        if len(images) != len(captions) or len(images) > len(VIEW_COLORS):
            msg = (
                f"there are {len(images)} images and {len(captions)} captions; "
                f"give one caption an image, and at most {len(VIEW_COLORS)} images"
            )
            raise ValueError(msg)
        self._pictures = [QPixmap.fromImage(phase_image(image)) for image in images]
        self._captions = list(captions)
        self.update()

    def _cells(self, columns: int) -> list[QRectF]:
        """Return the place of each picture with its frame and caption, in so many columns."""
        rows = -(-len(self._pictures) // columns)
        width = (self.width() - GAP * (columns - 1)) / columns
        height = (self.height() - GAP * (rows - 1)) / rows
        return [
            QRectF((i % columns) * (width + GAP), (i // columns) * (height + GAP), width, height)
            for i in range(len(self._pictures))
        ]

    def places(self) -> list[QRectF]:
        """Return where the pictures are drawn, without frames, in pixels of this widget."""
        caption = self._caption()
        choices = [
            [
                fitted(picture, cell, caption)
                for picture, cell in zip(self._pictures, self._cells(n), strict=True)
            ]
            for n in range(1, len(self._pictures) + 1)
        ]
        # As many columns as give the largest pictures.
        return max(choices, key=lambda places: places[0].width(), default=[])

    def _caption(self) -> int:
        """Return the height of a caption's row in pixels."""
        return int(sized(self.font(), CAPTION).pixelSize())

    def paintEvent(self, event: QPaintEvent | None) -> None:  # noqa: N802 - Qt's name
        """Draw pictures, frames and captions."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        if not self._pictures:
            painter.setPen(GREY)
            words = Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap
            painter.drawText(self.rect().adjusted(6, 6, -6, -6), words, NOTHING_YET)
        painter.setFont(sized(self.font(), CAPTION_SIZE))
        caption = self._caption()
        for index, place in enumerate(self.places()):
            picture, color = self._pictures[index], view_color(index)
            painter.drawPixmap(place, picture, QRectF(picture.rect()))
            painter.setPen(QPen(color, FRAME))
            edge = FRAME / 2
            painter.drawRect(place.adjusted(-edge, -edge, edge, edge))
            below = QRectF(place.left(), place.bottom() + FRAME, place.width(), caption)
            painter.setPen(self.palette().color(self.foregroundRole()))
            painter.drawText(below, Qt.AlignmentFlag.AlignCenter, self._captions[index])
        painter.end()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return the size next to a spectrum."""
        return QSize(125, 230)


def fitted(picture: QPixmap, cell: QRectF, caption: int) -> QRectF:
    """Return the largest place for a picture that leaves room for its frame and caption."""
    width, height = cell.width() - 2 * FRAME, cell.height() - 2 * FRAME - caption
    scale = max(min(width / picture.width(), height / picture.height()), 0.0)
    width, height = picture.width() * scale, picture.height() * scale
    # Frames on whole pixels are sharp.
    left = np.floor(cell.center().x() - width / 2 + TINY)
    top = np.floor(cell.center().y() - (height + caption) / 2 + TINY)
    return QRectF(QPointF(left, top), QPointF(left + width, top + height))


@cache
def cyclic_colors() -> list[int]:
    """Return 256 colours from -pi to pi that end as they begin: black, blue, white, red, black."""
    from matplotlib import colormaps

    table = colormaps["twilight_shifted"](np.arange(256) / 255, bytes=True).astype(np.uint32)
    packed = (255 << 24) | (table[:, 0] << 16) | (table[:, 1] << 8) | table[:, 2]
    return [int(color) for color in packed]


def phase_image(phase: NDArray[np.float32]) -> QImage:
    """Return wrapped phase in radians as a picture in cyclic colours, which owns its pixels."""
    turns = phase * np.float32(256 / (2 * np.pi))
    turns += np.float32(128)
    # Both ends of the turn are one colour, so that 256 is 0.
    indices = np.ascontiguousarray(turns.astype(np.int16).astype(np.uint8))
    height, width = indices.shape
    image = QImage(indices.tobytes(), width, height, width, QImage.Format.Format_Indexed8).copy()
    image.setColorTable(cyclic_colors())
    return image


SIDE = 64


def outline_image(mask: NDArray[np.bool_], size: QSize) -> QImage:
    """Return the rim of a mask (y, x) as a picture of that size, clear elsewhere."""
    rows = np.arange(size.height()) * mask.shape[0] // max(size.height(), 1)
    columns = np.arange(size.width()) * mask.shape[1] // max(size.width(), 1)
    sampled = mask[np.ix_(rows, columns)]
    rim = sampled & ~scipy.ndimage.binary_erosion(sampled, border_value=1)
    image = QImage(size, QImage.Format.Format_ARGB32)
    image.fill(Qt.GlobalColor.transparent)
    for y, x in np.argwhere(rim):
        image.setPixelColor(int(x), int(y), QColor(OBJECT_COLOUR))
    return image


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

    def show_frame(
        self,
        frame: NDArray[np.float32] | None,
        words: str,
        mask: NDArray[np.bool_] | None = None,
    ) -> None:
        """Show one frame.

        Parameters
        ----------
        frame : ndarray of shape (y, x), or None
            Wrapped phase in radians; None for no picture.
        words : str
            What there is to say.
        mask : ndarray of bool, same shape, optional
            The object, whose rim is drawn.
        """
        self.words.setText(words)
        if frame is None:
            self.picture.clear()
            return
        step = max(1, max(frame.shape) // (2 * SIDE))
        pixmap = QPixmap.fromImage(phase_image(frame[::step, ::step])).scaled(
            SIDE,
            SIDE,
            Qt.AspectRatioMode.KeepAspectRatio,
            Qt.TransformationMode.SmoothTransformation,
        )
        if mask is not None:
            painter = QPainter(pixmap)
            painter.drawImage(0, 0, outline_image(mask, pixmap.size()))
            painter.end()
        self.picture.setPixmap(pixmap)
