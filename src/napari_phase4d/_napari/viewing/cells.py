"""Cells and the object in the viewer: outlines, numbers, and the ways that they take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from napari.layers import Labels, Points, Tracks
from napari.utils import Colormap, CyclicLabelColormap, DirectLabelColormap
from numpy.typing import NDArray
from psygnal import Signal

from napari_phase4d._napari.turns import Steps
from napari_phase4d._napari.viewing.layers import layer_tuple, places_of_views, shown
from napari_phase4d.analysis import Cells, copied_labels
from napari_phase4d.io import step_of
from napari_phase4d.later import xr
from napari_phase4d.plotting import OBJECT_COLOUR, colour_of
from napari_phase4d.stacks import AXES, WAVELENGTH
from napari_phase4d.unwrapping import METHODS, object_in

__all__ = ["OUTLINE", "CellLayers", "cells_layer", "numbers_layer", "object_layer", "ways_layer"]

#: Width of outlines in pixels, of ways on screen, and the size of numbers in points.
OUTLINE, WAY, NUMBER_POINTS = 2, 2, 9
#: Numbers on cells whose largest phase exceeds this share of that of all are black, to be read.
BRIGHT = 0.65


@dataclass(frozen=True)
class ReadyLayers:
    """Layers of some cells that are made, and not yet shown."""

    cells: Cells
    numbers: Points
    outlines: Labels

    @classmethod
    def of(cls, cells: Cells) -> ReadyLayers:
        """Make the layers; they take a copy of all labels, and napari compiles their colours."""
        label, colours = named(cells)
        numbers = Points(**numbers_layer(cells, f"numbers of {label}", colours))
        outlines = Labels(**cells_layer(cells.labels, f"cells of {label}", colours))
        outlines.contour = OUTLINE
        outlines.opacity = 1.0  # else the picture would mix into the colour that tells a cell
        return cls(cells, numbers, outlines)


class CellLayers:
    """The layers of the cells that were found last.

    Parameters
    ----------
    viewer : napari.viewer.Viewer
        Where they are shown.
    """

    #: Layers of other cells are on screen, some turns after the cells were found.
    came_up = Signal()

    def __init__(self, viewer: Any) -> None:
        self.viewer = viewer
        self._ready: ReadyLayers | None = None
        self.forget()

    def forget(self) -> None:
        """Leave the layers of before as they are from now on."""
        self._cells: Cells | None = None
        self.outlines: Any = None
        self._numbers: Any = None
        self._ways: Any = None
        #: Ways at the angles that were looked at: making them takes as long as the labels do.
        self._made: dict[int, Tracks] = {}
        self._angle = 0

    @property
    def layers(self) -> list[Any]:
        """Outlines, numbers and ways, as far as there are any."""
        return [la for la in (self.outlines, self._numbers, self._ways) if la is not None]

    @property
    def is_edited(self) -> bool:
        """Whether cells were painted, split, merged or deleted since."""
        if self._cells is None or self.outlines not in self.viewer.layers:
            return False
        found, painted = self._cells.labels.data, self.outlines.data
        # Frame by frame, up to the first that was changed: labels may be longer than memory.
        return any(
            not np.array_equal(np.asarray(painted[time]), np.asarray(found[time]))
            for time in range(len(found))
        )

    def prepare(self, cells: Cells) -> None:
        """Make the layers of cells that are to be shown next; this may be done in any thread."""
        self._ready = None if cells.table.empty else ReadyLayers.of(cells)

    def showing(self, cells: Cells | None) -> Steps:
        """Show cells instead of those of before; a layer in which was painted stays, hidden."""
        ready, self._ready = self._ready, None
        if self.is_edited:
            self.outlines.visible = False  # what was painted is the user's
            self.outlines = None
        gone = [layer for layer in self.layers if layer in self.viewer.layers]
        self.forget()
        # napari collects all garbage after each layer that is removed, so that each has its turn.
        for layer in gone:
            if layer in self.viewer.layers:
                self.viewer.layers.remove(layer)
            yield
        if cells is None or cells.table.empty:
            return
        if ready is None or ready.cells is not cells:
            ready = ReadyLayers.of(cells)
        yield
        self._cells = cells
        self._angle = -1
        self.turn_to(self._angle_on_screen())
        yield
        # Outlines lie on top: they are what is painted in.
        self._numbers = self.viewer.add_layer(ready.numbers)
        yield
        self.outlines = self.viewer.add_layer(ready.outlines)
        self.came_up.emit()

    def _angle_on_screen(self) -> int:
        """Return the number of the view that is on screen."""
        assert self._cells is not None
        angles = places_of_views(np.asarray(self._cells.labels["angle"].values, np.float64))
        labels = list(self.viewer.dims.axis_labels)
        at = self.viewer.dims.point[labels.index("angle")] if "angle" in labels else angles[0]
        return int(np.clip(round((at - angles[0]) / step_of(angles)), 0, len(angles) - 1))

    def turn_to(self, angle: int) -> None:
        """Show the ways at a viewing angle: napari would show those of all angles at once."""
        if self._cells is None or angle == self._angle:
            return
        before, self._angle = self._ways, angle
        visible = before is None or before.visible
        place = len(self.viewer.layers)
        if before is not None:
            if before not in self.viewer.layers:  # the user has removed them
                return
            place = self.viewer.layers.index(before)
        label, colours = named(self._cells)
        active = self.viewer.layers.selection.active
        if angle not in self._made:
            keywords = ways_layer(self._cells, f"ways of {label}", colours, angle)
            if keywords is None:
                return
            self._made[angle] = Tracks(**keywords)
        self._ways = self._made[angle]
        self._ways.visible = visible
        self.viewer.layers.insert(place, self._ways)
        if before is not None:
            self.viewer.layers.remove(before)
        if active is not None and active in self.viewer.layers:
            self.viewer.layers.selection.active = active


def named(cells: Cells) -> tuple[str, dict[int, str]]:
    """Return the label of the method that cells are of, and the colour of each."""
    label = METHODS[cells.method].label if cells.method in METHODS else cells.method
    return label, {int(n): colour_of(int(n)) for n in np.unique(cells.table["cell"])}


def cells_layer(cells: xr.DataArray, name: str, colours: Mapping[int, str]) -> dict[str, Any]:
    """Return the keywords of a calibrated napari Labels layer.

    Parameters
    ----------
    cells : xarray.DataArray
        What `find_cells` gives, dims (time, angle, y, x) with coordinates.
    name : str
        Name in the layer list.
    colours : mapping of int to str
        Colour of each cell; others, such as those painted later, are white.
    """
    table: dict[int | None, str] = {None: "white", 0: "transparent"}
    table |= dict(colours.items())
    # A copy: what is painted in the layer does not change what was found.
    kept, data = keywords_of(cells, name), copied_labels(cells)
    return {**kept, "data": data, "colormap": DirectLabelColormap(color_dict=table)}


def object_layer(phase: xr.DataArray, name: str) -> dict[str, Any]:
    """Return the keywords of a Labels layer with the object of each frame, found when looked at.

    Parameters
    ----------
    phase : xarray.DataArray
        Wrapped phase in radians, dims (time, angle, y, x).
    name : str
        Name in the layer list.
    """
    import dask.array as da

    frames = phase.data if hasattr(phase.data, "dask") else da.from_array(phase.data)
    frames = frames.rechunk((1, 1, *phase.shape[2:]))
    found = frames.map_blocks(
        lambda f: object_in(f[0, 0]).astype(np.uint8)[None, None], dtype="u1"
    )
    kept = keywords_of(phase.copy(data=found), name, "object")
    # For colours by a table napari compiles for half a second, but not for these.
    colours = CyclicLabelColormap(colors=["transparent", OBJECT_COLOUR])
    return {**kept, "data": shown(found), "colormap": colours}


def keywords_of(cells: xr.DataArray, name: str, kind: str = "cells") -> dict[str, Any]:
    """Return what layers of cells have in common: name, scale, units, names of axes."""
    _, keywords, _ = layer_tuple(cells, name, kind, limits=(0, 1), colormap="gray")
    return {k: v for k, v in keywords.items() if k not in ("contrast_limits", "colormap")}


def numbers_layer(cells: Cells, name: str, colours: Mapping[int, str]) -> dict[str, Any]:
    """Return the keywords of a calibrated napari Points layer: numbers in the middle of cells."""
    kept = keywords_of(cells.labels, name)
    places = pixels_of(cells)
    numbers = cells.table["cell"].to_numpy(np.int64)
    return {
        **kept,
        "data": places,
        "features": {"cell": numbers},
        "size": 0.01,
        "opacity": 1.0,
        "text": {"string": "{cell}", "size": NUMBER_POINTS, "color": inks(cells)},
    }


def inks(cells: Cells) -> NDArray[np.float64]:
    """Return the colour (RGBA) of each number: black on cells that are bright, else white."""
    phase = np.abs(cells.table["largest phase (rad)"].to_numpy(np.float64))
    bright = phase > BRIGHT * np.nanmax(phase)
    return np.column_stack([*(np.where(bright, 0.0, 1.0),) * 3, np.ones(len(phase))])


def ways_layer(
    cells: Cells, name: str, colours: Mapping[int, str], angle: int
) -> dict[str, Any] | None:
    """Return the keywords of a calibrated napari Tracks layer, None where nothing moves.

    napari shows the tracks of all viewing angles at once, so that it holds those of one only.
    """
    places, numbers = pixels_of(cells), cells.table["cell"].to_numpy(np.int64)
    here = places[:, 1] == angle
    tracks = np.column_stack([numbers, places])[here]
    tracks = tracks[np.lexsort((tracks[:, 1], tracks[:, 0]))]
    if not len(tracks):
        return None
    top = max([1, *colours])
    ramp = [colours.get(number, "white") for number in range(top + 1)]
    edges = np.append(np.arange(top + 1) / (top + 1), 1.0)
    kept = keywords_of(cells.labels, name)
    known = set(tracks[:, 0].astype(int).tolist())
    parents = cells.labels.attrs.get("parents", ())
    return {
        **kept,
        "data": tracks,
        "features": {"colour": (tracks[:, 0] + 0.5) / (top + 1)},
        "color_by": "colour",
        "colormaps_dict": {"colour": Colormap(ramp, controls=edges, interpolation="zero")},
        "graph": {int(c): [int(p)] for c, p in parents if {int(c), int(p)} <= known},
        "tail_width": WAY,
        "blending": "translucent",
    }


def pixels_of(cells: Cells) -> NDArray[np.float64]:
    """Return where each row of the table lies, as numbers (time, angle, y, x) of the stack."""
    columns = []
    for dim, name in zip(AXES, ("time (s)", "angle (deg)", "y (um)", "x (um)"), strict=True):
        places = np.asarray(cells.labels[dim].values, dtype=np.float64)
        values = cells.table[name].to_numpy(np.float64)
        # Times and angles may be uneven; a cell lies between pixels, but in one frame.
        whole = dim in ("time", "angle")
        columns.append(
            nearest_of(places, values) if whole else (values - places[0]) / step_of(places)
        )
    if WAVELENGTH in cells.labels.coords:  # views are told by both
        keys = ["angle (deg)", "wavelength (um)"]
        views = zip(cells.labels["angle"].values, cells.labels[WAVELENGTH].values, strict=True)
        numbers = {view: number for number, view in enumerate(views)}
        columns[1] = np.array([numbers[row] for row in cells.table[keys].itertuples(False, None)])
    return np.column_stack(columns)


def nearest_of(places: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the number of that place which lies nearest to each value."""
    order = np.argsort(places)
    middles = (places[order][1:] + places[order][:-1]) / 2
    return order[np.searchsorted(middles, values)]
