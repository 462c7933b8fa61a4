"""What the session finds, as layers: the recording, its phase, results, maps and cells."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from napari.layers import Labels

from napari_phase4d._napari.session import Changed, Plan, Session
from napari_phase4d._napari.turns import UNSEEN, Steps, exhaust
from napari_phase4d._napari.viewing.cells import OUTLINE, CellLayers, object_layer
from napari_phase4d._napari.viewing.grid import (
    ViewState,
    common_contrast,
    take_down,
)
from napari_phase4d._napari.viewing.layers import (
    LayerTuple,
    hologram_layer,
    lazy_of,
    phase_colormap,
    recalibrate_layer,
    region_layer,
    spread_over_angles,
    stack_layer,
)
from napari_phase4d._napari.viewing.stage import Stage, is_own
from napari_phase4d.analysis import Cells, difference, most_trusted
from napari_phase4d.later import xr
from napari_phase4d.pipeline import Outcome
from napari_phase4d.plotting import EXACT
from napari_phase4d.recording import Recording
from napari_phase4d.task import Task, Watch
from napari_phase4d.unwrapping import METHODS, check_method

__all__ = ["Presenter"]

#: Under this name a window keeps the presenter.
KEPT = "napari_phase4d_presenter"
NO_RESULTS = "there are no results to show yet; press Run in step 4"


class Presenter(Stage):
    """Adds a layer for everything the session finds.

    Parameters
    ----------
    viewer : napari.viewer.ViewerModel
        Where the layers go; only its public model is used.
    session : Session
        What to show.
    """

    def __init__(self, viewer: Any, session: Session) -> None:
        super().__init__(viewer, session)
        #: Where the sliders were when results came up.
        self._arrived: tuple[int, int] | None = None
        #: The pixel that the layers of the recording were made with.
        self._pixel_um = 1.0
        self._exact: Any = None
        self._wrapped: Any = None
        #: Layers of unwrapped phase of the present recording: method id -> newest layer.
        self._results: dict[str, Any] = {}
        #: Layers of maps and differences: kind -> what they were made of, and the layers.
        self._made: dict[str, tuple[tuple[object, ...], list[Any]]] = {}
        #: Layers of results of a run that goes on: method id -> layer.
        self._finished: dict[str, Any] = {}
        self.cells = CellLayers(viewer)
        #: The layer with the outline of the object, and the phase that it is of.
        self._object: tuple[object, Any] = (None, None)
        #: Layers with regions of the present recording.
        self._regions: list[Any] = []
        self.listens = self._still = False
        #: Whether the dock was closed before all results had come up.
        self._cut_short = False

    @classmethod
    def of(cls, viewer: Any) -> Presenter:
        """Return the presenter of a viewer with its session, also after its dock was closed."""
        window = getattr(viewer, "window", None)
        # In a list: what napari gives to plugins wraps all that is called napari, as this is.
        kept: list[Presenter] = getattr(window, KEPT, [])
        if kept and not kept[0].listens:
            return kept[0]
        made = cls(viewer, Session())
        if window is not None and not kept:
            # With the window, and not in a table here, it goes when the window does.
            setattr(window, KEPT, [made])
        return made

    def listen(self) -> None:
        """Show what the session finds, from now on."""
        session, self.listens = self.session, True
        for signal, show in (
            (session.recording_changed, self.show_recording),
            (session.calibration_changed, self.show_calibration),
            (session.reconstruction_changed, self.show_phase),
            (session.outcome_changed, self.show_outcome),
            (session.truth_changed, self._truth_changed),
            (session.cells_changed, self.show_cells),
        ):
            signal.connect(partial(self._unless_still, show))
        session.result_finished.connect(self.show_finished)
        self.viewer.dims.events.range.connect(self._keep_sliders)
        self.viewer.dims.events.current_step.connect(self.say_where)

    def _unless_still(self, show: Callable[[], None]) -> None:
        if not self._still:
            show()

    @contextmanager
    def still(self) -> Iterator[None]:
        """Let all that is shown stay as it is, while others are told of it."""
        self._still = True
        try:
            yield
        finally:
            self._still = False

    def go_on(self) -> None:
        """Show what was still to come up when an earlier dock was closed."""
        if self._cut_short and self.session.outcome is not None:
            self.show_outcome()
        elif self._cut_short and self.session.reconstruction is not None:
            phase, layer = self.session.reconstruction["phase"], self._wrapped
            if layer is None or layer not in self.viewer.layers or not shows(layer, phase):
                self.show_phase()
        elif self._cut_short and self.session.recording is not None:
            self.turns.run(self._showing_recording(self.session.recording))
        self._cut_short = False

    def leave(self) -> None:
        """Let go of the viewer; what is shown stays, and the session waits for another dock."""
        if not self.listens:
            return
        self.listens, self._cut_short = False, self.turns.pending
        self.turns.stop()
        self.turns.failed = self.turns.canvas = None
        self.session.part()
        self.showing_changed.disconnect()
        self.holograms_came.disconnect()
        self.cells.came_up.disconnect()
        self.viewer.dims.events.range.disconnect(self._keep_sliders)
        self.viewer.dims.events.current_step.disconnect(self.say_where)
        self.words.leave()  # last, since the canvas may be going

    def show_recording(self) -> None:
        """Show the frames of the recording, in the layer it came from or in a new one."""
        self.turns.finish()
        recording = self.session.recording
        self._put_behind(self.cells.layers)
        self._results, self._own, self.holograms, self._wrapped = {}, [], None, None
        self._regions, self._made, self._finished = [], {}, {}
        self.cells.forget()
        self._before = None
        self._show_as("")
        if recording is None:
            self.hide_all()
        else:
            self._pixel_um, self._named = recording.optics.pixel_um, self.session.name
            self.turns.run(self._showing_recording(recording, self.adopted(recording)))

    def _showing_recording(self, recording: Recording, layer: Any | None = None) -> Steps:
        yield from take_down(self.viewer, [la for la in self._hideable() if la is not layer])
        if layer is None:  # unless its dock was closed when it had come up in part
            begun = (la for la in self._own if la in self.viewer.layers)
            layer = next((la for la in begun if is_own(la, "holograms")), None)
        if layer is None:
            layer = yield from self._adding(hologram_layer(recording))
        self.holograms = layer
        layer.visible = True
        self._keep_sliders()
        yield UNSEEN
        self._go_to_start(recording)
        self._fit()
        self.holograms_came.emit()
        yield
        # Letters are drawn for the first time, which takes as long as the picture.
        self.viewer.canvas.overlays.scale_bar.visible = True
        yield

    def show_calibration(self) -> None:
        """Give all layers of the recording its new scale."""
        self.turns.finish()
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
        self.turns.finish()
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
        self.turns.finish()
        data = self.session.needed_reconstruction()
        self._results, self._before, self._named = {}, None, self.session.name
        self._show_as("")
        self.turns.run(self._showing_phase(data, self.adopted(data["phase"].data)))

    def _showing_phase(self, data: xr.Dataset, wrapped: Any | None) -> Steps:
        name = self._named
        yield from take_down(self.viewer, [la for la in self._hideable() if la is not wrapped])
        if self.holograms in self.viewer.layers:
            spread_over_angles(self.holograms, data["angle"].values)
            yield UNSEEN
        if "amplitude" in data:
            yield from self._adding(
                stack_layer(data["amplitude"], f"amplitude, {name}", "amplitude")
            )
        if wrapped is None:
            wrapped = yield from self._adding(
                stack_layer(data["phase"], f"wrapped phase, {name}", "wrapped")
            )
        self._wrapped = wrapped
        self._wrapped.visible = True
        self.viewer.canvas.overlays.scale_bar.visible = True
        self._keep_sliders()
        self._fit()
        yield UNSEEN
        self.go_to(*next(iter(self.session.start_frames), (0, 0)))

    def show_finished(self, method: str, name: str, result: xr.DataArray) -> None:
        """Show a result by itself while other methods still run."""
        self.turns.run(self._finishing(method, name, result))

    def _finishing(self, method: str, name: str, result: xr.DataArray) -> Steps:
        if self._before is None:
            self._before = ViewState.of(self.viewer)
        self._show_as("")
        yield from self._hiding()
        yield from self._adding_truth()  # it comes first in the grid
        layer = yield from self._adding(stack_layer(result, name, "unwrapped"))
        self._finished[method] = layer
        layer.visible = True

    def drop_finished(self) -> None:
        """Take results away whose run has failed after them: they belong to nothing."""
        self.turns.finish()
        finished, self._finished = self._finished, {}
        for layer in finished.values():
            if layer in self.viewer.layers:
                self.viewer.layers.remove(layer)
        if finished and self.results():
            self.side_by_side()

    def show_outcome(self) -> None:
        """Show the results side by side, as new layers, after the truth where it is known."""
        outcome = self.session.needed_outcome()
        self.turns.run(self._coming(outcome, self.session.truth))

    def _coming(self, outcome: Outcome, truth: xr.DataArray | None) -> Steps:
        self._results, self._finished = {}, {}
        if self._before is None:
            self._before = ViewState.of(self.viewer)
        self._show_as("results")
        yield from self._hiding()  # adding to a grid takes much longer
        yield from self._adding_truth()
        if self._exact is not None and truth is not None:
            self._results[EXACT] = self._exact
        comparison = outcome.comparison
        for method, result in comparison.results.items():
            layer = self._layer_of(result)  # if it came up as its method ended
            if layer is None:
                name = str(comparison.table["method"][method])
                layer = yield from self._adding(stack_layer(result, name, "unwrapped"))
            self._results[method] = layer
        yield from self._side_by_side()
        self._arrived = self.current_frame()

    def _layer_of(self, result: xr.DataArray) -> Any | None:
        """Return the layer of ours that shows a result, None if there is none."""
        own = (la for la in self.viewer.layers if is_own(la, "unwrapped"))
        return next((la for la in own if shows(la, result)), None)

    @property
    def shows_object(self) -> bool:
        """Whether the outline of the object is on screen."""
        layer = self._object[1]
        return layer is not None and layer in self.viewer.layers and layer.visible

    def show_object(
        self, *, wanted: bool, then: Callable[[xr.Dataset], None] | None = None
    ) -> None:
        """Show or hide the outline of what is taken for the object, over the wrapped phase.

        ``then(data)`` is called when it is on screen, round the object of ``data``. Whatever
        comes of it, `showing_changed` says so.
        """
        self.turns.finish()
        if wanted:
            data = self.session.needed_reconstruction()
            self.turns.run(self._showing_object(data, self.session.name, then))
            return
        if self.shows_object:
            self._object[1].visible = False
        self.showing_changed.emit()

    def _showing_object(
        self, data: xr.Dataset, name: str, then: Callable[[xr.Dataset], None] | None
    ) -> Steps:
        try:
            yield from self._bringing_object(data, name)
        except Exception:
            self.showing_changed.emit()
            raise
        self.showing_changed.emit()
        if then is not None:
            then(data)

    def _bringing_object(self, data: xr.Dataset, name: str) -> Steps:
        phase, (of, layer) = data["phase"], self._object
        if layer is None or layer not in self.viewer.layers or of is not phase.data:
            keywords = object_layer(phase, f"object in {name}")
            yield UNSEEN
            made = Labels(**{**keywords, "visible": False})
            made.contour = OUTLINE
            layer = self.viewer.add_layer(made)
            self._own.append(layer)
            self._object = (phase.data, layer)
            # Its tools to paint with would only be in the way.
            self.viewer.layers.selection.active = None
            yield UNSEEN
        if self._wrapped not in self.viewer.layers or not self._wrapped.visible:
            yield from self._showing_wrapped(data)
            yield
        layer.visible = True

    def _adding_truth(self) -> Steps:
        """Add the exact phase, hidden, where it is known and not shown yet."""
        truth, layer = self.session.truth, self._exact
        there = layer is not None and layer in self.viewer.layers
        if truth is None or (there and shows(layer, truth)):
            return
        self._exact = yield from self._adding(stack_layer(truth, EXACT, "exact"))

    @property
    def has_stayed(self) -> bool:
        """Whether nobody has moved the sliders, or shown something else, since results came up."""
        return self.showing == "results" and self.current_frame() == self._arrived

    def show_margin(self) -> None:
        """Show where steps are too large, one layer for each dimension, side by side."""
        margin = self.session.margin
        if margin is not None:
            named = margin.data_vars.items()
            layers = (
                stack_layer(stack, f"step {str(n).replace('_', ' ')}", "margin")
                for n, stack in named
            )
            self._show_made(layers, "margin", (margin,))

    def show_confidence(self) -> None:
        """Show how far each result is to be trusted, side by side."""
        labels = self.session.needed_outcome().comparison.table["method"]
        maps = self.session.confidence
        layers = (
            stack_layer(stack, f"confidence in {labels[m]}", "confidence")
            for m, stack in maps.items()
        )
        self._show_made(layers, "confidence", (maps,))

    def show_difference(self, reference: str) -> None:
        """Show each result less one of them, side by side.

        Parameters
        ----------
        reference : str
            The id or label of a method among the results, or "exact" for the truth.
        """
        self.plan_difference(reference).run()

    def plan_difference(self, reference: str) -> Plan:
        """Plan to show each result less one of them, see `show_difference`.

        Parameters
        ----------
        reference : str
            The id or label of a method among the results, or "exact" for the truth.

        Raises
        ------
        ValueError
            If it is not there, or nothing is to be compared with it.
        """
        labels = self.session.needed_outcome().comparison.table["method"]
        if reference != EXACT:
            reference = check_method(reference, {})
        truth = self.session.truth
        base = truth if reference == EXACT else self.session.results[reference]
        if base is None:
            msg = "the exact phase is not known; choose another result to compare with"
            raise ValueError(msg)
        name = EXACT if reference == EXACT else labels[reference]
        others = {m: result for m, result in self.session.results.items() if m != reference}
        if not others:
            msg = f"there is no other result than {name} to compare with it"
            raise ValueError(msg)
        made_of, key = (base, self.session.results), f"difference to {reference}"
        known = self._has_made(key, made_of)

        def work(task: Task) -> list[LayerTuple]:
            made, left = [], {} if known else others
            watch = Watch(len(left), "taking the differences", task)
            for method, result in left.items():
                less = difference(result, base)
                made.append(stack_layer(less, f"{labels[method]} − {name}", "difference"))
                watch.step()
            return made

        def receive(layers: list[LayerTuple]) -> None:
            now = self.session.truth if reference == EXACT else self.session.results.get(reference)
            if now is not base or self.session.results is not made_of[1]:
                raise Changed
            if known and not self._has_made(key, made_of):  # removed meanwhile
                raise Changed
            self._show_made(layers, "difference", made_of, key)

        return Plan("Taking the differences", work, receive)

    def show_wrapped(self) -> None:
        """Show the wrapped phase alone, where it has not been removed."""
        self.turns.run(self._showing_wrapped(self.session.needed_reconstruction()))

    def _showing_wrapped(self, data: xr.Dataset) -> Steps:
        self._show_as("wrapped")
        if self._wrapped is None or self._wrapped not in self.viewer.layers:
            name = f"wrapped phase, {self.session.name}"
            self._wrapped = yield from self._adding(stack_layer(data["phase"], name, "wrapped"))
        yield from self._together([self._wrapped])

    def _show_made(
        self,
        made: Iterable[LayerTuple],
        kind: str,
        made_of: tuple[object, ...],
        key: str = "",
    ) -> None:
        """Show layers side by side, new ones unless those of before show the same."""
        self.turns.run(self._making(made, kind, made_of, key or kind))

    def _has_made(self, key: str, made_of: tuple[object, ...]) -> bool:
        """Say whether layers of before show the same, and are all there."""
        before, layers = self._made.get(key, ((), []))
        same = len(before) == len(made_of) and all(map(operator.is_, before, made_of))
        return same and all(layer in self.viewer.layers for layer in layers)

    def _making(
        self,
        made: Iterable[LayerTuple],
        kind: str,
        made_of: tuple[object, ...],
        key: str,
    ) -> Steps:
        self._show_as(kind)
        if not self._has_made(key, made_of):
            new = []
            for layer in made:
                added = yield from self._adding(layer)
                new.append(added)
            self._made[key] = (made_of, new)
        layers = self._made[key][1]
        yield from self._together(layers, layers[0].contrast_limits)

    def _show_as(self, showing: str) -> None:
        """Note what is shown side by side now; the outline lies over the wrapped phase alone."""
        if self.shows_object:
            self._object[1].visible = False
        super()._show_as(showing)

    def _clearest(self) -> Any | None:
        """Return the layer of the result that is most to be trusted, None if there is none."""
        return self._results.get(most_trusted(self.session.results) if self._results else "")

    def results(self) -> list[Any]:
        """Return the truth, where it is known, and the newest layer of every method in order."""
        layers = (self._results.get(name) for name in (EXACT, *METHODS))
        return [la for la in layers if la is not None and la in self.viewer.layers]

    def side_by_side(self) -> None:
        """Show the newest results of every method in a grid, with one contrast for all."""
        if not self.turns.pending and not self.results():
            raise ValueError(NO_RESULTS)
        self.turns.run(self._side_by_side())

    def _side_by_side(self) -> Steps:
        newest = self.results()
        if not newest:  # all were removed meanwhile
            return
        # What tells steps of many turns goes further than the others, and no cycle astray.
        told = self._results.get("synthetic-wavelength")
        limits = common_contrast(newest, self._results.get(EXACT, told))
        self._show_as("results")
        yield from self._together(newest, limits, phase_colormap(limits))

    def show_cells(self) -> None:
        """Show the cells that were found last, over the result that they are of."""
        self.turns.run(self._showing_cells(self.session.cells))

    def _showing_cells(self, cells: Cells | None) -> Steps:
        result = None if cells is None else self._results.get(cells.method)
        if result is not None and result in self.viewer.layers:
            self._show_as("cells")
            yield from self._together([result])
        yield from self.cells.showing(cells)

    def frame_changed(self) -> None:
        """Follow the sliders."""
        if self.session.cells is not None:
            self.cells.turn_to(self.current_frame()[1])

    def start_regions(self) -> None:
        """Add an empty layer to draw regions in; in the grid, over the most reliable result."""
        self.turns.run(self._starting_regions(self.session.needed_reconstruction()["phase"]))

    def add_regions(self) -> Any:
        """Return a new empty layer to draw regions in, shown as by `start_regions`."""
        self.turns.finish()
        exhaust(self._starting_regions(self.session.needed_reconstruction()["phase"]))
        return self._regions[-1]

    def _starting_regions(self, phase: xr.DataArray) -> Steps:
        if self.session.results and self.viewer.canvas.grid.enabled:
            best = self._results.get(most_trusted(self.session.results))
            if best is not None and best in self.viewer.layers:
                yield from self._together([best])
        layer = self.viewer.add_shapes(**region_layer(phase, "regions"))
        self._regions.append(layer)
        layer.mode = "add_polygon"
        self.viewer.layers.selection.active = layer
        yield


def shows(layer: Any, stack: xr.DataArray) -> bool:
    """Say whether a layer shows a stack, and no other of the same form."""
    data = layer.data
    return data is stack.data or lazy_of(data) is stack.data
