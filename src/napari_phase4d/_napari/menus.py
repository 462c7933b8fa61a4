"""What napari's menus call: opening, saving, samples; work on the selected layer."""

from __future__ import annotations

import atexit
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pint
from napari.layers import Image
from napari.qt.threading import create_worker
from napari.utils import cancelable_progress
from napari.utils.notifications import show_error, show_info, show_warning
from napari.viewer import Viewer
from qtpy.QtCore import QTimer

from napari_phase4d._napari.jobs import Ended, Hooks, sentence_of
from napari_phase4d._napari.preferences import (
    own_optics,
    own_refraction_increment,
    with_own_optics,
)
from napari_phase4d._napari.session.opening import open_anything
from napari_phase4d._napari.viewing.layers import (
    LAYER_UNITS,
    METADATA_KEY,
    LayerTuple,
    hologram_layer,
    is_hologram_layer,
    is_phase_layer,
    lazy_of,
    recording_of_layer,
    stack_layer,
    stack_of_layer,
    with_recipe,
)
from napari_phase4d.holography import find_lobes, reconstruct
from napari_phase4d.io import (
    JOINED_SUFFIXES,
    OME_TIFF,
    OME_ZARR,
    READABLE_SUFFIXES,
    needs_layout,
    open_recording,
    read_results,
    write_phase,
)
from napari_phase4d.io.results import is_result
from napari_phase4d.io.sequences import in_order
from napari_phase4d.later import xr
from napari_phase4d.optics import Optics
from napari_phase4d.pipeline import Recipe
from napari_phase4d.recording import Recording
from napari_phase4d.sample import CELLS, EUGLENA, cells_sample, euglena_sample, yeast_sample
from napari_phase4d.stacks import AXES, PLAIN_AXES, wavelengths_of
from napari_phase4d.task import Cancelled, Task
from napari_phase4d.unwrapping import METHODS, unwrap

__all__ = [
    "budding_yeast",
    "cells_video",
    "dry_mass_density",
    "euglena_phase",
    "euglena_video",
    "get_reader",
    "optical_path",
    "reconstruct_selected",
    "unwrap_2d",
    "unwrap_ta",
    "unwrap_wl1",
    "write_stack",
]

RECIPE_SUFFIX = ".json"
#: What is told by its unit alone.
KINDS_BY_UNIT = {"nm": "optical path", "pg/um^2": "dry mass", "pi rad": "margin"}


def get_reader(path: str | list[str]) -> Callable[[Any], list[LayerTuple]] | None:
    """Return the function that reads a file, or None if this plugin can't."""
    if isinstance(path, list):
        files = [Path(one) for one in path]
        if len(files) == 1:
            return get_reader(path[0])
        one_kind = len({file.suffix.lower() for file in files}) == 1
        return read if one_kind and files[0].suffix.lower() in JOINED_SUFFIXES else None
    file = Path(path)
    if file.suffix.lower() == RECIPE_SUFFIX:
        return read if is_recipe(file) else None
    if file.is_dir() or file.suffix.lower() in READABLE_SUFFIXES:
        return read
    return None


def read(path: str | list[str]) -> list[LayerTuple]:
    """Read a hologram video, wrapped phase, a result, or what a recipe names.

    Several files follow one another in time, in the order of the numbers in their names.
    """
    if isinstance(path, list) and len(path) > 1:
        return [hologram_layer(open_recording(in_order(map(Path, path))))]
    file = Path(path[0] if isinstance(path, list) else path)
    if needs_layout(file):
        msg = (
            f"{file.name} is raw and can't say how large its frames are; "
            "open it in step 1 of the Phase 4D dock, which asks how its frames lie"
        )
        raise ValueError(msg)
    if is_result(file):
        stack = read_results(file)
        kind = kind_of(stack.attrs)
        if kind == "wrapped":  # what is made of it can be made again from this file
            stack = stack.assign_attrs(source=str(file.resolve()))
        return [stack_layer(stack, name_of(file), kind)]
    opened = open_anything(file)
    if isinstance(opened.content, Recording):
        layer = hologram_layer(opened.content)
    else:
        name = Path(str(opened.content.attrs.get("source", file))).stem
        layer = stack_layer(opened.content, name, "wrapped")
    return [layer if opened.recipe is None else with_recipe(layer, opened.recipe)]


