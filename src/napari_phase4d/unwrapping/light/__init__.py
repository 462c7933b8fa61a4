"""Views of several wavelengths: which belong together, and what they tell of each other."""

from napari_phase4d.unwrapping.light.ladder import Rung, ladder_of, noise_between
from napari_phase4d.unwrapping.light.settling import settled_turns
from napari_phase4d.unwrapping.light.views import (
    Named,
    Together,
    ViewsOf,
    frames_among,
    views_by_light,
)

__all__ = [
    "Named",
    "Rung",
    "Together",
    "ViewsOf",
    "frames_among",
    "ladder_of",
    "noise_between",
    "settled_turns",
    "views_by_light",
]
