"""What the session's results look like in the viewer."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from napari_phase4d._napari.layers import (
    METADATA_KEY,
    LayerTuple,
    hologram_layer,
    recalibrate_layer,
    spread_over_angles,
    stack_layer,
    step_of,
)
from napari_phase4d._napari.session import Session
from napari_phase4d.unwrapping import METHODS

__all__ = ["Presenter"]

#: Name of the layer that shows the truth.
EXACT = "exact"
#: What results side by side share.
LINKED = ("contrast_limits", "colormap", "gamma")
#: More results than this in the grid get small labels.
CROWD = 6
#: Size of a name in points; width and height of a colour bar in pixels, and of its numbers in
#: points: first the usual ones, then the small ones.
NAME_FONT = (10.0, 8.0)
COLORBAR_SIZE, COLORBAR_FONT = ((9.0, 70.0), (6.0, 40.0)), (8.0, 6.0)


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
        #: The layer that shows the frames of the recording.
        self.holograms: Any = None
        #: All layers made of the present recording, and the pixel that they were made with.
        self._own: list[Any] = []
        self._pixel_um = 1.0
        self._adopted: tuple[object, Any] | None = None
        self._exact: Any = None
        #: Layers of unwrapped phase of the present recording: method id -> newest layer.
        self._results: dict[str, Any] = {}
        session.recording_changed.connect(self.show_recording)
        session.calibration_changed.connect(self.show_calibration)
        session.reconstruction_changed.connect(self.show_phase)
        session.outcome_changed.connect(self.show_outcome)
        session.margin_changed.connect(self.show_margin)
        session.confidence_changed.connect(self.show_confidence)

    def adopt(self, stack: object, layer: Any) -> None:
        """Note that a layer already shows a recording or phase, so that none is added for it."""
        self._adopted = (stack, layer)

    def adopted(self, stack: object) -> Any | None:
        """Return the layer that already shows a stack, now visible, or None."""
        if self._adopted is None or self._adopted[0] is not stack:
            return None
        layer, self._adopted = self._adopted[1], None
        layer.visible = True
        self._own.append(layer)
        return layer

    def add(self, layer: LayerTuple) -> Any:
        """Add a layer on top."""
        data, keywords, _ = layer
        added = self.viewer.add_image(data, **keywords)
        self._own.append(added)
        return added

    def show_recording(self) -> None:
        """Show the frames of the recording, in the layer it came from or in a new one."""
        recording = self.session.recording
        self._results, self._own, self.holograms = {}, [], None
        self.hide_all()
        if recording is None:
            return
        self._pixel_um = recording.optics.pixel_um
        self.holograms = self.adopted(recording) or self.add(hologram_layer(recording))
        self.viewer.canvas.overlays.scale_bar.visible = True
        self._fit()
        self._go_to_start()

    def show_calibration(self) -> None:
        """Give all layers of the recording its new scale."""
        recording = self.session.needed_recording()
        for layer in self._own:
            if layer in self.viewer.layers:
                recalibrate_layer(layer, recording, self._pixel_um)
        self._pixel_um = recording.optics.pixel_um
        self._fit()

    def show_phase(self) -> None:
        """Show the wrapped phase; the amplitude is added, hidden."""
        data = self.session.needed_reconstruction()
        self._results = {}
        self.hide_all()
        name = self.session.name
        if self.holograms in self.viewer.layers:
            spread_over_angles(self.holograms, data["angle"].values)
        if "amplitude" in data:
            amplitude = stack_layer(data["amplitude"], f"amplitude, {name}", "amplitude")
            self.add(amplitude).visible = False
        if self.adopted(data["phase"].data) is None:
            self.add(stack_layer(data["phase"], f"wrapped phase, {name}", "wrapped"))
        self.viewer.canvas.overlays.scale_bar.visible = True
        self._fit()
        self.go_to(*self.session.recipe.boundary[0])

    def show_outcome(self) -> None:
        """Show the results side by side, as new layers, after the truth where it is known."""
        self._results = {}
        comparison = self.session.needed_outcome().comparison
        truth = self.session.truth
        if truth is not None:
            shown = self._exact
            if shown is None or shown not in self.viewer.layers or shown.data is not truth.data:
                shown = self._exact = self.add(stack_layer(truth, EXACT, "exact"))
            self._results[EXACT] = shown
        for method, result in comparison.results.items():
            name = str(comparison.table["method"][method])
            self._results[method] = self.add(stack_layer(result, name, "unwrapped"))
        self.side_by_side()

    def show_margin(self) -> None:
        """Show where steps are too large, one layer for each dimension, side by side."""
        margin = self.session.margin
        if margin is None:
            return
        self.hide_all()
        layers = [
            self.add(stack_layer(stack, f"step {str(name).replace('_', ' ')}", "margin"))
            for name, stack in margin.data_vars.items()
        ]
        self._arrange(layers)

    def show_confidence(self) -> None:
        """Show how far each result is to be trusted, side by side."""
        if not self.session.confidence:
            return
        self.hide_all()
        labels = self.session.needed_outcome().comparison.table["method"]
        layers = [
            self.add(stack_layer(stack, f"trust in {labels[method]}", "confidence"))
            for method, stack in self.session.confidence.items()
        ]
        self._arrange(layers)

    def results(self) -> list[Any]:
        """Return the truth, where it is known, and the newest layer of every method in order."""
        layers = (self._results.get(name) for name in (EXACT, *METHODS))
        return [la for la in layers if la is not None and la in self.viewer.layers]

    def side_by_side(self) -> None:
        """Show the newest results of every method in a grid, with one contrast for all."""
        newest = self.results()
        if not newest:
            msg = "there are no results to show yet; press Run in step 4"
            raise ValueError(msg)
        self.hide_all()
        low, high = common_contrast(newest, self._results.get(EXACT))
        self._arrange(newest)
        for layer in newest:
            layer.contrast_limits_range = (
                min(low, layer.contrast_limits_range[0]),
                max(high, layer.contrast_limits_range[1]),
            )
            layer.contrast_limits = (low, high)
        self.viewer.layers.unlink_layers(newest)
        self.viewer.layers.link_layers(newest, LINKED)

    def _arrange(self, layers: list[Any]) -> None:
        """Show some layers in a grid, each with its name and colour bar."""
        for layer in layers:
            layer.visible = True
            show_labels(layer, small=len(layers) > CROWD)
        self.viewer.canvas.grid.enabled = len(layers) > 1
        self.viewer.canvas.overlays.current_slice.visible = True
        self._fit()

    def one_at_a_time(self) -> None:
        """Leave the grid; the newest result is shown alone."""
        results = self.results()
        if not results:
            msg = "there are no results to show yet; press Run in step 4"
            raise ValueError(msg)
        self.hide_all()
        results[-1].visible = True
        self._fit()

    def hide_all(self) -> None:
        """Hide every layer of this plugin and leave the grid; other layers stay as they are."""
        self.viewer.canvas.grid.enabled = False
        for layer in self.viewer.layers:
            if METADATA_KEY in layer.metadata:
                layer.visible = False

    def _fit(self) -> None:
        """Fill the canvas with what is visible; larger layers of other recordings do not count."""
        self.viewer.reset_view(layers=[la for la in self.viewer.layers if la.visible] or None)

    def current_frame(self) -> tuple[int, int]:
        """Return the (time, angle) numbers of the frame that is on screen."""
        phase = self.session.needed_reconstruction()["phase"]
        labels = list(self.viewer.dims.axis_labels)
        found = []
        for axis in ("time", "angle"):
            origin, step, n = axis_steps(phase, axis)
            world = self.viewer.dims.point[labels.index(axis)] if axis in labels else origin
            found.append(int(np.clip(round((world - origin) / step), 0, n - 1)))
        return found[0], found[1]

    def go_to(self, time: int, angle: int) -> None:
        """Move the sliders to a frame of the reconstruction."""
        phase = self.session.needed_reconstruction()["phase"]
        labels = list(self.viewer.dims.axis_labels)
        for axis, number in (("time", time), ("angle", angle)):
            if axis in labels:
                origin, step, _ = axis_steps(phase, axis)
                self.viewer.dims.set_point(labels.index(axis), origin + number * step)

    def _go_to_start(self) -> None:
        """Move the sliders to the first frame."""
        for axis in range(self.viewer.dims.ndim - 2):
            self.viewer.dims.set_current_step(axis, 0)


def axis_steps(stack: xr.DataArray, axis: str) -> tuple[float, float, int]:
    """Return where an axis starts, its step as the layers have it, and its length."""
    coordinates = np.asarray(stack[axis].values, dtype=np.float64)
    return float(coordinates[0]), step_of(coordinates), len(coordinates)


def common_contrast(layers: list[Any], exact: Any | None) -> tuple[float, float]:
    """Return contrast limits that suit several results: those of the truth, where it is shown.

    Without truth, a single method that fails by many cycles must not darken all others.
    """
    if exact is not None and exact in layers:
        low, high = exact.contrast_limits
        return float(low), float(high)
    limits = np.array([layer.contrast_limits for layer in layers])
    return float(np.median(limits[:, 0])), float(np.median(limits[:, 1]))


def show_labels(layer: Any, *, small: bool) -> None:
    """Show a layer's name and a colour bar that leaves the picture free, also in a small cell."""
    layer.name_overlay.font_size = NAME_FONT[small]
    layer.name_overlay.visible = True
    layer.colorbar.size = COLORBAR_SIZE[small]
    layer.colorbar.font_size = COLORBAR_FONT[small]
    layer.colorbar.tick_length = 3.0
    layer.colorbar.box = False
    layer.colorbar.position = "bottom_left"
    layer.colorbar.visible = True
