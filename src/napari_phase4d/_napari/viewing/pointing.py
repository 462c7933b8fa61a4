"""Where the user points: the viewer's sliders, the mouse over it, and regions that are drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import numpy as np
from napari.layers import Labels, Shapes
from numpy.typing import NDArray

from napari_phase4d._napari.viewing.layers import METADATA_KEY, places_of_views
from napari_phase4d.analysis import polygon_mask, region_masks
from napari_phase4d.io import step_of
from napari_phase4d.later import pd, xr

__all__ = [
    "Following",
    "LabelsWatch",
    "current_frame",
    "frames_of_regions",
    "go_to_frame",
    "is_region_layer",
    "newest_region",
    "note_frame",
    "pixel_under_cursor",
    "regions_of_layer",
    "table_of_regions",
]

#: Kinds of event after which a layer's data are new.
DONE_ACTIONS = ("added", "changed", "removed")


class Following:
    """Tells the steps when the sliders or the mouse have moved, until `stop` is called.

    Parameters
    ----------
    viewer : napari.viewer.Viewer
        What to follow.
    steps : sequence of Step
        A step with ``frame_changed()``, ``cursor_moved()`` or ``clicked()`` is told.
    """

    def __init__(self, viewer: Any, steps: Sequence[Any]) -> None:
        self._viewer = viewer
        self._steps = steps
        self._regions: list[Watched] = []
        self._drawn: Callable[[Any, Sequence[int]], None] | None = None
        self._stopped = False
        viewer.dims.events.current_step.connect(self._frame_changed)
        viewer.mouse_move_callbacks.append(self._cursor_moved)
        viewer.mouse_drag_callbacks.append(self._pressed)

    def stop(self, *_: object) -> None:
        """Let go of the viewer."""
        if self._stopped:
            return
        self._stopped = True
        self._viewer.dims.events.current_step.disconnect(self._frame_changed)
        if self._cursor_moved in self._viewer.mouse_move_callbacks:
            self._viewer.mouse_move_callbacks.remove(self._cursor_moved)
        if self._pressed in self._viewer.mouse_drag_callbacks:
            self._viewer.mouse_drag_callbacks.remove(self._pressed)
        for known in self._regions:
            known.layer.events.data.disconnect(self._region_changed)
        self._regions = []

    def watch_regions(self, drawn: Callable[[Any, Sequence[int]], None]) -> None:
        """Call a function whenever a shape is drawn, changed or removed.

        ``drawn(layer, changed)`` is told the layer, and the numbers of shapes that were there and
        have other corners now.
        """
        self._drawn = drawn
        for layer in self._viewer.layers:
            if isinstance(layer, Shapes) and self._watched(layer) is None:
                layer.events.data.connect(self._region_changed)
                self._regions.append(Watched(layer, copied_corners(layer)))

    def _watched(self, layer: Any) -> Watched | None:
        """Return what is known of a layer, None if it is not watched."""
        return next((known for known in self._regions if known.layer is layer), None)

    def _frame_changed(self, event: Any = None) -> None:
        for step in self._steps:
            if hasattr(step, "frame_changed"):
                step.frame_changed()

    def _cursor_moved(self, viewer: Any, event: Any) -> None:
        for step in self._steps:
            if hasattr(step, "cursor_moved"):
                step.cursor_moved()

    def _pressed(self, viewer: Any, event: Any) -> Iterator[None]:
        """Tell the steps of a click; not where the mouse was dragged or a layer is painted in."""
        active = viewer.layers.selection.active
        if active is not None and str(active.mode) != "pan_zoom":
            return
        yield
        if event.type == "mouse_move":  # dragged
            return
        for step in self._steps:
            if hasattr(step, "clicked"):
                step.clicked()

    def _region_changed(self, event: Any) -> None:
        # "adding" and the like come first, when the data are still those from before.
        if self._drawn is None or str(getattr(event.action, "value", "")) not in DONE_ACTIONS:
            return
        known = self._watched(event.source)
        self._drawn(event.source, () if known is None else known.changed())


@dataclass
class Watched:
    """A layer of regions, and the corners of its shapes as they were last."""

    layer: Shapes
    corners: list[NDArray[np.float64]]

    def changed(self) -> list[int]:
        """Return which shapes have other corners than before; one that was added is none."""
        before, self.corners = self.corners, copied_corners(self.layer)
        if len(before) != len(self.corners):
            return []
        pairs = zip(before, self.corners, strict=True)
        return [n for n, pair in enumerate(pairs) if not np.array_equal(*pair)]


def copied_corners(layer: Shapes) -> list[NDArray[np.float64]]:
    """Return the corners of all shapes of a layer, which may change them where they lie."""
    return [np.array(corners, dtype=np.float64) for corners in layer.data]


class LabelsWatch:
    """Tells when a layer holds other labels than were noted: painted, undone or given anew.

    Parameters
    ----------
    changed : callable
        Is called once after each note.
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._noted: tuple[Any, Any] | None = None

    def note(self, layer: Any) -> None:
        """Watch a layer as it is now, and no other; one without labels does not matter."""
        self.stop()
        if isinstance(layer, Labels):
            self._noted = layer, mark_of_labels(layer)
            layer.events.paint.connect(self._tell)
            # After undo and redo, napari tells of no more than that something is shown anew.
            layer.events.set_data.connect(self._compare)
            layer.events.data.connect(self._compare)

    def stop(self) -> None:
        """Watch nothing."""
        if self._noted is not None:
            events = self._noted[0].events
            events.paint.disconnect(self._tell)
            events.set_data.disconnect(self._compare)
            events.data.disconnect(self._compare)
            self._noted = None

    def _compare(self, event: Any = None) -> None:
        if self._noted is not None and mark_of_labels(self._noted[0]) != self._noted[1]:
            self._tell()

    def _tell(self, event: Any = None) -> None:
        self.stop()
        self._changed()