def name_of(file: Path) -> str:
    """Return what to call a result: the name of its file without the endings."""
    return file.name.removesuffix(OME_TIFF).removesuffix(OME_ZARR)


def is_recipe(file: Path) -> bool:
    """Say whether a file is a recipe of this program that names a recording."""
    try:
        return bool(Recipe.from_file(file).recording)
    except (OSError, ValueError):
        return False


def kind_of(attrs: dict[Any, Any]) -> str:
    """Return the kind of a result from its attributes."""
    if attrs.get("units") in KINDS_BY_UNIT:
        return KINDS_BY_UNIT[attrs["units"]]
    if "of" in attrs:
        return "confidence"
    if "less" in attrs:
        return "difference"
    if "method" in attrs:
        return "unwrapped"
    if attrs.get("exact"):
        return "exact"
    return "wrapped" if attrs.get("units") == "rad" else "amplitude"


def write_stack(path: str, data: Any, keywords: dict[str, Any]) -> list[str]:
    """Write one image layer as OME-TIFF or OME-Zarr that `read_results` and napari open again.

    Lazy layers are written some frames at a time.

    Parameters
    ----------
    path : str
        File to write; the ending is made ``.ome.tif``, or ``.ome.zarr`` if it is ``.zarr``.
    data : array_like
        Axes (time, angle, y, x), (time, y, x) or (y, x).
    keywords : dict
        The layer's other properties, as napari gives them to writers.

    Returns
    -------
    list of str
        The file that was written.

    Raises
    ------
    OSError
        If the file can't be written; an older file of that name is then left as it was.
    ValueError
        If the layer is in colour or has other axes.
    """
    if keywords.get("rgb") or data.ndim not in PLAIN_AXES:
        msg = (
            f"“{keywords.get('name', 'the layer')}” has the shape {tuple(data.shape)}; "
            f"Phase 4D saves grey stacks with the axes {', '.join(AXES)}"
        )
        raise ValueError(msg)
    if METADATA_KEY in keywords.get("metadata", {}):
        stack = own_stack(data, keywords)
    else:
        stack = plain_stack(lazy_of(data), keywords)
    return [str(write_phase(with_ending(Path(path)), stack))]


def own_stack(values: Any, keywords: dict[str, Any]) -> xr.DataArray:
    """Return a layer of this plugin as a stack with all that it notes; lazy ones stay lazy."""
    known = {name: keywords[name] for name in ("scale", "translate", "metadata")}
    # With contrast given, since a layer looks for it in all numbers otherwise.
    return stack_of_layer(Image(values, contrast_limits=(0, 1), **known))


def plain_stack(values: Any, keywords: dict[str, Any]) -> xr.DataArray:
    """Return a layer of another origin as a stack; axes that it lacks are one long."""
    axes = PLAIN_AXES[values.ndim]
    scale = keywords.get("scale", np.ones(values.ndim))
    origin = keywords.get("translate", np.zeros(values.ndim))
    units = keywords.get("units") or ("pixel",) * values.ndim
    places = {
        axis: in_unit(unit, LAYER_UNITS[AXES.index(axis)]) * (start + step * np.arange(n))
        for axis, n, step, start, unit in zip(
            axes, values.shape, scale, origin, units, strict=True
        )
    }
    missing = {axis: [0.0] for axis in AXES if axis not in axes}
    return xr.DataArray(values, dims=axes, coords=places).expand_dims(missing).transpose(*AXES)


