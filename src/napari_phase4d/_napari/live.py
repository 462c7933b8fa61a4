"""A small dock of its own: phase on screen while a recording is written."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from napari.layers import Image
from napari.viewer import Viewer
from numpy.typing import NDArray
from qtpy.QtCore import QObject, Signal
from qtpy.QtWidgets import (
    QComboBox,
    QFileDialog,
    QFormLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QWidget,
)

from napari_phase4d._napari.jobs import sentence_of
from napari_phase4d._napari.preferences import own_optics
from napari_phase4d._napari.viewing.layers import phase_colormap, stack_layer
from napari_phase4d.pipeline import LiveStatus, Recipe, watch
from napari_phase4d.unwrapping import CAUSAL, METHODS

__all__ = ["LiveDock"]

#: The method that is chosen at first.
FIRST_METHOD = "temporal-angular"
#: Phase up to which colours reach until a frame is thicker.
FIRST_LIMITS = (-np.pi, np.pi)

FIELDS = {
    "source": ("watch", "A folder that gets an image a frame, a TIFF that gets pages, or a Zarr "
               "array that grows; it need not be there yet."),
    "recipe": ("recipe", "A recipe.json with lobes and settings of an earlier recording. Without "
               "one they are found on the first frames."),
    "angles": ("angles", "Viewing angles in degrees, such as -7, 21. Without them views are "
               "counted."),
    "results": ("results", "Folder for the results. Without one it is named like the recording, "
                "with _phase."),
}  # fmt: skip


class Tellings(QObject):  # type: ignore[misc]
    """What a thread tells the window."""

    began = Signal(object)
    arrived = Signal()
    status = Signal(str)
    told = Signal(str)
    ended = Signal(str)


class Watching:
    """A recording that is watched in a thread.

    Only the newest frame is kept for the window, which may be slower than the camera.

    Parameters
    ----------
    source, results : str
        What is watched, and where results go.
    recipe : Recipe
        All settings; the first of its methods is shown.
    """

    def __init__(self, source: str, recipe: Recipe, results: str) -> None:
        self.tellings = Tellings()
        self.method = recipe.methods[0]
        self._newest: tuple[int, NDArray[np.float32]] | None = None
        self._lock = threading.Lock()
        self._stop, self._silent = threading.Event(), threading.Event()
        self._work: Callable[[], Any] = lambda: watch(
            source,
            recipe,
            results,
            began=self._tell(self.tellings.began),
            arrived=self._arrived,
            told=self._tell(self.tellings.told),
            status=self._status,
            stopped=self._stop.is_set,
        )
        self.results = results
        self.thread = threading.Thread(target=self._run, name="live", daemon=True)

    def stop(self) -> None:
        """Take the recording as complete: what has come is finished and written."""
        self._stop.set()

    def leave(self) -> None:
        """End likewise, and tell nobody any more: the window is gone."""
        self._silent.set()
        self._stop.set()

    def newest(self) -> tuple[int, NDArray[np.float32]] | None:
        """Return the number and phase (angle, y, x) of the newest frame, once."""
        with self._lock:
            found, self._newest = self._newest, None
        return found

    def _tell(self, signal: Any) -> Callable[..., None]:
        def tell(*what: Any) -> None:
            if not self._silent.is_set():
                with suppress(RuntimeError):  # the window goes at this moment
                    signal.emit(*what)

        return tell

    def _arrived(self, index: int, results: Any) -> None:
        with self._lock:
            waiting = self._newest is not None
            self._newest = index, results[self.method].copy()
        if not waiting:
            self._tell(self.tellings.arrived)()

    def _status(self, status: LiveStatus) -> None:
        self._tell(self.tellings.status)(status.sentence)

    def _run(self) -> None:
        try:
            self._work()
            said = f"Results are in {self.results}; Open folder… in Phase 4D shows them."
        except Exception as error:  # shown, as nobody else hears of it in a thread
            said = sentence_of(error)
        self._tell(self.tellings.ended)(said)


class LiveDock(QWidget):  # type: ignore[misc]
    """What is watched, a button, and how far it is; the phase is a layer.

    Parameters
    ----------
    napari_viewer : napari.viewer.Viewer
        Where the layer goes.
    """

    def __init__(self, napari_viewer: Viewer) -> None:
        super().__init__()
        self.viewer = napari_viewer
        self.watching: Watching | None = None
        self.layer: Image | None = None
        #: Number of the frame on screen.
        self.shown = -1
        form = QFormLayout(self)
        self.fields: dict[str, QLineEdit] = {}
        for name, (label, words) in FIELDS.items():
            field = self.fields[name] = QLineEdit()
            field.setObjectName(f"live_{name}")
            field.setToolTip(words)
            field.setAccessibleName(label)
            form.addRow(label, self._with_button(field) if name == "source" else field)
        self.method = QComboBox()
        self.method.setObjectName("live_method")
        self.method.setAccessibleName("method")
        for name in CAUSAL:
            self.method.addItem(METHODS[name].label, name)
        self.method.setCurrentIndex(CAUSAL.index(FIRST_METHOD))
        form.addRow("method", self.method)
        self.go = QPushButton("Watch")
        self.go.setObjectName("live_go")
        self.go.clicked.connect(self._pressed)
        form.addRow(self.go)
        self.status, self.told = QLabel(), QLabel()
        for label in (self.status, self.told):
            label.setWordWrap(True)
            form.addRow(label)
        self.destroyed.connect(self._closed_by(lambda: self.watching))

    def _with_button(self, field: QLineEdit) -> QWidget:
        """Return a field with a button that chooses a folder."""
        button = QPushButton("Folder…")
        button.setObjectName("live_folder")
        button.clicked.connect(self._choose)
        both = QWidget()
        row = QHBoxLayout(both)
        row.setContentsMargins(0, 0, 0, 0)
        row.addWidget(field)
        row.addWidget(button)
        return both

    @staticmethod
    def _closed_by(watching: Callable[[], Watching | None]) -> Callable[..., None]:
        def close(*_: object) -> None:
            found = watching()
            if found is not None:
                found.leave()

        return close

    def _choose(self) -> None:
        found = QFileDialog.getExistingDirectory(self, "Folder that gets the frames")
        if found:
            self.fields["source"].setText(found)

    def _pressed(self) -> None:
        """Begin, or end well."""
        if self.watching is not None:
            self.go.setEnabled(False)
            self.told.setText("Finishing what has come …")
            self.watching.stop()
            return
        try:
            self.start()
        except (OSError, TypeError, ValueError) as error:
            self.told.setText(sentence_of(error))

    def start(self) -> None:
        """Watch what the fields say.

        Raises
        ------
        OSError, TypeError, ValueError
            If a field says what can't be.
        """
        source = self.text("source")
        if not source:
            msg = "Name a folder or file to watch."
            raise ValueError(msg)
        results = self.text("results") or f"{Path(source).with_suffix('')}_phase"
        watching = Watching(source, self.asked(), results)
        tellings = watching.tellings
        tellings.began.connect(self._began)
        tellings.arrived.connect(self._arrived)
        tellings.status.connect(self.status.setText)
        tellings.told.connect(self._told)
        tellings.ended.connect(self._ended)
        self.watching, self.layer, self.shown = watching, None, -1
        self.go.setText("Stop")
        self.status.setText("Waiting for the first frames …")
        self.told.clear()
        watching.thread.start()

    def text(self, name: str) -> str:
        """Return what stands in a field."""
        return str(self.fields[name].text()).strip()

    def asked(self) -> Recipe:
        """Return the recipe that the fields ask for."""
        given = self.text("recipe")
        recipe = Recipe.from_file(given) if given else Recipe(optics=own_optics())
        words = self.text("angles").replace(",", " ").split()
        try:
            angles = tuple(float(word) for word in words)
        except ValueError as error:
            msg = f"Angles are numbers in degrees, such as -7, 21, but {self.text('angles')!r}."
            raise ValueError(msg) from error
        recipe = recipe.changed(methods=(self.method.currentData(),))
        return recipe.changed(angles_deg=angles) if angles else recipe

    def _began(self, data: xr.Dataset) -> None:
        """Add the layer, in which nothing is known yet."""
        assert self.watching is not None
        label = METHODS[self.watching.method].label
        phase = data["phase"].copy(data=np.zeros(data["phase"].shape, np.float32))
        values, keywords, _ = stack_layer(phase, f"live, {label}", "unwrapped")
        keywords |= {
            "contrast_limits": FIRST_LIMITS,
            "colormap": phase_colormap(FIRST_LIMITS),
        }
        self.layer = self.viewer.add_image(values, **keywords)

    def _arrived(self) -> None:
        """Show the newest frame."""
        newest = None if self.watching is None else self.watching.newest()
        if newest is None or self.layer is None or self.layer not in self.viewer.layers:
            return
        self.shown, phase = newest
        self.layer.data = phase[None]
        known = phase[np.isfinite(phase)]
        low, high = self.layer.contrast_limits
        if known.size and (known.max() > high or known.min() < low):
            limits = (min(low, float(known.min())), max(high, float(known.max())))
            self.layer.contrast_limits_range = limits
            self.layer.contrast_limits = limits
            self.layer.colormap = phase_colormap(limits)

    def _told(self, line: str) -> None:
        self.told.setText(f"{line[:1].upper()}{line[1:]}.")

    def _ended(self, said: str) -> None:
        self._arrived()
        self.watching = None
        self.go.setText("Watch")
        self.go.setEnabled(True)
        self.told.setText(said)
