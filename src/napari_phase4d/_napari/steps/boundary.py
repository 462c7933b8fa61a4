"""The part of step 4 that says from which frame to start: map, thumbnail, suggestion."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from magicgui.widgets import ComboBox
from qtpy.QtCore import Qt

from napari_phase4d._napari.session import plan_scores
from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.widgets.boundary_map import BoundaryMap
from napari_phase4d._napari.widgets.thumbnail import Thumbnail
from napari_phase4d.pipeline import start_words
from napari_phase4d.unwrapping import METHODS, ORDERS, best_frame, scores_sentence

__all__ = ["BoundaryPart"]

MANY_METHODS_PATH = "temporal-angular"
#: Along what each method goes, and in which order.
WAYS = "; ".join(f"{METHODS[name].label}: {', then '.join(dims)}" for name, dims in ORDERS.items())


class BoundaryPart(Step):
    """Times and angles as a map: click on a frame in which the object is thin."""

    title = "Boundary"
    purpose = (
        "The methods start from the safest frame, the star. Click on another one in which the "
        "object is thin to start from that; Shift-click adds one more."
    )

    def build(self) -> None:
        """Make the widgets."""
        self.column.setContentsMargins(0, 0, 0, 0)
        self._shown: xr.Dataset | None = None
        self.map = BoundaryMap()
        self.map.setObjectName("boundary_map")
        self.column.addWidget(self.map)
        self.start = self.text("", "start_words")
        self.column.addWidget(self.start)
        self.thumbnail = Thumbnail()
        self.column.addWidget(self.thumbnail)
        self.use_view = self.button(
            "Use current view",
            "use_view",
            "Start from the frame that the sliders show.",
            self.use_current,
        )
        self.automatic = self.button(
            "Automatic",
            "automatic",
            "Start from the safest frame again, the star, and show it: that on which the frame "
            "alone and all frames together agree most.",
            self.start_automatically,
        )
        self.path = self.watched(
            ComboBox(
                name="path",
                choices=[(METHODS[method].label, method) for method in ORDERS],
                value=MANY_METHODS_PATH,
                tooltip="Whose way through the frames is drawn: first pass blue, second red. "
                f"{WAYS}.",
            )
        )
        self.column.addLayout(self.row(self.use_view, self.automatic))
        self.column.addLayout(self.row(self.label("Arrows: the way of"), self.path.native))
        self.path.changed.connect(lambda _: self._show_path())
        self.map.frame_clicked.connect(
            lambda t, a, more: self.guarded(lambda: self._clicked(t, a, more=more))
        )
        self.map.frame_hovered.connect(self._describe)
        self.map.left.connect(self._describe_boundary)
        self.session.reconstruction_changed.connect(self._show)
        self.session.calibration_changed.connect(self._show)
        self.session.scores_changed.connect(self._show)
        self.session.recipe_changed.connect(self._show_boundary)
        self.session.recording_changed.connect(self._show)
        self._show()
        self._show_path()

    def frame_changed(self) -> None:
        """Outline the frame that the sliders show."""
        if self._shows_present_frames():
            self.map.set_current(self.presenter.current_frame())

    def _shows_present_frames(self) -> bool:
        """Say whether the map has been told of the phase that there is now."""
        data = self.session.reconstruction
        return data is not None and data is self._shown

    def use_current(self) -> None:
        """Start from the frame that the sliders show."""
        self.session.update(boundary=(self.presenter.current_frame(),))

    def start_automatically(self) -> None:
        """Start from the safest frame again, which may have to be looked for first."""
        self.session.needed_reconstruction()
        self.session.update(boundary="auto")
        if self.session.scores is None:
            self.jobs.start(plan_scores(self.session), then=self._show_best)
        else:
            self._show_best()

    def _show_best(self) -> None:
        scores = self.session.scores
        if scores is not None:
            self.presenter.go_to(*best_frame(scores))
            self.said.emit(f"{self.words_on_the_start()} {scores_sentence(scores)}")

    def words_on_the_start(self) -> str:
        """Say which frame a run would start from, and who chose it."""
        if self.session.reconstruction is None:
            return ""
        frames = self.session.start_frames
        if not frames:
            return "Start: the safest frame, which is being looked for …"
        return start_words(frames, found=self.session.recipe.boundary == "auto")

    def _clicked(self, time: int, angle: int, *, more: bool) -> None:
        """Start from the frame that was clicked on, or from that one too; show it."""
        boundary = self.session.start_frames
        if not more:
            boundary = ((time, angle),)
        elif (time, angle) not in boundary:
            boundary = (*boundary, (time, angle))
        elif len(boundary) > 1:
            boundary = tuple(frame for frame in boundary if frame != (time, angle))
        self.session.update(boundary=boundary)
        self.presenter.go_to(time, angle)
        self._describe(time, angle)

    def _show(self) -> None:
        """Show the frames that there are, with their scores."""
        data = self._shown = self.session.reconstruction
        self.start.setText(self.words_on_the_start())
        self.map.setEnabled(data is not None)
        if data is None:
            self.map.set_frames([], [])
            self.thumbnail.show_frame(None, "The frames appear here once there is phase.")
            return
        self.map.set_frames(data["time"].values, data["angle"].values)
        scores = self.session.scores
        self.map.set_scores(None if scores is None else scores.values)
        self.map.set_best(None if scores is None else tuple(scores.attrs["best"]))
        self.map.setCursor(Qt.CursorShape.PointingHandCursor)
        self._show_boundary()
        self.frame_changed()

    def _show_boundary(self) -> None:
        if self._shows_present_frames():
            self.start.setText(self.words_on_the_start())
            self.map.set_boundaries(list(self.session.start_frames))
            self._describe_boundary()

    def _show_path(self) -> None:
        self.map.set_path(self.path.value)

    def show_path_of(self, method: str) -> None:
        """Draw the path of a method, where it has one."""
        if method in ORDERS:
            self.path.value = method

    def _describe_boundary(self) -> None:
        if self._shows_present_frames() and self.session.reconstruction is not None:
            time, angle = next(iter(self.session.start_frames), self.presenter.current_frame())
            shape = self.session.reconstruction["phase"].shape
            self._describe(min(time, shape[0] - 1), min(angle, shape[1] - 1))

    def _describe(self, time: int, angle: int) -> None:
        """Show one frame and say how safe it is."""
        data = self.session.reconstruction
        if data is None:
            return
        phase = data["phase"]
        chosen = (time, angle) in self.session.start_frames
        lines = [
            f"<b>{'Start: ' if chosen else ''}time {time} ({float(phase['time'][time]):.3g} s), "
            f"angle {float(phase['angle'][angle]):g}°</b>",
            words_on_score(self.session.scores, time, angle),
        ]
        self.thumbnail.show_frame(np.asarray(phase.data[time, angle]), "<br>".join(lines))


def words_on_score(scores: Any, time: int, angle: int) -> str:
    """Say how safe a frame is, and why."""
    if scores is None:
        return "Its safety is being looked at …"
    score = float(scores.values[time, angle])
    best = (time, angle) == tuple(scores.attrs["best"])
    verdict = "safe" if score > 0.99 else "rather safe" if score > 0.95 else "not safe"
    if best:
        verdict = "the safest"
    return (
        f"Score {score:.3f}, {verdict}: {scores.attrs['basis']} agree on about "
        f"{100 * score:.1f} % of the object."
    )
