"""The newest frame of a recording that grows, in two layers that are filled anew."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from napari.layers import Image
from numpy.typing import NDArray

from napari_phase4d._napari.session import LiveView
from napari_phase4d._napari.turns import Steps, exhaust
from napari_phase4d._napari.viewing.grid import ViewState, arrange, take_down
from napari_phase4d._napari.viewing.layers import (
    METADATA_KEY,
    LayerTuple,
    keep_zero_black,
    stack_layer,
)
from napari_phase4d._napari.viewing.presenter import Presenter
from napari_phase4d.later import xr
from napari_phase4d.stacks import AXES
from napari_phase4d.unwrapping import METHODS

__all__ = ["LiveLayers"]

#: Shares of pixels between which the contrast of unwrapped phase lies.
SHARES = (0.001, 0.9995)
#: While so many frames wait, pictures give way to them: one in so many seconds is shown.
MANY, SELDOM_S = 8, 0.5


class LiveLayers:
    """Shows one frame after another: wrapped, and unwrapped by one method.

    Their one time is as long as all that is there, so that the newest frame is seen wherever the
    slider is.

    Parameters
    ----------
    presenter : Presenter
        What shows all else, and its viewer.
    """

    def __init__(self, presenter: Presenter) -> None:
        self._presenter, self._viewer = presenter, presenter.viewer
        #: By what they show.
        self._layers: dict[str, Any] = {}
        #: Contrast as it was set here; another one is the user's.
        self._limits: dict[str, tuple[float, float]] = {}
        self._before: ViewState | None = None
        #: Whether the canvas said time and view before.
        self._said_frame = False
        self._index, self._begun, self._shown_s = -1, False, -math.inf
        #: Newest frames that were not shown, since many were waiting; and the last of them.
        self.passed_over, self._passed = 0, -1

    def show(self, view: LiveView) -> bool:
        """Show what is newest, if it is newer than what is shown; say whether it is on screen."""
        if view.like is None or view.index <= self._index:
            return True
        if not self._begun:
            self._begun = True
            self._presenter.turns.run(self._coming(view, view.like))
            return True
        now_s = time.monotonic()
        if view.status.behind > MANY and now_s - self._shown_s < SELDOM_S:
            self.passed_over += view.index > self._passed
            self._passed = view.index
            return False  # a later one comes
        self._index, self._shown_s = view.index, now_s
        for name, layer in self._layers.items():
            if layer in self._viewer.layers:  # and was not taken away by the user
                values = view.shown[name]
                layer.data = values[None]
                self._widen(name, values)
        return True

    def remove(self) -> None:
        """Take the layers away."""
        exhaust(self.leaving())

    def leaving(self) -> Steps:
        """Take the layers away, one a step."""
        shown = [layer for layer in self._layers.values() if layer in self._viewer.layers]
        yield from take_down(self._viewer, shown)
        # The upper one first: where software draws, napari ends if one below it goes, unless names
        # stand at both.
        for layer in shown[::-1]:
            self._viewer.layers.remove(layer)
            yield
        self._layers, self._limits = {}, {}
        self._index, self._begun = -1, False
        self.passed_over, self._passed = 0, -1

    def restore(self) -> None:
        """Show again what was shown before."""
        before, self._before = self._before, None
        if before is not None:
            before.restore(self._viewer)
            self._presenter.words.say_colours(self._presenter.showing)
            self._presenter.words.frames = self._said_frame
            self._presenter.say_where()

    def forget(self) -> None:
        """Forget what was shown before: something else takes its place."""
        self._before = None

    def _coming(self, view: LiveView, like: xr.DataArray) -> Steps:
        """Add the layers, hidden, in small steps, and show them side by side."""
        self._before = ViewState.of(self._viewer)
        self._said_frame = self._presenter.words.frames
        self._presenter.words.say_colours("")
        self._presenter.hide_all()
        times = span_of_times(self._viewer)
        yield
        for name, values in view.shown.items():
            data, keywords, _ = live_layer(like.copy(data=values[None]), name, times)
            colormap = keywords.pop("colormap")
            # With other colours than its first ones, napari works them out again and again.
            made = Image(data, **{**keywords, "visible": False})
            yield
            layer = self._layers[name] = self._viewer.add_layer(made)
            self._limits[name] = tuple(layer.contrast_limits)
            yield
            layer.colormap = colormap
            layer.events.contrast_limits.connect(keep_zero_black)
            yield
        yield from self._arranging()

    def _arranging(self) -> Steps:
        layers = [layer for layer in self._layers.values() if layer in self._viewer.layers]
        if not layers:
            return
        # One colour bar is enough: that of phase whose contrast is not known beforehand.
        yield from arrange(self._viewer, layers, bar=len(layers) - 1)
        # The one time of these layers is not that of the newest frame.
        self._viewer.canvas.overlays.current_slice.visible = False
        self._presenter.words.say_colours("results")
        self._viewer.canvas.overlays.scale_bar.visible = True
        self._viewer.reset_view(layers=layers)

    def _widen(self, name: str, values: NDArray[np.float32]) -> None:
        """Let the contrast of unwrapped phase go as far as the phase does, if nobody chose it."""
        layer, limits = self._layers[name], self._limits[name]
        if name == "wrapped" or tuple(layer.contrast_limits) != limits:
            return
        some = values[:, ::4, ::4]
        known = some[np.isfinite(some)]
        if not known.size:
            return
        low, high = (float(v) for v in np.quantile(known, SHARES))
        wider = (min(low, limits[0]), max(high, limits[1]))
        if wider != limits:
            layer.contrast_limits_range = wider
            layer.contrast_limits = wider
            self._limits[name] = tuple(layer.contrast_limits)


def span_of_times(viewer: Any) -> tuple[float, float]:
    """Return the middle and the length of what the slider of time reaches over."""
    if viewer.dims.ndim < len(AXES):
        return 0.0, 1.0
    low, high, step = viewer.dims.range[-len(AXES)]
    return (low + high) / 2, high - low + step


def live_layer(stack: xr.DataArray, name: str, times: tuple[float, float]) -> LayerTuple:
    """Return the layer of one frame (time, angle, y, x) that lasts as long as is told."""
    wrapped = name == "wrapped"
    title = "wrapped phase" if wrapped else METHODS[name].label
    data, keywords, kind = stack_layer(
        stack, f"{title}, live", "wrapped" if wrapped else "unwrapped"
    )
    keywords["translate"][0], keywords["scale"][0] = times
    note = {**keywords["metadata"][METADATA_KEY], "kind": "live"}
    return data, {**keywords, "metadata": {METADATA_KEY: note}}, kind
