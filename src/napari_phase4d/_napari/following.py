"""Following the viewer: its sliders, the mouse over it, and regions that are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from napari.layers import Shapes

__all__ = ["Following"]

#: Kinds of event after which a layer's data are new.
DONE_ACTIONS = ("added", "changed", "removed")


class Following:
    """Tells the steps when the sliders or the mouse have moved, until `stop` is called.

    Parameters
    ----------
    viewer : napari.viewer.Viewer
        What to follow.
    steps : sequence of Step
        A step with ``frame_changed()`` or ``cursor_moved()`` is told.
    """

    def __init__(self, viewer: Any, steps: Sequence[Any]) -> None:
        self._viewer = viewer
        self._steps = steps
        self._regions: list[Any] = []
        self._drawn: Callable[[Any], None] | None = None
        self._stopped = False
        viewer.dims.events.current_step.connect(self._frame_changed)
        viewer.mouse_move_callbacks.append(self._cursor_moved)

    def stop(self, *_: object) -> None:
        """Let go of the viewer."""
        if self._stopped:
            return
        self._stopped = True
        self._viewer.dims.events.current_step.disconnect(self._frame_changed)
        if self._cursor_moved in self._viewer.mouse_move_callbacks:
            self._viewer.mouse_move_callbacks.remove(self._cursor_moved)
        for layer in self._regions:
            layer.events.data.disconnect(self._region_changed)
        self._regions = []

    def watch_regions(self, drawn: Callable[[Any], None]) -> None:
        """Call a function with the layer whenever a shape in it is drawn, changed or removed."""
        self._drawn = drawn
        for layer in self._viewer.layers:
            if isinstance(layer, Shapes) and not any(layer is known for known in self._regions):
                layer.events.data.connect(self._region_changed)
                self._regions.append(layer)

    def _frame_changed(self, event: Any = None) -> None:
        for step in self._steps:
            if hasattr(step, "frame_changed"):
                step.frame_changed()

    def _cursor_moved(self, viewer: Any, event: Any) -> None:
        for step in self._steps:
            if hasattr(step, "cursor_moved"):
                step.cursor_moved()

    def _region_changed(self, event: Any) -> None:
        # "adding" and the like come first, when the data are still those from before.
        if self._drawn is not None and str(getattr(event.action, "value", "")) in DONE_ACTIONS:
            self._drawn(event.source)