def mark_of_labels(layer: Labels) -> object:
    """Return what is another if the labels are others; of those on disk, which stack it is."""
    data = layer.data
    if isinstance(data, np.ndarray):
        return data.shape, data.dtype.str, crc32(np.ascontiguousarray(data).data)
    return id(getattr(data, "__wrapped__", data))  # napari may hand out a new proxy each time


def current_frame(viewer: Any, stack: xr.DataArray) -> tuple[int, int]:
    """Return the (time, angle) numbers of the frame that is on screen."""
    labels = list(viewer.dims.axis_labels)
    found = []
    for axis in ("time", "angle"):
        origin, step, n = axis_steps(stack, axis)
        world = viewer.dims.point[labels.index(axis)] if axis in labels else origin
        found.append(int(np.clip(round((world - origin) / step), 0, n - 1)))
    return found[0], found[1]


def go_to_frame(viewer: Any, stack: xr.DataArray, time: int, angle: int) -> None:
    """Move the sliders to a frame of a stack."""
    labels = list(viewer.dims.axis_labels)
    for axis, number in (("time", time), ("angle", angle)):
        if axis in labels:
            origin, step, _ = axis_steps(stack, axis)
            viewer.dims.set_point(labels.index(axis), origin + number * step)


def pixel_under_cursor(viewer: Any, stack: xr.DataArray) -> tuple[int, int] | None:
    """Return the (y, x) numbers of the pixel under the mouse, None outside of the stack."""
    found = []
    for axis, world in zip(("y", "x"), viewer.cursor.position[-2:], strict=True):
        origin, step, n = axis_steps(stack, axis)
        number = round((world - origin) / step)
        if not 0 <= number < n:
            return None
        found.append(int(number))
    return found[0], found[1]


def axis_steps(stack: xr.DataArray, axis: str) -> tuple[float, float, int]:
    """Return where an axis starts, its step as the layers have it, and its length."""
    coordinates = np.asarray(stack[axis].values, dtype=np.float64)
    if axis == "angle":
        coordinates = places_of_views(coordinates)
    return float(coordinates[0]), step_of(coordinates), len(coordinates)


Mask = NDArray[np.bool_]
#: Features of a shape: the numbers of time and angle that were on screen when it was drawn.
FRAME_COLUMNS = ("drawn at time", "drawn at angle")
#: Corners that stand for an ellipse.
ELLIPSE_CORNERS = 64


def is_region_layer(layer: Any) -> bool:
    """Say whether a layer can hold regions to measure."""
    return isinstance(layer, Labels | Shapes)


def regions_of_layer(layer: Any, phase: xr.DataArray) -> dict[str, Mask]:
    """Return the regions of a Shapes or Labels layer: name -> mask.

    Parameters
    ----------
    layer : napari.layers.Shapes or napari.layers.Labels
        Shapes are masks (y, x), where they were drawn; what they go along with is looked for in
        `with_their_cells`, by `frames_of_regions`. Labels have the axes (y, x), (time, y, x) or
        (time, angle, y, x) of the phase.
    phase : xarray.DataArray
        The phase, dims (time, angle, y, x).

    Raises
    ------
    ValueError
        If there is no region, or a layer does not fit the phase.
    """
    if isinstance(layer, Labels):
        return dict(region_masks(np.asarray(layer.data)))
    areas = areas_of(layer)
    if not areas:
        msg = f"“{layer.name}” holds no area; draw a polygon, rectangle or ellipse in it"
        raise ValueError(msg)
    return {f"region {index + 1}": mask_of(layer, index, phase) for index in areas}


