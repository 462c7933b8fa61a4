"""Layers: all that this plugin makes come from `layer_tuple`, and what the user's layers hold.

Stacks larger than memory are shown one frame at a time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from napari.utils import Colormap
from numpy.typing import ArrayLike, NDArray

from napari_phase4d.holography import first_seen
from napari_phase4d.io import PROGRAM, open_recording, step_of
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import Recipe
from napari_phase4d.plotting import phase_colours, safety_colours
from napari_phase4d.recording import Recording, one_frame
from napari_phase4d.stacks import AXES, UNITS, WAVELENGTH, wavelength_coordinate

__all__ = [
    "LAYER_UNITS",
    "METADATA_KEY",
    "PHASE_COLOURS",
    "LayerTuple",
    "OnDemand",
    "hologram_layer",
    "is_hologram_layer",
    "is_phase_layer",
    "keep_zero_black",
    "layer_tuple",
    "lazy_of",
    "phase_colormap",
    "places_of_views",
    "recalibrate_layer",
    "recipe_of_layer",
    "recording_of_layer",
    "region_layer",
    "shown",
    "spread_over_angles",
    "stack_layer",
    "stack_of_layer",
    "thinned",
    "truth_among",
    "with_recipe",
]

#: Units of the axes by the names that napari knows.
LAYER_UNITS = ("s", "degree", "um", "um")
#: Dark to light up to 1, half a cycle; red to yellow beyond.
MARGIN_COLORMAP = Colormap(
    [(0.05, 0.05, 0.1), (0.85, 0.85, 0.9), (0.85, 0.15, 0.1), (1.0, 0.9, 0.2)],
    name="steps",
    controls=[0.0, 0.5, 0.505, 1.0],
)
#: Dark where there is no difference, blue below and orange above.
DIFFERENCE_COLORMAP = Colormap(
    [(0.45, 0.85, 1.0), (0.1, 0.3, 0.75), (0.05, 0.05, 0.1), (0.8, 0.3, 0.05), (1.0, 0.85, 0.4)],
    name="difference",
)
#: Kinds whose contrast and colours do not depend on what is in them.
FIXED: dict[str, tuple[tuple[float, float], str | Colormap]] = {
    "wrapped": ((-np.pi, np.pi), "twilight_shifted"),
    "margin": ((0.0, 2.0), MARGIN_COLORMAP),
    "difference": ((-2 * np.pi, 2 * np.pi), DIFFERENCE_COLORMAP),
}
#: What names of colours of phase begin with.
PHASE_COLOURS = "phase"
#: Where a layer's metadata hold what this plugin knows of it.
METADATA_KEY = PROGRAM

LayerTuple = tuple[Any, dict[str, Any], str]


def layer_tuple(
    stack: xr.DataArray,
    name: str,
    kind: str,
    *,
    limits: tuple[float, float],
    colormap: str | Colormap,
    visible: bool = True,
) -> LayerTuple:
    """Return a calibrated napari image layer as (data, keywords, "image").

    Parameters
    ----------
    stack : xarray.DataArray
        Dims (time, angle, y, x) with coordinates in seconds, degrees and micrometres.
    name : str
        Name in the layer list.
    kind : str
        What it is, for the plugin to know it again: "holograms", or a kind of `stack_layer`.
    limits : tuple of float
        Contrast limits.
    colormap : str or Colormap
        A napari colormap or its name.
    visible : bool, optional
        Whether it is shown at once.
    """
    coordinates = [np.asarray(stack[axis].values, dtype=np.float64) for axis in AXES]
    places = [coordinates[0], places_of_views(coordinates[1]), *coordinates[2:]]
    keywords = {
        "name": name,
        "scale": [step_of(c) for c in places],
        "translate": [float(c[0]) for c in places],
        "units": LAYER_UNITS,
        "axis_labels": AXES,
        "contrast_limits": limits,
        "colormap": colormap,
        "visible": visible,
        "metadata": {
            METADATA_KEY: {
                **stack.attrs,  # whose own kind says only whether it is wrapped
                "kind": kind,
                "times_s": coordinates[0].tolist(),
                "angles_deg": coordinates[1].tolist(),
                **wavelength_note(stack),
            }
        },
    }
    return shown(stack.data), keywords, "image"


def wavelength_note(stack: xr.DataArray) -> dict[str, Any]:
    """Return what a layer notes of the wavelength of each view, nothing where they are one."""
    if WAVELENGTH not in stack.coords:
        return {}
    return {"wavelengths_um": np.asarray(stack[WAVELENGTH].values, dtype=np.float64).tolist()}


def places_of_views(angles_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where views lie on the angle's axis: at their angles, or by number.

    Views of one angle that differ in wavelength can't lie at the same place.
    """
    rising = bool((np.diff(angles_deg) > 0).all())
    return angles_deg if rising else np.arange(len(angles_deg), dtype=np.float64)