def in_unit(unit: Any, wanted: str) -> float:
    """Return a unit in seconds, degrees or micrometres; 1 for what is no such unit."""
    registry = pint.get_application_registry()  # type: ignore[no-untyped-call]
    try:
        return float(registry.Quantity(1, str(unit)).to(wanted).magnitude)
    except (pint.DimensionalityError, pint.UndefinedUnitError):
        return 1.0


def with_ending(path: Path) -> Path:
    """Return a path that ends with .ome.tif, or with .ome.zarr if it ends with .zarr."""
    ending = ".zarr" if path.suffix.lower() == ".zarr" else ".tif"
    name = path.name.removesuffix(ending).removesuffix(".ome")
    return path.with_name(f"{name}.ome{ending}")


def euglena_video() -> list[LayerTuple]:
    """Return the simulated hologram video of a swimming euglena."""
    return [hologram_layer(euglena_sample().recording, EUGLENA)]


def cells_video() -> list[LayerTuple]:
    """Return the simulated hologram video of several cells."""
    return [hologram_layer(cells_sample().recording, CELLS)]


def euglena_phase() -> list[LayerTuple]:
    """Return the wrapped phase reconstructed from that video, with the exact phase."""
    sample = euglena_sample()
    lobes = find_lobes(sample.recording, angles_deg=sample.angles_deg)
    wrapped = reconstruct(sample.recording, lobes)["phase"].assign_attrs(object=EUGLENA)
    truth = sample.truth(wrapped).assign_attrs(object=EUGLENA)
    return [
        stack_layer(truth, f"exact phase, {EUGLENA}", "exact", visible=False),
        stack_layer(wrapped, f"wrapped phase, {EUGLENA}", "wrapped"),
    ]


def budding_yeast() -> list[LayerTuple]:
    """Return the simulated phase of a budding yeast, exact and wrapped."""
    data = yeast_sample()
    name = str(data.attrs["object"])
    return [
        stack_layer(data["phase"], f"exact phase, {name}", "exact", visible=False),
        stack_layer(data["wrapped"], f"wrapped phase, {name}", "wrapped"),
    ]


#: Views that are looked for in a hologram.
N_VIEWS = 2
#: How often to look whether the viewer that waits for some work is still there.
LOOK_EVERY_MS = 500


def reconstruct_selected(viewer: Viewer) -> None:
    """Add the wrapped phase of the selected hologram video, two views, default settings."""

    def work(layer: Image, task: Task) -> LayerTuple:
        recording = with_own_optics(recording_of_layer(layer))
        lobes = find_lobes(recording, N_VIEWS, **task.calls)
        data = reconstruct(recording, lobes, **task.calls)
        return stack_layer(data["phase"], f"wrapped phase, {layer.name}", "wrapped")

    on_selected(viewer, is_hologram_layer, "a hologram video", "Reconstructing", work)


def unwrap_2d(viewer: Viewer) -> None:
    """Add the selected wrapped phase, unwrapped frame by frame."""
    unwrap_selected(viewer, "spatial-2d")


def unwrap_ta(viewer: Viewer) -> None:
    """Add the selected wrapped phase, unwrapped along time, then angle."""
    unwrap_selected(viewer, "temporal-angular")


def unwrap_wl1(viewer: Viewer) -> None:
    """Add the selected wrapped phase, unwrapped by directional L1."""
    unwrap_selected(viewer, "directional-l1")


def unwrap_selected(viewer: Viewer, method: str) -> None:
    """Add the selected wrapped phase, unwrapped by a method, from the first frame."""
    label = METHODS[method].label

    def work(layer: Image, task: Task) -> LayerTuple:
        result = unwrap(stack_of_layer(layer), method, **task.calls)
        return stack_layer(result, f"{label}, {layer.name}", "unwrapped")

    on_selected(viewer, is_phase_layer, "wrapped phase", f"Unwrapping by {label}", work)


