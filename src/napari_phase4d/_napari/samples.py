"""Sample data for File > Open Sample."""

from __future__ import annotations

from napari_phase4d._napari.layers import LayerTuple, hologram_layer, stack_layer
from napari_phase4d.sample import EUGLENA, euglena_sample, yeast_sample

__all__ = ["budding_yeast", "euglena_video"]


def euglena_video() -> list[LayerTuple]:
    """Return the simulated hologram video of a swimming euglena."""
    return [hologram_layer(euglena_sample().recording, EUGLENA)]


def budding_yeast() -> list[LayerTuple]:
    """Return the simulated phase of a budding yeast, exact and wrapped."""
    data = yeast_sample()
    name = str(data.attrs["object"])
    return [
        stack_layer(data["phase"], f"exact phase, {name}", "exact", visible=False),
        stack_layer(data["wrapped"], f"wrapped phase, {name}", "wrapped"),
    ]