def hologram_layer(recording: Recording, sample: str = "") -> LayerTuple:
    """Return the layer of a recording's frames, lazily, with an angle axis of one step.

    Parameters
    ----------
    recording : Recording
        The frames.
    sample : str, optional
        Name of the sample that it is, so that what is known of it is found again.
    """
    first = first_seen(recording)
    stack = recording.holograms.expand_dims({"angle": [0.0]}, axis=1)
    stack.attrs = optics_note(recording) | ({"sample": sample} if sample else {})
    limits = contrast(first, (0.001, 0.999))
    data, keywords, kind = layer_tuple(
        stack, recording.name, "holograms", limits=limits, colormap="gray"
    )
    # Of lazy frames the file is asked, not what was made of them here.
    return OnDemand(recording.holograms.data) if is_lazy(data) else data, keywords, kind


def stack_layer(stack: xr.DataArray, name: str, kind: str, *, visible: bool = True) -> LayerTuple:
    """Return the layer of a 4-D result.

    Parameters
    ----------
    stack : xarray.DataArray
        Dims (time, angle, y, x).
    name : str
        Name in the layer list.
    kind : str
        "wrapped", "amplitude", "unwrapped", "exact", "margin", "confidence", "difference",
        "optical path" or "dry mass".
    visible : bool, optional
        Whether it is shown at once.
    """
    limits, colormap = look_of(stack, kind)
    return layer_tuple(stack, name, kind, limits=limits, colormap=colormap, visible=visible)


def look_of(stack: xr.DataArray, kind: str) -> tuple[tuple[float, float], str | Colormap]:
    """Return contrast limits and colours that suit a result."""
    if kind in FIXED:
        return FIXED[kind]
    if kind == "confidence":  # as the map of frames to start from
        return (0.0, 1.0), Colormap(safety_colours(np.linspace(0, 1, 256)), name="safety")
    limits = contrast(some_of(stack), (0.001, 0.9995))
    return limits, "gray" if kind == "amplitude" else phase_colormap(limits)


def phase_colormap(limits: tuple[float, float]) -> Colormap:
    """Return the colours of unwrapped phase, and of what goes with it, between two limits.

    napari knows colours by their name, so that those with another place of zero need another.
    """
    low, high = limits
    zero = round(float(-low / (high - low)), 2) + 0.0  # and no -0
    name = f"{PHASE_COLOURS}, zero at {100 * zero:.0f} %" if zero else PHASE_COLOURS
    return Colormap(phase_colours(-zero, 1 - zero), name=name)


def keep_zero_black(event: Any) -> None:
    """Give a layer the colours of phase between its new limits, if it has those of phase."""
    layer = event.source
    if not layer.colormap.name.startswith(PHASE_COLOURS):
        return  # the user has chosen others
    wanted = phase_colormap(tuple(layer.contrast_limits))
    if wanted.name != layer.colormap.name:
        layer.colormap = wanted


def some_of(stack: xr.DataArray) -> NDArray[Any]:
    """Return a sixteenth of the pixels of some frames, which tells the range and is quick."""
    return thinned(shown(stack.data))


