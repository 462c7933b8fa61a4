"""Asking how the frames lie in a raw camera file, which does not say it."""

from __future__ import annotations

from pathlib import Path

from qtpy.QtWidgets import (
    QComboBox,
    QDialog,
    QDialogButtonBox,
    QFormLayout,
    QLabel,
    QSpinBox,
    QWidget,
)

from napari_phase4d.io import RawLayout
from napari_phase4d.io.raw import KINDS
from napari_phase4d.io.video import LARGEST_SIDE

__all__ = ["RawDialog"]

LARGEST_HEADER = 2**30


class RawDialog(QDialog):  # type: ignore[misc]
    """Height, width, type and header of raw frames; says how many frames that makes.

    Parameters
    ----------
    path : Path
        The file.
    before : RawLayout, optional
        What was typed in for an earlier file.
    parent : QWidget, optional
        The widget that asks.
    """

    def __init__(
        self, path: Path, before: RawLayout | None = None, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.setWindowTitle(f"Frames of {path.name}")
        self._bytes = path.stat().st_size
        form = QFormLayout(self)
        words = QLabel(f"{path.name} is raw: it does not say how its frames lie in it.")
        words.setWordWrap(True)
        form.addRow(words)
        usual = before or RawLayout(512, 512)
        self.height_box = self._number("raw_height", usual.height, 1, LARGEST_SIDE)
        self.width_box = self._number("raw_width", usual.width, 1, LARGEST_SIDE)
        self.header_box = self._number("raw_header", usual.header_bytes, 0, LARGEST_HEADER)
        self.kind = QComboBox()
        self.kind.setObjectName("raw_kind")
        self.kind.addItems(KINDS)
        self.kind.setCurrentText(usual.dtype)
        form.addRow("Height", self.height_box)
        form.addRow("Width", self.width_box)
        form.addRow("Pixels are", self.kind)
        form.addRow("Header (bytes)", self.header_box)
        self.verdict = QLabel()
        self.verdict.setObjectName("raw_verdict")
        form.addRow(self.verdict)
        kinds = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(kinds.Open | kinds.Cancel)
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)
        form.addRow(self.buttons)
        for box in (self.height_box, self.width_box, self.header_box):
            box.valueChanged.connect(self._judge)
        self.kind.currentTextChanged.connect(self._judge)
        self._judge()

    def layout_of_frames(self) -> RawLayout:
        """Return what is typed in."""
        return RawLayout(
            self.height_box.value(),
            self.width_box.value(),
            self.kind.currentText(),
            header_bytes=self.header_box.value(),
        )

    def _number(self, name: str, value: int, low: int, high: int) -> QSpinBox:
        box = QSpinBox()
        box.setObjectName(name)
        box.setRange(low, high)
        box.setValue(value)
        return box

    def _judge(self) -> None:
        """Say how many frames there are then, and how many bytes are left over."""
        frames, left = divmod(
            max(self._bytes - self.header_box.value(), 0), self.layout_of_frames().frame_bytes
        )
        self.verdict.setText(f"makes {frames} frames; {left} bytes are left over")
        self.buttons.button(QDialogButtonBox.StandardButton.Open).setEnabled(frames > 0)
