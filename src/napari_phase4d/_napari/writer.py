"""Saving a layer with its times, angles, pixel and where it came from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from napari.layers import Image

from napari_phase4d._napari.viewing.layers import AXES, METADATA_KEY
from napari_phase4d._napari.viewing.sources import stack_of_layer
from napari_phase4d.io import write_phase

__all__ = ["write_stack"]


def write_stack(path: str, data: Any, keywords: dict[str, Any]) -> list[str]:
    """Write one 4-D image layer as OME-TIFF that `read_results` and napari open again.

    Parameters
    ----------
    path : str
        File to write; the ending is made ``.ome.tif``.
    data : array_like
        Axes (time, angle, y, x).
    keywords : dict
        The layer's other properties, as napari gives them to writers.

    Returns
    -------
    list of str
        The file that was written.

    Raises
    ------
    ValueError
        If the layer has not these four axes.
    """
    if data.ndim != len(AXES):
        msg = (
            f"“{keywords.get('name', 'the layer')}” has {data.ndim} axes; "
            f"Phase 4D saves stacks with the four axes {', '.join(AXES)}"
        )
        raise ValueError(msg)
    note = keywords.get("metadata", {}).get(METADATA_KEY, {"kind": "image"})
    known = ("name", "scale", "translate")
    shown = {name: keywords[name] for name in known if name in keywords}
    layer = Image(data, **shown, metadata={METADATA_KEY: note})
    return [str(write_phase(with_ending(Path(path)), stack_of_layer(layer)))]


def with_ending(path: Path) -> Path:
    """Return a path that ends with .ome.tif."""
    name = path.name.removesuffix(".tif").removesuffix(".ome")
    return path.with_name(f"{name}.ome.tif")