def optical_path(viewer: Viewer) -> None:
    """Add the optical path difference of the selected unwrapped phase, in nanometres."""

    def work(layer: Image, _: Task) -> LayerTuple:
        stack = stack_of_layer(layer)
        path = stack.copy(data=nanometres(stack))
        path.attrs = {**stack.attrs, "units": "nm"}
        return stack_layer(path, f"optical path (nm), {layer.name}", "optical path")

    on_selected(viewer, is_unwrapped_layer, "unwrapped phase", "Computing the path", work)


def dry_mass_density(viewer: Viewer) -> None:
    """Add the dry mass of the selected unwrapped phase, in picograms a square micrometre."""
    increment = own_refraction_increment()

    def work(layer: Image, _: Task) -> LayerTuple:
        stack = stack_of_layer(layer)
        density = stack.copy(data=nanometres(stack) / np.float32(1000 * increment))
        density.attrs = {**stack.attrs, "units": "pg/um^2", "refraction_increment": increment}
        return stack_layer(density, f"dry mass (pg/µm²), {layer.name}", "dry mass")

    on_selected(viewer, is_unwrapped_layer, "unwrapped phase", "Computing the dry mass", work)


def nanometres(stack: xr.DataArray) -> Any:
    """Return the optical path difference of phase, float32."""
    light = wavelengths_of(stack)
    if light is None:
        light = np.full(stack.sizes["angle"], (own_optics() or Optics()).wavelength_um)
    path_um = stack.values * (light / (2 * np.pi))[:, None, None]
    return (1000 * path_um).astype(np.float32)


def is_unwrapped_layer(layer: Any) -> bool:
    """Say whether a layer is unwrapped phase, exact or computed."""
    return layer.metadata.get(METADATA_KEY, {}).get("kind") in ("unwrapped", "exact")


def is_open(viewer: Viewer) -> bool:
    """Say whether a viewer still has its window."""
    try:
        viewer.window.geometry()
    except (AttributeError, RuntimeError):  # napari has let go of it, or Qt has deleted it
        return False
    return True


def on_selected(
    viewer: Viewer,
    fits: Callable[[Any], bool],
    wanted: str,
    title: str,
    work: Callable[[Image, Task], LayerTuple],
) -> Any:
    """Work on the selected layer in a thread and add what comes of it; say what is wrong.

    Under *activity*, at the lower right of the window, it can be stopped.
    """
    layer = viewer.layers.selection.active
    if not isinstance(layer, Image) or not fits(layer):
        show_error(f"Select a layer with {wanted} first; Plugins > Phase 4D makes one.")
        return None

    ended, hooks = Ended(), Hooks()
    bar = cancelable_progress(total=0, desc=title)
    atexit.register(bar.cancel)

    def guarded() -> None:
        task = Task(None, lambda: bar.is_canceled)
        with hooks.kept():
            ended.do(lambda task: work(layer, task), task)

    def receive(_: object) -> None:
        watching.stop()
        bar.close()
        atexit.unregister(bar.cancel)
        if not is_open(viewer):  # it was closed meanwhile: nobody waits any more
            return
        if bar.is_canceled or isinstance(ended.error, Cancelled):
            show_info(f"{title}: cancelled.")
            return
        for sentence in ended.heard:
            show_warning(sentence)
        if ended.error is not None:
            show_error(sentence_of(ended.error))
            return
        # napari keeps its workers for good, and they this function.
        (data, keywords, _), ended.result = ended.result, None
        viewer.add_image(data, **keywords)
        show_info(f"{title}: done.")

    def look_who_waits() -> None:
        if not is_open(viewer):
            bar.cancel()
            watching.stop()

    watching = QTimer()
    watching.setInterval(LOOK_EVERY_MS)
    watching.timeout.connect(look_who_waits)
    watching.start()
    worker = create_worker(guarded, _start_thread=False)
    hooks.follow(worker)
    worker.returned.connect(receive)
    worker.start()
    return worker
