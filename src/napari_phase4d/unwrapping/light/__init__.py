"""Views of several wavelengths: which belong together, and what they tell of each other."""

from napari_phase4d.unwrapping.light.steps import settled_turns
from napari_phase4d.unwrapping.light.views import (
    Named,
    Rung,
    Together,
    ViewsOf,
    frames_among,
    ladder_of,
    noise_between,
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