def thinned(data: Any) -> NDArray[Any]:
    """Return every fourth row and column of some frames (n, y, x) of a stack."""
    times = range(0, data.shape[0], max(1, data.shape[0] // 16))
    return np.stack([data[t, a][::4, ::4] for t in times for a in range(data.shape[1])])


def contrast(values: NDArray[Any], quantiles: tuple[float, float]) -> tuple[float, float]:
    """Return contrast limits that leave out a few extreme pixels, and unknown ones."""
    known = values[np.isfinite(values)]
    low, high = (float(v) for v in np.quantile(known, quantiles)) if known.size else (0.0, 1.0)
    return (low, high) if high > low else (low, low + 1.0)


def spread_over_angles(layer: Any, angles_deg: ArrayLike) -> None:
    """Let one of our hologram layers show its frames at every viewing angle.

    A camera frame holds all views at once. The frames are repeated without being copied.
    """
    coordinates = np.asarray(angles_deg, dtype=np.float64)
    if isinstance(layer.data, OnDemand):
        layer.data = layer.data.spread(len(coordinates))
    else:
        data = layer.data[:, :1]
        layer.data = np.broadcast_to(data, (len(data), len(coordinates), *data.shape[2:]))
    places = places_of_views(coordinates)
    layer.scale = [layer.scale[0], step_of(places), *layer.scale[2:]]
    layer.translate = [layer.translate[0], float(places[0]), *layer.translate[2:]]
    note = {**layer.metadata[METADATA_KEY], "angles_deg": coordinates.tolist()}
    layer.metadata = {**layer.metadata, METADATA_KEY: note}


def recalibrate_layer(layer: Any, recording: Recording, pixel_um: float) -> None:
    """Give one of our layers a recording's new times and pixel.

    Parameters
    ----------
    layer : napari.layers.Image
        Made by this module.
    recording : Recording
        With the new optics and times.
    pixel_um : float
        Width that a camera pixel had before, in micrometres.
    """
    factor = recording.optics.pixel_um / pixel_um
    times = recording.times_s
    layer.scale = [step_of(times), layer.scale[1], *(s * factor for s in layer.scale[2:])]
    layer.translate = [
        float(times[0]),
        layer.translate[1],
        *(t * factor for t in layer.translate[2:]),
    ]
    note = {**layer.metadata[METADATA_KEY], "times_s": times.tolist()}
    note |= {key: value for key, value in optics_note(recording).items() if key in note}
    layer.metadata = {**layer.metadata, METADATA_KEY: note}


def optics_note(recording: Recording) -> dict[str, Any]:
    """Return what a hologram layer notes of its recording."""
    optics = recording.optics
    return {
        "wavelength_um": optics.wavelength_um,
        "camera_pixel_um": optics.camera_pixel_um,
        "magnification": optics.magnification,
        "medium_index": optics.medium_index,
        "recording": recording.name,
        "source": recording.source,
        "notes": list(recording.notes),
    }


def region_layer(like: xr.DataArray, name: str) -> dict[str, Any]:
    """Return the keywords of an empty Shapes layer to draw regions in.

    It has the axes y and x only, so that a region is seen where it was drawn at all times and
    angles. When it is measured it goes along with the cell that it was drawn on, unless it is told
    to stand still.

    Parameters
    ----------
    like : xarray.DataArray
        The stack that the regions are for, dims (time, angle, y, x).
    name : str
        Name in the layer list.
    """
    coordinates = [np.asarray(like[axis].values, dtype=np.float64) for axis in AXES[2:]]
    return {
        "name": name,
        "ndim": 2,
        "scale": [step_of(c) for c in coordinates],
        "translate": [float(c[0]) for c in coordinates],
        "units": LAYER_UNITS[2:],
        "axis_labels": AXES[2:],
        "face_color": "transparent",
        "edge_color": "white",
        "edge_width": 0.6,
        "metadata": {METADATA_KEY: {"kind": "regions"}},
    }


def with_recipe(layer: LayerTuple, recipe: Recipe) -> LayerTuple:
    """Return a layer that notes the settings to go on with, for the dock to take."""
    data, keywords, kind = layer
    note = {**keywords["metadata"][METADATA_KEY], "recipe": recipe.model_dump(mode="json")}
    return data, {**keywords, "metadata": {METADATA_KEY: note}}, kind


def is_hologram_layer(layer: Any) -> bool:
    """Say whether a layer could be a hologram video: its own kind, or a grey image in 2 or 3 D."""
    note = layer.metadata.get(METADATA_KEY)
    if note is not None:
        return bool(note.get("kind") == "holograms")
    return not layer.rgb and not layer.multiscale and layer.ndim in (2, 3)


def is_phase_layer(layer: Any) -> bool:
    """Say whether a layer is wrapped phase that this plugin made."""
    return bool(layer.metadata.get(METADATA_KEY, {}).get("kind") == "wrapped")


def stack_of_layer(layer: Any) -> xr.DataArray:
    """Return the stack that one of our 4-D layers shows, with its coordinates."""
    note = dict(layer.metadata[METADATA_KEY])
    note.pop("kind")
    note.pop("recipe", None)
    steps = zip(layer.data.shape, layer.scale, layer.translate, strict=True)
    evenly = [offset + scale * np.arange(n) for n, scale, offset in steps]
    light = note.pop("wavelengths_um", None)
    known = (np.asarray(note.pop("times_s")), np.asarray(note.pop("angles_deg")), *evenly[2:])
    coords = {
        axis: (axis, values, {"units": UNITS[axis]})
        for axis, values in zip(AXES, known, strict=True)
    }
    if light is not None:
        coords[WAVELENGTH] = wavelength_coordinate(np.asarray(light))
    return xr.DataArray(lazy_of(layer.data), dims=AXES, coords=coords, attrs=note)


def truth_among(layers: Any, phase: xr.DataArray) -> xr.DataArray | None:
    """Return the exact phase that belongs to wrapped phase, if a layer shows it."""
    for layer in layers:
        note = layer.metadata.get(METADATA_KEY, {})
        same = note.get("object") == phase.attrs.get("object") is not None
        if note.get("kind") == "exact" and same and layer.data.shape == phase.shape:
            return stack_of_layer(layer)
    return None


def recording_of_layer(layer: Any) -> Recording:
    """Return the recording that a layer shows.

    Parameters
    ----------
    layer : napari.layers.Image
        A layer made by `hologram_layer`, whose optics and times are noted in it, or any grey
        image (y, x) or video (time, y, x), whose scale and units are used where it has them.
    """
    note = layer.metadata.get(METADATA_KEY)
    if note is None:
        return open_recording(layer)
    optics = Optics(
        note["wavelength_um"],
        note["camera_pixel_um"],
        note["magnification"],
        note["medium_index"],
    )
    return Recording.from_frames(
        frames_of(layer.data),
        optics=optics,
        times_s=np.asarray(note["times_s"]),
        name=str(layer.name),
        source=str(note["source"]),
        notes=tuple(note["notes"]),
    )


def recipe_of_layer(layer: Any) -> Recipe | None:
    """Return the settings that came with a layer, None where there are none."""
    noted = layer.metadata.get(METADATA_KEY, {}).get("recipe")
    return None if noted is None else Recipe.model_validate(noted)


class OnDemand:
    """Frames (time, angle, y, x) that are read when they are looked at.

    A dask array of many frames takes a tenth of a second for each one that is shown, most of it
    for its graph; this goes straight to the file.

    Parameters
    ----------
    lazy : dask array
        (time, angle, y, x); or (time, y, x), which is then shown at every angle.
    n_angles : int, optional
        Number of angles that frames without an angle are shown at.
    """

    ndim = 4

    def __init__(self, lazy: Any, n_angles: int = 1) -> None:
        self._lazy = lazy
        times, *rest = lazy.shape
        self.shape = (times, *rest) if lazy.ndim == self.ndim else (times, n_angles, *rest)
        self.dtype = np.dtype(lazy.dtype)
        self._last: tuple[int, NDArray[Any]] | None = None

    def __getitem__(self, key: Any) -> NDArray[Any]:
        """Return numbers by whole numbers and slices, as of an array."""
        key = key if isinstance(key, tuple) else (key,)
        if len(key) < 2 or not all(isinstance(i, int | np.integer) for i in key[:2]):
            return np.asarray(self.as_dask()[key])
        frames = self._at(int(key[0]))
        frame = frames[int(key[1])] if self._lazy.ndim == self.ndim else frames
        return np.asarray(frame[key[2:]])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Return everything at once."""
        return np.asarray(self.as_dask(), dtype=dtype)

    def spread(self, n_angles: int) -> OnDemand:
        """Return frames without an angle, shown at so many."""
        return OnDemand(self._lazy, n_angles)

    def as_dask(self) -> Any:
        """Return the stack as a dask array (time, angle, y, x)."""
        import dask.array as da

        if self._lazy.ndim == self.ndim:
            return self._lazy
        return da.broadcast_to(self._lazy[:, None], self.shape)

    @property
    def frames(self) -> Any:
        """What was given, or its first angle: (time, y, x)."""
        return self._lazy if self._lazy.ndim < self.ndim else self._lazy[:, 0]

    def _at(self, time: int) -> NDArray[Any]:
        """Return what the file holds of one time; the last one is kept."""
        last = self._last
        if last is None or last[0] != time:
            last = self._last = (time, np.asarray(one_frame(self._lazy, time)))
        return last[1]


def is_lazy(data: Any) -> bool:
    """Say whether numbers are not in memory yet."""
    return isinstance(data, OnDemand) or hasattr(data, "dask")


def shown(data: Any) -> Any:
    """Return what napari is given to look at: arrays as they are, lazy ones on demand."""
    return OnDemand(data) if hasattr(data, "dask") else data


def lazy_of(data: Any) -> Any:
    """Return the array of a layer of ours, NumPy or dask."""
    return data.as_dask() if isinstance(data, OnDemand) else data


def frames_of(data: Any) -> Any:
    """Return camera frames (time, y, x) from a layer that shows them at every angle."""
    return data.frames if isinstance(data, OnDemand) else data[:, 0]
