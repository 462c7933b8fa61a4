"""Saving a layer with its times, angles, pixel and where it came from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pint
import xarray as xr
from napari.layers import Image

from napari_phase4d._napari.viewing.layers import LAYER_UNITS, METADATA_KEY
from napari_phase4d._napari.viewing.on_demand import lazy_of
from napari_phase4d._napari.viewing.sources import stack_of_layer
from napari_phase4d.axes import AXES, PLAIN_AXES
from napari_phase4d.io import write_phase

__all__ = ["write_stack"]


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
