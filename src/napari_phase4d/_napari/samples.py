"""Sample data in napari's menu, simulated: their exact phase is known."""

from __future__ import annotations

from napari_phase4d._napari.viewing.layers import LayerTuple, hologram_layer, stack_layer
from napari_phase4d.holography import find_lobes, reconstruct
from napari_phase4d.sample import EUGLENA, euglena_sample, yeast_sample

__all__ = ["budding_yeast", "euglena_phase", "euglena_video"]


def euglena_video() -> list[LayerTuple]:
    """Return the simulated hologram video of a swimming euglena."""
    return [hologram_layer(euglena_sample().recording, EUGLENA)]


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
