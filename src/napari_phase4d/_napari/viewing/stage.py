"""Layers in a viewer, whatever they show: how they come up and go; and its sliders."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any

from napari.layers import Image
from napari.utils import Colormap
from psygnal import Signal

from napari_phase4d._napari.session import Session
from napari_phase4d._napari.turns import UNSEEN, Steps, Turns
from napari_phase4d._napari.viewing.grid import (
    LINKED,
    ViewState,
    arrange,
    link,
    look_closer,
    take_down,
)
from napari_phase4d._napari.viewing.layers import (
    METADATA_KEY,
    LayerTuple,
    keep_zero_black,
    thinned,
)
from napari_phase4d._napari.viewing.pointing import (
    current_frame,
    go_to_frame,
    pixel_under_cursor,
)
from napari_phase4d._napari.viewing.saying import CanvasWords
from napari_phase4d.later import xr
from napari_phase4d.recording import Recording
from napari_phase4d.words import frame_in_words

__all__ = ["Stage", "is_own"]


class Stage:
    """Brings layers up and takes them down, side by side or alone, and moves the sliders.

    Parameters
    ----------
    viewer : napari.viewer.ViewerModel
        Where the layers go; only its public model is used.
    session : Session
        What the layers are of.
    """

    #: What is shown side by side has changed.
    showing_changed = Signal()
    #: The frames of a recording have come up.
    holograms_came = Signal()

    def __init__(self, viewer: Any, session: Session) -> None:
        self.viewer = viewer
        self.session = session
        #: In which results come up and go.
        self.turns = Turns()
        #: What is shown side by side: "results", "wrapped" or the kind of the maps; "" for none.
        self.showing = ""
        self.words = CanvasWords(viewer)
        #: The layer that shows the frames of the recording.
        self.holograms: Any = None
        #: All layers made of the present recording, and what it is called.
        self._own: list[Any] = []
        self._named = ""
        self._adopted: tuple[object, Any] | None = None
        #: What was shown before the first grid.
        self._before: ViewState | None = None
        #: Layers of recordings before this one; while hidden, the sliders pass over them.
        self._earlier: list[Any] = []
        self._setting_range = False

    def _keep_sliders(self, event: Any = None) -> None:
        """Let the sliders reach over one recording, not over hidden layers of those before."""
        # What was removed is not kept.
        self._earlier = [la for la in self._earlier if la in self.viewer.layers]
        earlier = [la for la in self._earlier if not la.visible]
        if self._setting_range or not earlier:
            return
        present = [la for la in self.viewer.layers if la not in earlier]
        if not present or max(la.ndim for la in present) < self.viewer.dims.ndim:
            return
        extent = self.viewer.layers.get_extent(present)
        self._setting_range = True
        try:
            self.viewer.dims.range = tuple(
                zip(extent.world[0], extent.world[1], extent.step, strict=True)
            )
        finally:
            self._setting_range = False

    def _put_behind(self, more: Iterable[Any]) -> None:
        """Let the layers so far be those of an earlier recording, and say so in their names."""
        for layer in (*self._own, *more):
            if layer in self.viewer.layers and layer is not self._adopting:
                if self._named and self._named not in layer.name:
                    layer.name = f"{layer.name}, {self._named}"
                self._earlier.append(layer)
                layer.events.visible.connect(self._keep_sliders)
        self._named = ""

    @property
    def _adopting(self) -> Any:
        """The layer that shows already what is about to be shown."""
        return None if self._adopted is None else self._adopted[1]

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
        added.events.contrast_limits.connect(keep_zero_black)
        self._own.append(added)
        return added

    def _adding(self, layer: LayerTuple) -> Generator[bool, None, Any]:
        """Add a hidden layer on top in steps, and return it."""
        data, keywords, _ = layer
        colormap = keywords["colormap"]
        # With other colours than its first ones, napari works them out again and again.
        made = Image(data, **{**keywords, "colormap": "gray", "visible": False})
        yield UNSEEN
        added = self.viewer.add_layer(made)
        self._own.append(added)
        yield UNSEEN
        added.colormap = colormap
        added.events.contrast_limits.connect(keep_zero_black)
        yield UNSEEN
        return added

    def _show_as(self, showing: str) -> None:
        """Note what is shown side by side now, and say what its colours mean."""
        self.showing = showing
        self.words.say_colours(showing)
        self.showing_changed.emit()

    def say_where(self, event: Any = None) -> None:
        """Say at which time and view the sliders are, before that is painted."""
        data = self.session.reconstruction
        if self.words.frames and data is not None:
            frame = frame_in_words(data["phase"], *self.current_frame())
            self.words.say_frame(frame, self.turns.canvas)

    def _together(
        self,
        layers: list[Any],
        limits: tuple[float, float] | None = None,
        colormap: Colormap | None = None,
    ) -> Steps:
        """Show some layers in a grid, with one contrast where it is given.

        What was shown before the first grid is noted, to come back to.
        """
        if self._before is None:
            self._before = ViewState.of(self.viewer)
        yield from self._hiding()
        if len(layers) > 1:  # in the grid, regions would get a cell of their own
            for layer in self.viewer.layers:
                if is_own(layer, "regions"):
                    layer.visible = False
        if limits is not None:
            yield from link(self.viewer, layers, limits, colormap)
        looked = False
        for _ in arrange(self.viewer, layers):
            yield
            ready = len(layers) == 1 or self.viewer.canvas.grid.enabled  # a cell is smaller
            if not looked and ready and any(layer.visible for layer in layers):
                self._look_at(layers)
                looked = True
                yield
        self.words.frames = True
        self.say_where()

    def _look_at(self, layers: list[Any]) -> None:
        """Let the canvas be filled with what is shown, or, in a grid of results, the object."""
        self._fit()
        clearest = self._clearest()
        alone = all(is_own(layer) for layer in self.viewer.layers if layer.visible)
        if len(layers) > 1 and clearest is not None and alone:
            look_closer(self.viewer, thinned(clearest.data))

    def _clearest(self) -> Any | None:
        """Return the layer that tells best where the object is, None if there is none yet."""
        return None

    def leave_grid(self) -> None:
        """Show again what was shown before the grid.

        Raises
        ------
        ValueError
            If there is no grid to leave.
        """
        self.turns.finish()
        if self._before is None:
            msg = "nothing is side by side; press Results in step 5 first"
            raise ValueError(msg)
        linked = [la for la in self.viewer.layers if isinstance(la, Image) and is_own(la)]
        if linked:
            self.viewer.layers.unlink_layers(linked, LINKED)
        self._before.restore(self.viewer)
        self._before = None
        self._show_as("")

    def hide_all(self) -> None:
        """Hide every layer of this plugin and leave the grid; other layers stay as they are."""
        self.turns.run(self._hiding())

    def _hiding(self) -> Steps:
        return take_down(self.viewer, self._hideable())

    def _hideable(self) -> list[Any]:
        """Return the layers of this plugin, but for those of regions."""
        return [la for la in self.viewer.layers if is_own(la) and not is_own(la, "regions")]

    def _fit(self) -> None:
        """Fill the canvas with what is visible; larger layers of other recordings do not count."""
        self.viewer.reset_view(layers=[la for la in self.viewer.layers if la.visible] or None)

    def current_frame(self) -> tuple[int, int]:
        """Return the (time, angle) numbers of the frame that is on screen."""
        return current_frame(self.viewer, self.session.needed_reconstruction()["phase"])

    def current_time(self) -> int:
        """Return the number of the camera frame that is on screen."""
        return current_frame(self.viewer, stack_of(self.session.needed_recording()))[0]

    def current_pixel(self) -> tuple[int, int] | None:
        """Return the (y, x) numbers of the phase pixel under the mouse, None outside."""
        return pixel_under_cursor(self.viewer, self.session.needed_reconstruction()["phase"])

    def go_to(self, time: int, angle: int) -> None:
        """Move the sliders to a frame of the reconstruction."""
        go_to_frame(self.viewer, self.session.needed_reconstruction()["phase"], time, angle)

    def go_soon_to(self, time: int, angle: int) -> None:
        """Move the sliders in a turn of their own, where what goes on is unhurried."""
        self.turns.run(self._going_to(time, angle))

    def _going_to(self, time: int, angle: int) -> Steps:
        self.go_to(time, angle)
        yield

    def _go_to_start(self, recording: Recording) -> None:
        """Move the sliders to the first frame, also where layers of before begin elsewhere."""
        if self.holograms in self._own:
            go_to_frame(self.viewer, stack_of(recording), 0, 0)
            return
        for axis in range(self.viewer.dims.ndim - 2):
            self.viewer.dims.set_current_step(axis, 0)


def stack_of(recording: Recording) -> xr.DataArray:
    """Return the frames of a recording with an angle axis, as their layer has it."""
    return recording.holograms.expand_dims({"angle": [0.0]}, axis=1)


def is_own(layer: Any, kind: str = "") -> bool:
    """Say whether this plugin made a layer, and one of a kind where that is given."""
    note = layer.metadata.get(METADATA_KEY)
    return note is not None and (not kind or note.get("kind") == kind)
