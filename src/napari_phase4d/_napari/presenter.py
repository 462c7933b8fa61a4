"""What the session's results look like in the viewer."""

from __future__ import annotations

from typing import Any

from napari_phase4d._napari.layers import (
    METADATA_KEY,
    LayerTuple,
    hologram_layer,
    stack_layer,
)
from napari_phase4d._napari.session import Session
from napari_phase4d.evaluation import Comparison
from napari_phase4d.unwrapping import METHODS

__all__ = ["Presenter"]

#: What results side by side share.
LINKED = ("contrast_limits", "colormap", "gamma")
#: Width and height in pixels, and size of its numbers in points.
COLORBAR_SIZE, COLORBAR_FONT = (9.0, 70.0), 8.0


class Presenter:
    """Adds a layer for everything the session finds, and arranges them.

    Parameters
    ----------
    viewer : napari.viewer.ViewerModel
        Where the layers go; only its public model is used.
    session : Session
        What to show.
    """

    def __init__(self, viewer: Any, session: Session) -> None:
        self.viewer = viewer
        self.session = session
        session.recording_changed.connect(self.show_recording)
        session.reconstruction_changed.connect(self.show_phase)
        session.results_added.connect(self.show_results)

    def add(self, layer: LayerTuple) -> Any:
        """Add a layer on top."""
        data, keywords, _ = layer
        return self.viewer.add_image(data, **keywords)

    def show_recording(self) -> None:
        """Show the frames of the recording, unless a layer shows them already."""
        recording = self.session.needed_recording()
        frames = recording.holograms.data
        for layer in self.viewer.layers:
            if layer.data is frames or same_frames(layer, recording.name):
                layer.visible = True
                return
        self.hide_all()
        self.add(hologram_layer(recording))
        self.viewer.canvas.overlays.scale_bar.visible = True
        self.go_to(0, 0)

    def show_phase(self) -> None:
        """Show the wrapped phase; the amplitude is added, hidden."""
        data = self.session.reconstruction
        if data is None:
            return
        self.hide_all()
        name = self.session.needed_recording().name
        self.add(stack_layer(data["amplitude"], f"amplitude, {name}", "amplitude", visible=False))
        self.add(stack_layer(data["phase"], f"wrapped phase, {name}", "wrapped"))
        self.viewer.reset_view()
        self.go_to(*self.session.recipe.boundary[0])

    def show_results(self, comparison: Comparison) -> None:
        """Show the results side by side, as new layers."""
        for method, result in comparison.results.items():
            self.add(stack_layer(result, METHODS[method].label, "unwrapped"))
        self.side_by_side()

    def results(self) -> list[Any]:
        """Return the layers of unwrapped phase, oldest first."""
        return [la for la in self.viewer.layers if kind_of(la) == "unwrapped"]

    def side_by_side(self) -> None:
        """Show the newest results of every method in a grid, with one contrast for all."""
        newest = list({note_of(la).get("method"): la for la in self.results()}.values())
        if not newest:
            return
        self.hide_all()
        low = min(la.contrast_limits[0] for la in newest)
        high = max(la.contrast_limits[1] for la in newest)
        for layer in newest:
            layer.visible = True
            layer.name_overlay.visible = True
            show_small_colorbar(layer)
            layer.contrast_limits_range = (
                min(low, layer.contrast_limits_range[0]),
                max(high, layer.contrast_limits_range[1]),
            )
            layer.contrast_limits = (low, high)
        self.viewer.layers.unlink_layers(newest)
        self.viewer.layers.link_layers(newest, LINKED)
        self.viewer.canvas.grid.enabled = len(newest) > 1
        self.viewer.canvas.overlays.current_slice.visible = True
        self.viewer.reset_view()

    def one_at_a_time(self) -> None:
        """Leave the grid; the newest result is shown alone."""
        self.viewer.canvas.grid.enabled = False
        results = self.results()
        if results:
            self.hide_all()
            results[-1].visible = True
        self.viewer.reset_view()

    def hide_all(self) -> None:
        """Hide every layer and leave the grid."""
        self.viewer.canvas.grid.enabled = False
        for layer in self.viewer.layers:
            layer.visible = False

    def current_frame(self) -> tuple[int, int]:
        """Return the (time, angle) numbers that the sliders show, within the reconstruction."""
        data = self.session.reconstruction
        if data is None:
            return (0, 0)
        found = []
        for axis, n in zip(("time", "angle"), data["phase"].shape[:2], strict=True):
            labels = list(self.viewer.dims.axis_labels)
            step = self.viewer.dims.current_step[labels.index(axis)] if axis in labels else 0
            found.append(min(int(step), n - 1))
        return found[0], found[1]

    def go_to(self, time: int, angle: int) -> None:
        """Move the sliders to a frame."""
        labels = list(self.viewer.dims.axis_labels)
        for axis, step in (("time", time), ("angle", angle)):
            if axis in labels:
                self.viewer.dims.set_current_step(labels.index(axis), step)


def show_small_colorbar(layer: Any) -> None:
    """Show a colour bar that leaves the picture free, also in a small cell of the grid."""
    layer.colorbar.size = COLORBAR_SIZE
    layer.colorbar.font_size = COLORBAR_FONT
    layer.colorbar.box = False
    layer.colorbar.visible = True


def note_of(layer: Any) -> dict[str, Any]:
    """Return what the plugin noted in a layer."""
    note = layer.metadata.get(METADATA_KEY, {})
    return note if isinstance(note, dict) else {}


def kind_of(layer: Any) -> str | None:
    """Return what a layer of this plugin is."""
    kind = note_of(layer).get("kind")
    return None if kind is None else str(kind)


def same_frames(layer: Any, name: str) -> bool:
    """Say whether a layer shows the holograms of a recording."""
    return kind_of(layer) == "holograms" and layer.name == name
