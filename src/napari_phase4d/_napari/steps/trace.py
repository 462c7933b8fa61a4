"""The tab of step 5 with the phase of one place over time and angle, by every method."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from qtpy.QtCore import QTimer

from napari_phase4d._napari.steps.step import Step
from napari_phase4d._napari.viewing.regions import newest_region
from napari_phase4d._napari.widgets.curves import CurvePlot, Panel
from napari_phase4d.analysis import traces
from napari_phase4d.plotting import named_results

__all__ = ["TracePart"]

#: The curves follow mouse and sliders, but no oftener than this.
EVERY_MS = 40


class TracePart(Step):
    """Curves of the pixel under the mouse, or of the region that was drawn last."""

    title = "Trace"
    summary = "Move the mouse over a result, or draw a region: its phase by every method."

    def build(self) -> None:
        """Make the widgets."""
        self._pixel: tuple[int, int] | None = None
        self.plot = CurvePlot()
        self.plot.setObjectName("trace_plot")
        self.plot.setMinimumHeight(180)
        self.column.addWidget(self.plot, 1)
        self.draw = self.button(
            "Draw a region",
            "draw_region",
            "Adds a layer to draw in. A region counts at all times and angles; the curves then "
            "show its mean, and step 5's Measure uses it too.",
            self.presenter.add_regions,
        )
        self.follow = self.button(
            "Follow the mouse", "follow_mouse", "Show the pixel under the mouse.", self.unpin
        )
        self.column.addLayout(self.row(self.draw, self.follow))
        self._mask: NDArray[np.bool_] | None = None
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(EVERY_MS)
        self._timer.timeout.connect(self._show)
        self.session.outcome_changed.connect(self._forget)
        self.session.recording_changed.connect(self._forget)
        self.session.truth_changed.connect(self._start)

    def cursor_moved(self) -> None:
        """Follow the mouse, unless a region is looked at."""
        if self.isVisible() and self._mask is None and self.session.results:
            pixel = self.presenter.current_pixel()
            if pixel is not None and pixel != self._pixel:
                self._pixel = pixel
                self._start()

    def frame_changed(self) -> None:
        """Follow the sliders."""
        self._start()

    def region_drawn(self) -> None:
        """Look at the region that was drawn last."""
        if self.session.reconstruction is None:
            return
        phase = self.session.needed_reconstruction()["phase"]
        self._mask = newest_region(self.presenter.viewer, phase)
        self._start()

    def unpin(self) -> None:
        """Follow the mouse again."""
        self._mask = None
        self._start()

    def showEvent(self, event: Any) -> None:  # noqa: N802 - Qt's name
        """Bring the curves up to date when the tab is opened."""
        super().showEvent(event)
        self._start()

    def _forget(self) -> None:
        self._mask = self._pixel = None
        self._start()

    def _start(self) -> None:
        if not self._timer.isActive():
            self._timer.start()

    def _show(self) -> None:
        """Draw the curves of the place that is looked at."""
        if not self.isVisible():
            return
        outcome = self.session.outcome
        where = self._mask if self._mask is not None else self._pixel
        if outcome is None or where is None:
            self.plot.message("Move the mouse over a result, or draw a region.")
            return
        if self.session.place is not None:
            self.plot.message("These results lie on disk; Measure gives curves of a region.")
            return
        stacks = named_results(outcome.comparison, self.session.truth)
        found = traces(stacks, self.presenter.current_frame(), where)
        time, angle = found.frame
        place = "mean of the region" if self._mask is not None else f"pixel {where}"
        panels = [
            Panel(
                found.times_s,
                found.over_time,
                f"time (s), at {found.angles_deg[angle]:g}°",
                "phase (rad)",
                float(found.times_s[time]),
            )
        ]
        if len(found.angles_deg) > 1:
            panels.append(
                Panel(
                    found.angles_deg,
                    found.over_angle,
                    f"angle (°), at {found.times_s[time]:.3g} s",
                    "",
                    float(found.angles_deg[angle]),
                )
            )
        self.plot.setToolTip(f"Phase of the {place}, by every method.")
        self.plot.show_traces(panels)