def note_frame(layer: Any, frame: tuple[int, int], changed: Sequence[int] = ()) -> None:
    """Note in a layer of regions at which (time, angle) those were drawn that do not say it.

    Those that were ``changed`` are where they are now at this frame. Lines are no regions: a
    layer of nothing else stays as it is.
    """
    areas = areas_of(layer)
    if not areas:
        return
    numbers, known = np.arange(len(layer.data)), layer.features
    columns = [
        known[name].to_numpy(np.float64) if name in known else np.full(len(layer.data), np.nan)
        for name in FRAME_COLUMNS
    ]
    features = known.copy()
    for name, column, number in zip(FRAME_COLUMNS, columns, frame, strict=True):
        new = (~np.isfinite(column) | np.isin(numbers, changed)) & np.isin(numbers, areas)
        features[name] = np.where(new, float(number), column)
    layer.features = features
    # Else napari gives the next shape the frame of this one.
    defaults = layer.feature_defaults
    kept = {name: defaults[name].iloc[0] for name in layer.features if name in defaults}
    layer.feature_defaults = kept | dict.fromkeys(FRAME_COLUMNS, np.nan)


def frames_of_regions(layer: Shapes) -> dict[str, tuple[int, int]]:
    """Return the (time, angle) at which each region of a layer was drawn, where that is known."""
    known = layer.features
    if any(name not in known for name in FRAME_COLUMNS):
        return {}
    places = known[list(FRAME_COLUMNS)].to_numpy(np.float64)
    return {
        f"region {index + 1}": (int(places[index][0]), int(places[index][1]))
        for index in areas_of(layer)
        if np.isfinite(places[index]).all()
    }


def table_of_regions(layers: Iterable[Any]) -> pd.DataFrame:
    """Return the corners of all regions that were drawn, a row each; empty without any.

    Parameters
    ----------
    layers : iterable of napari layers
        Of these, Shapes layers that the window made count.
    """
    rows = [
        {
            "layer": layer.name,
            "region": index + 1,
            "kind": layer.shape_type[index],
            **dict(
                zip(("time", "view"), frames.get(f"region {index + 1}", ("", "")), strict=True)
            ),
            "y (um)": y,
            "x (um)": x,
        }
        for layer in layers
        if isinstance(layer, Shapes) and METADATA_KEY in layer.metadata
        for frames in [frames_of_regions(layer)]
        for index in areas_of(layer)
        for y, x in corners_of(layer, index)
    ]
    return pd.DataFrame(rows)


def newest_region(viewer: Any, phase: xr.DataArray, drawn_in: Any = None) -> Mask | None:
    """Return the region that was drawn last, None if there is none.

    It is that of the layer that was ``drawn_in``, else of the topmost layer that has any.
    """
    first = [drawn_in] if drawn_in is not None and drawn_in in viewer.layers else []
    for layer in (*first, *reversed(viewer.layers)):
        if isinstance(layer, Shapes) and (areas := areas_of(layer)):
            return mask_of(layer, areas[-1], phase)
    return None


def areas_of(layer: Shapes) -> list[int]:
    """Return the numbers of the shapes that have an area, in the order they were drawn."""
    return [n for n, kind in enumerate(layer.shape_type) if kind not in ("line", "path")]


def corners_of(layer: Shapes, index: int) -> NDArray[np.float64]:
    """Return the corners (y, x) of one shape in micrometres."""
    return np.array([layer.data_to_world(corner) for corner in layer.data[index]])[:, -2:]


def mask_of(layer: Shapes, index: int, phase: xr.DataArray) -> Mask:
    """Return the pixels of the phase that one shape of a layer covers."""
    corners = corners_of(layer, index)
    outline = ellipse_outline(corners) if layer.shape_type[index] == "ellipse" else corners
    return polygon_mask(in_pixels(outline, phase), (phase.sizes["y"], phase.sizes["x"]))


def in_pixels(world: NDArray[np.float64], phase: xr.DataArray) -> NDArray[np.float64]:
    """Return (y, x) places in micrometres as pixel numbers of the phase."""
    columns = []
    for column, axis in enumerate(("y", "x")):
        places = np.asarray(phase[axis].values, dtype=np.float64)
        columns.append((world[:, column] - places[0]) / step_of(places))
    return np.stack(columns, axis=1)


def ellipse_outline(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the outline of the ellipse in a rectangle that is given by its four corners."""
    middle = corners.mean(axis=0)
    first, second = (corners[1] - corners[0]) / 2, (corners[3] - corners[0]) / 2
    turns = np.linspace(0, 2 * np.pi, ELLIPSE_CORNERS, endpoint=False)[:, None]
    outline: NDArray[np.float64] = middle + np.cos(turns) * first + np.sin(turns) * second
    return outline
