"""The part of step 1 that watches a recording while it is written."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from qtpy.QtWidgets import (
    QDialog,
    QDialogButtonBox,
    QDoubleSpinBox,
    QFileDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QWidget,
)

from napari_phase4d._napari.preferences import own_optics
from napari_phase4d._napari.session import LiveView, Plan, folder_without_results, plan_watching
from napari_phase4d._napari.session.live_plans import PATIENCE_S
from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.viewing.live import LiveLayers

__all__ = ["LivePart", "WatchDialog"]

#: The most of seconds without a new frame that can be waited for.
LONGEST_S = 86_400.0
GROWING = "TIFF that gets pages (*.tif *.tiff *.btf);;All files (*)"


class LivePart(Step):
    """Watches a recording grow: the newest frame in the viewer, the numbers in a line."""

    title = "Watch"

    def build(self) -> None:
        """Make the widgets."""
        self._layers = LiveLayers(self.presenter)
        self._stop = threading.Event()
        self._watching = False
        self.begin = self.button(
            "Watch…",
            "watch",
            "See the phase while the camera records: a folder that gets an image a frame, a TIFF "
            "that gets pages, or a Zarr array that grows, by the settings of all steps.",
            self._ask,
        )
        self.line = self.text("", "live_line")
        self.stop = self.button(
            "Stop and keep the results",
            "stop_watching",
            "Waits for no more frames, finishes those that have come and writes the results; "
            "Cancel below writes nothing.",
            self.finish,
        )
        self.column.addWidget(self.line)
        self.column.addWidget(self.stop)
        self.hide()
        self.session.live_changed.connect(self._show)
        self.jobs.finished.connect(self._ended)
        self.jobs.cancelled.connect(self._ended)
        self.jobs.failed.connect(self._ended)

    def watch(
        self,
        source: str | Path,
        out: str | Path,
        *,
        frames: int | None = None,
        patience_s: float = PATIENCE_S,
    ) -> None:
        """Work on a recording while it is written, in a thread.

        Parameters
        ----------
        source : str or Path
            A folder or file that grows; it need not be there yet.
        out : str or Path
            Folder for the results.
        frames : int, optional
            End after so many frames. Default: as many as come.
        patience_s : float, optional
            End after so many seconds without a new frame.
        """
        stop = threading.Event()
        plan = plan_watching(
            self.session,
            source,
            out,
            frames=frames,
            patience_s=patience_s,
            optics=own_optics(),
            stopped=stop.is_set,
        )
        self.jobs.start(replace(plan, receive=partial(self._take, plan)))
        self._stop, self._watching = stop, True
        self.line.setText(f"Waiting for frames in {Path(source).name} …")
        self.stop.setEnabled(True)
        self.show()

    def finish(self) -> None:
        """Wait for no more frames; what has come is finished and written."""
        self._stop.set()
        self.stop.setEnabled(False)

    def _ask(self) -> None:
        if self.jobs.running:
            msg = "another job is still running; wait for it or press Cancel"
            raise ValueError(msg)
        dialog = WatchDialog(self)
        if dialog.exec():
            self.watch(dialog.source(), dialog.out(), patience_s=dialog.patience.value())

    def _show(self, view: LiveView) -> None:
        """Show what is newest."""
        told = f"<br>{view.line[:1].upper()}{view.line[1:]}." if view.line else ""
        now_s, shown = time.monotonic(), self._layers.show(view)
        view = replace(view, not_shown=view.not_shown + self._layers.passed_over)
        headline = view.headline(now_s, shown=shown)
        self.line.setText(f"<b>● {headline}</b><br>{view.sentence}{told}")

    def _take(self, plan: Plan, outcome: Any) -> Iterator[None]:
        """Let the results take the place of the newest frame."""
        yield from self._layers.leaving()
        yield from plan.receive(outcome) or ()
        self._layers.forget()

    def _ended(self, *_: object) -> None:
        """Tidy up, however it ended."""
        if not self._watching:
            return
        self._watching = False
        self.hide()
        self._layers.remove()
        self._layers.restore()


class WatchDialog(QDialog):  # type: ignore[misc]
    """Asks what is watched, where its results go, and when it is complete.

    Parameters
    ----------
    parent : QWidget, optional
        The widget that asks.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Watch a recording")
        form = QFormLayout(self)
        words = QLabel(
            "Phase is computed as frames come, by the settings of all steps. What is watched need "
            "not be there yet; the object should be thin in the first frame."
        )
        words.setWordWrap(True)
        form.addRow(words)
        self.source_line = self._line("watch_source", "Recording that is written")
        self.out_line = self._line("watch_out", "Folder for the results")
        choices = [
            self._button("Folder…", "watch_folder", "Choose a folder or Zarr", self._ask_folder),
            self._button("File…", "watch_file", "Choose a TIFF that gets pages", self._ask_file),
        ]
        form.addRow("Recording", self._row(self.source_line, *choices))
        where = self._button("Folder…", "watch_out_folder", "Choose a folder", self._ask_out)
        form.addRow("Results", self._row(self.out_line, where))
        self.patience = QDoubleSpinBox()
        self.patience.setObjectName("watch_patience")
        self.patience.setAccessibleName("Ends after so many seconds without a frame")
        self.patience.setRange(1.0, LONGEST_S)
        self.patience.setDecimals(0)
        self.patience.setValue(PATIENCE_S)
        self.patience.setSuffix(" s without a new frame")
        form.addRow("Ends after", self.patience)
        kinds = QDialogButtonBox.StandardButton
        self.buttons = QDialogButtonBox(kinds.Ok | kinds.Cancel)
        self.buttons.button(kinds.Ok).setText("Watch")
        self.buttons.accepted.connect(self.accept)
        self.buttons.rejected.connect(self.reject)
        form.addRow(self.buttons)
        self._suggested = ""
        self.source_line.textChanged.connect(self._suggest)
        self.out_line.textChanged.connect(self._judge)
        self._judge()

    def source(self) -> Path:
        """Return what is watched."""
        return Path(self.source_line.text().strip()).expanduser()

    def out(self) -> Path:
        """Return where the results go: not where those of another run are."""
        out = Path(self.out_line.text().strip()).expanduser()
        return folder_without_results(out, str(self.source()))

    def _line(self, name: str, words: str) -> QLineEdit:
        line = QLineEdit()
        line.setObjectName(name)
        line.setAccessibleName(words)
        line.setMinimumWidth(320)
        return line

    def _button(
        self, words: str, name: str, tooltip: str, clicked: Callable[[], None]
    ) -> QPushButton:
        button = QPushButton(words)
        button.setObjectName(name)
        button.setToolTip(tooltip)
        button.setAccessibleDescription(tooltip)
        button.setAutoDefault(False)  # Return in a line is for Watch
        button.clicked.connect(lambda: clicked())
        return button

    def _row(self, *widgets: QWidget) -> QHBoxLayout:
        row = QHBoxLayout()
        for widget in widgets:
            row.addWidget(widget)
        return row

    def _ask_folder(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder or Zarr that is written")
        if path:
            self.source_line.setText(path)

    def _ask_file(self) -> None:
        path, _ = QFileDialog.getOpenFileName(self, "TIFF that is written", "", GROWING)
        if path:
            self.source_line.setText(path)

    def _ask_out(self) -> None:
        path = QFileDialog.getExistingDirectory(self, "Folder for the results")
        if path:
            self.out_line.setText(path)

    def _suggest(self) -> None:
        """Suggest a folder beside the recording, unless another one was typed in."""
        if self.out_line.text() == self._suggested:
            text, source = self.source_line.text().strip(), self.source()
            beside = source.with_name(f"{source.stem}_phase") if source.name else source
            self._suggested = str(beside) if text else ""
            self.out_line.setText(self._suggested)
        self._judge()

    def _judge(self) -> None:
        """Let Watch be pressed once both are known."""
        known = bool(self.source_line.text().strip() and self.out_line.text().strip())
        self.buttons.button(QDialogButtonBox.StandardButton.Ok).setEnabled(known)
