"""The project's own methods: steps are trusted by how little they change along themselves."""

from napari_phase4d.unwrapping.directional.methods import directional_growing, directional_l1

__all__ = ["directional_growing", "directional_l1"]
