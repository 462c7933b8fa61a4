"""Sample data for File > Open Sample."""

from __future__ import annotations

from napari_phase4d._napari.layers import LayerTuple, hologram_layer
from napari_phase4d.sample import euglena_sample

__all__ = ["euglena_video"]


def euglena_video() -> list[LayerTuple]:
    """Return the simulated hologram video of a swimming euglena."""
    return [hologram_layer(euglena_sample().recording)]
