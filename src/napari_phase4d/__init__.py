"""From a multiplexed off-axis hologram video to unwrapped phase over time, angle, y and x.

Importing this package imports neither Qt nor napari, and each part only when it is first used.

The chain, in the order of use:

- `Optics`, `open_recording`: the microscope and the hologram video;
- `power_spectrum`, `find_lobes`, `Lobe`: where the views lie in the Fourier plane;
- `reconstruct`: wrapped phase and amplitude;
- `score_boundaries`: which frame is thin enough to start from;
- `METHODS`, `unwrap`, `compare`: unwrapped phase, and methods side by side;
- `confidence`: how far to trust each pixel of a result;
- `find_cells`, `measure`: the cells, followed, and what each of them weighs;
- `Recipe`, `run`: all of it in one call;
- `simulation`: objects with exact phase, and holograms of them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str

    from napari_phase4d import simulation
    from napari_phase4d.analysis import Comparison, compare, find_cells, follow_cells, measure
    from napari_phase4d.analysis.confidence import confidence
    from napari_phase4d.holography import Lobe, find_lobes, power_spectrum, reconstruct
    from napari_phase4d.io import RawLayout, open_phase, open_recording, read_results, write_phase
    from napari_phase4d.optics import Optics
    from napari_phase4d.pipeline import Recipe, run
    from napari_phase4d.recording import Recording
    from napari_phase4d.task import Cancelled
    from napari_phase4d.unwrapping import METHODS, score_boundaries, unwrap

__all__ = [
    "METHODS",
    "Cancelled",
    "CellSettings",
    "Comparison",
    "Lobe",
    "Optics",
    "RawLayout",
    "Recipe",
    "Recording",
    "compare",
    "confidence",
    "find_cells",
    "find_lobes",
    "follow_cells",
    "measure",
    "open_phase",
    "open_recording",
    "power_spectrum",
    "read_results",
    "reconstruct",
    "run",
    "score_boundaries",
    "simulation",
    "unwrap",
    "write_phase",
]

_HOME = {
    "METHODS": "unwrapping",
    "Cancelled": "task",
    "CellSettings": "analysis",
    "Comparison": "analysis",
    "Lobe": "holography",
    "Optics": "optics",
    "RawLayout": "io",
    "Recipe": "pipeline",
    "Recording": "recording",
    "compare": "analysis",
    "confidence": "analysis",
    "find_cells": "analysis",
    "find_lobes": "holography",
    "follow_cells": "analysis",
    "measure": "analysis",
    "open_phase": "io",
    "open_recording": "io",
    "power_spectrum": "holography",
    "read_results": "io",
    "reconstruct": "holography",
    "run": "pipeline",
    "score_boundaries": "unwrapping",
    "unwrap": "unwrapping",
    "write_phase": "io",
}


if not TYPE_CHECKING:  # else type checkers would take every name for one of these

    def __getattr__(name: str) -> Any:
        """Load a public name from its home when it is first asked for."""
        if name == "__version__":
            from importlib import metadata  # which takes as long as all the rest

            return metadata.version("napari-phase4d")
        if name == "simulation":
            return importlib.import_module("napari_phase4d.simulation")
        if name in _HOME:
            return getattr(importlib.import_module(f"napari_phase4d.{_HOME[name]}"), name)
        msg = f"module 'napari_phase4d' has no attribute {name!r}"
        raise AttributeError(msg)


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
