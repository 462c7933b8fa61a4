"""What the session's results look like in the viewer."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import Any

import xarray as xr

from napari_phase4d._napari.session import Session
from napari_phase4d._napari.viewing.grid import (
    LINKED,
    ViewState,
    arrange,
    common_contrast,
    hide_labels,
    link,
)
from napari_phase4d._napari.viewing.layers import (
    METADATA_KEY,
    LayerTuple,
    hologram_layer,
    recalibrate_layer,
    region_layer,
    spread_over_angles,
    stack_layer,
)
from napari_phase4d._napari.viewing.pointing import current_frame, go_to_frame, pixel_under_cursor
from napari_phase4d.analysis import difference, most_trusted
from napari_phase4d.plotting import EXACT
from napari_phase4d.unwrapping import METHODS

__all__ = ["Presenter"]

NO_RESULTS = "there are no results to show yet; press Run in step 4"


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
        self._wrapped: Any = None
        #: Layers of unwrapped phase of the present recording: method id -> newest layer.
        self._results: dict[str, Any] = {}
        #: Layers of maps and differences: kind -> what they were made of, and the layers.
        self._made: dict[str, tuple[tuple[object, ...], list[Any]]] = {}
        #: Layers with regions of the present recording.
        self._regions: list[Any] = []
        self._before: ViewState | None = None
        session.recording_changed.connect(self.show_recording)
        session.calibration_changed.connect(self.show_calibration)
        session.reconstruction_changed.connect(self.show_phase)
        session.outcome_changed.connect(self.show_outcome)
        session.truth_changed.connect(self._truth_changed)

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
        self._results, self._own, self.holograms, self._wrapped = {}, [], None, None
        self._regions, self._made = [], {}
        self._before = None
        self.hide_all()
        if recording is None:
            return
        self._pixel_um = recording.optics.pixel_um
        self.holograms = self.adopted(recording) or self.add(hologram_layer(recording))
        self.viewer.canvas.overlays.scale_bar.visible = True
        self._go_to_start()
        self._fit()

    def show_calibration(self) -> None:
        """Give all layers of the recording its new scale."""
        recording = self.session.needed_recording()
        frame = self.viewer.dims.current_step
        for layer in self._own:
            if layer in self.viewer.layers:
                recalibrate_layer(layer, recording, self._pixel_um)
        factor = recording.optics.pixel_um / self._pixel_um
        for layer in self._regions:
            layer.scale, layer.translate = layer.scale * factor, layer.translate * factor
        self._pixel_um = recording.optics.pixel_um
        for axis in range(self.viewer.dims.ndim - 2):
            self.viewer.dims.set_current_step(axis, frame[axis])
        self._fit()

    def _truth_changed(self) -> None:
        """Let the grid show the truth that is chosen now, the next time it is made."""
        truth = self.session.truth
        self._results.pop(EXACT, None)
        if truth is None:
            return
        known = [la for la in (self._exact, *self.viewer.layers) if la is not None]
        layer = next((la for la in known if la.data is truth.data), None)
        if layer is None or layer not in self.viewer.layers:
            layer = self.add(stack_layer(truth, EXACT, "exact", visible=False))
        self._exact = self._results[EXACT] = layer

    def show_phase(self) -> None:
        """Show the wrapped phase; the amplitude is added, hidden."""
        data = self.session.needed_reconstruction()
        self._results, self._before = {}, None
        self.hide_all()
        name = self.session.name
        if self.holograms in self.viewer.layers:
            spread_over_angles(self.holograms, data["angle"].values)
        if "amplitude" in data:
            amplitude = stack_layer(
                data["amplitude"], f"amplitude, {name}", "amplitude", visible=False
            )
            self.add(amplitude)
        self._wrapped = self.adopted(data["phase"].data) or self.add(
            stack_layer(data["phase"], f"wrapped phase, {name}", "wrapped")
        )
        self.viewer.canvas.overlays.scale_bar.visible = True
        self._fit()
        self.go_to(*next(iter(self.session.start_frames), (0, 0)))

    def show_outcome(self) -> None:
        """Show the results side by side, as new layers, after the truth where it is known."""
        self._results = {}
        if self._before is None:
            self._before = ViewState.of(self.viewer)
        with self.viewer.layers.batched_update():
            self.hide_all()  # adding to a grid takes much longer
        comparison = self.session.needed_outcome().comparison
        truth = self.session.truth
        if truth is not None:
            shown = self._exact
            if shown is None or shown not in self.viewer.layers or shown.data is not truth.data:
                shown = self._exact = self.add(stack_layer(truth, EXACT, "exact", visible=False))
            self._results[EXACT] = shown
        for method, result in comparison.results.items():
            name = str(comparison.table["method"][method])
            layer = stack_layer(result, name, "unwrapped", visible=False)
            self._results[method] = self.add(layer)
        self.side_by_side()

    def show_margin(self) -> None:
        """Show where steps are too large, one layer for each dimension, side by side."""
        margin = self.session.margin
        if margin is not None:
            stacks = {f"step {str(n).replace('_', ' ')}": m for n, m in margin.data_vars.items()}
            self._show_made(stacks, "margin", (margin,))

    def show_confidence(self) -> None:
        """Show how far each result is to be trusted, side by side."""
        labels = self.session.needed_outcome().comparison.table["method"]
        maps = self.session.confidence
        stacks = {f"trust in {labels[m]}": stack for m, stack in maps.items()}
        self._show_made(stacks, "confidence", (maps,))

    def show_difference(self, reference: str) -> None:
        """Show each result less one of them, side by side.

        Parameters
        ----------
        reference : str
            A method id among the results, or "exact" for the truth.
        """
        labels = self.session.needed_outcome().comparison.table["method"]
        truth = self.session.truth
        base = truth if reference == EXACT else self.session.results[reference]
        if base is None:
            msg = "the exact phase is not known; choose another result to compare with"
            raise ValueError(msg)
        name = EXACT if reference == EXACT else labels[reference]
        stacks = {
            f"{labels[m]} − {name}": difference(result, base)
            for m, result in self.session.results.items()
            if m != reference
        }
        if not stacks:
            msg = f"there is no other result than {name} to compare with it"
            raise ValueError(msg)
        made_of = (base, self.session.results)
        self._show_made(stacks, "difference", made_of, f"difference to {reference}")

    def show_wrapped(self) -> None:
        """Show the wrapped phase alone, where it has not been removed."""
        if self._wrapped is None or self._wrapped not in self.viewer.layers:
            data = self.session.needed_reconstruction()
            name = f"wrapped phase, {self.session.name}"
            self._wrapped = self.add(stack_layer(data["phase"], name, "wrapped", visible=False))
        self._show_together([self._wrapped])

    def _show_made(
        self,
        stacks: Mapping[str, xr.DataArray],
        kind: str,
        made_of: tuple[object, ...],
        key: str = "",
    ) -> None:
        """Show stacks side by side, in new layers unless those of before still show the same."""
        before, layers = self._made.get(key or kind, ((), []))
        same = len(before) == len(made_of) and all(map(operator.is_, before, made_of))
        if not same or any(layer not in self.viewer.layers for layer in layers):
            layers = [
                self.add(stack_layer(stack, name, kind, visible=False))
                for name, stack in stacks.items()
            ]
            self._made[key or kind] = (made_of, layers)
        self._show_together(layers)
        link(self.viewer, layers, layers[0].contrast_limits)

    def results(self) -> list[Any]:
        """Return the truth, where it is known, and the newest layer of every method in order."""
        layers = (self._results.get(name) for name in (EXACT, *METHODS))
        return [la for la in layers if la is not None and la in self.viewer.layers]

    def side_by_side(self) -> None:
        """Show the newest results of every method in a grid, with one contrast for all."""
        newest = self.results()
        if not newest:
            raise ValueError(NO_RESULTS)
        self._show_together(newest)
        link(self.viewer, newest, common_contrast(newest, self._results.get(EXACT)))

    def _show_together(self, layers: list[Any]) -> None:
        """Show some layers in a grid, and note what was shown before the first grid."""
        if self._before is None:
            self._before = ViewState.of(self.viewer)
        with self.viewer.layers.batched_update():  # napari then lays out its canvas once
            self.hide_all()
            if len(layers) > 1:  # in the grid, regions would get a cell of their own
                for layer in self.viewer.layers:
                    if is_own(layer, "regions"):
                        layer.visible = False
            arrange(self.viewer, layers)
        self._fit()

    def leave_grid(self) -> None:
        """Show again what was shown before the grid.

        Raises
        ------
        ValueError
            If there is no grid to leave.
        """
        if self._before is None:
            msg = "nothing is side by side; press Side by side first"
            raise ValueError(msg)
        linked = [la for la in self.viewer.layers if is_own(la)]
        if linked:
            self.viewer.layers.unlink_layers(linked, LINKED)
        self._before.restore(self.viewer)
        self._before = None

    def hide_all(self) -> None:
        """Hide every layer of this plugin and leave the grid; other layers stay as they are."""
        self.viewer.canvas.grid.enabled = False
        for layer in self.viewer.layers:
            # napari lays out its canvas at every change, also of what is hidden already.
            if layer.visible and is_own(layer) and not is_own(layer, "regions"):
                hide_labels(layer)
                layer.visible = False

    def add_regions(self) -> Any:
        """Add an empty layer to draw regions in; in the grid, over the most reliable result."""
        phase = self.session.needed_reconstruction()["phase"]
        if self.session.results and self.viewer.canvas.grid.enabled:
            best = self._results.get(most_trusted(self.session.results))
            if best is not None and best in self.viewer.layers:
                self._show_together([best])
        layer = self.viewer.add_shapes(**region_layer(phase, "regions"))
        self._regions.append(layer)
        layer.mode = "add_polygon"
        self.viewer.layers.selection.active = layer
        return layer

    def _fit(self) -> None:
        """Fill the canvas with what is visible; larger layers of other recordings do not count."""
        self.viewer.reset_view(layers=[la for la in self.viewer.layers if la.visible] or None)

    def current_frame(self) -> tuple[int, int]:
        """Return the (time, angle) numbers of the frame that is on screen."""
        return current_frame(self.viewer, self.session.needed_reconstruction()["phase"])

    def current_time(self) -> int:
        """Return the number of the camera frame that is on screen."""
        return current_frame(self.viewer, self.holograms_stack())[0]

    def holograms_stack(self) -> xr.DataArray:
        """Return the frames with an angle axis, as their layer has it."""
        return self.session.needed_recording().holograms.expand_dims({"angle": [0.0]}, axis=1)

    def current_pixel(self) -> tuple[int, int] | None:
        """Return the (y, x) numbers of the phase pixel under the mouse, None outside."""
        return pixel_under_cursor(self.viewer, self.session.needed_reconstruction()["phase"])

    def go_to(self, time: int, angle: int) -> None:
        """Move the sliders to a frame of the reconstruction."""
        go_to_frame(self.viewer, self.session.needed_reconstruction()["phase"], time, angle)

    def _go_to_start(self) -> None:
        """Move the sliders to the first frame, also where layers of before begin elsewhere."""
        if self.holograms in self._own:
            go_to_frame(self.viewer, self.holograms_stack(), 0, 0)
            return
        for axis in range(self.viewer.dims.ndim - 2):
            self.viewer.dims.set_current_step(axis, 0)


def is_own(layer: Any, kind: str = "") -> bool:
    """Say whether this plugin made a layer, and one of a kind where that is given."""
    note = layer.metadata.get(METADATA_KEY)
    return note is not None and (not kind or note.get("kind") == kind)
